//! Parts of sequences: any bytes are a part or an error. One form of input is unpacked already, so that the msgpack in
//! it is reached.

#![no_main]

use std::path::Path;

use fluvia_sim::frames::sequence::parse_part;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = parse_part(Path::new("fuzzed"), bytes);
    // A zstd frame of raw blocks, at most 128 KiB each.
    let mut stored = b"\x28\xb5\x2f\xfd\x00\x58".to_vec();
    for block in bytes.chunks(128 << 10) {
        stored.extend(&((block.len() as u32) << 3).to_le_bytes()[..3]);
        stored.extend(block);
    }
    stored.extend([1, 0, 0]);
    let _ = parse_part(Path::new("fuzzed"), &stored);
});

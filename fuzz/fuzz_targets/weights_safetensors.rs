//! Weight files in the form of safetensors: any bytes are weights or an error.

#![no_main]

use fluvia_net::weights;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    // The length of the header is made right, so that the header is reached.
    let end = bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len());
    let file = [&(end as u64).to_le_bytes()[..], bytes].concat();
    let _ = weights::from_bytes("fuzzed", file.clone());
    let _ = weights::summarize_bytes("fuzzed", file);
});

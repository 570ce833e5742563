//! Weight files in the form of PyTorch: any bytes are weights or an error.

#![no_main]

use fluvia_net::weights;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    // The bytes that say which form this is stand before what is tried.
    let file = [&b"PK\x03\x04"[..], bytes].concat();
    let _ = weights::from_bytes("fuzzed", file.clone());
    let _ = weights::summarize_bytes("fuzzed", file);
});

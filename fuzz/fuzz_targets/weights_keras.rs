//! Weight files in the form of Keras: any bytes are weights or an error.

#![no_main]

use fluvia_net::weights;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    // The bytes that say which form this is stand before what is tried.
    let file = [&b"\x89HDF\r\n\x1a\n"[..], bytes].concat();
    let _ = weights::from_bytes("fuzzed", file.clone());
    let _ = weights::summarize_bytes("fuzzed", file);
});

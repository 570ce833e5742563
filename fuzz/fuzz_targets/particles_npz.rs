//! Particle files in the format npz: any bytes are particles or an error.

#![no_main]

use std::path::Path;

use fluvia_sim::frames::{Format, parse};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = parse(Path::new("fuzzed"), Format::Npz, bytes);
});

//! Scene files: any bytes are a scene or an error. The files that it names are not opened.

#![no_main]

use fluvia_sim::scene::Scene;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = Scene::parse(bytes, "fuzzed");
});

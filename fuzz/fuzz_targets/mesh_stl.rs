//! Mesh files in the format stl: any bytes are a mesh or an error.

#![no_main]

use fluvia_sim::mesh::{Format, TriangleMesh};

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(mesh) = TriangleMesh::parse(bytes, Format::Stl) {
        let _ = (mesh.open_edges(), mesh.volume(), mesh.contains(&[[0.0; 3]]));
    }
});

//! Writes the containers and bodies of random scenes as OBJ files to assets/models, for other programs.

use std::path::Path;

use fluvia_sim::scene::random::{BODIES, CONTAINERS};

fn main() -> std::io::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/models");
    std::fs::create_dir_all(&folder)?;
    for model in CONTAINERS.iter().chain(&BODIES) {
        std::fs::write(folder.join(model.shape.name()).with_extension("obj"), model.mesh().to_obj())?;
    }
    Ok(())
}

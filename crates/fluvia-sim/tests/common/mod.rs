//! Scenes for the tests of the solver and the rollout, made without files; and where the reference data are.

#![allow(dead_code, reason = "each test binary uses a part of it")]

use std::path::{Path, PathBuf};

use fluvia_sim::particles::{Boundary, Particles};
use fluvia_sim::scene::{Emitter, Material, Setup};

pub const RADIUS: f32 = 0.025;
pub const GRAVITY: [f32; 3] = [0.0, -9.81, 0.0];
pub const DT: f32 = 0.02;

/// The folder of reference data, or `None` with the reason printed.
pub fn reference() -> Option<PathBuf> {
    let folder = match std::env::var_os("FLUVIA_REFERENCE") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference"),
    };
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no reference data in {} (set FLUVIA_REFERENCE)", folder.display());
    None
}

/// A closed box whose six faces are sampled on regular grids of about the given spacing; normals look inward.
pub fn box_walls(low: [f32; 3], high: [f32; 3], spacing: f32) -> Boundary {
    let mut walls = Boundary::default();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let count = |a: usize| ((high[a] - low[a]) / spacing).round().max(1.0) as usize;
        let at = |a: usize, i: usize| low[a] + (i as f32 + 0.5) * (high[a] - low[a]) / count(a) as f32;
        for (side, direction) in [(low[axis], 1.0), (high[axis], -1.0)] {
            for (i, j) in (0..count(u)).flat_map(|i| (0..count(v)).map(move |j| (i, j))) {
                let (mut position, mut normal) = ([0.0; 3], [0.0; 3]);
                (position[axis], position[u], position[v]) = (side, at(u, i), at(v, j));
                normal[axis] = direction;
                walls.position.push(position);
                walls.normal.push(normal);
            }
        }
    }
    walls
}

/// The positions of a block on a lattice of spacing 2 r, z fastest.
pub fn block(first: [f32; 3], count: [usize; 3]) -> Vec<[f32; 3]> {
    let at = |axis: usize, i: usize| first[axis] + i as f32 * 2.0 * RADIUS;
    let cells = (0..count[0]).flat_map(|x| (0..count[1]).map(move |y| (x, y)));
    cells.flat_map(|(x, y)| (0..count[2]).map(move |z| [at(0, x), at(1, y), at(2, z)])).collect()
}

/// Particles with one velocity, numbered from 0.
pub fn particles(position: Vec<[f32; 3]>, velocity: [f32; 3]) -> Particles {
    let count = position.len();
    Particles::of_one_body(position, vec![velocity; count])
}

/// A small dam break: its box and its particles.
pub fn dam_break() -> (Boundary, Particles) {
    let walls = box_walls([0.0; 3], [0.6, 0.6, 0.4], RADIUS);
    (walls, particles(block([0.05; 3], [4, 6, 6]), [0.0; 3]))
}

/// A body that is emitted in steps `start`, `start + step`, ... below `stop`.
pub fn emitter(position: Vec<[f32; 3]>, velocity: [f32; 3], [start, stop, step]: [u64; 3]) -> Emitter {
    let velocity = vec![velocity; position.len()];
    let material = Material::default();
    Emitter {
        source: "block".into(),
        path: None,
        position,
        velocity,
        unused_velocity: None,
        start,
        stop,
        step,
        material,
    }
}

/// A scene.
pub fn setup(boundary: Boundary, emitters: Vec<Emitter>) -> Setup {
    Setup { boundary, walls: Vec::new(), emitters, gravity: GRAVITY, dt: DT, particle_radius: RADIUS }
}

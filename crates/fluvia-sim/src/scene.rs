//! Scene files: the published JSON and our optional keys.

use std::path::PathBuf;

/// Material of one fluid body; `None` where the scene says nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Material {
    /// The coefficient of Bender & Koschier 2017, dimensionless.
    pub viscosity: Option<f32>,
    /// Rest density, kilograms per cubic metre.
    pub density: Option<f32>,
}

/// A scene turned into particles: everything that a rollout needs.
#[derive(Clone, Debug)]
pub struct Setup {
    /// All wall particles.
    pub boundary: crate::particles::Boundary,
    /// Which wall particles came from which wall of the scene.
    pub walls: Vec<SampledWall>,
    /// One per fluid of the scene, in its order.
    pub emitters: Vec<Emitter>,
    /// External acceleration, metres per second squared.
    pub gravity: [f32; 3],
    /// Seconds between frames.
    pub dt: f32,
    /// Half the particle spacing, metres.
    pub particle_radius: f32,
}

/// The particles of one wall.
#[derive(Clone, Debug)]
pub struct SampledWall {
    /// The file or built-in shape that it was sampled from, as the scene names it.
    pub source: String,
    /// Its rows in [`Setup::boundary`].
    pub range: std::ops::Range<usize>,
}

/// A body of fluid and when it enters the scene: in steps k with `start <= k < stop` and
/// `(k - start) % step == 0`.
#[derive(Clone, Debug)]
pub struct Emitter {
    /// The file or built-in shape that it was sampled from, as the scene names it.
    pub source: String,
    /// The path of that file, if it is one.
    pub path: Option<PathBuf>,
    /// Positions of the particles, metres.
    pub position: Vec<[f32; 3]>,
    /// Velocities of the particles, metres per second.
    pub velocity: Vec<[f32; 3]>,
    /// First step that emits.
    pub start: u64,
    /// First step that does not emit any more.
    pub stop: u64,
    /// Steps between emissions, at least 1.
    pub step: u64,
    /// Its material.
    pub material: Material,
}

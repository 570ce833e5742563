//! Scene files: the published JSON and our optional keys.
//!
//! ```text
//! text -> Scene (what the file says) -> Setup (particles)
//! ```
//!
//! docs/formats.md has the keys. A [`Scene`] keeps what was left out apart from what was given, so that a
//! solver can tell a wish that it cannot fulfil from a default.

mod fields;
mod json;
mod parse;
mod placement;
pub mod random;
mod sample;
mod warnings;
mod write;

use std::ops::Range;
use std::path::{Path, PathBuf};

pub use placement::{Placement, Rotation};

use crate::frames::write_text;
use crate::mesh::TriangleMesh;
use crate::particles::Boundary;
use crate::shapes::Shape;
use crate::{Error, Result};

/// Gravity where a scene says nothing, metres per second squared.
pub const DEFAULT_GRAVITY: [f32; 3] = [0.0, -9.81, 0.0];
/// Seconds between frames where a scene says nothing: the 50 Hz of the published data.
pub const DEFAULT_DT: f32 = 0.02;
/// Particle radius where a scene says nothing, metres: that of the published data.
pub const DEFAULT_PARTICLE_RADIUS: f32 = 0.025;

/// The unit vector against gravity; y without gravity.
pub fn up(gravity: [f32; 3]) -> [f32; 3] {
    let length = gravity.iter().map(|g| g * g).sum::<f32>().sqrt();
    if length > 0.0 { gravity.map(|g| -g / length) } else { [0.0, 1.0, 0.0] }
}

/// The largest scene file that is read, bytes: scenes refer to what is large. JSON takes up to 40 times as much
/// memory as its text.
const MAX_BYTES: u64 = 4 << 20;

/// The scenes that come with the program, by name.
const SHIPPED: [(&str, &str); 8] = [
    ("dam_break", include_str!("../../../assets/scenes/dam_break.json")),
    ("two_bodies", include_str!("../../../assets/scenes/two_bodies.json")),
    ("emitter_step", include_str!("../../../assets/scenes/emitter_step.json")),
    ("obstacle_course", include_str!("../../../assets/scenes/obstacle_course.json")),
    ("river", include_str!("../../../assets/scenes/river.json")),
    ("waterfall", include_str!("../../../assets/scenes/waterfall.json")),
    ("three_viscosities", include_str!("../../../assets/scenes/three_viscosities.json")),
    ("hundred_thousand", include_str!("../../../assets/scenes/hundred_thousand.json")),
];

/// The text of a scene that comes with the program, from assets/scenes; it names no files.
pub fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|scene| scene.0 == name).map(|scene| scene.1)
}

/// The names that [`shipped`] knows.
pub fn shipped_names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|scene| scene.0)
}

/// What a scene file says; `None` where it says nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The file, for messages and as the place that its paths start from.
    pub path: PathBuf,
    /// The walls, in order.
    pub walls: Vec<Wall>,
    /// The fluid bodies, in order; at least one.
    pub fluids: Vec<Fluid>,
    /// External acceleration, metres per second squared.
    pub gravity: Option<[f32; 3]>,
    /// Seconds between frames.
    pub dt: Option<f32>,
    /// Half the particle spacing, metres.
    pub particle_radius: Option<f32>,
    /// The material of all fluids that have none of their own.
    pub material: Material,
}

/// A wall of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Wall {
    /// Where its particles come from.
    pub source: Source,
    /// Where it is put.
    pub placement: Placement,
    /// Whether the fluid is on the side that the faces look to. Normals always point into the fluid.
    pub invert_normals: bool,
}

/// A fluid body of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Fluid {
    /// Where its particles come from.
    pub source: Source,
    /// Where it is put.
    pub placement: Placement,
    /// Metres per second. Velocities in a particle file come first.
    pub velocity: Option<[f32; 3]>,
    /// First step that emits.
    pub start: u64,
    /// First step that does not emit any more.
    pub stop: u64,
    /// Steps between emissions, at least 1.
    pub step: u64,
    /// Its own material.
    pub material: Material,
}

/// Where the particles of a body come from.
#[derive(Clone, Debug, PartialEq)]
pub enum Source {
    /// A mesh file to sample; the path is relative to the scene file.
    Mesh(String),
    /// A file of particles; the path is relative to the scene file.
    Particles(String),
    /// A built-in shape to sample.
    Shape(Shape),
}

impl Source {
    /// The path or name, as in the scene file.
    pub fn name(&self) -> &str {
        match self {
            Source::Mesh(path) | Source::Particles(path) => path,
            Source::Shape(shape) => shape.name(),
        }
    }
}

/// Material of one fluid body; `None` where the scene says nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Material {
    /// The coefficient of Bender & Koschier 2017, dimensionless.
    pub viscosity: Option<f32>,
    /// Rest density, kilograms per cubic metre.
    pub density: Option<f32>,
}

impl Material {
    /// This material, the other where it says nothing.
    pub fn or(self, other: Material) -> Material {
        Material { viscosity: self.viscosity.or(other.viscosity), density: self.density.or(other.density) }
    }
}

impl Scene {
    /// Reads a scene file. The files that it names are read by [`sample`](Scene::sample).
    ///
    /// # Errors
    /// `Io` if the file cannot be read; `File`, with line or key, if it is not a scene.
    pub fn load(path: impl AsRef<Path>) -> Result<Scene> {
        let path = path.as_ref();
        let metadata = std::fs::metadata(path).map_err(Error::io(path))?;
        if metadata.is_dir() {
            return Err(Error::file(path, "a directory, expected a scene file (JSON)"));
        }
        if metadata.len() > MAX_BYTES {
            let message = format!("{} bytes, expected a scene of at most {MAX_BYTES}", metadata.len());
            return Err(Error::file(path, message));
        }
        let bytes = std::fs::read(path).map_err(Error::io(path))?;
        Scene::parse(&bytes, path)
    }

    /// Reads the content of a scene file; `path` is for messages and for the paths in it.
    ///
    /// # Errors
    /// `File`, with line or key, if it is not a scene.
    pub fn parse(text: &[u8], path: impl AsRef<Path>) -> Result<Scene> {
        let path = path.as_ref();
        parse::scene(text, path).map_err(|message| Error::file(path, message))
    }

    /// The text of a scene file that is read back as this scene, its [`path`](Scene::path) aside. Paths in it stay
    /// as they are, so the file belongs where they start from.
    ///
    /// # Errors
    /// `Parameter` if it holds what no scene file can: a number that is not finite, an emitter that never emits.
    pub fn to_json(&self) -> Result<String> {
        write::to_json(self)
    }

    /// Writes the scene file, atomically.
    ///
    /// # Errors
    /// `Io`, and those of [`to_json`](Scene::to_json).
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        write_text(path.as_ref(), &self.to_json()?)
    }

    /// The material of each fluid, the scene's where it has none of its own.
    pub fn materials(&self) -> Vec<Material> {
        self.fluids.iter().map(|fluid| fluid.material.or(self.material)).collect()
    }

    /// The surfaces of the walls, without those that are particle files, with faces that look into the fluid.
    ///
    /// # Errors
    /// If a mesh that the scene names is missing or damaged.
    pub fn surfaces(&self) -> Result<Vec<TriangleMesh>> {
        sample::surfaces(self)
    }

    /// Turns the scene into particles. The same seed gives the same bits.
    ///
    /// # Errors
    /// If a file that the scene names is missing, damaged or no body that can be sampled.
    pub fn sample(&self, seed: u64) -> Result<Setup> {
        sample::sample(self, seed)
    }
}

/// A scene turned into particles: everything that a rollout needs.
#[derive(Clone, Debug)]
pub struct Setup {
    /// All wall particles.
    pub boundary: Boundary,
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

impl Setup {
    /// What will surprise in this set-up though it can be run, one line each: fluid that starts in or against
    /// a wall, bodies that overlap, layers of an emitter that overlap, velocities that are not used.
    pub fn warnings(&self) -> Vec<String> {
        warnings::warnings(self)
    }
}

/// The particles of one wall.
#[derive(Clone, Debug)]
pub struct SampledWall {
    /// The file or built-in shape that it was sampled from, as the scene names it.
    pub source: String,
    /// Its rows in [`Setup::boundary`].
    pub range: Range<usize>,
    /// Its surface, with faces that look into the fluid; `None` if its particles are from a file.
    pub surface: Option<TriangleMesh>,
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
    /// The velocity that the scene gives and that is not used, because the particle file has velocities.
    pub unused_velocity: Option<[f32; 3]>,
    /// First step that emits.
    pub start: u64,
    /// First step that does not emit any more.
    pub stop: u64,
    /// Steps between emissions, at least 1.
    pub step: u64,
    /// Its material, the scene's where it has none of its own.
    pub material: Material,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_is_against_gravity() {
        assert_eq!(up([0.0, -9.81, 0.0]), [0.0, 1.0, 0.0]);
        assert_eq!(up([4.0, 0.0, 0.0]), [-1.0, 0.0, 0.0]);
        assert_eq!(up([0.0; 3]), [0.0, 1.0, 0.0]);
    }
}

//! Particles for meshes: Poisson disks on surfaces, a lattice in volumes.
//!
//! - [`sample_surface`]: floor(1.9 A / (π r²)) points on a surface of area A, as evenly spread as a random
//!   set can be, with the normals of the faces;
//! - [`sample_volume`]: the points of a cubic lattice of spacing 2 r inside a closed surface.
//!
//! r is the particle radius. Both say before they allocate how many particles a mesh would take, and refuse
//! to make more than anyone can have meant.

mod lattice;
mod poisson;

pub use lattice::sample_volume;
pub(crate) use poisson::uniform;
pub use poisson::{sample_surface, surface_count};

/// The most particles of a fluid body, and of all bodies of a scene: a file in millimetres taken for metres has 10⁹
/// times too many.
pub const MAX_FLUID_PARTICLES: u64 = 10_000_000;

/// The most particles of a wall, and of all walls of a scene: the random points that they are chosen from and their
/// neighbour lists take about 800 bytes a particle.
pub const MAX_WALL_PARTICLES: u64 = 2_000_000;

/// Why a mesh cannot be sampled. The messages continue a line that names the mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// The surface has no area.
    #[error("the surface has no area")]
    NoArea,
    /// A volume was asked for and the surface has holes.
    #[error("the mesh is open ({0} open edges), a fluid needs a closed one")]
    Open(
        /// Edges that an odd number of triangles share.
        usize,
    ),
    /// The surface lies on itself so many times that the random points on it have too many neighbours.
    #[error("the surface lies on itself about {times:.0} times; faces that are there once can be sampled")]
    Folded {
        /// How many times, on average.
        times: f64,
    },
    /// There would be more than [`MAX_FLUID_PARTICLES`] or [`MAX_WALL_PARTICLES`].
    #[error(
        "{} in size, which would be about {count:.1e} particles at a spacing of {spacing} m, at most \
         {most:e} are made; the key `scale` makes it smaller (0.001 for a file in millimetres)",
        metres(*size)
    )]
    TooMany {
        /// The size along each axis, metres.
        size: [f64; 3],
        /// The estimated number of particles.
        count: f64,
        /// How many are allowed.
        most: u64,
        /// The distance between particles, metres.
        spacing: f32,
    },
    /// There is no place for a single particle.
    #[error(
        "{} in size, no particle fits at a spacing of {spacing} m; the key `scale` makes it larger",
        metres(*size)
    )]
    TooSmall {
        /// The size along each axis, metres.
        size: [f64; 3],
        /// The distance between particles, metres.
        spacing: f32,
    },
}

fn metres(size: [f64; 3]) -> String {
    // Four digits: more would be those of float32.
    let [x, y, z] = size.map(|x| match format!("{x:.3e}").parse::<f64>() {
        Ok(rounded) if (1e-3..1e6).contains(&rounded) || rounded == 0.0 => rounded.to_string(),
        _ => format!("{x:.3e}"),
    });
    format!("{x} x {y} x {z} m")
}

//! The world without learning: scenes, meshes, particles, files, the rollout loop, classical solvers.
//!
//! ```text
//! scene file -> Scene -> Setup (walls and emitters as particles) -> Rollout(Solver) -> frames on disk
//! ```
//!
//! Units are metres, seconds and kilograms; y is up in the shipped scenes. Files are touched only in
//! [`scene`], [`mesh`] and [`frames`].

pub mod dfsph;
pub mod frames;
pub mod kernel;
pub mod mesh;
pub mod metrics;
pub mod particles;
pub mod pbf;
pub mod pour;
pub mod rollout;
pub mod sampling;
pub mod scene;
pub mod shapes;
pub mod substep;

mod error;
mod parallel;
mod vector;
mod walls;

pub use error::Error;

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

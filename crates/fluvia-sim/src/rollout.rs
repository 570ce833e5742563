//! The rollout loop: a [`Solver`] driven frame by frame, with emitters and removal.

use crate::Result;
use crate::particles::{Acceleration, Particles};

/// What moves the particles. A rollout cannot tell which solver it drives.
///
/// A solver is made for one set of walls, which do not move.
pub trait Solver {
    /// The name written to `run.json`: "pbf", "network".
    fn name(&self) -> &'static str;

    /// Advances `particles` by one frame interval of `dt` seconds under the external acceleration
    /// a_ext of Eq. 10. Particles keep their number and order.
    ///
    /// # Errors
    /// `Parameter` if `dt` or the acceleration is not what the solver was made for. Positions and
    /// velocities that are not finite are left for the rollout to find and report.
    fn step(
        &mut self,
        particles: &mut Particles,
        acceleration: Acceleration<'_>,
        dt: f32,
    ) -> Result<StepInfo>;
}

/// What a solver reports of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepInfo {
    /// How many steps of its own the solver took within the frame interval.
    pub substeps: u32,
    /// The largest number of fluid neighbours of a particle, itself excluded.
    pub max_neighbors: u32,
    /// The radius within which they were counted, metres.
    pub neighbor_radius: f32,
}

//! Densities of what is shown, where somebody wants to see them.

use fluvia_sim::kernel::{CubicSpline, SUPPORT_IN_RADII, wall_volumes};
use fluvia_sim::metrics::density_ratios_within;

/// What each wall particle counts in a density, cubic metres; computed when densities are first wanted.
#[derive(Default)]
pub struct WallVolumes(Option<Vec<f32>>);

impl WallVolumes {
    /// The density at each position over that at rest, beside these walls, which are always the same. `radius` is that of
    /// the particles, metres.
    pub fn ratios(&mut self, positions: &[[f32; 3]], walls: &[[f32; 3]], radius: f32) -> Vec<f32> {
        let kernel = || CubicSpline::new(SUPPORT_IN_RADII * radius);
        let volumes = self.0.get_or_insert_with(|| wall_volumes(walls, &kernel()));
        density_ratios_within(positions, (walls, volumes), radius)
    }
}

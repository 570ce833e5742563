//! Landscapes: ground that water runs over, open above. They are drawn for a scale of 4 x 0.9 x 2.4 m (river) and
//! 2.8 x 1.6 x 1.8 m (falls), at which a bed is about half a metre wide.

use std::f64::consts::TAU;

use super::build::ground;
use crate::mesh::TriangleMesh;

/// Parts of the ground along x and z: as fine as wall particles are apart.
const RIVER_PARTS: [usize; 2] = [96, 64];
const FALLS_PARTS: [usize; 2] = [80, 48];

/// A winding bed that falls from the left to a lake at the right.
pub(super) fn river() -> TriangleMesh {
    ground(RIVER_PARTS, |x, z| {
        // The banks rise to both sides of the bed.
        let middle = -0.13 * (TAU * 1.45 * (x + 0.4)).cos();
        let bed = 0.34 * (1.0 - (x + 0.5) / 0.72).max(0.0);
        let channel = bed + 0.6 * fade(0.03, 0.24, (z - middle).abs());
        let shore = ((x - 0.28) / 0.19).hypot(z / 0.36);
        let ground = channel.min(0.5 * fade(0.62, 1.3, shore));
        ground + rim(0.36, x, z) * (1.0 - ground)
    })
}

/// A bed above a cliff, the cliff, and a pool below it.
pub(super) fn falls() -> TriangleMesh {
    ground(FALLS_PARTS, |x, z| {
        let middle = 0.02 * (9.0 * x).sin();
        let above = 0.6 + 0.04 * fade(CLIFF, -0.45, x) + 0.3 * fade(0.06, 0.3, (z - middle).abs());
        let pool = 0.34 * fade(0.18, 0.46, (0.95 * (x - 0.16)).hypot(0.9 * z));
        // The cliff is as steep as the ground's squares are small.
        let (ground, height) = if x < CLIFF + 1e-9 { (above, 1.0) } else { (pool, 0.44) };
        ground + rim(0.32, x, z) * (height - ground).max(0.0)
    })
}

/// Where the cliff is: on a line of the ground's squares.
const CLIFF: f64 = -0.1;

/// A rim all around that water does not leave by: 0 up to `from` on either axis, 1 at the edges.
fn rim(from: f64, x: f64, z: f64) -> f64 {
    let part = |x: f64| ((x.abs() - from) / (0.5 - from)).max(0.0);
    part(x).max(part(z)).powi(2)
}

/// 0 at `from`, 1 at `to` and beyond, with a smooth way between them.
fn fade(from: f64, to: f64, x: f64) -> f64 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

//! Meshes of the containers of random scenes: boxes with something at the floor. They are drawn for a scale of
//! 2 x 4 x 2 m, at which what is at the floor is 0.2 to 0.5 m high, as in the published containers.

use std::f64::consts::{FRAC_PI_8, PI, TAU};

use super::HALF_SEGMENTS;
use super::build::{above, above_heights, cells, extrude};
use crate::mesh::TriangleMesh;

/// Squares of the hill's floor along each side.
const FLOOR_PARTS: usize = 16;
/// The hill: x and z of its top, its radius and its height.
const HILL: ([f64; 2], f64, f64) = ([0.125, -0.0625], 0.375, 0.0875);
/// The height of the waves from valley to crest, and how many there are.
const WAVES: (f64, f64) = (0.06, 2.5);
/// How much higher the trough is at its sides than in the middle.
const TROUGH_DEPTH: f64 = 0.08;
/// The height of a stair; there are four, the lowest at 0.
const STAIR: f64 = 0.04;

/// Upright, with eight sides.
pub(super) fn tank() -> TriangleMesh {
    let near = 0.5 * FRAC_PI_8.tan();
    let corners = [[0.5, -near], [0.5, near], [near, 0.5], [-near, 0.5]];
    let around: Vec<_> = corners.into_iter().chain(corners.map(|[x, y]| [-x, -y])).collect();
    // The axis z of the prism becomes y.
    extrude(&around).map(|[x, y, z]| [x, z + 0.5, -y])
}

/// A floor that falls along x.
pub(super) fn wedge() -> TriangleMesh {
    above(&[[-0.5, 0.1], [0.5, 0.0]])
}

/// A round floor, lowest in the middle.
pub(super) fn trough() -> TriangleMesh {
    above(&floor_of(|x| TROUGH_DEPTH * (2.0 * x).powi(2)))
}

/// A trench across the floor.
pub(super) fn ditch() -> TriangleMesh {
    let (edge, depth) = (0.2, 0.0625);
    above(&[[-0.5, depth], [-edge, depth], [-edge, 0.0], [edge, 0.0], [edge, depth], [0.5, depth]])
}

/// Four steps down along x.
pub(super) fn stairs() -> TriangleMesh {
    let steps = (0..4).flat_map(|k| {
        let (x, y) = (0.25 * f64::from(k) - 0.5, STAIR * f64::from(3 - k));
        [[x, y], [x + 0.25, y]]
    });
    above(&steps.collect::<Vec<_>>())
}

/// A ridge across the floor, steeper on one side.
pub(super) fn ridge() -> TriangleMesh {
    above(&[[-0.5, 0.0], [-0.3, 0.0], [0.0, 0.08], [0.125, 0.0], [0.5, 0.0]])
}

/// A wavy floor.
pub(super) fn waves() -> TriangleMesh {
    let (height, count) = WAVES;
    above(&floor_of(|x| 0.5 * height * (1.0 + (TAU * count * x).sin())))
}

/// A round hill on the floor.
pub(super) fn hill() -> TriangleMesh {
    let ([x_top, z_top], radius, height) = HILL;
    above_heights(FLOOR_PARTS, |x, z| {
        let distance = ((x - x_top).hypot(z - z_top) / radius).min(1.0);
        0.5 * height * (1.0 + (PI * distance).cos())
    })
}

/// A square post on the floor.
pub(super) fn post() -> TriangleMesh {
    let (x, y, z) = ([-0.5, -0.2, 0.05, 0.5], [0.0, 0.125, 1.0], [-0.5, -0.125, 0.125, 0.5]);
    cells([&x, &y, &z], |cell| cell != [1, 0, 1])
}

/// The obstacle course: from above a slope, a funnel, a landing, stairs and a basin. Drawn for 3.2 x 3.2 x 1.2 m.
pub(super) fn course() -> TriangleMesh {
    let metres: [[f64; 2]; 20] = [
        // The landing below the funnel, three stairs, the basin behind a sill.
        [-1.6, 0.8],
        [-0.1, 0.8],
        [-0.1, 0.6],
        [0.25, 0.6],
        [0.25, 0.4],
        [0.6, 0.4],
        [0.6, 0.25],
        [0.8, 0.25],
        [0.8, 0.0],
        [1.6, 0.0],
        // Up the right side: the roof of the lower room, the funnel's throat, the long slope.
        [1.6, 1.3],
        [-0.4, 1.5],
        [-0.4, 1.75],
        [1.6, 2.25],
        [1.6, 3.2],
        // Down the left side: the steep slope of the funnel, its throat, the roof.
        [-1.6, 3.2],
        [-1.6, 2.5],
        [-0.7, 1.75],
        [-0.7, 1.5],
        [-1.6, 1.4],
    ];
    extrude(&metres.map(|[x, y]| [x / 3.2, y / 3.2]))
}

/// The polyline of heights over x, as fine as what is round.
fn floor_of(height: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
    let at = |k: usize| k as f64 / HALF_SEGMENTS as f64 - 0.5;
    (0..=HALF_SEGMENTS).map(|k| [at(k), height(at(k))]).collect()
}

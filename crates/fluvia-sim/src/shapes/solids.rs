//! Profiles and meshes of the solids.

use std::f64::consts::{PI, TAU};

use super::build::{cells, extrude, revolve};
use super::{HALF_SEGMENTS, TORUS_RADII};
use crate::mesh::TriangleMesh;

/// How much wider than half a circle the egg is below its middle and how much narrower above it.
const EGG_TAPER: f64 = 0.25;
/// The outer and the inner radius of the horseshoe, and the half angle of its opening.
const HORSESHOE: (f64, f64, f64) = (0.5, 0.2, PI / 6.0);
/// The thickness of the horseshoe.
const HORSESHOE_THICKNESS: f64 = 0.5;
/// Half the width of the bars of the jack.
const JACK_HALF_WIDTH: f64 = 0.19;

/// The lower `part` of a half circle of diameter 1 from its lower pole upwards, raised by `height`.
pub(super) fn half_circle(part: f64, height: f64) -> Vec<[f64; 2]> {
    let last = (part * HALF_SEGMENTS as f64) as usize;
    let point = |k: usize| {
        let angle = PI * k as f64 / HALF_SEGMENTS as f64;
        // The poles lie on the axis exactly, so that their corners are one vertex.
        let radius = if k == 0 || k == HALF_SEGMENTS { 0.0 } else { 0.5 * angle.sin() };
        [radius, height - 0.5 * angle.cos()]
    };
    (0..=last).map(point).collect()
}

/// The tube of the torus, closed, from its inner side downwards.
pub(super) fn tube_circle() -> Vec<[f64; 2]> {
    let (ring, tube) = TORUS_RADII;
    let point = |k: usize| {
        let angle = TAU * (k % HALF_SEGMENTS) as f64 / HALF_SEGMENTS as f64;
        [ring - tube * angle.cos(), -tube * angle.sin()]
    };
    (0..=HALF_SEGMENTS).map(point).collect()
}

/// 1 high and 0.8 wide, its blunt end below.
pub(super) fn egg() -> TriangleMesh {
    let narrow = |[radius, y]: [f64; 2]| [0.75 * radius * (1.0 - EGG_TAPER * 2.0 * y), y];
    revolve(&half_circle(1.0, 0.0).into_iter().map(narrow).collect::<Vec<_>>())
}

/// A cube without a quarter.
pub(super) fn elbow() -> TriangleMesh {
    extrude(&[[-0.5, -0.5], [0.5, -0.5], [0.5, 0.0], [0.0, 0.0], [0.0, 0.5], [-0.5, 0.5]])
}

/// A flat ring with an opening towards +x.
pub(super) fn horseshoe() -> TriangleMesh {
    let (outer, inner, opening) = HORSESHOE;
    let point = |radius: f64, k: usize| {
        let angle = opening + (TAU - 2.0 * opening) * k as f64 / HALF_SEGMENTS as f64;
        [radius * angle.cos(), radius * angle.sin()]
    };
    let around = (0..=HALF_SEGMENTS).map(|k| point(outer, k));
    let back = (0..=HALF_SEGMENTS).rev().map(|k| point(inner, k));
    extrude(&around.chain(back).collect::<Vec<_>>()).map(|[x, y, z]| [x, y, HORSESHOE_THICKNESS * z])
}

/// Three bars across each other.
pub(super) fn jack() -> TriangleMesh {
    let planes = [-0.5, -JACK_HALF_WIDTH, JACK_HALF_WIDTH, 0.5];
    cells([&planes; 3], |cell| cell.iter().filter(|&&i| i == 1).count() >= 2)
}

//! Where vertical lines pass through a surface, without gaps or double hits at edges and vertices.
//!
//! In the projection along y, a line is the point p = (x, z), and a triangle is hit if a ray from p along +x
//! crosses an odd number of its sides. Whether it crosses a side depends on that side alone, in the same
//! arithmetic for every triangle that shares it: on a closed surface the crossings of each side cancel
//! between its triangles, so that every line enters as often as it leaves, whatever rounding does.

use super::TriangleMesh;
use super::geometry::{Vec3, cross, sub};

/// A vertical line that passes through a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crossing {
    /// The y of the point.
    pub height: f64,
    /// 1 if the line passes the triangle from one side, -1 from the other.
    pub direction: i32,
}

/// Where the line parallel to y through (x, z) passes through the triangle.
#[inline]
pub(crate) fn crossing(corners: &[Vec3; 3], x: f64, z: f64) -> Option<Crossing> {
    let [a, b, c] = *corners;
    let direction = side(a, b, x, z) + side(b, c, x, z) + side(c, a, x, z);
    if direction == 0 {
        return None;
    }
    let normal = cross(sub(b, a), sub(c, a));
    let height = a[1] - (normal[0] * (x - a[0]) + normal[2] * (z - a[2])) / normal[1];
    let (low, high) = (a[1].min(b[1]).min(c[1]), a[1].max(b[1]).max(c[1]));
    // A triangle seen edge on has no height of its own.
    let height = if height.is_finite() { height.clamp(low, high) } else { 0.5 * (low + high) };
    Some(Crossing { height, direction })
}

/// Whether the ray from (x, z) along +x crosses the side, and in which direction the side runs.
#[inline]
fn side(from: Vec3, to: Vec3, x: f64, z: f64) -> i32 {
    if (from[2] > z) == (to[2] > z) {
        return 0;
    }
    let (low, high, direction) = if from[2] < to[2] { (from, to, 1) } else { (to, from, -1) };
    let at = low[0] + (z - low[2]) / (high[2] - low[2]) * (high[0] - low[0]);
    if x < at { direction } else { 0 }
}

/// What counts as inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Filling {
    /// A winding number other than zero: shells that overlap are filled, cavities are not.
    NonZero,
    /// An odd number of crossings: for faces that do not agree on which side is outside.
    Odd,
}

impl Filling {
    pub(crate) fn of(mesh: &TriangleMesh) -> Filling {
        if mesh.is_oriented() { Filling::NonZero } else { Filling::Odd }
    }

    /// Whether a point is inside, by the sum of the directions of the crossings on one side of it. A sum of ±1
    /// terms is odd exactly if their number is.
    pub(crate) fn is_inside(self, winding: i32) -> bool {
        match self {
            Filling::NonZero => winding != 0,
            Filling::Odd => winding % 2 != 0,
        }
    }
}

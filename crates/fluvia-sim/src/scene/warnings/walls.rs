//! Fluid that starts in a wall or against it.

use rayon::prelude::*;

use super::search;
use crate::mesh::{TriangleMesh, Vec3, cross, distance_to_triangle, dot, sub};
use crate::scene::{SampledWall, Setup};

/// Fluid nearer to a wall than this many radii starts against it. Bodies that touch a wall have their particles
/// [0.55 radii](crate::sampling::sample_volume) away or more: both solvers push those off at less than 1 m/s.
const AGAINST: f64 = 0.5;

/// Fluid less than this many radii behind an open wall starts in it. A body that passes through the wall has
/// layers 2 radii apart: one is this near behind, or another one is [`AGAINST`] it.
const BEHIND: f64 = 1.5;

/// A wall particle from a file stands for the wall this many radii around it.
const AGAINST_PARTICLE: f32 = 0.95;

/// The next wall particle is at most this many radii from any place of a sampled wall.
const WIDEST_GAP: f64 = 1.6;

/// Which of the positions of a body start in the wall or against it.
pub(super) fn against_wall(setup: &Setup, wall: &SampledWall, positions: &[[f32; 3]]) -> Vec<bool> {
    let particles = &setup.boundary.position[wall.range.clone()];
    let Some(surface) = &wall.surface else {
        let neighbors = search(particles, positions, AGAINST_PARTICLE * setup.particle_radius);
        return (0..positions.len()).map(|q| neighbors.count(q) > 0).collect();
    };
    let radius = f64::from(setup.particle_radius);
    // Without closed surface there is no inside, but still a wrong side of the face that is near.
    let behind = behind_closed(surface, positions);
    let reach = if behind.is_some() { AGAINST } else { BEHIND } * radius;
    let around = search(particles, positions, (reach.hypot(WIDEST_GAP * radius)) as f32);
    let is_against = |q: usize| {
        if behind.as_ref().is_some_and(|behind| behind[q]) {
            return true;
        }
        if around.count(q) == 0 {
            return false;
        }
        match nearest(surface, positions[q].map(f64::from), reach) {
            Some(nearest) => nearest.distance < AGAINST * radius || nearest.is_behind,
            None => false,
        }
    };
    (0..positions.len()).into_par_iter().map(is_against).collect()
}

/// Which positions of a body are on the wrong side of a closed wall whose faces look into the fluid; `None` if the
/// wall is not closed. A body that is wholly outside of a container is where it was put; one that is inside as well
/// passes through the wall.
fn behind_closed(surface: &TriangleMesh, positions: &[[f32; 3]]) -> Option<Vec<bool>> {
    if !surface.is_oriented() {
        return None;
    }
    let mut inside = surface.contains(positions);
    let is_container = surface.volume() < 0.0;
    if is_container {
        let has_inside = inside.contains(&true);
        inside.iter_mut().for_each(|inside| *inside = has_inside && !*inside);
    }
    Some(inside)
}

/// The place of a surface that is nearest to a point.
struct Nearest {
    distance: f64,
    /// Whether the point is behind all triangles that meet there.
    is_behind: bool,
}

/// What is nearest to the point within `reach`, if anything is.
fn nearest(surface: &TriangleMesh, point: Vec3, reach: f64) -> Option<Nearest> {
    // Triangles that share the nearest corner or side are equally far but for rounding.
    const SAME: f64 = 1e-6;
    let mut found: Option<Nearest> = None;
    for t in 0..surface.triangles.len() {
        let corners @ [a, b, c] = surface.corners(t);
        let is_far = |k: usize| {
            let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
            point[k] < low - reach || point[k] > high + reach
        };
        if (0..3).any(is_far) {
            continue;
        }
        let distance = distance_to_triangle(point, &corners);
        let best = found.as_ref().map_or(reach, |best| best.distance);
        if distance > best + SAME * reach {
            continue;
        }
        let is_behind = dot(sub(point, a), cross(sub(b, a), sub(c, a))) < 0.0;
        let is_same = found.is_some() && distance > best - SAME * reach;
        let is_behind = is_behind && (!is_same || found.is_some_and(|best| best.is_behind));
        found = Some(Nearest { distance: distance.min(best), is_behind });
    }
    found
}

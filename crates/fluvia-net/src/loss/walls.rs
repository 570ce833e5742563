//! How far particles are into walls, with its derivatives.
//!
//! ```text
//! d_i = Σ_b W_ib n_b · (x_i − x_b) / Σ_b W_ib             the distance to the walls near particle i, negative behind them
//! E = Σ_i w_i max(0, 1/2 − d_i / r)                       fluid at rest keeps 0.7 r from them
//! ∂d_i/∂x_i = Σ_b [W_ib n_b + (n_b · (x_i − x_b) − d_i) ∇W_ib] / Σ_b W_ib
//! ```
//!
//! A distance that is a mean over the wall particles b near by, with their normals n_b, is smooth along edges (Kolluri 2005).
//! Without walls near by there is none, and no loss.

use fluvia_neighbors::Point;
use rayon::prelude::*;

use super::near::{Near, apart};

/// What particles keep clear, particle radii.
const CLEARANCE: f32 = 0.5;

/// E of particles that neighbours were found for, with weights `weight`; its derivatives by the positions are added to
/// `by_position`.
pub fn penetration(near: &Near<'_>, position: &[Point], weight: &[f32], by_position: &mut [Point]) -> f64 {
    let Near { around, kernel, .. } = near;
    let (wall_position, wall_normal, radius) =
        (around.wall_position, around.wall_normal, around.config.particle_radius);
    let of_particle = |(i, by): (usize, &mut Point)| {
        let walls = || {
            near.walls(i).map(|b| {
                let normal = wall_normal[b];
                let (d, distance) = apart(position[i], wall_position[b]);
                let along: f32 = d.iter().zip(normal).map(|(d, n)| d * n).sum();
                (normal, d, along, distance)
            })
        };
        let (mut sum, mut weights) = (0.0, 0.0);
        for (_, _, along, distance) in walls() {
            let value = kernel.value(distance);
            sum += value * along;
            weights += value;
        }
        if weights <= 0.0 {
            return 0.0;
        }
        let d = sum / weights;
        let excess = CLEARANCE - d / radius;
        if excess <= 0.0 {
            return 0.0;
        }
        let slope = -weight[i] / (radius * weights);
        for (normal, apart, along, distance) in walls() {
            let (value, factor) = (kernel.value(distance), (along - d) * kernel.gradient_factor(distance));
            for axis in 0..3 {
                by[axis] += slope * (value * normal[axis] + factor * apart[axis]);
            }
        }
        weight[i] * excess
    };
    let terms: Vec<f32> = by_position.par_iter_mut().enumerate().map(of_particle).collect();
    terms.into_iter().map(f64::from).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::loss::Surroundings;

    /// A floor and a wall that meet along z, in the first of two clouds; the second has none.
    fn corner() -> (Vec<Point>, Vec<Point>) {
        let side = |k: usize| 0.03 * k as f32;
        let cells = || (0..8).flat_map(|a| (0..8).map(move |b| (side(a), side(b))));
        let floor = cells().map(|(x, z)| ([x, 0.0, z], [0.0, 1.0, 0.0]));
        let wall = cells().map(|(y, z)| ([0.0, y + 0.015, z], [1.0, 0.0, 0.0]));
        floor.chain(wall).unzip()
    }

    fn value_and_derivatives(position: &[Point], clouds: &[usize; 3], weight: &[f32]) -> (f64, Vec<Point>) {
        let (wall_position, wall_normal) = corner();
        let around = Surroundings {
            clouds,
            wall_position: &wall_position,
            wall_normal: &wall_normal,
            wall_clouds: &[0, wall_position.len(), wall_position.len()],
            config: &Config::default(),
        };
        let mut near = Near::of(&around);
        near.find(position);
        let mut by = vec![[1.0; 3]; position.len()];
        let value = penetration(&near, position, weight, &mut by);
        (value, by.into_iter().map(|by| by.map(|d| d - 1.0)).collect())
    }

    #[test]
    fn the_derivatives_are_those_of_the_value() {
        let position = [
            [0.1, 0.004, 0.1],
            [0.113, -0.03, 0.087],
            [0.01, 0.005, 0.1],
            [-0.02, 0.1, 0.12],
            [-0.01, -0.02, 0.1],
            [0.1, 0.0, 0.1],
        ];
        let (clouds, weight) = ([0, 5, 6], [1.0, 2.0, 0.5, 3.0, 1.0, 1.0]);
        let (value, by) = value_and_derivatives(&position, &clouds, &weight);
        assert!(value > 1.0, "{value}");
        // Without walls in its cloud.
        assert_eq!(by[5], [0.0; 3]);
        for (k, axis) in (0..5).flat_map(|k| (0..3).map(move |axis| (k, axis))) {
            let moved = |way: f32| {
                let mut position = position;
                position[k][axis] += way;
                value_and_derivatives(&position, &clouds, &weight).0
            };
            let slope = (moved(1e-4) - moved(-1e-4)) / 2e-4;
            let found = f64::from(by[k][axis]);
            assert!((slope - found).abs() < 0.02 * (1.0 + slope.abs()), "{k} {axis}: {slope} and {found}");
        }
    }

    #[test]
    fn particles_in_front_are_free_and_those_behind_are_drawn_back() {
        let at = |x: Point| {
            let (value, by) = value_and_derivatives(&[x], &[0, 1, 1], &[1.0]);
            (value, by[0])
        };
        for x in [[0.1, 0.0125, 0.1], [0.0125, 0.1, 0.1], [0.02, 0.02, 0.1], [0.3, 0.3, 0.3]] {
            let (value, by) = at(x);
            assert!(value < 1e-4 && by.iter().all(|d| d.abs() < 1.0), "{x:?}: {value} {by:?}");
        }
        // d = -0.02 m is 0.8 r.
        let (value, by) = at([0.11, -0.02, 0.11]);
        assert!((value - 1.3).abs() < 1e-3, "{value}");
        assert!(by[1] < -30.0, "{by:?}");
    }
}

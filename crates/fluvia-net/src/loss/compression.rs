//! How far a fluid is compressed, with its derivatives.
//!
//! ```text
//! ρ_i / ρ_0 = V Σ_j W(x_i − x_j) + Σ_b V_b W(x_i − x_b)   fluid, particle i included, and walls; V, V_b their volumes
//! E = Σ_i w_i max(0, ρ_i / ρ_0 − 1)
//! dE/dx_i = V Σ_j (a_i + a_j) ∇W(x_i − x_j) + a_i Σ_b V_b ∇W(x_i − x_b)
//!                                                         a_i: w_i where particle i is compressed, 0 elsewhere
//! ```

use fluvia_neighbors::Point;
use rayon::prelude::*;

use super::near::{Near, apart};

/// E of particles that neighbours were found for, with weights `weight`; its derivatives by the positions are added to
/// `by_position`.
pub fn compression(near: &Near<'_>, position: &[Point], weight: &[f32], by_position: &mut [Point]) -> f64 {
    let Near { around, kernel, volume, wall_volume, .. } = near;
    let wall_position = around.wall_position;
    let excess = |i: usize| {
        let value = |x: Point| kernel.value(apart(position[i], x).1);
        let sum: f32 = near.fluid(i).map(|j| value(position[j])).sum();
        let from_walls: f32 = near.walls(i).map(|b| wall_volume[b] * value(wall_position[b])).sum();
        (volume * sum + from_walls - 1.0).max(0.0)
    };
    let excess: Vec<f32> = (0..position.len()).into_par_iter().map(excess).collect();
    let slope = |i: usize| if excess[i] > 0.0 { weight[i] } else { 0.0 };
    by_position.par_iter_mut().enumerate().for_each(|(i, by)| {
        let mut add = |factor: f32, x: Point| {
            let (d, distance) = apart(position[i], x);
            let factor = factor * kernel.gradient_factor(distance);
            by.iter_mut().zip(d).for_each(|(by, d)| *by += factor * d);
        };
        for j in near.fluid(i) {
            add(volume * (slope(i) + slope(j)), position[j]);
        }
        for b in near.walls(i) {
            add(wall_volume[b] * slope(i), wall_position[b]);
        }
    });
    excess.iter().zip(weight).map(|(&excess, &weight)| f64::from(weight * excess)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::loss::Surroundings;

    /// E and its derivatives, of clouds with walls.
    fn compression(
        position: &[Point],
        clouds: &[usize],
        (wall_position, wall_clouds): (&[Point], &[usize]),
        weight: &[f32],
    ) -> (f64, Vec<Point>) {
        let wall_normal = vec![[0.0; 3]; wall_position.len()];
        let config = &Config::default();
        let around = Surroundings { clouds, wall_position, wall_normal: &wall_normal, wall_clouds, config };
        let mut near = Near::of(&around);
        near.find(position);
        let mut by = vec![[1.0; 3]; position.len()];
        let value = super::compression(&near, position, weight, &mut by);
        (value, by.into_iter().map(|by| by.map(|d| d - 1.0)).collect())
    }

    /// A lattice of 4 x 4 x 4 particles and more.
    fn lattice(count: usize, spacing: f32) -> impl Iterator<Item = Point> {
        (0..count).map(move |k| [k % 4, k / 4 % 4, k / 16].map(|n| spacing * n as f32))
    }

    #[test]
    fn the_derivatives_are_those_of_the_value() {
        // Closer than at rest, in two clouds, a bit irregular, the first with a wall below.
        let shift = |k: usize, axis: usize| 0.004 * ((7 * k + 3 * axis) % 11) as f32 / 11.0;
        let irregular = |(k, x): (usize, Point)| std::array::from_fn(|axis| x[axis] + shift(k, axis));
        let position: Vec<Point> =
            lattice(64, 0.042).chain(lattice(48, 0.042)).enumerate().map(irregular).collect();
        let wall: Vec<Point> =
            (0..36).map(|k| [0.03 * (k % 6) as f32, -0.02, 0.03 * (k / 6) as f32]).collect();
        let walls = (wall.as_slice(), &[0, 36, 36][..]);
        let weight: Vec<f32> = (0..112).map(|k| 0.5 + (k % 5) as f32).collect();
        let clouds = [0, 64, 112];
        let (value, by) = compression(&position, &clouds, walls, &weight);
        assert!(value > compression(&position, &clouds, (&[], &[0, 0, 0]), &weight).0 + 1.0);
        for (k, axis) in [(0, 0), (1, 1), (21, 1), (42, 2), (63, 0), (64, 1), (100, 2)] {
            let moved = |way: f32| {
                let mut position = position.clone();
                position[k][axis] += way;
                compression(&position, &clouds, walls, &weight).0
            };
            let slope = (moved(1e-4) - moved(-1e-4)) / 2e-4;
            let found = f64::from(by[k][axis]);
            assert!((slope - found).abs() < 0.02 * (1.0 + slope.abs()), "{k} {axis}: {slope} and {found}");
        }
    }

    #[test]
    fn fluid_at_rest_and_particles_alone_are_not_compressed() {
        let lattice: Vec<Point> = lattice(64, 0.05).collect();
        let nowhere = (&[][..], &[0, 0][..]);
        let (value, by) = compression(&lattice, &[0, 64], nowhere, &[1.0; 64]);
        assert_eq!(value, 0.0);
        assert!(by.iter().flatten().all(|d| *d == 0.0));
        // Two clouds that lie in the same place do not see each other.
        let twice: Vec<Point> = lattice.iter().chain(&lattice).copied().collect();
        let of_two = (&[][..], &[0, 0, 0][..]);
        assert_eq!(compression(&twice, &[0, 64, 128], of_two, &[1.0; 128]).0, 0.0);
        assert!(compression(&twice, &[0, 128], nowhere, &[1.0; 128]).0 > 10.0);
        // A particle at a wall is pushed away from it.
        let wall: Vec<Point> =
            (0..121).map(|k| [0.03 * (k % 11) as f32, 0.0, 0.03 * (k / 11) as f32]).collect();
        let (value, by) = compression(&[[0.15, 0.01, 0.15]], &[0, 1], (&wall, &[0, 121]), &[1.0]);
        assert!(value > 0.1 && by[0][1] < -1.0, "{value} {by:?}");
    }
}

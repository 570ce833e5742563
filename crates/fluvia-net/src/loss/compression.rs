//! How far a fluid is compressed, with its derivatives.
//!
//! ```text
//! ρ_i / ρ_0 = V Σ_j W(x_i − x_j)                          the fluid alone, particle i included; V its volume at rest
//! E = Σ_i w_i max(0, ρ_i / ρ_0 − 1)
//! dE/dx_i = V Σ_j (a_i + a_j) ∇W(x_i − x_j)               a_i: w_i where particle i is compressed, 0 elsewhere
//! ```

use fluvia_neighbors::{Grids, Neighbors, Options, Point, Radius};
use fluvia_sim::kernel::{CubicSpline, SUPPORT_IN_RADII};
use fluvia_sim::metrics::particle_volume;
use rayon::prelude::*;

/// E of clouds of particles with weights `weight`; its derivatives by the positions are added to `by_position`.
pub(super) fn compression(
    position: &[Point],
    clouds: &[usize],
    weight: &[f32],
    particle_radius: f32,
    by_position: &mut [Point],
) -> f64 {
    let kernel = CubicSpline::new(SUPPORT_IN_RADII * particle_radius);
    let volume = particle_volume(particle_radius);
    let (mut grids, mut neighbors) = (Grids::new(), Neighbors::default());
    grids.build(position, clouds, kernel.support());
    let radius = Radius::Uniform(kernel.support());
    grids.search(position, clouds, radius, &Options::default(), &mut neighbors);
    let apart = |i: usize, j: u32| -> (Point, f32) {
        let (a, b) = (position[i], position[j as usize]);
        let d: Point = std::array::from_fn(|axis| a[axis] - b[axis]);
        (d, d.iter().map(|x| x * x).sum::<f32>().sqrt())
    };
    let excess = |i: usize| {
        let sum: f32 = neighbors.row(i).iter().map(|&j| kernel.value(apart(i, j).1)).sum();
        (volume * sum - 1.0).max(0.0)
    };
    let excess: Vec<f32> = (0..position.len()).into_par_iter().map(excess).collect();
    let slope = |i: usize| if excess[i] > 0.0 { weight[i] } else { 0.0 };
    by_position.par_iter_mut().enumerate().for_each(|(i, by)| {
        for &j in neighbors.row(i) {
            let (d, distance) = apart(i, j);
            let factor = volume * (slope(i) + slope(j as usize)) * kernel.gradient_factor(distance);
            by.iter_mut().zip(d).for_each(|(by, d)| *by += factor * d);
        }
    });
    excess.iter().zip(weight).map(|(&excess, &weight)| f64::from(weight * excess)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lattice of spacing 0.042 m, compressed for particles of 0.05 m, in two clouds, and a bit irregular.
    fn clouds() -> (Vec<Point>, [usize; 3]) {
        let at = |k: usize| [k % 4, k / 4 % 4, k / 16].map(|n| 0.042 * n as f32);
        let shift = |k: usize, axis: usize| 0.004 * ((7 * k + 3 * axis) % 11) as f32 / 11.0;
        let point = |k: usize| std::array::from_fn(|axis| at(k)[axis] + shift(k, axis));
        ((0..64).chain(0..48).map(point).collect(), [0, 64, 112])
    }

    #[test]
    fn the_derivatives_are_those_of_the_value() {
        let (position, clouds) = clouds();
        let weight: Vec<f32> = (0..112).map(|k| 0.5 + (k % 5) as f32).collect();
        let value = |position: &[Point]| {
            compression(position, &clouds, &weight, 0.025, &mut vec![[0.0; 3]; position.len()])
        };
        let mut by = vec![[1.0; 3]; 112];
        assert!(compression(&position, &clouds, &weight, 0.025, &mut by) > 1.0);
        for (k, axis) in [(0, 0), (21, 1), (42, 2), (63, 0), (64, 1), (100, 2)] {
            let moved = |way: f32| {
                let mut position = position.clone();
                position[k][axis] += way;
                value(&position)
            };
            let slope = (moved(1e-4) - moved(-1e-4)) / 2e-4;
            let found = f64::from(by[k][axis] - 1.0);
            assert!((slope - found).abs() < 0.02 * (1.0 + slope.abs()), "{k} {axis}: {slope} and {found}");
        }
    }

    #[test]
    fn fluid_at_rest_and_particles_alone_are_not_compressed() {
        let lattice: Vec<Point> =
            (0..64).map(|k| [k % 4, k / 4 % 4, k / 16].map(|n| 0.05 * n as f32)).collect();
        let mut by = vec![[0.0; 3]; 64];
        assert_eq!(compression(&lattice, &[0, 64], &[1.0; 64], 0.025, &mut by), 0.0);
        assert!(by.iter().flatten().all(|d| *d == 0.0));
        // Two clouds that lie in the same place do not see each other.
        let twice: Vec<Point> = lattice.iter().chain(&lattice).copied().collect();
        let mut by = vec![[0.0; 3]; 128];
        assert_eq!(compression(&twice, &[0, 64, 128], &[1.0; 128], 0.025, &mut by), 0.0);
        assert!(compression(&twice, &[0, 128], &[1.0; 128], 0.025, &mut by) > 10.0);
    }
}

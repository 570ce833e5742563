//! How far a fluid is compressed, with its derivatives.
//!
//! ```text
//! ρ_i / ρ_0 = V Σ_j W(x_i − x_j) + Σ_b V_b W(x_i − x_b)   fluid, particle i included, and walls; V, V_b their volumes
//! E = Σ_i w_i max(0, ρ_i / ρ_0 − 1)
//! dE/dx_i = V Σ_j (a_i + a_j) ∇W(x_i − x_j) + a_i Σ_b V_b ∇W(x_i − x_b)
//!                                                         a_i: w_i where particle i is compressed, 0 elsewhere
//! ```
//!
//! A particle at a wall has the density of the wall beside its own and is pushed away from it: inwards, as long as it is
//! in front of the wall.

use fluvia_neighbors::{Grids, Neighbors, Options, Point, Radius};
use fluvia_sim::kernel::{CubicSpline, SUPPORT_IN_RADII, wall_volumes};
use fluvia_sim::metrics::particle_volume;
use rayon::prelude::*;

use super::Scene;

/// What does not change from step to step.
pub(super) struct Compression<'a> {
    scene: &'a Scene<'a>,
    kernel: CubicSpline,
    /// Of a particle at rest, cubic metres.
    volume: f32,
    wall_volume: Vec<f32>,
    walls: Grids,
}

impl<'a> Compression<'a> {
    pub fn of(scene: &'a Scene<'a>) -> Compression<'a> {
        let Scene { wall_position, wall_clouds, config, .. } = scene;
        let kernel = CubicSpline::new(SUPPORT_IN_RADII * config.particle_radius);
        let volumes =
            wall_clouds.windows(2).map(|wall| wall_volumes(&wall_position[wall[0]..wall[1]], &kernel));
        let wall_volume = volumes.collect::<Vec<_>>().concat();
        let mut walls = Grids::new();
        walls.build(wall_position, wall_clouds, kernel.support());
        Compression { scene, kernel, volume: particle_volume(config.particle_radius), wall_volume, walls }
    }

    /// E of particles with weights `weight`; its derivatives by the positions are added to `by_position`.
    pub fn add(&mut self, position: &[Point], weight: &[f32], by_position: &mut [Point]) -> f64 {
        let Compression { scene: Scene { clouds, wall_position, .. }, kernel, volume, wall_volume, walls } =
            self;
        let (radius, options) = (Radius::Uniform(kernel.support()), Options::default());
        let (mut fluid, mut of_fluid, mut of_walls) =
            (Grids::new(), Neighbors::default(), Neighbors::default());
        fluid.build(position, clouds, kernel.support());
        fluid.search(position, clouds, radius, &options, &mut of_fluid);
        walls.search(position, clouds, radius, &options, &mut of_walls);
        let excess = |i: usize| {
            let value = |x: Point| kernel.value(apart(position[i], x).1);
            let sum: f32 = of_fluid.row(i).iter().map(|&j| value(position[j as usize])).sum();
            let of_walls = of_walls.row(i).iter().map(|&b| b as usize);
            let from_walls: f32 = of_walls.map(|b| wall_volume[b] * value(wall_position[b])).sum();
            (*volume * sum + from_walls - 1.0).max(0.0)
        };
        let excess: Vec<f32> = (0..position.len()).into_par_iter().map(excess).collect();
        let slope = |i: usize| if excess[i] > 0.0 { weight[i] } else { 0.0 };
        by_position.par_iter_mut().enumerate().for_each(|(i, by)| {
            let mut add = |factor: f32, x: Point| {
                let (d, distance) = apart(position[i], x);
                let factor = factor * kernel.gradient_factor(distance);
                by.iter_mut().zip(d).for_each(|(by, d)| *by += factor * d);
            };
            for j in of_fluid.row(i).iter().map(|&j| j as usize) {
                add(*volume * (slope(i) + slope(j)), position[j]);
            }
            for b in of_walls.row(i).iter().map(|&b| b as usize) {
                add(wall_volume[b] * slope(i), wall_position[b]);
            }
        });
        excess.iter().zip(weight).map(|(&excess, &weight)| f64::from(weight * excess)).sum()
    }
}

/// a − b and its length.
fn apart(a: Point, b: Point) -> (Point, f32) {
    let d: Point = std::array::from_fn(|axis| a[axis] - b[axis]);
    (d, d.iter().map(|x| x * x).sum::<f32>().sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    /// E and its derivatives, of clouds with walls.
    fn compression(
        position: &[Point],
        clouds: &[usize],
        (wall_position, wall_clouds): (&[Point], &[usize]),
        weight: &[f32],
    ) -> (f64, Vec<Point>) {
        let scene = Scene { clouds, wall_position, wall_clouds, config: &Config::default() };
        let mut by = vec![[1.0; 3]; position.len()];
        let value = Compression::of(&scene).add(position, weight, &mut by);
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
        // A particle in a wall is pushed away from it.
        let wall: Vec<Point> =
            (0..121).map(|k| [0.03 * (k % 11) as f32, 0.0, 0.03 * (k / 11) as f32]).collect();
        let (value, by) = compression(&[[0.15, 0.01, 0.15]], &[0, 1], (&wall, &[0, 121]), &[1.0]);
        assert!(value > 0.1 && by[0][1] < -1.0, "{value} {by:?}");
    }
}

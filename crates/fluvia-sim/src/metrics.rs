//! Pure functions that judge a state: density, escapes, energy, the distance of Eq. 18.

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use rayon::prelude::*;

use crate::kernel::{CubicSpline, SUPPORT_IN_RADII, distance, wall_volumes};
use crate::particles::Particles;

/// The volume of a fluid particle at rest as a fraction of its lattice cell (2 r)³: a lattice of spacing
/// 2 r is at 0.8 of rest density, as in the published data.
pub const VOLUME_FRACTION: f32 = 0.8;

/// Edge of the cells that [`distance_to_closest`] searches first, metres: about one particle spacing.
const FIRST_SEARCH_RADIUS: f32 = 0.05;

/// An axis-aligned box, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// The lowest coordinates.
    pub low: [f32; 3],
    /// The highest coordinates.
    pub high: [f32; 3],
}

impl Bounds {
    /// The bounding box of points; `None` if there are none.
    pub fn of(points: &[[f32; 3]]) -> Option<Bounds> {
        let first = *points.first()?;
        let start = Bounds { low: first, high: first };
        Some(points.iter().fold(start, |bounds, point| Bounds {
            low: std::array::from_fn(|a| bounds.low[a].min(point[a])),
            high: std::array::from_fn(|a| bounds.high[a].max(point[a])),
        }))
    }

    /// Whether a point lies in the box widened by `slack` on every side. A point that is not finite does
    /// not.
    pub fn contains(&self, point: [f32; 3], slack: f32) -> bool {
        (0..3).all(|a| point[a] >= self.low[a] - slack && point[a] <= self.high[a] + slack)
    }
}

/// How many positions lie more than `slack` beyond `bounds`. What a rollout reports as `outside` has the
/// walls' bounding box and a slack of one particle radius.
pub fn outside(positions: &[[f32; 3]], bounds: &Bounds, slack: f32) -> usize {
    positions.iter().filter(|point| !bounds.contains(**point, slack)).count()
}

/// The density of every particle over the rest density,
/// ρ_i / ρ_0 = Σ_j V W(x_i - x_j) + Σ_b V_b W(x_i - x_b), with V = 0.8 (2 r)³, the cubic spline of support
/// 4 r and the wall volumes of Akinci et al. (2012). `walls` may be empty.
pub fn density_ratios(positions: &[[f32; 3]], walls: &[[f32; 3]], particle_radius: f32) -> Vec<f32> {
    let kernel = CubicSpline::new(SUPPORT_IN_RADII * particle_radius);
    density_ratios_within(positions, (walls, &wall_volumes(walls, &kernel)), particle_radius)
}

/// [`density_ratios`] within walls whose volumes are known ([`wall_volumes`]).
///
/// # Panics
/// If there is not one volume per wall particle.
pub fn density_ratios_within(
    positions: &[[f32; 3]],
    (walls, volumes): (&[[f32; 3]], &[f32]),
    particle_radius: f32,
) -> Vec<f32> {
    assert_eq!(walls.len(), volumes.len(), "one volume per wall particle");
    let kernel = CubicSpline::new(SUPPORT_IN_RADII * particle_radius);
    let fluid = vec![particle_volume(particle_radius); positions.len()];
    let mut ratios = kernel_sums(positions, positions, &fluid, &kernel);
    if !walls.is_empty() {
        let from_walls = kernel_sums(positions, walls, volumes, &kernel);
        ratios.iter_mut().zip(from_walls).for_each(|(ratio, wall)| *ratio += wall);
    }
    ratios
}

/// The volume of a fluid particle at rest, cubic metres.
pub fn particle_volume(particle_radius: f32) -> f32 {
    VOLUME_FRACTION * (2.0 * particle_radius).powi(3)
}

/// The mean over particles of max(0, ρ / ρ_0 - 1); 0 without particles.
pub fn mean_compression(density_ratios: &[f32]) -> f64 {
    mean(density_ratios.iter().map(|&ratio| f64::from((ratio - 1.0).max(0.0))))
}

/// The mean of |v|² / 2, joules per kilogram; 0 without particles.
pub fn kinetic_energy(velocities: &[[f32; 3]]) -> f64 {
    mean(velocities.iter().map(|v| 0.5 * v.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>()))
}

/// The mean of -g · x, joules per kilogram; 0 without particles.
pub fn potential_energy(positions: &[[f32; 3]], gravity: [f32; 3]) -> f64 {
    let g = gravity.map(f64::from);
    mean(positions.iter().map(|x| -(0..3).map(|a| g[a] * f64::from(x[a])).sum::<f64>()))
}

/// The root mean square horizontal distance from the centre of mass, metres; `None` without particles.
pub fn spread(positions: &[[f32; 3]]) -> Option<f64> {
    let center = mean_vector(positions)?;
    let squared = |x: &[f32; 3]| [0, 2].map(|a| (f64::from(x[a]) - center[a]).powi(2)).iter().sum::<f64>();
    Some(mean(positions.iter().map(squared)).sqrt())
}

/// The height of the surface, metres: the median over square columns of the given width of the highest particle in each
/// that has one. `None` without particles.
pub fn surface_height(positions: &[[f32; 3]], column: f32) -> Option<f32> {
    let mut highest = std::collections::BTreeMap::new();
    for x in positions {
        let key = [0, 2].map(|a| (x[a] / column).floor() as i64);
        let height = highest.entry(key).or_insert(f32::NEG_INFINITY);
        *height = x[1].max(*height);
    }
    median(highest.into_values().collect())
}

/// The distance of every particle to the nearest other, metres; infinite for a particle alone.
pub fn nearest_distances(positions: &[[f32; 3]], particle_radius: f32) -> Vec<f32> {
    // Twice the spacing of a body: nearly all have a neighbour there.
    let near = 4.0 * particle_radius;
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    grid.build(positions, near);
    grid.search(positions, Radius::Uniform(near), &Options::default(), &mut neighbors);
    let nearest = |i: usize| {
        let to = |k: usize| distance(positions[i], positions[k]);
        let found = neighbors.row(i).iter().map(|&k| k as usize).filter(|&k| k != i).map(to);
        match found.fold(f32::INFINITY, f32::min) {
            f32::INFINITY => (0..positions.len()).filter(|&k| k != i).map(to).fold(f32::INFINITY, f32::min),
            nearest => nearest,
        }
    };
    (0..positions.len()).into_par_iter().map(nearest).collect()
}

/// The middle of the values in their order, the upper one of two; `None` if there are none.
pub fn median(mut values: Vec<f32>) -> Option<f32> {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The mean of vectors: of positions the centre of mass, metres; of velocities the momentum per mass, metres per second.
/// `None` without particles.
pub fn mean_vector(vectors: &[[f32; 3]]) -> Option<[f64; 3]> {
    let along = |axis: usize| mean(vectors.iter().map(|vector| f64::from(vector[axis])));
    (!vectors.is_empty()).then(|| std::array::from_fn(along))
}

/// The mean of |v|, metres per second; 0 without particles.
pub fn mean_speed(velocities: &[[f32; 3]]) -> f64 {
    mean(velocities.iter().map(|v| v.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>().sqrt()))
}

/// The largest |v|, metres per second; 0 without particles. The largest float32 for what is beyond it.
pub fn highest_speed(velocities: &[[f32; 3]]) -> f32 {
    // The square of a float32 need not be one.
    let squared = velocities.iter().map(|v| v.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>());
    squared.fold(0.0, f64::max).sqrt().min(f64::from(f32::MAX)) as f32
}

/// The first particle with a number that is not finite: its row, and "position" or "velocity".
pub fn first_non_finite(particles: &Particles) -> Option<(usize, &'static str)> {
    let finite = |v: &[f32; 3]| v.iter().all(|c| c.is_finite());
    (0..particles.len()).find_map(|i| {
        if !finite(&particles.position[i]) {
            Some((i, "position"))
        } else if !finite(&particles.velocity[i]) {
            Some((i, "velocity"))
        } else {
            None
        }
    })
}

/// Eq. 18: the mean over the true positions of the distance to the closest predicted one, metres,
/// d = 1/N Σ_i min_x |x̂_i - x|. One-sided as in the paper: a predicted particle far from all true ones does
/// not count. `None` if either set is empty.
pub fn distance_to_closest(truth: &[[f32; 3]], predicted: &[[f32; 3]]) -> Option<f64> {
    if truth.is_empty() || predicted.is_empty() {
        return None;
    }
    let mut closest = vec![f32::INFINITY; truth.len()];
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    grid.build(predicted, FIRST_SEARCH_RADIUS);
    let near = Radius::Uniform(FIRST_SEARCH_RADIUS);
    grid.search(truth, near, &Options::default(), &mut neighbors);
    closest.par_iter_mut().enumerate().for_each(|(i, closest)| {
        let distance = |&k: &u32| distance(truth[i], predicted[k as usize]);
        *closest = neighbors.row(i).iter().map(distance).fold(f32::INFINITY, f32::min);
        if *closest == f32::INFINITY {
            let distance = |x: &[f32; 3]| crate::kernel::distance(truth[i], *x);
            *closest = predicted.iter().map(distance).fold(f32::INFINITY, f32::min);
        }
    });
    Some(mean(closest.iter().map(|&d| f64::from(d))))
}

/// For every query, the sum over the points of volume times kernel.
fn kernel_sums(queries: &[[f32; 3]], points: &[[f32; 3]], volumes: &[f32], kernel: &CubicSpline) -> Vec<f32> {
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    grid.build(points, kernel.support());
    grid.search(queries, Radius::Uniform(kernel.support()), &Options::default(), &mut neighbors);
    let sum = |q: usize| {
        let term = |&i: &u32| volumes[i as usize] * kernel.value(distance(queries[q], points[i as usize]));
        neighbors.row(q).iter().map(term).sum()
    };
    (0..queries.len()).into_par_iter().map(sum).collect()
}

/// The mean of values; 0 if there are none.
fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1);
    values.sum::<f64>() / count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lattice(side: usize, spacing: f32) -> Vec<[f32; 3]> {
        let at = |i: usize| i as f32 * spacing;
        let cells = (0..side).flat_map(|x| (0..side).flat_map(move |y| (0..side).map(move |z| (x, y, z))));
        cells.map(|(x, y, z)| [at(x), at(y), at(z)]).collect()
    }

    #[test]
    fn lattice_is_at_four_fifths_of_rest_density() {
        let positions = lattice(9, 0.05);
        let ratios = density_ratios(&positions, &[], 0.025);
        let middle = ratios[(4 * 9 + 4) * 9 + 4];
        // The lattice sum of the kernel differs from its integral by less than 1 %.
        assert!((middle - 0.8).abs() < 0.008, "{middle}");
        assert_eq!(mean_compression(&[0.5, 1.02, 1.0]), f64::from(1.02_f32 - 1.0) / 3.0);
    }

    #[test]
    fn walls_add_density() {
        let wall: Vec<_> = lattice(12, 0.025).into_iter().filter(|x| x[1] == 0.0).collect();
        let alone = density_ratios(&[[0.14, 0.02, 0.14]], &[], 0.025)[0];
        let beside = density_ratios(&[[0.14, 0.02, 0.14]], &wall, 0.025)[0];
        assert!(beside > 2.0 * alone, "{alone} and {beside}");
    }

    #[test]
    fn outside_counts_beyond_the_slack_only() {
        let bounds = Bounds::of(&[[0.0; 3], [1.0; 3]]).unwrap();
        let points = [[0.5; 3], [-0.02, 0.5, 0.5], [0.5, 1.03, 0.5], [f32::NAN; 3]];
        assert_eq!(outside(&points, &bounds, 0.025), 2);
        assert_eq!(Bounds::of(&[]), None);
    }

    #[test]
    fn energy_center_and_speed() {
        let velocities = [[3.0, 0.0, 4.0], [0.0; 3]];
        assert_eq!(kinetic_energy(&velocities), 6.25);
        assert_eq!(highest_speed(&velocities), 5.0);
        assert_eq!((mean_speed(&velocities), mean_speed(&[])), (2.5, 0.0));
        assert_eq!(highest_speed(&[[1e20, 0.0, 0.0]]), 1e20);
        assert_eq!(highest_speed(&[[f32::MAX; 3]]), f32::MAX);
        assert_eq!(mean_vector(&[[1.0, 2.0, 3.0], [3.0, 2.0, 1.0]]), Some([2.0; 3]));
        assert_eq!((kinetic_energy(&[]), highest_speed(&[]), mean_vector(&[])), (0.0, 0.0, None));
    }

    #[test]
    fn potential_energy_spread_surface_and_nearest() {
        let positions = [[0.0, 1.0, 0.0], [0.06, 3.0, 0.08], [0.5, 0.25, 0.5]];
        let expected = 9.81 * 4.25 / 3.0;
        assert!((potential_energy(&positions, [0.0, -9.81, 0.0]) - expected).abs() < 1e-5);
        // The first two share a column of 0.1 m.
        assert_eq!(surface_height(&positions, 0.1), Some(3.0));
        assert_eq!(surface_height(&positions, 0.01), Some(1.0));
        assert_eq!(spread(&[[0.3, 1.0, 0.4], [-0.3, 2.0, -0.4]]).map(|s| (1e6 * s).round()), Some(5e5));
        let nearest = nearest_distances(&[[0.0; 3], [0.03, 0.0, 0.04], [0.0, 0.0, 9.0]], 0.025);
        assert!((nearest[0] - 0.05).abs() < 1e-7 && nearest[0] == nearest[1], "{nearest:?}");
        assert!(nearest[2] > 8.9, "{nearest:?}");
        assert_eq!(nearest_distances(&[[0.0; 3]], 0.025), [f32::INFINITY]);
        assert_eq!((surface_height(&[], 0.1), spread(&[]), median(Vec::new())), (None, None, None));
    }

    #[test]
    fn first_non_finite_names_row_and_quantity() {
        let mut particles = Particles::of_one_body(vec![[0.0; 3]; 3], vec![[0.0; 3]; 3]);
        assert_eq!(first_non_finite(&particles), None);
        particles.velocity[1][2] = f32::INFINITY;
        particles.position[2][0] = f32::NAN;
        assert_eq!(first_non_finite(&particles), Some((1, "velocity")));
    }

    #[test]
    fn distance_is_one_sided_and_finds_far_points() {
        let truth = [[0.0; 3], [1.0, 0.0, 0.0]];
        let predicted = [[0.01, 0.0, 0.0], [0.5, 0.0, 0.0], [90.0; 3]];
        let d = distance_to_closest(&truth, &predicted).unwrap();
        assert!((d - (0.01 + 0.5) / 2.0).abs() < 1e-7, "{d}");
        assert_eq!(distance_to_closest(&[], &predicted), None);
    }
}

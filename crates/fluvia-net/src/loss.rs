//! The loss of training, Eq. 16 and 17, with its derivatives.
//!
//! ```text
//! φ_i = exp(−|N(x*_i)| / c)                         N(x*_i): the fluid neighbours of particle i, itself excluded
//! L_k = 1/N Σ_i φ_i (|x_i − x̂_i|² + ε)^(γ/2)        step k of a cloud of N particles (16)
//! L   = s / (C K) Σ L_k                             the mean over C clouds and K steps (17), times s = 128
//! ```
//!
//! The paper sums where the published code takes means and multiplies with s, the inverse of the scale of the network's
//! output: what Adam makes of the gradient does not depend on it but for its ε. φ counts as a constant. With velocities in
//! the loss, L_k has the same term for Δt |v_i − v̂_i| / 2, half the way that the difference makes in a step, with the
//! same φ_i; with compression, it has 1/N Σ_i κ max(0, ρ_i / ρ_0 − 1), which no distance to the truth tells from a shift;
//! with walls, 1/N Σ_i λ max(0, 1/2 − d_i / r), for what is far off, as what has left through a wall, hardly moves
//! Eq. 16.

use fluvia_neighbors::Point;

use crate::config::Config;
use crate::integrate::State;

mod compression;
mod near;
mod walls;

use compression::compression;
use near::Near;
use walls::penetration;

/// s: the loss is of the order of 1.
const SCALE: f64 = 128.0;

/// ε, square metres: the derivative stays finite where a prediction is exact. That of the published code.
const EPSILON: f32 = 1e-9;

/// What is taken of the differences between prediction and truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss {
    /// c, neighbours; `None` counts all particles alike.
    pub neighbor_scale: Option<f32>,
    /// γ.
    pub exponent: f32,
    /// Whether velocities count beside positions.
    pub velocity: bool,
    /// κ: how much compression counts.
    pub compression: f32,
    /// λ: how much particles in walls count.
    pub walls: f32,
}

/// What a loss knows beside the states.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// Where the particles of each cloud start: clouds + 1 entries.
    pub clouds: &'a [usize],
    /// The walls, metres.
    pub wall_position: &'a [Point],
    /// Their normals, into the fluid.
    pub wall_normal: &'a [Point],
    /// Where the wall particles of each cloud start.
    pub wall_clouds: &'a [usize],
    /// Of this Δt and the particle radius count.
    pub config: &'a Config,
}

impl Default for Loss {
    /// That of the paper.
    fn default() -> Loss {
        Loss { neighbor_scale: Some(40.0), exponent: 0.5, velocity: false, compression: 0.0, walls: 0.0 }
    }
}

impl Loss {
    /// The loss of all steps. `predicted` and `truth` are the states after each; `neighbors` are the numbers of fluid
    /// neighbours at x* in each. The derivatives by `predicted` are written to `by_predicted`.
    ///
    /// # Panics
    /// If lengths do not fit.
    pub fn evaluate(
        &self,
        predicted: &[State],
        truth: &[State],
        neighbors: &[Vec<u32>],
        around: &Surroundings<'_>,
        by_predicted: &mut Vec<State>,
    ) -> f64 {
        assert_eq!(predicted.len(), truth.len(), "a true state for each step");
        assert_eq!(predicted.len(), neighbors.len(), "numbers of neighbours for each step");
        by_predicted.resize_with(predicted.len(), State::default);
        let Surroundings { clouds, config, .. } = *around;
        let mut near = (self.compression > 0.0 || self.walls > 0.0).then(|| Near::of(around));
        let terms = (clouds.len() - 1) * predicted.len();
        let mut sum = 0.0;
        for (k, by) in by_predicted.iter_mut().enumerate() {
            let (predicted, truth) = (&predicted[k], &truth[k]);
            let count = predicted.position.len();
            by.position.clear();
            by.velocity.clear();
            by.velocity.resize(count, [0.0; 3]);
            for cloud in clouds.windows(2) {
                let rows = cloud[0]..cloud[1];
                let scale = SCALE / (terms * rows.len()) as f64;
                let mut cloud_sum = 0.0;
                for i in rows {
                    let weight = self.weight(neighbors[k][i]);
                    let factor = scale as f32 * weight;
                    let (value, gradient) = self.term(predicted.position[i], truth.position[i], 1.0);
                    cloud_sum += f64::from(weight * value);
                    by.position.push(gradient.map(|d| factor * d));
                    if self.velocity {
                        let (value, gradient) =
                            self.term(predicted.velocity[i], truth.velocity[i], config.dt / 2.0);
                        cloud_sum += f64::from(weight * value);
                        by.velocity[i] = gradient.map(|d| factor * d);
                    }
                }
                sum += scale * cloud_sum;
            }
            let Some(near) = &mut near else { continue };
            near.find(&predicted.position);
            // All particles of a cloud alike.
            let weights = |weight: f32| {
                let of_cloud = |cloud: &[usize]| {
                    let count = cloud[1] - cloud[0];
                    let scale = SCALE / (terms * count) as f64 * f64::from(weight);
                    std::iter::repeat_n(scale as f32, count)
                };
                clouds.windows(2).flat_map(of_cloud).collect::<Vec<f32>>()
            };
            if self.compression > 0.0 {
                sum += compression(near, &predicted.position, &weights(self.compression), &mut by.position);
            }
            if self.walls > 0.0 {
                sum += penetration(near, &predicted.position, &weights(self.walls), &mut by.position);
            }
        }
        sum
    }

    /// φ of a particle with so many neighbours.
    fn weight(&self, neighbors: u32) -> f32 {
        self.neighbor_scale.map_or(1.0, |scale| (-(neighbors as f32) / scale).exp())
    }

    /// (|u (a − b)|² + ε)^(γ/2) and its derivatives by a.
    fn term(&self, a: Point, b: Point, unit: f32) -> (f32, Point) {
        let d: Point = std::array::from_fn(|axis| unit * (a[axis] - b[axis]));
        let squared = d.iter().map(|x| x * x).sum::<f32>() + EPSILON;
        let power = squared.powf(0.5 * self.exponent);
        let slope = self.exponent * power / squared * unit;
        (power, d.map(|x| slope * x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn states(values: &[f32]) -> Vec<State> {
        let points: Vec<Point> = values.as_chunks::<3>().0.to_vec();
        let half = points.len() / 2;
        vec![State { position: points[..half].to_vec(), velocity: points[half..].to_vec() }]
    }

    /// Two clouds without walls.
    fn around<'a>(clouds: &'a [usize; 3], config: &'a Config) -> Surroundings<'a> {
        Surroundings { clouds, wall_position: &[], wall_normal: &[], wall_clouds: &[0; 3], config }
    }

    #[test]
    fn the_derivatives_are_those_of_the_value() {
        let truth = states(&[0.0; 18]);
        let values: Vec<f32> = (0..18).map(|i| 0.01 * ((7 * i) % 11) as f32 - 0.04).collect();
        let neighbors = vec![vec![30, 5, 60]];
        let clouds = [0, 2, 3];
        for loss in [
            Loss::default(),
            Loss { velocity: true, ..Loss::default() },
            Loss { neighbor_scale: None, exponent: 1.0, velocity: true, ..Loss::default() },
        ] {
            let value = |values: &[f32]| {
                loss.evaluate(
                    &states(values),
                    &truth,
                    &neighbors,
                    &around(&clouds, &Config::default()),
                    &mut Vec::new(),
                )
            };
            let mut by = Vec::new();
            loss.evaluate(
                &states(&values),
                &truth,
                &neighbors,
                &around(&clouds, &Config::default()),
                &mut by,
            );
            let gradient: Vec<f32> =
                by[0].position.iter().chain(&by[0].velocity).flatten().copied().collect();
            for i in 0..18 {
                let step = 1e-3;
                let moved = |way: f32| {
                    let mut values = values.clone();
                    values[i] += way;
                    value(&values)
                };
                let slope = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
                let error = (slope - f64::from(gradient[i])).abs();
                // The step is a tenth of a difference: the third derivative shows, in float32 the rounding as well.
                assert!(error < 0.02 * (1.0 + slope.abs()), "{loss:?} {i}: {slope} and {}", gradient[i]);
            }
        }
    }

    #[test]
    fn compression_counts_beside_the_distance_to_the_truth() {
        // Twelve particles within a centimetre, and what they should be farther apart.
        let position: Vec<Point> =
            (0..12).map(|k| [k % 3, k / 3 % 2, k / 6].map(|n| 0.004 * n as f32)).collect();
        let clouds = [0, 10, 12];
        let value = |position: &[Point], compression: f32, by: &mut Vec<State>| {
            let loss = Loss { compression, ..Loss::default() };
            let velocity = vec![[0.0; 3]; 12];
            let state = [State { position: position.to_vec(), velocity: velocity.clone() }];
            let truth = [State { position: vec![[0.02, 0.03, 0.04]; 12], velocity }];
            loss.evaluate(&state, &truth, &[vec![0; 12]], &around(&clouds, &Config::default()), by)
        };
        let (mut without, mut with) = (Vec::new(), Vec::new());
        let more = value(&position, 0.5, &mut with) - value(&position, 0.0, &mut without);
        // Ten together: 2.5 times the density at rest and a bit less; two together: none.
        let highest = 128.0 * 0.5 * 0.5 * (10.0 * 0.2546 - 1.0);
        assert!(0.9 * highest < more && more < highest, "{more} of {highest}");
        assert_eq!(with[0].position[11], without[0].position[11]);
        for (k, axis) in [(0, 0), (3, 1), (9, 2)] {
            let moved = |way: f32| {
                let mut position = position.clone();
                position[k][axis] += way;
                value(&position, 0.5, &mut Vec::new())
            };
            let slope = (moved(1e-3) - moved(-1e-3)) / 2e-3;
            let found = f64::from(with[0].position[k][axis]);
            assert!((slope - found).abs() < 0.02 * (1.0 + slope.abs()), "{k} {axis}: {slope} and {found}");
        }
    }

    #[test]
    fn a_cloud_counts_as_much_as_another_and_few_neighbors_more() {
        let truth = states(&[0.0; 18]);
        let mut values = [0.0; 18];
        values[6] = 0.01;
        let loss = |values: &[f32; 18], neighbors: u32| {
            let neighbors = vec![vec![neighbors; 3]];
            Loss::default().evaluate(
                &states(values),
                &truth,
                &neighbors,
                &around(&[0, 2, 3], &Config::default()),
                &mut Vec::new(),
            )
        };
        // What is left of a loss where all is exact: sqrt(sqrt(ε)).
        let zero = loss(&[0.0; 18], 0);
        assert!((zero - 128.0 * 1e-9f64.powf(0.25)).abs() < 1e-5, "{zero}");
        // The third particle is a cloud by itself: half of the mean.
        let expected = 0.5 * zero + 64.0 * (1e-4f64 + 1e-9).powf(0.25);
        assert!((loss(&values, 0) - expected).abs() < 1e-5);
        assert!((loss(&values, 40) / loss(&values, 0) - (-1.0f64).exp()).abs() < 1e-6);
    }
}

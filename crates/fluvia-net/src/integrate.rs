//! How positions and velocities are integrated around the network: Eq. 10, 11, 13 and 14.
//!
//! ```text
//! v* = v + Δt a_ext                  (10)
//! x* = x + Δt (v + v*) / 2           (11)
//! x' = x* + Δx                       (13)
//! v' = (x' − x) / Δt                 (14, integration "paper")
//! v' = v* + Δv                       (integration "velocity", six outputs)
//! ```
//!
//! Metres, seconds; one entry a particle.

use fluvia_neighbors::Point;
use fluvia_sim::particles::Acceleration;

use crate::config::{Config, Integration};

/// Positions and velocities, metres and metres per second; one entry a particle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Positions.
    pub position: Vec<Point>,
    /// Velocities.
    pub velocity: Vec<Point>,
}

impl State {
    /// Zeros for so many particles.
    pub fn zeros(count: usize) -> State {
        State { position: vec![[0.0; 3]; count], velocity: vec![[0.0; 3]; count] }
    }
}

/// Applies the external acceleration, Eq. 10 and 11: x* and v* into `predicted`, whose memory is reused.
pub fn predict(
    position: &[Point],
    velocity: &[Point],
    acceleration: Acceleration<'_>,
    dt: f32,
    predicted: &mut State,
) {
    predicted.position.clear();
    predicted.velocity.clear();
    for (i, (x, v)) in position.iter().zip(velocity).enumerate() {
        let a = acceleration.of(i);
        let v_star: Point = std::array::from_fn(|k| v[k] + dt * a[k]);
        predicted.position.push(std::array::from_fn(|k| x[k] + dt * (v[k] + v_star[k]) / 2.0));
        predicted.velocity.push(v_star);
    }
}

/// The backward pass of [`predict`]: the derivatives by x and v of one particle from those by x* and v*.
pub fn predict_backward(dt: f32, by_x_star: Point, by_v_star: Point) -> (Point, Point) {
    (by_x_star, std::array::from_fn(|k| by_v_star[k] + dt * by_x_star[k]))
}

/// What the velocity output is multiplied by beside the scale and 1/Δt, so that both outputs of a network of
/// six ask for corrections of about the same size.
const VELOCITY_SCALE: f32 = 2.0;

/// Applies the network's output for one particle: its new position and velocity from its old position `x`,
/// x*, v* and the output row o.
#[inline]
pub fn correct(config: &Config, x: Point, x_star: Point, v_star: Point, output: &[f32]) -> (Point, Point) {
    let scale = config.output_scale;
    let position: Point = std::array::from_fn(|k| x_star[k] + output[k] * scale);
    let velocity = match config.integration {
        Integration::Paper => std::array::from_fn(|k| (position[k] - x[k]) / config.dt),
        Integration::Velocity => {
            std::array::from_fn(|k| v_star[k] + VELOCITY_SCALE * scale / config.dt * output[3 + k])
        }
    };
    (position, velocity)
}

/// Derivatives by what [`correct`] starts from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CorrectGradient {
    /// By the old position x, through Eq. 14.
    pub x: Point,
    /// By x*.
    pub x_star: Point,
    /// By v*.
    pub v_star: Point,
}

/// The backward pass of [`correct`] for one particle, from the derivatives by its new position and velocity; those by
/// its output row are written to `by_output`.
pub fn correct_backward(
    config: &Config,
    by_position: Point,
    by_velocity: Point,
    by_output: &mut [f32],
) -> CorrectGradient {
    let (scale, dt) = (config.output_scale, config.dt);
    let gradient = match config.integration {
        Integration::Paper => CorrectGradient {
            x: by_velocity.map(|d| -d / dt),
            x_star: std::array::from_fn(|k| by_position[k] + by_velocity[k] / dt),
            v_star: [0.0; 3],
        },
        Integration::Velocity => {
            let by_outputs = by_output[3..].iter_mut();
            by_outputs.zip(by_velocity).for_each(|(output, d)| *output = VELOCITY_SCALE * scale / dt * d);
            CorrectGradient { x: [0.0; 3], x_star: by_position, v_star: by_velocity }
        }
    };
    by_output.iter_mut().zip(gradient.x_star).for_each(|(output, d)| *output = scale * d);
    gradient
}

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

use fluvia_sim::particles::Acceleration;

use crate::config::{Config, Integration};

/// The state before the network: x* and v* of Eq. 10 and 11.
#[derive(Clone, Debug, Default)]
pub struct Predicted {
    /// Intermediate positions x*, metres.
    pub position: Vec<[f32; 3]>,
    /// Intermediate velocities v*, metres per second.
    pub velocity: Vec<[f32; 3]>,
}

/// Applies the external acceleration, Eq. 10 and 11, into `predicted`, whose memory is reused.
pub fn predict(
    position: &[[f32; 3]],
    velocity: &[[f32; 3]],
    acceleration: Acceleration<'_>,
    dt: f32,
    predicted: &mut Predicted,
) {
    predicted.position.clear();
    predicted.velocity.clear();
    for (i, (x, v)) in position.iter().zip(velocity).enumerate() {
        let a = acceleration.of(i);
        let v_star: [f32; 3] = std::array::from_fn(|k| v[k] + dt * a[k]);
        predicted.position.push(std::array::from_fn(|k| x[k] + dt * (v[k] + v_star[k]) / 2.0));
        predicted.velocity.push(v_star);
    }
}

/// What the velocity output is multiplied by beside the scale and 1/Δt, so that both outputs of a network of
/// six ask for corrections of about the same size.
const VELOCITY_SCALE: f32 = 2.0;

/// Applies the network's output for one particle: its new position and velocity from its old position `x`,
/// x*, v* and the output row o.
#[inline]
pub fn correct(
    config: &Config,
    x: [f32; 3],
    x_star: [f32; 3],
    v_star: [f32; 3],
    output: &[f32],
) -> ([f32; 3], [f32; 3]) {
    let scale = config.output_scale;
    let position: [f32; 3] = std::array::from_fn(|k| x_star[k] + output[k] * scale);
    let velocity = match config.integration {
        Integration::Paper => std::array::from_fn(|k| (position[k] - x[k]) / config.dt),
        Integration::Velocity => {
            std::array::from_fn(|k| v_star[k] + VELOCITY_SCALE * scale / config.dt * output[3 + k])
        }
    };
    (position, velocity)
}

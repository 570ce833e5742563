//! The two pressure solvers of Bender & Koschier (2017): one keeps the flow free of divergence, one the density
//! constant. Both are the same iteration on P_i = p_i / ρ_i², with other sources and units.
//!
//! ```text
//! a_i(P) = - Σ_j V (P_i + (ρ0_j / ρ0_i) P_j) ∇W_ij - P_i g_i^b        pressure acceleration (Algorithms 2 and 3, line 7)
//! e_i    = s_i + τ Σ_j V (a_i - a_j) · ∇W_ij + τ a_i · g_i^b          what is left of the compression (Eq. 12)
//! P_i    = max(0, P_i + ω α_i e_i / τ)                                Jacobi iteration, α_i of Eq. 11
//! ```
//!
//! | solver | source s_i | τ | done when the mean of max(0, e_i) is within |
//! | --- | --- | --- | --- |
//! | divergence | the rate of compression | h | the divergence tolerance / h |
//! | constant density | ρ_i / ρ_0 + h · that rate - 1 | h² | the density tolerance |
//!
//! Pressure never pulls. Positions, and with them α and the operators, stay as they are during a step.

use rayon::prelude::*;

use super::boundary::WallSums;
use super::pairs::Pairs;
use super::params::Solve;
use super::row::Row;
use crate::parallel::{self, CHUNK};

/// ω: undamped Jacobi iterations (1) overshoot.
const RELAXATION: f32 = 0.5;

/// The part of the last step's pressure that an iteration starts from.
const WARM_START: f32 = 0.5;

/// The equations of one solver in one step, and when their iteration ends.
pub struct System<'a> {
    pub pairs: &'a Pairs,
    pub walls: &'a [WallSums],
    /// α_i, square metres; 0 for a particle that has no neighbours to press against.
    pub alpha: &'a [f32],
    /// ρ0_i over the rest density of the first liquid.
    pub relative_density: &'a [f32],
    /// s_i.
    pub source: &'a [f32],
    /// τ.
    pub scale: f32,
    /// h, seconds.
    pub step: f32,
    /// Particles with fewer neighbours are not counted in the error.
    pub least_neighbors: u32,
    /// P τ of the last step that an iteration starts from, at most.
    pub memory_limit: f32,
    /// The mean error at which it is done.
    pub tolerance: f32,
    pub min_iterations: u32,
    pub max_iterations: u32,
}

/// What an iteration writes to.
#[derive(Default)]
pub struct Workspace {
    /// a_i.
    acceleration: Vec<Row>,
    /// ρ0_i / ρ0 · P_i.
    weighted: Vec<f32>,
    /// max(0, e_i) where it counts.
    error: Vec<f32>,
}

/// Solves the system and lets the pressure act on the velocities. `memory` is P τ of the last step and becomes that of
/// this one.
pub fn solve(system: &System<'_>, memory: &mut [f32], velocity: &mut [Row], work: &mut Workspace) -> Solve {
    let &System { scale, step, memory_limit, tolerance, min_iterations, max_iterations, .. } = system;
    let mut any = false;
    for (i, (pressure, &source)) in memory.iter_mut().zip(system.source).enumerate() {
        any |= source > 0.0 || source.is_nan();
        let start = WARM_START * pressure.min(memory_limit) / scale;
        *pressure = if source > 0.0 && system.counts(i) { start } else { 0.0 };
    }
    if !any {
        // No pressure from the start, and nothing that would raise one.
        return Solve { iterations: 0, error: 0.0, converged: true };
    }
    let mut solve = Solve::default();
    while solve.iterations < max_iterations {
        system.accelerate(memory, work);
        solve.error = system.update(memory, work);
        solve.iterations += 1;
        solve.converged = solve.error <= tolerance;
        if (solve.converged && solve.iterations >= min_iterations) || !solve.error.is_finite() {
            break;
        }
    }
    system.accelerate(memory, work);
    for (velocity, &acceleration) in velocity.iter_mut().zip(&work.acceleration) {
        velocity.add_scaled(step, acceleration);
    }
    memory.iter_mut().for_each(|pressure| *pressure *= scale);
    solve
}

impl System<'_> {
    /// Whether particle i counts in the error.
    fn counts(&self, i: usize) -> bool {
        // It is its own neighbour.
        self.pairs.near.count(i) as u32 + self.walls[i].count > self.least_neighbors
    }

    /// a_i(P).
    fn accelerate(&self, pressure: &[f32], work: &mut Workspace) {
        let Workspace { acceleration, weighted, .. } = work;
        weighted.clear();
        weighted.extend(pressure.iter().zip(self.relative_density).map(|(p, density)| p * density));
        acceleration.resize(pressure.len(), Row::default());
        acceleration.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, accelerations)| {
            for (k, acceleration) in accelerations.iter_mut().enumerate() {
                let i = chunk * CHUNK + k;
                let gradient = self.pairs.pressure_gradient(i, weighted);
                *acceleration = gradient.scaled(-1.0 / self.relative_density[i]);
                acceleration.add_scaled(-pressure[i], self.walls[i].gradient);
            }
        });
    }

    /// P_i by the next iteration; returns the mean error before it.
    fn update(&self, pressure: &mut [f32], work: &mut Workspace) -> f32 {
        let Workspace { acceleration, error, .. } = work;
        let acceleration = &*acceleration;
        let count = pressure.len();
        error.resize(count, 0.0);
        let chunks = pressure.par_chunks_mut(CHUNK).zip(error.par_chunks_mut(CHUNK));
        chunks.enumerate().for_each(|(chunk, (pressures, errors))| {
            for (k, (pressure, error)) in pressures.iter_mut().zip(errors).enumerate() {
                let i = chunk * CHUNK + k;
                let wall = acceleration[i].dot(self.walls[i].gradient);
                let rate = self.pairs.compression_rate(i, acceleration) + wall;
                let left = self.source[i] + self.scale * rate;
                let change = RELAXATION * self.alpha[i] / self.scale * left;
                *pressure = (*pressure + change).max(0.0);
                // NaN counts always, so that it ends the iteration.
                *error = if left > 0.0 && self.counts(i) || left.is_nan() { left } else { 0.0 };
            }
        });
        (parallel::sum(count, |i| f64::from(error[i])) / count.max(1) as f64) as f32
    }
}

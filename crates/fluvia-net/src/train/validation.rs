//! How good a network is in the middle of a training: its loss and its errors on a fixed choice of windows.

use cconv::Kernel;

use super::Options;
use crate::Result;
use crate::dataset::{Batch, DataSet, Rotation, Sampling};
use crate::evaluate::mean_distance;
use crate::net::Network;
use crate::unroll::{Storage, Unroll};
use crate::weights::Weights;

/// Windows of one call.
const TOGETHER: usize = 4;

/// Windows that are kept in memory.
#[derive(Debug)]
pub struct Validation {
    batches: Vec<Batch>,
}

/// What was found; not finite where a position was not.
#[derive(Clone, Debug, PartialEq)]
pub struct Errors {
    /// The loss of training.
    pub loss: f64,
    /// The mean over particles of |x − x̂| after each step, and of that over windows, metres.
    pub position: Vec<f64>,
}

impl Validation {
    /// Takes so many windows, evenly from all of a data set, as they are: not turned.
    ///
    /// # Errors
    /// If a part cannot be read, and as [`DataSet::check_windows`].
    pub fn read(data: &DataSet, sampling: &Sampling, windows: usize) -> Result<Validation> {
        let steps = sampling.steps;
        data.check_windows(steps + 1)?;
        let counts = data.windows(steps + 1);
        let all: usize = counts.iter().sum();
        let windows = windows.min(all);
        let mut chosen = (0..windows).map(|k| (2 * k + 1) * all / (2 * windows)).peekable();
        let (mut batches, mut first) = (Vec::new(), 0);
        let mut batch = Batch::new(steps, 0);
        for (part, count) in data.parts().iter().zip(counts) {
            let mut loaded = None;
            while let Some(window) = chosen.next_if(|&window| window < first + count) {
                if loaded.is_none() {
                    loaded = Some(part.read()?);
                }
                let Some(part) = &loaded else { continue };
                batch.push(part, window - first, &Rotation::NONE, sampling.viscosity, sampling.reach);
                if batch.clouds.len() > TOGETHER {
                    batches.push(std::mem::replace(&mut batch, Batch::new(steps, 0)));
                }
            }
            first += count;
        }
        if batch.clouds.len() > 1 {
            batches.push(batch);
        }
        Ok(Validation { batches })
    }

    /// The number of windows.
    pub fn windows(&self) -> usize {
        self.batches.iter().map(|batch| batch.clouds.len() - 1).sum()
    }

    /// The errors of these weights.
    ///
    /// # Errors
    /// `Parameter` as [`Weights::check`].
    pub fn errors(&self, weights: &Weights, options: &Options, kernel: Kernel) -> Result<Errors> {
        let network = Network::new(weights, kernel)?.with_precision(options.precision);
        let config = network.config();
        let mut unroll = Unroll::new(Storage::Recompute);
        let steps = self.batches.first().map_or(0, |batch| batch.truth.len());
        let mut errors = Errors { loss: 0.0, position: vec![0.0; steps] };
        let windows = self.windows().max(1) as f64;
        for batch in &self.batches {
            let (mut walls, world) = (batch.walls(&network), batch.world(config.gravity));
            if !unroll.forward(&network, &batch.start, world, &mut walls, steps) {
                return Ok(Errors { loss: f64::INFINITY, position: vec![f64::INFINITY; steps] });
            }
            let states = unroll.states();
            for ((state, truth), error) in states.iter().zip(&batch.truth).zip(&mut errors.position) {
                for cloud in batch.clouds.windows(2) {
                    let rows = cloud[0]..cloud[1];
                    *error += mean_distance(&state.position[rows.clone()], &truth.position[rows]) / windows;
                }
            }
            let part = (batch.clouds.len() - 1) as f64 / windows;
            let (neighbors, around) = (unroll.neighbor_counts(), batch.surroundings(config));
            let loss = options.loss.evaluate(states, &batch.truth, neighbors, &around, &mut Vec::new());
            errors.loss += part * loss;
        }
        Ok(errors)
    }
}

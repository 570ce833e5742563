//! Training: one step from a batch, and what it keeps.
//!
//! ```text
//! batch -> steps without gradient, perhaps -> K steps of the network -> loss (Eq. 16-17) -> backward -> Adam -> averages
//! ```

use cconv::{Kernel, PositionGradient, Precision};

use crate::adam::{Adam, average};
use crate::checkpoint::{Checkpoint, Place};
use crate::config::BASE_INPUTS;
use crate::dataset::Batch;
use crate::integrate::State;
use crate::loss::Loss;
use crate::net::Network;
use crate::step::StepGradients;
use crate::unroll::{Storage, Unroll};
use crate::weights::{Tensor, Weights};
use crate::{Error, Result, adam};

mod schedule;
mod validation;

pub use schedule::Schedule;
pub use validation::{Errors, Validation};

/// The part of all updates so far that averaged weights reach back over is one in so many, until `Options::average` is less.
const REACH: f32 = 10.0;

/// How a step is made.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The loss.
    pub loss: Loss,
    /// The rate of each update.
    pub schedule: Schedule,
    /// Constants of the optimiser.
    pub adam: adam::Params,
    /// How much of the averaged weights stays in an update; `None` averages nothing.
    pub average: Option<f32>,
    /// Whether gradients go through the geometry of the network; they do not in the published training.
    pub positions: PositionGradient,
    /// What is kept for the backward pass.
    pub storage: Storage,
    /// The format of the large matrix products.
    pub precision: Precision,
    /// How many times the rate the weights of [`Config::extra_inputs`](crate::config::Config::extra_inputs) have. Adam moves
    /// all weights alike, so that those of an input whose values are small (the published viscosities are at most 0.4) hardly
    /// change what the network computes: with a factor k the training is that of a network which takes k times the input.
    pub extra_input_rate: f32,
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// The loss before the update.
    pub loss: f64,
    /// The Euclidean length of the gradient.
    pub gradient: f64,
    /// The rate.
    pub rate: f32,
}

/// Weights in training, with all that the next step depends on.
#[derive(Debug)]
pub struct Trainer {
    options: Options,
    kernel: Kernel,
    weights: Weights,
    adam: Adam,
    /// Averaged weights, as the tensors of `weights`.
    averages: Option<Vec<Vec<f32>>>,
    gradients: Vec<Vec<f32>>,
    /// What the rate is multiplied by for each weight.
    factors: Vec<Vec<f32>>,
    by_states: Vec<State>,
    /// The steps before those that count.
    lead: Unroll,
    unroll: Unroll,
}

impl Trainer {
    /// Begins with these weights.
    ///
    /// # Errors
    /// `Parameter` as [`Weights::check`].
    pub fn new(options: Options, weights: Weights, kernel: Kernel) -> Result<Trainer> {
        let lengths = weights.tensors().into_iter().map(|tensor| tensor.values.len());
        let adam = Adam::new(options.adam, lengths);
        let averages = options.average.map(|_| values(&weights));
        Trainer::resume(options, weights, adam, averages, kernel)
    }

    /// Goes on with what a trainer had.
    ///
    /// # Errors
    /// `Parameter` as [`Weights::check`], or if the moments or averages are not shaped as the weights.
    pub fn resume(
        options: Options,
        weights: Weights,
        adam: Adam,
        averages: Option<Vec<Vec<f32>>>,
        kernel: Kernel,
    ) -> Result<Trainer> {
        weights.check()?;
        let gradients: Vec<Vec<f32>> =
            weights.tensors().iter().map(|tensor| vec![0.0; tensor.values.len()]).collect();
        for tensors in [Some(&adam.first), Some(&adam.second), averages.as_ref()].into_iter().flatten() {
            let fits = tensors.len() == gradients.len()
                && tensors.iter().zip(&gradients).all(|(a, b)| a.len() == b.len());
            if !fits {
                return Err(Error::Parameter("moments or averages of other tensors than the weights".into()));
            }
        }
        let factors = factors(&weights, options.extra_input_rate);
        let (lead, unroll) = (Unroll::new(Storage::Recompute), Unroll::new(options.storage));
        let by_states = Vec::new();
        Ok(Trainer { options, kernel, weights, adam, averages, gradients, factors, by_states, lead, unroll })
    }

    /// The weights of now.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// The optimiser.
    pub fn adam(&self) -> &Adam {
        &self.adam
    }

    /// What [`Trainer::resume`] goes on from.
    pub fn checkpoint(&self, place: Place) -> Checkpoint {
        let (adam, averages) = (self.adam.clone(), self.averages.clone());
        Checkpoint { place, weights: values(&self.weights), adam, averages }
    }

    /// The weights to use: averaged, if they are.
    pub fn result(&self) -> Weights {
        let mut weights = self.weights.clone();
        if let Some(averages) = &self.averages {
            weights.values_mut().into_iter().zip(averages).for_each(|(to, from)| to.copy_from_slice(from));
        }
        weights
    }

    /// The gradient of the last [`Trainer::differentiate`], as the tensors of the weights.
    pub fn gradients(&self) -> &[Vec<f32>] {
        &self.gradients
    }

    /// The loss of a batch and its gradient by all weights.
    ///
    /// # Errors
    /// `NotFinite` if a position, the loss or a derivative is not finite.
    ///
    /// # Panics
    /// If the batch is not made for this network.
    pub fn differentiate(&mut self, batch: &Batch) -> Result<f64> {
        let network = Network::new(&self.weights, self.kernel)?.with_precision(self.options.precision);
        let config = network.config();
        let (mut walls, world) = (batch.walls(&network), batch.world(config.gravity));
        self.gradients.iter_mut().for_each(|gradient| gradient.fill(0.0));
        let Trainer { options, adam, lead, unroll, by_states, gradients, .. } = self;
        let truth = &batch.truth[batch.lead..];
        let finite = lead.forward(&network, &batch.start, world, &mut walls, batch.lead) && {
            let start = lead.states().last().unwrap_or(&batch.start);
            unroll.forward(&network, start, world, &mut walls, truth.len())
        };
        if !finite {
            return Err(not_finite("a position", adam.updates));
        }
        let loss = options.loss.evaluate(
            unroll.states(),
            truth,
            unroll.neighbor_counts(),
            &batch.surroundings(config),
            by_states,
        );
        let wanted = StepGradients {
            tensors: Some(gradients),
            positions: options.positions,
            ..StepGradients::default()
        };
        unroll.backward(&network, by_states, world, &mut walls, wanted);
        let finite = self.gradients.iter().flatten().all(|d| d.is_finite());
        if !(loss.is_finite() && finite) {
            let what = if loss.is_finite() { "a derivative" } else { "the loss" };
            return Err(not_finite(what, self.adam.updates));
        }
        Ok(loss)
    }

    /// One step of training.
    ///
    /// # Errors
    /// As [`Trainer::differentiate`]; the weights are then as they were.
    ///
    /// # Panics
    /// As [`Trainer::differentiate`].
    pub fn step(&mut self, batch: &Batch) -> Result<Progress> {
        let loss = self.differentiate(batch)?;
        let squares = self.gradients.iter().flatten().map(|&d| f64::from(d).powi(2));
        let gradient = squares.sum::<f64>().sqrt();
        let rate = self.options.schedule.rate(self.adam.updates);
        self.adam.update(self.weights.values_mut(), &self.gradients, rate, &self.factors);
        if let (Some(averages), Some(decay)) = (&mut self.averages, self.options.average) {
            // At first less: the average reaches back over a tenth of the updates, so that the beginning is soon forgotten.
            let decay = decay.min(self.adam.updates as f32 / (self.adam.updates as f32 + REACH));
            let weights = self.weights.tensors();
            let weights: Vec<&[f32]> = weights.iter().map(|tensor| tensor.values).collect();
            average(averages, &weights, decay);
        }
        Ok(Progress { loss, gradient, rate })
    }
}

fn not_finite(what: &str, updates: u64) -> Error {
    Error::NotFinite(format!("{what} is not finite in update {}", updates + 1))
}

/// The values of all tensors.
fn values(weights: &Weights) -> Vec<Vec<f32>> {
    weights.tensors().iter().map(|tensor| tensor.values.to_vec()).collect()
}

/// For every weight how many times the rate it has: that of the extra inputs in the first layer, 1 elsewhere.
fn factors(weights: &Weights, extra_input_rate: f32) -> Vec<Vec<f32>> {
    let of_tensor = |tensor: Tensor<'_>| match (tensor.name.as_str(), tensor.shape.as_slice()) {
        ("conv0_fluid.kernel" | "dense0_fluid.weight", &[.., inputs, outputs]) => (0..tensor.values.len())
            .map(|place| if place / outputs % inputs < BASE_INPUTS { 1.0 } else { extra_input_rate })
            .collect(),
        _ => vec![1.0; tensor.values.len()],
    };
    weights.tensors().into_iter().map(of_tensor).collect()
}

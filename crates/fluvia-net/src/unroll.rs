//! Several steps of the network and the backward pass through them: what training and inverse problems are made of.
//!
//! ```text
//! s_k = step(s_{k−1}),  L = L_1(s_1) + … + L_n(s_n)
//! dL/ds_{k−1} = (∂step/∂s_{k−1})ᵀ (dL_k/ds_k + dL_{k+1…}/ds_k)
//! ```

use crate::integrate::State;
use crate::net::{Activations, Memory, Network, Walls};
use crate::step::{Step, StepGradients, World};

/// What is kept of each step until its backward pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Storage {
    /// Everything: the backward pass computes nothing twice.
    #[default]
    Keep,
    /// The states alone: each step is computed again before its backward pass. The same bits, for about half more
    /// time, with the memory of one step however many there are.
    Recompute,
}

/// Steps of the network, one after the other. The memory is reused from run to run.
#[derive(Debug, Default)]
pub struct Unroll {
    storage: Storage,
    /// The states before the first step and after each.
    states: Vec<State>,
    /// The fluid neighbours of each particle at x*, step by step.
    neighbors: Vec<Vec<u32>>,
    /// One for each step, or one for all.
    steps: Vec<Step>,
    memory: Memory,
}

impl Unroll {
    /// No steps.
    pub fn new(storage: Storage) -> Unroll {
        Unroll { storage, ..Unroll::default() }
    }

    /// Runs `count` steps from `start`. The result is in [`Unroll::states`]; there is none, and false, if a position is
    /// not finite after Eq. 11.
    ///
    /// # Panics
    /// If lengths do not fit each other, or if there are other numbers of clouds of particles and of walls.
    #[must_use]
    pub fn forward(
        &mut self,
        network: &Network,
        start: &State,
        world: World<'_>,
        walls: &mut Walls,
        count: usize,
    ) -> bool {
        let (kept, activations) = match self.storage {
            Storage::Keep => (count, Activations::Keep),
            Storage::Recompute => (count.min(1), Activations::Drop),
        };
        self.steps.resize_with(kept, Step::default);
        self.states.resize_with(count + 1, State::default);
        self.neighbors.clear();
        self.states[0].clone_from(start);
        for k in 0..count {
            let step = &mut self.steps[k.min(kept - 1)];
            let mut state = std::mem::take(&mut self.states[k + 1]);
            state.clone_from(&self.states[k]);
            let before = (state.position.as_slice(), state.velocity.as_slice());
            let is_finite = step.forward(network, before, world, walls, activations, &mut self.memory);
            if !is_finite {
                self.states.clear();
                return false;
            }
            step.correct(network, &mut state.position, &mut state.velocity);
            self.neighbors.push(step.neighbor_counts(network));
            self.states[k + 1] = state;
        }
        true
    }

    /// The states after each step.
    pub fn states(&self) -> &[State] {
        self.states.get(1..).unwrap_or_default()
    }

    /// The numbers of fluid neighbours of each particle at x* in each step, as [`Step::neighbor_counts`] has them.
    pub fn neighbor_counts(&self) -> &[Vec<u32>] {
        &self.neighbors
    }

    /// The backward pass of the last [`Unroll::forward`], with the same arguments, from the derivatives of L by
    /// the state after each step: dL_k/ds_k without what goes through later steps.
    ///
    /// # Panics
    /// If there are other numbers of derivatives than of steps, or lengths do not fit.
    pub fn backward(
        &mut self,
        network: &Network,
        by_states: &[State],
        world: World<'_>,
        walls: &mut Walls,
        gradients: StepGradients<'_>,
    ) {
        assert_eq!(by_states.len(), self.states().len(), "a derivative for each step");
        let StepGradients { mut tensors, mut extra, mut state, positions } = gradients;
        let Some(mut by_next) = by_states.last().cloned() else { return };
        for k in (0..by_states.len()).rev() {
            let step = match self.storage {
                Storage::Keep => &mut self.steps[k],
                Storage::Recompute => {
                    let State { position, velocity } = &self.states[k];
                    let step = &mut self.steps[0];
                    let memory = &mut self.memory;
                    // The same x* as before.
                    let _ =
                        step.forward(network, (position, velocity), world, walls, Activations::Keep, memory);
                    step
                }
            };
            let mut by_state = by_states[..k].last().cloned();
            let wanted = StepGradients {
                tensors: tensors.as_deref_mut(),
                extra: extra.as_deref_mut(),
                state: if k == 0 { state.as_deref_mut() } else { by_state.as_mut() },
                positions,
            };
            step.backward(network, &by_next, world, walls, wanted, &mut self.memory);
            if let Some(by_state) = by_state {
                by_next = by_state;
            }
        }
    }
}

//! One step of the network, Eq. 10-14, forward and backward, for one cloud of particles or several:
//! predict, sort by cell, network, correct.

use cconv::PositionGradient;
use fluvia_neighbors::Point;
use fluvia_sim::particles::Acceleration;

use crate::config::BASE_INPUTS;
use crate::integrate::{State, correct, correct_backward, predict, predict_backward};
use crate::net::{Activations, Fluid, Memory, Network, NetworkGradients, Pass, Walls};

/// What moves particles beside the network.
#[derive(Clone, Copy, Debug)]
pub struct World<'a> {
    /// The extra input features of each particle, [particles, extra inputs].
    pub extra: &'a [f32],
    /// The external acceleration of Eq. 10.
    pub acceleration: Acceleration<'a>,
    /// Where the particles of each cloud start: clouds + 1 entries, the last the number of particles.
    pub clouds: &'a [usize],
}

/// One step and what it leaves for its backward pass. The memory is reused from step to step.
#[derive(Debug, Default)]
pub struct Step {
    predicted: State,
    /// The particles by cloud and cell, and their x* and features [1, v*, extra] in that order.
    order: Vec<u32>,
    sorted: Vec<Point>,
    features: Vec<f32>,
    pass: Pass,
}

/// Where [`Step::backward`] adds derivatives; only those that are asked for are computed.
#[derive(Debug, Default)]
pub struct StepGradients<'a> {
    /// By the weights, in the order and the layout of [`Weights::tensors`](crate::weights::Weights::tensors).
    pub tensors: Option<&'a mut [Vec<f32>]>,
    /// By the extra inputs, [particles, extra inputs].
    pub extra: Option<&'a mut [f32]>,
    /// By the state before the step.
    pub state: Option<&'a mut State>,
    /// Whether the network's geometry counts in the last of them.
    pub positions: PositionGradient,
}

impl Step {
    /// Predicts and sorts the particles, and finds all their neighbours; for measuring.
    pub fn search(
        &mut self,
        network: &Network,
        (position, velocity): (&[Point], &[Point]),
        world: World<'_>,
        walls: &mut Walls,
        memory: &mut Memory,
    ) {
        self.prepare(network, (position, velocity), world, memory);
        network.search(&self.sorted, world.clouds, walls, &mut self.pass, memory);
    }

    /// x* and v* of Eq. 10 and 11.
    pub(crate) fn predicted(&self) -> &State {
        &self.predicted
    }

    /// Runs the network on a state. If an x* of Eq. 11 is not finite, it does not, and returns false.
    ///
    /// # Panics
    /// If lengths do not fit each other.
    #[must_use]
    pub fn forward(
        &mut self,
        network: &Network,
        (position, velocity): (&[Point], &[Point]),
        world: World<'_>,
        walls: &mut Walls,
        activations: Activations,
        memory: &mut Memory,
    ) -> bool {
        self.prepare(network, (position, velocity), world, memory);
        if !self.predicted.position.as_flattened().iter().all(|x| x.is_finite()) {
            return false;
        }
        let fluid = Fluid { position: &self.sorted, features: &self.features, clouds: world.clouds };
        network.forward(fluid, walls, activations, &mut self.pass, memory);
        true
    }

    /// Applies the result of [`Step::forward`] to the state that it started from.
    pub fn correct(&self, network: &Network, position: &mut [Point], velocity: &mut [Point]) {
        let config = network.config();
        let rows = self.pass.output().chunks_exact(config.integration.outputs());
        for (&i, output) in self.order.iter().zip(rows) {
            let i = i as usize;
            let (x_star, v_star) = (self.predicted.position[i], self.predicted.velocity[i]);
            (position[i], velocity[i]) = correct(config, position[i], x_star, v_star, output);
        }
    }

    /// The backward pass of a step, from the derivatives by the state after it. `world` and `walls` are those of
    /// [`Step::forward`], which kept its activations.
    ///
    /// # Panics
    /// If the activations were not kept or lengths do not fit.
    pub fn backward(
        &mut self,
        network: &Network,
        by_next: &State,
        world: World<'_>,
        walls: &Walls,
        gradients: StepGradients<'_>,
        memory: &mut Memory,
    ) {
        let config = network.config();
        let StepGradients { tensors, extra, state, positions } = gradients;
        let count = self.order.len();
        assert_eq!(by_next.position.len(), count, "a derivative by the position of each particle");
        assert_eq!(by_next.velocity.len(), count, "a derivative by the velocity of each particle");
        let (inputs, outputs) = (config.fluid_inputs(), config.integration.outputs());
        let mut by_output = vec![0.0; count * outputs];
        let mut corrected = Vec::with_capacity(count);
        for (&i, row) in self.order.iter().zip(by_output.chunks_exact_mut(outputs)) {
            let i = i as usize;
            corrected.push(correct_backward(config, by_next.position[i], by_next.velocity[i], row));
        }
        let flows = state.is_some() || extra.is_some();
        let mut by_features = vec![0.0; if flows { count * inputs } else { 0 }];
        let differentiates = state.is_some() && positions == PositionGradient::Full;
        let mut by_x_star = vec![[0.0; 3]; if differentiates { count } else { 0 }];
        let wanted = NetworkGradients {
            tensors,
            features: flows.then_some(by_features.as_mut_slice()),
            positions: differentiates.then_some(by_x_star.as_mut_slice()),
        };
        let fluid = Fluid { position: &self.sorted, features: &self.features, clouds: world.clouds };
        network.backward(fluid, walls, &by_output, wanted, &mut self.pass, memory);
        if let Some(extra) = extra {
            let extras = inputs - BASE_INPUTS;
            for (&i, row) in self.order.iter().zip(by_features.chunks_exact(inputs)) {
                let own = &mut extra[i as usize * extras..(i as usize + 1) * extras];
                own.iter_mut().zip(&row[BASE_INPUTS..]).for_each(|(sum, d)| *sum += d);
            }
        }
        let Some(state) = state else { return };
        let rows = self.order.iter().zip(corrected).zip(by_features.chunks_exact(inputs));
        for (k, ((&i, corrected), by_features)) in rows.enumerate() {
            let i = i as usize;
            let through = by_x_star.get(k).copied().unwrap_or([0.0; 3]);
            let by_x_star = std::array::from_fn(|axis| corrected.x_star[axis] + through[axis]);
            let by_v_star = std::array::from_fn(|axis| corrected.v_star[axis] + by_features[1 + axis]);
            let (by_x, by_v) = predict_backward(config.dt, by_x_star, by_v_star);
            for axis in 0..3 {
                state.position[i][axis] += corrected.x[axis] + by_x[axis];
                state.velocity[i][axis] += by_v[axis];
            }
        }
    }

    /// The number of fluid neighbours of each particle at x*, in the caller's order: itself excluded, and particles that
    /// coincide with it unless there is no fully connected part.
    pub fn neighbor_counts(&self, network: &Network) -> Vec<u32> {
        let itself = if network.config().fully_connected { 0 } else { 1 };
        let mut counts = vec![0; self.order.len()];
        for (row, &i) in self.order.iter().enumerate() {
            counts[i as usize] = self.pass.fluid_neighbors.count(row) as u32 - itself;
        }
        counts
    }

    /// The number of pairs among the fluid, and of walls and fluid.
    pub fn pairs(&self) -> (usize, usize) {
        (self.pass.fluid_neighbors.indices.len(), self.pass.wall_neighbors.indices.len())
    }

    /// Eq. 10 and 11; then the particles by cloud and cell, with their features.
    fn prepare(
        &mut self,
        network: &Network,
        (position, velocity): (&[Point], &[Point]),
        world: World<'_>,
        memory: &mut Memory,
    ) {
        let (config, extras) = (network.config(), network.config().extra_inputs.len());
        assert_eq!(position.len(), velocity.len(), "a velocity for each position");
        assert_eq!(world.extra.len(), position.len() * extras, "extra inputs of each particle");
        predict(position, velocity, world.acceleration, config.dt, &mut self.predicted);
        memory.order.build(&self.predicted.position, world.clouds, config.filter_radius);
        self.order.clear();
        self.order.extend_from_slice(memory.order.order());
        self.sorted.clear();
        self.features.clear();
        for &i in &self.order {
            let i = i as usize;
            self.sorted.push(self.predicted.position[i]);
            self.features.push(1.0);
            self.features.extend(self.predicted.velocity[i]);
            self.features.extend_from_slice(&world.extra[i * extras..(i + 1) * extras]);
        }
    }
}

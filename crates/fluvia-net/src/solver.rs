//! The network as a solver: one step is predict (Eq. 10-11), neighbours, network (Eq. 12), correct
//! (Eq. 13-14).

use cconv::Kernel;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::{Solver, StepInfo};

use crate::config::BASE_INPUTS;
use crate::integrate::{Predicted, correct, predict};
use crate::net::{Network, Pass, Walls};
use crate::weights::Weights;
use crate::{Error, Result};

/// Moves particles with the learned network. It keeps nothing from step to step but memory: the next state
/// is a function of the state, bit for bit.
#[derive(Debug)]
pub struct NetSolver {
    network: Network,
    walls: Walls,
    /// The extra input of the particles of each body, if the network has one.
    viscosity: Option<Vec<f32>>,
    pass: Pass,
    predicted: Predicted,
    sorted: Predicted,
    features: Vec<f32>,
    order: fluvia_neighbors::Grid,
}

/// The name of the extra input feature that this solver can give: the viscosity of the particle's body.
const VISCOSITY: &str = "viscosity";

impl NetSolver {
    /// A solver for the given walls. `viscosity` holds the viscosity of each body of the scene; where it is
    /// `None` the weights' own value counts. A network without that input ignores them: it moves every fluid as
    /// if it had the viscosity of its training data.
    ///
    /// # Errors
    /// `Parameter` if the network has an input other than the viscosity, or its layers do not fit.
    pub fn new(
        weights: &Weights,
        boundary: &Boundary,
        viscosity: &[Option<f32>],
        kernel: Kernel,
    ) -> Result<NetSolver> {
        let network = Network::new(weights, kernel)?;
        let config = network.config();
        let viscosity = match config.extra_inputs.as_slice() {
            [] => None,
            [name] if name == VISCOSITY => {
                Some(viscosity.iter().map(|value| value.unwrap_or(config.viscosity)).collect())
            }
            names => {
                return Err(Error::Parameter(format!(
                    "the network has the inputs {names:?}, expected none beside the velocity or `{VISCOSITY}`"
                )));
            }
        };
        let walls = network.walls(&boundary.position, &boundary.normal);
        Ok(NetSolver {
            network,
            walls,
            viscosity,
            pass: Pass::default(),
            predicted: Predicted::default(),
            sorted: Predicted::default(),
            features: Vec::new(),
            order: fluvia_neighbors::Grid::new(),
        })
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Sorts the predicted particles by cell and lays out their features [1, v*, extra].
    fn sort(&mut self, body: &[u32]) {
        self.order.build(&self.predicted.position, self.network.config().filter_radius);
        self.sorted.position.clear();
        self.features.clear();
        for &i in self.order.order() {
            let i = i as usize;
            self.sorted.position.push(self.predicted.position[i]);
            self.features.push(1.0);
            self.features.extend(self.predicted.velocity[i]);
            if let Some(viscosity) = &self.viscosity {
                self.features.push(viscosity[body[i] as usize]);
            }
        }
        debug_assert!(self.features.len() >= BASE_INPUTS * body.len(), "one row of features a particle");
    }

    /// Finds all pairs of a step as [`Solver::step`] does, and nothing else; for measuring.
    pub fn search(&mut self, particles: &Particles, acceleration: Acceleration<'_>) -> usize {
        let dt = self.network.config().dt;
        predict(&particles.position, &particles.velocity, acceleration, dt, &mut self.predicted);
        self.sort(&particles.body);
        self.network.search(&self.sorted.position, &mut self.walls, &mut self.pass);
        self.pass.fluid_neighbors.indices.len() + self.pass.wall_neighbors.indices.len()
    }
}

impl Solver for NetSolver {
    fn name(&self) -> &'static str {
        "network"
    }

    fn step(
        &mut self,
        particles: &mut Particles,
        acceleration: Acceleration<'_>,
        dt: f32,
    ) -> fluvia_sim::Result<StepInfo> {
        let made_for = self.network.config().dt;
        if dt != made_for {
            return Err(fluvia_sim::Error::Parameter(format!(
                "dt: {dt} s, but the weights were made for steps of {made_for} s"
            )));
        }
        predict(&particles.position, &particles.velocity, acceleration, dt, &mut self.predicted);
        self.sort(&particles.body);
        self.network.forward(&self.sorted.position, &self.features, &mut self.walls, &mut self.pass);

        let config = self.network.config();
        let rows = self.pass.output().chunks_exact(config.integration.outputs());
        for (&i, output) in self.order.order().iter().zip(rows) {
            let i = i as usize;
            let (x_star, v_star) = (self.predicted.position[i], self.predicted.velocity[i]);
            let (x, v) = correct(config, particles.position[i], x_star, v_star, output);
            particles.position[i] = x;
            particles.velocity[i] = v;
        }
        let counts = (0..particles.len()).map(|q| self.pass.fluid_neighbors.count(q));
        Ok(StepInfo {
            substeps: 1,
            max_neighbors: counts.max().unwrap_or(0) as u32,
            neighbor_radius: config.filter_radius,
        })
    }
}

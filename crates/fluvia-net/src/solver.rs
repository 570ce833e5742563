//! The network as a solver: one step is predict (Eq. 10-11), neighbours, network (Eq. 12), correct
//! (Eq. 13-14).

use cconv::{Kernel, Precision};
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::{Solver, StepInfo};

use crate::net::{Activations, Memory, Network, Walls};
use crate::step::{Step, World};
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
    /// The extra inputs of each particle.
    extra: Vec<f32>,
    step: Step,
    memory: Memory,
}

/// The name of the extra input feature that this solver can give: the viscosity of the particle's body.
const VISCOSITY: &str = "viscosity";

impl NetSolver {
    /// A solver for the given walls. `viscosity` holds the viscosity of each body of the scene; where it is
    /// `None` the weights' own value counts. A network without that input ignores them: it moves every fluid as
    /// if it had the viscosity of its training data.
    ///
    /// # Errors
    /// `Parameter` if the network has an input other than the viscosity, its layers do not fit, there is not a
    /// normal for each wall particle, or a viscosity is not finite.
    pub fn new(
        weights: &Weights,
        boundary: &Boundary,
        viscosity: &[Option<f32>],
        kernel: Kernel,
    ) -> Result<NetSolver> {
        let (walls, normals) = (boundary.position.len(), boundary.normal.len());
        if walls != normals {
            return Err(Error::Parameter(format!("{normals} normals for {walls} wall particles")));
        }
        if let Some(value) = viscosity.iter().flatten().find(|value| !value.is_finite()) {
            return Err(Error::Parameter(format!("viscosity {value}, expected a finite number")));
        }
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
        let walls = network.walls(&boundary.position, &boundary.normal, &[0, boundary.position.len()]);
        Ok(NetSolver {
            network,
            walls,
            viscosity,
            extra: Vec::new(),
            step: Step::default(),
            memory: Memory::default(),
        })
    }

    /// The same solver with the network's large matrix products in another format.
    pub fn with_precision(self, precision: Precision) -> NetSolver {
        NetSolver { network: self.network.with_precision(precision), ..self }
    }

    /// The network.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Looks up the extra inputs of all particles.
    fn look_up(&mut self, body: &[u32]) {
        self.extra.clear();
        if let Some(viscosity) = &self.viscosity {
            self.extra.extend(body.iter().map(|&body| viscosity[body as usize]));
        }
    }

    /// Finds all pairs of a step as [`Solver::step`] does, and nothing else; for measuring.
    pub fn search(&mut self, particles: &Particles, acceleration: Acceleration<'_>) -> usize {
        self.look_up(&particles.body);
        let world = World { extra: &self.extra, acceleration, clouds: &[0, particles.len()] };
        let state = (particles.position.as_slice(), particles.velocity.as_slice());
        self.step.search(&self.network, state, world, &mut self.walls, &mut self.memory);
        let (fluid, walls) = self.step.pairs();
        fluid + walls
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
        acceleration.check(particles.len())?;
        let bodies = self.viscosity.as_ref().map_or(usize::MAX, Vec::len);
        if let Some(body) = particles.body.iter().find(|&&body| body as usize >= bodies) {
            let message = format!("a particle of body {body}, but there are viscosities for {bodies} bodies");
            return Err(fluvia_sim::Error::Parameter(message));
        }
        self.look_up(&particles.body);
        let world = World { extra: &self.extra, acceleration, clouds: &[0, particles.len()] };
        let state = (particles.position.as_slice(), particles.velocity.as_slice());
        let NetSolver { network, walls, memory, step, .. } = self;
        if !step.forward(network, state, world, walls, Activations::Drop, memory) {
            // Too fast for float32: the caller sees by the positions which particles.
            particles.position.clone_from(&step.predicted().position);
            return Ok(StepInfo {
                substeps: 1,
                max_neighbors: 0,
                neighbor_radius: network.config().filter_radius,
                ..StepInfo::default()
            });
        }
        step.correct(network, &mut particles.position, &mut particles.velocity);
        Ok(StepInfo {
            substeps: 1,
            max_neighbors: step.neighbor_counts(network).into_iter().max().unwrap_or(0),
            neighbor_radius: network.config().filter_radius,
            ..StepInfo::default()
        })
    }
}

//! Makes the solver that was asked for, after making sure that it can honour the scene.

mod fit;

use std::path::Path;

use anyhow::{Context, Result};
use cconv::Kernel;
use fluvia_net::solver::NetSolver;
use fluvia_net::weights::Weights;
use fluvia_sim::dfsph::{self, Dfsph, Liquid};
use fluvia_sim::particles::{Acceleration, Particles};
use fluvia_sim::pbf::{self, Pbf};
use fluvia_sim::rollout::Solver;
use fluvia_sim::scene::{Material, Scene, Setup};
use fluvia_sim::substep::Substep;
use serde_json::json;

use crate::options::PrecisionName;
use crate::record::decimal;
pub use fit::{DFSPH_VISCOSITIES, check_material, check_network};

/// The step of DFSPH in the published data, seconds.
pub const PUBLISHED_STEP: f32 = 1e-3;

/// A solver by its parameters.
pub enum Choice {
    Dfsph(dfsph::Params),
    Pbf(pbf::Params),
    Network(Box<Weights>, PrecisionName),
}

/// A solver that needs no weights.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum SolverName {
    /// Divergence-free SPH (Bender & Koschier 2015), the solver of the published data.
    Dfsph,
    /// Position-based fluids (Macklin & Müller 2013).
    Pbf,
}

impl SolverName {
    /// The solver with its default parameters but for the step.
    pub fn choice(self, substep: Option<Substep>) -> Choice {
        match self {
            SolverName::Dfsph => {
                let default = dfsph::Params::default();
                Choice::Dfsph(dfsph::Params { substep: substep.unwrap_or(default.substep), ..default })
            }
            SolverName::Pbf => {
                let default = pbf::Params::default();
                Choice::Pbf(pbf::Params { substep: substep.unwrap_or(default.substep), ..default })
            }
        }
    }
}

impl Choice {
    /// Checks the scene against what the solver can honour, and gives the scene the values that the weights were
    /// made for where it says nothing.
    ///
    /// # Errors
    /// One line that names the scene file, the key and the value that would be honoured.
    pub fn adapt(&self, scene: &mut Scene) -> Result<()> {
        match self {
            Choice::Dfsph(_) => fit::check_dfsph(scene),
            Choice::Pbf(_) => fit::check_pbf(scene),
            Choice::Network(weights, _) => {
                check_network(scene, &weights.config).map_err(|unfit| unfit.advised())?;
                scene.dt = Some(weights.config.dt);
                scene.particle_radius = Some(weights.config.particle_radius);
                Ok(())
            }
        }
    }

    /// Checks what is recorded of true frames against what the solver can honour.
    ///
    /// # Errors
    /// One line that names `path` and the value.
    pub fn check(&self, path: &Path, setup: &Setup) -> Result<()> {
        match self {
            Choice::Dfsph(_) => fit::recorded_for_dfsph(path, setup),
            Choice::Pbf(_) => fit::recorded_for_pbf(path, setup),
            Choice::Network(weights, _) => {
                fit::recorded_for_network(path, setup, &weights.config).map_err(|unfit| unfit.advised())
            }
        }
    }

    /// What will surprise though the solver takes these liquids.
    pub fn warning(&self, path: &Path, materials: impl IntoIterator<Item = Material>) -> Option<String> {
        let Choice::Dfsph(dfsph::Params { substep, .. }) = self else { return None };
        let given = materials.into_iter().filter_map(|material| material.viscosity);
        let highest = given.reduce(f32::max)?;
        if *substep == Substep::Fixed(PUBLISHED_STEP) || highest <= Liquid::default().viscosity {
            return None;
        }
        Some(format!(
            "{}: viscosity {highest} acts once a step of the solver, and is that of the published data with \
             --solver-dt {PUBLISHED_STEP}",
            path.display()
        ))
    }

    /// The viscosities that the solver takes, from the lowest to the highest; `None` if it is made for one.
    pub fn viscosities(&self) -> Option<[f32; 2]> {
        match self {
            Choice::Dfsph(_) => Some(DFSPH_VISCOSITIES),
            Choice::Pbf(_) => None,
            Choice::Network(weights, _) => {
                weights.config.viscosity_range.filter(|_| fit::takes_viscosity(&weights.config))
            }
        }
    }

    /// The name of the solver.
    pub fn name(&self) -> &'static str {
        match self {
            Choice::Dfsph(_) => "dfsph",
            Choice::Pbf(_) => "pbf",
            Choice::Network(..) => "network",
        }
    }

    /// Makes the solver for the walls of a set-up, and makes sure that it takes the set-up's time step.
    pub fn make(&self, setup: &Setup, kernel: Kernel) -> Result<Box<dyn Solver + Send>> {
        let mut solver: Box<dyn Solver + Send> = match self {
            Choice::Dfsph(params) => {
                let liquids: Vec<_> = setup.emitters.iter().map(|emitter| liquid(emitter.material)).collect();
                Box::new(Dfsph::new(*params, &setup.boundary, setup.particle_radius, &liquids)?)
            }
            Choice::Pbf(params) => Box::new(Pbf::new(*params, &setup.boundary, setup.particle_radius)?),
            Choice::Network(weights, precision) => {
                let viscosity: Vec<_> = setup.emitters.iter().map(|e| e.material.viscosity).collect();
                let solver = NetSolver::new(weights, &setup.boundary, &viscosity, kernel)?;
                Box::new(solver.with_precision((*precision).into()))
            }
        };
        // A step of no particles: what is wrong shows before anything is written.
        let nothing = &mut Particles::default();
        solver.step(nothing, Acceleration::Uniform(setup.gravity), setup.dt).context("`dt`")?;
        Ok(solver)
    }

    /// The instruction set that computes.
    pub fn kernel_name(&self, kernel: Kernel) -> &'static str {
        match self {
            // Plain Rust: the compiler's baseline for the target.
            Choice::Dfsph(_) | Choice::Pbf(_) => "portable",
            Choice::Network(..) => kernel.name(),
        }
    }

    /// The parameters as they are recorded.
    pub fn parameters(&self) -> serde_json::Value {
        match self {
            Choice::Dfsph(params) => {
                let (kind, seconds) = step(params.substep);
                json!({
                    kind: decimal(seconds),
                    "travel": decimal(params.travel),
                    "density_tolerance": decimal(params.density_tolerance),
                    "divergence_tolerance": decimal(params.divergence_tolerance),
                    "min_iterations": params.min_iterations,
                    "max_iterations": params.max_iterations,
                    "viscosity_tolerance": decimal(params.viscosity_tolerance),
                    "max_viscosity_iterations": params.max_viscosity_iterations,
                })
            }
            Choice::Pbf(params) => {
                let (kind, seconds) = step(params.substep);
                json!({
                    kind: decimal(seconds),
                    "travel": decimal(params.travel),
                    "iterations": params.iterations,
                    "damping": decimal(params.damping),
                    "momentum": decimal(params.momentum),
                    "relaxation": decimal(params.relaxation),
                    "artificial_pressure": decimal(params.artificial_pressure),
                    "viscosity": decimal(params.viscosity),
                    "loose_density": decimal(params.loose_density),
                    "compaction_rate": decimal(params.compaction_rate),
                    "expansion_rate": decimal(params.expansion_rate),
                    "wall_clearance": decimal(params.wall_clearance),
                })
            }
            Choice::Network(weights, precision) => {
                let config = &weights.config;
                json!({
                    "integration": config.integration.name(),
                    "filter_radius": decimal(config.filter_radius),
                    "extra_inputs": config.extra_inputs,
                    "precision": precision.name(),
                })
            }
        }
    }
}

/// How the solver's own step is recorded: its key and the seconds.
fn step(substep: Substep) -> (&'static str, f32) {
    match substep {
        Substep::Fixed(seconds) => ("solver_dt", seconds),
        Substep::AtMost(seconds) => ("solver_dt_max", seconds),
    }
}

/// The material of a fluid, with that of the published data where it has none of its own.
pub fn liquid(material: Material) -> Liquid {
    let default = Liquid::default();
    Liquid {
        viscosity: material.viscosity.unwrap_or(default.viscosity),
        density: material.density.unwrap_or(default.density),
    }
}

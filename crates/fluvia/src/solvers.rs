//! Makes the solver that was asked for, after making sure that it can honour the scene.

use std::path::Path;

use anyhow::{Result, bail};
use cconv::Kernel;
use fluvia_net::config::Config;
use fluvia_net::solver::NetSolver;
use fluvia_net::weights::Weights;
use fluvia_sim::pbf::{Params, Pbf, Substep};
use fluvia_sim::rollout::Solver;
use fluvia_sim::scene::{Scene, Setup};
use serde_json::json;

use crate::options::PrecisionName;
use crate::record::decimal;

/// A solver by its parameters.
pub enum Choice {
    Pbf(Params),
    Network(Box<Weights>, PrecisionName),
}

impl Choice {
    /// Checks the scene against what the solver can honour, and gives the scene the values that the weights were
    /// made for where it says nothing.
    ///
    /// # Errors
    /// One line that names the scene file, the key and the value that would be honoured.
    pub fn adapt(&self, scene: &mut Scene) -> Result<()> {
        match self {
            Choice::Pbf(_) => check_pbf(scene),
            Choice::Network(weights, _) => {
                check_network(scene, &weights.config)?;
                scene.dt = Some(weights.config.dt);
                scene.particle_radius = Some(weights.config.particle_radius);
                Ok(())
            }
        }
    }

    /// Makes the solver for the walls of a set-up.
    pub fn make(&self, setup: &Setup, kernel: Kernel) -> Result<Box<dyn Solver>> {
        Ok(match self {
            Choice::Pbf(params) => Box::new(Pbf::new(*params, &setup.boundary, setup.particle_radius)?),
            Choice::Network(weights, precision) => {
                let viscosity: Vec<_> = setup.emitters.iter().map(|e| e.material.viscosity).collect();
                let solver = NetSolver::new(weights, &setup.boundary, &viscosity, kernel)?;
                Box::new(solver.with_precision((*precision).into()))
            }
        })
    }

    /// The instruction set that computes.
    pub fn kernel_name(&self, kernel: Kernel) -> &'static str {
        match self {
            // Plain Rust: the compiler's baseline for the target.
            Choice::Pbf(_) => "portable",
            Choice::Network(..) => kernel.name(),
        }
    }

    /// The parameters as they are recorded.
    pub fn parameters(&self) -> serde_json::Value {
        match self {
            Choice::Pbf(params) => {
                let (kind, seconds) = match params.substep {
                    Substep::Fixed(seconds) => ("solver_dt", seconds),
                    Substep::AtMost(seconds) => ("solver_dt_max", seconds),
                };
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

fn check_pbf(scene: &Scene) -> Result<()> {
    let path = scene.path.display();
    let honours = "but the solver pbf cannot honour that key: it has a smoothing of its own";
    if let Some(value) = scene.material.viscosity {
        bail!("{path}: `viscosity`: {value}, {honours}");
    }
    let mut density = None;
    for (i, fluid) in scene.fluids.iter().enumerate() {
        if let Some(value) = fluid.material.viscosity {
            bail!("{path}: `fluids[{i}].viscosity`: {value}, {honours}");
        }
        let own = fluid.material.density.or(scene.material.density);
        // One density for all moves as any other does: pressure and weight both grow with it.
        match density {
            Some(first) if first != own => bail!(
                "{path}: `fluids[{i}].density`: {} where fluids[0] has {}, but the solver pbf needs the same density in \
                 all fluids",
                named(own),
                named(first),
            ),
            _ => density = Some(own),
        }
    }
    Ok(())
}

/// A density, if one is given.
fn named(density: Option<f32>) -> String {
    density.map_or("none given".into(), |density| format!("{density} kg/m³"))
}

fn check_network(scene: &Scene, config: &Config) -> Result<()> {
    let path = &scene.path;
    check(path, "dt", scene.dt, config.dt, "s")?;
    check(path, "particle_radius", scene.particle_radius, config.particle_radius, "m")?;
    let has_viscosity = config.extra_inputs.iter().any(|input| input == "viscosity");
    let materials = std::iter::once((String::new(), scene.material))
        .chain(scene.fluids.iter().enumerate().map(|(i, f)| (format!("fluids[{i}]."), f.material)));
    for (prefix, material) in materials {
        if !has_viscosity {
            check(path, &format!("{prefix}viscosity"), material.viscosity, config.viscosity, "")?;
        }
        check(path, &format!("{prefix}density"), material.density, config.density, "kg/m³")?;
    }
    Ok(())
}

/// A value that the scene gives must be the one that the weights were made for.
fn check(path: &Path, key: &str, given: Option<f32>, made_for: f32, unit: &str) -> Result<()> {
    match given {
        Some(value) if value != made_for => {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            bail!(
                "{}: `{key}`: {value}{unit}, but the weights were made for {made_for}{unit}",
                path.display()
            )
        }
        _ => Ok(()),
    }
}

//! Makes the solver that was asked for, after making sure that it can honour the scene.

use std::fmt;
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use cconv::Kernel;
use fluvia_net::config::Config;
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

/// The step of DFSPH in the published data, seconds.
pub const PUBLISHED_STEP: f32 = 1e-3;

/// A solver by its parameters.
pub enum Choice {
    Dfsph(dfsph::Params),
    Pbf(pbf::Params),
    Network(Box<Weights>, PrecisionName),
}

/// A solver that needs no weights.
#[derive(Clone, Copy, clap::ValueEnum)]
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
            Choice::Dfsph(_) => check_dfsph(scene),
            Choice::Pbf(_) => check_pbf(scene),
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
        let materials = setup.emitters.iter().map(|emitter| emitter.material);
        match self {
            Choice::Network(weights, _) => {
                let config = &weights.config;
                check(path, "dt", Some(setup.dt), config.dt, "s")
                    .and_then(|()| {
                        let radius = Some(setup.particle_radius);
                        check(path, "particle_radius", radius, config.particle_radius, "m")
                    })
                    .and_then(|()| {
                        materials.clone().try_for_each(|material| check_material(path, "", material, config))
                    })
                    .and_then(|()| check_unsaid(path, materials, config))
                    .map_err(|unfit| unfit.advised())
            }
            Choice::Dfsph(_) => {
                check_densities(path, materials.clone())?;
                materials
                    .filter_map(|material| material.viscosity)
                    .try_for_each(|value| check_dfsph_viscosity(path, "", value))
            }
            // It has no viscosity: that of water is as good as none.
            Choice::Pbf(_) => {
                let water = Liquid::default().viscosity;
                match materials.filter_map(|material| material.viscosity).find(|value| *value > water) {
                    Some(value) => bail!("{}: viscosity {value}, {NOT_PBF}", path.display()),
                    None => Ok(()),
                }
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

    /// The name of the solver.
    pub fn name(&self) -> &'static str {
        match self {
            Choice::Dfsph(_) => "dfsph",
            Choice::Pbf(_) => "pbf",
            Choice::Network(..) => "network",
        }
    }

    /// Makes the solver for the walls of a set-up, and makes sure that it takes the set-up's time step.
    pub fn make(&self, setup: &Setup, kernel: Kernel) -> Result<Box<dyn Solver>> {
        let mut solver: Box<dyn Solver> = match self {
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

/// The densities of two liquids in a scene may differ by this factor: with 10 spray flies twice as fast as it should,
/// with 1000 the iteration diverges.
const MOST_DENSITY_RATIO: f32 = 5.0;

fn check_densities(path: &Path, materials: impl IntoIterator<Item = Material>) -> Result<()> {
    let densities = materials.into_iter().map(|material| liquid(material).density);
    let (low, high) = densities.fold((f32::MAX, 0.0), |(low, high), d| (d.min(low), d.max(high)));
    if high > MOST_DENSITY_RATIO * low {
        bail!(
            "{}: `density`: {low} and {high} kg/m³, but the solver dfsph takes liquids whose densities differ by a \
             factor of at most {MOST_DENSITY_RATIO}",
            path.display()
        );
    }
    Ok(())
}

fn check_dfsph(scene: &Scene) -> Result<()> {
    check_densities(&scene.path, scene.materials())?;
    for (prefix, material) in written_materials(scene) {
        if let Some(value) = material.viscosity {
            check_dfsph_viscosity(&scene.path, &prefix, value)?;
        }
    }
    Ok(())
}

/// The materials that a scene gives, with what their keys begin with.
fn written_materials(scene: &Scene) -> impl Iterator<Item = (String, Material)> {
    let of_fluids = scene.fluids.iter().enumerate().map(|(i, f)| (format!("fluids[{i}]."), f.material));
    std::iter::once((String::new(), scene.material)).chain(of_fluids)
}

/// The coefficients of viscosity that DFSPH takes: the part of the strain rate that goes in a step.
const DFSPH_VISCOSITIES: [f32; 2] = [0.0, 1.0];

fn check_dfsph_viscosity(path: &Path, prefix: &str, value: f32) -> Result<()> {
    let [low, high] = DFSPH_VISCOSITIES;
    if !dfsph_takes(value) {
        bail!("{}: `{prefix}viscosity`: {value}, but the solver dfsph takes {low} to {high}", path.display());
    }
    Ok(())
}

/// Why PBF takes no viscosity.
const NOT_PBF: &str = "but the solver pbf cannot honour that key: it has a smoothing of its own";

fn check_pbf(scene: &Scene) -> Result<()> {
    let path = scene.path.display();
    if let Some(value) = scene.material.viscosity {
        bail!("{path}: `viscosity`: {value}, {NOT_PBF}");
    }
    let mut density = None;
    for (i, fluid) in scene.fluids.iter().enumerate() {
        if let Some(value) = fluid.material.viscosity {
            bail!("{path}: `fluids[{i}].viscosity`: {value}, {NOT_PBF}");
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

/// A value that a network is not made for.
#[derive(Debug)]
pub struct Unfit {
    message: String,
    /// What takes it, if anything does.
    advice: Option<&'static str>,
}

impl Unfit {
    /// The value, with what takes it.
    fn advised(&self) -> anyhow::Error {
        match self.advice {
            Some(advice) => anyhow!("{} ({advice})", self.message),
            None => anyhow!("{}", self.message),
        }
    }
}

impl fmt::Display for Unfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Unfit {}

/// Checks the keys of a scene against what a network was made for.
///
/// # Errors
/// One line that names the scene file, the key and the value that would be honoured.
pub fn check_network(scene: &Scene, config: &Config) -> Result<(), Unfit> {
    let path = &scene.path;
    check(path, "dt", scene.dt, config.dt, "s")?;
    check(path, "particle_radius", scene.particle_radius, config.particle_radius, "m")?;
    for (prefix, material) in written_materials(scene) {
        check_material(path, &prefix, material, config)?;
    }
    check_unsaid(path, scene.materials(), config)
}

/// Checks a material against what a network was made for.
///
/// # Errors
/// One line that names the file, the key and the value that would be honoured.
pub fn check_material(path: &Path, prefix: &str, material: Material, config: &Config) -> Result<(), Unfit> {
    if let Some(value) = material.viscosity {
        let key = format!("{prefix}viscosity");
        match takes_viscosity(config) {
            true => check_learned(path, &key, value, config)?,
            false => check(path, &key, Some(value), config.viscosity, "").map_err(|unfit| Unfit {
                advice: dfsph_takes(value)
                    .then_some("--weights viscosity takes other viscosities, --solver dfsph more"),
                ..unfit
            })?,
        }
    }
    check(path, &format!("{prefix}density"), material.density, config.density, "kg/m³")
}

/// Checks what counts for fluids whose viscosity is not given.
fn check_unsaid(
    path: &Path,
    materials: impl IntoIterator<Item = Material>,
    config: &Config,
) -> Result<(), Unfit> {
    match materials.into_iter().any(|material| material.viscosity.is_none()) && takes_viscosity(config) {
        true => check_learned(path, "viscosity", config.viscosity, config),
        false => Ok(()),
    }
}

/// A network is taken to know what is beyond what it has learned from by this part of the range: the extremes of a random
/// draw lie within what was drawn from.
const BEYOND: f32 = 0.05;

/// A viscosity must be one that the network has learned from.
fn check_learned(path: &Path, key: &str, value: f32, config: &Config) -> Result<(), Unfit> {
    let Some([low, high]) = config.viscosity_range else { return Ok(()) };
    let beyond = BEYOND * (high - low);
    if (low - beyond..=high + beyond).contains(&value) {
        return Ok(());
    }
    let path = path.display();
    let message = format!("{path}: `{key}`: {value}, but the network has learned from {low} to {high}");
    Err(Unfit { message, advice: dfsph_takes(value).then_some(SOLVER) })
}

/// Whether viscosity is an input of a network.
fn takes_viscosity(config: &Config) -> bool {
    config.extra_inputs.iter().any(|input| input == "viscosity")
}

fn dfsph_takes(viscosity: f32) -> bool {
    let [low, high] = DFSPH_VISCOSITIES;
    (low..=high).contains(&viscosity)
}

/// What takes most values that a network does not.
const SOLVER: &str = "--solver dfsph takes others";

/// A value that the scene gives must be the one that the network is made for.
fn check(path: &Path, key: &str, given: Option<f32>, made_for: f32, unit: &str) -> Result<(), Unfit> {
    match given {
        Some(value) if value != made_for => {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            let path = path.display();
            let message =
                format!("{path}: `{key}`: {value}{unit}, but the network is made for {made_for}{unit}");
            Err(Unfit { message, advice: Some(SOLVER) })
        }
        _ => Ok(()),
    }
}

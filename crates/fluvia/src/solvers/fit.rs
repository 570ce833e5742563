//! Whether a solver can honour a scene, or what is recorded of true frames.

use std::fmt;
use std::path::Path;

use anyhow::{Result, anyhow, bail};
use fluvia_net::config::Config;
use fluvia_sim::dfsph::Liquid;
use fluvia_sim::scene::{Material, Scene, Setup};

use super::liquid;

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

/// Checks a scene.
///
/// # Errors
/// One line that names the scene file, the key and what would be honoured.
pub fn check_dfsph(scene: &Scene) -> Result<()> {
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
pub const DFSPH_VISCOSITIES: [f32; 2] = [0.0, 1.0];

fn check_dfsph_viscosity(path: &Path, prefix: &str, value: f32) -> Result<()> {
    let [low, high] = DFSPH_VISCOSITIES;
    if !dfsph_takes(value) {
        bail!("{}: `{prefix}viscosity`: {value}, but the solver dfsph takes {low} to {high}", path.display());
    }
    Ok(())
}

/// Checks what is recorded of true frames.
///
/// # Errors
/// One line that names `path` and the value.
pub fn recorded_for_dfsph(path: &Path, setup: &Setup) -> Result<()> {
    check_densities(path, materials(setup))?;
    materials(setup)
        .filter_map(|material| material.viscosity)
        .try_for_each(|value| check_dfsph_viscosity(path, "", value))
}

/// The materials of what is recorded.
fn materials(setup: &Setup) -> impl Iterator<Item = Material> {
    setup.emitters.iter().map(|emitter| emitter.material)
}

/// Why PBF takes no viscosity.
const NOT_PBF: &str = "but the solver pbf cannot honour that key: it has a smoothing of its own";

/// As [`check_dfsph`].
pub fn check_pbf(scene: &Scene) -> Result<()> {
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

/// As [`recorded_for_dfsph`].
pub fn recorded_for_pbf(path: &Path, setup: &Setup) -> Result<()> {
    // It has no viscosity: that of water is as good as none.
    let water = Liquid::default().viscosity;
    if let Some(value) =
        materials(setup).filter_map(|material| material.viscosity).find(|value| *value > water)
    {
        bail!("{}: viscosity {value}, {NOT_PBF}", path.display());
    }
    let densities: Vec<f32> = materials(setup).map(|material| liquid(material).density).collect();
    if let Some([one, other]) = densities.windows(2).find(|pair| pair[0] != pair[1]) {
        bail!(
            "{}: densities {one} and {other} kg/m³, but the solver pbf needs the same density in all fluids",
            path.display()
        );
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
    pub fn advised(&self) -> anyhow::Error {
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

/// As [`recorded_for_dfsph`].
pub fn recorded_for_network(path: &Path, setup: &Setup, config: &Config) -> Result<(), Unfit> {
    check(path, "dt", Some(setup.dt), config.dt, "s")?;
    check(path, "particle_radius", Some(setup.particle_radius), config.particle_radius, "m")?;
    materials(setup).try_for_each(|material| check_material(path, "", material, config))?;
    check_unsaid(path, materials(setup), config)
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
pub fn takes_viscosity(config: &Config) -> bool {
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

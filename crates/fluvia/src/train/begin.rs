//! What a training begins with: weights and data that fit its settings, and a directory without an earlier training.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use fluvia_net::config::Config as NetworkConfig;
use fluvia_net::dataset::{DataSet, PartFile};
use fluvia_net::weights::Tensor;
use fluvia_sim::frames::sequence;
use fluvia_sim::scene::{DEFAULT_DT, DEFAULT_GRAVITY, DEFAULT_PARTICLE_RADIUS, Material};

use super::config::Config;
use super::origin::First;
use super::{BEST, CHECKPOINT, SETTINGS, WEIGHTS, events, log};
use crate::frame_source::{recorded_beside, stored_materials};
use crate::solvers::{check_material, check_network};
use crate::trained;

/// Weights to begin with, which must be of the network of the settings.
pub fn given_weights(path: &Path, config: &Config) -> Result<First> {
    let (mut given, source) = trained::load(path)?;
    // That of the data that follow.
    given.config.viscosity_range = None;
    let expected = config.first_weights();
    if let ([], [name]) = (given.config.extra_inputs.as_slice(), expected.config.extra_inputs.as_slice()) {
        given = given.with_extra_input(name);
    }
    let path = path.display();
    let (found, wanted) = (given.tensors(), expected.tensors());
    if found.len() != wanted.len() {
        let (found, wanted) = (found.len(), wanted.len());
        bail!(
            "{path}: weights of another network than that of the settings: {found} tensors, expected {wanted}"
        );
    }
    let differs = |(found, wanted): &(&Tensor<'_>, &Tensor<'_>)| {
        (&found.name, &found.shape) != (&wanted.name, &wanted.shape)
    };
    if let Some((found, wanted)) = found.iter().zip(&wanted).find(differs) {
        bail!(
            "{path}: weights of another network than that of the settings: tensor {} {:?}, expected {} {:?}",
            found.name,
            found.shape,
            wanted.name,
            wanted.shape
        );
    }
    let values = |config: &NetworkConfig| {
        [
            ("interpolation", format!("{:?}", config.interpolation)),
            ("window", format!("{:?}", config.window)),
            ("fully_connected", config.fully_connected.to_string()),
            ("extra inputs", format!("{:?}", config.extra_inputs)),
            ("integration", config.integration.name().to_owned()),
            ("dt", format!("{} s", config.dt)),
            ("gravity", format!("{:?} m/s²", config.gravity)),
            // What no settings change.
            ("constants", format!("{config:?}")),
        ]
    };
    let (found, wanted) = (values(&given.config), values(&expected.config));
    if let Some(((key, found), (_, wanted))) = found.iter().zip(&wanted).find(|(a, b)| a != b) {
        bail!(
            "{path}: weights of another network than that of the settings: {key} {found}, expected {wanted}"
        );
    }
    Ok(First { weights: given, source })
}

/// Makes sure that the settings are those of the data, as far as these say what they are. Returns the lowest and the highest
/// viscosity.
///
/// # Errors
/// One line that names the sequence, the key, its value and what the settings have.
pub fn check_data(data: &DataSet, config: &Config) -> Result<[f32; 2]> {
    let made_for = config.made_for();
    let mut range = [f32::INFINITY, f32::NEG_INFINITY];
    let mut widen = |material: Material| {
        let viscosity = material.viscosity.unwrap_or(made_for.viscosity);
        range = [range[0].min(viscosity), range[1].max(viscosity)];
    };
    fn name(part: &PartFile) -> (Option<&Path>, &str) {
        (part.path.parent(), &part.sequence)
    }
    for parts in data.parts().chunk_by(|a, b| name(a) == name(b)) {
        let Some(mut scene) = recorded_beside(&parts[0].path, &parts[0].sequence)? else {
            // A published sequence says what its particles are, and no more.
            let (path, radius) = (&parts[0].path, made_for.particle_radius);
            let (_, frame) = sequence::read_start(path)?;
            for material in stored_materials(&frame, radius) {
                check_material(path, "", material, &made_for)?;
                widen(material);
            }
            continue;
        };
        scene.dt.get_or_insert(DEFAULT_DT);
        scene.particle_radius.get_or_insert(DEFAULT_PARTICLE_RADIUS);
        check_network(&scene, &made_for)?;
        scene.materials().into_iter().for_each(&mut widen);
        let gravity = scene.gravity.unwrap_or(DEFAULT_GRAVITY);
        if gravity != made_for.gravity {
            let path = scene.path.display();
            bail!(
                "{path}: `gravity`: {gravity:?} m/s², but the network is made for {:?} m/s²",
                made_for.gravity
            );
        }
    }
    Ok(range)
}

/// The files of a training that cost its time.
const TRAINED: [&str; 3] = [CHECKPOINT, WEIGHTS, BEST];

/// Makes sure that a training that begins loses nothing that is there. To go on where an earlier one was stopped before its
/// first checkpoint is to begin.
pub fn refuse_run(out: &Path, resume: bool) -> Result<()> {
    let place = out.display();
    let exists = |name: &&&str| out.join(name).exists();
    let trained = TRAINED.iter().find(exists);
    if let (true, Some(found)) = (resume, trained) {
        bail!("{place}: holds {found}, but no {CHECKPOINT} to go on from");
    }
    if resume && out.join(SETTINGS).exists() {
        return Ok(());
    }
    let others = [SETTINGS, log::FILE];
    let found = trained.or_else(|| others.iter().find(exists)).map(|name| name.to_string());
    let is_events = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into_owned());
    match found.or_else(|| events::files(out).ok()?.iter().find_map(is_events)) {
        Some(found) if resume => bail!("{place}: holds {found}, but no {SETTINGS} of a training"),
        Some(found) => bail!("{place}: holds {found} of a training; expected --resume or --overwrite"),
        None => Ok(()),
    }
}

/// Removes what an earlier training has left: a new one that is killed before its first checkpoint must not go on with it.
pub fn remove_run(out: &Path) -> Result<()> {
    let remove = |path: &Path| match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| path.display().to_string())
        }
        _ => Ok(()),
    };
    TRAINED.iter().chain([&log::FILE]).try_for_each(|name| remove(&out.join(name)))?;
    events::files(out)?.iter().try_for_each(|path| remove(path))
}

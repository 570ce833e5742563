//! What a training begins with: weights, data that fit its settings, and the settings as they are recorded.

use std::path::Path;

use anyhow::{Result, bail};
use cconv::Kernel;
use fluvia_net::dataset::{DataSet, PartFile};
use fluvia_net::weights::{Tensor, Weights};
use fluvia_sim::scene::{DEFAULT_DT, DEFAULT_GRAVITY, DEFAULT_PARTICLE_RADIUS};
use serde_json::{Value, json};

use super::Plan;
use super::config::Config;
use crate::frame_source::recorded_beside;
use crate::solvers::check_network;

/// Weights to begin with, which must be of the network of the settings.
pub fn given_weights(path: &Path, config: &Config) -> Result<Weights> {
    let mut given = fluvia_net::weights::load(path)?;
    let expected = config.first_weights();
    if let ([], [name]) = (given.config.extra_inputs.as_slice(), expected.config.extra_inputs.as_slice()) {
        given = given.with_extra_input(name);
    }
    let path = path.display();
    let (found, wanted) = (given.tensors(), expected.tensors());
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
    if found.len() != wanted.len() || given.config != expected.config {
        bail!(
            "{path}: weights of another network than that of the settings: {:?}, expected {:?}",
            given.config,
            expected.config
        );
    }
    Ok(given)
}

/// Makes sure that the settings are those of the data, as far as these say what they are.
///
/// # Errors
/// One line that names the sequence, the key, its value and what the settings have.
pub fn check_data(data: &DataSet, config: &Config) -> Result<()> {
    let made_for = config.made_for();
    fn sequence(part: &PartFile) -> (Option<&Path>, &str) {
        (part.path.parent(), &part.sequence)
    }
    for parts in data.parts().chunk_by(|a, b| sequence(a) == sequence(b)) {
        let Some(mut scene) = recorded_beside(&parts[0].path, &parts[0].sequence)? else { continue };
        scene.dt.get_or_insert(DEFAULT_DT);
        scene.particle_radius.get_or_insert(DEFAULT_PARTICLE_RADIUS);
        check_network(&scene, &made_for)?;
        let gravity = scene.gravity.unwrap_or(DEFAULT_GRAVITY);
        if gravity != made_for.gravity {
            let path = scene.path.display();
            bail!(
                "{path}: `gravity`: {gravity:?} m/s², but the network is made for {:?} m/s²",
                made_for.gravity
            );
        }
    }
    Ok(())
}

/// What the bits of a training depend on.
pub fn settings(plan: &Plan, data: &DataSet) -> Value {
    let mut value = serde_json::to_value(&plan.config).unwrap_or_default();
    value["data"]["parts"] = json!(data.parts().len());
    value["data"]["frames"] = json!(data.parts().iter().map(|part| part.frames).sum::<usize>());
    value["first_weights"] = json!(plan.weights);
    value["kernel"] = json!(Kernel::detect().name());
    value["version"] = json!(env!("CARGO_PKG_VERSION"));
    value
}

/// Adds the entries that `value` does not have, at every depth.
pub fn complete(value: &mut Value, defaults: &Value) {
    let (Value::Object(entries), Value::Object(defaults)) = (value, defaults) else { return };
    for (key, default) in defaults {
        match entries.get_mut(key) {
            Some(own) => complete(own, default),
            None => {
                entries.insert(key.clone(), default.clone());
            }
        }
    }
}

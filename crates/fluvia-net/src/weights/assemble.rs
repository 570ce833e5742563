//! From the tensors of a file to a network: names, shapes, configuration.

use std::collections::{BTreeMap, BTreeSet};

use super::archive::Archive;
use super::{Convolution, Dense, FileKind, Layer, Weights, keras, safetensors};
use crate::config::{BASE_INPUTS, Config, Integration, WALL_INPUTS};

/// The tensor by which a network is found in a file.
const ANCHOR: &str = "conv0_fluid.kernel";

/// What an extra input is called where the file does not say: the only one that the paper has.
const EXTRA_INPUT: &str = "viscosity";

/// Builds the network that a file holds.
pub(super) fn network(archive: &mut dyn Archive) -> Result<Weights, String> {
    let record = safetensors::record(archive.metadata())?;
    let mut tensors = Tensors { names: names(archive)?, used: BTreeSet::new(), archive };
    let last = tensors.last_layer()?;
    let (config, training) = match record {
        Some(record) => record,
        None => (tensors.default_config(last)?, None),
    };
    if let Some(fault) = config.fault() {
        return Err(format!("configuration: {fault}"));
    }
    tensors.check_gravity(&config)?;

    let obstacle = tensors.convolution("conv0_obstacle", WALL_INPUTS, None, &config)?;
    let fluid = tensors.convolution("conv0_fluid", config.fluid_inputs(), None, &config)?;
    let dense = |tensors: &mut Tensors<'_>, name: &str, inputs, outputs| {
        config.fully_connected.then(|| tensors.dense(name, inputs, outputs)).transpose()
    };
    let fluid_dense = dense(&mut tensors, "dense0_fluid", config.fluid_inputs(), None)?;
    let mut width = obstacle.outputs + fluid.outputs + fluid_dense.as_ref().map_or(0, |part| part.outputs);
    let mut layers = Vec::new();
    for number in 1..=last {
        let outputs = (number == last).then(|| config.integration.outputs());
        let convolution = tensors.convolution(&format!("conv{number}"), width, outputs, &config)?;
        let dense = dense(&mut tensors, &format!("dense{number}"), width, Some(convolution.outputs))?;
        width = convolution.outputs;
        layers.push(Layer { convolution, dense });
    }
    tensors.check_rest()?;
    Ok(Weights { config, obstacle, fluid, fluid_dense, layers, training })
}

/// The tensors of a file under the names that they have in the published PyTorch file.
fn names(archive: &dyn Archive) -> Result<BTreeMap<String, usize>, String> {
    let files: Vec<&str> = archive.entries().iter().map(|entry| entry.name.as_str()).collect();
    let prefix = match archive.kind() {
        FileKind::Keras => None,
        FileKind::PyTorch | FileKind::Safetensors => Some(prefix(&files)?),
    };
    let mut names = BTreeMap::new();
    for (index, file) in files.iter().enumerate() {
        let name = match &prefix {
            None => keras::tensor_name(file),
            Some(prefix) => file.strip_prefix(prefix.as_str()).map(str::to_owned),
        };
        let Some(name) = name else { continue };
        if let Some(other) = names.insert(name.clone(), index) {
            return Err(format!("tensor `{name}` is there twice, as `{}` and as `{file}`", files[other]));
        }
    }
    Ok(names)
}

/// What stands before the names of the network in a PyTorch file: `module.` of a parallel wrapper, the key of a
/// training checkpoint.
fn prefix(names: &[&str]) -> Result<String, String> {
    let mut prefixes: Vec<&str> = names
        .iter()
        .filter_map(|name| name.strip_suffix(ANCHOR))
        .filter(|prefix| prefix.is_empty() || prefix.ends_with('.'))
        .collect();
    // A checkpoint may hold several copies (an average beside the model): the usual places come first.
    const USUAL: [&str; 4] = ["", "model_state_dict.", "state_dict.", "model."];
    let usual = USUAL.iter().find_map(|place| {
        let wrapped = format!("{place}module.");
        prefixes.iter().find(|prefix| *prefix == place || **prefix == wrapped)
    });
    match (usual, prefixes.as_slice()) {
        (Some(prefix), _) => Ok((*prefix).to_owned()),
        (None, []) => Ok(String::new()),
        (None, [prefix]) => Ok((*prefix).to_owned()),
        (None, _) => {
            prefixes.sort_unstable();
            Err(format!("several networks, under `{}`: expected one", prefixes.join("`, `")))
        }
    }
}

struct Tensors<'a> {
    archive: &'a mut dyn Archive,
    /// Indices in the archive.
    names: BTreeMap<String, usize>,
    used: BTreeSet<String>,
}

impl Tensors<'_> {
    /// The number of the last layer.
    fn last_layer(&self) -> Result<usize, String> {
        // A file without the first layer holds something else, whatever its other names are.
        self.index(ANCHOR)?;
        let number = |name: &String| {
            let layer = name.strip_suffix(".kernel").and_then(|layer| layer.strip_prefix("conv"));
            let layer = layer.or_else(|| name.strip_suffix(".weight")?.strip_prefix("dense"));
            layer?.parse::<usize>().ok()
        };
        let last = self.names.keys().filter_map(number).max().unwrap_or(0).max(1);
        // Only so many layers can be there: one that is missing is found at once.
        (1..=last).try_for_each(|number| self.index(&format!("conv{number}.kernel")).map(drop))?;
        Ok(last)
    }

    /// The configuration of the published model, but for what the tensors tell.
    fn default_config(&mut self, last: usize) -> Result<Config, String> {
        let mut config = Config::default();
        let [filter @ .., inputs, _] = self.kernel_shape(ANCHOR)?;
        config.filter_size = filter;
        let extra = inputs.checked_sub(BASE_INPUTS).ok_or_else(|| {
            format!("tensor `{ANCHOR}` has {inputs} inputs, expected at least {BASE_INPUTS}")
        })?;
        config.extra_inputs = match extra {
            1 => vec![EXTRA_INPUT.to_owned()],
            _ => (1..=extra).map(|number| format!("extra_{number}")).collect(),
        };
        let name = format!("conv{last}.kernel");
        let [.., outputs] = self.kernel_shape(&name)?;
        config.integration = [Integration::Paper, Integration::Velocity]
            .into_iter()
            .find(|integration| integration.outputs() == outputs)
            .ok_or_else(|| {
                format!(
                    "tensor `{name}` has {outputs} outputs, expected 3 (positions) or 6 (positions and velocities)"
                )
            })?;
        if self.names.contains_key("gravity") {
            config.gravity = self.gravity()?;
        }
        Ok(config)
    }

    fn gravity(&mut self) -> Result<[f32; 3], String> {
        let values = self.values("gravity", &[3])?;
        Ok([values[0], values[1], values[2]])
    }

    fn check_gravity(&mut self, config: &Config) -> Result<(), String> {
        if self.names.contains_key("gravity") {
            let found = self.gravity()?;
            if found != config.gravity {
                return Err(format!(
                    "tensor `gravity` is {found:?}, expected {:?} as in the metadata",
                    config.gravity
                ));
            }
        }
        Ok(())
    }

    fn convolution(
        &mut self,
        name: &str,
        inputs: usize,
        outputs: Option<usize>,
        config: &Config,
    ) -> Result<Convolution, String> {
        let kernel = format!("{name}.kernel");
        let [.., found] = self.kernel_shape(&kernel)?;
        let outputs = outputs.unwrap_or(found);
        let [depth, height, width] = config.filter_size;
        let kernel = self.values(&kernel, &[depth, height, width, inputs, outputs])?;
        let bias = self.values(&format!("{name}.bias"), &[outputs])?;
        let offset = format!("{name}.offset");
        if self.names.contains_key(&offset) {
            let offset_values = self.values(&offset, &[3])?;
            if offset_values.iter().any(|&value| value != 0.0) {
                return Err(format!("tensor `{offset}` is {offset_values:?}, expected zeros"));
            }
        }
        Ok(Convolution { inputs, outputs, kernel, bias })
    }

    fn dense(&mut self, name: &str, inputs: usize, outputs: Option<usize>) -> Result<Dense, String> {
        let name_weight = format!("{name}.weight");
        let transposed = self.archive.kind() != FileKind::Keras;
        let found = self.shape(&name_weight)?;
        let outputs = outputs.or_else(|| found.get(usize::from(!transposed)).copied()).unwrap_or(0);
        let shape = if transposed { [outputs, inputs] } else { [inputs, outputs] };
        let mut weight = self.values(&name_weight, &shape)?;
        if transposed {
            weight = transpose(&weight, outputs, inputs);
        }
        let bias = self.values(&format!("{name}.bias"), &[outputs])?;
        Ok(Dense { inputs, outputs, weight, bias })
    }

    /// Every tensor of the network must have been read: what is left belongs to another one.
    fn check_rest(&self) -> Result<(), String> {
        let optimiser = |name: &str| name.starts_with("optim");
        match self.names.keys().find(|name| !self.used.contains(*name) && !optimiser(name)) {
            Some(name) => Err(format!("tensor `{name}` is no part of this network: weights of another one")),
            None => Ok(()),
        }
    }

    fn index(&self, name: &str) -> Result<usize, String> {
        /// So many names are listed.
        const LISTED: usize = 3;
        self.names.get(name).copied().ok_or_else(|| {
            let entries = self.archive.entries();
            let names: Vec<_> =
                entries.iter().take(LISTED).map(|entry| format!("`{}`", entry.name)).collect();
            let more = if entries.len() > LISTED { ", ..." } else { "" };
            format!(
                "tensor `{name}` is missing: weights of another network? ({} tensors: {}{more})",
                entries.len(),
                names.join(", ")
            )
        })
    }

    fn shape(&self, name: &str) -> Result<&[usize], String> {
        Ok(&self.archive.entries()[self.index(name)?].shape)
    }

    fn kernel_shape(&self, name: &str) -> Result<[usize; 5], String> {
        let shape = self.shape(name)?;
        <[usize; 5]>::try_from(shape).ok().filter(|shape| !shape.contains(&0)).ok_or_else(|| {
            format!("tensor `{name}` has shape {shape:?}, expected [depth, height, width, in, out]")
        })
    }

    /// The values of a tensor of a known shape, all of them finite.
    fn values(&mut self, name: &str, expected: &[usize]) -> Result<Vec<f32>, String> {
        let index = self.index(name)?;
        let entry = &self.archive.entries()[index];
        if entry.shape != expected {
            return Err(format!("tensor `{name}` has shape {:?}, expected {expected:?}", entry.shape));
        }
        if !entry.element.is_float() {
            return Err(format!("tensor `{name}`: {}", entry.element.not_read()));
        }
        let values = self.archive.values(index).map_err(|fault| format!("tensor `{name}`: {fault}"))?;
        let values: Vec<f32> = values.into_iter().map(|value| value as f32).collect();
        if let Some(place) = values.iter().position(|value| !value.is_finite()) {
            return Err(format!(
                "tensor `{name}`: value {place} is {}, expected finite numbers",
                values[place]
            ));
        }
        self.used.insert(name.to_owned());
        Ok(values)
    }
}

/// The transpose of a row-major matrix.
pub(super) fn transpose(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns).flat_map(|column| (0..rows).map(move |row| matrix[row * columns + column])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transposing_twice_changes_nothing() {
        let matrix = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let turned = transpose(&matrix, 2, 3);
        assert_eq!(turned, [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        assert_eq!(transpose(&turned, 3, 2), matrix);
    }
}

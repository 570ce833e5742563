//! What a training leaves on disk to go on from, to the same bits.
//!
//! A checkpoint is a safetensors file: `weights/NAME`, `first/NAME`, `second/NAME` (moments of Adam) and perhaps
//! `average/NAME` for every tensor of the network, in the layout of [`Weights::tensors`], with the rest as JSON in its
//! metadata, key `fluvia_training`. It is written under a temporary name and renamed: a full disk or a kill leaves the one
//! before.

use std::collections::BTreeMap;
use std::path::Path;

use fluvia_sim::frames::write_atomically;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use crate::adam::{self, Adam};
use crate::weights::{FileTensor, Weights, content};
use crate::{Error, Result};

/// The key in the metadata.
const KEY: &str = "fluvia_training";

/// The version of this layout.
const FORMAT: u32 = 1;

/// Where a training is, beside its tensors.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Updates made.
    pub updates: u64,
    /// The position in the stream of windows.
    pub position: u64,
    /// Particles that were in all windows so far, times the steps of each.
    pub particle_samples: u64,
    /// Seconds of training so far, in all runs.
    pub seconds: f64,
    /// The update with the lowest validation error, and that error.
    pub best: Option<(u64, f64)>,
    /// The settings, as the caller wrote them: those that it goes on with must be the same.
    pub settings: String,
}

/// A training at some update.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Where it is.
    pub place: Place,
    /// The values of all tensors of the network.
    pub weights: Vec<Vec<f32>>,
    /// The optimiser.
    pub adam: Adam,
    /// Averaged weights.
    pub averages: Option<Vec<Vec<f32>>>,
}

/// The metadata as it is in the file.
#[derive(Serialize, Deserialize)]
struct Record {
    format: u32,
    place: Place,
}

impl Checkpoint {
    /// Writes the checkpoint; `network` has the names and shapes.
    ///
    /// # Errors
    /// `Io`; `Parameter` if the tensors are not those of the network.
    pub fn save(&self, path: &Path, network: &Weights) -> Result<()> {
        let groups = [
            ("weights", Some(&self.weights)),
            ("first", Some(&self.adam.first)),
            ("second", Some(&self.adam.second)),
            ("average", self.averages.as_ref()),
        ];
        let tensors = network.tensors();
        let mut files = Vec::new();
        for (group, values) in groups.into_iter().filter_map(|(name, values)| Some((name, values?))) {
            if values.len() != tensors.len() {
                return Err(Error::Parameter(format!("checkpoint: {group} of another network")));
            }
            files.extend(tensors.iter().zip(values).map(|(tensor, values)| {
                FileTensor::new(format!("{group}/{}", tensor.name), tensor.shape.clone(), values)
            }));
        }
        let record = Record { format: FORMAT, place: self.place.clone() };
        let content = content(&files, KEY, &record)
            .map_err(|fault| Error::Parameter(format!("checkpoint: {fault}")))?;
        Ok(write_atomically(path, |out| out.write_all(&content))?)
    }

    /// Reads a checkpoint of this network, whose optimiser has these constants.
    ///
    /// # Errors
    /// `Io`; `File` if it is damaged, no checkpoint, or one of another network.
    pub fn load(path: &Path, network: &Weights, params: adam::Params) -> Result<Checkpoint> {
        let bytes = std::fs::read(path).map_err(Error::io(path))?;
        parse(&bytes, network, params).map_err(|message| Error::file(path, message))
    }
}

fn parse(bytes: &[u8], network: &Weights, params: adam::Params) -> std::result::Result<Checkpoint, String> {
    let damaged = |error: safetensors::SafeTensorError| format!("no checkpoint, or damaged: {error}");
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let record = header.metadata().as_ref().and_then(|notes| notes.get(KEY));
    let record = record.ok_or_else(|| format!("no checkpoint: its metadata has no `{KEY}`"))?;
    let Record { format, place } =
        serde_json::from_str(record).map_err(|error| format!("metadata `{KEY}`: {error}"))?;
    if format != FORMAT {
        return Err(format!("checkpoint of version {format}, expected {FORMAT}"));
    }
    let content = SafeTensors::deserialize(bytes).map_err(damaged)?;
    let mut tensors: BTreeMap<String, TensorView<'_>> = content.tensors().into_iter().collect();
    let mut group = |group: &str| -> std::result::Result<Vec<Vec<f32>>, String> {
        let read = |tensor: &crate::weights::Tensor<'_>| {
            let name = format!("{group}/{}", tensor.name);
            let view =
                tensors.remove(&name).ok_or_else(|| format!("no tensor `{name}`: of another network"))?;
            if view.shape() != tensor.shape || view.dtype() != Dtype::F32 {
                let (found, expected) = (view.shape(), &tensor.shape);
                return Err(format!(
                    "tensor `{name}` has shape {found:?}, expected {expected:?}: another network"
                ));
            }
            let values: Vec<f32> =
                view.data().as_chunks::<4>().0.iter().map(|raw| f32::from_le_bytes(*raw)).collect();
            match values.iter().find(|value| !value.is_finite()) {
                Some(value) => Err(format!("tensor `{name}` has the value {value}, expected finite numbers")),
                None => Ok(values),
            }
        };
        network.tensors().iter().map(read).collect()
    };
    let (weights, first, second) = (group("weights")?, group("first")?, group("second")?);
    let has_average = content.names().iter().any(|name| name.starts_with("average/"));
    let averages = has_average.then(|| group("average")).transpose()?;
    if let Some(name) = tensors.keys().next() {
        return Err(format!("tensor `{name}` is none of this network: another one"));
    }
    let adam = Adam { params, updates: place.updates, first, second };
    Ok(Checkpoint { place, weights, adam, averages })
}

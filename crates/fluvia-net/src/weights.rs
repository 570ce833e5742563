//! The weights of the network (Fig. 2) and the files that hold them.
//!
//! ```text
//! obstacle      convolution  wall normals                  -> a
//! fluid         convolution  1, velocity, extra inputs     -> b
//! fluid_dense   dense        the same                      -> c
//! layers[0]     convolution + dense  a + b + c (in this order) -> n_1
//! layers[k]     convolution + dense  n_k                   -> n_(k+1); the last gives 3 or 6 outputs
//! ```
//!
//! Filters are `[depth, height, width, in, out]` (z slowest), dense matrices `[in, out]`; PyTorch files hold the
//! transpose of the latter. The published network has a = b = c = 32 and layers of 64, 64 and 3 outputs.
//!
//! Read are the published PyTorch (`.pt`) and Keras (`.h5`) files, files made like them, and safetensors;
//! which of them a file is, its first bytes say. Safetensors, the only form that is written, has the tensor
//! names of the PyTorch file and a [`Config`] in its metadata; the other two forms have none, and
//! get the configuration of the published model, as far as the tensors do not say otherwise.

mod archive;
mod assemble;
mod initial;
mod keras;
mod pickle;
mod pytorch;
mod safetensors;
mod tensors;

use std::fmt;
use std::path::Path;

use crate::config::{Config, WALL_INPUTS};
use crate::{Error, Result};
use archive::{Archive, Entry};

pub(crate) use self::safetensors::{FileTensor, content};
pub use self::safetensors::{save_safetensors, to_safetensors};
pub use self::tensors::Tensor;

/// The weights of a network with its configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// What the weights were made for.
    pub config: Config,
    /// First layer, walls to fluid (`conv0_obstacle`).
    pub obstacle: Convolution,
    /// First layer, fluid to fluid (`conv0_fluid`).
    pub fluid: Convolution,
    /// First layer, each particle by itself (`dense0_fluid`); `None` in a network that is not fully connected.
    pub fluid_dense: Option<Dense>,
    /// The layers that follow (`conv1` with `dense1` and so on), at least one.
    pub layers: Vec<Layer>,
    /// How the weights were trained, as JSON text, if the file says.
    pub training: Option<String>,
}

/// A layer after the first: the outputs of both parts are added.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Over the neighbours.
    pub convolution: Convolution,
    /// Over the particle itself; `None` in a network that is not fully connected.
    pub dense: Option<Dense>,
}

/// A continuous convolution.
#[derive(Clone, Debug, PartialEq)]
pub struct Convolution {
    /// Channels in.
    pub inputs: usize,
    /// Channels out.
    pub outputs: usize,
    /// The filter, `[depth, height, width, in, out]`.
    pub kernel: Vec<f32>,
    /// Added to each output, `[out]`.
    pub bias: Vec<f32>,
}

/// A fully connected layer.
#[derive(Clone, Debug, PartialEq)]
pub struct Dense {
    /// Channels in.
    pub inputs: usize,
    /// Channels out.
    pub outputs: usize,
    /// The matrix, `[in, out]`.
    pub weight: Vec<f32>,
    /// Added to each output, `[out]`.
    pub bias: Vec<f32>,
}

impl Weights {
    /// A network that is zero everywhere. Each part of the first layer gives `first` channels,
    /// the layers between the first and the last give those of `hidden`.
    pub fn zeros(config: Config, first: usize, hidden: &[usize]) -> Weights {
        let cells = config.filter_size.iter().product::<usize>();
        let convolution = |inputs, outputs| Convolution {
            inputs,
            outputs,
            kernel: vec![0.0; cells * inputs * outputs],
            bias: vec![0.0; outputs],
        };
        let dense = |inputs, outputs| {
            config.fully_connected.then(|| Dense {
                inputs,
                outputs,
                weight: vec![0.0; inputs * outputs],
                bias: vec![0.0; outputs],
            })
        };
        let parts = if config.fully_connected { 3 } else { 2 };
        let mut widths = vec![parts * first];
        widths.extend(hidden);
        widths.push(config.integration.outputs());
        let layer = |pair: &[usize]| Layer {
            convolution: convolution(pair[0], pair[1]),
            dense: dense(pair[0], pair[1]),
        };
        Weights {
            obstacle: convolution(WALL_INPUTS, first),
            fluid: convolution(config.fluid_inputs(), first),
            fluid_dense: dense(config.fluid_inputs(), first),
            layers: widths.windows(2).map(layer).collect(),
            training: None,
            config,
        }
    }

    /// The same network with one more input of fluid particles, after all others and with weights of zero: it computes the
    /// same until these are trained.
    pub fn with_extra_input(mut self, name: &str) -> Weights {
        let wider = |values: &[f32], inputs: usize, outputs| pad_inputs(values, inputs, outputs, inputs + 1);
        let Weights { fluid, fluid_dense, .. } = &mut self;
        fluid.kernel = wider(&fluid.kernel, fluid.inputs, fluid.outputs);
        fluid.inputs += 1;
        if let Some(dense) = fluid_dense {
            dense.weight = wider(&dense.weight, dense.inputs, dense.outputs);
            dense.inputs += 1;
        }
        self.config.extra_inputs.push(name.to_owned());
        self
    }

    /// Checks that the layers fit each other and the configuration, and that every number is finite.
    ///
    /// # Errors
    /// `Parameter` that names the tensor or key, what it is and what was expected.
    pub fn check(&self) -> Result<()> {
        self.fault().map_or(Ok(()), |fault| Err(Error::Parameter(format!("weights: {fault}"))))
    }

    fn fault(&self) -> Option<String> {
        if let Some(fault) = self.config.fault() {
            return Some(fault);
        }
        let Some(last) = self.layers.last() else {
            return Some("no layer after the first, expected at least one".into());
        };
        let inputs = self.config.fluid_inputs();
        let outputs = self.config.integration.outputs();
        let mut widths = vec![
            ("conv0_obstacle inputs".to_owned(), self.obstacle.inputs, WALL_INPUTS),
            ("conv0_fluid inputs".to_owned(), self.fluid.inputs, inputs),
            (format!("conv{} outputs", self.layers.len()), last.convolution.outputs, outputs),
        ];
        let mut previous = self.obstacle.outputs + self.fluid.outputs;
        if let Some(dense) = &self.fluid_dense {
            widths.push(("dense0_fluid inputs".to_owned(), dense.inputs, inputs));
            previous += dense.outputs;
        }
        let mut all_dense = vec![("dense0_fluid".to_owned(), &self.fluid_dense)];
        for (number, Layer { convolution, dense }) in (1..).zip(&self.layers) {
            widths.push((format!("conv{number} inputs"), convolution.inputs, previous));
            if let Some(dense) = dense {
                widths.push((format!("dense{number} inputs"), dense.inputs, previous));
                widths.push((format!("dense{number} outputs"), dense.outputs, convolution.outputs));
            }
            all_dense.push((format!("dense{number}"), dense));
            previous = convolution.outputs;
        }
        let expected = self.config.fully_connected;
        if let Some((name, _)) = all_dense.iter().find(|(_, dense)| dense.is_some() != expected) {
            return Some(match expected {
                true => format!("{name} is missing in a fully connected network"),
                false => format!("{name} in a network that is not fully connected"),
            });
        }
        if let Some((name, found, expected)) =
            widths.into_iter().find(|(_, found, expected)| found != expected)
        {
            return Some(format!("{name}: {found}, expected {expected}"));
        }
        self.tensors().iter().find_map(|tensor| {
            let expected: usize = tensor.shape.iter().product();
            if tensor.values.len() != expected {
                let Tensor { name, shape, values } = tensor;
                return Some(format!("tensor `{name}` has {} values, expected {shape:?}", values.len()));
            }
            let index = tensor.values.iter().position(|value| !value.is_finite())?;
            Some(format!("tensor `{}`: value {index} is {}", tensor.name, tensor.values[index]))
        })
    }
}

/// Adds zero channels to the inputs of a filter [cells, in, out].
pub(crate) fn pad_inputs(kernel: &[f32], inputs: usize, outputs: usize, padded: usize) -> Vec<f32> {
    let zeros = vec![0.0; (padded - inputs) * outputs];
    kernel.chunks_exact(inputs * outputs).flat_map(|cell| cell.iter().chain(&zeros)).copied().collect()
}

/// Reads the weights of a network.
///
/// # Errors
/// `Io` if the file cannot be read; `File` if it is damaged, of another kind, or holds another network.
pub fn load(path: impl AsRef<Path>) -> Result<Weights> {
    let path = path.as_ref();
    from_bytes(path, std::fs::read(path).map_err(Error::io(path))?)
}

/// Reads the weights of a network from the content of a file; `path` only names it in errors.
///
/// # Errors
/// `File` as [`load`].
pub fn from_bytes(path: impl AsRef<Path>, bytes: Vec<u8>) -> Result<Weights> {
    open(bytes).and_then(|mut archive| assemble::network(&mut *archive)).map_err(in_file(path.as_ref()))
}

/// What a file holds, of whichever network.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// The format.
    pub kind: FileKind,
    /// Notes in the file, sorted by key.
    pub metadata: Vec<(String, String)>,
    /// The tensors, in the order of the file.
    pub tensors: Vec<TensorInfo>,
}

impl Summary {
    /// The number of numbers in all tensors that are trained: published files hold constants beside them.
    pub fn parameters(&self) -> usize {
        let is_constant = |name: &str| name == "gravity" || name.ends_with(".offset");
        let trained = self.tensors.iter().filter(|tensor| !is_constant(&tensor.name));
        trained.map(|tensor| tensor.shape.iter().product::<usize>()).sum()
    }
}

/// What a tensor of a file is.
#[derive(Clone, Debug, PartialEq)]
pub struct TensorInfo {
    /// The name in the file.
    pub name: String,
    /// Extents in the file, outermost first.
    pub shape: Vec<usize>,
    /// The type of its elements: "f32".
    pub element: String,
    /// Its values in short; `None` if it has none or its type is not read.
    pub statistics: Option<Statistics>,
}

/// The values of a tensor in short.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics {
    /// The smallest finite value.
    pub min: f64,
    /// The largest finite value.
    pub max: f64,
    /// The mean of the finite values.
    pub mean: f64,
    /// How many values are not finite.
    pub non_finite: usize,
}

/// Lists what a weight file holds, of this network or another.
///
/// # Errors
/// `Io` if the file cannot be read; `File` if it is damaged or of another kind.
pub fn summarize(path: impl AsRef<Path>) -> Result<Summary> {
    let path = path.as_ref();
    summarize_bytes(path, std::fs::read(path).map_err(Error::io(path))?)
}

/// Lists what the content of a weight file holds; `path` only names it in errors.
///
/// # Errors
/// `File` as [`summarize`].
pub fn summarize_bytes(path: impl AsRef<Path>, bytes: Vec<u8>) -> Result<Summary> {
    open(bytes).and_then(|mut archive| summary(&mut *archive)).map_err(in_file(path.as_ref()))
}

/// The formats that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A zip archive with a pickle, `.pt`.
    PyTorch,
    /// HDF5, `.h5`.
    Keras,
    /// `.safetensors`.
    Safetensors,
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            FileKind::PyTorch => "PyTorch",
            FileKind::Keras => "Keras (HDF5)",
            FileKind::Safetensors => "safetensors",
        })
    }
}

/// Adds the file to a message, which may quote names in the file: it is made one line of a bounded length.
fn in_file(path: &Path) -> impl FnOnce(String) -> Error {
    /// Enough for every message whose names are not made to be long.
    const MAX_CHARACTERS: usize = 600;
    move |message| {
        let line = message.chars().map(|c| if c.is_control() { ' ' } else { c }).take(MAX_CHARACTERS);
        Error::file(path, line.collect::<String>())
    }
}

/// Opens a file as what its first bytes say that it is.
fn open(bytes: Vec<u8>) -> std::result::Result<Box<dyn Archive>, String> {
    if bytes.starts_with(pytorch::MAGIC) {
        Ok(Box::new(pytorch::open(bytes)?))
    } else if bytes.starts_with(keras::MAGIC) {
        Ok(Box::new(keras::open(bytes)?))
    } else if safetensors::is_safetensors(&bytes) {
        Ok(Box::new(safetensors::open(bytes)?))
    } else {
        Err(unknown(&bytes))
    }
}

/// Says what a file is that is none of the formats.
fn unknown(bytes: &[u8]) -> String {
    const EXPECTED: &str = "expected PyTorch (.pt), Keras (.h5) or safetensors weights";
    if bytes.is_empty() {
        format!("empty file (0 bytes), {EXPECTED}")
    } else if pytorch::is_legacy(bytes) {
        "the old PyTorch form from before version 1.6, which is not read: save it again with a newer PyTorch"
            .into()
    } else if bytes.starts_with(b"version https://git-lfs") {
        format!("a Git LFS pointer in place of the file, {EXPECTED}")
    } else {
        let start = &bytes[..bytes.len().min(8)];
        format!(
            "not a weight file: {} bytes that begin with \"{}\", {EXPECTED}",
            bytes.len(),
            start.escape_ascii()
        )
    }
}

fn summary(archive: &mut dyn Archive) -> std::result::Result<Summary, String> {
    let entries: Vec<Entry> = archive.entries().to_vec();
    let mut tensors = Vec::with_capacity(entries.len());
    for (index, entry) in entries.into_iter().enumerate() {
        let statistics = if entry.element.size().is_some() {
            let values =
                archive.values(index).map_err(|fault| format!("tensor `{}`: {fault}", entry.name))?;
            statistics(&values)
        } else {
            None
        };
        tensors.push(TensorInfo {
            element: entry.element.name().to_owned(),
            name: entry.name,
            shape: entry.shape,
            statistics,
        });
    }
    Ok(Summary { kind: archive.kind(), metadata: archive.metadata().to_vec(), tensors })
}

fn statistics(values: &[f64]) -> Option<Statistics> {
    let finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let mean = finite.iter().sum::<f64>() / finite.len().max(1) as f64;
    (!values.is_empty()).then(|| Statistics {
        min: finite.iter().copied().reduce(f64::min).unwrap_or(f64::NAN),
        max: finite.iter().copied().reduce(f64::max).unwrap_or(f64::NAN),
        mean: if finite.is_empty() { f64::NAN } else { mean },
        non_finite: values.len() - finite.len(),
    })
}

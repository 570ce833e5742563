//! Safetensors: a JSON header and raw little-endian data, read and written.
//!
//! ```text
//! 8 bytes  length of the header
//! header   {"__metadata__": {"fluvia": RECORD}, "conv1.kernel": {"dtype": "F32", "shape": ..., "data_offsets": ...}, ...}
//! data     the tensors one after the other
//! ```
//!
//! Tensors have the names and shapes of the published PyTorch file (dense weights are `[out, in]`), with its
//! constants `gravity` and `conv*.offset`, so that PyTorch loads the file into the published network. RECORD is
//! a JSON text: format version, units, network, physics, integration mode, training record.

use std::ops::Range;
use std::path::Path;

use cconv::{Interpolation, Window};
use fluvia_sim::frames::write_atomically;
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};

use super::archive::{Archive, Element, Entry, check_total};
use super::assemble::transpose;
use super::{FileKind, Tensor, Weights};
use crate::config::{Config, Integration};
use crate::{Error, Result};

/// The key of our record in the metadata of a file.
const RECORD_KEY: &str = "fluvia";

/// The version of the record that is written, and the only one that is read.
const FORMAT_VERSION: u64 = 1;

/// What the numbers of the record are in.
const UNITS: &str = "metre, second, kilogram";

/// The content of a safetensors file with these weights. Equal weights give equal bytes.
///
/// # Errors
/// `Parameter` if [`Weights::check`] finds a fault.
pub fn to_safetensors(weights: &Weights) -> Result<Vec<u8>> {
    weights.check()?;
    let mut tensors = vec![FileTensor::new("gravity".into(), vec![3], &weights.config.gravity)];
    for Tensor { name, shape, values } in weights.tensors() {
        if let Some(layer) = name.strip_suffix(".kernel") {
            tensors.push(FileTensor::new(format!("{layer}.offset"), vec![3], &[0.0; 3]));
        }
        tensors.push(match *shape {
            [inputs, outputs] => {
                FileTensor::new(name, vec![outputs, inputs], &transpose(values, inputs, outputs))
            }
            _ => FileTensor::new(name, shape, values),
        });
    }
    let record = Record::new(&weights.config, weights.training.as_deref());
    content(&tensors, RECORD_KEY, &record).map_err(|fault| Error::Parameter(format!("weights: {fault}")))
}

/// A safetensors file with a record, as JSON, under one key of its metadata: several keys would be written in an order
/// that changes from run to run.
pub(crate) fn content(
    tensors: &[FileTensor],
    key: &str,
    record: &impl Serialize,
) -> std::result::Result<Vec<u8>, String> {
    let text = |fault: SafeTensorError| fault.to_string();
    let mut views = Vec::with_capacity(tensors.len());
    for FileTensor { name, shape, bytes } in tensors {
        views.push((name, TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(text)?));
    }
    let record = serde_json::to_string(record).map_err(|fault| fault.to_string())?;
    serialize(views, Some([(key.to_owned(), record)].into_iter().collect())).map_err(text)
}

/// Writes these weights as a safetensors file: to a temporary name first, which then takes the place of `path`.
///
/// # Errors
/// `Parameter` as [`to_safetensors`]; `Io` if the file cannot be written.
pub fn save_safetensors(path: impl AsRef<Path>, weights: &Weights) -> Result<()> {
    let bytes = to_safetensors(weights)?;
    Ok(write_atomically(path.as_ref(), |out| out.write_all(&bytes))?)
}

/// A tensor in the form of the file.
pub(crate) struct FileTensor {
    name: String,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl FileTensor {
    pub(crate) fn new(name: String, shape: Vec<usize>, values: &[f32]) -> FileTensor {
        FileTensor { name, shape, bytes: values.iter().flat_map(|value| value.to_le_bytes()).collect() }
    }
}

/// The record as it is in the file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Record {
    format_version: u64,
    units: String,
    network: NetworkRecord,
    particle_radius: f32,
    filter_radius: f32,
    dt: f32,
    gravity: [f32; 3],
    viscosity: f32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    viscosity_range: Option<[f32; 2]>,
    density: f32,
    integration: IntegrationRecord,
    training: Option<String>,
}

/// Depth, height and width of the filters, in cells; what the channels mean.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct NetworkRecord {
    filter_size: [usize; 3],
    extra_inputs: Vec<String>,
    output_scale: f32,
    // What the paper's ablations vary: files of the published network do not have it.
    #[serde(default, skip_serializing_if = "is_default")]
    interpolation: InterpolationRecord,
    #[serde(default, skip_serializing_if = "is_default")]
    window: WindowRecord,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fully_connected: Option<bool>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

#[derive(Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum InterpolationRecord {
    #[default]
    Linear,
    LinearBorder,
    Nearest,
}

#[derive(Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum WindowRecord {
    #[default]
    Poly6,
    Triangular,
    None,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum IntegrationRecord {
    Paper,
    Velocity,
}

impl Record {
    fn new(config: &Config, training: Option<&str>) -> Record {
        Record {
            format_version: FORMAT_VERSION,
            units: UNITS.into(),
            network: NetworkRecord {
                filter_size: config.filter_size,
                extra_inputs: config.extra_inputs.clone(),
                output_scale: config.output_scale,
                interpolation: match config.interpolation {
                    Interpolation::Linear => InterpolationRecord::Linear,
                    Interpolation::LinearBorder => InterpolationRecord::LinearBorder,
                    Interpolation::Nearest => InterpolationRecord::Nearest,
                },
                window: match config.window {
                    Window::Poly6 => WindowRecord::Poly6,
                    Window::Triangular => WindowRecord::Triangular,
                    Window::None => WindowRecord::None,
                },
                fully_connected: (!config.fully_connected).then_some(false),
            },
            particle_radius: config.particle_radius,
            filter_radius: config.filter_radius,
            dt: config.dt,
            gravity: config.gravity,
            viscosity: config.viscosity,
            viscosity_range: config.viscosity_range,
            density: config.density,
            integration: match config.integration {
                Integration::Paper => IntegrationRecord::Paper,
                Integration::Velocity => IntegrationRecord::Velocity,
            },
            training: training.map(str::to_owned),
        }
    }

    fn config(self) -> (Config, Option<String>) {
        let config = Config {
            filter_size: self.network.filter_size,
            extra_inputs: self.network.extra_inputs,
            particle_radius: self.particle_radius,
            filter_radius: self.filter_radius,
            dt: self.dt,
            gravity: self.gravity,
            viscosity: self.viscosity,
            viscosity_range: self.viscosity_range,
            density: self.density,
            output_scale: self.network.output_scale,
            interpolation: match self.network.interpolation {
                InterpolationRecord::Linear => Interpolation::Linear,
                InterpolationRecord::LinearBorder => Interpolation::LinearBorder,
                InterpolationRecord::Nearest => Interpolation::Nearest,
            },
            window: match self.network.window {
                WindowRecord::Poly6 => Window::Poly6,
                WindowRecord::Triangular => Window::Triangular,
                WindowRecord::None => Window::None,
            },
            fully_connected: self.network.fully_connected.unwrap_or(true),
            integration: match self.integration {
                IntegrationRecord::Paper => Integration::Paper,
                IntegrationRecord::Velocity => Integration::Velocity,
            },
        };
        (config, self.training)
    }
}

/// The configuration and training record in the metadata of a file, if it has them.
pub(super) fn record(
    metadata: &[(String, String)],
) -> std::result::Result<Option<(Config, Option<String>)>, String> {
    /// What every version of the record has.
    #[derive(Deserialize)]
    struct Version {
        format_version: u64,
    }
    let Some((_, text)) = metadata.iter().find(|(key, _)| key == RECORD_KEY) else { return Ok(None) };
    let fault = |fault: serde_json::Error| format!("metadata `{RECORD_KEY}`: {fault}");
    let Version { format_version } = serde_json::from_str(text).map_err(fault)?;
    if format_version != FORMAT_VERSION {
        return Err(format!(
            "metadata `{RECORD_KEY}`: format version {format_version}, expected {FORMAT_VERSION}"
        ));
    }
    let record: Record = serde_json::from_str(text).map_err(fault)?;
    if record.units != UNITS {
        return Err(format!("metadata `{RECORD_KEY}`: units `{}`, expected `{UNITS}`", record.units));
    }
    Ok(Some(record.config()))
}

/// Bytes of the length before the header.
const LENGTH_SIZE: usize = 8;

/// Whether a file begins as safetensors do: a length and the brace of the header.
pub(super) fn is_safetensors(bytes: &[u8]) -> bool {
    /// Longer headers are not allowed by the format.
    const MAX_HEADER: u64 = 100_000_000;
    header_length(bytes).is_some_and(|length| length <= MAX_HEADER) && bytes.get(LENGTH_SIZE) == Some(&b'{')
}

fn header_length(bytes: &[u8]) -> Option<u64> {
    bytes.first_chunk().map(|length| u64::from_le_bytes(*length))
}

/// Opens a safetensors file.
pub(super) fn open(bytes: Vec<u8>) -> std::result::Result<SafetensorsFile, String> {
    let (header, content) = SafeTensors::read_metadata(&bytes).map_err(|error| fault(error, &bytes))?;
    let start = LENGTH_SIZE + header;
    let mut entries = Vec::new();
    let mut ranges = Vec::new();
    for name in content.offset_keys() {
        let Some(info) = content.info(&name) else { continue };
        ranges.push(start + info.data_offsets.0..start + info.data_offsets.1);
        entries.push(Entry { name, shape: info.shape.clone(), element: element(info.dtype) });
    }
    check_total(&entries, bytes.len())?;
    let mut metadata: Vec<(String, String)> =
        content.metadata().iter().flatten().map(|(key, value)| (key.clone(), value.clone())).collect();
    metadata.sort_unstable();
    Ok(SafetensorsFile { bytes, metadata, entries, ranges })
}

/// An open safetensors file.
pub(super) struct SafetensorsFile {
    bytes: Vec<u8>,
    metadata: Vec<(String, String)>,
    entries: Vec<Entry>,
    /// Where the tensors lie in the file.
    ranges: Vec<Range<usize>>,
}

impl Archive for SafetensorsFile {
    fn kind(&self) -> FileKind {
        FileKind::Safetensors
    }

    fn metadata(&self) -> &[(String, String)] {
        &self.metadata
    }

    fn entries(&self) -> &[Entry] {
        &self.entries
    }

    fn values(&mut self, index: usize) -> std::result::Result<Vec<f64>, String> {
        self.entries[index].element.decode_all(&self.bytes[self.ranges[index].clone()])
    }
}

fn element(dtype: Dtype) -> Element {
    match dtype {
        Dtype::F64 => Element::F64,
        Dtype::F32 => Element::F32,
        Dtype::F16 => Element::F16,
        Dtype::BF16 => Element::BF16,
        Dtype::I64 => Element::I64,
        Dtype::I32 => Element::I32,
        Dtype::I16 => Element::I16,
        Dtype::I8 => Element::I8,
        Dtype::U64 => Element::U64,
        Dtype::U32 => Element::U32,
        Dtype::U16 => Element::U16,
        Dtype::U8 => Element::U8,
        Dtype::BOOL => Element::Bool,
        other => Element::Other(other.to_string()),
    }
}

/// Says what is wrong with a file, with the numbers of bytes where it was cut short.
fn fault(error: SafeTensorError, bytes: &[u8]) -> String {
    let expected = match error {
        SafeTensorError::InvalidHeaderLength => {
            header_length(bytes).and_then(|length| length.checked_add(LENGTH_SIZE as u64))
        }
        SafeTensorError::MetadataIncompleteBuffer => data_end(bytes),
        _ => None,
    };
    let found = bytes.len() as u64;
    match expected {
        Some(expected) if expected > found => {
            format!("truncated safetensors file: {expected} bytes expected, {found} found")
        }
        Some(expected) => format!("safetensors file of {found} bytes, {expected} expected"),
        None => format!("damaged safetensors file: {error}"),
    }
}

/// Where the data of a file end, as its header says.
fn data_end(bytes: &[u8]) -> Option<u64> {
    let start = header_length(bytes)?.checked_add(LENGTH_SIZE as u64)?;
    let header = bytes.get(LENGTH_SIZE..usize::try_from(start).ok()?)?;
    let header: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(header).ok()?;
    let end = |tensor: &serde_json::Value| tensor.get("data_offsets")?.get(1)?.as_u64();
    header.values().filter_map(end).max()?.checked_add(start)
}

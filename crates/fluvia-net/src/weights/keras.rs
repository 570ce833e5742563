//! Keras files (`.h5`, HDF5): weights alone, or a whole model with them in the group `model_weights`.
//!
//! A layer is a group with arrays below it: `conv1/MODEL/conv1/kernel:0`. Convolutions are stored as
//! `[depth, height, width, in, out]`, dense layers as `[in, out]`.

use std::collections::HashSet;

use hdf5_pure::{AttrValue, Dataset, Datatype, DatatypeByteOrder, File, Group, Layout};

use super::FileKind;
use super::archive::{Archive, Element, Entry, check_total, element_count, memory_limit};

/// How an HDF5 file begins.
pub(super) const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";

/// How deep groups may lie in each other: links can form circles.
const MAX_DEPTH: usize = 16;

/// How many groups and arrays are looked at: links can lead to the same group in many ways.
const MAX_OBJECTS: usize = 10_000;

/// The longest path of an array, bytes.
const MAX_PATH: usize = 1024;

/// Opens a Keras file.
pub(super) fn open(bytes: Vec<u8>) -> Result<KerasFile, String> {
    let length = bytes.len();
    let file = File::from_bytes(bytes)
        .map_err(|fault| format!("damaged or truncated Keras file (HDF5) of {length} bytes: {fault}"))?;
    let expected = file.superblock().eof_address;
    if expected > length as u64 {
        return Err(format!("truncated Keras file (HDF5): {expected} bytes expected, {length} found"));
    }
    let root = file.root();
    let mut walk = Walk { length, objects: 0, arrays: Vec::new() };
    walk.group(&root, "", 0)?;
    let (entries, datasets): (Vec<_>, Vec<_>) = walk.arrays.into_iter().unzip();
    check_total(&entries, length)?;
    Ok(KerasFile { metadata: metadata(&root), entries, datasets, limit: memory_limit(length) })
}

/// An open Keras file.
pub(super) struct KerasFile {
    metadata: Vec<(String, String)>,
    entries: Vec<Entry>,
    datasets: Vec<Dataset>,
    /// The most bytes that one chunk may have.
    limit: u64,
}

impl Archive for KerasFile {
    fn kind(&self) -> FileKind {
        FileKind::Keras
    }

    fn metadata(&self) -> &[(String, String)] {
        &self.metadata
    }

    fn entries(&self) -> &[Entry] {
        &self.entries
    }

    fn values(&mut self, index: usize) -> Result<Vec<f64>, String> {
        let (entry, dataset) = (&self.entries[index], &self.datasets[index]);
        let Some(size) = entry.element.size() else { return Err(entry.element.not_read()) };
        check_layout(dataset, entry, size, self.limit)?;
        let values = match entry.element {
            Element::F16 => {
                let big = matches!(
                    dataset.datatype(),
                    Ok(Datatype::FloatingPoint { byte_order: DatatypeByteOrder::BigEndian, .. })
                );
                let mut bytes = dataset.read_raw().map_err(|fault| fault.to_string())?;
                if big {
                    bytes.chunks_exact_mut(size).for_each(<[u8]>::reverse);
                }
                entry.element.decode_all(&bytes)?
            }
            _ => dataset.read_f64().map_err(|fault| fault.to_string())?,
        };
        if values.len() != entry.count() {
            return Err(format!(
                "{} values, expected {} of shape {:?}",
                values.len(),
                entry.count(),
                entry.shape
            ));
        }
        Ok(values)
    }
}

/// Checks how an array is stored before a byte of it is asked for: what was never written would be read as
/// zeros, and a chunk that lies elsewhere than its index says would be added to places that do not exist.
fn check_layout(dataset: &Dataset, entry: &Entry, size: usize, limit: u64) -> Result<(), String> {
    let chunk_shape = match dataset.layout().map_err(|fault| fault.to_string())? {
        Layout::Contiguous { address: None, .. } => return Err("its values were never written".into()),
        Layout::Chunked { chunk_shape, .. } => chunk_shape,
        _ => return Ok(()),
    };
    let bytes = chunk_shape.iter().try_fold(size as u64, |bytes, &extent| bytes.checked_mul(extent));
    let fits = chunk_shape.len() == entry.shape.len()
        && !chunk_shape.contains(&0)
        && bytes.is_some_and(|bytes| bytes <= limit);
    if !fits {
        return Err(format!(
            "chunks of shape {chunk_shape:?}, expected no more than the file can hold of {:?}",
            entry.shape
        ));
    }
    let chunks = dataset.chunks().map_err(|fault| fault.to_string())?;
    let grid = entry.shape.iter().zip(&chunk_shape).map(|(&extent, &chunk)| (extent as u64).div_ceil(chunk));
    // Neither the count of elements nor, therefore, that of chunks overflows.
    let expected: u64 = grid.product();
    let places: HashSet<&[u64]> = chunks.iter().map(|chunk| chunk.offset.as_slice()).collect();
    let inside = |place: &&[u64]| {
        let mut axes = place.iter().zip(&chunk_shape).zip(&entry.shape);
        axes.all(|((&at, &chunk), &extent)| at.is_multiple_of(chunk) && at < extent as u64)
    };
    let found = places.iter().filter(|place| inside(place)).count();
    if found as u64 != expected || found != chunks.len() {
        return Err(format!("{found} of {} chunks in their places, expected {expected}", chunks.len()));
    }
    Ok(())
}

struct Walk {
    length: usize,
    objects: usize,
    arrays: Vec<(Entry, Dataset)>,
}

impl Walk {
    fn group(&mut self, group: &Group, path: &str, depth: usize) -> Result<(), String> {
        let fault = |fault: hdf5_pure::Error| format!("group `/{path}`: {fault}");
        for (name, dataset) in group.iter_datasets().map_err(fault)? {
            let name = self.enter(path, &name)?;
            let entry = entry(name, &dataset)?;
            self.arrays.push((entry, dataset));
        }
        for (name, inner) in group.iter_groups().map_err(fault)? {
            let name = self.enter(path, &name)?;
            if depth < MAX_DEPTH {
                self.group(&inner, &name, depth + 1)?;
            }
        }
        Ok(())
    }

    /// The path of an object, counted.
    fn enter(&mut self, path: &str, name: &str) -> Result<String, String> {
        self.objects += 1;
        if self.objects > MAX_OBJECTS.min(self.length) {
            return Err(format!(
                "more than {MAX_OBJECTS} groups and arrays, expected the weights of a network"
            ));
        }
        let path = if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") };
        if path.len() > MAX_PATH {
            return Err(format!("a path of {} bytes, expected at most {MAX_PATH}", path.len()));
        }
        Ok(path)
    }
}

fn entry(name: String, dataset: &Dataset) -> Result<Entry, String> {
    let fault = |fault: hdf5_pure::Error| format!("tensor `{name}`: {fault}");
    let extents = dataset.shape().map_err(fault)?;
    let element = element(&dataset.datatype().map_err(fault)?);
    let shape: Option<Vec<usize>> = extents.iter().map(|&extent| usize::try_from(extent).ok()).collect();
    let shape = shape.ok_or_else(|| format!("tensor `{name}`: shape {extents:?} is beyond memory"))?;
    element_count(&shape).map_err(|fault| format!("tensor `{name}`: {fault}"))?;
    Ok(Entry { name, shape, element })
}

fn element(datatype: &Datatype) -> Element {
    match datatype {
        Datatype::FloatingPoint { size: 8, .. } => Element::F64,
        Datatype::FloatingPoint { size: 4, .. } => Element::F32,
        Datatype::FloatingPoint { size: 2, layout, .. } if layout.exponent_size == HALF_EXPONENT => {
            Element::F16
        }
        Datatype::FixedPoint { size, layout, .. } => match (size, layout.signed) {
            (8, true) => Element::I64,
            (4, true) => Element::I32,
            (2, true) => Element::I16,
            (1, true) => Element::I8,
            (8, false) => Element::U64,
            (4, false) => Element::U32,
            (2, false) => Element::U16,
            (1, false) => Element::U8,
            _ => Element::Other(format!("integer of {size} bytes")),
        },
        Datatype::String { .. } => Element::Other("string".into()),
        _ => Element::Other("none of numbers".into()),
    }
}

/// Bits of the exponent of an IEEE 754 half-precision number.
const HALF_EXPONENT: u8 = 5;

/// The notes of Keras that say who wrote the file.
fn metadata(root: &Group) -> Vec<(String, String)> {
    let attributes = root.attrs().unwrap_or_default();
    let text = |key: &str| match attributes.get(key) {
        Some(
            AttrValue::String(text)
            | AttrValue::AsciiString(text)
            | AttrValue::VarLenString(text)
            | AttrValue::VarLenAsciiString(text),
        ) => Some((key.to_owned(), text.clone())),
        _ => None,
    };
    ["backend", "keras_version"].into_iter().filter_map(text).collect()
}

/// The PyTorch name of an array of a network: `model_weights/conv1/MODEL/conv1/kernel:0` is `conv1.kernel`.
/// `None` for the state of an optimiser.
pub(super) fn tensor_name(path: &str) -> Option<String> {
    let path = path.strip_prefix("model_weights/").unwrap_or(path);
    if path.starts_with("optimizer") {
        return None;
    }
    let mut parts = path.rsplit('/');
    let array = parts.next()?;
    let array = array.strip_suffix(":0").unwrap_or(array);
    let layer = parts.next()?;
    let array = if layer.starts_with("dense") && array == "kernel" { "weight" } else { array };
    Some(format!("{layer}.{array}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_pytorch_file() {
        let name = |path| tensor_name(path);
        assert_eq!(name("conv1/MyParticleNetwork/conv1/kernel:0").as_deref(), Some("conv1.kernel"));
        assert_eq!(name("dense0_fluid/N/dense0_fluid/kernel:0").as_deref(), Some("dense0_fluid.weight"));
        assert_eq!(name("model_weights/conv3/N/conv3/bias:0").as_deref(), Some("conv3.bias"));
        assert_eq!(name("conv1/kernel").as_deref(), Some("conv1.kernel"));
        assert_eq!(name("optimizer_weights/Adam/conv1/kernel/m:0"), None);
        assert_eq!(name("kernel"), None);
    }
}

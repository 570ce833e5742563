//! PyTorch files (`.pt`, `.pth`) as written since PyTorch 1.6.
//!
//! A zip archive: `ROOT/data.pkl` is a pickle that names the tensors and says where their elements lie,
//! `ROOT/data/KEY` are the storages (little-endian), `ROOT/byteorder` is optional. A tensor is a view of a
//! storage: an offset and one stride a dimension, in elements. The pickle is read by [`super::pickle`],
//! which executes nothing.

use std::collections::{HashMap, HashSet};
use std::io::{Cursor, Read};
use std::rc::Rc;

use zip::ZipArchive;

use super::FileKind;
use super::archive::{Archive, Element, Entry, check_total, element_count, memory_limit};
use super::pickle::{Id, Pickle, Value};

/// How a zip archive begins.
pub(super) const MAGIC: &[u8] = b"PK\x03\x04";

/// How the last record of a zip archive begins.
const DIRECTORY_END: &[u8] = b"PK\x05\x06";

/// Whether a file is a PyTorch file from before version 1.6: pickles in a row (their first is a number that
/// says so), or a tar archive.
pub(super) fn is_legacy(bytes: &[u8]) -> bool {
    const NUMBER: &[u8] = b"\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19";
    /// The number follows at most two opcodes that announce a protocol and a frame.
    const SEARCHED: usize = 32;
    /// Where a tar archive says that it is one.
    const TAR: std::ops::Range<usize> = 257..262;
    let start = &bytes[..bytes.len().min(SEARCHED)];
    start.windows(NUMBER.len()).any(|window| window == NUMBER) || bytes.get(TAR) == Some(b"ustar")
}

/// The largest description of tensors that is read, bytes: some 30,000 tensors. It bounds the memory that
/// a compressed pickle can ask for.
const MAX_PICKLE: u64 = 4 << 20;

/// PyTorch allows no more dimensions.
const MAX_DIMENSIONS: usize = 64;

/// How deep dictionaries may lie in each other; checkpoints have three to five levels.
const MAX_DEPTH: usize = 12;

/// Opens a PyTorch file.
pub(super) fn open(bytes: Vec<u8>) -> Result<PyTorchFile, String> {
    let length = bytes.len();
    if !bytes.windows(DIRECTORY_END.len()).any(|window| window == DIRECTORY_END) {
        return Err(format!("truncated PyTorch file: {length} bytes without the zip directory that ends it"));
    }
    let mut zip = ZipArchive::new(Cursor::new(bytes))
        .map_err(|fault| format!("damaged or truncated PyTorch file of {length} bytes: {fault}"))?;
    let root = root(&zip)?;
    let pickle = Pickle::parse(&member(&mut zip, &format!("{root}data.pkl"), MAX_PICKLE)?)?;
    check_byte_order(&mut zip, &root)?;

    let mut collector = Collector { pickle: &pickle, visits: VISITS, tensors: Vec::new() };
    collector.collect(pickle.root(), "", 0)?;
    let tensors = collector.tensors;
    if tensors.is_empty() {
        return Err(match pickle.get(pickle.root()) {
            Value::Call { function, .. } => {
                let (module, class) = pickle.global(*function).unwrap_or(("", "?"));
                format!(
                    "holds a pickled object ({module}.{class}), expected a dictionary of tensors (state_dict)"
                )
            }
            _ => "holds no tensors, expected a dictionary of tensors (state_dict)".into(),
        });
    }
    let (entries, views): (Vec<_>, Vec<_>) = tensors.into_iter().unzip();
    check_total(&entries, length)?;
    check_storages(&mut zip, &root, &entries, &views, length)?;
    Ok(PyTorchFile { zip, root, entries, views, storages: HashMap::new() })
}

/// An open PyTorch file.
pub(super) struct PyTorchFile {
    zip: ZipArchive<Cursor<Vec<u8>>>,
    /// The folder in the archive, with its slash.
    root: String,
    entries: Vec<Entry>,
    views: Vec<View>,
    /// Storages that were read; tensors may share one.
    storages: HashMap<String, Rc<[u8]>>,
}

/// Where the elements of a tensor lie.
#[derive(Debug)]
struct View {
    storage: String,
    /// Elements before the first one.
    offset: usize,
    /// Elements from one index to the next, for each dimension.
    strides: Vec<usize>,
    /// Elements of the storage.
    length: usize,
}

impl Archive for PyTorchFile {
    fn kind(&self) -> FileKind {
        FileKind::PyTorch
    }

    fn metadata(&self) -> &[(String, String)] {
        &[]
    }

    fn entries(&self) -> &[Entry] {
        &self.entries
    }

    fn values(&mut self, index: usize) -> Result<Vec<f64>, String> {
        let (entry, view) = (&self.entries[index], &self.views[index]);
        let Some(size) = entry.element.size() else { return Err(entry.element.not_read()) };
        let storage = match self.storages.get(&view.storage) {
            Some(storage) => Rc::clone(storage),
            None => {
                let name = format!("{}data/{}", self.root, view.storage);
                let storage: Rc<[u8]> = member(&mut self.zip, &name, u64::MAX)?.into();
                self.storages.insert(view.storage.clone(), Rc::clone(&storage));
                storage
            }
        };
        let mut values = Vec::with_capacity(entry.count());
        if entry.count() == 0 {
            return Ok(values);
        }
        gather(&entry.shape, &view.strides, view.offset, &mut |element| {
            let bytes = storage.get(element * size..(element + 1) * size)?;
            values.push(entry.element.decode(bytes));
            Some(())
        })
        .ok_or_else(|| format!("storage {} is shorter than its zip entry says", view.storage))?;
        Ok(values)
    }
}

/// Calls `visit` with the place of every element in row-major order, until it gives `None`.
fn gather(
    shape: &[usize],
    strides: &[usize],
    offset: usize,
    visit: &mut impl FnMut(usize) -> Option<()>,
) -> Option<()> {
    match (shape, strides) {
        ([extent, shape @ ..], [stride, strides @ ..]) => {
            (0..*extent).try_for_each(|index| gather(shape, strides, offset + index * stride, visit))
        }
        _ => visit(offset),
    }
}

/// The folder of `data.pkl`, with its slash.
fn root(zip: &ZipArchive<Cursor<Vec<u8>>>) -> Result<String, String> {
    let names: Vec<_> = zip.file_names().filter_map(Result::ok).collect();
    if let Some(root) = names
        .iter()
        .filter_map(|name| name.strip_suffix("data.pkl"))
        .filter(|root| root.is_empty() || root.ends_with('/'))
        .min_by_key(|root| root.len())
    {
        return Ok(root.to_owned());
    }
    Err(if names.iter().any(|name| name.ends_with(".npy")) {
        "a NumPy archive (npz), expected PyTorch, Keras or safetensors weights".into()
    } else if names.iter().any(|name| name.ends_with(".weights.h5")) {
        "a Keras 3 archive (.keras), expected PyTorch, Keras (.h5) or safetensors weights".into()
    } else {
        "a zip archive without data.pkl, expected PyTorch weights".into()
    })
}

/// The content of a member, which may be at most `limit` bytes.
fn member(zip: &mut ZipArchive<Cursor<Vec<u8>>>, name: &str, limit: u64) -> Result<Vec<u8>, String> {
    let file = zip.by_name(name).map_err(|fault| format!("zip entry `{name}`: {fault}"))?;
    let size = file.size();
    if size > limit {
        return Err(format!("zip entry `{name}`: {size} bytes, expected at most {limit}"));
    }
    // Not reserved ahead: the size is only a claim, the content grows as it is decompressed.
    let mut content = Vec::new();
    file.take(size)
        .read_to_end(&mut content)
        .map_err(|fault| format!("zip entry `{name}`: damaged: {fault}"))?;
    if content.len() as u64 != size {
        return Err(format!("zip entry `{name}`: {size} bytes expected, {} found", content.len()));
    }
    Ok(content)
}

fn check_byte_order(zip: &mut ZipArchive<Cursor<Vec<u8>>>, root: &str) -> Result<(), String> {
    /// Longer than any name of a byte order.
    const MAX_NAME: u64 = 64;
    let name = format!("{root}byteorder");
    if zip.index_for_name(&name).is_none() {
        return Ok(());
    }
    let order = member(zip, &name, MAX_NAME)?;
    if order.trim_ascii() == b"little" {
        return Ok(());
    }
    Err(format!("byte order `{}`, expected `little`", String::from_utf8_lossy(&order).escape_debug()))
}

/// Checks every view against its storage, and the storages together against the length of the file.
fn check_storages(
    zip: &mut ZipArchive<Cursor<Vec<u8>>>,
    root: &str,
    entries: &[Entry],
    views: &[View],
    length: usize,
) -> Result<(), String> {
    let mut seen = HashSet::new();
    let mut total = 0_u64;
    for (entry, view) in entries.iter().zip(views) {
        let Some(size) = entry.element.size() else { continue };
        let name = format!("{root}data/{}", view.storage);
        let index = zip
            .index_for_name(&name)
            .ok_or_else(|| format!("tensor `{}`: zip entry `{name}` is missing", entry.name))?;
        let found = zip.by_index_raw(index).map_err(|fault| format!("zip entry `{name}`: {fault}"))?.size();
        let expected = (view.length as u64).saturating_mul(size as u64);
        if found < expected {
            return Err(format!("zip entry `{name}`: {expected} bytes expected, {found} found"));
        }
        if seen.insert(&view.storage) {
            total = total.saturating_add(found);
        }
        if total > memory_limit(length) {
            return Err(format!(
                "zip entry `{name}` claims {found} bytes: more than a file of {length} bytes can hold"
            ));
        }
    }
    Ok(())
}

/// How many places of a pickle are looked at. An object that is used often is met often.
const VISITS: usize = 1 << 20;

struct Collector<'a> {
    pickle: &'a Pickle,
    visits: usize,
    tensors: Vec<(Entry, View)>,
}

impl Collector<'_> {
    /// Finds the tensors below a value; their names are the keys on the way, joined by dots.
    fn collect(&mut self, id: Id, name: &str, depth: usize) -> Result<(), String> {
        self.visits = self.visits.checked_sub(1).ok_or("more entries than a file of tensors has")?;
        if depth > MAX_DEPTH {
            return Ok(());
        }
        let join = |key: &str| if name.is_empty() { key.to_owned() } else { format!("{name}.{key}") };
        let pickle = self.pickle;
        match pickle.get(id) {
            Value::Dict(items) => {
                for &(key, value) in items {
                    match pickle.get(key) {
                        Value::Text(key) => self.collect(value, &join(key), depth + 1)?,
                        Value::Integer(key) => self.collect(value, &join(&key.to_string()), depth + 1)?,
                        _ => {}
                    }
                }
            }
            Value::List(items) | Value::Tuple(items) => {
                for (index, &item) in items.iter().enumerate() {
                    // Most lists hold plain numbers, for which no name is made.
                    if matches!(pickle.get(item), Value::Integer(_) | Value::Text(_) | Value::Other) {
                        continue;
                    }
                    self.collect(item, &join(&index.to_string()), depth + 1)?;
                }
            }
            Value::Call { function, arguments } => {
                let tensor = tensor(pickle, *function, *arguments, 0);
                if let Some((element, shape, view)) =
                    tensor.map_err(|fault| format!("tensor `{name}`: {fault}"))?
                {
                    self.tensors.push((Entry { name: name.to_owned(), shape, element }, view));
                }
            }
            _ => {}
        }
        Ok(())
    }
}

type Tensor = (Element, Vec<usize>, View);

/// The tensor that a call of one of PyTorch's functions would have made; `None` for other calls.
fn tensor(pickle: &Pickle, function: Id, arguments: Id, depth: usize) -> Result<Option<Tensor>, String> {
    /// A parameter holds a tensor, and a subclass of tensor holds either.
    const MAX_WRAPS: usize = 3;
    let arguments = pickle.items(arguments).unwrap_or_default();
    let inner = |function: Id, arguments: Id| {
        if depth < MAX_WRAPS { tensor(pickle, function, arguments, depth + 1) } else { Ok(None) }
    };
    match (pickle.global(function), arguments) {
        (Some(("torch._utils", "_rebuild_parameter" | "_rebuild_parameter_with_state")), [data, ..]) => {
            match *pickle.get(*data) {
                Value::Call { function, arguments } => inner(function, arguments),
                _ => Err("a parameter without a tensor".into()),
            }
        }
        (Some(("torch._tensor", "_rebuild_from_type_v2")), [function, _, arguments, ..]) => {
            inner(*function, *arguments)
        }
        (
            Some(("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2")),
            [storage, offset, shape, strides, ..],
        ) => view(pickle, *storage, *offset, *shape, *strides).map(Some),
        (Some(("torch._utils", name)), _) if name.starts_with("_rebuild_") => {
            Err(format!("made by {name}, expected a dense tensor"))
        }
        _ => Ok(None),
    }
}

/// Reads the arguments of `_rebuild_tensor_v2` and checks that the view lies within its storage.
fn view(pickle: &Pickle, storage: Id, offset: Id, shape: Id, strides: Id) -> Result<Tensor, String> {
    let sizes =
        |id: Id| -> Option<Vec<usize>> { pickle.items(id)?.iter().map(|&item| pickle.size(item)).collect() };
    let (Some(offset), Some(shape), Some(strides)) = (pickle.size(offset), sizes(shape), sizes(strides))
    else {
        return Err("offset, shape or strides are not whole numbers of at least 0".into());
    };
    if shape.len() != strides.len() || shape.len() > MAX_DIMENSIONS {
        return Err(format!(
            "{} extents and {} strides, expected as many and at most {MAX_DIMENSIONS}",
            shape.len(),
            strides.len()
        ));
    }
    let (element, key, length) = persistent(pickle, storage)?;
    let count = element_count(&shape)?;
    let extent = shape.iter().zip(&strides).try_fold(offset, |extent, (&size, &stride)| {
        extent.checked_add(size.saturating_sub(1).checked_mul(stride)?)
    });
    let fits = count == 0 || extent.is_some_and(|last| last < length);
    if !fits {
        return Err(format!(
            "shape {shape:?} with strides {strides:?} from element {offset} reaches beyond its storage of {length} elements"
        ));
    }
    Ok((element, shape, View { storage: key, offset, strides, length }))
}

/// Reads `('storage', torch.FloatStorage, key, device, elements)`.
fn persistent(pickle: &Pickle, storage: Id) -> Result<(Element, String, usize), String> {
    let Value::Persistent(reference) = *pickle.get(storage) else { return Err("no storage".into()) };
    let Some([kind, class, key, _, length, ..]) = pickle.items(reference) else {
        return Err("a storage of an unknown form".into());
    };
    let (Some("storage"), Some(key), Some(length)) =
        (pickle.text(*kind), pickle.text(*key), pickle.size(*length))
    else {
        return Err("a storage of an unknown form".into());
    };
    let class = pickle.global(*class).map_or("?", |(_, name)| name);
    let element = match class {
        "DoubleStorage" => Element::F64,
        "FloatStorage" => Element::F32,
        "HalfStorage" => Element::F16,
        "BFloat16Storage" => Element::BF16,
        "LongStorage" => Element::I64,
        "IntStorage" => Element::I32,
        "ShortStorage" => Element::I16,
        "CharStorage" => Element::I8,
        "ByteStorage" => Element::U8,
        "BoolStorage" => Element::Bool,
        _ => Element::Other(class.to_owned()),
    };
    Ok((element, key.to_owned(), length))
}

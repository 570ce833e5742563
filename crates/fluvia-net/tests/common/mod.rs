//! What the tests of weight files share: the network of the fixtures, and writers of files with faults.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]
#![allow(dead_code, reason = "each test file takes what it needs")]

use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};

use fluvia_net::config::{Config, Integration};
use fluvia_net::weights::{Convolution, Dense, Layer, Weights};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A file of fixtures/weights, which fixtures/make_weights.py writes.
pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/weights").join(name)
}

/// A file of the reference folder, or a printed reason why it is not there.
pub fn reference(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("FLUVIA_REFERENCE").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference"),
        PathBuf::from,
    );
    let path = folder.join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there (set FLUVIA_REFERENCE to the reference folder)", path.display());
    None
}

/// The network of the fixtures, made by the same formula.
pub fn network(outputs: usize) -> Weights {
    const FILTER: [usize; 3] = [2, 3, 4];
    let integration = if outputs == 6 { Integration::Velocity } else { Integration::Paper };
    // Places of the tensors in the list of the script.
    let convolution = |place: usize, inputs: usize, outputs: usize| Convolution {
        inputs,
        outputs,
        kernel: (0..24 * inputs * outputs).map(|k| value(place, k)).collect(),
        bias: (0..outputs).map(|k| value(place + 1, k)).collect(),
    };
    let dense = |place: usize, inputs: usize, outputs: usize| Dense {
        inputs,
        outputs,
        // The formula counts in PyTorch's layout, [out, in].
        weight: (0..inputs * outputs).map(|k| value(place, k % outputs * inputs + k / outputs)).collect(),
        bias: (0..outputs).map(|k| value(place + 1, k)).collect(),
    };
    Weights {
        config: Config { filter_size: FILTER, integration, ..Config::default() },
        obstacle: convolution(0, 3, 2),
        fluid: convolution(2, 4, 3),
        fluid_dense: Some(dense(8, 4, 1)),
        layers: vec![
            Layer { convolution: convolution(4, 6, 2), dense: Some(dense(10, 6, 2)) },
            Layer { convolution: convolution(6, 2, outputs), dense: Some(dense(12, 2, outputs)) },
        ],
        training: None,
    }
}

fn value(place: usize, k: usize) -> f32 {
    ((7 * k + 13 * place) % 61) as f32 / 32.0 - 30.0 / 32.0
}

/// Members of a zip archive, uncompressed.
pub fn stored() -> SimpleFileOptions {
    SimpleFileOptions::default().compression_method(CompressionMethod::Stored)
}

/// Members of a zip archive, compressed.
pub fn deflated() -> SimpleFileOptions {
    SimpleFileOptions::default().compression_method(CompressionMethod::Deflated)
}

/// A zip archive.
pub struct Archived {
    pub members: Vec<(String, Vec<u8>)>,
    pub options: SimpleFileOptions,
}

impl Archived {
    pub fn bytes(&self) -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, content) in &self.members {
            zip.start_file(name.as_str(), self.options).unwrap();
            zip.write_all(content).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }
}

/// What a PyTorch file says of a tensor, true or not.
pub struct View {
    name: String,
    storage: String,
    elements: usize,
    offset: usize,
    shape: Vec<usize>,
    strides: Vec<usize>,
}

pub fn view(
    name: &str,
    storage: &str,
    elements: usize,
    offset: usize,
    shape: &[usize],
    strides: &[usize],
) -> View {
    let (name, storage) = (name.to_owned(), storage.to_owned());
    View { name, storage, elements, offset, shape: shape.to_vec(), strides: strides.to_vec() }
}

/// The bytes of a storage.
pub fn list(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// A PyTorch file with a dictionary of these tensors.
pub fn pt(views: &[View], storages: &[(&str, Vec<u8>)], options: SimpleFileOptions) -> Vec<u8> {
    let mut pickle = b"\x80\x02}(".to_vec();
    for view in views {
        text(&mut pickle, &view.name);
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut pickle, "storage");
        pickle.extend(b"ctorch\nFloatStorage\n");
        text(&mut pickle, &view.storage);
        text(&mut pickle, "cpu");
        integer(&mut pickle, view.elements);
        pickle.extend(b"tQ");
        integer(&mut pickle, view.offset);
        for numbers in [&view.shape, &view.strides] {
            pickle.push(b'(');
            numbers.iter().for_each(|&number| integer(&mut pickle, number));
            pickle.push(b't');
        }
        pickle.extend(b"\x89ccollections\nOrderedDict\n)RtR");
    }
    pickle.extend(b"u.");
    let mut members = vec![("archive/data.pkl".to_owned(), pickle)];
    members.extend(storages.iter().map(|(key, bytes)| (format!("archive/data/{key}"), bytes.clone())));
    Archived { members, options }.bytes()
}

fn text(pickle: &mut Vec<u8>, text: &str) {
    pickle.push(b'X');
    pickle.extend((text.len() as u32).to_le_bytes());
    pickle.extend(text.as_bytes());
}

fn integer(pickle: &mut Vec<u8>, number: usize) {
    pickle.extend([0x8a, 8]);
    pickle.extend((number as i64).to_le_bytes());
}

/// The header of a safetensors file.
pub fn header(bytes: &[u8]) -> &str {
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    std::str::from_utf8(&bytes[8..8 + length]).unwrap()
}

/// A safetensors file with the first `from` of its header replaced.
pub fn replace_in_header(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let old = header(bytes);
    assert!(old.contains(from), "`{from}` is not in {old}");
    let new = old.replacen(from, to, 1);
    [&(new.len() as u64).to_le_bytes()[..], new.as_bytes(), &bytes[8 + old.len()..]].concat()
}

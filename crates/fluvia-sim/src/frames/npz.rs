//! NumPy archives: a zip of `NAME.npy` members, each a header (type, order, shape) and the numbers.
//!
//! `pos` (N, 3), `vel` (N, 3), `normals` (N, 3), `id` (N), `body` (N); float32 or float64, C or Fortran order, stored
//! or deflated. Written: float32 and uint32, stored, with a fixed time stamp, so that equal frames are equal bytes.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Read, Write};
use std::path::Path;

use zip::read::ZipFile;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

use super::Rows;
use super::columns::{Columns, Quantity};
use super::numbers::{ByteOrder, Parsed, Scalar, numpy_type, shown};
use crate::{Error, Result};

/// An array: its shape, and its numbers in C order (the last index runs fastest).
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// The length of every axis; empty for a single number.
    pub shape: Vec<usize>,
    /// Every float32 and every integer below 2^53 is exact.
    pub values: Vec<f64>,
}

/// Reads all arrays of numbers in an archive, by name; text and other types are skipped.
///
/// # Errors
/// `Io`; `File` if the archive is damaged.
pub fn read_arrays(path: &Path) -> Result<BTreeMap<String, Array>> {
    let bytes = std::fs::read(path).map_err(Error::io(path))?;
    parse_arrays(&bytes).map_err(|message| Error::file(path, message))
}

/// An array to be written; its shape is (N) or (N, width).
pub(super) enum Values<'a> {
    F32(&'a [f32]),
    F64(&'a [f64]),
    U32(&'a [u32]),
    U64(&'a [u64]),
}

/// Writes arrays with their names and shapes.
pub(super) fn write_arrays<'a>(
    arrays: impl IntoIterator<Item = (String, Vec<usize>, Values<'a>)>,
    out: &mut dyn Write,
) -> io::Result<()> {
    // A zip is written with seeks, which `out` does not promise; a frame fits in memory.
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::DEFAULT);
    for (name, shape, values) in arrays {
        let large = shape.iter().product::<usize>() >= LARGE_MEMBER;
        archive.start_file(format!("{name}.npy"), options.large_file(large))?;
        let (kind, bytes): (_, Vec<u8>) = match values {
            Values::F32(values) => ("<f4", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            Values::F64(values) => ("<f8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            Values::U32(values) => ("<u4", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
            Values::U64(values) => ("<u8", values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        };
        archive.write_all(&header(kind, &shape))?;
        archive.write_all(&bytes)?;
    }
    out.write_all(archive.finish()?.get_ref())
}

pub(super) fn write(rows: Rows<'_>, out: &mut dyn Write) -> io::Result<()> {
    let vectors = [("pos", Some(rows.position)), ("vel", rows.velocity), ("normals", rows.normal)];
    let vectors = vectors.into_iter().filter_map(|(name, values)| {
        values.map(|values| (name.to_owned(), vec![rows.len(), 3], Values::F32(values.as_flattened())))
    });
    let integers =
        rows.integers().map(|(name, values)| (name.to_owned(), vec![rows.len()], Values::U32(values)));
    write_arrays(vectors.chain(integers), out)
}

pub(super) fn parse(bytes: &[u8]) -> Parsed<Columns> {
    const ARRAYS: [(&str, Quantity); 5] = [
        ("pos", Quantity::Position),
        ("vel", Quantity::Velocity),
        ("normals", Quantity::Normal),
        ("id", Quantity::Id),
        ("body", Quantity::Body),
    ];
    let mut archive = open(bytes)?;
    let mut columns = Columns::default();
    for (name, quantity) in ARRAYS {
        let Some(index) = archive.index_for_name(&format!("{name}.npy")) else { continue };
        let mut member = member(&mut archive, index, name)?;
        let header = Header::read(&mut member, name)?;
        let is_row = matches!(quantity, Quantity::Id | Quantity::Body);
        let width = match (header.shape.as_slice(), is_row) {
            ([_, 3], false) => 3,
            ([_] | [_, 1], true) => 1,
            (_, row) => {
                let expected = if row { "(N,)" } else { "(N, 3)" };
                return Err(format!(
                    "array '{name}' has shape {}, expected {expected}",
                    tuple(&header.shape)
                ));
            }
        };
        match header.scalar {
            Some(scalar) if is_row || scalar.is_float() => {}
            _ => {
                let expected = if is_row { "an integer type" } else { "float32 or float64" };
                return Err(format!(
                    "array '{name}' has type '{}', expected {expected}",
                    shown(&header.kind)
                ));
            }
        }
        columns.add(quantity, name, width, header.values(&mut member, name)?.values);
    }
    if !columns.has(Quantity::Position) {
        let names: Vec<String> = archive.file_names().flatten().map(|name| shown(&name)).take(8).collect();
        return Err(format!("no array 'pos' in this archive, found: {}", names.join(", ")));
    }
    Ok(columns)
}

/// All arrays of numbers.
pub(super) fn parse_arrays(bytes: &[u8]) -> Parsed<BTreeMap<String, Array>> {
    let mut archive = open(bytes)?;
    let mut arrays = BTreeMap::new();
    for index in 0..archive.len() {
        let mut member = member(&mut archive, index, "member")?;
        let name = member.name().map_err(|error| error.to_string())?.into_owned();
        let Some(name) = name.strip_suffix(".npy") else { continue };
        let header = Header::read(&mut member, name)?;
        if header.scalar.is_some() {
            arrays.insert(name.to_owned(), header.values(&mut member, name)?);
        }
    }
    Ok(arrays)
}

/// From this many values on a member may need 64-bit sizes in the zip (4 GiB at 8 bytes each, with room to spare).
const LARGE_MEMBER: usize = 500_000_000;

/// What a `.npy` file starts with, before the version.
const MAGIC: &[u8] = b"\x93NUMPY";

/// No header of an array of numbers comes near this; it bounds what a damaged length field makes us read.
const LONGEST_HEADER: usize = 1 << 16;

/// More axes than NumPy itself allows.
const MOST_AXES: usize = 64;

type Member<'a, 'b> = ZipFile<'a, Cursor<&'b [u8]>>;

fn open(bytes: &[u8]) -> Parsed<ZipArchive<Cursor<&[u8]>>> {
    let bad = |error: ZipError| {
        let reason = shown(&error.to_string());
        format!("no npz (zip archive) or a truncated one of {} bytes: {reason}", bytes.len())
    };
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(bad)?;
    // Otherwise the arrays could be many times the size of the file.
    match archive.has_overlapping_files().map_err(bad)? {
        true => Err("damaged: members of this archive share their bytes".into()),
        false => Ok(archive),
    }
}

fn member<'a, 'b>(
    archive: &'a mut ZipArchive<Cursor<&'b [u8]>>,
    index: usize,
    name: &str,
) -> Parsed<Member<'a, 'b>> {
    archive.by_index(index).map_err(|error| format!("array '{}': {}", shown(name), shown(&error.to_string())))
}

/// What stands before the numbers of an array.
struct Header {
    kind: String,
    /// `None` for types that are not numbers.
    scalar: Option<Scalar>,
    order: ByteOrder,
    fortran: bool,
    shape: Vec<usize>,
}

impl Header {
    fn read(member: &mut impl Read, name: &str) -> Parsed<Header> {
        let name = shown(name);
        let mut take = |count: usize| {
            let mut bytes = vec![0; count];
            match member.read_exact(&mut bytes) {
                Ok(()) => Ok(bytes),
                Err(error) => Err(format!("array '{name}': the header cannot be read: {error}")),
            }
        };
        let start = take(MAGIC.len() + 2)?;
        if !start.starts_with(MAGIC) {
            return Err(format!("array '{name}' is not in the npy format"));
        }
        let length = match start[MAGIC.len()] {
            1 => {
                let bytes = take(2)?;
                usize::from(u16::from_le_bytes([bytes[0], bytes[1]]))
            }
            2 | 3 => {
                let bytes = take(4)?;
                u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as usize
            }
            version => return Err(format!("array '{name}': npy version {version}, expected 1, 2 or 3")),
        };
        if length > LONGEST_HEADER {
            return Err(format!(
                "array '{name}': header of {length} bytes, expected at most {LONGEST_HEADER}"
            ));
        }
        let text = String::from_utf8_lossy(&take(length)?).into_owned();
        Header::parse(&text).ok_or_else(|| {
            format!("array '{name}': header '{}', expected descr, fortran_order, shape", shown(&text))
        })
    }

    /// Reads the Python dictionary `{'descr': '<f4', 'fortran_order': False, 'shape': (7, 3), }`.
    fn parse(text: &str) -> Option<Header> {
        let value = |key: &str| {
            let quoted = [format!("'{key}'"), format!("\"{key}\"")];
            let after = quoted.iter().find_map(|key| text.split_once(key.as_str()))?.1;
            Some(after.trim_start().strip_prefix(':')?.trim_start())
        };
        let descr = value("descr")?;
        // Structured types have a list here: their kind stays empty, which is no number.
        let kind = descr
            .strip_prefix(['\'', '"'])
            .and_then(|rest| rest.split_once(['\'', '"']))
            .map_or("", |(kind, _)| kind);
        let fortran = value("fortran_order")?;
        let fortran = match (fortran.starts_with("True"), fortran.starts_with("False")) {
            (false, false) => return None,
            (fortran, _) => fortran,
        };
        let axes = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let axes = axes.split(',').map(str::trim).filter(|axis| !axis.is_empty());
        let shape: Vec<usize> =
            axes.map(|axis| axis.trim_end_matches('L').parse().ok()).collect::<Option<_>>()?;
        let (order, scalar) = numpy_type(kind);
        (shape.len() <= MOST_AXES).then(|| Header { kind: kind.to_owned(), scalar, order, fortran, shape })
    }

    /// Reads the numbers that follow the header, in C order.
    fn values(self, member: &mut impl Read, name: &str) -> Parsed<Array> {
        let Some(scalar) = self.scalar else {
            return Err(format!(
                "array '{}' has type '{}', expected numbers",
                shown(name),
                shown(&self.kind)
            ));
        };
        let claim = self.shape.iter().try_fold(scalar.size(), |bytes, &axis| bytes.checked_mul(axis));
        let Some(expected) = claim else {
            return Err(format!("array '{}' claims shape {}, too large", shown(name), tuple(&self.shape)));
        };
        // Read as much as there is, one byte too many at most; the end of the member is where its checksum is
        // compared.
        let mut bytes = Vec::new();
        let read = member.take((expected as u64).saturating_add(1)).read_to_end(&mut bytes);
        if let Err(error) = read {
            return Err(format!("array '{}' is damaged: {error}", shown(name)));
        }
        if bytes.len() != expected {
            let found = if bytes.len() > expected { "more".to_owned() } else { bytes.len().to_string() };
            return Err(format!(
                "array '{}' of shape {} needs {expected} bytes, found {found}",
                shown(name),
                tuple(&self.shape)
            ));
        }
        let mut values = scalar.decode_all(self.order, &bytes);
        if self.fortran && self.shape.len() > 1 {
            values = in_c_order(&values, &self.shape);
        }
        Ok(Array { shape: self.shape, values })
    }
}

/// Turns numbers whose first index runs fastest into numbers whose last one does.
fn in_c_order(values: &[f64], shape: &[usize]) -> Vec<f64> {
    let mut index = vec![0; shape.len()];
    let mut strides = vec![1; shape.len()];
    for axis in 1..shape.len() {
        strides[axis] = strides[axis - 1] * shape[axis - 1];
    }
    let mut position = 0;
    let mut next = |_| {
        let value = values[position];
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            position += strides[axis];
            if index[axis] < shape[axis] {
                break;
            }
            position -= strides[axis] * shape[axis];
            index[axis] = 0;
        }
        value
    };
    (0..values.len()).map(&mut next).collect()
}

fn header(kind: &str, shape: &[usize]) -> Vec<u8> {
    /// NumPy aligns the numbers to this many bytes.
    const ALIGNMENT: usize = 64;
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {}, }}", tuple(shape));
    let start = MAGIC.len() + 4;
    let padded = (start + text.len() + 1).next_multiple_of(ALIGNMENT) - start;
    text.extend(std::iter::repeat_n(' ', padded - text.len() - 1));
    text.push('\n');
    let length = u16::try_from(text.len()).expect("the header of a few axes is short");
    [MAGIC, &[1, 0], &length.to_le_bytes(), text.as_bytes()].concat()
}

/// A shape as Python writes it.
fn tuple(shape: &[usize]) -> String {
    match shape {
        [length] => format!("({length},)"),
        _ => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_in_the_forms_that_are_met() {
        let header =
            Header::parse("{'descr': '>f8', 'fortran_order': True, 'shape': (2, 3), }   \n").unwrap();
        assert_eq!((header.scalar, header.order, header.fortran), (Some(Scalar::F64), ByteOrder::Big, true));
        assert_eq!(header.shape, [2, 3]);
        let header = Header::parse("{\"shape\":(5L,),\"fortran_order\":False,\"descr\":\"|u1\"}").unwrap();
        assert_eq!((header.scalar, header.shape.as_slice()), (Some(Scalar::U8), &[5][..]));
        let scalar = Header::parse("{'descr': '<U8', 'fortran_order': False, 'shape': ()}").unwrap();
        assert_eq!((scalar.scalar, scalar.shape.len()), (None, 0));
        for bad in ["", "{}", "{'descr': '<f4', 'fortran_order': 1, 'shape': (1,)}", "{'descr': '<f4'}"] {
            assert!(Header::parse(bad).is_none(), "{bad}");
        }
    }

    #[test]
    fn fortran_order_of_three_axes() {
        // The value is its index (i, j, k) as digits.
        let shape = [2, 3, 4];
        let mut fortran = Vec::new();
        for k in 0..4 {
            for j in 0..3 {
                fortran.extend((0..2).map(|i| f64::from(i * 100 + j * 10 + k)));
            }
        }
        let c = in_c_order(&fortran, &shape);
        let expected: Vec<f64> = (0..24).map(|n| f64::from(n / 12 * 100 + n / 4 % 3 * 10 + n % 4)).collect();
        assert_eq!(c, expected);
    }
}

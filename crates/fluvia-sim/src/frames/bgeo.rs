//! Houdini classic geometry (version 5), as partio and SPlisHSPlasH read and write it; all numbers big endian.
//!
//! ```text
//! "Bgeo" "V" i32 5, i32 points, prims, point groups, prim groups, point attributes, vertex, prim, detail attributes
//! a point attribute: u16 length, name, u16 size, i32 type, defaults (size x 4 bytes)
//! a point: x y z w, then the values of each attribute in turn (size x 4 bytes)
//! ```
//!
//! Type 0 is float, 1 integer, 4 an index into strings (listed in place of defaults), 5 a vector of floats. The file
//! may be gzip-compressed. What is read is sorted by `id`, as the published reader does.

use std::io::{self, Read, Write};

use flate2::read::GzDecoder;

use super::Rows;
use super::columns::{Columns, Quantity};
use super::numbers::{ByteOrder, Parsed, Scalar, shown};

pub(super) fn parse(bytes: &[u8]) -> Parsed<Columns> {
    if !bytes.starts_with(GZIP) {
        return parse_stream(&mut Stream { source: bytes, read: 0 });
    }
    let mut stream = Stream { source: GzDecoder::new(bytes), read: 0 };
    let columns = parse_stream(&mut stream)?;
    // The checksum is at the end. What follows the points of a particle file is short, so reading as much again
    // reaches it, and a damaged file cannot make this last long.
    let rest = stream.read + GZIP_REST;
    io::copy(&mut stream.source.take(rest), &mut io::sink())
        .map_err(|error| format!("gzip data: {error}"))?;
    Ok(columns)
}

pub(super) fn write(rows: Rows<'_>, out: &mut dyn Write) -> io::Result<()> {
    let vectors = [("velocity", rows.velocity), ("N", rows.normal)];
    let vectors: Vec<_> =
        vectors.into_iter().filter_map(|(name, values)| values.map(|values| (name, values))).collect();
    let integers: Vec<_> = rows.integers().collect();
    let attributes = (vectors.len() + integers.len()) as u32;

    out.write_all(MAGIC)?;
    for number in [VERSION, count(rows.len())?, 0, 0, 0, attributes, 0, 0, 0] {
        out.write_all(&number.to_be_bytes())?;
    }
    let mut attribute = |name: &str, size: u16, kind: i32| {
        out.write_all(&(name.len() as u16).to_be_bytes())?;
        out.write_all(name.as_bytes())?;
        out.write_all(&size.to_be_bytes())?;
        out.write_all(&kind.to_be_bytes())?;
        out.write_all(&[0; 3 * WORD][..usize::from(size) * WORD])
    };
    for (name, _) in &vectors {
        attribute(name, 3, VECTOR)?;
    }
    for (name, _) in &integers {
        attribute(name, 1, INTEGER)?;
    }
    for (particle, [x, y, z]) in rows.position.iter().enumerate() {
        let homogeneous = [*x, *y, *z, 1.0];
        for value in homogeneous.iter().chain(vectors.iter().flat_map(|(_, values)| &values[particle])) {
            out.write_all(&value.to_be_bytes())?;
        }
        for (_, values) in &integers {
            out.write_all(&count(values[particle])?.to_be_bytes())?;
        }
    }
    out.write_all(END)
}

const GZIP: &[u8] = b"\x1f\x8b";
const MAGIC: &[u8] = b"BgeoV";
/// How the binary-JSON form of Houdini 12 and later begins.
const NEWER_MAGIC: &[u8] = b"\x7fNSJb";
const VERSION: u32 = 5;
/// What ends a file without detail attributes.
const END: &[u8] = b"\x00\xff";
const FLOAT: i32 = 0;
const INTEGER: i32 = 1;
const STRING_INDEX: i32 = 4;
const VECTOR: i32 = 5;
/// Bytes of one value of an attribute.
const WORD: usize = 4;
/// Bytes of the position of a point: x y z w.
const POSITION: usize = 4 * WORD;
/// Points are read in blocks of about this many bytes.
const BLOCK: usize = 1 << 16;
/// How far beyond the points the end of a compressed file is looked for, at least.
const GZIP_REST: u64 = 1 << 20;

/// The format counts and numbers in signed 32-bit integers.
fn count(value: impl TryInto<i32> + Copy + std::fmt::Display) -> io::Result<u32> {
    match value.try_into() {
        Ok(value) if value >= 0 => Ok(value as u32),
        _ => Err(io::Error::other(format!("bgeo holds numbers up to {}, found {value}", i32::MAX))),
    }
}

/// The bytes of the file after decompression.
struct Stream<R> {
    source: R,
    read: u64,
}

impl<R: Read> Stream<R> {
    /// The next `length` bytes, which are `what`.
    fn fill(&mut self, length: usize, what: &str) -> Parsed<Vec<u8>> {
        let mut bytes = Vec::new();
        let read = (&mut self.source).take(length as u64).read_to_end(&mut bytes);
        self.read += bytes.len() as u64;
        match read {
            Ok(found) if found == length => Ok(bytes),
            Ok(found) => Err(format!("truncated: {what} needs {length} bytes, {found} are left")),
            Err(error) => Err(format!("damaged gzip data in {what}: {error}")),
        }
    }

    fn u16(&mut self, what: &str) -> Parsed<u16> {
        let bytes = self.fill(2, what)?;
        Ok(u16::from_be_bytes([bytes[0], bytes[1]]))
    }

    fn i32(&mut self, what: &str) -> Parsed<i32> {
        let bytes = self.fill(WORD, what)?;
        Ok(i32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    fn count(&mut self, what: &str) -> Parsed<usize> {
        let count = self.i32(what)?;
        usize::try_from(count).map_err(|_| format!("{what} is {count}, expected 0 or more"))
    }

    fn text(&mut self, what: &str) -> Parsed<String> {
        let length = self.u16(what)?;
        Ok(String::from_utf8_lossy(&self.fill(usize::from(length), what)?).into_owned())
    }
}

/// An attribute that is read: where it lies in a point.
struct Wanted {
    quantity: Quantity,
    name: String,
    width: usize,
    offset: usize,
    scalar: Scalar,
    values: Vec<f64>,
}

fn parse_stream(stream: &mut Stream<impl Read>) -> Parsed<Columns> {
    let magic = stream.fill(MAGIC.len(), "the header")?;
    if magic == NEWER_MAGIC {
        return Err("the newer binary-JSON form of bgeo, expected the classic one (version 5): save it as \
                    .bhclassic in Houdini"
            .into());
    }
    if magic != MAGIC {
        return Err("no Houdini classic bgeo file: it does not begin with 'BgeoV'".into());
    }
    let version = stream.i32("the header")?;
    if version != VERSION as i32 {
        return Err(format!("bgeo version {version}, expected {VERSION}"));
    }
    let points = stream.count("the number of points")?;
    for what in ["primitives", "point groups", "primitive groups"] {
        stream.count(&format!("the number of {what}"))?;
    }
    let attributes = stream.count("the number of point attributes")?;
    for what in ["vertex", "primitive", "detail"] {
        stream.count(&format!("the number of {what} attributes"))?;
    }

    let mut wanted = vec![Wanted {
        quantity: Quantity::Position,
        name: "P".into(),
        width: 3,
        offset: 0,
        scalar: Scalar::F32,
        values: Vec::new(),
    }];
    let mut stride = POSITION;
    for _ in 0..attributes {
        stride += attribute(stream, stride, &mut wanted)?;
    }
    points_of(stream, points, stride, &mut wanted)?;

    let mut columns = Columns::default();
    for column in wanted {
        columns.add(column.quantity, &column.name, column.width, column.values);
    }
    Ok(columns)
}

/// Reads the description of an attribute that lies at `offset` in a point; returns its bytes in a point.
fn attribute(stream: &mut Stream<impl Read>, offset: usize, wanted: &mut Vec<Wanted>) -> Parsed<usize> {
    let name = stream.text("the name of an attribute")?;
    let what = format!("attribute '{}'", shown(&name));
    let width = usize::from(stream.u16(&what)?);
    let kind = stream.i32(&what)?;
    match kind {
        FLOAT | INTEGER | VECTOR => {
            stream.fill(width * WORD, &what)?;
        }
        STRING_INDEX => {
            for _ in 0..stream.count(&what)? {
                stream.text(&what)?;
            }
        }
        _ => {
            return Err(format!(
                "{what} has type {kind}, expected 0 (float), 1 (integer), 4 (index) or 5 (vector)"
            ));
        }
    }
    let scalar = if matches!(kind, FLOAT | VECTOR) { Scalar::F32 } else { Scalar::I32 };
    if let Some(quantity) = Quantity::of_attribute(&name, width).filter(|_| kind != STRING_INDEX) {
        wanted.push(Wanted { quantity, name, width, offset, scalar, values: Vec::new() });
    }
    Ok(width * WORD)
}

fn points_of(
    stream: &mut Stream<impl Read>,
    points: usize,
    stride: usize,
    wanted: &mut [Wanted],
) -> Parsed<()> {
    let block = (BLOCK / stride).max(1);
    let mut done = 0;
    while done < points {
        let count = block.min(points - done);
        let what = format!("points {done} to {} of {points}", done + count - 1);
        for point in stream.fill(count * stride, &what)?.chunks_exact(stride) {
            for column in &mut *wanted {
                let bytes = &point[column.offset..column.offset + column.width * WORD];
                column.values.extend(column.scalar.decode_all(ByteOrder::Big, bytes));
            }
        }
        done += count;
    }
    Ok(())
}

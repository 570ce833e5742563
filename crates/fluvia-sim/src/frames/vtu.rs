//! VTK XML files: the points and point data of an UnstructuredGrid (`.vtu`) or PolyData (`.vtp`), and the `.pvd`
//! index that gives ParaView the times of a run's frames.
//!
//! Arrays are read in every form of [`data`](super::vtu_data). Written: inline base64, little endian, UInt64 counts,
//! one vertex cell a particle.

use std::io::{self, Write};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use super::Rows;
use super::columns::{Columns, Quantity};
use super::numbers::{ByteOrder, Cursor, Parsed, Scalar, shown};
use super::vtu_data::{Appended, Encoding, Source};

pub(super) fn parse(bytes: &[u8]) -> Parsed<Columns> {
    // What is appended may be raw bytes, so the XML that is parsed ends before it.
    let (text, appended) = match find(bytes, b"<AppendedData") {
        Some(start) => (&bytes[..start], Some(Appended::read(&bytes[start..])?)),
        None => (bytes, None),
    };
    let text = String::from_utf8_lossy(text);
    let text = text.trim_start_matches('\u{feff}');
    let mut parser = Parser { complete: appended.is_some(), appended, ..Parser::default() };
    let mut reader = Reader::from_str(text);
    loop {
        let event = reader.read_event().map_err(|error| {
            let before = text.bytes().take(reader.error_position() as usize);
            let line = 1 + before.filter(|&byte| byte == b'\n').count();
            format!("line {line}: truncated or no XML: {}", shown(&error.to_string()))
        })?;
        match event {
            Event::Start(tag) => parser.start(&tag)?,
            Event::Empty(tag) => {
                parser.start(&tag)?;
                parser.end(tag.name().as_ref())?;
            }
            Event::End(tag) => parser.end(tag.name().as_ref())?,
            Event::Text(content) => {
                if let Some(array) = parser.array.as_mut().filter(|_| parser.inner == 0) {
                    array.text.push_str(&content);
                }
            }
            Event::Eof => break,
            _ => {}
        }
    }
    match parser.complete {
        true => Ok(parser.columns),
        false => Err("no VTK XML file or a truncated one: it ends before </VTKFile>".into()),
    }
}

pub(super) fn write(rows: Rows<'_>, out: &mut dyn Write) -> io::Result<()> {
    let count = rows.len();
    let Ok(cells) = i32::try_from(count) else {
        return Err(io::Error::other(format!("vtu holds {} particles, found {count}", i32::MAX)));
    };
    let active = match (rows.velocity, rows.normal) {
        (Some(_), _) => " Vectors=\"velocity\"",
        (None, Some(_)) => " Normals=\"normals\"",
        (None, None) => "",
    };
    write!(
        out,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n\
         <UnstructuredGrid>\n<Piece NumberOfPoints=\"{count}\" NumberOfCells=\"{count}\">\n<PointData{active}>\n"
    )?;
    for (name, values) in [("velocity", rows.velocity), ("normals", rows.normal)] {
        if let Some(values) = values {
            write_array(name, "Float32", 3, values.as_flattened().iter().flat_map(|v| v.to_le_bytes()), out)?;
        }
    }
    for (name, values) in rows.integers() {
        write_array(name, "UInt32", 1, values.iter().flat_map(|v| v.to_le_bytes()), out)?;
    }
    out.write_all(b"</PointData>\n<CellData>\n</CellData>\n<Points>\n")?;
    let positions = rows.position.as_flattened().iter().flat_map(|v| v.to_le_bytes());
    write_array("points", "Float32", 3, positions, out)?;
    out.write_all(b"</Points>\n<Cells>\n")?;
    write_array("connectivity", "Int32", 1, (0..cells).flat_map(i32::to_le_bytes), out)?;
    write_array("offsets", "Int32", 1, (0..cells).flat_map(|cell| (cell + 1).to_le_bytes()), out)?;
    write_array("types", "UInt8", 1, std::iter::repeat_n(VERTEX_CELL, count), out)?;
    out.write_all(b"</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")
}

/// Writes an index of frames: their times in seconds and their file names.
pub(super) fn write_index(
    frames: impl Iterator<Item = (f64, String)>,
    out: &mut dyn Write,
) -> io::Result<()> {
    out.write_all(
        b"<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\" byte_order=\"LittleEndian\">\n\
          <Collection>\n",
    )?;
    for (time, file) in frames {
        writeln!(out, "<DataSet timestep=\"{time}\" part=\"0\" file=\"{file}\"/>")?;
    }
    out.write_all(b"</Collection>\n</VTKFile>\n")
}

/// The number of VTK_VERTEX.
const VERTEX_CELL: u8 = 1;

/// Writes an array with its count of bytes before it, in base64: unlike raw bytes that keeps the file XML.
fn write_array(
    name: &str,
    kind: &str,
    width: usize,
    bytes: impl Iterator<Item = u8>,
    out: &mut dyn Write,
) -> io::Result<()> {
    const COUNT: usize = size_of::<u64>();
    let mut data = vec![0; COUNT];
    data.extend(bytes);
    let length = (data.len() - COUNT) as u64;
    data[..COUNT].copy_from_slice(&length.to_le_bytes());
    write!(
        out,
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{width}\" format=\"binary\">\n{}\n</DataArray>\n",
        STANDARD.encode(data)
    )
}

/// The part of a piece that the present element is in.
#[derive(Clone, Copy, Default, PartialEq)]
enum Section {
    #[default]
    Other,
    Points,
    PointData,
}

/// The array of the present element, if it is wanted.
struct Wanted {
    quantity: Quantity,
    name: String,
    width: usize,
    scalar: Scalar,
    format: String,
    offset: usize,
    text: String,
}

#[derive(Default)]
struct Parser {
    appended: Option<Appended>,
    /// How much of the appended data has been read.
    used: usize,
    encoding: Encoding,
    has_root: bool,
    complete: bool,
    section: Section,
    /// Points of the present piece.
    points: usize,
    array: Option<Wanted>,
    /// How many elements within that of the array are open; ParaView keeps ranges there.
    inner: usize,
    piece: Columns,
    columns: Columns,
}

impl Parser {
    fn start(&mut self, tag: &BytesStart<'_>) -> Parsed<()> {
        if self.array.is_some() {
            self.inner += 1;
            return Ok(());
        }
        match tag.name().as_ref() {
            "VTKFile" => {
                self.has_root = true;
                self.encoding = encoding(tag)?;
            }
            other if !self.has_root => {
                return Err(format!("no VTK XML file: <{}>, expected <VTKFile>", shown(other)));
            }
            "Piece" => {
                let count = attribute(tag, "NumberOfPoints")?.unwrap_or_default();
                self.points = count
                    .trim()
                    .parse()
                    .map_err(|_| format!("NumberOfPoints is '{}', expected a count", shown(&count)))?;
            }
            "Points" => self.section = Section::Points,
            "PointData" => self.section = Section::PointData,
            "DataArray" => self.array = self.wanted(tag)?,
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self, name: &str) -> Parsed<()> {
        if self.inner > 0 {
            self.inner -= 1;
            return Ok(());
        }
        match name {
            "VTKFile" => self.complete = true,
            "Points" | "PointData" => self.section = Section::Other,
            "Piece" => self.columns.append(std::mem::take(&mut self.piece)),
            "DataArray" => {
                if let Some(array) = self.array.take() {
                    let values = self
                        .values(&array)
                        .map_err(|message| format!("array '{}': {message}", shown(&array.name)))?;
                    self.piece.add(array.quantity, &array.name, array.width, values);
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn wanted(&self, tag: &BytesStart<'_>) -> Parsed<Option<Wanted>> {
        let name = attribute(tag, "Name")?.unwrap_or_default();
        let width = attribute(tag, "NumberOfComponents")?;
        let width = match width.as_deref().map(str::trim) {
            None => 1,
            Some(width) => width.parse().map_err(|_| format!("array '{}' has no width", shown(&name)))?,
        };
        let quantity = match self.section {
            Section::Other => None,
            Section::Points => Some(Quantity::Position),
            Section::PointData => Quantity::of_attribute(&name, width),
        };
        let Some(quantity) = quantity.filter(|&quantity| !self.piece.has(quantity)) else { return Ok(None) };
        let kind = attribute(tag, "type")?.unwrap_or_default();
        let scalar = match kind.as_str() {
            "Int8" => Scalar::I8,
            "UInt8" => Scalar::U8,
            "Int16" => Scalar::I16,
            "UInt16" => Scalar::U16,
            "Int32" => Scalar::I32,
            "UInt32" => Scalar::U32,
            "Int64" => Scalar::I64,
            "UInt64" => Scalar::U64,
            "Float32" => Scalar::F32,
            "Float64" => Scalar::F64,
            _ => {
                return Err(format!(
                    "array '{}' has type '{}', expected a number",
                    shown(&name),
                    shown(&kind)
                ));
            }
        };
        let format = attribute(tag, "format")?.unwrap_or_else(|| "ascii".into());
        let offset = attribute(tag, "offset")?.unwrap_or_default();
        let offset = offset.trim().parse().unwrap_or(0);
        let name = if name.is_empty() { "points".into() } else { name };
        Ok(Some(Wanted { quantity, name, width, scalar, format, offset, text: String::new() }))
    }

    fn values(&mut self, array: &Wanted) -> Parsed<Vec<f64>> {
        let Some(total) = self.points.checked_mul(array.width) else {
            return Err(format!("{} points of {} values claimed", self.points, array.width));
        };
        let source = match (array.format.as_str(), &self.appended) {
            ("ascii", _) => return numbers(&array.text, total),
            ("binary", _) => Source::inline(&array.text),
            ("appended", Some(appended)) => appended.source(array.offset)?,
            ("appended", None) => return Err("its data is appended, and the file has none".into()),
            (other, _) => {
                return Err(format!("format '{}', expected ascii, binary or appended", shown(other)));
            }
        };
        let Some(expected) = total.checked_mul(array.scalar.size()) else {
            return Err(format!("{total} values claimed"));
        };
        let (bytes, used) = source.decode(&self.encoding, expected)?;
        if let ("appended", Some(appended)) = (array.format.as_str(), &self.appended) {
            // Arrays that share their data could be many times the size of the file.
            self.used += used;
            if self.used > appended.len() {
                return Err("its data overlaps that of another array".into());
            }
        }
        Ok(array.scalar.decode_all(self.encoding.order, &bytes))
    }
}

/// How the arrays of a file are encoded, from its root element.
fn encoding(tag: &BytesStart<'_>) -> Parsed<Encoding> {
    match attribute(tag, "type")?.as_deref() {
        Some("UnstructuredGrid" | "PolyData") => {}
        Some("Collection") => {
            return Err("an index of frames (.pvd), expected one of the files that it lists".into());
        }
        other => {
            let found = shown(other.unwrap_or_default());
            return Err(format!("VTK file of type '{found}', expected UnstructuredGrid or PolyData"));
        }
    }
    let order = match attribute(tag, "byte_order")?.as_deref() {
        Some("BigEndian") => ByteOrder::Big,
        _ => ByteOrder::Little,
    };
    let counts = match attribute(tag, "header_type")?.as_deref() {
        Some("UInt64") => Scalar::U64,
        _ => Scalar::U32,
    };
    let compressed = match attribute(tag, "compressor")?.as_deref() {
        None | Some("") => false,
        Some("vtkZLibDataCompressor") => true,
        Some(other) => {
            return Err(format!("compressor '{}', expected none or vtkZLibDataCompressor", shown(other)));
        }
    };
    Ok(Encoding { order, counts, compressed })
}

fn attribute(tag: &BytesStart<'_>, name: &str) -> Parsed<Option<String>> {
    let bad = |error: &dyn std::fmt::Display| format!("attribute '{name}': {}", shown(&error.to_string()));
    let Some(attribute) = tag.try_get_attribute(name).map_err(|error| bad(&error))? else { return Ok(None) };
    let value = attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|error| bad(&error))?;
    Ok(Some(value.into_owned()))
}

fn numbers(text: &str, total: usize) -> Parsed<Vec<f64>> {
    let mut cursor = Cursor::new(text.as_bytes());
    let mut values = Vec::new();
    while let Some(word) = cursor.word() {
        let value = word.parse().map_err(|_| format!("'{}', expected a number", shown(word)))?;
        values.push(value);
    }
    match values.len() == total {
        true => Ok(values),
        false => Err(format!("{} numbers, expected {total}", values.len())),
    }
}

fn find(bytes: &[u8], needle: &[u8]) -> Option<usize> {
    bytes.windows(needle.len()).position(|window| window == needle)
}

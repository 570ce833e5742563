//! PLY point clouds: the points of element `vertex`, in ASCII and in both binary byte orders.
//!
//! Properties `x y z`, `vx vy vz` (velocity), `nx ny nz` (normal), `id` and `body`, of any number type; other
//! properties and elements are skipped. Written: binary little endian, float and uint.

use std::io::{self, Write};

use super::Rows;
use super::columns::{Columns, Quantity};
use super::numbers::{ByteOrder, Cursor, Parsed, Scalar, shown};

pub(super) fn parse(bytes: &[u8]) -> Parsed<Columns> {
    let mut cursor = Cursor::new(bytes);
    let header = Header::read(&mut cursor)?;
    for element in &header.elements {
        if element.name == "vertex" {
            return points(&mut cursor, header.encoding, element);
        }
        skip(&mut cursor, header.encoding, element)?;
    }
    Err("no element 'vertex' in the header".into())
}

pub(super) fn write(rows: Rows<'_>, out: &mut dyn Write) -> io::Result<()> {
    write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}\n", rows.len())?;
    let vectors = [("", Some(rows.position)), ("v", rows.velocity), ("n", rows.normal)];
    let vectors: Vec<_> =
        vectors.into_iter().filter_map(|(prefix, values)| values.map(|values| (prefix, values))).collect();
    let integers: Vec<_> = rows.integers().collect();
    for (prefix, _) in &vectors {
        for axis in ["x", "y", "z"] {
            writeln!(out, "property float {prefix}{axis}")?;
        }
    }
    for (name, _) in &integers {
        writeln!(out, "property uint {name}")?;
    }
    out.write_all(b"end_header\n")?;
    for particle in 0..rows.len() {
        for (_, values) in &vectors {
            for value in values[particle] {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        for (_, values) in &integers {
            out.write_all(&values[particle].to_le_bytes())?;
        }
    }
    Ok(())
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Ascii,
    Binary(ByteOrder),
}

/// The type of a property.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Number(Scalar),
    /// A count of the first type, then as many numbers of the second.
    List(Scalar, Scalar),
}

#[derive(Debug)]
struct Element {
    name: String,
    count: usize,
    properties: Vec<(String, Kind)>,
}

impl Element {
    /// The bytes of one row in a binary file; `None` if there are lists, whose length varies.
    fn row_size(&self) -> Option<usize> {
        let sizes = self.properties.iter().map(|(_, kind)| match kind {
            Kind::Number(scalar) => Some(scalar.size()),
            Kind::List(..) => None,
        });
        sizes.sum()
    }
}

struct Header {
    encoding: Encoding,
    elements: Vec<Element>,
}

impl Header {
    fn read(cursor: &mut Cursor<'_>) -> Parsed<Header> {
        if cursor.line() != Some(b"ply") {
            return Err("no PLY file: the first line is not 'ply'".into());
        }
        let mut encoding = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut number = 1;
        loop {
            number += 1;
            let Some(line) = cursor.line() else {
                return Err("truncated: the file ends within its header, expected 'end_header'".into());
            };
            // Comments may be in any encoding; they are not looked at.
            let line = String::from_utf8_lossy(line);
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let bad = || format!("line {number}: '{}' in the header of a PLY file", shown(&line));
            match words.as_slice() {
                [] | ["comment" | "obj_info", ..] => {}
                ["format", name, _] => {
                    encoding = Some(match *name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::Binary(ByteOrder::Little),
                        "binary_big_endian" => Encoding::Binary(ByteOrder::Big),
                        _ => return Err(bad()),
                    });
                }
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| format!("{}, expected a count", bad()))?;
                    elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
                }
                ["property", kind @ .., name] => {
                    let kind = match kind {
                        ["list", count, item] => {
                            scalar(count).zip(scalar(item)).map(|(c, i)| Kind::List(c, i))
                        }
                        [number] => scalar(number).map(Kind::Number),
                        _ => None,
                    };
                    match (kind, elements.last_mut()) {
                        (Some(kind), Some(element)) => element.properties.push(((*name).into(), kind)),
                        _ => return Err(bad()),
                    }
                }
                ["end_header"] => break,
                _ => return Err(bad()),
            }
        }
        let encoding = encoding.ok_or("no line 'format' in the header of a PLY file")?;
        Ok(Header { encoding, elements })
    }
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

/// What the properties of a vertex mean: the quantity and the names of its components.
const MEANINGS: [(Quantity, &str, &[&str]); 5] = [
    (Quantity::Position, "x y z", &["x", "y", "z"]),
    (Quantity::Velocity, "vx vy vz", &["vx", "vy", "vz"]),
    (Quantity::Normal, "nx ny nz", &["nx", "ny", "nz"]),
    (Quantity::Id, "id", &["id"]),
    (Quantity::Body, "body", &["body"]),
];

fn points(cursor: &mut Cursor<'_>, encoding: Encoding, element: &Element) -> Parsed<Columns> {
    // For every quantity that is there, the property that each of its components comes from.
    let mut found = Vec::new();
    for (quantity, label, components) in MEANINGS {
        let is = |name: &&str| {
            element.properties.iter().position(|(n, kind)| n == name && matches!(kind, Kind::Number(_)))
        };
        let properties: Vec<usize> = components.iter().filter_map(is).collect();
        if properties.len() == components.len() {
            found.push((quantity, label, properties, Vec::new()));
        } else if !properties.is_empty() || quantity == Quantity::Position {
            return Err(format!("element 'vertex' has not all of the properties {label}"));
        }
    }
    if let (Encoding::Binary(_), Some(size)) = (encoding, element.row_size()) {
        // Better than to find out at the end, and the message has the whole size.
        cursor.clone().take_numbers(element.count, size, "element 'vertex'")?;
    }
    let mut row = vec![0.0; element.properties.len()];
    for number in 0..element.count {
        for ((_, kind), value) in element.properties.iter().zip(&mut row) {
            *value = property(cursor, encoding, *kind)
                .map_err(|message| format!("{message} (vertex {number} of {})", element.count))?;
        }
        for (_, _, properties, values) in &mut found {
            values.extend(properties.iter().map(|&property| row[property]));
        }
    }
    let mut columns = Columns::default();
    for (quantity, label, properties, values) in found {
        columns.add(quantity, label, properties.len(), values);
    }
    Ok(columns)
}

/// Reads one property of one row; a list gives 0.
fn property(cursor: &mut Cursor<'_>, encoding: Encoding, kind: Kind) -> Parsed<f64> {
    let mut number = |scalar: Scalar| match encoding {
        Encoding::Ascii => cursor.number("a property"),
        Encoding::Binary(order) => Ok(scalar.decode(order, cursor.take(scalar.size(), "a property")?)),
    };
    match kind {
        Kind::Number(scalar) => number(scalar),
        Kind::List(count, item) => {
            // As a count, what is negative or no number is 0.
            let count = number(count)? as usize;
            match encoding {
                Encoding::Ascii => (0..count).try_for_each(|_| number(item).map(drop))?,
                Encoding::Binary(_) => drop(cursor.take_numbers(count, item.size(), "a list")?),
            }
            Ok(0.0)
        }
    }
}

fn skip(cursor: &mut Cursor<'_>, encoding: Encoding, element: &Element) -> Parsed<()> {
    let what = format!("element '{}'", shown(&element.name));
    match (encoding, element.row_size()) {
        // Rows of nothing take no bytes in a binary file, however many there are.
        (Encoding::Binary(_), Some(size)) => cursor.take_numbers(element.count, size, &what).map(drop),
        (Encoding::Ascii, _) if element.properties.is_empty() => Ok(()),
        _ => {
            for _ in 0..element.count {
                for (_, kind) in &element.properties {
                    property(cursor, encoding, *kind).map_err(|message| format!("{message} ({what})"))?;
                }
            }
            Ok(())
        }
    }
}

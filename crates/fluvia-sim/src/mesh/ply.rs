//! PLY: ASCII or binary of either byte order, any scalar types.
//!
//! Read are the properties x, y, z of the element `vertex` and the list `vertex_indices` (or `vertex_index`) of
//! the element `face`; everything else is skipped.

use super::polygons::Polygons;

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

enum Kind {
    Scalar(Scalar),
    List { length: Scalar, item: Scalar },
}

struct Property {
    name: String,
    kind: Kind,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Polygons, String> {
    let (encoding, elements, body) = header(bytes)?;
    let mut body = Body { encoding, rest: body };
    let mut polygons = Polygons::default();
    for element in &elements {
        // Without properties an element takes no bytes, however many there are.
        if element.properties.is_empty() {
            continue;
        }
        let names =
            |property: &&Property| ["vertex_indices", "vertex_index"].contains(&property.name.as_str());
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut body, &mut polygons)?,
            "face" if element.properties.iter().any(|p| names(&p)) => {
                read_faces(element, &mut body, &mut polygons)?;
            }
            _ => {
                for index in 0..element.count {
                    for property in &element.properties {
                        body.read(property, |_| {}).map_err(|e| at(element, index, &e))?;
                    }
                }
            }
        }
    }
    if polygons.ends.is_empty() {
        return Err(format!(
            "{} points and no faces, expected a surface (particles belong under the key `particles`)",
            polygons.positions.len()
        ));
    }
    let vertices = polygons.positions.len();
    let mut start = 0;
    for (face, &end) in polygons.ends.iter().enumerate() {
        if let Some(vertex) = polygons.corners[start..end].iter().find(|&&v| v as usize >= vertices) {
            return Err(format!("face {face}: vertex {vertex} of {vertices}, they count from 0"));
        }
        start = end;
    }
    Ok(polygons)
}

fn at(element: &Element, index: u64, message: &str) -> String {
    format!("{} {index} of {}: {message}", element.name, element.count)
}

fn read_vertices(element: &Element, body: &mut Body<'_>, polygons: &mut Polygons) -> Result<(), String> {
    let mut axes = Vec::with_capacity(element.properties.len());
    for property in &element.properties {
        let axis = ["x", "y", "z"].iter().position(|&name| name == property.name);
        axes.push(axis.filter(|_| matches!(property.kind, Kind::Scalar(_))));
    }
    if let Some(missing) = (0..3).find(|&axis| !axes.contains(&Some(axis))) {
        return Err(format!("vertices without the property `{}`", ["x", "y", "z"][missing]));
    }
    for index in 0..element.count {
        let mut position = [0.0; 3];
        for (property, axis) in element.properties.iter().zip(&axes) {
            body.read(property, |value| {
                if let Some(axis) = *axis {
                    position[axis] = value as f32;
                }
            })
            .map_err(|e| at(element, index, &e))?;
        }
        if let Some(x) = position.iter().find(|x| !x.is_finite()) {
            return Err(at(element, index, &format!("coordinate {x}, expected a finite number")));
        }
        polygons.positions.push(position);
    }
    Ok(())
}

fn read_faces(element: &Element, body: &mut Body<'_>, polygons: &mut Polygons) -> Result<(), String> {
    for index in 0..element.count {
        let start = polygons.corners.len();
        let mut bad = None;
        for property in &element.properties {
            let is_corners = ["vertex_indices", "vertex_index"].contains(&property.name.as_str());
            body.read(property, |value| {
                if !is_corners {
                } else if value >= 0.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0 {
                    polygons.corners.push(value as u32);
                } else {
                    bad = Some(value);
                }
            })
            .map_err(|e| at(element, index, &e))?;
        }
        if let Some(value) = bad {
            return Err(at(element, index, &format!("vertex {value}, expected an index")));
        }
        let corners = polygons.corners.len() - start;
        if corners < 3 {
            return Err(at(element, index, &format!("{corners} corners, expected at least 3")));
        }
        polygons.ends.push(polygons.corners.len());
    }
    Ok(())
}

/// Reads the header; returns the encoding, the elements and the bytes after `end_header`.
fn header(bytes: &[u8]) -> Result<(Encoding, Vec<Element>, &[u8]), String> {
    let mut rest = bytes;
    if next_line(&mut rest).as_deref() != Some("ply") {
        return Err("the first line is not `ply`".into());
    }
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    let mut number = 1;
    loop {
        number += 1;
        let line = next_line(&mut rest).ok_or("the header has no `end_header`: cut short")?;
        let at_line = |message: &str| format!("line {number}: `{}`, {message}", super::shorten(&line));
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            [] | ["comment" | "obj_info", ..] => {}
            ["format", name, _] => {
                encoding = Some(match name {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    _ => return Err(at_line("expected ascii, binary_little_endian or binary_big_endian")),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| at_line("expected a count"))?;
                elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ref kind @ .., name] => {
                let unknown = || at_line("a property of unknown type");
                let kind = match *kind {
                    ["list", length, item] => Kind::List {
                        length: scalar(length).ok_or_else(unknown)?,
                        item: scalar(item).ok_or_else(unknown)?,
                    },
                    [kind] => Kind::Scalar(scalar(kind).ok_or_else(unknown)?),
                    _ => return Err(unknown()),
                };
                let element = elements.last_mut().ok_or_else(|| at_line("before any element"))?;
                element.properties.push(Property { name: name.into(), kind });
            }
            ["end_header"] => break,
            _ => return Err(at_line("which no PLY header has")),
        }
    }
    Ok((encoding.ok_or("the header has no line `format`")?, elements, rest))
}

/// Takes a line, ended by LF, CR LF or CR alone, off `rest`; `None` at the end of the file.
fn next_line(rest: &mut &[u8]) -> Option<String> {
    let end = rest.iter().position(|&byte| byte == b'\n' || byte == b'\r')?;
    let line = String::from_utf8_lossy(rest[..end].trim_ascii()).into_owned();
    let skip = if rest[end..].starts_with(b"\r\n") { 2 } else { 1 };
    *rest = &rest[end + skip..];
    Some(line)
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

/// What follows the header.
struct Body<'a> {
    encoding: Encoding,
    rest: &'a [u8],
}

impl Body<'_> {
    /// Reads a property and hands its number, or each number of its list, to `value`.
    fn read(&mut self, property: &Property, mut value: impl FnMut(f64)) -> Result<(), String> {
        match property.kind {
            Kind::Scalar(scalar) => value(self.number(scalar)?),
            Kind::List { length, item } => {
                let count = self.number(length)?;
                if !(count >= 0.0 && count.fract() == 0.0) {
                    return Err(format!("a list of {count} entries"));
                }
                // Every entry takes a byte at least, so the end of the file bounds the loop.
                for _ in 0..count as u64 {
                    value(self.number(item)?);
                }
            }
        }
        Ok(())
    }

    fn number(&mut self, scalar: Scalar) -> Result<f64, String> {
        if self.encoding == Encoding::Ascii {
            let text = self.rest.trim_ascii_start();
            let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
            if end == 0 {
                return Err("the file ends here: cut short".into());
            }
            self.rest = &text[end..];
            let word = String::from_utf8_lossy(&text[..end]);
            return word.parse().map_err(|_| format!("`{}`, expected a number", super::shorten(&word)));
        }
        Ok(match scalar {
            Scalar::I8 => i8::from_le_bytes(self.take()?).into(),
            Scalar::U8 => u8::from_le_bytes(self.take()?).into(),
            Scalar::I16 => i16::from_le_bytes(self.take()?).into(),
            Scalar::U16 => u16::from_le_bytes(self.take()?).into(),
            Scalar::I32 => i32::from_le_bytes(self.take()?).into(),
            Scalar::U32 => u32::from_le_bytes(self.take()?).into(),
            Scalar::F32 => f32::from_le_bytes(self.take()?).into(),
            Scalar::F64 => f64::from_le_bytes(self.take()?),
        })
    }

    /// The next `N` bytes, the lowest first.
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (bytes, rest) = self
            .rest
            .split_first_chunk::<N>()
            .ok_or_else(|| format!("the file ends here, {} bytes short", N - self.rest.len()))?;
        self.rest = rest;
        let mut bytes = *bytes;
        if self.encoding == Encoding::Big {
            bytes.reverse();
        }
        Ok(bytes)
    }
}

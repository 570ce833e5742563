//! Legacy VTK files, versions 2.0 to 5.1, in ASCII and BINARY (big endian): the points of a POLYDATA or
//! UNSTRUCTURED_GRID, and of its POINT_DATA the velocity, the normals, `id` and `body`.
//!
//! Cells, other arrays, METADATA blocks and the OFFSETS / CONNECTIVITY form of cells (5.x) are skipped. Written:
//! version 3.0, BINARY, one vertex cell a particle, which every reader takes.

use std::io::{self, Write};

use super::Rows;
use super::columns::{Columns, Quantity};
use super::numbers::{ByteOrder, Cursor, Parsed, Scalar, shown};

pub(super) fn parse(bytes: &[u8]) -> Parsed<Columns> {
    let mut cursor = Cursor::new(bytes);
    let first = cursor.line().unwrap_or_default();
    let Some(version) = first.strip_prefix(b"# vtk DataFile Version ") else {
        return Err("no legacy VTK file: the first line is not '# vtk DataFile Version'".into());
    };
    let _title = cursor.line();
    let binary = match cursor.word() {
        Some("ASCII") => false,
        Some("BINARY") => true,
        other => {
            return Err(format!("line 3: '{}', expected ASCII or BINARY", shown(other.unwrap_or_default())));
        }
    };
    let offsets = version.first().is_some_and(|&major| major >= FIRST_MAJOR_WITH_OFFSETS);
    Parser { cursor, binary, offsets, section: Section::Geometry, points: 0, columns: Columns::default() }
        .run()
}

pub(super) fn write(rows: Rows<'_>, out: &mut dyn Write) -> io::Result<()> {
    let count = rows.len();
    // In this version cells are 32-bit integers.
    if i32::try_from(count).is_err() {
        return Err(io::Error::other(format!("legacy vtk holds {} particles, found {count}", i32::MAX)));
    }
    out.write_all(b"# vtk DataFile Version 3.0\nparticles\nBINARY\nDATASET UNSTRUCTURED_GRID\n")?;
    writeln!(out, "POINTS {count} float")?;
    write_vectors(rows.position, out)?;
    writeln!(out, "CELLS {count} {}", 2 * count)?;
    for particle in 0..count as u32 {
        out.write_all(&1u32.to_be_bytes())?;
        out.write_all(&particle.to_be_bytes())?;
    }
    writeln!(out, "\nCELL_TYPES {count}")?;
    for _ in 0..count {
        out.write_all(&VERTEX_CELL.to_be_bytes())?;
    }
    writeln!(out, "\nPOINT_DATA {count}")?;
    // Normals are declared as vectors, because not every reader knows the keyword NORMALS.
    for (name, values) in [("velocity", rows.velocity), ("normals", rows.normal)] {
        if let Some(values) = values {
            writeln!(out, "VECTORS {name} float")?;
            write_vectors(values, out)?;
        }
    }
    let integers: Vec<_> = rows.integers().collect();
    if !integers.is_empty() {
        writeln!(out, "FIELD FieldData {}", integers.len())?;
    }
    for (name, values) in integers {
        writeln!(out, "{name} 1 {count} unsigned_int")?;
        for value in values {
            out.write_all(&value.to_be_bytes())?;
        }
        out.write_all(b"\n")?;
    }
    Ok(())
}

/// The number of VTK_VERTEX.
const VERTEX_CELL: u32 = 1;

/// From version 5 on cells are OFFSETS and CONNECTIVITY.
const FIRST_MAJOR_WITH_OFFSETS: u8 = b'5';

fn write_vectors(vectors: &[[f32; 3]], out: &mut dyn Write) -> io::Result<()> {
    for value in vectors.as_flattened() {
        out.write_all(&value.to_be_bytes())?;
    }
    out.write_all(b"\n")
}

/// What the arrays that come next belong to.
#[derive(Clone, Copy, PartialEq)]
enum Section {
    Geometry,
    Points,
    Cells,
}

/// What a declared array is made of.
#[derive(Clone, Copy)]
enum Kind {
    Number(Scalar),
    Bit,
    Text,
}

struct Parser<'a> {
    cursor: Cursor<'a>,
    binary: bool,
    offsets: bool,
    section: Section,
    /// Entries of each array in the present section.
    points: usize,
    columns: Columns,
}

impl<'a> Parser<'a> {
    fn run(mut self) -> Parsed<Columns> {
        while let Some(keyword) = self.cursor.word() {
            self.part(&keyword.to_ascii_uppercase(), keyword)?;
        }
        match self.columns.has(Quantity::Position) {
            true => Ok(self.columns),
            false => Err("truncated: the file ends before POINTS".into()),
        }
    }

    /// Reads one keyword's part of the file.
    fn part(&mut self, keyword: &str, found: &str) -> Parsed<()> {
        match keyword {
            "DATASET" => match self.word("DATASET")? {
                "POLYDATA" | "UNSTRUCTURED_GRID" => Ok(()),
                other => Err(format!("DATASET {}, expected POLYDATA or UNSTRUCTURED_GRID", shown(other))),
            },
            "POINTS" => {
                let count = self.cursor.count("points")?;
                let kind = self.kind("POINTS")?;
                self.array(Some(Quantity::Position), "points", 3, count, kind)
            }
            "VERTICES" | "LINES" | "POLYGONS" | "TRIANGLE_STRIPS" | "CELLS" => self.cells(keyword),
            "CELL_TYPES" => {
                let count = self.cursor.count("cell types")?;
                self.array(None, keyword, 1, count, Kind::Number(Scalar::I32))
            }
            "POINT_DATA" | "CELL_DATA" => {
                self.section = if keyword == "POINT_DATA" { Section::Points } else { Section::Cells };
                self.points = self.cursor.count("entries")?;
                Ok(())
            }
            "METADATA" => {
                // It ends at the first empty line, or at the end of the file.
                self.cursor.line();
                while self.cursor.line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
                Ok(())
            }
            "FIELD" => self.field(),
            "LOOKUP_TABLE" => {
                self.word(keyword)?;
                let count = self.cursor.count("colours")?;
                self.array(None, keyword, 4, count, self.colour())
            }
            "COLOR_SCALARS" => {
                self.word(keyword)?;
                let width = self.cursor.count("components")?;
                self.array(None, keyword, width, self.points, self.colour())
            }
            "SCALARS" => self.scalars(),
            "TEXTURE_COORDINATES" => {
                self.word(keyword)?;
                let width = self.cursor.count("components")?;
                let kind = self.kind(keyword)?;
                self.array(None, keyword, width, self.points, kind)
            }
            "VECTORS" | "NORMALS" | "TENSORS" | "TENSORS6" | "GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS" => {
                let name = self.word(keyword)?;
                let kind = self.kind(keyword)?;
                let width = match keyword {
                    "VECTORS" | "NORMALS" => 3,
                    "TENSORS" => 9,
                    "TENSORS6" => 6,
                    _ => 1,
                };
                let quantity = match keyword {
                    "NORMALS" => Some(Quantity::Normal),
                    _ => Quantity::of_attribute(name, width),
                };
                self.array(
                    quantity.filter(|_| self.section == Section::Points),
                    name,
                    width,
                    self.points,
                    kind,
                )
            }
            _ => Err(format!(
                "line {}: '{}', expected a keyword of VTK",
                self.cursor.line_number(),
                shown(found)
            )),
        }
    }

    fn cells(&mut self, keyword: &str) -> Parsed<()> {
        let first = self.cursor.count("cells")?;
        let second = self.cursor.count("cell entries")?;
        let is_offsets = self.offsets && self.cursor.clone().word() == Some("OFFSETS");
        if !is_offsets {
            return self.array(None, keyword, 1, second, Kind::Number(Scalar::I32));
        }
        for (part, count) in [("OFFSETS", first), ("CONNECTIVITY", second)] {
            let found = self.word(part)?;
            if found != part {
                let line = self.cursor.line_number();
                return Err(format!("line {line}: '{}', expected {part} of {keyword}", shown(found)));
            }
            let kind = self.kind(part)?;
            self.array(None, part, 1, count, kind)?;
        }
        Ok(())
    }

    fn field(&mut self) -> Parsed<()> {
        self.word("FIELD")?;
        let arrays = self.cursor.count("arrays")?;
        for _ in 0..arrays {
            let mut name = self.word("FIELD")?;
            if name == "METADATA" {
                self.part("METADATA", "METADATA")?;
                name = self.word("FIELD")?;
            }
            // An array that is missing is written so.
            if name == "NULL_ARRAY" {
                continue;
            }
            let width = self.cursor.count("components")?;
            let count = self.cursor.count("entries")?;
            let kind = self.kind("FIELD")?;
            let quantity = Quantity::of_attribute(name, width).filter(|_| self.section == Section::Points);
            self.array(quantity, name, width, count, kind)?;
        }
        Ok(())
    }

    fn scalars(&mut self) -> Parsed<()> {
        let name = self.word("SCALARS")?;
        let kind = self.kind("SCALARS")?;
        // The number of components may be left out; so may the table, in files of other programs.
        let mut ahead = self.cursor.clone();
        let width = match ahead.word().and_then(|word| word.parse().ok()) {
            Some(width) if !self.rest_of_line_is_empty() => {
                self.cursor = ahead;
                width
            }
            _ => 1,
        };
        let mut ahead = self.cursor.clone();
        if ahead.word() == Some("LOOKUP_TABLE") {
            self.cursor = ahead;
            self.word("LOOKUP_TABLE")?;
        }
        let quantity = Quantity::of_attribute(name, width).filter(|_| self.section == Section::Points);
        self.array(quantity, name, width, self.points, kind)
    }

    fn rest_of_line_is_empty(&self) -> bool {
        let line = self.cursor.clone().line().unwrap_or_default();
        line.trim_ascii().is_empty()
    }

    fn word(&mut self, after: &str) -> Parsed<&'a str> {
        self.cursor.word().ok_or_else(|| format!("truncated: the file ends after {after}"))
    }

    fn kind(&mut self, after: &str) -> Parsed<Kind> {
        let name = self.word(after)?.to_ascii_lowercase();
        let scalar = match name.as_str() {
            "char" => Scalar::I8,
            "unsigned_char" => Scalar::U8,
            "short" => Scalar::I16,
            "unsigned_short" => Scalar::U16,
            // In binary files vtkIdType is written as int.
            "int" | "vtkidtype" => Scalar::I32,
            "unsigned_int" => Scalar::U32,
            "long" | "vtktypeint64" => Scalar::I64,
            "unsigned_long" | "vtktypeuint64" => Scalar::U64,
            "float" => Scalar::F32,
            "double" => Scalar::F64,
            "bit" => return Ok(Kind::Bit),
            "string" => return Ok(Kind::Text),
            _ => {
                let line = self.cursor.line_number();
                return Err(format!("line {line}: '{}', expected a type such as float", shown(&name)));
            }
        };
        Ok(Kind::Number(scalar))
    }

    /// The type of colours: bytes in binary files, numbers from 0 to 1 in ASCII.
    fn colour(&self) -> Kind {
        Kind::Number(Scalar::U8)
    }

    /// Reads the numbers of an array, or skips them if it has no meaning for us.
    fn array(
        &mut self,
        quantity: Option<Quantity>,
        name: &str,
        width: usize,
        count: usize,
        kind: Kind,
    ) -> Parsed<()> {
        let what = format!("array '{}'", shown(name));
        let Some(total) = width.checked_mul(count) else {
            return Err(format!("{what} claims {count} entries of {width} values"));
        };
        let scalar = match kind {
            Kind::Text => return self.texts(total, &what),
            Kind::Bit if self.binary => {
                self.start_of_data();
                return self.cursor.take(total.div_ceil(8), &what).map(drop);
            }
            Kind::Bit => Scalar::U8,
            Kind::Number(scalar) => scalar,
        };
        let values = if self.binary {
            self.start_of_data();
            let bytes = self.cursor.take_numbers(total, scalar.size(), &what)?;
            quantity.map(|_| scalar.decode_all(ByteOrder::Big, bytes))
        } else {
            self.numbers(total, &what, quantity.is_some())?
        };
        if let (Some(quantity), Some(values)) = (quantity, values) {
            self.columns.add(quantity, name, width, values);
        }
        Ok(())
    }

    /// Reads `total` numbers in ASCII; gives them back if they are `wanted`.
    fn numbers(&mut self, total: usize, what: &str, wanted: bool) -> Parsed<Option<Vec<f64>>> {
        let left = self.cursor.rest().len();
        // A number takes a digit and a blank before it.
        if total > left {
            return Err(format!("truncated: {what} needs {total} numbers, {left} bytes are left"));
        }
        if !wanted {
            for _ in 0..total {
                self.cursor.word().ok_or_else(|| format!("truncated: the file ends within {what}"))?;
            }
            return Ok(None);
        }
        let mut values = Vec::new();
        for _ in 0..total {
            values.push(self.cursor.number(what)?);
        }
        Ok(Some(values))
    }

    /// Skips an array of texts: a line each in ASCII; in binary each after its length, whose top two bits say in how
    /// many bytes it is written.
    fn texts(&mut self, count: usize, what: &str) -> Parsed<()> {
        let truncated = || format!("truncated: the file ends within {what}");
        if !self.binary {
            self.cursor.line();
            return (0..count).try_for_each(|_| self.cursor.line().map(drop).ok_or_else(truncated));
        }
        self.start_of_data();
        for _ in 0..count {
            let Some(&first) = self.cursor.rest().first() else { return Err(truncated()) };
            let size = [8, 4, 2, 1][usize::from(first >> 6)];
            let length =
                self.cursor.take(size, what)?.iter().fold(0, |length, &byte| length << 8 | u64::from(byte));
            let length = length & (u64::MAX >> (64 - 8 * size + 2));
            self.cursor.take(usize::try_from(length).unwrap_or(usize::MAX), what)?;
        }
        Ok(())
    }

    /// Binary data starts after the line that declares it.
    fn start_of_data(&mut self) {
        self.cursor.line();
    }
}

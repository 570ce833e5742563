//! Wavefront OBJ: the lines `v` and `f`. Texture coordinates, normals, colours, groups, materials, lines and
//! points are skipped.
//!
//! A face corner is `v`, `v/vt`, `v//vn` or `v/vt/vn`; v counts from 1, or backwards from the last vertex
//! above if negative. A backslash at its end continues a line.

use std::fmt::Write;

use super::TriangleMesh;
use super::polygons::Polygons;

/// Decimals of coordinates that are written: a micrometre, and the same text on machines whose sine rounds otherwise.
const DECIMALS: f64 = 1e6;

pub(super) fn parse(bytes: &[u8]) -> Result<Polygons, String> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut polygons = Polygons::default();
    // Vertices may follow the faces that name them: the line of each face, for the check at the end.
    let mut face_lines = Vec::new();
    for (number, line) in lines(bytes) {
        let at_line = |message: String| format!("line {number}: {message}");
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => polygons.positions.push(position(words).map_err(at_line)?),
            Some("f") => {
                let start = polygons.corners.len();
                for word in words.take_while(|word| !word.starts_with('#')) {
                    let corner = corner(word, polygons.positions.len()).map_err(at_line)?;
                    polygons.corners.push(corner);
                }
                let corners = polygons.corners.len() - start;
                if corners < 3 {
                    return Err(at_line(format!("a face of {corners} corners, expected at least 3")));
                }
                polygons.ends.push(polygons.corners.len());
                face_lines.push(number);
            }
            _ => {}
        }
    }
    let (mut start, vertices) = (0, polygons.positions.len());
    for (&end, line) in polygons.ends.iter().zip(face_lines) {
        if let Some(corner) = polygons.corners[start..end].iter().find(|&&v| v as usize >= vertices) {
            let index = u64::from(*corner) + 1;
            return Err(format!("line {line}: vertex {index} of {vertices}, expected 1 to {vertices}"));
        }
        start = end;
    }
    Ok(polygons)
}

/// The lines with their numbers, without comments on lines of their own; continued lines are joined and have
/// the number of the first.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, String)> {
    // Files of old Macintosh programs end lines with a carriage return alone.
    let end = if bytes.contains(&b'\n') { b'\n' } else { b'\r' };
    let mut lines = bytes.split(move |&byte| byte == end).enumerate();
    std::iter::from_fn(move || {
        let (number, first) = lines.next()?;
        let mut line = text(first);
        while line.ends_with('\\') && !line.trim_start().starts_with('#') {
            line.pop();
            line.push(' ');
            match lines.next() {
                Some((_, next)) => line.push_str(&text(next)),
                None => break,
            }
        }
        Some((number + 1, line))
    })
}

/// Names may be in any encoding; whatever is not UTF-8 in them does not matter here.
fn text(line: &[u8]) -> String {
    String::from_utf8_lossy(line.trim_ascii_end()).into_owned()
}

/// The first three numbers; a fourth (w) or a colour may follow.
fn position<'a>(mut words: impl Iterator<Item = &'a str>) -> Result<[f32; 3], String> {
    let mut position = [0.0; 3];
    for (coordinate, name) in position.iter_mut().zip(["x", "y", "z"]) {
        let word = words.next().ok_or_else(|| format!("a vertex without {name}, expected three numbers"))?;
        *coordinate = super::number(word)?;
    }
    Ok(position)
}

/// The vertex of a face corner, counted from 0.
fn corner(word: &str, vertices: usize) -> Result<u32, String> {
    let index = word.split('/').next().unwrap_or_default();
    let value: i64 = index.parse().map_err(|_| format!("face corner `{word}`, expected a vertex index"))?;
    let vertex = match value {
        1.. => Some(value - 1),
        0 => None,
        _ => Some(vertices as i64 + value).filter(|&vertex| vertex >= 0),
    };
    vertex
        .and_then(|vertex| u32::try_from(vertex).ok())
        .ok_or_else(|| format!("vertex {value} of {vertices}, expected 1 to {vertices} or -{vertices} to -1"))
}

/// The text of a mesh, `v` and `f`.
pub(super) fn format(mesh: &TriangleMesh) -> String {
    let mut text = String::new();
    // Writing to a text cannot fail. Adding zero turns -0 into 0.
    for position in &mesh.positions {
        let [x, y, z] = position.map(|x| (f64::from(x) * DECIMALS).round() / DECIMALS + 0.0);
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|v| u64::from(v) + 1);
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text
}

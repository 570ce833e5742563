//! STL, binary or ASCII.
//!
//! Binary files have a header of 80 bytes, the number n of triangles and 50 bytes for each. Their headers may
//! begin with `solid` as ASCII files do, so the size decides: 84 + 50 n bytes are a binary file.

use super::polygons::Polygons;

const HEADER: usize = 80;
const PREFIX: usize = HEADER + 4;
/// A normal, three corners and two bytes that programs use as they like.
const RECORD: usize = 50;

pub(super) fn parse(bytes: &[u8]) -> Result<Polygons, String> {
    let declared = bytes.get(HEADER..PREFIX).map(|n| u32::from_le_bytes([n[0], n[1], n[2], n[3]]));
    let expected = declared.map(|n| PREFIX as u64 + RECORD as u64 * u64::from(n));
    if expected == Some(bytes.len() as u64) {
        return binary(bytes);
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let begins_as_text = text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    if begins_as_text && !text.contains(&0) {
        return ascii(text);
    }
    match (declared, expected) {
        (Some(n), Some(expected)) => Err(format!(
            "{n} triangles promised, which take {expected} bytes, but the file has {} ({})",
            bytes.len(),
            if expected > bytes.len() as u64 { "it was cut short" } else { "more than expected" }
        )),
        _ => Err(format!("{} bytes, expected `solid` or a binary header of {PREFIX} bytes", bytes.len())),
    }
}

fn binary(bytes: &[u8]) -> Result<Polygons, String> {
    let mut polygons = Polygons::default();
    for (t, record) in bytes[PREFIX..].chunks_exact(RECORD).enumerate() {
        let numbers: Vec<f32> = record[..48]
            .chunks_exact(4)
            .map(|word| f32::from_le_bytes([word[0], word[1], word[2], word[3]]))
            .collect();
        if let Some(number) = numbers[3..].iter().find(|number| !number.is_finite()) {
            return Err(format!("triangle {t}: coordinate {number}, expected a finite number"));
        }
        let first = polygons.positions.len() as u32;
        polygons.positions.extend(numbers[3..].chunks_exact(3).map(|x| [x[0], x[1], x[2]]));
        polygons.push(first..first + 3);
    }
    Ok(polygons)
}

/// `solid NAME`, any number of `facet normal X Y Z outer loop vertex X Y Z ... endloop endfacet`, `endsolid
/// NAME`; several solids may follow each other.
fn ascii(text: &[u8]) -> Result<Polygons, String> {
    let text = String::from_utf8_lossy(text);
    let mut polygons = Polygons::default();
    let mut loop_start = None;
    let mut ended = false;
    for (number, line) in text.lines().enumerate() {
        let at_line = |message: String| format!("line {}: {message}", number + 1);
        let mut words = line.split_ascii_whitespace();
        while let Some(word) = words.next() {
            match word.to_ascii_lowercase().as_str() {
                // A name may follow, of any words.
                "solid" => {
                    ended = false;
                    break;
                }
                "endsolid" => {
                    ended = true;
                    break;
                }
                "facet" => {
                    // `normal` and its numbers; exporters write `nan` for degenerate triangles.
                    words.by_ref().take(4).for_each(drop);
                }
                "outer" | "endfacet" => {}
                "loop" => loop_start = Some(polygons.positions.len()),
                "vertex" => {
                    if loop_start.is_none() {
                        return Err(at_line("`vertex` outside of a loop".into()));
                    }
                    let mut position = [0.0; 3];
                    for x in &mut position {
                        let word =
                            words.next().ok_or_else(|| at_line("`vertex` without three numbers".into()))?;
                        *x = super::number(word).map_err(at_line)?;
                    }
                    polygons.positions.push(position);
                }
                "endloop" => {
                    let first =
                        loop_start.take().ok_or_else(|| at_line("`endloop` without a loop".into()))?;
                    let end = polygons.positions.len();
                    if end - first < 3 {
                        return Err(at_line(format!("a face of {} corners, expected 3", end - first)));
                    }
                    polygons.push(first as u32..end as u32);
                }
                _ => return Err(at_line(format!("`{}`, which no STL file has", super::shorten(word)))),
            }
        }
    }
    if loop_start.is_some() || !ended {
        return Err(format!("cut short: no `endsolid` after {} triangles", polygons.ends.len()));
    }
    Ok(polygons)
}

//! Parts as the published script writes them.

use std::io;
use std::path::Path;

use rmp::encode;

use super::super::write_atomically;
use super::{Frame, Part, zst};
use crate::{Error, Result};

/// Writes a part file, atomically. Equal parts are equal bytes.
///
/// # Errors
/// `Io`; `Parameter` if the part could not be read again: vectors of different lengths, no frames, frames that do not
/// follow each other, numbers that are not finite.
pub fn write_part(path: &Path, part: &Part) -> Result<()> {
    check(part).map_err(|message| Error::Parameter(format!("{}: {message}", path.display())))?;
    let packed = encode(part).and_then(|bytes| zst::pack(&bytes)).map_err(Error::io(path))?;
    write_atomically(path, |out| out.write_all(&packed))
}

type Checked = std::result::Result<(), String>;

fn check(part: &Part) -> Checked {
    let Some(first) = part.frames.first() else { return Err("a part without frames".into()) };
    let walls = &part.walls;
    if walls.normal.len() != walls.position.len() {
        let (normals, points) = (walls.normal.len(), walls.position.len());
        return Err(format!("{normals} wall normals for {points} wall particles, expected one each"));
    }
    finite("box", walls.position.as_flattened())?;
    finite("box_normals", walls.normal.as_flattened())?;
    let mut last = None;
    for frame in &part.frames {
        if let Some(last) = last.replace((frame.number, first.position.len())) {
            follows(last, frame)?;
        }
        check_frame(frame).map_err(|message| format!("frame {}: {message}", frame.number))?;
    }
    Ok(())
}

fn check_frame(frame: &Frame) -> Checked {
    let count = frame.position.len();
    if i64::try_from(frame.number).is_err() {
        return Err(format!("a number above {}, which is int64 in the file", i64::MAX));
    }
    let lengths = [
        ("velocities", frame.velocity.len()),
        ("masses", frame.mass.len()),
        ("viscosities", frame.viscosity.len()),
    ];
    if let Some((name, length)) = lengths.into_iter().find(|&(_, length)| length != count) {
        return Err(format!("{length} {name} for {count} particles, expected one each"));
    }
    finite("pos", frame.position.as_flattened())?;
    finite("vel", frame.velocity.as_flattened())?;
    finite("m", &frame.mass)?;
    finite("viscosity", &frame.viscosity)
}

fn finite(name: &str, values: &[f32]) -> Checked {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(k) => Err(format!("value {k} of '{name}' is {}, expected finite numbers", values[k])),
    }
}

/// Whether a frame can follow one of that number with so many particles.
fn follows((number, particles): (u64, usize), frame: &Frame) -> Checked {
    if frame.number != number.saturating_add(1) {
        return Err(format!("frame {} after frame {number}, expected the next one", frame.number));
    }
    match frame.position.len() {
        count if count == particles => Ok(()),
        count => Err(format!("frame {}: {count} particles, expected {particles} as before", frame.number)),
    }
}

/// The msgpack of a part: the keys, their order and the types of the published files.
fn encode(part: &Part) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    encode::write_array_len(&mut out, length(part.frames.len())?)?;
    for (k, frame) in part.frames.iter().enumerate() {
        encode::write_map_len(&mut out, if k == 0 { 8 } else { 6 })?;
        if k == 0 {
            write_vectors(&mut out, "box", &part.walls.position)?;
            write_vectors(&mut out, "box_normals", &part.walls.normal)?;
        }
        encode::write_str(&mut out, "frame_id")?;
        write_head(&mut out, 3, false, "<i8")?;
        encode::write_bin(&mut out, b"data")?;
        encode::write_bin(&mut out, &frame.number.to_le_bytes())?;
        encode::write_str(&mut out, "scene_id")?;
        encode::write_str(&mut out, &part.scene)?;
        write_vectors(&mut out, "pos", &frame.position)?;
        write_vectors(&mut out, "vel", &frame.velocity)?;
        write_array(&mut out, "m", &[frame.mass.len()], &frame.mass)?;
        write_array(&mut out, "viscosity", &[frame.viscosity.len()], &frame.viscosity)?;
    }
    Ok(out)
}

fn write_vectors(out: &mut Vec<u8>, name: &str, rows: &[[f32; 3]]) -> io::Result<()> {
    write_array(out, name, &[rows.len(), 3], rows.as_flattened())
}

fn write_array(out: &mut Vec<u8>, name: &str, shape: &[usize], values: &[f32]) -> io::Result<()> {
    encode::write_str(out, name)?;
    write_head(out, 5, true, "<f4")?;
    encode::write_bin(out, b"kind")?;
    encode::write_bin(out, b"")?;
    encode::write_bin(out, b"shape")?;
    encode::write_array_len(out, length(shape.len())?)?;
    for &axis in shape {
        encode::write_uint(out, axis as u64)?;
    }
    encode::write_bin(out, b"data")?;
    encode::write_bin_len(out, length(4 * values.len())?)?;
    out.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    Ok(())
}

/// The first two of the entries of an array or number of msgpack-numpy.
fn write_head(out: &mut Vec<u8>, entries: u32, is_array: bool, kind: &str) -> io::Result<()> {
    encode::write_map_len(out, entries)?;
    encode::write_bin(out, b"nd")?;
    encode::write_bool(out, is_array)?;
    encode::write_bin(out, b"type")?;
    encode::write_str(out, kind)?;
    Ok(())
}

/// Lengths in msgpack have 32 bits.
fn length(length: usize) -> io::Result<u32> {
    u32::try_from(length)
        .map_err(|_| io::Error::other(format!("{length} bytes or items, too many for msgpack")))
}

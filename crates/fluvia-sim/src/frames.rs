//! Frames and particle files on disk: one file a format below this one.
//!
//! A particle file holds N positions (metres) and, where it has them, velocities (m/s), normals, identities and
//! body indices, one a particle. A run is a directory of them ([`run`]): `box.npz`, `fluid_0000.npz`, ...
//!
//! Readers take files of any origin. They allocate in proportion to the bytes that are there, never to a count
//! that a header claims, and every fault is one line that names the file, the array and what was expected.
//! Writers go through [`write_atomically`].

use std::fmt;
use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::str::FromStr;

use crate::particles::{Boundary, Particles};
use crate::{Error, Result};
use columns::Columns;

mod atomic;
mod bgeo;
mod columns;
pub mod npz;
mod numbers;
mod ply;
pub mod run;
pub mod sequence;
pub mod state;
mod vtk;
mod vtu;
mod vtu_data;

pub use atomic::{
    Replacement, prepare, read_json, remove_temporaries, write_atomically, write_json, write_text,
};
pub use run::{FrameFile, Mode, RunDirectory};
pub use sequence::Sequence;
pub use state::State;

/// What a particle file holds; every vector present has one entry a particle.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParticleData {
    /// Positions, metres.
    pub position: Vec<[f32; 3]>,
    /// Velocities, metres per second.
    pub velocity: Option<Vec<[f32; 3]>>,
    /// Normals (walls).
    pub normal: Option<Vec<[f32; 3]>>,
    /// Identities.
    pub id: Option<Vec<u32>>,
    /// Indices of the scene's fluids.
    pub body: Option<Vec<u32>>,
}

/// A format of particle files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Format {
    /// NumPy: arrays `pos`, `vel`, `id`, `body` (walls: `pos`, `normals`).
    Npz,
    /// PLY point cloud, binary little endian: x y z, vx vy vz, nx ny nz, id, body.
    Ply,
    /// Houdini classic (version 5): attributes `velocity`, `N`, `id`, `body`.
    Bgeo,
    /// VTK XML unstructured grid, with `fluid.pvd` as the index of the frames: for ParaView.
    Vtu,
    /// VTK legacy unstructured grid, binary.
    Vtk,
}

impl Format {
    /// Every format, in the order in which a frame that exists in several is read.
    pub const ALL: [Format; 5] = [Format::Npz, Format::Ply, Format::Bgeo, Format::Vtu, Format::Vtk];

    /// The file name extension, without the dot; also the name that users type.
    pub fn extension(self) -> &'static str {
        match self {
            Format::Npz => "npz",
            Format::Ply => "ply",
            Format::Bgeo => "bgeo",
            Format::Vtu => "vtu",
            Format::Vtk => "vtk",
        }
    }

    /// The format that a file name announces; `None` if its extension is none of ours.
    pub fn from_path(path: &Path) -> Option<Format> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "bhclassic" => Some(Format::Bgeo),
            "vtp" => Some(Format::Vtu),
            name => Format::ALL.into_iter().find(|format| format.extension() == name),
        }
    }

    /// The format that the first bytes of a file show.
    pub fn from_bytes(bytes: &[u8]) -> Option<Format> {
        const MAGIC: [(&[u8], Format); 9] = [
            (b"PK\x03\x04", Format::Npz),
            (b"PK\x05\x06", Format::Npz),
            (b"ply\n", Format::Ply),
            (b"ply\r", Format::Ply),
            (b"Bgeo", Format::Bgeo),
            (b"\x7fNSJb", Format::Bgeo),
            (b"\x1f\x8b", Format::Bgeo),
            (b"<", Format::Vtu),
            (b"# vtk", Format::Vtk),
        ];
        MAGIC.into_iter().find(|(magic, _)| bytes.starts_with(magic)).map(|(_, format)| format)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.extension())
    }
}

impl FromStr for Format {
    type Err = Error;

    fn from_str(name: &str) -> Result<Format> {
        Format::ALL.into_iter().find(|format| format.extension() == name).ok_or_else(|| {
            let known = Format::ALL.map(Format::extension).join(", ");
            Error::Parameter(format!("format '{name}' is not known, expected one of {known}"))
        })
    }
}

/// Reads a particle file: its format is that of its extension or, if that says nothing, of its first bytes.
///
/// # Errors
/// `Io` if the file cannot be read, `File` if it is damaged, of another kind, or holds a number that is not finite.
pub fn read(path: &Path) -> Result<ParticleData> {
    let bytes = fs::read(path).map_err(Error::io(path))?;
    let Some(format) = Format::from_path(path).or_else(|| Format::from_bytes(&bytes)) else {
        let known = Format::ALL.map(Format::extension).join(", ");
        return Err(Error::file(path, format!("neither its name nor its content is one of {known}")));
    };
    parse(path, format, &bytes)
}

/// Reads a particle file that is in memory; `path` is for messages.
///
/// # Errors
/// As [`read`].
pub fn parse(path: &Path, format: Format, bytes: &[u8]) -> Result<ParticleData> {
    if bytes.is_empty() {
        return Err(Error::file(path, format!("empty (0 bytes), expected particles as {format}")));
    }
    let columns = match format {
        Format::Npz => npz::parse(bytes),
        Format::Ply => ply::parse(bytes),
        Format::Bgeo => bgeo::parse(bytes),
        Format::Vtu => vtu::parse(bytes),
        Format::Vtk => vtk::parse(bytes),
    };
    let mut data = columns.and_then(Columns::check).map_err(|message| Error::file(path, message))?;
    // Houdini and SPlisHSPlasH keep their points in an order of their own.
    if format == Format::Bgeo {
        columns::sort_by_id(&mut data);
    }
    Ok(data)
}

/// Writes a frame of the fluid.
///
/// # Errors
/// `Io`; `Parameter` if the vectors of `particles` differ in length.
pub fn write_fluid(path: &Path, format: Format, particles: &Particles) -> Result<()> {
    let rows = Rows {
        position: &particles.position,
        velocity: Some(&particles.velocity),
        normal: None,
        id: Some(&particles.id),
        body: Some(&particles.body),
    };
    write(path, format, rows)
}

/// Writes the walls.
///
/// # Errors
/// `Io`; `Parameter` if there are not as many normals as positions.
pub fn write_walls(path: &Path, format: Format, walls: &Boundary) -> Result<()> {
    let rows =
        Rows { position: &walls.position, velocity: None, normal: Some(&walls.normal), id: None, body: None };
    write(path, format, rows)
}

/// What a writer is given; all slices have one entry a particle.
#[derive(Clone, Copy)]
struct Rows<'a> {
    position: &'a [[f32; 3]],
    velocity: Option<&'a [[f32; 3]]>,
    normal: Option<&'a [[f32; 3]]>,
    id: Option<&'a [u32]>,
    body: Option<&'a [u32]>,
}

impl<'a> Rows<'a> {
    /// The number of particles.
    fn len(&self) -> usize {
        self.position.len()
    }

    /// The identities and body indices that are there, with their names in files.
    fn integers(&self) -> impl Iterator<Item = (&'static str, &'a [u32])> {
        [("id", self.id), ("body", self.body)]
            .into_iter()
            .filter_map(|(name, values)| values.map(|values| (name, values)))
    }
}

fn write(path: &Path, format: Format, rows: Rows<'_>) -> Result<()> {
    let lengths = [
        rows.velocity.map(<[_]>::len),
        rows.normal.map(<[_]>::len),
        rows.id.map(<[_]>::len),
        rows.body.map(<[_]>::len),
    ];
    if let Some(length) = lengths.into_iter().flatten().find(|&length| length != rows.len()) {
        return Err(Error::Parameter(format!(
            "{}: {length} values for {} particles, expected one each",
            path.display(),
            rows.len()
        )));
    }
    let writer: fn(Rows<'_>, &mut dyn Write) -> io::Result<()> = match format {
        Format::Npz => npz::write,
        Format::Ply => ply::write,
        Format::Bgeo => bgeo::write,
        Format::Vtu => vtu::write,
        Format::Vtk => vtk::write,
    };
    write_atomically(path, |out| writer(rows, out))
}

//! Sequences of data sets in the published format: parts `NAME_00.msgpack.zst`, `NAME_01.msgpack.zst`, ...
//!
//! ```text
//! part   zstd stream of a msgpack list, one item a frame        (docs/formats.md)
//! item   frame_id, scene_id, pos (N, 3), vel (N, 3), m (N), viscosity (N); the first also box, box_normals (M, 3)
//! ```
//!
//! A part is read whole; a [`Sequence`] holds one at a time. What is written is the published form to the byte, before
//! compression. Bad files are errors that name the file, the frame and the array.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::particles::Boundary;
use crate::{Error, Result};
use read::PartReader;

mod msgpack;
mod read;
mod write;
mod zst;

pub use write::write_part;

/// How the names of part files end, after the number of the part.
pub const EXTENSION: &str = ".msgpack.zst";

/// Frames of a part in the published data sets: 16 s at 50 Hz in 16 parts.
pub const FRAMES_PER_PART: usize = 50;

/// One frame; every vector has one entry a particle, in the same order in all frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// `frame_id`, counted from the beginning of the sequence.
    pub number: u64,
    /// `pos`, metres.
    pub position: Vec<[f32; 3]>,
    /// `vel`, metres per second.
    pub velocity: Vec<[f32; 3]>,
    /// `m`, kilograms: [`stored_mass`].
    pub mass: Vec<f32>,
    /// `viscosity`, the coefficient of Bender & Koschier 2017.
    pub viscosity: Vec<f32>,
}

/// The content of a part file: successive frames of one scene, with equally many particles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// `scene_id`.
    pub scene: String,
    /// `box` and `box_normals`, the same in all parts of a sequence.
    pub walls: Boundary,
    /// At least one.
    pub frames: Vec<Frame>,
}

/// The part files of a sequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SequenceFiles {
    /// What their names have in common, without the folder.
    pub name: String,
    /// In their order.
    pub parts: Vec<PathBuf>,
}

/// The mass that data sets store for a particle, density (2 r)³, whatever mass the solver gave it; 0.125 kg for
/// 1000 kg/m³ and 0.025 m.
pub fn stored_mass(density: f32, particle_radius: f32) -> f32 {
    density * (2.0 * f64::from(particle_radius)).powi(3) as f32
}

/// Reads a part file.
///
/// # Errors
/// `Io` if the file cannot be opened; `File` if it is damaged, truncated, or not of this format.
pub fn read_part(path: &Path) -> Result<Part> {
    let (file, length) = open_part(path)?;
    read_all(file, length).map_err(|message| Error::file(path, message))
}

/// Reads a part file that is in memory; `path` is for messages.
///
/// # Errors
/// `File`, as [`read_part`].
pub fn parse_part(path: &Path, bytes: &[u8]) -> Result<Part> {
    read_all(bytes, bytes.len() as u64).map_err(|message| Error::file(path, message))
}

/// Whether a file name is that of a part of a sequence.
pub fn is_part(path: &Path) -> bool {
    path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.ends_with(EXTENSION))
}

/// The walls and the first frame of a part file; the rest of it is not read.
///
/// # Errors
/// As [`read_part`].
pub fn read_start(path: &Path) -> Result<(Boundary, Frame)> {
    let start = Start::read(path)?;
    Ok((start.walls, start.frame))
}

/// The sequences that `path` names: all in a folder, the one that a part file is of (with that part only), or the one
/// whose parts begin with `path` (`valid/sim_0206`). None if there are none.
///
/// # Errors
/// `Io`.
pub fn find(path: &Path) -> Result<Vec<SequenceFiles>> {
    if path.is_dir() {
        return list(path);
    }
    let Some(name) = path.file_name().and_then(|name| name.to_str()) else { return Ok(Vec::new()) };
    if path.exists() {
        let Some(stem) = name.strip_suffix(EXTENSION) else { return Ok(Vec::new()) };
        let name = part_name(name).map_or(stem, |(name, _)| name).to_owned();
        return Ok(vec![SequenceFiles { name, parts: vec![path.to_path_buf()] }]);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut all = list(folder)?;
    all.retain(|files| files.name == name);
    Ok(all)
}

/// A sequence on disk. Opening reads the first frame of each part and makes sure that the parts belong together.
#[derive(Debug)]
pub struct Sequence {
    files: SequenceFiles,
    scene: String,
    walls: Boundary,
    particles: usize,
    /// The number of the first frame of each part, and that after the last.
    starts: Vec<u64>,
    /// The part that was read last.
    loaded: Option<(usize, Part)>,
}

impl Sequence {
    /// Opens what `path` names: a folder with one sequence, a part file, or the common prefix of the parts.
    ///
    /// # Errors
    /// `File` if that is no sequence or more than one; as [`Sequence::of`].
    pub fn open(path: &Path) -> Result<Sequence> {
        let mut found = find(path)?;
        if found.len() > 1 {
            return Err(Error::file(path, several(&found)));
        }
        let Some(files) = found.pop() else {
            fs::metadata(path).map_err(Error::io(path))?;
            return Err(Error::file(path, format!("no sequence, expected files named NAME_00{EXTENSION}")));
        };
        Sequence::of(files)
    }

    /// Opens a sequence that [`find`] has found.
    ///
    /// # Errors
    /// As [`read_part`]; `File` if the parts are of different scenes, have other walls or numbers of particles, or do
    /// not follow each other; `Parameter` if there are none.
    pub fn of(files: SequenceFiles) -> Result<Sequence> {
        let Some(first) = files.parts.first() else {
            return Err(Error::Parameter(format!("{}: a sequence without parts", files.name)));
        };
        let mut opened = Sequence::of_one(first)?;
        for path in &files.parts[1..] {
            let next = Sequence::of_one(path)?;
            let end = opened.end();
            let wrong = |message: String| Err(Error::file(path, message));
            if next.scene != opened.scene {
                return wrong(format!(
                    "scene '{}', expected '{}' as in the first part",
                    next.scene, opened.scene
                ));
            }
            if next.particles != opened.particles {
                let expected = opened.particles;
                return wrong(format!(
                    "{} particles, expected {expected} as in the first part",
                    next.particles
                ));
            }
            if next.walls != opened.walls {
                return wrong("'box' or 'box_normals' differ from those of the first part".into());
            }
            if next.starts[0] != end {
                let message = "a part before it is missing or has another length";
                return wrong(format!("begins with frame {}, expected {end}: {message}", next.starts[0]));
            }
            opened.starts.push(next.end());
        }
        opened.files = files;
        Ok(opened)
    }

    /// Gives the memory of the part back that was read last.
    pub fn unload(&mut self) {
        self.loaded = None;
    }

    /// What the names of the files have in common.
    pub fn name(&self) -> &str {
        &self.files.name
    }

    /// `scene_id`.
    pub fn scene(&self) -> &str {
        &self.scene
    }

    /// The walls.
    pub fn walls(&self) -> &Boundary {
        &self.walls
    }

    /// The number of particles, the same in all frames.
    pub fn particles(&self) -> usize {
        self.particles
    }

    /// The numbers of the frames: those that the parts claim to have, which reading them makes sure of.
    pub fn frames(&self) -> Range<u64> {
        self.starts[0]..self.end()
    }

    /// The number of the first frame of each part.
    pub fn starts(&self) -> &[u64] {
        &self.starts[..self.files.parts.len()]
    }

    /// The part files, in their order.
    pub fn parts(&self) -> &[PathBuf] {
        &self.files.parts
    }

    /// Reads part `k` and checks that it is the one that was opened.
    ///
    /// # Errors
    /// As [`read_part`]; `File` if it has changed since; `Parameter` if there is no such part.
    pub fn read_part(&self, k: usize) -> Result<Part> {
        let Some(path) = self.files.parts.get(k) else {
            return Err(Error::Parameter(format!("{}: no part {k}", self.files.name)));
        };
        let part = read_part(path)?;
        let frames = part.frames[0].number..part.frames[0].number + part.frames.len() as u64;
        let particles = part.frames[0].position.len();
        if frames != (self.starts[k]..self.starts[k + 1]) || particles != self.particles {
            return Err(Error::file(path, "has changed since it was opened"));
        }
        Ok(part)
    }

    /// Frame `number`; its part is read if it is not the one that was read last.
    ///
    /// # Errors
    /// `File` if there is no such frame; as [`Sequence::read_part`].
    pub fn frame(&mut self, number: u64) -> Result<&Frame> {
        if !self.frames().contains(&number) {
            let (first, last) = (self.starts[0], self.end() - 1);
            let message = format!("no frame {number}, there are {first} to {last}");
            return Err(Error::file(&self.files.parts[0], message));
        }
        let k = self.starts.partition_point(|&start| start <= number) - 1;
        let part = match self.loaded.take() {
            Some((loaded, part)) if loaded == k => part,
            _ => self.read_part(k)?,
        };
        let (_, part) = self.loaded.insert((k, part));
        Ok(&part.frames[(number - self.starts[k]) as usize])
    }

    fn of_one(path: &Path) -> Result<Sequence> {
        let Start { scene, walls, frame, claimed } = Start::read(path)?;
        Ok(Sequence {
            files: SequenceFiles { name: scene.clone(), parts: vec![path.to_path_buf()] },
            scene,
            walls,
            particles: frame.position.len(),
            starts: vec![frame.number, frame.number + claimed],
            loaded: None,
        })
    }

    fn end(&self) -> u64 {
        self.starts[self.starts.len() - 1]
    }
}

/// The beginning of a part file.
struct Start {
    scene: String,
    walls: Boundary,
    frame: Frame,
    /// The number of frames that the file claims to have.
    claimed: u64,
}

impl Start {
    fn read(path: &Path) -> Result<Start> {
        let (file, length) = open_part(path)?;
        let wrong = |message| Error::file(path, message);
        let mut reader = PartReader::new(file, length).map_err(wrong)?;
        let claimed = reader.claimed();
        let frame = reader.next().map_err(wrong)?.ok_or_else(|| wrong("no frames".into()))?;
        let (scene, walls) = reader.finish();
        Ok(Start { scene, walls, frame, claimed })
    }
}

/// All sequences whose parts lie in `folder`, by name.
fn list(folder: &Path) -> Result<Vec<SequenceFiles>> {
    let mut parts: BTreeMap<String, BTreeMap<u64, PathBuf>> = BTreeMap::new();
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        let file_name = entry.map_err(Error::io(folder))?.file_name();
        if let Some((name, number)) = file_name.to_str().and_then(part_name) {
            parts.entry(name.to_owned()).or_default().insert(number, folder.join(&file_name));
        }
    }
    let files =
        parts.into_iter().map(|(name, parts)| SequenceFiles { name, parts: parts.into_values().collect() });
    Ok(files.collect())
}

/// The name of part `number` of a sequence: two digits, more where they are needed.
pub fn part_file_name(name: &str, number: u64) -> String {
    format!("{name}_{number:02}{EXTENSION}")
}

/// The sequence and the number that a file name stands for.
fn part_name(file_name: &str) -> Option<(&str, u64)> {
    let (name, digits) = file_name.strip_suffix(EXTENSION)?.rsplit_once('_')?;
    let number = digits.parse().ok()?;
    (!name.is_empty() && file_name == part_file_name(name, number)).then_some((name, number))
}

/// Why a folder of several sequences is not one.
fn several(found: &[SequenceFiles]) -> String {
    /// Enough to see what the folder holds.
    const SHOWN: usize = 6;
    let names: Vec<&str> = found.iter().take(SHOWN).map(|files| files.name.as_str()).collect();
    let more = if found.len() > SHOWN { ", ..." } else { "" };
    format!("{} sequences ({}{more}), expected one: name it as FOLDER/NAME", found.len(), names.join(", "))
}

fn open_part(path: &Path) -> Result<(BufReader<File>, u64)> {
    let file = File::open(path).map_err(Error::io(path))?;
    let length = file.metadata().map_err(Error::io(path))?.len();
    Ok((BufReader::new(file), length))
}

fn read_all(source: impl Read, length: u64) -> std::result::Result<Part, String> {
    let mut reader = PartReader::new(source, length)?;
    let mut frames = Vec::new();
    while let Some(frame) = reader.next()? {
        frames.push(frame);
    }
    let (scene, walls) = reader.finish();
    Ok(Part { scene, walls, frames })
}

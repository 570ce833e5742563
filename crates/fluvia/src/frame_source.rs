//! Where frames come from: the directory of a run, or a sequence of a data set.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use fluvia_sim::Error;
use fluvia_sim::frames::sequence::Frame;
use fluvia_sim::frames::{self, ParticleData, Sequence, run, sequence};
use fluvia_sim::scene::{DEFAULT_DT, DEFAULT_GRAVITY, DEFAULT_PARTICLE_RADIUS, Material, Scene};

use crate::options::labelled;
use crate::record::{Record, decimal};

/// Frames on disk, read one at a time, with what is known of the scene.
pub struct FrameSource {
    path: PathBuf,
    /// In their order; at least one.
    numbers: Vec<u64>,
    walls: ParticleData,
    /// Seconds between frames.
    pub dt: f64,
    /// Metres.
    pub particle_radius: f32,
    /// Metres per second squared.
    pub gravity: [f32; 3],
    /// Whether the radius is known, and not the usual one for want of a record.
    radius_is_recorded: bool,
    kind: Kind,
}

/// What holds the frames.
enum Kind {
    /// The directory of a run, with its record if it has one.
    Run(Option<Box<Record>>),
    Sequence(Box<Sequence>),
}

impl FrameSource {
    /// Opens `FRAMES` or `LABEL=FRAMES`; gives the label, which is the text without one.
    pub fn open_labelled(text: &str, dt: Option<f32>) -> Result<(String, FrameSource)> {
        let (label, path) = labelled(text);
        Ok((label.to_owned(), FrameSource::open(path, dt)?))
    }

    /// Opens the directory of a run, or a sequence: its folder, one of its parts, or the common prefix of its parts.
    /// `dt` counts where none is recorded; [`DEFAULT_DT`] if it is not given.
    pub fn open(path: &Path, dt: Option<f32>) -> Result<FrameSource> {
        let mut numbers: Vec<u64> = match path.is_dir() {
            true => run::list(path)?.into_iter().map(|frame| frame.index).collect(),
            false => Vec::new(),
        };
        numbers.dedup();
        let dt = dt.unwrap_or(DEFAULT_DT);
        if numbers.is_empty() {
            return FrameSource::of_sequence(path, dt);
        }
        let record_path = path.join(run::RECORD);
        let record: Option<Record> =
            if record_path.exists() { Some(frames::read_json(&record_path)?) } else { None };
        let (dt, particle_radius, gravity) =
            record.as_ref().map_or((dt, DEFAULT_PARTICLE_RADIUS, DEFAULT_GRAVITY), |record| {
                (record.dt, record.particle_radius, record.gravity)
            });
        for (key, value) in [("dt", dt), ("particle_radius", particle_radius)] {
            if !(value > 0.0 && value.is_finite()) {
                bail!("{}: `{key}`: {value}, expected a positive number", record_path.display());
            }
        }
        let radius_is_recorded = record.is_some();
        let walls = run::read_walls(path)?.unwrap_or_default();
        let (path, dt, kind) = (path.to_path_buf(), decimal(dt), Kind::Run(record.map(Box::new)));
        Ok(FrameSource { path, numbers, walls, dt, particle_radius, gravity, radius_is_recorded, kind })
    }

    fn of_sequence(path: &Path, dt: f32) -> Result<FrameSource> {
        if path.exists() && sequence::find(path)?.is_empty() {
            bail!("{}: {NO_FRAMES}", path.display());
        }
        let sequence = Sequence::open(path)?;
        let (position, normal) = (sequence.walls().position.clone(), sequence.walls().normal.clone());
        let scene = recorded_scene(&sequence)?;
        let scene = scene.as_ref();
        Ok(FrameSource {
            path: path.to_path_buf(),
            numbers: sequence.frames().collect(),
            walls: ParticleData { position, normal: Some(normal), ..ParticleData::default() },
            dt: decimal(scene.map_or(dt, |scene| scene.dt.unwrap_or(DEFAULT_DT))),
            particle_radius: scene.and_then(|scene| scene.particle_radius).unwrap_or(DEFAULT_PARTICLE_RADIUS),
            gravity: scene.and_then(|scene| scene.gravity).unwrap_or(DEFAULT_GRAVITY),
            radius_is_recorded: scene.is_some(),
            kind: Kind::Sequence(Box::new(sequence)),
        })
    }

    /// What was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Takes the particles for ones of `radius`, metres, where that is not recorded.
    pub fn assume_radius(&mut self, radius: Option<f32>) {
        if !self.radius_is_recorded {
            self.particle_radius = radius.unwrap_or(self.particle_radius);
        }
    }

    /// The numbers of the frames, in their order.
    pub fn numbers(&self) -> &[u64] {
        &self.numbers
    }

    /// The walls; empty if there are none on disk.
    pub fn walls(&self) -> &ParticleData {
        &self.walls
    }

    /// What is known of a run, if this is one.
    pub fn record(&self) -> Option<&Record> {
        match &self.kind {
            Kind::Run(record) => record.as_deref(),
            Kind::Sequence(_) => None,
        }
    }

    /// A frame of a sequence with all that it holds; `None` if this is none.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn frame_of_sequence(&mut self, number: u64) -> fluvia_sim::Result<Option<&Frame>> {
        match &mut self.kind {
            Kind::Run(_) => Ok(None),
            Kind::Sequence(sequence) => sequence.frame(number).map(Some),
        }
    }

    /// Gives the memory back of what is kept for the next frame.
    pub fn unload(&mut self) {
        if let Kind::Sequence(sequence) = &mut self.kind {
            sequence.unload();
        }
    }

    /// Reads a frame. Of a sequence the part that it is in is kept for the next.
    ///
    /// # Errors
    /// If there is no such frame, or it cannot be read.
    pub fn read(&mut self, number: u64) -> fluvia_sim::Result<ParticleData> {
        if self.numbers.binary_search(&number).is_err() {
            let (first, last) = (self.numbers[0], self.numbers[self.numbers.len() - 1]);
            return Err(Error::file(&self.path, format!("no frame {number}, there are {first} to {last}")));
        }
        match &mut self.kind {
            Kind::Run(_) => run::read_frame(&self.path, number),
            Kind::Sequence(sequence) => {
                let frame = sequence.frame(number)?;
                let (position, velocity) = (frame.position.clone(), frame.velocity.clone());
                Ok(ParticleData { position, velocity: Some(velocity), ..ParticleData::default() })
            }
        }
    }
}

/// Why something that is there holds no frames.
pub const NO_FRAMES: &str = "no frames, expected the directory of a run with fluid_0000.npz or the like, or a sequence \
                             (NAME_00.msgpack.zst)";

/// The material of each particle, as the frames of sequences have it.
pub fn stored_materials(frame: &Frame, particle_radius: f32) -> impl Iterator<Item = Material> {
    let kilogram = sequence::stored_mass(1.0, particle_radius);
    frame.viscosity.iter().zip(&frame.mass).map(move |(&viscosity, &mass)| {
        // Masses are float32: whole kilograms per cubic metre are what they can tell.
        let density = (mass / kilogram).round();
        Material { viscosity: Some(viscosity), density: Some(density) }
    })
}

/// The scene that a sequence was made from, where `fluvia generate` has left its record beside the parts.
pub fn recorded_scene(sequence: &Sequence) -> Result<Option<Scene>> {
    sequence.parts().first().map_or(Ok(None), |part| recorded_beside(part, sequence.name()))
}

/// The same of the sequence of that name, one of whose parts is `part`.
pub fn recorded_beside(part: &Path, name: &str) -> Result<Option<Scene>> {
    let path = part.with_file_name(format!("{name}.json"));
    if !path.exists() {
        return Ok(None);
    }
    let record: serde_json::Value = frames::read_json(&path)?;
    let Some(scene) = record.get("scene") else { return Ok(None) };
    Ok(Some(Scene::parse(scene.to_string().as_bytes(), &path)?))
}

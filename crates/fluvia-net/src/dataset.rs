//! Training data: windows of successive frames from the sequences of a data set, in an order that depends on a seed
//! alone, as batches of clouds.
//!
//! ```text
//! DataSet   the parts of all sequences in a folder, and how many windows each has
//! Order     position in the stream of windows -> part and first frame   (dataset/order.rs)
//! Loader    a thread that reads and decompresses ahead, bounded          (dataset/loader.rs)
//! Batch     clouds one behind the other: starts, true states, walls
//! ```
//!
//! A window of K + 1 frames starts K steps of the network. It does not reach from one part into the next, as in the
//! published reader.

use std::path::{Path, PathBuf};

use fluvia_neighbors::Point;
use fluvia_sim::frames::sequence::{self, Part, Sequence};
use fluvia_sim::particles::Acceleration;

use crate::config::Config;
use crate::integrate::State;
use crate::loss::Surroundings;
use crate::net::{Network, Walls};
use crate::step::World;
use crate::{Error, Result};

mod free;
mod loader;
mod noise;
mod order;
mod rotation;

pub use free::FreeFall;
pub use loader::{Damaged, Loaded, Loader, Sampling};
pub use noise::Noise;
pub use order::Order;
pub use rotation::Rotation;

/// The parts of a data set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DataSet {
    parts: Vec<PartFile>,
}

/// A part file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PartFile {
    /// Where it is.
    pub path: PathBuf,
    /// The name of its sequence.
    pub sequence: String,
    /// The number of its first frame.
    pub first: u64,
    /// How many frames it has.
    pub frames: usize,
}

impl PartFile {
    /// Reads it.
    ///
    /// # Errors
    /// As [`sequence::read_part`]; `File` if it has changed since it was found.
    pub fn read(&self) -> Result<Part> {
        let part = sequence::read_part(&self.path)?;
        if (part.frames[0].number, part.frames.len()) != (self.first, self.frames) {
            return Err(Error::file(&self.path, "has changed since it was opened"));
        }
        Ok(part)
    }
}

impl DataSet {
    /// The sequences in some folders, in each by name. Of each part the first frame is read.
    ///
    /// # Errors
    /// `Io`; `File` if a folder has no sequence, or one is damaged at its beginning.
    pub fn open(folders: &[impl AsRef<Path>]) -> Result<DataSet> {
        let mut found = Vec::new();
        for folder in folders {
            let of_folder = sequence::find(folder.as_ref())?;
            if of_folder.is_empty() {
                let message = format!("no sequence, expected files named NAME_00{}", sequence::EXTENSION);
                return Err(Error::file(folder, message));
            }
            found.extend(of_folder);
        }
        let mut parts = Vec::new();
        for files in found {
            let sequence = Sequence::of(files)?;
            let mut starts: Vec<u64> = sequence.starts().to_vec();
            starts.push(sequence.frames().end);
            parts.extend(sequence.parts().iter().zip(starts.windows(2)).map(|(path, start)| PartFile {
                path: path.clone(),
                sequence: sequence.name().to_owned(),
                first: start[0],
                frames: (start[1] - start[0]) as usize,
            }));
        }
        Ok(DataSet { parts })
    }

    /// The parts, in the order of the folders and of the names of sequences.
    pub fn parts(&self) -> &[PartFile] {
        &self.parts
    }

    /// Makes sure that there is a window of `frames` frames.
    ///
    /// # Errors
    /// `File` if all parts are shorter.
    pub fn check_windows(&self, frames: usize) -> Result<()> {
        if self.parts.iter().any(|part| part.frames >= frames) {
            return Ok(());
        }
        let folder = self.parts.first().and_then(|part| part.path.parent()).unwrap_or(Path::new(""));
        let longest = self.parts.iter().map(|part| part.frames).max().unwrap_or_default();
        let message =
            format!("parts of at most {longest} frames, expected one of {frames} or more for a window");
        Err(Error::file(folder, message))
    }

    /// The windows of `frames` frames in each part.
    pub fn windows(&self, frames: usize) -> Vec<usize> {
        self.parts.iter().map(|part| (part.frames + 1).saturating_sub(frames)).collect()
    }
}

/// Windows of several scenes as one set of clouds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// The states that the windows start from.
    pub start: State,
    /// The steps from there that count for nothing: the network's own states are what it starts from then.
    pub lead: usize,
    /// How many of the particles, the last, are of no window.
    pub free: usize,
    /// The true states after each step, those of the lead included.
    pub truth: Vec<State>,
    /// The extra inputs of each particle, [particles, extra inputs].
    pub extra: Vec<f32>,
    /// Where the particles of each cloud start: clouds + 1 entries.
    pub clouds: Vec<usize>,
    /// Wall particles near the fluid, metres.
    pub wall_position: Vec<Point>,
    /// Their normals.
    pub wall_normal: Vec<Point>,
    /// Where the wall particles of each cloud start.
    pub wall_clouds: Vec<usize>,
}

impl Batch {
    /// No clouds; windows of so many steps after the lead.
    pub fn new(steps: usize, lead: usize) -> Batch {
        Batch {
            lead,
            truth: vec![State::default(); lead + steps],
            clouds: vec![0],
            wall_clouds: vec![0],
            ..Batch::default()
        }
    }

    /// Particles of windows, each as often as it has steps that count.
    pub fn samples(&self) -> u64 {
        ((self.start.position.len() - self.free) * (self.truth.len() - self.lead)) as u64
    }

    /// The particles' extra inputs and clouds, in a world with this gravity.
    pub fn world(&self, gravity: Point) -> World<'_> {
        let acceleration = Acceleration::Uniform(gravity);
        World { extra: &self.extra, acceleration, clouds: &self.clouds }
    }

    /// What a loss knows of it.
    pub fn surroundings<'a>(&'a self, config: &'a Config) -> Surroundings<'a> {
        let Batch { clouds, wall_position, wall_normal, wall_clouds, .. } = self;
        Surroundings { clouds, wall_position, wall_normal, wall_clouds, config }
    }

    /// The wall particles, for a network.
    pub fn walls(&self, network: &Network) -> Walls {
        network.walls(&self.wall_position, &self.wall_normal, &self.wall_clouds)
    }

    /// Adds the window that begins with frame `first` of a part, counted from 0, turned by `rotation`. Each particle gets
    /// its viscosity as an extra input if `viscosity` is set. Wall particles farther than `reach` from all that the fluid
    /// is in the window are left out, metres.
    ///
    /// # Panics
    /// If the window does not lie in the part.
    pub fn push(&mut self, part: &Part, first: usize, rotation: &Rotation, viscosity: bool, reach: f32) {
        let states = std::iter::once(&mut self.start).chain(&mut self.truth);
        for (state, frame) in states.zip(&part.frames[first..]) {
            state.position.extend(frame.position.iter().map(|&x| rotation.of(x)));
            state.velocity.extend(frame.velocity.iter().map(|&v| rotation.of(v)));
        }
        let frame = &part.frames[first];
        if viscosity {
            self.extra.extend(&frame.viscosity);
        }
        self.clouds.push(self.start.position.len());
        let window = &part.frames[first..=first + self.truth.len()];
        let near = near_fluid(window.iter().map(|frame| frame.position.as_slice()), reach);
        let walls = part.walls.position.iter().zip(&part.walls.normal);
        for (&x, &normal) in walls.filter(|(x, _)| near(**x)) {
            self.wall_position.push(rotation.of(x));
            self.wall_normal.push(rotation.of(normal));
        }
        self.wall_clouds.push(self.wall_position.len());
    }
}

/// Whether a point is within `reach` of the bounding box of all these points.
fn near_fluid<'a>(frames: impl Iterator<Item = &'a [Point]>, reach: f32) -> impl Fn(Point) -> bool {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for x in frames.flatten() {
        for axis in 0..3 {
            low[axis] = low[axis].min(x[axis] - reach);
            high[axis] = high[axis].max(x[axis] + reach);
        }
    }
    move |x| (0..3).all(|axis| low[axis] <= x[axis] && x[axis] <= high[axis])
}

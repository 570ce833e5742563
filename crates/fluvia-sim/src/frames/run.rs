//! The directory of a run: `box.*`, `fluid_0000.*`, `fluid.pvd`, `run.json`, `state.npz`.
//!
//! ```text
//! open -> write_walls, write_record -> write_frame(0), write_state -> write_frame(1), write_state -> ...
//! ```
//!
//! A killed run leaves whole frames and a state that names the last of them. A run that fails before its first frame is
//! complete leaves nothing: what it wrote and the directories it made are removed when the [`RunDirectory`] is dropped.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::atomic::target_of;
use super::{Format, ParticleData, State, read, vtu, write_atomically, write_fluid, write_json, write_walls};
use crate::particles::{Boundary, Particles};
use crate::{Error, Result};

/// What is known of the run.
pub const RECORD: &str = "run.json";
/// The state to resume from.
pub const STATE: &str = "state.npz";
/// The index of the `vtu` frames for ParaView.
pub const INDEX: &str = "fluid.pvd";

/// How a run treats what its directory holds already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// It must hold no run.
    New,
    /// The files of the old run, and only those, are removed when the new one writes its first.
    Overwrite,
    /// The run goes on from its state file.
    Resume,
}

/// A frame on disk.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameFile {
    /// The number of the frame.
    pub index: u64,
    /// Its format.
    pub format: Format,
    /// The file.
    pub path: PathBuf,
}

/// The frames in a directory, by index and then by format.
///
/// # Errors
/// `Io`.
pub fn list(directory: &Path) -> Result<Vec<FrameFile>> {
    let mut frames: Vec<FrameFile> = file_names(directory)?
        .iter()
        .filter_map(|name| {
            let (index, format) = frame_of(name)?;
            Some(FrameFile { index, format, path: directory.join(name) })
        })
        .collect();
    frames.sort();
    Ok(frames)
}

/// Reads frame `index` of a directory; of several formats the first of [`Format::ALL`].
///
/// # Errors
/// `File` if there is none; as [`read`].
pub fn read_frame(directory: &Path, index: u64) -> Result<ParticleData> {
    let paths = Format::ALL.map(|format| directory.join(frame_name(index, format)));
    match paths.iter().find(|path| path.exists()) {
        Some(path) => read(path),
        None => Err(Error::file(
            directory,
            format!("no frame {index}, expected {}", frame_name(index, Format::Npz)),
        )),
    }
}

/// Reads the walls of a directory; `None` if it has none.
///
/// # Errors
/// As [`read`].
pub fn read_walls(directory: &Path) -> Result<Option<ParticleData>> {
    let paths = Format::ALL.map(|format| directory.join(walls_name(format)));
    paths.iter().find(|path| path.exists()).map(|path| read(path)).transpose()
}

/// The directory that a run writes to.
#[derive(Debug)]
pub struct RunDirectory {
    path: PathBuf,
    formats: Vec<Format>,
    /// Seconds between frames.
    dt: f64,
    /// The outermost directory that was made for this run, and those in it.
    made: Vec<PathBuf>,
    /// Files of an old run that are to be removed.
    old: Vec<PathBuf>,
    /// What was written before the first frame was complete.
    unfinished: Vec<PathBuf>,
    has_frame: bool,
    /// The frames that the index lists.
    indexed: BTreeSet<u64>,
}

impl RunDirectory {
    /// Opens a directory for a run that writes `formats`, with `dt` seconds between frames; makes it where it does
    /// not exist, and makes sure that files can be written there.
    ///
    /// # Errors
    /// `Io` if it cannot be written; `File` if a new run would mix with an old one, or if there is no state to resume
    /// from.
    pub fn open(path: &Path, mode: Mode, formats: &[Format], dt: f32) -> Result<RunDirectory> {
        let names = if path.exists() { file_names(path)? } else { BTreeSet::new() };
        if mode == Mode::Resume && !names.contains(STATE) {
            return Err(Error::file(path, format!("no {STATE} to resume from")));
        }
        let (abandoned, own): (Vec<&String>, Vec<&String>) =
            own_files(&names, formats).into_iter().partition(|name| is_temporary(name));
        if let (Mode::New, Some(name)) = (mode, own.first()) {
            let message = format!("holds a run already ({name}), expected --resume or --overwrite");
            return Err(Error::file(path, message));
        }
        let mut old: Vec<PathBuf> = abandoned.into_iter().map(|name| path.join(name)).collect();
        if mode == Mode::Overwrite {
            old.extend(own.into_iter().map(|name| path.join(name)));
        }
        let indexed = match mode {
            Mode::Resume => {
                names.iter().filter_map(|name| frame_of(name)).filter(is_vtu).map(|(k, _)| k).collect()
            }
            Mode::New | Mode::Overwrite => BTreeSet::new(),
        };
        let mut run = RunDirectory {
            path: path.to_path_buf(),
            formats: formats.to_vec(),
            // The decimal number that was meant, not the nearest f32: times read 0.06 and not 0.0599999986.
            dt: dt.to_string().parse().unwrap_or(f64::from(dt)),
            made: Vec::new(),
            old,
            unfinished: Vec::new(),
            has_frame: mode == Mode::Resume,
            indexed,
        };
        run.make_directories()?;
        run.check_writable()?;
        if mode == Mode::Resume {
            // What killed processes left, now: there may be nothing more to write.
            run.remove_old()?;
        }
        Ok(run)
    }

    /// The directory.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the walls, `box.*`.
    ///
    /// # Errors
    /// As [`write_walls`].
    pub fn write_walls(&mut self, walls: &Boundary) -> Result<()> {
        for format in self.formats.clone() {
            let path = self.begin(&walls_name(format))?;
            write_walls(&path, format, walls)?;
        }
        Ok(())
    }

    /// Writes what is known of the run, `run.json`.
    ///
    /// # Errors
    /// `Io`.
    pub fn write_record(&mut self, record: &impl Serialize) -> Result<()> {
        let path = self.begin(RECORD)?;
        write_json(&path, record)
    }

    /// Writes frame `index` in every format, and the index for ParaView if `vtu` is one of them. If one of them
    /// fails the frame is there in none.
    ///
    /// # Errors
    /// As [`write_fluid`].
    pub fn write_frame(&mut self, index: u64, particles: &Particles) -> Result<()> {
        let written = self.write_frame_files(index, particles);
        if written.is_err() {
            self.indexed.remove(&index);
            for format in &self.formats {
                // The first error is the one to report.
                let _ = fs::remove_file(self.path.join(frame_name(index, *format)));
            }
            return written;
        }
        self.has_frame = true;
        self.unfinished.clear();
        Ok(())
    }

    /// Writes the state, after the frame of its step.
    ///
    /// # Errors
    /// As [`State::save`].
    pub fn write_state(&mut self, state: &State) -> Result<()> {
        let path = self.begin(STATE)?;
        state.save(&path)
    }

    /// Reads the state to resume from.
    ///
    /// # Errors
    /// As [`State::load`].
    pub fn read_state(&self) -> Result<State> {
        State::load(&self.path.join(STATE))
    }

    /// The frames on disk, by index and then by format.
    ///
    /// # Errors
    /// `Io`.
    pub fn frames(&self) -> Result<Vec<FrameFile>> {
        list(&self.path)
    }

    /// Reads a frame.
    ///
    /// # Errors
    /// As [`read_frame`].
    pub fn read_frame(&self, index: u64) -> Result<ParticleData> {
        read_frame(&self.path, index)
    }

    fn write_frame_files(&mut self, index: u64, particles: &Particles) -> Result<()> {
        for format in self.formats.clone() {
            let path = self.begin(&frame_name(index, format))?;
            write_fluid(&path, format, particles)?;
        }
        if self.formats.contains(&Format::Vtu) {
            self.indexed.insert(index);
            let path = self.begin(INDEX)?;
            let frames = self.indexed.iter().map(|&k| (k as f64 * self.dt, frame_name(k, Format::Vtu)));
            write_atomically(&path, |out| vtu::write_index(frames, out))?;
        }
        Ok(())
    }

    fn remove_old(&mut self) -> Result<()> {
        // The state goes first: what is left of a run that is half removed must not look as if it could be resumed.
        self.old.sort_by_key(|path| !path.ends_with(STATE));
        self.old.drain(..).try_for_each(|path| remove_file(&path))
    }

    /// Removes the old run before the first file of this one; gives the path of `name`.
    fn begin(&mut self, name: &str) -> Result<PathBuf> {
        self.remove_old()?;
        let path = self.path.join(name);
        if !self.has_frame {
            self.unfinished.push(path.clone());
        }
        Ok(path)
    }

    fn make_directories(&mut self) -> Result<()> {
        let missing: Vec<&Path> =
            self.path.ancestors().take_while(|path| !path.as_os_str().is_empty() && !path.exists()).collect();
        let missing: Vec<PathBuf> = missing.into_iter().rev().map(Path::to_path_buf).collect();
        for path in missing {
            match fs::create_dir(&path) {
                Ok(()) => self.made.push(path),
                // Another process was first; it is not ours to remove.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(Error::io(&path)(error)),
            }
        }
        Ok(())
    }

    fn check_writable(&self) -> Result<()> {
        let path = self.path.join(WRITE_CHECK);
        let written = write_atomically(&path, |_| Ok(())).and_then(|()| remove_file(&path));
        // What the user named is the directory, not the file that this tries.
        written.map_err(|error| match error {
            Error::Io { source, .. } => Error::io(&self.path)(source),
            other => other,
        })
    }
}

impl Drop for RunDirectory {
    fn drop(&mut self) {
        if self.has_frame {
            return;
        }
        // The run has failed and says why; what cannot be removed now stays.
        for path in &self.unfinished {
            let _ = fs::remove_file(path);
        }
        for path in self.made.iter().rev() {
            let _ = fs::remove_dir(path);
        }
    }
}

/// The name of the file that is written and removed to see whether a directory can be written.
const WRITE_CHECK: &str = ".fluvia-write-check";

/// Frames are numbered with at least this many digits.
const DIGITS: usize = 4;

fn frame_name(index: u64, format: Format) -> String {
    format!("fluid_{index:0DIGITS$}.{format}")
}

fn walls_name(format: Format) -> String {
    format!("box.{format}")
}

/// The frame and format that a file name stands for.
fn frame_of(name: &str) -> Option<(u64, Format)> {
    let (digits, extension) = name.strip_prefix("fluid_")?.split_once('.')?;
    let format = extension.parse().ok()?;
    let index = digits.parse().ok()?;
    (name == frame_name(index, format)).then_some((index, format))
}

fn is_vtu(frame: &(u64, Format)) -> bool {
    frame.1 == Format::Vtu
}

/// The files of a run among `names`. Walls are in the formats of its frames or in those about to be written: a
/// `box.ply` of somebody else beside npz frames is left alone.
fn own_files<'a>(names: &'a BTreeSet<String>, formats: &[Format]) -> Vec<&'a String> {
    let frames: BTreeSet<Format> =
        names.iter().filter_map(|name| frame_of(name)).map(|(_, format)| format).collect();
    let is_walls = |name: &str| {
        Format::ALL.into_iter().any(|format| {
            name == walls_name(format) && (frames.contains(&format) || formats.contains(&format))
        })
    };
    let is_own = |name: &str| {
        [RECORD, STATE, INDEX].contains(&name)
            || frame_of(name).is_some()
            || is_walls(name)
            || is_temporary(name)
    };
    names.iter().filter(|name| is_own(name)).collect()
}

/// Whether `name` is that of a file of a run that was being written when the process was killed.
fn is_temporary(name: &str) -> bool {
    if name == WRITE_CHECK {
        return true;
    }
    target_of(name).is_some_and(|target| {
        [RECORD, STATE, INDEX, WRITE_CHECK].contains(&target)
            || frame_of(target).is_some()
            || Format::ALL.into_iter().any(|format| target == walls_name(format))
    })
}

/// The names in a directory that are text; ours are.
fn file_names(directory: &Path) -> Result<BTreeSet<String>> {
    let entries = fs::read_dir(directory).map_err(Error::io(directory))?;
    let mut names = BTreeSet::new();
    for entry in entries {
        let name = entry.map_err(Error::io(directory))?.file_name();
        names.extend(name.into_string());
    }
    Ok(names)
}

fn remove_file(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(Error::io(path)(error)),
        _ => Ok(()),
    }
}

//! Recordings: what runs as the directory of a run, or two.
//!
//! The stage writes frames; the main thread ends a recording when the program is to stop. Both go through one lock, so that a
//! frame is on disk whole or not at all.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_sim::frames::{Format, Mode, RunDirectory};
use fluvia_sim::rollout::Rollout;
use fluvia_sim::scene::Setup;

use super::menu::Offer;
use super::panel::Panel;
use crate::record::{self, Change, Live, Record, Source, Summary};

/// Where recordings go if nothing else is said.
const DIRECTORY: &str = "out/view";

/// Recordings of a name are numbered up to this.
const MOST_RECORDINGS: u32 = 9999;

/// Writes frames while there is a recording.
pub struct Recorder {
    folder: PathBuf,
    formats: Vec<Format>,
    desk: Mutex<Desk>,
}

/// What those that write and end recordings take turns at.
#[derive(Default)]
struct Desk {
    running: Option<Recording>,
    /// Whether the program ends: none begins any more, for nobody would end it.
    is_closed: bool,
}

/// What is recorded, and from what.
pub struct Subject<'a> {
    /// The name of the scene.
    pub title: &'a str,
    pub scene: &'a Source,
    pub seed: u64,
    pub setup: &'a Setup,
    pub kernel: Kernel,
}

/// One run a panel.
struct Recording(Vec<Run>);

struct Run {
    directory: RunDirectory,
    record: Record,
    /// As of the last frame; none before the first.
    summary: Option<Summary>,
}

impl Recorder {
    pub fn new(folder: Option<&Path>, formats: &[Format]) -> Recorder {
        let mut formats = formats.to_vec();
        formats.sort_by_key(|format| format.extension());
        formats.dedup();
        if formats.is_empty() {
            formats.push(Format::Npz);
        }
        let folder = folder.unwrap_or(Path::new(DIRECTORY)).to_path_buf();
        Recorder { folder, formats, desk: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Desk> {
        // What is on disk is whole, whoever has failed.
        self.desk.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The directories of the recording that runs.
    pub fn directories(&self) -> Option<Vec<String>> {
        let name = |run: &Run| run.directory.path().display().to_string();
        self.lock().running.as_ref().map(|recording| recording.0.iter().map(name).collect())
    }

    /// Begins a recording with what the panels are now, a directory each.
    ///
    /// # Errors
    /// If a directory cannot be made or written to, or the program ends.
    pub fn start(&self, subject: &Subject<'_>, panels: &[(&Panel, &Offer)]) -> Result<()> {
        let mut desk = self.lock();
        if desk.is_closed {
            bail!("the program ends");
        }
        let number = self.free_number(subject.title)?;
        let mut runs = Vec::new();
        for (panel, offer) in panels {
            let solver = Path::new(&offer.name).file_stem().unwrap_or_default().display();
            let name = match panels.len() {
                1 => format!("{}-{number:03}", subject.title),
                _ => format!("{}-{number:03}-{}-{solver}", subject.title, runs.len() + 1),
            };
            let path = self.folder.join(name);
            let mut directory = RunDirectory::open(&path, Mode::New, &self.formats, subject.setup.dt)?;
            let record = self.record(subject, offer, &panel.rollout);
            directory.write_record(&record)?;
            directory.write_walls(&subject.setup.boundary)?;
            runs.push(Run { directory, record, summary: None });
        }
        let mut recording = Recording(runs);
        recording.write(panels.iter().map(|(panel, _)| *panel))?;
        desk.running = Some(recording);
        Ok(())
    }

    /// The first number for which nothing is there.
    fn free_number(&self, title: &str) -> Result<u32> {
        let names: Vec<String> = match std::fs::read_dir(&self.folder) {
            Ok(entries) => entries.flatten().map(|entry| entry.file_name().display().to_string()).collect(),
            Err(_) => Vec::new(),
        };
        let is_free = |number: &u32| {
            let name = format!("{title}-{number:03}");
            names.iter().all(|taken| *taken != name && !taken.starts_with(&format!("{name}-")))
        };
        (1..=MOST_RECORDINGS).find(is_free).with_context(|| {
            format!("{}: {MOST_RECORDINGS} recordings of {title} already", self.folder.display())
        })
    }

    fn record(&self, subject: &Subject<'_>, offer: &Offer, rollout: &Rollout) -> Record {
        let setup = subject.setup;
        // Frame 0 is no state that the scene begins with: the recording is never taken for a run of the scene.
        let particles = [record::hash_particles(setup), record::hash_state(rollout.state())].concat();
        Record {
            version: env!("CARGO_PKG_VERSION").into(),
            scene: subject.scene.clone(),
            weights: offer.weights.clone(),
            particles_sha256: record::sha256(particles.as_bytes()),
            seed: subject.seed,
            solver: offer.choice.name().into(),
            parameters: offer.choice.parameters(),
            kernel: offer.choice.kernel_name(subject.kernel).into(),
            earlier: Vec::new(),
            threads: rayon::current_num_threads(),
            formats: self.formats.iter().map(|format| format.extension().into()).collect(),
            dt: setup.dt,
            particle_radius: setup.particle_radius,
            gravity: setup.gravity,
            steps: 0,
            live: Some(Live { first_step: rollout.state().step, changes: Vec::new() }),
            summary: None,
        }
    }

    /// Writes a frame of the panels, if there is a recording.
    ///
    /// # Errors
    /// If it cannot be written: the recording has ended then, with the frames before.
    pub fn write<'a>(&self, panels: impl Iterator<Item = &'a Panel>) -> Result<()> {
        let mut desk = self.lock();
        let Some(recording) = desk.running.as_mut() else { return Ok(()) };
        let written = recording.write(panels);
        if written.is_err() {
            let ended = desk.running.take();
            // The first error is the one to report.
            let _ = ended.map(Recording::finish);
        }
        written
    }

    /// Notes something that was changed. Of changes to one thing, whose texts all begin with it, the last before a frame
    /// counts, as where a slider is drawn.
    pub fn note(&self, what: &str, thing: Option<&str>) {
        for run in self.lock().running.iter_mut().flat_map(|recording| &mut recording.0) {
            let frame = run.record.steps;
            if let Some(live) = &mut run.record.live {
                let stays = |change: &Change| {
                    change.frame != frame || thing.is_none_or(|thing| !change.what.starts_with(thing))
                };
                live.changes.retain(stays);
                live.changes.push(Change { frame, what: what.to_owned() });
            }
        }
    }

    /// Ends the recording, if there is one; gives its directories and how many frames they hold.
    ///
    /// # Errors
    /// If the record of a run cannot be written; the frames are there.
    pub fn finish(&self) -> Result<Vec<(PathBuf, usize)>> {
        let ended = self.lock().running.take();
        ended.map_or(Ok(Vec::new()), Recording::finish)
    }

    /// The same for good.
    ///
    /// # Errors
    /// As [`Recorder::finish`].
    pub fn close(&self) -> Result<Vec<(PathBuf, usize)>> {
        self.lock().is_closed = true;
        self.finish()
    }
}

impl Recording {
    /// A frame of every panel; one that stands still after an error has had its last.
    fn write<'a>(&mut self, panels: impl Iterator<Item = &'a Panel>) -> Result<()> {
        for (run, panel) in self.0.iter_mut().zip(panels).filter(|(_, panel)| panel.error.is_none()) {
            let next = run.summary.as_ref().map_or(0, |summary| summary.steps + 1);
            run.directory.write_frame(next, &panel.rollout.state().particles)?;
            run.record.steps = next;
            run.summary =
                Some(Summary { steps: next, ..Summary::new(panel.rollout.state(), panel.ms_per_step) });
        }
        Ok(())
    }

    fn finish(self) -> Result<Vec<(PathBuf, usize)>> {
        let mut ended = Vec::new();
        for mut run in self.0.into_iter().filter(|run| run.summary.is_some()) {
            run.record.summary = run.summary;
            run.directory.write_record(&run.record)?;
            ended.push((run.directory.path().to_path_buf(), run.record.steps as usize + 1));
        }
        Ok(ended)
    }
}

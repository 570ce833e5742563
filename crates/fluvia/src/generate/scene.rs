//! One scene of a data set: drawn, simulated, written part by part, and recorded.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_sim::frames::sequence::{Frame, Part, stored_mass, write_part};
use fluvia_sim::frames::{self, Format, State};
use fluvia_sim::kernel::{CubicSpline, SUPPORT_IN_RADII, wall_volumes};
use fluvia_sim::metrics;
use fluvia_sim::rollout::Rollout;
use fluvia_sim::scene::Setup;
use fluvia_sim::scene::random::{self, RandomScene};
use fluvia_sim::{Error, dfsph::Liquid};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::files::Files;
use super::plan::{Plan, Task};
use super::{Progress, folder};
use crate::record::decimal;
use crate::resume::{from_disk, to_disk};
use crate::solvers::liquid;

/// Scenes that are drawn in place of one that blew up, at most.
const MOST_ATTEMPTS: u32 = 10;

/// Whether a scene is done.
pub enum Outcome {
    Done,
    Interrupted,
}

/// The record of a scene, as it is on disk and in the manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    pub name: String,
    /// "train" or "valid".
    pub split: String,
    /// The seed that the scene and its wall particles were drawn with.
    pub seed: u64,
    pub particles: usize,
    pub wall_particles: usize,
    pub frames: u64,
    /// What was drawn in vain: columns without a free place, bodies, scenes.
    pub retries: [u32; 3],
    /// The lengths of its part files, bytes.
    pub parts: Vec<u64>,
    /// Scenes that blew up; this one is in their place.
    pub replaced: Vec<Replaced>,
    pub statistics: Statistics,
    /// The scene, as a scene file has it.
    pub scene: Value,
}

/// A scene that blew up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replaced {
    pub seed: u64,
    /// The frame that shows it.
    pub frame: u64,
    pub reason: Reason,
}

/// Why a scene is no part of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// A number is not finite.
    NotFinite,
    /// A particle is more than a radius beyond the walls' bounding box.
    Outside,
    /// A particle has fallen out of the scene.
    FellOut,
}

impl Reason {
    pub fn text(self) -> &'static str {
        match self {
            Reason::NotFinite => "a number that is not finite",
            Reason::Outside => "a particle outside the walls",
            Reason::FellOut => "a particle that fell out",
        }
    }
}

/// What happened in a sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Metres per second, in all frames.
    pub highest_speed: f64,
    /// Density over rest density, walls included: the highest in all frames.
    pub highest_density: f64,
    /// The mean of max(0, density ratio - 1) over the particles: the mean over frames, and in the worst.
    pub mean_compression: f64,
    pub worst_compression: f64,
    /// Iterations of the solver that ended at their limit.
    pub unconverged: u64,
}

/// Makes a scene, or what is left of it.
///
/// # Errors
/// If files cannot be read or written, or the recipe cannot be fulfilled.
pub fn make(
    out: &Path,
    plan: &Plan,
    task: &Task,
    interrupted: &AtomicBool,
    progress: &Progress<'_>,
) -> Result<Outcome> {
    let files = Files { folder: folder(out, task), name: task.name.clone() };
    frames::remove_temporaries(&files.folder, |target| target.starts_with(&files.name))?;
    if files.record().exists() {
        let record: Record = frames::read_json(&files.record())?;
        if files.part_lengths(record.parts.len() as u64) == record.parts {
            files.remove_progress()?;
            progress.skip(plan.steps());
            progress.scene(&format!("{}: is there", task.name));
            return Ok(Outcome::Done);
        }
        progress.warning(&format!("{}: its parts are not those of its record; it is made again", task.name));
        files.clear()?;
    }
    let attempts = files.attempts();
    let mut replaced: Vec<Replaced> =
        if attempts.exists() { frames::read_json(&attempts)? } else { Vec::new() };
    loop {
        let attempt = replaced.len() as u32;
        if attempt > MOST_ATTEMPTS {
            let Replaced { seed, frame, reason } = replaced[replaced.len() - 1];
            let reason = reason.text();
            bail!(
                "{}: {attempt} scenes blew up, the last (seed {seed}) with {reason} in frame {frame}",
                task.name
            );
        }
        let (recipe, seed) = plan.draw(task, attempt);
        let drawn = random::random_scene(&recipe, seed).with_context(|| task.name.clone())?;
        let setup = drawn.scene.sample(seed)?;
        let mut run = Run::new(plan, &files, &drawn, &setup, seed, progress)?;
        progress.skip(run.rollout.state().step);
        match run.simulate(plan, interrupted, progress)? {
            End::Interrupted => return Ok(Outcome::Interrupted),
            End::Whole => {
                let record = run.record(task, plan, replaced)?;
                frames::write_json(&files.record(), &record)?;
                files.remove_progress()?;
                progress.scene(&format!("{}: {} particles", task.name, record.particles));
                return Ok(Outcome::Done);
            }
            End::BlewUp(frame, reason) => {
                let text = reason.text();
                progress
                    .warning(&format!("{} (seed {seed}) is replaced: {text} in frame {frame}", task.name));
                progress.take_back(frame - 1);
                replaced.push(Replaced { seed, frame, reason });
                frames::write_json(&attempts, &replaced)?;
                files.clear()?;
            }
        }
    }
}

/// How the simulation of a scene ended.
enum End {
    Whole,
    Interrupted,
    /// In a frame.
    BlewUp(u64, Reason),
}

/// What an earlier command has left of an attempt.
struct Left {
    rollout: Rollout,
    statistics: Statistics,
    /// Positions and velocities of the frames of the part that is not whole.
    open: Vec<[Vec<[f32; 3]>; 2]>,
}

/// Reads what is left of the attempt with this seed.
///
/// # Errors
/// If it cannot be gone on with.
fn read_left(plan: &Plan, files: &Files, setup: &Setup, seed: u64) -> Result<Option<Left>> {
    let path = files.state();
    if !path.exists() {
        return Ok(None);
    }
    let state = State::load(&path)?;
    let parts = plan.whole_parts(state.step + 1);
    let lengths = (0..parts).map(|number| state.counters.get(&part_counter(number)).map(|&n| n as u64));
    if state.counters.get(SEED) != Some(&(seed as f64)) {
        bail!("{}: of another attempt", path.display());
    }
    if !lengths.eq(files.part_lengths(parts).into_iter().map(Some)) {
        bail!("{}: not with the parts that are there", path.display());
    }
    let read = |number| -> Result<[Vec<[f32; 3]>; 2]> {
        let path = files.frame(number);
        let frame = frames::read(&path)?;
        let velocity = frame.velocity.filter(|_| frame.position.len() == state.particles.len());
        Ok([frame.position, velocity.with_context(|| format!("{}: another frame", path.display()))?])
    };
    let open = plan.open_frames(state.step + 1).map(read).collect::<Result<_>>()?;
    let statistics = statistics_of(&state.counters);
    let rollout = Rollout::resume(setup, from_disk(state)).with_context(|| path.display().to_string())?;
    Ok(Some(Left { rollout, statistics, open }))
}

/// A scene that is simulated.
struct Run<'a> {
    files: &'a Files,
    drawn: &'a RandomScene,
    setup: &'a Setup,
    seed: u64,
    wall_volumes: Vec<f32>,
    rollout: Rollout,
    statistics: Statistics,
    /// The part that is not on disk yet.
    part: Part,
}

impl<'a> Run<'a> {
    /// A run from the last frame on disk, or from its beginning.
    fn new(
        plan: &Plan,
        files: &'a Files,
        drawn: &'a RandomScene,
        setup: &'a Setup,
        seed: u64,
        progress: &Progress<'_>,
    ) -> Result<Run<'a>> {
        let left = read_left(plan, files, setup, seed).unwrap_or_else(|error| {
            progress.warning(&format!(
                "{}: begins again, for what is left of it is damaged: {error:#}",
                files.name
            ));
            None
        });
        let Left { rollout, statistics, open } = match left {
            Some(left) => left,
            None => {
                files.clear()?;
                Left { rollout: Rollout::new(setup)?, statistics: Statistics::default(), open: Vec::new() }
            }
        };
        let part = Part { scene: files.name.clone(), walls: setup.boundary.clone(), frames: Vec::new() };
        let kernel = CubicSpline::new(SUPPORT_IN_RADII * setup.particle_radius);
        let wall_volumes = wall_volumes(&setup.boundary.position, &kernel);
        let mut run = Run { files, drawn, setup, seed, wall_volumes, rollout, statistics, part };
        if run.rollout.state().step == 0 {
            run.observe();
            run.keep(plan)?;
        } else {
            let numbers = plan.open_frames(run.rollout.state().step + 1);
            let frames =
                numbers.zip(open).map(|(number, [position, velocity])| run.frame(number, position, velocity));
            run.part.frames = frames.collect();
        }
        Ok(run)
    }

    fn simulate(&mut self, plan: &Plan, interrupted: &AtomicBool, progress: &Progress<'_>) -> Result<End> {
        let mut solver = plan.solver.make(self.setup, Kernel::detect())?;
        while self.rollout.state().step + 1 < plan.settings.frames {
            if interrupted.load(Ordering::Relaxed) {
                return Ok(End::Interrupted);
            }
            let step = match self.rollout.advance(solver.as_mut()) {
                Ok(step) => step,
                Err(Error::NonFinite { step, .. }) => return Ok(End::BlewUp(step, Reason::NotFinite)),
                Err(error) => return Err(error.into()),
            };
            if step.removed > 0 {
                return Ok(End::BlewUp(step.frame, Reason::FellOut));
            }
            if step.outside > 0 {
                return Ok(End::BlewUp(step.frame, Reason::Outside));
            }
            self.observe();
            self.keep(plan)?;
            progress.frame();
        }
        Ok(End::Whole)
    }

    /// Brings the statistics up to date with a new frame.
    fn observe(&mut self) {
        let state = self.rollout.state();
        let walls = (self.setup.boundary.position.as_slice(), self.wall_volumes.as_slice());
        let densities =
            metrics::density_ratios_within(&state.particles.position, walls, self.setup.particle_radius);
        let compression = metrics::mean_compression(&densities);
        let Statistics { highest_density, mean_compression, worst_compression, .. } = &mut self.statistics;
        *highest_density = densities.into_iter().map(decimal).fold(*highest_density, f64::max);
        // Over the frames so far.
        *mean_compression += (compression - *mean_compression) / (state.step + 1) as f64;
        *worst_compression = worst_compression.max(compression);
    }

    /// Adds the frame to its part, and writes the part when it is whole; until then its frames lie on disk by themselves.
    /// Then writes the state.
    fn keep(&mut self, plan: &Plan) -> Result<()> {
        let state = self.rollout.state();
        let particles = &state.particles;
        let frame = self.frame(state.step, particles.position.clone(), particles.velocity.clone());
        self.part.frames.push(frame);
        let parts = plan.whole_parts(state.step + 1);
        let whole = plan.open_frames(state.step + 1).is_empty();
        if whole {
            write_part(&self.files.part(parts - 1), &self.part)?;
        } else {
            let folder = self.files.frames();
            std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
            frames::write_fluid(&self.files.frame(state.step), Format::Npz, particles)?;
        }
        let mut state = to_disk(state);
        add_statistics(&self.statistics, &mut state.counters);
        state.counters.insert(SEED.to_owned(), self.seed as f64);
        for (number, length) in self.files.part_lengths(parts).into_iter().enumerate() {
            state.counters.insert(part_counter(number as u64), length as f64);
        }
        state.save(&self.files.state())?;
        if whole {
            self.part.frames.clear();
            self.files.remove_frames()?;
        }
        Ok(())
    }

    /// A frame of a part.
    fn frame(&self, number: u64, position: Vec<[f32; 3]>, velocity: Vec<[f32; 3]>) -> Frame {
        let liquids: Vec<Liquid> = self.setup.emitters.iter().map(|e| liquid(e.material)).collect();
        let mass = |liquid: &Liquid| stored_mass(liquid.density, self.setup.particle_radius);
        let bodies = &self.rollout.state().particles.body;
        let of_bodies = || bodies.iter().map(|&body| &liquids[body as usize]);
        Frame {
            number,
            position,
            velocity,
            mass: of_bodies().map(mass).collect(),
            viscosity: of_bodies().map(|liquid| liquid.viscosity).collect(),
        }
    }

    fn record(&self, task: &Task, plan: &Plan, replaced: Vec<Replaced>) -> Result<Record> {
        let random::Retries { columns, bodies, scenes } = self.drawn.retries;
        let summary = &self.rollout.state().summary;
        Ok(Record {
            name: task.name.clone(),
            split: task.split.folder().to_owned(),
            seed: self.seed,
            particles: self.rollout.state().particles.len(),
            wall_particles: self.setup.boundary.position.len(),
            frames: self.rollout.state().step + 1,
            retries: [columns, bodies, scenes],
            parts: self.files.part_lengths(plan.whole_parts(plan.settings.frames)),
            replaced,
            statistics: Statistics {
                highest_speed: decimal(summary.highest_speed),
                unconverged: summary.unconverged,
                ..self.statistics
            },
            scene: serde_json::from_str(&self.drawn.scene.to_json()?)?,
        })
    }
}

/// Counters of the state file.
const SEED: &str = "seed";
const HIGHEST_DENSITY: &str = "highest_density";
const MEAN_COMPRESSION: &str = "mean_compression";
const WORST_COMPRESSION: &str = "worst_compression";

/// The length of a part, bytes.
fn part_counter(number: u64) -> String {
    format!("part_{number}_bytes")
}

fn add_statistics(statistics: &Statistics, counters: &mut BTreeMap<String, f64>) {
    counters.insert(HIGHEST_DENSITY.to_owned(), statistics.highest_density);
    counters.insert(MEAN_COMPRESSION.to_owned(), statistics.mean_compression);
    counters.insert(WORST_COMPRESSION.to_owned(), statistics.worst_compression);
}

/// The rest is in the summary of the rollout.
fn statistics_of(counters: &BTreeMap<String, f64>) -> Statistics {
    let counter = |name: &str| counters.get(name).copied().unwrap_or_default();
    Statistics {
        highest_density: counter(HIGHEST_DENSITY),
        mean_compression: counter(MEAN_COMPRESSION),
        worst_compression: counter(WORST_COMPRESSION),
        ..Statistics::default()
    }
}

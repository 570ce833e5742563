//! `fluvia generate`: data sets of random scenes, simulated and written as sequences.
//!
//! ```text
//! DIR/manifest.json                     what was asked for, and the records of all scenes that are done
//! DIR/train/sim_0001.json               the record of a scene
//! DIR/train/sim_0001_00.msgpack.zst     its parts
//! DIR/train/sim_0001.state.npz          only while it is simulated: where to go on,
//! DIR/train/sim_0001.frames/            and the frames of the part that is not whole
//! DIR/valid/...
//! ```
//!
//! A scene depends on the seed of the set and its own number alone: not on threads, on the shard that makes it, or on
//! how often the command was stopped.

mod files;
mod manifest;
mod plan;
mod scene;

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_sim::scene::random::random_scene;
use indicatif::ProgressBar;

use crate::interrupt;
use crate::options::{pair, positive, thread_pool, threads};
use crate::report::Report;
use crate::solvers::DFSPH_VISCOSITIES;
pub use manifest::{FILE as MANIFEST, settings_of};
use plan::{Plan, Preset, Task};
use scene::Outcome;

/// Options of `fluvia generate`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia generate --preset default --out data/default
  fluvia generate --preset box-6k --scenes 20 --valid 2 --duration 4 --seed 7 --out data/small
  fluvia generate --preset viscosity --out data/viscosity --shard 3/8
  fluvia generate --preset viscosity --viscosity 0.01..0.1 --out data/thin

The same command goes on where an earlier one stopped. Shards of one set may write to one directory, at once or one
after the other; made in several directories, their files are put together and the command without --shard writes the
manifest.")]
pub struct Args {
    /// Which of the paper's data sets.
    #[arg(long, value_enum)]
    preset: Preset,
    /// Training scenes; the paper's number if not given.
    #[arg(long, value_name = "N")]
    scenes: Option<u32>,
    /// Validation scenes; the paper's number if not given.
    #[arg(long, value_name = "M")]
    valid: Option<u32>,
    /// The seed of the whole set.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// The directory to write to.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Scenes simulated at once, at most one a thread; as many as there are threads if not given.
    #[arg(long, value_name = "J", value_parser = threads)]
    jobs: Option<usize>,
    /// Threads, shared by the scenes; all cores if not given. Files do not depend on it.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// Make part K of N of the set only.
    #[arg(long, value_name = "K/N", value_parser = shard)]
    shard: Option<Shard>,
    /// The length of a sequence, seconds; the preset's if not given.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    duration: Option<f32>,
    /// The fluid particles of a scene; the preset's if not given.
    #[arg(long, value_name = "MIN..MAX", value_parser = counts)]
    particles: Option<RangeInclusive<usize>>,
    /// The viscosity of a scene, uniform in a range within 0..1; the preset's if not given. For default, box-6k and viscosity.
    #[arg(long, value_name = "MIN..MAX", value_parser = viscosities)]
    viscosity: Option<RangeInclusive<f32>>,
    /// The solver's own step, seconds; 0.001 for dfsph, as in the published data, if not given.
    #[arg(long, value_name = "SECONDS", value_parser = positive, conflicts_with = "solver_dt_max")]
    solver_dt: Option<f32>,
    /// The solver's longest step, seconds, for steps that depend on how fast particles are.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    solver_dt_max: Option<f32>,
    /// Give every body its highest initial speed.
    #[arg(long)]
    highest_speed: bool,
    /// Print the manifest without its scenes as a JSON object.
    #[arg(long)]
    json: bool,
}

/// A part of the work: every `of`-th scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shard {
    /// From 1.
    number: usize,
    of: usize,
}

/// Parses "K/N".
fn shard(text: &str) -> std::result::Result<Shard, String> {
    let parse = || {
        let (number, of) = text.split_once('/')?;
        let (number, of) = (number.parse().ok()?, of.parse().ok()?);
        (1..=of).contains(&number).then_some(Shard { number, of })
    };
    parse().ok_or_else(|| "expected K/N with 1 <= K <= N".into())
}

fn counts(text: &str) -> std::result::Result<RangeInclusive<usize>, String> {
    let counts = pair(text).filter(|(least, most)| (1..=*most).contains(least));
    counts.map(|(least, most)| least..=most).ok_or_else(|| "expected MIN..MAX with 1 <= MIN <= MAX".into())
}

fn viscosities(text: &str) -> std::result::Result<RangeInclusive<f32>, String> {
    let [low, high] = DFSPH_VISCOSITIES;
    let viscosities = pair(text).filter(|(least, most)| low <= *least && least <= most && *most <= high);
    let expected = || format!("expected MIN..MAX with {low} <= MIN <= MAX <= {high}");
    viscosities.map(|(least, most)| least..=most).ok_or_else(expected)
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let plan = Plan::new(args)?;
    let shard = args.shard.unwrap_or(Shard { number: 1, of: 1 });
    let tasks: Vec<Task> =
        plan.tasks().filter(|task| task.number as usize % shard.of == shard.number - 1).collect();
    if tasks.is_empty() {
        bail!("no scenes to make: --scenes {} --valid {}", plan.settings.scenes, plan.settings.valid);
    }
    try_first(&plan, &tasks[0], report)?;
    manifest::begin(&args.out, &plan.settings, args.shard.is_some())?;
    let interrupted = interrupt::watch()?;

    let progress = Progress::new(&plan, &tasks, report);
    let finished = simulate(args, &plan, &tasks, &interrupted, &progress);
    progress.bar.finish_and_clear();
    let manifest = manifest::write(&args.out, &plan);
    // A disk that is full would say so twice.
    let (finished, manifest) = (finished?, manifest?);
    if args.json {
        report.result(serde_json::to_string(&manifest.without_scenes())?)?;
    } else if !report.is_quiet() {
        report.result(manifest.summary(&args.out))?;
    }
    if !finished {
        report.note("stopped; the same command goes on");
        return Ok(interrupt::exit_code());
    }
    Ok(ExitCode::SUCCESS)
}

/// Makes sure before anything is written that scenes can be drawn and that the solver takes them.
fn try_first(plan: &Plan, task: &Task, report: &Report) -> Result<()> {
    let (recipe, seed) = plan.draw(task, 0);
    let scene = random_scene(&recipe, seed)
        .with_context(|| format!("{} with {} particles", task.name, range_text(&recipe.particles)))?
        .scene;
    if let Some(warning) = plan.solver.warning(&scene.path, scene.materials()) {
        report.warning(warning);
    }
    plan.solver.make(&scene.sample(seed)?, Kernel::detect())?;
    Ok(())
}

fn range_text(range: &RangeInclusive<usize>) -> String {
    format!("{}..{}", range.start(), range.end())
}

/// Makes the scenes that are not done yet, several at once; whether all are done.
fn simulate(
    args: &Args,
    plan: &Plan,
    tasks: &[Task],
    interrupted: &AtomicBool,
    progress: &Progress<'_>,
) -> Result<bool> {
    let cores = args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    let jobs = args.jobs.unwrap_or(cores).min(tasks.len()).min(cores);
    let next = AtomicUsize::new(0);
    let failure = Mutex::new(None);
    let fail = |error| {
        interrupted.store(true, Ordering::Relaxed);
        failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    };
    let work = |pool: rayon::ThreadPool| {
        while let Some(task) = tasks.get(next.fetch_add(1, Ordering::Relaxed)) {
            match pool.install(|| scene::make(&args.out, plan, task, interrupted, progress)) {
                Ok(Outcome::Done) => {}
                Ok(Outcome::Interrupted) => return,
                Err(error) => return fail(error),
            }
        }
    };
    std::thread::scope(|scope| -> Result<()> {
        for job in 0..jobs {
            // What does not divide goes to the first.
            let threads = cores / jobs + usize::from(job < cores % jobs);
            let pool = thread_pool(Some(threads))?;
            scope.spawn(|| work(pool));
        }
        Ok(())
    })?;
    match failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error),
        None => Ok(!interrupted.load(Ordering::Relaxed)),
    }
}

/// What is shown while scenes are simulated.
pub struct Progress<'a> {
    report: &'a Report,
    bar: ProgressBar,
    scenes: usize,
    done: AtomicUsize,
}

impl<'a> Progress<'a> {
    fn new(plan: &Plan, tasks: &[Task], report: &'a Report) -> Progress<'a> {
        let frames = tasks.len() as u64 * plan.steps();
        let bar = report.bar_like(frames, "{bar:16} frame {pos}/{len}, {msg}, {eta} left");
        let progress = Progress { report, bar, scenes: tasks.len(), done: AtomicUsize::new(0) };
        progress.show();
        progress
    }

    fn show(&self) {
        let done = self.done.load(Ordering::Relaxed);
        self.bar.set_message(format!("scene {done}/{} done", self.scenes));
    }

    /// Frames that were there from an earlier run: no time was spent on them.
    pub fn skip(&self, frames: u64) {
        self.bar.inc(frames);
        self.bar.reset_eta();
    }

    /// A frame was simulated.
    pub fn frame(&self) {
        self.bar.inc(1);
    }

    /// Frames that do not count because their scene is made anew.
    pub fn take_back(&self, frames: u64) {
        self.bar.dec(frames);
    }

    /// A scene is done.
    pub fn scene(&self, line: &str) {
        self.done.fetch_add(1, Ordering::Relaxed);
        self.show();
        self.bar.suspend(|| self.report.detail(line));
    }

    /// A scene is replaced.
    pub fn warning(&self, line: &str) {
        self.bar.suspend(|| self.report.warning(line));
    }
}

/// The folder of a split of the set.
fn folder(out: &Path, task: &Task) -> PathBuf {
    out.join(task.split.folder())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_and_ranges() {
        assert_eq!(shard("3/8"), Ok(Shard { number: 3, of: 8 }));
        assert!(["0/2", "3/2", "1", "a/b", "1/0", "-1/2"].iter().all(|text| shard(text).is_err()));
        assert_eq!(counts("10..20"), Ok(10..=20));
        assert_eq!(counts("10..10"), Ok(10..=10));
        assert!(["0..5", "7..5", "5", "..", "a..b"].iter().all(|text| counts(text).is_err()));
        assert_eq!(viscosities("0..0.03"), Ok(0.0..=0.03));
        for text in ["-0.1..0.3", "0.3..0.1", "0.1..1.1", "0.1..inf", "nan..1", "0.1"] {
            assert_eq!(
                viscosities(text).unwrap_err(),
                "expected MIN..MAX with 0 <= MIN <= MAX <= 1",
                "{text}"
            );
        }
    }
}

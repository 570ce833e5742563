//! `fluvia simulate`: runs a scene and writes its frames.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_net::weights;
use fluvia_sim::frames::{self, Format, Mode, RunDirectory};
use fluvia_sim::pbf::{Params, Substep};
use fluvia_sim::rollout::{self, Rollout, Solver, StepReport};
use fluvia_sim::scene::Setup;
use indicatif::{ProgressBar, ProgressStyle};

use crate::record::{self, Record, Source, Summary};
use crate::report::Report;
use crate::solvers::Choice;

/// The exit code of a run that Ctrl-C stopped, as shells give it to a process ended by that signal.
const INTERRUPTED: u8 = 130;

/// Options of `fluvia simulate`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia simulate dam_break --steps 200 --out out/dam
  fluvia simulate scene.json --weights pretrained_model_weights.pt --steps 250 --out out/net --format npz,vtu
  fluvia simulate scene.json --weights pretrained_model_weights.pt --steps 500 --out out/net --format npz,vtu --resume

N steps write N + 1 frames; fluid_0000 is the state before the first step. The shipped scenes are
dam_break, two_bodies and emitter_step.")]
pub struct Args {
    /// A scene file (JSON), or the name of a shipped scene.
    scene: String,
    /// Weights of the network: .pt, .h5 or .safetensors. Without them the solver is pbf.
    #[arg(long, value_name = "FILE", conflicts_with = "solver")]
    weights: Option<PathBuf>,
    /// A solver that needs no weights.
    #[arg(long, value_enum, default_value_t = SolverName::Pbf)]
    solver: SolverName,
    /// Frame intervals to simulate.
    #[arg(long, value_name = "N", default_value_t = 250)]
    steps: u64,
    /// The directory to write to.
    #[arg(long, value_name = "DIR", default_value = "out")]
    out: PathBuf,
    /// Formats of the frames: npz, ply, bgeo, vtu, vtk.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "npz")]
    format: Vec<Format>,
    /// Threads; all cores if not given. Results do not depend on it.
    #[arg(long, value_name = "T")]
    threads: Option<std::num::NonZeroUsize>,
    /// The seed of the wall particles.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// The solver's own step, seconds (pbf).
    #[arg(long, value_name = "SECONDS", conflicts_with_all = ["weights", "solver_dt_max"])]
    solver_dt: Option<f32>,
    /// The solver's longest step, seconds (pbf; 0.004 if not given).
    #[arg(long, value_name = "SECONDS", conflicts_with = "weights")]
    solver_dt_max: Option<f32>,
    /// Go on with the run in the directory.
    #[arg(long, conflicts_with = "overwrite")]
    resume: bool,
    /// Replace the run in the directory.
    #[arg(long)]
    overwrite: bool,
    /// Print the summary as a JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum SolverName {
    /// Position-based fluids (Macklin & Müller 2013).
    Pbf,
}

/// Everything that a run needs, made and checked before anything is written.
struct Prepared {
    setup: Setup,
    solver: Box<dyn Solver>,
    record: Record,
    formats: Vec<Format>,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let pool = thread_pool(args.threads)?;
    pool.install(|| {
        let prepared = prepare(args, report)?;
        for warning in prepared.setup.warnings() {
            report.warning(warning);
        }
        simulate(args, report, prepared)
    })
}

/// A pool of the given number of threads, by default one per core.
pub fn thread_pool(threads: Option<std::num::NonZeroUsize>) -> Result<rayon::ThreadPool> {
    let threads = threads.map_or(0, std::num::NonZeroUsize::get);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("cannot start the threads")
}

fn prepare(args: &Args, report: &Report) -> Result<Prepared> {
    let (mut scene, scene_source) = record::load_scene(&args.scene)?;
    let (choice, weights_source) = choose(args)?;
    choice.adapt(&mut scene)?;
    let setup = scene.sample(args.seed)?;
    let kernel = Kernel::detect();
    let solver = choice.make(&setup, kernel)?;
    let mut formats = args.format.clone();
    formats.sort_by_key(|format| format.extension());
    formats.dedup();
    report.detail(format_args!(
        "{} wall particles, {} fluids, solver {}, kernel {}",
        setup.boundary.position.len(),
        setup.emitters.len(),
        solver.name(),
        choice.kernel_name(kernel)
    ));
    let record = Record {
        version: env!("CARGO_PKG_VERSION").into(),
        scene: scene_source,
        weights: weights_source,
        particles_sha256: record::hash_particles(&setup),
        seed: args.seed,
        solver: solver.name().into(),
        parameters: choice.parameters(),
        kernel: choice.kernel_name(kernel).into(),
        threads: rayon::current_num_threads(),
        formats: formats.iter().map(|format| format.extension().into()).collect(),
        dt: setup.dt,
        particle_radius: setup.particle_radius,
        gravity: setup.gravity,
        steps: args.steps,
        summary: None,
    };
    Ok(Prepared { setup, solver, record, formats })
}

fn choose(args: &Args) -> Result<(Choice, Option<Source>)> {
    let Some(path) = &args.weights else {
        let SolverName::Pbf = args.solver;
        let mut params = Params::default();
        match (args.solver_dt, args.solver_dt_max) {
            (Some(dt), _) => params.substep = Substep::Fixed(dt),
            (None, Some(dt)) => params.substep = Substep::AtMost(dt),
            (None, None) => {}
        }
        return Ok((Choice::Pbf(params), None));
    };
    let (bytes, source) = record::read_source(path)?;
    let weights = weights::from_bytes(path, bytes)?;
    Ok((Choice::Network(Box::new(weights)), Some(source)))
}

fn simulate(args: &Args, report: &Report, prepared: Prepared) -> Result<ExitCode> {
    let Prepared { setup, mut solver, mut record, formats } = prepared;
    let has_state = args.out.join(frames::run::STATE).exists();
    let mode = match (args.resume, args.overwrite) {
        (true, _) if has_state => Mode::Resume,
        // Killed before its first state was on disk: what is there belongs to a run that has to begin again.
        (true, _) => Mode::Overwrite,
        (false, true) => Mode::Overwrite,
        (false, false) => Mode::New,
    };
    // Frame 0 exists only if the particles can be emitted: before the directory is touched.
    let fresh = if mode == Mode::Resume { None } else { Some(Rollout::new(&setup)?) };
    let mut directory = RunDirectory::open(&args.out, mode, &formats, setup.dt)?;
    let mut rollout = match fresh {
        Some(rollout) => rollout,
        None => resume(&directory, &setup, &record, args, report)?,
    };
    if mode != Mode::Resume {
        directory.write_record(&record)?;
        directory.write_walls(&setup.boundary)?;
        write(&mut directory, rollout.state())?;
    }
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&interrupted);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("cannot watch for Ctrl-C")?;

    let first_step = rollout.state().step;
    let bar = progress_bar(args.steps, first_step, report);
    let (mut seconds, mut warned) = (0.0, Warned::default());
    while rollout.state().step < args.steps && !interrupted.load(Ordering::Relaxed) {
        let start = Instant::now();
        let step = rollout.advance(solver.as_mut())?;
        seconds += start.elapsed().as_secs_f64();
        write(&mut directory, rollout.state())?;
        bar.suspend(|| warned.tell(&step, report));
        let milliseconds = 1e3 * seconds / (step.frame - first_step) as f64;
        bar.set_message(format!("{} particles, {milliseconds:.1} ms a step", step.particles));
        bar.set_position(step.frame);
    }
    bar.finish_and_clear();
    let done = rollout.state().step - first_step;
    let summary = Summary::new(rollout.state(), if done > 0 { 1e3 * seconds / done as f64 } else { 0.0 });
    record.steps = record.steps.max(summary.steps);
    record.summary = Some(summary.clone());
    directory.write_record(&record)?;
    if args.json {
        report.result(serde_json::to_string(&summary)?)?;
    } else if !report.is_quiet() {
        report.result(describe(&summary, &args.out))?;
    }
    if rollout.state().step < args.steps {
        report.note(format_args!(
            "stopped after step {}; the same command with --resume goes on",
            rollout.state().step
        ));
        return Ok(ExitCode::from(INTERRUPTED));
    }
    Ok(ExitCode::SUCCESS)
}

/// The rollout in the directory, if it is one of the same scene, solver and files.
fn resume(
    directory: &RunDirectory,
    setup: &Setup,
    record: &Record,
    args: &Args,
    report: &Report,
) -> Result<Rollout> {
    let path = directory.path().join(frames::run::RECORD);
    let old: Record = frames::read_json(&path)?;
    if let Some((name, old, new)) = record.difference(&old) {
        bail!("{}: the run was made with another {name}: {old}, now {new}", path.display());
    }
    if old.kernel != record.kernel {
        report.warning(format_args!(
            "the run was computed by the kernel {}, now by {}: its continuation is right, but not the same bits",
            old.kernel, record.kernel
        ));
    }
    let state = directory.read_state()?;
    report.note(format_args!("resuming after step {} of {}", state.step, args.steps));
    Ok(Rollout::resume(setup, from_disk(state))?)
}

/// Writes the frame of a state, then the state: a run that is killed between the two writes the frame again.
fn write(directory: &mut RunDirectory, state: &rollout::State) -> Result<()> {
    directory.write_frame(state.step, &state.particles)?;
    directory.write_state(&to_disk(state))?;
    Ok(())
}

const OUTSIDE: &str = "outside";
const WORST_OUTSIDE: &str = "worst_outside";
const HIGHEST_SPEED: &str = "highest_speed";

fn to_disk(state: &rollout::State) -> frames::State {
    let rollout::Summary { outside, worst_outside, removed, highest_speed } = state.summary;
    frames::State {
        step: state.step,
        particles: state.particles.clone(),
        next_id: state.next_id,
        removed,
        counters: [
            (OUTSIDE.to_owned(), outside as f64),
            (WORST_OUTSIDE.to_owned(), worst_outside as f64),
            (HIGHEST_SPEED.to_owned(), f64::from(highest_speed)),
        ]
        .into(),
        arrays: Default::default(),
    }
}

fn from_disk(state: frames::State) -> rollout::State {
    let counter = |name: &str| state.counters.get(name).copied().unwrap_or_default();
    rollout::State {
        step: state.step,
        next_id: state.next_id,
        summary: rollout::Summary {
            outside: counter(OUTSIDE) as usize,
            worst_outside: counter(WORST_OUTSIDE) as usize,
            removed: state.removed,
            highest_speed: counter(HIGHEST_SPEED) as f32,
        },
        particles: state.particles,
    }
}

/// Which warnings have been given: each comes once a run.
#[derive(Default)]
struct Warned {
    outside: bool,
    piled_up: bool,
    removed: bool,
}

impl Warned {
    fn tell(&mut self, step: &StepReport, report: &Report) {
        if step.outside > 0 && !std::mem::replace(&mut self.outside, true) {
            report.warning(format_args!(
                "step {}: {} outside the walls",
                step.frame,
                particles(step.outside)
            ));
        }
        if step.removed > 0 && !std::mem::replace(&mut self.removed, true) {
            report.warning(format_args!(
                "step {}: {} removed, fallen out of the scene",
                step.frame,
                particles(step.removed)
            ));
        }
        if step.piled_up && !std::mem::replace(&mut self.piled_up, true) {
            report.warning(format_args!(
                "step {}: particles pile up: one has {} neighbours within {} m",
                step.frame, step.solver.max_neighbors, step.solver.neighbor_radius
            ));
        }
    }
}

/// "1 particle", "2 particles".
fn particles(count: usize) -> String {
    format!("{count} particle{}", if count == 1 { "" } else { "s" })
}

/// A bar on a terminal; drawn nowhere else.
fn progress_bar(steps: u64, first: u64, report: &Report) -> ProgressBar {
    if report.is_quiet() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(steps);
    let template = "{bar:30} step {pos}/{len}, {msg}, {eta} left";
    bar.set_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.set_position(first);
    bar.reset_eta();
    bar
}

fn describe(summary: &Summary, out: &Path) -> String {
    format!(
        "{}: {}, {} steps, {:.1} ms a step\n\
         highest speed {:.2} m/s; outside the walls: {} in the last frame, {} in the worst; removed: {}",
        out.display(),
        particles(summary.particles),
        summary.steps,
        summary.ms_per_step,
        summary.highest_speed,
        summary.outside,
        summary.worst_outside,
        summary.removed,
    )
}

//! `fluvia simulate`: runs a scene and writes its frames.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::{Context, Result};
use cconv::Kernel;
use fluvia_sim::frames::{Format, Mode, RunDirectory};

use fluvia_sim::rollout::{Rollout, Solver};
use fluvia_sim::scene::{DEFAULT_DT, Setup};

use crate::interrupt;
use crate::options::{PrecisionName, positive, substep, thread_pool, threads};
use crate::record::{self, Record, Source, Summary};
use crate::report::{Report, counted};
use crate::resume;
use crate::solvers::{Choice, SolverName};
use crate::trained;
use crate::warnings::Warned;

/// Options of `fluvia simulate`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia simulate dam_break --steps 200 --out out/dam
  fluvia simulate scene.json --steps 250 --out out/net --format npz,vtu
  fluvia simulate scene.json --steps 500 --out out/net --format npz,vtu --resume
  fluvia simulate scene.json --weights pretrained_model_weights.pt --out out/published
  fluvia simulate scene.json --solver dfsph --out out/truth

N steps write N + 1 frames; fluid_0000 is the state before the first step. The shipped scenes are dam_break,
two_bodies, emitter_step, obstacle_course, river, waterfall, three_viscosities (--weights viscosity, or
--solver dfsph) and hundred_thousand.")]
pub struct Args {
    /// A scene file (JSON), or the name of a shipped scene.
    scene: String,
    /// Weights of the network: a file (.pt, .h5 or .safetensors), or the name of shipped ones (default, viscosity).
    #[arg(long, value_name = "FILE", default_value = trained::DEFAULT, conflicts_with = "solver")]
    weights: PathBuf,
    /// A solver that needs no weights, in place of the network.
    #[arg(long, value_enum)]
    solver: Option<SolverName>,
    /// Frame intervals to simulate.
    #[arg(long, value_name = "N", default_value_t = 250)]
    steps: u64,
    /// The directory to write to; out/NAME for a scene NAME or NAME.json if not given.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Formats of the frames: npz, ply, bgeo, vtu, vtk.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "npz")]
    format: Vec<Format>,
    /// Threads; all cores if not given. Results do not depend on it.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// The seed of the wall particles.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// The format of the network's large matrix products.
    #[arg(long, value_enum, default_value_t = PrecisionName::F32, conflicts_with = "solver")]
    precision: PrecisionName,
    /// The solver's own step, seconds (dfsph, pbf): an interval is cut into equal parts that are no longer.
    #[arg(long, value_name = "SECONDS", value_parser = positive, requires = "solver", conflicts_with_all = ["weights", "solver_dt_max"])]
    solver_dt: Option<f32>,
    /// The solver's longest step, seconds, shorter while particles are fast; if not given 0.005 (dfsph), 0.004 (pbf).
    #[arg(long, value_name = "SECONDS", value_parser = positive, requires = "solver", conflicts_with = "weights")]
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

impl Args {
    fn out(&self) -> PathBuf {
        self.out.clone().unwrap_or_else(|| {
            let name = Path::new(&self.scene).file_stem().unwrap_or_default();
            Path::new("out").join(name)
        })
    }
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

fn prepare(args: &Args, report: &Report) -> Result<Prepared> {
    let (mut scene, scene_source) = record::load_scene(&args.scene)?;
    let (choice, weights_source) = choose(args, scene.dt.unwrap_or(DEFAULT_DT))?;
    choice.adapt(&mut scene)?;
    let setup = scene.sample(args.seed)?;
    let kernel = Kernel::detect();
    let solver = choice.make(&setup, kernel).with_context(|| args.scene.clone())?;
    if let Some(warning) = choice.warning(&scene.path, scene.materials()) {
        report.warning(warning);
    }
    if setup.emitters.iter().all(|emitter| emitter.start > args.steps) {
        report.warning(format_args!("no particles within {} steps: every fluid starts later", args.steps));
    }
    let mut formats = args.format.clone();
    formats.sort_by_key(|format| format.extension());
    formats.dedup();
    report.detail(format_args!(
        "wall particles: {}, fluids: {}, solver: {}, kernel: {}",
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
        earlier: Vec::new(),
        threads: rayon::current_num_threads(),
        formats: formats.iter().map(|format| format.extension().into()).collect(),
        dt: setup.dt,
        particle_radius: setup.particle_radius,
        gravity: setup.gravity,
        steps: args.steps,
        live: None,
        summary: None,
    };
    Ok(Prepared { setup, solver, record, formats })
}

/// The solver that was asked for, of frames that are `frame` seconds apart.
fn choose(args: &Args, frame: f32) -> Result<(Choice, Option<Source>)> {
    if let Some(solver) = args.solver {
        let substep = substep(args.solver_dt, args.solver_dt_max, frame)?;
        return Ok((solver.choice(substep), None));
    }
    let (weights, source) = trained::load(&args.weights)?;
    Ok((Choice::Network(Box::new(weights), args.precision), Some(source)))
}

fn simulate(args: &Args, report: &Report, prepared: Prepared) -> Result<ExitCode> {
    let Prepared { setup, mut solver, mut record, formats } = prepared;
    let out = args.out();
    let mode = match (args.resume, args.overwrite) {
        (true, _) => resume::mode(&out, &record)?,
        (false, true) => Mode::Overwrite,
        (false, false) => Mode::New,
    };
    // Frame 0 exists only if the particles can be emitted: before the directory is touched.
    let fresh = if mode == Mode::Resume { None } else { Some(Rollout::new(&setup)?) };
    let mut directory = RunDirectory::open(&out, mode, &formats, setup.dt)?;
    let (mut rollout, ended) = match fresh {
        Some(rollout) => (rollout, None),
        None => resume::rollout(&mut directory, &setup, &mut record, report)?,
    };
    if mode != Mode::Resume {
        directory.write_record(&record)?;
        directory.write_walls(&setup.boundary)?;
        resume::write(&mut directory, rollout.state())?;
    }
    let interrupted = interrupt::watch()?;
    let first_step = rollout.state().step;
    // Fits the 80 columns of a plain terminal up to millions of particles.
    let bar = report.bar_like(args.steps, "{bar:16} step {pos}/{len}, {msg}, {eta} left");
    bar.set_position(first_step);
    bar.reset_eta();
    let (mut seconds, mut warned) = (0.0, Warned::default());
    while rollout.state().step < args.steps && !interrupted.load(Ordering::Relaxed) {
        let start = Instant::now();
        let step = rollout.advance(solver.as_mut())?;
        seconds += start.elapsed().as_secs_f64();
        resume::write(&mut directory, rollout.state())?;
        for warning in warned.new_ones(&step) {
            bar.suspend(|| report.warning(warning));
        }
        let milliseconds = 1e3 * seconds / (step.frame - first_step) as f64;
        bar.set_message(format!("{} particles, {milliseconds:.1} ms a step", step.particles));
        bar.set_position(step.frame);
    }
    bar.finish_and_clear();
    let done = rollout.state().step - first_step;
    let summary = match ended {
        // Nothing was left to do: the record stays as it is.
        Some(summary) if done == 0 => summary,
        _ => {
            let ms_per_step = if done > 0 { 1e3 * seconds / done as f64 } else { 0.0 };
            let summary = Summary::new(rollout.state(), ms_per_step);
            record.steps = record.steps.max(summary.steps);
            record.summary = Some(summary.clone());
            directory.write_record(&record)?;
            summary
        }
    };
    if args.json {
        report.result(serde_json::to_string(&summary)?)?;
    } else if !report.is_quiet() {
        report.result(describe(&summary, &out))?;
    }
    if rollout.state().step < args.steps {
        report.note(format_args!(
            "stopped after step {}; the same command with --resume goes on",
            rollout.state().step
        ));
        return Ok(interrupt::exit_code());
    }
    Ok(ExitCode::SUCCESS)
}

fn describe(summary: &Summary, out: &Path) -> String {
    format!(
        "{}: {}, {}, {:.1} ms a step\n\
         highest speed {:.2} m/s; outside the walls: {} in the last frame, {} in the worst; removed: {}",
        out.display(),
        counted(summary.particles, "particle"),
        counted(summary.steps as usize, "step"),
        summary.ms_per_step,
        summary.highest_speed,
        summary.outside,
        summary.worst_outside,
        summary.removed,
    )
}

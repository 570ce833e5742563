//! `fluvia evaluate`: how far solvers are from true sequences, by the paper's metrics and by what they miss.

pub mod figures;
mod report;
pub mod truth;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_net::evaluate::{Judged, Rolled, StartErrors, Truth, lone_acceleration};
use fluvia_net::weights::Weights;
use fluvia_sim::particles::Boundary;
use fluvia_sim::scene::{Emitter, Material, Setup};
use indicatif::ProgressBar;

use crate::curves::Curves;
use crate::options::{PrecisionName, labelled, positive, substep, thread_pool, threads};
use crate::report::Report;
use crate::solvers::{Choice, SolverName};
use crate::trained;
use figures::Figures;
use truth::Recorded;

/// Options of `fluvia evaluate`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia evaluate --weights out/paper/best.safetensors --data data/default
  fluvia evaluate --weights ours=best.safetensors --weights published=pretrained_model_weights.pt \\
    --data data/default --out out/evaluation
  fluvia evaluate --weights best.safetensors --solver dfsph --solver-dt-max 0.005 --data out/dfsph_1ms --out out/figure_6

DIR is a data set (its folder valid if it has one), a sequence (valid/sim_0206) or the directory of a run. Errors after one
and two frames (n+1, n+2) start from every fifth true frame; d of Eq. 18 is that of a rollout from the first frame, every
fifth frame. Curves and pictures go to --out.")]
pub struct Args {
    /// Weights of a network: a file (.pt, .h5 or .safetensors), or the name of shipped ones (default, viscosity); LABEL=FILE
    /// names them. May be given several times. The shipped ones if there is no --solver either.
    #[arg(long, value_name = "FILE")]
    weights: Vec<String>,
    /// A solver that needs no weights. May be given several times.
    #[arg(long, value_enum)]
    solver: Vec<SolverName>,
    /// What is right: a data set, a sequence or a run.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// The directory to write report.json, report.md and a picture for each sequence to.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The format of the network's large matrix products.
    #[arg(long, value_enum, default_value_t = PrecisionName::F32)]
    precision: PrecisionName,
    /// The step of dfsph and pbf, seconds: an interval is cut into equal parts that are no longer.
    #[arg(long, value_name = "SECONDS", value_parser = positive, conflicts_with = "solver_dt_max", requires = "solver")]
    solver_dt: Option<f32>,
    /// Their longest step, seconds, shorter while particles are fast; if not given 0.005 (dfsph), 0.004 (pbf).
    #[arg(long, value_name = "SECONDS", value_parser = positive, requires = "solver")]
    solver_dt_max: Option<f32>,
    /// Seconds between frames where that is not recorded; 0.02 if not given.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    dt: Option<f32>,
    /// Threads; all cores if not given.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// Print a JSON object, not a table.
    #[arg(long)]
    json: bool,
}

/// A solver that is evaluated, with the name that it has in tables.
struct Candidate {
    label: String,
    choice: Choice,
}

/// Everything that was found.
struct Results {
    sequences: Vec<Sequence>,
    /// For each candidate.
    evaluations: Vec<Evaluation>,
}

/// What is right.
struct Sequence {
    name: String,
    /// The number of its first frame.
    first: u64,
    /// Seconds between frames.
    dt: f64,
    truth: Curves,
}

/// What a solver did.
struct Evaluation {
    label: String,
    /// `None` if a number is not finite.
    lone_acceleration: Option<[f64; 3]>,
    /// On each sequence.
    outcomes: Vec<Outcome>,
}

/// What a solver did on a sequence.
struct Outcome {
    starts: Vec<StartErrors>,
    rolled: Rolled,
    /// Of all frames, or of those before one that is not finite.
    curves: Curves,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    thread_pool(args.threads)?.install(|| {
        // All that can be wrong with what was asked for shows before the first step.
        let mut truths = open(&args.data, args.dt, report)?.collect::<Result<Vec<_>>>()?;
        let candidates = candidates(args, &truths, report)?;
        let frames: u64 = truths.iter().map(|truth| truth.frames().end - truth.frames().start).sum();
        let bar = report.bar(frames * (1 + candidates.len() as u64));
        let sequences = truths.iter_mut().map(|truth| measure(truth, &bar)).collect::<Result<Vec<_>>>()?;
        if let Some(out) = &args.out {
            std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
        }
        let evaluations = evaluate(&candidates, &mut truths, &bar)?;
        bar.finish_and_clear();
        let results = Results { sequences, evaluations };
        if let Some(out) = &args.out {
            report::write(out, &results)?;
        }
        match args.json {
            true => report.result(report::json(&results))?,
            false => report.result(report::markdown(&results))?,
        }
        Ok(ExitCode::SUCCESS)
    })
}

/// The solvers that were asked for, all of which can honour all sequences.
fn candidates(args: &Args, truths: &[Recorded], report: &Report) -> Result<Vec<Candidate>> {
    let mut candidates = Vec::new();
    let default = [trained::DEFAULT.to_owned()];
    let networks: &[String] =
        if args.solver.is_empty() && args.weights.is_empty() { &default } else { &args.weights };
    if networks.is_empty() && args.precision != PrecisionName::F32 {
        bail!("--precision: these solvers have none, expected it with --weights");
    }
    for text in networks {
        let (label, path) = labelled(text);
        let choice = Choice::Network(Box::new(trained::load(path)?.0), args.precision);
        candidates.push(Candidate { label: label.into(), choice });
    }
    for solver in &args.solver {
        let shortest = truths.iter().map(|truth| truth.setup.dt).fold(f32::INFINITY, f32::min);
        let choice = solver.choice(substep(args.solver_dt, args.solver_dt_max, shortest)?);
        candidates.push(Candidate { label: choice.name().into(), choice });
    }
    for (k, Candidate { label, choice }) in candidates.iter().enumerate() {
        if candidates[..k].iter().any(|other| other.label == *label) {
            bail!("two solvers are called {label}: LABEL=FILE names weights");
        }
        for truth in truths {
            choice.check(truth.path(), &truth.setup)?;
            let materials = truth.setup.emitters.iter().map(|emitter| emitter.material);
            if let Some(warning) = choice.warning(truth.path(), materials) {
                report.warning(warning);
            }
        }
    }
    Ok(candidates)
}

/// Makes sure that weights can be evaluated on the sequences of a data set.
///
/// # Errors
/// As [`of_weights`].
pub fn check(weights: Weights, data: &Path, report: &Report) -> Result<()> {
    let choice = Choice::Network(Box::new(weights), PrecisionName::F32);
    open(data, None, report)?.try_for_each(|truth| {
        let truth = truth?;
        choice.check(truth.path(), &truth.setup)
    })
}

/// The true sequences, each opened when it is asked for.
fn open(data: &Path, dt: Option<f32>, report: &Report) -> Result<impl Iterator<Item = Result<Recorded>>> {
    let open = move |path: PathBuf| {
        let mut truth = Recorded::open(&path, dt, report)?;
        truth.unload();
        Ok(truth)
    };
    Ok(truth::find(data)?.into_iter().map(open))
}

/// The figures of weights on the sequences of a data set; `None` if it was told to stop.
///
/// # Errors
/// If frames cannot be read, or do not fit the weights.
pub fn of_weights(
    weights: Weights,
    data: &Path,
    interrupted: &AtomicBool,
    report: &Report,
) -> Result<Option<Figures>> {
    let choice = Choice::Network(Box::new(weights), PrecisionName::F32);
    let candidate = Candidate { label: String::new(), choice };
    let (mut sequences, mut outcomes) = (Vec::new(), Vec::new());
    for truth in open(data, None, report)? {
        let mut truth = truth?;
        if interrupted.load(Ordering::Relaxed) {
            return Ok(None);
        }
        candidate.choice.check(truth.path(), &truth.setup)?;
        let frames = truth.frames();
        let bar = report.bar(2 * (frames.end - frames.start));
        sequences.push(measure(&mut truth, &bar)?);
        outcomes.push(outcome(&candidate, &mut truth, &bar)?);
        bar.finish_and_clear();
    }
    Ok(Some(Figures::of(&sequences.iter().zip(&outcomes).collect::<Vec<_>>())))
}

/// Reads all true frames.
fn measure(truth: &mut Recorded, bar: &ProgressBar) -> Result<Sequence> {
    let mut curves = truth.curves("truth");
    for number in truth.frames() {
        let particles = truth.particles(number)?;
        curves.measure(&particles.position, &particles.velocity);
        bar.inc(1);
    }
    truth.unload();
    let first = truth.frames().start;
    Ok(Sequence { name: truth.name.clone(), first, dt: truth.dt(), truth: curves })
}

fn evaluate(candidates: &[Candidate], truths: &mut [Recorded], bar: &ProgressBar) -> Result<Vec<Evaluation>> {
    let evaluation = |candidate: &Candidate| {
        let mut outcomes = Vec::new();
        for truth in &mut *truths {
            let path = truth.path().display().to_string();
            outcomes.push(outcome(candidate, truth, bar).context(path)?);
        }
        let lone_acceleration = lone(&candidate.choice, &truths[0].setup)?;
        Ok(Evaluation { label: candidate.label.clone(), lone_acceleration, outcomes })
    };
    candidates.iter().map(evaluation).collect()
}

fn outcome(candidate: &Candidate, truth: &mut Recorded, bar: &ProgressBar) -> Result<Outcome> {
    let setup = truth.setup.clone();
    let mut solver = candidate.choice.make(&setup, Kernel::detect())?;
    let mut judged = Judged { solver: solver.as_mut(), gravity: setup.gravity, dt: setup.dt };
    let starts = judged.start_errors(truth)?;
    let mut curves = truth.curves(&candidate.label);
    let rolled = judged.roll_out(truth, |particles| {
        curves.measure(&particles.position, &particles.velocity);
        bar.inc(1);
    })?;
    bar.inc(rolled.non_finite_frames);
    truth.unload();
    Ok(Outcome { starts, rolled, curves })
}

/// The acceleration of a particle alone, without walls; under the gravity of the scene, or that of the weights.
fn lone(choice: &Choice, setup: &Setup) -> Result<Option<[f64; 3]>> {
    let (gravity, dt) = match choice {
        Choice::Network(weights, _) => (weights.config.gravity, weights.config.dt),
        Choice::Dfsph(_) | Choice::Pbf(_) => (setup.gravity, setup.dt),
    };
    let emitters = vec![Emitter { material: Material::default(), ..setup.emitters[0].clone() }];
    let empty = Setup { boundary: Boundary::default(), emitters, gravity, dt, ..setup.clone() };
    let mut solver = choice.make(&empty, Kernel::detect())?;
    Ok(lone_acceleration(solver.as_mut(), gravity, dt)?)
}

//! `fluvia bench`: times the network on a given state.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_net::config::Config;
use fluvia_net::solver::NetSolver;
use fluvia_net::weights;
use fluvia_sim::frames::npz;
use fluvia_sim::metrics::Bounds;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::Solver;
use serde::Serialize;

use crate::report::Report;
use crate::simulate::thread_pool;

/// Options of `fluvia bench`.
#[derive(clap::Args)]
#[command(after_help = "\
STATE holds pos, vel, box and box_normals (metres, metres per second). Every repetition starts from it. The
grid of the walls, which do not move, is made once before. The last line printed is a JSON object with the
median in milliseconds.

Example:
  fluvia bench --state state_6k.npz --weights pretrained_model_weights.pt --steps 20")]
pub struct Args {
    /// The state to start from (npz).
    #[arg(long, value_name = "FILE")]
    state: PathBuf,
    /// Weights of the network: .pt, .h5 or .safetensors.
    #[arg(long, value_name = "FILE")]
    weights: PathBuf,
    /// Repetitions, after one that does not count.
    #[arg(long, value_name = "K", default_value = "20")]
    steps: NonZeroUsize,
    /// What to time.
    #[arg(long, value_enum, default_value_t = Stage::Step)]
    stage: Stage,
    /// Repeat the state and its walls side by side along x.
    #[arg(long, value_name = "N", default_value = "1")]
    tile: NonZeroUsize,
    /// Threads; all cores if not given.
    #[arg(long, value_name = "T")]
    threads: Option<NonZeroUsize>,
    /// Print the JSON line alone.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Stage {
    /// One step of the network, neighbour search included.
    Step,
    /// All pairs of a step: fluid and fluid, wall and fluid.
    Neighbors,
}

/// The last line that is printed.
#[derive(Serialize)]
struct Timing {
    median_ms: f64,
    particles: usize,
    stage: Stage,
    threads: usize,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    thread_pool(args.threads)?.install(|| {
        let weights = weights::load(&args.weights)?;
        let (particles, boundary) = load(&args.state, &weights.config, args.tile.get())?;
        let mut solver = NetSolver::new(&weights, &boundary, &[None], Kernel::detect())?;
        let mut times = Vec::with_capacity(args.steps.get());
        for repetition in 0..=args.steps.get() {
            let elapsed = time(args.stage, &mut solver, &particles, &weights.config)?;
            if repetition > 0 {
                times.push(elapsed);
            }
        }
        let timing = Timing {
            median_ms: median(&mut times),
            particles: particles.len(),
            stage: args.stage,
            threads: rayon::current_num_threads(),
        };
        if !args.json && !report.is_quiet() {
            report.result(format_args!(
                "{} particles, {} wall particles, kernel {}: {:.2} ms ({:.2} to {:.2}), {:.2} µs a particle",
                particles.len(),
                boundary.position.len(),
                solver.network().kernel().name(),
                timing.median_ms,
                times[0],
                times[times.len() - 1],
                1e3 * timing.median_ms / particles.len().max(1) as f64,
            ))?;
        }
        report.result(serde_json::to_string(&timing)?)?;
        Ok(ExitCode::SUCCESS)
    })
}

/// One repetition from the same state, milliseconds.
fn time(stage: Stage, solver: &mut NetSolver, particles: &Particles, config: &Config) -> Result<f64> {
    let gravity = Acceleration::Uniform(config.gravity);
    let mut moved = particles.clone();
    let start = Instant::now();
    match stage {
        Stage::Step => {
            solver.step(&mut moved, gravity, config.dt)?;
        }
        Stage::Neighbors => {
            solver.search(&moved, gravity);
        }
    }
    Ok(1e3 * start.elapsed().as_secs_f64())
}

/// Sorts the values; the median of an even number is the mean of the two in the middle.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { (values[middle - 1] + values[middle]) / 2.0 }
}

/// The particles and walls of a state, repeated side by side.
fn load(path: &Path, config: &Config, tiles: usize) -> Result<(Particles, Boundary)> {
    let arrays = npz::read_arrays(path)?;
    let points = |name: &str| -> Result<Vec<[f32; 3]>> {
        let array = arrays.get(name).with_context(|| format!("{}: no array `{name}`", path.display()))?;
        if array.shape.len() != 2 || array.shape[1] != 3 {
            bail!("{}: `{name}` has the shape {:?}, expected (N, 3)", path.display(), array.shape);
        }
        Ok(array.values.chunks_exact(3).map(|p| [p[0] as f32, p[1] as f32, p[2] as f32]).collect())
    };
    let (position, velocity) = (points("pos")?, points("vel")?);
    let (wall, normal) = (points("box")?, points("box_normals")?);
    if position.len() != velocity.len() || wall.len() != normal.len() {
        bail!("{}: pos and vel, box and box_normals must have the same number of rows", path.display());
    }
    // Twice the filter radius apart, so that no tile sees another.
    let everything: Vec<[f32; 3]> = position.iter().chain(&wall).copied().collect();
    let width = Bounds::of(&everything).map_or(0.0, |b| b.high[0] - b.low[0] + 2.0 * config.filter_radius);
    let repeat = |values: &[[f32; 3]], shift: f32| -> Vec<[f32; 3]> {
        (0..tiles).flat_map(|k| values.iter().map(move |x| [x[0] + k as f32 * shift, x[1], x[2]])).collect()
    };
    let count = position.len() * tiles;
    let particles = Particles {
        position: repeat(&position, width),
        velocity: repeat(&velocity, 0.0),
        id: (0..count as u32).collect(),
        body: vec![0; count],
    };
    Ok((particles, Boundary { position: repeat(&wall, width), normal: repeat(&normal, 0.0) }))
}

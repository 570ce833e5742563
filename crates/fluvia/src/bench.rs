//! `fluvia bench`: times the network on a given state.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use cconv::{Kernel, PositionGradient, Precision};
use fluvia_net::config::Config;
use fluvia_net::integrate::State;
use fluvia_net::loss::{Loss, Surroundings};
use fluvia_net::net::{Activations, Memory, Network, Walls};
use fluvia_net::step::{Step, StepGradients, World};
use fluvia_net::unroll::{Storage, Unroll};
use fluvia_net::weights::Weights;
use fluvia_sim::frames::npz;
use fluvia_sim::metrics::Bounds;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use serde::Serialize;

use crate::options::{PrecisionName, thread_pool, threads};
use crate::report::Report;
use crate::trained;

/// Options of `fluvia bench`.
#[derive(clap::Args)]
#[command(after_help = "\
STATE holds pos, vel, box and box_normals (metres, metres per second). Every repetition starts from it. The
grid of the walls, which do not move, is made once before. The last line printed is a JSON object with the
median in milliseconds.

Example:
  fluvia bench --state state_6k.npz --steps 20")]
pub struct Args {
    /// The state to start from (npz).
    #[arg(long, value_name = "FILE")]
    state: PathBuf,
    /// Weights of the network: a file (.pt, .h5 or .safetensors), or the name of shipped ones (default, viscosity).
    #[arg(long, value_name = "FILE", default_value = trained::DEFAULT)]
    weights: PathBuf,
    /// Repetitions, after one that does not count.
    #[arg(long, value_name = "K", default_value = "20")]
    steps: NonZeroUsize,
    /// What to time.
    #[arg(long, value_enum, default_value_t = Stage::Step)]
    stage: Stage,
    /// The format of the network's large matrix products.
    #[arg(long, value_enum, default_value_t = PrecisionName::F32)]
    precision: PrecisionName,
    /// Repeat the state and its walls side by side along x.
    #[arg(long, value_name = "N", default_value = "1")]
    tile: NonZeroUsize,
    /// Take so many copies of the state, each a cloud of its own, in one call; train-step takes as many at a time as
    /// are at most 16,384 particles, and adds their gradients.
    #[arg(long, value_name = "B", default_value = "1")]
    batch: NonZeroUsize,
    /// Threads; all cores if not given.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// Print the JSON line alone.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, clap::ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Stage {
    /// One step of the network, neighbour search included.
    Step,
    /// All pairs of a step: fluid and fluid, wall and fluid.
    Neighbors,
    /// Two steps of every copy, a loss on their positions, and the gradient of all weights, with the positions as
    /// constants inside the network as in the published training.
    TrainStep,
}

/// The last line that is printed.
#[derive(Serialize)]
struct Timing {
    median_ms: f64,
    /// Of one copy.
    particles: usize,
    batch: usize,
    stage: Stage,
    precision: &'static str,
    kernel: &'static str,
    threads: usize,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    thread_pool(args.threads)?.install(|| {
        if matches!(args.stage, Stage::Neighbors) && args.precision != PrecisionName::F32 {
            bail!("--precision: the search multiplies nothing, expected it with --stage step or train-step");
        }
        let weights = trained::load(&args.weights)?.0;
        let copies = (args.tile.get(), args.batch.get());
        let (particles, boundary) = load(&args.state, &weights.config, copies)?;
        let mut bench = Bench::new(weights, args, &particles, &boundary)?;
        let mut times = Vec::with_capacity(args.steps.get());
        for repetition in 0..=args.steps.get() {
            let start = Instant::now();
            bench.run(args.stage)?;
            if repetition > 0 {
                times.push(1e3 * start.elapsed().as_secs_f64());
            }
        }
        let timing = Timing {
            median_ms: median(&mut times),
            particles: particles.len(),
            batch: args.batch.get(),
            stage: args.stage,
            precision: args.precision.name(),
            kernel: bench.network.kernel().name(),
            threads: rayon::current_num_threads(),
        };
        if !args.json && !report.is_quiet() {
            let all = particles.len() * timing.batch;
            report.result(format_args!(
                "{all} particles, {} wall particles, kernel {}: {:.2} ms ({:.2} to {:.2}), {:.2} µs a particle",
                boundary.position.len() * timing.batch,
                bench.network.kernel().name(),
                timing.median_ms,
                times[0],
                times[times.len() - 1],
                1e3 * timing.median_ms / all.max(1) as f64,
            ))?;
        }
        report.result(serde_json::to_string(&timing)?)?;
        Ok(ExitCode::SUCCESS)
    })
}

/// A network needs several kilobytes a particle: more do not fit into any machine's memory.
const MAX_PARTICLES: usize = 50_000_000;

/// Why a state cannot be timed.
const TOO_FAST: &str = "the speeds of the state lead beyond float32";

/// Steps of the training stage.
const TRAIN_STEPS: usize = 2;

/// Particles whose activations the training stage keeps at once: the copies of a batch are taken some together, and
/// their gradients added.
const TRAIN_PARTICLES: usize = 16_384;

/// Copies of a state and what moves them; the memory is reused from repetition to repetition.
struct Bench {
    weights: Weights,
    precision: Precision,
    network: Network,
    calls: Vec<Call>,
    step: Step,
    memory: Memory,
    unroll: Unroll,
    tensors: Vec<Vec<f32>>,
}

/// The copies that one call takes.
struct Call {
    walls: Walls,
    state: State,
    clouds: Vec<usize>,
    extra: Vec<f32>,
}

impl Bench {
    fn new(weights: Weights, args: &Args, particles: &Particles, boundary: &Boundary) -> Result<Bench> {
        let precision = args.precision.into();
        let network = Network::new(&weights, Kernel::detect())?.with_precision(precision);
        let batch = args.batch.get();
        let together = match args.stage {
            Stage::TrainStep => (TRAIN_PARTICLES / particles.len().max(1)).clamp(1, batch),
            Stage::Step | Stage::Neighbors => batch,
        };
        let call = |first: usize| {
            let copies = together.min(batch - first);
            let starts = |count: usize| (0..=copies).map(|k| k * count).collect::<Vec<_>>();
            let (wall, normal) = (boundary.position.repeat(copies), boundary.normal.repeat(copies));
            let (position, velocity) = (particles.position.repeat(copies), particles.velocity.repeat(copies));
            let extras = weights.config.extra_inputs.len();
            Call {
                walls: network.walls(&wall, &normal, &starts(boundary.position.len())),
                clouds: starts(particles.len()),
                extra: vec![weights.config.viscosity; position.len() * extras],
                state: State { position, velocity },
            }
        };
        Ok(Bench {
            calls: (0..batch).step_by(together).map(call).collect(),
            step: Step::default(),
            memory: Memory::default(),
            unroll: Unroll::new(Storage::Keep),
            tensors: weights.tensors().iter().map(|tensor| vec![0.0; tensor.values.len()]).collect(),
            network,
            precision,
            weights,
        })
    }

    /// One repetition, always from the same state.
    fn run(&mut self, stage: Stage) -> Result<()> {
        let acceleration = Acceleration::Uniform(self.weights.config.gravity);
        if let Stage::TrainStep = stage {
            // The weights change from step to step in training, so preparing them counts.
            self.network = Network::new(&self.weights, Kernel::detect())?.with_precision(self.precision);
            self.tensors.iter_mut().for_each(|tensor| tensor.fill(0.0));
        }
        let Bench { network, calls, step, memory, unroll, tensors, .. } = self;
        for Call { walls, state, clouds, extra } in calls {
            let world = World { extra, acceleration, clouds };
            let before = (state.position.as_slice(), state.velocity.as_slice());
            match stage {
                Stage::Step => {
                    let State { mut position, mut velocity } = state.clone();
                    if !step.forward(network, before, world, walls, Activations::Drop, memory) {
                        bail!("{TOO_FAST}");
                    }
                    step.correct(network, &mut position, &mut velocity);
                }
                Stage::Neighbors => step.search(network, before, world, walls, memory),
                Stage::TrainStep => {
                    if !unroll.forward(network, state, world, walls, TRAIN_STEPS) {
                        bail!("{TOO_FAST}");
                    }
                    // Where nothing moved is as good a truth as any for the time that it takes.
                    let truth = vec![state.clone(); TRAIN_STEPS];
                    let (neighbors, config) = (unroll.neighbor_counts(), network.config());
                    // No walls: only compression asks for them.
                    let around = Surroundings {
                        clouds,
                        wall_position: &[],
                        wall_normal: &[],
                        wall_clouds: &[],
                        config,
                    };
                    let mut by_states = Vec::new();
                    Loss::default().evaluate(unroll.states(), &truth, neighbors, &around, &mut by_states);
                    let wanted = StepGradients {
                        tensors: Some(tensors),
                        positions: PositionGradient::Stop,
                        ..StepGradients::default()
                    };
                    unroll.backward(network, &by_states, world, walls, wanted);
                }
            }
        }
        Ok(())
    }
}

/// Sorts the values; the median of an even number is the mean of the two in the middle.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 { values[middle] } else { (values[middle - 1] + values[middle]) / 2.0 }
}

/// The particles and walls of a state, repeated side by side.
fn load(path: &Path, config: &Config, (tiles, batch): (usize, usize)) -> Result<(Particles, Boundary)> {
    let arrays = npz::read_arrays(path)?;
    let points = |name: &str| -> Result<Vec<[f32; 3]>> {
        let array = arrays.get(name).with_context(|| format!("{}: no array `{name}`", path.display()))?;
        if array.shape.len() != 2 || array.shape[1] != 3 {
            bail!("{}: `{name}` has the shape {:?}, expected (N, 3)", path.display(), array.shape);
        }
        if let Some(i) = array.values.iter().position(|x| !(*x as f32).is_finite()) {
            bail!("{}: `{name}`: row {} is not finite", path.display(), i / 3);
        }
        Ok(array.values.chunks_exact(3).map(|p| [p[0] as f32, p[1] as f32, p[2] as f32]).collect())
    };
    let (position, velocity) = (points("pos")?, points("vel")?);
    let (wall, normal) = (points("box")?, points("box_normals")?);
    if position.len() != velocity.len() || wall.len() != normal.len() {
        bail!("{}: pos and vel, box and box_normals must have the same number of rows", path.display());
    }
    let total = tiles.saturating_mul(batch).saturating_mul(position.len().max(wall.len()));
    if total > MAX_PARTICLES {
        bail!(
            "{}: {tiles} tiles in a batch of {batch} are {total} particles, expected at most {MAX_PARTICLES}",
            path.display()
        );
    }
    // Twice the filter radius apart, so that no tile sees another.
    let everything: Vec<[f32; 3]> = position.iter().chain(&wall).copied().collect();
    let width = Bounds::of(&everything).map_or(0.0, |b| b.high[0] - b.low[0] + 2.0 * config.filter_radius);
    let repeat = |values: &[[f32; 3]], shift: f32| -> Vec<[f32; 3]> {
        (0..tiles).flat_map(|k| values.iter().map(move |x| [x[0] + k as f32 * shift, x[1], x[2]])).collect()
    };
    let particles = Particles::of_one_body(repeat(&position, width), repeat(&velocity, 0.0));
    Ok((particles, Boundary { position: repeat(&wall, width), normal: repeat(&normal, 0.0) }))
}

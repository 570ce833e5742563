//! `fluvia train`: trains a network on the sequences of a data set.
//!
//! ```text
//! RUN/config.json              the settings
//! RUN/checkpoint.safetensors   where to go on, to the same bits
//! RUN/weights.safetensors      the weights of the last checkpoint, as `--weights` takes them
//! RUN/best.safetensors         those with the lowest validation error
//! RUN/metrics.jsonl            what was found on the way; also as TensorBoard's events
//! ```

mod begin;
pub mod config;
mod events;
pub mod log;
mod names;
mod origin;
mod shipped;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_net::checkpoint::{Checkpoint, Place};
use fluvia_net::dataset::{Damaged, DataSet, Loaded, Loader};
use fluvia_net::train::{Progress, Trainer, Validation};
use fluvia_net::weights::{Weights, save_safetensors};
use fluvia_sim::frames;
use indicatif::ProgressBar;
use serde_json::{Value, json};

use crate::interrupt;
use crate::options::{thread_pool, threads};
use crate::record::decimal;
use crate::report::Report;
use begin::{check_data, given_weights, refuse_run, remove_run};
use config::{Config, Data};
use log::{Line, Log};

const SETTINGS: &str = "config.json";
const CHECKPOINT: &str = "checkpoint.safetensors";
const WEIGHTS: &str = "weights.safetensors";
const BEST: &str = "best.safetensors";

/// Options of `fluvia train`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia generate --preset default --out data/default
  fluvia train paper --data data/default --out out/paper
  fluvia train paper --data data/default --out out/paper --resume

DIR of --data has the folders train and valid. A run that was interrupted or killed goes on with --resume from its last
checkpoint, to the same weights as one that was not.")]
pub struct Args {
    /// The settings: a file (TOML), or the name of one in assets/configs.
    #[arg(value_name = "CONFIG")]
    config: String,
    /// A data set, with the folders `train` and `valid`; takes the place of `data` in the settings. May be given several times.
    #[arg(long, value_name = "DIR")]
    data: Vec<PathBuf>,
    /// The directory to write to.
    #[arg(long, value_name = "RUN")]
    out: PathBuf,
    /// Updates of the weights; those of the settings if not given. Schedules shrink with them.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    updates: Option<u64>,
    /// The seed; that of the settings if not given.
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Begin with these weights, a file or the name of shipped ones (default, viscosity), not with random ones. Where
    /// the settings have the viscosity as an input and these weights do not, it begins without influence.
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Updates from one checkpoint to the next.
    #[arg(long, value_name = "K", default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    checkpoint: u64,
    /// Leave out parts of training sequences that cannot be read, with a warning; their first frame must be there.
    #[arg(long)]
    skip_damaged: bool,
    /// Go on where an earlier run stopped.
    #[arg(long)]
    resume: bool,
    /// Train anew in a directory that holds a run.
    #[arg(long, conflicts_with = "resume")]
    overwrite: bool,
    /// Threads; all cores if not given.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// Print a JSON object at the end.
    #[arg(long)]
    json: bool,
}

/// A training: its settings, and how it begins and writes.
pub struct Plan {
    pub config: Config,
    pub out: PathBuf,
    /// Weights to begin with, if not random ones.
    pub weights: Option<PathBuf>,
    /// Updates from one checkpoint to the next.
    pub checkpoint: u64,
    pub skip_damaged: bool,
    pub resume: bool,
    pub overwrite: bool,
}

/// What is known at the end of a training.
pub struct Trained {
    pub place: Place,
    /// The file of the last weights.
    pub weights: PathBuf,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let mut config = Config::load(&args.config)?;
    config.set_updates(args.updates.unwrap_or(config.training.updates));
    config.training.seed = args.seed.unwrap_or(config.training.seed);
    if !args.data.is_empty() {
        config.data = Data::of(&args.data);
    }
    let plan = Plan {
        config,
        out: args.out.clone(),
        weights: args.weights.clone(),
        checkpoint: args.checkpoint,
        skip_damaged: args.skip_damaged,
        resume: args.resume,
        overwrite: args.overwrite,
    };
    let interrupted = interrupt::watch()?;
    let trained = thread_pool(args.threads)?.install(|| train(&plan, &interrupted, report))?;
    let Some(Trained { place: Place { updates, particle_samples, best, seconds, .. }, weights }) = trained
    else {
        report.note("--resume goes on");
        return Ok(interrupt::exit_code());
    };
    if args.json {
        report.result(json!({
            "updates": updates,
            "particle_samples": particle_samples,
            "seconds": seconds,
            "best_update": best.map(|best| best.0),
            "best_err_mm": best.map(|best| 1e3 * best.1),
            "weights": weights,
        }))?;
    } else if !report.is_quiet() {
        report.result(format_args!("{}: {updates} updates", weights.display()))?;
        if let Some((update, error)) = best {
            let error = 1e3 * error;
            report.result(format_args!("lowest validation error {error:.3} mm after update {update}"))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Trains to the end; `None` if the flag told it to stop before.
///
/// # Errors
/// If data or weights cannot be read, the directory holds another training, a file cannot be written, or a loss is not finite.
pub fn train(plan: &Plan, interrupted: &AtomicBool, report: &Report) -> Result<Option<Trained>> {
    Run::new(plan, report)?.train(interrupted)
}

/// Makes sure that a training could begin, and changes nothing. Returns the weights that it would begin with.
///
/// # Errors
/// As [`train`] before its first update.
pub fn check(plan: &Plan, report: &Report) -> Result<Weights> {
    let data = Opened::of(plan)?;
    let sampling = plan.config.sampling(Damaged::Stop);
    data.train.check_windows(sampling.frames())?;
    data.valid.iter().try_for_each(|valid| valid.check_windows(sampling.steps + 1))?;
    Ok(first_state(plan, &data, report)?.0.result())
}

/// The data of a training.
struct Opened {
    train: DataSet,
    valid: Option<DataSet>,
    /// The lowest and the highest viscosity of the training data.
    viscosity: [f32; 2],
}

impl Opened {
    fn of(plan: &Plan) -> Result<Opened> {
        let config = &plan.config;
        if config.data.train.is_empty() {
            bail!("no data: expected --data, or `data.train` in the settings");
        }
        let open = |folders: &[PathBuf]| -> Result<(DataSet, [f32; 2])> {
            if let Some(missing) = folders.iter().find(|folder| !folder.exists()) {
                bail!("{}: not there; --data names another data set", missing.display());
            }
            let data = DataSet::open(folders)?;
            let viscosity = check_data(&data, config)?;
            Ok((data, viscosity))
        };
        let (train, viscosity) = open(&config.data.train)?;
        let valid = &config.data.valid;
        let valid = if valid.is_empty() { None } else { Some(open(valid)?.0) };
        Ok(Opened { train, valid, viscosity })
    }
}

/// Where a training begins or goes on, and whether it begins.
fn first_state(plan: &Plan, data: &Opened, report: &Report) -> Result<(Trainer, Place, bool)> {
    let config = &plan.config;
    let (mut random, options) = (config.first_weights(), config.options());
    let range = config.network.viscosity.then_some(data.viscosity);
    random.config.viscosity_range = range;
    let path = plan.out.join(CHECKPOINT);
    let goes_on = plan.resume && path.exists();
    if !goes_on && !plan.overwrite {
        refuse_run(&plan.out, plan.resume)?;
    }
    let given = plan.weights.as_ref().or(config.training.weights.as_ref());
    // What goes on has its weights.
    let first = match given.filter(|given| !goes_on || given.exists()) {
        Some(given) => Some(given_weights(given, config)?),
        None => None,
    };
    let settings = origin::of(plan, &data.train, data.valid.as_ref(), first.as_ref())?;
    if goes_on {
        let Checkpoint { mut place, weights: values, adam, averages } =
            Checkpoint::load(&path, &random, options.adam)?;
        let old = serde_json::from_str(&place.settings)?;
        let (settings, warnings) =
            origin::going_on(old, settings, place.updates).with_context(|| path.display().to_string())?;
        warnings.iter().for_each(|warning| report.warning(warning));
        place.settings = settings.to_string();
        let mut weights = random;
        weights.values_mut().into_iter().zip(&values).for_each(|(to, from)| to.copy_from_slice(from));
        return Ok((Trainer::resume(options, weights, adam, averages, Kernel::detect())?, place, false));
    }
    let begun = plan.out.join(SETTINGS);
    if plan.resume && begun.exists() {
        origin::going_on(frames::read_json(&begun)?, settings.clone(), 0)
            .with_context(|| begun.display().to_string())?;
    }
    let place = Place { settings: settings.to_string(), ..Place::default() };
    let mut weights = first.map_or(random, |first| first.weights);
    weights.config.viscosity_range = range;
    Ok((Trainer::new(options, weights, Kernel::detect())?, place, true))
}

/// A training that runs.
struct Run<'a> {
    plan: &'a Plan,
    report: &'a Report,
    trainer: Trainer,
    place: Place,
    loader: Loader,
    validation: Option<Validation>,
    log: Log,
    bar: ProgressBar,
    /// When this process began, and the seconds of those before.
    start: (Instant, f64),
}

impl<'a> Run<'a> {
    fn new(plan: &'a Plan, report: &'a Report) -> Result<Run<'a>> {
        let config = &plan.config;
        let damaged = if plan.skip_damaged { Damaged::Skip } else { Damaged::Stop };
        let sampling = config.sampling(damaged);
        let data = Opened::of(plan)?;
        let (trainer, place, begins) = first_state(plan, &data, report)?;
        let validation = match &data.valid {
            Some(valid) => Some(Validation::read(valid, &sampling, config.validation.windows)?),
            None => {
                report.warning("no validation data: the last weights count as the best");
                None
            }
        };
        let loader = Loader::start(&data.train, sampling, place.position)?;
        // Nothing can be wrong any more but the disk.
        if begins {
            std::fs::create_dir_all(&plan.out).with_context(|| plan.out.display().to_string())?;
            remove_run(&plan.out)?;
        } else {
            report
                .note(format_args!("resuming after update {} of {}", place.updates, config.training.updates));
        }
        let settings: Value = serde_json::from_str(&place.settings)?;
        frames::write_json(&plan.out.join(SETTINGS), &settings)?;
        let log = Log::open(&plan.out, place.updates)?;
        let bar = report.bar_like(config.training.updates, "{bar:16} update {pos}/{len}, {msg}, {eta} left");
        bar.set_position(place.updates);
        bar.reset_eta();
        let start = (Instant::now(), place.seconds);
        Ok(Run { plan, report, trainer, place, loader, validation, log, bar, start })
    }

    fn train(mut self, interrupted: &AtomicBool) -> Result<Option<Trained>> {
        let mut shown = None;
        while self.place.updates < self.plan.config.training.updates {
            let begin = Instant::now();
            let Loaded { batch, next, skipped } = match self.loader.take() {
                Ok(loaded) => loaded,
                Err(error) => return self.give_up(error.into()),
            };
            for message in skipped {
                self.bar.suspend(|| self.report.warning(format_args!("left out: {message}")));
            }
            let Progress { loss, gradient, rate } = match self.trainer.step(&batch) {
                Ok(progress) => progress,
                Err(error) => return self.give_up(error.into()),
            };
            let particles = batch.samples();
            let particles_per_s = particles as f64 / begin.elapsed().as_secs_f64().max(1e-9);
            self.place.updates += 1;
            self.place.position = next;
            self.place.particle_samples += particles;
            let updates = self.place.updates;
            let last = updates == self.plan.config.training.updates;
            self.log.add(&Line::Train {
                update: updates,
                loss,
                gradient,
                rate: decimal(rate),
                particles_per_s,
            })?;
            let smooth = shown.map_or(loss, |shown| SMOOTHING * shown + (1.0 - SMOOTHING) * loss);
            shown = Some(smooth);
            let thousand = particles_per_s / 1e3;
            self.bar.set_message(format!("loss {smooth:.3}, rate {rate:.1e}, {thousand:.0}k particles/s"));
            self.bar.inc(1);
            if updates.is_multiple_of(self.plan.config.validation.every) || last {
                self.validate()?;
            }
            let stop = interrupted.load(Ordering::Relaxed);
            if updates.is_multiple_of(self.plan.checkpoint) || last || stop {
                self.save()?;
            }
            if stop && !last {
                self.bar.finish_and_clear();
                self.report.note(format_args!("stopped after update {updates}"));
                return Ok(None);
            }
        }
        self.bar.finish_and_clear();
        let weights = self.plan.out.join(WEIGHTS);
        Ok(Some(Trained { place: Place { seconds: self.seconds(), ..self.place }, weights }))
    }

    /// Ends with an error and with what was learned before it on disk: the weights are still those of the last update.
    fn give_up(&mut self, error: anyhow::Error) -> Result<Option<Trained>> {
        if self.place.updates > 0 {
            self.save().with_context(|| error.to_string())?;
        }
        Err(error)
    }

    /// The errors on the validation windows; the best weights are kept.
    fn validate(&mut self) -> Result<()> {
        let Some(validation) = &self.validation else { return Ok(()) };
        let errors =
            validation.errors(&self.trainer.result(), &self.plan.config.options(), Kernel::detect())?;
        let finite = |value: &f64| value.is_finite();
        let error = |step: usize| errors.position.get(step).copied().filter(finite);
        let mm = |step: usize| error(step).map(|metres| 1e3 * metres);
        let (update, loss) = (self.place.updates, Some(errors.loss).filter(finite));
        self.log.add(&Line::Valid { update, loss, err_n1_mm: mm(0), err_n2_mm: mm(1) })?;
        // By the last step of the windows.
        let Some(judged) = errors.position.last().copied().filter(finite) else { return Ok(()) };
        if self.place.best.is_none_or(|(_, best)| judged < best) {
            self.place.best = Some((update, judged));
            save_safetensors(self.plan.out.join(BEST), &self.result())?;
        }
        Ok(())
    }

    /// The weights to use, with a record of their training.
    fn result(&self) -> Weights {
        let training = json!({
            "updates": self.place.updates,
            "particle_samples": self.place.particle_samples,
            "seconds": self.seconds().round(),
            "validation": self.log.validated(),
            "settings": serde_json::from_str::<Value>(&self.place.settings).unwrap_or_default(),
        });
        Weights { training: Some(training.to_string()), ..self.trainer.result() }
    }

    fn seconds(&self) -> f64 {
        self.start.1 + self.start.0.elapsed().as_secs_f64()
    }

    fn save(&mut self) -> Result<()> {
        self.place.seconds = self.seconds();
        let result = self.result();
        save_safetensors(self.plan.out.join(WEIGHTS), &result)?;
        if self.validation.is_none() {
            save_safetensors(self.plan.out.join(BEST), &result)?;
        }
        let checkpoint = self.trainer.checkpoint(self.place.clone());
        checkpoint.save(&self.plan.out.join(CHECKPOINT), self.trainer.weights())?;
        Ok(())
    }
}

/// How much of the shown loss stays from one update to the next.
const SMOOTHING: f64 = 0.98;

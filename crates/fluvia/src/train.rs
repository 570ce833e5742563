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
mod shipped;

use std::path::{Path, PathBuf};
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
use crate::record::{decimal, first_difference};
use crate::report::Report;
use begin::{check_data, complete, given_weights, settings};
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
    /// Begin with these weights, not with random ones. Where the settings have the viscosity as an input and these weights do
    /// not, it begins without influence.
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
    let weights = match &plan.weights {
        None => plan.config.first_weights(),
        Some(path) => given_weights(path, &plan.config)?,
    };
    Run::new(plan, weights, report)?.train(interrupted)
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
    fn new(plan: &'a Plan, weights: Weights, report: &'a Report) -> Result<Run<'a>> {
        let config = &plan.config;
        let damaged = if plan.skip_damaged { Damaged::Skip } else { Damaged::Stop };
        let sampling = config.sampling(damaged);
        if config.data.train.is_empty() {
            bail!("no data: expected --data, or `data.train` in the settings");
        }
        let data = DataSet::open(&config.data.train)?;
        check_data(&data, config)?;
        let validation = if config.data.valid.is_empty() {
            report.warning("no validation data: the last weights count as the best");
            None
        } else {
            let data = DataSet::open(&config.data.valid)?;
            check_data(&data, config)?;
            Some(Validation::read(&data, &sampling, config.validation.windows)?)
        };
        let settings = settings(plan, &data);
        let path = plan.out.join(CHECKPOINT);
        let options = config.options();
        let (trainer, place) = if plan.resume && path.exists() {
            let Checkpoint { place, weights: values, adam, averages } =
                Checkpoint::load(&path, &weights, options.adam)?;
            let mut old: Value = serde_json::from_str(&place.settings)?;
            // What settings did not have yet is as it is without them.
            complete(&mut old, &serde_json::to_value(Config::default())?);
            let kernel = std::mem::replace(&mut old["kernel"], settings["kernel"].clone());
            if kernel != settings["kernel"] {
                report.warning(format_args!(
                    "begun with the kernel {kernel}, going on with {}: other bits than without the change",
                    settings["kernel"]
                ));
            }
            if let Some((key, old, new)) = first_difference("", &old, &settings) {
                bail!("{}: not the same training, its {key}: {old}, now: {new}", path.display());
            }
            let mut weights = weights;
            weights.values_mut().into_iter().zip(&values).for_each(|(to, from)| to.copy_from_slice(from));
            report
                .note(format_args!("resuming after update {} of {}", place.updates, config.training.updates));
            (Trainer::resume(options, weights, adam, averages, Kernel::detect())?, place)
        } else {
            if path.exists() && !plan.overwrite {
                bail!("{}: holds a training; expected --resume or --overwrite", plan.out.display());
            }
            std::fs::create_dir_all(&plan.out).with_context(|| plan.out.display().to_string())?;
            remove_run(&plan.out)?;
            frames::write_json(&plan.out.join(SETTINGS), &settings)?;
            let place = Place { settings: settings.to_string(), ..Place::default() };
            (Trainer::new(options, weights, Kernel::detect())?, place)
        };
        let loader = Loader::start(&data, sampling, place.position)?;
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
            let Loaded { batch, next, skipped } = self.loader.take()?;
            for message in skipped {
                self.bar.suspend(|| self.report.warning(format_args!("left out: {message}")));
            }
            let begin = Instant::now();
            let Progress { loss, gradient, rate } = match self.trainer.step(&batch) {
                Ok(progress) => progress,
                Err(error) => {
                    // The weights are still those of the update before.
                    self.save()?;
                    return Err(error.into());
                }
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

    /// The errors on the validation windows; the best weights are kept.
    fn validate(&mut self) -> Result<()> {
        let Some(validation) = &self.validation else { return Ok(()) };
        let weights = self.result();
        let errors = validation.errors(&weights, &self.plan.config.options(), Kernel::detect())?;
        let finite = |value: &f64| value.is_finite();
        let error = |step: usize| errors.position.get(step).copied().filter(finite);
        let mm = |step: usize| error(step).map(|metres| 1e3 * metres);
        let (update, loss) = (self.place.updates, Some(errors.loss).filter(finite));
        self.log.add(&Line::Valid { update, loss, err_n1_mm: mm(0), err_n2_mm: mm(1) })?;
        // By the last step of the windows.
        let Some(judged) = errors.position.last().copied().filter(finite) else { return Ok(()) };
        if self.place.best.is_none_or(|(_, best)| judged < best) {
            self.place.best = Some((update, judged));
            save_safetensors(self.plan.out.join(BEST), &weights)?;
        }
        Ok(())
    }

    /// The weights to use, with a record of their training.
    fn result(&self) -> Weights {
        let training = json!({
            "updates": self.place.updates,
            "particle_samples": self.place.particle_samples,
            "seconds": self.seconds().round(),
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

/// Removes what an earlier training has left: a new one that is killed before its first checkpoint must not go on with it.
fn remove_run(out: &Path) -> Result<()> {
    for name in [CHECKPOINT, WEIGHTS, BEST, log::FILE] {
        match std::fs::remove_file(out.join(name)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| out.join(name).display().to_string());
            }
            _ => {}
        }
    }
    Ok(())
}

/// How much of the shown loss stays from one update to the next.
const SMOOTHING: f64 = 0.98;

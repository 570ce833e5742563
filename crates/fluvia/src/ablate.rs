//! `fluvia ablate`: trains variants of a network, each with several seeds, and sets their figures side by side.
//!
//! ```text
//! OUT/NAME/seed_S/   a training, as `fluvia train` writes it, and figures.json, what `fluvia evaluate` finds of it
//! OUT/ablation.json  all figures
//! OUT/ablation.md    the table, beside the paper's
//! ```

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result, bail};
use fluvia_net::{Error, weights};
use fluvia_sim::frames::{self, sequence};
use serde::Serialize;
use serde_json::{Value, json};

use crate::evaluate::{
    self,
    truth::{VALID, find},
};
use crate::interrupt;
use crate::options::{PrecisionName, thread_pool, threads};
use crate::plots::{decimals, range, short};
use crate::record::read_source;
use crate::report::{Report, row};
use crate::train::config::{Config, Data};
use crate::train::{self, Plan, Trained};

const FIGURES: &str = "figures.json";
const JSON: &str = "ablation.json";
const TABLE: &str = "ablation.md";

/// Updates from one checkpoint to the next.
const CHECKPOINT: u64 = 100;

/// The paper's figures, millimetres: Table 2; of the triangular window Table 5.
const PAPER: [(&str, [f64; 5]); 6] = [
    ("paper", [0.67, 1.87, 0.25, 0.74, 30.63]),
    ("without-interpolation", [0.79, 2.24, 0.30, 0.89, 32.39]),
    ("without-window", [0.77, 2.21, 0.30, 0.89, 31.77]),
    ("triangular-window", [0.69, 1.94, 0.27, 0.79, 30.28]),
    ("naive-loss", [0.69, 1.86, 0.27, 0.77, 30.35]),
    ("without-fc", [0.75, 2.17, 0.27, 0.80, 32.49]),
];

/// The keys of these figures.
const KEYS: [(&str, &str); 5] = [
    ("err_n1_mm", "n+1"),
    ("err_n2_mm", "n+2"),
    ("err_n1_last_fifth_mm", "n+1, end"),
    ("err_n2_last_fifth_mm", "n+2, end"),
    ("whole_seq_mm", "d, whole sequence"),
];

/// Options of `fluvia ablate`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia ablate --data data/default --updates 2000 --out out/ablation
  fluvia ablate paper mine.toml --data data/default --updates 5000 --seeds 3 --out out/mine

Without CONFIG the variants are those of the paper's Tables 2 and 5. The same command goes on where it was stopped.")]
pub struct Args {
    /// Settings of the variants: files (TOML), or names of those in assets/configs.
    #[arg(value_name = "CONFIG")]
    configs: Vec<String>,
    /// The data set, with the folders `train` and `valid`.
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// The directory to write to.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Updates of each training; those of its settings if not given. Schedules shrink with it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    updates: Option<u64>,
    /// Seeds of each variant: 0, 1, ...
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// The format of the large matrix products in trainings; that of the settings if not given.
    #[arg(long, value_enum)]
    precision: Option<PrecisionName>,
    /// Threads; all cores if not given.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// Print JSON, not a table.
    #[arg(long)]
    json: bool,
}

/// A variant and what came of it.
#[derive(Serialize)]
struct Variant {
    name: String,
    /// For each seed; null where its training came to a number that is not finite.
    figures: Vec<Value>,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let mut names: Vec<String> = args.configs.clone();
    if names.is_empty() {
        names = PAPER.iter().map(|(name, _)| (*name).to_owned()).collect();
    }
    let configs = names.iter().map(|name| Config::load(name)).collect::<Result<Vec<_>>>()?;
    let stem = |name: &String| Path::new(name).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let names: Vec<String> = names.iter().map(stem).collect();
    if let Some((k, name)) = names.iter().enumerate().find(|(k, name)| names[..*k].contains(name)) {
        bail!("CONFIG {}: two variants are called {name}", k + 1);
    }
    let valid = args.data.join(VALID);
    if !valid.is_dir() || sequence::find(&valid)?.is_empty() {
        bail!("{}: no sequences, expected those that variants are compared on", valid.display());
    }
    // What can be wrong with settings and data shows before the first training.
    for (config, name) in configs.iter().zip(&names) {
        let out = args.out.join(name).join(seed_folder(0));
        let weights = train::check(&plan(args, config.clone(), 0, out), report)?;
        evaluate::check(weights, &valid, report)?;
    }
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    let interrupted = interrupt::watch()?;
    let variants = thread_pool(args.threads)?.install(|| -> Result<Option<Vec<Variant>>> {
        let mut variants: Vec<Variant> =
            names.iter().map(|name| Variant { name: name.clone(), figures: Vec::new() }).collect();
        // All variants with a seed, then all with the next: what was stopped is a table of fewer seeds.
        for seed in 0..args.seeds {
            for (k, config) in configs.iter().enumerate() {
                let out = args.out.join(&names[k]).join(seed_folder(seed));
                report.note(format_args!("{}, seed {seed}", names[k]));
                let plan = plan(args, config.clone(), seed, out);
                let trained = match train::train(&plan, &interrupted, report) {
                    // It is no reason to know nothing of the others.
                    Err(error) if matches!(error.downcast_ref(), Some(Error::NotFinite(_))) => {
                        report.warning(format_args!("{}, seed {seed}: {error}", names[k]));
                        variants[k].figures.push(Value::Null);
                        write(&args.out, &variants)?;
                        continue;
                    }
                    trained => trained?,
                };
                let Some(trained) = trained else { return Ok(None) };
                let Some(figures) = figures(args, &plan, &trained, &interrupted, report)? else {
                    return Ok(None);
                };
                variants[k].figures.push(figures);
                write(&args.out, &variants)?;
            }
        }
        Ok(Some(variants))
    })?;
    let Some(variants) = variants else {
        report.note("stopped; the same command goes on");
        return Ok(interrupt::exit_code());
    };
    report.result(if args.json { json!(variants).to_string() } else { markdown(&variants) })?;
    Ok(ExitCode::SUCCESS)
}

/// Writes what there is so far.
fn write(out: &Path, variants: &[Variant]) -> Result<()> {
    frames::write_json(&out.join(JSON), &variants)?;
    Ok(frames::write_text(&out.join(TABLE), &(markdown(variants) + "\n"))?)
}

/// Where a training with a seed is, in the folder of its variant.
fn seed_folder(seed: u64) -> String {
    format!("seed_{seed}")
}

/// A training that goes on if it has begun.
fn plan(args: &Args, mut config: Config, seed: u64, out: PathBuf) -> Plan {
    config.data = Data::of(std::slice::from_ref(&args.data));
    config.training.seed = seed;
    config.set_updates(args.updates.unwrap_or(config.training.updates));
    config.training.precision = args.precision.unwrap_or(config.training.precision);
    Plan {
        config,
        out,
        weights: None,
        checkpoint: CHECKPOINT,
        skip_damaged: false,
        resume: true,
        overwrite: false,
    }
}

/// The figures of a training: those on disk if they are of the same weights on the same data. `None` if it was told to stop.
fn figures(
    args: &Args,
    plan: &Plan,
    trained: &Trained,
    interrupted: &AtomicBool,
    report: &Report,
) -> Result<Option<Value>> {
    let (path, valid) = (plan.out.join(FIGURES), args.data.join(VALID));
    let (bytes, source) = read_source(&trained.weights)?;
    let of = json!({ "weights_sha256": source.sha256, "data": sizes(&valid)? });
    if path.exists() {
        let mut old: Value = frames::read_json(&path)?;
        if old["of"] == of {
            return Ok(Some(old["figures"].take()));
        }
    }
    let weights = weights::from_bytes(&trained.weights, bytes)?;
    let Some(figures) = evaluate::of_weights(weights, &valid, interrupted, report)? else {
        return Ok(None);
    };
    let figures = serde_json::to_value(figures)?;
    frames::write_json(&path, &json!({ "of": of, "figures": figures }))?;
    Ok(Some(figures))
}

/// The validation scenes by the sizes of their files: others are compressed to others.
fn sizes(data: &Path) -> Result<Vec<u64>> {
    let mut sizes = Vec::new();
    for path in find(data)? {
        for part in sequence::find(&path)?.into_iter().flat_map(|files| files.parts) {
            let metadata = std::fs::metadata(&part).with_context(|| part.display().to_string())?;
            sizes.push(metadata.len());
        }
    }
    Ok(sizes)
}

/// Means over seeds with half of their range, and in brackets what the paper has.
fn markdown(variants: &[Variant]) -> String {
    let counts = || variants.iter().map(|variant| variant.figures.len());
    let (fewest, most) = (counts().min().unwrap_or_default(), counts().max().unwrap_or_default());
    let means = match most {
        _ if fewest < most => format!("Means of up to {most} seeds ± half of their range, not done yet"),
        1 => "One seed".to_owned(),
        _ => format!("Means of {most} seeds ± half of their range"),
    };
    let mut lines = vec![format!("{means}, mm; in brackets the paper's.")];
    lines.push(String::new());
    lines.push(row("variant", KEYS.iter().map(|(_, title)| (*title).to_owned())));
    lines.push("| --- |".to_owned() + &" --- |".repeat(KEYS.len()));
    for Variant { name, figures } in variants {
        let paper = PAPER.iter().find(|(known, _)| known == name).map(|(_, values)| values);
        let cell = |(k, (key, _)): (usize, &(&str, &str))| {
            let values: Option<Vec<f64>> = figures.iter().map(|one| one[*key].as_f64()).collect();
            let found = match values.as_deref() {
                None | Some([]) => "none".into(),
                Some([only]) => short(*only),
                Some(values) => {
                    let mean = values.iter().sum::<f64>() / values.len() as f64;
                    let (low, high) = range(values.iter().copied());
                    format!("{mean:.0$} ± {1:.0$}", decimals(mean), (high - low) / 2.0)
                }
            };
            match paper {
                Some(values) => format!("{found} ({})", values[k]),
                None => found,
            }
        };
        lines.push(row(name, KEYS.iter().enumerate().map(cell)));
    }
    lines.join("\n")
}

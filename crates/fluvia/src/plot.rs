//! `fluvia plot`: the curves of trainings as a picture.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use fluvia_sim::frames;

use crate::curves::Curve;
use crate::options::labelled;
use crate::plots::{self, Panel, Scale};
use crate::report::Report;
use crate::train::log::{FILE, Line, read_whole};

/// The picture of one run, in its directory.
const PICTURE: &str = "curves.svg";

/// A curve has at most so many points: means of as many updates.
const POINTS: usize = 300;

/// Panels in a row.
const COLUMNS: usize = 3;

/// Options of `fluvia plot`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia plot out/paper
  fluvia plot paper=out/paper velocity=out/velocity --out curves.svg")]
pub struct Args {
    /// The directory of a training; LABEL=RUN names it.
    #[arg(value_name = "RUN", required = true)]
    runs: Vec<String>,
    /// The picture (SVG); RUN/curves.svg for one run if not given.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// The numbers of a training.
struct Training<'a> {
    label: &'a str,
    /// Updates, loss, length of the gradient, rate, particles a second.
    train: [Vec<f64>; 5],
    /// Updates of validations, and errors after one and two steps.
    validated: Vec<f64>,
    errors: [Curve; 2],
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let out = match (&args.out, args.runs.as_slice()) {
        (Some(out), _) => out.clone(),
        (None, [run]) => labelled(run).1.join(PICTURE),
        (None, _) => bail!("several runs: expected --out for their picture"),
    };
    let trainings = args.runs.iter().map(|run| read(run)).collect::<Result<Vec<_>>>()?;
    let picture = picture(&trainings).map_err(|error| anyhow::anyhow!("{}: {error}", out.display()))?;
    frames::write_text(&out, &picture)?;
    if !report.is_quiet() {
        report.result(out.display())?;
    }
    Ok(ExitCode::SUCCESS)
}

fn read(run: &str) -> Result<Training<'_>> {
    let (label, path) = labelled(run);
    let path = path.join(FILE);
    let mut training =
        Training { label, train: Default::default(), validated: Vec::new(), errors: Default::default() };
    for line in read_whole(&path)? {
        match line {
            Line::Train { update, loss, gradient, rate, particles_per_s } => {
                let values = [update as f64, loss, gradient, rate, particles_per_s];
                training.train.iter_mut().zip(values).for_each(|(curve, value)| curve.push(value));
            }
            Line::Valid { update, err_n1_mm, err_n2_mm, .. } => {
                training.validated.push(update as f64);
                training.errors[0].push(err_n1_mm);
                training.errors[1].push(err_n2_mm);
            }
        }
    }
    if training.train[0].is_empty() {
        bail!("{}: no updates yet", path.display());
    }
    Ok(Training { train: training.train.map(|values| thinned(&values)), ..training })
}

fn picture(runs: &[Training<'_>]) -> Result<String, String> {
    let panel = |title, scale, curve: &dyn Fn(&Training<'_>) -> (Vec<f64>, Curve)| {
        let curves = runs.iter().map(|run| {
            let (at, values) = curve(run);
            (run.label, at, values)
        });
        Panel { title, across: "updates", scale, curves: curves.collect() }
    };
    let train = |k: usize| {
        move |run: &Training<'_>| (run.train[0].clone(), run.train[k].iter().copied().map(Some).collect())
    };
    let valid = |k: usize| move |run: &Training<'_>| (run.validated.clone(), run.errors[k].clone());
    let panels = [
        panel("loss", Scale::Logarithmic, &train(1)),
        panel("validation: error after one step, mm", Scale::Logarithmic, &valid(0)),
        panel("validation: error after two steps, mm", Scale::Logarithmic, &valid(1)),
        panel("rate", Scale::Logarithmic, &train(3)),
        panel("length of the gradient", Scale::Logarithmic, &train(2)),
        panel("particles a second", Scale::Linear, &train(4)),
    ];
    plots::svg(&panels, COLUMNS)
}

/// Means of so many values in a row that few are left.
fn thinned(values: &[f64]) -> Vec<f64> {
    let size = values.len().div_ceil(POINTS).max(1);
    values.chunks(size).map(|chunk| chunk.iter().sum::<f64>() / chunk.len() as f64).collect()
}

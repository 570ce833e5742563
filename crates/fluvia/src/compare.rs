//! `fluvia compare`: how far two runs of one scene are apart, and in what.

mod plots;
mod table;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use fluvia_sim::frames;
use fluvia_sim::metrics::{Bounds, distance_to_closest};
use serde::Serialize;

use crate::curves::{Curves, Surroundings};
use crate::frame_source::FrameSource;
use crate::options::{positive, thread_pool, threads};
use crate::report::Report;
use table::Difference;

/// The files that `--out` writes.
const JSON: &str = "compare.json";
const TABLE: &str = "compare.md";
const PLOTS: &str = "compare.svg";

/// Options of `fluvia compare`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia compare dfsph=out/dfsph pbf=out/pbf
  fluvia compare truth=data/valid/sim_0206 network=out/net --out out/compare
  fluvia compare out/1ms out/5ms --control out/1ms_seed_1 --out out/figure_6

The distance d of Eq. 18 is the mean distance from the particles of one run to the closest of the other. After the first
impact it measures chaos as much as error: a control, a run like A but for the seed of its wall particles, shows how much
of it says nothing, and the other curves how much alike the runs are as fluids.")]
pub struct Args {
    /// A directory of frames, or a sequence of a data set: what is right, if one of them is. LABEL=FRAMES names it.
    #[arg(value_name = "A")]
    a: String,
    /// The frames to compare with it.
    #[arg(value_name = "B")]
    b: String,
    /// A run like A that differs in what should not matter.
    #[arg(long, value_name = "C")]
    control: Option<String>,
    /// Every K-th frame only.
    #[arg(long, value_name = "K", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    /// The directory to write compare.json, compare.md and compare.svg to.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seconds between frames where that is not recorded, as in sequences; 0.02 if not given.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    dt: Option<f32>,
    /// Threads; all cores if not given.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// Print a JSON object with all curves, not a table.
    #[arg(long)]
    json: bool,
}

/// A run, with the name that it has in tables.
pub struct Run {
    pub label: String,
    pub source: FrameSource,
}

/// Everything that is found, as it is printed and written.
#[derive(Serialize)]
pub struct Comparison {
    /// The numbers of the frames.
    pub frame: Vec<u64>,
    /// Their times, seconds.
    pub time_s: Vec<f64>,
    pub distance: Distances,
    /// Of A and of B.
    pub runs: [Curves; 2],
    pub differences: Vec<Difference>,
}

/// d^n of Eq. 18, metres; `None` where a frame has no particles.
#[derive(Default, Serialize)]
pub struct Distances {
    /// From the particles of A to the closest of B.
    pub a_to_b_m: Vec<Option<f64>>,
    /// From the particles of B to the closest of A.
    pub b_to_a_m: Vec<Option<f64>>,
    /// From the particles of A to the closest of the control.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control_m: Option<Vec<Option<f64>>>,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let open = |text: &String| -> Result<Run> {
        let (label, source) = FrameSource::open_labelled(text, args.dt)?;
        Ok(Run { label, source })
    };
    let (mut a, mut b) = (open(&args.a)?, open(&args.b)?);
    let mut control = args.control.as_ref().map(open).transpose()?;
    let frame = common_frames(&a, [Some(&b), control.as_ref()], args.every)?;
    if let Some(out) = &args.out {
        std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    }
    if a.source.gravity != b.source.gravity {
        report.warning(format_args!("{} and {} have different gravity", a.label, b.label));
    }
    let [in_a, in_b] = [&mut a, &mut b].map(|run| run.source.read(frame[0]).map(|data| data.position.len()));
    let (in_a, in_b) = (in_a?, in_b?);
    if in_a != in_b {
        let (first, a, b) = (frame[0], &a.label, &b.label);
        report.warning(format_args!(
            "{a} has {in_a} particles in frame {first}, {b} {in_b}: not the same scene?"
        ));
    }
    let comparison =
        thread_pool(args.threads)?.install(|| compare(&mut a, &mut b, control.as_mut(), frame, report))?;
    if let Some(out) = &args.out {
        write(out, &comparison)?;
    }
    if args.json {
        report.result(serde_json::to_string(&comparison)?)?;
    } else {
        report.result(table::markdown(&comparison))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The frames that all runs have, every `every`-th.
fn common_frames(a: &Run, others: [Option<&Run>; 2], every: u64) -> Result<Vec<u64>> {
    let mut frames = a.source.numbers().to_vec();
    let path = a.source.path().display();
    for other in others.into_iter().flatten() {
        let other_path = other.source.path().display();
        if (other.source.dt - a.source.dt).abs() > 1e-6 * a.source.dt {
            let (dt, other_dt) = (a.source.dt, other.source.dt);
            bail!(
                "{other_path}: {other_dt} s between frames, but {path} has {dt} s (--dt says it where nothing is recorded)"
            );
        }
        if other.source.particle_radius != a.source.particle_radius {
            let (radius, other_radius) = (a.source.particle_radius, other.source.particle_radius);
            bail!("{other_path}: particle radius {other_radius} m, but {path} has {radius} m");
        }
        frames.retain(|number| other.source.numbers().binary_search(number).is_ok());
        if frames.is_empty() {
            bail!("{other_path}: no frame has the number of one in {path}");
        }
    }
    let first = frames[0];
    frames.retain(|number| (number - first).is_multiple_of(every));
    Ok(frames)
}

fn compare(
    a: &mut Run,
    b: &mut Run,
    mut control: Option<&mut Run>,
    frame: Vec<u64>,
    report: &Report,
) -> Result<Comparison> {
    let bar = report.bar(frame.len() as u64);
    let mut distance = Distances { control_m: control.as_ref().map(|_| Vec::new()), ..Distances::default() };
    let curves = |run: &Run| {
        let source = &run.source;
        let scene = Surroundings {
            walls: Bounds::of(&source.walls().position),
            particle_radius: source.particle_radius,
            gravity: source.gravity,
        };
        Curves::new(&run.label, source.path(), scene)
    };
    let mut runs = [curves(a), curves(b)];
    for &number in &frame {
        let [in_a, in_b] = [a.source.read(number)?, b.source.read(number)?];
        distance.a_to_b_m.push(distance_to_closest(&in_a.position, &in_b.position));
        distance.b_to_a_m.push(distance_to_closest(&in_b.position, &in_a.position));
        if let (Some(control), Some(distances)) = (&mut control, &mut distance.control_m) {
            distances.push(distance_to_closest(&in_a.position, &control.source.read(number)?.position));
        }
        for (curves, (run, frame)) in runs.iter_mut().zip([(&*a, in_a), (&*b, in_b)]) {
            let without = || format!("{}: frames without velocities", run.source.path().display());
            curves.measure(&frame.position, &frame.velocity.with_context(without)?);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let time_s = frame.iter().map(|&number| number as f64 * a.source.dt).collect();
    let differences = table::differences(&runs, &frame);
    Ok(Comparison { frame, time_s, distance, runs, differences })
}

fn write(out: &Path, comparison: &Comparison) -> Result<()> {
    let plots = plots::svg(comparison).map_err(|error| anyhow::anyhow!("{}: {error}", out.display()))?;
    frames::write_json(&out.join(JSON), comparison)?;
    frames::write_text(&out.join(TABLE), &(table::markdown(comparison) + "\n"))?;
    Ok(frames::write_text(&out.join(PLOTS), &plots)?)
}

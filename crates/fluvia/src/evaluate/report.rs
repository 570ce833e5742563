//! What was found as JSON, as Markdown and as pictures.

use std::path::Path;

use anyhow::{Result, anyhow};
use fluvia_sim::frames;
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::figures::{Figures, StateFigures};
use super::{Evaluation, Outcome, Results, Sequence};
use crate::curves::{Curve, Curves};
use crate::plots::{self, Panel, Scale};
use crate::report::row;

/// The files that `--out` writes, beside a picture for each sequence.
const JSON: &str = "report.json";
const TABLE: &str = "report.md";

/// Panels in a row of a picture.
const COLUMNS: usize = 4;

/// What the file has beside what is printed.
#[derive(Serialize)]
struct SequenceCurves<'a> {
    time_s: Vec<f64>,
    truth: &'a Curves,
    solvers: Vec<&'a Curves>,
}

/// One object with the figures of the solver and, by name, those of each sequence; of several solvers such an object for
/// each, by label. What there is of the truth is under its name.
pub fn json(results: &Results) -> Value {
    let mut of_each: Map<String, Value> =
        results.evaluations.iter().map(|one| (one.label.clone(), figures(results, one))).collect();
    let mut object = match results.evaluations.as_slice() {
        [only] => of_each.remove(&only.label).unwrap_or_default(),
        _ => json!({ "solvers": of_each }),
    };
    object["truth"] = json!(truth(results));
    object
}

/// What there is of the truth, of all sequences together.
fn truth(results: &Results) -> StateFigures {
    let curves: Vec<(&Curves, usize)> =
        results.sequences.iter().map(|one| (&one.truth, one.truth.particles.len())).collect();
    StateFigures::of(&curves)
}

fn figures(results: &Results, evaluation: &Evaluation) -> Value {
    let object = |parts: &[(&Sequence, &Outcome)]| json!(Figures::of(parts));
    let parts: Vec<(&Sequence, &Outcome)> = results.sequences.iter().zip(&evaluation.outcomes).collect();
    let mut all = object(&parts);
    all["lone_acceleration_m_per_s2"] = json!(evaluation.lone_acceleration);
    let each: Map<String, Value> =
        parts.iter().map(|part| (part.0.name.clone(), object(std::slice::from_ref(part)))).collect();
    all["sequences"] = Value::Object(each);
    all
}

/// Writes the report and a picture for each sequence.
///
/// # Errors
/// If a file cannot be written.
pub fn write(out: &Path, results: &Results) -> Result<()> {
    let mut report = json(results);
    let mut curves = Map::new();
    for (k, sequence) in results.sequences.iter().enumerate() {
        let solvers = results.evaluations.iter().map(|one| &one.outcomes[k].curves).collect();
        let one = SequenceCurves { time_s: times(sequence), truth: &sequence.truth, solvers };
        curves.insert(sequence.name.clone(), serde_json::to_value(one)?);
        let path = out.join(format!("{}.svg", sequence.name));
        let picture = picture(results, k).map_err(|error| anyhow!("{}: {error}", path.display()))?;
        frames::write_text(&path, &picture)?;
    }
    report["curves"] = Value::Object(curves);
    frames::write_json(&out.join(JSON), &report)?;
    Ok(frames::write_text(&out.join(TABLE), &(markdown(results) + "\n"))?)
}

/// The time of each frame, seconds.
fn times(sequence: &Sequence) -> Vec<f64> {
    (0..sequence.truth.particles.len() as u64).map(|k| (sequence.first + k) as f64 * sequence.dt).collect()
}

/// The curves of all solvers on sequence `k`.
fn picture(results: &Results, k: usize) -> Result<String, String> {
    let sequence = &results.sequences[k];
    let time = times(sequence);
    let at = |frame: u64| frame as f64 * sequence.dt;
    let outcomes = || results.evaluations.iter().map(move |one| (one.label.as_str(), &one.outcomes[k]));
    let scaled = |value: Option<f64>| value.map(|value| 1e3 * value);
    let panel = |title, curves| Panel { title, across: "time, s", scale: Scale::Linear, curves };
    // The truth has the first colour in all panels.
    let of_solvers = |mut curves: Vec<_>| {
        curves.insert(0, ("truth", Vec::new(), Vec::new()));
        curves
    };
    let error = |title, n: usize| {
        let curves = outcomes().map(|(label, one)| {
            let (at, curve) =
                one.starts.iter().map(|start| (at(start.frame), scaled(start.errors[n]))).unzip();
            (label, at, curve)
        });
        panel(title, of_solvers(curves.collect()))
    };
    let distance = outcomes().map(|(label, one)| {
        let compared = one.rolled.compared.iter();
        let (at, curve) = compared.map(|frame| (at(frame.frame), scaled(frame.distance))).unzip();
        (label, at, curve)
    });
    let all = |title, curve: &dyn Fn(&Curves) -> Curve| {
        let mut curves = vec![("truth", time.clone(), curve(&sequence.truth))];
        curves.extend(outcomes().map(|(label, one)| (label, time.clone(), curve(&one.curves))));
        panel(title, curves)
    };
    let dense = |run: &Curves| run.dense_particles.iter().map(|&count| Some(count as f64)).collect();
    let panels = [
        panel("distance d of Eq. 18, mm", of_solvers(distance.collect())),
        error("error one frame after a start, mm", 0),
        error("error two frames after a start, mm", 1),
        all("height of the centre of mass, m", &Curves::height),
        all("kinetic energy per mass, J/kg", &|run| run.kinetic_energy_j_per_kg.clone()),
        all("mean speed, m/s", &|run| run.mean_speed_m_per_s.clone()),
        all("highest density over rest density", &|run| run.highest_density.clone()),
        all("particles above 1.05 of rest density", &dense),
    ];
    plots::svg(&panels, COLUMNS)
}

/// The figures as tables: of all sequences together, and the main ones of each.
pub fn markdown(results: &Results) -> String {
    let evaluations = &results.evaluations;
    let labels = || evaluations.iter().map(|one| one.label.clone());
    let rule = || "| --- |".to_owned() + &" --- |".repeat(evaluations.len());
    let all: Vec<Figures> = evaluations
        .iter()
        .map(|one| Figures::of(&results.sequences.iter().zip(&one.outcomes).collect::<Vec<_>>()))
        .collect();
    let frames: usize = results.sequences.iter().map(|sequence| sequence.truth.particles.len()).sum();
    let sequences = results.sequences.len();
    let noun = if sequences == 1 { "sequence" } else { "sequences" };
    let mut lines = vec![format!("{sequences} {noun}, {frames} frames"), String::new()];
    lines.push(row("figure", ["truth".to_owned()].into_iter().chain(labels())));
    lines.push(rule() + " --- |");
    type Row<F> = (&'static str, fn(&F) -> String);
    let rows: [Row<Figures>; 13] = [
        ("error at n+1, mm", |f| number(f.err_n1_mm)),
        ("error at n+2, mm", |f| number(f.err_n2_mm)),
        ("error at n+1, last fifth, mm", |f| number(f.err_n1_last_fifth_mm)),
        ("error at n+2, last fifth, mm", |f| number(f.err_n2_last_fifth_mm)),
        ("d of Eq. 18, whole sequence, mm", |f| number(f.whole_seq_mm)),
        ("d from predicted to true, mm", |f| number(f.whole_seq_back_mm)),
        ("d as in the published evaluator, mm", |f| number(f.whole_seq_published_loop_mm)),
        ("height of the centre of mass, mean error, mm", |f| number(f.height_error_mm)),
        ("the same in frame 20, too high, mm", |f| number(f.height_error_frame_20_mm)),
        ("momentum per mass, mean error, m/s", |f| number(f.momentum_error_m_per_s)),
        ("energy per mass, mean error, J/kg", |f| number(f.energy_error_j_per_kg)),
        ("frames that are not finite", |f| f.non_finite_frames.to_string()),
        ("unstable from frame", |f| f.unstable_from.map_or("never".into(), |frame| frame.to_string())),
    ];
    lines.extend(rows.map(|(name, text)| row(name, [String::new()].into_iter().chain(all.iter().map(text)))));
    let rows: [Row<StateFigures>; 6] = [
        ("particles outside, last frame", |f| count(f.outside)),
        ("particles outside, worst frame", |f| count(f.worst_outside)),
        ("highest density over rest density", |f| number(f.highest_density)),
        ("particles above 1.05, worst frame", |f| count(f.worst_dense_particles)),
        ("particles above 1.05, last fifth", |f| number(f.dense_particles_last_fifth)),
        ("mean speed, last fifth, m/s", |f| number(f.speed_last_fifth_m_per_s)),
    ];
    let exact = truth(results);
    let states = || [&exact].into_iter().chain(all.iter().map(|f| &f.state));
    lines.extend(rows.map(|(name, text)| row(name, states().map(text))));
    let lone = evaluations.iter().map(|one| number(one.lone_acceleration.map(length)));
    lines.push(row("acceleration of a particle alone, m/s²", [String::new()].into_iter().chain(lone)));
    lines.push(String::new());
    lines.push(row("n+1, n+2, whole sequence, mm", labels()));
    lines.push(rule());
    for (k, sequence) in results.sequences.iter().enumerate() {
        let cells = evaluations.iter().map(|one| {
            let f = Figures::of(&[(sequence, &one.outcomes[k])]);
            format!("{}, {}, {}", number(f.err_n1_mm), number(f.err_n2_mm), number(f.whole_seq_mm))
        });
        lines.push(row(&sequence.name, cells));
    }
    lines.join("\n")
}

/// A number with four digits, or that there is none.
fn number(value: Option<f64>) -> String {
    value.map_or("none".into(), plots::short)
}

fn count(value: Option<usize>) -> String {
    value.map_or("none".into(), |count| count.to_string())
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

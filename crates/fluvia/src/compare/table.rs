//! The differences between two runs, and the Markdown table of them.

use serde::Serialize;

use super::Comparison;
use crate::curves::{Curve, Curves};

/// Figures that fluctuate are means over this part of the frames, the last.
const END: f64 = 0.2;

/// How far a curve of B is from that of A.
#[derive(Serialize)]
pub struct Difference {
    /// What the curve is of.
    pub quantity: &'static str,
    pub unit: &'static str,
    /// The highest value of A less its lowest.
    pub range: f64,
    /// The largest |A - B|, and the frame it is at.
    pub largest: f64,
    pub at_frame: u64,
    /// The mean of |A - B|.
    pub mean: f64,
    /// The mean values of A and B over the last fifth of the frames.
    pub end: [f64; 2],
}

/// The differences of all curves that are compared; of frames in which both runs have particles.
pub fn differences(runs: &[Curves; 2], frame: &[u64]) -> Vec<Difference> {
    type Quantity = (&'static str, &'static str, fn(&Curves) -> Curve);
    let quantities: [Quantity; 5] = [
        ("kinetic energy per mass", "J/kg", |run| run.kinetic_energy_j_per_kg.clone()),
        ("potential energy per mass", "J/kg", |run| run.potential_energy_j_per_kg.clone()),
        ("height of the centre of mass", "m", Curves::height),
        ("horizontal spread", "m", |run| run.spread_m.clone()),
        ("surface height", "m", |run| run.surface_height_m.clone()),
    ];
    let differences = quantities.into_iter().filter_map(|(quantity, unit, curve)| {
        let [a, b] = [curve(&runs[0]), curve(&runs[1])];
        let pairs: Vec<(u64, f64, f64)> =
            frame.iter().zip(a.iter().zip(&b)).filter_map(|(&n, (a, b))| Some((n, (*a)?, (*b)?))).collect();
        let apart: Vec<f64> = pairs.iter().map(|&(_, a, b)| (a - b).abs()).collect();
        let farthest = (0..pairs.len()).max_by(|&i, &k| apart[i].total_cmp(&apart[k]))?;
        let [a, b]: [Vec<f64>; 2] =
            [pairs.iter().map(|pair| pair.1).collect(), pairs.iter().map(|pair| pair.2).collect()];
        let end = end_of(pairs.len());
        Some(Difference {
            quantity,
            unit,
            range: a.iter().copied().fold(f64::MIN, f64::max) - a.iter().copied().fold(f64::MAX, f64::min),
            largest: apart[farthest],
            at_frame: pairs[farthest].0,
            mean: mean(&apart),
            end: [mean(&a[end..]), mean(&b[end..])],
        })
    });
    differences.collect()
}

/// Where the last fifth of `count` values begins; there is at least one in it.
fn end_of(count: usize) -> usize {
    count - ((END * count as f64).ceil() as usize).clamp(1, count.max(1)).min(count)
}

/// The comparison as a table.
pub fn markdown(comparison: &Comparison) -> String {
    let Comparison { frame, time_s, distance, runs, differences } = comparison;
    let [a, b] = runs;
    let count = frame.len();
    let mut lines = vec![format!(
        "A: {} ({} particles), B: {} ({} particles); {count} frames, {} to {}, {:.2} s",
        a.label,
        a.particles.last().copied().unwrap_or_default(),
        b.label,
        b.particles.last().copied().unwrap_or_default(),
        frame.first().copied().unwrap_or_default(),
        frame.last().copied().unwrap_or_default(),
        time_s.last().copied().unwrap_or_default() - time_s.first().copied().unwrap_or_default(),
    )];
    lines.push(String::new());
    lines.push(
        "| curve | range of A | largest difference | at frame | mean difference | last fifth, A | B |".into(),
    );
    lines.push("| --- | --- | --- | --- | --- | --- | --- |".into());
    for Difference { quantity, unit, range, largest, at_frame, mean, end } in differences {
        let part = |value: f64| {
            if *range > 0.0 { format!(" ({:.1} %)", 100.0 * value / range) } else { String::new() }
        };
        lines.push(format!(
            "| {quantity}, {unit} | {range:.4} | {largest:.4}{} | {at_frame} | {mean:.4}{} | {:.4} | {:.4} |",
            part(*largest),
            part(*mean),
            end[0],
            end[1]
        ));
    }
    lines.push(String::new());
    lines.push("| d of Eq. 18, mm | mean | largest | last |".into());
    lines.push("| --- | --- | --- | --- |".into());
    let distances = [
        ("A to B", Some(&distance.a_to_b_m)),
        ("B to A", Some(&distance.b_to_a_m)),
        ("control", distance.control_m.as_ref()),
    ];
    for (name, curve) in distances {
        let Some(curve) = curve else { continue };
        let millimetres: Vec<f64> = curve.iter().flatten().map(|d| 1e3 * d).collect();
        if millimetres.is_empty() {
            lines.push(format!("| {name} | none | none | none |"));
            continue;
        }
        let [mean, largest] = [mean(&millimetres), millimetres.iter().copied().fold(0.0, f64::max)];
        let last = millimetres.last().copied().unwrap_or_default();
        lines.push(format!("| {name} | {mean:.2} | {largest:.2} | {last:.2} |"));
    }
    lines.push(String::new());
    lines.push("| run | outside, worst and last frame | highest density, all frames and last fifth | particles above 1.05, worst and last fifth | nearest neighbour, last fifth, mm: median, smallest |".into());
    lines.push("| --- | --- | --- | --- | --- |".into());
    for (name, run) in [("A", a), ("B", b)] {
        let end = end_of(count);
        let highest = |curve: &[Option<f64>]| curve.iter().flatten().copied().fold(0.0, f64::max);
        let dense: Vec<f64> = run.dense_particles[end..].iter().map(|&n| n as f64).collect();
        let median: Vec<f64> = run.nearest_median_m[end..].iter().flatten().copied().collect();
        let smallest = run.nearest_smallest_m[end..].iter().flatten().copied().reduce(f64::min);
        lines.push(format!(
            "| {name} | {}, {} | {:.3}, {:.3} | {}, {:.1} | {:.1}, {} |",
            run.outside.iter().max().copied().unwrap_or_default(),
            run.outside.last().copied().unwrap_or_default(),
            highest(&run.highest_density),
            highest(&run.highest_density[end..]),
            run.dense_particles.iter().max().copied().unwrap_or_default(),
            mean(&dense),
            1e3 * mean(&median),
            smallest.map_or("none".into(), |d| format!("{:.1}", 1e3 * d)),
        ));
    }
    lines.join("\n")
}

/// The mean; 0 of no values.
fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

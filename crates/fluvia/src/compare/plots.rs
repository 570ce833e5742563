//! The curves of two runs as an SVG picture of six panels.

use super::Comparison;
use crate::curves::{Curve, Curves};
use crate::plots::{self, Panel, Scale};

const COLUMNS: usize = 3;

/// Draws the comparison.
///
/// # Errors
/// What the drawing library reports.
pub fn svg(comparison: &Comparison) -> Result<String, String> {
    let Comparison { time_s, distance, runs: [a, b], .. } = comparison;
    let panel = |title, curves| Panel { title, across: "time, s", scale: Scale::Linear, curves };
    let mut distances = vec![("A to B", &distance.a_to_b_m), ("B to A", &distance.b_to_a_m)];
    distances.extend(distance.control_m.iter().map(|control| ("control", control)));
    let scaled = |(label, curve): (_, &Curve)| {
        (label, time_s.clone(), curve.iter().map(|value| value.map(|value| 1e3 * value)).collect())
    };
    let both = |title, curve: fn(&Curves) -> Curve| {
        panel(title, [a, b].map(|run| (run.label.as_str(), time_s.clone(), curve(run))).to_vec())
    };
    let panels = [
        panel("distance d of Eq. 18, mm", distances.into_iter().map(scaled).collect()),
        both("kinetic energy per mass, J/kg", |run| run.kinetic_energy_j_per_kg.clone()),
        both("height of the centre of mass, m", Curves::height),
        both("surface height, m", |run| run.surface_height_m.clone()),
        both("horizontal spread, m", |run| run.spread_m.clone()),
        both("highest density over rest density", |run| run.highest_density.clone()),
    ];
    plots::svg(&panels, COLUMNS)
}

//! The curves of two runs as an SVG picture of six panels.

use plotters::prelude::*;

use super::Comparison;
use crate::curves::{Curve, Curves};

/// Pixels.
const SIZE: (u32, u32) = (1200, 720);
const TEXT: (&str, i32) = ("sans-serif", 14);
const TITLE: (&str, i32) = ("sans-serif", 16);

/// Of A, of B and of the control: told apart by those who do not see colours too, A is drawn thicker.
const COLORS: [RGBColor; 3] = [RGBColor(31, 119, 180), RGBColor(214, 39, 40), RGBColor(127, 127, 127)];

struct Panel<'a> {
    title: &'static str,
    curves: Vec<(&'a str, Curve)>,
}

/// Draws the comparison.
///
/// # Errors
/// What the drawing library reports.
pub fn svg(comparison: &Comparison) -> Result<String, String> {
    let Comparison { time_s, distance, runs: [a, b], .. } = comparison;
    let scaled =
        |curve: &Curve, scale: f64| curve.iter().map(|value| value.map(|value| scale * value)).collect();
    let mut distances =
        vec![("A to B", scaled(&distance.a_to_b_m, 1e3)), ("B to A", scaled(&distance.b_to_a_m, 1e3))];
    if let Some(control) = &distance.control_m {
        distances.push(("control", scaled(control, 1e3)));
    }
    let both = |title, curve: fn(&Curves) -> Curve| Panel {
        title,
        curves: vec![(a.label.as_str(), curve(a)), (b.label.as_str(), curve(b))],
    };
    let panels = [
        Panel { title: "distance d of Eq. 18, mm", curves: distances },
        both("kinetic energy per mass, J/kg", |run| run.kinetic_energy_j_per_kg.clone()),
        both("height of the centre of mass, m", Curves::height),
        both("surface height, m", |run| run.surface_height_m.clone()),
        both("horizontal spread, m", |run| run.spread_m.clone()),
        both("highest density over rest density", |run| run.highest_density.clone()),
    ];
    let mut picture = String::new();
    {
        let root = SVGBackend::with_string(&mut picture, SIZE).into_drawing_area();
        root.fill(&WHITE).map_err(|error| error.to_string())?;
        for (panel, area) in panels.iter().zip(root.split_evenly((2, 3))) {
            draw(panel, time_s, &area).map_err(|error| error.to_string())?;
        }
        root.present().map_err(|error| error.to_string())?;
    }
    Ok(picture)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw(panel: &Panel<'_>, time: &[f64], area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let values = || panel.curves.iter().flat_map(|(_, curve)| curve.iter().flatten().copied());
    let (low, high) = values().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
    let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
    let slack = if high > low { 0.05 * (high - low) } else { 0.5 };
    // Room for the legend.
    let top = high + (1 + panel.curves.len()) as f64 * 1.5 * slack;
    let [start, end] = [time.first(), time.last()].map(|time| time.copied().unwrap_or_default());
    let end = if end > start { end } else { start + 1.0 };
    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, TITLE)
        .margin(10)
        .x_label_area_size(34)
        .y_label_area_size(52)
        .build_cartesian_2d(start..end, low - slack..top)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("time, s")
        .x_labels(6)
        .y_labels(6)
        .label_style(TEXT)
        .axis_desc_style(TEXT)
        .draw()?;
    for (k, (label, curve)) in panel.curves.iter().enumerate() {
        let style = COLORS[k].stroke_width(if k == 0 { 3 } else { 1 });
        // A frame without a value is a gap.
        for piece in pieces(time, curve) {
            chart.draw_series(LineSeries::new(piece, style))?;
        }
        let legend = move |(x, y)| PathElement::new(vec![(x, y), (x + 18, y)], style);
        chart.draw_series(std::iter::empty::<Circle<(f64, f64), i32>>())?.label(*label).legend(legend);
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .label_font(TEXT)
        .draw()?;
    Ok(())
}

/// The stretches of a curve that have values.
fn pieces(time: &[f64], curve: &Curve) -> Vec<Vec<(f64, f64)>> {
    let points: Vec<(f64, Option<f64>)> = time.iter().copied().zip(curve.iter().copied()).collect();
    let stretches = points.split(|(_, value)| value.is_none());
    let piece = |stretch: &[(f64, Option<f64>)]| stretch.iter().filter_map(|&(t, v)| Some((t, v?))).collect();
    stretches.filter(|stretch| !stretch.is_empty()).map(piece).collect()
}

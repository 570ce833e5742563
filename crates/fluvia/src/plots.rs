//! Curves over time as an SVG picture of several panels.

use plotters::prelude::*;

use crate::curves::Curve;

/// Pixels of a panel.
const PANEL: (u32, u32) = (400, 360);
const TEXT: (&str, i32) = ("sans-serif", 14);
const TITLE: (&str, i32) = ("sans-serif", 16);

/// Told apart by those who do not see colours too: the first is drawn thicker.
const COLORS: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(214, 39, 40),
    RGBColor(127, 127, 127),
    RGBColor(255, 127, 14),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
];

/// How the values of a panel go up.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    Linear,
    /// Values that are not above 0 are gaps.
    Logarithmic,
}

/// One panel: curves with their labels.
pub struct Panel<'a> {
    pub title: &'a str,
    /// What is to the right.
    pub across: &'a str,
    pub scale: Scale,
    /// Where each value lies to the right, and the values.
    pub curves: Vec<(&'a str, Vec<f64>, Curve)>,
}

/// Draws panels in rows of `columns`.
///
/// # Errors
/// What the drawing library reports.
pub fn svg(panels: &[Panel<'_>], columns: usize) -> Result<String, String> {
    let rows = panels.len().div_ceil(columns);
    let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
    let mut picture = String::new();
    {
        let root = SVGBackend::with_string(&mut picture, size).into_drawing_area();
        root.fill(&WHITE).map_err(|error| error.to_string())?;
        for (panel, area) in panels.iter().zip(root.split_evenly((rows, columns))) {
            draw(panel, &area).map_err(|error| error.to_string())?;
        }
        root.present().map_err(|error| error.to_string())?;
    }
    Ok(picture)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn draw(panel: &Panel<'_>, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
    // What is not finite is a gap: no axis reaches there. A logarithmic panel has the exponents of ten.
    let height = |value: f64| {
        let height = match panel.scale {
            Scale::Linear => value,
            Scale::Logarithmic => value.log10(),
        };
        height.is_finite().then_some(height)
    };
    let curves: Vec<Vec<(f64, Option<f64>)>> = panel
        .curves
        .iter()
        .map(|(_, at, curve)| at.iter().zip(curve).map(|(&x, value)| (x, value.and_then(height))).collect())
        .collect();
    let values = || curves.iter().flatten().filter_map(|(_, value)| *value);
    let (low, high) = range(values());
    let (low, high) = if low > high { (0.0, 1.0) } else { (low, high) };
    let slack = if high > low { 0.05 * (high - low) } else { 0.5 };
    // Room for the legend.
    let top = high + (1 + panel.curves.len()) as f64 * 1.5 * slack;
    let across = || curves.iter().flatten().map(|(x, _)| *x);
    let (start, end) = range(across());
    let (start, end) = match (start < end, start > end) {
        (true, _) => (start, end),
        (_, true) => (0.0, 1.0),
        _ => (start, start + 1.0),
    };
    let mut chart = ChartBuilder::on(area)
        .caption(panel.title, TITLE)
        .margin(10)
        .x_label_area_size(34)
        .y_label_area_size(52)
        .build_cartesian_2d(start..end, low - slack..top)?;
    let labels = |value: &f64| match panel.scale {
        Scale::Linear => short(*value),
        Scale::Logarithmic => short(10f64.powf(*value)),
    };
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc(panel.across)
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|x| short(*x))
        .y_label_formatter(&labels)
        .label_style(TEXT)
        .axis_desc_style(TEXT)
        .draw()?;
    for (k, ((label, ..), curve)) in panel.curves.iter().zip(&curves).enumerate() {
        let style = COLORS[k % COLORS.len()].stroke_width(if k == 0 { 3 } else { 1 });
        // A frame without a value is a gap.
        for piece in pieces(curve) {
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

/// The lowest and the highest of some values; of none the lowest is above the highest.
pub fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)))
}

/// A number of at most four digits.
pub fn short(value: f64) -> String {
    let text = format!("{value:.*}", decimals(value));
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// How many decimals give a value four digits.
pub fn decimals(value: f64) -> usize {
    let digits = 4 - value.abs().log10().floor().clamp(-6.0, 4.0) as i32 - 1;
    digits.clamp(0, 9) as usize
}

/// The stretches of a curve that have values.
fn pieces(curve: &[(f64, Option<f64>)]) -> Vec<Vec<(f64, f64)>> {
    let stretches = curve.split(|(_, value)| value.is_none());
    let piece = |stretch: &[(f64, Option<f64>)]| stretch.iter().filter_map(|&(x, v)| Some((x, v?))).collect();
    stretches.filter(|stretch| !stretch.is_empty()).map(piece).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_short() {
        let texts = [0.0, 0.5, 1.2345678, -0.0002, 12.0, 50_000.0, 1234.56].map(short);
        assert_eq!(texts, ["0", "0.5", "1.235", "-0.0002", "12", "50000", "1235"]);
    }

    #[test]
    fn values_that_no_axis_has_are_gaps() {
        let curve = vec![Some(1.0), Some(f64::INFINITY), None, Some(f64::NAN), Some(-2.0), Some(0.0)];
        for scale in [Scale::Linear, Scale::Logarithmic] {
            let at: Vec<f64> = (0..6).map(f64::from).collect();
            let curves = vec![("a", at, curve.clone()), ("none", Vec::new(), Vec::new())];
            let panel = Panel { title: "gaps", across: "x", scale, curves };
            assert!(svg(&[panel], 1).unwrap().contains("gaps"));
        }
    }

    #[test]
    fn gaps_part_a_curve() {
        let curve = [(0.0, Some(1.0)), (1.0, None), (2.0, Some(3.0)), (3.0, Some(4.0))];
        assert_eq!(pieces(&curve), [vec![(0.0, 1.0)], vec![(2.0, 3.0), (3.0, 4.0)]]);
    }
}

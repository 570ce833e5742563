//! The operator in float64 as a double loop: the specification of everything else in this crate.
//!
//! Written from the equations, without the tricks of the fast path: Eq. 7-9 for the sum, Eq. 19-21 for the
//! mapping.

use std::f64::consts::PI;

use crate::{Interpolation, Mapping, Options, PointSets, Window};

/// The weights of one layer as plain slices.
#[derive(Clone, Copy, Debug)]
pub struct Weights<'a> {
    /// Channels of the input features.
    pub in_channels: usize,
    /// Channels of the output.
    pub out_channels: usize,
    /// The filter, [depth, height, width, in, out].
    pub filter: &'a [f32],
    /// One value per output channel; 0 if absent.
    pub bias: Option<&'a [f32]>,
    /// Weights [in, out] for the output point's own features; the input and output points are then the same.
    pub pointwise: Option<&'a [f32]>,
}

/// Computes Eq. 7 for every output point: [output points, out channels].
///
/// # Panics
/// If lengths do not fit each other.
pub fn forward(options: &Options, sets: &PointSets<'_>, weights: &Weights<'_>, features: &[f64]) -> Vec<f64> {
    sets.validate();
    let (inputs, outputs) = (weights.in_channels, weights.out_channels);
    assert_eq!(features.len(), sets.inputs.len() * inputs, "features are [input points, in channels]");
    assert_eq!(weights.filter.len(), options.cells() * inputs * outputs, "the filter's size");
    let mut result = vec![0.0; sets.outputs.len() * outputs];
    for (row, output) in result.chunks_exact_mut(outputs).enumerate() {
        let mut psi = 0.0;
        for pair in sets.neighbors.row_splits[row]..sets.neighbors.row_splits[row + 1] {
            let i = sets.neighbors.indices[pair] as usize;
            let r = relative(sets, row, i);
            let a = match sets.window_values {
                Some(values) => f64::from(values[pair]),
                None => window(options.window, r),
            };
            psi += a;
            let importance = sets.importance.map_or(1.0, |m| f64::from(m[i]));
            let f = &features[i * inputs..(i + 1) * inputs];
            for (cell, share) in interpolate(options, map(options.mapping, r)) {
                let g = &weights.filter[cell * inputs * outputs..(cell + 1) * inputs * outputs];
                add_product(output, a * importance * share, f, g);
            }
        }
        if options.normalize && psi != 0.0 {
            output.iter_mut().for_each(|value| *value /= psi);
        }
        if let Some(pointwise) = weights.pointwise {
            add_product(output, 1.0, &features[row * inputs..(row + 1) * inputs], pointwise);
        }
        if let Some(bias) = weights.bias {
            output.iter_mut().zip(bias).for_each(|(value, b)| *value += f64::from(*b));
        }
    }
    result
}

/// output += scale · f · g, with g of shape [in, out].
fn add_product(output: &mut [f64], scale: f64, f: &[f64], g: &[f32]) {
    for (value, row) in f.iter().zip(g.chunks_exact(output.len())) {
        for (sum, weight) in output.iter_mut().zip(row) {
            *sum += scale * value * f64::from(*weight);
        }
    }
}

/// (x_i − x) / R, with R half the extent along each axis.
fn relative(sets: &PointSets<'_>, row: usize, i: usize) -> [f64; 3] {
    let extent = sets.extent.of(row);
    std::array::from_fn(|axis| {
        let difference = f64::from(sets.inputs[i][axis]) - f64::from(sets.outputs[row][axis]);
        difference / (f64::from(extent[axis]) / 2.0)
    })
}

/// The window a of Eq. 8 at the normalised position `r`.
pub fn window(window: Window, r: [f64; 3]) -> f64 {
    let q = r.iter().map(|x| x * x).sum::<f64>();
    match window {
        Window::Poly6 => (1.0 - q).max(0.0).powi(3),
        Window::Triangular => (1.0 - q.sqrt()).max(0.0),
        Window::None => 1.0,
    }
}

/// Λ of Eq. 19-21 before the shift to [0, 1]: from the unit ball to [−1, 1]³.
pub fn map(mapping: Mapping, r: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = r;
    let norm = (x * x + y * y + z * z).sqrt();
    if norm == 0.0 {
        return [0.0; 3];
    }
    match mapping {
        Mapping::Identity => r,
        Mapping::Radial => r.map(|c| c * norm / x.abs().max(y.abs()).max(z.abs())),
        Mapping::VolumePreserving => {
            let planar = (x * x + y * y).sqrt();
            // Eq. 19
            let (x, y, z) = if 1.25 * z * z <= x * x + y * y {
                (x * norm / planar, y * norm / planar, 1.5 * z)
            } else {
                let scale = (3.0 * norm / (norm + z.abs())).sqrt();
                (x * scale, y * scale, z.signum() * norm)
            };
            // Eq. 20
            let planar = (x * x + y * y).sqrt();
            if planar == 0.0 {
                [0.0, 0.0, z]
            } else if y.abs() <= x.abs() {
                [x.signum() * planar, 4.0 / PI * x.signum() * planar * (y / x).atan(), z]
            } else {
                [4.0 / PI * y.signum() * planar * (x / y).atan(), y.signum() * planar, z]
            }
        }
    }
}

/// The filter cells around a position of the cube [−1, 1]³ and their shares.
pub fn interpolate(options: &Options, position: [f64; 3]) -> Vec<(usize, f64)> {
    let [depth, height, width] = options.filter_size;
    let axes: [Vec<(usize, f64)>; 3] = std::array::from_fn(|axis| {
        let size = [width, height, depth][axis];
        let span = if options.align_corners { size as f64 - 1.0 } else { size as f64 };
        // Eq. 21, then from [0, 1] to cells counted from the centre of the first.
        let unit = 0.5 * position[axis] + 0.5;
        let shift = if options.align_corners { 0.0 } else { -0.5 };
        along(options.interpolation, unit * span + shift + f64::from(options.offset[axis]), size)
    });
    let mut cells = Vec::new();
    for (z, share_z) in &axes[2] {
        for (y, share_y) in &axes[1] {
            for (x, share_x) in &axes[0] {
                cells.push(((z * height + y) * width + x, share_x * share_y * share_z));
            }
        }
    }
    cells
}

fn along(interpolation: Interpolation, x: f64, size: usize) -> Vec<(usize, f64)> {
    let last = size as f64 - 1.0;
    match interpolation {
        Interpolation::Nearest => vec![(x.clamp(0.0, last).round() as usize, 1.0)],
        Interpolation::Linear => {
            let x = x.clamp(0.0, last);
            let low = x.floor();
            vec![(low as usize, 1.0 - (x - low)), ((low + 1.0).min(last) as usize, x - low)]
        }
        Interpolation::LinearBorder => {
            let low = x.floor();
            [(low, 1.0 - (x - low)), (low + 1.0, x - low)]
                .into_iter()
                .filter(|(cell, _)| (0.0..=last).contains(cell))
                .map(|(cell, share)| (cell as usize, share))
                .collect()
        }
    }
}

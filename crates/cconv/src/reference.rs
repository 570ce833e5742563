//! The operator in float64 as double loops, forward and backward: the specification of everything else in this
//! crate.
//!
//! Written from the equations, without the tricks of the fast path: Eq. 7-9 for the sum, Eq. 19-21 for the
//! mapping. Derivatives at kinks are those of [`Geometry::backward`](crate::Geometry::backward).

mod lookup;

use fluvia_neighbors::Neighbors;

use crate::{Options, PointSets};
use lookup::{Corner, interpolate, map, map_slope, window, window_slope};

/// [`PointSets`] in float64.
#[derive(Clone, Debug)]
pub struct Sets {
    /// Input points x_i.
    pub inputs: Vec<[f64; 3]>,
    /// Output points x.
    pub outputs: Vec<[f64; 3]>,
    /// The input points near each output point.
    pub neighbors: Neighbors,
    /// The filter's diameter at each output point along each axis.
    pub extent: Vec<[f64; 3]>,
    /// The importance m_i of each input point; 1 if absent.
    pub importance: Option<Vec<f64>>,
    /// A window value for each pair, in place of [`Options::window`].
    pub window_values: Option<Vec<f64>>,
}

impl From<&PointSets<'_>> for Sets {
    fn from(sets: &PointSets<'_>) -> Sets {
        sets.validate();
        Sets {
            inputs: sets.inputs.iter().map(|x| x.map(f64::from)).collect(),
            outputs: sets.outputs.iter().map(|x| x.map(f64::from)).collect(),
            neighbors: sets.neighbors.clone(),
            extent: (0..sets.outputs.len()).map(|row| sets.extent.of(row).map(f64::from)).collect(),
            importance: sets.importance.map(widen),
            window_values: sets.window_values.map(widen),
        }
    }
}

/// The same values in float64.
pub fn widen(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

/// The weights of one layer as plain slices.
#[derive(Clone, Copy, Debug)]
pub struct Weights<'a> {
    /// Channels of the input features.
    pub in_channels: usize,
    /// Channels of the output.
    pub out_channels: usize,
    /// The filter, [depth, height, width, in, out].
    pub filter: &'a [f64],
    /// One value per output channel; 0 if absent.
    pub bias: Option<&'a [f64]>,
    /// Weights [in, out] for the output point's own features; the input and output points are then the same.
    pub pointwise: Option<&'a [f64]>,
}

/// The derivatives of a number L that depends on the output. Those of weights and options that are absent are
/// those at their default.
#[derive(Clone, Debug, Default)]
pub struct Gradients {
    /// [depth, height, width, in, out].
    pub filter: Vec<f64>,
    /// One per output channel.
    pub bias: Vec<f64>,
    /// [in, out]; empty if there is no pointwise term.
    pub pointwise: Vec<f64>,
    /// [input points, in channels].
    pub features: Vec<f64>,
    /// One per input point.
    pub importance: Vec<f64>,
    /// One per pair: by the window value, given or not.
    pub window_values: Vec<f64>,
    /// One per input point. Window values that are given do not depend on it.
    pub input_positions: Vec<[f64; 3]>,
    /// One per output point.
    pub output_positions: Vec<[f64; 3]>,
}

/// Computes Eq. 7 for every output point: [output points, out channels].
///
/// # Panics
/// If lengths do not fit each other.
pub fn forward(options: &Options, sets: &Sets, weights: &Weights<'_>, features: &[f64]) -> Vec<f64> {
    check(options, sets, weights, features);
    let (inputs, outputs) = (weights.in_channels, weights.out_channels);
    let mut result = vec![0.0; sets.outputs.len() * outputs];
    for (row, output) in result.chunks_exact_mut(outputs).enumerate() {
        let pairs = Pair::of_row(options, sets, row);
        for pair in &pairs {
            let f = &features[pair.i * inputs..(pair.i + 1) * inputs];
            for corner in &pair.corners {
                let g = &weights.filter[corner.cell * inputs * outputs..][..inputs * outputs];
                add_product(output, pair.window * pair.importance * corner.share, f, g);
            }
        }
        let psi = psi(options, &pairs);
        output.iter_mut().for_each(|value| *value /= psi);
        if let Some(pointwise) = weights.pointwise {
            add_product(output, 1.0, &features[row * inputs..(row + 1) * inputs], pointwise);
        }
        if let Some(bias) = weights.bias {
            output.iter_mut().zip(bias).for_each(|(value, b)| *value += b);
        }
    }
    result
}

/// The derivatives of L from those by the output, [output points, out channels].
///
/// # Panics
/// If lengths do not fit each other.
pub fn backward(
    options: &Options,
    sets: &Sets,
    weights: &Weights<'_>,
    features: &[f64],
    output_gradient: &[f64],
) -> Gradients {
    check(options, sets, weights, features);
    let (inputs, outputs) = (weights.in_channels, weights.out_channels);
    assert_eq!(
        output_gradient.len(),
        sets.outputs.len() * outputs,
        "gradients are [output points, out channels]"
    );
    let mut gradients = Gradients {
        filter: vec![0.0; weights.filter.len()],
        bias: vec![0.0; outputs],
        pointwise: vec![0.0; weights.pointwise.map_or(0, <[f64]>::len)],
        features: vec![0.0; features.len()],
        importance: vec![0.0; sets.inputs.len()],
        window_values: vec![0.0; sets.neighbors.indices.len()],
        input_positions: vec![[0.0; 3]; sets.inputs.len()],
        output_positions: vec![[0.0; 3]; sets.outputs.len()],
    };
    for (row, d_output) in output_gradient.chunks_exact(outputs).enumerate() {
        gradients.bias.iter_mut().zip(d_output).for_each(|(sum, d)| *sum += d);
        if let Some(pointwise) = weights.pointwise {
            let own = row * inputs..(row + 1) * inputs;
            add_outer(&mut gradients.pointwise, 1.0, &features[own.clone()], d_output);
            add_transposed_product(&mut gradients.features[own], 1.0, pointwise, d_output);
        }
        let pairs = Pair::of_row(options, sets, row);
        let psi = psi(options, &pairs);
        // The output before the pointwise term and the bias, times its gradient.
        let mut mean = 0.0;
        let first = sets.neighbors.row_splits[row];
        let mut by_window = vec![0.0; pairs.len()];
        for (pair, by_window) in pairs.iter().zip(&mut by_window) {
            let own = pair.i * inputs..(pair.i + 1) * inputs;
            let f = &features[own.clone()];
            let (mut by_weight, mut by_position) = (0.0, [0.0; 3]);
            for corner in &pair.corners {
                let cell = corner.cell * inputs * outputs..(corner.cell + 1) * inputs * outputs;
                let weight = pair.window * pair.importance * corner.share / psi;
                add_outer(&mut gradients.filter[cell.clone()], weight, f, d_output);
                let g = &weights.filter[cell];
                add_transposed_product(&mut gradients.features[own.clone()], weight, g, d_output);
                // f · g · dL/d output: the derivative by the weight of this cell.
                let by_cell: f64 = f
                    .iter()
                    .zip(g.chunks_exact(outputs))
                    .map(|(f, g)| f * g.iter().zip(d_output).map(|(g, d)| g * d).sum::<f64>())
                    .sum();
                by_weight += corner.share * by_cell / psi;
                let scale = pair.window * pair.importance * by_cell / psi;
                by_position.iter_mut().zip(corner.slope).for_each(|(sum, slope)| *sum += scale * slope);
            }
            gradients.importance[pair.i] += pair.window * by_weight;
            *by_window = pair.importance * by_weight;
            mean += pair.window * pair.importance * by_weight;
            pair.add_position(sets, row, by_position, &pair.map_slope, &mut gradients);
        }
        for (k, (pair, by_window)) in pairs.iter().zip(by_window).enumerate() {
            // ψ depends on every window value of the row.
            let by_window =
                if options.normalize && psi_is_sum(&pairs) { by_window - mean / psi } else { by_window };
            gradients.window_values[first + k] = by_window;
            if sets.window_values.is_none() {
                let slope = window_slope(options.window, pair.r).map(|slope| slope * by_window);
                pair.add_position(sets, row, slope, &IDENTITY, &mut gradients);
            }
        }
    }
    gradients
}

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// An output point and one of its neighbours.
struct Pair {
    /// The input point.
    i: usize,
    /// (x_i − x) / R.
    r: [f64; 3],
    window: f64,
    importance: f64,
    corners: Vec<Corner>,
    /// ∂Λ/∂r, a row for each coordinate of Λ.
    map_slope: [[f64; 3]; 3],
}

impl Pair {
    fn of_row(options: &Options, sets: &Sets, row: usize) -> Vec<Pair> {
        let Neighbors { indices, row_splits, .. } = &sets.neighbors;
        (row_splits[row]..row_splits[row + 1])
            .map(|pair| {
                let i = indices[pair] as usize;
                let r = std::array::from_fn(|axis| {
                    (sets.inputs[i][axis] - sets.outputs[row][axis]) / (sets.extent[row][axis] / 2.0)
                });
                Pair {
                    i,
                    r,
                    window: sets
                        .window_values
                        .as_ref()
                        .map_or_else(|| window(options.window, r), |a| a[pair]),
                    importance: sets.importance.as_ref().map_or(1.0, |m| m[i]),
                    corners: interpolate(options, map(options.mapping, r)),
                    map_slope: map_slope(options.mapping, r),
                }
            })
            .collect()
    }

    /// Adds to the derivatives by both positions, given those by a function of r and that function's slope.
    fn add_position(
        &self,
        sets: &Sets,
        row: usize,
        by_function: [f64; 3],
        slope: &[[f64; 3]; 3],
        gradients: &mut Gradients,
    ) {
        for (axis, extent) in sets.extent[row].iter().enumerate() {
            let by_r: f64 = by_function.iter().zip(slope).map(|(d, slope)| d * slope[axis]).sum();
            let by_x = by_r / (extent / 2.0);
            gradients.input_positions[self.i][axis] += by_x;
            gradients.output_positions[row][axis] -= by_x;
        }
    }
}

/// ψ of Eq. 7: 1, or the sum of the window values. A row whose window values sum to zero is not divided.
fn psi(options: &Options, pairs: &[Pair]) -> f64 {
    if options.normalize && psi_is_sum(pairs) { pairs.iter().map(|pair| pair.window).sum() } else { 1.0 }
}

fn psi_is_sum(pairs: &[Pair]) -> bool {
    pairs.iter().map(|pair| pair.window).sum::<f64>() != 0.0
}

fn check(options: &Options, sets: &Sets, weights: &Weights<'_>, features: &[f64]) {
    let (inputs, outputs) = (weights.in_channels, weights.out_channels);
    assert_eq!(sets.neighbors.queries(), sets.outputs.len(), "a row of neighbours for each output point");
    assert_eq!(sets.extent.len(), sets.outputs.len(), "an extent for each output point");
    assert_eq!(features.len(), sets.inputs.len() * inputs, "features are [input points, in channels]");
    assert_eq!(weights.filter.len(), options.cells() * inputs * outputs, "the filter's size");
    let lengths = [
        (weights.bias, outputs, "one bias per output channel"),
        (weights.pointwise, inputs * outputs, "pointwise weights are [in, out]"),
        (sets.importance.as_deref(), sets.inputs.len(), "one importance per input point"),
        (sets.window_values.as_deref(), sets.neighbors.indices.len(), "one window value per pair"),
    ];
    for (values, expected, what) in lengths {
        assert!(values.is_none_or(|values| values.len() == expected), "{what}: expected {expected}");
    }
}

/// output += scale · f · g, with g of shape [in, out].
fn add_product(output: &mut [f64], scale: f64, f: &[f64], g: &[f64]) {
    for (value, row) in f.iter().zip(g.chunks_exact(output.len())) {
        for (sum, weight) in output.iter_mut().zip(row) {
            *sum += scale * value * weight;
        }
    }
}

/// g += scale · f ⊗ d, of shape [in, out].
fn add_outer(g: &mut [f64], scale: f64, f: &[f64], d: &[f64]) {
    for (row, value) in g.chunks_exact_mut(d.len()).zip(f) {
        row.iter_mut().zip(d).for_each(|(sum, d)| *sum += scale * value * d);
    }
}

/// f += scale · g · d, with g of shape [in, out].
fn add_transposed_product(f: &mut [f64], scale: f64, g: &[f64], d: &[f64]) {
    for (sum, row) in f.iter_mut().zip(g.chunks_exact(d.len())) {
        *sum += scale * row.iter().zip(d).map(|(g, d)| g * d).sum::<f64>();
    }
}

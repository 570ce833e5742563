//! A fully connected layer, forward and backward.

use std::sync::OnceLock;

use super::output::{Columns, Output};
use super::sums::{self, Partition};
use super::{Workspace, products};
use crate::aligned::AlignedVec;
use crate::filter::panels;
use crate::kernel::Kernel;

/// A fully connected layer: weights [in, out] and a bias, in the order in which the kernels read them.
#[derive(Clone, Debug)]
pub struct Dense {
    in_channels: usize,
    out_channels: usize,
    packed: AlignedVec,
    bias: Vec<f32>,
    /// The weights as given, and packed as [out, in] when a backward pass needs them.
    plain: Vec<f32>,
    adjoint: OnceLock<AlignedVec>,
}

impl Dense {
    /// A layer with weights of shape [`in_channels`, out channels] and one bias per output channel.
    ///
    /// # Panics
    /// If the number of weights is another, or a dimension is zero.
    pub fn new(in_channels: usize, weights: &[f32], bias: &[f32]) -> Dense {
        let out_channels = bias.len();
        assert!(in_channels > 0 && out_channels > 0, "a layer needs channels");
        assert_eq!(weights.len(), in_channels * out_channels, "weights are [in, out]");
        let packed = pack(in_channels, out_channels, |row, column| weights[row * out_channels + column]);
        let (plain, bias) = (weights.to_vec(), bias.to_vec());
        Dense { in_channels, out_channels, packed, bias, plain, adjoint: OnceLock::new() }
    }

    /// The number of output channels.
    pub fn out_channels(&self) -> usize {
        self.out_channels
    }
}

/// Panels of columns of a matrix [rows, columns], the last padded with zeros.
fn pack(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f32) -> AlignedVec {
    let mut packed = Vec::with_capacity(rows * columns.next_multiple_of(16));
    for (first, width) in panels(columns) {
        for row in 0..rows {
            let inside = |column| if column < columns { value(row, column) } else { 0.0 };
            packed.extend((first..first + width).map(inside));
        }
    }
    AlignedVec::from_slice(&packed)
}

/// Applies a fully connected layer to `features` [points, in channels].
///
/// # Panics
/// If a length does not fit the layer.
pub fn dense(
    layer: &Dense,
    features: &[f32],
    output: Columns<'_>,
    workspace: &mut Workspace,
    kernel: Kernel,
) {
    let points = features.len() / layer.in_channels;
    assert_eq!(features.len(), points * layer.in_channels, "features are [points, in channels]");
    output.check(points, layer.out_channels);
    workspace.prepare();
    let rows = products::Rows {
        features,
        in_channels: layer.in_channels,
        packed: &layer.packed,
        columns: layer.out_channels,
        bias: &layer.bias,
    };
    products::multiply(rows, Output { columns: output, add: false }, &workspace.scratch, kernel);
}

/// Where [`dense_backward`] adds derivatives; only those that are asked for are computed.
#[derive(Debug, Default)]
pub struct DenseGradients<'a> {
    /// By the weights, [in, out].
    pub weights: Option<&'a mut [f32]>,
    /// By the bias, \[out\].
    pub bias: Option<&'a mut [f32]>,
    /// By the features, [points, in].
    pub features: Option<&'a mut [f32]>,
}

/// The backward pass of [`dense`], from the derivatives by the output, [points, out channels]. `clouds` says where the
/// points of each cloud start, as [`PointSets::input_clouds`](crate::PointSets::input_clouds) does.
///
/// # Panics
/// If a length does not fit the layer.
pub fn dense_backward(
    layer: &Dense,
    features: &[f32],
    output_gradient: &[f32],
    clouds: &[usize],
    gradients: DenseGradients<'_>,
    workspace: &mut Workspace,
    kernel: Kernel,
) {
    let (inputs, outputs) = (layer.in_channels, layer.out_channels);
    let points = features.len() / inputs;
    assert_eq!(features.len(), points * inputs, "features are [points, in channels]");
    assert_eq!(output_gradient.len(), points * outputs, "gradients of {points} points, {outputs} channels");
    workspace.prepare();
    let DenseGradients { weights, bias, features: by_features } = gradients;
    let clouds = crate::geometry::boundaries(clouds, points);
    if let Some(bias) = bias {
        assert_eq!(bias.len(), outputs, "the gradient of one bias per output channel");
        sums::add_columns(output_gradient, &clouds, bias);
    }
    if let Some(weights) = weights {
        assert_eq!(weights.len(), inputs * outputs, "the gradient of the weights, [in, out]");
        let points = Partition { clouds: &clouds, kernel };
        sums::add_products(features, output_gradient, points, (inputs, outputs), weights, workspace);
    }
    if let Some(gradient) = by_features {
        assert_eq!(gradient.len(), features.len(), "the gradient of the features");
        let packed = layer
            .adjoint
            .get_or_init(|| pack(outputs, inputs, |row, column| layer.plain[column * outputs + row]));
        let rows = products::Rows {
            features: output_gradient,
            in_channels: outputs,
            packed,
            columns: inputs,
            bias: &[],
        };
        products::multiply(rows, Output::added(gradient, inputs), &workspace.scratch, kernel);
    }
}

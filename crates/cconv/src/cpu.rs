//! The operator on the CPU: the forward pass.
//!
//! Every output row is computed by one task, in an order that depends on the input alone, so that the
//! number of threads does not change a bit. Different kernels round differently.

mod patches;
mod products;

use std::sync::Mutex;

use crate::aligned::AlignedVec;
use crate::filter::{Layout, panels};
use crate::kernel::Kernel;
use crate::{Filter, Geometry};

/// Working memory of [`forward`], reused from call to call.
#[derive(Debug, Default)]
pub struct Workspace {
    /// One for each thread.
    scratch: Vec<Mutex<Scratch>>,
    /// Features with their channels padded, or the products of features and filter.
    whole: AlignedVec,
}

#[derive(Debug, Default)]
struct Scratch {
    patches: AlignedVec,
    sums: AlignedVec,
}

impl Workspace {
    /// Makes room for a scratch per thread of the current pool.
    fn prepare(&mut self) {
        self.scratch.resize_with(rayon::current_num_threads().max(1), Mutex::default);
    }
}

/// Runs `work` with the scratch of the current thread.
fn with_scratch(scratch: &[Mutex<Scratch>], work: impl FnOnce(&mut Scratch)) {
    let own = &scratch[rayon::current_thread_index().unwrap_or(0) % scratch.len()];
    // A scratch is overwritten before it is read, so one that a panic left behind is as good as any.
    let mut guard = own.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    work(&mut guard);
}

/// Where results go: columns `first..first + channels` of rows of `stride` values.
#[derive(Debug)]
pub struct Columns<'a> {
    /// [points, `stride`].
    pub values: &'a mut [f32],
    /// Values in a row.
    pub stride: usize,
    /// The first column to write.
    pub first: usize,
}

/// Computes one layer, Eq. 7: `features` [input points, in channels] to `output` [output points, out
/// channels].
///
/// # Panics
/// If a length does not fit the geometry and the filter, or if the filter was made for another number of
/// cells, or has a pointwise term although there are other numbers of input and output points.
pub fn forward(
    geometry: &Geometry,
    filter: &Filter,
    features: &[f32],
    output: &mut [f32],
    workspace: &mut Workspace,
) {
    let stride = filter.out_channels;
    forward_into(geometry, filter, features, Columns { values: output, stride, first: 0 }, workspace);
}

/// As [`forward`], into some columns of wider rows.
///
/// # Panics
/// As [`forward`], and if the columns do not lie within the rows.
pub fn forward_into(
    geometry: &Geometry,
    filter: &Filter,
    features: &[f32],
    output: Columns<'_>,
    workspace: &mut Workspace,
) {
    let (inputs, outputs) = (geometry.inputs, geometry.outputs);
    assert_eq!(filter.cells, geometry.cells, "cells of the filter and of the geometry");
    assert_eq!(features.len(), inputs * filter.in_channels, "features of {inputs} input points");
    check_columns(&output, outputs, filter.out_channels);
    if filter.rows() > filter.cells {
        assert_eq!(inputs, outputs, "a pointwise term needs the same input and output points");
    }
    workspace.prepare();
    match filter.layout {
        Layout::Patches => patches::forward(geometry, filter, features, output, workspace),
        Layout::Products { group } => {
            products::forward(geometry, filter, group, features, output, workspace);
        }
    }
}

/// A fully connected layer: weights [in, out] and a bias, in the order in which the kernels read them.
#[derive(Clone, Debug)]
pub struct Dense {
    in_channels: usize,
    out_channels: usize,
    packed: AlignedVec,
    bias: Vec<f32>,
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
        let mut packed = Vec::with_capacity(in_channels * out_channels.next_multiple_of(16));
        for (first, width) in panels(out_channels) {
            for row in weights.chunks_exact(out_channels) {
                packed.extend((first..first + width).map(|column| row.get(column).copied().unwrap_or(0.0)));
            }
        }
        let packed = AlignedVec::from_slice(&packed);
        Dense { in_channels, out_channels, packed, bias: bias.to_vec() }
    }

    /// The number of output channels.
    pub fn out_channels(&self) -> usize {
        self.out_channels
    }
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
    check_columns(&output, points, layer.out_channels);
    workspace.prepare();
    let rows = products::Rows {
        features,
        in_channels: layer.in_channels,
        packed: &layer.packed,
        columns: layer.out_channels,
        bias: &layer.bias,
    };
    products::multiply(rows, output, &workspace.scratch, kernel);
}

fn check_columns(output: &Columns<'_>, points: usize, channels: usize) {
    let Columns { values, stride, first } = output;
    assert!(*stride > 0 && first + channels <= *stride, "columns {first}.. of rows of {stride} values");
    assert_eq!(values.len(), points * stride, "{points} rows of {stride} values");
}

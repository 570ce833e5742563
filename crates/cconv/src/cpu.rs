//! The operator on the CPU: forward and backward.
//!
//! Every output row is computed by one task, in an order that depends on the input alone, so that the
//! number of threads does not change a bit; sums over points are taken over fixed runs of points. Different
//! kernels round differently.

mod dense;
mod dots;
mod output;
mod patches;
mod products;
mod sums;

use std::sync::Mutex;

pub use dense::{Dense, DenseGradients, dense, dense_backward};
pub use output::Columns;
use output::Output;
use patches::Patches;
use sums::{FilterSums, Partition};

use crate::aligned::AlignedVec;
use crate::filter::Layout;
use crate::geometry::{Lists, PairGradient};
use crate::{Filter, Geometry};

/// Working memory of [`forward`] and [`backward`], reused from call to call.
#[derive(Debug, Default)]
pub struct Workspace {
    /// One for each thread.
    scratch: Vec<Mutex<Scratch>>,
    /// Features with their channels padded, or the products of features and filter.
    whole: AlignedVec,
    /// Partial sums of a filter's gradient.
    partial: AlignedVec,
}

#[derive(Debug, Default)]
struct Scratch {
    patches: AlignedVec,
    /// Patches in bfloat16: point after point, and two points together.
    rounded: AlignedVec,
    paired: AlignedVec,
    sums: AlignedVec,
    /// Rows of one factor as the matrix product reads them.
    packed: AlignedVec,
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

/// Features [points, channels] with their channels padded by zeros.
fn pad<'a>(
    features: &'a [f32],
    channels: usize,
    padded: usize,
    points: usize,
    memory: &'a mut AlignedVec,
) -> &'a [f32] {
    if padded == channels {
        return features;
    }
    memory.reserve_len(points * padded);
    for (to, from) in memory.chunks_exact_mut(padded).zip(features.chunks_exact(channels)) {
        to[..channels].copy_from_slice(from);
        to[channels..].fill(0.0);
    }
    &memory[..points * padded]
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
    check_sizes(geometry, filter, features);
    output.check(geometry.lists.rows, filter.out_channels);
    workspace.prepare();
    let output = Output { columns: output, add: false };
    let patches = Patches { lists: &geometry.lists, filter, features };
    match filter.layout {
        Layout::Patches => patches::run(patches, Some(output), None, workspace),
        Layout::Products { group } => products::run(patches, group, output, workspace),
    }
}

fn check_sizes(geometry: &Geometry, filter: &Filter, features: &[f32]) {
    let (inputs, outputs) = (geometry.lists.columns, geometry.lists.rows);
    assert_eq!(filter.cells, geometry.lists.cells, "cells of the filter and of the geometry");
    assert_eq!(features.len(), inputs * filter.in_channels, "features of {inputs} input points");
    if filter.rows() > filter.cells {
        assert_eq!(inputs, outputs, "a pointwise term needs the same input and output points");
    }
}

/// Where [`backward`] adds the derivatives of a number L that depends on a layer's output. Only those that are asked for
/// are computed.
#[derive(Debug, Default)]
pub struct Gradients<'a> {
    /// By the filter, [depth, height, width, in, out].
    pub filter: Option<&'a mut [f32]>,
    /// By the pointwise weights, [in, out].
    pub pointwise: Option<&'a mut [f32]>,
    /// By the bias, \[out\].
    pub bias: Option<&'a mut [f32]>,
    /// By the features, [input points, in].
    pub features: Option<&'a mut [f32]>,
    /// By the weights of the pairs. [`Geometry::backward`] makes those by positions, importance and window values
    /// of it, once for all layers on the same points. Without it the positions count as constants, as in the
    /// published code.
    pub pairs: Option<&'a mut PairGradient>,
}

/// The backward pass of [`forward`]: from the derivatives of L by the output, [output points, out channels], to
/// those by what the output depends on, which are added to `gradients`.
///
/// # Panics
/// If a length does not fit the geometry and the filter, or if the gradient of the features is asked for without
/// [`Geometry::prepare_backward`].
pub fn backward(
    geometry: &Geometry,
    filter: &Filter,
    features: &[f32],
    output_gradient: &[f32],
    gradients: Gradients<'_>,
    workspace: &mut Workspace,
) {
    check_sizes(geometry, filter, features);
    let (cells, inputs, outputs) = (filter.cells, filter.in_channels, filter.out_channels);
    let rows = geometry.lists.rows;
    let has_pointwise = filter.rows() > cells;
    assert_eq!(
        output_gradient.len(),
        rows * outputs,
        "gradients of {rows} output points, {outputs} channels"
    );
    workspace.prepare();
    let Gradients { filter: by_filter, mut pointwise, bias, features: mut by_features, pairs } = gradients;
    if let Some(gradient) = &pointwise {
        assert!(has_pointwise, "the gradient of a pointwise term that the filter does not have");
        assert_eq!(gradient.len(), inputs * outputs, "the gradient of pointwise weights, [in, out]");
    }
    if let Some(bias) = bias {
        assert_eq!(bias.len(), outputs, "the gradient of one bias per output channel");
        sums::add_columns(output_gradient, &geometry.lists.clouds, bias);
    }
    if let Some(gradient) = &by_features {
        assert_eq!(gradient.len(), features.len(), "the gradient of the features");
    }
    // The gradients of the features and of the filter share the patches of the output gradient, unless it is
    // cheaper to interpolate the features.
    let shares = by_features.is_some() && Layout::choose(outputs, inputs) == Layout::Patches;
    let exchanged = shares || outputs < inputs && geometry.is_prepared();
    let feature_patches = Patches { lists: &geometry.lists, filter, features };
    let gradient_patches = || Patches {
        lists: &geometry.transposed().lists,
        filter: filter.adjoint(),
        features: output_gradient,
    };
    if let Some(gradient) = by_filter {
        assert_eq!(gradient.len(), cells * inputs * outputs, "the gradient of the filter");
        let (other, channels) = if exchanged { (features, inputs) } else { (output_gradient, outputs) };
        let sums = FilterSums { other, channels, filter: gradient, pointwise: pointwise.take(), exchanged };
        if exchanged {
            let output = by_features.take_if(|_| shares).map(|values| Output::added(values, inputs));
            patches::run(gradient_patches(), output, Some(sums), workspace);
        } else {
            patches::run(feature_patches, None, Some(sums), workspace);
        }
    }
    if let Some(gradient) = pointwise {
        let Lists { clouds, kernel, .. } = &geometry.lists;
        let points = Partition { clouds, kernel: *kernel };
        sums::add_products(features, output_gradient, points, (inputs, outputs), gradient, workspace);
    }
    if let Some(gradient) = by_features {
        let (patches, output) = (gradient_patches(), Output::added(gradient, inputs));
        match patches.filter.layout {
            Layout::Patches => patches::run(patches, Some(output), None, workspace),
            Layout::Products { group } => products::run(patches, group, output, workspace),
        }
    }
    if let Some(pairs) = pairs {
        assert_eq!(
            pairs.blocks.len(),
            geometry.lists.blocks.len(),
            "a gradient of the pairs of this geometry"
        );
        dots::run(&geometry.lists, filter, features, output_gradient, pairs, workspace);
    }
}

//! The forward pass through a patch matrix (paper, section A.1): features are interpolated into a matrix
//! [points, cells · channels], and that is multiplied by the filter.
//!
//! The matrix never exists as a whole. A task takes some output points and goes through the slabs of input
//! channels; for each slab it fills the patches of [`ROWS`] points and multiplies them while they are hot, so
//! that the weights of the slab are fetched once a task.

use rayon::prelude::*;

use super::{Columns, Scratch, Workspace, with_scratch};
use crate::filter::panels;
use crate::geometry::{Block, LANES};
use crate::kernel::{InstructionSet, Operation, Product, ROWS};
use crate::{Filter, Geometry};

/// Output points of a task: enough to pay for fetching the weights, few enough to balance two threads on
/// some thousand points.
const TASK_ROWS: usize = 16 * ROWS;

/// How many pairs ahead the features of a neighbour are asked for.
const PREFETCH_PAIRS: usize = 4;

pub fn forward(
    geometry: &Geometry,
    filter: &Filter,
    features: &[f32],
    output: Columns<'_>,
    workspace: &mut Workspace,
) {
    let padded = filter.slabs.padded();
    let features = if padded == filter.in_channels {
        features
    } else {
        let whole = &mut workspace.whole;
        whole.reserve_len(geometry.inputs * padded);
        for (to, from) in whole.chunks_exact_mut(padded).zip(features.chunks_exact(filter.in_channels)) {
            to[..from.len()].copy_from_slice(from);
            to[from.len()..].fill(0.0);
        }
        &whole[..geometry.inputs * padded]
    };
    let Columns { values, stride, first } = output;
    let scratch = &workspace.scratch;
    values.par_chunks_mut(TASK_ROWS * stride).enumerate().for_each(|(k, rows)| {
        with_scratch(scratch, |scratch| {
            geometry.kernel.run(Task {
                geometry,
                filter,
                features,
                first_row: k * TASK_ROWS,
                output: Columns { values: rows, stride, first },
                scratch,
            });
        });
    });
}

/// The output points from `first_row` on, as many as `output` has rows.
struct Task<'a> {
    geometry: &'a Geometry,
    filter: &'a Filter,
    /// [input points, padded channels].
    features: &'a [f32],
    first_row: usize,
    output: Columns<'a>,
    scratch: &'a mut Scratch,
}

impl Operation for Task<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Task { geometry, filter, features, first_row, output, scratch } = self;
        let rows = output.values.len() / output.stride;
        let outputs = filter.out_channels;
        let width = outputs.next_multiple_of(16);
        let Scratch { patches, sums } = scratch;
        sums.reserve_len(rows.next_multiple_of(ROWS) * width);
        sums[..rows.next_multiple_of(ROWS) * width].fill(0.0);
        let mut packed: &[f32] = &filter.packed;
        for slab in filter.slabs.iter() {
            let depth = filter.rows() * slab.len();
            patches.reserve_len(ROWS * depth);
            let (weights, rest) = packed.split_at(depth * width);
            packed = rest;
            for block in (0..rows).step_by(ROWS) {
                let live = ROWS.min(rows - block);
                for (row, patch) in patches.chunks_exact_mut(depth).take(live).enumerate() {
                    let source = Source {
                        geometry,
                        filter,
                        features,
                        row: first_row + block + row,
                        channel: slab.start,
                    };
                    match slab.len() {
                        4 => fill::<I, 4>(patch, &source),
                        8 => fill::<I, 8>(patch, &source),
                        16 => fill::<I, 16>(patch, &source),
                        _ => fill::<I, 32>(patch, &source),
                    }
                }
                for (first, panel) in panels(outputs) {
                    I::multiply(Product {
                        rows: live,
                        depth,
                        width: panel,
                        a: patches,
                        a_stride: depth,
                        b: &weights[depth * first..],
                        c: &mut sums[block * width + first..],
                        c_stride: width,
                    });
                }
            }
        }
        for (row, sums) in output.values.chunks_exact_mut(output.stride).zip(sums.chunks_exact(width)) {
            let row = &mut row[output.first..output.first + outputs];
            if filter.bias.is_empty() {
                row.copy_from_slice(&sums[..outputs]);
            } else {
                for ((value, sum), bias) in row.iter_mut().zip(sums).zip(&filter.bias) {
                    *value = sum + bias;
                }
            }
        }
    }
}

/// Where a patch comes from: the neighbours of one output point, some channels of their features.
struct Source<'a> {
    geometry: &'a Geometry,
    filter: &'a Filter,
    features: &'a [f32],
    row: usize,
    channel: usize,
}

/// Fills the patch [cells, `C`] of one output point.
#[inline(always)]
fn fill<I: InstructionSet, const C: usize>(patch: &mut [f32], source: &Source<'_>) {
    let Source { geometry, filter, features, row, channel } = *source;
    let stride = filter.slabs.padded();
    let (patch, pointwise) = patch.split_at_mut(filter.cells * C);
    patch.fill(0.0);
    let last = geometry.indices.len().saturating_sub(1);
    let steps = geometry.steps.map(|step| step * C);
    for pair in geometry.row_splits[row]..geometry.row_splits[row + 1] {
        let start = |pair: usize| geometry.indices[pair] as usize * stride + channel;
        let next = start((pair + PREFETCH_PAIRS).min(last));
        I::prefetch(&features[next]);
        I::prefetch(&features[next + C / 2]);
        let f = &features[start(pair)..][..C];
        let block = &geometry.blocks[pair / LANES];
        let lane = pair % LANES;
        let patch = &mut patch[block.cell[lane] as usize * C..];
        if geometry.corners == 8 {
            spread::<I, C, 8>(patch, f, block, lane, &steps);
        } else {
            spread::<I, C, 1>(patch, f, block, lane, &steps);
        }
    }
    if !pointwise.is_empty() {
        pointwise.copy_from_slice(&features[row * stride + channel..][..C]);
    }
}

/// Adds the features `f` of a neighbour to its cells. `patch` starts at the lowest of them.
#[inline(always)]
fn spread<I: InstructionSet, const C: usize, const CORNERS: usize>(
    patch: &mut [f32],
    f: &[f32],
    block: &Block,
    lane: usize,
    steps: &[usize; 8],
) {
    // The last step is the largest: one check for all.
    let patch = &mut patch[..steps[CORNERS - 1] + C];
    if C >= 16 {
        let f: [I::Vector; 8] = std::array::from_fn(|v| I::load(&f[v * I::LANES % C..]));
        for corner in 0..CORNERS {
            let weight = I::splat(block.weights[corner][lane]);
            for v in 0..C / I::LANES {
                let sums = &mut patch[steps[corner] + v * I::LANES..];
                I::store(I::multiply_add(weight, f[v], I::load(sums)), sums);
            }
        }
    } else {
        let f: [I::Quad; 2] = std::array::from_fn(|v| I::quad_load(&f[v * 4 % C..]));
        for corner in 0..CORNERS {
            let weight = I::quad_splat(block.weights[corner][lane]);
            for v in 0..C / 4 {
                let sums = &mut patch[steps[corner] + v * 4..];
                I::quad_store(I::quad_multiply_add(weight, f[v], I::quad_load(sums)), sums);
            }
        }
    }
}

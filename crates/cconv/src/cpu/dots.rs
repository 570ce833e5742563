//! The derivatives by the weights of the pairs: h_c = f_i · g_c · dL/d output, for every pair and cell.
//!
//! The gradient of each output point is multiplied by all cells of the filter, [cells · in], a slab of channels at
//! a time; every pair then takes the dot products of its neighbour's features with the cells it has a weight in.

use std::ops::Range;

use rayon::prelude::*;

use super::{Scratch, Workspace, with_scratch};
use crate::Filter;
use crate::filter::panels;
use crate::geometry::{LANES, Lists, PairGradient};
use crate::kernel::{InstructionSet, Operation, Product, ROWS};

/// Blocks of pairs of a task, some 200 points.
const TASK_BLOCKS: usize = 512;

/// Adds the derivatives of one layer.
pub fn run(
    lists: &Lists,
    filter: &Filter,
    features: &[f32],
    output_gradient: &[f32],
    pairs: &mut PairGradient,
    workspace: &mut Workspace,
) {
    let Workspace { scratch, whole, .. } = workspace;
    let features = super::pad(features, filter.in_channels, filter.slabs.padded(), lists.columns, whole);
    let splits = &lists.neighbors.row_splits;
    pairs.blocks.par_chunks_mut(TASK_BLOCKS).enumerate().for_each(|(k, blocks)| {
        let first = k * TASK_BLOCKS * LANES;
        let end = lists.neighbors.indices.len().min(first + blocks.len() * LANES);
        // The rows of these pairs; the first and the last may be shared with other tasks.
        let first_row = splits.partition_point(|&start| start <= first) - 1;
        let end_row = splits.partition_point(|&start| start < end);
        with_scratch(scratch, |scratch| {
            lists.kernel.run(Task {
                lists,
                filter,
                features,
                output_gradient,
                pairs: first..end,
                rows: first_row..end_row,
                blocks,
                scratch,
            });
        });
    });
}

struct Task<'a> {
    lists: &'a Lists,
    filter: &'a Filter,
    /// [columns, padded in channels].
    features: &'a [f32],
    output_gradient: &'a [f32],
    pairs: Range<usize>,
    rows: Range<usize>,
    /// The blocks of `pairs`.
    blocks: &'a mut [[[f32; LANES]; 8]],
    scratch: &'a mut Scratch,
}

impl Operation for Task<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Task { lists, filter, features, output_gradient, pairs, rows, blocks, scratch } = self;
        let outputs = filter.out_channels;
        let Scratch { sums: products, packed, .. } = scratch;
        packed.reserve_len(ROWS * outputs);
        let splits = &lists.neighbors.row_splits;
        let mut weights: &[f32] = filter.packed_by_cell();
        for slab in filter.slabs.iter() {
            let columns = filter.cells * slab.len();
            let width = columns.next_multiple_of(16);
            products.reserve_len(ROWS * width);
            let (slab_weights, rest) = weights.split_at(outputs * width);
            weights = rest;
            for block in rows.clone().step_by(ROWS) {
                let live = ROWS.min(rows.end - block);
                let a = match output_gradient.get(block * outputs..(block + ROWS) * outputs) {
                    Some(rows) => rows,
                    None => {
                        let live = &output_gradient[block * outputs..(block + live) * outputs];
                        packed[..live.len()].copy_from_slice(live);
                        &*packed
                    }
                };
                products[..ROWS * width].fill(0.0);
                for (first, panel) in panels(columns) {
                    I::multiply(Product {
                        rows: live,
                        depth: outputs,
                        width: panel,
                        a,
                        a_stride: outputs,
                        b: &slab_weights[outputs * first..],
                        c: &mut products[first..],
                        c_stride: width,
                    });
                }
                for (row, products) in (block..block + live).zip(products.chunks_exact(width)) {
                    for pair in splits[row].max(pairs.start)..splits[row + 1].min(pairs.end) {
                        let start =
                            lists.neighbors.indices[pair] as usize * filter.slabs.padded() + slab.start;
                        let f = &features[start..start + slab.len()];
                        let cell = lists.blocks[pair / LANES].cell[pair % LANES] as usize;
                        let place = pair - pairs.start;
                        let sums = &mut blocks[place / LANES];
                        for corner in 0..lists.corners {
                            let product =
                                &products[(cell + lists.steps[corner]) * slab.len()..][..slab.len()];
                            sums[corner][place % LANES] += dot::<I>(f, product);
                        }
                    }
                }
            }
        }
    }
}

/// The dot product of rows whose length is 4, 8 or a multiple of 16.
#[inline(always)]
fn dot<I: InstructionSet>(a: &[f32], b: &[f32]) -> f32 {
    if a.len() >= 16 {
        let mut sum = I::mul(I::load(a), I::load(b));
        for k in (I::LANES..a.len()).step_by(I::LANES) {
            sum = I::multiply_add(I::load(&a[k..]), I::load(&b[k..]), sum);
        }
        I::sum(sum)
    } else {
        let mut sum = I::quad_splat(0.0);
        for (a, b) in a.chunks_exact(4).zip(b.chunks_exact(4)) {
            sum = I::quad_multiply_add(I::quad_load(a), I::quad_load(b), sum);
        }
        let mut lanes = [0.0; 4];
        I::quad_store(sum, &mut lanes);
        (lanes[0] + lanes[1]) + (lanes[2] + lanes[3])
    }
}

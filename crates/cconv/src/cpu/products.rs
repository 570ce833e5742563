//! A layer with few output channels, forward, or as the gradient of few features: the features of every input point
//! are multiplied by all cells of the filter first, and the products [points, cells · out] are interpolated.
//!
//! The number of multiplications is the same as through patches, but the interpolation reads out channels a
//! pair and cell in place of in channels.

use std::sync::Mutex;

use rayon::prelude::*;

use super::patches::Patches;
use super::{Columns, Output, Scratch, Workspace, with_scratch};
use crate::Filter;
use crate::filter::panels;
use crate::geometry::{LANES, Lists};
use crate::kernel::{InstructionSet, Kernel, Operation, Product, ROWS};

/// Points of a task.
const TASK_ROWS: usize = 16 * ROWS;

/// How many pairs ahead the products of a neighbour are asked for.
const PREFETCH_PAIRS: usize = 4;

pub fn run(source: Patches<'_>, group: usize, output: Output<'_>, workspace: &mut Workspace) {
    let Patches { lists, filter, features } = source;
    let width = filter.rows() * group;
    let Workspace { scratch, whole, .. } = workspace;
    whole.reserve_len(lists.columns * width);
    let products = &mut whole[..lists.columns * width];
    let rows =
        Rows { features, in_channels: filter.in_channels, packed: &filter.packed, columns: width, bias: &[] };
    let columns = Columns { values: products, stride: width, first: 0 };
    multiply(rows, Output { columns, add: false }, scratch, lists.kernel);
    output.tasks(TASK_ROWS).for_each(|(first_row, output)| {
        lists.kernel.run(Gather { lists, filter, group, products, first_row, output });
    });
}

/// Rows of features times a packed matrix, plus a bias.
#[derive(Clone, Copy)]
pub struct Rows<'a> {
    /// [points, in channels].
    pub features: &'a [f32],
    pub in_channels: usize,
    /// Panels [in channels, columns].
    pub packed: &'a [f32],
    pub columns: usize,
    /// One value per column, or none.
    pub bias: &'a [f32],
}

/// Multiplies all rows.
pub fn multiply(rows: Rows<'_>, output: Output<'_>, scratch: &[Mutex<Scratch>], kernel: Kernel) {
    output.tasks(TASK_ROWS).for_each(|(first_row, output)| {
        with_scratch(scratch, |scratch| kernel.run(RowsTask { rows, first_row, output, scratch }));
    });
}

/// The rows from `first_row` on, as many as `output` has.
struct RowsTask<'a> {
    rows: Rows<'a>,
    first_row: usize,
    output: Output<'a>,
    scratch: &'a mut Scratch,
}

impl Operation for RowsTask<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Rows { features, in_channels: depth, packed, columns, bias } = self.rows;
        let mut output = self.output;
        let width = columns.next_multiple_of(16);
        let Scratch { patches, sums, .. } = self.scratch;
        patches.reserve_len(ROWS * depth);
        sums.reserve_len(ROWS * width);
        let count = output.rows();
        for block in (0..count).step_by(ROWS) {
            let live = ROWS.min(count - block);
            let start = (self.first_row + block) * depth;
            let a = match features.get(start..start + ROWS * depth) {
                Some(rows) => rows,
                None => {
                    patches[..live * depth].copy_from_slice(&features[start..start + live * depth]);
                    &*patches
                }
            };
            sums[..ROWS * width].fill(0.0);
            for (column, panel) in panels(columns) {
                I::multiply(Product {
                    rows: live,
                    depth,
                    width: panel,
                    a,
                    a_stride: depth,
                    b: &packed[depth * column..],
                    c: &mut sums[column..],
                    c_stride: width,
                });
            }
            output.write(block..block + live, sums, width, columns, bias);
        }
    }
}

/// Interpolates products for the output points from `first_row` on.
struct Gather<'a> {
    lists: &'a Lists,
    filter: &'a Filter,
    /// Values a cell: the output channels, padded.
    group: usize,
    /// [input points, cells · group].
    products: &'a [f32],
    first_row: usize,
    output: Output<'a>,
}

impl Operation for Gather<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        match self.group {
            4 => self.gather::<I, 4>(),
            _ => self.gather::<I, 8>(),
        }
    }
}

impl Gather<'_> {
    #[inline(always)]
    fn gather<I: InstructionSet, const G: usize>(self) {
        let Gather { lists, filter, products, first_row, mut output, .. } = self;
        let stride = filter.rows() * G;
        let last = lists.neighbors.indices.len().saturating_sub(1);
        for k in 0..output.rows() {
            let row = first_row + k;
            // Four chains of additions, so that one need not wait for the other.
            let mut sums = [[I::quad_splat(0.0); 2]; 4];
            for pair in lists.neighbors.row_splits[row]..lists.neighbors.row_splits[row + 1] {
                let block = &lists.blocks[pair / LANES];
                let lane = pair % LANES;
                let ahead = (pair + PREFETCH_PAIRS).min(last);
                let next = lists.neighbors.indices[ahead] as usize * stride;
                let next_block = &lists.blocks[ahead / LANES];
                let next = &products[next + next_block.cell[ahead % LANES] as usize * G..];
                for corner in (0..lists.corners).step_by(2) {
                    I::prefetch(&next[lists.steps[corner] * G]);
                }
                let own = &products[lists.neighbors.indices[pair] as usize * stride..][..stride];
                let own = &own[block.cell[lane] as usize * G..];
                for corner in 0..lists.corners {
                    let weight = I::quad_splat(block.weights[corner][lane]);
                    let product = &own[lists.steps[corner] * G..][..G];
                    for (sum, product) in sums[corner % 4].iter_mut().zip(product.chunks_exact(4)) {
                        *sum = I::quad_multiply_add(weight, I::quad_load(product), *sum);
                    }
                }
            }
            let mut totals = [[0.0; 8]; 4];
            for (total, sum) in totals.iter_mut().zip(sums) {
                I::quad_store(sum[0], total);
                I::quad_store(sum[1], &mut total[4..]);
            }
            let mut row_sums = [0.0; 8];
            for (channel, sum) in row_sums.iter_mut().enumerate().take(filter.out_channels) {
                let [a, b, c, d] = totals.map(|total| total[channel]);
                *sum = (a + b) + (c + d);
                if filter.rows() > filter.cells {
                    *sum += products[row * stride + filter.cells * G + channel];
                }
            }
            output.write(k..k + 1, &row_sums, 8, filter.out_channels, &filter.bias);
        }
    }
}

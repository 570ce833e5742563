//! The forward pass of a layer with few output channels: the features of every input point are multiplied by
//! all cells of the filter first, and the products [points, cells · out] are interpolated.
//!
//! The number of multiplications is the same as through patches, but the interpolation reads out channels a
//! pair and cell in place of in channels.

use std::sync::Mutex;

use rayon::prelude::*;

use super::{Columns, Scratch, Workspace, with_scratch};
use crate::filter::panels;
use crate::geometry::LANES;
use crate::kernel::{InstructionSet, Kernel, Operation, Product, ROWS};
use crate::{Filter, Geometry};

/// Points of a task.
const TASK_ROWS: usize = 16 * ROWS;

/// How many pairs ahead the products of a neighbour are asked for.
const PREFETCH_PAIRS: usize = 4;

pub fn forward(
    geometry: &Geometry,
    filter: &Filter,
    group: usize,
    features: &[f32],
    output: Columns<'_>,
    workspace: &mut Workspace,
) {
    let width = filter.rows() * group;
    let Workspace { scratch, whole } = workspace;
    whole.reserve_len(geometry.inputs * width);
    let products = &mut whole[..geometry.inputs * width];
    let rows =
        Rows { features, in_channels: filter.in_channels, packed: &filter.packed, columns: width, bias: &[] };
    multiply(rows, Columns { values: products, stride: width, first: 0 }, scratch, geometry.kernel);
    let Columns { values, stride, first } = output;
    values.par_chunks_mut(TASK_ROWS * stride).enumerate().for_each(|(k, rows)| {
        let output = Columns { values: rows, stride, first };
        geometry.kernel.run(Gather { geometry, filter, group, products, first_row: k * TASK_ROWS, output });
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
pub fn multiply(rows: Rows<'_>, output: Columns<'_>, scratch: &[Mutex<Scratch>], kernel: Kernel) {
    let Columns { values, stride, first } = output;
    values.par_chunks_mut(TASK_ROWS * stride).enumerate().for_each(|(k, values)| {
        with_scratch(scratch, |scratch| {
            let output = Columns { values, stride, first };
            kernel.run(RowsTask { rows, first_row: k * TASK_ROWS, output, scratch });
        });
    });
}

/// The rows from `first_row` on, as many as `output` has.
struct RowsTask<'a> {
    rows: Rows<'a>,
    first_row: usize,
    output: Columns<'a>,
    scratch: &'a mut Scratch,
}

impl Operation for RowsTask<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Rows { features, in_channels: depth, packed, columns, bias } = self.rows;
        let Columns { values, stride, first } = self.output;
        let width = columns.next_multiple_of(16);
        let Scratch { patches, sums } = self.scratch;
        patches.reserve_len(ROWS * depth);
        sums.reserve_len(ROWS * width);
        let count = values.len() / stride;
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
            let rows = values[block * stride..].chunks_exact_mut(stride);
            for (row, sums) in rows.zip(sums.chunks_exact(width)).take(live) {
                let row = &mut row[first..first + columns];
                row.copy_from_slice(&sums[..columns]);
                for (value, bias) in row.iter_mut().zip(bias) {
                    *value += bias;
                }
            }
        }
    }
}

/// Interpolates products for the output points from `first_row` on.
struct Gather<'a> {
    geometry: &'a Geometry,
    filter: &'a Filter,
    /// Values a cell: the output channels, padded.
    group: usize,
    /// [input points, cells · group].
    products: &'a [f32],
    first_row: usize,
    output: Columns<'a>,
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
        let Gather { geometry, filter, products, .. } = self;
        let stride = filter.rows() * G;
        let last = geometry.indices.len().saturating_sub(1);
        for (k, output) in self.output.values.chunks_exact_mut(self.output.stride).enumerate() {
            let row = self.first_row + k;
            // Four chains of additions, so that one need not wait for the other.
            let mut sums = [[I::quad_splat(0.0); 2]; 4];
            for pair in geometry.row_splits[row]..geometry.row_splits[row + 1] {
                let block = &geometry.blocks[pair / LANES];
                let lane = pair % LANES;
                let ahead = (pair + PREFETCH_PAIRS).min(last);
                let next = geometry.indices[ahead] as usize * stride;
                let next_block = &geometry.blocks[ahead / LANES];
                let next = &products[next + next_block.cell[ahead % LANES] as usize * G..];
                for corner in (0..geometry.corners).step_by(2) {
                    I::prefetch(&next[geometry.steps[corner] * G]);
                }
                let own = &products[geometry.indices[pair] as usize * stride..][..stride];
                let own = &own[block.cell[lane] as usize * G..];
                for corner in 0..geometry.corners {
                    let weight = I::quad_splat(block.weights[corner][lane]);
                    let product = &own[geometry.steps[corner] * G..][..G];
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
            let output = &mut output[self.output.first..][..filter.out_channels];
            for (channel, value) in output.iter_mut().enumerate() {
                let [a, b, c, d] = totals.map(|total| total[channel]);
                let sum = (a + b) + (c + d);
                let bias = filter.bias.get(channel).copied().unwrap_or(0.0);
                *value = sum + bias;
                if filter.rows() > filter.cells {
                    *value += products[row * stride + filter.cells * G + channel];
                }
            }
        }
    }
}

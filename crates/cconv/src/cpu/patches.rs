//! Patch matrices (paper, section A.1): features are interpolated into a matrix [points, cells · channels].
//!
//! The forward pass multiplies it by the filter. So does the backward pass, with the lists transposed: the
//! gradient of the features is the operator itself, applied to the gradient of the output with the filter's
//! channels exchanged. The gradient of the filter is the patch matrix, transposed, times the other side: of
//! the features and the gradient of the output, one is interpolated and the other is not.
//!
//! The matrix never exists as a whole. A task takes some points and goes through the slabs of channels; for
//! each slab it fills the patches of a few points and multiplies them while they are hot, so that the
//! weights of the slab are fetched once a task.

use std::ops::Range;

use rayon::prelude::*;

use super::sums::{Block, FilterSums, PARTIAL_SUMS, PartialSum, SUM_ROWS, chunks, sum_size};
use super::{Output, Scratch, Workspace, pad, with_scratch};
use crate::filter::panels;
use crate::geometry::{Block as Weights, LANES, Lists};
use crate::kernel::{InstructionSet, Operation, Product, ROWS};
use crate::{Filter, Precision};

/// Points of a task: enough to pay for fetching the weights, few enough to balance two threads on
/// some thousand points.
const TASK_ROWS: usize = 16 * ROWS;

/// Patches that are filled before they are multiplied, if a filter's gradient is summed: the sums are
/// loaded and stored once for so many points.
const SUM_BLOCK: usize = 4 * ROWS;

/// How many pairs ahead the features of a neighbour are asked for.
const PREFETCH_PAIRS: usize = 4;

/// What is interpolated: some features over some lists, for a filter whose input they are.
#[derive(Clone, Copy)]
pub struct Patches<'a> {
    pub lists: &'a Lists,
    pub filter: &'a Filter,
    /// [columns of the lists, in channels].
    pub features: &'a [f32],
}

/// Fills all patches; multiplies them by the filter, sums their products with the other side, or both.
pub fn run(
    patches: Patches<'_>,
    output: Option<Output<'_>>,
    mut sums: Option<FilterSums<'_>>,
    workspace: &mut Workspace,
) {
    let Patches { lists, filter, features } = patches;
    let Workspace { scratch, whole, partial } = workspace;
    let features = pad(features, filter.in_channels, filter.slabs.padded(), lists.columns, whole);
    let patches = Patches { features, ..patches };
    let chunks = chunks(&lists.clouds, if sums.is_some() { SUM_ROWS } else { TASK_ROWS });
    let mut outputs = output.map(|output| output.split(&chunks).into_iter());
    let held = if sums.is_some() { PARTIAL_SUMS.min(chunks.len()) } else { chunks.len() }.max(1);
    let size = sums.as_ref().map_or(0, |sums| sum_size(filter, sums.channels));
    partial.reserve_len(held * size);
    for chunks in chunks.chunks(held) {
        let mut partials = partial.chunks_exact_mut(size.max(1));
        let tasks: Vec<Task<'_>> = chunks
            .iter()
            .map(|rows| Task {
                patches,
                first_row: rows.start,
                rows: rows.len(),
                output: outputs.as_mut().and_then(Iterator::next),
                sum: sums.as_ref().zip(partials.next()).map(|(sums, values)| sums.partial(rows, values)),
            })
            .collect();
        tasks.into_par_iter().for_each(|task| {
            with_scratch(scratch, |scratch| lists.kernel.run(TaskWith { task, scratch }));
        });
        if let Some(sums) = &mut sums {
            sums.add(filter, &partial[..chunks.len() * size]);
        }
    }
}

/// The points from `first_row` on.
struct Task<'a> {
    patches: Patches<'a>,
    first_row: usize,
    rows: usize,
    output: Option<Output<'a>>,
    sum: Option<PartialSum<'a>>,
}

struct TaskWith<'a> {
    task: Task<'a>,
    scratch: &'a mut Scratch,
}

impl Operation for TaskWith<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Task { patches: source, first_row, rows, mut output, mut sum } = self.task;
        let filter = source.filter;
        let width = filter.out_channels.next_multiple_of(16);
        let Scratch { patches, rounded, paired, sums, packed } = self.scratch;
        let summed_rows = if output.is_some() { rows.next_multiple_of(ROWS) } else { 0 };
        sums.reserve_len(summed_rows * width);
        sums[..summed_rows * width].fill(0.0);
        let block_rows = if sum.is_some() { SUM_BLOCK } else { ROWS };
        for slab in filter.slabs.iter() {
            let depth = filter.rows() * slab.len();
            let stride = patch_stride(depth);
            let weights = filter.rows() * slab.start * width;
            for block in (0..rows).step_by(block_rows) {
                let live = block..rows.min(block + block_rows);
                let source = |row: usize| Source { patches: source, row: first_row + row, slab: &slab };
                match filter.precision {
                    Precision::F32 => {
                        patches.reserve_len(block_rows * stride);
                        for (row, patch) in live.clone().zip(patches.chunks_exact_mut(stride)) {
                            fill_slab::<I>(&mut patch[..depth], &source(row));
                        }
                    }
                    Precision::Bf16 => {
                        // Two at a time, so that they are rounded while they are in the first-level cache.
                        patches.reserve_len(2 * stride);
                        rounded.reserve_len(block_rows * stride / 2);
                        paired.reserve_len(block_rows * stride / 2);
                        let rounded = rounded.halves_mut().chunks_exact_mut(2 * stride);
                        let paired = paired.halves_mut().chunks_exact_mut(2 * stride);
                        for ((row, rounded), paired) in live.clone().step_by(2).zip(rounded).zip(paired) {
                            let (first, second) = patches.split_at_mut(stride);
                            let (first, second) = (&mut first[..depth], &mut second[..depth]);
                            fill_slab::<I>(first, &source(row));
                            if row + 1 < live.end {
                                fill_slab::<I>(second, &source(row + 1));
                            } else {
                                // The last point has no other to make a pair with.
                                second.fill(0.0);
                            }
                            if output.is_some() {
                                I::round_bf16(first, &mut rounded[..depth]);
                                I::round_bf16(second, &mut rounded[stride..stride + depth]);
                            }
                            if sum.is_some() {
                                I::interleave_bf16(first, second, &mut paired[..2 * depth]);
                            }
                        }
                    }
                }
                let block = Block {
                    exact: patches,
                    rounded: rounded.halves(),
                    paired: paired.halves(),
                    stride,
                    depth,
                };
                if output.is_some() {
                    multiply::<I>(filter, weights, block, live.len(), &mut sums[live.start * width..]);
                }
                if let Some(sum) = &mut sum {
                    sum.add::<I>(block, live, slab.start, filter, packed);
                }
            }
        }
        if let Some(output) = &mut output {
            output.write(0..rows, sums, width, filter.out_channels, &filter.bias);
        }
    }
}

/// Adds the products of `live` patches with the slab of weights that starts at `start` to `sums`.
#[inline(always)]
fn multiply<I: InstructionSet>(
    filter: &Filter,
    start: usize,
    block: Block<'_>,
    live: usize,
    sums: &mut [f32],
) {
    let Block { exact, rounded, stride, depth, .. } = block;
    let c_stride = filter.out_channels.next_multiple_of(16);
    for first_row in (0..live).step_by(ROWS) {
        let rows = ROWS.min(live - first_row);
        for (first, width) in panels(filter.out_channels) {
            let (b, c) = (start + depth * first, &mut sums[first_row * c_stride + first..]);
            match filter.precision {
                Precision::F32 => {
                    let (a, b) = (&exact[first_row * stride..], &filter.packed[b..]);
                    I::multiply(Product { rows, depth, width, a, a_stride: stride, b, c, c_stride });
                }
                Precision::Bf16 => {
                    let (a, b) = (&rounded[first_row * stride..], &filter.packed.halves()[b..]);
                    I::multiply_bf16(Product { rows, depth, width, a, a_stride: stride, b, c, c_stride });
                }
            }
        }
    }
}

/// Floats from a patch to the next. Multiples of a page would all fall into the same few lines of the cache.
fn patch_stride(depth: usize) -> usize {
    const PAGE: usize = 1024;
    const LINE: usize = 16;
    if depth.is_multiple_of(PAGE) { depth + LINE } else { depth }
}

/// Where a patch comes from: the neighbours of one point, some channels of their features.
struct Source<'a> {
    patches: Patches<'a>,
    row: usize,
    slab: &'a Range<usize>,
}

/// Fills the patch [cells, slab] of one point.
#[inline(always)]
fn fill_slab<I: InstructionSet>(patch: &mut [f32], source: &Source<'_>) {
    match source.slab.len() {
        4 => fill::<I, 4>(patch, source),
        8 => fill::<I, 8>(patch, source),
        16 => fill::<I, 16>(patch, source),
        _ => fill::<I, 32>(patch, source),
    }
}

#[inline(always)]
fn fill<I: InstructionSet, const C: usize>(patch: &mut [f32], source: &Source<'_>) {
    let Source { patches: Patches { lists, filter, features }, row, slab } = source;
    let (row, channel, stride) = (*row, slab.start, filter.slabs.padded());
    let (patch, pointwise) = patch.split_at_mut(filter.cells * C);
    patch.fill(0.0);
    let indices = &lists.neighbors.indices;
    let last = indices.len().saturating_sub(1);
    let steps = lists.steps.map(|step| step * C);
    for pair in lists.neighbors.row_splits[row]..lists.neighbors.row_splits[row + 1] {
        let start = |pair: usize| indices[pair] as usize * stride + channel;
        let next = start((pair + PREFETCH_PAIRS).min(last));
        I::prefetch(&features[next]);
        I::prefetch(&features[next + C / 2]);
        let f = &features[start(pair)..][..C];
        let block = &lists.blocks[pair / LANES];
        let lane = pair % LANES;
        let patch = &mut patch[block.cell[lane] as usize * C..];
        if lists.corners == 8 {
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
    block: &Weights,
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

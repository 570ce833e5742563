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

use rayon::prelude::*;

use super::sums::{Block, FilterSums, PARTIAL_SUMS, PartialSum, SUM_ROWS, chunks, sum_size};
use super::{Output, Scratch, Workspace, pad, with_scratch};
use crate::aligned::AlignedVec;
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
                sum: sums.as_ref().and_then(|sums| sums.partial(rows, partials.next()?)),
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
        let Scratch { patches, sums, rounded, packed } = self.scratch;
        let summed_rows = if output.is_some() { rows.next_multiple_of(ROWS) } else { 0 };
        sums.reserve_len(summed_rows * width);
        sums[..summed_rows * width].fill(0.0);
        let block_rows = if sum.is_some() { SUM_BLOCK } else { ROWS };
        for slab in filter.slabs.iter() {
            let depth = filter.rows() * slab.len();
            let stride = patch_stride(depth);
            patches.reserve_len(block_rows * stride);
            for block in (0..rows).step_by(block_rows) {
                let live = block_rows.min(rows - block);
                for (row, patch) in patches.chunks_exact_mut(stride).take(live).enumerate() {
                    let source =
                        Source { patches: source, row: first_row + block + row, channel: slab.start };
                    match slab.len() {
                        4 => fill::<I, 4>(&mut patch[..depth], &source),
                        8 => fill::<I, 8>(&mut patch[..depth], &source),
                        16 => fill::<I, 16>(&mut patch[..depth], &source),
                        _ => fill::<I, 32>(&mut patch[..depth], &source),
                    }
                }
                if output.is_some() {
                    let start = filter.rows() * slab.start * width;
                    let sums = &mut sums[block * width..];
                    multiply::<I>(filter, start, (patches, stride, depth), live, sums, rounded);
                }
                if let Some(sum) = &mut sum {
                    let patches = Block { patches, stride, depth, rows: block..block + live };
                    sum.add::<I>(patches, slab.start, filter, (&mut *rounded, &mut *packed));
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
    (patches, stride, depth): (&[f32], usize, usize),
    live: usize,
    sums: &mut [f32],
    rounded: &mut AlignedVec,
) {
    let width = filter.out_channels.next_multiple_of(16);
    for first_row in (0..live).step_by(ROWS) {
        let rows = ROWS.min(live - first_row);
        let patches = &patches[first_row * stride..];
        let sums = &mut sums[first_row * width..];
        if filter.precision == Precision::Bf16 {
            rounded.reserve_len(ROWS * stride / 2);
            let halves = rounded.halves_mut().chunks_exact_mut(stride);
            for (to, from) in halves.zip(patches.chunks(stride)).take(rows) {
                I::round_bf16(&from[..depth], &mut to[..depth]);
            }
        }
        for (first, panel) in panels(filter.out_channels) {
            let b = start + depth * first;
            let (c, c_stride) = (&mut sums[first..], width);
            match filter.precision {
                Precision::F32 => {
                    let (a, b) = (patches, &filter.packed[b..]);
                    I::multiply(Product { rows, depth, width: panel, a, a_stride: stride, b, c, c_stride });
                }
                Precision::Bf16 => {
                    let (a, b) = (rounded.halves(), &filter.packed.halves()[b..]);
                    I::multiply_bf16(Product {
                        rows,
                        depth,
                        width: panel,
                        a,
                        a_stride: stride,
                        b,
                        c,
                        c_stride,
                    });
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
    channel: usize,
}

/// Fills the patch [cells, `C`] of one point.
#[inline(always)]
fn fill<I: InstructionSet, const C: usize>(patch: &mut [f32], source: &Source<'_>) {
    let Source { patches: Patches { lists, filter, features }, row, channel } = *source;
    let stride = filter.slabs.padded();
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

//! The gradient of a filter: patches, transposed, times the other side, summed over points.
//!
//! Sums are taken over runs of a fixed number of points of one cloud, and added in their order: so they do not
//! depend on the number of threads, and those of several clouds are those of one call a cloud.

use std::ops::Range;

use rayon::prelude::*;

use super::{Scratch, Workspace, with_scratch};
use crate::aligned::AlignedVec;
use crate::filter::panels;
use crate::kernel::{Bf16, InstructionSet, Kernel, Operation, Outer, PANEL, ROWS};
use crate::{Filter, Precision};

/// Points over which one partial sum is taken. Part of the result's bits.
pub const SUM_ROWS: usize = 32 * ROWS;

/// Partial sums that are held at once.
pub const PARTIAL_SUMS: usize = 16;

/// Cuts each cloud's points into runs of at most `size`.
pub fn chunks(clouds: &[usize], size: usize) -> Vec<Range<usize>> {
    let cut = |cloud: &[usize]| {
        let (start, end) = (cloud[0], cloud[1]);
        (start..end).step_by(size).map(move |first| first..end.min(first + size))
    };
    clouds.windows(2).flat_map(cut).collect()
}

/// Values of one partial sum: [slab][cell, channel][other channel, padded].
pub fn sum_size(filter: &Filter, channels: usize) -> usize {
    filter.rows() * filter.slabs.padded() * channels.next_multiple_of(16)
}

/// Adds the sums of the columns of `rows` [points, channels] to `sums`.
pub fn add_columns(rows: &[f32], clouds: &[usize], sums: &mut [f32]) {
    let channels = sums.len();
    for run in chunks(clouds, SUM_ROWS) {
        let mut partial = vec![0.0; channels];
        for row in rows[run.start * channels..run.end * channels].chunks_exact(channels) {
            partial.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        sums.iter_mut().zip(partial).for_each(|(sum, value)| *sum += value);
    }
}

/// How points are cut into runs, and what computes.
#[derive(Clone, Copy)]
pub struct Partition<'a> {
    pub clouds: &'a [usize],
    pub kernel: Kernel,
}

/// Adds aᵀ b to `sums` [channels of a, channels of b], for `a` and `b` of [points, channels].
pub fn add_products(
    a: &[f32],
    b: &[f32],
    points: Partition<'_>,
    (rows, columns): (usize, usize),
    sums: &mut [f32],
    workspace: &mut Workspace,
) {
    let Workspace { scratch, partial, .. } = workspace;
    let (a_stride, padded) = (rows.next_multiple_of(4), columns.next_multiple_of(16));
    let size = a_stride * padded;
    let chunks = chunks(points.clouds, SUM_ROWS);
    partial.reserve_len(chunks.len() * size);
    let partial = &mut partial[..chunks.len() * size];
    partial.par_chunks_exact_mut(size).zip(&chunks).for_each(|(partial, run)| {
        with_scratch(scratch, |scratch| {
            let Scratch { patches, packed, .. } = scratch;
            let a = &a[run.start * rows..run.end * rows];
            let b = &b[run.start * columns..run.end * columns];
            let (a_padded, b_packed) = (patches, packed);
            points.kernel.run(Products { a, b, rows, columns, partial, a_padded, b_packed });
        });
    });
    for partial in partial.chunks_exact(size) {
        for (sums, partial) in sums.chunks_exact_mut(columns).zip(partial.chunks_exact(padded)) {
            sums.iter_mut().zip(partial).for_each(|(sum, value)| *sum += value);
        }
    }
}

/// One partial sum of [`add_products`].
struct Products<'a> {
    a: &'a [f32],
    b: &'a [f32],
    rows: usize,
    columns: usize,
    partial: &'a mut [f32],
    a_padded: &'a mut AlignedVec,
    b_packed: &'a mut AlignedVec,
}

impl Operation for Products<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Products { a, b, rows, columns, partial, a_padded, b_packed } = self;
        let (depth, a_stride) = (a.len() / rows, rows.next_multiple_of(4));
        let a = super::pad(a, rows, a_stride, depth, a_padded);
        partial.fill(0.0);
        multiply_outer::<I>((a, a_stride, a_stride), (b, columns), partial, b_packed);
    }
}

/// sums += aᵀ b, with `a` of [points, `rows` of `a_stride`], `b` of [points, columns] and `sums` of
/// [rows, columns padded to 16].
#[inline(always)]
fn multiply_outer<I: InstructionSet>(
    (a, a_stride, rows): (&[f32], usize, usize),
    (b, columns): (&[f32], usize),
    sums: &mut [f32],
    packed: &mut AlignedVec,
) {
    let depth = b.len() / columns;
    let padded = columns.next_multiple_of(16);
    packed.reserve_len(depth * padded);
    for (first, width) in panels(columns) {
        let live = width.min(columns - first);
        for (to, row) in packed.chunks_exact_mut(width).zip(b.chunks_exact(columns)) {
            to[..live].copy_from_slice(&row[first..first + live]);
            to[live..].fill(0.0);
        }
        let c = &mut sums[first..];
        I::multiply_outer(Outer { rows, depth, width, a, a_stride, b: packed, c, c_stride: padded });
    }
}

/// Where the gradient of a filter is added.
pub struct FilterSums<'a> {
    /// The other side, [rows of the lists, channels].
    pub other: &'a [f32],
    pub channels: usize,
    /// [cells, in, out].
    pub filter: &'a mut [f32],
    /// [in, out], if it is wanted.
    pub pointwise: Option<&'a mut [f32]>,
    /// Whether the patches are those of output channels, and the other side has the input channels.
    pub exchanged: bool,
}

impl FilterSums<'_> {
    /// A partial sum over some rows.
    pub fn partial<'a>(&'a self, rows: &Range<usize>, values: &'a mut [f32]) -> PartialSum<'a> {
        let other = &self.other[rows.start * self.channels..rows.end * self.channels];
        PartialSum { other, channels: self.channels, values }
    }

    /// Adds partial sums, in order. `filter` is that of the patches.
    pub fn add(&mut self, filter: &Filter, partials: &[f32]) {
        let (other, exchanged) = (self.channels, self.exchanged);
        let cell_size = filter.in_channels * other;
        let add_cell = |cell: usize, gradient: &mut [f32]| {
            let padded = other.next_multiple_of(16);
            let mut row = vec![0.0; other];
            for slab in filter.slabs.iter() {
                for channel in slab.start..slab.end.min(filter.in_channels) {
                    let start = filter.rows() * slab.start + cell * slab.len() + channel - slab.start;
                    let place = |k: usize| {
                        if exchanged { k * filter.in_channels + channel } else { channel * other + k }
                    };
                    row.iter_mut().enumerate().for_each(|(k, value)| *value = gradient[place(k)]);
                    for partial in partials.chunks_exact(sum_size(filter, other)) {
                        let partial = &partial[start * padded..][..other];
                        row.iter_mut().zip(partial).for_each(|(sum, value)| *sum += value);
                    }
                    row.iter().enumerate().for_each(|(k, value)| gradient[place(k)] = *value);
                }
            }
        };
        self.filter
            .par_chunks_exact_mut(cell_size)
            .enumerate()
            .for_each(|(cell, gradient)| add_cell(cell, gradient));
        if let Some(pointwise) = &mut self.pointwise {
            add_cell(filter.cells, pointwise);
        }
    }
}

/// A sum over the points of one task. The first block that is added overwrites what was there.
pub struct PartialSum<'a> {
    other: &'a [f32],
    channels: usize,
    values: &'a mut [f32],
}

/// Patches of consecutive points of a task, of one slab: exact, or as the products in bfloat16 need them.
#[derive(Clone, Copy)]
pub struct Block<'a> {
    /// [points, `stride`], of which `depth` count.
    pub exact: &'a [f32],
    /// [points, `stride`].
    pub rounded: &'a [Bf16],
    /// Two points together, [pairs, `stride`, 2].
    pub paired: &'a [Bf16],
    pub stride: usize,
    pub depth: usize,
}

impl PartialSum<'_> {
    /// Adds the products of patches of the slab that starts with `channel` and their rows of the other side.
    #[inline(always)]
    pub fn add<I: InstructionSet>(
        &mut self,
        block: Block<'_>,
        rows: Range<usize>,
        channel: usize,
        filter: &Filter,
        packed: &mut AlignedVec,
    ) {
        let Block { exact, paired, stride, depth, .. } = block;
        let padded = self.channels.next_multiple_of(16);
        let values = &mut self.values[filter.rows() * channel * padded..][..depth * padded];
        if rows.start == 0 {
            values.fill(0.0);
        }
        let other = &self.other[rows.start * self.channels..rows.end * self.channels];
        match filter.precision {
            Precision::F32 => {
                multiply_outer::<I>((exact, stride, depth), (other, self.channels), values, packed);
            }
            Precision::Bf16 => {
                multiply_outer_bf16::<I>((paired, 2 * stride, depth), (other, self.channels), values, packed);
            }
        }
    }
}

/// As [`multiply_outer`], with two points together: `a` is rounded already.
#[inline(always)]
fn multiply_outer_bf16<I: InstructionSet>(
    (a, a_stride, rows): (&[Bf16], usize, usize),
    (b, columns): (&[f32], usize),
    sums: &mut [f32],
    packed: &mut AlignedVec,
) {
    let (depth, padded) = ((b.len() / columns).div_ceil(2), columns.next_multiple_of(16));
    packed.reserve_len(depth * padded);
    for (first, width) in panels(columns) {
        let live = width.min(columns - first);
        let mut both = [[0.0; PANEL]; 2];
        for (to, rows) in packed.halves_mut().chunks_exact_mut(2 * width).zip(b.chunks(2 * columns)) {
            both[1].fill(0.0);
            for (both, row) in both.iter_mut().zip(rows.chunks_exact(columns)) {
                both[..live].copy_from_slice(&row[first..first + live]);
            }
            I::interleave_bf16(&both[0][..width], &both[1][..width], to);
        }
        let (b, c) = (packed.halves(), &mut sums[first..]);
        I::multiply_outer_bf16(Outer { rows, depth, width, a, a_stride, b, c, c_stride: padded });
    }
}

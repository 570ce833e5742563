//! Where results go: rows of values, of which a layer writes some columns.

use std::ops::Range;

use rayon::prelude::*;

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

impl Columns<'_> {
    /// # Panics
    /// If the columns do not lie within the rows of so many points.
    pub(super) fn check(&self, points: usize, channels: usize) {
        let Columns { values, stride, first } = self;
        assert!(*stride > 0 && first + channels <= *stride, "columns {first}.. of rows of {stride} values");
        assert_eq!(values.len(), points * stride, "{points} rows of {stride} values");
    }
}

/// Columns that are written, or added to.
#[derive(Debug)]
pub struct Output<'a> {
    pub columns: Columns<'a>,
    pub add: bool,
}

impl<'a> Output<'a> {
    /// Whole rows that are added to.
    pub fn added(values: &'a mut [f32], stride: usize) -> Self {
        Output { columns: Columns { values, stride, first: 0 }, add: true }
    }

    /// The number of rows.
    pub fn rows(&self) -> usize {
        self.columns.values.len() / self.columns.stride
    }

    /// Runs of `size` rows, each with its first row.
    pub fn tasks(self, size: usize) -> impl IndexedParallelIterator<Item = (usize, Output<'a>)> {
        let Output { columns: Columns { values, stride, first }, add } = self;
        values
            .par_chunks_mut(size * stride)
            .enumerate()
            .map(move |(k, values)| (k * size, Output { columns: Columns { values, stride, first }, add }))
    }

    /// Cuts the rows into consecutive runs.
    pub fn split(self, runs: &[Range<usize>]) -> Vec<Output<'a>> {
        let Output { columns: Columns { values, stride, first }, add } = self;
        let mut rest = values;
        runs.iter()
            .map(|rows| {
                let (values, after) = std::mem::take(&mut rest).split_at_mut(rows.len() * stride);
                rest = after;
                Output { columns: Columns { values, stride, first }, add }
            })
            .collect()
    }

    /// Writes or adds rows of `sums`, of `width` values each, and a bias, which may be empty.
    #[inline(always)]
    pub fn write(&mut self, rows: Range<usize>, sums: &[f32], width: usize, channels: usize, bias: &[f32]) {
        let Columns { values, stride, first } = &mut self.columns;
        let live = &mut values[rows.start * *stride..rows.end * *stride];
        for (row, sums) in live.chunks_exact_mut(*stride).zip(sums.chunks_exact(width)) {
            let row = &mut row[*first..*first + channels];
            if self.add {
                row.iter_mut().zip(sums).for_each(|(value, sum)| *value += sum);
            } else {
                row.copy_from_slice(&sums[..channels]);
            }
            row.iter_mut().zip(bias).for_each(|(value, bias)| *value += bias);
        }
    }
}

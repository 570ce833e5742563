//! Loops over particles and their neighbours, the same at any number of threads.

use fluvia_neighbors::Neighbors;
use rayon::prelude::*;

/// Particles that one task works on.
pub(crate) const CHUNK: usize = 128;

/// The sum of f(i) for i below `count`, in an order that depends on nothing else.
pub(crate) fn sum(count: usize, f: impl Fn(usize) -> f64 + Sync) -> f64 {
    let chunk = |k: usize| (k * CHUNK..count.min((k + 1) * CHUNK)).map(&f).sum();
    let sums: Vec<f64> = (0..count.div_ceil(CHUNK)).into_par_iter().map(chunk).collect();
    sums.iter().sum()
}

/// Cuts `values`, one per entry of neighbour rows, into one slice for every `CHUNK` rows.
pub(crate) fn split_by_rows<'a, T>(values: &'a mut [T], row_splits: &[usize]) -> Vec<&'a mut [T]> {
    let rows = row_splits.len().saturating_sub(1);
    let mut rest = values;
    let mut slices = Vec::with_capacity(rows.div_ceil(CHUNK));
    for first in (0..rows).step_by(CHUNK) {
        let count = row_splits[rows.min(first + CHUNK)] - row_splits[first];
        let (slice, tail) = rest.split_at_mut(count);
        slices.push(slice);
        rest = tail;
    }
    slices
}

/// The largest number of neighbours besides the particle itself, where each is its own neighbour.
pub(crate) fn most_neighbors(neighbors: &Neighbors) -> u32 {
    let counts = (0..neighbors.queries()).map(|i| neighbors.count(i));
    counts.max().unwrap_or(0).saturating_sub(1) as u32
}

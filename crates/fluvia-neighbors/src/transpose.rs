//! The transpose of a neighbour list: for every point, the queries that it is a neighbour of.
//!
//! A backward pass scatters along a neighbour list; over the transposed list it gathers instead, so that
//! it needs no atomics and gives the same bits at any thread count.

use crate::Neighbors;

/// For every point, the pairs it takes part in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transpose {
    /// The query of each pair, point after point, ascending within a point.
    pub queries: Vec<u32>,
    /// The position of each pair in [`Neighbors::indices`].
    pub pairs: Vec<u32>,
    /// Where each point's row starts: points + 1 entries.
    pub row_splits: Vec<usize>,
}

/// Transposes the neighbour lists of `points` points.
///
/// # Panics
/// If an index is not below `points`, or if there are 2³² pairs or more.
pub fn transpose(neighbors: &Neighbors, points: usize) -> Transpose {
    let pairs = neighbors.indices.len();
    assert!(u32::try_from(pairs).is_ok(), "{pairs} pairs, at most {} can be numbered", u32::MAX);
    let mut row_splits = vec![0; points + 1];
    for &i in &neighbors.indices {
        assert!((i as usize) < points, "neighbour index {i} of {points} points");
        row_splits[i as usize + 1] += 1;
    }
    for i in 0..points {
        row_splits[i + 1] += row_splits[i];
    }
    let mut next = row_splits.clone();
    let (mut queries, mut numbers) = (vec![0; pairs], vec![0; pairs]);
    for q in 0..neighbors.queries() {
        for pair in neighbors.row_splits[q]..neighbors.row_splits[q + 1] {
            let slot = &mut next[neighbors.indices[pair] as usize];
            queries[*slot] = q as u32;
            numbers[*slot] = pair as u32;
            *slot += 1;
        }
    }
    Transpose { queries, pairs: numbers, row_splits }
}

//! The transpose of a neighbour list: for every point, the queries that it is a neighbour of.
//!
//! A backward pass scatters along a neighbour list; over the transposed list it gathers instead, so that
//! it needs no atomics and gives the same bits at any thread count.

use crate::Neighbors;

/// For every point, the pairs it takes part in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transpose {
    /// The queries of each point, ascending; without distances.
    pub queries: Neighbors,
    /// The position of each pair in [`Neighbors::indices`] of the list that was transposed.
    pub pairs: Vec<u32>,
}

impl Transpose {
    /// Transposes the neighbour lists of `points` points, into memory that is reused.
    ///
    /// # Panics
    /// If an index is not below `points`, or if there are 2³² pairs or more.
    pub fn build(&mut self, neighbors: &Neighbors, points: usize) {
        let count = neighbors.indices.len();
        assert!(u32::try_from(count).is_ok(), "{count} pairs, at most {} can be numbered", u32::MAX);
        let Transpose { queries: Neighbors { indices: queries, row_splits, distances }, pairs } = self;
        distances.clear();
        row_splits.clear();
        row_splits.resize(points + 1, 0);
        for &i in &neighbors.indices {
            assert!((i as usize) < points, "neighbour index {i} of {points} points");
            row_splits[i as usize] += 1;
        }
        let mut sum = 0;
        for start in row_splits.iter_mut() {
            sum += std::mem::replace(start, sum);
        }
        queries.clear();
        queries.resize(count, 0);
        pairs.clear();
        pairs.resize(count, 0);
        for q in 0..neighbors.queries() {
            for pair in neighbors.row_splits[q]..neighbors.row_splits[q + 1] {
                let slot = &mut row_splits[neighbors.indices[pair] as usize];
                queries[*slot] = q as u32;
                pairs[*slot] = pair as u32;
                *slot += 1;
            }
        }
        // Every entry has moved to the start of the next row.
        row_splits.rotate_right(1);
        row_splits[0] = 0;
    }
}

//! Fixed-radius neighbour search in three dimensions: which points lie within R of each query.
//!
//! A point x_i is a neighbour of the query x if d(x_i, x) <= R in the chosen [`Metric`]. The result is a
//! compact row-split list ([`Neighbors`]): the neighbours of query `q` are
//! `indices[row_splits[q]..row_splits[q + 1]]`.
//!
//! [`brute_force`] is the specification; [`Grid`] computes the same sets fast. Both compute distances in
//! float32 with the same operations, so that they agree on points exactly at the radius. The order inside
//! a row is not part of the contract, but it is a function of the input alone: the same input gives the
//! same bits at any thread count.

mod grid;
mod grids;
mod transpose;

pub use grid::Grid;
pub use grids::{Grids, check_clouds};
pub use transpose::Transpose;

/// A position in metres: x, y, z.
pub type Point = [f32; 3];

/// How the distance between two points is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Metric {
    /// |dx| + |dy| + |dz|.
    L1,
    /// The Euclidean distance; reported squared (see [`Neighbors::distances`]).
    #[default]
    L2,
    /// max(|dx|, |dy|, |dz|).
    Linf,
}

/// The search radius, in the unit of the points. Negative and non-finite radii find nothing; nor do, for
/// [`Metric::L2`], those whose square is beyond the range of float32, below 1.1e-19 (but for 0) and above 1.8e19.
#[derive(Clone, Copy, Debug)]
pub enum Radius<'a> {
    /// One radius for all queries.
    Uniform(f32),
    /// One radius per query; its length is that of the queries.
    PerQuery(&'a [f32]),
}

impl Radius<'_> {
    /// The radius of query `q`.
    pub fn of(&self, q: usize) -> f32 {
        match self {
            Radius::Uniform(radius) => *radius,
            Radius::PerQuery(radii) => radii[q],
        }
    }
}

/// What to search for and what to report.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// How distances are measured.
    pub metric: Metric,
    /// Skip points at distance zero, as the network does with the particle itself (paper, section 5.1).
    pub ignore_coincident: bool,
    /// Fill [`Neighbors::distances`].
    pub distances: bool,
}

/// The neighbours of every query as compact row-split lists.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Neighbors {
    /// Point indices, row after row.
    pub indices: Vec<u32>,
    /// Where each row starts in `indices`: queries + 1 entries, the first 0, the last `indices.len()`.
    pub row_splits: Vec<usize>,
    /// The distance of every entry of `indices`, squared for [`Metric::L2`]; empty if not asked for.
    pub distances: Vec<f32>,
}

impl Neighbors {
    /// The number of queries.
    pub fn queries(&self) -> usize {
        self.row_splits.len().saturating_sub(1)
    }

    /// The neighbours of query `q`.
    pub fn row(&self, q: usize) -> &[u32] {
        &self.indices[self.row_splits[q]..self.row_splits[q + 1]]
    }

    /// The number of neighbours of query `q`.
    pub fn count(&self, q: usize) -> usize {
        self.row_splits[q + 1] - self.row_splits[q]
    }

    fn clear(&mut self) {
        self.indices.clear();
        self.distances.clear();
        self.row_splits.clear();
        self.row_splits.push(0);
    }
}

/// The distance as the search compares it with the radius: squared for [`Metric::L2`].
#[inline]
fn distance(metric: Metric, a: Point, b: Point) -> f32 {
    let [dx, dy, dz] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    match metric {
        Metric::L1 => dx.abs() + dy.abs() + dz.abs(),
        Metric::L2 => dx * dx + dy * dy + dz * dz,
        Metric::Linf => dx.abs().max(dy.abs()).max(dz.abs()),
    }
}

/// The number that a [`distance`] may not exceed. Below every distance for a radius that finds nothing.
#[inline]
fn threshold(metric: Metric, radius: f32) -> f32 {
    if !(radius >= 0.0 && radius.is_finite()) {
        return -1.0;
    }
    match metric {
        Metric::L2 if radius == 0.0 || (radius * radius).is_normal() => radius * radius,
        Metric::L2 => -1.0,
        Metric::L1 | Metric::Linf => radius,
    }
}

/// Finds all neighbours by comparing every query with every point: the specification of [`Grid::search`].
pub fn brute_force(points: &[Point], queries: &[Point], radius: Radius<'_>, options: &Options) -> Neighbors {
    let mut neighbors = Neighbors::default();
    neighbors.clear();
    for (q, query) in queries.iter().enumerate() {
        let limit = threshold(options.metric, radius.of(q));
        for (i, point) in points.iter().enumerate() {
            let d = distance(options.metric, *point, *query);
            if d <= limit && !(options.ignore_coincident && d == 0.0) {
                neighbors.indices.push(i as u32);
                if options.distances {
                    neighbors.distances.push(d);
                }
            }
        }
        neighbors.row_splits.push(neighbors.indices.len());
    }
    neighbors
}

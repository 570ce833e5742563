//! Many disjoint clouds of points in one search: a grid for each.

use rayon::prelude::*;

use crate::{Grid, Neighbors, Options, Point, Radius};

/// Grids over clouds of points that do not see each other. The result of a search is that of one [`Grid`] a cloud, bit
/// for bit, with the clouds' points numbered one after the other.
///
/// Clouds are given by where the points of each start: clouds + 1 entries, the first 0 and the last the number of
/// points.
#[derive(Debug, Default)]
pub struct Grids {
    grids: Vec<Grid>,
    clouds: Vec<usize>,
    order: Vec<u32>,
    found: Neighbors,
}

impl Grids {
    /// No clouds.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sorts the points of each cloud into cells; see [`Grid::build`].
    ///
    /// # Panics
    /// As [`Grid::build`], and if the clouds do not ascend from 0 to the number of points.
    pub fn build(&mut self, points: &[Point], clouds: &[usize], cell_size: f32) {
        check_clouds(clouds, points.len());
        assert!(u32::try_from(points.len()).is_ok(), "{} points, at most {} fit", points.len(), u32::MAX);
        self.clouds.clear();
        self.clouds.extend_from_slice(clouds);
        self.grids.resize_with(clouds.len() - 1, Grid::new);
        self.grids.par_iter_mut().zip(clouds.par_windows(2)).for_each(|(grid, cloud)| {
            grid.build(&points[cloud[0]..cloud[1]], cell_size);
        });
        self.order.clear();
        for (grid, first) in self.grids.iter().zip(clouds) {
            self.order.extend(grid.order().iter().map(|i| i + *first as u32));
        }
    }

    /// Where the points of each cloud start.
    pub fn clouds(&self) -> &[usize] {
        &self.clouds
    }

    /// The indices of the points, cloud after cloud, each in cell order; see [`Grid::order`].
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Finds the points of each cloud within the radius of its queries; see [`Grid::search`].
    ///
    /// # Panics
    /// As [`Grid::search`], and if the queries have another number of clouds or theirs do not ascend to the number
    /// of queries.
    pub fn search(
        &mut self,
        queries: &[Point],
        query_clouds: &[usize],
        radius: Radius<'_>,
        options: &Options,
        neighbors: &mut Neighbors,
    ) {
        check_clouds(query_clouds, queries.len());
        let (clouds, of_queries) = (self.grids.len(), query_clouds.len() - 1);
        assert_eq!(of_queries, clouds, "clouds of the queries and of the points");
        if let Radius::PerQuery(radii) = radius {
            assert_eq!(radii.len(), queries.len(), "one radius per query");
        }
        neighbors.clear();
        for ((grid, first), cloud) in self.grids.iter_mut().zip(&self.clouds).zip(query_clouds.windows(2)) {
            let rows = cloud[0]..cloud[1];
            let radius = match radius {
                Radius::Uniform(radius) => Radius::Uniform(radius),
                Radius::PerQuery(radii) => Radius::PerQuery(&radii[rows.clone()]),
            };
            if clouds == 1 {
                grid.search(queries, radius, options, neighbors);
                return;
            }
            grid.search(&queries[rows], radius, options, &mut self.found);
            let before = neighbors.indices.len();
            neighbors.indices.extend(self.found.indices.iter().map(|i| i + *first as u32));
            neighbors.distances.extend_from_slice(&self.found.distances);
            neighbors.row_splits.extend(self.found.row_splits[1..].iter().map(|end| before + end));
        }
    }
}

/// Makes sure that clouds ascend from 0 to the number of points.
///
/// # Panics
/// If they do not.
pub fn check_clouds(clouds: &[usize], points: usize) {
    let ends = (clouds.first(), clouds.last());
    assert!(
        ends == (Some(&0), Some(&points)) && clouds.is_sorted(),
        "clouds must ascend from 0 to {points} points, but are {clouds:?}"
    );
}

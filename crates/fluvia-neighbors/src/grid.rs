//! A uniform grid over the points: the fast twin of [`brute_force`](crate::brute_force).
//!
//! The points are sorted by cell (z slowest, then y, then x), so that the points of neighbouring cells in
//! one row of x lie next to each other: a query scans one run of memory for each row of cells that its
//! radius touches. Where the cells start is a dense table if the points fill their bounding box well
//! enough, and a sorted list of the occupied cells otherwise, so that memory is bounded by the number of
//! points wherever they are. Teschner et al. (2003) hash the cells instead; a run in memory is what that
//! gives away.

#[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
mod avx512;

use rayon::prelude::*;

use crate::{Metric, Neighbors, Options, Point, Radius, distance, threshold};

/// The smallest positive float32: whatever is not below it is not zero.
#[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
const SMALLEST: f32 = f32::from_bits(1);

/// Queries that one task works on: enough to hide the cost of a task, few enough to balance threads.
const CHUNK: usize = 128;

/// Cells that the dense table may have per point; beyond that only occupied cells are listed.
const DENSE_CELLS_PER_POINT: usize = 8;

/// Coordinates of cells stay within ± this: farther points share the outermost cells, and the number of a cell
/// fits 63 bits.
const CELL_LIMIT: f64 = ((1 << 20) - 1) as f64;

/// By how much the range of cells is widened against rounding in the float32 distances.
const SLACK: f64 = 1e-5;

/// Points sorted into cells, and the memory that building and searching reuse from call to call.
#[derive(Debug, Default)]
pub struct Grid {
    cell: Cells,
    /// The points by coordinate, in cell order.
    sorted: [Vec<f32>; 3],
    /// The index of each sorted point among the caller's points.
    order: Vec<u32>,
    keys: Vec<u64>,
    starts: Starts,
    chunks: Vec<Chunk>,
}

/// Where the sorted points of a cell start.
#[derive(Debug)]
enum Starts {
    /// One entry for each cell of the bounding box, and one more.
    Dense(Vec<u32>),
    /// The keys of the occupied cells, ascending, and the start of each; one more start at the end.
    Sparse(Vec<u64>, Vec<u32>),
}

impl Default for Starts {
    fn default() -> Self {
        Starts::Sparse(Vec::new(), vec![0])
    }
}

/// The mapping from positions to cells. Cell coordinates count from the lowest occupied cell.
#[derive(Clone, Copy, Debug, Default)]
struct Cells {
    inverse_size: f64,
    low: [i64; 3],
    count: [i64; 3],
}

impl Cells {
    fn coordinate(&self, x: f64) -> i64 {
        // Shifted to where rounding towards zero rounds down; `floor` is a function call on older processors.
        ((x * self.inverse_size).clamp(-CELL_LIMIT, CELL_LIMIT) + CELL_LIMIT) as i64
    }

    fn key(&self, [x, y, z]: [i64; 3]) -> u64 {
        ((z * self.count[1] + y) * self.count[0] + x) as u64
    }

    /// The cells that points within `radius` of `center` can be in, clipped to the occupied ones: first and
    /// last along each axis; `None` if there are none.
    fn range(&self, center: Point, radius: f32) -> Option<[(i64, i64); 3]> {
        let mut range = [(0, 0); 3];
        for axis in 0..3 {
            let x = f64::from(center[axis]);
            // Rounding in float32 is relative to the coordinates as well as to the radius.
            let reach = f64::from(radius) * (1.0 + SLACK) + x.abs() * f64::from(f32::EPSILON);
            let first = (self.coordinate(x - reach) - self.low[axis]).max(0);
            let last = (self.coordinate(x + reach) - self.low[axis]).min(self.count[axis] - 1);
            if first > last {
                return None;
            }
            range[axis] = (first, last);
        }
        Some(range)
    }
}

/// What one task found.
#[derive(Debug, Default)]
struct Chunk {
    indices: Vec<u32>,
    distances: Vec<f32>,
    counts: Vec<u32>,
}

impl Grid {
    /// An empty grid.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sorts `points` into cells of the given edge length, usually the search radius. Any radius can be
    /// searched with any cell size; only speed depends on it. Points that are not finite are never found.
    ///
    /// # Panics
    /// If `cell_size` is not positive and finite, or if there are 2³² points or more.
    pub fn build(&mut self, points: &[Point], cell_size: f32) {
        assert!(
            cell_size > 0.0 && cell_size.is_finite(),
            "cell size {cell_size}, expected a positive length"
        );
        assert!(u32::try_from(points.len()).is_ok(), "{} points, at most {} fit", points.len(), u32::MAX);
        self.cell = Cells { inverse_size: 1.0 / f64::from(cell_size), low: [i64::MAX; 3], count: [0; 3] };
        let mut high = [i64::MIN; 3];
        for point in points {
            for axis in 0..3 {
                let cell = self.cell.coordinate(f64::from(point[axis]));
                self.cell.low[axis] = self.cell.low[axis].min(cell);
                high[axis] = high[axis].max(cell);
            }
        }
        if points.is_empty() {
            self.cell.low = [0; 3];
        } else {
            self.cell.count = std::array::from_fn(|axis| high[axis] - self.cell.low[axis] + 1);
        }
        self.keys.clear();
        self.keys.extend(points.iter().map(|point| {
            let cell = std::array::from_fn(|a| self.cell.coordinate(f64::from(point[a])) - self.cell.low[a]);
            self.cell.key(cell)
        }));
        let cells = self.cell.count.iter().map(|&n| n as u128).product::<u128>();
        if cells <= (DENSE_CELLS_PER_POINT * points.len().max(64)) as u128 {
            self.sort_dense(cells as usize);
        } else {
            self.sort_sparse();
        }
        for (axis, sorted) in self.sorted.iter_mut().enumerate() {
            sorted.clear();
            sorted.extend(self.order.iter().map(|&i| points[i as usize][axis]));
        }
    }

    /// The indices of the points in cell order. Points that follow each other here are near each other in
    /// space: data kept in this order is read with few cache misses.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// Counting sort over all cells of the bounding box.
    fn sort_dense(&mut self, cells: usize) {
        let mut starts = match std::mem::take(&mut self.starts) {
            Starts::Dense(starts) => starts,
            Starts::Sparse(_, starts) => starts,
        };
        starts.clear();
        starts.resize(cells + 1, 0);
        for &key in &self.keys {
            starts[key as usize] += 1;
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        self.order.clear();
        self.order.resize(self.keys.len(), 0);
        for (i, &key) in self.keys.iter().enumerate() {
            let slot = &mut starts[key as usize];
            self.order[*slot as usize] = i as u32;
            *slot += 1;
        }
        // Every entry has moved to the start of the next cell.
        starts.rotate_right(1);
        starts[0] = 0;
        self.starts = Starts::Dense(starts);
    }

    /// Comparison sort; lists the occupied cells only.
    fn sort_sparse(&mut self) {
        let keys = &self.keys;
        self.order.clear();
        self.order.extend(0..keys.len() as u32);
        self.order.par_sort_unstable_by_key(|&i| (keys[i as usize], i));
        let (mut occupied, mut starts) = (Vec::new(), Vec::new());
        for (slot, &i) in self.order.iter().enumerate() {
            let key = keys[i as usize];
            if occupied.last() != Some(&key) {
                occupied.push(key);
                starts.push(slot as u32);
            }
        }
        starts.push(self.order.len() as u32);
        self.starts = Starts::Sparse(occupied, starts);
    }

    /// Finds the points within the radius of every query; see [`Neighbors`]. Takes `self` mutably for its
    /// working memory only.
    ///
    /// # Panics
    /// If there is one radius per query and their numbers differ.
    pub fn search(
        &mut self,
        queries: &[Point],
        radius: Radius<'_>,
        options: &Options,
        neighbors: &mut Neighbors,
    ) {
        if let Radius::PerQuery(radii) = radius {
            assert_eq!(radii.len(), queries.len(), "one radius per query");
        }
        let scan = Scan::detect(options);
        let mut chunks = std::mem::take(&mut self.chunks);
        chunks.resize_with(queries.len().div_ceil(CHUNK), Chunk::default);
        chunks.par_iter_mut().enumerate().for_each(|(k, chunk)| {
            chunk.indices.clear();
            chunk.distances.clear();
            chunk.counts.clear();
            let first = k * CHUNK;
            for (q, query) in queries.iter().enumerate().skip(first).take(CHUNK) {
                let before = chunk.indices.len();
                self.search_one(*query, radius.of(q), options, scan, chunk);
                chunk.counts.push((chunk.indices.len() - before) as u32);
            }
        });
        self.chunks = chunks;
        self.gather(neighbors);
    }

    fn search_one(&self, query: Point, radius: f32, options: &Options, scan: Scan, chunk: &mut Chunk) {
        let limit = threshold(options.metric, radius);
        if limit < 0.0 {
            return;
        }
        let Some([xs, ys, zs]) = self.cell.range(query, radius) else {
            return;
        };
        let rows = (ys.1 - ys.0 + 1) * (zs.1 - zs.0 + 1);
        match &self.starts {
            Starts::Dense(starts) => {
                for z in zs.0..=zs.1 {
                    for y in ys.0..=ys.1 {
                        let start = starts[self.cell.key([xs.0, y, z]) as usize];
                        let end = starts[self.cell.key([xs.1, y, z]) as usize + 1];
                        self.scan(start as usize..end as usize, query, limit, options, scan, chunk);
                    }
                }
            }
            // More rows than occupied cells: looking at every point is cheaper.
            Starts::Sparse(occupied, _) if rows >= occupied.len() as i64 => {
                self.scan(0..self.order.len(), query, limit, options, scan, chunk);
            }
            Starts::Sparse(occupied, starts) => {
                for z in zs.0..=zs.1 {
                    for y in ys.0..=ys.1 {
                        let (low, high) = (self.cell.key([xs.0, y, z]), self.cell.key([xs.1, y, z]));
                        let first = occupied.partition_point(|&key| key < low);
                        let cells = occupied[first..].iter().take_while(|&&key| key <= high).count();
                        let (start, end) = (starts[first] as usize, starts[first + cells] as usize);
                        self.scan(start..end, query, limit, options, scan, chunk);
                    }
                }
            }
        }
    }

    /// Appends those of the sorted points `run` that are neighbours.
    fn scan(
        &self,
        run: std::ops::Range<usize>,
        query: Point,
        limit: f32,
        options: &Options,
        scan: Scan,
        chunk: &mut Chunk,
    ) {
        let [x, y, z] = &self.sorted;
        match scan {
            #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
            Scan::Avx512 => {
                let lowest = if options.ignore_coincident { SMALLEST } else { 0.0 };
                let points = avx512::Run {
                    x: &x[run.clone()],
                    y: &y[run.clone()],
                    z: &z[run.clone()],
                    order: &self.order[run],
                };
                // SAFETY: Scan::detect found AVX-512F.
                unsafe { avx512::scan(&points, query, lowest, limit, &mut chunk.indices) };
            }
            Scan::Any => {
                for i in run {
                    let d = distance(options.metric, [x[i], y[i], z[i]], query);
                    if d <= limit && !(options.ignore_coincident && d == 0.0) {
                        chunk.indices.push(self.order[i]);
                        if options.distances {
                            chunk.distances.push(d);
                        }
                    }
                }
            }
        }
    }

    /// Joins what the tasks found, in the order of the queries.
    fn gather(&self, neighbors: &mut Neighbors) {
        neighbors.clear();
        let mut end = 0;
        for count in self.chunks.iter().flat_map(|chunk| &chunk.counts) {
            end += *count as usize;
            neighbors.row_splits.push(end);
        }
        neighbors.indices.reserve(end);
        for chunk in &self.chunks {
            neighbors.indices.extend_from_slice(&chunk.indices);
            neighbors.distances.extend_from_slice(&chunk.distances);
        }
    }
}

/// How runs of points are compared with a query.
#[derive(Clone, Copy)]
enum Scan {
    #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
    Avx512,
    Any,
}

impl Scan {
    fn detect(options: &Options) -> Scan {
        #[cfg(all(target_arch = "x86_64", not(fluvia_portable)))]
        if options.metric == Metric::L2 && !options.distances && is_x86_feature_detected!("avx512f") {
            return Scan::Avx512;
        }
        let _ = (options, Metric::L2);
        Scan::Any
    }
}

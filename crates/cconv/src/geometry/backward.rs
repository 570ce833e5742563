//! The backward pass of the geometry: from derivatives by the weight of every pair in every cell to those by
//! importance, window values and positions.
//!
//! With h_c the derivative by the weight of the pair (x, x_i) in cell c, s_c(Λ(r)) the share of that cell,
//! r = (x_i − x) / R, a the window and m the importance, w_c = a m s_c / ψ:
//!
//! ```text
//! S      = Σ_c h_c s_c
//! dL/dm  = Σ_x a S / ψ
//! dL/da  = m S / ψ − [ψ = Σ a] · Σ_row(a m S) / ψ²
//! dL/dr  = (a m / ψ) · (∂Λ/∂r)ᵀ Σ_c h_c ∂s_c/∂Λ + dL/da · ∂a/∂r
//! dL/dx_i = Σ_x dL/dr / R,   dL/dx = −Σ_i dL/dr / R
//! ```
//!
//! The sums h over all layers on the same points are taken first ([`PairGradient`]), so that this is done once a
//! step.

use fluvia_neighbors::Point;
use rayon::prelude::*;

use super::{Geometry, LANES, Lists, Rows, TASK_BLOCKS, norm_square};
use crate::filter::grid_coordinate;
use crate::kernel::{InstructionSet, Operation};
use crate::{Options, PointSets, Window};

/// Rows of a reduction that one task works on.
const TASK_ROWS: usize = 256;

/// Derivatives by the weight of each pair in each of its cells, in blocks of lanes as the weights are.
#[derive(Clone, Debug, Default)]
pub struct PairGradient {
    pub(crate) blocks: Vec<[[f32; LANES]; 8]>,
}

impl PairGradient {
    /// Zeros, as many as the geometry has pairs. The memory is reused.
    pub fn reset(&mut self, geometry: &Geometry) {
        self.blocks.clear();
        self.blocks.resize(geometry.lists.blocks.len(), [[0.0; LANES]; 8]);
    }
}

/// Where [`Geometry::backward`] adds derivatives; only those that are asked for are computed.
#[derive(Debug, Default)]
pub struct PointGradients<'a> {
    /// By the importance of each input point, given or 1.
    pub importance: Option<&'a mut [f32]>,
    /// By the window value of each pair, given or computed.
    pub window_values: Option<&'a mut [f32]>,
    /// By the position of each input point: through the mapping, the interpolation and, unless its values
    /// are given, the window.
    pub input_positions: Option<&'a mut [Point]>,
    /// By the position of each output point.
    pub output_positions: Option<&'a mut [Point]>,
}

/// Derivatives of some lanes of pairs.
#[derive(Clone, Copy)]
struct PairBlock {
    by_importance: [f32; LANES],
    by_window: [f32; LANES],
    /// By r, along each axis.
    by_position: [[f32; LANES]; 3],
}

const EMPTY: PairBlock =
    PairBlock { by_importance: [0.0; LANES], by_window: [0.0; LANES], by_position: [[0.0; LANES]; 3] };

impl Geometry {
    /// Adds the derivatives by the points to `gradients`, from those by the weights of the pairs, which
    /// [`backward`](crate::backward) sums over layers. `sets` are those of the build.
    ///
    /// Where there is no derivative one is chosen. At the centre of a filter cell it is that towards the next cell, at
    /// the last centre of [`Interpolation::Linear`](crate::Interpolation) that towards the one before, beyond
    /// the outermost centres 0; on a seam of a mapping that of the piece which the mapping itself takes; 0 for
    /// coincident points (but of the identity), across the axis of the volume-preserving map, and at the kinks of the triangular window.
    ///
    /// # Panics
    /// If `sets` is not of the size of those of the build, if a length does not fit, or if
    /// derivatives by input points are asked for without [`Geometry::prepare_backward`].
    pub fn backward(&self, sets: &PointSets<'_>, pairs: &PairGradient, gradients: PointGradients<'_>) {
        let (lists, options) = (&self.lists, &self.options);
        sets.validate();
        assert_eq!(sets.neighbors.indices.len(), lists.neighbors.indices.len(), "pairs of the build");
        assert_eq!(
            (sets.inputs.len(), sets.outputs.len()),
            (lists.columns, lists.rows),
            "points of the build"
        );
        assert_eq!(pairs.blocks.len(), lists.blocks.len(), "a gradient of the pairs of this geometry");
        let given = if options.normalize { Some(self.windows.as_slice()) } else { sets.window_values };
        let mut blocks = vec![EMPTY; lists.blocks.len()];
        blocks.par_chunks_mut(TASK_BLOCKS).enumerate().for_each(|(k, blocks)| {
            let first = k * TASK_BLOCKS * LANES;
            lists.kernel.run(ThroughFilter { options, sets, pairs, given, first, blocks });
        });
        if options.normalize {
            self.through_normalization(&mut blocks);
        }
        if sets.window_values.is_none() && options.window != Window::None {
            blocks.par_chunks_mut(TASK_BLOCKS).enumerate().for_each(|(k, blocks)| {
                let first = k * TASK_BLOCKS * LANES;
                lists.kernel.run(ThroughWindow { window: options.window, sets, first, blocks });
            });
        }
        let PointGradients { importance, window_values, input_positions, output_positions } = gradients;
        if let Some(sums) = importance {
            let transposed = self.transposed();
            add_rows(&transposed.lists, sums, |_, k| {
                let pair = transposed.pairs[k] as usize;
                blocks[pair / LANES].by_importance[pair % LANES]
            });
        }
        if let Some(sums) = window_values {
            assert_eq!(sums.len(), lists.neighbors.indices.len(), "one window value per pair");
            for (block, sums) in blocks.iter().zip(sums.chunks_mut(LANES)) {
                sums.iter_mut().zip(block.by_window).for_each(|(sum, value)| *sum += value);
            }
        }
        let by_x = |row: usize, pair: usize| -> Point {
            let (block, extent) = (&blocks[pair / LANES], sets.extent.of(row));
            std::array::from_fn(|axis| block.by_position[axis][pair % LANES] / (0.5 * extent[axis]))
        };
        if let Some(sums) = input_positions {
            let transposed = self.transposed();
            add_rows(&transposed.lists, sums, |_, k| {
                by_x(transposed.lists.neighbors.indices[k] as usize, transposed.pairs[k] as usize)
            });
        }
        if let Some(sums) = output_positions {
            add_rows(lists, sums, |row, pair| by_x(row, pair).map(|x| -x));
        }
    }

    /// ψ is the sum of the window values of a row, so each of them counts in all the row's weights.
    fn through_normalization(&self, blocks: &mut [PairBlock]) {
        for (row, &psi) in self.lists.neighbors.row_splits.windows(2).zip(&self.psi) {
            let pairs = || (row[0]..row[1]).map(|pair| (pair / LANES, pair % LANES));
            // A row whose window values sum to zero is not divided.
            let Some(psi) = psi else { continue };
            let weighted =
                pairs().map(|(k, lane)| self.windows[LANES * k + lane] * blocks[k].by_window[lane]);
            let mean: f32 = weighted.sum();
            for (k, lane) in pairs() {
                let value = &mut blocks[k].by_window[lane];
                *value = (*value - mean) / psi;
            }
        }
    }
}

/// What is summed over pairs.
trait Sum: Copy + Send {
    fn add(&mut self, other: Self);
}

impl Sum for f32 {
    fn add(&mut self, other: f32) {
        *self += other;
    }
}

impl Sum for Point {
    fn add(&mut self, other: Point) {
        self.iter_mut().zip(other).for_each(|(sum, value)| *sum += value);
    }
}

/// Adds the values of the pairs of each row to `sums`, in order.
fn add_rows<T: Sum>(lists: &Lists, sums: &mut [T], value: impl Fn(usize, usize) -> T + Sync) {
    assert_eq!(sums.len(), lists.rows, "one derivative per point");
    sums.par_chunks_mut(TASK_ROWS).enumerate().for_each(|(task, sums)| {
        for (k, sum) in sums.iter_mut().enumerate() {
            let row = task * TASK_ROWS + k;
            let splits = &lists.neighbors.row_splits;
            (splits[row]..splits[row + 1]).for_each(|pair| sum.add(value(row, pair)));
        }
    });
}

/// Everything but the slope of the window, for the blocks that start with pair `first`.
struct ThroughFilter<'a> {
    options: &'a Options,
    sets: &'a PointSets<'a>,
    pairs: &'a PairGradient,
    given: Option<&'a [f32]>,
    first: usize,
    blocks: &'a mut [PairBlock],
}

impl Operation for ThroughFilter<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let ThroughFilter { options, sets, pairs, given, first, blocks } = self;
        let window = if given.is_some() { Window::None } else { options.window };
        let mut rows = Rows::new(sets, first);
        for (block, by_weight) in blocks.iter_mut().zip(&pairs.blocks[first / LANES..]) {
            let pair = rows.pair;
            let (position, indices) = rows.next();
            let (mut windows, mut importances) = ([1.0; LANES], [1.0; LANES]);
            if let Some(given) = given {
                windows[..indices.len()].copy_from_slice(&given[pair..pair + indices.len()]);
            }
            if let Some(importance) = sets.importance {
                importances.iter_mut().zip(indices).for_each(|(value, &i)| *value = importance[i as usize]);
            }
            for lane in (0..LANES).step_by(I::LANES) {
                let p = position.each_ref().map(|x| I::load(&x[lane..]));
                let a = I::mul(I::load(&windows[lane..]), window.values::<I>(norm_square::<I>(p)));
                let m = I::load(&importances[lane..]);
                let by_weight = by_weight.each_ref().map(|h| I::load(&h[lane..]));
                let (sum, slope) = interpolate::<I>(options, p, by_weight);
                I::store(I::mul(a, sum), &mut block.by_importance[lane..]);
                I::store(I::mul(m, sum), &mut block.by_window[lane..]);
                let scale = I::mul(a, m);
                let by_position = options.mapping.pull_back::<I>(p, slope.map(|x| I::mul(x, scale)));
                for (to, x) in block.by_position.iter_mut().zip(by_position) {
                    I::store(x, &mut to[lane..]);
                }
            }
        }
    }
}

/// S and its derivative by the position in the cube.
#[inline(always)]
fn interpolate<I: InstructionSet>(
    options: &Options,
    p: [I::Vector; 3],
    by_weight: [I::Vector; 8],
) -> (I::Vector, [I::Vector; 3]) {
    let [depth, height, width] = options.filter_size.map(|cells| cells as f32);
    let (align, offset) = (options.align_corners, options.offset);
    let p = options.mapping.apply::<I>(p);
    let along = |axis: usize, size: f32| {
        let x = grid_coordinate::<I>(p[axis], size, align, offset[axis]);
        let shares = options.interpolation.along::<I>(x, size).weights;
        let span = I::splat(if align { 0.5 * (size - 1.0) } else { 0.5 * size });
        (shares, options.interpolation.slopes::<I>(x, size).map(|slope| I::mul(slope, span)))
    };
    let ((x, x_slope), (y, y_slope), (z, z_slope)) = (along(0, width), along(1, height), along(2, depth));
    let zero = I::splat(0.0);
    let (mut sum, mut slope) = (zero, [zero; 3]);
    for k in 0..2 {
        for j in 0..2 {
            let (yz, slope_y, slope_z) =
                (I::mul(y[j], z[k]), I::mul(y_slope[j], z[k]), I::mul(y[j], z_slope[k]));
            for i in 0..2 {
                let h = by_weight[4 * k + 2 * j + i];
                let hx = I::mul(h, x[i]);
                sum = I::multiply_add(hx, yz, sum);
                slope[0] = I::multiply_add(I::mul(h, x_slope[i]), yz, slope[0]);
                slope[1] = I::multiply_add(hx, slope_y, slope[1]);
                slope[2] = I::multiply_add(hx, slope_z, slope[2]);
            }
        }
    }
    (sum, slope)
}

/// The slope of the window, for the blocks that start with pair `first`.
struct ThroughWindow<'a> {
    window: Window,
    sets: &'a PointSets<'a>,
    first: usize,
    blocks: &'a mut [PairBlock],
}

impl Operation for ThroughWindow<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let mut rows = Rows::new(self.sets, self.first);
        for block in self.blocks {
            let (position, _) = rows.next();
            for lane in (0..LANES).step_by(I::LANES) {
                let p = position.each_ref().map(|x| I::load(&x[lane..]));
                let slope = self.window.slope_over_distance::<I>(norm_square::<I>(p));
                let scale = I::mul(slope, I::load(&block.by_window[lane..]));
                for (to, x) in block.by_position.iter_mut().zip(p) {
                    let to = &mut to[lane..];
                    I::store(I::multiply_add(x, scale, I::load(to)), to);
                }
            }
        }
    }
}

//! What all layers on the same points share: for every pair of an output point and its neighbour, the filter
//! cells that it falls between and its weight in each.
//!
//! The weight of pair (x, x_i) in cell c is a(x_i, x) · m_i / ψ(x) times the share of c in the
//! interpolation at Λ(x_i − x); a layer is then a sum over pairs, cells and channels (Eq. 7).
//!
//! The pairs are stored in blocks of [`LANES`], cell by cell, so that vector instructions compute a block at
//! once.

mod backward;
mod points;

use fluvia_neighbors::{Neighbors, Transpose};
use rayon::prelude::*;

pub use backward::{PairGradient, PointGradients};
pub(crate) use points::boundaries;
pub use points::{Extent, PointSets};

use crate::filter::grid_coordinate;
use crate::kernel::{InstructionSet, Kernel, Operation};
use crate::{Interpolation, Mapping, Options, Window};

/// Pairs in a block: the float32 lanes of the widest vector.
pub(crate) const LANES: usize = 16;

/// Blocks that one task computes.
const TASK_BLOCKS: usize = 64;

/// The filter cells of [`LANES`] pairs and their weights.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    /// The lowest of the cells around the point, along each axis.
    pub cell: [u16; LANES],
    /// The weights of that cell and of those [`Geometry::steps`] away.
    pub weights: [[f32; LANES]; 8],
}

const EMPTY: Block = Block { cell: [0; LANES], weights: [[0.0; LANES]; 8] };

/// The pairs of a set of points, row after row, with their weights in the cells of the filter.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lists {
    /// The number of points that neighbours are indices of.
    pub columns: usize,
    /// The number of points that have neighbours.
    pub rows: usize,
    /// The columns of each row; without distances.
    pub neighbors: Neighbors,
    /// Where the rows of each cloud start.
    pub clouds: Vec<usize>,
    pub blocks: Vec<Block>,
    /// How many cells a pair can have a weight in: 1 or 8.
    pub corners: usize,
    /// From the lowest cell of a pair to each of its cells; x changes first, then y, then z.
    pub steps: [usize; 8],
    pub cells: usize,
    pub kernel: Kernel,
}

/// The same pairs by input point, for the backward pass.
#[derive(Clone, Debug, Default)]
pub(crate) struct Transposed {
    pub lists: Lists,
    /// The number of each pair in the lists that were transposed.
    pub pairs: Vec<u32>,
}

/// The geometry of all pairs of a set of points. Its memory is reused from build to build.
#[derive(Clone, Debug, Default)]
pub struct Geometry {
    /// Those of the build.
    options: Options,
    /// The input points of every output point.
    pub(crate) lists: Lists,
    /// The window values divided by ψ and the ψ of each row, if they are normalised.
    windows: Vec<f32>,
    psi: Vec<Option<f32>>,
    /// The output points of every input point, if they were prepared.
    transposed: Transposed,
    is_prepared: bool,
}

impl Geometry {
    /// Computes the cells and weights of all pairs.
    ///
    /// # Panics
    /// If lengths in `sets` do not fit each other, if a neighbour's index is out of range, if an extent is not
    /// a positive number or a position not finite, or if the filter has more than 65,536 cells or none.
    pub fn build(&mut self, options: &Options, sets: &PointSets<'_>, kernel: Kernel) {
        sets.validate();
        let cells = options.cells();
        assert!((1..=1 << 16).contains(&cells), "{cells} filter cells, expected 1 to 65,536");
        let pairs = sets.neighbors.indices.len();
        let [depth, height, width] = options.filter_size;
        let along = [(width, 1), (height, width), (depth, width * height)]
            .map(|(size, stride)| if size > 1 { stride } else { 0 });
        self.is_prepared = false;
        self.options = options.clone();
        self.windows.clear();
        if options.normalize {
            self.windows.resize(pairs, 0.0);
            self.windows.par_chunks_mut(TASK_BLOCKS * LANES).enumerate().for_each(|(k, windows)| {
                kernel.run(Windows { options, sets, first: k * TASK_BLOCKS * LANES, windows });
            });
            normalize(&mut self.windows, &sets.neighbors.row_splits, &mut self.psi);
        }
        let lists = &mut self.lists;
        lists.corners = options.interpolation.corners();
        lists.steps = std::array::from_fn(|corner| {
            (corner & 1) * along[0] + (corner >> 1 & 1) * along[1] + (corner >> 2) * along[2]
        });
        lists.cells = cells;
        lists.columns = sets.inputs.len();
        lists.rows = sets.outputs.len();
        lists.kernel = kernel;
        lists.neighbors.indices.clone_from(&sets.neighbors.indices);
        lists.neighbors.row_splits.clone_from(&sets.neighbors.row_splits);
        lists.clouds = boundaries(sets.output_clouds, sets.outputs.len());
        self.transposed.lists.clouds = boundaries(sets.input_clouds, sets.inputs.len());
        lists.blocks.resize(pairs.div_ceil(LANES), EMPTY);
        let given = if options.normalize { Some(self.windows.as_slice()) } else { sets.window_values };
        lists.blocks.par_chunks_mut(TASK_BLOCKS).enumerate().for_each(|(k, blocks)| {
            kernel.run(Blocks { options, sets, given, first: k * TASK_BLOCKS * LANES, blocks });
        });
    }

    /// Sorts the pairs by input point as well. The gradients of features, importance and input positions need that,
    /// and a filter's is often cheaper with it. Does nothing the second time.
    pub fn prepare_backward(&mut self) {
        if self.is_prepared {
            return;
        }
        let (from, to) = (&self.lists, &mut self.transposed);
        let mut transpose = Transpose {
            queries: std::mem::take(&mut to.lists.neighbors),
            pairs: std::mem::take(&mut to.pairs),
        };
        transpose.build(&from.neighbors, from.columns);
        Transpose { queries: to.lists.neighbors, pairs: to.pairs } = transpose;
        let Lists { neighbors: _, clouds: _, blocks, columns, rows, corners, steps, cells, kernel } =
            &mut to.lists;
        (*columns, *rows) = (from.rows, from.columns);
        (*corners, *steps, *cells, *kernel) = (from.corners, from.steps, from.cells, from.kernel);
        blocks.resize(from.blocks.len(), EMPTY);
        blocks.par_iter_mut().zip(to.pairs.par_chunks(LANES)).for_each(|(block, pairs)| {
            *block = EMPTY;
            for (lane, &pair) in pairs.iter().enumerate() {
                let (from, from_lane) = (&from.blocks[pair as usize / LANES], pair as usize % LANES);
                block.cell[lane] = from.cell[from_lane];
                for (to, from) in block.weights.iter_mut().zip(&from.weights) {
                    to[lane] = from[from_lane];
                }
            }
        });
        self.is_prepared = true;
    }

    /// Whether the pairs are sorted by input point.
    pub(crate) fn is_prepared(&self) -> bool {
        self.is_prepared
    }

    /// # Panics
    /// If they were not prepared.
    pub(crate) fn transposed(&self) -> &Transposed {
        assert!(self.is_prepared, "a backward pass needs Geometry::prepare_backward after the build");
        &self.transposed
    }
}

/// Divides the window values of each row by their sum, ψ of Eq. 9, if that is not zero.
fn normalize(windows: &mut [f32], row_splits: &[usize], psi: &mut Vec<Option<f32>>) {
    psi.clear();
    for row in row_splits.windows(2) {
        let row = &mut windows[row[0]..row[1]];
        let sum = Some(row.iter().sum()).filter(|&sum: &f32| sum != 0.0);
        if let Some(sum) = sum {
            row.iter_mut().for_each(|window| *window /= sum);
        }
        psi.push(sum);
    }
}

/// The rows of consecutive pairs.
struct Rows<'a> {
    sets: &'a PointSets<'a>,
    pair: usize,
    row: usize,
}

impl<'a> Rows<'a> {
    /// Starts with pair `first`.
    #[inline(always)]
    fn new(sets: &'a PointSets<'a>, first: usize) -> Self {
        // The last row that starts at or before the pair.
        let row = sets.neighbors.row_splits.partition_point(|&start| start <= first).saturating_sub(1);
        Rows { sets, pair: first, row }
    }

    /// The next pairs, as many as there are lanes: (x_i − x) / (extent / 2), the positions of the neighbours in
    /// the unit ball, and the neighbours' indices. Lanes beyond the last pair are left at the centre.
    #[inline(always)]
    fn next(&mut self) -> ([[f32; LANES]; 3], &'a [u32]) {
        let PointSets { inputs, outputs, neighbors, extent, .. } = self.sets;
        let end = neighbors.indices.len().min(self.pair + LANES);
        let indices = &neighbors.indices[self.pair..end];
        let mut position = [[0.0; LANES]; 3];
        for (lane, &index) in indices.iter().enumerate() {
            while neighbors.row_splits[self.row + 1] <= self.pair + lane {
                self.row += 1;
            }
            let (x_i, x, extent) = (inputs[index as usize], outputs[self.row], extent.of(self.row));
            for axis in 0..3 {
                position[axis][lane] = (x_i[axis] - x[axis]) / (0.5 * extent[axis]);
            }
        }
        self.pair = end;
        (position, indices)
    }
}

/// The window values of the pairs from `first` on.
struct Windows<'a> {
    options: &'a Options,
    sets: &'a PointSets<'a>,
    first: usize,
    windows: &'a mut [f32],
}

impl Operation for Windows<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        if let Some(values) = self.sets.window_values {
            let end = self.first + self.windows.len();
            self.windows.copy_from_slice(&values[self.first..end]);
            return;
        }
        let mut rows = Rows::new(self.sets, self.first);
        for windows in self.windows.chunks_mut(LANES) {
            let (position, _) = rows.next();
            let mut block = [0.0; LANES];
            for lane in (0..LANES).step_by(I::LANES) {
                let [x, y, z] = &position;
                let p = [I::load(&x[lane..]), I::load(&y[lane..]), I::load(&z[lane..])];
                I::store(self.options.window.values::<I>(norm_square::<I>(p)), &mut block[lane..]);
            }
            windows.copy_from_slice(&block[..windows.len()]);
        }
    }
}

/// The blocks that start with pair `first`.
struct Blocks<'a> {
    options: &'a Options,
    sets: &'a PointSets<'a>,
    /// A window value for each pair, if they do not follow from the options alone.
    given: Option<&'a [f32]>,
    first: usize,
    blocks: &'a mut [Block],
}

impl Operation for Blocks<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Blocks { options, sets, given, first, blocks } = self;
        let window = if given.is_some() { Window::None } else { options.window };
        let mut rows = Rows::new(sets, first);
        for block in blocks {
            let pair = rows.pair;
            let (position, indices) = rows.next();
            let mut scale = [1.0; LANES];
            if let Some(given) = given {
                scale[..indices.len()].copy_from_slice(&given[pair..pair + indices.len()]);
            }
            if let Some(importance) = sets.importance {
                scale.iter_mut().zip(indices).for_each(|(scale, &i)| *scale *= importance[i as usize]);
            }
            for lane in (0..LANES).step_by(I::LANES) {
                let [x, y, z] = &position;
                let p = [I::load(&x[lane..]), I::load(&y[lane..]), I::load(&z[lane..])];
                let scale = I::load(&scale[lane..]);
                // The paper's choices have a loop of their own, in which nothing is left to choose.
                if (options.mapping, options.interpolation, window)
                    == (Mapping::VolumePreserving, Interpolation::Linear, Window::Poly6)
                {
                    let choices = (Mapping::VolumePreserving, Interpolation::Linear, Window::Poly6);
                    fill::<I>(options, choices, p, scale, block, lane);
                } else {
                    let choices = (options.mapping, options.interpolation, window);
                    fill::<I>(options, choices, p, scale, block, lane);
                }
            }
        }
    }
}

/// Fills some lanes of a block for neighbours at `p` in the unit ball.
#[inline(always)]
fn fill<I: InstructionSet>(
    options: &Options,
    (mapping, interpolation, window): (Mapping, Interpolation, Window),
    p: [I::Vector; 3],
    scale: I::Vector,
    block: &mut Block,
    lane: usize,
) {
    let [depth, height, width] = options.filter_size.map(|cells| cells as f32);
    let (align, offset) = (options.align_corners, options.offset);
    let scale = I::mul(scale, window.values::<I>(norm_square::<I>(p)));
    let p = mapping.apply::<I>(p);
    let x = interpolation.along::<I>(grid_coordinate::<I>(p[0], width, align, offset[0]), width);
    let y = interpolation.along::<I>(grid_coordinate::<I>(p[1], height, align, offset[1]), height);
    let z = interpolation.along::<I>(grid_coordinate::<I>(p[2], depth, align, offset[2]), depth);
    let row = I::multiply_add(z.cell, I::splat(height), y.cell);
    let cell = I::multiply_add(row, I::splat(width), x.cell);
    I::store_u16(cell, &mut block.cell[lane..]);
    for k in 0..2 {
        let z_weight = I::mul(z.weights[k], scale);
        for j in 0..2 {
            let yz_weight = I::mul(y.weights[j], z_weight);
            for i in 0..2 {
                let weight = I::mul(x.weights[i], yz_weight);
                I::store(weight, &mut block.weights[4 * k + 2 * j + i][lane..]);
            }
        }
    }
}

/// q, the squared distance from the centre of the unit ball.
#[inline(always)]
fn norm_square<I: InstructionSet>([x, y, z]: [I::Vector; 3]) -> I::Vector {
    I::add(I::add(I::mul(x, x), I::mul(y, y)), I::mul(z, z))
}

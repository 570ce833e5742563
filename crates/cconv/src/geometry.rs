//! What all layers on the same points share: for every pair of an output point and its neighbour, the filter
//! cells that it falls between and its weight in each.
//!
//! The weight of pair (x, x_i) in cell c is a(x_i, x) · m_i / ψ(x) times the share of c in the
//! interpolation at Λ(x_i − x); a layer is then a sum over pairs, cells and channels (Eq. 7).
//!
//! The pairs are stored in blocks of [`LANES`], cell by cell, so that vector instructions compute a block at
//! once.

use fluvia_neighbors::{Neighbors, Point};
use rayon::prelude::*;

use crate::cpu::{InstructionSet, Kernel, Operation};
use crate::filter::{Along, grid_coordinate};
use crate::{Interpolation, Mapping, Options, Window};

/// Pairs in a block: the float32 lanes of the widest vector.
pub(crate) const LANES: usize = 16;

/// Blocks that one task computes.
const TASK_BLOCKS: usize = 64;

/// The diameter of the filter's support: 2 R, in the unit of the points.
#[derive(Clone, Copy, Debug)]
pub enum Extent<'a> {
    /// The same for all output points.
    Uniform(f32),
    /// The same for all output points, one along each axis.
    PerAxis([f32; 3]),
    /// One per output point.
    PerPoint(&'a [f32]),
    /// One per output point along each axis.
    PerPointAndAxis(&'a [[f32; 3]]),
}

impl Extent<'_> {
    #[inline(always)]
    pub(crate) fn of(&self, row: usize) -> [f32; 3] {
        match self {
            Extent::Uniform(extent) => [*extent; 3],
            Extent::PerAxis(extent) => *extent,
            Extent::PerPoint(extents) => [extents[row]; 3],
            Extent::PerPointAndAxis(extents) => extents[row],
        }
    }
}

/// The points of a convolution and which of them are neighbours.
#[derive(Clone, Copy, Debug)]
pub struct PointSets<'a> {
    /// Input points x_i.
    pub inputs: &'a [Point],
    /// Output points x.
    pub outputs: &'a [Point],
    /// The input points near each output point; their indices are those of `inputs`.
    pub neighbors: &'a Neighbors,
    /// The filter's diameter.
    pub extent: Extent<'a>,
    /// The importance m_i of each input point; 1 if absent.
    pub importance: Option<&'a [f32]>,
    /// A window value for each pair, in the order of the neighbours, in place of [`Options::window`].
    pub window_values: Option<&'a [f32]>,
}

impl<'a> PointSets<'a> {
    /// Points without importance, with the window of the options.
    pub fn new(
        inputs: &'a [Point],
        outputs: &'a [Point],
        neighbors: &'a Neighbors,
        extent: Extent<'a>,
    ) -> Self {
        PointSets { inputs, outputs, neighbors, extent, importance: None, window_values: None }
    }

    /// # Panics
    /// If a length or a neighbour's index does not fit the points.
    pub(crate) fn validate(&self) {
        let (inputs, outputs) = (self.inputs.len(), self.outputs.len());
        let splits = &self.neighbors.row_splits;
        assert_eq!(splits.len(), outputs + 1, "row splits for {outputs} output points");
        assert!(splits.windows(2).all(|w| w[0] <= w[1]) && splits[0] == 0, "row splits must ascend from 0");
        let pairs = self.neighbors.indices.len();
        assert_eq!(splits[outputs], pairs, "the last row split is the number of pairs");
        let largest = self.neighbors.indices.iter().max();
        assert!(
            largest.is_none_or(|&i| (i as usize) < inputs),
            "neighbour index {largest:?} of {inputs} input points"
        );
        match self.extent {
            Extent::PerPoint(extents) => assert_eq!(extents.len(), outputs, "one extent per output point"),
            Extent::PerPointAndAxis(extents) => {
                assert_eq!(extents.len(), outputs, "one extent per output point");
            }
            Extent::Uniform(_) | Extent::PerAxis(_) => {}
        }
        if let Some(importance) = self.importance {
            assert_eq!(importance.len(), inputs, "one importance per input point");
        }
        if let Some(values) = self.window_values {
            assert_eq!(values.len(), pairs, "one window value per pair");
        }
    }
}

/// The filter cells of [`LANES`] pairs and their weights, corner by corner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    pub weights: [[f32; LANES]; 8],
    pub cells: [[u16; LANES]; 8],
}

const EMPTY: Block = Block { weights: [[0.0; LANES]; 8], cells: [[0; LANES]; 8] };

/// The geometry of all pairs of a set of points. Its memory is reused from build to build.
#[derive(Clone, Debug, Default)]
pub struct Geometry {
    pub(crate) blocks: Vec<Block>,
    pub(crate) corners: usize,
    pub(crate) cells: usize,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    pub(crate) kernel: Kernel,
    pub(crate) indices: Vec<u32>,
    pub(crate) row_splits: Vec<usize>,
    windows: Vec<f32>,
}

impl Geometry {
    /// Computes the cells and weights of all pairs.
    ///
    /// # Panics
    /// If lengths in `sets` do not fit each other, if a neighbour's index is out of range, or if the filter
    /// has more than 65,536 cells or none.
    pub fn build(&mut self, options: &Options, sets: &PointSets<'_>, kernel: Kernel) {
        sets.validate();
        let cells = options.cells();
        assert!((1..=1 << 16).contains(&cells), "{cells} filter cells, expected 1 to 65,536");
        let pairs = sets.neighbors.indices.len();
        self.corners = options.interpolation.corners();
        self.cells = cells;
        self.inputs = sets.inputs.len();
        self.outputs = sets.outputs.len();
        self.kernel = kernel;
        self.indices.clone_from(&sets.neighbors.indices);
        self.row_splits.clone_from(&sets.neighbors.row_splits);
        self.normalized_windows(options, sets);
        self.blocks.resize(pairs.div_ceil(LANES), EMPTY);
        let windows = (!self.windows.is_empty()).then_some(self.windows.as_slice());
        self.blocks.par_chunks_mut(TASK_BLOCKS).enumerate().for_each(|(k, blocks)| {
            kernel.run(Task { options, sets, windows, first: k * TASK_BLOCKS * LANES, blocks });
        });
    }

    /// Fills `windows` with a(x_i, x) / ψ(x) if ψ is not 1, and empties it otherwise.
    fn normalized_windows(&mut self, options: &Options, sets: &PointSets<'_>) {
        self.windows.clear();
        if !options.normalize {
            return;
        }
        let neighbors = sets.neighbors;
        self.windows.resize(neighbors.indices.len(), 0.0);
        for row in 0..sets.outputs.len() {
            let pairs = neighbors.row_splits[row]..neighbors.row_splits[row + 1];
            for pair in pairs.clone() {
                self.windows[pair] = match sets.window_values {
                    Some(values) => values[pair],
                    None => {
                        let p = relative(sets, row, neighbors.indices[pair]);
                        options.window.value(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
                    }
                };
            }
            let sum: f32 = self.windows[pairs.clone()].iter().sum();
            if sum != 0.0 {
                self.windows[pairs].iter_mut().for_each(|window| *window /= sum);
            }
        }
    }
}

/// The computation of the blocks that start with pair `first`.
struct Task<'a> {
    options: &'a Options,
    sets: &'a PointSets<'a>,
    /// The normalised windows, if ψ is not 1.
    windows: Option<&'a [f32]>,
    first: usize,
    blocks: &'a mut [Block],
}

/// (x_i − x) / (extent / 2): the position of a neighbour in the unit ball.
#[inline(always)]
fn relative(sets: &PointSets<'_>, row: usize, index: u32) -> [f32; 3] {
    let (x_i, x, extent) = (sets.inputs[index as usize], sets.outputs[row], sets.extent.of(row));
    std::array::from_fn(|axis| (x_i[axis] - x[axis]) / (0.5 * extent[axis]))
}

impl Operation for Task<'_> {
    #[inline(always)]
    fn run<I: InstructionSet>(self) {
        let Task { options, sets, first, .. } = self;
        let neighbors = sets.neighbors;
        let windows = self.windows.or(sets.window_values);
        // The row of the first pair: the last one that starts at or before it.
        let mut row = neighbors.row_splits.partition_point(|&start| start <= first).saturating_sub(1);
        let mut pair = first;
        for block in self.blocks {
            let (mut position, mut scale) = ([[0.0; LANES]; 3], [0.0; LANES]);
            let live = LANES.min(neighbors.indices.len() - pair);
            for lane in 0..live {
                while neighbors.row_splits[row + 1] <= pair {
                    row += 1;
                }
                let index = neighbors.indices[pair];
                let p = relative(sets, row, index);
                for axis in 0..3 {
                    position[axis][lane] = p[axis];
                }
                scale[lane] = sets.importance.map_or(1.0, |importance| importance[index as usize])
                    * windows.map_or(1.0, |windows| windows[pair]);
                pair += 1;
            }
            if windows.is_none() {
                apply_window(options.window, &position, &mut scale);
            }
            // Loops of their own, so that the compiler can turn each into vectors.
            let (volume, linear) = (Mapping::VolumePreserving, Interpolation::Linear);
            match (options.mapping, options.interpolation) {
                (Mapping::VolumePreserving, Interpolation::Linear) => {
                    fill_block(options, volume, linear, &position, &scale, block);
                }
                (mapping, interpolation) => {
                    fill_block(options, mapping, interpolation, &position, &scale, block);
                }
            }
        }
    }
}

#[inline(always)]
fn apply_window(window: Window, [x, y, z]: &[[f32; LANES]; 3], scale: &mut [f32; LANES]) {
    for lane in 0..LANES {
        scale[lane] *= window.value(x[lane] * x[lane] + y[lane] * y[lane] + z[lane] * z[lane]);
    }
}

#[inline(always)]
fn fill_block(
    options: &Options,
    mapping: Mapping,
    interpolation: Interpolation,
    position: &[[f32; LANES]; 3],
    scale: &[f32; LANES],
    block: &mut Block,
) {
    let [depth, height, width] = options.filter_size;
    let (align, offset) = (options.align_corners, options.offset);
    let size = [width as f32, height as f32, depth as f32];
    let stride = [1, width as i32, (width * height) as i32];
    for lane in 0..LANES {
        let mapped = mapping.apply([position[0][lane], position[1][lane], position[2][lane]]);
        let along = |axis: usize| -> Along {
            let x = grid_coordinate(mapped[axis], size[axis], align, offset[axis]);
            interpolation.along(x, size[axis])
        };
        let [x, y, z] = [along(0), along(1), along(2)];
        for corner in 0..8 {
            let (i, j, k) = (corner & 1, corner >> 1 & 1, corner >> 2);
            block.weights[corner][lane] = x.weights[i] * y.weights[j] * (z.weights[k] * scale[lane]);
            let cell = x.cells[i] + y.cells[j] * stride[1] + z.cells[k] * stride[2];
            block.cells[corner][lane] = cell as u16;
        }
    }
}

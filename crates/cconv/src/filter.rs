//! The filter g: values on a regular grid of cells, looked up between them, and the layout in which the
//! kernels read it.

use std::sync::OnceLock;

use crate::Options;
use crate::aligned::AlignedVec;
use crate::kernel::{InstructionSet, PANEL, Slabs, bf16};

/// How the filter is looked up at a point between the centres of its cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// Trilinear; beyond the outermost centres the nearest values go on.
    #[default]
    Linear,
    /// Trilinear; beyond the outermost centres values fall to zero within one cell.
    LinearBorder,
    /// The value of the nearest cell.
    Nearest,
}

/// The cell before a coordinate along one axis, as a whole float, and the weights of that cell and of the
/// next one (of the same one, with weight 0, on an axis of one cell).
#[derive(Clone, Copy)]
pub(crate) struct Along<V> {
    pub cell: V,
    pub weights: [V; 2],
}

/// Where coordinates of the cube [−1, 1] fall among the centres of `size` cells, in cells from the first
/// centre.
#[inline(always)]
pub(crate) fn grid_coordinate<I: InstructionSet>(
    p: I::Vector,
    size: f32,
    align_corners: bool,
    offset: f32,
) -> I::Vector {
    let span = if align_corners { size - 1.0 } else { size };
    I::multiply_add(p, I::splat(0.5 * span), I::splat(0.5 * (size - 1.0) + offset))
}

impl Interpolation {
    /// The cells and weights for the grid coordinates `x` on an axis of `size` cells.
    #[inline(always)]
    pub(crate) fn along<I: InstructionSet>(self, x: I::Vector, size: f32) -> Along<I::Vector> {
        let (zero, one) = (I::splat(0.0), I::splat(1.0));
        let (last, last_pair) = (I::splat(size - 1.0), I::splat((size - 2.0).max(0.0)));
        match self {
            Interpolation::Nearest => {
                let x = I::add(I::min(I::max(x, zero), last), I::splat(0.5));
                Along { cell: I::min(I::truncate(x), last), weights: [one, zero] }
            }
            Interpolation::Linear => {
                // At the centre of the last cell, the pair before it with the whole weight on its second.
                let x = I::min(I::max(x, zero), last);
                let cell = I::min(I::truncate(x), last_pair);
                let fraction = I::sub(x, cell);
                Along { cell, weights: [I::sub(one, fraction), fraction] }
            }
            Interpolation::LinearBorder => {
                // The share of a cell falls with the distance of its centre; outside there is none.
                let cell = I::min(I::max(I::truncate(x), zero), last_pair);
                let share = |cell| I::max(I::sub(one, I::abs(I::sub(x, cell))), zero);
                let next = I::add(cell, one);
                let inside = I::less_equal(next, last);
                Along { cell, weights: [share(cell), I::select(inside, share(next), zero)] }
            }
        }
    }

    /// The derivatives of the two weights of [`Interpolation::along`] by the coordinate. Between two cells they
    /// are −1 and 1; at the centre of a cell those of the cells after it count, and at the last centre of
    /// [`Interpolation::Linear`] those before it. Beyond the border of that kind they are 0.
    #[inline(always)]
    pub(crate) fn slopes<I: InstructionSet>(self, x: I::Vector, size: f32) -> [I::Vector; 2] {
        let (zero, one, minus_one) = (I::splat(0.0), I::splat(1.0), I::splat(-1.0));
        let (last, last_pair) = (I::splat(size - 1.0), I::splat((size - 2.0).max(0.0)));
        match self {
            Interpolation::Nearest => [zero, zero],
            Interpolation::Linear => {
                let inside = I::select(I::less_equal(x, last), one, zero);
                let slope = I::select(I::less_equal(zero, x), inside, zero);
                [I::sub(zero, slope), slope]
            }
            Interpolation::LinearBorder => {
                let cell = I::min(I::max(I::truncate(x), zero), last_pair);
                let slope = |cell| {
                    let t = I::sub(x, cell);
                    let falling = I::select(I::less_equal(one, t), zero, minus_one);
                    let rising = I::select(I::less_equal(minus_one, t), one, zero);
                    I::select(I::less_equal(zero, t), falling, rising)
                };
                let next = I::add(cell, one);
                [slope(cell), I::select(I::less_equal(next, last), slope(next), zero)]
            }
        }
    }

    /// How many of a point's up to eight cells can have a weight.
    pub(crate) fn corners(self) -> usize {
        match self {
            Interpolation::Nearest => 1,
            Interpolation::Linear | Interpolation::LinearBorder => 8,
        }
    }
}

/// The weights of one layer: a filter, and optionally a bias and a pointwise term
/// (the paper's "4 × 4 × 4 + 1": one more cell that sees the features of the output point itself).
///
/// Holds the weights in the order in which the kernels read them.
#[derive(Clone, Debug)]
pub struct Filter {
    pub(crate) cells: usize,
    pub(crate) in_channels: usize,
    pub(crate) out_channels: usize,
    pub(crate) bias: Vec<f32>,
    pub(crate) slabs: Slabs,
    pub(crate) layout: Layout,
    pub(crate) precision: Precision,
    /// The packed matrix, see [`Layout`]. In bfloat16 two rows are packed together, a value of the one and one of the
    /// other in turn.
    pub(crate) packed: AlignedVec,
    /// The filter as given, [cells, in, out], then the pointwise weights if there are any.
    plain: Vec<f32>,
    adjoint: OnceLock<Box<Filter>>,
    packed_by_cell: OnceLock<AlignedVec>,
}

/// In which format the factors of the large matrix products are multiplied. Products are summed, and everything is
/// stored, in float32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// float32.
    #[default]
    F32,
    /// bfloat16, which has the range of float32 and 8 bits of precision: about twice as fast where the processor has
    /// instructions for it (AVX512-BF16), and slow elsewhere. The forward pass of layers with
    /// up to 8 outputs and more inputs than that, whose products are small, keeps float32.
    Bf16,
}

/// Which of the two factors of the operator comes first, and the order of the packed weights.
///
/// `Patches`: features are interpolated into a patch matrix [points, cells · in], which is multiplied by
/// the filter. Packed as [slab of input channels][panel of output channels][cell, channel][column].
///
/// `Products`: the features of every input point are multiplied by all cells, and the products
/// [points, cells · out] are interpolated. Cheaper if there are few output channels. Packed as
/// [panel of cells · out][in][column].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Layout {
    Patches,
    Products { group: usize },
}

impl Layout {
    /// The cheaper one.
    pub fn choose(inputs: usize, outputs: usize) -> Layout {
        let few = outputs <= FEW_CHANNELS && inputs > FEW_CHANNELS;
        if few { Layout::Products { group: outputs.next_multiple_of(4) } } else { Layout::Patches }
    }
}

/// Up to this many output channels, `Products` pays if there are more input channels than that.
const FEW_CHANNELS: usize = 8;

impl Filter {
    /// A filter of shape [depth, height, width, `in_channels`, `out_channels`].
    ///
    /// # Panics
    /// If the number of weights is another, or a dimension is zero.
    pub fn new(options: &Options, in_channels: usize, out_channels: usize, weights: &[f32]) -> Filter {
        let cells = options.cells();
        assert_eq!(
            weights.len(),
            cells * in_channels * out_channels,
            "weights of {cells} cells x {in_channels} x {out_channels}"
        );
        Self::build(cells, in_channels, out_channels, weights.to_vec(), Vec::new(), Precision::F32)
    }

    /// The same filter, multiplied in another format.
    pub fn with_precision(self, precision: Precision) -> Filter {
        Self::build(self.cells, self.in_channels, self.out_channels, self.plain, self.bias, precision)
    }

    /// Adds a bias, one value per output channel.
    ///
    /// # Panics
    /// If the number of values is another.
    pub fn with_bias(mut self, bias: &[f32]) -> Filter {
        assert_eq!(bias.len(), self.out_channels, "one bias per output channel");
        self.bias = bias.to_vec();
        self
    }

    /// Adds a pointwise term: weights [in, out] for the features of the output point itself. The input and
    /// output points must then be the same.
    ///
    /// # Panics
    /// If the number of weights is another.
    pub fn with_pointwise(self, weights: &[f32]) -> Filter {
        assert_eq!(weights.len(), self.in_channels * self.out_channels, "pointwise weights are [in, out]");
        let mut plain = self.plain;
        plain.truncate(self.cells * self.in_channels * self.out_channels);
        plain.extend_from_slice(weights);
        Self::build(self.cells, self.in_channels, self.out_channels, plain, self.bias, self.precision)
    }

    /// The number of input channels.
    pub fn in_channels(&self) -> usize {
        self.in_channels
    }

    /// The number of output channels.
    pub fn out_channels(&self) -> usize {
        self.out_channels
    }

    /// The filter's cells, and the pointwise term as one more.
    pub(crate) fn rows(&self) -> usize {
        self.plain.len() / (self.in_channels * self.out_channels)
    }

    /// The filter whose operator computes the gradient of the features: input and output channels exchanged,
    /// without a bias.
    pub(crate) fn adjoint(&self) -> &Filter {
        self.adjoint.get_or_init(|| {
            let (inputs, outputs) = (self.in_channels, self.out_channels);
            let exchanged = self.plain.chunks_exact(inputs * outputs).flat_map(|cell| {
                (0..outputs).flat_map(move |output| cell[output..].iter().step_by(outputs).copied())
            });
            let (cells, plain) = (self.cells, exchanged.collect());
            Box::new(Filter::build(cells, outputs, inputs, plain, Vec::new(), self.precision))
        })
    }

    /// The cells without the pointwise term as a matrix [out, cells · in], packed as [slab of input
    /// channels][panel of cells and channels][out][column].
    pub(crate) fn packed_by_cell(&self) -> &[f32] {
        self.packed_by_cell.get_or_init(|| {
            let mut packed = Vec::new();
            for slab in self.slabs.iter() {
                let columns = self.cells * slab.len();
                for (first, width) in panels(columns) {
                    for output in 0..self.out_channels {
                        packed.extend((first..first + width).map(|column| {
                            let (cell, channel) = (column / slab.len(), slab.start + column % slab.len());
                            let inside = column < columns && channel < self.in_channels;
                            let place = (cell * self.in_channels + channel) * self.out_channels + output;
                            if inside { self.plain[place] } else { 0.0 }
                        }));
                    }
                }
            }
            AlignedVec::from_slice(&packed)
        })
    }

    fn build(
        cells: usize,
        inputs: usize,
        outputs: usize,
        plain: Vec<f32>,
        bias: Vec<f32>,
        precision: Precision,
    ) -> Filter {
        assert!(cells > 0 && inputs > 0 && outputs > 0, "a filter needs cells and channels");
        let one = cells * inputs * outputs;
        assert!(
            plain.len() == one || plain.len() == one + inputs * outputs,
            "{} weights, expected {cells} cells x {inputs} x {outputs}",
            plain.len()
        );
        let rows = plain.len() / (inputs * outputs);
        let layout = Layout::choose(inputs, outputs);
        let slabs = Slabs::new(inputs);
        let packed = match layout {
            Layout::Patches => pack_patches(&plain, rows, inputs, outputs, &slabs),
            Layout::Products { group } => pack_products(&plain, rows, inputs, outputs, group),
        };
        let packed = match (precision, layout) {
            (Precision::Bf16, Layout::Patches) => pair_rows(&packed, rows, outputs, &slabs),
            _ => AlignedVec::from_slice(&packed),
        };
        Filter {
            cells,
            precision,
            in_channels: inputs,
            out_channels: outputs,
            bias,
            slabs,
            layout,
            packed,
            plain,
            adjoint: OnceLock::new(),
            packed_by_cell: OnceLock::new(),
        }
    }
}

/// Splits `columns` into panels of at most [`PANEL`]: first column and width, a multiple of 16.
pub(crate) fn panels(columns: usize) -> impl Iterator<Item = (usize, usize)> {
    let padded = columns.next_multiple_of(16);
    (0..padded).step_by(PANEL).map(move |first| (first, PANEL.min(padded - first)))
}

fn pack_patches(plain: &[f32], rows: usize, inputs: usize, outputs: usize, slabs: &Slabs) -> Vec<f32> {
    let mut packed = Vec::with_capacity(rows * slabs.padded() * outputs.next_multiple_of(16));
    for slab in slabs.iter() {
        for (first, width) in panels(outputs) {
            for row in 0..rows {
                for channel in slab.clone() {
                    packed.extend((first..first + width).map(|column| {
                        let inside = channel < inputs && column < outputs;
                        if inside { plain[(row * inputs + channel) * outputs + column] } else { 0.0 }
                    }));
                }
            }
        }
    }
    packed
}

/// Rounds weights that were packed by [`pack_patches`], and puts the rows of each panel together two by two.
fn pair_rows(packed: &[f32], rows: usize, outputs: usize, slabs: &Slabs) -> AlignedVec {
    let mut paired = AlignedVec::default();
    paired.reserve_len(packed.len().div_ceil(2));
    let mut start = 0;
    for slab in slabs.iter() {
        for (_, width) in panels(outputs) {
            let panel = start..start + rows * slab.len() * width;
            start = panel.end;
            let to = &mut paired.halves_mut()[panel.clone()];
            for (to, from) in to.chunks_exact_mut(2 * width).zip(packed[panel].chunks_exact(2 * width)) {
                let (first, second) = from.split_at(width);
                bf16::interleave(first, second, to);
            }
        }
    }
    paired
}

fn pack_products(plain: &[f32], rows: usize, inputs: usize, outputs: usize, group: usize) -> Vec<f32> {
    let mut packed = Vec::with_capacity(inputs * (rows * group).next_multiple_of(16));
    for (first, width) in panels(rows * group) {
        for channel in 0..inputs {
            packed.extend((first..first + width).map(|column| {
                let (row, output) = (column / group, column % group);
                let inside = row < rows && output < outputs;
                if inside { plain[(row * inputs + channel) * outputs + output] } else { 0.0 }
            }));
        }
    }
    packed
}

//! The continuous convolution as a module of the tensor framework [burn](https://burn.dev), version 0.22: the
//! feature `burn`, which needs Rust 1.95.
//!
//! [`ContinuousConv`] is Eq. 7 as one operator with its own forward and backward pass, those of this crate, on the
//! memory of burn's CPU backend Flex. What burn tracks is differentiated: filter, bias, pointwise weights,
//! features, importance, window values, and input and output positions. Nothing else is computed. All are float32.
//!
//! | tensor | shape | unit |
//! | --- | --- | --- |
//! | positions | \[points, 3\]: x, y, z | that of the radius |
//! | features | \[input points, in\] | |
//! | output | \[output points, out\] | |
//! | filter | \[depth, height, width, in, out\] | |
//! | bias, pointwise | \[out\], \[in, out\] | |
//! | importance | \[input points\] | |
//! | window values | \[pairs\], in the order of the neighbours | |
//!
//! ```
//! use burn::tensor::{Device, Distribution, Tensor};
//! use cconv::burn::ContinuousConvConfig;
//!
//! let device = Device::flex().autodiff();
//! let positions = Tensor::<2>::random([100, 3], Distribution::Default, &device);
//! let features = Tensor::<2>::ones([100, 1], &device);
//!
//! let conv = ContinuousConvConfig::new(1, 8).init(&device); // 1 channel in, 8 out
//! let output = conv.forward(features, positions.clone(), positions, 0.3);
//! let gradients = output.sum().backward();
//!
//! let filter = conv.filter.val().grad(&gradients).expect("a parameter of the loss");
//! assert_eq!(filter.dims(), [4, 4, 4, 1, 8]);
//! ```

use std::sync::Arc;

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients as GradientContainer;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::FlexTensor;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, ExtensionType, Flex, TensorMetadata, backend_extension};
use burn::module::{Initializer, Module, Param};
use burn::tensor::{DType, Device, Tensor, TensorData};
use fluvia_neighbors::{Grid, Neighbors, Options as SearchOptions, Point, Radius};

use crate::{
    Extent, Filter, Geometry, Gradients, Kernel, Options, PairGradient, PointGradients, PointSets,
    PositionGradient, Precision, Workspace,
};

/// The published code draws its filters uniformly from ± this.
const FILTER_RANGE: f64 = 0.05;

/// What a [`ContinuousConv`] is made from: the paper's choices with some changed, for instance
/// `ContinuousConvConfig { pointwise: true, ..ContinuousConvConfig::new(1, 8) }`.
#[derive(Clone, Debug)]
pub struct ContinuousConvConfig {
    /// Channels of the features.
    pub in_channels: usize,
    /// Channels of the output.
    pub out_channels: usize,
    /// Filter size, mapping, interpolation, window: the options of the operator.
    pub options: Options,
    /// Whether to add a bias per output channel, zero at first.
    pub bias: bool,
    /// Whether to add a linear map of the features of the output point itself. The input and output points are then the
    /// same. Its weights are drawn after Glorot and Bengio, as the published code's dense layers.
    pub pointwise: bool,
    /// Whether [`ContinuousConv::forward`] leaves out neighbours at distance zero, such as the point itself.
    pub ignore_coincident: bool,
    /// Whether tracked positions get a gradient.
    pub position_gradient: PositionGradient,
    /// In which format the large matrix products are computed.
    pub precision: Precision,
    /// How the filter is drawn.
    pub initializer: Initializer,
}

impl ContinuousConvConfig {
    /// The paper's options, with a bias, without pointwise weights, with coincident points, with gradients by positions,
    /// in float32; the filter is uniform in ±0.05.
    pub fn new(in_channels: usize, out_channels: usize) -> Self {
        ContinuousConvConfig {
            in_channels,
            out_channels,
            options: Options::default(),
            bias: true,
            pointwise: false,
            ignore_coincident: false,
            position_gradient: PositionGradient::Full,
            precision: Precision::F32,
            initializer: Initializer::Uniform { min: -FILTER_RANGE, max: FILTER_RANGE },
        }
    }

    /// A layer with weights of its own on `device`, which are drawn when they are first used.
    pub fn init(&self, device: &Device) -> ContinuousConv {
        let [depth, height, width] = self.options.filter_size;
        let (inputs, outputs) = (self.in_channels, self.out_channels);
        let dense = Initializer::XavierUniform { gain: 1.0 };
        ContinuousConv {
            filter: self.initializer.init([depth, height, width, inputs, outputs], device),
            bias: self.bias.then(|| Initializer::Zeros.init([outputs], device)),
            pointwise: self
                .pointwise
                .then(|| dense.init_with([inputs, outputs], Some(inputs), Some(outputs), device)),
            options: self.options.clone(),
            ignore_coincident: self.ignore_coincident,
            position_gradient: self.position_gradient,
            precision: self.precision,
        }
    }
}

/// A continuous convolution with its weights; made by [`ContinuousConvConfig::init`].
#[derive(Module, Debug)]
pub struct ContinuousConv {
    /// The filter, \[depth, height, width, in, out\].
    pub filter: Param<Tensor<5>>,
    /// The bias, \[out\].
    pub bias: Option<Param<Tensor<1>>>,
    /// Weights for the features of the output point itself, \[in, out\].
    pub pointwise: Option<Param<Tensor<2>>>,
    #[module(skip)]
    options: Options,
    ignore_coincident: bool,
    #[module(skip)]
    position_gradient: PositionGradient,
    #[module(skip)]
    precision: Precision,
}

/// The neighbours that a convolution sums over, and what else it can be given for points. Layers on the same points can
/// share a clone.
#[derive(Clone, Debug)]
pub struct Neighborhood<'a> {
    /// The input points near each output point.
    pub neighbors: Arc<Neighbors>,
    /// The filter's diameter, in the unit of the positions.
    pub extent: Extent<'a>,
    /// A factor for each input point, \[input points\]; 1 if absent.
    pub importance: Option<Tensor<1>>,
    /// A window value for each pair, \[pairs\], in place of [`Options::window`].
    pub window_values: Option<Tensor<1>>,
}

impl<'a> Neighborhood<'a> {
    /// Given neighbours and diameter, without importance, with the window of the options.
    pub fn new(neighbors: Arc<Neighbors>, extent: Extent<'a>) -> Self {
        Neighborhood { neighbors, extent, importance: None, window_values: None }
    }

    /// All input points within `radius` of each output point, in the unit of the positions \[points, 3\]. Which points
    /// they are counts as a constant in a backward pass.
    ///
    /// # Panics
    /// If the radius is not a positive number, or if positions are not float32 and of that shape.
    pub fn search(inputs: &Tensor<2>, outputs: &Tensor<2>, radius: f32, ignore_coincident: bool) -> Self {
        let (inputs, outputs) = (points(inputs, "input positions"), points(outputs, "output positions"));
        let options = SearchOptions { ignore_coincident, ..SearchOptions::default() };
        let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
        grid.build(&inputs, radius);
        grid.search(&outputs, Radius::Uniform(radius), &options, &mut neighbors);
        Self::new(Arc::new(neighbors), Extent::Uniform(2.0 * radius))
    }
}

impl ContinuousConv {
    /// Convolves `features` \[input points, in\] at `input_positions` \[input points, 3\] over the neighbours within
    /// `radius`, in the unit of the positions, of each of the `output_positions` \[output points, 3\]: to
    /// \[output points, out\].
    ///
    /// # Panics
    /// If a shape is another, if a tensor is not float32 or not on the Flex device, if the radius is not a positive
    /// number, or if there are pointwise weights and other numbers of input and output points.
    pub fn forward(
        &self,
        features: Tensor<2>,
        input_positions: Tensor<2>,
        output_positions: Tensor<2>,
        radius: f32,
    ) -> Tensor<2> {
        let neighborhood =
            Neighborhood::search(&input_positions, &output_positions, radius, self.ignore_coincident);
        self.forward_with(features, input_positions, output_positions, neighborhood)
    }

    /// As [`ContinuousConv::forward`], over given neighbours.
    ///
    /// # Panics
    /// As [`ContinuousConv::forward`], and if lengths or indices of the neighbourhood do not fit the points.
    pub fn forward_with(
        &self,
        features: Tensor<2>,
        input_positions: Tensor<2>,
        output_positions: Tensor<2>,
        neighborhood: Neighborhood<'_>,
    ) -> Tensor<2> {
        let Neighborhood { neighbors, extent, importance, window_values } = neighborhood;
        let filter = self.filter.val();
        let [depth, height, width, in_channels, out_channels] = filter.dims();
        assert_eq!([depth, height, width], self.options.filter_size, "the size of the filter");
        let ([inputs, _], [outputs, _]) = (input_positions.dims(), output_positions.dims());
        assert_eq!(features.dims(), [inputs, in_channels], "features are [input points, in]");
        for positions in [&input_positions, &output_positions] {
            assert_eq!(positions.dims()[1], 3, "positions are [points, 3]");
        }
        if let Some(importance) = &importance {
            assert_eq!(importance.dims(), [inputs], "one importance per input point");
        }
        if let Some(values) = &window_values {
            assert_eq!(values.dims(), [neighbors.indices.len()], "one window value per pair");
        }
        let stop = |positions: Tensor<2>| match self.position_gradient {
            PositionGradient::Full => positions,
            PositionGradient::Stop => positions.detach(),
        };
        let extents = match extent {
            Extent::Uniform(extent) => vec![[extent; 3]; outputs],
            Extent::PerAxis(extent) => vec![extent; outputs],
            Extent::PerPoint(extents) => extents.iter().map(|&extent| [extent; 3]).collect(),
            Extent::PerPointAndAxis(extents) => extents.to_vec(),
        };
        let absent = Tensor::<1>::zeros([0], &features.device().without_autodiff());
        let or_absent = |tensor: Option<Tensor<1>>| tensor.unwrap_or_else(|| absent.clone()).into_dispatch();
        let operands = Operands::<Dispatch> {
            filter: filter.into_dispatch(),
            bias: or_absent(self.bias.as_ref().map(Param::val)),
            pointwise: or_absent(self.pointwise.as_ref().map(|weights| weights.val().flatten(0, 1))),
            features: features.into_dispatch(),
            importance: or_absent(importance),
            window_values: or_absent(window_values),
            input_positions: stop(input_positions).into_dispatch(),
            output_positions: stop(output_positions).into_dispatch(),
        };
        let (options, channels) = (self.options.clone(), (in_channels, out_channels));
        let plan = Plan { options, channels, precision: self.precision, neighbors, extents };
        Tensor::from_dispatch(Dispatch::continuous_convolution(operands, plan))
    }
}

/// Positions \[points, 3\] as the search takes them.
fn points(positions: &Tensor<2>, name: &str) -> Vec<Point> {
    assert_eq!(positions.dims()[1], 3, "{name} are [points, 3]");
    assert_eq!(positions.dtype(), DType::F32, "the type of {name}");
    positions.to_data().iter::<f32>().collect::<Vec<_>>().as_chunks().0.to_vec()
}

/// What the operator can be differentiated by. One that is absent is empty.
#[derive(ExtensionType)]
struct Operands<B: Backend> {
    filter: FloatTensor<B>,
    bias: FloatTensor<B>,
    pointwise: FloatTensor<B>,
    features: FloatTensor<B>,
    importance: FloatTensor<B>,
    window_values: FloatTensor<B>,
    input_positions: FloatTensor<B>,
    output_positions: FloatTensor<B>,
}

/// The number of [`Operands`].
const OPERANDS: usize = 8;

impl<B: Backend> Operands<B> {
    /// In the order of the fields.
    fn into_array(self) -> [FloatTensor<B>; OPERANDS] {
        let Operands { filter, bias, pointwise, features, .. } = self;
        let Operands { importance, window_values, input_positions, output_positions, .. } = self;
        [filter, bias, pointwise, features, importance, window_values, input_positions, output_positions]
    }
}

/// What is constant in a backward pass.
#[derive(Clone, Debug)]
struct Plan {
    options: Options,
    channels: (usize, usize),
    precision: Precision,
    neighbors: Arc<Neighbors>,
    /// One per output point.
    extents: Vec<[f32; 3]>,
}

impl Plan {
    fn sets<'a>(&'a self, operands: &'a [FlexTensor; OPERANDS]) -> PointSets<'a> {
        let [_, _, _, _, importance, window_values, inputs, outputs] = operands.each_ref().map(values);
        let extent = Extent::PerPointAndAxis(&self.extents);
        PointSets {
            importance: given(importance),
            window_values: given(window_values),
            ..PointSets::new(inputs.as_chunks().0, outputs.as_chunks().0, &self.neighbors, extent)
        }
    }
}

/// The numbers of a contiguous float32 tensor.
fn values(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice().unwrap_or_else(|| panic!("a tensor of {:?}, expected float32", tensor.dtype()))
}

/// An operand that may be absent.
fn given(values: &[f32]) -> Option<&[f32]> {
    (!values.is_empty()).then_some(values)
}

/// The operator, in the form in which burn routes it to a backend.
#[backend_extension(Flex, Autodiff)]
trait Operator: Backend {
    fn continuous_convolution(#[extension_type] operands: Operands<Self>, plan: Plan) -> FloatTensor<Self>;
}

impl Operator for Flex {
    fn continuous_convolution(operands: Operands<Self>, plan: Plan) -> FloatTensor<Self> {
        Call::new(operands.into_array(), plan).forward()
    }
}

impl<C: CheckpointStrategy> Operator for Autodiff<Flex, C> {
    fn continuous_convolution(operands: Operands<Self>, plan: Plan) -> FloatTensor<Self> {
        let operands = operands.into_array();
        let nodes = operands.each_ref().map(|tensor| tensor.node());
        let call = Call::new(operands.map(|tensor| tensor.into_primitive()), plan);
        let output = call.forward();
        match OperatorBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(tracked) => tracked.finish(call, output),
            OpsKind::UnTracked(untracked) => untracked.finish(output),
        }
    }
}

#[derive(Debug)]
struct OperatorBackward;

impl Backward<Flex, OPERANDS> for OperatorBackward {
    type State = Call;

    fn backward(self, ops: Ops<Call, OPERANDS>, container: &mut GradientContainer, _: &mut Checkpointer) {
        let output_gradient = container.consume::<Flex>(&ops.node).to_contiguous();
        let shapes = ops.state.operands.each_ref().map(|tensor| tensor.shape());
        let tracked = ops.parents.each_ref().map(Option::is_some);
        let gradients = ops.state.backward(values(&output_gradient), tracked);
        for ((node, gradient), shape) in ops.parents.iter().zip(gradients).zip(shapes) {
            if let (Some(node), Some(gradient)) = (node, gradient) {
                let gradient = FlexTensor::from_data(TensorData::new(gradient, shape));
                container.register::<Flex>(node.id, gradient);
            }
        }
    }
}

/// One application of the operator: what a backward pass reads of it.
#[derive(Clone, Debug)]
struct Call {
    operands: [FlexTensor; OPERANDS],
    plan: Plan,
    filter: Filter,
    geometry: Geometry,
}

impl Call {
    fn new(operands: [FlexTensor; OPERANDS], plan: Plan) -> Self {
        let operands = operands.map(|tensor| tensor.to_contiguous());
        let [filter, bias, pointwise, ..] = &operands;
        let filter = Filter::new(&plan.options, plan.channels.0, plan.channels.1, values(filter));
        let mut filter = filter.with_precision(plan.precision);
        if let Some(bias) = given(values(bias)) {
            filter = filter.with_bias(bias);
        }
        if let Some(pointwise) = given(values(pointwise)) {
            filter = filter.with_pointwise(pointwise);
        }
        let mut geometry = Geometry::default();
        geometry.build(&plan.options, &plan.sets(&operands), Kernel::detect());
        Call { operands, plan, filter, geometry }
    }

    /// \[output points, out\].
    fn forward(&self) -> FlexTensor {
        let shape = [self.plan.sets(&self.operands).outputs.len(), self.filter.out_channels()];
        let mut output = vec![0.0; shape[0] * shape[1]];
        let [_, _, _, features, ..] = &self.operands;
        let Call { geometry, filter, .. } = self;
        crate::forward(geometry, filter, values(features), &mut output, &mut Workspace::default());
        FlexTensor::from_data(TensorData::new(output, shape))
    }

    /// The derivatives by those operands that are tracked, from those by the output, \[output points, out\].
    fn backward(self, output_gradient: &[f32], tracked: [bool; OPERANDS]) -> [Option<Vec<f32>>; OPERANDS] {
        let Call { operands, plan, filter, mut geometry } = self;
        let [_, _, _, by_features, points @ ..] = tracked;
        let [by_importance, _, by_inputs, _] = points;
        if by_features || by_importance || by_inputs {
            geometry.prepare_backward();
        }
        let by_points = points.contains(&true);
        let mut pairs = PairGradient::default();
        if by_points {
            pairs.reset(&geometry);
        }
        let mut gradients: [Option<Vec<f32>>; OPERANDS] =
            std::array::from_fn(|k| tracked[k].then(|| vec![0.0; values(&operands[k]).len()]));
        let wanted = gradients.each_mut().map(|gradient| gradient.as_deref_mut());
        let [weights, bias, pointwise, features, importance, window_values, inputs, outputs] = wanted;
        let pairs_wanted = by_points.then_some(&mut pairs);
        let wanted = Gradients { filter: weights, pointwise, bias, features, pairs: pairs_wanted };
        let workspace = &mut Workspace::default();
        crate::backward(&geometry, &filter, values(&operands[3]), output_gradient, wanted, workspace);
        if by_points {
            let wanted = PointGradients {
                importance,
                window_values,
                input_positions: inputs.map(|sums| sums.as_chunks_mut().0),
                output_positions: outputs.map(|sums| sums.as_chunks_mut().0),
            };
            geometry.backward(&plan.sets(&operands), &pairs, wanted);
        }
        gradients
    }
}

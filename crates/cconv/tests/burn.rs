//! burn's automatic differentiation through the module against the explicit backward pass.

mod common;

use std::sync::Arc;

use burn::module::Param;
use burn::tensor::activation::relu;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use cconv::burn::{ContinuousConv, ContinuousConvConfig, Neighborhood};
use cconv::{Geometry, Kernel, Options, PositionGradient, Precision, Workspace};
use common::{
    AllGradients, EXTENTS, ExtentKind, Numbers, Parts, Problem, all_gradients, all_options, largest,
};

/// A tensor that gradients are asked for where `device` has automatic differentiation.
fn leaf<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    let tensor = Tensor::from_data(TensorData::new(values.to_vec(), shape), device);
    if device.is_autodiff() { tensor.require_grad() } else { tensor }
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().iter::<f32>().collect()
}

/// A problem as a layer and tensors, each of them a [`leaf`].
struct Tensors {
    layer: ContinuousConv,
    features: Tensor<2>,
    inputs: Tensor<2>,
    outputs: Tensor<2>,
    importance: Option<Tensor<1>>,
    window_values: Option<Tensor<1>>,
}

fn config(problem: &Problem) -> ContinuousConvConfig {
    ContinuousConvConfig {
        options: problem.options.clone(),
        bias: problem.bias.is_some(),
        pointwise: problem.pointwise.is_some(),
        ..ContinuousConvConfig::new(problem.channels.0, problem.channels.1)
    }
}

impl Tensors {
    fn new(problem: &Problem, config: ContinuousConvConfig, device: &Device) -> Tensors {
        let mut layer = config.init(device);
        let shape = layer.filter.val().dims();
        let (ins, outs) = problem.channels;
        layer.filter = Param::from_tensor(leaf(&problem.filter, shape, device));
        layer.bias = problem.bias.as_ref().map(|bias| Param::from_tensor(leaf(bias, [outs], device)));
        layer.pointwise =
            problem.pointwise.as_ref().map(|weights| Param::from_tensor(leaf(weights, [ins, outs], device)));
        let positions = |points: &[[f32; 3]]| leaf(points.as_flattened(), [points.len(), 3], device);
        let vector = |values: &Vec<f32>| leaf(values, [values.len()], device);
        Tensors {
            layer,
            features: leaf(&problem.features, [problem.inputs.len(), ins], device),
            inputs: positions(&problem.inputs),
            outputs: positions(&problem.outputs),
            importance: problem.importance.as_ref().map(vector),
            window_values: problem.window_values.as_ref().map(vector),
        }
    }

    fn forward(&self, problem: &Problem) -> Tensor<2> {
        let neighborhood = Neighborhood {
            importance: self.importance.clone(),
            window_values: self.window_values.clone(),
            ..Neighborhood::new(Arc::new(problem.neighbors.clone()), problem.sets().extent)
        };
        let (features, inputs, outputs) = (self.features.clone(), self.inputs.clone(), self.outputs.clone());
        self.layer.forward_with(features, inputs, outputs, neighborhood)
    }
}

/// The gradients of L = Σ output · the problem's output gradient.
fn backward(output: Tensor<2>, problem: &Problem, device: &Device) -> Gradients {
    let shape = [problem.outputs.len(), problem.channels.1];
    let by_output = Tensor::<2>::from_data(TensorData::new(problem.output_gradient.clone(), shape), device);
    (output * by_output).sum().backward()
}

/// Output and gradients without burn.
fn explicit(problem: &Problem) -> (Vec<f32>, AllGradients) {
    let (mut geometry, mut workspace) = (Geometry::default(), Workspace::default());
    geometry.build(&problem.options, &problem.sets(), Kernel::detect());
    let filter = problem.filter();
    let mut output = vec![0.0; problem.outputs.len() * problem.channels.1];
    cconv::forward(&geometry, &filter, &problem.features, &mut output, &mut workspace);
    (output, all_gradients(problem, &filter, &mut geometry, &mut workspace))
}

/// The same numbers, bit for bit: both sides make the same calls.
#[track_caller]
fn same<const D: usize>(tensor: &Tensor<D>, gradients: &Gradients, expected: &[f32]) {
    let found = tensor.grad(gradients).expect("a gradient of a tracked tensor");
    assert_eq!(found.dims(), tensor.dims());
    assert_eq!(values(found), expected);
}

#[test]
fn gradients_are_those_of_the_explicit_backward() {
    let (mut numbers, device) = (Numbers(1), Device::flex().autodiff());
    for (k, options) in all_options().into_iter().enumerate() {
        let pointwise = k % 3 == 0;
        let inputs = numbers.points(30);
        let outputs = if pointwise { inputs.clone() } else { numbers.points(12) };
        let parts = Parts {
            extent: EXTENTS[k % 4],
            importance: k % 2 == 0,
            window_values: k % 5 == 0,
            bias: k % 7 < 4,
            pointwise,
        };
        // More inputs than outputs, and the other way round.
        let channels = if k % 4 < 2 { (3, 5) } else { (12, 2) };
        let problem = Problem::new(&mut numbers, options, inputs, outputs, channels, parts);
        let (expected_output, expected) = explicit(&problem);

        let plain = Tensors::new(&problem, config(&problem), &Device::flex());
        assert_eq!(values(plain.forward(&problem)), expected_output);

        let tensors = Tensors::new(&problem, config(&problem), &device);
        let output = tensors.forward(&problem);
        assert_eq!(values(output.clone()), expected_output);
        let gradients = backward(output, &problem, &device);
        same(&tensors.layer.filter.val(), &gradients, &expected.filter);
        if let Some(bias) = &tensors.layer.bias {
            same(&bias.val(), &gradients, &expected.bias);
        }
        if let Some(pointwise) = &tensors.layer.pointwise {
            same(&pointwise.val(), &gradients, &expected.pointwise);
        }
        same(&tensors.features, &gradients, &expected.features);
        if let Some(importance) = &tensors.importance {
            same(importance, &gradients, &expected.importance);
        }
        if let Some(values) = &tensors.window_values {
            same(values, &gradients, &expected.window_values);
        }
        same(&tensors.inputs, &gradients, expected.input_positions.as_flattened());
        same(&tensors.outputs, &gradients, expected.output_positions.as_flattened());
    }
}

const ALL: Parts =
    Parts { extent: ExtentKind::Uniform, importance: true, window_values: true, bias: true, pointwise: true };

fn problem_of_all_parts(seed: u64) -> Problem {
    let mut numbers = Numbers(seed);
    let points = numbers.points(25);
    Problem::new(&mut numbers, Options::default(), points.clone(), points, (6, 4), ALL)
}

#[test]
fn constants_have_no_gradient() {
    let (problem, device) = (problem_of_all_parts(2), Device::flex().autodiff());
    let (_, expected) = explicit(&problem);
    // One tracked tensor at a time, in the order of the names.
    let names =
        ["filter", "bias", "pointwise", "features", "importance", "window values", "inputs", "outputs"];
    for (tracked, name) in names.iter().enumerate() {
        let mut tensors = Tensors::new(&problem, config(&problem), &device);
        let Tensors { layer, features, inputs, outputs, importance, window_values } = &mut tensors;
        layer.filter = layer.filter.clone().set_require_grad(tracked == 0);
        layer.bias = layer.bias.take().map(|bias| bias.set_require_grad(tracked == 1));
        layer.pointwise = layer.pointwise.take().map(|weights| weights.set_require_grad(tracked == 2));
        *features = features.clone().set_require_grad(tracked == 3);
        *importance = importance.take().map(|values| values.set_require_grad(tracked == 4));
        *window_values = window_values.take().map(|values| values.set_require_grad(tracked == 5));
        *inputs = inputs.clone().set_require_grad(tracked == 6);
        *outputs = outputs.clone().set_require_grad(tracked == 7);
        let gradients = backward(tensors.forward(&problem), &problem, &device);
        let vector =
            |tensor: &Option<Tensor<1>>| tensor.as_ref().and_then(|x| x.grad(&gradients)).map(values);
        let found = [
            tensors.layer.filter.val().grad(&gradients).map(values),
            vector(&tensors.layer.bias.as_ref().map(Param::val)),
            tensors.layer.pointwise.as_ref().and_then(|x| x.val().grad(&gradients)).map(values),
            tensors.features.grad(&gradients).map(values),
            vector(&tensors.importance),
            vector(&tensors.window_values),
            tensors.inputs.grad(&gradients).map(values),
            tensors.outputs.grad(&gradients).map(values),
        ];
        let all = [
            &expected.filter,
            &expected.bias,
            &expected.pointwise,
            &expected.features,
            &expected.importance,
            &expected.window_values,
            &expected.input_positions.concat(),
            &expected.output_positions.concat(),
        ];
        for (k, found) in found.iter().enumerate() {
            assert_eq!(found.is_some(), k == tracked, "{} where {name} is tracked", names[k]);
        }
        let found = found[tracked].as_ref().expect("the tracked one");
        let scale = largest(all[tracked].iter().map(|&x| f64::from(x)));
        let error = largest(found.iter().zip(all[tracked]).map(|(a, b)| f64::from(a - b)));
        // Alone it can be summed in another order.
        assert!(found.len() == all[tracked].len() && error < 1e-5 * scale, "{name} off by {error:.1e}");
    }
}

#[test]
fn stopped_positions_have_no_gradient() {
    let (problem, device) = (problem_of_all_parts(3), Device::flex().autodiff());
    let config = ContinuousConvConfig { position_gradient: PositionGradient::Stop, ..config(&problem) };
    let tensors = Tensors::new(&problem, config, &device);
    let gradients = backward(tensors.forward(&problem), &problem, &device);
    assert!(tensors.inputs.grad(&gradients).is_none() && tensors.outputs.grad(&gradients).is_none());
    let (_, expected) = explicit(&problem);
    same(&tensors.features, &gradients, &expected.features);
    same(&tensors.layer.filter.val(), &gradients, &expected.filter);
}

/// Two layers with a ReLU between them on the same points, which are searched by the layers.
#[test]
fn two_layers_have_the_gradients_of_a_chain() {
    for precision in [Precision::F32, Precision::Bf16] {
        let (mut numbers, device) = (Numbers(4), Device::flex().autodiff());
        let points = numbers.points(40);
        let parts = Parts { importance: false, window_values: false, ..ALL };
        let mut problem = |channels| {
            let (inputs, outputs) = (points.clone(), points.clone());
            let mut problem =
                Problem::new(&mut numbers, Options::default(), inputs, outputs, channels, parts);
            problem.search(true);
            problem
        };
        let (mut first, mut second) = (problem((2, 16)), problem((16, 12)));
        let [one, two] = [&first, &second].map(|problem| {
            let config = ContinuousConvConfig { ignore_coincident: true, precision, ..config(problem) };
            Tensors::new(problem, config, &device)
        });
        let positions = || (one.inputs.clone(), one.inputs.clone());
        let ((inputs, outputs), radius) = (positions(), 0.7);
        let hidden = relu(one.layer.forward(one.features.clone(), inputs, outputs, radius));
        let (inputs, outputs) = positions();
        let output = two.layer.forward(hidden, inputs, outputs, radius);
        let gradients = backward(output.clone(), &second, &device);

        // The grid finds neighbours in an order of its own, in which sums are taken.
        let found = Neighborhood::search(&one.inputs, &one.inputs, radius, true);
        first.neighbors = (*found.neighbors).clone();
        second.neighbors = first.neighbors.clone();
        let (mut geometry, mut workspace) = (Geometry::default(), Workspace::default());
        geometry.build(&first.options, &first.sets(), Kernel::detect());
        let filters = [&first, &second].map(|problem| problem.filter().with_precision(precision));
        let mut before = vec![0.0; 40 * 16];
        cconv::forward(&geometry, &filters[0], &first.features, &mut before, &mut workspace);
        second.features = before.iter().map(|x| x.max(0.0)).collect();
        let mut expected = vec![0.0; 40 * 12];
        cconv::forward(&geometry, &filters[1], &second.features, &mut expected, &mut workspace);
        assert_eq!(values(output), expected);
        let of_second = all_gradients(&second, &filters[1], &mut geometry, &mut workspace);
        let through_relu = of_second.features.iter().zip(&before);
        first.output_gradient = through_relu.map(|(d, x)| if *x > 0.0 { *d } else { 0.0 }).collect();
        let of_first = all_gradients(&first, &filters[0], &mut geometry, &mut workspace);

        for (tensors, expected) in [(&one, &of_first), (&two, &of_second)] {
            let ContinuousConv { filter, bias, pointwise, .. } = &tensors.layer;
            same(&filter.val(), &gradients, &expected.filter);
            same(&bias.as_ref().expect("a bias").val(), &gradients, &expected.bias);
            same(&pointwise.as_ref().expect("pointwise weights").val(), &gradients, &expected.pointwise);
        }
        same(&one.features, &gradients, &of_first.features);
        // The positions count in both layers, as input and as output points; four numbers are added in another order.
        let by_positions = values(one.inputs.grad(&gradients).expect("a gradient of the positions"));
        let sums = [
            &of_first.input_positions,
            &of_first.output_positions,
            &of_second.input_positions,
            &of_second.output_positions,
        ];
        let scale = largest(sums.iter().flat_map(|sum| sum.as_flattened()).map(|&x| f64::from(x)));
        for (k, found) in by_positions.into_iter().enumerate() {
            let expected: f32 = sums.iter().map(|sum| sum.as_flattened()[k]).sum();
            assert!(f64::from((found - expected).abs()) < 1e-6 * scale, "{found} instead of {expected}");
        }
    }
}

#[test]
fn no_points_and_no_neighbours_are_no_special_case() {
    let device = Device::flex().autodiff();
    let layer = ContinuousConvConfig::new(2, 3).init(&device);
    for (inputs, outputs) in [(0, 0), (0, 4), (4, 0), (4, 4)] {
        let features = Tensor::<2>::ones([inputs, 2], &device).require_grad();
        let positions = Tensor::<2>::zeros([inputs, 3], &device).require_grad();
        let far = Tensor::<2>::ones([outputs, 3], &device);
        let output = layer.forward(features.clone(), positions.clone(), far, 0.5);
        assert_eq!(output.dims(), [outputs, 3]);
        let gradients = output.sum().backward();
        assert_eq!(values(features.grad(&gradients).expect("a gradient")), vec![0.0; inputs * 2]);
        assert_eq!(values(positions.grad(&gradients).expect("a gradient")), vec![0.0; inputs * 3]);
        let bias = layer.bias.as_ref().expect("a bias").val().grad(&gradients).expect("a gradient");
        assert_eq!(values(bias), [outputs as f32; 3]);
    }
}

/// A view of a wider tensor, as slices and transposes give it.
#[test]
fn tensors_need_not_be_contiguous() {
    let problem = problem_of_all_parts(5);
    let tensors = Tensors::new(&problem, config(&problem), &Device::flex());
    let expected = values(tensors.forward(&problem));
    let turned = |tensor: &Tensor<2>| {
        let [rows, columns] = tensor.dims();
        let data = TensorData::new(values(tensor.clone().transpose()), [columns, rows]);
        Tensor::<2>::from_data(data, &Device::flex()).transpose()
    };
    let wider = Tensor::cat(vec![tensors.outputs.clone(), tensors.outputs.clone()], 1);
    let outputs = wider.slice([0..problem.outputs.len(), 3..6]);
    let (features, inputs) = (turned(&tensors.features), turned(&tensors.inputs));
    let views = Tensors { features, inputs, outputs, ..tensors };
    assert_eq!(values(views.forward(&problem)), expected);
}

#[test]
#[should_panic(expected = "features are [input points, in]")]
fn features_of_other_points_are_refused() {
    let device = Device::flex();
    let layer = ContinuousConvConfig::new(2, 3).init(&device);
    let (features, positions) = (Tensor::ones([4, 2], &device), Tensor::ones([5, 3], &device));
    layer.forward(features, positions.clone(), positions, 0.5);
}

#[test]
#[should_panic(expected = "one extent per output point")]
fn too_few_extents_are_refused() {
    let device = Device::flex();
    let layer = ContinuousConvConfig::new(2, 3).init(&device);
    let (features, positions) = (Tensor::ones([5, 2], &device), Tensor::ones([5, 3], &device));
    let found = Neighborhood::search(&positions, &positions, 0.5, false);
    let neighborhood = Neighborhood { extent: cconv::Extent::PerPoint(&[1.0]), ..found };
    layer.forward_with(features, positions.clone(), positions, neighborhood);
}

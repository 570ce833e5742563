//! Trains a network of three continuous convolutions on points: it sees the values of a smooth field at the points of
//! a random cloud, and learns to tell the field's gradient there.
//!
//! ```text
//! cargo run --release -p cconv --features burn --example train_points
//! ```
//!
//! Every iteration draws a new cloud and a new field, f(x) = Σ_k a_k sin(w_k · x + p_k), so there is nothing to learn by
//! heart. The error is relative: 1 is that of answering zero.

use std::collections::HashMap;
use std::time::Instant;

use burn::module::{Module, ModuleMapper, Param, ParamId};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Distribution, Gradients, Tensor};
use cconv::burn::{ContinuousConv, ContinuousConvConfig, Neighborhood};
use cconv::{Options, PositionGradient};

/// Points of a cloud in the unit cube, and how far a layer sees: some 30 neighbours inside the cloud.
const POINTS: usize = 1000;
const RADIUS: f32 = 0.2;

const ITERATIONS: usize = 500;
const RATE: f64 = 3e-3;

#[derive(Module, Debug)]
struct Network {
    first: ContinuousConv,
    second: ContinuousConv,
    third: ContinuousConv,
}

impl Network {
    fn new(device: &Device) -> Self {
        let layer = |inputs, outputs| {
            let config = ContinuousConvConfig {
                // Divided by the sum of the windows a layer is a mean: how dense the points are does not matter.
                options: Options { normalize: true, ..Options::default() },
                pointwise: true,
                ignore_coincident: true,
                position_gradient: PositionGradient::Stop,
                ..ContinuousConvConfig::new(inputs, outputs)
            };
            config.init(device)
        };
        Network { first: layer(1, 16), second: layer(16, 16), third: layer(16, 3) }
    }

    /// From the field, [points, 1], at positions [points, 3] to its gradient, [points, 3].
    fn forward(&self, field: Tensor<2>, positions: Tensor<2>) -> Tensor<2> {
        // One search for all layers; a single layer searches by itself: `layer.forward(features, inputs, outputs, radius)`.
        let near = Neighborhood::search(&positions, &positions, RADIUS, true);
        let convolve = |layer: &ContinuousConv, features| {
            layer.forward_with(features, positions.clone(), positions.clone(), near.clone())
        };
        let hidden = relu(convolve(&self.first, field));
        let hidden = relu(convolve(&self.second, hidden));
        convolve(&self.third, hidden)
    }
}

/// The network's mean squared error on a new cloud and field, relative to the mean square of the gradient.
fn error(network: &Network, device: &Device) -> Tensor<1> {
    const WAVES: usize = 4;
    let uniform = |shape: [usize; 2], low: f64, high: f64| {
        Tensor::<2>::random(shape, Distribution::Uniform(low, high), device)
    };
    let positions = uniform([POINTS, 3], 0.0, 1.0);
    let (waves, amplitudes) = (uniform([3, WAVES], -4.0, 4.0), uniform([1, WAVES], -1.0, 1.0));
    let phases = positions.clone().matmul(waves.clone()) + uniform([1, WAVES], -3.0, 3.0);
    let field = (phases.clone().sin() * amplitudes.clone()).sum_dim(1);
    let gradient = (phases.cos() * amplitudes).matmul(waves.transpose());

    let difference = network.forward(field, positions) - gradient.clone();
    difference.square().mean() / gradient.square().mean()
}

/// Adam (Kingma and Ba, 2015). A program that depends on burn with its default features takes `AdamConfig` of
/// `burn::optim` in its place; this crate builds burn without them.
#[derive(Default)]
struct Adam {
    /// Steps done, and the moments of every parameter, flattened.
    steps: i32,
    moments: HashMap<ParamId, (Tensor<1>, Tensor<1>)>,
    gradients: Option<Gradients>,
}

impl Adam {
    fn step(&mut self, network: Network, loss: Tensor<1>) -> Network {
        self.steps += 1;
        self.gradients = Some(loss.backward());
        network.map(self)
    }
}

impl ModuleMapper for Adam {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        const DECAY: (f64, f64) = (0.9, 0.999);
        let Some(gradient) = self.gradients.as_mut().and_then(|all| param.val().grad_remove(all)) else {
            return param;
        };
        let shape = gradient.shape();
        let d: Tensor<1> = gradient.flatten(0, D - 1);
        let (mean, square) =
            self.moments.remove(&param.id).unwrap_or_else(|| (d.zeros_like(), d.zeros_like()));
        let mean = mean * DECAY.0 + d.clone() * (1.0 - DECAY.0);
        let square = square * DECAY.1 + d.square() * (1.0 - DECAY.1);
        let rate = RATE * (1.0 - DECAY.1.powi(self.steps)).sqrt() / (1.0 - DECAY.0.powi(self.steps));
        let step = mean.clone() / (square.clone().sqrt() + 1e-8) * rate;
        self.moments.insert(param.id, (mean, square));
        // A new leaf of the graph.
        param.map(|weights| (weights.inner() - step.reshape(shape)).autodiff().require_grad())
    }
}

fn main() {
    let device = Device::flex().autodiff();
    device.seed(0);
    let (start, mut network, mut adam) = (Instant::now(), Network::new(&device), Adam::default());
    for iteration in 0..ITERATIONS {
        let loss = error(&network, &device);
        if iteration % 50 == 0 {
            println!("iteration {iteration:3}: error {:.3}", loss.clone().into_scalar::<f32>());
        }
        network = adam.step(network, loss);
    }
    let seconds = start.elapsed().as_secs_f64();
    println!("after {ITERATIONS} iterations, {seconds:.1} s");
    // Without the graph, as one uses a trained network.
    let (network, device) = (network.valid(), device.without_autodiff());
    println!("a cloud that it never saw: error {:.3}", error(&network, &device).into_scalar::<f32>());
}

//! Trains a network of three continuous convolutions on points. The points fill a drop; the network learns to tell how
//! deep below the surface each of them is, from nothing but where the others are.
//!
//! ```text
//! cargo run --release -p cconv --features burn --example train_points
//! ```
//!
//! Every iteration draws a new drop of another size and density, so there is nothing to learn by heart.

use std::collections::HashMap;
use std::time::Instant;

use burn::module::{Initializer, Module, ModuleMapper, Param, ParamId};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Distribution, Gradients, Tensor};
use cconv::burn::{ContinuousConv, ContinuousConvConfig, Neighborhood};
use cconv::{Options, PositionGradient};

/// Points of a drop, and how far a layer sees: 25 to 84 neighbours inside.
const POINTS: usize = 1000;
const RADIUS: f32 = 0.35;

const ITERATIONS: usize = 1500;
const RATE: f64 = 6e-3;

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
                // A mean of neighbours wants larger weights than a sum of them.
                initializer: Initializer::Uniform { min: -0.5, max: 0.5 },
                ..ContinuousConvConfig::new(inputs, outputs)
            };
            config.init(device)
        };
        Network { first: layer(1, 16), second: layer(16, 16), third: layer(16, 1) }
    }

    /// From positions \[points, 3\] to depths \[points, 1\], in units of the radius.
    fn forward(&self, positions: Tensor<2>) -> Tensor<2> {
        // One search serves all layers. A layer alone searches by itself: `layer.forward(features, from, to, RADIUS)`.
        let near = Neighborhood::search(&positions, &positions, RADIUS, true);
        let convolve = |layer: &ContinuousConv, features| {
            layer.forward_with(features, positions.clone(), positions.clone(), near.clone())
        };
        let nothing_known = Tensor::ones([POINTS, 1], &positions.device());
        let hidden = relu(convolve(&self.first, nothing_known));
        let hidden = relu(convolve(&self.second, hidden));
        convolve(&self.third, hidden)
    }
}

/// The points of a drop, \[points, 3\], and their depths, \[points, 1\]: in units of the radius, and 1 for all that are
/// deeper than that.
fn drop_of_points(device: &Device) -> (Tensor<2>, Tensor<2>) {
    let uniform = |points| Tensor::<2>::random([points, 1], Distribution::Uniform(0.0, 1.0), device);
    let size = uniform(1) * 0.4 + 0.8;
    let directions = Tensor::<2>::random([POINTS, 3], Distribution::Normal(0.0, 1.0), device);
    let lengths = directions.clone().square().sum_dim(1).sqrt();
    let from_center = uniform(POINTS).powf_scalar(1.0 / 3.0) * size.clone();
    let depths = (size - from_center.clone()) / RADIUS;
    (directions / lengths * from_center, depths.clamp_max(1.0))
}

/// The network's mean squared error on a new drop.
fn loss(network: &Network, device: &Device) -> Tensor<1> {
    let (positions, depths) = drop_of_points(device);
    (network.forward(positions) - depths).square().mean()
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
        let loss = loss(&network, &device);
        if iteration % 100 == 0 {
            println!("iteration {iteration:4}: loss {:.4}", loss.clone().into_scalar::<f32>());
        }
        network = adam.step(network, loss);
    }
    println!("{ITERATIONS} iterations in {:.1} s", start.elapsed().as_secs_f64());
    // Without the graph, as one uses a trained network.
    let (network, device) = (network.valid(), device.without_autodiff());
    let last = loss(&network, &device).into_scalar::<f32>();
    println!("a drop that it never saw: loss {last:.4}, an error of {:.2} radii", last.sqrt());
}

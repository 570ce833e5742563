//! Numbers and networks that look random and are the same everywhere.

use fluvia_net::config::{Config, Integration};
use fluvia_net::weights::Weights;

/// Numbers in −1..1 that look random and are the same everywhere.
pub struct Numbers(pub u32);

impl Numbers {
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / (1 << 23) as f32 - 1.0
    }

    pub fn point(&mut self, scale: f32) -> [f32; 3] {
        std::array::from_fn(|_| scale * self.next())
    }
}

/// A small network with random weights.
pub fn weights(integration: Integration, extra_inputs: &[&str], numbers: &mut Numbers) -> Weights {
    let extra_inputs = extra_inputs.iter().map(|name| (*name).to_owned()).collect();
    let config = Config { integration, extra_inputs, filter_size: [3, 4, 2], ..Config::default() };
    let mut weights = Weights::zeros(config, 5, &[7, 7]);
    let Weights { obstacle, fluid, fluid_dense, layers, .. } = &mut weights;
    let convolutions =
        [obstacle, fluid].into_iter().chain(layers.iter_mut().map(|layer| &mut layer.convolution));
    for convolution in convolutions {
        convolution.kernel.iter_mut().chain(&mut convolution.bias).for_each(|w| *w = 0.3 * numbers.next());
    }
    for layer in layers.iter_mut() {
        layer.dense.weight.iter_mut().chain(&mut layer.dense.bias).for_each(|w| *w = 0.3 * numbers.next());
    }
    fluid_dense.weight.iter_mut().chain(&mut fluid_dense.bias).for_each(|w| *w = 0.3 * numbers.next());
    weights
}

//! Numbers and networks that look random and are the same everywhere.

use cconv::{Interpolation, Window};
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

/// A configuration with small filters.
pub fn config(integration: Integration, extra_inputs: &[&str]) -> Config {
    let extra_inputs = extra_inputs.iter().map(|name| (*name).to_owned()).collect();
    Config { integration, extra_inputs, filter_size: [3, 4, 2], ..Config::default() }
}

/// What the paper's ablations change, each beside something else.
#[allow(dead_code, reason = "not all tests need it")]
pub fn ablations() -> [Config; 3] {
    let paper = config(Integration::Paper, &["viscosity"]);
    [
        Config { interpolation: Interpolation::Nearest, ..config(Integration::Velocity, &["viscosity"]) },
        Config { window: Window::None, fully_connected: false, ..paper.clone() },
        Config { window: Window::Triangular, interpolation: Interpolation::LinearBorder, ..paper },
    ]
}

/// A small network with random weights.
pub fn weights(config: Config, numbers: &mut Numbers) -> Weights {
    let mut weights = Weights::zeros(config, 5, &[7, 7]);
    let Weights { obstacle, fluid, fluid_dense, layers, .. } = &mut weights;
    let convolutions =
        [obstacle, fluid].into_iter().chain(layers.iter_mut().map(|layer| &mut layer.convolution));
    for convolution in convolutions {
        convolution.kernel.iter_mut().chain(&mut convolution.bias).for_each(|w| *w = 0.3 * numbers.next());
    }
    let dense = layers.iter_mut().map(|layer| &mut layer.dense).chain([fluid_dense]);
    for part in dense.flatten() {
        part.weight.iter_mut().chain(&mut part.bias).for_each(|w| *w = 0.3 * numbers.next());
    }
    weights
}

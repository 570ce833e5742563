//! Random weights.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

use super::{Dense, Layer, Weights};
use crate::config::Config;

impl Weights {
    /// A network to begin training with, [`Weights::zeros`] but for the filters, uniform in ±0.05, and the dense weights,
    /// uniform in ±√(6 / (in + out)) (Glorot & Bengio 2010).
    pub fn random(config: Config, first: usize, hidden: &[usize], seed: u64) -> Weights {
        const FILTER_RANGE: f32 = 0.05;
        let mut weights = Weights::zeros(config, first, hidden);
        let mut random = Pcg64::seed_from_u64(seed);
        let mut fill = |values: &mut [f32], range: f32| {
            // 24 bits, as many as a float32 has.
            let unit = |bits: u64| (bits >> 40) as f32 / (1u32 << 24) as f32;
            values.iter_mut().for_each(|value| *value = range * (2.0 * unit(random.next_u64()) - 1.0));
        };
        let glorot = |dense: &Dense| (6.0 / (dense.inputs + dense.outputs) as f32).sqrt();
        fill(&mut weights.obstacle.kernel, FILTER_RANGE);
        fill(&mut weights.fluid.kernel, FILTER_RANGE);
        if let Some(dense) = &mut weights.fluid_dense {
            let range = glorot(dense);
            fill(&mut dense.weight, range);
        }
        for Layer { convolution, dense } in &mut weights.layers {
            fill(&mut convolution.kernel, FILTER_RANGE);
            if let Some(dense) = dense {
                let range = glorot(dense);
                fill(&mut dense.weight, range);
            }
        }
        weights
    }
}

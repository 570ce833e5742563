//! All tensors of a network in one order, with the names that they have in files.

use super::{Convolution, Dense, Layer, Weights};

/// A tensor of a network as it is in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor<'a> {
    /// The name in files: `conv1.kernel`.
    pub name: String,
    /// Extents, outermost first. Dense weights are `[in, out]`.
    pub shape: Vec<usize>,
    /// Row-major values.
    pub values: &'a [f32],
}

impl Weights {
    /// Every tensor, in the order of the network. Equal networks give equal names and shapes.
    pub fn tensors(&self) -> Vec<Tensor<'_>> {
        let mut tensors = Vec::with_capacity(6 + 4 * self.layers.len());
        let filter = self.config.filter_size;
        push_convolution(&mut tensors, "conv0_obstacle", &self.obstacle, filter);
        push_convolution(&mut tensors, "conv0_fluid", &self.fluid, filter);
        push_dense(&mut tensors, "dense0_fluid", self.fluid_dense.as_ref());
        for (number, layer) in (1..).zip(&self.layers) {
            push_convolution(&mut tensors, &format!("conv{number}"), &layer.convolution, filter);
            push_dense(&mut tensors, &format!("dense{number}"), layer.dense.as_ref());
        }
        tensors
    }

    /// The values of every tensor, in the order of [`Weights::tensors`].
    pub fn values_mut(&mut self) -> Vec<&mut [f32]> {
        let mut values: Vec<&mut [f32]> = vec![
            &mut self.obstacle.kernel,
            &mut self.obstacle.bias,
            &mut self.fluid.kernel,
            &mut self.fluid.bias,
        ];
        fn parts(dense: &mut Option<Dense>) -> impl Iterator<Item = &mut [f32]> {
            dense.iter_mut().flat_map(|dense| [dense.weight.as_mut_slice(), &mut dense.bias])
        }
        values.extend(parts(&mut self.fluid_dense));
        for Layer { convolution, dense } in &mut self.layers {
            values.push(&mut convolution.kernel);
            values.push(&mut convolution.bias);
            values.extend(parts(dense));
        }
        values
    }

    /// The number of numbers in all tensors.
    pub fn parameters(&self) -> usize {
        self.tensors().iter().map(|tensor| tensor.values.len()).sum()
    }
}

fn push_convolution<'a>(
    tensors: &mut Vec<Tensor<'a>>,
    name: &str,
    part: &'a Convolution,
    filter: [usize; 3],
) {
    let [depth, height, width] = filter;
    let shape = vec![depth, height, width, part.inputs, part.outputs];
    tensors.push(Tensor { name: format!("{name}.kernel"), shape, values: &part.kernel });
    tensors.push(Tensor { name: format!("{name}.bias"), shape: vec![part.outputs], values: &part.bias });
}

fn push_dense<'a>(tensors: &mut Vec<Tensor<'a>>, name: &str, part: Option<&'a Dense>) {
    let Some(part) = part else { return };
    let shape = vec![part.inputs, part.outputs];
    tensors.push(Tensor { name: format!("{name}.weight"), shape, values: &part.weight });
    tensors.push(Tensor { name: format!("{name}.bias"), shape: vec![part.outputs], values: &part.bias });
}

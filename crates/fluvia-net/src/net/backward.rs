//! The backward pass of the network, the adjoint of [`Network::forward`] line by line.
//!
//! With d(·) the derivative of a number L, and the layers as in Fig. 2:
//!
//! ```text
//! dh_{k−1} = relu'(h_{k−1}) · (C_kᵀ dh_k + D_kᵀ dh_k)   k = K … 1; plus dh_k where the widths are equal
//! df       = C_fluidᵀ d + D_fluidᵀ d                    with d the columns of dh_0 of either part
//! dx*      = through the geometry of all C              unless the positions count as constants
//! ```
//!
//! relu has slope 0 at 0.

use cconv::{DenseGradients, Gradients, PointGradients, backward, dense_backward};
use fluvia_neighbors::Point;
use rayon::prelude::*;

use super::{
    Fluid, Memory, Network, Pass, TASK_VALUES, WALL_CHANNELS, WALL_INPUTS, Walls, activate, add, is_residual,
};
use crate::weights::pad_inputs;

/// Places of the first layer's tensors in [`Weights::tensors`](crate::weights::Weights::tensors): kernels and weights; each
/// bias follows.
const OBSTACLE: usize = 0;
const FLUID: usize = 2;
const FLUID_DENSE: usize = 4;
/// A convolution has a kernel and a bias, a fully connected part weights and a bias.
const PART: usize = 2;

/// Where [`Network::backward`] adds derivatives; only those that are asked for are computed.
#[derive(Debug, Default)]
pub struct NetworkGradients<'a> {
    /// By the weights, in the order and the layout of [`Weights::tensors`](crate::weights::Weights::tensors).
    pub tensors: Option<&'a mut [Vec<f32>]>,
    /// By the features, [particles, inputs].
    pub features: Option<&'a mut [f32]>,
    /// By the positions x*. Without it they count as constants.
    pub positions: Option<&'a mut [Point]>,
}

impl Network {
    /// The backward pass of [`Network::forward`] on the same particles and walls: adds the derivatives of a number
    /// L to `gradients`, from those by the output, [particles, outputs].
    ///
    /// # Panics
    /// If the activations of the pass were not kept, or a length does not fit.
    pub fn backward(
        &self,
        fluid: Fluid<'_>,
        walls: &Walls,
        by_output: &[f32],
        gradients: NetworkGradients<'_>,
        pass: &mut Pass,
        memory: &mut Memory,
    ) {
        let NetworkGradients { mut tensors, features: by_features, positions } = gradients;
        let kept = pass.values.iter().filter(|h| !h.is_empty()).count();
        assert!(fluid.position.is_empty() || kept == self.layers.len() + 1, "the pass kept its activations");
        let Memory { activated, pairs, workspace, .. } = memory;
        pass.fluid_geometry.prepare_backward();
        let geometry = &pass.fluid_geometry;
        if positions.is_some() {
            pairs.reset(geometry);
        }
        let mut by_values = by_output.to_vec();
        for (k, layer) in self.layers.iter().enumerate().rev() {
            let before = &pass.values[k];
            activate(before, activated);
            let mut by_before = vec![0.0; before.len()];
            let mut wanted = Gradients {
                features: Some(&mut by_before),
                pairs: positions.is_some().then_some(&mut *pairs),
                ..Gradients::default()
            };
            let mut by_dense_bias = Gradients::default();
            let dense_part = if self.fluid_dense.is_some() { PART } else { 0 };
            let of_layer = PART + dense_part;
            let place = 2 * PART + dense_part + k * of_layer;
            let by_layer = tensors.as_deref_mut().map(|tensors| &mut tensors[place..place + of_layer]);
            if let Some([kernel, bias, dense @ ..]) = by_layer {
                wanted.filter = Some(kernel);
                wanted.bias = Some(bias);
                if let [weight, dense_bias] = dense {
                    wanted.pointwise = Some(weight);
                    // The two biases are added to the same sum.
                    by_dense_bias.bias = Some(dense_bias);
                }
            }
            backward(geometry, layer, activated, &by_values, wanted, workspace);
            backward(geometry, layer, activated, &by_values, by_dense_bias, workspace);
            deactivate(&mut by_before, before);
            if is_residual(layer) {
                add(&mut by_before, &by_values);
            }
            by_values = by_before;
        }
        self.first_layer_backward(
            fluid,
            walls,
            &by_values,
            NetworkGradients { tensors, features: by_features, positions },
            pass,
            memory,
        );
    }

    /// The part of [`Network::backward`] from h_0 on.
    fn first_layer_backward(
        &self,
        fluid: Fluid<'_>,
        walls: &Walls,
        by_values: &[f32],
        gradients: NetworkGradients<'_>,
        pass: &Pass,
        memory: &mut Memory,
    ) {
        let NetworkGradients { mut tensors, features: mut by_features, positions } = gradients;
        let Memory { pairs, workspace, .. } = memory;
        let [walls_width, fluid_width, dense_width] = self.first_widths();
        let stride = walls_width + fluid_width + dense_width;
        let columns = |first: usize, width: usize| -> Vec<f32> {
            by_values.chunks_exact(stride).flat_map(|row| &row[first..first + width]).copied().collect()
        };

        if let Some(layer) = &self.fluid_dense {
            let by_dense = columns(walls_width + fluid_width, dense_width);
            let mut wanted =
                DenseGradients { features: by_features.as_deref_mut(), ..DenseGradients::default() };
            if let Some([weight, bias]) = part(&mut tensors, FLUID_DENSE) {
                wanted.weights = Some(weight);
                wanted.bias = Some(bias);
            }
            let clouds = fluid.clouds;
            dense_backward(layer, fluid.features, &by_dense, clouds, wanted, workspace, self.kernel);
        }

        let by_fluid = columns(walls_width, fluid_width);
        let mut wanted = Gradients {
            features: by_features,
            pairs: positions.is_some().then_some(&mut *pairs),
            ..Gradients::default()
        };
        if let Some([kernel, bias]) = part(&mut tensors, FLUID) {
            wanted.filter = Some(kernel);
            wanted.bias = Some(bias);
        }
        backward(&pass.fluid_geometry, &self.fluid, fluid.features, &by_fluid, wanted, workspace);

        let (fluid_sets, wall_sets) = self.sets(fluid, walls, &pass.fluid_neighbors, &pass.wall_neighbors);
        let mut by_positions = positions;
        if let Some(by_positions) = &mut by_positions {
            let mut by_outputs = vec![[0.0; 3]; fluid.position.len()];
            let wanted = PointGradients {
                input_positions: Some(by_positions),
                output_positions: Some(&mut by_outputs),
                ..PointGradients::default()
            };
            pass.fluid_geometry.backward(&fluid_sets, pairs, wanted);
            add(by_positions.as_flattened_mut(), by_outputs.as_flattened());
            pairs.reset(&pass.wall_geometry);
        }

        let by_walls = columns(0, walls_width);
        let mut wanted =
            Gradients { pairs: by_positions.is_some().then_some(&mut *pairs), ..Gradients::default() };
        // With the channel that was added to the normals.
        let (mut by_kernel, mut padded) = (None, Vec::new());
        if let Some([kernel, bias]) = part(&mut tensors, OBSTACLE) {
            padded = pad_inputs(kernel, WALL_INPUTS, walls_width, WALL_CHANNELS);
            wanted.filter = Some(&mut padded);
            wanted.bias = Some(bias);
            by_kernel = Some(kernel);
        }
        backward(&pass.wall_geometry, &self.obstacle, &walls.features, &by_walls, wanted, workspace);
        if let Some(kernel) = by_kernel {
            let cells = padded.chunks_exact(WALL_CHANNELS * walls_width);
            for (to, from) in kernel.chunks_exact_mut(WALL_INPUTS * walls_width).zip(cells) {
                to.copy_from_slice(&from[..WALL_INPUTS * walls_width]);
            }
        }
        if let Some(by_positions) = by_positions {
            let wanted = PointGradients { output_positions: Some(by_positions), ..PointGradients::default() };
            pass.wall_geometry.backward(&wall_sets, pairs, wanted);
        }
    }
}

/// The gradients of a kernel or weights, and of the bias that follows.
fn part<'a>(tensors: &'a mut Option<&mut [Vec<f32>]>, place: usize) -> Option<&'a mut [Vec<f32>]> {
    tensors.as_deref_mut().map(|tensors| &mut tensors[place..place + PART])
}

/// Derivatives by h from those by relu(h).
fn deactivate(gradient: &mut [f32], values: &[f32]) {
    gradient.par_chunks_mut(TASK_VALUES).zip(values.par_chunks(TASK_VALUES)).for_each(
        |(gradient, values)| {
            gradient.iter_mut().zip(values).for_each(|(d, h)| *d = if *h > 0.0 { *d } else { 0.0 });
        },
    );
}

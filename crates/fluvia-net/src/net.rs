//! The network of Fig. 2: from intermediate states and walls to corrections.
//!
//! With f_i = [1, v*_i, extra_i] the features of particle i at x*_i, n_j the normal of wall particle j, C_k a
//! continuous convolution and D_k a fully connected layer, each with its bias:
//!
//! ```text
//! h_0 = [C_obstacle(n), C_fluid(f), D_fluid(f)]      concatenated: N × 96 in the published network
//! h_k = C_k(relu(h_{k−1})) + D_k(relu(h_{k−1}))      k = 1 … K; plus h_{k−1} where the widths are equal
//! o   = h_K                                          N × 3 (or 6)
//! ```
//!
//! C_k and D_k are one operator with 4 × 4 × 4 + 1 cells (section 5.1).

use cconv::{
    Columns, Dense, Extent, Filter, Geometry, Kernel, Options, PointSets, Workspace, dense, forward,
    forward_into,
};
use fluvia_neighbors::{Grid, Neighbors, Radius};
use rayon::prelude::*;

use crate::Result;
use crate::config::{Config, WALL_INPUTS};
use crate::weights::{Convolution, Weights};

/// Channels of a wall particle's features: its normal and a zero, so that four lanes hold them.
const WALL_CHANNELS: usize = 4;

/// Values that one task of an element-wise pass works on.
const TASK_VALUES: usize = 1 << 14;

/// The network with its weights in the order in which the kernels read them.
#[derive(Clone, Debug)]
pub struct Network {
    config: Config,
    options: Options,
    kernel: Kernel,
    obstacle: Filter,
    fluid: Filter,
    fluid_dense: Dense,
    layers: Vec<Filter>,
}

/// Wall particles, sorted and indexed for the search; made once, for walls do not move.
#[derive(Debug)]
pub struct Walls {
    position: Vec<[f32; 3]>,
    /// Normals, each followed by a zero.
    features: Vec<f32>,
    grid: Grid,
}

/// Working memory of a forward pass, and its result.
#[derive(Debug, Default)]
pub struct Pass {
    grid: Grid,
    /// Fluid neighbours of each particle, itself excluded.
    pub fluid_neighbors: Neighbors,
    /// Wall neighbours of each particle.
    pub wall_neighbors: Neighbors,
    fluid_geometry: Geometry,
    wall_geometry: Geometry,
    /// h_k before the activation, and after it.
    values: Vec<f32>,
    activated: Vec<f32>,
    next: Vec<f32>,
    workspace: Workspace,
}

impl Pass {
    /// The output o of the last forward pass: [particles, outputs].
    pub fn output(&self) -> &[f32] {
        &self.values
    }
}

impl Network {
    /// Prepares a network for the given kernel.
    ///
    /// # Errors
    /// `Parameter` if the layers do not fit each other.
    pub fn new(weights: &Weights, kernel: Kernel) -> Result<Network> {
        weights.check()?;
        let config = weights.config.clone();
        let options = Options { filter_size: config.filter_size, ..Options::default() };
        let filter = |part: &Convolution| {
            Filter::new(&options, part.inputs, part.outputs, &part.kernel).with_bias(&part.bias)
        };
        let layers = weights.layers.iter();
        Ok(Network {
            obstacle: Filter::new(
                &options,
                WALL_CHANNELS,
                weights.obstacle.outputs,
                &pad_inputs(&weights.obstacle.kernel, WALL_INPUTS, weights.obstacle.outputs, WALL_CHANNELS),
            )
            .with_bias(&weights.obstacle.bias),
            fluid: filter(&weights.fluid),
            fluid_dense: Dense::new(
                weights.fluid_dense.inputs,
                &weights.fluid_dense.weight,
                &weights.fluid_dense.bias,
            ),
            layers: layers
                .map(|layer| {
                    // The two biases are added to the same sum.
                    let pairs = layer.convolution.bias.iter().zip(&layer.dense.bias);
                    let bias: Vec<f32> = pairs.map(|(a, b)| a + b).collect();
                    filter(&layer.convolution).with_bias(&bias).with_pointwise(&layer.dense.weight)
                })
                .collect(),
            config,
            options,
            kernel,
        })
    }

    /// What the weights were made for.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The kernel that computes.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Prepares wall particles for this network.
    pub fn walls(&self, position: &[[f32; 3]], normal: &[[f32; 3]]) -> Walls {
        let mut grid = Grid::new();
        grid.build(position, self.config.filter_radius);
        // In the order of the cells, so that neighbours are near in memory.
        let order: Vec<usize> = grid.order().iter().map(|&i| i as usize).collect();
        let position: Vec<_> = order.iter().map(|&i| position[i]).collect();
        let features = order.iter().flat_map(|&i| [normal[i][0], normal[i][1], normal[i][2], 0.0]).collect();
        grid.build(&position, self.config.filter_radius);
        Walls { position, features, grid }
    }

    /// Finds the neighbours of particles at x*, among them and among the walls, without what is at distance zero: the
    /// particle itself, and whatever coincides with it.
    pub fn search(&self, position: &[[f32; 3]], walls: &mut Walls, pass: &mut Pass) {
        let radius = self.config.filter_radius;
        let options = fluvia_neighbors::Options { ignore_coincident: true, ..Default::default() };
        pass.grid.build(position, radius);
        pass.grid.search(position, Radius::Uniform(radius), &options, &mut pass.fluid_neighbors);
        walls.grid.search(position, Radius::Uniform(radius), &options, &mut pass.wall_neighbors);
    }

    /// Computes o for particles at x* with the features [1, v*, extra] ([particles, inputs]); read it from
    /// [`Pass::output`]. Fastest if particles that are near in space are near in memory.
    ///
    /// # Panics
    /// If the number of features is not that of the particles times the inputs.
    pub fn forward(&self, position: &[[f32; 3]], features: &[f32], walls: &mut Walls, pass: &mut Pass) {
        self.search(position, walls, pass);
        let Pass { fluid_neighbors, wall_neighbors, fluid_geometry, wall_geometry, workspace, .. } = pass;
        let extent = Extent::Uniform(2.0 * self.config.filter_radius);
        let fluid_sets = PointSets::new(position, position, fluid_neighbors, extent);
        fluid_geometry.build(&self.options, &fluid_sets, self.kernel);
        let wall_sets = PointSets::new(&walls.position, position, wall_neighbors, extent);
        wall_geometry.build(&self.options, &wall_sets, self.kernel);

        let widths =
            [self.obstacle.out_channels(), self.fluid.out_channels(), self.fluid_dense.out_channels()];
        let stride = widths.iter().sum();
        let values = &mut pass.values;
        values.resize(position.len() * stride, 0.0);
        let first = Columns { values, stride, first: 0 };
        forward_into(wall_geometry, &self.obstacle, &walls.features, first, workspace);
        let second = Columns { values, stride, first: widths[0] };
        forward_into(fluid_geometry, &self.fluid, features, second, workspace);
        let third = Columns { values, stride, first: widths[0] + widths[1] };
        dense(&self.fluid_dense, features, third, workspace, self.kernel);

        for layer in &self.layers {
            activate(&pass.values, &mut pass.activated);
            pass.next.resize(position.len() * layer.out_channels(), 0.0);
            forward(fluid_geometry, layer, &pass.activated, &mut pass.next, workspace);
            if layer.in_channels() == layer.out_channels() {
                add(&mut pass.next, &pass.values);
            }
            std::mem::swap(&mut pass.values, &mut pass.next);
        }
    }
}

/// Adds zero channels to the inputs of a filter [cells, in, out].
fn pad_inputs(kernel: &[f32], inputs: usize, outputs: usize, padded: usize) -> Vec<f32> {
    let zeros = vec![0.0; (padded - inputs) * outputs];
    kernel.chunks_exact(inputs * outputs).flat_map(|cell| cell.iter().chain(&zeros)).copied().collect()
}

/// to = relu(from).
fn activate(from: &[f32], to: &mut Vec<f32>) {
    to.resize(from.len(), 0.0);
    to.par_chunks_mut(TASK_VALUES).zip(from.par_chunks(TASK_VALUES)).for_each(|(to, from)| {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = from.max(0.0));
    });
}

/// to += from.
fn add(to: &mut [f32], from: &[f32]) {
    to.par_chunks_mut(TASK_VALUES).zip(from.par_chunks(TASK_VALUES)).for_each(|(to, from)| {
        to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
    });
}

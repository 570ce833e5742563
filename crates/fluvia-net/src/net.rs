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

mod backward;

use cconv::{
    Columns, Dense, Extent, Filter, Geometry, Kernel, Options, PairGradient, PointSets, Precision, Workspace,
    dense, forward, forward_into,
};
use fluvia_neighbors::{Grids, Neighbors, Point, Radius};
use rayon::prelude::*;

use crate::Result;
use crate::config::{Config, WALL_INPUTS};
use crate::weights::{Convolution, Layer, Weights, pad_inputs};

pub use backward::NetworkGradients;

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
    fluid_dense: Option<Dense>,
    layers: Vec<Filter>,
}

/// Wall particles of one cloud or of several, sorted and indexed for the search; made once, for walls do not move.
#[derive(Debug)]
pub struct Walls {
    position: Vec<Point>,
    /// Normals, each followed by a zero.
    features: Vec<f32>,
    grids: Grids,
}

/// What a forward pass leaves: its result, and what the backward pass needs of it.
#[derive(Debug, Default)]
pub struct Pass {
    /// Fluid neighbours of each particle.
    pub fluid_neighbors: Neighbors,
    /// Wall neighbours of each particle.
    pub wall_neighbors: Neighbors,
    fluid_geometry: Geometry,
    wall_geometry: Geometry,
    /// h_0 … h_K before the activation; those before h_K are empty if they were not kept.
    values: Vec<Vec<f32>>,
}

/// Working memory of the passes, which they can share.
#[derive(Debug, Default)]
pub struct Memory {
    /// For sorting the particles, and for searching among them when they are sorted.
    pub(crate) order: Grids,
    grids: Grids,
    activated: Vec<f32>,
    /// Values of layers that are no longer needed.
    spare: Vec<Vec<f32>>,
    pairs: PairGradient,
    workspace: Workspace,
}

/// Whether h_0 … h_(K−1) stay in memory for a backward pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activations {
    /// All of them: 900 bytes a particle in the published network.
    Keep,
    /// Only h_K, the output.
    Drop,
}

impl Pass {
    /// The output o of the last forward pass: [particles, outputs].
    pub fn output(&self) -> &[f32] {
        self.values.last().map_or(&[], Vec::as_slice)
    }
}

/// The particles of a pass: one cloud or several.
#[derive(Clone, Copy, Debug)]
pub struct Fluid<'a> {
    /// Positions x*. A pass is fastest if particles that are near in space are near in memory.
    pub position: &'a [Point],
    /// [1, v*, extra] of each particle, [particles, inputs].
    pub features: &'a [f32],
    /// Where the particles of each cloud start: clouds + 1 entries, the last the number of particles.
    pub clouds: &'a [usize],
}

impl Network {
    /// Prepares a network for the given kernel.
    ///
    /// # Errors
    /// `Parameter` if the layers do not fit each other.
    pub fn new(weights: &Weights, kernel: Kernel) -> Result<Network> {
        weights.check()?;
        let config = weights.config.clone();
        let options = config.options();
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
            fluid_dense: weights
                .fluid_dense
                .as_ref()
                .map(|part| Dense::new(part.inputs, &part.weight, &part.bias)),
            layers: layers
                .map(|Layer { convolution, dense }| {
                    let Some(dense) = dense else { return filter(convolution) };
                    // The two biases are added to the same sum.
                    let pairs = convolution.bias.iter().zip(&dense.bias);
                    let bias: Vec<f32> = pairs.map(|(a, b)| a + b).collect();
                    filter(convolution).with_bias(&bias).with_pointwise(&dense.weight)
                })
                .collect(),
            config,
            options,
            kernel,
        })
    }

    /// The same network with its large matrix products in another format.
    pub fn with_precision(self, precision: Precision) -> Network {
        Network {
            obstacle: self.obstacle.with_precision(precision),
            fluid: self.fluid.with_precision(precision),
            layers: self.layers.into_iter().map(|layer| layer.with_precision(precision)).collect(),
            ..self
        }
    }

    /// What the weights were made for.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The kernel that computes.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Prepares wall particles for this network. `clouds` says where those of each cloud start: clouds + 1
    /// entries, the last the number of wall particles.
    ///
    /// # Panics
    /// If there is not a normal for each position, or if the clouds do not ascend from 0 to their number.
    pub fn walls(&self, position: &[Point], normal: &[Point], clouds: &[usize]) -> Walls {
        assert_eq!(normal.len(), position.len(), "a normal for each wall particle");
        let mut grids = Grids::new();
        grids.build(position, clouds, self.config.filter_radius);
        // In the order of the cells, so that neighbours are near in memory.
        let order: Vec<usize> = grids.order().iter().map(|&i| i as usize).collect();
        let position: Vec<_> = order.iter().map(|&i| position[i]).collect();
        let features = order.iter().flat_map(|&i| [normal[i][0], normal[i][1], normal[i][2], 0.0]).collect();
        grids.build(&position, clouds, self.config.filter_radius);
        Walls { position, features, grids }
    }

    /// Finds the neighbours of particles at x*, among them and among the walls. In a fully connected network they are
    /// without what is at distance zero: the particle itself, and whatever coincides with it.
    ///
    /// # Panics
    /// If there are other numbers of clouds of particles and of walls.
    pub fn search(
        &self,
        position: &[Point],
        clouds: &[usize],
        walls: &mut Walls,
        pass: &mut Pass,
        memory: &mut Memory,
    ) {
        let radius = self.config.filter_radius;
        let options = self.config.search();
        let (grids, uniform) = (&mut memory.grids, Radius::Uniform(radius));
        grids.build(position, clouds, radius);
        grids.search(position, clouds, uniform, &options, &mut pass.fluid_neighbors);
        walls.grids.search(position, clouds, uniform, &options, &mut pass.wall_neighbors);
    }

    /// Computes o; read it from [`Pass::output`].
    ///
    /// # Panics
    /// If the number of features is not that of the particles times the inputs, or if there are other numbers of
    /// clouds of particles and of walls.
    pub fn forward(
        &self,
        fluid: Fluid<'_>,
        walls: &mut Walls,
        activations: Activations,
        pass: &mut Pass,
        memory: &mut Memory,
    ) {
        let Fluid { position, features, clouds } = fluid;
        self.search(position, clouds, walls, pass, memory);
        let (fluid_sets, wall_sets) = self.sets(fluid, walls, &pass.fluid_neighbors, &pass.wall_neighbors);
        pass.fluid_geometry.build(&self.options, &fluid_sets, self.kernel);
        pass.wall_geometry.build(&self.options, &wall_sets, self.kernel);

        let Pass { fluid_geometry, wall_geometry, values, .. } = pass;
        let Memory { activated, spare, workspace, .. } = memory;
        values.resize_with(self.layers.len() + 1, Vec::new);
        let [walls_width, fluid_width, dense_width] = self.first_widths();
        let stride = walls_width + fluid_width + dense_width;
        let first = &mut values[0];
        take_spare(first, spare);
        first.resize(position.len() * stride, 0.0);
        let columns = Columns { values: first, stride, first: 0 };
        forward_into(wall_geometry, &self.obstacle, &walls.features, columns, workspace);
        let columns = Columns { values: first, stride, first: walls_width };
        forward_into(fluid_geometry, &self.fluid, features, columns, workspace);
        if let Some(part) = &self.fluid_dense {
            let columns = Columns { values: first, stride, first: walls_width + fluid_width };
            dense(part, features, columns, workspace, self.kernel);
        }

        for (k, layer) in self.layers.iter().enumerate() {
            let (before, next) = values[k..].split_first_mut().expect("a value for each layer and one more");
            let next = &mut next[0];
            activate(before, activated);
            take_spare(next, spare);
            next.resize(position.len() * layer.out_channels(), 0.0);
            forward(fluid_geometry, layer, activated, next, workspace);
            if is_residual(layer) {
                add(next, before);
            }
            if activations == Activations::Drop {
                spare.push(std::mem::take(before));
            }
        }
    }

    /// Channels of the three parts of the first layer; 0 of one that is not there.
    fn first_widths(&self) -> [usize; 3] {
        let dense = self.fluid_dense.as_ref().map_or(0, Dense::out_channels);
        [self.obstacle.out_channels(), self.fluid.out_channels(), dense]
    }

    /// The points of the two geometries: among the fluid, and of walls and fluid.
    fn sets<'a>(
        &self,
        fluid: Fluid<'a>,
        walls: &'a Walls,
        fluid_neighbors: &'a Neighbors,
        wall_neighbors: &'a Neighbors,
    ) -> (PointSets<'a>, PointSets<'a>) {
        let Fluid { position, clouds, .. } = fluid;
        let extent = Extent::Uniform(2.0 * self.config.filter_radius);
        (
            PointSets::new(position, position, fluid_neighbors, extent).with_clouds(clouds, clouds),
            PointSets::new(&walls.position, position, wall_neighbors, extent)
                .with_clouds(walls.grids.clouds(), clouds),
        )
    }
}

/// Memory for values that have none.
fn take_spare(values: &mut Vec<f32>, spare: &mut Vec<Vec<f32>>) {
    if values.is_empty() {
        *values = spare.pop().unwrap_or_default();
    }
}

/// Whether the input of a layer is added to its output.
fn is_residual(layer: &Filter) -> bool {
    layer.in_channels() == layer.out_channels()
}

/// Keeps what is no number: it must show in the output.
fn relu(x: f32) -> f32 {
    if x < 0.0 { 0.0 } else { x }
}

/// to = relu(from).
fn activate(from: &[f32], to: &mut Vec<f32>) {
    to.resize(from.len(), 0.0);
    to.par_chunks_mut(TASK_VALUES).zip(from.par_chunks(TASK_VALUES)).for_each(|(to, from)| {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = relu(*from));
    });
}

/// to += from.
fn add(to: &mut [f32], from: &[f32]) {
    to.par_chunks_mut(TASK_VALUES).zip(from.par_chunks(TASK_VALUES)).for_each(|(to, from)| {
        to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
    });
}

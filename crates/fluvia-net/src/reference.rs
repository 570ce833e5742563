//! The network in float64: the specification of [`net`](crate::net), written from Fig. 2 and Eq. 10-14.

use cconv::reference::Weights as LayerWeights;
use cconv::{Extent, Options, PointSets};
use fluvia_neighbors::{Metric, Radius, brute_force};
use fluvia_sim::particles::{Acceleration, Boundary};

use crate::config::Integration;
use crate::weights::{Convolution, Dense, Weights};

/// Positions and velocities of all particles, metres and metres per second.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Positions.
    pub position: Vec<[f64; 3]>,
    /// Velocities.
    pub velocity: Vec<[f64; 3]>,
}

/// One step of the network. `extra` holds the extra input features, [particles, extra inputs].
///
/// The neighbours are those of the float32 search at the rounded x*, so that both computations sum over
/// the same pairs.
pub fn step(
    weights: &Weights,
    state: &State,
    extra: &[f64],
    boundary: &Boundary,
    acceleration: Acceleration<'_>,
) -> State {
    let config = &weights.config;
    let dt = f64::from(config.dt);
    let count = state.position.len();
    // Eq. 10 and 11.
    let (mut x_star, mut v_star) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for i in 0..count {
        let (x, v, a) = (state.position[i], state.velocity[i], acceleration.of(i));
        let v_new: [f64; 3] = std::array::from_fn(|k| v[k] + dt * f64::from(a[k]));
        x_star.push(std::array::from_fn::<f64, 3, _>(|k| x[k] + dt * (v[k] + v_new[k]) / 2.0));
        v_star.push(v_new);
    }
    let points: Vec<[f32; 3]> = x_star.iter().map(|x| x.map(|c| c as f32)).collect();
    let extras = config.extra_inputs.len();
    let features: Vec<f64> = (0..count)
        .flat_map(|i| {
            let own = &extra[i * extras..(i + 1) * extras];
            [1.0].into_iter().chain(v_star[i]).chain(own.iter().copied())
        })
        .collect();
    let normals: Vec<f64> = boundary.normal.iter().flatten().map(|&n| f64::from(n)).collect();
    let output = network(weights, &points, &features, &boundary.position, &normals);
    // Eq. 13 and 14.
    let scale = f64::from(config.output_scale);
    let mut next = State { position: Vec::with_capacity(count), velocity: Vec::with_capacity(count) };
    for (i, o) in output.chunks_exact(config.integration.outputs()).enumerate() {
        let x: [f64; 3] = std::array::from_fn(|k| x_star[i][k] + scale * o[k]);
        next.velocity.push(match config.integration {
            Integration::Paper => std::array::from_fn(|k| (x[k] - state.position[i][k]) / dt),
            Integration::Velocity => std::array::from_fn(|k| v_star[i][k] + 2.0 * scale / dt * o[3 + k]),
        });
        next.position.push(x);
    }
    next
}

/// The output o of the network, [particles, outputs].
fn network(
    weights: &Weights,
    points: &[[f32; 3]],
    features: &[f64],
    walls: &[[f32; 3]],
    normals: &[f64],
) -> Vec<f64> {
    let radius = weights.config.filter_radius;
    let options = Options { filter_size: weights.config.filter_size, ..Options::default() };
    let search = |inputs: &[[f32; 3]]| {
        let options =
            fluvia_neighbors::Options { metric: Metric::L2, ignore_coincident: true, distances: false };
        brute_force(inputs, points, Radius::Uniform(radius), &options)
    };
    let (fluid, wall) = (search(points), search(walls));
    let extent = Extent::Uniform(2.0 * radius);
    let fluid_sets = PointSets::new(points, points, &fluid, extent);
    let wall_sets = PointSets::new(walls, points, &wall, extent);
    let convolve = |part: &Convolution, sets: &PointSets<'_>, features: &[f64]| {
        let weights = LayerWeights {
            in_channels: part.inputs,
            out_channels: part.outputs,
            filter: &part.kernel,
            bias: Some(&part.bias),
            pointwise: None,
        };
        cconv::reference::forward(&options, sets, &weights, features)
    };
    let parts = [
        (convolve(&weights.obstacle, &wall_sets, normals), weights.obstacle.outputs),
        (convolve(&weights.fluid, &fluid_sets, features), weights.fluid.outputs),
        (fully_connected(&weights.fluid_dense, features), weights.fluid_dense.outputs),
    ];
    let mut values: Vec<f64> = (0..points.len())
        .flat_map(|i| parts.iter().flat_map(move |(part, width)| part[i * width..(i + 1) * width].iter()))
        .copied()
        .collect();
    for layer in &weights.layers {
        let activated: Vec<f64> = values.iter().map(|x| x.max(0.0)).collect();
        let mut next = convolve(&layer.convolution, &fluid_sets, &activated);
        add(&mut next, &fully_connected(&layer.dense, &activated));
        if next.len() == values.len() {
            add(&mut next, &values);
        }
        values = next;
    }
    values
}

fn fully_connected(layer: &Dense, features: &[f64]) -> Vec<f64> {
    let mut result = Vec::new();
    for f in features.chunks_exact(layer.inputs) {
        let mut row: Vec<f64> = layer.bias.iter().map(|&b| f64::from(b)).collect();
        for (value, weights) in f.iter().zip(layer.weight.chunks_exact(layer.outputs)) {
            row.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * f64::from(*weight));
        }
        result.extend(row);
    }
    result
}

fn add(to: &mut [f64], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}

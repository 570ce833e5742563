//! The network in float64, forward and backward: the specification of [`net`](crate::net), written from Fig. 2 and
//! Eq. 10-14.

use cconv::reference::{Sets, Weights as LayerWeights};
use cconv::{Extent, PointSets, PositionGradient};
use fluvia_neighbors::{Neighbors, Radius, brute_force};
use fluvia_sim::particles::{Acceleration, Boundary};

use crate::config::{Config, Integration};
use crate::weights::Weights;

/// Positions and velocities of all particles, metres and metres per second.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Positions.
    pub position: Vec<[f64; 3]>,
    /// Velocities.
    pub velocity: Vec<[f64; 3]>,
}

/// The weights in float64.
#[derive(Clone, Debug)]
pub struct Network {
    /// What the weights were made for.
    pub config: Config,
    /// The values of every tensor, in the order of [`Weights::tensors`].
    pub tensors: Vec<Vec<f64>>,
}

/// Places of the tensors of the first layer: kernels and weights; each bias follows.
const OBSTACLE: usize = 0;
const FLUID: usize = 2;
const FLUID_DENSE: usize = 4;

impl From<&Weights> for Network {
    fn from(weights: &Weights) -> Network {
        let widen = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect();
        let tensors = weights.tensors().iter().map(|tensor| widen(tensor.values)).collect();
        Network { config: weights.config.clone(), tensors }
    }
}

/// The derivatives of a number L that depends on the states after some steps.
#[derive(Clone, Debug)]
pub struct Gradients {
    /// By the weights, in the order of [`Weights::tensors`].
    pub tensors: Vec<Vec<f64>>,
    /// By the state before the first step.
    pub state: State,
    /// By the extra input features, [particles, extra inputs].
    pub extra: Vec<f64>,
}

/// What moves the particles of every step beside the network.
#[derive(Clone, Copy, Debug)]
pub struct World<'a> {
    /// The extra input features, [particles, extra inputs].
    pub extra: &'a [f64],
    /// Wall particles.
    pub boundary: &'a Boundary,
    /// The external acceleration of Eq. 10.
    pub acceleration: Acceleration<'a>,
}

/// One step of the network.
///
/// The neighbours are those of the float32 search at the rounded x*, so that both computations sum over
/// the same pairs.
pub fn step(network: &Network, state: &State, world: World<'_>) -> State {
    Trace::new(network, state, world).next
}

/// The derivatives of L from those by the states after each of some steps from `state`.
pub fn backward(
    network: &Network,
    state: &State,
    world: World<'_>,
    by_states: &[State],
    positions: PositionGradient,
) -> Gradients {
    let mut traces: Vec<Trace> = Vec::new();
    for _ in by_states {
        let start = traces.last().map_or(state, |trace| &trace.next);
        let trace = Trace::new(network, start, world);
        traces.push(trace);
    }
    let zero = vec![[0.0; 3]; state.position.len()];
    let mut gradients = Gradients {
        tensors: network.tensors.iter().map(|tensor| vec![0.0; tensor.len()]).collect(),
        state: State { position: zero.clone(), velocity: zero },
        extra: vec![0.0; world.extra.len()],
    };
    for (trace, by_state) in traces.iter().zip(by_states).rev() {
        add_points(&mut gradients.state.position, &by_state.position);
        add_points(&mut gradients.state.velocity, &by_state.velocity);
        trace.backward(network, world, positions, &mut gradients);
    }
    gradients
}

/// One step with everything that its backward pass needs.
struct Trace {
    /// x* of Eq. 11.
    x_star: Vec<[f64; 3]>,
    /// [1, v*, extra], [particles, inputs].
    features: Vec<f64>,
    fluid: Sets,
    walls: Sets,
    /// h_0 … h_K.
    values: Vec<Vec<f64>>,
    next: State,
}

impl Trace {
    fn new(network: &Network, state: &State, world: World<'_>) -> Trace {
        let config = &network.config;
        let (dt, scale) = (f64::from(config.dt), f64::from(config.output_scale));
        let count = state.position.len();
        // Eq. 10 and 11.
        let (mut x_star, mut v_star) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for i in 0..count {
            let (x, v, a) = (state.position[i], state.velocity[i], world.acceleration.of(i));
            let v_new: [f64; 3] = std::array::from_fn(|k| v[k] + dt * f64::from(a[k]));
            x_star.push(std::array::from_fn::<f64, 3, _>(|k| x[k] + dt * (v[k] + v_new[k]) / 2.0));
            v_star.push(v_new);
        }
        let extras = config.extra_inputs.len();
        let features: Vec<f64> = (0..count)
            .flat_map(|i| {
                let own = &world.extra[i * extras..(i + 1) * extras];
                [1.0].into_iter().chain(v_star[i]).chain(own.iter().copied())
            })
            .collect();
        let (fluid, walls) = sets(config, &x_star, &world.boundary.position);
        let mut trace = Trace {
            x_star,
            features,
            fluid,
            walls,
            values: Vec::new(),
            next: State { position: Vec::with_capacity(count), velocity: Vec::with_capacity(count) },
        };
        trace.values = trace.network(network, &normals(world.boundary));
        // Eq. 13 and 14.
        let output = &trace.values[trace.values.len() - 1];
        for (i, o) in output.chunks_exact(config.integration.outputs()).enumerate() {
            let x: [f64; 3] = std::array::from_fn(|k| trace.x_star[i][k] + scale * o[k]);
            trace.next.velocity.push(match config.integration {
                Integration::Paper => std::array::from_fn(|k| (x[k] - state.position[i][k]) / dt),
                Integration::Velocity => std::array::from_fn(|k| v_star[i][k] + 2.0 * scale / dt * o[3 + k]),
            });
            trace.next.position.push(x);
        }
        trace
    }

    /// h_0 … h_K of Fig. 2.
    fn network(&self, network: &Network, normals: &[f64]) -> Vec<Vec<f64>> {
        let parts = [
            network.convolve(OBSTACLE, &self.walls, normals),
            network.convolve(FLUID, &self.fluid, &self.features),
            match network.config.fully_connected {
                true => network.fully_connected(FLUID_DENSE, &self.features),
                false => Vec::new(),
            },
        ];
        let widths = network.first_widths();
        let first = (0..self.x_star.len()).flat_map(|i| {
            parts.iter().zip(widths).flat_map(move |(part, width)| &part[i * width..(i + 1) * width]).copied()
        });
        let mut values = vec![first.collect::<Vec<f64>>()];
        for place in network.layers() {
            let before = &values[values.len() - 1];
            let activated: Vec<f64> = before.iter().map(|&x| relu(x)).collect();
            let mut next = network.convolve(place, &self.fluid, &activated);
            if network.config.fully_connected {
                add(&mut next, &network.fully_connected(place + 2, &activated));
            }
            if network.is_residual(place) {
                add(&mut next, before);
            }
            values.push(next);
        }
        values
    }

    /// Replaces the derivatives by the state after the step by those by the state before it, and adds those by
    /// the weights and the extra inputs.
    fn backward(
        &self,
        network: &Network,
        world: World<'_>,
        positions: PositionGradient,
        gradients: &mut Gradients,
    ) {
        let config = &network.config;
        let (dt, scale) = (f64::from(config.dt), f64::from(config.output_scale));
        let State { position, velocity } = &mut gradients.state;
        // Eq. 14 and 13. From here on `position` is dL/dx, and `x_star` and `v_star` dL/dx* and dL/dv*.
        let mut x_star = position.clone();
        let mut v_star = vec![[0.0; 3]; position.len()];
        let mut output = Vec::new();
        for i in 0..position.len() {
            position[i] = [0.0; 3];
            let by_velocity = velocity[i];
            match config.integration {
                Integration::Paper => {
                    for k in 0..3 {
                        x_star[i][k] += by_velocity[k] / dt;
                        position[i][k] -= by_velocity[k] / dt;
                    }
                    output.extend(x_star[i].map(|d| scale * d));
                }
                Integration::Velocity => {
                    v_star[i] = by_velocity;
                    output.extend(x_star[i].map(|d| scale * d));
                    output.extend(by_velocity.map(|d| 2.0 * scale / dt * d));
                }
            }
        }
        let (by_features, by_x_star) =
            self.network_backward(network, world.boundary, output, &mut gradients.tensors);
        let extras = config.extra_inputs.len();
        for (i, row) in by_features.chunks_exact(config.fluid_inputs()).enumerate() {
            (0..3).for_each(|k| v_star[i][k] += row[1 + k]);
            add(&mut gradients.extra[i * extras..(i + 1) * extras], &row[4..]);
        }
        if positions == PositionGradient::Full {
            add_points(&mut x_star, &by_x_star);
        }
        // Eq. 11 and 10.
        for i in 0..position.len() {
            for k in 0..3 {
                position[i][k] += x_star[i][k];
                velocity[i][k] = v_star[i][k] + dt * x_star[i][k];
            }
        }
    }

    /// The derivatives by the features and by x*, from those by the output.
    fn network_backward(
        &self,
        network: &Network,
        boundary: &Boundary,
        mut by_values: Vec<f64>,
        tensors: &mut [Vec<f64>],
    ) -> (Vec<f64>, Vec<[f64; 3]>) {
        let mut by_x_star = vec![[0.0; 3]; self.x_star.len()];
        for (place, before) in network.layers().zip(&self.values).rev() {
            let activated: Vec<f64> = before.iter().map(|&x| relu(x)).collect();
            let layer = network.convolve_backward(place, &self.fluid, &activated, &by_values, tensors);
            add_points(&mut by_x_star, &layer.input_positions);
            add_points(&mut by_x_star, &layer.output_positions);
            let mut by_activated = layer.features;
            if network.config.fully_connected {
                let dense = network.fully_connected_backward(place + 2, &activated, &by_values, tensors);
                add(&mut by_activated, &dense);
            }
            // relu has no slope at 0.
            by_activated.iter_mut().zip(before).filter(|(_, x)| **x <= 0.0).for_each(|(d, _)| *d = 0.0);
            if network.is_residual(place) {
                add(&mut by_activated, &by_values);
            }
            by_values = by_activated;
        }
        let widths = network.first_widths();
        let stride = widths.iter().sum::<usize>();
        let part = |k: usize| -> Vec<f64> {
            let first = widths[..k].iter().sum::<usize>();
            by_values.chunks_exact(stride).flat_map(|row| &row[first..first + widths[k]]).copied().collect()
        };
        let walls = network.convolve_backward(OBSTACLE, &self.walls, &normals(boundary), &part(0), tensors);
        add_points(&mut by_x_star, &walls.output_positions);
        let fluid = network.convolve_backward(FLUID, &self.fluid, &self.features, &part(1), tensors);
        add_points(&mut by_x_star, &fluid.input_positions);
        add_points(&mut by_x_star, &fluid.output_positions);
        let mut by_features = fluid.features;
        if network.config.fully_connected {
            let dense = network.fully_connected_backward(FLUID_DENSE, &self.features, &part(2), tensors);
            add(&mut by_features, &dense);
        }
        (by_features, by_x_star)
    }
}

/// The pairs among the fluid, and those of walls and fluid, at the positions x*.
fn sets(config: &Config, x_star: &[[f64; 3]], walls: &[[f32; 3]]) -> (Sets, Sets) {
    let points: Vec<[f32; 3]> = x_star.iter().map(|x| x.map(|c| c as f32)).collect();
    let search = |inputs: &[[f32; 3]]| -> Neighbors {
        brute_force(inputs, &points, Radius::Uniform(config.filter_radius), &config.search())
    };
    let extent = Extent::Uniform(2.0 * config.filter_radius);
    let (fluid, wall) = (search(&points), search(walls));
    let fluid = Sets::from(&PointSets::new(&points, &points, &fluid, extent));
    let wall = Sets::from(&PointSets::new(walls, &points, &wall, extent));
    // At x* itself, not at its rounding.
    (
        Sets { inputs: x_star.to_vec(), outputs: x_star.to_vec(), ..fluid },
        Sets { outputs: x_star.to_vec(), ..wall },
    )
}

fn normals(boundary: &Boundary) -> Vec<f64> {
    boundary.normal.iter().flatten().map(|&n| f64::from(n)).collect()
}

impl Network {
    /// The places of the layers after the first.
    fn layers(&self) -> impl DoubleEndedIterator<Item = usize> + ExactSizeIterator + use<> {
        // Two convolutions come first; each has a bias, and so has a fully connected part.
        let (first, of_layer) = if self.config.fully_connected { (6, 4) } else { (4, 2) };
        (first..self.tensors.len()).step_by(of_layer)
    }

    fn outputs(&self, place: usize) -> usize {
        self.tensors[place + 1].len()
    }

    /// Output channels of the three parts of the first layer; 0 of one that is not there.
    fn first_widths(&self) -> [usize; 3] {
        let dense = if self.config.fully_connected { self.outputs(FLUID_DENSE) } else { 0 };
        [self.outputs(OBSTACLE), self.outputs(FLUID), dense]
    }

    /// Whether the layer's input is added to its output.
    fn is_residual(&self, place: usize) -> bool {
        let layer = self.layer(place);
        layer.in_channels == layer.out_channels
    }

    fn layer(&self, place: usize) -> LayerWeights<'_> {
        let (filter, bias) = (&self.tensors[place], &self.tensors[place + 1]);
        let (cells, out_channels) = (self.config.filter_size.iter().product::<usize>(), bias.len());
        LayerWeights {
            in_channels: filter.len() / (cells * out_channels),
            out_channels,
            filter,
            bias: Some(bias),
            pointwise: None,
        }
    }

    fn convolve(&self, place: usize, sets: &Sets, features: &[f64]) -> Vec<f64> {
        cconv::reference::forward(&self.config.options(), sets, &self.layer(place), features)
    }

    fn convolve_backward(
        &self,
        place: usize,
        sets: &Sets,
        features: &[f64],
        by_output: &[f64],
        tensors: &mut [Vec<f64>],
    ) -> cconv::reference::Gradients {
        let layer = self.layer(place);
        let gradients = cconv::reference::backward(&self.config.options(), sets, &layer, features, by_output);
        add(&mut tensors[place], &gradients.filter);
        add(&mut tensors[place + 1], &gradients.bias);
        gradients
    }

    fn fully_connected(&self, place: usize, features: &[f64]) -> Vec<f64> {
        let (weight, bias) = (&self.tensors[place], &self.tensors[place + 1]);
        let mut result = Vec::new();
        for f in features.chunks_exact(weight.len() / bias.len()) {
            let mut row = bias.clone();
            for (value, weights) in f.iter().zip(weight.chunks_exact(bias.len())) {
                row.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
            }
            result.extend(row);
        }
        result
    }

    /// Adds the derivatives by the weights; returns those by the features.
    fn fully_connected_backward(
        &self,
        place: usize,
        features: &[f64],
        by_output: &[f64],
        tensors: &mut [Vec<f64>],
    ) -> Vec<f64> {
        let (weight, outputs) = (&self.tensors[place], self.outputs(place));
        let mut by_features = Vec::with_capacity(features.len());
        for (f, d) in features.chunks_exact(weight.len() / outputs).zip(by_output.chunks_exact(outputs)) {
            add(&mut tensors[place + 1], d);
            for (row, value) in tensors[place].chunks_exact_mut(outputs).zip(f) {
                row.iter_mut().zip(d).for_each(|(sum, d)| *sum += value * d);
            }
            by_features.extend(
                weight.chunks_exact(outputs).map(|row| row.iter().zip(d).map(|(w, d)| w * d).sum::<f64>()),
            );
        }
        by_features
    }
}

/// Keeps what is no number.
fn relu(x: f64) -> f64 {
    if x < 0.0 { 0.0 } else { x }
}

fn add(to: &mut [f64], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}

fn add_points(to: &mut [[f64; 3]], from: &[[f64; 3]]) {
    add(to.as_flattened_mut(), from.as_flattened());
}

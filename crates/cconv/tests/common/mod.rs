//! What the tests of this crate share.

#![allow(dead_code, reason = "each test file takes what it needs")]

use cconv::reference::{self, widen};
use cconv::{
    Extent, Filter, Geometry, Gradients, Interpolation, Mapping, Options, PairGradient, PointGradients,
    PointSets, Window, Workspace,
};
use fluvia_neighbors::{Neighbors, Options as SearchOptions, Point, Radius, brute_force};

/// A small deterministic generator (SplitMix64), so that cases are the same everywhere.
pub struct Numbers(pub u64);

impl Numbers {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in −1..1.
    pub fn signed(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }

    pub fn vec(&mut self, len: usize) -> Vec<f32> {
        (0..len).map(|_| self.signed()).collect()
    }

    pub fn points(&mut self, len: usize) -> Vec<Point> {
        (0..len).map(|_| std::array::from_fn(|_| self.signed())).collect()
    }
}

/// One random problem with everything that the operator can be given.
#[derive(Clone)]
pub struct Problem {
    pub options: Options,
    pub inputs: Vec<Point>,
    /// The input points themselves if the problem has a pointwise term.
    pub outputs: Vec<Point>,
    pub channels: (usize, usize),
    pub extent: ExtentKind,
    pub scalars: Vec<f32>,
    pub vectors: Vec<[f32; 3]>,
    pub neighbors: Neighbors,
    pub importance: Option<Vec<f32>>,
    pub window_values: Option<Vec<f32>>,
    pub filter: Vec<f32>,
    pub bias: Option<Vec<f32>>,
    pub pointwise: Option<Vec<f32>>,
    pub features: Vec<f32>,
    /// The derivatives by the output.
    pub output_gradient: Vec<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ExtentKind {
    Uniform,
    PerAxis,
    PerPoint,
    PerPointAndAxis,
}

pub const EXTENTS: [ExtentKind; 4] =
    [ExtentKind::Uniform, ExtentKind::PerAxis, ExtentKind::PerPoint, ExtentKind::PerPointAndAxis];

/// Which optional parts a [`Problem`] has.
#[derive(Clone, Copy, Debug)]
pub struct Parts {
    pub extent: ExtentKind,
    pub importance: bool,
    pub window_values: bool,
    pub bias: bool,
    /// Needs the same input and output points.
    pub pointwise: bool,
}

impl Problem {
    pub fn new(
        numbers: &mut Numbers,
        options: Options,
        inputs: Vec<Point>,
        outputs: Vec<Point>,
        channels: (usize, usize),
        parts: Parts,
    ) -> Problem {
        let neighbors = search(&inputs, &outputs, false);
        let (channels_in, channels_out) = channels;
        let pairs = neighbors.indices.len();
        Problem {
            channels,
            extent: parts.extent,
            scalars: outputs.iter().map(|_| 1.4 + 0.3 * numbers.signed().abs()).collect(),
            vectors: outputs
                .iter()
                .map(|_| std::array::from_fn(|_| 1.4 + 0.3 * numbers.signed().abs()))
                .collect(),
            importance: parts.importance.then(|| numbers.vec(inputs.len())),
            window_values: parts.window_values.then(|| numbers.vec(pairs).iter().map(|x| x.abs()).collect()),
            filter: numbers.vec(options.cells() * channels_in * channels_out),
            bias: parts.bias.then(|| numbers.vec(channels_out)),
            pointwise: parts.pointwise.then(|| numbers.vec(channels_in * channels_out)),
            features: numbers.vec(inputs.len() * channels_in),
            output_gradient: numbers.vec(outputs.len() * channels_out),
            options,
            inputs,
            outputs,
            neighbors,
        }
    }

    /// Problems as one, point after point. The weights are those of the first.
    pub fn joined(problems: &[Problem]) -> Problem {
        let mut joined = problems[0].clone();
        for problem in &problems[1..] {
            let (first_input, first_pair) = (joined.inputs.len() as u32, joined.neighbors.indices.len());
            joined.inputs.extend_from_slice(&problem.inputs);
            joined.outputs.extend_from_slice(&problem.outputs);
            joined.scalars.extend_from_slice(&problem.scalars);
            joined.vectors.extend_from_slice(&problem.vectors);
            joined.features.extend_from_slice(&problem.features);
            joined.output_gradient.extend_from_slice(&problem.output_gradient);
            if let (Some(all), Some(own)) = (&mut joined.importance, &problem.importance) {
                all.extend_from_slice(own);
            }
            let Neighbors { indices, row_splits, .. } = &problem.neighbors;
            joined.neighbors.indices.extend(indices.iter().map(|i| first_input + i));
            joined.neighbors.row_splits.extend(row_splits[1..].iter().map(|end| first_pair + end));
        }
        joined
    }

    /// Finds the neighbours again, without coincident points if so asked.
    pub fn search(&mut self, ignore_coincident: bool) {
        self.neighbors = search(&self.inputs, &self.outputs, ignore_coincident);
    }

    pub fn sets(&self) -> PointSets<'_> {
        let extent = match self.extent {
            ExtentKind::Uniform => Extent::Uniform(1.4),
            ExtentKind::PerAxis => Extent::PerAxis([1.4, 1.6, 1.9]),
            ExtentKind::PerPoint => Extent::PerPoint(&self.scalars),
            ExtentKind::PerPointAndAxis => Extent::PerPointAndAxis(&self.vectors),
        };
        PointSets {
            importance: self.importance.as_deref(),
            window_values: self.window_values.as_deref(),
            ..PointSets::new(&self.inputs, &self.outputs, &self.neighbors, extent)
        }
    }

    pub fn filter(&self) -> Filter {
        let mut filter = Filter::new(&self.options, self.channels.0, self.channels.1, &self.filter);
        if let Some(bias) = &self.bias {
            filter = filter.with_bias(bias);
        }
        if let Some(pointwise) = &self.pointwise {
            filter = filter.with_pointwise(pointwise);
        }
        filter
    }

    pub fn wide(&self) -> Wide {
        Wide {
            options: self.options.clone(),
            sets: reference::Sets::from(&self.sets()),
            channels: self.channels,
            filter: widen(&self.filter),
            bias: self.bias.as_deref().map(widen),
            pointwise: self.pointwise.as_deref().map(widen),
            features: widen(&self.features),
        }
    }
}

fn search(inputs: &[Point], outputs: &[Point], ignore_coincident: bool) -> Neighbors {
    let options = SearchOptions { ignore_coincident, ..SearchOptions::default() };
    brute_force(inputs, outputs, Radius::Uniform(0.7), &options)
}

/// A problem in float64.
#[derive(Clone)]
pub struct Wide {
    pub options: Options,
    pub sets: reference::Sets,
    pub channels: (usize, usize),
    pub filter: Vec<f64>,
    pub bias: Option<Vec<f64>>,
    pub pointwise: Option<Vec<f64>>,
    pub features: Vec<f64>,
}

impl Wide {
    fn weights(&self) -> reference::Weights<'_> {
        reference::Weights {
            in_channels: self.channels.0,
            out_channels: self.channels.1,
            filter: &self.filter,
            bias: self.bias.as_deref(),
            pointwise: self.pointwise.as_deref(),
        }
    }

    pub fn forward(&self) -> Vec<f64> {
        reference::forward(&self.options, &self.sets, &self.weights(), &self.features)
    }

    pub fn backward(&self, output_gradient: &[f64]) -> reference::Gradients {
        reference::backward(&self.options, &self.sets, &self.weights(), &self.features, output_gradient)
    }
}

/// All combinations of mapping, interpolation, window, alignment and normalisation.
pub fn all_options() -> Vec<Options> {
    let mut all = Vec::new();
    for mapping in [Mapping::VolumePreserving, Mapping::Radial, Mapping::Identity] {
        for interpolation in [Interpolation::Linear, Interpolation::LinearBorder, Interpolation::Nearest] {
            for window in [Window::Poly6, Window::Triangular, Window::None] {
                for (align_corners, normalize) in [(true, false), (false, true), (true, true), (false, false)]
                {
                    let offset = if align_corners { [0.0; 3] } else { [0.2, -0.1, 0.3] };
                    all.push(Options {
                        filter_size: [4, 4, 4],
                        mapping,
                        interpolation,
                        align_corners,
                        offset,
                        window,
                        normalize,
                    });
                }
            }
        }
    }
    all
}

/// The largest magnitude; NaN counts as the largest.
pub fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |a, x| if x.abs() > a || x.is_nan() { x.abs() } else { a })
}

/// Every gradient in float32.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AllGradients {
    pub filter: Vec<f32>,
    pub bias: Vec<f32>,
    pub pointwise: Vec<f32>,
    pub features: Vec<f32>,
    pub importance: Vec<f32>,
    pub window_values: Vec<f32>,
    pub input_positions: Vec<Point>,
    pub output_positions: Vec<Point>,
}

pub fn all_gradients(
    problem: &Problem,
    filter: &Filter,
    geometry: &mut Geometry,
    workspace: &mut Workspace,
) -> AllGradients {
    add_gradients(AllGradients::default(), problem, filter, geometry, workspace)
}

/// Adds the gradients of one more cloud: those by weights to the ones there are, those by points after them.
pub fn add_gradients(
    before: AllGradients,
    problem: &Problem,
    filter: &Filter,
    geometry: &mut Geometry,
    workspace: &mut Workspace,
) -> AllGradients {
    let or_zeros = |values: Vec<f32>, len: usize| if values.is_empty() { vec![0.0; len] } else { values };
    let mut gradients = AllGradients {
        filter: or_zeros(before.filter, problem.filter.len()),
        bias: or_zeros(before.bias, problem.channels.1),
        pointwise: or_zeros(before.pointwise, problem.pointwise.as_ref().map_or(0, Vec::len)),
        features: vec![0.0; problem.features.len()],
        importance: vec![0.0; problem.inputs.len()],
        window_values: vec![0.0; problem.neighbors.indices.len()],
        input_positions: vec![[0.0; 3]; problem.inputs.len()],
        output_positions: vec![[0.0; 3]; problem.outputs.len()],
    };
    geometry.prepare_backward();
    let mut pairs = PairGradient::default();
    pairs.reset(geometry);
    let wanted = Gradients {
        filter: Some(&mut gradients.filter),
        bias: Some(&mut gradients.bias),
        pointwise: problem.pointwise.is_some().then_some(gradients.pointwise.as_mut_slice()),
        features: Some(&mut gradients.features),
        pairs: Some(&mut pairs),
    };
    let Problem { features, output_gradient, .. } = problem;
    cconv::backward(geometry, filter, features, output_gradient, wanted, workspace);
    let wanted = PointGradients {
        importance: Some(&mut gradients.importance),
        window_values: Some(&mut gradients.window_values),
        input_positions: Some(&mut gradients.input_positions),
        output_positions: Some(&mut gradients.output_positions),
    };
    geometry.backward(&problem.sets(), &pairs, wanted);
    AllGradients {
        features: [before.features, gradients.features].concat(),
        importance: [before.importance, gradients.importance].concat(),
        window_values: [before.window_values, gradients.window_values].concat(),
        input_positions: [before.input_positions, gradients.input_positions].concat(),
        output_positions: [before.output_positions, gradients.output_positions].concat(),
        ..gradients
    }
}

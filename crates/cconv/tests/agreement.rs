//! Every kernel against the float64 reference, over all options and awkward sizes.

mod common;

use cconv::{
    Columns, Dense, Extent, Filter, Geometry, Interpolation, Kernel, Mapping, Options, PointSets, Window,
    Workspace, reference,
};
use common::Numbers;
use fluvia_neighbors::{Options as SearchOptions, Radius, brute_force};

/// One random problem; `same` uses one set of points for input and output, with a pointwise term.
struct Problem {
    options: Options,
    inputs: Vec<[f32; 3]>,
    outputs: Vec<[f32; 3]>,
    channels: (usize, usize),
    same: bool,
    extent: usize,
    importance: bool,
    window_values: bool,
    bias: bool,
}

impl Problem {
    /// Runs every kernel and compares with the reference, relative to the largest magnitude of the sum of
    /// absolute terms: float32 rounding of each of up to some thousand terms.
    fn check(&self, numbers: &mut Numbers, workspace: &mut Workspace) {
        const RADIUS: f32 = 0.7;
        let Problem { options, inputs, channels: (channels_in, channels_out), .. } = self;
        let outputs = if self.same { inputs } else { &self.outputs };
        let neighbors = brute_force(inputs, outputs, Radius::Uniform(RADIUS), &SearchOptions::default());
        let scalar: Vec<f32> = outputs.iter().map(|_| 1.4 + 0.3 * numbers.signed().abs()).collect();
        let vector: Vec<[f32; 3]> =
            outputs.iter().map(|_| std::array::from_fn(|_| 1.4 + 0.3 * numbers.signed().abs())).collect();
        let importance = numbers.vec(inputs.len());
        let windows: Vec<f32> = numbers.vec(neighbors.indices.len()).iter().map(|x| x.abs()).collect();
        let sets = PointSets {
            inputs,
            outputs,
            neighbors: &neighbors,
            extent: match self.extent {
                0 => Extent::Uniform(2.0 * RADIUS),
                1 => Extent::PerAxis([1.4, 1.6, 1.9]),
                2 => Extent::PerPoint(&scalar),
                _ => Extent::PerPointAndAxis(&vector),
            },
            importance: self.importance.then_some(importance.as_slice()),
            window_values: self.window_values.then_some(windows.as_slice()),
        };
        let filter = numbers.vec(options.cells() * channels_in * channels_out);
        let bias = numbers.vec(*channels_out);
        let pointwise = numbers.vec(channels_in * channels_out);
        let features = numbers.vec(inputs.len() * channels_in);
        let wide: Vec<f64> = features.iter().map(|&x| f64::from(x)).collect();
        let weights = reference::Weights {
            in_channels: *channels_in,
            out_channels: *channels_out,
            filter: &filter,
            bias: self.bias.then_some(bias.as_slice()),
            pointwise: self.same.then_some(pointwise.as_slice()),
        };
        let expected = reference::forward(options, &sets, &weights, &wide);
        let scale = expected.iter().fold(1.0f64, |a, x| a.max(x.abs()));
        for kernel in Kernel::available() {
            let mut geometry = Geometry::default();
            geometry.build(options, &sets, kernel);
            let mut packed = Filter::new(options, *channels_in, *channels_out, &filter);
            if self.bias {
                packed = packed.with_bias(&bias);
            }
            if self.same {
                packed = packed.with_pointwise(&pointwise);
            }
            let mut output = vec![f32::NAN; outputs.len() * channels_out];
            cconv::forward(&geometry, &packed, &features, &mut output, workspace);
            for (k, (value, expected)) in output.iter().zip(&expected).enumerate() {
                let error = (f64::from(*value) - expected).abs() / scale;
                assert!(error < 1e-5, "{} {options:?}: value {k} off by {error:.1e}", kernel.name());
            }
        }
    }
}

fn all_options() -> Vec<Options> {
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

/// Whether a small change of the position moves the interpolation by a whole cell, so that float32 and
/// float64 may rightly differ.
fn jumps(options: &Options) -> bool {
    options.interpolation == Interpolation::Nearest
}

#[test]
fn all_options_agree_with_the_reference() {
    let (mut numbers, mut workspace) = (Numbers(1), Workspace::default());
    let sizes = [[4, 4, 4], [3, 5, 2], [1, 1, 1], [2, 7, 1]];
    for (k, mut options) in all_options().into_iter().enumerate() {
        options.filter_size = sizes[k % sizes.len()];
        let problem = Problem {
            inputs: numbers.points(40),
            outputs: numbers.points(15),
            channels: (1 + numbers.below(9), 1 + numbers.below(9)),
            same: k % 3 == 0,
            extent: numbers.below(4),
            importance: numbers.below(2) == 0,
            window_values: numbers.below(4) == 0,
            bias: numbers.below(2) == 0,
            options,
        };
        problem.check(&mut numbers, &mut workspace);
    }
}

#[test]
fn awkward_sizes_agree_with_the_reference() {
    let (mut numbers, mut workspace) = (Numbers(2), Workspace::default());
    let channels = [
        (1, 1),
        (3, 32),
        (4, 32),
        (96, 64),
        (64, 3),
        (17, 5),
        (9, 8),
        (33, 65),
        (48, 48),
        (20, 130),
        (5, 17),
    ];
    for (k, channels) in channels.into_iter().enumerate() {
        for (inputs, outputs) in [(0, 0), (0, 3), (1, 1), (3, 0), (2, 13), (50, 26), (30, 193)] {
            let problem = Problem {
                options: Options::default(),
                inputs: numbers.points(inputs),
                outputs: numbers.points(outputs),
                channels,
                same: (k + inputs) % 2 == 0,
                extent: 0,
                importance: false,
                window_values: false,
                bias: true,
            };
            problem.check(&mut numbers, &mut workspace);
        }
    }
}

#[test]
fn coincident_points_agree_with_the_reference() {
    let (mut numbers, mut workspace) = (Numbers(3), Workspace::default());
    for options in all_options().into_iter().filter(|options| !jumps(options)) {
        let mut inputs = numbers.points(6);
        inputs.extend_from_within(..);
        inputs.extend_from_within(..);
        let problem = Problem {
            options,
            outputs: inputs[..5].to_vec(),
            inputs,
            channels: (4, 6),
            same: false,
            extent: 0,
            importance: true,
            window_values: false,
            bias: false,
        };
        problem.check(&mut numbers, &mut workspace);
    }
}

#[test]
fn a_dense_layer_is_a_matrix_product() {
    let mut numbers = Numbers(4);
    for (points, inputs, outputs) in [(0, 4, 32), (1, 4, 32), (29, 5, 3), (200, 17, 70)] {
        let (weights, bias) = (numbers.vec(inputs * outputs), numbers.vec(outputs));
        let features = numbers.vec(points * inputs);
        let layer = Dense::new(inputs, &weights, &bias);
        for kernel in Kernel::available() {
            // Into the middle of wider rows, whose other columns stay.
            let (stride, first) = (outputs + 5, 2);
            let mut values = vec![7.0; points * stride];
            let output = Columns { values: &mut values, stride, first };
            cconv::dense(&layer, &features, output, &mut Workspace::default(), kernel);
            for (row, f) in values.chunks_exact(stride).zip(features.chunks_exact(inputs)) {
                assert!(row[..first].iter().chain(&row[first + outputs..]).all(|&x| x == 7.0));
                for o in 0..outputs {
                    let sum: f64 =
                        (0..inputs).map(|i| f64::from(f[i]) * f64::from(weights[i * outputs + o])).sum();
                    // Float32 rounding of at most 17 products of numbers below 1.
                    assert!((f64::from(row[first + o]) - sum - f64::from(bias[o])).abs() < 1e-5);
                }
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let mut numbers = Numbers(5);
    let points = numbers.points(700);
    let neighbors = brute_force(&points, &points, Radius::Uniform(0.4), &SearchOptions::default());
    let options = Options::default();
    for (channels_in, channels_out) in [(4, 32), (96, 64), (64, 3)] {
        let filter = numbers.vec(64 * channels_in * channels_out);
        let features = numbers.vec(points.len() * channels_in);
        for kernel in Kernel::available() {
            let run = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| {
                    let mut geometry = Geometry::default();
                    let sets = PointSets::new(&points, &points, &neighbors, Extent::Uniform(0.8));
                    geometry.build(&options, &sets, kernel);
                    let filter = Filter::new(&options, channels_in, channels_out, &filter);
                    let mut output = vec![0.0; points.len() * channels_out];
                    cconv::forward(&geometry, &filter, &features, &mut output, &mut Workspace::default());
                    output.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
                })
            };
            assert_eq!(run(1), run(2), "{}", kernel.name());
        }
    }
}

//! Every kernel against the float64 reference, over all options and awkward sizes.

mod common;

use cconv::reference::widen;
use cconv::{Columns, Dense, Geometry, Gradients, Interpolation, Kernel, Options, Precision, Workspace};
use common::{EXTENTS, ExtentKind, Numbers, Parts, Problem, all_gradients, all_options, largest};
use fluvia_neighbors::{Options as SearchOptions, Point, Radius, brute_force};

/// Runs every kernel forward and backward and compares with the reference, relative to the largest magnitude: float32
/// rounding of sums of up to some thousand terms.
fn check(problem: &Problem, workspace: &mut Workspace) {
    let wide = problem.wide();
    let expected = wide.forward();
    let expected_gradients = wide.backward(&widen(&problem.output_gradient));
    for kernel in Kernel::available() {
        let close = |name: &str, values: &[f32], expected: &[f64]| {
            assert_eq!(values.len(), expected.len(), "{name}");
            let scale = largest(expected.iter().copied()).max(1.0);
            let error = largest(values.iter().zip(expected).map(|(value, e)| f64::from(*value) - e)) / scale;
            assert!(error < 1e-5, "{} {:?}: {name} off by {error:.1e}", kernel.name(), problem.options);
        };
        let mut geometry = Geometry::default();
        geometry.build(&problem.options, &problem.sets(), kernel);
        let filter = problem.filter();
        let mut output = vec![f32::NAN; expected.len()];
        cconv::forward(&geometry, &filter, &problem.features, &mut output, workspace);
        close("output", &output, &expected);

        let gradients = all_gradients(problem, &filter, &mut geometry, workspace);
        close("filter", &gradients.filter, &expected_gradients.filter);
        close("bias", &gradients.bias, &expected_gradients.bias);
        close("pointwise", &gradients.pointwise, &expected_gradients.pointwise);
        close("features", &gradients.features, &expected_gradients.features);
        close("importance", &gradients.importance, &expected_gradients.importance);
        close("window values", &gradients.window_values, &expected_gradients.window_values);
        let positions = gradients.input_positions.as_flattened();
        close("input positions", positions, expected_gradients.input_positions.as_flattened());
        let positions = gradients.output_positions.as_flattened();
        close("output positions", positions, expected_gradients.output_positions.as_flattened());
    }
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
        let inputs = numbers.points(40);
        let pointwise = k % 3 == 0;
        let outputs = if pointwise { inputs.clone() } else { numbers.points(15) };
        let channels = (1 + numbers.below(9), 1 + numbers.below(9));
        let parts = Parts {
            extent: EXTENTS[numbers.below(4)],
            importance: numbers.below(2) == 0,
            window_values: numbers.below(4) == 0,
            bias: numbers.below(2) == 0,
            pointwise,
        };
        check(&Problem::new(&mut numbers, options, inputs, outputs, channels, parts), &mut workspace);
    }
}

const BIAS_ALONE: Parts = Parts {
    extent: ExtentKind::Uniform,
    importance: false,
    window_values: false,
    bias: true,
    pointwise: false,
};

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
            let pointwise = (k + inputs) % 2 == 0;
            let inputs = numbers.points(inputs);
            let outputs = if pointwise { inputs.clone() } else { numbers.points(outputs) };
            let parts = Parts { pointwise, ..BIAS_ALONE };
            let options = Options::default();
            check(&Problem::new(&mut numbers, options, inputs, outputs, channels, parts), &mut workspace);
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
        let outputs = inputs[..5].to_vec();
        let parts = Parts { importance: true, bias: false, ..BIAS_ALONE };
        check(&Problem::new(&mut numbers, options, inputs, outputs, (4, 6), parts), &mut workspace);
    }
}

/// Multiples of 1/4 around the origin lie on every kink there is: on the seams of the mappings, on the axis, on the
/// centres of filter cells, at the border of the window. All of it is exact in float32, so both sides must
/// take the same derivative.
#[test]
fn points_on_kinks_agree_with_the_reference() {
    let (mut numbers, mut workspace) = (Numbers(7), Workspace::default());
    let steps = || (-4..=4).map(|k| k as f32 / 4.0);
    let inputs: Vec<Point> =
        steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z]))).collect();
    for mut options in all_options().into_iter().filter(|options| !jumps(options)) {
        options.filter_size = [3, 5, 3];
        options.offset = [0.0; 3];
        // The ball alone: Λ is a map of it.
        let inside = inputs.iter().filter(|p| p.iter().map(|x| x * x).sum::<f32>() <= 1.0);
        let inputs: Vec<Point> = inside.copied().collect();
        let parts = Parts { bias: false, ..BIAS_ALONE };
        let mut problem = Problem::new(&mut numbers, options, inputs, vec![[0.0; 3]], (3, 2), parts);
        problem.neighbors =
            brute_force(&problem.inputs, &problem.outputs, Radius::Uniform(1.0), &SearchOptions::default());
        problem.extent = ExtentKind::PerPoint;
        problem.scalars = vec![2.0];
        check(&problem, &mut workspace);
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
    for channels in [(4, 32), (96, 64), (64, 3)] {
        let parts = Parts { importance: true, pointwise: true, ..BIAS_ALONE };
        let problem =
            Problem::new(&mut numbers, Options::default(), points.clone(), points.clone(), channels, parts);
        for kernel in Kernel::available() {
            for precision in [Precision::F32, Precision::Bf16] {
                let run = |threads| {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    pool.install(|| {
                        let (mut geometry, mut workspace) = (Geometry::default(), Workspace::default());
                        geometry.build(&problem.options, &problem.sets(), kernel);
                        let filter = problem.filter().with_precision(precision);
                        let mut output = vec![0.0; points.len() * channels.1];
                        cconv::forward(&geometry, &filter, &problem.features, &mut output, &mut workspace);
                        (output, all_gradients(&problem, &filter, &mut geometry, &mut workspace))
                    })
                };
                assert!(run(1) == run(2), "{} {precision:?} {channels:?}", kernel.name());
            }
        }
    }
}

/// Without the lists by input point the gradient of a filter is summed on the other side.
#[test]
fn the_filters_gradient_needs_no_preparation() {
    let mut numbers = Numbers(8);
    for channels in [(9, 4), (12, 3), (3, 12)] {
        let (inputs, outputs) = (numbers.points(40), numbers.points(30));
        let problem = Problem::new(&mut numbers, Options::default(), inputs, outputs, channels, BIAS_ALONE);
        let expected = problem.wide().backward(&widen(&problem.output_gradient)).filter;
        for kernel in Kernel::available() {
            let mut geometry = Geometry::default();
            geometry.build(&problem.options, &problem.sets(), kernel);
            let mut found = vec![0.0; problem.filter.len()];
            let wanted = Gradients { filter: Some(&mut found), ..Gradients::default() };
            let Problem { features, output_gradient, .. } = &problem;
            let workspace = &mut Workspace::default();
            cconv::backward(&geometry, &problem.filter(), features, output_gradient, wanted, workspace);
            let scale = largest(expected.iter().copied());
            let error = largest(found.iter().zip(&expected).map(|(a, b)| f64::from(*a) - b)) / scale;
            // Float32 sums of some hundred terms.
            assert!(error < 1e-5, "{} {channels:?}: off by {error:.1e}", kernel.name());
        }
    }
}

//! What must hold whatever the numbers are: symmetries, sums, permutations, batches.

mod common;

use cconv::{Geometry, Interpolation, Kernel, Mapping, Options, Precision, Window, Workspace};
use common::{
    AllGradients, EXTENTS, ExtentKind, Numbers, Parts, Problem, add_gradients, all_gradients, all_options,
    largest,
};

const PLAIN: Parts = Parts {
    extent: ExtentKind::Uniform,
    importance: true,
    window_values: false,
    bias: true,
    pointwise: false,
};

fn forward(problem: &Problem, kernel: Kernel) -> Vec<f32> {
    let mut geometry = Geometry::default();
    geometry.build(&problem.options, &problem.sets(), kernel);
    let mut output = vec![f32::NAN; problem.outputs.len() * problem.channels.1];
    cconv::forward(&geometry, &problem.filter(), &problem.features, &mut output, &mut Workspace::default());
    output
}

fn gradients(problem: &Problem, kernel: Kernel) -> AllGradients {
    let mut geometry = Geometry::default();
    geometry.build(&problem.options, &problem.sets(), kernel);
    all_gradients(problem, &problem.filter(), &mut geometry, &mut Workspace::default())
}

/// Fails if two arrays differ by more than float32 rounding of sums, relative to the largest magnitude.
fn assert_close(name: &str, a: &[f32], b: &[f32], tolerance: f64) {
    assert_eq!(a.len(), b.len(), "{name}");
    let scale = largest(a.iter().map(|&x| f64::from(x))).max(1e-3);
    let error = largest(a.iter().zip(b).map(|(a, b)| f64::from(*a) - f64::from(*b))) / scale;
    assert!(error <= tolerance, "{name}: off by {error:.1e}");
}

fn random_problem(numbers: &mut Numbers, options: Options, parts: Parts) -> Problem {
    let (inputs, outputs) = (numbers.points(60), numbers.points(25));
    Problem::new(numbers, options, inputs, outputs, (5, 6), parts)
}

#[test]
fn translation_changes_nothing_beyond_rounding() {
    let mut numbers = Numbers(1);
    for options in all_options() {
        let mut problem = random_problem(&mut numbers, options, PLAIN);
        // Multiples of 1/1024 and a shift by whole numbers: the differences of positions are the same exactly.
        for point in problem.inputs.iter_mut().chain(&mut problem.outputs) {
            *point = point.map(|x| (x * 1024.0).round() / 1024.0);
        }
        problem.search(false);
        let mut moved = problem.clone();
        for point in moved.inputs.iter_mut().chain(&mut moved.outputs) {
            *point = [point[0] + 3.0, point[1] - 5.0, point[2] + 8.0];
        }
        for kernel in Kernel::available() {
            assert_eq!(forward(&problem, kernel), forward(&moved, kernel), "{:?}", problem.options);
            assert!(gradients(&problem, kernel) == gradients(&moved, kernel), "{:?}", problem.options);
        }
    }
}

#[test]
fn turning_by_90_degrees_permutes_the_filter() {
    let mut numbers = Numbers(2);
    let (size, channels) = (3, (4, 5));
    for interpolation in [Interpolation::Linear, Interpolation::LinearBorder] {
        let options = Options {
            filter_size: [size; 3],
            mapping: Mapping::Identity,
            interpolation,
            ..Options::default()
        };
        let (inputs, outputs) = (numbers.points(60), numbers.points(25));
        let problem = Problem::new(&mut numbers, options, inputs, outputs, channels, PLAIN);
        // About z: x to y, y to −x.
        let turn = |p: [f32; 3]| [-p[1], p[0], p[2]];
        let mut turned = problem.clone();
        for point in turned.inputs.iter_mut().chain(&mut turned.outputs) {
            *point = turn(*point);
        }
        let cell = |z: usize, y: usize, x: usize| ((z * size + y) * size + x) * channels.0 * channels.1;
        for z in 0..size {
            for y in 0..size {
                for x in 0..size {
                    // The cell at (x, y) is seen where it is turned to.
                    let (from, to) = (cell(z, y, x), cell(z, x, size - 1 - y));
                    let values = &problem.filter[from..from + channels.0 * channels.1];
                    turned.filter[to..to + values.len()].copy_from_slice(values);
                }
            }
        }
        for kernel in Kernel::available() {
            assert_close("output", &forward(&problem, kernel), &forward(&turned, kernel), 1e-5);
            let (before, after) = (gradients(&problem, kernel), gradients(&turned, kernel));
            let expected: Vec<[f32; 3]> = before.input_positions.into_iter().map(turn).collect();
            let (expected, found) = (expected.as_flattened(), after.input_positions.as_flattened());
            assert_close("input positions", expected, found, 1e-4);
            assert_close("features", &before.features, &after.features, 1e-5);
        }
    }
}

/// L depends on differences of positions alone, so moving all points together does not change it.
#[test]
fn position_gradients_sum_to_zero() {
    let mut numbers = Numbers(3);
    for options in all_options() {
        for extent in EXTENTS {
            let problem = random_problem(&mut numbers, options.clone(), Parts { extent, ..PLAIN });
            for kernel in Kernel::available() {
                let AllGradients { input_positions, output_positions, .. } = gradients(&problem, kernel);
                let all = || input_positions.iter().chain(&output_positions);
                for axis in 0..3 {
                    let sum: f64 = all().map(|d| f64::from(d[axis])).sum();
                    let magnitude: f64 = all().map(|d| f64::from(d[axis]).abs()).sum();
                    assert!(
                        sum.abs() <= 1e-6 * magnitude.max(1.0),
                        "{sum} of {magnitude}: {:?}",
                        problem.options
                    );
                }
            }
        }
    }
}

#[test]
fn permuting_the_input_points_permutes_the_gradients() {
    let mut numbers = Numbers(4);
    for options in all_options() {
        let problem = random_problem(&mut numbers, options, PLAIN);
        let mut order: Vec<usize> = (0..problem.inputs.len()).collect();
        for k in (1..order.len()).rev() {
            order.swap(k, numbers.below(k + 1));
        }
        let (channels, importance) = (problem.channels.0, problem.importance.as_deref().unwrap_or_default());
        let rows = |values: &[f32]| -> Vec<f32> {
            order.iter().flat_map(|&i| &values[i * channels..(i + 1) * channels]).copied().collect()
        };
        let mut permuted = problem.clone();
        permuted.inputs = order.iter().map(|&i| problem.inputs[i]).collect();
        permuted.features = rows(&problem.features);
        permuted.importance = Some(order.iter().map(|&i| importance[i]).collect());
        permuted.search(false);
        for kernel in Kernel::available() {
            let (before, after) = (gradients(&problem, kernel), gradients(&permuted, kernel));
            assert_close("filter", &before.filter, &after.filter, 1e-5);
            assert_close("features", &rows(&before.features), &after.features, 1e-5);
            let expected: Vec<f32> = order.iter().map(|&i| before.importance[i]).collect();
            assert_close("importance", &expected, &after.importance, 1e-5);
            let expected: Vec<[f32; 3]> = order.iter().map(|&i| before.input_positions[i]).collect();
            let (expected, found) = (expected.as_flattened(), after.input_positions.as_flattened());
            assert_close("input positions", expected, found, 1e-4);
            let expected = before.output_positions.as_flattened();
            assert_close("output positions", expected, after.output_positions.as_flattened(), 1e-4);
        }
    }
}

/// Clouds in one call have the bits of one call a cloud, in every array.
#[test]
fn a_batch_is_one_call_a_cloud() {
    let mut numbers = Numbers(5);
    let options = Options { normalize: true, window: Window::Triangular, ..Options::default() };
    // More than one run of partial sums; clouds of one point and of none.
    let sizes = [(500, 390), (1, 4), (0, 0), (60, 0), (30, 800)];
    let parts = Parts { extent: ExtentKind::PerPoint, ..PLAIN };
    let mut problems: Vec<Problem> = Vec::new();
    for (inputs, outputs) in sizes {
        let (inputs, outputs) = (numbers.points(inputs), numbers.points(outputs));
        problems.push(Problem::new(&mut numbers, options.clone(), inputs, outputs, (9, 20), parts));
    }
    let together = Problem::joined(&problems);
    let starts = |count: fn(&Problem) -> usize| {
        let ends = problems.iter().scan(0, |end, problem| {
            *end += count(problem);
            Some(*end)
        });
        std::iter::once(0).chain(ends).collect::<Vec<_>>()
    };
    let (input_clouds, output_clouds) = (starts(|p| p.inputs.len()), starts(|p| p.outputs.len()));
    for kernel in Kernel::available() {
        for precision in [Precision::F32, Precision::Bf16] {
            let mut alone = AllGradients::default();
            let mut outputs = Vec::new();
            for problem in &problems {
                let problem = Problem {
                    filter: together.filter.clone(),
                    bias: together.bias.clone(),
                    ..problem.clone()
                };
                outputs.extend(forward(&problem, kernel));
                let mut geometry = Geometry::default();
                geometry.build(&problem.options, &problem.sets(), kernel);
                let filter = problem.filter().with_precision(precision);
                alone = add_gradients(alone, &problem, &filter, &mut geometry, &mut Workspace::default());
            }
            assert_eq!(outputs, forward(&together, kernel), "{}", kernel.name());
            let mut geometry = Geometry::default();
            let sets = together.sets().with_clouds(&input_clouds, &output_clouds);
            geometry.build(&together.options, &sets, kernel);
            let filter = together.filter().with_precision(precision);
            let found = all_gradients(&together, &filter, &mut geometry, &mut Workspace::default());
            assert!(found == alone, "{} {precision:?}", kernel.name());
        }
    }
}

/// The factors are rounded to 8 bits, so every product is within 2⁻⁸ of the exact one, and sums of many are nearer.
#[test]
fn bfloat16_is_near_float32_and_the_same_on_every_kernel() {
    let mut numbers = Numbers(6);
    for channels in [(3, 5), (4, 32), (33, 20), (96, 64), (64, 3)] {
        let inputs = numbers.points(151);
        let parts = Parts { pointwise: true, ..PLAIN };
        let problem = Problem::new(&mut numbers, Options::default(), inputs.clone(), inputs, channels, parts);
        let run = |kernel, precision| {
            let mut geometry = Geometry::default();
            geometry.build(&problem.options, &problem.sets(), kernel);
            let filter = problem.filter().with_precision(precision);
            let mut workspace = Workspace::default();
            let mut output = vec![f32::NAN; problem.outputs.len() * channels.1];
            cconv::forward(&geometry, &filter, &problem.features, &mut output, &mut workspace);
            let gradients = all_gradients(&problem, &filter, &mut geometry, &mut workspace);
            (output, gradients)
        };
        let exact = run(Kernel::detect(), Precision::F32);
        let rounded = run(Kernel::detect(), Precision::Bf16);
        let is_rounded = channels.1 > 8 || channels.0 <= 8;
        assert_eq!(exact.0 != rounded.0, is_rounded, "{channels:?}: the output");
        assert_close("output", &exact.0, &rounded.0, 4e-3);
        assert_close("filter", &exact.1.filter, &rounded.1.filter, 4e-3);
        assert_close("pointwise", &exact.1.pointwise, &rounded.1.pointwise, 4e-3);
        assert_close("features", &exact.1.features, &rounded.1.features, 4e-3);
        for kernel in Kernel::available() {
            // Patches that differ in the last bit of float32 may round to neighbouring bfloat16 numbers.
            let other = run(kernel, Precision::Bf16);
            assert_close(kernel.name(), &rounded.0, &other.0, 1e-3);
            assert_close(kernel.name(), &rounded.1.filter, &other.1.filter, 1e-3);
            assert_close(kernel.name(), &rounded.1.features, &other.1.features, 1e-3);
        }
    }
}

//! Every gradient of the float64 reference against central differences, over all combinations of mapping,
//! interpolation, window, kind of extent, normalisation and importance.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

mod common;

use cconv::reference::widen;
use cconv::{Interpolation, Options};
use common::{EXTENTS, Numbers, Parts, Problem, Wide, all_options, largest};

/// The step of the differences. None of the random points lies so near to a kink.
const STEP: f64 = 1e-6;

/// L = Σ output · gradient.
fn loss(wide: &Wide, output_gradient: &[f64]) -> f64 {
    wide.forward().iter().zip(output_gradient).map(|(value, d)| value * d).sum()
}

/// Compares with the differences of L by the values that `place` points to.
fn check(
    name: &str,
    wide: &Wide,
    output_gradient: &[f64],
    gradient: &[f64],
    place: impl Fn(&mut Wide, usize) -> &mut f64,
) {
    let difference = |k: usize| {
        let moved = |step: f64| {
            let mut wide = wide.clone();
            *place(&mut wide, k) += step;
            loss(&wide, output_gradient)
        };
        (moved(STEP) - moved(-STEP)) / (2.0 * STEP)
    };
    let differences: Vec<f64> = (0..gradient.len()).map(difference).collect();
    // Relative to the largest; where there is nothing to differ, to 1.
    let scale = largest(differences.iter().copied()).max(1.0);
    let error = largest(gradient.iter().zip(&differences).map(|(a, b)| a - b)) / scale;
    assert!(error < 1e-6, "{name}: off by {error:.1e} in {:?}", wide.options);
}

fn check_all(problem: &Problem) {
    let wide = problem.wide();
    let output_gradient = widen(&problem.output_gradient);
    let gradients = wide.backward(&output_gradient);
    let check = |name: &str, gradient: &[f64], place: fn(&mut Wide, usize) -> &mut f64| {
        check(name, &wide, &output_gradient, gradient, place);
    };
    check("filter", &gradients.filter, |wide, k| &mut wide.filter[k]);
    check("features", &gradients.features, |wide, k| &mut wide.features[k]);
    if wide.bias.is_some() {
        check("bias", &gradients.bias, |wide, k| &mut wide.bias.as_mut().unwrap()[k]);
    }
    if wide.pointwise.is_some() {
        check("pointwise", &gradients.pointwise, |wide, k| &mut wide.pointwise.as_mut().unwrap()[k]);
    }
    if wide.sets.importance.is_some() {
        check("importance", &gradients.importance, |wide, k| &mut wide.sets.importance.as_mut().unwrap()[k]);
    }
    if wide.sets.window_values.is_some() {
        check("window values", &gradients.window_values, |wide, k| {
            &mut wide.sets.window_values.as_mut().unwrap()[k]
        });
    }
    check("input positions", gradients.input_positions.as_flattened(), |wide, k| {
        &mut wide.sets.inputs[k / 3][k % 3]
    });
    check("output positions", gradients.output_positions.as_flattened(), |wide, k| {
        &mut wide.sets.outputs[k / 3][k % 3]
    });
}

#[test]
fn all_gradients_are_those_of_central_differences() {
    let mut numbers = Numbers(1);
    for options in all_options() {
        for extent in EXTENTS {
            for importance in [false, true] {
                for window_values in [false, true] {
                    let (inputs, outputs) = (numbers.points(5), numbers.points(3));
                    let parts = Parts { extent, importance, window_values, bias: true, pointwise: false };
                    let options = Options { filter_size: [2, 3, 2], ..options.clone() };
                    check_all(&Problem::new(&mut numbers, options, inputs, outputs, (2, 2), parts));
                }
            }
        }
    }
}

#[test]
fn positions_move_all_sizes_of_filters() {
    let mut numbers = Numbers(2);
    for filter_size in [[1, 1, 1], [4, 4, 4], [1, 5, 2], [3, 1, 6]] {
        for interpolation in [Interpolation::Linear, Interpolation::LinearBorder] {
            for offset in [[0.0; 3], [0.6, -1.3, 0.4]] {
                let inputs = numbers.points(7);
                let parts = Parts {
                    extent: EXTENTS[0],
                    importance: true,
                    window_values: false,
                    bias: false,
                    pointwise: true,
                };
                let options = Options { filter_size, interpolation, offset, ..Options::default() };
                let mut problem = Problem::new(&mut numbers, options, inputs.clone(), inputs, (2, 3), parts);
                // A point is at a kink of the mapping around itself.
                problem.search(true);
                check_all(&problem);
            }
        }
    }
}

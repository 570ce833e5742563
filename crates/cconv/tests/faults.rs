//! What callers can get wrong: documented panics that name both numbers, and numbers that are none, which must never
//! lead out of bounds.

mod common;

use std::panic::{AssertUnwindSafe, catch_unwind};

use cconv::{
    Columns, Dense, DenseGradients, Extent, Filter, Geometry, Gradients, Kernel, Options, PairGradient,
    PointGradients, PointSets, Workspace,
};
use common::{EXTENTS, Numbers, Parts, Problem, all_gradients, all_options};
use fluvia_neighbors::Neighbors;

/// The message of the panic of `run`.
fn message(run: impl FnOnce()) -> String {
    let payload = catch_unwind(AssertUnwindSafe(run)).expect_err("a panic");
    match payload.downcast::<String>() {
        Ok(text) => *text,
        Err(payload) => payload.downcast_ref::<&str>().expect("a message").to_string(),
    }
}

/// Fails unless `run` panics with a message that has all of the words.
#[track_caller]
fn refuses(words: &[&str], run: impl FnOnce()) {
    let message = message(run);
    assert!(words.iter().all(|word| message.contains(word)), "{words:?} are not in: {message}");
}

const POINTS: [[f32; 3]; 3] = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0]];

fn neighbors(indices: &[u32], row_splits: &[usize]) -> Neighbors {
    Neighbors { indices: indices.to_vec(), row_splits: row_splits.to_vec(), distances: Vec::new() }
}

fn build(neighbors: &Neighbors, change: impl Fn(PointSets<'_>) -> Geometry) -> Geometry {
    change(PointSets::new(&POINTS, &POINTS[..2], neighbors, Extent::Uniform(1.0)))
}

fn built(sets: &PointSets<'_>) -> Geometry {
    let mut geometry = Geometry::default();
    geometry.build(&Options::default(), sets, Kernel::detect());
    geometry
}

#[test]
fn points_that_do_not_fit_are_refused() {
    let good = neighbors(&[1, 2, 0], &[0, 2, 3]);
    let refuses_list = |words: &[&str], list: &Neighbors| {
        refuses(words, || {
            build(list, |sets| built(&sets));
        });
    };
    build(&good, |sets| built(&sets));
    refuses_list(&["row splits for 2 output points", "2", "3"], &neighbors(&[1, 2], &[0, 2]));
    refuses_list(&["neighbour index 3 of 3 input points"], &neighbors(&[1, 3, 0], &[0, 2, 3]));
    refuses_list(&["row splits must ascend"], &neighbors(&[1, 2, 0], &[0, 4, 3]));
    refuses_list(&["last row split", "2", "3"], &neighbors(&[1, 2, 0], &[0, 2, 2]));

    let refuses_sets = |words: &[&str], change: fn(PointSets<'_>) -> Geometry| {
        refuses(words, || {
            build(&good, change);
        });
    };
    refuses_sets(&["one extent per output point", "3", "2"], |sets| {
        built(&PointSets { extent: Extent::PerPoint(&[1.0; 3]), ..sets })
    });
    for extent in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        refuses(&["extent", &extent.to_string()[..1], "output point 1", "positive"], || {
            let extents = [1.0, extent];
            build(&good, |sets| built(&PointSets { extent: Extent::PerPoint(&extents), ..sets }));
        });
    }
    refuses_sets(&["one importance per input point", "2", "3"], |sets| {
        built(&PointSets { importance: Some(&[1.0; 2]), ..sets })
    });
    refuses_sets(&["one window value per pair", "4", "3"], |sets| {
        built(&PointSets { window_values: Some(&[1.0; 4]), ..sets })
    });
    refuses_sets(&["clouds", "3 points", "2"], |sets| built(&sets.with_clouds(&[0, 2], &[0, 2])));
    refuses_sets(&["input and output clouds", "3", "2"], |sets| {
        built(&sets.with_clouds(&[0, 1, 3], &[0, 2]))
    });
    refuses_sets(&["0 filter cells"], |sets| {
        let options = Options { filter_size: [4, 0, 4], ..Options::default() };
        let mut geometry = Geometry::default();
        geometry.build(&options, &sets, Kernel::detect());
        geometry
    });
}

#[test]
fn layers_that_do_not_fit_are_refused() {
    let options = Options::default();
    let list = neighbors(&[1, 2, 0], &[0, 2, 3]);
    let sets = PointSets::new(&POINTS, &POINTS[..2], &list, Extent::Uniform(1.0));
    let mut geometry = built(&sets);
    let filter = Filter::new(&options, 2, 3, &[0.0; 64 * 6]);
    let (features, by_output) = ([0.0; 6], [0.0; 6]);
    let workspace = &mut Workspace::default();

    for count in [64 * 6 - 1, 65 * 6] {
        refuses(&[&count.to_string(), "384", "64 cells x 2 x 3"], || {
            Filter::new(&options, 2, 3, &vec![0.0; count]);
        });
    }
    refuses(&["one bias per output channel", "2", "3"], || {
        filter.clone().with_bias(&[0.0; 2]);
    });
    refuses(&["pointwise weights", "5", "6"], || {
        filter.clone().with_pointwise(&[0.0; 5]);
    });
    refuses(&["features of 3 input points", "5", "6"], || {
        cconv::forward(&geometry, &filter, &features[..5], &mut [0.0; 6], &mut Workspace::default());
    });
    refuses(&["2 rows of 3 values", "5", "6"], || {
        cconv::forward(&geometry, &filter, &features, &mut [0.0; 5], &mut Workspace::default());
    });
    refuses(&["columns 2.. of rows of 4 values"], || {
        let columns = Columns { values: &mut [0.0; 8], stride: 4, first: 2 };
        cconv::forward_into(&geometry, &filter, &features, columns, &mut Workspace::default());
    });
    refuses(&["cells of the filter and of the geometry", "27", "64"], || {
        let options = Options { filter_size: [3; 3], ..Options::default() };
        let filter = Filter::new(&options, 2, 3, &[0.0; 27 * 6]);
        cconv::forward(&geometry, &filter, &features, &mut [0.0; 6], &mut Workspace::default());
    });
    refuses(&["pointwise term needs the same", "3", "2"], || {
        let filter = filter.clone().with_pointwise(&[0.0; 6]);
        cconv::forward(&geometry, &filter, &features, &mut [0.0; 6], &mut Workspace::default());
    });

    refuses(&["prepare_backward"], || {
        let gradients = Gradients { features: Some(&mut [0.0; 6]), ..Gradients::default() };
        cconv::backward(&geometry, &filter, &features, &by_output, gradients, &mut Workspace::default());
    });
    geometry.prepare_backward();
    let mut backward = |gradients: Gradients<'_>| {
        cconv::backward(&geometry, &filter, &features, &by_output, gradients, workspace);
    };
    refuses(&["gradient of the filter", "6", "384"], || {
        backward(Gradients { filter: Some(&mut [0.0; 6]), ..Gradients::default() });
    });
    refuses(&["one bias per output channel", "2", "3"], || {
        backward(Gradients { bias: Some(&mut [0.0; 2]), ..Gradients::default() });
    });
    refuses(&["gradient of the features", "4", "6"], || {
        backward(Gradients { features: Some(&mut [0.0; 4]), ..Gradients::default() });
    });
    refuses(&["pointwise term that the filter does not have"], || {
        backward(Gradients { pointwise: Some(&mut [0.0; 6]), ..Gradients::default() });
    });
    refuses(&["gradient of the pairs of this geometry", "0", "1"], || {
        backward(Gradients { pairs: Some(&mut PairGradient::default()), ..Gradients::default() });
    });
    refuses(&["gradients of 2 output points, 3 channels", "5", "6"], || {
        let gradients = Gradients::default();
        cconv::backward(&geometry, &filter, &features, &by_output[..5], gradients, &mut Workspace::default());
    });

    let mut pairs = PairGradient::default();
    pairs.reset(&geometry);
    refuses(&["one derivative per point", "2", "3"], || {
        let wanted =
            PointGradients { input_positions: Some(&mut [[0.0; 3]; 2]), ..PointGradients::default() };
        geometry.backward(&sets, &pairs, wanted);
    });
    refuses(&["points of the build", "(3, 2)", "(3, 3)"], || {
        let list = neighbors(&[1, 2, 0], &[0, 2, 3, 3]);
        let sets = PointSets::new(&POINTS, &POINTS, &list, Extent::Uniform(1.0));
        geometry.backward(&sets, &pairs, PointGradients::default());
    });

    let dense = Dense::new(2, &[0.0; 6], &[0.0; 3]);
    refuses(&["clouds", "2 points", "[0, 1]"], || {
        let (wanted, workspace) = (DenseGradients::default(), &mut Workspace::default());
        cconv::dense_backward(&dense, &[0.0; 4], &[0.0; 6], &[0, 1], wanted, workspace, Kernel::detect());
    });
    refuses(&["gradients of 2 points, 3 channels", "5", "6"], || {
        let (wanted, workspace) = (DenseGradients::default(), &mut Workspace::default());
        cconv::dense_backward(&dense, &[0.0; 4], &[0.0; 5], &[], wanted, workspace, Kernel::detect());
    });
    refuses(&["weights are [in, out]", "5", "6"], || {
        Dense::new(2, &[0.0; 5], &[0.0; 3]);
    });
}

/// Values that are no numbers show in what is computed from them; positions that are none are refused.
#[test]
fn numbers_that_are_none_are_seen_or_refused() {
    let list = neighbors(&[1, 2, 0], &[0, 2, 3]);
    for bad in [f32::NAN, f32::INFINITY] {
        let points = [[0.0; 3], [0.1, bad, 0.0], [0.0, 0.2, 0.0]];
        refuses(&["input point 1", "finite"], || {
            built(&PointSets::new(&points, &POINTS[..2], &list, Extent::Uniform(1.0)));
        });
        refuses(&["output point 1", "finite"], || {
            built(&PointSets::new(&POINTS, &points[..2], &list, Extent::Uniform(1.0)));
        });
        let options = Options::default();
        for kernel in Kernel::available() {
            let sets = PointSets::new(&POINTS, &POINTS[..2], &list, Extent::Uniform(1.0));
            let mut geometry = Geometry::default();
            geometry.build(&options, &sets, kernel);
            let filter = Filter::new(&options, 1, 1, &[0.1; 64]);
            let mut output = [0.0; 2];
            let workspace = &mut Workspace::default();
            cconv::forward(&geometry, &filter, &[1.0, bad, 1.0], &mut output, workspace);
            assert!(!output[0].is_finite() && output[1].is_finite(), "{output:?}");
        }
    }
}

/// Numbers that are none, and positions as far apart as they can be, go through every kernel, both ways, without a panic
/// and without a read out of bounds.
#[test]
fn absurd_numbers_stay_within_bounds() {
    let mut numbers = Numbers(1);
    let parts =
        Parts { extent: EXTENTS[2], importance: true, window_values: false, bias: true, pointwise: false };
    for options in all_options() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e30, 1e-40] {
            let (inputs, outputs) = (numbers.points(20), numbers.points(9));
            let mut problem = Problem::new(&mut numbers, options.clone(), inputs, outputs, (9, 5), parts);
            // After the search, which would not find them.
            let far = if bad.is_finite() { bad } else { f32::MAX };
            problem.inputs[3] = [far, 0.1, 0.1];
            problem.inputs[4] = [far; 3];
            problem.outputs[1] = [0.0, 0.0, -far];
            problem.features[17] = bad;
            problem.filter[40] = bad;
            problem.output_gradient[7] = bad;
            problem.importance.as_mut().expect("importance")[5] = bad;
            for kernel in Kernel::available() {
                let (mut geometry, mut workspace) = (Geometry::default(), Workspace::default());
                geometry.build(&problem.options, &problem.sets(), kernel);
                let mut output = vec![0.0; problem.outputs.len() * 5];
                cconv::forward(&geometry, &problem.filter(), &problem.features, &mut output, &mut workspace);
                let found = all_gradients(&problem, &problem.filter(), &mut geometry, &mut workspace);
                assert_eq!(found.features.len(), problem.features.len());
            }
        }
    }
}

//! On the points of a grid, with the identity mapping and nearest neighbours, the operator is a dense 3-D
//! convolution (Eq. 5).

use cconv::{
    Extent, Filter, Geometry, Interpolation, Kernel, Mapping, Options, PointSets, Window, Workspace,
};
use fluvia_neighbors::{Metric, Options as SearchOptions, Radius, brute_force};

#[test]
fn equals_a_dense_convolution_on_grid_points() {
    const N: usize = 6;
    const SPACING: f32 = 0.5;
    const CHANNELS_IN: usize = 5;
    const CHANNELS_OUT: usize = 7;
    let numbers = |count: usize, step: f32| (0..count).map(|k| (k as f32 * step).sin()).collect::<Vec<_>>();
    let index = |x: usize, y: usize, z: usize| (z * N + y) * N + x;
    let mut points = vec![[0.0; 3]; N * N * N];
    for (x, y, z) in cells(N) {
        points[index(x, y, z)] = [x, y, z].map(|k| k as f32 * SPACING);
    }
    let features = numbers(points.len() * CHANNELS_IN, 0.7);
    let filter = numbers(27 * CHANNELS_IN * CHANNELS_OUT, 1.3);
    let options = Options {
        filter_size: [3, 3, 3],
        mapping: Mapping::Identity,
        interpolation: Interpolation::Nearest,
        align_corners: false,
        window: Window::None,
        ..Options::default()
    };
    // A cube of 3 × 3 × 3 grid points: the largest distance along an axis is one spacing.
    let search = SearchOptions { metric: Metric::Linf, ..SearchOptions::default() };
    let neighbors = brute_force(&points, &points, Radius::Uniform(1.1 * SPACING), &search);
    let sets = PointSets::new(&points, &points, &neighbors, Extent::Uniform(3.0 * SPACING));

    let mut expected = vec![0.0f64; points.len() * CHANNELS_OUT];
    for (x, y, z) in cells(N) {
        for (i, j, k) in cells(3) {
            let at = |a: usize, b: usize| (a + b).checked_sub(1).filter(|&c| c < N);
            let (Some(u), Some(v), Some(w)) = (at(x, i), at(y, j), at(z, k)) else { continue };
            for c in 0..CHANNELS_IN {
                for o in 0..CHANNELS_OUT {
                    let g = filter[(((k * 3 + j) * 3 + i) * CHANNELS_IN + c) * CHANNELS_OUT + o];
                    let f = features[index(u, v, w) * CHANNELS_IN + c];
                    expected[index(x, y, z) * CHANNELS_OUT + o] += f64::from(f) * f64::from(g);
                }
            }
        }
    }
    for kernel in Kernel::available() {
        let mut geometry = Geometry::default();
        geometry.build(&options, &sets, kernel);
        let filter = Filter::new(&options, CHANNELS_IN, CHANNELS_OUT, &filter);
        let mut output = vec![0.0; expected.len()];
        cconv::forward(&geometry, &filter, &features, &mut output, &mut Workspace::default());
        for (value, expected) in output.iter().zip(&expected) {
            // Float32 rounding of 135 products of numbers below 1.
            assert!((f64::from(*value) - expected).abs() < 1e-4, "{value} {expected}");
        }
    }
}

fn cells(n: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..n * n * n).map(move |k| (k % n, k / n % n, k / (n * n)))
}

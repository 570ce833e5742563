//! The grid against its specification, `brute_force`.

use fluvia_neighbors::{Grid, Grids, Metric, Neighbors, Options, Point, Radius, Transpose, brute_force};
use proptest::prelude::*;

/// Rows as sorted sets: the order inside a row is not part of the contract.
fn sorted_rows(neighbors: &Neighbors) -> Vec<Vec<(u32, u32)>> {
    (0..neighbors.queries())
        .map(|q| {
            let mut row: Vec<_> = (neighbors.row_splits[q]..neighbors.row_splits[q + 1])
                .map(|k| (neighbors.indices[k], neighbors.distances.get(k).map_or(0, |d| d.to_bits())))
                .collect();
            row.sort_unstable();
            row
        })
        .collect()
}

fn assert_agree(points: &[Point], queries: &[Point], radius: Radius<'_>, cell: f32, options: &Options) {
    let mut grid = Grid::new();
    let mut found = Neighbors::default();
    // Built and searched twice, so that what is left in the reused memory would show.
    grid.build(&[[1.0, 2.0, 3.0]; 5], 0.3);
    grid.search(points, Radius::Uniform(1.0), options, &mut found);
    grid.build(points, cell);
    grid.search(queries, radius, options, &mut found);
    let expected = brute_force(points, queries, radius, options);
    assert_eq!(sorted_rows(&found), sorted_rows(&expected));
    let mut order = grid.order().to_vec();
    order.sort_unstable();
    assert!(order.iter().enumerate().all(|(i, &o)| i == o as usize), "the order is a permutation");
}

fn metric() -> impl Strategy<Value = Metric> {
    prop_oneof![Just(Metric::L1), Just(Metric::L2), Just(Metric::Linf)]
}

fn cloud(size: impl Into<proptest::collection::SizeRange>) -> impl Strategy<Value = Vec<Point>> {
    // Multiples of 1/8 give coincident points and distances exactly at the radius.
    let coordinate = prop_oneof![(-8i8..8).prop_map(|k| f32::from(k) / 8.0), -1.0f32..1.0];
    proptest::collection::vec(proptest::array::uniform3(coordinate), size)
}

proptest! {
    #[test]
    fn grid_equals_brute_force(
        points in cloud(0..200), queries in cloud(0..80), radius in 0.01f32..0.7, cell in 0.05f32..0.9,
        metric in metric(), ignore_coincident: bool, distances: bool, scale in prop_oneof![Just(1.0f32), Just(1e-3), Just(1e4)],
        shift in prop_oneof![Just(0.0f32), Just(-3e5), Just(7e7)],
    ) {
        let moved = |cloud: Vec<Point>| -> Vec<Point> {
            cloud.into_iter().map(|p| p.map(|x| x * scale + shift)).collect()
        };
        let (points, queries) = (moved(points), moved(queries));
        let options = Options { metric, ignore_coincident, distances };
        assert_agree(&points, &queries, Radius::Uniform(radius * scale), cell * scale, &options);
        let radii: Vec<f32> = (0..queries.len()).map(|q| radius * scale * (q % 4) as f32 / 2.0).collect();
        assert_agree(&points, &queries, Radius::PerQuery(&radii), cell * scale, &options);
        assert_agree(&points, &points, Radius::Uniform(radius * scale), cell * scale, &options);
    }
}

#[test]
fn clouds_far_apart_need_no_dense_table() {
    let mut points = Vec::new();
    for center in [-1e9f32, 0.0, 3e5, 1e9] {
        points.extend((0..50).map(|i| [center, (i % 7) as f32, (i / 7) as f32]));
    }
    for radius in [0.5, 1.0, 2.5, 1e6, 3e9] {
        assert_agree(&points, &points, Radius::Uniform(radius), 1.0, &Options::default());
    }
}

#[test]
fn points_that_are_not_finite_are_not_found() {
    let points =
        [[0.0; 3], [f32::NAN, 0.0, 0.0], [f32::INFINITY; 3], [f32::NEG_INFINITY, 0.0, 0.0], [0.5, 0.0, 0.0]];
    let options = Options { ignore_coincident: true, ..Options::default() };
    assert_agree(&points, &points, Radius::Uniform(1.0), 1.0, &options);
}

#[test]
fn radii_that_are_no_radius_find_nothing() {
    let points = [[0.0f32; 3]; 4];
    let radii = [-1.0, f32::NAN, f32::INFINITY, 0.0];
    let mut grid = Grid::new();
    let mut found = Neighbors::default();
    grid.build(&points, 1.0);
    grid.search(&points, Radius::PerQuery(&radii), &Options::default(), &mut found);
    assert_eq!(found.row_splits, [0, 0, 0, 0, 4]);
}

#[test]
fn empty_sets_have_empty_rows() {
    let mut grid = Grid::new();
    let mut found = Neighbors::default();
    grid.build(&[], 1.0);
    grid.search(&[], Radius::Uniform(1.0), &Options::default(), &mut found);
    assert_eq!((found.queries(), found.row_splits.len()), (0, 1));
    grid.search(&[[0.0; 3]; 3], Radius::Uniform(1.0), &Options::default(), &mut found);
    assert_eq!(found.row_splits, [0; 4]);
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let points: Vec<Point> = (0..3000u32)
        .map(|i| [i, i.wrapping_mul(7919), i.wrapping_mul(104_729)].map(|k| (k % 1000) as f32 / 1000.0))
        .collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (mut grid, mut found) = (Grid::new(), Neighbors::default());
            grid.build(&points, 0.1);
            grid.search(&points, Radius::Uniform(0.1), &Options::default(), &mut found);
            found
        })
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn the_transpose_lists_every_pair_once() {
    let points: Vec<Point> = (0..60u8).map(|i| [f32::from(i % 5), f32::from(i / 5), 0.0]).collect();
    let neighbors = brute_force(&points, &points[..20], Radius::Uniform(1.5), &Options::default());
    // Twice, so that what is left in memory from the first build would show.
    let mut transposed = Transpose::default();
    transposed.build(&brute_force(&points, &points, Radius::Uniform(2.0), &Options::default()), points.len());
    transposed.build(&neighbors, points.len());
    let Transpose { queries, pairs } = &transposed;
    assert_eq!(queries.indices.len(), neighbors.indices.len());
    assert_eq!(pairs.len(), neighbors.indices.len());
    assert_eq!(queries.queries(), points.len());
    for point in 0..points.len() {
        assert!(queries.row(point).is_sorted());
        let row = queries.row_splits[point]..queries.row_splits[point + 1];
        for (&q, &pair) in queries.indices[row.clone()].iter().zip(&pairs[row]) {
            let (q, pair) = (q as usize, pair as usize);
            assert_eq!(neighbors.indices[pair] as usize, point);
            assert!((neighbors.row_splits[q]..neighbors.row_splits[q + 1]).contains(&pair));
        }
    }
}

#[test]
fn clouds_are_searched_as_one_call_each() {
    let points: Vec<Point> =
        (0..90u8).map(|i| [f32::from(i % 7), f32::from(i % 11), f32::from(i % 3)]).collect();
    let radii: Vec<f32> = (0..90u8).map(|i| 0.5 + f32::from(i % 4)).collect();
    let options = Options { distances: true, ignore_coincident: true, ..Options::default() };
    for clouds in [vec![0, 90], vec![0, 0, 40, 41, 90], vec![0]] {
        let points = &points[..clouds[clouds.len() - 1]];
        let radii = &radii[..points.len()];
        for radius in [Radius::Uniform(1.5), Radius::PerQuery(radii)] {
            let (mut grids, mut together) = (Grids::new(), Neighbors::default());
            grids.build(points, &clouds, 1.5);
            grids.search(points, &clouds, radius, &options, &mut together);
            assert_eq!(together.queries(), points.len());
            for cloud in clouds.windows(2) {
                let rows = cloud[0]..cloud[1];
                let (mut grid, mut alone) = (Grid::new(), Neighbors::default());
                grid.build(&points[rows.clone()], 1.5);
                let radius = match radius {
                    Radius::PerQuery(radii) => Radius::PerQuery(&radii[rows.clone()]),
                    uniform => uniform,
                };
                grid.search(&points[rows.clone()], radius, &options, &mut alone);
                let order: Vec<u32> = grid.order().iter().map(|i| i + cloud[0] as u32).collect();
                assert_eq!(&grids.order()[rows.clone()], order);
                for (q, row) in rows.enumerate() {
                    let expected: Vec<u32> = alone.row(q).iter().map(|i| i + cloud[0] as u32).collect();
                    assert_eq!(together.row(row), expected);
                    assert_eq!(
                        together.distances[together.row_splits[row]..together.row_splits[row + 1]],
                        alone.distances[alone.row_splits[q]..alone.row_splits[q + 1]]
                    );
                }
            }
        }
    }
}

#[test]
fn the_ends_of_float32_agree_with_brute_force() {
    let far = 3e38;
    let points: Vec<Point> =
        vec![[-1e30; 3], [1e30; 3], [0.0; 3], [1e-24, 0.0, 0.0], [far, -far, far], [1.0, 0.0, 0.0]];
    for metric in [Metric::L1, Metric::L2, Metric::Linf] {
        let options = Options { metric, ..Options::default() };
        for radius in [0.0, 1e-30, 1e-25, 1e-19, 1e-18, 0.5, 1.0, 1e18, 1e19, 1e20, 1e38] {
            let expected = brute_force(&points, &points, Radius::Uniform(radius), &options);
            for cell_size in [1e-20, 1.0, 1e20] {
                let (mut grid, mut found) = (Grid::new(), Neighbors::default());
                grid.build(&points, cell_size);
                grid.search(&points, Radius::Uniform(radius), &options, &mut found);
                for q in 0..points.len() {
                    let (mut row, mut expected) = (found.row(q).to_vec(), expected.row(q).to_vec());
                    row.sort_unstable();
                    expected.sort_unstable();
                    assert_eq!(row, expected, "{metric:?} radius {radius:e} cells {cell_size:e} query {q}");
                }
            }
        }
    }
}

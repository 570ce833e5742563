//! Building the grid and finding all pairs of a block of fluid: 18³ points near a lattice of spacing 0.05,
//! radius 0.1125, about 45 neighbours each.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use fluvia_neighbors::{Grid, Neighbors, Options, Point, Radius};

const SIDE: usize = 18;
const SPACING: f32 = 0.05;
const RADIUS: f32 = 0.1125;

/// Lattice points, each moved by up to a tenth of the spacing.
fn block() -> Vec<Point> {
    let shift = |k: usize| (k as f32 * 12.9898).sin() * 0.1 * SPACING;
    (0..SIDE * SIDE * SIDE)
        .map(|i| {
            let cell = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)];
            std::array::from_fn(|axis| cell[axis] as f32 * SPACING + shift(3 * i + axis))
        })
        .collect()
}

fn search(c: &mut Criterion) {
    let points = block();
    let (mut grid, mut found) = (Grid::new(), Neighbors::default());
    c.bench_function("build", |b| b.iter(|| grid.build(black_box(&points), RADIUS)));
    for (name, distances) in [("search", false), ("search with distances", true)] {
        let options = Options { ignore_coincident: true, distances, ..Options::default() };
        c.bench_function(name, |b| {
            b.iter(|| grid.search(black_box(&points), Radius::Uniform(RADIUS), &options, &mut found));
        });
    }
}

criterion_group!(benches, search);
criterion_main!(benches);

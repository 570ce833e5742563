//! The stages of the operator on a block of fluid: 18³ points near a lattice of spacing 0.05, radius 0.1125,
//! about 45 neighbours each, the layers of the published network; and the matrix product alone.

use std::hint::black_box;

use cconv::{
    Columns, Dense, Extent, Filter, Geometry, Kernel, Options, PointSets, Workspace, dense, forward,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use fluvia_neighbors::{Grid, Neighbors, Options as SearchOptions, Radius};

const SIDE: usize = 18;
const SPACING: f32 = 0.05;
const RADIUS: f32 = 0.1125;

/// Lattice points, each moved by up to a tenth of the spacing.
fn block() -> Vec<[f32; 3]> {
    let shift = |k: usize| (k as f32 * 12.9898).sin() * 0.1 * SPACING;
    (0..SIDE * SIDE * SIDE)
        .map(|i| {
            let cell = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)];
            std::array::from_fn(|axis| cell[axis] as f32 * SPACING + shift(3 * i + axis))
        })
        .collect()
}

fn values(count: usize) -> Vec<f32> {
    (0..count).map(|k| (k as f32 * 0.7).sin()).collect()
}

fn operator(c: &mut Criterion) {
    let points = block();
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    grid.build(&points, RADIUS);
    let search = SearchOptions { ignore_coincident: true, ..SearchOptions::default() };
    grid.search(&points, Radius::Uniform(RADIUS), &search, &mut neighbors);
    let options = Options::default();
    let sets = PointSets::new(&points, &points, &neighbors, Extent::Uniform(2.0 * RADIUS));
    let (mut geometry, mut workspace) = (Geometry::default(), Workspace::default());
    for kernel in Kernel::available() {
        let mut group = c.benchmark_group(kernel.name());
        group.sample_size(20);
        group.throughput(Throughput::Elements(neighbors.indices.len() as u64));
        group.bench_function("geometry", |b| b.iter(|| geometry.build(&options, black_box(&sets), kernel)));
        for (inputs, outputs) in [(4, 32), (96, 64), (64, 64), (64, 3)] {
            // Two operations for each weight of 64 cells and the pointwise term.
            let operations = 2 * 65 * inputs * outputs * points.len();
            group.throughput(Throughput::Elements(operations as u64));
            let filter = Filter::new(&options, inputs, outputs, &values(64 * inputs * outputs))
                .with_pointwise(&values(inputs * outputs));
            let features = values(points.len() * inputs);
            let mut output = vec![0.0; points.len() * outputs];
            group.bench_function(format!("forward {inputs} to {outputs}"), |b| {
                b.iter(|| forward(&geometry, &filter, black_box(&features), &mut output, &mut workspace));
            });
        }
        // The matrix product of the 64 to 64 layer alone, on ready patches of some of the points.
        let (rows, depth, outputs) = (1200, 65 * 64, 64);
        group.throughput(Throughput::Elements((2 * rows * depth * outputs) as u64));
        let layer = Dense::new(depth, &values(depth * outputs), &values(outputs));
        let patches = values(rows * depth);
        let mut output = vec![0.0; rows * outputs];
        group.bench_function("matrix product", |b| {
            b.iter(|| {
                let columns = Columns { values: &mut output, stride: outputs, first: 0 };
                dense(&layer, black_box(&patches), columns, &mut workspace, kernel);
            });
        });
    }
}

criterion_group!(benches, operator);
criterion_main!(benches);

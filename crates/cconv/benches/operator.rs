//! The stages of the operator on a block of fluid: 18³ points near a lattice of spacing 0.05, radius 0.1125,
//! about 45 neighbours each, the layers of the published network; and the matrix product alone.

use std::hint::black_box;

use cconv::{
    Columns, Dense, Extent, Filter, Geometry, Gradients, Kernel, Options, PairGradient, PointGradients,
    PointSets, Workspace, backward, dense, forward,
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
        group.bench_function("geometry for the backward pass", |b| {
            b.iter(|| {
                geometry.build(&options, black_box(&sets), kernel);
                geometry.prepare_backward();
            });
        });
        geometry.prepare_backward();
        let mut pairs = PairGradient::default();
        pairs.reset(&geometry);
        let (mut by_input, mut by_output) = (vec![[0.0; 3]; points.len()], vec![[0.0; 3]; points.len()]);
        group.bench_function("geometry backward", |b| {
            b.iter(|| {
                let gradients = PointGradients {
                    input_positions: Some(&mut by_input),
                    output_positions: Some(&mut by_output),
                    ..PointGradients::default()
                };
                geometry.backward(black_box(&sets), &pairs, gradients);
            });
        });
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
            let mut by_filter = vec![0.0; 64 * inputs * outputs];
            let (mut by_pointwise, mut by_bias) = (vec![0.0; inputs * outputs], vec![0.0; outputs]);
            let mut by_features = vec![0.0; features.len()];
            group.bench_function(format!("backward {inputs} to {outputs}"), |b| {
                b.iter(|| {
                    let gradients = Gradients {
                        filter: Some(&mut by_filter),
                        pointwise: Some(&mut by_pointwise),
                        bias: Some(&mut by_bias),
                        features: Some(&mut by_features),
                        pairs: None,
                    };
                    backward(&geometry, &filter, &features, black_box(&output), gradients, &mut workspace);
                });
            });
            group.bench_function(format!("backward to pairs {inputs} to {outputs}"), |b| {
                b.iter(|| {
                    let gradients = Gradients { pairs: Some(&mut pairs), ..Gradients::default() };
                    backward(&geometry, &filter, &features, black_box(&output), gradients, &mut workspace);
                });
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

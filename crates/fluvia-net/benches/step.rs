//! One step of a network of the published size with made-up weights, on a block of 18³ particles over a floor:
//! the search alone, and the whole step.

use cconv::Kernel;
use criterion::{Criterion, criterion_group, criterion_main};
use fluvia_net::config::Config;
use fluvia_net::solver::NetSolver;
use fluvia_net::weights::Weights;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::Solver;

const SIDE: usize = 18;
const SPACING: f32 = 0.05;
const GRAVITY: Acceleration<'_> = Acceleration::Uniform([0.0, -9.81, 0.0]);

fn block() -> Particles {
    let count = SIDE * SIDE * SIDE;
    let position = (0..count)
        .map(|i| [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)].map(|cell| cell as f32 * SPACING))
        .collect();
    Particles::of_one_body(position, vec![[0.0; 3]; count])
}

fn floor() -> Boundary {
    let side = 2 * SIDE as i32;
    let position: Vec<[f32; 3]> = (-side..2 * side)
        .flat_map(|x| (-side..2 * side).map(move |z| [x as f32, -2.0, z as f32].map(|c| c * 0.5 * SPACING)))
        .collect();
    Boundary { normal: vec![[0.0, 1.0, 0.0]; position.len()], position }
}

fn step(c: &mut Criterion) {
    let weights = Weights::zeros(Config::default(), 32, &[64, 64]);
    let mut group = c.benchmark_group("network");
    group.sample_size(20);
    let start = block();
    let mut solver =
        NetSolver::new(&weights, &floor(), &[None], Kernel::detect()).expect("weights that fit each other");
    group.bench_function("search", |b| b.iter(|| solver.search(&start, GRAVITY)));
    group.bench_function("step", |b| {
        b.iter_batched_ref(
            || start.clone(),
            |particles| solver.step(particles, GRAVITY, Config::default().dt).expect("a step"),
            criterion::BatchSize::LargeInput,
        );
    });
}

criterion_group!(benches, step);
criterion_main!(benches);

//! One step of the published network in bfloat16 against float32, on a state in the middle of an impact.

mod common;

use std::path::Path;

use cconv::{Kernel, Precision};
use fluvia_net::solver::NetSolver;
use fluvia_net::weights::{self, Weights};
use fluvia_sim::frames::npz::read_arrays;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::Solver;

/// A state with its walls: pos, vel, box, box_normals.
fn state(path: &Path) -> (Particles, Boundary) {
    let arrays = read_arrays(path).expect("a readable state");
    let points = |name: &str| -> Vec<[f32; 3]> {
        arrays[name].values.chunks_exact(3).map(|p| [p[0] as f32, p[1] as f32, p[2] as f32]).collect()
    };
    let (position, velocity) = (points("pos"), points("vel"));
    let particles = Particles::of_one_body(position, velocity);
    (particles, Boundary { position: points("box"), normal: points("box_normals") })
}

/// The distances between one step in float32 and one in bfloat16, sorted, metres.
fn distances(weights: &Weights, start: &Particles, boundary: &Boundary, kernel: Kernel) -> Vec<f32> {
    let step = |precision| {
        let mut particles = start.clone();
        let solver = NetSolver::new(weights, boundary, &[None], kernel).expect("a network");
        let gravity = Acceleration::Uniform(weights.config.gravity);
        solver.with_precision(precision).step(&mut particles, gravity, weights.config.dt).expect("a step");
        particles.position
    };
    let pairs = step(Precision::F32).into_iter().zip(step(Precision::Bf16));
    let distance = |(a, b): ([f32; 3], [f32; 3])| -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt()
    };
    let mut distances: Vec<f32> = pairs.map(distance).collect();
    distances.sort_by(f32::total_cmp);
    distances
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

#[test]
fn a_step_of_the_published_network_is_near_float32() {
    let files = ["official/pretrained_model_weights.pt", "bench/state_6k.npz"].map(common::reference);
    let [Some(weights), Some(start)] = files else { return };
    let weights = weights::load(weights).expect("the published weights");
    let (start, boundary) = state(&start);
    let distances = distances(&weights, &start, &boundary, Kernel::detect());
    let (mean, largest) = (mean(&distances), distances[distances.len() - 1]);
    let percentile = distances[distances.len() * 99 / 100];
    // A particle moves some millimetres relative to free fall in a step.
    assert!(mean > 0.0 && mean <= 2e-5, "mean {mean:.1e} m");
    assert!(percentile <= 5e-5, "99th percentile {percentile:.1e} m");
    assert!(largest <= 2e-4, "largest {largest:.1e} m");
}

#[test]
fn every_kernel_rounds_alike() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/golden");
    let weights = weights::load(fixtures.join("net.pt")).expect("the small network");
    let (start, boundary) = state(&fixtures.join("net.npz"));
    let means: Vec<f32> = Kernel::available()
        .into_iter()
        .map(|kernel| mean(&distances(&weights, &start, &boundary, kernel)))
        .collect();
    assert!(means[0] > 0.0, "bfloat16 rounds");
    for (mean, kernel) in means.iter().zip(Kernel::available()) {
        // Kernels differ in the last bit of float32, and so in few of the bfloat16 factors.
        assert!(
            (mean / means[0] - 1.0).abs() < 0.05,
            "{}: {mean:.2e} m, not {:.2e}",
            kernel.name(),
            means[0]
        );
    }
}

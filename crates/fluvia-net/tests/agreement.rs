//! The solver against its float64 reference: every kernel, both integrations, with and without the viscosity as an
//! input, accelerations of each particle, and awkward numbers of particles.

mod numbers;

use cconv::Kernel;
use fluvia_net::config::Integration;
use fluvia_net::reference::{self, Network, State, World};
use fluvia_net::solver::NetSolver;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::Solver;
use numbers::{Numbers, ablations, config, weights};

fn particles(count: usize, numbers: &mut Numbers) -> Particles {
    Particles {
        position: (0..count).map(|_| numbers.point(0.15)).collect(),
        velocity: (0..count).map(|_| numbers.point(1.0)).collect(),
        id: (0..count as u32).collect(),
        body: (0..count as u32).map(|i| i % 2).collect(),
        memory: Vec::new(),
    }
}

#[test]
fn a_step_equals_the_reference() {
    let mut numbers = Numbers(1);
    // The first body has a viscosity of its own, the second that of the weights.
    let viscosity = [Some(0.25), None];
    let usual = [
        config(Integration::Paper, &[]),
        config(Integration::Paper, &["viscosity"]),
        config(Integration::Velocity, &[]),
        config(Integration::Velocity, &["viscosity"]),
    ];
    for config in usual.into_iter().chain(ablations()) {
        let integration = config.integration;
        let extra_inputs = config.extra_inputs.clone();
        let weights = weights(config, &mut numbers);
        let dt = weights.config.dt;
        for count in [0, 1, 13, 90] {
            let start = particles(count, &mut numbers);
            let boundary = Boundary {
                position: (0..40).map(|_| numbers.point(0.2)).collect(),
                normal: (0..40).map(|_| numbers.point(1.0)).collect(),
            };
            let accelerations: Vec<[f32; 3]> = (0..count).map(|_| numbers.point(9.81)).collect();
            let acceleration = Acceleration::PerParticle(&accelerations);
            let wide = |values: &[[f32; 3]]| values.iter().map(|v| v.map(f64::from)).collect();
            let state = State { position: wide(&start.position), velocity: wide(&start.velocity) };
            let extra: Vec<f64> = start
                .body
                .iter()
                .map(|&body| f64::from(viscosity[body as usize].unwrap_or(weights.config.viscosity)))
                .filter(|_| !extra_inputs.is_empty())
                .collect();
            let world = World { extra: &extra, boundary: &boundary, acceleration };
            let expected = reference::step(&Network::from(&weights), &state, world);
            for kernel in Kernel::available() {
                let mut moved = start.clone();
                let mut solver = NetSolver::new(&weights, &boundary, &viscosity, kernel).unwrap();
                // Twice, so that what is left in the memory of the first step would show.
                solver.step(&mut moved.clone(), acceleration, dt).unwrap();
                solver.step(&mut moved, acceleration, dt).unwrap();
                let pairs = moved.position.iter().flatten().zip(expected.position.iter().flatten());
                let error = pairs.map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
                // Float32 positions below 0.3 m, and corrections of some centimetres computed in float32.
                assert!(error < 1e-6, "{integration:?} {count} {}: off by {error:.1e} m", kernel.name());
                let pairs = moved.velocity.iter().flatten().zip(expected.velocity.iter().flatten());
                let error = pairs.map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
                assert!(error < 1e-4, "{integration:?} {count} {}: off by {error:.1e} m/s", kernel.name());
            }
        }
    }
}

#[test]
fn rollouts_are_the_same_bits_at_any_number_of_threads() {
    let mut numbers = Numbers(2);
    let weights = weights(config(Integration::Paper, &[]), &mut numbers);
    let start = particles(700, &mut numbers);
    let boundary = Boundary {
        position: (0..300).map(|_| numbers.point(0.2)).collect(),
        normal: (0..300).map(|_| numbers.point(1.0)).collect(),
    };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut particles = start.clone();
            let mut solver = NetSolver::new(&weights, &boundary, &[None, None], Kernel::detect()).unwrap();
            for _ in 0..3 {
                let gravity = Acceleration::Uniform([0.0, -9.81, 0.0]);
                solver.step(&mut particles, gravity, weights.config.dt).unwrap();
            }
            particles
        })
    };
    let one = run(1);
    assert!(one.position.iter().flatten().all(|x| x.is_finite()));
    for threads in [2, 3] {
        assert!(one == run(threads), "{threads} threads");
    }
}

#[test]
fn another_time_step_or_input_is_refused() {
    let mut numbers = Numbers(3);
    let good = weights(config(Integration::Paper, &[]), &mut numbers);
    let mut solver = NetSolver::new(&good, &Boundary::default(), &[None], Kernel::detect()).unwrap();
    let error = solver.step(&mut Particles::default(), Acceleration::Uniform([0.0; 3]), 0.01).unwrap_err();
    assert_eq!(error.to_string(), "dt: 0.01 s, but the weights were made for steps of 0.02 s");
    let heat = weights(config(Integration::Paper, &["temperature"]), &mut numbers);
    let error = NetSolver::new(&heat, &Boundary::default(), &[None], Kernel::detect()).unwrap_err();
    assert!(error.to_string().contains("temperature"), "{error}");
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut numbers = Numbers(5);
    let weights = weights(config(Integration::Paper, &["viscosity"]), &mut numbers);
    let dt = weights.config.dt;
    let boundary = Boundary { position: vec![[0.0; 3]; 2], normal: vec![[0.0, 1.0, 0.0]] };
    let error = NetSolver::new(&weights, &boundary, &[None], Kernel::detect()).unwrap_err();
    assert_eq!(error.to_string(), "1 normals for 2 wall particles");
    let error =
        NetSolver::new(&weights, &Boundary::default(), &[Some(f32::NAN)], Kernel::detect()).unwrap_err();
    assert_eq!(error.to_string(), "viscosity NaN, expected a finite number");
    let mut solver = NetSolver::new(&weights, &Boundary::default(), &[None], Kernel::detect()).unwrap();
    let mut start = particles(3, &mut numbers);
    let error = solver.step(&mut start, Acceleration::PerParticle(&[[0.0; 3]; 2]), dt).unwrap_err();
    assert_eq!(error.to_string(), "2 accelerations for 3 particles");
    let error = solver.step(&mut start, Acceleration::Uniform([0.0; 3]), dt).unwrap_err();
    assert_eq!(error.to_string(), "a particle of body 1, but there are viscosities for 1 bodies");
}

/// What is no number must reach the positions, where a rollout looks for it: neither a relu nor a clamp may hide it.
#[test]
fn numbers_that_are_none_show_in_the_positions() {
    let mut numbers = Numbers(6);
    let weights = weights(config(Integration::Paper, &[]), &mut numbers);
    let rest = Acceleration::Uniform([0.0; 3]);
    let start = particles(12, &mut numbers);
    for kernel in Kernel::available() {
        // So far and fast that x* is no float32.
        let mut fast = start.clone();
        (fast.position[3], fast.velocity[3]) = ([f32::MAX; 3], [f32::MAX; 3]);
        // Weights so large that sums overflow.
        let mut large = weights.clone();
        large.fluid_dense.as_mut().expect("a fully connected part").weight.fill(f32::MAX);
        let mut moving = start.clone();
        moving.velocity[3] = [1.0; 3];
        for (weights, mut particles) in [(&weights, fast), (&large, moving)] {
            let mut solver = NetSolver::new(weights, &Boundary::default(), &[None], kernel).unwrap();
            solver.step(&mut particles, rest, weights.config.dt).unwrap();
            let position = &particles.position;
            assert!(position.iter().flatten().any(|x| !x.is_finite()), "{}: {position:?}", kernel.name());
        }
    }
}

/// The published layers leave out what is at distance zero, wall particles too: Open3D gives a particle that
/// coincides with one the same correction as without it.
#[test]
fn a_wall_particle_at_the_same_place_does_not_count() {
    let mut numbers = Numbers(4);
    let weights = weights(config(Integration::Paper, &[]), &mut numbers);
    let at = |position: [f32; 3]| Boundary { position: vec![position], normal: vec![[0.0, 1.0, 0.0]] };
    // At rest without acceleration x* is x to the last bit.
    let start = Particles { velocity: vec![[0.0; 3]], ..particles(1, &mut numbers) };
    let rest = Acceleration::Uniform([0.0; 3]);
    let x = start.position[0];
    let state = State { position: vec![x.map(f64::from)], velocity: vec![[0.0; 3]] };
    let moved = |boundary: &Boundary| {
        let mut moved = start.clone();
        let mut solver = NetSolver::new(&weights, boundary, &[None], Kernel::detect()).unwrap();
        solver.step(&mut moved, rest, weights.config.dt).unwrap();
        let world = World { extra: &[], boundary, acceleration: rest };
        (moved, reference::step(&Network::from(&weights), &state, world))
    };
    let alone = moved(&Boundary::default());
    assert_eq!(moved(&at(x)), alone);
    assert_ne!(moved(&at([x[0] + 0.01, x[1], x[2]])), alone);
}

//! The backward pass through steps of the network: the float64 reference against central differences, float32 against
//! the reference and against PyTorch and Open3D, what is kept against what is computed again, and batches against
//! one call a cloud.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

mod numbers;

use cconv::{Interpolation, Kernel, PositionGradient, Window};
use fluvia_net::config::{Config, Integration};
use fluvia_net::integrate::State;
use fluvia_net::net::{Network, Walls};
use fluvia_net::reference;
use fluvia_net::step::{StepGradients, World};
use fluvia_net::unroll::{Storage, Unroll};
use fluvia_net::weights::Weights;
use fluvia_sim::particles::{Acceleration, Boundary};
use numbers::{Numbers, ablations, config, weights};

/// A few particles over a few wall particles, with derivatives by the states after each step.
struct Problem {
    weights: Weights,
    start: State,
    extra: Vec<f32>,
    boundary: Boundary,
    acceleration: Vec<[f32; 3]>,
    by_states: Vec<State>,
}

impl Problem {
    fn new(numbers: &mut Numbers, config: Config, count: usize, steps: usize) -> Self {
        let viscosity = !config.extra_inputs.is_empty();
        let mut points =
            |scale: f32, count: usize| (0..count).map(|_| numbers.point(scale)).collect::<Vec<_>>();
        let start = State { position: points(0.12, count), velocity: points(0.3, count) };
        let boundary = Boundary { position: points(0.2, 30), normal: points(1.0, 30) };
        // Along the integration a velocity counts as a position does over a step.
        let by_states = (0..steps)
            .map(|_| State { position: points(1.0, count), velocity: points(0.02, count) })
            .collect();
        let acceleration = points(9.81, count);
        let extra = (0..if viscosity { count } else { 0 }).map(|_| 0.2 + 0.1 * numbers.next()).collect();
        let weights = weights(config, numbers);
        Problem { weights, start, extra, boundary, acceleration, by_states }
    }

    fn wide(&self) -> Wide {
        let widen = |values: &[f32]| values.iter().map(|&x| f64::from(x)).collect();
        Wide {
            network: reference::Network::from(&self.weights),
            start: widen_state(&self.start),
            extra: widen(&self.extra),
            by_states: self.by_states.iter().map(widen_state).collect(),
        }
    }

    fn reference_world<'a>(&'a self, extra: &'a [f64]) -> reference::World<'a> {
        let acceleration = Acceleration::PerParticle(&self.acceleration);
        reference::World { extra, boundary: &self.boundary, acceleration }
    }
}

fn widen_state(state: &State) -> reference::State {
    let widen = |points: &[[f32; 3]]| points.iter().map(|x| x.map(f64::from)).collect();
    reference::State { position: widen(&state.position), velocity: widen(&state.velocity) }
}

#[derive(Clone)]
struct Wide {
    network: reference::Network,
    start: reference::State,
    extra: Vec<f64>,
    by_states: Vec<reference::State>,
}

impl Wide {
    /// L = Σ over steps of positions · their derivatives + velocities · theirs.
    fn loss(&self, problem: &Problem) -> f64 {
        let mut state = self.start.clone();
        let mut loss = 0.0;
        for by_state in &self.by_states {
            state = reference::step(&self.network, &state, problem.reference_world(&self.extra));
            for (points, gradient) in
                [(&state.position, &by_state.position), (&state.velocity, &by_state.velocity)]
            {
                let pairs = points.as_flattened().iter().zip(gradient.as_flattened());
                loss += pairs.map(|(x, d)| x * d).sum::<f64>();
            }
        }
        loss
    }

    fn backward(&self, problem: &Problem, positions: PositionGradient) -> reference::Gradients {
        let world = problem.reference_world(&self.extra);
        reference::backward(&self.network, &self.start, world, &self.by_states, positions)
    }
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |a, x| if x.abs() > a || x.is_nan() { x.abs() } else { a })
}

type Place<'a> = &'a dyn for<'w> Fn(&'w mut Wide, usize) -> &'w mut f64;

#[test]
fn the_reference_has_the_gradients_of_central_differences() {
    // None of the numbers lies so near to a kink of a relu or a mapping.
    const STEP: f64 = 1e-5;
    let mut numbers = Numbers(1);
    let usual = [Integration::Paper, Integration::Velocity].map(|kind| config(kind, &["viscosity"]));
    for config in usual.into_iter().chain(ablations()) {
        // The windows and lookups of ablations have kinks where pairs begin, and in ten steps one is met.
        let is_smooth = config.window == Window::Poly6 && config.interpolation == Interpolation::Linear;
        for steps in [1, 2, 10].into_iter().filter(|&steps| is_smooth || steps < 10) {
            let problem = Problem::new(&mut numbers, config.clone(), 12, steps);
            let wide = problem.wide();
            let gradients = wide.backward(&problem, PositionGradient::Full);
            let check = |name: &str, gradient: &[f64], place: Place<'_>| {
                // Of long lists some, spread over them.
                let picked: Vec<usize> = (0..gradient.len()).step_by(1 + gradient.len() / 24).collect();
                let moved = |k: usize, step: f64| {
                    let mut wide = wide.clone();
                    *place(&mut wide, k) += step;
                    wide.loss(&problem)
                };
                let difference = |&k: &usize| (moved(k, STEP) - moved(k, -STEP)) / (2.0 * STEP);
                let scale = largest(gradient.iter().copied());
                let error = largest(picked.iter().map(|k| gradient[*k] - difference(k))) / scale;
                assert!(error < 1e-6, "{config:?}, {steps} steps: {name} off by {error:.1e}");
            };
            for (k, tensor) in gradients.tensors.iter().enumerate() {
                check(&format!("tensor {k}"), tensor, &|wide, i| &mut wide.network.tensors[k][i]);
            }
            let reference::State { position, velocity } = &gradients.state;
            check("position", position.as_flattened(), &|wide, i| &mut wide.start.position[i / 3][i % 3]);
            check("velocity", velocity.as_flattened(), &|wide, i| &mut wide.start.velocity[i / 3][i % 3]);
            check("viscosity", &gradients.extra, &|wide, i| &mut wide.extra[i]);
        }
    }
}

/// All gradients of one call.
#[derive(Clone, Debug, PartialEq)]
struct AllGradients {
    tensors: Vec<Vec<f32>>,
    state: State,
    extra: Vec<f32>,
}

impl AllGradients {
    fn zeros(weights: &Weights, count: usize, extras: usize) -> AllGradients {
        AllGradients {
            tensors: weights.tensors().iter().map(|tensor| vec![0.0; tensor.values.len()]).collect(),
            state: State::zeros(count),
            extra: vec![0.0; extras],
        }
    }

    fn wanted(&mut self, positions: PositionGradient) -> StepGradients<'_> {
        StepGradients {
            tensors: Some(&mut self.tensors),
            state: Some(&mut self.state),
            extra: Some(&mut self.extra),
            positions,
        }
    }
}

fn walls(network: &Network, boundaries: &[&Boundary]) -> Walls {
    let mut clouds = vec![0];
    let (mut position, mut normal) = (Vec::new(), Vec::new());
    for boundary in boundaries {
        position.extend_from_slice(&boundary.position);
        normal.extend_from_slice(&boundary.normal);
        clouds.push(position.len());
    }
    network.walls(&position, &normal, &clouds)
}

/// The gradients through all steps of one problem, added to `gradients`.
fn backward(
    problem: &Problem,
    kernel: Kernel,
    storage: Storage,
    positions: PositionGradient,
    gradients: &mut AllGradients,
) {
    let network = Network::new(&problem.weights, kernel).unwrap();
    let mut walls = walls(&network, &[&problem.boundary]);
    let clouds = [0, problem.start.position.len()];
    let world = World {
        extra: &problem.extra,
        acceleration: Acceleration::PerParticle(&problem.acceleration),
        clouds: &clouds,
    };
    let mut unroll = Unroll::new(storage);
    // Twice, so that what is left in the memory of the first run would show.
    assert!(unroll.forward(&network, &problem.start, world, &mut walls, problem.by_states.len() + 1));
    assert!(unroll.forward(&network, &problem.start, world, &mut walls, problem.by_states.len()));
    unroll.backward(&network, &problem.by_states, world, &mut walls, gradients.wanted(positions));
}

#[test]
fn float32_equals_the_reference() {
    let mut numbers = Numbers(2);
    let usual = [
        config(Integration::Paper, &[]),
        config(Integration::Paper, &["viscosity"]),
        config(Integration::Velocity, &["viscosity"]),
    ];
    for config in usual.into_iter().chain(ablations()) {
        // Rounding grows from step to step, as any small difference does; after some it puts pairs into other cells.
        let is_smooth = config.interpolation != Interpolation::Nearest;
        let all = [(1, 1e-4), (2, 1e-4), (10, 1e-3)];
        for (steps, tolerance) in all.into_iter().filter(|(steps, _)| is_smooth || *steps == 1) {
            for positions in [PositionGradient::Full, PositionGradient::Stop] {
                let problem = Problem::new(&mut numbers, config.clone(), 40, steps);
                let expected = problem.wide().backward(&problem, positions);
                for kernel in Kernel::available() {
                    let mut found = AllGradients::zeros(&problem.weights, 40, problem.extra.len());
                    backward(&problem, kernel, Storage::Keep, positions, &mut found);
                    let close = |name: &str, values: &[f32], expected: &[f64]| {
                        assert_eq!(values.len(), expected.len(), "{name}");
                        let scale = largest(expected.iter().copied());
                        let differences = values.iter().zip(expected).map(|(a, b)| f64::from(*a) - b);
                        let error = largest(differences) / scale;
                        let context = format!("{config:?}, {positions:?}, {steps} steps, {}", kernel.name());
                        assert!(
                            values.is_empty() || error < tolerance,
                            "{context}: {name} off by {error:.1e}"
                        );
                    };
                    for (k, (values, expected)) in found.tensors.iter().zip(&expected.tensors).enumerate() {
                        close(&format!("tensor {k}"), values, expected);
                    }
                    let (state, expected_state) = (&found.state, &expected.state);
                    let flat = state.position.as_flattened();
                    close("position", flat, expected_state.position.as_flattened());
                    let flat = state.velocity.as_flattened();
                    close("velocity", flat, expected_state.velocity.as_flattened());
                    close("viscosity", &found.extra, &expected.extra);
                }
            }
        }
    }
}

#[test]
fn what_is_computed_again_has_the_same_bits_as_what_was_kept() {
    let mut numbers = Numbers(3);
    let problem = Problem::new(&mut numbers, config(Integration::Paper, &["viscosity"]), 60, 4);
    let run = |storage| {
        let mut gradients = AllGradients::zeros(&problem.weights, 60, 60);
        backward(&problem, Kernel::detect(), storage, PositionGradient::Full, &mut gradients);
        gradients
    };
    assert!(run(Storage::Keep) == run(Storage::Recompute));
}

#[test]
fn gradients_can_be_asked_for_one_by_one() {
    let mut numbers = Numbers(4);
    let problem = Problem::new(&mut numbers, config(Integration::Velocity, &["viscosity"]), 30, 2);
    let network = Network::new(&problem.weights, Kernel::detect()).unwrap();
    let mut walls = walls(&network, &[&problem.boundary]);
    let acceleration = Acceleration::PerParticle(&problem.acceleration);
    let world = World { extra: &problem.extra, acceleration, clouds: &[0, 30] };
    let mut unroll = Unroll::new(Storage::Keep);
    assert!(unroll.forward(&network, &problem.start, world, &mut walls, 2));
    let mut all = AllGradients::zeros(&problem.weights, 30, 30);
    let mut one = all.clone();
    let full = PositionGradient::Full;
    unroll.backward(&network, &problem.by_states, world, &mut walls, all.wanted(full));
    let wanted = StepGradients { tensors: Some(&mut one.tensors), ..StepGradients::default() };
    unroll.backward(&network, &problem.by_states, world, &mut walls, wanted);
    let wanted = StepGradients { extra: Some(&mut one.extra), ..StepGradients::default() };
    unroll.backward(&network, &problem.by_states, world, &mut walls, wanted);
    let wanted = StepGradients { state: Some(&mut one.state), ..StepGradients::default() };
    unroll.backward(&network, &problem.by_states, world, &mut walls, wanted);
    let scale = all.tensors.iter().flatten().fold(0.0f32, |a, x| a.max(x.abs()));
    assert!(one.state == all.state && one.extra == all.extra);
    // The weights' gradient alone is summed on the cheaper side, with another rounding.
    for (one, all) in one.tensors.iter().flatten().zip(all.tensors.iter().flatten()) {
        assert!((one - all).abs() <= 1e-5 * scale, "{one} instead of {all}");
    }
}

#[test]
fn a_batch_has_the_bits_of_one_call_a_cloud() {
    // Over two steps the sums over clouds and steps are taken in another order than by one call a cloud, so there the
    // weights' gradient is left out.
    check_batch(1, true);
    check_batch(2, false);
}

fn check_batch(steps: usize, with_weights: bool) {
    let mut numbers = Numbers(5);
    // More than one run of partial sums, clouds of one particle and of none.
    let sizes = [500, 1, 0, 37, 400];
    let mut problems: Vec<Problem> = sizes
        .iter()
        .map(|&count| Problem::new(&mut numbers, config(Integration::Paper, &["viscosity"]), count, steps))
        .collect();
    let weights = problems[0].weights.clone();
    for problem in &mut problems {
        problem.weights = weights.clone();
    }
    let total: usize = sizes.iter().sum();
    for kernel in Kernel::available() {
        let mut alone = AllGradients::zeros(&weights, 0, 0);
        for problem in &problems {
            let count = problem.start.position.len();
            let mut gradients =
                AllGradients { tensors: alone.tensors, ..AllGradients::zeros(&weights, count, count) };
            backward(problem, kernel, Storage::Keep, PositionGradient::Full, &mut gradients);
            alone.tensors = gradients.tensors;
            alone.state.position.extend(gradients.state.position);
            alone.state.velocity.extend(gradients.state.velocity);
            alone.extra.extend(gradients.extra);
        }

        let mut clouds = vec![0];
        let mut together = State::default();
        let (mut extra, mut acceleration) = (Vec::new(), Vec::new());
        let mut by_states = vec![State::default(); steps];
        for problem in &problems {
            together.position.extend_from_slice(&problem.start.position);
            together.velocity.extend_from_slice(&problem.start.velocity);
            extra.extend_from_slice(&problem.extra);
            acceleration.extend_from_slice(&problem.acceleration);
            for (all, one) in by_states.iter_mut().zip(&problem.by_states) {
                all.position.extend_from_slice(&one.position);
                all.velocity.extend_from_slice(&one.velocity);
            }
            clouds.push(together.position.len());
        }
        let network = Network::new(&weights, kernel).unwrap();
        let mut walls =
            walls(&network, &problems.iter().map(|problem| &problem.boundary).collect::<Vec<_>>());
        let acceleration = Acceleration::PerParticle(&acceleration);
        let world = World { extra: &extra, acceleration, clouds: &clouds };
        for threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut unroll = Unroll::new(Storage::Keep);
                assert!(unroll.forward(&network, &together, world, &mut walls, steps));
                let mut gradients = AllGradients::zeros(&weights, total, total);
                let full = PositionGradient::Full;
                unroll.backward(&network, &by_states, world, &mut walls, gradients.wanted(full));
                let context = format!("{} with {threads} threads", kernel.name());
                assert!(gradients.state == alone.state, "{context}: the state");
                assert!(gradients.extra == alone.extra, "{context}: the extra inputs");
                assert!(!with_weights || gradients.tensors == alone.tensors, "{context}: the weights");
            });
        }
    }
}

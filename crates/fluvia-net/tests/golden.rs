//! The network against golden steps and rollouts of the published weights, computed by Open3D, and against
//! its float64 reference.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cconv::{Kernel, PositionGradient};
use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use fluvia_net::integrate::{self, predict};
use fluvia_net::net;
use fluvia_net::reference::{self, Network, State, World};
use fluvia_net::solver::NetSolver;
use fluvia_net::step::{self, StepGradients};
use fluvia_net::unroll::{Storage, Unroll};
use fluvia_net::weights::{self, Weights};
use fluvia_sim::frames::npz::{Array, read_arrays};
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::Solver;

const GRAVITY: Acceleration<'_> = Acceleration::Uniform([0.0, -9.81, 0.0]);
const DT: f32 = 0.02;

/// The folder of golden files: `FLUVIA_GOLDEN`, or `../shared/reference/golden` beside the repository.
fn golden_folder() -> PathBuf {
    std::env::var_os("FLUVIA_GOLDEN").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference/golden"),
        PathBuf::from,
    )
}

/// The published weights and the golden files whose names start with `prefix`; none, with a printed reason.
fn published(prefix: &str) -> Option<(Weights, Vec<Golden>)> {
    let folder = golden_folder();
    let file = folder.join("../official/pretrained_model_weights.pt");
    let names = (0..).map(|k| folder.join(format!("{prefix}{k}.npz"))).take_while(|path| path.exists());
    let files: Vec<_> = names.map(|path| Golden::open(&path)).collect();
    if files.is_empty() || !file.exists() {
        eprintln!("skipped: no {prefix}*.npz in {} with the published weights beside", folder.display());
        return None;
    }
    Some((weights::load(&file).expect("the published weights"), files))
}

struct Golden {
    name: String,
    arrays: BTreeMap<String, Array>,
}

impl Golden {
    fn open(path: &Path) -> Golden {
        let arrays = read_arrays(path).expect("a readable golden file");
        Golden { name: path.display().to_string(), arrays }
    }

    fn values(&self, name: &str) -> &[f64] {
        &self.arrays.get(name).unwrap_or_else(|| panic!("{}: no {name}", self.name)).values
    }

    fn points(&self, name: &str) -> Vec<[f32; 3]> {
        self.values(name).chunks_exact(3).map(|p| [p[0] as f32, p[1] as f32, p[2] as f32]).collect()
    }

    fn particles(&self) -> Particles {
        let position = self.points("pos");
        let velocity = self.points("vel");
        Particles::of_one_body(position, velocity)
    }

    fn boundary(&self) -> Boundary {
        Boundary { position: self.points("box"), normal: self.points("box_normals") }
    }
}

/// One step with every kernel: positions within 2e-6 m, velocities within 1e-4 m/s, for Eq. 14 divides the
/// rounding of the positions by 0.02 s.
fn check_step(weights: &Weights, golden: &Golden) {
    let (start, boundary) = (golden.particles(), golden.boundary());
    let (position, velocity) = (golden.points("pos_next"), golden.points("vel_next"));
    for kernel in Kernel::available() {
        let mut particles = start.clone();
        let mut solver = NetSolver::new(weights, &boundary, &[None], kernel).expect("a network");
        solver.step(&mut particles, GRAVITY, DT).expect("a step");
        let moved = largest_difference(&particles.position, &position);
        assert!(moved <= 2e-6, "{} {}: positions off by {moved:.1e} m", golden.name, kernel.name());
        let speed = largest_difference(&particles.velocity, &velocity);
        assert!(speed <= 1e-4, "{} {}: velocities off by {speed:.1e} m/s", golden.name, kernel.name());
    }
}

fn largest_difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    assert_eq!(a.len(), b.len());
    let differences = a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| (a - b).abs());
    differences.fold(0.0, |largest, d| if d > largest || d.is_nan() { d } else { largest })
}

fn mean_height(position: &[[f32; 3]]) -> f64 {
    position.iter().map(|p| f64::from(p[1])).sum::<f64>() / position.len() as f64
}

fn mean_speed(velocity: &[[f32; 3]]) -> f64 {
    let speed = |v: &[f32; 3]| v.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>().sqrt();
    velocity.iter().map(speed).sum::<f64>() / velocity.len() as f64
}

#[test]
fn one_step_of_a_small_network_equals_open3ds() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/golden");
    let weights = weights::load(folder.join("net.pt")).unwrap();
    check_step(&weights, &Golden::open(&folder.join("net.npz")));
}

#[test]
fn one_step_equals_open3ds() {
    let Some((weights, goldens)) = published("net_step_") else { return };
    goldens.iter().for_each(|golden| check_step(&weights, golden));
}

#[test]
fn neighbour_counts_equal_open3ds() {
    let Some((weights, goldens)) = published("net_step_") else { return };
    let radius = weights.config.filter_radius;
    for golden in goldens {
        let start = golden.particles();
        let mut predicted = integrate::State::default();
        predict(&start.position, &start.velocity, GRAVITY, DT, &mut predicted);
        let points = &predicted.position;
        let (mut grid, mut found) = (Grid::new(), Neighbors::default());
        grid.build(points, radius);
        let options = Options { ignore_coincident: true, ..Options::default() };
        // Pairs within a micrometre of R may fall on either side: x* is rounded in another order there.
        let mut bounds = Vec::new();
        for shift in [-1e-6, 1e-6] {
            grid.search(points, Radius::Uniform(radius + shift), &options, &mut found);
            bounds.push((0..points.len()).map(|q| found.count(q) as i64).collect::<Vec<_>>());
        }
        for (q, expected) in golden.values("num_neighbors").iter().map(|&n| n as i64).enumerate() {
            let range = bounds[0][q]..=bounds[1][q];
            assert!(range.contains(&expected), "{}: particle {q} has {range:?}, not {expected}", golden.name);
        }
    }
}

#[test]
fn rollouts_follow_open3ds() {
    let Some((weights, goldens)) = published("net_roll_") else { return };
    for golden in goldens {
        let (mut particles, boundary) = (golden.particles(), golden.boundary());
        let mut solver = NetSolver::new(&weights, &boundary, &[None], Kernel::detect()).unwrap();
        for step in 1..=50 {
            solver.step(&mut particles, GRAVITY, DT).unwrap();
            // The rollout is chaotic: rounding grows, and later frames can only be compared as a whole.
            let tolerance = match step {
                5 => 2e-5,
                10 => 2e-4,
                50 => f32::MAX,
                _ => continue,
            };
            let position = golden.points(&format!("pos_{step}"));
            let moved = largest_difference(&particles.position, &position);
            assert!(moved <= tolerance, "{} frame {step}: positions off by {moved:.1e} m", golden.name);
        }
        let ratio = mean_height(&particles.position) / mean_height(&golden.points("pos_50"));
        assert!((ratio - 1.0).abs() < 0.02, "{}: mean height is {ratio} of theirs", golden.name);
        let ratio = mean_speed(&particles.velocity) / mean_speed(&golden.points("vel_50"));
        assert!((ratio - 1.0).abs() < 0.02, "{}: mean speed is {ratio} of theirs", golden.name);
    }
}

#[test]
fn one_step_equals_the_float64_reference() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/golden");
    let weights = weights::load(folder.join("net.pt")).unwrap();
    let golden = Golden::open(&folder.join("net.npz"));
    let (start, boundary) = (golden.particles(), golden.boundary());
    let widen = |values: &[[f32; 3]]| values.iter().map(|v| v.map(f64::from)).collect();
    let state = State { position: widen(&start.position), velocity: widen(&start.velocity) };
    let expected = reference::step(
        &Network::from(&weights),
        &state,
        World { extra: &[], boundary: &boundary, acceleration: GRAVITY },
    );
    for kernel in Kernel::available() {
        let mut particles = start.clone();
        let mut solver = NetSolver::new(&weights, &boundary, &[None], kernel).unwrap();
        solver.step(&mut particles, GRAVITY, DT).unwrap();
        let pairs = particles.position.iter().flatten().zip(expected.position.iter().flatten());
        let error = pairs.map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
        // Float32 positions of up to 2 m are spaced by 1e-7 m, and the correction is computed in float32.
        assert!(error < 1e-6, "{}: positions off by {error:.1e} m", kernel.name());
    }
}

/// Two steps and the gradients of a sum over both, with the gradient stopped at the positions as Open3D does.
#[test]
fn gradients_of_two_steps_equal_open3ds() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/golden");
    let weights = weights::load(folder.join("net.pt")).unwrap();
    let (start, golden) =
        (Golden::open(&folder.join("net.npz")), Golden::open(&folder.join("net_gradient.npz")));
    let boundary = start.boundary();
    let start = integrate::State { position: start.points("pos"), velocity: start.points("vel") };
    let count = start.position.len();
    let by_states = [1, 2].map(|step| integrate::State {
        position: golden.points(&format!("pos_grad_{step}")),
        velocity: golden.points(&format!("vel_grad_{step}")),
    });
    for kernel in Kernel::available() {
        let network = net::Network::new(&weights, kernel).unwrap();
        let mut walls = network.walls(&boundary.position, &boundary.normal, &[0, boundary.position.len()]);
        let world = step::World { extra: &[], acceleration: GRAVITY, clouds: &[0, count] };
        let mut unroll = Unroll::new(Storage::Keep);
        assert!(unroll.forward(&network, &start, world, &mut walls, by_states.len()));
        let mut tensors: Vec<Vec<f32>> =
            weights.tensors().iter().map(|tensor| vec![0.0; tensor.values.len()]).collect();
        let mut state = integrate::State::zeros(count);
        let wanted = StepGradients {
            tensors: Some(&mut tensors),
            state: Some(&mut state),
            extra: None,
            positions: PositionGradient::Stop,
        };
        unroll.backward(&network, &by_states, world, &mut walls, wanted);

        // Both sides are float32 sums.
        let close = |name: &str, values: &[f32], expected: &[f64]| {
            assert_eq!(values.len(), expected.len(), "{name}");
            let scale = expected.iter().fold(0.0f64, |a, x| a.max(x.abs()));
            let differences = values.iter().zip(expected).map(|(a, b)| (f64::from(*a) - b).abs());
            let error = differences.fold(0.0, |a, d| if d > a || d.is_nan() { d } else { a }) / scale;
            assert!(error < 1e-4, "{}: {name} off by {error:.1e}", kernel.name());
        };
        close("pos", state.position.as_flattened(), golden.values("pos_grad"));
        close("vel", state.velocity.as_flattened(), golden.values("vel_grad"));
        for (tensor, values) in weights.tensors().iter().zip(&tensors) {
            let expected = golden.values(&tensor.name);
            let shape = &tensor.shape;
            if tensor.name.ends_with(".weight") {
                // PyTorch's layout is [out, in].
                let place = |k: usize| (k % shape[1]) * shape[0] + k / shape[1];
                let transposed: Vec<f64> = (0..values.len()).map(|k| expected[place(k)]).collect();
                close(&tensor.name, values, &transposed);
            } else {
                close(&tensor.name, values, expected);
            }
        }
    }
}

//! Training: one step and twenty against PyTorch with Open3D, the same bits at any number of threads, and a network that
//! learns.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cconv::{Kernel, PositionGradient, Precision};
use fluvia_net::adam;
use fluvia_net::config::Config;
use fluvia_net::dataset::Batch;
use fluvia_net::integrate::State;
use fluvia_net::loss::Loss;
use fluvia_net::net::Network;
use fluvia_net::train::{Options, Schedule, Trainer};
use fluvia_net::unroll::{Storage, Unroll};
use fluvia_net::weights::{self, Weights};
use fluvia_sim::frames::npz::{Array, read_arrays};

fn golden_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/golden")
}

/// The training of the published scripts, with a rate that stays.
fn published() -> Options {
    Options {
        loss: Loss::default(),
        schedule: Schedule::Steps { rate: 1e-3, factor: 1.0, at: Vec::new() },
        adam: adam::Params::default(),
        average: None,
        positions: PositionGradient::Stop,
        storage: Storage::Keep,
        precision: Precision::F32,
        extra_input_rate: 1.0,
    }
}

struct Golden(BTreeMap<String, Array>);

impl Golden {
    fn open() -> Golden {
        Golden(read_arrays(&golden_folder().join("training.npz")).unwrap())
    }

    fn values(&self, name: &str) -> &[f64] {
        &self.0.get(name).unwrap_or_else(|| panic!("no {name}")).values
    }

    fn points(&self, name: &str) -> Vec<[f32; 3]> {
        self.values(name).chunks_exact(3).map(|p| [p[0] as f32, p[1] as f32, p[2] as f32]).collect()
    }

    fn batch(&self, b: usize) -> Batch {
        let mut batch = Batch::new(2, 0);
        for c in 0..2 {
            let points = |name: &str| self.points(&format!("{name}_{b}_{c}"));
            batch.start.position.extend(points("pos"));
            batch.start.velocity.extend(points("vel"));
            for (truth, name) in batch.truth.iter_mut().zip(["pos1", "pos2"]) {
                truth.position.extend(points(name));
                // Not in the loss.
                truth.velocity.resize(truth.position.len(), [0.0; 3]);
            }
            batch.clouds.push(batch.start.position.len());
            batch.wall_position.extend(points("box"));
            batch.wall_normal.extend(points("box_normals"));
            batch.wall_clouds.push(batch.wall_position.len());
        }
        batch
    }
}

#[test]
fn a_step_has_the_loss_and_the_gradients_of_pytorch() {
    let golden = Golden::open();
    let weights = weights::load(golden_folder().join("net.pt")).unwrap();
    for kernel in Kernel::available() {
        let mut trainer = Trainer::new(published(), weights.clone(), kernel).unwrap();
        let loss = trainer.differentiate(&golden.batch(0)).unwrap();
        let expected = golden.values("loss")[0];
        assert!((loss / expected - 1.0).abs() < 1e-4, "{}: {loss}, not {expected}", kernel.name());
        for (tensor, values) in weights.tensors().iter().zip(trainer.gradients()) {
            let expected = golden.values(&tensor.name);
            let shape = &tensor.shape;
            // PyTorch's layout of dense weights is [out, in].
            let place = |k: usize| match tensor.name.ends_with(".weight") {
                true => (k % shape[1]) * shape[0] + k / shape[1],
                false => k,
            };
            let scale = expected.iter().fold(0.0f64, |a, x| a.max(x.abs()));
            let worst = values.iter().enumerate().map(|(k, d)| (f64::from(*d) - expected[place(k)]).abs());
            let error = worst.fold(0.0, |a, d| if d > a || d.is_nan() { d } else { a }) / scale;
            // Both sides are float32 sums.
            assert!(error < 1e-4, "{}: {} off by {error:.1e}", kernel.name(), tensor.name);
        }
    }
}

#[test]
fn twenty_steps_follow_the_losses_of_pytorch() {
    let golden = Golden::open();
    let weights = weights::load(golden_folder().join("net.pt")).unwrap();
    let mut trainer = Trainer::new(published(), weights, Kernel::detect()).unwrap();
    for (update, &expected) in golden.values("loss").iter().enumerate() {
        let progress = trainer.step(&golden.batch(update % 4)).unwrap();
        let error = (progress.loss / expected - 1.0).abs();
        assert!(error < 0.01, "update {update}: {} where PyTorch has {expected}", progress.loss);
    }
    assert_eq!(trainer.adam().updates, 20);
}

/// A batch with known answers: what the network of `teacher` does.
fn taught(teacher: &Weights, batch: Batch) -> Batch {
    let network = Network::new(teacher, Kernel::detect()).unwrap();
    let (mut walls, world) = (batch.walls(&network), batch.world(teacher.config.gravity));
    let mut unroll = Unroll::new(Storage::Keep);
    assert!(unroll.forward(&network, &batch.start, world, &mut walls, 2));
    let truth: Vec<State> = unroll.states().to_vec();
    Batch { truth, ..batch }
}

#[test]
fn a_network_learns_and_its_average_follows() {
    let golden = Golden::open();
    let teacher = weights::load(golden_folder().join("net.pt")).unwrap();
    let student = Weights::random(teacher.config.clone(), 4, &[6, 6], 1);
    let options = Options {
        schedule: Schedule::Cosine { rate: 1e-2, warmup: 10, updates: 150 },
        average: Some(0.95),
        ..published()
    };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut trainer = Trainer::new(options.clone(), student.clone(), Kernel::detect()).unwrap();
            let batches: Vec<Batch> = (0..4).map(|b| taught(&teacher, golden.batch(b))).collect();
            let losses: Vec<f64> = (0..150).map(|k| trainer.step(&batches[k % 4]).unwrap().loss).collect();
            let mut judge = Trainer::new(options.clone(), trainer.result(), Kernel::detect()).unwrap();
            (losses, judge.differentiate(&batches[0]).unwrap(), trainer.result())
        })
    };
    let (losses, averaged, result) = run(1);
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    let (before, after) = (mean(&losses[..8]), mean(&losses[142..]));
    // The loss grows with the root of a distance: half of it is a quarter of the distance.
    assert!(after < 0.6 * before, "{before} to {after}");
    assert!(averaged < 0.65 * before, "{before} to {averaged}");
    let (again, _, same) = run(3);
    assert!(losses == again && result == same, "other bits with other numbers of threads");
}

/// A network of viscosities times 16 is the same network with a sixteenth of their weights. Powers of two change no digit of
/// float32, so that the trainings are the same to the last bit.
#[test]
fn a_rate_of_extra_inputs_is_that_of_larger_inputs() {
    let golden = Golden::open();
    let teacher = weights::load(golden_folder().join("net.pt")).unwrap();
    let config = Config { extra_inputs: vec!["viscosity".into()], ..teacher.config.clone() };
    let student = Weights::random(config, 4, &[6, 6], 1);
    /// The weights of the viscosity times a factor.
    fn scaled(mut weights: Weights, factor: f32) -> Weights {
        let outputs = weights.fluid.outputs;
        let dense = weights.fluid_dense.as_mut().unwrap();
        for rows in [&mut weights.fluid.kernel, &mut dense.weight] {
            rows.chunks_exact_mut(5 * outputs).for_each(|cell| {
                cell[4 * outputs..].iter_mut().for_each(|weight| *weight *= factor);
            });
        }
        weights
    }
    let run = |student: Weights, factor: f32, extra_input_rate: f32| {
        // ε would be another one for gradients that are 16 times as large.
        let adam = adam::Params { epsilon: 1e-30, ..adam::Params::default() };
        let options = Options { adam, extra_input_rate, average: Some(0.5), ..published() };
        let mut trainer = Trainer::new(options, student, Kernel::detect()).unwrap();
        for b in 0..4 {
            let mut batch = golden.batch(b);
            batch.extra =
                (0..batch.start.position.len()).map(|i| factor * (0.01 + 0.01 * i as f32)).collect();
            trainer.step(&batch).unwrap();
        }
        trainer.result()
    };
    let expected = run(scaled(student.clone(), 1.0 / 16.0), 16.0, 1.0);
    assert!(run(student.clone(), 1.0, 16.0) == scaled(expected, 16.0));
    assert!(run(student.clone(), 1.0, 16.0) != run(student, 1.0, 1.0));
}

#[test]
fn a_lead_is_walked_without_gradient() {
    let golden = Golden::open();
    let weights = weights::load(golden_folder().join("net.pt")).unwrap();
    let batch = golden.batch(0);
    let first = taught(&weights, batch.clone()).truth[0].clone();
    let later = Batch { start: first, truth: batch.truth[1..].to_vec(), ..batch.clone() };
    let led = Batch { lead: 1, ..batch };
    let [expected, found] = [later, led].map(|batch| {
        let mut trainer = Trainer::new(published(), weights.clone(), Kernel::detect()).unwrap();
        (trainer.differentiate(&batch).unwrap(), trainer.gradients().to_vec())
    });
    assert!(found == expected, "{} and {}", found.0, expected.0);
}

#[test]
fn what_is_not_finite_leaves_the_weights() {
    let golden = Golden::open();
    let weights = weights::load(golden_folder().join("net.pt")).unwrap();
    let mut trainer = Trainer::new(published(), weights.clone(), Kernel::detect()).unwrap();
    let mut batch = golden.batch(0);
    batch.truth[1].position[3][0] = f32::NAN;
    let error = trainer.step(&batch).unwrap_err().to_string();
    assert!(error.contains("update 1") && error.contains("not finite"), "{error}");
    assert_eq!(*trainer.weights(), weights);
    assert_eq!(trainer.adam().updates, 0);
}

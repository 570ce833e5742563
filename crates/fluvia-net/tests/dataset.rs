//! Training data: batches are windows of the sequences, the same from any position on, and damaged files are named.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

use std::path::{Path, PathBuf};

use fluvia_net::dataset::{Batch, Damaged, DataSet, FreeFall, Loader, Noise, Rotation, Sampling};
use fluvia_sim::frames::sequence::{Frame, Part, part_file_name, read_part, write_part};
use fluvia_sim::particles::Boundary;

fn sampling() -> Sampling {
    Sampling {
        seed: 7,
        batch: 4,
        steps: 2,
        lead: 0,
        group: 3,
        axis: Some([0.0, -9.81, 0.0]),
        noise: Noise::default(),
        free: FreeFall { count: 0, gravity: [0.0, -9.81, 0.0], dt: 0.02 },
        viscosity: true,
        reach: 0.3,
        damaged: Damaged::Stop,
    }
}

/// Five sequences of two parts, of 9 and 6 frames; sequence k has k + 2 particles, which move along x.
fn write_set(folder: &Path) -> DataSet {
    for k in 0..5 {
        for (number, frames) in [(0, 0..9), (1, 9..15)] {
            let frame = |number: u64| Frame {
                number,
                position: (0..k + 2).map(|i| [number as f32, i as f32, k as f32]).collect(),
                velocity: vec![[50.0, 0.0, k as f32]; k + 2],
                mass: vec![0.125; k + 2],
                viscosity: vec![0.01 * k as f32; k + 2],
            };
            let walls = Boundary {
                position: vec![[0.0, -0.1, k as f32], [500.0, 0.0, 0.0]],
                normal: vec![[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
            };
            let name = format!("sim_{k:04}");
            let part = Part { scene: name.clone(), walls, frames: frames.map(frame).collect() };
            write_part(&folder.join(part_file_name(&name, number)), &part).unwrap();
        }
    }
    DataSet::open(&[folder]).unwrap()
}

fn take(data: &DataSet, sampling: Sampling, position: u64, count: usize) -> Vec<(Batch, u64)> {
    let mut loader = Loader::start(data, sampling, position).unwrap();
    let mut next = || loader.take().unwrap();
    (0..count).map(|_| next()).map(|loaded| (loaded.batch, loaded.next)).collect()
}

#[test]
fn an_epoch_has_every_window_and_goes_on_from_any_batch() {
    let folder = tempfile::tempdir().unwrap();
    let data = write_set(folder.path());
    assert_eq!(data.parts().len(), 10);
    assert_eq!(data.windows(3), [7, 4, 7, 4, 7, 4, 7, 4, 7, 4]);
    let straight = Sampling { axis: None, ..sampling() };
    // 55 windows: fourteen batches, the last with one of the next epoch.
    let batches = take(&data, straight.clone(), 0, 14);
    let mut starts: Vec<(usize, usize)> = Vec::new();
    for (batch, _) in &batches {
        assert_eq!((batch.clouds.len(), batch.wall_clouds.len(), batch.truth.len()), (5, 5, 2));
        assert_eq!(batch.extra.len(), batch.start.position.len());
        for (cloud, walls) in batch.clouds.windows(2).zip(batch.wall_clouds.windows(2)) {
            let [x, _, z] = batch.start.position[cloud[0]];
            assert_eq!(cloud[1] - cloud[0], z as usize + 2, "the particles of one sequence");
            assert_eq!(batch.extra[cloud[0]], 0.01 * z);
            for (k, truth) in (1..).zip(&batch.truth) {
                assert_eq!(truth.position[cloud[0]], [x + k as f32, 0.0, z]);
                assert_eq!(truth.velocity[cloud[0]], [50.0, 0.0, z]);
            }
            // The wall particle far away is not needed, nor is the other where the fluid is not near.
            assert_eq!(walls[1] - walls[0], usize::from(x == 0.0));
            starts.push((z as usize, x as usize));
        }
    }
    starts.truncate(55);
    starts.sort_unstable();
    let all: Vec<(usize, usize)> =
        (0..5).flat_map(|k| (0..7).chain(9..13).map(move |first| (k, first))).collect();
    assert_eq!(starts, all);

    let noise = Noise { position: 0.01, velocity: 0.0 };
    let led = Sampling { lead: 3, ..straight.clone() };
    let leads: Vec<usize> = take(&data, led.clone(), 0, 9).iter().map(|(batch, _)| batch.lead).collect();
    assert!((0..=3).all(|lead| leads.contains(&lead)), "{leads:?}");
    for changed in [sampling(), Sampling { noise, ..straight }, led] {
        let other = take(&data, changed.clone(), 0, 9);
        assert!(other.iter().zip(&batches).all(|(a, b)| a.0 != b.0));
        for from in [0, 3, 7] {
            let again = take(&data, changed.clone(), other[from].1, 8 - from);
            assert!(again == other[from + 1..], "from {from}");
        }
    }
    let [a, b] = [7, 8].map(|seed| take(&data, Sampling { seed, ..sampling() }, 0, 1));
    assert!(a != b);
}

#[test]
fn turning_keeps_heights_and_distances() {
    let part = read_part(&fixtures().join("plain/fall_00.msgpack.zst")).unwrap();
    let mut batch = Batch::new(2, 0);
    batch.push(&part, 0, &Rotation::about([0.0, -9.81, 0.0], 1.0), false, 10.0);
    let frame = &part.frames[0];
    for (a, b) in frame.position.iter().zip(&batch.start.position) {
        assert!((a[1] - b[1]).abs() < 1e-6 && (a[0].hypot(a[2]) - b[0].hypot(b[2])).abs() < 1e-6);
    }
    assert_eq!(batch.wall_position.len(), part.walls.position.len());
    assert!(batch.extra.is_empty());
}

#[test]
fn damaged_and_missing_files() {
    let folder = tempfile::tempdir().unwrap();
    let data = write_set(folder.path());
    let bad = folder.path().join("sim_0002_00.msgpack.zst");
    let bytes = std::fs::read(&bad).unwrap();
    std::fs::write(&bad, &bytes[..bytes.len() / 2]).unwrap();
    // Within an epoch its turn comes.
    let mut loader = Loader::start(&data, sampling(), 0).unwrap();
    let error = (0..20).find_map(|_| loader.take().err()).unwrap().to_string();
    assert!(error.contains("sim_0002_00.msgpack.zst") && error.lines().count() == 1, "{error}");
    let skip = Sampling { damaged: Damaged::Skip, axis: None, ..sampling() };
    let mut loader = Loader::start(&data, skip.clone(), 0).unwrap();
    let loaded: Vec<_> = (0..12).map(|_| loader.take().unwrap()).collect();
    let skipped: Vec<&String> = loaded.iter().flat_map(|loaded| &loaded.skipped).collect();
    assert!(skipped[0].contains("sim_0002_00"), "{skipped:?}");
    let starts = loaded
        .iter()
        .flat_map(|loaded| loaded.batch.clouds.windows(2).map(|cloud| loaded.batch.start.position[cloud[0]]));
    assert!(starts.into_iter().all(|[x, _, z]| z != 2.0 || x >= 9.0));
    // Where one goes on does not change by it.
    let again = take(&data, skip, loaded[4].next, 2);
    assert!(again[1].0 == loaded[6].batch);

    for part in data.parts() {
        std::fs::remove_file(&part.path).unwrap();
    }
    let mut loader = Loader::start(&data, Sampling { damaged: Damaged::Skip, ..sampling() }, 0).unwrap();
    let error = loader.take().unwrap_err().to_string();
    assert!(error.contains("no part"), "{error}");
    let error = DataSet::open(&[folder.path()]).unwrap_err().to_string();
    assert!(error.contains("no sequence"), "{error}");
}

#[test]
fn a_part_that_changes_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let data = write_set(folder.path());
    // All parts become copies of the last, whose frames have other numbers.
    let last = std::fs::read(&data.parts().last().unwrap().path).unwrap();
    for part in data.parts() {
        std::fs::write(&part.path, &last).unwrap();
    }
    let error = Loader::start(&data, sampling(), 0).unwrap().take().unwrap_err().to_string();
    assert!(error.contains("has changed"), "{error}");
}

#[test]
fn windows_longer_than_parts() {
    let folder = tempfile::tempdir().unwrap();
    let data = write_set(folder.path());
    let error = Loader::start(&data, Sampling { steps: 9, ..sampling() }, 0).unwrap_err().to_string();
    assert!(error.contains("at most 9 frames") && error.contains("10 or more"), "{error}");
}

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/sequences")
}

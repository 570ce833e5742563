//! The figures of the published weights on the sequences of the reference data: slow, and it reads those data.
//!
//! `cargo test --release -p fluvia-net --test published_evaluation -- --ignored --nocapture`

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

use std::path::{Path, PathBuf};

use cconv::Kernel;
use fluvia_net::evaluate::{Judged, mean};
use fluvia_net::solver::NetSolver;
use fluvia_net::weights;
use fluvia_sim::frames::sequence::Sequence;

/// The folder of reference data: `FLUVIA_REFERENCE`, or `../shared/reference` beside the repository.
fn reference() -> PathBuf {
    std::env::var_os("FLUVIA_REFERENCE").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference"),
        PathBuf::from,
    )
}

#[test]
#[ignore = "a minute, and it reads reference data"]
fn the_published_weights_have_their_figures() {
    let folder = reference();
    let file = folder.join("splishsplash/eval_official.json");
    let Ok(text) = std::fs::read(&file) else {
        eprintln!("skipped: no {}", file.display());
        return;
    };
    let expected: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let weights = weights::load(folder.join("official/pretrained_model_weights.pt")).unwrap();
    for scene in ["sim_0206", "sim_0301"] {
        let mut sequence = Sequence::open(&folder.join("splishsplash/dataset/valid").join(scene)).unwrap();
        let mut solver = NetSolver::new(&weights, sequence.walls(), &[None], Kernel::detect()).unwrap();
        let mut judged =
            Judged { solver: &mut solver, gravity: weights.config.gravity, dt: weights.config.dt };
        let starts = judged.start_errors(&mut sequence).unwrap();
        let rolled = judged.roll_out(&mut sequence, |_| ()).unwrap();
        let frames = sequence.frames().end;
        let last = |frame: u64| 5 * frame >= 4 * frames;
        let error = |k: usize, late: bool| {
            mean(starts.iter().filter(|s| !late || last(s.frame)).map(|s| s.errors[k])).unwrap()
        };
        let whole = mean(rolled.compared.iter().map(|frame| frame.distance)).unwrap();
        let published = mean(rolled.published.iter().copied()).unwrap();
        for (key, found, within) in [
            ("err_n1_mm", error(0, false), 0.01),
            ("err_n2_mm", error(1, false), 0.01),
            ("err_n1_last_fifth_mm", error(0, true), 0.01),
            ("err_n2_last_fifth_mm", error(1, true), 0.01),
            ("whole_seq_mm", whole, 0.03),
            ("whole_seq_published_loop_mm", published, 0.03),
        ] {
            let expected = expected[scene][key].as_f64().unwrap();
            let found = 1e3 * found;
            println!("{scene} {key}: {found:.4}, published {expected:.4}");
            assert!((found / expected - 1.0).abs() < within, "{scene} {key}: {found}, not {expected}");
        }
    }
}

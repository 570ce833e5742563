//! Weight files that are right: the committed fixtures, what is written and read back, and the published files
//! and cases where the reference folder is at hand.

mod common;

use cconv::{Interpolation, Window};
use common::{fixture, network, reference};
use fluvia_net::config::{Config, Integration};
use fluvia_net::weights::{self, Dense, FileKind, Weights};
use proptest::prelude::*;

#[test]
fn every_form_of_the_same_network_gives_the_same_weights() {
    let expected = network(3);
    let bytes = weights::to_safetensors(&expected).unwrap();
    let forms = [
        "plain.pt",
        "protocol4.pt",
        "parameters.pt",
        "checkpoint.pt",
        "views.pt",
        "plain.h5",
        "model.h5",
        "types.h5",
    ];
    for form in forms {
        let read = weights::load(fixture(form)).unwrap();
        assert_eq!(read, expected, "{form}");
        assert_eq!(weights::to_safetensors(&read).unwrap(), bytes, "{form}");
    }
    assert_eq!(weights::from_bytes("x", bytes).unwrap(), expected);
}

#[test]
fn six_outputs_are_positions_and_velocities() {
    let read = weights::load(fixture("six_outputs.pt")).unwrap();
    assert_eq!(read.config.integration, Integration::Velocity);
    assert_eq!(read, network(6));
}

/// The fully connected part of a layer.
fn dense(weights: &mut Weights, layer: usize) -> &mut Dense {
    weights.layers[layer].dense.as_mut().expect("a fully connected part")
}

#[test]
fn a_network_of_other_widths_and_inputs_survives_safetensors() {
    let config = Config {
        filter_size: [2, 3, 5],
        extra_inputs: vec!["viscosity".into(), "age".into()],
        particle_radius: 0.01,
        filter_radius: 0.045,
        dt: 1.0 / 60.0,
        gravity: [0.1, -8.918, 0.0],
        viscosity: 0.3,
        density: 998.2,
        output_scale: 0.1,
        integration: Integration::Velocity,
        ..Config::default()
    };
    let mut weights = Weights::zeros(config, 16, &[12, 7, 12]);
    dense(&mut weights, 1).weight[3] = -0.0;
    weights.layers[3].convolution.kernel[11] = f32::MIN_POSITIVE / 4.0;
    weights.training = Some("{\"iterations\": 50000, \"note\": \"\u{fc}\"}".into());
    let bytes = weights::to_safetensors(&weights).unwrap();
    let read = weights::from_bytes("x", bytes.clone()).unwrap();
    assert_eq!(read, weights);
    // Equality of numbers takes -0 for 0, that of bytes does not.
    assert_eq!(weights::to_safetensors(&read).unwrap(), bytes);
}

#[test]
fn the_networks_of_the_ablations_survive_safetensors() {
    for (interpolation, window, fully_connected) in [
        (Interpolation::Nearest, Window::Poly6, true),
        (Interpolation::LinearBorder, Window::Triangular, false),
        (Interpolation::Linear, Window::None, false),
    ] {
        let config = Config { interpolation, window, fully_connected, ..Config::default() };
        let weights = Weights::random(config, 3, &[4, 4], 1);
        let read = weights::from_bytes("x", weights::to_safetensors(&weights).unwrap()).unwrap();
        assert_eq!(read, weights);
        let dense = weights.tensors().iter().filter(|tensor| tensor.name.starts_with("dense")).count();
        assert_eq!(dense, if fully_connected { 8 } else { 0 });
        assert_eq!(weights.clone().values_mut().len(), weights.tensors().len());
    }
}

#[test]
fn a_new_input_has_no_influence() {
    for fully_connected in [true, false] {
        let config = Config { fully_connected, filter_size: [1, 2, 2], ..Config::default() };
        let weights = Weights::random(config, 3, &[4], 1);
        let wider = weights.clone().with_extra_input("viscosity");
        wider.check().unwrap();
        assert_eq!(wider.config.extra_inputs, ["viscosity"]);
        // Four rows of each cell stay, the fifth is zero.
        for (cell, rows) in wider.fluid.kernel.chunks_exact(15).zip(weights.fluid.kernel.chunks_exact(12)) {
            assert_eq!((&cell[..12], &cell[12..]), (rows, &[0.0; 3][..]));
        }
        if let (Some(wider), Some(dense)) = (&wider.fluid_dense, &weights.fluid_dense) {
            assert_eq!((&wider.weight[..12], &wider.weight[12..]), (dense.weight.as_slice(), &[0.0; 3][..]));
        }
    }
}

#[test]
fn weights_that_do_not_fit_are_not_written() {
    type Change = fn(&mut Weights);
    let changes: [(Change, &str); 8] = [
        (|w| w.layers[1].dense = None, "dense2 is missing in a fully connected network"),
        (|w| w.config.fully_connected = false, "dense0_fluid in a network that is not fully connected"),
        (|w| dense(w, 0).bias[1] = f32::NAN, "tensor `dense1.bias`: value 1 is NaN"),
        (|w| w.layers[1].convolution.outputs = 4, "conv2 outputs: 4, expected 3"),
        (|w| w.config.extra_inputs.push("age".into()), "conv0_fluid inputs: 4, expected 5"),
        (
            |w| w.fluid.kernel.truncate(287),
            "tensor `conv0_fluid.kernel` has 287 values, expected [2, 3, 4, 4, 3]",
        ),
        (|w| w.layers.clear(), "no layer after the first"),
        (|w| w.config.dt = 0.0, "dt is 0, expected"),
    ];
    for (change, message) in changes {
        let mut weights = network(3);
        change(&mut weights);
        let fault = weights::to_safetensors(&weights).unwrap_err().to_string();
        assert!(fault.contains(message), "`{message}` is not in `{fault}`");
    }
}

#[test]
fn a_saved_file_is_whole_and_replaces_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.safetensors");
    weights::save_safetensors(&path, &network(6)).unwrap();
    weights::save_safetensors(&path, &network(3)).unwrap();
    assert_eq!(weights::load(&path).unwrap(), network(3));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file may stay");
    let missing =
        weights::save_safetensors(folder.path().join("no/net.safetensors"), &network(3)).unwrap_err();
    assert!(missing.to_string().contains("net.safetensors"), "{missing}");
}

#[test]
fn a_summary_lists_files_of_every_kind() {
    let summary = weights::summarize(fixture("checkpoint.pt")).unwrap();
    assert_eq!(summary.kind, FileKind::PyTorch);
    let names: Vec<_> = summary.tensors.iter().map(|tensor| tensor.name.as_str()).collect();
    assert!(names.contains(&"model_state_dict.module.conv1.kernel"), "{names:?}");
    assert!(names.contains(&"optimizer_state_dict.state.0.exp_avg"), "{names:?}");
    let gravity = summary.tensors.iter().find(|tensor| tensor.name.ends_with("gravity")).unwrap();
    assert_eq!((gravity.shape.as_slice(), gravity.element.as_str()), (&[3][..], "f32"));
    let statistics = gravity.statistics.unwrap();
    assert_eq!((statistics.min, statistics.max, statistics.non_finite), (f64::from(-9.81_f32), 0.0, 0));
    assert_eq!(statistics.mean, f64::from(-9.81_f32) / 3.0);

    let summary = weights::summarize(fixture("model.h5")).unwrap();
    assert_eq!(summary.kind, FileKind::Keras);
    assert_eq!(summary.metadata[0], ("backend".into(), "tensorflow".into()));
    // The optimiser's array of 3 is counted too.
    assert_eq!(summary.parameters(), network(3).parameters() + 3);

    let summary = weights::summarize_bytes("x", weights::to_safetensors(&network(3)).unwrap()).unwrap();
    assert_eq!(summary.kind, FileKind::Safetensors);
    assert!(summary.metadata[0].1.contains("\"integration\":\"paper\""), "{:?}", summary.metadata);
}

proptest! {
    #[test]
    fn any_configuration_survives(
        radius in 1e-6_f32..10.0,
        dt in 1e-6_f32..1.0,
        gravity in prop::array::uniform3(-100_f32..100.0),
        viscosity in 0_f32..1.0,
        density in 1e-3_f32..1e5,
        scale in 1e-6_f32..1.0,
        first in 1_usize..5,
        hidden in prop::collection::vec(1_usize..5, 0..4),
        names in prop::collection::vec(".{0,8}", 0..3),
        training in prop::option::of(".*"),
        value in any::<f32>().prop_filter("finite", |value| value.is_finite()),
    ) {
        let config = Config {
            filter_size: [1, 2, 3],
            extra_inputs: names,
            particle_radius: radius,
            filter_radius: radius * 4.5,
            dt,
            gravity,
            viscosity,
            density,
            output_scale: scale,
            integration: Integration::Paper,
            ..Config::default()
        };
        let mut weights = Weights::zeros(config, first, &hidden);
        dense(&mut weights, 0).weight[0] = value;
        weights.training = training;
        let read = weights::from_bytes("x", weights::to_safetensors(&weights).unwrap()).unwrap();
        prop_assert_eq!(read, weights);
    }
}

#[test]
fn the_published_files_hold_the_same_network() {
    let (Some(pt), Some(h5)) = (
        reference("official/pretrained_model_weights.pt"),
        reference("official/pretrained_model_weights.h5"),
    ) else {
        return;
    };
    let (pt, h5) = (weights::load(pt).unwrap(), weights::load(h5).unwrap());
    for (a, b) in pt.tensors().iter().zip(&h5.tensors()) {
        assert_eq!(a, b);
    }
    assert_eq!(pt, h5);
    assert_eq!(pt.config, Config::default());
    // Filters of 64 cells and the dense part, that is 65, for 96 * 64 + 64 * 64 + 64 * 3 + 4 * 32 weights; the
    // wall filters have no dense part; biases.
    let biases = 3 * 32 + 2 * (64 + 64 + 3);
    assert_eq!(pt.parameters(), 65 * (96 * 64 + 64 * 64 + 64 * 3 + 4 * 32) + 64 * 3 * 32 + biases);
    // conv0_fluid.kernel[0, 0, 0, 0, 1] and dense1.weight[0, 1] as PyTorch prints them, to its last digit.
    assert_eq!(pt.fluid.kernel[1], 0.361_067_9);
    assert_eq!(pt.layers[0].dense.as_ref().unwrap().weight[64], -0.010_485_196);
    let bytes = weights::to_safetensors(&pt).unwrap();
    assert_eq!(weights::to_safetensors(&h5).unwrap(), bytes);
    assert_eq!(weights::from_bytes("x", bytes).unwrap(), pt);
}

/// The network of the cases: zero but for six numbers.
fn probe() -> Weights {
    let mut probe = Weights::zeros(Config::default(), 32, &[64, 64]);
    probe.fluid_dense.as_mut().expect("a fully connected part").weight[3] = 2.0;
    dense(&mut probe, 0).weight[(64 + 3) * 64 + 10] = 0.5;
    dense(&mut probe, 1).weight[10 * 64 + 20] = 3.0;
    dense(&mut probe, 2).weight[10 * 3] = 1.25;
    dense(&mut probe, 2).weight[20 * 3 + 1] = 0.3125;
    dense(&mut probe, 2).bias[2] = -0.625;
    probe
}

#[test]
fn the_cases_are_read_as_their_table_says() {
    for case in ["a23_pt_plain.pt", "a24_pt_module.pt", "a25_pt_nested.pt", "a27_h5_full_model.h5"] {
        if let Some(path) = reference(&format!("cases/{case}")) {
            assert_eq!(weights::load(path).unwrap(), probe(), "{case}");
        }
    }
    if let Some(path) = reference("cases/a26_pt_legacy.pt") {
        let message = weights::summarize(path).unwrap_err().to_string();
        assert!(
            message.contains("a26_pt_legacy.pt: the old PyTorch form from before version 1.6"),
            "{message}"
        );
    }
    if let Some(path) = reference("cases/a28_safetensors_cut.safetensors") {
        for message in [weights::summarize(&path).unwrap_err(), weights::load(&path).unwrap_err()] {
            let message = message.to_string();
            assert!(message.contains("25324 bytes expected, 24624 found"), "{message}");
        }
    }
}

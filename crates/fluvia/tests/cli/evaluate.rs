//! `fluvia evaluate` and `fluvia plot`.

use crate::common::{Folder, SCENE, fixture, scene_with};

/// A run of 12 steps of DFSPH.
fn truth() -> Folder {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver dfsph --steps 12 --out truth");
    folder
}

#[test]
fn a_solver_against_itself_and_others() {
    let folder = truth();
    let found = folder.succeed("evaluate --solver dfsph --data truth --json").last_json();
    // The same rollout to the last bit.
    for key in ["whole_seq_mm", "whole_seq_back_mm", "height_error_mm", "energy_error_j_per_kg"] {
        assert_eq!(found[key], 0.0, "{key}");
    }
    // Free fall has no pressure that a start could forget.
    assert!(found["err_n2_mm"].as_f64().unwrap() < 1e-3, "{found}");
    assert_eq!(found["sequences"]["truth"]["whole_seq_mm"], 0.0);
    assert_eq!((&found["non_finite_frames"], &found["unstable_from"]), (&0.into(), &serde_json::Value::Null));
    let lone = found["lone_acceleration_m_per_s2"][1].as_f64().unwrap();
    assert!((lone + 9.81).abs() < 1e-3, "{lone}");
    assert!(found["truth"]["highest_density"].as_f64().unwrap() > 0.5);

    // Without options it is the shipped network.
    let default = folder.succeed("evaluate --data truth --json").last_json();
    assert_eq!(folder.succeed("evaluate --weights default --data truth --json").last_json(), default);

    let weights = fixture("plain.pt");
    let command = format!("evaluate --weights net={weights} --solver pbf --data truth --out report");
    let printed = folder.succeed(&command).stdout;
    assert!(printed.contains("| figure | truth | net | pbf |"), "{printed}");
    assert_eq!(std::fs::read_to_string(folder.path("report/report.md")).unwrap(), printed);
    let report = folder.json("report/report.json");
    let of_net = report["solvers"]["net"]["whole_seq_mm"].as_f64().unwrap();
    // What falls freely is exact in one and not in the other.
    assert!(of_net > 10.0 * report["solvers"]["pbf"]["whole_seq_mm"].as_f64().unwrap(), "{report}");
    assert_eq!(report["curves"]["truth"]["solvers"][1]["label"], "pbf");
    let picture = std::fs::read_to_string(folder.path("report/truth.svg")).unwrap();
    assert!(["distance d of Eq. 18, mm", "net", "pbf"].iter().all(|text| picture.contains(text)));
    // Of the five panels that have a point for every frame.
    assert_eq!(curves(&picture), 5 * 3);
}

#[test]
fn a_data_set_is_its_validation_scenes() {
    let folder = Folder::new();
    folder.succeed(
        "generate --preset default --scenes 1 --valid 2 --duration 0.2 --particles 1000..1100 \
         --solver-dt-max 0.005 --out data --quiet",
    );
    let names = |data: &str| -> Vec<String> {
        let found =
            folder.succeed(&format!("evaluate --solver dfsph --data {data} --solver-dt-max 0.005 --json"));
        let found = found.last_json();
        found["sequences"].as_object().unwrap().keys().cloned().collect()
    };
    assert_eq!(names("data"), ["sim_0002", "sim_0003"]);
    assert_eq!(names("data/train"), ["sim_0001"]);
    assert_eq!(names("data/valid/sim_0003"), ["sim_0003"]);
    // A start forgets the pressures of the frames before, so one sequence is no figure of another.
    let found = folder.succeed("evaluate --solver dfsph --data data --json").last_json();
    let error = |value: &serde_json::Value| value["err_n1_mm"].as_f64().unwrap();
    let of_each: Vec<f64> = ["sim_0002", "sim_0003"].map(|name| error(&found["sequences"][name])).to_vec();
    assert!((error(&found) - (of_each[0] + of_each[1]) / 2.0).abs() < 1e-9);
}

#[test]
fn what_is_refused() {
    let folder = truth();
    let weights = fixture("plain.pt");
    folder.fail("evaluate --solver dfsph --precision bf16 --data truth", &["--precision", "--weights"]);
    folder.fail("evaluate --solver pbf --data nowhere --out out", &["nowhere"]);
    std::fs::create_dir(folder.path("empty")).unwrap();
    folder.fail("evaluate --solver pbf --data empty --out out", &["empty", "no frames"]);
    folder.succeed(
        "generate --preset viscosity --scenes 1 --valid 0 --duration 0.1 --particles 1000..1200 --out set",
    );
    folder.fail(
        "evaluate --solver dfsph --data set --out out",
        &["set: ", "without the folder valid", "set/train"],
    );
    folder.fail(
        &format!("evaluate --weights {weights} --weights {weights} --data truth --out out"),
        &["LABEL=FILE"],
    );
    folder.fail("evaluate --weights missing.pt --data truth --out out", &["missing.pt"]);
    // Other steps than those of the weights.
    folder.write("slow.json", scene_with(r#""dt": 0.05"#));
    folder.succeed("simulate slow.json --solver dfsph --steps 2 --out slow");
    folder.fail(
        &format!("evaluate --weights {weights} --data slow --out out"),
        &["slow", "`dt`", "0.05 s", "0.02 s"],
    );
    // A viscosity that the weights do not know.
    folder.write("thick.json", scene_with(r#""viscosity": 0.3"#));
    folder.succeed("simulate thick.json --solver dfsph --solver-dt 0.001 --steps 2 --out thick");
    folder.fail(
        &format!("evaluate --weights {weights} --data thick --out out"),
        &["thick", "`viscosity`", "0.3", "0.01"],
    );
    // Viscosity depends on the solver's step.
    let warned =
        |step: &str| folder.succeed(&format!("evaluate --solver dfsph {step} --data thick --json")).stderr;
    assert!(warned("").contains("warning: thick: viscosity 0.3"));
    assert_eq!(warned("--solver-dt 0.001"), "");
    // Particles that come later cannot be followed.
    folder.write("emitter.json", SCENE.replace("0.2]}", "0.2], \"start\": 0, \"stop\": 9, \"step\": 4}"));
    folder.succeed("simulate emitter.json --solver dfsph --steps 6 --out emitter");
    folder.fail("evaluate --solver dfsph --data emitter --out out", &["emitter", "frame 4", "128", "64"]);
    std::fs::remove_file(folder.path("truth/fluid_0005.npz")).unwrap();
    folder.fail("evaluate --solver dfsph --data truth --out out", &["truth", "missing between 0 and 12"]);
}

/// How many curves a picture has that are of more than two points: marks of axes have two.
fn curves(picture: &str) -> usize {
    picture.lines().filter(|line| line.contains("<polyline") && line.matches(',').count() > 2).count()
}

#[test]
fn curves_of_trainings() {
    let folder = Folder::new();
    for (run, scale) in [("a", 1.0), ("b", 2.0)] {
        std::fs::create_dir(folder.path(run)).unwrap();
        let line = |k: u32| {
            let loss = scale / (1.0 + f64::from(k));
            let train = format!(
                r#"{{"kind":"train","update":{k},"loss":{loss},"gradient":1.0,"rate":0.001,"particles_per_s":5e4}}"#
            );
            let valid = format!(
                r#"{{"kind":"valid","update":{k},"loss":{loss},"err_n1_mm":{loss},"err_n2_mm":{loss}}}"#
            );
            if k.is_multiple_of(10) { format!("{train}\n{valid}\n") } else { format!("{train}\n") }
        };
        folder.write(&format!("{run}/metrics.jsonl"), (1..=40).map(line).collect::<String>());
    }
    folder.succeed("plot a");
    let picture = std::fs::read_to_string(folder.path("a/curves.svg")).unwrap();
    assert!(picture.contains("validation: error after one step, mm"), "{picture}");
    let of_one = curves(&picture);
    assert!(of_one >= 6, "{picture}");
    folder.succeed("plot first=a b --out both.svg");
    let picture = std::fs::read_to_string(folder.path("both.svg")).unwrap();
    assert!(picture.contains("first") && picture.contains("rate"));
    assert_eq!(curves(&picture), 2 * of_one);
    folder.fail("plot a b", &["--out"]);
    folder.fail("plot nowhere", &["nowhere/metrics.jsonl"]);
    folder.write("a/metrics.jsonl", "{}\n");
    folder.fail("plot a", &["a/metrics.jsonl", "line 1"]);
}

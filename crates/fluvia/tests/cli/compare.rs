//! `fluvia compare`.

use crate::common::{Folder, SCENE, scene_with};

/// Two runs of a scene that differ in their solver, and one with other wall particles.
fn runs() -> Folder {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver dfsph --steps 12 --out dfsph");
    folder.succeed("simulate scene.json --solver dfsph --seed 1 --steps 12 --out control");
    folder.succeed("simulate scene.json --solver pbf --steps 10 --out pbf");
    folder
}

#[test]
fn curves_tables_and_plots() {
    let folder = runs();
    let run = folder.succeed("compare dfsph pbf --control control --json");
    let found = run.last_json();
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
    };
    // The frames that both have.
    assert_eq!(numbers(&found["frame"]), (0..=10).map(f64::from).collect::<Vec<_>>());
    assert!((numbers(&found["time_s"])[10] - 0.2).abs() < 1e-9);
    for key in ["a_to_b_m", "b_to_a_m", "control_m"] {
        let distance = numbers(&found["distance"][key]);
        assert_eq!((distance.len(), distance[0]), (11, 0.0), "{key}");
    }
    assert!(numbers(&found["distance"]["a_to_b_m"])[10] > 0.0);
    let a = &found["runs"][0];
    // 64 particles of a block at 0.5 and 0.2 m/s, its middle at 0.3 m.
    assert_eq!(a["particles"][0], 64);
    assert!((numbers(&a["kinetic_energy_j_per_kg"])[0] - 0.145).abs() < 1e-6);
    assert!((numbers(&a["potential_energy_j_per_kg"])[0] - 9.81 * 0.3).abs() < 1e-4);
    assert!((a["center_of_mass_m"][0][1].as_f64().unwrap() - 0.3).abs() < 1e-6);
    assert!((numbers(&a["surface_height_m"])[0] - 0.375).abs() < 1e-6);
    // Four particles in a row of spacing 0.05 m, in two directions.
    assert!((numbers(&a["spread_m"])[0] - (2.0_f64 * 0.003125).sqrt()).abs() < 1e-6);
    assert!((numbers(&a["nearest_median_m"])[0] - 0.05).abs() < 1e-6);
    assert_eq!((&a["outside"][10], &a["dense_particles"][0]), (&0.into(), &0.into()));
    assert!((0.5..0.85).contains(&numbers(&a["highest_density"])[0]));

    let run = folder.succeed("compare solver=dfsph other=pbf --every 5 --out report");
    assert!(
        run.stdout.contains("A: solver (64 particles), B: other (64 particles); 3 frames"),
        "{}",
        run.stdout
    );
    assert!(run.stdout.contains("| kinetic energy per mass, J/kg |"), "{}", run.stdout);
    assert_eq!(std::fs::read_to_string(folder.path("report/compare.md")).unwrap(), run.stdout);
    assert_eq!(folder.json("report/compare.json")["frame"], serde_json::json!([0, 5, 10]));
    let plots = std::fs::read_to_string(folder.path("report/compare.svg")).unwrap();
    assert!(plots.starts_with("<svg") && plots.trim_end().ends_with("</svg>"));
    assert!(["solver", "other", "distance d of Eq. 18, mm"].iter().all(|text| plots.contains(text)));
}

#[test]
fn a_run_is_no_way_from_itself() {
    let folder = runs();
    let found = folder.succeed("compare dfsph dfsph --json").last_json();
    for difference in found["differences"].as_array().unwrap() {
        assert_eq!((&difference["largest"], &difference["mean"]), (&0.0.into(), &0.0.into()), "{difference}");
        assert!(difference["range"].as_f64().unwrap() > 0.0, "{difference}");
    }
    assert_eq!(found["runs"][0]["kinetic_energy_j_per_kg"], found["runs"][1]["kinetic_energy_j_per_kg"]);
}

#[test]
fn frames_without_particles_are_gaps() {
    let folder = Folder::new();
    let jet = r#""shape": "box", "scale": 0.2, "translation": [0, 0.3, 0], "start": 2"#;
    folder.write("scene.json", crate::common::scene_of(jet));
    folder.succeed("simulate scene.json --solver pbf --steps 4 --out a");
    folder.succeed("simulate scene.json --steps 4 --solver dfsph --out b");
    let found = folder.succeed("compare a b --out report --json").last_json();
    let distance = found["distance"]["a_to_b_m"].as_array().unwrap();
    assert!(distance[..2].iter().all(serde_json::Value::is_null) && distance[2] == 0.0, "{distance:?}");
    folder.succeed("compare a b");
}

#[test]
fn runs_of_different_scenes_are_compared_with_a_warning() {
    let folder = runs();
    folder.succeed("simulate dam_break --solver pbf --steps 1 --out other");
    let run = folder.succeed("compare dfsph other");
    assert!(
        run.stderr.contains("warning: dfsph has ") && run.stderr.contains("not the same scene?"),
        "{}",
        run.stderr
    );
    assert_eq!(folder.succeed("compare dfsph pbf").stderr, "");
}

#[test]
fn what_cannot_be_compared() {
    let folder = runs();
    folder.write("slow.json", scene_with(r#""dt": 0.01"#));
    folder.succeed("simulate slow.json --solver pbf --steps 2 --out slow");
    folder.write("fine.json", scene_with(r#""particle_radius": 0.02"#));
    folder.succeed("simulate fine.json --solver pbf --steps 2 --out fine");
    folder.fail("compare dfsph slow --out out", &["slow", "0.01 s", "dfsph", "0.02 s"]);
    folder.fail("compare dfsph fine --out out", &["fine", "0.02 m", "0.025 m"]);
    folder.fail("compare dfsph nowhere --out out", &["nowhere"]);
    for frame in 1..=10 {
        std::fs::remove_file(folder.path(&format!("pbf/fluid_{frame:04}.npz"))).unwrap();
    }
    std::fs::remove_file(folder.path("dfsph/fluid_0000.npz")).unwrap();
    folder.fail("compare dfsph pbf --out out", &["pbf", "no frame", "dfsph"]);
    assert_eq!(folder.run("compare dfsph").code, Some(2));
    assert_eq!(folder.run("compare dfsph control --every 0").code, Some(2));
}

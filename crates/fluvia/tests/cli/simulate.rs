//! `fluvia simulate`: frames, determinism, interruption and resuming.

use std::process::Stdio;
use std::time::Duration;

#[cfg(target_os = "linux")]
use crate::common::SmallDisk;
use crate::common::{Folder, SCENE, fixture, scene_of, scene_with};

const FORMATS: &str = "--format npz,ply,bgeo,vtu,vtk";

/// The solvers, as arguments.
fn solvers() -> [String; 3] {
    ["--solver pbf".into(), "--solver dfsph".into(), format!("--weights {}", fixture("plain.pt"))]
}

#[test]
fn without_options_it_is_the_shipped_network() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --steps 3");
    let record = folder.json("out/scene/run.json");
    assert_eq!((&record["solver"], &record["weights"]["name"]), (&"network".into(), &"default".into()));
    folder.succeed("simulate scene.json --weights default --steps 3 --out named");
    assert!(folder.files("out/scene") == folder.files("named"));
    // Water is what it knows; another network takes other liquids.
    folder.write("thick.json", scene_with(r#""viscosity": 0.2"#));
    let run = folder.run("simulate thick.json --steps 3 --out thick");
    assert!(run.code == Some(1) && run.stderr.contains("made for 0.01"), "{}", run.stderr);
    assert!(run.stderr.contains("--weights viscosity takes"), "{}", run.stderr);
    for viscosity in ["0.01", "0.2", "0.3"] {
        folder.write("thick.json", scene_with(&format!(r#""viscosity": {viscosity}"#)));
        folder.succeed("simulate thick.json --weights viscosity --steps 3 --out thick --overwrite");
    }
    folder.write("tar.json", scene_with(r#""viscosity": 1.5"#));
    for weights in ["default", "viscosity"] {
        let run = folder.run(&format!("simulate tar.json --weights {weights} --steps 3 --out tar"));
        assert!(run.code == Some(1) && !run.stderr.contains("dfsph"), "{}", run.stderr);
    }
    // Nor do they take all.
    for (key, weights) in
        [(r#""viscosity": 0.9"#, "viscosity"), (r#""dt": 0.01"#, "default"), (r#""density": 900"#, "default")]
    {
        folder.write("other.json", scene_with(key));
        let run = folder.run(&format!("simulate other.json --weights {weights} --steps 3 --out other"));
        assert!(run.code == Some(1), "{key}: {}", run.stderr);
        assert!(run.stderr.ends_with("(--solver dfsph takes others)\n"), "{key}: {}", run.stderr);
    }
    let run = folder.run("simulate scene.json --weights viscous --steps 3 --out viscous");
    assert!(run.code == Some(1) && run.stderr.contains("there are default, viscosity"), "{}", run.stderr);
}

#[test]
fn n_steps_write_n_plus_one_frames_in_every_format() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    for (k, solver) in solvers().iter().enumerate() {
        let run = folder.succeed(&format!("simulate scene.json {solver} --steps 3 --out {k} {FORMATS}"));
        assert!(run.stdout.contains("64 particles, 3 steps"), "{}", run.stdout);
        assert_eq!(run.stderr, "");
        let names: Vec<String> = folder.files(&k.to_string()).into_keys().collect();
        let mut expected = vec!["fluid.pvd".to_owned(), "state.npz".to_owned()];
        for extension in ["npz", "ply", "bgeo", "vtu", "vtk"] {
            expected.push(format!("box.{extension}"));
            expected.extend((0..=3).map(|frame| format!("fluid_{frame:04}.{extension}")));
        }
        expected.sort();
        assert_eq!(names, expected);
    }
}

#[test]
fn runs_are_the_same_bytes_at_any_number_of_threads() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    for solver in solvers() {
        let run = |out: &str, more: &str| {
            folder
                .succeed(&format!("simulate scene.json {solver} --steps 12 --out {out} --overwrite {more}"));
            folder.files(out)
        };
        let first = run("a", "--threads 1");
        assert_eq!(first, run("b", "--threads 2"));
        assert_eq!(first, run("c", "--threads 2"));
        assert_ne!(first["box.npz"], run("d", "--seed 7")["box.npz"]);
    }
}

#[test]
fn a_killed_run_goes_on_to_the_same_bytes() {
    let folder = Folder::new();
    // Beside the block a body that falls out of the scene, and one that arrives in parts.
    let falls = r#""shape": "box", "scale": 0.1, "translation": [3, 0.3, 0]"#;
    let arrives = r#""shape": "box", "scale": [0.2, 0.05, 0.2], "translation": [0, 0.6, 0], "velocity": [0, -2, 0],
        "start": 7, "stop": 90, "step": 20"#;
    folder.write("scene.json", SCENE.replace("}]\n}", &format!("}}, {{{falls}}}, {{{arrives}}}]\n}}")));
    for solver in solvers() {
        let arguments =
            |out: &str| format!("simulate scene.json {solver} --steps 120 --out {out} --quiet {FORMATS}");
        folder.succeed(&format!("{} --overwrite", arguments("whole")));
        let last = folder.succeed("inspect whole/fluid_0120.npz --json").last_json();
        // The small network has weights at random, which may well hold up what should fall.
        let particles = last["particles"].as_u64().unwrap();
        assert!(particles == 64 + 5 * 16 || solver.contains("weights"), "{solver}: {particles} particles");
        // Moments spread over a run, the first before anything is on disk.
        for k in 0..20u64 {
            let mut command = folder.command(&format!("{} --resume", arguments("killed")));
            let mut child = command.stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
            std::thread::sleep(Duration::from_micros(3_000 + 7_919 * (k * k % 23)));
            child.kill().unwrap();
            child.wait().unwrap();
        }
        folder.succeed(&format!("{} --resume", arguments("killed")));
        assert!(folder.files("killed") == folder.files("whole"), "{solver}: files differ");
        std::fs::remove_dir_all(folder.path("killed")).unwrap();
    }
}

#[test]
#[cfg(unix)]
fn control_c_leaves_whole_frames() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let stopped =
        folder.interrupt("simulate scene.json --solver pbf --steps 100000 --out out", "out/fluid_0003.npz");
    assert!(stopped.stderr.contains("--resume"), "{}", stopped.stderr);
    let frames = folder.files("out").keys().filter(|name| name.starts_with("fluid_")).count();
    let state = folder.succeed("inspect out/state.npz --json").last_json();
    assert_eq!(state["particles"], 64);
    let run = folder.succeed(&format!(
        "simulate scene.json --solver pbf --steps {} --out out --resume --json",
        frames + 1
    ));
    assert_eq!(run.last_json()["steps"], frames + 1);
}

#[test]
fn resuming_another_run_is_refused() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.write("other.json", scene_with(r#""gravity": [0, -5, 0]"#));
    folder.succeed("simulate scene.json --solver pbf --steps 2 --out out");
    let before = folder.files("out");
    for (arguments, word) in [
        ("simulate other.json --solver pbf --steps 4 --out out --resume", "scene"),
        ("simulate scene.json --solver pbf --steps 4 --out out --resume --seed 1", "seed"),
        ("simulate scene.json --solver pbf --steps 4 --out out --resume --format ply", "formats"),
        (
            "simulate scene.json --solver pbf --steps 4 --out out --resume --solver-dt 0.002",
            "solver_dt_max: 0.004, now: none",
        ),
        ("simulate scene.json --solver pbf --steps 4 --out out", "--resume"),
    ] {
        let run = folder.run(arguments);
        assert_eq!(run.code, Some(1), "{arguments}");
        assert!(run.stderr.contains(word), "{arguments}: {}", run.stderr);
        assert!(folder.files("out") == before, "{arguments}: changed the run");
    }
    // More steps, then again from the beginning: the same bytes.
    folder.succeed("simulate scene.json --solver pbf --steps 4 --out out --resume");
    let extended = folder.files("out");
    folder.write("out/notes.txt", "mine");
    folder.succeed("simulate scene.json --solver pbf --steps 4 --out out --overwrite");
    assert_eq!(std::fs::read(folder.path("out/notes.txt")).unwrap(), b"mine");
    std::fs::remove_file(folder.path("out/notes.txt")).unwrap();
    assert!(folder.files("out") == extended);
}

#[test]
fn a_run_that_has_ended_keeps_its_record() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 3 --out out");
    let record = std::fs::read(folder.path("out/run.json")).unwrap();
    for steps in [3, 1] {
        let run = folder
            .succeed(&format!("simulate scene.json --solver pbf --steps {steps} --out out --resume --json"));
        assert_eq!(run.last_json()["steps"], 3);
        assert!(run.last_json()["ms_per_step"].as_f64().unwrap() > 0.0);
        assert!(std::fs::read(folder.path("out/run.json")).unwrap() == record);
    }
    // Another kernel goes on: the record names both.
    let mut changed = folder.json("out/run.json");
    changed["kernel"] = "abacus".into();
    folder.write("out/run.json", changed.to_string());
    let run = folder.succeed("simulate scene.json --solver pbf --steps 4 --out out --resume");
    assert!(run.stderr.contains("abacus"), "{}", run.stderr);
    let record = folder.json("out/run.json");
    assert_eq!(record["earlier"][0]["kernel"], "abacus");
    assert_eq!(record["earlier"][0]["until_step"], 3);
}

#[test]
fn speeds_beyond_all_measure_stay_numbers() {
    let folder = Folder::new();
    let body = r#""shape": "box", "scale": 0.2, "translation": [0, 0.3, 0], "velocity": [1e20, 0, 0]"#;
    folder.write("scene.json", scene_of(body));
    folder.run("simulate scene.json --solver pbf --steps 1 --out out");
    let record = folder.json("out/run.json");
    let summary = &record["summary"];
    assert!(summary.is_null() || summary["highest_speed"].is_number(), "{summary}");
    folder.succeed("render out -o last.png --size 64");
}

#[test]
fn fluids_that_start_too_late_are_a_warning() {
    let folder = Folder::new();
    let late = r#""shape": "box", "scale": 0.2, "translation": [0, 0.3, 0], "start": 5"#;
    folder.write("scene.json", scene_of(late));
    let run = folder.succeed("simulate scene.json --solver pbf --steps 3 --out out");
    assert!(run.stderr.contains("no particles within 3 steps"), "{}", run.stderr);
    assert!(
        !folder
            .succeed("simulate scene.json --solver pbf --steps 5 --out long")
            .stderr
            .contains("no particles")
    );
}

#[test]
fn frames_that_are_no_run_are_never_replaced() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 2 --out out");
    std::fs::remove_file(folder.path("out/state.npz")).unwrap();
    let before = folder.files("out");
    // Another run without a state file, then frames of whoever made them.
    let other = "simulate scene.json --solver pbf --steps 4 --out out --resume --seed 1";
    let same = "simulate scene.json --solver pbf --steps 4 --out out --resume";
    let refused = |arguments: &str, word: &str| {
        let run = folder.run(arguments);
        assert_eq!(run.code, Some(1), "{arguments}: {}", run.stderr);
        assert!(run.stderr.contains(word), "{}", run.stderr);
        assert!(folder.files("out") == before, "{arguments}: changed the files");
    };
    refused(other, "not the same run");
    let record = std::fs::read(folder.path("out/run.json")).unwrap();
    std::fs::remove_file(folder.path("out/run.json")).unwrap();
    refused(same, "run.json");
    // The record of this very run says that it was killed before its first state.
    folder.write("out/run.json", record);
    folder.succeed(same);
    folder.succeed("simulate scene.json --solver pbf --steps 4 --out whole");
    assert!(folder.files("out") == folder.files("whole"));
}

#[test]
fn where_a_run_goes_by_default() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 1");
    assert!(folder.path("out/scene/fluid_0001.npz").exists());
    // A directory of the name of a shipped scene does not hide the scene.
    folder.succeed("simulate dam_break --solver pbf --steps 0 --out dam_break");
    folder.succeed("simulate dam_break --solver pbf --steps 0 --out dam_break --resume");
}

#[test]
fn the_precision_is_recorded_and_a_run_keeps_it() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let weights = fixture("plain.pt");
    let network = format!("simulate scene.json --weights {weights}");
    folder.succeed(&format!("{network} --steps 2 --out exact --threads 1"));
    folder.succeed(&format!("{network} --steps 2 --out out --precision bf16 --threads 1"));
    let record = folder.json("out/run.json");
    assert_eq!(record["parameters"]["precision"], "bf16");
    let frame = |run: &str| std::fs::read(folder.path(&format!("{run}/fluid_0002.npz"))).unwrap();
    assert!(frame("exact") != frame("out"));
    let run = folder.run(&format!("{network} --steps 4 --out out --resume"));
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("bf16") && run.stderr.contains("f32"), "{}", run.stderr);
    folder.succeed(&format!("{network} --steps 4 --out out --resume --precision bf16 --threads 2"));
    folder.succeed(&format!("{network} --steps 4 --out whole --precision bf16 --threads 1"));
    assert!(folder.files("out") == folder.files("whole"));
}

#[test]
fn a_damaged_state_is_an_error() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 2 --out out");
    let whole = std::fs::read(folder.path("out/state.npz")).unwrap();
    folder.write("out/state.npz", &whole[..whole.len() / 2]);
    let run = folder.run("simulate scene.json --solver pbf --steps 4 --out out --resume");
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.starts_with("error: out/state.npz: "), "{}", run.stderr);
    assert_eq!(run.stderr.lines().count(), 1);
    assert!(!folder.path("out/fluid_0003.npz").exists());
}

#[test]
fn emitters_and_what_falls_out() {
    let folder = Folder::new();
    let jet = r#""shape": "box", "scale": [0.2, 0.05, 0.2], "translation": [0, 0.6, 0], "velocity": [0, -3, 0],
        "start": 1, "stop": 6, "step": 2"#;
    folder.write("scene.json", scene_of(jet));
    folder.succeed("simulate scene.json --solver pbf --steps 8 --out out");
    let counts: Vec<u64> = (0..=8)
        .map(|k| folder.succeed(&format!("inspect out/fluid_{k:04}.npz --json")).last_json())
        .map(|found| found["particles"].as_u64().unwrap())
        .collect();
    assert_eq!(counts, [0, 16, 16, 32, 32, 48, 48, 48, 48]);

    // Beside the container nothing holds it.
    folder.write("scene.json", scene_of(r#""shape": "box", "scale": 0.1, "translation": [3, 0.3, 0]"#));
    let run = folder.succeed("simulate scene.json --solver pbf --steps 40 --out fallen --json");
    let summary = run.last_json();
    assert_eq!((summary["particles"].as_u64(), summary["removed"].as_u64()), (Some(0), Some(8)));
    assert!(run.stderr.contains("warning: ") && run.stderr.contains("removed"), "{}", run.stderr);
    assert_eq!(folder.files("fallen").len(), 41 + 2);
}

#[test]
fn warnings_are_lines_and_quiet_is_quiet() {
    let folder = Folder::new();
    let overlap = r#""shape": "box", "scale": 0.2, "translation": [0, 0.4, 0], "stop": 3"#;
    folder.write("scene.json", scene_of(overlap));
    let run = folder.succeed("simulate scene.json --solver pbf --steps 4 --out a");
    let lines: Vec<&str> = run.stderr.lines().collect();
    assert!(lines.iter().all(|line| line.starts_with("warning: ")), "{}", run.stderr);
    assert!(lines[0].contains("fluids[0]") && lines[0].contains("step"), "{}", run.stderr);
    let run = folder.succeed("simulate scene.json --solver pbf --steps 4 --out b --quiet");
    assert_eq!((run.stdout.as_str(), run.stderr.as_str()), ("", ""));
}

/// A disk that is full in the middle of a run: the frames before it are whole, and the run goes on elsewhere.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let disk = folder.path("disk");
    let Some(small) = SmallDisk::mount(&disk, "384k") else { return };
    let run = folder.run("simulate scene.json --solver pbf --steps 300 --out disk/out");
    let files = folder.files("disk/out");
    let moved = folder.path("moved");
    std::fs::create_dir(&moved).unwrap();
    for (name, content) in &files {
        std::fs::write(moved.join(name), content).unwrap();
    }
    std::fs::copy(disk.join("out/run.json"), moved.join("run.json")).unwrap();
    drop(small);
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.stderr.starts_with("error: disk/out/") && run.stderr.contains("space"), "{}", run.stderr);
    assert_eq!(run.stderr.lines().count(), 1);
    assert!(files.keys().all(|name| !name.contains("tmp")), "{:?}", files.keys());
    // Elsewhere it goes on to the bytes of a run that was never stopped.
    folder.succeed("simulate scene.json --solver pbf --steps 300 --out moved --resume");
    folder.succeed("simulate scene.json --solver pbf --steps 300 --out whole");
    assert!(folder.files("moved") == folder.files("whole"));
}

//! The commands beside `simulate`: inspect, convert, bench, completions.

use std::process::Stdio;

use crate::common::{Folder, SCENE, fixture};

/// A folder with a short run in `out`.
fn with_run() -> Folder {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 6 --out out --format npz,vtu");
    folder
}

#[test]
fn a_damaged_mesh_is_no_particle_file() {
    let folder = Folder::new();
    let header =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let points = "0 0 0\n1 0 0\n0 1 0\n";
    let face = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    folder.write("mesh.ply", format!("{header}{face}{points}3 0 1 9\n"));
    let run = folder.run("inspect mesh.ply");
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("mesh.ply") && run.stderr.contains('9'), "{}", run.stderr);
    folder.write("points.ply", format!("{header}end_header\n{points}"));
    assert_eq!(folder.succeed("inspect points.ply --json").last_json()["particles"], 3);
}

#[test]
fn inspect_says_what_is_in_each_kind_of_file() {
    let folder = with_run();
    folder.write("mesh.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    for (path, key, value) in [
        ("scene.json".to_owned(), "kind", "scene"),
        ("dam_break".to_owned(), "kind", "scene"),
        ("out/fluid_0002.vtu".to_owned(), "kind", "particles"),
        ("out/box.npz".to_owned(), "kind", "particles"),
        ("mesh.obj".to_owned(), "kind", "mesh"),
        ("out".to_owned(), "kind", "run"),
        (fixture("plain.pt"), "kind", "weights"),
        (fixture("plain.h5"), "format", "Keras (HDF5)"),
    ] {
        let found = folder.succeed(&format!("inspect {path} --json")).last_json();
        assert_eq!(found[key], value, "{path}");
        let text = folder.succeed(&format!("inspect {path}")).stdout;
        assert!(text.lines().count() >= 4, "{path}: {text}");
    }
    let weights = folder.succeed("inspect default --json").last_json();
    assert!(weights["metadata"]["fluvia"]["training"]["updates"].is_u64(), "{}", weights["metadata"]);
    folder.write("notes.txt", "mine");
    for (path, word) in [
        ("none.pt", "No such file"),
        ("none.xyz", "No such file"),
        ("notes.txt", "expected"),
        (".", "no frames"),
    ] {
        let run = folder.run(&format!("inspect {path}"));
        assert_eq!(run.code, Some(1));
        assert!(run.stderr.starts_with("error: ") && run.stderr.contains(word), "{}", run.stderr);
    }
}

#[test]
fn weights_of_every_form_convert_to_the_same_bytes() {
    let folder = Folder::new();
    folder.succeed(&format!("convert {} a.safetensors", fixture("plain.pt")));
    folder.succeed(&format!("convert {} b.safetensors", fixture("plain.h5")));
    folder.succeed("convert a.safetensors c.safetensors");
    let bytes = |name: &str| std::fs::read(folder.path(name)).unwrap();
    assert!(bytes("a.safetensors") == bytes("b.safetensors"));
    assert!(bytes("a.safetensors") == bytes("c.safetensors"));
    for (arguments, word) in [
        (format!("convert {} a.safetensors", fixture("plain.pt")), "--overwrite"),
        (format!("convert {} a.pt", fixture("plain.pt")), ".safetensors"),
        ("convert none.pt d.safetensors".to_owned(), "none.pt"),
    ] {
        let run = folder.run(&arguments);
        assert_eq!(run.code, Some(1));
        assert!(run.stderr.contains(word), "{}", run.stderr);
    }
    folder.succeed(&format!("convert {} a.safetensors --overwrite", fixture("plain.pt")));
}

#[test]
fn bench_prints_its_result_last() {
    let folder = with_run();
    let weights = fixture("plain.pt");
    let golden = format!("{}/../../fixtures/golden/net.npz", env!("CARGO_MANIFEST_DIR"));
    for stage in ["step", "neighbors", "train-step"] {
        let run = folder.succeed(&format!(
            "bench --state {golden} --weights {weights} --steps 2 --stage {stage} --tile 3 --batch 2 --threads 1"
        ));
        let result = run.last_json();
        assert_eq!((&result["particles"], &result["batch"]), (&(3 * 125).into(), &2.into()));
        assert_eq!((&result["stage"], &result["threads"]), (&stage.into(), &1.into()));
        assert!(result["median_ms"].as_f64().unwrap() > 0.0);
    }
    let run = folder.run(&format!("bench --state {golden} --weights {weights} --tile 1000000000"));
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("tiles") && run.stderr.contains("at most"), "{}", run.stderr);
    let run = folder.run(&format!("bench --state out/fluid_0000.npz --weights {weights} --steps 2"));
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("fluid_0000.npz") && run.stderr.contains("box"), "{}", run.stderr);
}

#[test]
fn completions_exist_for_every_shell() {
    let folder = Folder::new();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        assert!(folder.succeed(&format!("completions {shell}")).stdout.contains("simulate"), "{shell}");
    }
    // A reader that has seen enough, as `head` does.
    let mut command = folder.command("completions bash");
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), String::from_utf8_lossy(&output.stderr).as_ref()), (Some(0), ""));
    for arguments in ["--help", "simulate --help", "render --help", "bench --help", "inspect --help"] {
        let help = folder.succeed(arguments).stdout;
        assert!(help.contains("Usage"), "{arguments}");
    }
    assert!(folder.succeed("--version").stdout.starts_with("fluvia "));
}

/// The names in the help are those that there are.
#[test]
fn help_names_every_shipped_scene() {
    let folder = Folder::new();
    for command in ["simulate", "view"] {
        let help = folder.succeed(&format!("{command} --help")).stdout;
        for name in fluvia_sim::scene::shipped_names() {
            assert!(help.contains(name), "{command} --help does not name {name}");
        }
    }
}

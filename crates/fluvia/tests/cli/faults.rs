//! Bad input: each kind of fault gives exit code 1, one line that names file, line or key and what was expected, and
//! writes nothing.

use crate::common::{Folder, SCENE, fixture, scene_of, scene_with};

const RUN: &str = "simulate scene.json --steps 2 --out out";

#[test]
fn files_that_are_missing() {
    let folder = Folder::new();
    folder.fail("simulate none.json --out out", &["none.json", "No such file"]);
    folder.fail("simulate dam_brake --out out", &["dam_brake", "dam_break"]);
    folder.write("scene.json", SCENE);
    folder.fail(&format!("{RUN} --weights none.pt"), &["none.pt", "No such file"]);
    folder.write("scene.json", scene_of(r#""path": "none.obj""#));
    folder.fail(RUN, &["none.obj", "No such file"]);
}

#[test]
fn weights_that_are_damaged_or_others() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    for name in ["plain.pt", "plain.h5"] {
        let whole = std::fs::read(fixture(name)).unwrap();
        folder.write(name, &whole[..whole.len() / 2]);
        folder.fail(&format!("{RUN} --weights {name}"), &[name]);
    }
    folder.succeed(&format!("convert {} whole.safetensors", fixture("plain.pt")));
    let whole = std::fs::read(folder.path("whole.safetensors")).unwrap();
    folder.write("cut.safetensors", &whole[..whole.len() - 7]);
    folder.fail(
        &format!("{RUN} --weights cut.safetensors"),
        &["cut.safetensors", &whole.len().to_string(), &(whole.len() - 7).to_string()],
    );
    // Names lie; the first bytes count.
    folder.write("scene.pt", SCENE);
    folder.fail(&format!("{RUN} --weights scene.pt"), &["scene.pt", "not a weight file"]);
    folder.write("empty.h5", "");
    folder.fail(&format!("{RUN} --weights empty.h5"), &["empty.h5", "empty"]);
    folder.fail(&format!("{RUN} --weights {}", fixture("old.pt")), &["old.pt", "1.6"]);
    // Another network: a tensor under another name.
    let renamed: Vec<u8> = {
        let text = whole.as_slice();
        let at = text.windows(10).position(|w| w == b"conv1.bias").unwrap();
        [&text[..at], b"conv9.bias", &text[at + 10..]].concat()
    };
    folder.write("other.safetensors", renamed);
    folder.fail(&format!("{RUN} --weights other.safetensors"), &["other.safetensors", "conv1.bias"]);
}

#[test]
fn scenes_that_are_none() {
    let folder = Folder::new();
    for (text, words) in [
        ("", vec!["scene.json"]),
        ("[1, 2]", vec!["walls", "fluids"]),
        ("{\"walls\": [],\n\"fluids\": [{\"shape\": \"box\"}],\n}", vec!["line 3"]),
        ("{\"walls\": [], // none\n\"fluids\": []}", vec!["line 1"]),
        (r#"{"Configuration": {}, "FluidModels": []}"#, vec!["Configuration", "walls", "fluids"]),
        (r#"{"walls": [], "fluids": []}"#, vec!["fluids", "at least one"]),
    ] {
        folder.write("scene.json", text);
        folder.fail(RUN, &[vec!["scene.json"], words].concat());
    }
    folder.write("scene.json", [0xff, 0xfe, 0x7b, 0x00]);
    folder.fail(RUN, &["scene.json"]);
}

#[test]
fn keys_and_values() {
    let folder = Folder::new();
    for (text, words) in [
        (scene_with(r#""gravty": [0, -1, 0]"#), ["gravty", "gravity"]),
        (scene_with(r#""dt": -0.02"#), ["`dt`", "positive"]),
        (scene_with(r#""dt": "fast""#), ["`dt`", "number"]),
        (scene_with(r#""particle_radius": 0"#), ["`particle_radius`", "positive"]),
        (scene_with(r#""particle_radius": -0.1"#), ["`particle_radius`", "positive"]),
        (scene_with(r#""gravity": [0, 1e999, 0]"#), ["line 1", "out of range"]),
        (scene_of(r#""shape": "box", "scale": 0"#), ["fluids[0].scale", "positive"]),
        (scene_of(r#""shape": "blob""#), ["fluids[0].shape", "sphere"]),
        (scene_of(r#""shape": "box", "velocty": [0, 0, 0]"#), ["velocty", "velocity"]),
        (scene_of(r#""shape": "box", "start": 5, "stop": 5"#), ["fluids[0].stop", "start"]),
        (scene_of(r#""shape": "box", "step": 0"#), ["fluids[0].step", "at least 1"]),
        (scene_of(r#""shape": "box", "path": "a.obj""#), ["fluids[0]", "path"]),
    ] {
        folder.write("scene.json", text);
        folder.fail(RUN, &[vec!["scene.json"], words.to_vec()].concat());
    }
}

#[test]
fn keys_that_a_solver_cannot_honour() {
    let folder = Folder::new();
    let network = format!("{RUN} --weights {}", fixture("plain.pt"));
    for (keys, words) in [
        (r#""dt": 0.01"#, ["`dt`", "0.01", "0.02"]),
        (r#""particle_radius": 0.05"#, ["`particle_radius`", "0.05", "0.025"]),
        (r#""viscosity": 0.2"#, ["`viscosity`", "0.2", "0.01"]),
        (r#""density": 900"#, ["`density`", "900", "1000"]),
    ] {
        folder.write("scene.json", scene_with(keys));
        folder.fail(&network, &[vec!["scene.json"], words.to_vec()].concat());
    }
    folder.write("scene.json", scene_of(r#""shape": "box", "scale": 0.2, "viscosity": 0.2"#));
    folder.fail(&network, &["scene.json", "`fluids[0].viscosity`", "0.2", "0.01"]);
    folder.fail(RUN, &["scene.json", "`fluids[0].viscosity`", "0.2", "--solver dfsph"]);
    folder.fail(&format!("{RUN} --solver pbf"), &["scene.json", "`fluids[0].viscosity`", "pbf"]);
    // A time step that the solver cannot take, found before anything is written.
    folder.write("scene.json", SCENE);
    folder.fail(&format!("{RUN} --solver pbf --solver-dt 1e-9"), &["0.02", "100000"]);
    // DFSPH takes any viscosity up to 1, and says what it depends on.
    let dfsph = format!("{RUN} --solver dfsph");
    folder.write("scene.json", scene_of(r#""shape": "box", "scale": 0.2, "viscosity": 1.5"#));
    folder.fail(&dfsph, &["scene.json", "`fluids[0].viscosity`", "1.5", "dfsph takes 0 to 1"]);
    let light = r#"}, {"shape": "box", "scale": 0.1, "translation": [0, 0.6, 0], "density": 150}]"#;
    folder.write("scene.json", SCENE.replace("}]\n}", &format!("{light}\n}}")));
    folder.fail(&dfsph, &["scene.json", "`density`", "150 and 1000", "at most 5"]);
    folder.write("scene.json", scene_with(r#""viscosity": 0.2, "density": 900"#));
    let warned = |more: &str| folder.succeed(&format!("{dfsph} --overwrite {more}")).stderr;
    assert!(
        warned("").contains("warning: scene.json: viscosity 0.2") && warned("").contains("--solver-dt 0.001")
    );
    assert_eq!(warned("--solver-dt 0.001"), "");
    std::fs::remove_dir_all(folder.path("out")).expect("the run");
    // What they were made for, and what Eq. 10 honours, is no fault.
    folder.write(
        "scene.json",
        scene_with(r#""dt": 0.02, "viscosity": 0.01, "density": 1000, "gravity": [1, -2, 0]"#),
    );
    folder.succeed(&network);
}

#[test]
fn meshes_that_cannot_be_filled() {
    let folder = Folder::new();
    // A tetrahedron, without one side, flat, and with an index too many.
    let vertices = "v 0 0 0\nv 0.3 0 0\nv 0 0.3 0\nv 0 0 0.3\n";
    let sides = ["f 1 3 2\n", "f 1 2 4\n", "f 2 3 4\n", "f 1 4 3\n"];
    folder.write("scene.json", scene_of(r#""path": "body.obj", "translation": [0, 0.3, 0]"#));
    folder.write("body.obj", format!("{vertices}{}", sides.concat()));
    folder.succeed(RUN);
    std::fs::remove_dir_all(folder.path("out")).unwrap();
    folder.write("body.obj", format!("{vertices}{}", sides[..3].concat()));
    folder.fail(RUN, &["body.obj", "open", "3"]);
    folder.write("body.obj", format!("{vertices}f 1 2 9\n"));
    folder.fail(RUN, &["body.obj", "line 5", "9", "4"]);
    folder.write("body.obj", vertices);
    folder.fail(RUN, &["body.obj", "no faces"]);
    folder.write("body.obj", "");
    folder.fail(RUN, &["body.obj", "empty"]);
    folder.write("body.stl", "solid nothing\nendsolid\n");
    folder.write("scene.json", scene_of(r#""path": "body.stl""#));
    folder.fail(RUN, &["body.stl"]);

    let wall = r#"{"walls": [{"path": "wall.obj"}], "fluids": [{"shape": "box", "scale": 0.2}]}"#;
    folder.write("scene.json", wall);
    folder.write("wall.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    folder.fail(RUN, &["wall.obj", "area"]);

    // Millimetres taken for metres, and a body smaller than a particle.
    folder.write("scene.json", scene_of(r#""shape": "box", "scale": 300"#));
    folder.fail(RUN, &["scene.json", "300", "scale"]);
    folder.write("scene.json", scene_of(r#""shape": "box", "scale": 0.01"#));
    folder.fail(RUN, &["scene.json", "no particle fits"]);
}

/// A ply file of particles.
fn ply(rows: &[&str]) -> String {
    let header = "ply\nformat ascii 1.0\nelement vertex";
    let properties = "property float x\nproperty float y\nproperty float z\nend_header";
    format!("{header} {}\n{properties}\n{}\n", rows.len(), rows.join("\n"))
}

#[test]
fn particle_files() {
    let folder = Folder::new();
    folder.write("scene.json", scene_of(r#""particles": "p.ply""#));
    folder.write("p.ply", ply(&["0 0.3 0", "0.1 0.3 0"]));
    folder.succeed(RUN);
    std::fs::remove_dir_all(folder.path("out")).unwrap();
    folder.write("p.ply", ply(&["0 0.3 0", "0.1 nan 0"]));
    folder.fail(RUN, &["p.ply", "particle 1", "NaN"]);
    folder.write("p.ply", ply(&[]));
    folder.fail(RUN, &["p.ply", "no particles"]);
    folder.write("p.ply", ply(&["0 0 0"]).replace("vertex 1", "vertex 1000000000"));
    folder.fail(RUN, &["p.ply"]);
    folder.write("scene.json", scene_of(r#""particles": "p.npz""#));
    folder.write("p.npz", "PK\u{3}\u{4}");
    folder.fail(RUN, &["p.npz"]);
    folder.write("scene.json", scene_of(r#""particles": "p.bgeo""#));
    folder.write("p.bgeo", b"\x7fNSJb");
    folder.fail(RUN, &["p.bgeo", "bhclassic"]);
}

#[test]
fn places_that_cannot_be_written() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.write("file", "in the way");
    for out in ["file", "file/below"] {
        let run = folder.run(&format!("simulate scene.json --steps 2 --out {out}"));
        assert_eq!(run.code, Some(1), "{}", run.stderr);
        assert!(run.stderr.starts_with("error: file"), "{}", run.stderr);
    }
    assert_eq!(std::fs::read(folder.path("file")).unwrap(), b"in the way");
}

#[test]
fn wrong_usage() {
    let folder = Folder::new();
    for arguments in [
        "",
        "simulate",
        "simulate dam_break --steps many",
        "simulate dam_break --format png",
        "simulate dam_break --resume --overwrite",
        "simulate dam_break --threads 0",
        "simulate dam_break --threads 20000",
        "simulate dam_break --solver dfsph --solver-dt=-0.001",
        "simulate dam_break --solver dfsph --solver-dt-max nan",
        "simulate dam_break --solver-dt 0.001",
        "simulate dam_break --solver pbf --precision bf16",
        "simulate dam_break --solver-dt 0.001 --weights a.pt",
        "simulate dam_break --solver dfsph --weights a.pt",
        "render out -o a.png --max-speed 0",
        "render -o a.png",
        "render out -o a.png --sheet 0x2",
        "nothing",
    ] {
        let run = folder.run(arguments);
        assert_eq!(run.code, Some(2), "{arguments}: {}", run.stderr);
        assert!(!folder.path("out").exists());
    }
}

//! Scene files: the reference cases, the shipped scenes, and every kind of fault in files written here.

mod common;
#[path = "formats/memory.rs"]
mod memory;

use std::fs;
use std::path::{Path, PathBuf};

use common::reference;
use fluvia_sim::frames::ParticleData;
use fluvia_sim::particles::Particles;
use fluvia_sim::scene::{self, Scene, Setup, Source};
use fluvia_sim::{Error, Result, frames};
use proptest::prelude::*;

fn load(path: impl AsRef<Path>) -> Result<Setup> {
    Scene::load(path)?.sample(0)
}

fn case(folder: &Path, name: &str) -> Setup {
    load(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// The message of the error, which is one line and has all the texts.
#[track_caller]
fn rejected<T>(result: Result<T>, texts: &[&str]) -> String {
    let message = result.err().expect("an error").to_string();
    assert!(!message.contains('\n'), "one line: {message}");
    for text in texts {
        assert!(message.contains(text), "`{text}` in: {message}");
    }
    message
}

fn bounds(points: &[[f32; 3]]) -> [[f32; 3]; 2] {
    points.iter().fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |[low, high], x| {
        [[0, 1, 2].map(|k| low[k].min(x[k])), [0, 1, 2].map(|k| high[k].max(x[k]))]
    })
}

#[track_caller]
fn assert_bounds(points: &[[f32; 3]], expected: [[f32; 3]; 2], tolerance: f32) {
    let found = bounds(points);
    for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
        assert!((found - expected).abs() <= tolerance, "{found} is not {expected} +- {tolerance}");
    }
}

#[test]
fn ordinary_case_and_its_guises() {
    let Some(folder) = reference().map(|folder| folder.join("cases")) else { return };
    let plain = case(&folder, "plain.json");
    assert_eq!(plain.warnings(), Vec::<String>::new());
    let count = plain.emitters[0].position.len();
    let lattice = 0.39_f64.powi(3) / 0.05_f64.powi(3);
    assert!((count as f64 / lattice - 1.0).abs() < 0.35, "{count} particles");
    // floor(1.9 * 6 / (pi 0.025^2)).
    assert_eq!(plain.boundary.position.len(), 5805);
    for (x, n) in plain.boundary.position.iter().zip(&plain.boundary.normal) {
        let inward: f32 = (0..3).map(|k| n[k] * ([0.0, 0.5, 0.0][k] - x[k])).sum();
        assert!(inward > 0.0, "the normal {n:?} at {x:?} points out");
    }
    for name in [
        "a02_obj_negative_indices.json",
        "a03_obj_vertex_colours.json",
        "a04_obj_line_ends.json",
        "a05_obj_separate_corners.json",
        "a06_obj_lines_points.json",
        "a09_stl_binary_solid.json",
        "a10_stl_ascii_exponents.json",
        "a13_ply_double.json",
        "a14_millimetres_scaled.json",
        "a32_scene_bom.json",
    ] {
        let guise = case(&folder, name);
        assert_eq!(guise.emitters[0].position.len(), count, "{name}");
        assert_bounds(&guise.emitters[0].position, [[-0.195, 0.305, -0.195], [0.195, 0.695, 0.195]], 0.05);
        assert_eq!(guise.warnings(), Vec::<String>::new(), "{name}");
    }
}

#[test]
fn other_bodies_of_the_cases() {
    let Some(folder) = reference().map(|folder| folder.join("cases")) else { return };
    let prism = &case(&folder, "a01_obj_polygons.json").emitters[0].position;
    assert!((162..=337).contains(&prism.len()), "{} particles", prism.len());
    assert_bounds(prism, [[-0.2, 0.35, -0.1733], [0.2, 0.65, 0.1733]], 0.075);

    let shells = &case(&folder, "a07_obj_two_shells.json").emitters[0].position;
    assert!((76..=201).contains(&shells.len()), "{} particles", shells.len());
    assert_bounds(shells, [[-0.4, 0.405, -0.095], [0.4, 0.595, 0.095]], 0.05);
    assert!(!shells.iter().any(|x| (-0.16..0.06).contains(&x[0])), "nothing between the shells");

    let cup = case(&folder, "a15_cup_as_wall.json");
    assert!(!cup.boundary.position.iter().any(|x| x[1] > 0.599 && x[0].abs() < 0.29 && x[2].abs() < 0.29));
    assert_eq!(cup.warnings(), Vec::<String>::new());
}

#[test]
fn rejected_cases() {
    let Some(folder) = reference().map(|folder| folder.join("cases")) else { return };
    let cases: [(&str, &[&str]); 10] = [
        ("a08_obj_index_too_large", &["a08_obj_index_too_large.obj", "line 21", "vertex 9 of 8"]),
        ("a11_stl_cut_short", &["a11_stl_cut_short.stl", "12 triangles", "684 bytes", "454", "cut short"]),
        ("a12_stl_empty", &["a12_stl_empty.stl", "empty"]),
        ("a14_millimetres", &["a14_millimetres.stl", "390 x 390 x 390 m", "4.7e11 particles", "`scale`"]),
        ("a15_cup_as_fluid", &["a15_cup.obj", "open", "4 open edges"]),
        ("a33_scene_comma", &["a33_scene_comma.json", "line 28", "trailing comma"]),
        ("a33_scene_comment", &["a33_scene_comment.json", "line 2", "no comments"]),
        ("a34_scene_other", &["a34_scene_other.json", "`Configuration`", "walls", "fluids"]),
        ("a39_speck", &["a39_speck.obj", "0.02 x 0.02 x 0.02 m", "0.05 m", "no particle fits"]),
        ("a18_npz_nan", &["a18_npz_nan.npz", "pos", "17"]),
    ];
    for (name, texts) in cases {
        rejected(load(folder.join(format!("{name}.json"))), texts);
    }
}

#[test]
fn set_ups_that_can_be_run() {
    let Some(folder) = reference().map(|folder| folder.join("cases")) else { return };
    let obstacle = case(&folder, "a35_wall_in_fluid.json");
    let warnings = obstacle.warnings();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    // 4 x 4 x 4 of the particles have their places in the block or on its faces.
    assert!(warnings[0].contains("walls[1] (a35_obstacle.obj): 64 fluid particles"), "{warnings:?}");
    // The block stands in the fluid: its normals look away from its middle.
    let range = obstacle.walls[1].range.clone();
    for (x, n) in obstacle.boundary.position[range.clone()].iter().zip(&obstacle.boundary.normal[range]) {
        assert!((0..3).map(|k| n[k] * (x[k] - [0.0, 0.5, 0.0][k])).sum::<f32>() > 0.0);
    }

    let emitter = case(&folder, "a38_emitter.json");
    let warnings = emitter.warnings();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    for text in ["fluids[0] (a38_emitter.npz)", "overlap", "`step`"] {
        assert!(warnings[0].contains(text), "{warnings:?}");
    }
    assert_eq!((emitter.emitters[0].start, emitter.emitters[0].stop, emitter.emitters[0].step), (0, 6, 1));

    for (name, count) in [("a36_outside.json", 27), ("a37_one_particle.json", 1), ("probe.json", 8)] {
        let setup = case(&folder, name);
        assert_eq!(setup.emitters[0].position.len(), count, "{name}");
        assert_eq!(setup.warnings(), Vec::<String>::new(), "{name}");
    }
    for name in ["a19_no_velocity_ply.json", "a19_no_velocity_npz.json", "a19_no_velocity_bgeo.json"] {
        let setup = case(&folder, name);
        assert!(setup.emitters[0].velocity.iter().all(|v| *v == [0.1, -0.2, 0.3]), "{name}");
    }
}

#[test]
fn published_example_and_models() {
    let Some(folder) = reference().map(|folder| folder.join("official")) else { return };
    let example = case(&folder, "scripts/example_scene.json");
    // A cube of 1 m at a spacing of 0.05 m; int(1.9 * 40 / (pi 0.025^2)) wall particles.
    assert_eq!(example.emitters[0].position.len(), 8000);
    assert_eq!(example.boundary.position.len(), 38706);
    assert_eq!(example.warnings(), Vec::<String>::new());
    assert_eq!((example.gravity, example.dt, example.particle_radius), ([0.0, -9.81, 0.0], 0.02, 0.025));
}

#[test]
fn shipped_scenes() {
    for name in scene::shipped_names() {
        let text = scene::shipped(name).expect("a scene");
        let setup = Scene::parse(text.as_bytes(), name).expect(name).sample(0).expect(name);
        assert_eq!(setup.warnings(), Vec::<String>::new(), "{name}");
        let emitted = setup
            .emitters
            .iter()
            .map(|e| e.position.len() as u64 * (e.stop - e.start).div_ceil(e.step))
            .sum::<u64>();
        println!("{name}: {emitted} fluid and {} wall particles", setup.boundary.position.len());
        // Emitters fill a river in 16 s; one scene is large by its name.
        let expected = if name == "hundred_thousand" { 100_000..=110_000 } else { 2000..=8500 };
        assert!(expected.contains(&emitted), "{name}: {emitted} particles");
        let [low, high] = bounds(&setup.boundary.position);
        for emitter in &setup.emitters {
            for x in &emitter.position {
                assert!((0..3).all(|k| x[k] > low[k] && x[k] < high[k]), "{name}: {x:?} is outside");
            }
        }
    }
    assert!(scene::shipped("no_such_scene").is_none());
}

/// Files for one test.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().expect("a folder"))
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, content).expect("writes");
        path
    }

    /// Samples a scene with this fluid in a container.
    fn fluid(&self, fluid: &str) -> Result<Setup> {
        load(self.write(
            "scene.json",
            format!(r#"{{"walls": [{{"shape": "container", "scale": 2}}], "fluids": [{fluid}]}}"#),
        ))
    }

    /// Samples a scene with this wall around a fluid.
    fn wall(&self, wall: &str) -> Result<Setup> {
        load(self.write(
            "scene.json",
            format!(
                r#"{{"walls": [{wall}], "fluids": [{{"shape": "box", "scale": 0.3, "translation": [0, 0.5, 0]}}]}}"#
            ),
        ))
    }

    /// Writes a particle file.
    fn particles(&self, name: &str, data: &ParticleData) {
        let velocity = data.velocity.clone().expect("velocities");
        let particles = Particles::of_one_body(data.position.clone(), velocity);
        frames::write_fluid(&self.0.path().join(name), frames::Format::Npz, &particles).expect("writes");
    }
}

fn parse(text: &str) -> Result<Scene> {
    Scene::parse(text.as_bytes(), "scene.json")
}

#[test]
fn what_is_no_scene() {
    for (text, expected) in [
        (
            "{\"walls\": [], // none\n\"fluids\": []}",
            "line 1, column 15: key must be a string (JSON has no comments)",
        ),
        ("{\"walls\": [\n/* none */ ]}", "line 2, column 1: expected value (JSON has no comments)"),
        (
            r#"{"walls": [{"path": "a\nb.obj"}], "fluids": []}"#,
            "`walls[0].path`: `a\\nb.obj`, expected the path",
        ),
        ("", "empty"),
        ("\u{feff} \n", "empty"),
        ("[]", "a list of 0, expected a scene"),
        ("3", "3, expected a scene"),
        ("{}", "no key `walls`"),
        (r#"{"walls": []}"#, "no key `fluids`"),
        (r#"{"walls": {}, "fluids": []}"#, "`walls`: an object, expected a list of walls"),
        (r#"{"walls": [], "fluids": []}"#, "`fluids`: an empty list"),
        (r#"{"walls": [], "fluids": [3]}"#, "`fluids[0]`: 3, expected a fluid"),
        (r#"{"walls": [], "walls": []}"#, "`walls` is there twice"),
        ("{\"walls\": []\n\"fluids\": []}", "line 2, column 1"),
        ("{\"walls\": [],\n", "line 2, column 0: EOF"),
        ("{'walls': []}", "line 1, column 2"),
        (
            "{\"walls\": [],\n# none\n\"fluids\": []}",
            "line 2, column 1: key must be a string (JSON has no comments)",
        ),
        (r#"{"dt": 1e999}"#, "line 1"),
        (r#"{"wall": []}"#, "unknown key `wall`: did you mean `walls`?"),
        (r#"{"gravitation": []}"#, "did you mean `gravity`?"),
        ("{\"a\\nb\": 1}", "unknown key `a\\nb`"),
    ] {
        rejected(parse(text), &["scene.json: ", expected]);
    }
    let nested = "[".repeat(100_000);
    rejected(parse(&nested), &["recursion limit"]);
    rejected(Scene::parse(b"\xff\xfe{\0}\0", "scene.json"), &["UTF-16"]);
    rejected(Scene::parse(b"PK\x03\x04\xff", "scene.json"), &["not text"]);
    rejected(Scene::load("no/such/scene.json"), &["no/such/scene.json"]);
    rejected(Scene::load(env!("CARGO_MANIFEST_DIR")), &["a directory"]);
}

#[test]
fn json_as_it_is_written_by_hand() {
    let text = "{\n\"walls\": [{\"shape\": \"container\"}],\n\"fluids\": [{\"shape\": \"box\"}]\n}";
    let plain = parse(text).expect("a scene");
    assert_eq!(parse(&format!("\u{feff}{text}")).expect("a scene"), plain);
    assert_eq!(parse(&text.replace('\n', "\r\n\t")).expect("a scene"), plain);
    rejected(parse(&text.replace("}]\n}", "}],\n}")), &["line 4, column 1: trailing comma"]);
    rejected(parse(&text.replace("}]\n}", "},\n]}")), &["line 4, column 1: trailing comma"]);
    rejected(parse(&text.replace("\"walls\"", "// the box\n\"walls\"")), &["line 2", "no comments"]);
    rejected(parse(&text[..text.len() - 1]), &["line 4", "EOF"]);
    rejected(parse(&format!("{text}{text}")), &["line 4, column 2: trailing characters"]);
    // Scenes of another simulator.
    let other = r#"{"Configuration": {"particleRadius": 0.025}, "RigidBodies": [], "FluidModels": []}"#;
    rejected(parse(other), &["unknown key `Configuration`: a scene has walls, fluids"]);
}

#[test]
fn wrong_values_are_named_by_their_key() {
    let scene = |more: &str| format!(r#"{{"walls": [], "fluids": [{{"shape": "box"}}]{more}}}"#);
    for (more, expected) in [
        (r#", "dt": 0"#, "`dt`: 0, expected a positive number"),
        (r#", "dt": -0.02"#, "`dt`: -0.02"),
        (r#", "dt": "0.02""#, "`dt`: a text"),
        (r#", "dt": 1e-60"#, "`dt`: 1e-60"),
        (r#", "particle_radius": -1"#, "`particle_radius`: -1, expected a positive number, metres"),
        (r#", "particle_radius": 1e300"#, "`particle_radius`: 1e300"),
        (r#", "gravity": -9.81"#, "`gravity`: -9.81, expected three times a finite number"),
        (r#", "gravity": [0, -9.81]"#, "`gravity`: a list of 2"),
        (r#", "gravity": [0, null, 0]"#, "`gravity[1]`: null"),
        (r#", "viscosity": -0.1"#, "`viscosity`"),
        (r#", "density": 0"#, "`density`"),
    ] {
        rejected(parse(&scene(more)), &[expected]);
    }
    let fluid = |body: &str| format!(r#"{{"walls": [], "fluids": [{{"shape": "box"}}, {body}]}}"#);
    for (body, expected) in [
        (r#"{"shape": "box", "velocity": "fast"}"#, "`fluids[1].velocity`: a text, expected three"),
        (r#"{"shape": "box", "velocity": [0, 0, true]}"#, "`fluids[1].velocity[2]`: true"),
        (r#"{"shape": "box", "velocty": [0, 0, 0]}"#, "`fluids[1].velocty`: did you mean `velocity`?"),
        (r#"{"shape": "box", "invert_normals": true}"#, "unknown key `fluids[1].invert_normals`"),
        (
            r#"{"shape": "blob"}"#,
            "`fluids[1].shape`: `blob` is not a built-in shape, expected one of box, sphere",
        ),
        (r#"{"path": ""}"#, "`fluids[1].path`: empty"),
        (r#"{"path": 3}"#, "`fluids[1].path`: 3, expected the path"),
        (r#"{}"#, "`fluids[1]`: 0 of the keys path, particles and shape"),
        (r#"{"path": "a.obj", "shape": "box"}"#, "`fluids[1]`: 2 of the keys"),
        (r#"{"shape": "box", "scale": 0}"#, "`fluids[1].scale`: 0, expected a positive number"),
        (r#"{"shape": "box", "scale": [1, -1, 1]}"#, "`fluids[1].scale[1]`: -1"),
        (r#"{"shape": "box", "rotation": 90}"#, "`fluids[1].rotation`: 90, expected a rotation"),
        (r#"{"shape": "box", "rotation": {"angle": 90}}"#, "no key `fluids[1].rotation.axis`"),
        (r#"{"shape": "box", "rotation": {"axis": [0, 1, 0]}}"#, "no key `fluids[1].rotation.angle`"),
        (
            r#"{"shape": "box", "rotation": {"axis": [0, 0, 0], "angle": 1}}"#,
            "`fluids[1].rotation.axis`: all zero",
        ),
        (r#"{"shape": "box", "start": -1}"#, "`fluids[1].start`: -1, expected a whole number of at least 0"),
        (r#"{"shape": "box", "start": 0.5}"#, "`fluids[1].start`: 0.5"),
        (r#"{"shape": "box", "step": 0}"#, "`fluids[1].step`: 0, expected a whole number of at least 1"),
        (r#"{"shape": "box", "start": 3, "stop": 3}"#, "`fluids[1].stop`: 3, expected more than `start`"),
        (r#"{"shape": "box", "stop": 1e30}"#, "`fluids[1].stop`"),
    ] {
        rejected(parse(&fluid(body)), &[expected]);
    }
    rejected(
        parse(r#"{"walls": [{"shape": "box", "invert_normal": true}], "fluids": []}"#),
        &["`walls[0].invert_normal`: did you mean `invert_normals`?"],
    );
    rejected(
        parse(r#"{"walls": [{"shape": "box", "invert_normals": 1}], "fluids": [{"shape": "box"}]}"#),
        &["`walls[0].invert_normals`: 1, expected true or false"],
    );
}

#[test]
fn what_was_given_is_kept_apart_from_defaults() {
    let plain = parse(r#"{"walls": [], "fluids": [{"shape": "sphere"}]}"#).expect("a scene");
    assert_eq!((plain.gravity, plain.dt, plain.particle_radius), (None, None, None));
    let fluid = &plain.fluids[0];
    assert_eq!((fluid.start, fluid.stop, fluid.step, fluid.velocity), (0, 1, 1, None));
    assert!(matches!(fluid.source, Source::Shape(_)));

    let text = r#"{"walls": [], "gravity": [0, -1, 0], "dt": 0.01, "particle_radius": 0.05, "viscosity": 0.1,
        "density": 900, "fluids": [{"shape": "box", "start": 4, "viscosity": 0.3}, {"shape": "box",
        "translation": [2, 0, 0], "start": 2, "stop": 9, "step": 3}]}"#;
    let setup = parse(text).expect("a scene").sample(0).expect("a set-up");
    assert_eq!((setup.gravity, setup.dt, setup.particle_radius), ([0.0, -1.0, 0.0], 0.01, 0.05));
    let [first, second] = &setup.emitters[..] else { panic!("two fluids") };
    // Ten layers of 0.1 m along each axis.
    assert_eq!(first.position.len(), 1000);
    assert_eq!((first.start, first.stop), (4, 5));
    assert_eq!((second.start, second.stop, second.step), (2, 9, 3));
    assert_eq!((first.material.viscosity, first.material.density), (Some(0.3), Some(900.0)));
    assert_eq!(second.material.viscosity, Some(0.1));
    assert!(setup.boundary.position.is_empty());
}

#[test]
fn bodies_that_cannot_be_sampled() {
    let folder = Folder::new();
    rejected(folder.fluid(r#"{"path": "none.obj"}"#), &["none.obj"]);
    rejected(folder.fluid(r#"{"particles": "none.npz"}"#), &["none.npz"]);
    rejected(folder.fluid(r#"{"path": "mesh.npz"}"#), &["mesh.npz", ".obj", "`particles`"]);
    rejected(folder.fluid(r#"{"shape": "bowl"}"#), &["scene.json: fluids[0] (shape bowl)", "48 open edges"]);
    rejected(
        folder.fluid(r#"{"shape": "box", "scale": 1000}"#),
        &["1000 x 1000 x 1000 m", "8.0e12", "`scale`"],
    );
    rejected(
        folder.fluid(r#"{"shape": "box", "scale": [1, 0.001, 1]}"#),
        &["1 x 0.001 x 1 m", "no particle fits"],
    );
    rejected(
        folder.fluid(r#"{"shape": "box", "scale": 1e38, "translation": [3e38, 0, 0]}"#),
        &["1.000e38 x"],
    );
    // Each body is small enough, all of them are not.
    let half = r#"{"shape": "box", "scale": [9, 9, 9]}"#;
    rejected(
        folder.fluid(&format!("{half}, {half}")),
        &["scene.json: fluids[1] (shape box)", "11664000 particles", "at most 1e7"],
    );
    rejected(folder.wall(r#"{"shape": "box", "scale": 1000}"#), &["walls[0]", "particles", "`scale`"]);
    rejected(folder.wall(r#"{"shape": "box", "scale": 0.001}"#), &["walls[0]", "no particle fits"]);

    folder.write("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    rejected(folder.fluid(r#"{"path": "flat.obj"}"#), &["flat.obj", "no area"]);
    rejected(folder.wall(r#"{"path": "flat.obj"}"#), &["flat.obj", "no area"]);
    // A sheet of paper with two sides is closed and has no inside.
    folder.write("sheet.obj", "v 0 0 0\nv 1 0 0\nv 1 1 1\nf 1 2 3\nf 1 3 2\n");
    rejected(folder.fluid(r#"{"path": "sheet.obj"}"#), &["sheet.obj", "no particle fits"]);
    folder.write("far.obj", "v 0 0 0\nv 3e38 0 0\nv 0 3e38 0\nf 1 2 3\n");
    rejected(folder.wall(r#"{"path": "far.obj"}"#), &["far.obj", "`scale`"]);
    rejected(folder.wall(r#"{"path": "far.obj", "scale": 10}"#), &["far.obj", "too large for float32"]);
}

#[test]
fn particle_files_are_placed_and_keep_their_velocities() {
    let folder = Folder::new();
    let data = ParticleData {
        position: vec![[0.1, 0.0, 0.0], [0.0, 0.2, 0.0]],
        velocity: Some(vec![[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]),
        ..Default::default()
    };
    folder.particles("two.npz", &data);
    let placed =
        r#""scale": [2, 1, 1], "rotation": {"axis": [0, 0, 1], "angle": 90}, "translation": [0, 1, 0]"#;
    let setup = folder.fluid(&format!(r#"{{"particles": "two.npz", {placed}}}"#)).expect("a set-up");
    let emitter = &setup.emitters[0];
    assert_eq!(emitter.position, [[0.0, 1.2, 0.0], [-0.2, 1.0, 0.0]]);
    assert_eq!(emitter.velocity, [[0.0, 1.0, 0.0], [0.0, 0.0, 2.0]]);
    assert_eq!(emitter.path.as_deref(), Some(folder.0.path().join("two.npz").as_path()));
    assert_eq!(setup.warnings(), Vec::<String>::new());

    // The file's velocities win, and the scene's are not dropped in silence.
    let moving = r#"{"particles": "two.npz", "velocity": [3, 0, 0], "translation": [0, 1, 0]}"#;
    let setup = folder.fluid(moving).expect("a set-up");
    assert_eq!(setup.emitters[0].velocity, [[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]);
    let warnings = setup.warnings();
    assert!(warnings.len() == 1 && warnings[0].contains("velocity (3, 0, 0)"), "{warnings:?}");

    // As walls, the published script's files have the normals as velocities.
    let setup = folder.wall(&format!(r#"{{"particles": "two.npz", {placed}}}"#)).expect("a set-up");
    assert_eq!(setup.boundary.normal, [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let setup = folder.wall(r#"{"particles": "two.npz", "invert_normals": true}"#).expect("a set-up");
    assert_eq!(setup.boundary.normal, [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]);
    folder.particles("zero.npz", &ParticleData { velocity: Some(vec![[0.0; 3]; 2]), ..data.clone() });
    rejected(folder.wall(r#"{"particles": "zero.npz"}"#), &["zero.npz", "normal of particle 0 is zero"]);

    let none = ParticleData { velocity: Some(Vec::new()), ..Default::default() };
    folder.particles("none.npz", &none);
    rejected(folder.fluid(r#"{"particles": "none.npz"}"#), &["none.npz", "no particles"]);
}

#[test]
fn warnings_for_what_will_surprise() {
    let folder = Folder::new();
    let warnings = |fluid: &str| folder.fluid(fluid).expect("a set-up").warnings();
    // A body may touch its walls: its particles are 0.55 to 1.55 radii from them, by its size.
    for tenths in 0..10 {
        let side = 0.5 + 0.005 * f64::from(tenths);
        let at = 1.0 - side / 2.0;
        let fluid =
            format!(r#"{{"shape": "box", "scale": {side}, "translation": [{at}, {}, {at}]}}"#, side / 2.0);
        assert_eq!(warnings(&fluid), Vec::<String>::new(), "{side}");
    }
    // One that stands through the floor is found, wherever the floor is between two layers.
    for depth in [0.02, 0.03, 0.04, 0.05, 0.06, 0.5] {
        let sunk = warnings(&format!(r#"{{"shape": "box", "translation": [0.5, {}, 0.5]}}"#, 0.5 - depth));
        assert!(
            sunk.len() == 1 && sunk[0].starts_with("walls[0] (container): ") && sunk[0].contains("fluids[0]"),
            "{depth}: {sunk:?}"
        );
    }
    // Beside the container it is not in a wall.
    assert_eq!(warnings(r#"{"shape": "box", "translation": [3, 0.5, 0]}"#), Vec::<String>::new());

    // The middle of an obstacle is far from its faces.
    let inside = folder
        .wall(r#"{"shape": "box", "translation": [0, 0.5, 0], "invert_normals": true}"#)
        .expect("a set-up")
        .warnings();
    assert!(inside.len() == 1 && inside[0].contains("216 fluid particles"), "{inside:?}");
    let around = folder.wall(r#"{"shape": "box", "translation": [0, 0.5, 0]}"#).expect("a set-up").warnings();
    assert_eq!(around, Vec::<String>::new());
    // The fluid stands over the edge of the step, a radius above it.
    let over = r#"{"shape": "step", "scale": 1, "translation": [0, 0.075, 0]}"#;
    assert_eq!(folder.wall(over).expect("a set-up").warnings(), Vec::<String>::new());
    // An open wall has no inside, but a back: a cup through the fluid, at any height between its layers.
    for height in [0.4, 0.41, 0.42, 0.43, 0.44] {
        let cup = format!(r#"{{"shape": "basin", "translation": [0, {height}, 0]}}"#);
        let cut = folder.wall(&cup).expect("a set-up").warnings();
        assert!(cut.len() == 1 && cut[0].starts_with("walls[0] (basin): "), "{height}: {cut:?}");
    }
    let under = folder.wall(r#"{"shape": "basin", "translation": [0, 0.35, 0]}"#).expect("a set-up");
    assert_eq!(under.warnings(), Vec::<String>::new());
    // The walls of a particle file are where its particles are.
    let data = ParticleData {
        position: vec![[0.03, 0.51, 0.02], [0.0, 0.2, 0.0]],
        velocity: Some(vec![[0.0, 1.0, 0.0]; 2]),
        ..Default::default()
    };
    folder.particles("nails.npz", &data);
    let nails = folder.wall(r#"{"particles": "nails.npz"}"#).expect("a set-up").warnings();
    assert!(nails.len() == 1 && nails[0].starts_with("walls[0] (nails.npz): "), "{nails:?}");
    // A tetrahedron with one face turned round.
    folder.write("turned.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 4 3 2\n");
    let turned =
        folder.wall(r#"{"path": "turned.obj", "translation": [3, 0, 0]}"#).expect("a set-up").warnings();
    assert!(
        turned.len() == 1 && turned[0].contains("turned.obj") && turned[0].contains("3 edges"),
        "{turned:?}"
    );

    // The rest needs no walls.
    let alone = |fluids: &str| {
        let scene = parse(&format!(r#"{{"walls": [], "fluids": [{fluids}]}}"#)).expect("a scene");
        scene.sample(0).expect("a set-up").warnings()
    };
    // Whatever the offset of two bodies' lattices is, half a spacing along all axes included.
    for offset in [0.0, 0.0125, 0.025, 0.04] {
        let pair = |x: f64| {
            alone(&format!(
                r#"{{"shape": "box", "scale": 0.5, "translation": [0, 1, 0]}},
                {{"shape": "box", "scale": 0.5, "translation": [{x}, {}, {offset}]}}"#,
                1.0 + offset
            ))
        };
        let overlap = pair(0.3 + offset);
        assert!(
            overlap.len() == 1 && overlap[0].starts_with("fluids[1] (box) overlaps fluids[0] (box)"),
            "{overlap:?}"
        );
        assert_eq!(pair(0.5), Vec::<String>::new(), "side by side");
    }
    let later = r#"{"shape": "box", "translation": [0, 1, 0], "scale": 0.5},
        {"shape": "box", "translation": [0, 1, 0], "scale": 0.5, "start": 50}"#;
    assert_eq!(alone(later), Vec::<String>::new());

    // One layer of particles, a spacing in 0.02 s or in 0.04 s.
    let nozzle = |speed: f64, step: u32| {
        alone(&format!(
            r#"{{"shape": "box", "scale": [0.3, 0.05, 0.3], "translation": [0, 1, 0],
            "velocity": [0, {speed}, 0], "stop": 20, "step": {step}}}"#
        ))
    };
    assert_eq!(nozzle(-2.5, 1), Vec::<String>::new());
    assert_eq!(nozzle(-1.25, 1).len(), 1);
    assert_eq!(nozzle(-1.25, 2), Vec::<String>::new());
    // At rest, gravity alone clears a spacing in about 0.1 s.
    assert_eq!(nozzle(0.0, 4).len(), 1);
    assert_eq!(nozzle(0.0, 6), Vec::<String>::new());
}

#[test]
fn the_seed_decides_the_walls_and_each_wall_has_its_own() {
    let text = |first: &str| {
        format!(
            r#"{{"walls": [{{"shape": "{first}"}}, {{"shape": "bowl"}}], "fluids": [{{"shape": "box"}}]}}"#
        )
    };
    let sample = |first: &str, seed| parse(&text(first)).expect("a scene").sample(seed).expect("a set-up");
    let (once, again, other) = (sample("container", 7), sample("container", 7), sample("container", 8));
    assert_eq!(once.boundary, again.boundary);
    assert_ne!(once.boundary.position, other.boundary.position);
    assert_eq!(once.boundary.position.len(), other.boundary.position.len());
    let bowl = |setup: &Setup| setup.boundary.position[setup.walls[1].range.clone()].to_vec();
    assert_eq!(bowl(&once), bowl(&sample("sphere", 7)), "a change of one wall leaves the other");
}

/// A scene may be as large as its text allows, and no larger.
#[test]
fn large_scenes() {
    let folder = Folder::new();
    let wall = r#"{"shape": "box"},"#;
    let walls = wall.repeat(5_000_000 / wall.len());
    let path =
        folder.write("large.json", format!(r#"{{"walls": [{}], "fluids": []}}"#, &walls[..walls.len() - 1]));
    rejected(Scene::load(path), &["large.json", "bytes, expected a scene of at most 4194304"]);
    let numbers = "0,".repeat(1_000_000);
    let (result, peak) = memory::peak_of(|| parse(&format!(r#"{{"walls": [{}0]}}"#, numbers)));
    rejected(result, &["`walls[0]`: 0, expected a wall"]);
    assert!(peak < BYTES_FOR_A_BYTE * 2_000_000, "{peak} bytes");
}

/// The most memory for a byte of JSON: a digit and its comma become a node of 32 bytes, in a list that is copied when
/// it grows; the text itself is held twice here.
const BYTES_FOR_A_BYTE: usize = 64;

const FULL_SCENE: &str = r#"{"walls": [{"shape": "container", "scale": [2, 1, 1], "invert_normals": false,
    "rotation": {"axis": [0, 1, 0], "angle": 30}, "translation": [0, 0, 1e-3]}], "gravity": [0, -9.81, 0],
    "dt": 0.02, "fluids": [{"path": "a.obj", "velocity": [0.3, 0, 0.2], "start": 0, "stop": 1, "step": 1,
    "viscosity": 0.01}]}"#;

proptest! {
    // Failing cases are kept as tests by hand.
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Any change of bytes gives a scene or an error of one line that names the file.
    #[test]
    fn mutated_scenes_are_scenes_or_errors(
        changes in prop::collection::vec((0..FULL_SCENE.len(), any::<u8>()), 1..4),
        length in 0..=FULL_SCENE.len(),
        is_cut in any::<bool>(),
    ) {
        let mut bytes = FULL_SCENE.as_bytes().to_vec();
        for (at, value) in changes {
            bytes[at] = value;
        }
        if is_cut {
            bytes.truncate(length);
        }
        match Scene::parse(&bytes, "scene.json") {
            Ok(scene) => prop_assert!(!scene.fluids.is_empty()),
            Err(Error::File { message, .. }) => prop_assert!(!message.contains('\n'), "{message}"),
            Err(error) => prop_assert!(false, "{error}"),
        }
    }
}

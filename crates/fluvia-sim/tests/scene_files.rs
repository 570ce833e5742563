//! Scenes written and read back.

use fluvia_sim::scene::{self, Fluid, Material, Placement, Rotation, Scene, Source, Wall};
use fluvia_sim::shapes::Shape;
use proptest::option;
use proptest::prelude::*;

/// Any finite number, and often one of a few digits.
fn number() -> impl Strategy<Value = f32> {
    prop_oneof![prop::num::f32::NORMAL | prop::num::f32::ZERO, (-9999..9999).prop_map(|n| n as f32 / 100.0)]
}

fn positive() -> impl Strategy<Value = f32> {
    number().prop_map(|x| x.abs()).prop_filter("positive", |x| *x > 0.0)
}

fn source() -> impl Strategy<Value = Source> {
    prop_oneof![
        prop::sample::select(&Shape::ALL[..]).prop_map(Source::Shape),
        "[^\\p{C}]{1,20}".prop_map(Source::Mesh),
        "[^\\p{C}]{1,20}".prop_map(Source::Particles),
    ]
}

fn placement() -> impl Strategy<Value = Placement> {
    let scale =
        prop_oneof![prop::array::uniform3(positive()), positive().prop_map(|x| [x; 3]), Just([1.0; 3])];
    let axis = prop::array::uniform3(number()).prop_filter("a direction", |axis| *axis != [0.0; 3]);
    let rotation = option::of((axis, number()).prop_map(|(axis, angle)| Rotation { axis, angle }));
    (scale, rotation, prop::array::uniform3(number())).prop_map(|(scale, rotation, translation)| Placement {
        scale,
        rotation,
        translation,
    })
}

fn material() -> impl Strategy<Value = Material> {
    (option::of(number().prop_map(f32::abs)), option::of(positive()))
        .prop_map(|(viscosity, density)| Material { viscosity, density })
}

fn wall() -> impl Strategy<Value = Wall> {
    (source(), placement(), any::<bool>()).prop_map(|(source, placement, invert_normals)| Wall {
        source,
        placement,
        invert_normals,
    })
}

fn fluid() -> impl Strategy<Value = Fluid> {
    let velocity = option::of(prop::array::uniform3(number()));
    let emission = prop_oneof![Just((0, 1, 1)), (0..1000_u64, 1..1000_u64, 1..10_u64)];
    (source(), placement(), velocity, emission, material()).prop_map(
        |(source, placement, velocity, (start, emissions, step), material)| {
            let stop = start + emissions;
            Fluid { source, placement, velocity, start, stop, step, material }
        },
    )
}

fn any_scene() -> impl Strategy<Value = Scene> {
    let whole = (option::of(prop::array::uniform3(number())), option::of(positive()), option::of(positive()));
    let bodies = (prop::collection::vec(wall(), 0..3), prop::collection::vec(fluid(), 1..4));
    (bodies, whole, material()).prop_map(|((walls, fluids), (gravity, dt, particle_radius), material)| {
        Scene { path: "scene.json".into(), walls, fluids, gravity, dt, particle_radius, material }
    })
}

proptest! {
    #[test]
    fn a_scene_is_read_back_as_it_was_written(scene in any_scene()) {
        let text = scene.to_json().expect("a scene file");
        prop_assert_eq!(Scene::parse(text.as_bytes(), "scene.json").expect("a scene"), scene);
    }
}

#[test]
fn shipped_scenes_are_read_back_as_they_were_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scene.json");
    for name in scene::shipped_names() {
        let text = scene::shipped(name).expect("a scene");
        let scene = Scene::parse(text.as_bytes(), &path).expect("a scene");
        scene.write(&path).expect("writes");
        assert_eq!(Scene::load(&path).expect("a scene"), scene, "{name}");
    }
}

#[test]
fn the_text_has_a_line_a_body_and_no_defaults() {
    let text = r#"{"walls": [{"shape": "container", "scale": [2, 4, 2]}], "gravity": [0, -1.5, 0], "dt": 0.01,
        "fluids": [{"shape": "box", "scale": 0.7, "velocity": [1, 0, 0]}, {"path": "a \"b\".obj", "start": 2}]}"#;
    let scene = Scene::parse(text.as_bytes(), "scene.json").expect("a scene");
    let expected = r#"{
    "walls": [
        {"shape": "container", "scale": [2.0, 4.0, 2.0]}
    ],
    "fluids": [
        {"shape": "box", "scale": 0.7, "velocity": [1.0, 0.0, 0.0]},
        {"path": "a \"b\".obj", "start": 2, "stop": 3, "step": 1}
    ],
    "gravity": [0.0, -1.5, 0.0], "dt": 0.01
}
"#;
    assert_eq!(scene.to_json().expect("a scene file"), expected);
}

#[test]
fn what_no_file_can_hold_is_an_error() {
    let scene = Scene::parse(br#"{"walls": [], "fluids": [{"shape": "box"}]}"#, "s.json").expect("a scene");
    let infinite = Scene { dt: Some(f32::INFINITY), ..scene.clone() };
    let mut silent = scene.clone();
    silent.fluids[0].stop = 0;
    let mut odd = scene.clone();
    odd.fluids[0].source = Source::Mesh("two\nlines".into());
    for (scene, expected) in [
        (infinite, "`dt`: null"),
        (silent, "`fluids[0].stop`"),
        (odd, "`fluids[0].path`"),
        (Scene { fluids: Vec::new(), ..scene }, "`fluids`: an empty list"),
    ] {
        let message = scene.to_json().expect_err("no file").to_string();
        assert!(message.contains("no scene file can hold it") && message.contains(expected), "{message}");
        assert!(!message.contains('\n'), "{message}");
    }
}

//! A scene that runs, and what is done to it.

use serde_json::json;

use super::client::View;
use crate::common::{Folder, SCENE, fixture, scene_of, scene_with};

fn floats(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().expect("a list").iter().map(|x| x.as_f64().expect("a number")).collect()
}

#[test]
fn it_runs_pauses_steps_and_begins_again() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let mut client = view.connect();
    let first = client.frame();
    assert_eq!((first.number, first.time, first.panels[0].position.len()), (0, 0.0, 64));
    let state = client.until("there is one", |_| true);
    assert_eq!(
        (&state["kind"], &state["mode"], &state["title"]),
        (&"state".into(), &"live".into(), &"scene".into())
    );
    assert_eq!((&state["playing"], &state["speed"]), (&false.into(), &1.0.into()));
    assert_eq!((&state["panels"][0]["solver"], &state["panels"][0]["error"]), (&"pbf".into(), &json!(null)));
    // A container: vertices and triangles, no points.
    assert!(client.walls.starts_with(b"FLVW") && client.walls.len() > 40);
    assert_eq!(client.walls[12..16], [0; 4]);
    // The block of the scene, to the precision of the bytes.
    let lowest = first.panels[0].position.iter().map(|x| x[1]).fold(f32::INFINITY, f32::min);
    assert!((lowest - 0.225).abs() < 1e-4, "{lowest}");
    let speed = 0.29_f32.sqrt();
    assert!(first.panels[0].speed.iter().all(|found| (found - speed).abs() < 1e-4));

    client.send(json!({"do": "step", "by": 1}));
    let second = client.frame();
    assert_eq!((second.number, second.time), (1, 0.02));
    assert!(second.panels[0].ms_per_step > 0.0);
    // It stands still: the next frame is that of the next step.
    client.send(json!({"do": "step", "by": 1}));
    assert_eq!(client.frame().number, 2);
    // So many as were asked for, and no more.
    client.send(json!({"do": "step", "by": 5}));
    client.until_frame("it has stepped", |frame| frame.number == 7);
    client.send(json!({"do": "step", "by": 0}));
    assert_eq!(client.frame().number, 7);
    client.send(json!({"do": "speed", "factor": null}));
    client.send(json!({"do": "play"}));
    let later = client.until_frame("it has run", |frame| frame.number > 30);
    assert!((later.time - 0.02 * f64::from(later.number)).abs() < 1e-9);
    client.send(json!({"do": "pause"}));
    client.until("it stands still", |state| state["playing"] == false);
    client.send(json!({"do": "reset"}));
    let again = client.until_frame("it has begun again", |frame| frame.number == 0);
    assert_eq!(again.panels[0].position, first.panels[0].position);
}

#[test]
fn everybody_sees_and_steers_the_same() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let (mut one, mut other) = (view.connect(), view.connect());
    one.frame();
    other.frame();
    one.send(json!({"do": "step", "by": 1}));
    assert_eq!(one.frame(), other.frame());
    other.send(json!({"do": "speed", "factor": 0.25}));
    one.until("it is slow", |state| state["speed"] == 0.25);
    // Who comes later sees what is there.
    assert_eq!(view.connect().frame().number, 1);
}

#[test]
fn fluid_is_dropped_where_there_is_room() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver dfsph --paused");
    let mut client = view.connect();
    client.frame();
    let drop = |x: f64, size: f64| {
        json!({"do": "drop", "panel": 0, "origin": [x, 5, 0], "direction": [0, -1, 0],
               "body": {"form": "cube", "size": size}})
    };
    client.send(drop(0.0, 0.15));
    let frame = client.frame();
    let panel = &frame.panels[0];
    assert_eq!((frame.number, panel.position.len()), (0, 64 + 27));
    assert_eq!((panel.body[0], panel.body[64]), (0, 1));
    assert!(panel.position[64..].iter().all(|x| x[1] > 0.4 && x[1] < 0.8), "{:?}", &panel.position[64..]);
    // Where the first is there is no room for a second of that size, and none at all for one as wide as the walls.
    for (command, name) in [(drop(0.0, 0.45), "0.45"), (drop(0.0, 0.6), "0.60")] {
        let said = client.answer(command);
        assert!(said.contains("no room") && said.contains(name), "{said}");
    }
    client.send(json!({"do": "speed", "factor": null}));
    client.send(json!({"do": "play"}));
    let later = client.until_frame("it fell", |frame| frame.number > 100);
    assert_eq!(later.panels[0].position.len(), 91);
    // 91 particles on a floor of 0.5 m by 0.5 m are a layer or two.
    assert!(later.panels[0].mean[1] < 0.15, "{:?}", later.panels[0].mean);
}

#[test]
fn gravity_viscosity_and_solver_change_while_it_runs() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, &format!("scene.json --weights {}", fixture("plain.pt")));
    let mut client = view.connect();
    let state = client.until("there is one", |_| true);
    assert_eq!(state["viscosities"], json!(null));
    let names: Vec<&str> =
        state["solvers"].as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names.len(), 5, "{names:?}");
    assert!(
        names[0].ends_with("plain.pt") && names[1..] == ["default", "viscosity", "dfsph", "pbf"],
        "{names:?}"
    );
    let said = client.answer(json!({"do": "viscosity", "to": 0.1}));
    assert!(said.contains("`viscosity`: 0.1") && said.contains("made for 0.01"), "{said}");

    client.send(json!({"do": "solver", "panel": 0, "name": "dfsph"}));
    let state = client.until("it is DFSPH", |state| state["panels"][0]["solver"] == "dfsph");
    assert_eq!(floats(&json!([state["viscosities"]["low"], state["viscosities"]["high"]])), [0.0, 1.0]);
    client.send(json!({"do": "viscosity", "to": 0.125}));
    let state = client.until("it is thick", |state| state["viscosity"] == 0.125);
    let warning = state["panels"][0]["warning"].as_str().unwrap();
    assert!(warning.contains("viscosity 0.125 acts once a step"), "{warning}");
    // What knows water alone is not to be had for it.
    let refused = |k: usize| state["solvers"][k]["refused"].as_str().unwrap_or_default();
    assert!(refused(1).contains("made for 0.01") && refused(4).contains("viscosity"), "{state}");
    assert_eq!(refused(3), "");
    let said = client.answer(json!({"do": "solver", "panel": 0, "name": "default"}));
    assert!(said.contains("made for 0.01"), "{said}");
    client.send(json!({"do": "viscosity", "to": 0.01}));
    client.send(json!({"do": "solver", "panel": 0, "name": "pbf"}));
    client.until("it is PBF", |state| state["panels"][0]["solver"] == "pbf");

    // Upside down, in the page too: it stays below the lid.
    client.send(json!({"do": "gravity", "to": [0, 9.81, 0]}));
    let state = client.until("gravity is turned", |state| state["gravity"][1].as_f64() > Some(9.0));
    assert_eq!(floats(&state["up"]), [0.0, -1.0, 0.0]);
    assert!(floats(&state["scene_gravity"])[1] < -9.0);
    client.send(json!({"do": "speed", "factor": null}));
    let from = client.frame().number;
    let risen = client.until_frame("it has risen", |frame| frame.number > from + 60);
    assert!(risen.panels[0].mean[1] > 0.6, "{:?}", risen.panels[0].mean);
}

#[test]
fn what_goes_wrong_is_told_beside_the_picture() {
    let folder = Folder::new();
    // Beside the walls, and from there down.
    folder.write("scene.json", scene_of(r#""shape": "box", "scale": 0.2, "translation": [1, 0.3, 0]"#));
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let mut client = view.connect();
    assert_eq!(client.until("there is one", |_| true)["panels"][0]["warning"], json!(null));
    client.send(json!({"do": "step", "by": 1}));
    let state = client.until("it is told", |state| !state["panels"][0]["warning"].is_null());
    assert_eq!(state["panels"][0]["warning"], "step 1: 64 particles outside the walls");
    client.send(json!({"do": "step", "by": 30}));
    let state = client.until("more is told", |state| {
        state["panels"][0]["warning"].as_str().is_some_and(|warning| warning.contains("removed"))
    });
    assert!(state["panels"][0]["error"].is_null(), "{state}");
    client.send(json!({"do": "reset"}));
    client.until("it is forgotten", |state| state["panels"][0]["warning"].is_null());
}

#[test]
fn liquids_of_two_densities_are_not_for_every_solver() {
    let folder = Folder::new();
    let fluid = |x: f64, density: u32| {
        format!(r#"{{"shape": "box", "scale": 0.2, "translation": [{x}, 0.3, 0], "density": {density}}}"#)
    };
    let walls = r#"[{"shape": "container", "scale": [0.8, 0.8, 0.5]}]"#;
    let fluids = [fluid(-0.15, 1000), fluid(0.15, 500)].join(", ");
    folder.write("scene.json", format!(r#"{{"walls": {walls}, "fluids": [{fluids}]}}"#));
    let view = View::start(&folder, "scene.json --solver dfsph --paused");
    let mut client = view.connect();
    let state = client.until("there is one", |_| true);
    let offers = state["solvers"].as_array().unwrap();
    let pbf = offers.iter().find(|offer| offer["name"] == "pbf").unwrap();
    assert!(pbf["refused"].as_str().unwrap().contains("densities 1000 and 500"), "{pbf}");
    let said = client.answer(json!({"do": "solver", "panel": 0, "name": "pbf"}));
    assert!(said.contains("the same density in all fluids"), "{said}");
    // What is refused changes nothing: a recording goes on.
    client.send(json!({"do": "record", "on": true}));
    client.until("it records", |state| !state["recording"].is_null());
    let said = client.answer(json!({"do": "compare", "on": true}));
    assert!(said.contains("no other solver"), "{said}");
    assert!(!client.state["recording"].is_null(), "{}", client.state);
}

#[test]
fn two_solvers_run_side_by_side_from_the_same_state() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver dfsph --paused");
    let mut client = view.connect();
    client.frame();
    client.send(json!({"do": "step", "by": 1}));
    let alone = client.frame();
    client.send(json!({"do": "compare", "on": true}));
    let both = client.frame();
    assert_eq!((both.number, both.panels.len()), (1, 2));
    assert_eq!(both.panels[0].position, alone.panels[0].position);
    assert_eq!(both.panels[1].position, alone.panels[0].position);
    let state =
        client.until("there are two", |state| state["panels"].as_array().is_some_and(|p| p.len() == 2));
    assert_eq!(
        (&state["panels"][0]["solver"], &state["panels"][1]["solver"]),
        (&"dfsph".into(), &"default".into())
    );
    client.send(json!({"do": "solver", "panel": 1, "name": "pbf"}));
    client.frame();
    client.send(json!({"do": "step", "by": 1}));
    let stepped = client.frame();
    assert_eq!(stepped.number, 2);
    assert_ne!(stepped.panels[0].position, stepped.panels[1].position);
    // What is dropped is dropped in both.
    client.send(json!({"do": "drop", "panel": 1, "origin": [0, 5, 0], "direction": [0, -1, 0],
                       "body": {"form": "ball", "size": 0.2}}));
    let dropped = client.frame();
    let [left, right] = [0, 1].map(|k| dropped.panels[k].position[64..].to_vec());
    assert!(left.len() == right.len() && left.len() > 10, "{} and {}", left.len(), right.len());
    client.send(json!({"do": "compare", "on": false}));
    assert_eq!(client.frame().panels.len(), 1);
    client.until("there is one", |state| state["panels"].as_array().is_some_and(|p| p.len() == 1));
}

#[test]
fn an_emitter_is_moved() {
    let folder = Folder::new();
    let jet = r#""shape": "box", "scale": [0.1, 0.05, 0.1], "translation": [0, 0.6, 0], "velocity": [0, -3, 0],
        "start": 0, "stop": 60, "step": 2"#;
    folder.write("scene.json", scene_of(jet));
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let mut client = view.connect();
    client.frame();
    let state = client.until("there is one", |_| true);
    assert_eq!(
        (&state["emitters"][0]["label"], &state["emitters"][0]["active"]),
        (&"box".into(), &true.into())
    );
    let at = floats(&state["emitters"][0]["position"]);
    assert!((at[1] - 0.6).abs() < 1e-3 && at[0].abs() < 1e-3, "{at:?}");
    let said = client.answer(json!({"do": "move-emitter", "index": 0, "to": [0.3, 0.6, 0]}));
    assert!(said.contains("no room"), "{said}");
    client.send(json!({"do": "move-emitter", "index": 0, "to": [0.15, 0.5, 0]}));
    client.until("it is there", |state| floats(&state["emitters"][0]["position"])[0] > 0.1);
    for _ in 0..2 {
        client.send(json!({"do": "step", "by": 1}));
    }
    let frame = client.until_frame("it has given again", |frame| frame.number == 2);
    let new = &frame.panels[0].position[4..];
    assert!(new.len() == 4 && new.iter().all(|x| (x[0] - 0.15).abs() < 0.03), "{new:?}");
    // It stays there when the scene begins again.
    client.send(json!({"do": "reset"}));
    let again = client.until_frame("it has begun again", |frame| frame.number == 0);
    assert!(again.panels[0].position.iter().all(|x| x[0] > 0.1));
}

#[test]
fn densities_come_where_they_are_wanted() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    let view = View::start(&folder, "scene.json --solver pbf --paused");
    let mut client = view.connect();
    assert!(!client.frame().has_densities);
    client.send(json!({"do": "density", "on": true}));
    let frame = client.until_frame("densities are there", |frame| frame.has_densities);
    let highest = frame.panels[0].density.iter().copied().fold(0.0, f32::max);
    // In the middle of the lattice of a body.
    assert!((0.7..0.85).contains(&highest), "{highest}");
    client.send(json!({"do": "density", "on": false}));
    client.send(json!({"do": "step", "by": 1}));
    assert!(!client.until_frame("it has stepped", |frame| frame.number == 1).has_densities);
    // Who leaves wants nothing any more.
    let mut other = view.connect();
    other.send(json!({"do": "density", "on": true}));
    other.until_frame("densities are there", |frame| frame.has_densities);
    drop(other);
    client.until_frame("nobody wants them", |frame| frame.has_densities);
    for number in 2..200 {
        client.send(json!({"do": "step", "by": 1}));
        if !client.until_frame("it has stepped", |frame| frame.number == number).has_densities {
            return;
        }
    }
    panic!("densities after whoever wanted them has left");
}

#[test]
#[cfg(unix)]
fn a_recording_is_a_run_that_others_read() {
    let folder = Folder::new();
    folder.write("scene.json", scene_with(r#""gravity": [0, -5, 0]"#));
    let view = View::start(&folder, "scene.json --solver pbf --paused --format npz,vtu");
    let mut client = view.connect();
    client.frame();
    client.send(json!({"do": "step", "by": 1}));
    client.frame();
    client.send(json!({"do": "record", "on": true}));
    let state = client.until("it records", |state| !state["recording"].is_null());
    assert_eq!(state["recording"]["directories"], json!(["out/view/scene-001"]));
    client.send(json!({"do": "gravity", "to": [0, -9, 0]}));
    for number in 2..=6 {
        client.send(json!({"do": "step", "by": 1}));
        client.until_frame("it has stepped", |frame| frame.number == number);
    }
    let said = client.answer(json!({"do": "record", "on": false}));
    assert!(said.contains("out/view/scene-001 (6 frames)"), "{said}");
    let names: Vec<String> = folder.files("out/view/scene-001").into_keys().collect();
    assert_eq!(names.len(), 2 * 7 + 1, "{names:?}");
    let record = folder.json("out/view/scene-001/run.json");
    assert_eq!(
        (&record["steps"], &record["summary"]["steps"], &record["summary"]["particles"]),
        (&5.into(), &5.into(), &64.into())
    );
    assert_eq!(
        (&record["live"]["first_step"], &record["live"]["changes"][0]["frame"]),
        (&1.into(), &0.into())
    );
    assert!(record["live"]["changes"][0]["what"].as_str().unwrap().contains("gravity"), "{record}");

    // A second one has a directory of its own; Ctrl-C ends it with whole frames.
    client.send(json!({"do": "compare", "on": true}));
    client.send(json!({"do": "record", "on": true}));
    let state = client.until("it records again", |state| !state["recording"].is_null());
    let directories: Vec<&str> =
        state["recording"]["directories"].as_array().unwrap().iter().map(|d| d.as_str().unwrap()).collect();
    assert_eq!(directories, ["out/view/scene-002-1-pbf", "out/view/scene-002-2-default"]);
    client.send(json!({"do": "speed", "factor": null}));
    client.send(json!({"do": "play"}));
    client.until_frame("it has run", |frame| frame.number > 12);
    let (code, said) = view.interrupt();
    assert_eq!(code, Some(130), "{said}");
    for directory in directories {
        assert!(said.contains(directory), "{said}");
        let record = folder.json(&format!("{directory}/run.json"));
        let steps = record["summary"]["steps"].as_u64().unwrap();
        let files = folder.files(directory);
        assert!(files.keys().all(|name| !name.contains("tmp")), "{:?}", files.keys());
        assert_eq!(files.keys().filter(|name| name.ends_with(".npz")).count() as u64, steps + 2);
        for frame in 0..=steps {
            let found =
                folder.succeed(&format!("inspect {directory}/fluid_{frame:04}.npz --json")).last_json();
            assert_eq!(found["particles"], 64, "{directory} {frame}");
        }
        folder.succeed(&format!("render {directory} --size 64 -o {directory}.png"));
    }
    folder.succeed("compare a=out/view/scene-001 b=out/view/scene-001");
    // It is not taken for a run of the scene that could go on.
    let run =
        folder.run("simulate scene.json --solver pbf --format npz,vtu --out out/view/scene-001 --resume");
    assert!(run.code == Some(1) && run.stderr.contains("not the same run"), "{}", run.stderr);
}

/// The end does not wait for a step, which takes minutes here.
#[test]
#[cfg(unix)]
fn control_c_ends_it_within_a_step() {
    let folder = Folder::new();
    let view = View::start(&folder, "dam_break --solver dfsph --solver-dt 0.000001 --paused");
    let mut client = view.connect();
    client.frame();
    client.send(json!({"do": "record", "on": true}));
    client.until("it records", |state| !state["recording"].is_null());
    client.send(json!({"do": "play"}));
    client.until("it runs", |state| state["playing"] == true);
    let (code, said) = view.interrupt();
    assert_eq!(code, Some(130), "{said}");
    assert!(said.contains("out/view/dam_break-001: 1 frame\n"), "{said}");
    assert!(client.closed().is_some());
    let record = folder.json("out/view/dam_break-001/run.json");
    assert_eq!((&record["summary"]["steps"], &record["summary"]["particles"]), (&0.into(), &5600.into()));
}

//! Frames on disk: runs of every format, and sequences.

use serde_json::json;

use super::client::View;
use crate::common::{Folder, SCENE, sequence};

#[test]
fn runs_of_every_format_are_gone_through() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    for format in ["npz", "ply", "bgeo", "vtu", "vtk"] {
        folder.succeed(&format!(
            "simulate scene.json --solver pbf --steps 9 --out runs/{format} --format {format}"
        ));
        let view = View::start(&folder, &format!("runs/{format} --paused"));
        let mut client = view.connect();
        let first = client.frame();
        assert_eq!((first.number, first.panels[0].position.len()), (0, 64), "{format}");
        let state = client.until("there is one", |_| true);
        assert_eq!((&state["mode"], &state["title"]), (&"playback".into(), &format.into()));
        assert_eq!(state["stored"], json!([0, 9, 10]));
        assert_eq!((&state["has_speeds"], &state["has_bodies"]), (&true.into(), &true.into()), "{format}");
        // The scene is where it was: its surfaces are shown.
        assert_eq!(client.walls[12..16], [0; 4], "{format}");
        client.send(json!({"do": "seek", "index": 7}));
        let sought = client.frame();
        assert_eq!((sought.number, sought.time), (7, 0.14), "{format}");
        assert_ne!(sought.panels[0].position, first.panels[0].position);
        client.send(json!({"do": "step", "by": -2}));
        assert_eq!(client.frame().number, 5);
        client.send(json!({"do": "seek", "index": 1_000_000}));
        assert_eq!(client.frame().number, 9);
    }
    // Without the scene the wall particles are shown.
    std::fs::remove_file(folder.path("scene.json")).unwrap();
    let view = View::start(&folder, "runs/ply --paused");
    let mut client = view.connect();
    client.frame();
    assert_ne!(client.walls[12..16], [0; 4]);
    assert_eq!(client.walls[4..12], [0; 8]);
}

#[test]
fn it_begins_when_somebody_looks() {
    let folder = Folder::new();
    // A frame a second: three would have passed.
    let view = View::start(&folder, &format!("{} --dt 1", sequence("plain/fall")));
    std::thread::sleep(std::time::Duration::from_secs(3));
    let mut client = view.connect();
    assert_eq!(client.frame().number, 0);
    assert_eq!(client.until("it runs", |_| true)["playing"], true);
    client.until_frame("time passes", |frame| frame.number > 0);
}

#[test]
fn it_plays_to_the_end_and_from_the_beginning() {
    let folder = Folder::new();
    let view = View::start(&folder, &format!("{} --paused", sequence("plain/fall")));
    let mut client = view.connect();
    let first = client.frame();
    assert_eq!((first.number, first.panels[0].position.len()), (0, 8));
    let state = client.until("there is one", |_| true);
    assert_eq!((&state["has_speeds"], &state["has_bodies"]), (&true.into(), &false.into()));
    for _ in 0..2 {
        client.send(json!({"do": "play"}));
        client.until_frame("it has ended", |frame| frame.number == 5);
        client.until("it stands still", |state| state["playing"] == false);
    }
    for command in [
        json!({"do": "gravity", "to": [0, 0, 0]}),
        json!({"do": "record", "on": true}),
        json!({"do": "compare", "on": true}),
    ] {
        assert!(client.answer(command).contains("cannot be changed"));
    }
    client.send(json!({"do": "density", "on": true}));
    let frame = client.until_frame("densities are there", |frame| frame.has_densities);
    assert!(frame.panels[0].density.iter().all(|density| *density > 0.0));
}

#[test]
fn frames_with_gaps_are_gone_through_by_their_places() {
    let folder = Folder::new();
    let view = View::of_frames_with_gaps(&folder);
    let mut client = view.connect();
    let first = client.frame();
    assert_eq!((first.number, first.index), (0, 0));
    assert_eq!(client.until("there is one", |_| true)["stored"], json!([0, 9, 4]));
    client.send(json!({"do": "seek", "index": 1}));
    let sought = client.frame();
    assert_eq!((sought.number, sought.index), (7, 1));
    client.send(json!({"do": "step", "by": 2}));
    let last = client.frame();
    assert_eq!((last.number, last.index), (9, 3));
}

#[test]
fn a_frame_that_has_gone_is_said_and_the_rest_is_shown() {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 4 --out run");
    let view = View::start(&folder, "run --paused");
    let mut client = view.connect();
    client.frame();
    folder.write("run/fluid_0002.npz", "damaged");
    let said = client.answer(json!({"do": "seek", "index": 2}));
    assert!(said.contains("run/fluid_0002.npz"), "{said}");
    client.send(json!({"do": "seek", "index": 3}));
    assert_eq!(client.until_frame("another is shown", |frame| frame.number != 0).number, 3);
}

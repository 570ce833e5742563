//! Sequences of data sets where directories of frames are taken, and data sets.

use crate::common::{Folder, sequence};

#[test]
fn a_sequence_is_a_folder_a_prefix_or_a_part() {
    let folder = Folder::new();
    for (name, frames, parts) in [
        ("plain", "0 to 5", 2),
        ("plain/fall", "0 to 5", 2),
        ("plain/fall_01.msgpack.zst", "3 to 5", 1),
        // The older form of the same.
        ("old", "0 to 5", 2),
    ] {
        let found = folder.succeed(&format!("inspect {} --json", sequence(name))).last_json();
        assert_eq!((&found["kind"], &found["frames"]), (&"sequence".into(), &frames.into()), "{name}");
        assert_eq!((&found["parts"], &found["particles"]), (&parts.into(), &8.into()), "{name}");
        assert_eq!(found["mass_kg"], serde_json::json!([0.125, 0.125]), "{name}");
        folder.succeed(&format!("render {} --size 64 -o picture.png", sequence(name)));
    }
    let found = folder.succeed(&format!("inspect {} --dt 0.01 --json", sequence("plain"))).last_json();
    assert!((found["duration_s"].as_f64().unwrap() - 0.05).abs() < 1e-9, "{found}");
}

#[test]
fn sequences_are_drawn_and_compared_as_runs_are() {
    let folder = Folder::new();
    let (plain, old) = (sequence("plain"), sequence("old"));
    folder.succeed(&format!("render {plain} --sheet 3x2 --size 64 -o sheet.png"));
    folder.succeed(&format!("render a={plain} b={old} --frames 0,4 --size 64 -o both.png"));
    folder.succeed(&format!("render {plain} --size 64 -o film.gif"));
    let found = folder.succeed(&format!("compare {plain} {old} --json")).last_json();
    assert_eq!(found["distance"]["a_to_b_m"], serde_json::json!([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    // It falls freely, frame by frame.
    let heights: Vec<f64> =
        (0..6).map(|k| found["runs"][0]["center_of_mass_m"][k][1].as_f64().unwrap()).collect();
    assert!((heights[5] - (0.5 - 0.5 * 9.81 * 0.01)).abs() < 1e-6, "{heights:?}");
}

#[test]
fn a_data_set_is_summed_up() {
    let folder = Folder::new();
    let found = folder.succeed(&format!("inspect {} --json", sequence("set"))).last_json();
    assert_eq!((&found["kind"], &found["sequences"]), (&"data set".into(), &3.into()), "{found}");
    assert_eq!((&found["frames"], &found["particles"]), (&24.into(), &serde_json::json!([6, 8])), "{found}");
    assert_eq!(found["folders"]["train"]["sequences"], 2, "{found}");
    assert_eq!(found["folders"]["valid"]["sequences"], 1, "{found}");
    let train = folder.succeed(&format!("inspect {} --json", sequence("set/train"))).last_json();
    assert_eq!(train["scenes"].as_array().map(Vec::len), Some(2), "{train}");
    // Several where one is asked for.
    folder.fail(&format!("render {} -o a.png", sequence("set/train")), &["sim_0001", "sim_0002"]);
    folder.fail(&format!("compare {} {}", sequence("set/train"), sequence("plain")), &["sim_0001"]);
}

#[test]
fn damaged_sequences_are_one_line() {
    let folder = Folder::new();
    for (name, words) in [
        ("faults/cut_00.msgpack.zst", ["frame 0", "truncated"]),
        ("faults/short_00.msgpack.zst", ["frame 4", "truncated"]),
        ("faults/damaged_00.msgpack.zst", ["frame 0", "damaged"]),
        ("faults/fewer_00.msgpack.zst", ["frame 3", "7 particles, expected 8"]),
        ("faults/gap_00.msgpack.zst", ["frame 7", "frame 1"]),
        ("faults/no_box_00.msgpack.zst", ["frame 0", "no 'box'"]),
        ("faults/not_finite_00.msgpack.zst", ["frame 2", "particle 5"]),
        ("faults/other_type_00.msgpack.zst", ["frame 1", "<f8"]),
        ("hole", ["fall_02", "begins with frame 6, expected 3"]),
        ("mixed", ["fall_01", "'other', expected 'fall'"]),
    ] {
        folder.fail(&format!("inspect {}", sequence(name)), &words);
        folder.fail(&format!("render {} -o out.png", sequence(name)), &words);
        folder.fail(&format!("compare {} {}", sequence("plain"), sequence(name)), &words);
        assert!(!folder.path("out.png").exists(), "{name}");
    }
    folder.fail(&format!("render {} -o out.png", sequence("nothing")), &["nothing"]);
    folder.fail(&format!("render {} --frame 9 -o out.png", sequence("plain")), &["no frame 9", "0 to 5"]);
}

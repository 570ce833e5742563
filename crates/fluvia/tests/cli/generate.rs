//! `fluvia generate`: the same files by any number of threads, shards and interruptions.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use crate::common::Folder;
#[cfg(target_os = "linux")]
use crate::common::SmallDisk;

/// A set that takes a second or two: 3 scenes of two parts.
const SMALL: &str = "generate --preset default --scenes 2 --valid 1 --duration 1.1 --particles 1000..1600 \
                     --solver-dt-max 0.005 --seed 4";

/// All files below a directory, by their path from there.
fn tree(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(directory).expect("a directory") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        if path.is_dir() {
            files.extend(tree(&path).into_iter().map(|(below, bytes)| (format!("{name}/{below}"), bytes)));
        } else {
            files.insert(name, std::fs::read(&path).expect("a readable file"));
        }
    }
    files
}

fn make(folder: &Folder, out: &str, more: &str) -> BTreeMap<String, Vec<u8>> {
    folder.succeed(&format!("{SMALL} --out {out} {more}"));
    tree(&folder.path(out))
}

#[test]
fn a_set_is_the_same_files_however_it_is_made() {
    let folder = Folder::new();
    let whole = make(&folder, "whole", "--threads 1");
    let names: Vec<&str> = whole.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "manifest.json",
            "train/sim_0001.json",
            "train/sim_0001_00.msgpack.zst",
            "train/sim_0001_01.msgpack.zst",
            "train/sim_0002.json",
            "train/sim_0002_00.msgpack.zst",
            "train/sim_0002_01.msgpack.zst",
            "valid/sim_0003.json",
            "valid/sim_0003_00.msgpack.zst",
            "valid/sim_0003_01.msgpack.zst",
        ]
    );
    assert!(make(&folder, "threads", "--threads 3 --jobs 2") == whole);
    // Shards into one directory.
    make(&folder, "shared", "--shard 2/2");
    assert!(make(&folder, "shared", "--shard 1/2") == whole);
    // Into two: put together, and the manifest by the command without a shard.
    let first = make(&folder, "first", "--shard 1/2");
    assert_eq!(folder.json("first/manifest.json")["complete"], false);
    make(&folder, "second", "--shard 2/2");
    for (name, bytes) in first.iter().filter(|(name, _)| *name != "manifest.json") {
        folder.write(&format!("second/{name}"), bytes);
    }
    assert!(make(&folder, "second", "") == whole);
    // A smaller set begins in the same way; another seed is another set.
    let scenes = |seed: u32, out: &str| {
        let smaller = SMALL.replace("--scenes 2 --valid 1", "--scenes 1 --valid 0");
        folder.succeed(&format!("{} --out {out}", smaller.replace("--seed 4", &format!("--seed {seed}"))));
        tree(&folder.path(out)).remove("train/sim_0001_00.msgpack.zst")
    };
    assert!(scenes(4, "smaller") == whole.get("train/sim_0001_00.msgpack.zst").cloned());
    assert!(scenes(5, "other") != whole.get("train/sim_0001_00.msgpack.zst").cloned());
}

#[test]
fn the_manifest_says_what_was_made() {
    let folder = Folder::new();
    let run = folder.succeed(&format!("{SMALL} --out set --json"));
    let printed = run.last_json();
    let manifest = folder.json("set/manifest.json");
    assert_eq!((&manifest["complete"], &manifest["frames"]), (&true.into(), &55.into()));
    assert_eq!((&printed["done"], &printed["replaced"]), (&3.into(), &0.into()));
    let records = manifest["records"].as_array().unwrap();
    for (record, name) in records.iter().zip(["train/sim_0001", "train/sim_0002", "valid/sim_0003"]) {
        assert_eq!(*record, folder.json(&format!("set/{name}.json")));
        let particles = record["particles"].as_u64().unwrap();
        assert!((1000..=1600).contains(&particles), "{particles}");
        assert!(record["statistics"]["highest_density"].as_f64().unwrap() > 0.75);
        // The sequence is that of the scene.
        let found = folder.succeed(&format!("inspect set/{name} --json")).last_json();
        assert_eq!(
            (&found["particles"], &found["frames"]),
            (&particles.into(), &"0 to 54".into()),
            "{found}"
        );
        // The scene can be simulated by itself, from the same wall particles.
        folder.write("scene.json", record["scene"].to_string());
        let seed = record["seed"].as_u64().unwrap();
        folder.succeed(&format!(
            "simulate scene.json --solver dfsph --solver-dt-max 0.005 --seed {seed} --steps 54 --out run --overwrite"
        ));
        let run = folder.succeed(&format!("compare run set/{name} --json")).last_json();
        let distance = |key: &str| {
            run["distance"][key].as_array().unwrap().iter().filter_map(|d| d.as_f64()).sum::<f64>()
        };
        assert_eq!(distance("a_to_b_m") + distance("b_to_a_m"), 0.0, "{name}");
    }
    let whole = folder.succeed("inspect set --json").last_json();
    assert_eq!(whole["manifest"]["preset"], "default", "{whole}");
}

#[test]
fn a_killed_command_goes_on_to_the_same_files() {
    let folder = Folder::new();
    let whole = make(&folder, "whole", "");
    for k in 0..12u64 {
        let mut command = folder.command(&format!("{SMALL} --out killed --quiet"));
        let mut child = command.stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(20 + 97 * (k * k % 13)));
        child.kill().unwrap();
        child.wait().unwrap();
    }
    assert!(make(&folder, "killed", "") == whole);
    // What is whole is left as it is, but for what a command that was killed at its end has not removed.
    folder.write("killed/train/sim_0001.state.npz", "left");
    std::fs::create_dir(folder.path("killed/train/sim_0001.frames")).unwrap();
    assert!(make(&folder, "killed", "") == whole);
    assert!(!folder.path("killed/train/sim_0001.frames").exists());
    // A scene that has lost a part is made again, as is one with a part that is cut short. What another process has left
    // of a write is removed.
    std::fs::remove_file(folder.path("killed/train/sim_0002_00.msgpack.zst")).unwrap();
    folder.write("killed/train/sim_0001_01.msgpack.zst", &whole["train/sim_0001_01.msgpack.zst"][..100]);
    folder.write("killed/train/.sim_0001_00.msgpack.zst.4242.tmp", "half");
    folder.write("killed/.manifest.json.4242.tmp", "half");
    // Killed while they are made again, too: then they count as not done.
    let mut child =
        folder.command(&format!("{SMALL} --out killed --quiet")).stderr(Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(250));
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(make(&folder, "killed", "") == whole);
}

#[test]
fn a_killed_command_loses_no_frame() {
    let folder = Folder::new();
    let mut made = BTreeMap::new();
    for last in [3, 9, 15] {
        let mut command = folder.command(&format!("{SMALL} --out killed --jobs 1 --threads 1 --quiet"));
        let mut child = command.spawn().unwrap();
        let frame = |k: u64| folder.path(&format!("killed/train/sim_0001.frames/{k:04}.npz"));
        let start = std::time::Instant::now();
        while !frame(last).exists() && start.elapsed() < Duration::from_secs(60) {
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        // Each but the last, whose state may not have been written, is made once and never again.
        for k in 0..last {
            let time = std::fs::metadata(frame(k)).and_then(|data| data.modified()).unwrap();
            assert_eq!(*made.entry(k).or_insert(time), time, "frame {k}, killed after {last}");
        }
    }
    // What is damaged is not gone on with.
    let whole = make(&folder, "whole", "");
    folder.write("killed/train/sim_0001.frames/0007.npz", "PK");
    let run = folder.succeed(&format!("{SMALL} --out killed"));
    assert!(
        run.stderr.contains("warning: sim_0001: begins again") && run.stderr.contains("0007.npz"),
        "{}",
        run.stderr
    );
    assert!(tree(&folder.path("killed")) == whole);
}

#[test]
fn a_scene_that_blew_up_is_replaced() {
    let folder = Folder::new();
    let whole = make(&folder, "whole", "");
    std::fs::create_dir_all(folder.path("set/train")).unwrap();
    folder.write("set/train/sim_0002.replaced.json", r#"[{ "seed": 7, "frame": 3, "reason": "outside" }]"#);
    let run = folder.succeed(&format!("{SMALL} --out set"));
    assert!(run.stdout.contains("left the walls: 1"), "{}", run.stdout);
    assert!(
        run.stdout.contains("sim_0002 (seed 7): a particle outside the walls in frame 3"),
        "{}",
        run.stdout
    );
    let manifest = folder.json("set/manifest.json");
    assert_eq!((&manifest["complete"], &manifest["replaced"]), (&true.into(), &1.into()));
    let record = folder.json("set/train/sim_0002.json");
    assert_eq!(record["replaced"][0]["reason"], "outside");
    assert_ne!(record["seed"], folder.json("whole/train/sim_0002.json")["seed"]);
    // Nothing else differs, and nothing is left over.
    let set = tree(&folder.path("set"));
    assert!(set.keys().eq(whole.keys()), "{:?}", set.keys());
    assert!(set["train/sim_0001_00.msgpack.zst"] == whole["train/sim_0001_00.msgpack.zst"]);
    assert!(set["train/sim_0002_00.msgpack.zst"] != whole["train/sim_0002_00.msgpack.zst"]);
}

#[test]
#[cfg(unix)]
fn control_c_stops_and_the_command_goes_on() {
    let folder = Folder::new();
    let whole = make(&folder, "whole", "");
    folder.interrupt(&format!("{SMALL} --out out"), "out/train/sim_0001_00.msgpack.zst");
    assert!(make(&folder, "out", "") == whole);
}

#[test]
fn another_set_or_other_files_are_refused() {
    let folder = Folder::new();
    let before = make(&folder, "set", "--shard 1/3");
    for (more, words) in [
        ("--seed 9", ["seed: 4, now: 9"]),
        ("--scenes 5", ["scenes: 2, now: 5"]),
        ("--solver-dt-max 0.004", ["parameters.solver_dt_max"]),
        ("--preset viscosity", ["preset"]),
    ] {
        let option = more.split(' ').next().unwrap();
        let at = SMALL.find(option).unwrap();
        let rest = SMALL[at..].splitn(3, ' ').nth(2).unwrap_or_default();
        let arguments = format!("{} {rest} {more} --out set", &SMALL[..at]);
        let run = folder.run(&arguments);
        assert_eq!(run.code, Some(1), "{arguments}: {}", run.stderr);
        assert!(words.iter().all(|word| run.stderr.contains(word)), "{}", run.stderr);
        assert!(tree(&folder.path("set")) == before, "{arguments}: changed the files");
    }
    std::fs::create_dir(folder.path("mine")).unwrap();
    folder.write("mine/notes.txt", "mine");
    let run = folder.run(&format!("{SMALL} --out mine"));
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("manifest.json"), "{}", run.stderr);
    assert_eq!(tree(&folder.path("mine")).len(), 1);
    // A file in place of the directory.
    let run = folder.run(&format!("{SMALL} --out mine/notes.txt"));
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.starts_with("error: mine/notes.txt"), "{}", run.stderr);
}

#[test]
fn settings_out_of_range() {
    let folder = Folder::new();
    for (arguments, words) in [
        ("generate --preset default --scenes 0 --valid 0 --out out", ["no scenes"]),
        ("generate --preset default --scenes 9000 --valid 1000 --out out", ["9999"]),
        ("generate --preset default --solver-dt 0.5 --out out", ["--solver-dt"]),
        ("generate --preset default --particles 1..5 --out out", ["1..5"]),
        ("generate --preset default --duration 0.01 --out out", ["--duration"]),
        ("generate --preset default --solver-dt-max 1e-9 --out out", ["100000"]),
        ("generate --preset dam-break --viscosity 0.1..0.2 --out out", ["--viscosity"]),
        ("generate --preset material-test --viscosity 0.1..0.2 --out out", ["--viscosity"]),
    ] {
        folder.fail(arguments, &words);
    }
    for arguments in [
        "generate --preset default --shard 3/2 --out out",
        "generate --preset default --particles 5..2 --out out",
        "generate --preset default --viscosity 0.2..0.1 --out out",
        "generate --preset other --out out",
        "generate --out out",
    ] {
        assert_eq!(folder.run(arguments).code, Some(2), "{arguments}");
    }
}

#[test]
fn every_preset_makes_scenes() {
    let folder = Folder::new();
    for (preset, particles, solver) in [
        ("box-6k", 6000..=6000, "dfsph"),
        ("viscosity", 1000..=1600, "dfsph"),
        ("dam-break", 3456..=3456, "pbf"),
        ("material-test", 1000..=20_000, "dfsph"),
    ] {
        let fewer = if preset == "viscosity" { "--particles 1000..1600" } else { "" };
        folder.succeed(&format!(
            "generate --preset {preset} --scenes 0 --valid 2 --duration 0.06 {fewer} --out {preset}"
        ));
        let manifest = folder.json(&format!("{preset}/manifest.json"));
        assert_eq!(manifest["solver"], solver);
        for record in manifest["records"].as_array().unwrap() {
            assert!(
                particles.contains(&(record["particles"].as_u64().unwrap() as usize)),
                "{preset}: {record}"
            );
        }
    }
    // Frames of the dam break are 1/60 s apart, and its gravity is another: both are recorded.
    let found = folder.succeed("inspect dam-break/valid/sim_0001 --json").last_json();
    assert!((found["dt_s"].as_f64().unwrap() - 1.0 / 60.0).abs() < 1e-6, "{found}");
    let dam = folder.succeed("compare dam-break/valid/sim_0001 dam-break/valid/sim_0002 --json").last_json();
    let energy = dam["runs"][0]["potential_energy_j_per_kg"][0].as_f64().unwrap();
    let height = dam["runs"][0]["center_of_mass_m"][0][1].as_f64().unwrap();
    assert!((energy / height - 9.81 / 1.1).abs() < 1e-4, "{energy} at {height}");
    // A set that lacks a sequence is not what its manifest says.
    std::fs::remove_file(folder.path("dam-break/valid/sim_0002_00.msgpack.zst")).unwrap();
    folder.fail("inspect dam-break", &["1 sequences, expected 2"]);
    let set = folder.succeed("inspect material-test --json").last_json();
    assert!(set.to_string().contains("0.044") && set.to_string().contains("0.127"), "{set}");
}

#[test]
fn viscosities_are_those_asked_for() {
    let folder = Folder::new();
    let command =
        "generate --preset default --scenes 4 --valid 0 --duration 0.06 --particles 1000..1600 --out set";
    folder.succeed(&format!("{command} --viscosity 0.5..0.6"));
    let manifest = folder.json("set/manifest.json");
    assert_eq!(manifest["viscosity"], serde_json::json!([0.5, 0.6]));
    let found: Vec<f64> = manifest["records"]
        .as_array()
        .unwrap()
        .iter()
        .map(|record| record["scene"]["viscosity"].as_f64().unwrap())
        .collect();
    assert!(found.iter().all(|viscosity| (0.5..=0.6).contains(viscosity)), "{found:?}");
    assert!(found.windows(2).all(|pair| pair[0] != pair[1]), "{found:?}");
    // Another range is another set.
    folder.fail(&format!("{command} --viscosity 0.5..0.7"), &["set/manifest.json"]);
    folder.fail(command, &["set/manifest.json"]);
}

/// A disk that is full in the middle of a set: what is whole stays, and elsewhere the command goes on.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk() {
    let folder = Folder::new();
    let whole = make(&folder, "whole", "");
    let disk = folder.path("disk");
    let Some(small) = SmallDisk::mount(&disk, "4m") else { return };
    let run = folder.run(&format!("{SMALL} --out disk/set --jobs 1"));
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(run.stderr.starts_with("error: disk/set/") && run.stderr.contains("space"), "{}", run.stderr);
    assert_eq!(run.stderr.lines().count(), 1);
    let files = tree(&disk.join("set"));
    assert!(files.keys().all(|name| !name.contains("tmp")), "{:?}", files.keys());
    assert!(files.contains_key("train/sim_0001_00.msgpack.zst"), "{:?}", files.keys());
    for (name, bytes) in &files {
        let path = folder.path("moved").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    drop(small);
    assert!(make(&folder, "moved", "") == whole);
}

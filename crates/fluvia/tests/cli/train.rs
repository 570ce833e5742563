//! `fluvia train`: the same weights however often it is stopped, and what it refuses.

use std::process::Stdio;
use std::time::Duration;

use crate::common::{Folder, scene_with};

const DATA: &str = "generate --preset default --scenes 2 --valid 1 --duration 0.3 --particles 1000..1200 \
                    --solver-dt-max 0.005 --out data --quiet";

/// A small network, a mean of weights, few updates.
const CONFIG: &str = "\
[network]
integration = \"velocity\"
first = 4
hidden = [4]
[loss]
velocity = true
[training]
updates = 24
batch = 2
lead = 2
position_noise = 0.0001
velocity_noise = 0.01
free_particles = 3
average = 0.9
[rate]
kind = \"cosine\"
highest = 0.01
warmup = 4
[validation]
every = 6
windows = 3
";

fn folder() -> Folder {
    let folder = Folder::new();
    folder.succeed(DATA);
    folder.write("config.toml", CONFIG);
    folder
}

/// The numbers of a safetensors file: what follows the header, which has the time of training.
fn numbers(folder: &Folder, name: &str) -> Vec<u8> {
    let bytes = std::fs::read(folder.path(name)).expect("a file of weights");
    let header = u64::from_le_bytes(*bytes.first_chunk().expect("a length")) as usize;
    bytes[8 + header..].to_vec()
}

fn lines(folder: &Folder, run: &str) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(folder.path(&format!("{run}/metrics.jsonl"))).expect("lines");
    let mut lines: Vec<serde_json::Value> =
        text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    // The only number that depends on the clock.
    lines.iter_mut().for_each(|line| line["particles_per_s"] = 0.into());
    lines
}

/// The last validation of a training that validates every 10 updates, by its record in weights.
fn recorded_validation(folder: &Folder, name: &str) -> u64 {
    let weights = folder.succeed(&format!("inspect {name} --json")).last_json();
    let training = &weights["metadata"]["fluvia"]["training"];
    let last = training["updates"].as_u64().expect("a number of updates") / 10 * 10;
    assert_eq!(training["validation"]["update"].as_u64().unwrap_or(0), last, "{training}");
    last
}

/// How often a training is killed.
const KILLS: usize = 20;

#[test]
fn a_killed_training_ends_with_the_same_weights() {
    let folder = folder();
    folder.write(
        "config.toml",
        CONFIG.replace("updates = 24", "updates = 120").replace("every = 6", "every = 10"),
    );
    folder.succeed("train config.toml --data data --out whole");
    let whole = numbers(&folder, "whole/weights.safetensors");
    let metrics = folder.path("killed/metrics.jsonl");
    let count = || std::fs::read_to_string(&metrics).unwrap_or_default().lines().count();
    let mut validated = 0;
    for k in 0..KILLS {
        let threads = 1 + k % 2;
        let mut command = folder.command(&format!(
            "train config.toml --data data --out killed --checkpoint 2 --threads {threads} --quiet --resume"
        ));
        let mut child = command.stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
        // Between none and five updates later, at any moment of one.
        let (start, more) = (count(), k * k % 6);
        while count() < start + more {
            assert!(child.try_wait().unwrap().is_none(), "ended before kill {k}");
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis((7 * k % 23) as u64));
        child.kill().unwrap();
        assert!(!child.wait().unwrap().success());
        if folder.path("killed/weights.safetensors").exists() {
            validated = recorded_validation(&folder, "killed/weights.safetensors");
        }
    }
    assert!(validated > 0, "killed before the first validation only");
    folder.succeed("train config.toml --data data --out killed --resume");
    assert!(numbers(&folder, "killed/weights.safetensors") == whole);
    assert!(numbers(&folder, "killed/best.safetensors") == numbers(&folder, "whole/best.safetensors"));
    assert_eq!(lines(&folder, "killed"), lines(&folder, "whole"));
    recorded_validation(&folder, "killed/best.safetensors");
    // Done: nothing changes.
    folder.succeed("train config.toml --data data --out killed --resume");
    assert!(numbers(&folder, "killed/weights.safetensors") == whole);
    assert_eq!(lines(&folder, "killed"), lines(&folder, "whole"));
    // The weights are those of a network that moves fluids.
    folder.succeed("simulate dam_break --weights whole/weights.safetensors --steps 2 --out run");
}

#[test]
fn the_loss_falls_and_is_recorded() {
    let folder = folder();
    let printed = folder.succeed("train config.toml --data data --out run --json").last_json();
    assert_eq!(printed["updates"], 24);
    let lines = lines(&folder, "run");
    let losses: Vec<f64> =
        lines.iter().filter(|l| l["kind"] == "valid").map(|l| l["loss"].as_f64().unwrap()).collect();
    assert_eq!(losses.len(), 4);
    assert!(losses[3] < losses[0], "{losses:?}");
    let best = printed["best_update"].as_u64().unwrap();
    let errors = |update: u64| {
        let line = lines.iter().find(|l| l["kind"] == "valid" && l["update"] == update).unwrap();
        line["err_n2_mm"].as_f64().unwrap()
    };
    assert!([6, 12, 18, 24].iter().all(|&update| errors(best) <= errors(update)));
    let events = std::fs::read_dir(folder.path("run")).unwrap().filter(|entry| {
        entry.as_ref().unwrap().file_name().to_string_lossy().starts_with("events.out.tfevents.")
    });
    assert_eq!(events.count(), 1);
}

#[test]
fn what_is_refused() {
    let folder = folder();
    folder.succeed("train config.toml --data data --out run --updates 1");
    folder.fail("train config.toml --data data --out run --updates 1", &["run", "--resume or --overwrite"]);
    folder.fail(
        "train config.toml --data data --out run --updates 2 --resume",
        &["training.updates: 1, now: 2"],
    );
    folder.write("wider.toml", CONFIG.replace("first = 4", "first = 5"));
    folder.fail("train wider.toml --data data --out run --updates 1 --resume", &["another network"]);
    folder.write("typo.toml", CONFIG.replace("batch", "bach"));
    folder.fail("train typo.toml --data data --out new", &["typo.toml", "line 9", "`bach`"]);
    folder.write("zero.toml", CONFIG.replace("batch = 2", "batch = 0"));
    folder.fail("train zero.toml --data data --out new", &["zero.toml", "`training.batch`", "at least 1"]);
    folder.fail("train config.toml --data nothing --out new", &["nothing/train", "--data"]);
    folder.fail("train config.toml --out new", &["--data", "data.train"]);
    std::fs::create_dir_all(folder.path("empty/train")).unwrap();
    folder.fail("train config.toml --data empty --out new", &["empty/train", "no sequence"]);
    assert!(!folder.path("new").exists());
    // A damaged part is named, and left out where that is wished.
    let part = folder.path("data/train/sim_0002_00.msgpack.zst");
    let bytes = std::fs::read(&part).unwrap();
    std::fs::write(&part, &bytes[..bytes.len() - 20]).unwrap();
    folder.fail("train config.toml --data data --out damaged", &["sim_0002_00.msgpack.zst"]);
    let run = folder.succeed("train config.toml --data data --out left --skip-damaged");
    assert!(run.stderr.contains("sim_0002_00.msgpack.zst"), "{}", run.stderr);
    // A checkpoint that is cut short.
    let checkpoint = folder.path("run/checkpoint.safetensors");
    let bytes = std::fs::read(&checkpoint).unwrap();
    std::fs::write(&checkpoint, &bytes[..bytes.len() / 2]).unwrap();
    folder.fail(
        "train config.toml --data data --out run --updates 1 --resume",
        &["run/checkpoint.safetensors"],
    );
}

#[test]
fn an_overwritten_training_is_gone() {
    let folder = folder();
    folder.succeed("train config.toml --data data --out run --updates 8");
    folder.write(
        "wild.toml",
        CONFIG.replace("highest = 0.01", "highest = 1e30").replace("updates = 24", "updates = 8"),
    );
    // It ends before its first validation.
    let run = folder.run("train wild.toml --data data --out run --overwrite");
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    assert!(!folder.path("run/best.safetensors").exists());
    folder.fail("train config.toml --data data --out run --updates 8 --resume", &["rate.highest"]);
}

/// What was learned before a loss that is not finite is on disk, and such weights are evaluated as what they are.
#[test]
fn a_training_that_explodes() {
    let folder = folder();
    folder.write("wild.toml", CONFIG.replace("highest = 0.01", "highest = 1e30"));
    folder.fail("train wild.toml --data data --out wild", &["not finite in update"]);
    let updates = lines(&folder, "wild").len();
    let inspected = folder.succeed("inspect wild/weights.safetensors --json").last_json();
    let trained = &inspected["metadata"]["fluvia"]["training"]["updates"];
    assert!(updates > 0 && *trained == updates, "{inspected}");
    folder.fail("train wild.toml --data data --out wild --resume --quiet", &["not finite in update"]);

    let command = "evaluate --weights wild/weights.safetensors --data data --out report --json";
    let found = folder.succeed(command).last_json();
    assert!(found["non_finite_frames"].as_u64().unwrap() > 0, "{found}");
    assert!(found["unstable_from"].as_u64().unwrap() > 0, "{found}");
    for key in ["whole_seq_mm", "outside", "worst_outside", "highest_density", "height_error_mm"] {
        assert!(found[key].is_null(), "{key}: {}", found[key]);
        assert!(found["sequences"]["sim_0003"][key].is_null(), "{key}");
    }
    assert!(folder.path("report/sim_0003.svg").exists());
}

/// Nothing that was trained is lost to a training that begins, unless it is told to.
#[test]
fn trained_weights_are_kept() {
    let folder = folder();
    folder.succeed("train config.toml --data data --out run --updates 6");
    let before = folder.files("run");
    let refused = |arguments: &str, words: &[&str]| {
        folder.fail(&format!("train {arguments} --out run"), words);
        assert!(folder.files("run") == before, "{arguments}");
    };
    refused("config.toml --data data --updates 6", &["checkpoint.safetensors", "--overwrite"]);
    // What cannot begin does not end what is there.
    folder.write("long.toml", CONFIG.replace("lead = 2", "lead = 60"));
    refused("long.toml --data data --overwrite", &["data/train", "63"]);
    folder.write("odd.toml", CONFIG.replace("[network]", "[network]\ngravity = [nan, 0, 0]"));
    refused("odd.toml --data data --overwrite", &["gravity"]);
    // What other programs have written.
    for name in ["config.json", "metrics.jsonl", "events.out.tfevents.1"] {
        std::fs::create_dir_all(folder.path("theirs")).unwrap();
        folder.write(&format!("theirs/{name}"), "{}");
        folder.fail("train config.toml --data data --out theirs", &["theirs", name, "--overwrite"]);
        folder.fail("train config.toml --data data --out theirs --resume", &["theirs", "config.json"]);
        assert_eq!(folder.files("theirs").len(), 1);
        std::fs::remove_dir_all(folder.path("theirs")).unwrap();
    }
    // Weights without a checkpoint.
    std::fs::remove_file(folder.path("run/checkpoint.safetensors")).unwrap();
    let before = folder.files("run");
    folder.fail("train config.toml --data data --out run", &["weights.safetensors", "--overwrite"]);
    folder.fail("train config.toml --data data --out run --resume", &["no checkpoint.safetensors"]);
    assert!(folder.files("run") == before);
    folder.succeed(
        "train config.toml --data data --out run --updates 2 --weights run/best.safetensors --overwrite",
    );
    let events = folder.files("run").keys().filter(|name| name.starts_with("events.")).count();
    assert_eq!(events, 1);
}

#[test]
fn settings_must_be_those_of_the_data() {
    let folder = folder();
    folder.fail(
        "train dam-break --data data --updates 1 --out new",
        &["data/train/sim_0001.json", "`dt`", "0.02 s"],
    );
    folder.write("light.toml", CONFIG.replace("[network]", "[network]\ngravity = [0, -1.6, 0]"));
    folder.fail("train light.toml --data data --out new", &["sim_0001.json", "`gravity`", "-9.81", "-1.6"]);
    folder.write("slow.toml", CONFIG.replace("[network]", "[network]\ndt = 0.01"));
    folder.fail("train slow.toml --data data --out new", &["sim_0001.json", "`dt`", "0.02 s", "0.01 s"]);
    // A sequence without a record has its particles.
    folder.succeed("generate --preset viscosity --scenes 1 --valid 0 --duration 0.2 --particles 1000..1200 --out thick --quiet");
    std::fs::remove_file(folder.path("thick/train/sim_0001.json")).unwrap();
    folder.fail(
        "train config.toml --data thick --out new",
        &["thick/train/sim_0001_00", "`viscosity`", "0.01"],
    );
    assert!(!folder.path("new").exists());
}

#[test]
fn weights_to_begin_with() {
    let folder = folder();
    folder.succeed("train config.toml --data data --out plain --updates 3");
    folder.write("viscosity.toml", CONFIG.replace("[network]", "[network]\nviscosity = true"));
    folder.succeed("train viscosity.toml --data data --data data --out wider --updates 1 --weights plain/weights.safetensors");
    assert_eq!(
        folder.json("wider/config.json")["data"]["train"],
        serde_json::json!(["data/train", "data/train"])
    );
    let inspected = folder.succeed("inspect wider/weights.safetensors").stdout;
    assert!(inspected.contains("viscosity"), "{inspected}");
    // What goes on has its weights, and its record says where they are from.
    folder.succeed(
        "train viscosity.toml --data data --out later --updates 2 --weights plain/weights.safetensors",
    );
    std::fs::rename(folder.path("plain"), folder.path("moved")).unwrap();
    folder.succeed("train viscosity.toml --data data --out later --updates 2 --resume");
    let named = CONFIG.replace("[training]", "[training]\nweights = \"plain/best.safetensors\"");
    folder.write("named.toml", named);
    folder.fail("train named.toml --data data --out named", &["plain/best.safetensors"]);
    std::fs::rename(folder.path("moved"), folder.path("plain")).unwrap();
    folder.succeed("train named.toml --data data --out named --updates 1");
    let record = folder.json("named/config.json");
    assert_eq!(record["first_weights"]["name"], "plain/best.safetensors");
    assert_eq!(record["first_weights"]["training"]["updates"], 3);
    assert_eq!(record["data"]["sets"][0]["preset"], "default");
    assert!(record["made_with"]["threads"].as_u64().unwrap() > 0);
    // It has learned from the viscosities of its data.
    folder.write("thick.json", scene_with(r#""viscosity": 0.2"#));
    let run = folder.run("simulate thick.json --weights wider/weights.safetensors --steps 1 --out thick");
    assert!(run.code == Some(1) && run.stderr.contains("learned from 0.01 to 0.01"), "{}", run.stderr);
    // Not the other way round.
    folder.fail(
        "train config.toml --data data --out narrower --weights wider/weights.safetensors",
        &["wider/weights.safetensors", "another network"],
    );
}

#[test]
fn variants_side_by_side() {
    let folder = folder();
    folder.write("base.toml", CONFIG);
    let variant = "[network]\nwindow = \"none\"\ninterpolation = \"nearest\"\nfully_connected = false";
    folder.write("bare.toml", CONFIG.replace("[network]", variant));
    let command = "ablate base.toml bare.toml --data data --updates 3 --seeds 2 --out table";
    let printed = folder.succeed(command).stdout;
    assert!(printed.contains("Means of 2 seeds"), "{printed}");
    assert_eq!(std::fs::read_to_string(folder.path("table/ablation.md")).unwrap(), printed);
    let found = folder.json("table/ablation.json");
    assert_eq!((&found[0]["name"], &found[1]["name"]), (&"base".into(), &"bare".into()));
    let error = |variant: usize, seed: usize| found[variant]["figures"][seed]["err_n1_mm"].as_f64().unwrap();
    assert!(error(0, 0) != error(0, 1) && error(0, 0) != error(1, 0));
    let inspected = folder.succeed("inspect table/bare/seed_1/weights.safetensors").stdout;
    assert!(!inspected.contains("dense1"), "{inspected}");
    // Stopped in its second training and in its first evaluation, the same command ends with the same table.
    #[cfg(unix)]
    for (out, file) in [
        ("trains", "trains/bare/seed_0/config.json"),
        ("evaluates", "evaluates/base/seed_0/weights.safetensors"),
    ] {
        let command = command.replace("--out table", &format!("--out {out}"));
        let stopped = folder.interrupt(&command, file);
        assert!(stopped.stderr.contains("the same command goes on"), "{}", stopped.stderr);
        // What is done is a table; the evaluation may have been too fast to be stopped.
        let table = std::fs::read_to_string(folder.path(&format!("{out}/ablation.md"))).unwrap_or_default();
        assert!(table.contains("not done yet") || out == "evaluates", "{table}");
        assert_eq!(folder.succeed(&command).stdout, printed);
    }
    // What is there is not made again.
    let before = numbers(&folder, "table/bare/seed_1/weights.safetensors");
    assert_eq!(folder.succeed(command).stdout, printed);
    assert!(numbers(&folder, "table/bare/seed_1/weights.safetensors") == before);
    folder.fail("ablate base.toml base.toml --data data --out twice", &["base", "two variants"]);
    folder.fail("ablate unknown --data data --out unknown", &["unknown", "without-window"]);
    // Other weights, other figures.
    folder.succeed("train base.toml --data data --updates 5 --out table/base/seed_0 --overwrite");
    folder.succeed("ablate base.toml --data data --updates 5 --seeds 1 --out table");
    assert!(folder.json("table/ablation.json")[0]["figures"][0]["err_n1_mm"] != error(0, 0));
    // What diverges has no figures, and the others have theirs.
    folder.write("wild.toml", CONFIG.replace("highest = 0.01", "highest = 1e30"));
    let run = folder.succeed("ablate wild.toml base.toml --data data --updates 5 --seeds 1 --out wild");
    assert!(run.stderr.contains("wild, seed 0") && run.stdout.contains("| wild | none |"), "{}", run.stdout);
    assert!(folder.json("wild/ablation.json")[1]["figures"][0]["err_n1_mm"].is_number());
    // What cannot be trained stops all before the first update.
    folder.write("moon.toml", CONFIG.replace("[network]", "[network]\ngravity = [0, -1.6, 0]"));
    folder.fail("ablate base.toml moon.toml --data data --updates 5 --out other", &["`gravity`", "-1.6"]);
    folder.write("long.toml", CONFIG.replace("lead = 2", "lead = 60"));
    folder.fail("ablate base.toml long.toml --data data --updates 5 --out other", &["data/train", "63"]);
    assert!(!folder.path("other").exists());
    // What cannot be evaluated is not trained.
    std::fs::remove_dir_all(folder.path("data/valid")).unwrap();
    std::fs::create_dir(folder.path("data/valid")).unwrap();
    folder.fail(
        "ablate base.toml --data data --updates 5 --seeds 1 --out other",
        &["data/valid", "no sequences"],
    );
    assert!(!folder.path("other").exists());
}

/// On a disk that fills up between two checkpoints the first stays, and a training goes on from it.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_the_old_checkpoint() {
    use crate::common::SmallDisk;
    let folder = folder();
    folder.succeed("train config.toml --data data --out whole");
    let disk = folder.path("disk");
    let Some(_small) = SmallDisk::mount(&disk, "2m") else { return };
    let command = "train config.toml --data data --out disk/run --checkpoint 4";
    let mut child = folder.command(command).stderr(Stdio::null()).stdout(Stdio::null()).spawn().unwrap();
    let checkpoint = disk.join("run/checkpoint.safetensors");
    while !checkpoint.exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let old = std::fs::read(&checkpoint).unwrap();
    // Room for some lines of numbers, none for a checkpoint.
    let free = |bytes: usize| {
        let mut filler = vec![0u8; 2 << 20];
        while std::fs::write(disk.join("filler"), &filler).is_err() {
            filler.truncate(filler.len() - 4096);
        }
        filler.truncate(filler.len() - bytes);
        std::fs::write(disk.join("filler"), &filler).unwrap();
    };
    free(3 * 4096);
    let run = folder.run(&format!("{command} --resume"));
    assert_eq!(run.code, Some(1), "{}", run.stderr);
    let error: Vec<&str> = run.stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    assert!(
        error.len() == 1 && error[0].contains("disk/run/") && error[0].contains("space"),
        "{}",
        run.stderr
    );
    assert!(std::fs::read(&checkpoint).unwrap() == old);
    std::fs::remove_file(disk.join("filler")).unwrap();
    folder.succeed(&format!("{command} --resume"));
    assert!(
        numbers(&folder, "disk/run/weights.safetensors") == numbers(&folder, "whole/weights.safetensors")
    );
    assert_eq!(lines(&folder, "disk/run"), lines(&folder, "whole"));
}

/// What a training holds in memory does not grow with its updates.
#[cfg(target_os = "linux")]
#[test]
fn memory_stays_flat() {
    const MOST_GROWTH: f64 = 1.0;
    let folder = Folder::new();
    folder.write(
        "config.toml",
        CONFIG
            // The sequences of the fixture are of several liquids.
            .replace("[network]", "[network]\nviscosity = true")
            .replace("updates = 24", "updates = 2400")
            .replace("every = 6", "every = 50")
            .replace("lead = 2", "lead = 1"),
    );
    let data = crate::common::sequence("set");
    let mut command =
        folder.command(&format!("train config.toml --data {data} --out run --quiet --threads 2"));
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let metrics = folder.path("run/metrics.jsonl");
    // Resident memory in MiB, by the number of updates.
    let mut samples: Vec<(u64, f64)> = Vec::new();
    while child.try_wait().unwrap().is_none() {
        let status = std::fs::read_to_string(&status).unwrap_or_default();
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let resident = resident.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
        let update = std::fs::read_to_string(&metrics).unwrap_or_default().lines().count() as u64;
        samples.extend(resident.map(|kibibytes| (update, kibibytes / 1024.0)));
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(child.wait().unwrap().success());
    let highest = |updates: std::ops::Range<u64>| {
        let of_range = samples.iter().filter(|(update, _)| updates.contains(update));
        of_range.map(|(_, resident)| *resident).fold(0.0, f64::max)
    };
    let (early, late) = (highest(200..500), highest(2000..3000));
    println!("{early:.2} MiB after 200 to 500 updates, {late:.2} MiB after 2000; {} samples", samples.len());
    assert!(early > 0.0 && late > 0.0, "{} samples", samples.len());
    // Lists of events and lines would be as long; a batch or a gradient that stays is a hundred times that.
    assert!(late - early < MOST_GROWTH, "{early} MiB, then {late} MiB");
}

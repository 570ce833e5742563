//! The directory of a run: what each mode keeps and removes, what a failed run leaves, and the index for ParaView.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use fluvia_sim::Error;
use fluvia_sim::frames::{Format, Mode, RunDirectory, State, run};
use fluvia_sim::particles::{Boundary, Particles};

const DT: f32 = 0.02;

fn particles(count: usize) -> Particles {
    Particles::of_one_body(vec![[0.1, 0.2, 0.3]; count], vec![[1.0, 2.0, 3.0]; count])
}

fn walls() -> Boundary {
    Boundary { position: vec![[0.0; 3]], normal: vec![[0.0, 1.0, 0.0]] }
}

fn names(directory: &Path) -> BTreeSet<String> {
    fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

fn set(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[track_caller]
fn refused(path: &Path, mode: Mode, mentions: &[&str]) {
    let message = RunDirectory::open(path, mode, &[Format::Npz], DT).unwrap_err().to_string();
    for mention in mentions.iter().chain([&path.to_str().unwrap()]) {
        assert!(message.contains(mention), "'{mention}' is not in: {message}");
    }
    assert!(!message.contains('\n'), "{message}");
}

/// A whole run of `frames` frames.
fn finished(path: &Path, frames: u64, formats: &[Format]) {
    let mut run = RunDirectory::open(path, Mode::New, formats, DT).unwrap();
    run.write_walls(&walls()).unwrap();
    run.write_record(&serde_json::json!({"seed": 0})).unwrap();
    for step in 0..frames {
        run.write_frame(step, &particles(2)).unwrap();
        run.write_state(&State { step, particles: particles(2), ..State::default() }).unwrap();
    }
}

#[test]
fn a_run_writes_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/out");
    finished(&path, 2, &[Format::Npz, Format::Vtu]);
    let expected = [
        "box.npz",
        "box.vtu",
        "fluid.pvd",
        "fluid_0000.npz",
        "fluid_0000.vtu",
        "fluid_0001.npz",
        "fluid_0001.vtu",
        "run.json",
        "state.npz",
    ];
    assert_eq!(names(&path), set(&expected));
    let frames = run::list(&path).unwrap();
    let found: Vec<_> = frames.iter().map(|frame| (frame.index, frame.format)).collect();
    assert_eq!(found, [(0, Format::Npz), (0, Format::Vtu), (1, Format::Npz), (1, Format::Vtu)]);
    assert_eq!(run::read_frame(&path, 1).unwrap().position, particles(2).position);
    assert_eq!(run::read_walls(&path).unwrap().unwrap().normal, Some(walls().normal));
    assert!(run::read_frame(&path, 2).unwrap_err().to_string().contains("fluid_0002"));
    let record: serde_json::Value = fluvia_sim::frames::read_json(&path.join("run.json")).unwrap();
    assert_eq!(record["seed"], 0);
}

#[test]
fn the_index_lists_the_frames_with_their_times() {
    let folder = tempfile::tempdir().unwrap();
    finished(folder.path(), 4, &[Format::Vtu]);
    let mut run = RunDirectory::open(folder.path(), Mode::Resume, &[Format::Vtu], DT).unwrap();
    run.write_frame(50_000, &particles(0)).unwrap();
    let text = fs::read_to_string(folder.path().join("fluid.pvd")).unwrap();
    for entry in [
        "timestep=\"0\" part=\"0\" file=\"fluid_0000.vtu\"",
        "timestep=\"0.06\" part=\"0\" file=\"fluid_0003.vtu\"",
        "timestep=\"1000\" part=\"0\" file=\"fluid_50000.vtu\"",
    ] {
        assert!(text.contains(entry), "{entry} is not in {text}");
    }
    assert_eq!(text.matches("<DataSet").count(), 5);
    assert_eq!(run.frames().unwrap().last().unwrap().index, 50_000, "sorted by number, not by name");
}

#[test]
fn a_new_run_does_not_mix_with_an_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let old = ["fluid_0003.ply", "state.npz", "run.json", "fluid.pvd", "box.npz"];
    for name in old {
        let path = folder.path().join(name);
        fs::write(&path, "old").unwrap();
        refused(folder.path(), Mode::New, &[name, "--resume", "--overwrite"]);
        fs::remove_file(path).unwrap();
    }
    // These belong to somebody else.
    for name in ["box.obj", "box.ply", "fluid_3.npz", "fluid_0000.npz.bak", "scene.json"] {
        fs::write(folder.path().join(name), "other").unwrap();
    }
    RunDirectory::open(folder.path(), Mode::New, &[Format::Npz], DT).unwrap();
    let file = folder.path().join("scene.json");
    assert!(RunDirectory::open(&file, Mode::New, &[Format::Npz], DT).is_err(), "a file is no directory");
}

#[test]
fn overwriting_removes_the_old_run_and_nothing_else_when_the_new_one_writes() {
    let folder = tempfile::tempdir().unwrap();
    finished(folder.path(), 3, &[Format::Npz, Format::Bgeo]);
    for name in ["box.obj", "box.ply", "notes.txt", "picture.png"] {
        fs::write(folder.path().join(name), "other").unwrap();
    }
    fs::write(folder.path().join(".fluid_0009.npz.123.tmp"), "begun").unwrap();
    let before = names(folder.path());
    let run = RunDirectory::open(folder.path(), Mode::Overwrite, &[Format::Npz], DT).unwrap();
    drop(run);
    assert_eq!(names(folder.path()), before, "a run that fails before it writes leaves the old one");

    let mut run = RunDirectory::open(folder.path(), Mode::Overwrite, &[Format::Npz], DT).unwrap();
    run.write_frame(0, &particles(1)).unwrap();
    let expected = ["box.obj", "box.ply", "fluid_0000.npz", "notes.txt", "picture.png"];
    assert_eq!(names(folder.path()), set(&expected));
}

#[test]
fn a_run_resumes_from_its_state() {
    let folder = tempfile::tempdir().unwrap();
    refused(folder.path(), Mode::Resume, &["state.npz"]);
    let missing = folder.path().join("missing");
    refused(&missing, Mode::Resume, &["state.npz"]);
    assert!(!missing.exists());
    finished(folder.path(), 2, &[Format::Npz]);
    // The process was killed while it wrote the next frame.
    fs::write(folder.path().join(".fluid_0002.npz.123.tmp"), "begun").unwrap();
    let mut run = RunDirectory::open(folder.path(), Mode::Resume, &[Format::Npz], DT).unwrap();
    let state = run.read_state().unwrap();
    assert_eq!((state.step, state.particles), (1, particles(2)));
    run.write_frame(2, &particles(2)).unwrap();
    drop(run);
    let expected = ["box.npz", "fluid_0000.npz", "fluid_0001.npz", "fluid_0002.npz", "run.json", "state.npz"];
    assert_eq!(names(folder.path()), set(&expected));
}

#[test]
fn what_killed_processes_left_is_gone_though_there_is_nothing_more_to_write() {
    let folder = tempfile::tempdir().unwrap();
    finished(folder.path(), 2, &[Format::Npz]);
    let whole = names(folder.path());
    for name in [".fluvia-write-check", "..fluvia-write-check.123.tmp", ".state.npz.123.tmp"] {
        fs::write(folder.path().join(name), "begun").unwrap();
    }
    drop(RunDirectory::open(folder.path(), Mode::Resume, &[Format::Npz], DT).unwrap());
    assert_eq!(names(folder.path()), whole);
}

#[test]
fn a_run_that_fails_before_its_first_frame_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b/out");
    let mut run = RunDirectory::open(&path, Mode::New, &[Format::Npz, Format::Bgeo], DT).unwrap();
    assert!(path.is_dir());
    run.write_walls(&walls()).unwrap();
    run.write_record(&1).unwrap();
    // The first format can hold this identity, the second cannot.
    let odd = Particles { id: vec![u32::MAX], ..particles(1) };
    assert!(matches!(run.write_frame(0, &odd), Err(Error::Io { .. })));
    assert_eq!(names(&path), set(&["box.bgeo", "box.npz", "run.json"]));
    drop(run);
    assert_eq!(names(folder.path()), set(&[]));
}

#[test]
fn a_frame_that_fails_is_there_in_no_format_and_those_before_it_are_whole() {
    let folder = tempfile::tempdir().unwrap();
    let formats = [Format::Npz, Format::Vtu, Format::Bgeo];
    let mut run = RunDirectory::open(folder.path(), Mode::New, &formats, DT).unwrap();
    run.write_frame(0, &particles(1)).unwrap();
    let before = names(folder.path());
    let odd = Particles { id: vec![u32::MAX], ..particles(1) };
    assert!(run.write_frame(1, &odd).is_err());
    drop(run);
    assert_eq!(names(folder.path()), before);
    for frame in run::list(folder.path()).unwrap() {
        assert_eq!(fluvia_sim::frames::read(&frame.path).unwrap().position.len(), 1);
    }
    let index = fs::read_to_string(folder.path().join("fluid.pvd")).unwrap();
    assert_eq!(index.matches("<DataSet").count(), 1);
}

#[cfg(target_os = "linux")]
#[test]
fn a_directory_that_cannot_be_written_is_found_at_once() {
    // Nobody, not even root, makes files there.
    refused(Path::new("/proc"), Mode::New, &[]);
    refused(Path::new("/proc/fluvia"), Mode::New, &[]);
}

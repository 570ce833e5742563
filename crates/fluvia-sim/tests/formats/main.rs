//! Particle files: what is written reads back to the same bits, odd files of other programs are read, and damaged
//! ones are one-line errors within bounded memory.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

use std::fs;
use std::path::{Path, PathBuf};

use fluvia_sim::Error;
use fluvia_sim::frames::{self, Format, ParticleData, State};
use fluvia_sim::particles::{Boundary, Particles};

mod damage;
mod memory;
mod odd;

/// A reader may hold this many bytes for each byte of the file: a one-digit ASCII number and its blank become an f64
/// in a vector that is up to half empty and is copied when it grows (3 x 8 bytes for 2), beside copies of the text.
const BYTES_FOR_A_BYTE: usize = 24;
/// The state of inflate and of the zip reader comes on top.
const READER_STATE: usize = 512 << 10;

/// Parses within bounded memory; an error must be one line that names the file.
fn parse(format: Format, bytes: &[u8]) -> Result<ParticleData, String> {
    let path = PathBuf::from(format!("folder/odd.{format}"));
    let (result, peak) = memory::peak_of(|| frames::parse(&path, format, bytes));
    let allowed = BYTES_FOR_A_BYTE * bytes.len() + READER_STATE;
    assert!(peak <= allowed, "{format}: {peak} bytes held for a file of {}, allowed {allowed}", bytes.len());
    result.map_err(|error| one_line(&error, &path))
}

#[track_caller]
fn one_line(error: &Error, path: &Path) -> String {
    /// More would not be read.
    const LONGEST: usize = 400;
    let message = error.to_string();
    assert!(!message.contains('\n'), "more than one line: {message}");
    assert!(message.starts_with(path.to_str().unwrap()), "does not name its file: {message}");
    assert!(message.len() < LONGEST, "too long: {message}");
    message
}

#[track_caller]
fn rejected(format: Format, bytes: &[u8], mentions: &[&str]) {
    let message = parse(format, bytes).expect_err("a damaged file was accepted");
    for mention in mentions {
        assert!(message.contains(mention), "'{mention}' is not in: {message}");
    }
}

/// Values that a detour through text or another type would change.
fn particles(count: usize) -> Particles {
    let special = [-0.0, f32::MIN_POSITIVE / 8.0, f32::MAX, f32::MIN, 0.1, 1.0 / 3.0, -1e-30];
    let number = |i: usize| special[i % special.len()] * if i < special.len() { 1.0 } else { 0.37 };
    Particles {
        position: (0..count).map(|i| [number(3 * i), number(3 * i + 1), number(3 * i + 2)]).collect(),
        velocity: (0..count).map(|i| [number(5 * i), -number(i), i as f32]).collect(),
        // Identities rise, as in a run: bgeo readers sort by them.
        id: (0..count).map(|i| if i + 1 == count { i32::MAX as u32 } else { 3 * i as u32 }).collect(),
        body: (0..count).map(|i| i as u32 % 3).collect(),
        memory: Vec::new(),
    }
}

fn walls(count: usize) -> Boundary {
    let particles = particles(count);
    Boundary { position: particles.position, normal: particles.velocity }
}

/// A fluid frame of our own.
fn file_of(format: Format, count: usize) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fluid");
    frames::write_fluid(&path, format, &particles(count)).unwrap();
    fs::read(&path).unwrap()
}

fn state() -> State {
    State {
        step: 12,
        particles: Particles {
            memory: vec![[0.1, -0.0], [3.0, f32::MAX], [1.0 / 7.0, 4.0], [0.0; 2], [-5.0, 1e-40]],
            ..particles(5)
        },
        next_id: u32::MAX,
        removed: 3,
        counters: [("highest speed".into(), f64::NEG_INFINITY), ("mean".into(), 0.1)].into(),
    }
}

fn bits(vectors: &[[f32; 3]]) -> Vec<u32> {
    vectors.as_flattened().iter().map(|value| value.to_bits()).collect()
}

#[test]
fn what_is_written_reads_back_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL {
        for count in [0, 1, 2, 3000] {
            let path = folder.path().join(format!("fluid.{format}"));
            let written = particles(count);
            frames::write_fluid(&path, format, &written).unwrap();
            let read = frames::read(&path).unwrap();
            assert_eq!(bits(&read.position), bits(&written.position), "{format} {count}");
            assert_eq!(bits(read.velocity.as_ref().unwrap()), bits(&written.velocity), "{format} {count}");
            assert_eq!(read.id.as_ref(), Some(&written.id), "{format} {count}");
            assert_eq!(read.body.as_ref(), Some(&written.body), "{format} {count}");
            assert_eq!(read.normal, None, "{format} {count}");

            let written = walls(count);
            frames::write_walls(&path, format, &written).unwrap();
            let read = frames::read(&path).unwrap();
            assert_eq!(bits(&read.position), bits(&written.position), "{format} {count}");
            assert_eq!(bits(read.normal.as_ref().unwrap()), bits(&written.normal), "{format} {count}");
            assert_eq!((read.velocity, read.id, read.body), (None, None, None), "{format} {count}");

            // Known by its content too.
            let renamed = folder.path().join("fluid.data");
            fs::rename(&path, &renamed).unwrap();
            assert_eq!(frames::read(&renamed).unwrap().position.len(), count, "{format}");
        }
    }
}

#[test]
fn equal_frames_are_equal_files() {
    for format in Format::ALL {
        assert_eq!(file_of(format, 20), file_of(format, 20), "{format}");
    }
}

#[test]
fn writers_refuse_what_they_cannot_hold() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fluid.bgeo");
    let mut odd = particles(2);
    odd.id[1] = u32::MAX;
    let error = frames::write_fluid(&path, Format::Bgeo, &odd).unwrap_err();
    assert!(one_line(&error, &path).contains("4294967295"));
    odd.body.pop();
    let error = frames::write_fluid(&path, Format::Npz, &odd).unwrap_err();
    assert!(matches!(error, Error::Parameter(_)));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_state_reads_back_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state.npz");
    for written in [state(), State::default()] {
        written.save(&path).unwrap();
        let read = State::load(&path).unwrap();
        assert_eq!(bits(&read.particles.position), bits(&written.particles.position));
        assert_eq!(bits(&read.particles.velocity), bits(&written.particles.velocity));
        assert_eq!(read, written);
    }
    frames::write_fluid(&path, Format::Npz, &particles(2)).unwrap();
    let message = one_line(&State::load(&path).unwrap_err(), &path);
    assert!(message.contains("no state"), "{message}");
    let mut odd = state();
    odd.particles.memory.pop();
    assert!(matches!(odd.save(&path), Err(Error::Parameter(message)) if message.contains("4 memories")));
}

#[test]
fn format_names() {
    for format in Format::ALL {
        assert_eq!(format.extension().parse::<Format>().unwrap(), format);
    }
    let message = "usd".parse::<Format>().unwrap_err().to_string();
    assert!(message.contains("'usd'") && message.contains("npz, ply, bgeo, vtu, vtk"), "{message}");
    assert_eq!(Format::from_path(Path::new("a/b.BGEO")), Some(Format::Bgeo));
    assert_eq!(Format::from_path(Path::new("a/b.bhclassic")), Some(Format::Bgeo));
    assert_eq!(Format::from_path(Path::new("a/b.bgeo.gz")), None);
}

#[test]
fn empty_missing_and_unknown_files() {
    let folder = tempfile::tempdir().unwrap();
    for format in Format::ALL {
        rejected(format, b"", &["empty (0 bytes)"]);
        let missing = folder.path().join(format!("none.{format}"));
        let error = frames::read(&missing).unwrap_err();
        assert!(matches!(error, Error::Io { .. }));
        one_line(&error, &missing);
    }
    let text = folder.path().join("notes.txt");
    fs::write(&text, "hello").unwrap();
    let message = one_line(&frames::read(&text).unwrap_err(), &text);
    assert!(message.contains("npz, ply, bgeo, vtu, vtk"), "{message}");
    one_line(&frames::read(folder.path()).unwrap_err(), folder.path());
}

/// The folder of cases, if the reference is beside the repository or named by `FLUVIA_REFERENCE`.
fn cases() -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let reference =
        std::env::var_os("FLUVIA_REFERENCE").map_or(root.join("../shared/reference"), PathBuf::from);
    let cases = reference.join("cases");
    if !cases.is_dir() {
        println!("skipped: there is no {}", cases.display());
        return None;
    }
    Some(cases)
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[track_caller]
fn assert_near(found: &[[f32; 3]], expected: &serde_json::Value, tolerance: f64) {
    let expected: Vec<[f64; 3]> = serde_json::from_value(expected.clone()).unwrap();
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((f64::from(*found) - expected).abs() <= tolerance, "{found} is not {expected}");
    }
}

#[test]
fn cases_that_others_met() {
    const PARTICLE_FILES: [&str; 7] = ["a16", "a17", "a18", "a19", "a20", "a21", "a22"];
    let Some(cases) = cases() else { return };
    let table = json(&cases.join("expected.json"));
    let mut checked = 0;
    for case in table.as_array().unwrap() {
        if !PARTICLE_FILES.contains(&&case["case"].as_str().unwrap()[..3]) {
            continue;
        }
        for run in case["runs"].as_array().unwrap() {
            let scene = json(&cases.join(run["args"][1].as_str().unwrap()));
            let path = cases.join(scene["fluids"][0]["particles"].as_str().unwrap());
            let result = frames::read(&path);
            checked += 1;
            if run["exit"][0] == 1 {
                let message = one_line(&result.unwrap_err(), &path).to_lowercase();
                for texts in run["error_line_mentions"].as_array().unwrap() {
                    let texts: Vec<&str> =
                        texts.as_array().unwrap().iter().filter_map(|t| t.as_str()).collect();
                    let any = texts.iter().any(|text| message.contains(&text.to_lowercase()));
                    assert!(any, "none of {texts:?} in: {message}");
                }
                continue;
            }
            let data = result.unwrap();
            let frame = &run["frame0"];
            let tolerance = frame["tolerance"].as_f64().unwrap();
            assert_near(&data.position, &frame["pos"], tolerance);
            match frame.get("vel") {
                Some(velocity) => assert_near(data.velocity.as_ref().unwrap(), velocity, tolerance),
                None => assert_eq!(data.velocity, None),
            }
        }
    }
    assert_eq!(checked, 9, "the cases a16 to a22 have nine runs");
}

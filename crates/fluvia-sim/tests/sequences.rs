//! Sequences of data sets: what is written reads back and is the published form to the byte; older forms are read;
//! damaged files are one-line errors within bounded memory.

#![allow(clippy::unwrap_used, reason = "a test that fails says where")]

use std::fs;
use std::path::{Path, PathBuf};

use fluvia_sim::Error;
use fluvia_sim::frames::sequence::{
    self, FRAMES_PER_PART, Frame, Part, Sequence, parse_part, read_part, stored_mass, write_part,
};
use fluvia_sim::particles::Boundary;
use fluvia_sim::scene::Scene;
use proptest::prelude::*;

mod common;
#[path = "formats/memory.rs"]
mod memory;

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/sequences")
}

/// Values that a detour through text or another type would change.
fn numbers(count: usize, seed: usize) -> Vec<f32> {
    let special = [-0.0, f32::MIN_POSITIVE / 8.0, f32::MAX, f32::MIN, 0.1, 1.0 / 3.0, -1e-30];
    (0..count).map(|i| if i < 7 { special[(i + seed) % 7] } else { 0.37 * (i * seed % 101) as f32 }).collect()
}

fn vectors(count: usize, seed: usize) -> Vec<[f32; 3]> {
    numbers(3 * count, seed).as_chunks().0.to_vec()
}

fn walls(count: usize) -> Boundary {
    Boundary { position: vectors(count, 3), normal: vectors(count, 5) }
}

fn frame(number: u64, count: usize) -> Frame {
    let seed = number as usize + 1;
    Frame {
        number,
        position: vectors(count, seed),
        velocity: vectors(count, seed + 1),
        mass: numbers(count, seed + 2),
        viscosity: numbers(count, seed + 3),
    }
}

fn part(scene: &str, first: u64, frames: u64, count: usize) -> Part {
    let frames = (first..first + frames).map(|number| frame(number, count)).collect();
    Part { scene: scene.into(), walls: walls(4), frames }
}

/// A part as bits, so that -0 is not 0.
fn bits(part: &Part) -> Vec<Vec<u32>> {
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<u32>>();
    let mut all = vec![bits(part.walls.position.as_flattened()), bits(part.walls.normal.as_flattened())];
    for frame in &part.frames {
        let vectors = [frame.position.as_flattened(), frame.velocity.as_flattened()];
        all.extend(vectors.into_iter().chain([&frame.mass[..], &frame.viscosity[..]]).map(bits));
    }
    all
}

/// A part file as bytes.
fn packed(part: &Part) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a_00.msgpack.zst");
    write_part(&path, part).unwrap();
    fs::read(path).unwrap()
}

fn unpacked(bytes: &[u8]) -> Vec<u8> {
    zrip::decompress(bytes).unwrap()
}

/// Parses in bounded memory; an error must be one line that names the file.
fn parse(bytes: &[u8]) -> Result<Part, String> {
    /// The content as floats, twice while a vector grows, and the two windows of the unpacker: each at most what a
    /// file may unpack to.
    const COPIES: usize = 5;
    /// The tables of the unpacker.
    const READER_STATE: usize = 1 << 20;
    let path = Path::new("folder/sim_0001_00.msgpack.zst");
    let (result, peak) = memory::peak_of(|| parse_part(path, bytes));
    let content = zrip::decompress_with_limit(bytes, 64 << 20).map_or(64 << 20, |content| content.len());
    assert!(peak <= COPIES * content + READER_STATE, "{peak} bytes held for {content}");
    result.map_err(|error| one_line(&error, path))
}

#[track_caller]
fn one_line(error: &Error, path: &Path) -> String {
    let message = error.to_string();
    assert!(!message.contains('\n') && message.len() < 400, "no short line: {message}");
    assert!(message.starts_with(path.to_str().unwrap()), "does not name its file: {message}");
    message
}

#[track_caller]
fn rejected(bytes: &[u8], mentions: &[&str]) {
    let message = parse(bytes).expect_err("a damaged file was accepted");
    for mention in mentions {
        assert!(message.contains(mention), "'{mention}' is not in: {message}");
    }
}

#[test]
fn what_is_written_reads_back_to_the_same_bits() {
    for (frames, count) in [(1, 0), (1, 1), (3, 7), (15, 2), (16, 300), (2, 30_000)] {
        let written = part("sim_0001", 50, frames, count);
        let bytes = packed(&written);
        assert_eq!(bytes, packed(&written), "equal parts are equal bytes");
        let read = parse(&bytes).unwrap();
        assert_eq!(bits(&read), bits(&written), "{frames} frames of {count}");
        assert_eq!((&read.scene, read.frames[0].number), (&written.scene, 50));
    }
}

#[test]
fn any_numbers_read_back() {
    let float = any::<f32>().prop_filter("finite", |value| value.is_finite());
    let vectors = |count| prop::collection::vec([float.clone(), float.clone(), float.clone()], count);
    let numbers = |count| prop::collection::vec(float.clone(), count);
    let frame = |count| (vectors(count), vectors(count), numbers(count), numbers(count));
    let frames = (0..20usize).prop_flat_map(|count| prop::collection::vec(frame(count), 1..20));
    let walls = (0..9usize).prop_flat_map(|count| (vectors(count), vectors(count)));
    proptest!(ProptestConfig::with_cases(200), |(scene in "\\PC{1,20}", first in 0..1u64 << 40, frames in frames, walls in walls)| {
        let frames = frames.into_iter().zip(first..).map(|((position, velocity, mass, viscosity), number)| {
            Frame { number, position, velocity, mass, viscosity }
        });
        let written = Part { scene, walls: Boundary { position: walls.0, normal: walls.1 }, frames: frames.collect() };
        let read = parse(&packed(&written)).unwrap();
        prop_assert_eq!(bits(&read), bits(&written));
        prop_assert_eq!(read, written);
    });
}

#[test]
fn written_files_are_those_of_msgpack_numpy_to_the_byte() {
    for name in ["plain/fall_00", "plain/fall_01", "set/train/sim_0002_01"] {
        let path = fixtures().join(format!("{name}.msgpack.zst"));
        let published = unpacked(&fs::read(&path).unwrap());
        let part = read_part(&path).unwrap();
        assert_eq!(unpacked(&packed(&part)), published, "{name}");
    }
}

#[test]
fn the_older_form_holds_the_same_numbers() {
    for k in 0..2 {
        let read = |form| read_part(&fixtures().join(format!("{form}/fall_0{k}.msgpack.zst"))).unwrap();
        assert_eq!(read("old"), read("plain"));
    }
    let part = read_part(&fixtures().join("plain/fall_01.msgpack.zst")).unwrap();
    assert_eq!((part.scene.as_str(), part.frames.len(), part.walls.position.len()), ("fall", 3, 9));
    let frame = &part.frames[2];
    assert_eq!((frame.number, frame.position[0], frame.mass[7]), (5, [-0.175, 0.45095, 0.0], 0.125));
    assert_eq!((frame.velocity[3], frame.viscosity[0]), ([0.0, -0.981, 0.0], 0.01));
}

#[test]
fn the_stored_mass_is_that_of_the_published_files() {
    assert_eq!(stored_mass(1000.0, 0.025), 0.125);
}

#[test]
fn a_sequence_is_a_folder_a_part_or_a_prefix() {
    let plain = fixtures().join("plain");
    for (path, frames) in [
        (plain.clone(), 0..6),
        (plain.join("fall"), 0..6),
        (plain.join("fall_01.msgpack.zst"), 3..6),
        (plain.join("fall_00.msgpack.zst"), 0..3),
    ] {
        let mut sequence = Sequence::open(&path).unwrap();
        assert_eq!((sequence.frames(), sequence.particles(), sequence.name()), (frames.clone(), 8, "fall"));
        for number in frames.clone().rev().chain(frames) {
            let frame = sequence.frame(number).unwrap();
            assert_eq!((frame.number, frame.position.len()), (number, 8));
        }
        let message = sequence.frame(6).unwrap_err().to_string();
        assert!(
            message.contains("no frame 6") && message.contains("to 5")
                || path.ends_with("fall_00.msgpack.zst")
        );
    }
    let found = sequence::find(&fixtures().join("set/train")).unwrap();
    let names: Vec<&str> = found.iter().map(|files| files.name.as_str()).collect();
    assert_eq!(names, ["sim_0001", "sim_0002"]);
    assert_eq!(found[1].parts.len(), 2);

    for (path, mentions) in [
        (fixtures().join("set/train"), vec!["2 sequences", "sim_0001, sim_0002"]),
        (fixtures(), vec!["no sequence", "NAME_00.msgpack.zst"]),
        (plain.join("fal"), vec!["No such file"]),
        (plain.join("fall_02.msgpack.zst"), vec!["No such file"]),
        (plain.join("none/fall"), vec!["No such file"]),
        (fixtures().join("../README.md"), vec!["no sequence"]),
    ] {
        let message = one_line(&Sequence::open(&path).unwrap_err(), &path);
        assert!(mentions.iter().all(|mention| message.contains(mention)), "{message}");
    }
}

#[test]
fn a_scene_starts_where_a_part_does() {
    let path = fixtures().join("plain/fall_01.msgpack.zst");
    let text = r#"{
        "walls": [{ "particles": "fall_01.msgpack.zst" }],
        "fluids": [{ "particles": "fall_01.msgpack.zst", "translation": [1, 0, 0] }]
    }"#;
    let scene = Scene::parse(text.as_bytes(), fixtures().join("plain/scene.json")).unwrap();
    let setup = scene.sample(0).unwrap();
    let part = read_part(&path).unwrap();
    assert_eq!(setup.boundary, part.walls);
    let moved = part.frames[0].position.iter().map(|&[x, y, z]| [x + 1.0, y, z]).collect::<Vec<_>>();
    assert_eq!(setup.emitters[0].position, moved);
    assert_eq!(setup.emitters[0].velocity, part.frames[0].velocity);
}

#[test]
fn parts_that_do_not_belong_together() {
    let open = |name: &str, part: &str| {
        let message = Sequence::open(&fixtures().join(name)).unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
        message
    };
    assert!(open("mixed", "fall_01.msgpack.zst").contains("'other', expected 'fall'"));
    assert!(open("hole", "fall_02.msgpack.zst").contains("frame 6, expected 3"));

    let folder = tempfile::tempdir().unwrap();
    let path = |k: u64| folder.path().join(format!("a_{k:02}.msgpack.zst"));
    let second = |change: fn(&mut Part)| {
        write_part(&path(0), &part("a", 0, 2, 3)).unwrap();
        let mut second = part("a", 2, 2, 3);
        change(&mut second);
        write_part(&path(1), &second).unwrap();
        Sequence::open(folder.path()).map_err(|error| one_line(&error, &path(1)))
    };
    assert_eq!(second(|_| {}).unwrap().frames(), 0..4);
    assert!(second(|part| part.walls.normal[0] = [9.0; 3]).unwrap_err().contains("box_normals"));
    assert!(second(|part| *part = self::part("a", 2, 2, 4)).unwrap_err().contains("4 particles, expected 3"));
    let sequence = second(|_| {}).unwrap();
    write_part(&path(1), &part("a", 2, 1, 3)).unwrap();
    assert!(sequence.read_part(1).unwrap_err().to_string().contains("changed"));
    assert!(matches!(sequence.read_part(2), Err(Error::Parameter(_))));
}

#[test]
fn what_could_not_be_read_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a_00.msgpack.zst");
    let wrong: [fn(&mut Part); 8] = [
        |part| part.frames.clear(),
        |part| part.frames[1].number = 5,
        |part| part.frames[1].velocity.truncate(2),
        |part| part.frames[1].mass.truncate(2),
        |part| part.frames[1] = frame(1, 4),
        |part| part.frames[0].position[2][1] = f32::NAN,
        |part| part.walls.position[0][0] = f32::INFINITY,
        |part| part.walls.normal.truncate(1),
    ];
    for change in wrong {
        let mut part = part("a", 0, 2, 3);
        change(&mut part);
        let error = write_part(&path, &part).unwrap_err();
        assert!(matches!(error, Error::Parameter(_)), "{error}");
        one_line(&error, &path);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn faults_are_named() {
    for (name, mentions) in [
        ("cut", ["truncated", "frame"]),
        ("short", ["truncated", "frame"]),
        ("damaged", ["damaged", "zstd"]),
        ("fewer", ["frame 3", "7 particles, expected 8"]),
        ("not_finite", ["frame 2", "'vel': particle 5 is [0.0, NaN, 0.0]"]),
        ("other_type", ["frame 1", "'pos' has type '<f8', expected '<f4'"]),
        ("no_box", ["frame 0", "no 'box'"]),
        ("gap", ["frame 7", "follows frame 1"]),
    ] {
        let path = fixtures().join(format!("faults/{name}_00.msgpack.zst"));
        let message = one_line(&read_part(&path).unwrap_err(), &path);
        assert!(mentions.iter().all(|mention| message.contains(mention)), "{name}: {message}");
    }
    rejected(b"", &["empty (0 bytes)"]);
    rejected(b"{\"walls\": []}", &["no zstd stream"]);
    let pack = |bytes: &[u8]| zrip::compress(bytes, 1).unwrap();
    rejected(&pack(b""), &["truncated", "the list of frames"]);
    rejected(&pack(b"\x90"), &["no frames"]);
    rejected(&pack(b"\x80"), &["no msgpack list"]);
    rejected(&pack(b"\x91\xc0"), &["item 0 of 1", "no msgpack map"]);
    rejected(&pack(b"\x91\x80"), &["item 0 of 1", "no 'frame_id'"]);
    rejected(&pack(b"\x91\x81\xc1"), &["0xc1"]);
    rejected(&pack(b"\x91\x81\xa8frame_id\xff"), &["'frame_id' is -1"]);
    rejected(&pack(b"\x91\x81\xa8frame_id\xc0"), &["'frame_id' is nothing"]);
    rejected(&pack(b"\x91\x82\xa8frame_id\x05\xa8frame_id\x05"), &["frame 5", "'frame_id' is there twice"]);
    rejected(&pack(b"\x91\x81\xa3pos\x93\x01\x02\x03"), &["'pos' is a list of 3", "array of NumPy"]);
    rejected(&pack(b"\x91\x81\xa3pos\x81\xa4type\xa3<f4"), &["'pos' has no data"]);
    let whole = packed(&part("a", 0, 2, 3));
    let content = unpacked(&whole);
    rejected(&pack(&[&content[..], b"\xc0"].concat()), &["more bytes follow the list of 2 frames"]);
    // Claims cost nothing.
    rejected(&pack(b"\xdd\xff\xff\xff\xff"), &["list of 4294967295 frames"]);
    rejected(&pack(b"\x91\xdf\xff\xff\xff\xff"), &["truncated"]);
    rejected(&pack(b"\x91\x81\xa3pos\x81\xa4data\xc6\xff\xff\xff\xff"), &["truncated", "'pos'"]);
    rejected(&pack(b"\x91\x81\xa1x\xdd\xff\xff\xff\xff"), &["truncated", "'x'"]);
}

#[test]
fn keys_that_are_not_known_are_passed_over() {
    let content = unpacked(&packed(&part("a", 0, 1, 3)));
    // A map of a nested list, an extension, floats, nothing, a negative number and bytes.
    let others =
        b"\xa5other\x81\xa1x\x97\x92\x01\x91\xc0\xd5\x00ab\xca0000\xcb00000000\xc2\xd1\xff\x00\xc4\x02ab";
    assert_eq!(content[..2], [0x91, 0x88]);
    let with = [&[0x91, 0x89], &others[..], &content[2..]].concat();
    assert_eq!(parse(&zrip::compress(&with, 1).unwrap()).unwrap(), part("a", 0, 1, 3));
}

#[test]
fn every_truncation_is_an_error() {
    let whole = packed(&part("sim_0001", 0, 3, 5));
    for length in 0..whole.len() {
        rejected(&whole[..length], &[if length == 0 { "empty" } else { "truncated" }]);
    }
    let content = unpacked(&whole);
    for length in 0..content.len() {
        rejected(&zrip::compress(&content[..length], 1).unwrap(), &["truncated"]);
    }
}

#[test]
fn a_file_that_unpacks_to_too_much_is_refused() {
    // Blocks of one repeated byte: four bytes for each 128 KiB.
    let blocks: usize = 1 << 13;
    let mut bytes = b"\x28\xb5\x2f\xfd\x00\x58".to_vec();
    let content = b"\x91\x81\xa3pos\x81\xa4data\xc6\xff\xff\xff\xff";
    bytes.extend(&((content.len() as u32) << 3).to_le_bytes()[..3]);
    bytes.extend(content);
    for _ in 0..blocks {
        bytes.extend(&(((128u32 << 10) << 3) | 2).to_le_bytes()[..3]);
        bytes.push(0);
    }
    let path = Path::new("bomb_00.msgpack.zst");
    let (result, peak) = memory::peak_of(|| parse_part(path, &bytes));
    let message = one_line(&result.unwrap_err(), path);
    assert!(message.contains("unpacks to more than 67108864 bytes"), "{message}");
    assert!(peak < 4 * (64 << 20), "{peak}");
}

#[test]
fn damaged_files_neither_panic_nor_fill_memory() {
    let mut originals = vec![packed(&part("sim_0001", 7, 3, 5)), packed(&part("a", 0, 20, 70))];
    for name in ["plain/fall_00", "old/fall_00", "old/fall_01"] {
        originals.push(fs::read(fixtures().join(format!("{name}.msgpack.zst"))).unwrap());
    }
    let at = any::<prop::sample::Index>;
    let change = prop_oneof![
        (at(), any::<u8>()).prop_map(|(at, byte)| (at, Some(byte))),
        at().prop_map(|at| (at, None)),
    ];
    let changes = prop::collection::vec(change, 1..5);
    let config = ProptestConfig::with_cases(8000);
    proptest!(config, |(which in 0..originals.len(), inside in any::<bool>(), changes in changes)| {
        let mut bytes = originals[which].clone();
        if inside {
            bytes = unpacked(&bytes);
        }
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            match byte {
                Some(byte) => bytes[at] = byte,
                None => { bytes.remove(at); }
            }
        }
        if inside {
            bytes = zrip::compress(&bytes, 1).unwrap();
        }
        // Accepted or rejected: `parse` checks the memory and the message.
        let _ = parse(&bytes);
    });
}

#[test]
fn published_files_are_written_back_to_the_same_bytes() {
    let Some(reference) = common::reference() else { return };
    let mut checked = 0;
    for folder in ["valid", "viscosity"] {
        for files in sequence::find(&reference.join("splishsplash/dataset").join(folder)).unwrap() {
            let sequence = Sequence::of(files).unwrap();
            for (k, path) in sequence.parts().iter().enumerate() {
                let part = sequence.read_part(k).unwrap();
                assert_eq!((part.frames.len(), part.frames[0].mass[0]), (FRAMES_PER_PART, 0.125));
                let published = unpacked(&fs::read(path).unwrap());
                assert!(unpacked(&packed(&part)) == published, "{} differs", path.display());
                checked += 1;
            }
        }
    }
    assert_eq!(checked, 14);
}

#[test]
fn cases_that_others_met() {
    let Some(reference) = common::reference() else { return };
    let path = |case: &str| reference.join("cases").join(case).join("sim_9001_00.msgpack.zst");
    let plain = read_part(&path("data_plain")).unwrap();
    assert_eq!((plain.frames.len(), plain.frames[9].position.len()), (10, 64));
    assert_eq!(read_part(&path("a31_data_old_msgpack")).unwrap(), plain);
    for (case, mentions) in
        [("a29_data_cut", vec!["truncated"]), ("a30_data_count", vec!["frame 4", "63", "64"])]
    {
        let message = one_line(&read_part(&path(case)).unwrap_err(), &path(case));
        assert!(mentions.iter().all(|mention| message.contains(mention)), "{message}");
    }
}

//! `fluvia mesh`: surfaces of runs and sequences, what they are not made of, and what is left of an interrupted one.

use std::path::Path;

use fluvia_sim::frames;
use fluvia_sim::mesh::TriangleMesh;

use crate::common::{Folder, SCENE, block, cloud, sequence};

/// A folder with a short run in `run`.
fn with_run() -> Folder {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 6 --out run");
    folder
}

fn names(folder: &Folder, directory: &str) -> Vec<String> {
    folder.files(directory).into_keys().collect()
}

#[test]
fn every_frame_has_a_closed_surface_in_each_format() {
    let folder = with_run();
    folder.succeed("mesh run -o ply");
    folder.succeed("mesh run -o obj --format obj --frames 0..6 --every 3");
    let run = folder.succeed("mesh run -o vtk --format vtk --frames 4,1,3..4 --verbose");
    assert!(run.stderr.contains("3 surfaces"), "a frame twice is made once: {}", run.stderr);
    assert_eq!(names(&folder, "ply"), (0..7).map(|k| format!("surface_000{k}.ply")).collect::<Vec<_>>());
    assert_eq!(names(&folder, "obj"), ["surface_0000.obj", "surface_0003.obj", "surface_0006.obj"]);
    assert_eq!(names(&folder, "vtk"), ["surface_0001.vtk", "surface_0003.vtk", "surface_0004.vtk"]);

    let load = |name: &str| TriangleMesh::load(folder.path(name)).unwrap();
    let (first, third) = (load("ply/surface_0000.ply"), load("ply/surface_0003.ply"));
    assert_eq!((first.open_edges(), first.is_oriented()), (0, true));
    // 64 particles of 5 cm each; so small a block has round edges.
    let part = first.volume() / (64.0 * 0.05_f64.powi(3));
    assert!((0.75..1.0).contains(&part), "{part}");
    assert!(load("obj/surface_0003.obj") == third);
    let points = frames::read(&folder.path("vtk/surface_0003.vtk")).unwrap();
    assert!(points == frames::read(&folder.path("ply/surface_0003.ply")).unwrap());
    // The body starts with (0.5, 0, 0.2) m/s and falls.
    let velocity = points.velocity.unwrap();
    assert!(velocity.iter().all(|v| (v[0] - 0.5).abs() < 0.1 && v[1] < -0.1), "{:?}", velocity[0]);
    assert_eq!(points.normal.map(|normal| normal.len()), Some(velocity.len()));
}

#[test]
fn options_change_the_surface_and_threads_do_not() {
    let folder = with_run();
    folder.succeed("mesh run -o one --threads 1");
    folder.succeed("mesh run -o three --threads 3");
    assert!(folder.files("one") == folder.files("three"));
    let size = |options: &str| {
        folder.succeed(&format!("mesh run -o other --overwrite --frames 6 {options}"));
        TriangleMesh::load(folder.path("other/surface_0006.ply")).unwrap()
    };
    let usual = size("");
    assert!(size("--cube-size 1").triangles.len() < usual.triangles.len() / 2);
    assert!(size("--threshold 0.3").volume() > 1.05 * usual.volume());
    assert!(size("--smoothing-length 1.5").triangles != usual.triangles);
    let (rough, smooth) = (size("--smoothing 0"), size("--smoothing 50"));
    assert!(rough.area() > usual.area() && usual.area() > smooth.area());
    // The vertices stay, and their normals do not.
    let usual = frames::read(&folder.path("one/surface_0006.ply")).unwrap();
    size("--normal-smoothing 0");
    let rough = frames::read(&folder.path("other/surface_0006.ply")).unwrap();
    assert!(rough.position == usual.position && rough.normal != usual.normal);
}

/// A folder with frames that small liquids fill: a block of particles off the lattice, smaller in each.
fn with_clouds() -> Folder {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("run")).expect("a folder");
    for number in 0..5 {
        let at = |i: usize, step: f32| 0.4 * (step * i as f32).fract();
        let line = |i| format!("{} {} {}", at(i, 0.618_034), at(i, 0.754_877), at(i, 0.569_84));
        let lines: Vec<String> = (0..1500 - 200 * number).map(line).collect();
        folder.write(&format!("run/fluid_{number:04}.ply"), cloud(&lines));
    }
    folder
}

#[test]
fn a_small_liquid_has_one_surface_whatever_the_threads() {
    let folder = with_clouds();
    folder.succeed("mesh run -o one --frames 0 --threads 1");
    // One frame has all the threads.
    for threads in [2, 7, 2, 7] {
        folder.succeed(&format!("mesh run -o other --frames 0 --overwrite --threads {threads}"));
        assert!(folder.files("one") == folder.files("other"), "{threads} threads");
    }
}

#[test]
fn a_directory_with_surfaces_is_not_overwritten_by_chance() {
    let folder = with_run();
    folder.succeed("mesh run -o surfaces --frames 0..2");
    folder.write("surfaces/mine.ply", "mine");
    let run = folder.run("mesh run -o surfaces");
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("surface_0000.ply") && run.stderr.contains("--overwrite"), "{}", run.stderr);
    // One that fails before its first surface has removed nothing.
    folder.fail("mesh run -o surfaces --overwrite --frames 9", &["frame 9", "0 to 6"]);
    let before = folder.files("surfaces");
    assert_eq!(before.len(), 4);
    // Other frames and other formats are nobody's business.
    folder.succeed("mesh run -o surfaces --frames 5");
    folder.succeed("mesh run -o surfaces --format obj --frames 1");
    let run = folder.succeed("mesh run -o surfaces --overwrite --frames 1 --cube-size 1");
    assert!(run.stderr.contains("3 surfaces of other frames"), "{}", run.stderr);
    let after = folder.files("surfaces");
    let expected = ["mine", "surface_0000", "surface_0001", "surface_0001", "surface_0002", "surface_0005"];
    assert!(after.keys().map(|name| name.split('.').next().unwrap()).eq(expected), "{:?}", after.keys());
    for (name, bytes) in &before {
        assert_eq!(after[name] == *bytes, name != "surface_0001.ply", "{name}");
    }
    // A temporary file of a process that works on other frames stays, one of these frames was left by a killed one.
    folder.write("surfaces/.surface_0006.ply.123.tmp", "other");
    folder.write("surfaces/.surface_0003.ply.123.tmp", "killed");
    folder.succeed("mesh run -o surfaces --frames 3");
    assert!(folder.path("surfaces/.surface_0006.ply.123.tmp").exists());
    assert!(!folder.path("surfaces/.surface_0003.ply.123.tmp").exists());
}

#[test]
fn what_was_stopped_goes_on() {
    let folder = with_clouds();
    folder.succeed("mesh run -o whole");
    folder.succeed("mesh run -o part --frames 1,3");
    let modified = |name: &str| std::fs::metadata(folder.path(name)).unwrap().modified().unwrap();
    let before = modified("part/surface_0003.ply");
    folder.succeed("mesh run -o part --resume");
    assert_eq!(modified("part/surface_0003.ply"), before);
    let whole = folder.files("whole");
    assert!(folder.files("part") == whole);
    // Nothing is left to do.
    folder.succeed("mesh run -o whole --resume");
    assert!(folder.files("whole") == whole);
    // Surfaces that other options made, or that are of other frames or another's, are not mixed with these.
    std::fs::create_dir(folder.path("twin")).unwrap();
    for (name, bytes) in folder.files("run") {
        folder.write(&format!("twin/{name}"), bytes);
    }
    for (format, last) in [("ply", 4), ("obj", 2), ("vtk", 2)] {
        folder.succeed(&format!("mesh run -o {format} --format {format} --frames 1..2"));
        for other in ["run --smoothing 50", "run --particle-radius 0.02", "twin"] {
            let run = folder.run(&format!("mesh {other} -o {format} --format {format} --resume"));
            assert_eq!((run.code, run.stderr.lines().count()), (Some(1), 1), "{}", run.stderr);
            assert!(run.stderr.contains(&format!("{format}/surface_0001.{format}: ")), "{}", run.stderr);
            assert_eq!(folder.files(format).len(), 2);
        }
        folder.succeed(&format!("mesh run -o {format} --format {format} --frames 1..{last} --resume"));
    }
    folder.write("whole/surface_0003.ply", "mine");
    assert_eq!(folder.run("mesh run -o whole --resume").code, Some(1));
    assert_eq!(folder.files("whole")["surface_0003.ply"], b"mine");
    assert_eq!(folder.run("mesh run -o whole --resume --overwrite").code, Some(2));
}

#[test]
fn sequences_and_foreign_particles() {
    let folder = Folder::new();
    folder.succeed(&format!("mesh {} -o surfaces", sequence("plain")));
    assert_eq!(names(&folder, "surfaces").len(), 6);
    // Frames of another program: no record, no velocities, a radius that has to be said; and one without a particle.
    std::fs::create_dir(folder.path("foreign")).unwrap();
    folder.write("foreign/fluid_0000.ply", cloud(&["1 2 3"]));
    folder.write("foreign/fluid_0001.ply", cloud(&[""; 0]));
    folder.succeed("mesh foreign -o drops --particle-radius 0.5");
    let path = folder.path("drops/surface_0000.ply");
    let [low, high] = TriangleMesh::load(&path).unwrap().bounds().unwrap();
    assert!((0..3).all(|k| (0.8..1.5).contains(&(high[k] - low[k]))), "{low:?} {high:?}");
    assert_eq!(frames::read(&path).unwrap().velocity, None);
    assert!(frames::read(&folder.path("drops/surface_0001.ply")).unwrap().position.is_empty());
}

#[test]
fn what_has_no_surface() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("empty")).unwrap();
    std::fs::create_dir(folder.path("bad")).unwrap();
    folder.write("bad/fluid_0000.ply", cloud(&["0 0 0", "0 nan 0"]));
    std::fs::create_dir(folder.path("wide")).unwrap();
    folder.write("wide/fluid_0000.ply", cloud(&["0 0 0", "0 0 1e9"]));
    folder.write("file", "");
    for (arguments, words) in [
        ("mesh nothing -o out", ["nothing", "No such file"]),
        ("mesh empty -o out", ["empty", "no frames"]),
        ("mesh bad -o out", ["fluid_0000.ply: ", "particle 1"]),
        ("mesh wide -o out", ["wide: frame 0", "m apart"]),
        ("mesh wide -o out --frames 3", ["frame 3", "0 to 0"]),
        ("mesh wide -o out --frames 3..5", ["3 to 5", "0 to 0"]),
        ("mesh wide -o out --particle-radius 1e38", ["wide: frame 0", "particle radius of 1e38 m"]),
        ("mesh wide -o file", ["file", "directory"]),
    ] {
        folder.fail(arguments, &words);
    }
    for (arguments, word) in [
        ("mesh wide -o out --format stl", "ply, obj, vtk"),
        ("mesh wide -o out --cube-size 0.1", "0.2 to 10"),
        ("mesh wide -o out --smoothing-length 1", "1.5 to 3"),
        ("mesh wide -o out --smoothing-length 10", "1.5 to 3"),
        ("mesh wide -o out --threshold 1.5", "below 1"),
        ("mesh wide -o out --frames 5..3", "FIRST..LAST"),
        ("mesh wide -o out --every 0", "--every"),
    ] {
        let run = folder.run(arguments);
        assert_eq!(run.code, Some(2), "{arguments}");
        assert!(run.stderr.contains(word), "{arguments}: {}", run.stderr);
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_whole_surfaces() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("run")).unwrap();
    // Large enough to be stopped in.
    (0..60).for_each(|k| folder.write(&format!("run/fluid_{k:04}.ply"), block()));
    let run =
        folder.interrupt("mesh run -o surfaces --threads 2 --cube-size 0.2", "surfaces/surface_0001.ply");
    let left = names(&folder, "surfaces");
    assert!((1..60).contains(&left.len()), "{left:?}");
    assert!(run.stderr.contains(&format!("stopped after {} of 60", left.len())), "{}", run.stderr);
    assert!(run.stderr.contains("with --resume goes on"), "{}", run.stderr);
    for name in left {
        assert!(!name.starts_with('.'), "{name}");
        let mesh = TriangleMesh::load(folder.path("surfaces").join(Path::new(&name))).unwrap();
        assert_eq!(mesh.open_edges(), 0, "{name}");
    }
    // One that replaces others and is stopped leaves none of them that would be taken for its own.
    (0..60).for_each(|k| folder.write(&format!("surfaces/surface_{k:04}.ply"), "old"));
    let arguments = "mesh run -o surfaces --overwrite --threads 2 --cube-size 0.2";
    let run = folder.interrupt_when(arguments, |_| {
        std::fs::read(folder.path("surfaces/surface_0000.ply")).is_ok_and(|bytes| bytes != b"old")
    });
    assert!(run.stderr.contains("--resume in place of --overwrite"), "{}", run.stderr);
    let files = folder.files("surfaces");
    assert!(
        (1..60).contains(&files.len()) && files.values().all(|bytes| bytes != b"old"),
        "{:?}",
        files.keys()
    );
}

#[cfg(target_os = "linux")]
#[test]
fn who_asks_twice_does_not_wait() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("run")).unwrap();
    // It is read for ever: nobody writes into it.
    let fifo = folder.path("run/fluid_0000.ply");
    assert!(std::process::Command::new("mkfifo").arg(fifo).status().expect("mkfifo").success());
    folder.interrupt_until_it_ends("mesh run -o surfaces");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_whole_surfaces() {
    let folder = with_run();
    let Some(_disk) = crate::common::SmallDisk::mount(&folder.path("disk"), "300k") else { return };
    let run = folder.run("mesh run -o disk/surfaces");
    assert_eq!(run.code, Some(1));
    assert!(run.stderr.contains("No space left"), "{}", run.stderr);
    for name in names(&folder, "disk/surfaces") {
        assert_eq!(TriangleMesh::load(folder.path("disk/surfaces").join(name)).unwrap().open_edges(), 0);
    }
}

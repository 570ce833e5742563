//! `fluvia render`: pictures, sheets and films, of particles and of surfaces, and what they are not made of.

use crate::common::{Folder, SCENE, block, cloud};

/// A folder with a short run in `out`.
fn with_run() -> Folder {
    let folder = Folder::new();
    folder.write("scene.json", SCENE);
    folder.succeed("simulate scene.json --solver pbf --steps 6 --out out --format npz,vtu");
    folder
}

fn bytes(folder: &Folder, name: &str) -> Vec<u8> {
    std::fs::read(folder.path(name)).expect("a readable file")
}

/// The width and height of a PNG.
fn size(folder: &Folder, name: &str) -> (u32, u32) {
    let bytes = bytes(folder, name);
    assert_eq!(&bytes[1..4], b"PNG", "{name}");
    let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    (number(16), number(20))
}

/// The width and height of a GIF.
fn gif_size(folder: &Folder, name: &str) -> (u16, u16) {
    let bytes = bytes(folder, name);
    (u16::from_le_bytes([bytes[6], bytes[7]]), u16::from_le_bytes([bytes[8], bytes[9]]))
}

#[test]
fn pictures_sheets_and_films() {
    let folder = with_run();
    folder.succeed("render out -o last.png --size 200");
    folder.succeed("render out -o third.png --size 200 --frame 3 --color height");
    assert_eq!(size(&folder, "last.png").0, size(&folder, "third.png").0);
    assert!(bytes(&folder, "last.png") != bytes(&folder, "third.png"));
    folder.succeed("render out -o sheet.png --size 100 --sheet 3x2");
    folder.succeed("render A=out B=out -o two.png --size 100 --frames 0,3,6 --color body");
    assert!(size(&folder, "sheet.png").0 > 300 && size(&folder, "two.png").0 > 300);
    folder.succeed("render out -o film.gif --size 120 --every 2 --top -0.1");
    // 2 hundredths of a second from frame to frame.
    assert_eq!(delays(&folder, "film.gif"), [4, 4, 4, 4]);
    folder.succeed("render out -o gaps.gif --size 120 --frames 0,1,6");
    assert_eq!(delays(&folder, "gaps.gif"), [2, 10, 10]);
    // The same frames give the same picture.
    folder.succeed("render out -o again.png --size 200");
    assert!(bytes(&folder, "last.png") == bytes(&folder, "again.png"));
}

/// The delays of a GIF's images, hundredths of a second: in the graphic control extensions.
fn delays(folder: &Folder, name: &str) -> Vec<u16> {
    let bytes = bytes(folder, name);
    assert_eq!(&bytes[..6], b"GIF89a");
    let blocks = bytes.windows(8).filter(|block| block[..3] == [0x21, 0xf9, 4] && block[7] == 0);
    blocks.map(|block| u16::from_le_bytes([block[4], block[5]])).collect()
}

#[test]
fn what_cannot_be_drawn() {
    let folder = with_run();
    std::fs::create_dir(folder.path("folder.png")).unwrap();
    std::fs::create_dir(folder.path("foreign")).unwrap();
    folder.write("foreign/fluid_0000.ply", cloud(&["0 0 0", "0.1 0 0"]));
    for (arguments, words) in [
        ("render out -o a.jpg", ["a.jpg", ".png"]),
        ("render out -o a.png --frame 7", ["frame 7", "0 to 6"]),
        ("render nothing -o a.png", ["nothing", "No such file"]),
        ("render . -o a.png", [".", "no frames"]),
        // Before anything is read.
        ("render nothing -o none/a.png", ["none/a.png", "No such file"]),
        ("render nothing -o none/a.gif", ["none/a.gif", "No such file"]),
        ("render nothing -o folder.png", ["folder.png", "directory"]),
        ("render out -o a.gif --frame 3", ["a.gif", "--frame"]),
        ("render out -o a.mp4 --sheet 2x1", ["a.mp4", "--sheet"]),
        ("render out -o a", ["a: ", ".mp4"]),
        ("render out -o a.png --orbit 20", ["--orbit", ".mp4"]),
        ("render out out -o a.png --plain", ["a.png", "--plain"]),
        ("render out -o a.png --plain --frames 0..3", ["a.png", "--plain"]),
        ("render out -o a.png --plain --frames 0,3", ["a.png", "--plain"]),
        ("render out -o a.png --frames 8..9", ["8 to 9", "0 to 6"]),
        ("render out -o a.png --eye 0,9,0 --look-at 0,0,0", ["place of the camera", "beside"]),
        ("render out -o a.png --field-of-view 170", ["angle of view", "170"]),
        ("render out -o a.png --eye 0,1,5 --look-at 0,1,10", ["--eye and --look-at", "in view"]),
        (
            "render out -o a.gif --eye 0,1,5 --look-at 9,1,4 --field-of-view 20",
            ["--eye and --look-at", "in view"],
        ),
        ("render out -o a.png --look-at -40,0,-90", ["--look-at", "in view"]),
        ("render out -o a.png --size 9000x9000", ["9000 x 9000", "a smaller picture"]),
        // What the colours are to show has to be there.
        ("render foreign -o a.png --color speed", ["foreign: ", "no velocities"]),
        ("render foreign -o a.gif --max-speed 3", ["foreign: ", "no velocities"]),
        ("render foreign -o a.png --surface --color body", ["foreign: ", "no bodies"]),
        ("render foreign -o a.png --surface --particle-radius 1e38", ["foreign: frame 0", "1e38"]),
        ("render out -o a.png --body-names a,b", ["--body-names", "--color body"]),
        ("render out -o a.png --size 20x99999", ["height", "16384"]),
        ("render out -o a.png --surface --max-speed 3", ["--max-speed", "--color speed"]),
        ("render out -o a.png --every 2", ["--every", ".gif"]),
        ("render out -o a.png --color body --max-speed 3", ["--max-speed", "--color speed"]),
        ("render out -o a.png --frames 0 --sheet 3x3", ["1 frames", "9 places"]),
        ("render out out -o a.png --sheet 3x3", ["3 rows", "2 directories"]),
    ] {
        let run = folder.run(arguments);
        assert_eq!(run.code, Some(1), "{arguments}: {}", run.stderr);
        assert_eq!(run.stderr.lines().count(), 1, "{}", run.stderr);
        for word in words {
            assert!(run.stderr.contains(word), "{arguments}: {}", run.stderr);
        }
        assert!(["a.png", "a.gif", "a.mp4"].iter().all(|name| !folder.path(name).exists()));
    }
    for arguments in [
        "render out -o a.png --size 12x",
        "render out -o a.png --look-at 1,2",
        "render out -o a.png --eye 1,2,3 --yaw 10",
        "render out -o a.png --cube-size 0.5",
        "render out -o a.png --frames 3..1",
        "render out -o a.gif --orbit inf",
        "render out -o a.gif --orbit nan",
        "render out -o a.png --particle-radius 0",
        "render out -o a.png --plain --color body --body-names water",
    ] {
        assert_eq!(folder.run(arguments).code, Some(2), "{arguments}");
    }
}

#[test]
fn surfaces_are_drawn_in_every_colour_and_are_the_same_at_any_number_of_threads() {
    let folder = with_run();
    folder.succeed("render out -o spheres.png --size 200x120 --plain");
    let mut seen = vec![bytes(&folder, "spheres.png")];
    for options in ["", "--color speed", "--color height", "--color body", "--cube-size 1", "--frame 2"] {
        folder
            .succeed(&format!("render out -o a.png --size 200x120 --plain --surface --threads 1 {options}"));
        assert_eq!(size(&folder, "a.png"), (200, 120), "{options}");
        folder
            .succeed(&format!("render out -o b.png --size 200x120 --plain --surface --threads 3 {options}"));
        assert!(bytes(&folder, "a.png") == bytes(&folder, "b.png"), "{options}");
        seen.push(bytes(&folder, "a.png"));
    }
    for (k, one) in seen.iter().enumerate() {
        assert!(seen[..k].iter().all(|other| other != one), "picture {k} is another's");
    }
    // Legends: of speeds a scale, of bodies their names; of water none.
    let height = |options: &str| {
        folder.succeed(&format!("render out -o legend.png --size 200x120 --surface {options}"));
        size(&folder, "legend.png").1
    };
    assert!(height("") < height("--color body") && height("--color body") < height("--color speed"));
}

#[test]
fn films_show_ranges_of_frames_and_runs_side_by_side() {
    let folder = with_run();
    folder.succeed("render out -o part.gif --size 100 --frames 1..3,6");
    assert_eq!(delays(&folder, "part.gif"), [2, 2, 6, 6]);
    folder.succeed("render A=out -o one.gif --size 100 --frames 0..2");
    folder.succeed("render A=out B=out -o two.gif --size 100 --frames 0..2");
    assert_eq!(gif_size(&folder, "one.gif").0, 112);
    // Framed as alone: walls of a second run are not taken for particles.
    assert_eq!(gif_size(&folder, "two.gif"), (218, gif_size(&folder, "one.gif").1));
    folder.succeed("render out -o plain.gif --size 100x60 --plain --frames 0..2");
    assert_eq!(gif_size(&folder, "plain.gif"), (100, 60));
    folder.succeed("render A=out B=out -o both.gif --size 100x60 --plain --frames 0..2 --color height");
    assert_eq!(gif_size(&folder, "both.gif"), (200, 60));
    // A camera that moves shows something else.
    folder.succeed("render out -o turned.gif --size 100x60 --plain --frames 0..2 --orbit 90");
    assert!(bytes(&folder, "plain.gif") != bytes(&folder, "turned.gif"));
    folder.succeed("render out -o water.gif --size 100x60 --plain --frames 0..2 --surface --threads 1");
    folder.succeed("render out -o again.gif --size 100x60 --plain --frames 0..2 --surface --threads 3");
    assert!(bytes(&folder, "water.gif") == bytes(&folder, "again.gif"));
    // Frames that a run lacks are left out, if they are not asked for.
    std::fs::create_dir(folder.path("few")).unwrap();
    for name in ["run.json", "box.npz", "fluid_0001.npz", "fluid_0004.npz"] {
        std::fs::copy(folder.path("out").join(name), folder.path("few").join(name)).unwrap();
    }
    folder.succeed("render out few -o few.gif --size 100");
    assert_eq!(delays(&folder, "few.gif"), [6, 6]);
    let run = folder.run("render out few -o none.gif --size 100 --frames 0..2");
    assert!(run.code == Some(1) && run.stderr.contains("few: no frame 0"), "{}", run.stderr);
}

#[test]
fn runs_that_do_not_go_together() {
    let folder = with_run();
    folder.succeed("simulate scene.json --solver pbf --steps 2 --out other");
    let record = std::fs::read_to_string(folder.path("other/run.json")).unwrap();
    for (key, value, output, word) in [
        ("\"particle_radius\": 0.025", "\"particle_radius\": 0.05", "a.png", "particle radius"),
        ("\"dt\": 0.02", "\"dt\": 0.01", "a.gif", "between frames"),
    ] {
        assert!(record.contains(key), "{record}");
        folder.write("other/run.json", record.replace(key, value));
        let run = folder.run(&format!("render out other -o {output} --frames 0..1 --size 60"));
        assert_eq!(run.code, Some(1));
        assert!(run.stderr.contains("other: ") && run.stderr.contains(word), "{}", run.stderr);
        assert!(!folder.path(output).exists());
    }
}

#[test]
fn frames_without_a_record_have_the_radius_that_is_given() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("foreign")).unwrap();
    folder.write("foreign/fluid_0000.ply", cloud(&["0 0 0", "2 0 0"]));
    // Which part of the picture is drawn grows with the radius, for spheres and surfaces.
    for surface in ["", "--surface"] {
        let drawn = |radius: &str| {
            let options = "--size 200x100 --plain --yaw 0 --pitch 0";
            folder
                .succeed(&format!("render foreign -o a.png {options} {surface} --particle-radius {radius}"));
            let file = std::io::BufReader::new(std::fs::File::open(folder.path("a.png")).unwrap());
            let mut reader = png::Decoder::new(file).read_info().unwrap();
            let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            let ground = pixels[..3].to_vec();
            pixels.chunks_exact(3).filter(|pixel| **pixel != ground[..]).count()
        };
        let (small, large) = (drawn("0.1"), drawn("0.5"));
        assert!(small > 10 && large > 5 * small, "{small} and {large} {surface}");
    }
    // Where it is recorded that counts.
    let folder = with_run();
    folder.succeed("render out -o one.png --size 100");
    folder.succeed("render out -o other.png --size 100 --particle-radius 0.5");
    assert!(bytes(&folder, "one.png") == bytes(&folder, "other.png"));
}

#[test]
fn bodies_have_the_names_that_are_given() {
    let folder = with_run();
    for surface in ["", "--surface"] {
        folder.succeed(&format!("render out -o usual.png --size 200 --color body {surface}"));
        folder
            .succeed(&format!("render out -o other.png --size 200 --color body {surface} --body-names oil"));
        assert_eq!(size(&folder, "usual.png"), size(&folder, "other.png"));
        assert!(bytes(&folder, "usual.png") != bytes(&folder, "other.png"));
    }
    let run = folder.succeed("render out -o other.png --size 200 --color body --body-names oil,water");
    assert!(run.stderr.contains("2 names, expected at most 1"), "{}", run.stderr);
    // Bodies of a foreign file may have any numbers.
    std::fs::create_dir(folder.path("foreign")).unwrap();
    for number in [u32::MAX - 1, u32::MAX] {
        let head = "ply\nformat ascii 1.0\nelement vertex 1\n";
        let columns = "property float x\nproperty float y\nproperty float z\nproperty uint body\n";
        folder.write("foreign/fluid_0000.ply", format!("{head}{columns}end_header\n0 0 0 {number}\n"));
        folder.succeed("render foreign -o many.png --size 200 --color body");
    }
}

#[test]
fn nothing_one_particle_and_numbers_that_are_none() {
    let folder = Folder::new();
    for (name, points) in [("empty", vec![]), ("one", vec!["1 2 3"]), ("bad", vec!["0 0 0", "inf 0 0"])] {
        std::fs::create_dir(folder.path(name)).unwrap();
        folder.write(&format!("{name}/fluid_0000.ply"), cloud(&points));
    }
    for options in ["", "--color height", "--surface", "--surface --color height"] {
        folder.succeed(&format!("render empty -o empty.png --size 80 {options}"));
        folder.succeed(&format!("render one -o one.png --size 80 {options}"));
        let run = folder.run(&format!("render bad -o bad.png --size 80 {options}"));
        assert!(run.code == Some(1) && run.stderr.contains("bad/fluid_0000.ply: "), "{}", run.stderr);
        assert!(!folder.path("bad.png").exists());
    }
    folder.succeed("render one -o one.gif --size 80 --surface");
    assert_eq!(delays(&folder, "one.gif"), [2]);
    // No picture is too small.
    folder.succeed("render one -o one.png --size 10 --color height");
}

/// A folder with frames of another program in `mixed`, the first of which has no velocities.
fn with_mixed_frames() -> Folder {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("mixed")).expect("a folder");
    folder.write("mixed/fluid_0000.ply", cloud(&["0 0 0", "0.4 0.1 0"]));
    let columns: String =
        ["x", "y", "z", "vx", "vy", "vz"].map(|name| format!("property float {name}\n")).concat();
    for number in 1..3 {
        let head = "ply\nformat ascii 1.0\nelement vertex 2\n";
        let rows = "0 0 0 1 0 0\n0.4 0.1 0 0 2 0\n";
        folder.write(&format!("mixed/fluid_000{number}.ply"), format!("{head}{columns}end_header\n{rows}"));
    }
    folder
}

#[test]
fn all_pictures_of_a_film_have_one_size() {
    let folder = with_mixed_frames();
    folder.succeed("render mixed -o film.gif --size 100");
    folder.succeed("render mixed -o last.gif --size 100 --frames 1..2");
    assert_eq!(delays(&folder, "film.gif"), [2, 2, 2]);
    assert_eq!(gif_size(&folder, "film.gif"), gif_size(&folder, "last.gif"));
    if has_ffmpeg() {
        folder.succeed("render mixed -o film.mp4 --size 100");
        let (width, height) = gif_size(&folder, "film.gif");
        let expected = format!("h264,{},{},yuv420p,50/1,3", width + width % 2, height + height % 2);
        assert_eq!(probe(&folder, "film.mp4"), expected);
    }
}

/// Whether ffmpeg and ffprobe are installed; says so where they are not. In continuous integration they must be.
fn has_ffmpeg() -> bool {
    let there = |program: &str| std::process::Command::new(program).arg("-version").output().is_ok();
    let found = there("ffmpeg") && there("ffprobe");
    assert!(found || std::env::var_os("CI").is_none(), "no ffmpeg and ffprobe, which CI needs");
    if !found {
        eprintln!("skipped: ffmpeg and ffprobe are not installed");
    }
    found
}

/// What ffprobe says of a film: codec, width, height, format of pixels, frames a second, frames.
fn probe(folder: &Folder, name: &str) -> String {
    let mut command = std::process::Command::new("ffprobe");
    command.args([
        "-v",
        "error",
        "-count_frames",
        "-select_streams",
        "v:0",
        "-of",
        "csv=p=0",
        "-show_entries",
    ]);
    command.arg("stream=codec_name,width,height,pix_fmt,r_frame_rate,nb_read_frames").arg(folder.path(name));
    let output = command.output().expect("ffprobe");
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    String::from_utf8(output.stdout).expect("UTF-8").trim().to_owned()
}

#[test]
fn mp4_plays_at_the_speed_of_the_simulation() {
    if !has_ffmpeg() {
        return;
    }
    let folder = with_run();
    folder.succeed("render out -o plain.mp4 --size 160x90 --plain");
    assert_eq!(probe(&folder, "plain.mp4"), "h264,160,90,yuv420p,50/1,7");
    // Odd sides become even.
    folder.succeed("render out -o odd.mp4 --size 161x91 --plain --surface --frames 0..3");
    assert_eq!(probe(&folder, "odd.mp4"), "h264,162,92,yuv420p,50/1,4");
    // Frames that are 2 and 4 apart are shown for 2 and 4.
    folder.succeed("render out -o gaps.mp4 --size 160x90 --plain --frames 0,2,6");
    assert_eq!(probe(&folder, "gaps.mp4"), "h264,160,90,yuv420p,25/1,5");
    folder.succeed("render out B=out -o both.mp4 --size 160 --every 2 --title Twice");
    assert!(probe(&folder, "both.mp4").ends_with("25/1,4"));
    // Nothing but the films is left.
    let names = std::fs::read_dir(folder.path("")).unwrap();
    let names: Vec<String> = names.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    assert!(names.iter().all(|name| !name.starts_with('.')), "{names:?}");
}

/// A folder with a run and a program `bin/ffmpeg` that does this when it is to make a film.
#[cfg(unix)]
fn with_ffmpeg(script: &str) -> Folder {
    use std::os::unix::fs::PermissionsExt;
    let folder = with_run();
    std::fs::create_dir(folder.path("bin")).expect("a folder");
    let path = "PATH=/usr/bin:/bin";
    folder.write("bin/ffmpeg", format!("#!/bin/sh\n{path}\n[ \"$1\" = -version ] && exit 0\n{script}\n"));
    std::fs::set_permissions(folder.path("bin/ffmpeg"), std::fs::Permissions::from_mode(0o755))
        .expect("permissions");
    folder
}

/// Names in a folder that begin with a film's, temporary ones too.
#[cfg(unix)]
fn films(folder: &Folder) -> Vec<String> {
    let names = std::fs::read_dir(folder.path("")).expect("a folder");
    let names = names.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned());
    names.filter(|name| name.contains("film")).collect()
}

#[cfg(unix)]
#[test]
fn films_without_ffmpeg_or_with_one_that_fails() {
    let folder = with_run();
    std::fs::create_dir(folder.path("nothing")).unwrap();
    let run = folder.run_with_path("render out -o film.mp4", Some("nothing"));
    assert_eq!((run.code, run.stderr.lines().count()), (Some(1), 1), "{}", run.stderr);
    assert!(
        run.stderr.contains("film.mp4: ") && run.stderr.contains("ffmpeg") && run.stderr.contains(".gif")
    );
    assert_eq!(folder.run_with_path("render out -o film.gif --size 60", Some("nothing")).code, Some(0));

    // One that fails in the middle, that is killed, and that fails at the end; what was there before stays.
    for (script, word) in [
        ("head -c 1000 > /dev/null; echo 'first' >&2; echo 'Unknown encoder' >&2; exit 1", "Unknown encoder"),
        ("head -c 1000 > /dev/null; kill -9 $$", "signal"),
        ("cat > /dev/null; echo 'No space left on device' >&2; exit 228", "No space left"),
    ] {
        let folder = with_ffmpeg(script);
        folder.write("film.mp4", "old");
        let run = folder.run_with_path("render out -o film.mp4 --size 200", Some("bin"));
        assert_eq!((run.code, run.stderr.lines().count()), (Some(1), 1), "{}", run.stderr);
        assert!(run.stderr.contains("film.mp4: ") && run.stderr.contains(word), "{}", run.stderr);
        assert_eq!(films(&folder), ["film.mp4"]);
        assert_eq!(bytes(&folder, "film.mp4"), b"old");
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_no_half_film() {
    let folder = with_ffmpeg("touch started; sleep 0.2; cat > /dev/null; exec sleep 3600");
    let arguments = "render out -o film.mp4 --size 100";
    let mut command = folder.command(arguments);
    command.env("PATH", folder.path("bin"));
    // Pictures that fill the pipe, so that it is stopped while it writes.
    std::fs::remove_dir_all(folder.path("out")).unwrap();
    std::fs::create_dir(folder.path("out")).unwrap();
    (0..2000).for_each(|k| folder.write(&format!("out/fluid_{k:04}.ply"), cloud(&["0 0 0", "1 1 1"])));
    let run = folder.interrupt_command(command, arguments, |_| folder.path("started").exists());
    assert!(run.stderr.contains("stopped"), "{}", run.stderr);
    assert!(films(&folder).is_empty(), "{:?}", films(&folder));
}

#[cfg(unix)]
#[test]
fn ctrl_c_does_not_wait_for_the_end_of_a_film() {
    // It has all pictures and does not end.
    let folder = with_ffmpeg("cat > /dev/null; touch ending; exec sleep 3600");
    let arguments = "render out -o film.mp4 --size 100";
    let mut command = folder.command(arguments);
    command.env("PATH", folder.path("bin"));
    let run = folder.interrupt_command(command, arguments, |_| folder.path("ending").exists());
    assert!(run.stderr.contains("film.mp4: stopped"), "{}", run.stderr);
    assert!(films(&folder).is_empty(), "{:?}", films(&folder));
}

#[cfg(target_os = "linux")]
#[test]
fn ctrl_c_ends_a_sheet() {
    let folder = Folder::new();
    std::fs::create_dir(folder.path("run")).unwrap();
    // It would take minutes.
    (0..100).for_each(|k| folder.write(&format!("run/fluid_{k:04}.ply"), block()));
    folder.write("sheet.png", "old");
    let arguments = "render run -o sheet.png --sheet 10x10 --surface --cube-size 0.2 --threads 1";
    let run = folder.interrupt_when(arguments, crate::common::catches_ctrl_c);
    assert!(run.stderr.contains("sheet.png: stopped, no picture"), "{}", run.stderr);
    assert_eq!(bytes(&folder, "sheet.png"), b"old");
    let names = std::fs::read_dir(folder.path("")).unwrap().map(|entry| entry.unwrap().file_name());
    assert_eq!(names.count(), 2, "the run and the old picture");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_no_half_film() {
    if !has_ffmpeg() {
        return;
    }
    let folder = with_run();
    let Some(_disk) = crate::common::SmallDisk::mount(&folder.path("disk"), "4k") else { return };
    for name in ["film.mp4", "film.gif"] {
        let run = folder.run(&format!("render out -o disk/{name} --size 400"));
        assert_eq!((run.code, run.stderr.lines().count()), (Some(1), 1), "{}", run.stderr);
        assert!(run.stderr.contains(name), "{}", run.stderr);
        assert_eq!(std::fs::read_dir(folder.path("disk")).unwrap().count(), 0);
    }
}

//! The house: which crate may know which, who may touch files, how long a file may be. Each rule is a function over
//! text, checked on text that breaks it as well.

use std::path::{Path, PathBuf};

/// What each crate may depend on, of this repository.
const ARROWS: [(&str, &[&str]); 7] = [
    ("fluvia-neighbors", &[]),
    ("cconv", &["fluvia-neighbors"]),
    ("fluvia-sim", &["fluvia-neighbors"]),
    ("fluvia-net", &["fluvia-neighbors", "cconv", "fluvia-sim"]),
    ("fluvia-render", &[]),
    ("fluvia-view", &[]),
    ("fluvia", &["fluvia-neighbors", "cconv", "fluvia-sim", "fluvia-net", "fluvia-render", "fluvia-view"]),
];

/// Where files may be touched outside the binary.
const TOUCHES_FILES: [&str; 9] = [
    "fluvia-sim/src/scene.rs",
    "fluvia-sim/src/scene/",
    "fluvia-sim/src/mesh.rs",
    "fluvia-sim/src/mesh/",
    "fluvia-sim/src/frames.rs",
    "fluvia-sim/src/frames/",
    "fluvia-net/src/weights.rs",
    "fluvia-net/src/checkpoint.rs",
    "fluvia-net/src/weights/",
];

/// Input and output, flags and the environment.
const FILES: [&str; 4] = ["fs::", "fs}", "File::", "OpenOptions"];
const PRINTS: [&str; 6] = ["println!", "print!(", "stdout()", "stderr()", "env::", "process::exit"];

/// Crates without input, output and globals.
const PURE: [&str; 3] = ["fluvia-neighbors/", "cconv/", "fluvia-render/"];

/// What outlives a call.
const GLOBALS: [&str; 3] = ["\nstatic ", " static ", "thread_local!"];

/// Tensor frameworks; one adapter file may name one, and the manifest of its crate.
const FRAMEWORKS: [&str; 4] = ["burn::", "use tch", "candle_core", "tract_"];
const FRAMEWORK_CRATES: [&str; 5] = ["burn", "tch", "candle-core", "tract-core", "ort"];

const LONGEST_FILE: usize = 420;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The crates that a manifest names as any kind of dependency, under their own names where it renames them.
fn dependencies(manifest: &str) -> Vec<&str> {
    let mut in_dependencies = false;
    let mut found = Vec::new();
    for line in manifest.lines().map(str::trim) {
        if let Some(header) = line.strip_prefix('[') {
            // [dependencies], [target.'cfg(unix)'.dev-dependencies], [dependencies.name]
            let rest = header.split_once("dependencies").map(|(_, rest)| rest);
            in_dependencies = rest.is_some();
            found.extend(
                rest.and_then(|rest| rest.strip_prefix('.')).map(|name| name.trim_matches([']', '"'])),
            );
        } else if in_dependencies && !line.starts_with('#') {
            found.extend(line.split(['.', ' ', '=']).next().map(|name| name.trim_matches('"')));
            let package = line.split_once("package").and_then(|(_, rest)| rest.split('"').nth(1));
            found.extend(package);
        }
    }
    found
}

/// What a manifest depends on and may not: crates of this repository against the arrows, tensor frameworks.
fn wrong_arrows<'a>(name: &str, manifest: &'a str) -> Vec<&'a str> {
    let allowed = ARROWS.iter().find(|(known, _)| *known == name).map_or(&[][..], |(_, to)| *to);
    let is_wrong = |to: &&str| {
        let is_ours = ARROWS.iter().any(|(known, _)| known == to);
        is_ours && !allowed.contains(to) || name != "cconv" && FRAMEWORK_CRATES.contains(to)
    };
    dependencies(manifest).into_iter().filter(is_wrong).collect()
}

/// The code of a file, without its unit tests and comments.
fn code(text: &str) -> String {
    let before_tests = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let is_code = |line: &&str| !line.trim_start().starts_with("//");
    before_tests.lines().filter(is_code).collect::<Vec<_>>().join("\n")
}

/// What a file below `crates/` does that it may not.
fn trespasses(path: &str, text: &str) -> Vec<&'static str> {
    let code = code(text);
    let mut found: Vec<&'static str> = Vec::new();
    if !path.starts_with("fluvia/") {
        found.extend(PRINTS.iter().filter(|word| code.contains(**word)));
        if !TOUCHES_FILES.iter().any(|allowed| path.starts_with(allowed)) {
            found.extend(FILES.iter().filter(|word| code.contains(**word)));
        }
    }
    if PURE.iter().any(|pure| path.starts_with(pure)) {
        found.extend(GLOBALS.iter().filter(|word| code.contains(**word)));
    }
    if path != "cconv/src/burn.rs" {
        found.extend(FRAMEWORKS.iter().filter(|word| code.contains(**word)));
    }
    found
}

/// All Rust files in a folder and below it.
fn rust_files(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a readable folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            rust_files(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

#[test]
fn arrows_point_one_way() {
    for (name, _) in ARROWS {
        let path = root().join(name).join("Cargo.toml");
        let manifest = std::fs::read_to_string(&path).expect("a manifest");
        assert_eq!(wrong_arrows(name, &manifest), [""; 0], "{name} may not depend on these");
    }
    let crates = std::fs::read_dir(root()).expect("the crates").count();
    assert_eq!(crates, ARROWS.len(), "every crate is in the picture");
}

#[test]
fn files_are_touched_where_they_may_be() {
    for (name, _) in ARROWS {
        let mut files = Vec::new();
        rust_files(&root().join(name).join("src"), &mut files);
        assert!(!files.is_empty());
        for path in files {
            let text = std::fs::read_to_string(&path).expect("a readable file");
            let relative =
                path.strip_prefix(root()).expect("below the crates").to_string_lossy().into_owned();
            assert_eq!(trespasses(&relative, &text), [""; 0], "{relative}");
            let lines = text.split("#[cfg(test)]\nmod tests {").next().map_or(0, |code| code.lines().count());
            assert!(lines <= LONGEST_FILE, "{relative} has {lines} lines beside its tests");
            assert!(text.starts_with("//!") || relative.ends_with("error.rs"), "{relative} opens with //!");
        }
    }
}

#[test]
fn the_rules_can_be_broken() {
    assert_eq!(
        wrong_arrows("cconv", "[dependencies]\nrayon = \"1\"\nfluvia-sim.workspace = true"),
        ["fluvia-sim"]
    );
    let manifest = "[dev-dependencies]\nfluvia-net = { path = \"..\" }";
    assert_eq!(wrong_arrows("fluvia-render", manifest), ["fluvia-net"]);
    assert_eq!(wrong_arrows("fluvia-net", "[dependencies]\ncconv.workspace = true"), [""; 0]);
    let table = "[build-dependencies.fluvia-sim]\npath = \"..\"";
    assert_eq!(wrong_arrows("cconv", table), ["fluvia-sim"]);
    let renamed = "[target.'cfg(unix)'.dependencies]\nsim = { package = \"fluvia-sim\", path = \"..\" }";
    assert_eq!(wrong_arrows("cconv", renamed), ["fluvia-sim"]);
    assert_eq!(wrong_arrows("fluvia-net", "[dependencies]\nburn = \"0.22\""), ["burn"]);
    assert_eq!(
        wrong_arrows("cconv", "[dependencies]\nburn = { version = \"0.22\", optional = true }"),
        [""; 0]
    );
    assert_eq!(wrong_arrows("cconv", "[package]\nname = \"fluvia-sim\""), [""; 0]);
    assert_eq!(trespasses("cconv/src/cpu.rs", "fn f() { std::fs::read(\"a\"); }"), ["fs::"]);
    assert_eq!(
        trespasses("cconv/src/cpu.rs", "use std::{io, fs};\nfn f() { fs::write(a, b); }"),
        ["fs::", "fs}"]
    );
    assert_eq!(trespasses("fluvia-net/src/net.rs", "use std::env;\nfn f() { env::var(\"a\"); }"), ["env::"]);
    assert_eq!(trespasses("fluvia-neighbors/src/grid.rs", "thread_local! {}"), ["thread_local!"]);
    assert_eq!(trespasses("fluvia-sim/src/frames/npz.rs", "std::fs::read(\"a\")"), [""; 0]);
    assert_eq!(trespasses("fluvia-sim/src/pbf.rs", "println!(\"a\")"), ["println!"]);
    assert_eq!(trespasses("fluvia-net/src/net.rs", "use burn::tensor;"), ["burn::"]);
    assert_eq!(trespasses("cconv/src/burn.rs", "use burn::tensor;"), [""; 0]);
    assert_eq!(trespasses("cconv/src/cpu.rs", "// std::fs is not for us"), [""; 0]);
}

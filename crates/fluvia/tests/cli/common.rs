//! What the command-line tests share: a folder of their own, and runs of the program.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::process::{Child, Stdio};
use std::process::{Command, Output};

/// The small network of fixtures/weights, as the given file.
pub fn fixture(name: &str) -> String {
    let file = below_fixtures(&format!("weights/{name}"));
    assert!(Path::new(&file).exists(), "{file} is missing");
    file
}

/// The small sequences of fixtures/sequences: a folder, a file, or what the parts of one begin with.
pub fn sequence(name: &str) -> String {
    below_fixtures(&format!("sequences/{name}"))
}

fn below_fixtures(name: &str) -> String {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures");
    fixtures.join(name).display().to_string()
}

/// A temporary folder, which is also where the program runs.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Folder {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        std::fs::write(self.path(name), content).expect("a file in a temporary folder");
    }

    /// The program with arguments split at blanks, not started.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_fluvia"));
        command.args(arguments.split_whitespace()).current_dir(self.0.path());
        command
    }

    pub fn run(&self, arguments: &str) -> Run {
        self.run_with_path(arguments, None)
    }

    /// The same where programs are looked for in a folder of this one.
    pub fn run_with_path(&self, arguments: &str, path: Option<&str>) -> Run {
        let mut command = self.command(arguments);
        if let Some(path) = path {
            command.env("PATH", self.path(path));
        }
        Run::new(arguments, command.output().expect("the program starts"))
    }

    /// Runs what must succeed.
    pub fn succeed(&self, arguments: &str) -> Run {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(0), "{arguments}: {}", run.stderr);
        run
    }

    /// Runs what has begun with `file` when Ctrl-C comes, and must then stop by itself.
    #[cfg(unix)]
    pub fn interrupt(&self, arguments: &str, file: &str) -> Run {
        self.interrupt_when(arguments, |_| self.path(file).exists())
    }

    /// The same of what has begun when `has_begun`, which gets the number of the process.
    #[cfg(unix)]
    pub fn interrupt_when(&self, arguments: &str, has_begun: impl Fn(u32) -> bool) -> Run {
        self.interrupt_command(self.command(arguments), arguments, has_begun)
    }

    /// The same of a command with an environment of its own.
    #[cfg(unix)]
    pub fn interrupt_command(
        &self,
        command: Command,
        arguments: &str,
        has_begun: impl Fn(u32) -> bool,
    ) -> Run {
        let mut child = Running::start(command);
        wait_for(&format!("{arguments}: the beginning"), || has_begun(child.0.id()));
        ctrl_c(child.0.id());
        wait_for(&format!("{arguments}: an end"), || child.0.try_wait().expect("a process").is_some());
        child.end(arguments)
    }

    /// Runs what gets Ctrl-C again and again until it ends.
    #[cfg(target_os = "linux")]
    pub fn interrupt_until_it_ends(&self, arguments: &str) -> Run {
        let mut child = Running::start(self.command(arguments));
        wait_for(&format!("{arguments}: the beginning"), || catches_ctrl_c(child.0.id()));
        wait_for(&format!("{arguments}: an end"), || {
            ctrl_c(child.0.id());
            std::thread::sleep(std::time::Duration::from_millis(20));
            child.0.try_wait().expect("a process").is_some()
        });
        child.end(arguments)
    }

    /// Runs what must fail with one line that mentions all of `words`, and leave no directory `out`.
    pub fn fail(&self, arguments: &str, words: &[&str]) {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(1), "{arguments}: {}", run.stderr);
        let errors: Vec<&str> = run.stderr.lines().filter(|line| !line.starts_with("warning: ")).collect();
        assert!(
            matches!(errors.as_slice(), [line] if line.starts_with("error: ")),
            "{arguments}: expected one line of error: {:?}",
            run.stderr
        );
        for word in words {
            assert!(errors[0].contains(word), "{arguments}: `{word}` in {:?}", errors[0]);
        }
        assert!(!self.path("out").exists(), "{arguments}: left `out` behind");
    }

    /// The content of a JSON file.
    pub fn json(&self, name: &str) -> serde_json::Value {
        let bytes = std::fs::read(self.path(name)).expect("a readable file");
        serde_json::from_slice(&bytes).expect("JSON")
    }

    /// The content of all files of a run but its record, which holds times and threads.
    pub fn files(&self, directory: &str) -> BTreeMap<String, Vec<u8>> {
        let entries = std::fs::read_dir(self.path(directory)).expect("a directory");
        entries
            .map(|entry| {
                let path = entry.expect("an entry").path();
                let name = path.file_name().expect("a name").to_string_lossy().into_owned();
                (name, std::fs::read(&path).expect("a readable file"))
            })
            .filter(|(name, _)| name != "run.json")
            .collect()
    }
}

/// A process that does not outlive its test.
#[cfg(unix)]
struct Running(Child);

#[cfg(unix)]
impl Running {
    fn start(mut command: Command) -> Running {
        Running(command.stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("the program starts"))
    }

    /// What it did, which Ctrl-C has ended.
    fn end(&mut self, arguments: &str) -> Run {
        fn read(pipe: Option<impl std::io::Read>) -> Vec<u8> {
            let mut bytes = Vec::new();
            pipe.expect("a pipe").read_to_end(&mut bytes).expect("its output");
            bytes
        }
        let (stdout, stderr) = (read(self.0.stdout.take()), read(self.0.stderr.take()));
        let run = Run::new(arguments, Output { status: self.0.wait().expect("an end"), stdout, stderr });
        assert_eq!(run.code, Some(130), "{arguments}: {}", run.stderr);
        run
    }
}

#[cfg(unix)]
impl Drop for Running {
    fn drop(&mut self) {
        // What has ended cannot be killed.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Whether a process has a handler for Ctrl-C.
#[cfg(target_os = "linux")]
pub fn catches_ctrl_c(process: u32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    // SIGINT is signal 2, the second bit.
    caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 2 != 0)
}

#[cfg(unix)]
fn ctrl_c(process: u32) {
    let status = Command::new("kill").args(["-INT", &process.to_string()]).status().expect("kill");
    assert!(status.success(), "no process {process}");
}

/// Waits for what happens at once on an idle machine; after minutes it does not happen.
#[cfg(unix)]
fn wait_for(what: &str, mut is_there: impl FnMut() -> bool) {
    use std::time::{Duration, Instant};
    let start = Instant::now();
    while !is_there() {
        assert!(start.elapsed() < Duration::from_secs(180), "waited for {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// A disk of so many bytes in a folder, unmounted when dropped; `None` where one cannot be mounted.
#[cfg(target_os = "linux")]
pub struct SmallDisk(PathBuf);

#[cfg(target_os = "linux")]
impl SmallDisk {
    pub fn mount(path: &Path, size: &str) -> Option<SmallDisk> {
        std::fs::create_dir(path).expect("a folder");
        let mut command = Command::new("mount");
        command.args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"]).arg(path);
        let mounted = command.output().is_ok_and(|output| output.status.success());
        if !mounted {
            eprintln!("skipped: a small disk cannot be mounted here");
        }
        mounted.then(|| SmallDisk(path.to_path_buf()))
    }
}

#[cfg(target_os = "linux")]
impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// What a run of the program did.
pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Run {
    fn new(arguments: &str, output: Output) -> Run {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
        let run =
            Run { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) };
        assert!(!run.stderr.contains("panicked"), "{arguments}: {}", run.stderr);
        run
    }

    pub fn last_json(&self) -> serde_json::Value {
        let line = self.stdout.lines().last().expect("a line of output");
        serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))
    }
}

/// The text of a point cloud.
pub fn cloud(points: &[impl std::fmt::Display]) -> String {
    let count = points.len();
    let properties = "property float x\nproperty float y\nproperty float z\n";
    let points: String = points.iter().map(|point| format!("{point}\n")).collect();
    format!("ply\nformat ascii 1.0\nelement vertex {count}\n{properties}end_header\n{points}")
}

/// The text of a cloud whose surface takes a while: a block of 8,000 particles.
pub fn block() -> String {
    let at = |i: usize| [i % 20, i / 400, i / 20 % 20].map(|k| format!("{}", 0.05 * k as f32)).join(" ");
    cloud(&(0..8000).map(at).collect::<Vec<_>>())
}

/// A block of 64 particles above the floor of a small container.
pub const SCENE: &str = r#"{
  "walls": [{"shape": "container", "scale": [0.5, 0.8, 0.5]}],
  "fluids": [{"shape": "box", "scale": 0.2, "translation": [0, 0.3, 0], "velocity": [0.5, 0, 0.2]}]
}"#;

/// The text of [`SCENE`] with further keys at its top.
pub fn scene_with(keys: &str) -> String {
    SCENE.replacen('{', &format!("{{ {keys},"), 1)
}

/// The text of a scene whose fluid is given by these keys.
pub fn scene_of(fluid: &str) -> String {
    format!(r#"{{"walls": [{{"shape": "container", "scale": [0.5, 0.8, 0.5]}}], "fluids": [{{{fluid}}}]}}"#)
}

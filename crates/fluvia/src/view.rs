//! `fluvia view`: shows a scene that runs, or frames on disk, in a browser.
//!
//! ```text
//! Live | Playback -> Stage (a thread: when is the next frame due, what was asked for) <-> fluvia_view::Server
//! ```

mod densities;
mod live;
mod menu;
mod panel;
mod playback;
mod recorder;
mod stage;
mod surfaces;

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Result, anyhow, bail};
use fluvia_sim::frames::Format;
use fluvia_sim::scene;
use fluvia_view::Server;
use rayon::ThreadPool;

use crate::interrupt;
use crate::options::{PrecisionName, positive, thread_pool, threads};
use crate::report::{Report, counted};
use crate::solvers::SolverName;
use live::Live;
use playback::Playback;
use recorder::Recorder;
use stage::{Show, Stage};

/// The port where none is given.
const PORT: u16 = 8642;

/// The scene where none is given.
const SCENE: &str = "dam_break";

/// How often the main thread looks whether it is time to go.
const LOOK: Duration = Duration::from_millis(20);

/// Options of `fluvia view`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia view --open
  fluvia view scene.json --solver dfsph
  fluvia view scene.json --weights mine.safetensors --port 9000
  fluvia view out/dam_break
  fluvia view data/valid/sim_0206

The page is at http://127.0.0.1:8642/ until Ctrl-C; what it shows begins when somebody looks, and goes on when nobody
does any more. All that look at it see the same and steer the same: on a machine that others use, they can too. A name
of a shipped scene (dam_break, two_bodies, emitter_step, obstacle_course, river, waterfall, hundred_thousand;
three_viscosities with --weights viscosity or --solver dfsph) is that scene; ./dam_break is a directory. From another
machine: ssh -L 8642:127.0.0.1:8642 HOST, then the same address.")]
pub struct Args {
    /// A scene to run: a file (JSON) or the name of a shipped scene; or frames to show: the directory of a run, or a
    /// sequence of a data set (its folder, a part file, or the common prefix of its parts). dam_break if not given.
    #[arg(value_name = "SCENE|FRAMES")]
    show: Option<String>,
    /// The port; 0 finds a free one.
    #[arg(long, value_name = "P", default_value_t = PORT)]
    port: u16,
    /// Open the page in the browser of this system.
    #[arg(long)]
    open: bool,
    /// The address to listen at. Others than those of this machine let everybody steer who can reach it.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    bind: IpAddr,
    /// Weights of a network to offer beside the shipped ones: a file (.pt, .h5 or .safetensors) or the name of shipped
    /// ones; several times for several. The first is what begins.
    #[arg(long, value_name = "FILE")]
    weights: Vec<PathBuf>,
    /// Begin with a solver that needs no weights.
    #[arg(long, value_enum)]
    solver: Option<SolverName>,
    /// That solver's own step, seconds: an interval is cut into equal parts that are no longer.
    #[arg(long, value_name = "SECONDS", value_parser = positive, requires = "solver", conflicts_with = "solver_dt_max")]
    solver_dt: Option<f32>,
    /// That solver's longest step, seconds, shorter while particles are fast; if not given 0.005 (dfsph), 0.004 (pbf).
    #[arg(long, value_name = "SECONDS", value_parser = positive, requires = "solver")]
    solver_dt_max: Option<f32>,
    /// The format of the networks' large matrix products; f32 if not given.
    #[arg(long, value_enum)]
    precision: Option<PrecisionName>,
    /// The seed of the wall particles; 0 if not given.
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Where recordings go, a directory each; out/view if not given.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Formats of recorded frames: npz, ply, bgeo, vtu, vtk; npz if not given.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    format: Vec<Format>,
    /// Seconds between stored frames where that is not recorded, as in sequences; 0.02 if not given.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    dt: Option<f32>,
    /// Threads; all cores if not given.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    /// Stand still until somebody presses play.
    #[arg(long)]
    paused: bool,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let pool = thread_pool(args.threads)?;
    let name = args.show.as_deref().unwrap_or(SCENE);
    let recorder = Arc::new(Recorder::new(args.out.as_deref(), &args.format));
    if is_scene(name) {
        refuse(args.only_for_frames(), "a scene runs, expected frames on disk")?;
        let live = pool.install(|| Live::new(args, name, Arc::clone(&recorder), report))?;
        serve(live, pool, args, &recorder, report)
    } else {
        refuse(args.only_for_scenes(), "frames on disk are shown, expected a scene")?;
        let playback = pool.install(|| Playback::open(Path::new(name), args.dt).map_err(or_a_scene))?;
        serve(playback, pool, args, &recorder, report)
    }
}

/// Serves the page until Ctrl-C.
fn serve<S: Show + Send + 'static>(
    show: S,
    pool: ThreadPool,
    args: &Args,
    recorder: &Recorder,
    report: &Report,
) -> Result<ExitCode> {
    let (server, commands) = Server::start(SocketAddr::new(args.bind, args.port))?;
    let server = Arc::new(server);
    let interrupted = interrupt::watch()?;
    let mut bound = server.address();
    if bound.ip().is_unspecified() {
        report.warning(format_args!(
            "everybody who can reach this machine can watch and steer, at port {} of any of its addresses",
            bound.port()
        ));
        // Nobody can go to the address that means all of them.
        bound.set_ip(match bound.ip() {
            IpAddr::V4(_) => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(_) => Ipv6Addr::LOCALHOST.into(),
        });
    } else if !bound.ip().is_loopback() {
        report.warning(format_args!("everybody who can reach {bound} can watch and steer"));
    }
    let address = format!("http://{bound}/");
    report.result(&address)?;
    report.note("Ctrl-C ends it");
    if args.open {
        open(&address, report);
    }
    let mut stage = Stage::new(Arc::clone(&server), commands, show, !args.paused);
    let thread = std::thread::Builder::new().name("stage".into());
    let thread = thread.spawn(move || pool.install(|| stage.run()))?;
    while !interrupted.load(Ordering::Relaxed) && !thread.is_finished() && server.is_running() {
        std::thread::sleep(LOOK);
    }
    // A step may take seconds, and nobody wants its result: the process ends below it. What is being written is waited for.
    for (directory, frames) in recorder.close()? {
        report.note(format_args!("{}: {}", directory.display(), counted(frames, "frame")));
    }
    if !interrupted.load(Ordering::Relaxed) {
        let what = if thread.is_finished() { "the simulation" } else { "the server" };
        bail!("{what} has ended unexpectedly");
    }
    Ok(interrupt::exit_code())
}

impl Args {
    /// The first option given that only scenes have.
    fn only_for_scenes(&self) -> Option<&'static str> {
        let given = [
            (!self.weights.is_empty(), "--weights"),
            (self.solver.is_some(), "--solver"),
            (self.precision.is_some(), "--precision"),
            (self.seed.is_some(), "--seed"),
            (self.out.is_some(), "--out"),
            (!self.format.is_empty(), "--format"),
        ];
        given.into_iter().find(|(given, _)| *given).map(|(_, name)| name)
    }

    /// The first option given that only stored frames have.
    fn only_for_frames(&self) -> Option<&'static str> {
        self.dt.map(|_| "--dt")
    }
}

fn refuse(option: Option<&str>, why: &str) -> Result<()> {
    option.map_or(Ok(()), |option| Err(anyhow!("{option}: {why}")))
}

/// Whether it is a scene that is asked for, and not frames.
fn is_scene(name: &str) -> bool {
    let path = Path::new(name);
    let is_json = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("json"));
    !path.is_dir() && is_json || scene::shipped(name).is_some()
}

/// The error of frames that are not there, with the scenes that may have been meant.
fn or_a_scene(error: anyhow::Error) -> anyhow::Error {
    let is_missing = error.downcast_ref::<fluvia_sim::Error>().is_some_and(|error| {
        matches!(error, fluvia_sim::Error::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound)
    });
    if !is_missing {
        return error;
    }
    let names = scene::shipped_names().collect::<Vec<_>>().join(", ");
    error.context(format!("neither frames nor a shipped scene (there are {names})"))
}

/// Opens the page as the system opens addresses; it need not have a browser.
fn open(address: &str, report: &Report) {
    let opener = match std::env::consts::OS {
        "macos" => "open",
        "windows" => "explorer",
        _ => "xdg-open",
    };
    let mut command = Command::new(opener);
    let started =
        command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    if let Err(error) = started {
        report.warning(format_args!("--open: {opener}: {error}"));
    }
}

//! `fluvia render`: draws frames as a picture, a contact sheet or a film.

mod film;
mod moment;
mod mp4;
mod picture;
mod values;
mod writer;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, anyhow, bail};
use fluvia_render::{Camera, Error, Legend, Scale, Style, Subject, View};
use fluvia_sim::frames;

use crate::interrupt;
use crate::options::{FrameRange, frame_range, positive, thread_pool, threads};
use crate::report::Report;
use crate::surface;
use film::film;
use moment::{Color, Colors, Run};
use picture::picture;
use values::{Place, Shape, Size};

/// Options of `fluvia render`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia render out/dam -o last.png
  fluvia render out/dam -o water.png --surface --frame 40 --size 1280x720
  fluvia render out/dam -o sheet.png --sheet 4x2
  fluvia render out/dam -o film.mp4 --surface --orbit 12 --size 1280x720 --plain
  fluvia render DFSPH=out/dfsph network=out/net -o both.mp4 --frames 0..150
  fluvia render out/dam -o film.gif --every 2 --size 360
  fluvia render PBF=out/pbf network=out/net -o compare.png --frames 0,10,20,50,100 --title 'Two solvers'
  fluvia render truth=data/valid/sim_0206 network=out/net -o compare.png --frames 0,10,20,50
  fluvia render out/dam -o close.png --eye 2,1,2 --look-at 0,0.3,0 --field-of-view 30

All pictures of a sheet or film share one camera and one colour scale. Walls are drawn where they face the camera and hide \
what is behind them, but not particles in orange: those are more than a radius behind a wall, and with --surface they are \
the ones that are still drawn as spheres. Films play at the speed of the simulation; mp4 needs ffmpeg.")]
pub struct Args {
    /// Directories of frames, as `fluvia simulate` writes them, or sequences of a data set: the folder of one, a part
    /// file, or the common prefix of its parts. LABEL=FRAMES names one. Each is a row of a sheet, and a column of a film.
    #[arg(required = true, value_name = "FRAMES")]
    runs: Vec<String>,
    /// The picture (.png) or film (.mp4, .gif) to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Draw the surface of the liquid, not its particles. It is drawn out to the walls that the liquid rests at.
    #[arg(long)]
    surface: bool,
    /// The side of the cubes that the surface is cut with, particle radii; 0.5 if not given.
    #[arg(long, value_name = "RADII", requires = "surface", value_parser = surface::cube_size)]
    cube_size: Option<f32>,
    /// A contact sheet of COLUMNS x ROWS frames, evenly spread; several directories have a row each.
    #[arg(long, value_name = "COLUMNSxROWS", conflicts_with = "frame")]
    sheet: Option<Shape>,
    /// The frames of a sheet or film, numbers and ranges FIRST..LAST; if not given evenly spread ones of a sheet, all of
    /// a film.
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = frame_range, conflicts_with = "frame")]
    frames: Vec<FrameRange>,
    /// The one frame to draw; the last if not given.
    #[arg(long, value_name = "N")]
    frame: Option<u64>,
    /// Every K-th frame of a film; 1 if not given.
    #[arg(long, value_name = "K")]
    every: Option<NonZeroUsize>,
    /// Seconds between frames where that is not recorded, as in sequences; 0.02 if not given.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    dt: Option<f32>,
    /// The particle radius where that is not recorded, metres; 0.025 if not given.
    #[arg(long, value_name = "METRES", value_parser = positive)]
    particle_radius: Option<f32>,
    /// What colours show; speed if not given, water with --surface.
    #[arg(long, value_enum)]
    color: Option<Color>,
    /// The speed of the yellow end of the scale of speeds, metres per second; 4 if not given.
    #[arg(long, value_name = "SPEED", value_parser = positive)]
    max_speed: Option<f32>,
    /// What the legend calls the bodies, in their order; body 0 and so on if not given.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', conflicts_with = "plain")]
    body_names: Vec<String>,
    /// The width of a picture, pixels, or its width and height; 640, in a sheet 240.
    #[arg(long, value_name = "WIDTH[xHEIGHT]")]
    size: Option<Size>,
    /// Nothing but the picture: no frame numbers, times and legends. Of several runs in a film their pictures side by
    /// side.
    #[arg(long, conflicts_with_all = ["sheet", "title"])]
    plain: bool,
    /// A title above the picture, sheet or film.
    #[arg(long, default_value = "")]
    title: String,
    /// Threads; all cores if not given. A film has as many frames in memory. Pictures do not depend on it.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    #[command(flatten)]
    place: Place,
}

/// The width of a picture where none is given, pixels: alone, and as a tile of a sheet.
const WIDTHS: [u32; 2] = [640, 240];

/// The speed of the yellow end of the scale where none is given, metres per second.
const MAX_SPEED: f32 = 4.0;

/// What a file is by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Png,
    Gif,
    Mp4,
}

impl Args {
    fn kind(&self) -> Result<Kind> {
        let output = self.output.display();
        let extension = self.output.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        let kind = match extension.to_ascii_lowercase().as_str() {
            "png" => Kind::Png,
            "gif" => Kind::Gif,
            "mp4" => Kind::Mp4,
            _ => bail!("{output}: expected a name that ends in .png, .gif or .mp4"),
        };
        if kind != Kind::Png && (self.sheet.is_some() || self.frame.is_some()) {
            bail!("{output}: a film is without --sheet and --frame");
        }
        if kind == Kind::Png {
            for (option, is_given) in
                [("--every", self.every.is_some()), ("--orbit", self.place.orbit.is_some())]
            {
                if is_given {
                    bail!("{output}: {option} is for films (.mp4, .gif)");
                }
            }
        }
        Ok(kind)
    }

    fn color(&self) -> Color {
        self.color.unwrap_or(if self.surface { Color::Water } else { Color::Speed })
    }

    fn surface(&self) -> Option<surface::Params> {
        let params = surface::Params::default();
        let cube_size = self.cube_size.unwrap_or(params.cube_size);
        self.surface.then_some(surface::Params { cube_size, ..params })
    }

    fn view(&self, is_sheet: bool, sweep: f32) -> View {
        let Place { yaw, pitch, top, look_at, eye, field_of_view, .. } = self.place;
        let usual = Size { width: WIDTHS[usize::from(is_sheet)], height: None };
        let Size { width, height } = self.size.unwrap_or(usual);
        View { yaw, pitch, width, height, top, look_at, eye, field_of_view, sweep, ..View::default() }
    }

    /// The camera of a picture or of a film, which goes around by `sweep` degrees.
    fn camera(&self, subject: &Subject<'_>, is_sheet: bool, sweep: f32) -> Result<Camera> {
        Camera::fit(subject, &self.view(is_sheet, sweep)).map_err(|error| match error {
            Error::OutOfView => {
                let placed = match (self.place.eye, self.place.look_at) {
                    (Some(_), Some(_)) => "--eye and --look-at",
                    (Some(_), None) => "--eye",
                    _ => "--look-at",
                };
                anyhow!("{placed}: nothing of the scene is in view, expected it before the camera")
            }
            error => error.into(),
        })
    }
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let kind = args.kind()?;
    if args.max_speed.is_some() && args.color() != Color::Speed {
        bail!("--max-speed: the colours do not show speeds, expected --color speed");
    }
    if !args.body_names.is_empty() && args.color() != Color::Body {
        bail!("--body-names: the colours do not show bodies, expected --color body");
    }
    if kind == Kind::Mp4 {
        mp4::check(&args.output)?;
    }
    // What cannot be written in the end is not drawn.
    frames::prepare(&args.output)?;
    let interrupted = interrupt::watch()?;
    thread_pool(args.threads)?.install(|| {
        let open = |text: &String| Run::open(text, args.dt, args.particle_radius);
        let runs = args.runs.iter().map(open).collect::<Result<Vec<_>>>()?;
        check_alike(&runs, kind)?;
        let output = args.output.display();
        let (what, is_done) = match kind {
            Kind::Png => match picture(args, &runs, &interrupted, report)? {
                Some(bytes) => {
                    frames::write_atomically(&args.output, |file| file.write_all(&bytes))?;
                    report.detail(format_args!("{output}: {} bytes", bytes.len()));
                    ("picture", true)
                }
                None => ("picture", false),
            },
            Kind::Gif | Kind::Mp4 => ("film", film(args, kind, &runs, &interrupted, report)?),
        };
        if !is_done {
            report.note(format_args!("{output}: stopped, no {what} was written"));
            return Ok(interrupt::exit_code());
        }
        Ok(ExitCode::SUCCESS)
    })
}

/// Runs that are drawn together have one radius and one direction down; in a film they have one rate.
fn check_alike(runs: &[Run], kind: Kind) -> Result<()> {
    let first = &runs[0];
    for run in &runs[1..] {
        let (path, first_path) = (run.path.display(), first.path.display());
        if (run.radius, run.up) != (first.radius, first.up) {
            bail!(
                "{path}: another particle radius or gravity than {first_path}, expected the same in all directories"
            );
        }
        if kind != Kind::Png && run.dt != first.dt {
            let (dt, first) = (run.dt, first.dt);
            bail!("{path}: {dt} s between frames, {first_path} has {first} s, expected the same in a film");
        }
    }
    Ok(())
}

/// The walls of all runs.
fn subject(runs: &[Run]) -> Subject<'_> {
    let first = &runs[0];
    let mut subject = Subject::new(first.walls(), first.radius).with_up(first.up);
    runs[1..].iter().for_each(|run| subject.add_walls(run.walls()));
    subject
}

/// What the values of all pictures have in common.
#[derive(Default)]
struct Seen {
    /// Whether a frame has what colours show.
    has_values: bool,
    /// The lowest and the highest value; none that is finite at first.
    range: Option<[f32; 2]>,
    bodies: u32,
}

impl Seen {
    fn add(&mut self, colors: &Colors) {
        match colors {
            Colors::Scalar(values) => {
                self.has_values = true;
                for &value in values.iter().filter(|value| value.is_finite()) {
                    let [low, high] = self.range.unwrap_or([value; 2]);
                    self.range = Some([low.min(value), high.max(value)]);
                }
            }
            Colors::Body(bodies) => {
                self.has_values = true;
                self.bodies = bodies.iter().fold(self.bodies, |most, &body| most.max(body.saturating_add(1)));
            }
            Colors::None | Colors::Mixed(_) => {}
        }
    }

    /// Looks at whether the options about colours do something.
    ///
    /// # Errors
    /// If no frame has what the colours are to show.
    fn check(&self, args: &Args, runs: &[Run], report: &Report) -> Result<()> {
        let (option, what) = match args.color {
            Some(Color::Speed) => ("--color speed", "velocities"),
            Some(Color::Body) => ("--color body", "bodies"),
            _ if args.max_speed.is_some() => ("--max-speed", "velocities"),
            _ => return Ok(()),
        };
        if !self.has_values {
            bail!("{}: the frames have no {what}, expected some for {option}", runs[0].path.display());
        }
        let (names, bodies) = (args.body_names.len(), self.bodies as usize);
        if names > bodies {
            report.warning(format_args!(
                "--body-names: {names} names, expected at most {bodies}: the frames have no more bodies"
            ));
        }
        Ok(())
    }

    fn legend(&self, args: &Args) -> Legend {
        match args.color() {
            Color::Speed | Color::Height if self.has_values => Legend::Scale,
            Color::Body => {
                let name = |body: usize| args.body_names.get(body).cloned();
                // A number in a foreign file may be any.
                let bodies = 0..Legend::MOST_BODIES.min(self.bodies as usize);
                Legend::Bodies(
                    bodies.map(|body| name(body).unwrap_or_else(|| format!("body {body}"))).collect(),
                )
            }
            _ => Legend::None,
        }
    }
}

fn style(args: &Args, runs: &[Run], seen: &Seen) -> Style {
    let scale = match (args.color(), seen.range) {
        (Color::Height, Some([low, high])) if low < high => Scale::height(low, high),
        (Color::Height, _) => Scale::height(0.0, 1.0),
        _ => Scale::speed(args.max_speed.unwrap_or(MAX_SPEED)),
    };
    Style { radius: runs[0].radius, scale, ..Style::default() }
}

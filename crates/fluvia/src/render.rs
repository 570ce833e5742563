//! `fluvia render`: draws frames as a picture, a contact sheet or a film.

mod film;
mod moment;
mod mp4;
mod writer;

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use fluvia_render::{Camera, Row, Scale, Sheet, Style, Subject, View, draw_frame, encode_png, sheet};
use fluvia_sim::frames;

use crate::interrupt;
use crate::options::{FrameRange, chosen_frames, frame_range, positive, thread_pool, threads};
use crate::report::Report;
use crate::surface;
use film::film;
use moment::{Color, Colors, Moment, Run};

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

All pictures of a sheet or film share one camera and one colour scale. Orange particles are more than a radius
behind the wall; with --surface they are the ones that are still drawn as spheres. Films play at the speed of the
simulation; mp4 needs ffmpeg.")]
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
    #[arg(long, value_name = "RADII", requires = "surface", value_parser = surface::factor)]
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
    /// What colours show; speed if not given, water with --surface.
    #[arg(long, value_enum)]
    color: Option<Color>,
    /// The speed of the yellow end of the scale of speeds, metres per second; 4 if not given.
    #[arg(long, value_name = "SPEED", value_parser = positive)]
    max_speed: Option<f32>,
    /// The width of a picture, pixels, or its width and height; 640, in a sheet 240.
    #[arg(long, value_name = "WIDTH[xHEIGHT]")]
    size: Option<Size>,
    /// Nothing but the picture: no frame numbers, times and legends.
    #[arg(long, conflicts_with_all = ["sheet", "title"])]
    plain: bool,
    /// A title above a sheet or film.
    #[arg(long, default_value = "")]
    title: String,
    /// Threads; all cores if not given. Pictures do not depend on it.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    #[command(flatten)]
    place: Place,
}

/// Where the camera stands.
#[derive(clap::Args)]
#[command(next_help_heading = "Camera")]
struct Place {
    /// The turn of the camera about the vertical, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 24.0, allow_negative_numbers = true)]
    yaw: f32,
    /// How far the camera looks down, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 18.0, allow_negative_numbers = true)]
    pitch: f32,
    /// The highest point to show, metres; the highest particle if not given.
    #[arg(long, value_name = "HEIGHT", allow_negative_numbers = true)]
    top: Option<f32>,
    /// How fast the camera of a film goes around what it looks at, degrees a second.
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    orbit: Option<f32>,
    /// The point in the middle of the picture, metres; if not given the whole scene fills it.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point)]
    look_at: Option<[f32; 3]>,
    /// Where the camera stands, metres; far from the scene, by --yaw and --pitch, if not given.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = point, conflicts_with_all = ["yaw", "pitch"])]
    eye: Option<[f32; 3]>,
    /// The angle of view from the lower to the upper edge, degrees; if not given all is to be seen.
    #[arg(long, value_name = "DEGREES")]
    field_of_view: Option<f32>,
}

/// Columns and rows of a sheet.
#[derive(Clone, Copy, Debug)]
struct Shape {
    columns: usize,
    rows: usize,
}

impl std::str::FromStr for Shape {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Shape, String> {
        let number = |text: &str| text.parse().ok().filter(|n| (1..=100).contains(n));
        let shape = text.split_once(['x', 'X']).map(|(c, r)| (number(c), number(r)));
        match shape {
            Some((Some(columns), Some(rows))) => Ok(Shape { columns, rows }),
            _ => Err("expected COLUMNSxROWS, each 1 to 100, as in 4x2".into()),
        }
    }
}

/// The width of a picture, and its height if that is given, pixels.
#[derive(Clone, Copy, Debug)]
struct Size {
    width: u32,
    height: Option<u32>,
}

impl std::str::FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Size, String> {
        let size = match text.split_once(['x', 'X']) {
            Some((width, height)) => {
                width.parse().ok().zip(height.parse().ok()).map(|(width, height)| (width, Some(height)))
            }
            None => text.parse().ok().map(|width| (width, None)),
        };
        let (width, height) = size.ok_or("expected a width in pixels, or WIDTHxHEIGHT, as in 1280x720")?;
        Ok(Size { width, height })
    }
}

/// Parses three numbers.
fn point(text: &str) -> std::result::Result<[f32; 3], String> {
    let numbers: Vec<f32> =
        text.split(',').filter_map(|word| word.trim().parse().ok()).filter(|x: &f32| x.is_finite()).collect();
    let count = text.split(',').count();
    let point = <[f32; 3]>::try_from(numbers).ok().filter(|_| count == 3);
    point.ok_or_else(|| "expected three numbers, as in 0.5,1,-2".into())
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
        if self.plain && kind == Kind::Png && (self.runs.len() > 1 || self.frames.len() > 1) {
            bail!("{output}: --plain is for one picture or a film");
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
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let kind = args.kind()?;
    if args.max_speed.is_some() && args.color() != Color::Speed {
        bail!("--max-speed: the colours do not show speeds, expected --color speed");
    }
    if kind == Kind::Mp4 {
        mp4::check(&args.output)?;
    }
    let interrupted = interrupt::watch()?;
    thread_pool(args.threads)?.install(|| {
        let runs = args.runs.iter().map(|text| Run::open(text, args.dt)).collect::<Result<Vec<_>>>()?;
        check_alike(&runs, kind)?;
        if kind == Kind::Png {
            let bytes = picture(args, &runs)?;
            frames::write_atomically(&args.output, |file| file.write_all(&bytes))?;
            report.detail(format_args!("{}: {} bytes", args.output.display(), bytes.len()));
            return Ok(ExitCode::SUCCESS);
        }
        match film(args, kind, &runs, &interrupted, report)? {
            true => Ok(ExitCode::SUCCESS),
            false => {
                report.note(format_args!("{}: stopped, no film was written", args.output.display()));
                Ok(interrupt::exit_code())
            }
        }
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

/// A picture or a sheet, as a file.
fn picture(args: &Args, runs: &[Run]) -> Result<Vec<u8>> {
    let rows = choose_frames(args, runs)?;
    let (color, surface) = (args.color(), args.surface());
    let mut moments = Vec::new();
    for (run, frames) in &rows {
        let read = |&frame| runs[*run].moment(frame, color, surface.as_ref());
        moments.push(frames.iter().map(read).collect::<Result<Vec<Moment>>>()?);
    }
    let is_sheet = args.sheet.is_some() || moments.len() > 1 || moments[0].len() > 1;
    let mut subject = subject(runs);
    moments.iter().flatten().for_each(|moment| subject.add(&moment.position));
    let camera = Camera::fit(&subject, &args.view(is_sheet, 0.0))?;
    let mut seen = Seen::default();
    moments.iter().flatten().for_each(|moment| seen.add(moment));
    let style = style(args, runs, &seen);
    if args.plain {
        return Ok(encode_png(&draw_frame(&moments[0][0].frame(), &runs[0].stage, &camera, &style)?)?);
    }
    let rows = rows.iter().zip(&moments).map(|((run, _), moments)| {
        let run = &runs[*run];
        // The rows of one run need no label.
        let label = if runs.len() == 1 { String::new() } else { run.label.clone() };
        Row { label, tiles: moments.iter().map(|moment| moment.tile(run, "")).collect() }
    });
    let page = Sheet { title: args.title.clone(), rows: rows.collect() };
    Ok(encode_png(&sheet(&page, &camera, &style)?)?)
}

/// The rows of the picture: which run, and which of its frames.
fn choose_frames(args: &Args, runs: &[Run]) -> Result<Vec<(usize, Vec<u64>)>> {
    let mut rows = Vec::new();
    for (k, run) in runs.iter().enumerate() {
        let there = run.numbers.as_slice();
        let last = *there.last().context("a run has frames")?;
        let given = if args.frames.is_empty() { Vec::new() } else { chosen_frames(there, &args.frames)? };
        let (columns, row_count) = match args.sheet {
            Some(shape) => (shape.columns, if runs.len() == 1 { shape.rows } else { 1 }),
            None => (given.len().max(1), 1),
        };
        let count = columns * row_count;
        if let Some(Shape { columns, rows }) = args.sheet {
            if !given.is_empty() && given.len() != count {
                let given = given.len();
                bail!("--frames: {given} frames for {count} places of --sheet {columns}x{rows}");
            }
            if runs.len() > 1 && rows != runs.len() {
                let count = runs.len();
                bail!("--sheet: {rows} rows for {count} directories, expected {columns}x{count}");
            }
        }
        let frames: Vec<u64> = match (given.as_slice(), args.frame) {
            ([], None) if count == 1 => vec![last],
            ([], None) => spread(there, count),
            ([], Some(frame)) => vec![frame],
            (frames, _) => frames.to_vec(),
        };
        rows.extend(frames.chunks(columns).map(|frames| (k, frames.to_vec())));
    }
    Ok(rows)
}

/// `count` of the frames, evenly spread from the first to the last.
fn spread(frames: &[u64], count: usize) -> Vec<u64> {
    let count = count.min(frames.len());
    (0..count).map(|k| frames[(k * (frames.len() - 1)).checked_div(count - 1).unwrap_or(0)]).collect()
}

/// The walls of all runs.
fn subject(runs: &[Run]) -> Subject<'_> {
    let first = &runs[0];
    let mut subject = Subject::new(first.walls(), first.radius).with_up(first.up);
    runs[1..].iter().for_each(|run| subject.add(run.walls().position));
    subject
}

/// What the values of all pictures have in common.
#[derive(Default)]
struct Seen {
    /// The lowest and the highest value; none that is finite at first.
    range: Option<[f32; 2]>,
    bodies: u32,
}

impl Seen {
    fn add(&mut self, moment: &Moment) {
        match &moment.colors {
            Colors::Scalar(values) => {
                for &value in values.iter().filter(|value| value.is_finite()) {
                    let [low, high] = self.range.unwrap_or([value; 2]);
                    self.range = Some([low.min(value), high.max(value)]);
                }
            }
            Colors::Body(bodies) => {
                self.bodies = bodies.iter().fold(self.bodies, |most, &body| most.max(body + 1));
            }
            Colors::None | Colors::Mixed(_) => {}
        }
    }
}

fn style(args: &Args, runs: &[Run], seen: &Seen) -> Style {
    let scale = match (args.color(), seen.range) {
        (Color::Height, Some([low, high])) if low < high => Scale::height(low, high),
        (Color::Height, _) => Scale::height(0.0, 1.0),
        _ => Scale::speed(args.max_speed.unwrap_or(MAX_SPEED)),
    };
    let bodies = (0..seen.bodies).map(|body| format!("body {body}")).collect();
    Style { radius: runs[0].radius, scale, bodies, ..Style::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_from_the_first_to_the_last() {
        assert_eq!(spread(&[0, 1, 2, 3, 4], 3), [0, 2, 4]);
        assert_eq!(spread(&[3, 7], 8), [3, 7]);
        assert_eq!(spread(&[3, 7], 1), [3]);
    }

    #[test]
    fn points_and_sizes_are_read() {
        assert_eq!(point("0.5, 1,-2"), Ok([0.5, 1.0, -2.0]));
        assert!(["", "1,2", "1,2,3,4", "1,2,x", "1,,2", "1,2,nan"].iter().all(|text| point(text).is_err()));
        let size = |text: &str| text.parse().map(|Size { width, height }| (width, height));
        assert_eq!(size("640"), Ok((640, None)));
        assert_eq!(size("1280x720"), Ok((1280, Some(720))));
        assert!(["", "x", "1280x", "-1", "12 x 7"].iter().all(|text| size(text).is_err()));
    }
}

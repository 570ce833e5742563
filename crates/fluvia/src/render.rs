//! `fluvia render`: draws frames as a picture, a contact sheet or a film.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use fluvia_render::{
    Camera, Frame, GifEncoder, Image, OutsideTest, Palette, Row, Scale, Sheet, Style, Subject, Tile, Values,
    View, Walls, encode_png, heights, sheet, speeds,
};
use fluvia_sim::frames::{self, ParticleData};

use crate::frame_source::FrameSource;
use crate::options::positive;
use crate::report::Report;

/// Options of `fluvia render`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia render out/dam -o last.png
  fluvia render out/dam -o sheet.png --sheet 4x2
  fluvia render PBF=out/pbf network=out/net -o compare.png --frames 0,10,20,50,100 --title 'Two solvers'
  fluvia render out/dam -o film.gif --every 2 --size 360
  fluvia render truth=data/valid/sim_0206 network=out/net -o compare.png --frames 0,10,20,50

All pictures of a sheet or film share one camera and one colour scale. Orange particles are more than a radius
behind the wall.")]
pub struct Args {
    /// Directories of frames, as `fluvia simulate` writes them, or sequences of a data set: the folder of one, a part
    /// file, or the common prefix of its parts. LABEL=FRAMES names one. Each is a row of a sheet.
    #[arg(required = true, value_name = "FRAMES")]
    runs: Vec<String>,
    /// The picture (.png) or film (.gif) to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// A contact sheet of COLUMNS x ROWS frames, evenly spread; several directories have a row each.
    #[arg(long, value_name = "COLUMNSxROWS", conflicts_with = "frame")]
    sheet: Option<Shape>,
    /// The frames of a sheet or film, in place of evenly spread ones.
    #[arg(long, value_name = "LIST", value_delimiter = ',', conflicts_with = "frame")]
    frames: Vec<u64>,
    /// The one frame to draw; the last if not given.
    #[arg(long, value_name = "N")]
    frame: Option<u64>,
    /// Every K-th frame of a film, which plays at the speed of the simulation; 1 if not given.
    #[arg(long, value_name = "K")]
    every: Option<NonZeroUsize>,
    /// Seconds between frames where that is not recorded, as in sequences; 0.02 if not given.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    dt: Option<f32>,
    /// What colours show.
    #[arg(long, value_enum, default_value_t = Color::Speed)]
    color: Color,
    /// The speed of the yellow end of the scale of speeds, metres per second; 4 if not given.
    #[arg(long, value_name = "SPEED", value_parser = positive)]
    max_speed: Option<f32>,
    /// The turn of the camera about the vertical, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 24.0, allow_negative_numbers = true)]
    yaw: f32,
    /// How far the camera looks down, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 18.0, allow_negative_numbers = true)]
    pitch: f32,
    /// The width of a picture, pixels; 640, in a sheet 240.
    #[arg(long, value_name = "PIXELS")]
    size: Option<u32>,
    /// The highest point to show, metres; the highest particle if not given.
    #[arg(long, value_name = "HEIGHT", allow_negative_numbers = true)]
    top: Option<f32>,
    /// A title above a sheet.
    #[arg(long, default_value = "")]
    title: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Color {
    /// Speed, on a square-root scale.
    Speed,
    /// Height.
    Height,
    /// The fluid of the scene that a particle came from.
    Body,
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

/// The width of a picture where none is given, pixels: alone, and as a tile of a sheet.
const WIDTHS: [u32; 2] = [640, 240];

/// The speed of the yellow end of the scale where none is given, metres per second.
const MAX_SPEED: f32 = 4.0;

/// Frames of a film that its colours are chosen from.
const PALETTE_FRAMES: usize = 8;

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let output = args.output.display();
    let extension = args.output.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let is_film = match extension.to_ascii_lowercase().as_str() {
        "png" => false,
        "gif" => true,
        _ => bail!("{output}: expected a name that ends in .png or .gif"),
    };
    if is_film && (args.runs.len() > 1 || args.sheet.is_some() || args.frame.is_some()) {
        bail!("{output}: a film shows one directory, without --sheet or --frame");
    }
    if args.every.is_some() && !is_film {
        bail!("{output}: --every is for films (.gif)");
    }
    if args.max_speed.is_some() && args.color != Color::Speed {
        bail!("--max-speed: the colours do not show speeds, expected --color speed");
    }
    let mut runs = args.runs.iter().map(|text| Run::open(text, args.dt)).collect::<Result<Vec<_>>>()?;
    let rows = choose_frames(args, &runs, is_film)?;
    let moments = rows
        .iter()
        .map(|(run, frames)| frames.iter().map(|&frame| runs[*run].moment(frame, args.color)).collect())
        .collect::<Result<Vec<Vec<Moment>>>>()?;

    let first = &runs[0];
    for run in &runs[1..] {
        if (run.radius(), run.up) != (first.radius(), first.up) {
            let (path, first) = (run.source.path().display(), first.source.path().display());
            bail!(
                "{path}: another particle radius or gravity than {first}, expected the same in all directories"
            );
        }
    }
    let is_sheet = args.sheet.is_some() || runs.len() > 1 || (args.frames.len() > 1 && !is_film);
    let mut subject = Subject::new(first.walls(), first.radius()).with_up(first.up);
    runs[1..].iter().for_each(|run| subject.add(&run.source.walls().position));
    moments.iter().flatten().for_each(|moment| subject.add(&moment.position));
    let width = args.size.unwrap_or(WIDTHS[usize::from(is_sheet)]);
    let view = View { yaw: args.yaw, pitch: args.pitch, width, top: args.top, ..View::default() };
    let camera = Camera::fit(&subject, &view)?;
    let style = style(args, &runs, &moments);

    let bytes = if is_film {
        film(&runs[0], &moments[0], &camera, &style, args)?
    } else {
        let rows = rows.iter().zip(&moments).map(|((run, _), moments)| row(&runs[*run], moments));
        let mut rows: Vec<_> = rows.collect();
        if runs.len() == 1 {
            // The rows of one run need no label.
            rows.iter_mut().for_each(|row| row.label.clear());
        }
        let page = Sheet { title: args.title.clone(), rows };
        encode_png(&sheet(&page, &camera, &style)?)?
    };
    frames::write_atomically(&args.output, |file| file.write_all(&bytes))?;
    report.detail(format_args!("{output}: {} bytes", bytes.len()));
    Ok(ExitCode::SUCCESS)
}

/// The rows of the picture: which run, and which of its frames.
fn choose_frames(args: &Args, runs: &[Run], is_film: bool) -> Result<Vec<(usize, Vec<u64>)>> {
    if is_film {
        let all = if args.frames.is_empty() { runs[0].source.numbers() } else { &args.frames };
        return Ok(vec![(0, all.iter().copied().step_by(args.every.map_or(1, NonZeroUsize::get)).collect())]);
    }
    let mut rows = Vec::new();
    for (k, run) in runs.iter().enumerate() {
        let last = *run.source.numbers().last().context("a run has frames")?;
        let (columns, row_count) = match args.sheet {
            Some(shape) => (shape.columns, if runs.len() == 1 { shape.rows } else { 1 }),
            None => (args.frames.len().max(1), 1),
        };
        let count = columns * row_count;
        if let Some(Shape { columns, rows }) = args.sheet {
            let (given, places) = (args.frames.len(), columns * if runs.len() == 1 { rows } else { 1 });
            if given > 0 && given != places {
                bail!("--frames: {given} frames for {places} places of --sheet {columns}x{rows}");
            }
            if runs.len() > 1 && rows != runs.len() {
                let count = runs.len();
                bail!("--sheet: {rows} rows for {count} directories, expected {columns}x{count}");
            }
        }
        let frames: Vec<u64> = match (args.frames.as_slice(), args.frame) {
            ([], None) if count == 1 => vec![last],
            ([], None) => spread(run.source.numbers(), count),
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

fn style(args: &Args, runs: &[Run], moments: &[Vec<Moment>]) -> Style {
    let scale = match args.color {
        Color::Height => {
            let values = moments.iter().flatten().flat_map(|moment| &moment.values);
            let (low, high) = values
                .filter(|value| value.is_finite())
                .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
            if low < high { Scale::height(low, high) } else { Scale::height(0.0, 1.0) }
        }
        Color::Speed | Color::Body => Scale::speed(args.max_speed.unwrap_or(MAX_SPEED)),
    };
    let bodies = moments.iter().flatten().flat_map(|moment| &moment.bodies).max().map_or(0, |&last| last + 1);
    let bodies = (0..bodies).map(|body| format!("body {body}")).collect();
    Style { radius: runs[0].radius(), scale, bodies, ..Style::default() }
}

/// A film: every moment as a sheet of one tile.
fn film(run: &Run, moments: &[Moment], camera: &Camera, style: &Style, args: &Args) -> Result<Vec<u8>> {
    let draw = |moment: &Moment| -> Result<Image> {
        let rows =
            vec![Row { label: String::new(), walls: run.walls(), tiles: vec![moment.tile(run.source.dt)] }];
        Ok(sheet(&Sheet { title: args.title.clone(), rows }, camera, style)?)
    };
    let step = moments.len().div_ceil(PALETTE_FRAMES).max(1);
    let samples = moments.iter().step_by(step).map(draw).collect::<Result<Vec<_>>>()?;
    let size = samples.first().context("no frames to draw")?;
    let mut encoder = GifEncoder::new(size.width, size.height, Palette::of(&samples))?;
    for (k, moment) in moments.iter().enumerate() {
        // Until the next moment; the last stays as long as the one before.
        let pair = &moments[k.min(moments.len().saturating_sub(2))..];
        let frames = pair.get(1).map_or(1, |next| next.index.abs_diff(pair[0].index).max(1));
        encoder.push(&draw(moment)?, run.source.dt * frames as f64)?;
    }
    Ok(encoder.finish()?)
}

fn row<'a>(run: &'a Run, moments: &'a [Moment]) -> Row<'a> {
    let tiles = moments.iter().map(|moment| moment.tile(run.source.dt)).collect();
    Row { label: run.label.clone(), walls: run.walls(), tiles }
}

/// A row or more of the picture.
struct Run {
    label: String,
    source: FrameSource,
    outside: Option<OutsideTest>,
    /// Against gravity, a unit vector.
    up: [f32; 3],
}

impl Run {
    /// Opens `FRAMES` or `LABEL=FRAMES`.
    fn open(text: &str, dt: Option<f32>) -> Result<Run> {
        let (label, source) = FrameSource::open_labelled(text, dt)?;
        let up = against(source.gravity);
        let mut opened = Run { label, source, outside: None, up };
        if opened.source.walls().normal.is_some() {
            opened.outside = Some(OutsideTest::new(opened.walls(), opened.radius()));
        }
        Ok(opened)
    }

    fn radius(&self) -> f32 {
        self.source.particle_radius
    }

    fn walls(&self) -> Walls<'_> {
        let ParticleData { position, normal, .. } = self.source.walls();
        Walls { position, normal: normal.as_deref().unwrap_or_default() }
    }

    fn moment(&mut self, index: u64, color: Color) -> Result<Moment> {
        let ParticleData { position, velocity, body, .. } = self.source.read(index)?;
        let (mut values, mut bodies) = (Vec::new(), Vec::new());
        match color {
            Color::Speed => values = velocity.as_deref().map(speeds).unwrap_or_default(),
            Color::Height => values = heights(&position, self.up),
            Color::Body => bodies = body.unwrap_or_else(|| vec![0; position.len()]),
        }
        let outside = self.outside.as_ref().map(|test| test.mark(&position)).unwrap_or_default();
        Ok(Moment { index, position, values, bodies, outside })
    }
}

/// The unit vector against gravity; without gravity y is up, as everywhere.
fn against(gravity: [f32; 3]) -> [f32; 3] {
    let length = gravity.iter().map(|g| g * g).sum::<f32>().sqrt();
    if length > 0.0 { gravity.map(|g| -g / length) } else { [0.0, 1.0, 0.0] }
}

/// The particles of one frame and what colours them.
struct Moment {
    index: u64,
    position: Vec<[f32; 3]>,
    values: Vec<f32>,
    bodies: Vec<u32>,
    outside: Vec<bool>,
}

impl Moment {
    fn tile(&self, dt: f64) -> Tile<'_> {
        let values = match (self.values.as_slice(), self.bodies.as_slice()) {
            ([], []) => Values::None,
            ([], bodies) => Values::Body(bodies),
            (values, _) => Values::Scalar(values),
        };
        Tile {
            frame: Frame { position: &self.position, values, outside: &self.outside },
            label: format!("frame {}", self.index),
            note: format!("{:.2} s", self.index as f64 * dt),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_metres_whatever_the_gravity() {
        for (gravity, height) in [([0.0, -9.81, 0.0], 2.0), ([0.0; 3], 2.0), ([0.0, 0.0, -0.5], 3.0)] {
            assert_eq!(heights(&[[1.0, 2.0, 3.0]], against(gravity)), [height]);
        }
    }

    #[test]
    fn frames_are_spread_from_the_first_to_the_last() {
        assert_eq!(spread(&[0, 1, 2, 3, 4], 3), [0, 2, 4]);
        assert_eq!(spread(&[3, 7], 8), [3, 7]);
        assert_eq!(spread(&[3, 7], 1), [3]);
    }
}

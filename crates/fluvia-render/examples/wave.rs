//! A synthetic wave in a tank, drawn in every way that the library knows.
//!
//! ```sh
//! cargo run --release -p fluvia-render --example wave -- OUTPUT_DIRECTORY
//! ```
//!
//! writes `frame.png` (one picture), `sheet.png` (a contact sheet of two rows) and `film.gif`.

use std::error::Error;
use std::f32::consts::TAU;
use std::path::PathBuf;

use fluvia_render::{
    Camera, Frame, GifEncoder, Image, Legend, OutsideTest, Page, Palette, Scale, Stage, Style, Subject, Tile,
    Values, View, Walls, draw_frame, encode_png, speeds,
};

/// Particle radius, metres; particles are two radii apart.
const RADIUS: f32 = 0.025;
/// Length, height and depth of the tank, metres.
const TANK: [f32; 3] = [2.0, 1.0, 0.8];
/// Frames of one period of the wave, which lasts one second.
const FRAMES: usize = 25;

fn main() -> Result<(), Box<dyn Error>> {
    let directory = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| ".".to_owned()));
    let (wall, normal) = tank();
    let walls = Walls { position: &wall, normal: &normal };
    let (test, stage) = (OutsideTest::new(walls, RADIUS), Stage::new(walls));
    let moments: Vec<Moment> = (0..FRAMES).map(|frame| wave(frame as f32 / FRAMES as f32, &test)).collect();

    // One camera and one colour scale for all pictures.
    let style = Style { radius: RADIUS, scale: Scale::speed(2.0), ..Style::default() };
    let mut subject = Subject::new(walls, RADIUS);
    moments.iter().for_each(|moment| subject.add(&moment.position));
    let camera = Camera::fit(&subject, &View { width: 480, ..View::default() })?;

    let image = draw_frame(&moments[0].frame(), &stage, &camera, &style)?;
    std::fs::write(directory.join("frame.png"), encode_png(&image)?)?;

    let tile = |index: usize| {
        let note = format!("{:.2} s", index as f32 / FRAMES as f32);
        Tile { frame: moments[index].frame(), stage: Some(&stage), label: format!("frame {index}"), note }
    };
    let rows = [("first half", 3), ("second half", 3)];
    let mut page = Page::new("A wave in a tank", &rows, Legend::Scale, &camera, &style)?;
    for (row, frames) in [[0, 4, 8], [12, 16, 20]].into_iter().enumerate() {
        for (column, frame) in frames.into_iter().enumerate() {
            page.draw([row, column], &tile(frame))?;
        }
    }
    std::fs::write(directory.join("sheet.png"), encode_png(&page.finish())?)?;

    let film: Vec<Image> = (0..FRAMES)
        .map(|index| {
            let mut page = Page::new("", &[("", 1)], Legend::Scale, &camera, &style)?;
            page.draw([0, 0], &tile(index))?;
            Ok(page.finish())
        })
        .collect::<fluvia_render::Result<_>>()?;
    let palette = Palette::of(film.iter().step_by(FRAMES / 5));
    let mut encoder = GifEncoder::new(film[0].width, film[0].height, palette)?;
    for image in &film {
        encoder.push(image, 1.0 / FRAMES as f64)?;
    }
    std::fs::write(directory.join("film.gif"), encoder.finish()?)?;
    Ok(())
}

/// The particles at one time.
struct Moment {
    position: Vec<[f32; 3]>,
    speed: Vec<f32>,
    outside: Vec<bool>,
}

impl Moment {
    fn frame(&self) -> Frame<'_> {
        Frame {
            position: &self.position,
            values: Values::Scalar(&self.speed),
            outside: &self.outside,
            ..Frame::default()
        }
    }
}

/// A travelling wave: columns of water on a lattice, stretched in time with the surface above them.
fn wave(phase: f32, test: &OutsideTest) -> Moment {
    let [columns, layers, rows] = [TANK[0], 0.5, TANK[2]].map(|side| (side / (2.0 * RADIUS)) as usize);
    let (mut position, mut velocity) = (Vec::new(), Vec::new());
    for (i, j, k) in
        (0..columns).flat_map(|i| (0..layers).flat_map(move |j| (0..rows).map(move |k| (i, j, k))))
    {
        let [x, y, z] = [i, j, k].map(|n| (2 * n + 1) as f32 * RADIUS);
        let angle = TAU * (x / TANK[0] + 0.15 * z - phase);
        // A steep crest: waves in shallow water are not sines.
        let lift = 0.35 * (angle.cos() + 0.3 * (2.0 * angle).cos());
        position.push([x, y * (1.0 + lift), z]);
        velocity.push([0.0, y * 0.35 * TAU * (angle.sin() + 0.6 * (2.0 * angle).sin()), 0.0]);
    }
    // One drop has left the tank: it is marked.
    position.push([-0.1, 0.4 * TANK[1], 0.5 * TANK[2]]);
    velocity.push([0.0; 3]);
    let outside = test.mark(&position);
    Moment { speed: speeds(&velocity), position, outside }
}

/// Wall particles on a lattice, and normals into the tank; it is open above.
fn tank() -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let (mut position, mut normal) = (Vec::new(), Vec::new());
    for (axis, side, inwards) in
        [(0, 0.0, 1.0), (0, TANK[0], -1.0), (1, 0.0, 1.0), (2, 0.0, 1.0), (2, TANK[2], -1.0)]
    {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let steps = |axis: usize| (TANK[axis] / (1.5 * RADIUS)) as usize;
        for (i, j) in (0..=steps(u)).flat_map(|i| (0..=steps(v)).map(move |j| (i, j))) {
            let (mut point, mut direction) = ([0.0; 3], [0.0; 3]);
            point[axis] = side;
            point[u] = TANK[u] * i as f32 / steps(u) as f32;
            point[v] = TANK[v] * j as f32 / steps(v) as f32;
            direction[axis] = inwards;
            position.push(point);
            normal.push(direction);
        }
    }
    (position, normal)
}

//! A run that is drawn, and a frame of it with what gives it its colours.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result};
use fluvia_render::{
    Frame, OutsideTest, Rgb, Stage, Surface, Tile, Values, Walls, body_color, heights, speeds,
};
use fluvia_sim::frames::ParticleData;
use fluvia_sim::mesh;
use fluvia_sim::scene::up;

use crate::frame_source::FrameSource;
use crate::surface::{self, reconstruct};

/// What colours show.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Color {
    /// Speed, on a square-root scale.
    Speed,
    /// Height.
    Height,
    /// The fluid of the scene that a particle came from.
    Body,
    /// Nothing: all is the colour of water.
    Water,
}

/// Spheres of water.
const WATER: Rgb = [74, 158, 232];

/// A row or more of a picture, a column of a film.
pub struct Run {
    pub label: String,
    pub path: PathBuf,
    /// The numbers of its frames, in their order.
    pub numbers: Vec<u64>,
    /// Seconds between frames.
    pub dt: f64,
    /// Of a particle, metres.
    pub radius: f32,
    /// Against gravity, a unit vector.
    pub up: [f32; 3],
    pub stage: Stage,
    walls: ParticleData,
    outside: Option<OutsideTest>,
    /// Frames are read by several threads, one after another: of a sequence a part is kept for the next.
    source: Mutex<FrameSource>,
}

impl Run {
    /// Opens `FRAMES` or `LABEL=FRAMES`; `dt` and `radius` count where they are not recorded.
    pub fn open(text: &str, dt: Option<f32>, radius: Option<f32>) -> Result<Run> {
        let (label, mut source) = FrameSource::open_labelled(text, dt)?;
        source.assume_radius(radius);
        let mut opened = Run {
            label,
            path: source.path().to_path_buf(),
            numbers: source.numbers().to_vec(),
            dt: source.dt,
            radius: source.particle_radius,
            up: up(source.gravity),
            stage: Stage::default(),
            walls: source.walls().clone(),
            outside: None,
            source: Mutex::new(source),
        };
        opened.stage = Stage::new(opened.walls());
        if opened.walls.normal.is_some() {
            opened.outside = Some(OutsideTest::new(opened.walls(), opened.radius));
        }
        Ok(opened)
    }

    pub fn walls(&self) -> Walls<'_> {
        Walls { position: &self.walls.position, normal: self.walls.normal.as_deref().unwrap_or_default() }
    }

    /// Reads a frame.
    ///
    /// # Errors
    /// If there is no such frame, or it cannot be read.
    pub fn read(&self, number: u64) -> Result<ParticleData> {
        Ok(self.source.lock().unwrap_or_else(PoisonError::into_inner).read(number)?)
    }

    /// Reads where the particles of a frame are, and what gives them their colours.
    pub fn particles(&self, index: u64, color: Color) -> Result<(Vec<[f32; 3]>, Colors)> {
        let data = self.read(index)?;
        let colors = self.colors(color, &data.position, data.velocity.as_deref(), data.body);
        Ok((data.position, colors))
    }

    /// Reads a frame and makes of it what is drawn; with `surface`, their surface by these parameters.
    pub fn moment(&self, index: u64, color: Color, surface: Option<&surface::Params>) -> Result<Moment> {
        let data = self.read(index)?;
        let outside = self.outside.as_ref().map(|test| test.mark(&data.position)).unwrap_or_default();
        let surface = match surface {
            Some(params) => Some(
                self.surface(&data, &outside, color, params)
                    .with_context(|| format!("{}: frame {index}", self.path.display()))?,
            ),
            None => None,
        };
        let colors = self.colors(color, &data.position, data.velocity.as_deref(), data.body);
        Ok(Moment { index, position: data.position, colors, outside, surface })
    }

    fn colors(
        &self,
        color: Color,
        position: &[[f32; 3]],
        velocity: Option<&[[f32; 3]]>,
        body: Option<Vec<u32>>,
    ) -> Colors {
        match color {
            Color::Speed => velocity.map_or(Colors::None, |velocity| Colors::Scalar(speeds(velocity))),
            Color::Height => Colors::Scalar(heights(position, self.up)),
            Color::Body => body.map_or(Colors::None, Colors::Body),
            Color::Water => Colors::Mixed(vec![WATER; position.len()]),
        }
    }

    /// The surface of the liquid, without the particles that are outside: they are drawn as what they are.
    fn surface(
        &self,
        data: &ParticleData,
        outside: &[bool],
        color: Color,
        params: &surface::Params,
    ) -> Result<Drawn> {
        let inside =
            |i: &usize| outside.get(*i) != Some(&true) && data.position[*i].iter().all(|x| x.is_finite());
        let kept: Vec<usize> = (0..data.position.len()).filter(inside).collect();
        let position: Vec<[f32; 3]> = kept.iter().map(|&i| data.position[i]).collect();
        let velocity: Option<Vec<[f32; 3]>> =
            data.velocity.as_ref().map(|velocity| kept.iter().map(|&i| velocity[i]).collect());
        let mut surface = reconstruct(&position, velocity.as_deref(), self.radius, params)?;
        if let Some(normal) = &self.walls.normal {
            surface::to_walls(&mut surface, &self.walls.position, normal, self.radius);
        }
        let colors = match color {
            Color::Water => Colors::None,
            Color::Body => data.body.as_ref().map_or(Colors::None, |bodies| {
                let bodies: Vec<u32> = kept.iter().map(|&i| bodies[i]).collect();
                let shares = surface::shares(&surface.mesh.positions, &position, self.radius);
                Colors::Mixed(shares.iter().map(|shares| mixed(shares, &bodies)).collect())
            }),
            _ => self.colors(color, &surface.mesh.positions, surface.velocity.as_deref(), None),
        };
        Ok(Drawn { surface, colors })
    }
}

/// What gives particles or vertices their colours.
pub enum Colors {
    None,
    Scalar(Vec<f32>),
    Body(Vec<u32>),
    /// The colours themselves.
    Mixed(Vec<Rgb>),
}

/// The colour of a point that bodies have these shares in.
fn mixed(shares: &[(usize, f32)], bodies: &[u32]) -> Rgb {
    let mut sum = [0.0; 3];
    for &(particle, share) in shares {
        let color = body_color(bodies[particle]);
        (0..3).for_each(|k| sum[k] += share * f32::from(color[k]));
    }
    sum.map(|channel| channel.round() as u8)
}

impl Colors {
    fn values(&self) -> Values<'_> {
        match self {
            Colors::None => Values::None,
            Colors::Scalar(values) => Values::Scalar(values),
            Colors::Body(bodies) => Values::Body(bodies),
            Colors::Mixed(colors) => Values::Color(colors),
        }
    }
}

/// A surface and its colours.
struct Drawn {
    surface: mesh::Surface,
    colors: Colors,
}

/// The particles of one frame and what colours them.
pub struct Moment {
    pub index: u64,
    pub position: Vec<[f32; 3]>,
    pub colors: Colors,
    outside: Vec<bool>,
    surface: Option<Drawn>,
}

impl Moment {
    pub fn frame(&self) -> Frame<'_> {
        let surface = self.surface.as_ref().map(|drawn| Surface {
            position: &drawn.surface.mesh.positions,
            normal: &drawn.surface.normal,
            triangles: &drawn.surface.mesh.triangles,
            values: drawn.colors.values(),
        });
        Frame { position: &self.position, values: self.colors.values(), outside: &self.outside, surface }
    }

    /// The frame with its number and time; `caption` stands before them.
    pub fn tile<'a>(&'a self, run: &'a Run, caption: &str) -> Tile<'a> {
        let comma = if caption.is_empty() { "" } else { ", " };
        Tile {
            frame: self.frame(),
            stage: Some(&run.stage),
            label: format!("{caption}{comma}frame {}", self.index),
            note: format!("{:.2} s", self.index as f64 * run.dt),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_metres_whatever_the_gravity() {
        for (gravity, height) in [([0.0, -9.81, 0.0], 2.0), ([0.0; 3], 2.0), ([0.0, 0.0, -0.5], 3.0)] {
            assert_eq!(heights(&[[1.0, 2.0, 3.0]], up(gravity)), [height]);
        }
    }
}

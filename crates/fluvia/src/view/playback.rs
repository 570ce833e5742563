//! Frames on disk as a show.

use std::path::Path;

use anyhow::{Context, Result, bail};
use fluvia_sim::frames::ParticleData;
use fluvia_sim::scene::up;
use fluvia_view::walls::Walls;
use fluvia_view::{Command, Frame, Mode, Panel, PanelState, State};

use super::densities::WallVolumes;
use super::stage::{Show, blank};
use super::surfaces;
use crate::frame_source::FrameSource;

/// Frames on disk, one of them in memory.
pub struct Playback {
    title: String,
    label: String,
    source: FrameSource,
    walls: Walls,
    volumes: WallVolumes,
    index: usize,
    particles: ParticleData,
    density: Vec<f32>,
    /// As it was in the first frame.
    has_speeds: bool,
    has_bodies: bool,
}

impl Playback {
    /// Opens the directory of a run or a sequence.
    ///
    /// # Errors
    /// If it is none, or its first frame cannot be read.
    pub fn open(path: &Path, dt: Option<f32>) -> Result<Playback> {
        let mut source = FrameSource::open(path, dt)?;
        let first = source.numbers()[0];
        let particles = source.read(first)?;
        let walls = surfaces::of_frames(&source, &particles.position);
        let label = source.record().map_or("stored frames".into(), |record| match &record.weights {
            Some(weights) => format!("{} {}", record.solver, weights.name),
            None => record.solver.clone(),
        });
        Ok(Playback {
            title: path.file_name().map_or(path.as_os_str(), |name| name).display().to_string(),
            label,
            walls,
            volumes: WallVolumes::default(),
            index: 0,
            density: Vec::new(),
            has_speeds: particles.velocity.is_some(),
            has_bodies: particles.body.is_some(),
            particles,
            source,
        })
    }

    fn show(&mut self, index: usize) -> Result<()> {
        if index != self.index {
            let number = *self.source.numbers().get(index).context("no such frame")?;
            self.particles = self.source.read(number)?;
            self.density.clear();
            self.index = index;
        }
        Ok(())
    }

    fn last(&self) -> usize {
        self.source.numbers().len() - 1
    }

    fn number(&self) -> u64 {
        self.source.numbers()[self.index]
    }

    fn find_density(&mut self) {
        let (walls, radius) = (self.source.walls().position.as_slice(), self.source.particle_radius);
        self.density = self.volumes.ratios(&self.particles.position, walls, radius);
    }
}

impl Show for Playback {
    fn walls(&self) -> Walls {
        self.walls.clone()
    }

    fn dt(&self) -> f64 {
        self.source.dt
    }

    fn advance(&mut self, frames: i64) -> Result<()> {
        let index = (self.index as i64).saturating_add(frames).clamp(0, self.last() as i64);
        self.show(index as usize)
    }

    fn can_skip(&self) -> bool {
        true
    }

    fn is_over(&self) -> bool {
        self.index == self.last()
    }

    fn obey(&mut self, command: &Command) -> Result<()> {
        match *command {
            Command::Seek { index } => self.show(index.min(self.last())),
            Command::Reset => self.show(0),
            _ => bail!("frames on disk cannot be changed"),
        }
    }

    fn news(&mut self) -> Option<String> {
        None
    }

    fn frame(&mut self, with_density: bool) -> Frame<'_> {
        if with_density && self.density.len() != self.particles.position.len() {
            self.find_density();
        }
        let panel = Panel {
            position: &self.particles.position,
            velocity: self.particles.velocity.as_deref().unwrap_or_default(),
            density: if with_density { &self.density } else { &[] },
            body: self.particles.body.as_deref().unwrap_or_default(),
            ms_per_step: 0.0,
        };
        let number = self.number();
        let time = number as f64 * self.source.dt;
        Frame { number, index: self.index, time, panels: vec![panel] }
    }

    fn describe(&self) -> State {
        let numbers = self.source.numbers();
        State {
            title: self.title.clone(),
            stored: Some([numbers[0], numbers[self.last()], numbers.len() as u64]),
            dt: self.source.dt,
            particle_radius: self.source.particle_radius,
            up: up(self.source.gravity),
            gravity: self.source.gravity,
            scene_gravity: self.source.gravity,
            has_speeds: self.has_speeds,
            has_bodies: self.has_bodies,
            panels: vec![PanelState { label: self.label.clone(), solver: None, error: None, warning: None }],
            ..blank(Mode::Playback)
        }
    }
}

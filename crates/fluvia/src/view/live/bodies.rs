//! Bodies of fluid that are dropped into a scene that runs, and emitters that are moved.

use std::f64::consts::PI;

use anyhow::{Context, Result, anyhow, bail};
use fluvia_sim::metrics::Bounds;
use fluvia_sim::pour::Ray;
use fluvia_sim::sampling::sample_volume;
use fluvia_sim::scene::{Emitter, Scene, up};
use fluvia_sim::shapes::Shape;
use fluvia_view::{Body, Form};

use super::Live;
use crate::record::decimal;
use crate::view::panel::Panel;

/// What was poured in, as the name of a body.
const POURED: &str = "poured";

/// How far above the place that was pointed at a body begins to fall, metres.
const FALL: f32 = 0.3;

/// The sizes of bodies that can be dropped, metres.
const SIZES: std::ops::RangeInclusive<f32> = 0.1..=2.0;

/// Nothing more is poured into a scene of so many particles: a step would take seconds.
const MOST_PARTICLES: usize = 500_000;

/// What is poured into a scene, as one of its fluids: of the same material as the first of them, so that whatever solver takes
/// the scene takes this too.
pub fn poured(scene: &Scene) -> Emitter {
    Emitter {
        source: POURED.into(),
        path: None,
        position: Vec::new(),
        velocity: Vec::new(),
        unused_velocity: None,
        start: 0,
        stop: 0,
        step: 1,
        material: scene.materials().first().copied().unwrap_or(scene.material),
    }
}

impl Live {
    pub(super) fn drop_body(&mut self, panel: usize, ray: Ray, body: Body) -> Result<()> {
        if !SIZES.contains(&body.size) {
            bail!("a body of {} m, expected {} to {}", body.size, SIZES.start(), SIZES.end());
        }
        let (name, shape) = match body.form {
            Form::Cube => ("cube", Shape::Box),
            Form::Ball => ("ball", Shape::Sphere),
        };
        let fluids: Vec<&[[f32; 3]]> = self.panels.iter().map(Panel::position).collect();
        let most = fluids.iter().map(|fluid| fluid.len()).max().unwrap_or(0);
        // Before they are made: a body may be of millions.
        if most as f64 + particles_in(body, self.setup.particle_radius) > MOST_PARTICLES as f64 {
            bail!("{MOST_PARTICLES} particles are the most that are poured");
        }
        let mesh = shape.mesh().map(|x| x.map(|x| x * decimal(body.size)));
        let particles =
            sample_volume(&mesh, self.setup.particle_radius).map_err(|fault| anyhow!("{name}: {fault}"))?;
        let hit =
            self.room.hit(ray, self.panel(panel)?.position()).context("there is nothing to drop it on")?;
        let place = self.room.place(&particles, hit, up(self.setup.gravity), FALL, &fluids);
        let Some(place) = place else { bail!("no room there for a {name} of {:.2} m", body.size) };
        let particles: Vec<_> = particles.iter().map(|x| [0, 1, 2].map(|a| x[a] + place[a])).collect();
        let poured = self.setup.emitters.len() - 1;
        self.panels.iter_mut().try_for_each(|panel| panel.add(&particles, poured))?;
        self.recorder.note(&format!("a {name} of {} m dropped at {place:?}", body.size), None);
        Ok(())
    }

    pub(super) fn move_emitter(&mut self, index: usize, to: [f32; 3]) -> Result<()> {
        let movable = self.setup.emitters.iter().enumerate().filter(|(_, emitter)| is_movable(emitter));
        let (index, emitter) = movable.clone().nth(index).context("there is no such emitter")?;
        let middle = middle(emitter);
        let by = [0, 1, 2].map(|a| to[a] - middle[a]);
        let moved: Vec<_> = emitter.position.iter().map(|x| [0, 1, 2].map(|a| x[a] + by[a])).collect();
        let others: Vec<&[[f32; 3]]> = movable
            .filter(|(other, _)| *other != index)
            .map(|(_, other)| other.position.as_slice())
            .collect();
        if !moved.iter().flatten().all(|x| x.is_finite()) || !self.room.allows(&moved, &others) {
            bail!("no room there for the emitter");
        }
        self.panels.iter_mut().try_for_each(|panel| panel.rollout.move_emitter(index, by))?;
        self.setup.emitters[index].position = moved;
        let thing = format!("emitter {index} moved");
        self.recorder.note(&format!("{thing} to {to:?}"), Some(&thing));
        Ok(())
    }
}

/// How many particles a body is of, about.
fn particles_in(body: Body, radius: f32) -> f64 {
    let filled = match body.form {
        Form::Cube => 1.0,
        Form::Ball => PI / 6.0,
    };
    filled * (decimal(body.size) / (2.0 * decimal(radius))).powi(3)
}

/// Whether an emitter gives more than once.
pub fn is_movable(emitter: &Emitter) -> bool {
    !emitter.position.is_empty() && emitter.stop > emitter.start.saturating_add(emitter.step)
}

/// The middle of what an emitter gives, metres.
pub fn middle(emitter: &Emitter) -> [f32; 3] {
    let bounds = Bounds::of(&emitter.position);
    bounds.map_or([0.0; 3], |Bounds { low, high }| [0, 1, 2].map(|a| 0.5 * (low[a] + high[a])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn how_many_there_are_is_known_before_they_are_made() {
        for (form, shape) in [(Form::Cube, Shape::Box), (Form::Ball, Shape::Sphere)] {
            let mesh = shape.mesh().map(|x| x.map(|x| x * 0.6));
            let made = sample_volume(&mesh, 0.02).unwrap().len() as f64;
            let found = particles_in(Body { form, size: 0.6 }, 0.02);
            // A layer more or less of fifteen.
            assert!((found / made - 1.0).abs() < 0.15, "{form:?}: {found} and {made}");
        }
        assert!(particles_in(Body { form: Form::Cube, size: 2.0 }, 0.005) > MOST_PARTICLES as f64);
    }
}

//! Random scenes for data sets (Section 5.3, A.2, Fig. 8 and 9 of the paper): one to three bodies of fluid with random
//! shape, size, orientation, place and velocity in a random container.
//!
//! ```text
//! Recipe, seed -> draw a container -> for each body: draw shape, size, orientation -> the lowest free place of a
//!                 random column -> velocity -> Scene
//! ```
//!
//! The particles of a body, as [`Scene::sample`] makes them, keep at least one spacing clear of the walls and of those
//! of the other bodies. A body without such a place is drawn again, then the whole scene is; what was drawn in vain is
//! counted in [`Retries`]. The same recipe and seed give the same scene, on any machine and in any version.

mod draw;
mod drawing;
mod recipes;
mod space;

use std::ops::RangeInclusive;
use std::path::PathBuf;

use super::{Fluid, Material, Placement, Scene, Source, Wall};
use crate::mesh::TriangleMesh;
use crate::shapes::Shape;
use crate::{Error, Result};
use drawing::{Body, Drawing};
pub use recipes::{BODIES, CONTAINERS, MATERIAL_TEST_VISCOSITIES};

/// The scenes that are drawn with a number of bodies before that is drawn again: it stays uniform where it can.
const SCENES_TRIED: u32 = 50;

/// A built-in shape in a size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// The shape, of size 1.
    pub shape: Shape,
    /// Its size along each axis, metres.
    pub size: [f32; 3],
}

impl Model {
    /// Its surface.
    pub fn mesh(&self) -> TriangleMesh {
        let placement = Placement { scale: self.size, ..Placement::default() };
        self.shape.mesh().map(placement.turn())
    }
}

/// How a body is turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orientation {
    /// Not at all.
    Upright,
    /// All rotations are equally likely.
    Any,
}

/// How fast a body is at the beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Speed {
    /// Along each axis uniform up to the highest, either way.
    Uniform,
    /// Along each axis the highest, either way: the hardest case for a solver.
    Highest,
}

/// The viscosity of a scene.
#[derive(Clone, Debug, PartialEq)]
pub enum Viscosity {
    /// The scene says nothing.
    Unset,
    /// Always the same.
    Fixed(f32),
    /// Uniform in a range, one for all bodies of a scene.
    Uniform(RangeInclusive<f32>),
}

/// What scenes are drawn from.
#[derive(Clone, Debug, PartialEq)]
pub struct Recipe {
    /// The containers, all equally likely; closed, with faces that look away from the fluid.
    pub containers: Vec<Model>,
    /// The bodies, all equally likely.
    pub bodies: Vec<Model>,
    /// How many bodies a scene has, uniform.
    pub body_count: RangeInclusive<u32>,
    /// The factor on the size of a body, uniform.
    pub scale: RangeInclusive<f32>,
    /// How bodies are turned.
    pub orientation: Orientation,
    /// How far from the lowest x and z that it can have a body may be put, metres; infinite for the whole container.
    pub reach: [f32; 2],
    /// The highest initial speed along each axis, metres per second.
    pub velocity: [f32; 3],
    /// How much of it bodies have.
    pub speed: Speed,
    /// The viscosity coefficient of Bender & Koschier 2017.
    pub viscosity: Viscosity,
    /// Rest density, kilograms per cubic metre; `None` if the scene says nothing.
    pub density: Option<f32>,
    /// How many fluid particles a scene has.
    pub particles: RangeInclusive<usize>,
    /// Gravity, metres per second squared.
    pub gravity: [f32; 3],
    /// Seconds between frames.
    pub dt: f32,
    /// The length of a sequence, seconds.
    pub duration: f32,
}

/// What was drawn in vain for a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retries {
    /// Columns without a free place for a body.
    pub columns: u32,
    /// Bodies that were drawn again: without a place in any column tried, with too few particles, or without a size
    /// that has the number needed.
    pub bodies: u32,
    /// Scenes that were drawn again: with too few or too many particles, or without a place for one of their bodies.
    pub scenes: u32,
}

/// A scene, and what it took to draw it.
#[derive(Clone, Debug, PartialEq)]
pub struct RandomScene {
    /// The scene; [`Scene::to_json`] makes a scene file of it.
    pub scene: Scene,
    /// The number of fluid particles that it has.
    pub particles: usize,
    /// What was drawn in vain.
    pub retries: Retries,
}

/// Draws a scene. The same recipe and seed give the same.
///
/// # Errors
/// `Parameter` if the recipe is none (an empty list or range, a size or a viscosity that is no such), or if no scene
/// was found in a thousand draws.
pub fn random_scene(recipe: &Recipe, seed: u64) -> Result<RandomScene> {
    recipe.check()?;
    let mut drawing = Drawing::new(recipe, seed);
    // First, so that scenes of recipes that differ in the viscosity alone do too.
    let viscosity = match &recipe.viscosity {
        Viscosity::Unset => None,
        Viscosity::Fixed(viscosity) => Some(*viscosity),
        Viscosity::Uniform(range) => Some(drawing.between(range)),
    };
    let mut count = 0;
    loop {
        if drawing.retries.scenes.is_multiple_of(SCENES_TRIED) {
            let (low, high) = (*recipe.body_count.start(), *recipe.body_count.end());
            count = low + draw::index(&mut drawing.random, (high - low) as usize + 1) as u32;
        }
        if let Some((container, bodies)) = drawing.scene(count)? {
            let material = Material { viscosity, density: recipe.density };
            let particles = bodies.iter().map(|body| body.particles.len()).sum();
            let scene = recipe.scene(container, bodies, material, seed);
            return Ok(RandomScene { scene, particles, retries: drawing.retries });
        }
        drawing.retries.scenes += 1;
    }
}

impl Recipe {
    fn check(&self) -> Result<()> {
        let is_size = |size: &f32| size.is_finite() && *size > 0.0;
        let models = || self.containers.iter().chain(&self.bodies);
        let is_coefficient = |x: &f32| x.is_finite() && *x >= 0.0;
        let viscosity = match &self.viscosity {
            Viscosity::Unset => true,
            Viscosity::Fixed(viscosity) => is_coefficient(viscosity),
            Viscosity::Uniform(range) => {
                is_coefficient(range.start()) && range.end().is_finite() && !range.is_empty()
            }
        };
        let rules = [
            (!self.containers.is_empty(), "containers: none, expected at least one"),
            (!self.bodies.is_empty(), "bodies: none, expected at least one"),
            (models().all(|model| model.size.iter().all(is_size)), "sizes: expected positive numbers"),
            (*self.body_count.start() > 0 && !self.body_count.is_empty(), "body_count: expected 1 or more"),
            (
                is_size(self.scale.start()) && self.scale.end().is_finite() && !self.scale.is_empty(),
                "scale: expected a range of positive numbers",
            ),
            (self.reach.iter().all(|x| *x >= 0.0), "reach: expected numbers that are not negative"),
            (self.velocity.iter().all(is_coefficient), "velocity: expected numbers that are not negative"),
            (viscosity, "viscosity: expected numbers that are not negative"),
            (self.density.as_ref().is_none_or(is_size), "density: expected a positive number"),
            (
                *self.particles.start() > 0 && !self.particles.is_empty(),
                "particles: expected a range of 1 or more",
            ),
            (self.gravity.iter().all(|x| x.is_finite()), "gravity: expected finite numbers"),
            (is_size(&self.dt) && is_size(&self.duration), "dt, duration: expected positive numbers"),
        ];
        match rules.iter().find(|rule| !rule.0) {
            Some((_, message)) => Err(Error::Parameter(format!("recipe: {message}"))),
            None => Ok(()),
        }
    }

    fn scene(&self, container: Model, bodies: Vec<Body>, material: Material, seed: u64) -> Scene {
        let fluid = |body: Body| Fluid {
            source: Source::Shape(body.shape),
            placement: body.placement,
            velocity: Some(body.velocity),
            start: 0,
            stop: 1,
            step: 1,
            material: Material::default(),
        };
        let wall = Wall {
            source: Source::Shape(container.shape),
            placement: Placement { scale: container.size, ..Placement::default() },
            invert_normals: false,
        };
        Scene {
            path: PathBuf::from(format!("random scene {seed}")),
            walls: vec![wall],
            fluids: bodies.into_iter().map(fluid).collect(),
            gravity: Some(self.gravity),
            dt: Some(self.dt),
            particle_radius: None,
            material,
        }
    }
}

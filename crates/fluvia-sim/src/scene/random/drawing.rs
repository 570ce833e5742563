//! How a scene is drawn: container, bodies, places; what is in vain is counted and drawn again.

use std::ops::RangeInclusive;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;

use super::space::Space;
use super::{Model, Orientation, Recipe, Retries, Speed, draw};
use crate::sampling::sample_volume;
use crate::scene::{DEFAULT_PARTICLE_RADIUS, Placement};
use crate::shapes::Shape;
use crate::{Error, Result};

/// Bodies with fewer particles are drawn again: a splash more than a body. The smallest of the recipes have about 190.
const LEAST_OF_A_BODY: usize = 100;
/// The columns that are tried for a body before it is drawn again.
const COLUMNS_TRIED: usize = 8;
/// The times that a body is drawn for a scene before the scene is drawn again; as in the published script.
const BODIES_TRIED: usize = 10;
/// The scenes and bodies that are drawn before a recipe is given up, some seconds. The recipes of the paper need about
/// ten at most.
const MOST_DRAWN: u32 = 1000;
/// A range of particle counts narrower than this part of its end is met by the size of the last body: scenes drawn
/// until one has exactly 6,000 particles would be some thousands.
const NARROW: f64 = 0.1;
/// The halvings of a range of sizes until it is [`FINEST`].
const HALVINGS: u32 = 20;
/// Sizes that are nearer than this are the same.
const FINEST: f64 = 1e-6;
/// The part by which the size that a body needs may differ from what its volume says.
const SIZE_ERROR: f64 = 0.1;

/// A body on its way to its place.
pub(super) struct Body {
    pub shape: Shape,
    pub placement: Placement,
    pub velocity: [f32; 3],
    /// Its particles where it is put.
    pub particles: Vec<[f32; 3]>,
}

impl Body {
    /// At the origin.
    fn new(shape: Shape, placement: Placement) -> Body {
        // What cannot be sampled has no particles, and is drawn again as what has too few.
        let mesh = shape.mesh().map(placement.turn());
        let particles = sample_volume(&mesh, DEFAULT_PARTICLE_RADIUS).unwrap_or_default();
        Body { shape, placement, velocity: [0.0; 3], particles }
    }
}

/// What is drawn for one scene.
pub(super) struct Drawing<'a> {
    recipe: &'a Recipe,
    pub random: Pcg64,
    /// Of each container, once it was drawn.
    spaces: Vec<Option<Space>>,
    pub retries: Retries,
    /// Scenes and bodies drawn so far.
    drawn: u32,
}

impl<'a> Drawing<'a> {
    pub(super) fn new(recipe: &'a Recipe, seed: u64) -> Drawing<'a> {
        Drawing {
            recipe,
            random: Pcg64::seed_from_u64(seed),
            spaces: vec![None; recipe.containers.len()],
            retries: Retries::default(),
            drawn: 0,
        }
    }

    /// Uniform in the range.
    pub(super) fn between(&mut self, range: &RangeInclusive<f32>) -> f32 {
        draw::between(&mut self.random, *range.start(), *range.end())
    }

    /// A container with `count` bodies; `None` if one of them found no place, or the particles are too few or many.
    pub(super) fn scene(&mut self, count: u32) -> Result<Option<(Model, Vec<Body>)>> {
        self.count_draw()?;
        let recipe = self.recipe;
        let (least, most) = (*recipe.particles.start(), *recipe.particles.end());
        let is_narrow = ((most - least) as f64) < NARROW * most as f64;
        let index = draw::index(&mut self.random, recipe.containers.len());
        let mut space = self.space(index);
        let (mut bodies, mut total) = (Vec::new(), 0);
        for k in 0..count {
            let is_last = k + 1 == count;
            let wanted = (is_narrow && is_last).then(|| least.saturating_sub(total)..=most - total);
            if wanted.as_ref().is_some_and(|wanted| *wanted.end() < LEAST_OF_A_BODY) {
                return Ok(None);
            }
            let Some(body) = self.body(&mut space, wanted)? else { return Ok(None) };
            total += body.particles.len();
            if total > most {
                return Ok(None);
            }
            bodies.push(body);
        }
        Ok((total >= least).then_some((recipe.containers[index], bodies)))
    }

    /// The free space of an empty container.
    fn space(&mut self, index: usize) -> Space {
        let model = self.recipe.containers[index];
        let space =
            self.spaces[index].get_or_insert_with(|| Space::inside(&model.mesh(), DEFAULT_PARTICLE_RADIUS));
        space.clone()
    }

    /// A body in its place, which is taken from the space; with as many particles as `wanted` if that is given.
    fn body(&mut self, space: &mut Space, wanted: Option<RangeInclusive<usize>>) -> Result<Option<Body>> {
        for _ in 0..BODIES_TRIED {
            self.count_draw()?;
            let body = self.shaped_body(wanted.as_ref());
            let body = body.filter(|body| body.particles.len() >= LEAST_OF_A_BODY);
            if let Some(body) = body.and_then(|body| self.placed(body, space)) {
                space.take(&body.particles);
                return Ok(Some(body));
            }
            self.retries.bodies += 1;
        }
        Ok(None)
    }

    fn count_draw(&mut self) -> Result<()> {
        self.drawn += 1;
        if self.drawn <= MOST_DRAWN {
            return Ok(());
        }
        let (least, most) = (self.recipe.particles.start(), self.recipe.particles.end());
        Err(Error::Parameter(format!(
            "no random scene with {least} to {most} fluid particles in {MOST_DRAWN} draws: the bodies do not fit the \
             number, or the containers"
        )))
    }

    /// A body of random shape, size and orientation, at the origin; `None` if no size has the wanted number of
    /// particles.
    fn shaped_body(&mut self, wanted: Option<&RangeInclusive<usize>>) -> Option<Body> {
        let recipe = self.recipe;
        let model = recipe.bodies[draw::index(&mut self.random, recipe.bodies.len())];
        let scale = self.between(&recipe.scale);
        let rotation = match recipe.orientation {
            Orientation::Upright => None,
            Orientation::Any => Some(draw::rotation(&mut self.random)),
        };
        let of_size = |scale: f32| {
            let scale = model.size.map(|size| scale * size);
            Body::new(model.shape, Placement { scale, rotation, translation: [0.0; 3] })
        };
        match wanted {
            None => Some(of_size(scale)),
            Some(wanted) => {
                let cell = (2.0 * f64::from(DEFAULT_PARTICLE_RADIUS)).powi(3);
                body_of_count(of_size, model.mesh().volume() / cell, wanted, &recipe.scale)
            }
        }
    }

    /// The body at the lowest free place of a random column, with a random velocity.
    fn placed(&mut self, mut body: Body, space: &Space) -> Option<Body> {
        let range = [0, 2].map(|k| {
            let lowest = body.particles.iter().map(|x| x[k]).fold(f32::INFINITY, f32::min);
            let highest = body.particles.iter().map(|x| x[k]).fold(f32::NEG_INFINITY, f32::max);
            let [start, end] = [space.low[k] as f32 - lowest, space.high[k] as f32 - highest];
            [start, end.min(start + self.recipe.reach[k / 2])]
        });
        if range.iter().any(|[start, end]| start > end) {
            return None;
        }
        for _ in 0..COLUMNS_TRIED {
            let [x, z] = range.map(|[start, end]| draw::between(&mut self.random, start, end));
            if let Some(y) = space.lowest_place(&body.particles, [x, z]) {
                body.placement.translation = [x, y, z];
                let placement = body.placement;
                body.particles.iter_mut().for_each(|x| *x = placement.translate(*x));
                body.velocity = self.velocity();
                return Some(body);
            }
            self.retries.columns += 1;
        }
        None
    }

    fn velocity(&mut self) -> [f32; 3] {
        let (highest, speed) = (self.recipe.velocity, self.recipe.speed);
        highest.map(|highest| match speed {
            Speed::Uniform => draw::between(&mut self.random, -highest, highest),
            Speed::Highest => draw::sign(&mut self.random) * highest,
        })
    }
}

/// The body in a size in which it has as many particles as `wanted`; size 1 has room for `particles_of_unit`. The
/// particles of a body grow with its size, but not one by one: in some orientations no size has the number.
fn body_of_count(
    of_size: impl Fn(f32) -> Body,
    particles_of_unit: f64,
    wanted: &RangeInclusive<usize>,
    scale: &RangeInclusive<f32>,
) -> Option<Body> {
    let middle = 0.5 * (*wanted.start() as f64 + *wanted.end() as f64);
    let estimate = (middle / particles_of_unit).cbrt();
    let mut low = ((1.0 - SIZE_ERROR) * estimate).max(f64::from(*scale.start()));
    let mut high = ((1.0 + SIZE_ERROR) * estimate).min(f64::from(*scale.end()));
    if low > high {
        return None;
    }
    for _ in 0..HALVINGS {
        let size = draw::fine(0.5 * (low + high));
        let body = of_size(size);
        let count = body.particles.len();
        if wanted.contains(&count) {
            return Some(body);
        }
        if count < *wanted.start() {
            low = size.into();
        } else {
            high = size.into();
        }
        if high - low < FINEST {
            break;
        }
    }
    None
}

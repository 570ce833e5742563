//! From what is seen to colours: walls, spheres and water in the light of one lamp and a sky.
//!
//! Light and colours are linear and of the order of 1; the picture's bytes are sRGB. With the colour c of a thing, its
//! normal n, the lamp's direction L, the part s of the sky that it sees and the part l of the lamp that reaches it:
//!
//! ```text
//! wall      c (A(n) s + K l max(0, n·L))
//! sphere    the same, with a highlight
//! water     (1 - F) (B T (1 - m) + c (A(n) s + K l w(n·L)) m) + F R(n)
//! ```
//!
//! A is the light of sky and ground, K the lamp's. Of water F is Fresnel's reflection after Schlick, B what is seen
//! through it, displaced by refraction, T and m what it absorbs and scatters on the way through it, R the sky that it
//! mirrors and w the lamp's light that goes round its edges.

use crate::color::{WALL_COLOR, linear};
use crate::light::Lit;
use crate::vector::{Vec3, add, dot, mix, scaled, smoothstep, sub, unit};

/// Light and directions that are the same for a whole picture.
#[derive(Clone, Copy)]
pub(crate) struct Light {
    pub lamp: Vec3,
    pub up: Vec3,
    /// The colour of the liquid's shadow: the mean of its surface.
    pub tint: Vec3,
    /// Radius of a particle, metres: ways through water are measured in it, so that a picture does not depend on the scale.
    pub radius: f32,
}

/// What reaches a point.
#[derive(Clone, Copy)]
pub(crate) struct Reach {
    /// The part of the sky that it sees.
    pub sky: f32,
    pub lamp: Lit,
}

/// Light of the sky from above and of the ground from below.
const SKY: Vec3 = [0.50, 0.55, 0.62];
const GROUND: Vec3 = [0.16, 0.17, 0.19];
/// Light that finds its way to what sees no sky.
const LEAST_SKY: f32 = 0.10;
/// The lamp's light.
const KEY: Vec3 = [0.92, 0.88, 0.80];

/// What a liquid takes of the light of its own colour, and what more of that which its colour lacks, a particle radius.
const ABSORB: [f32; 2] = [0.010, 0.105];
/// What water scatters, a particle radius.
const SCATTER: f32 = 0.035;
/// The least part of the lamp that goes through a liquid: light that is scattered on, and that of its own colour more.
const LEAST_THROUGH: [f32; 2] = [0.20, 0.30];
/// Water without values: the colour of deep water.
pub(crate) const WATER: Vec3 = [0.022, 0.245, 0.44];
/// Reflection of water seen straight on.
const FRESNEL: f32 = 0.02;
/// The least cosine between what is seen of water and the way to the eye.
const LEAST_FACING: f32 = 0.06;
/// How much water displaces what is behind it: 1 - 1 / 1.33.
const REFRACTION: f32 = 0.25;

impl Light {
    /// The light of sky and ground on a surface.
    fn ambient(&self, normal: Vec3, sky: f32) -> Vec3 {
        let half = 0.5 + 0.5 * dot(normal, self.up);
        let seen = LEAST_SKY + (1.0 - LEAST_SKY) * sky;
        scaled(mix(GROUND, SKY, half), seen)
    }

    /// The lamp's light that reaches a point, past walls and through the liquid.
    fn key(&self, lit: Lit) -> Vec3 {
        let through = match lit.way.is_finite() {
            true => self.through(lit.way),
            false => [0.0; 3],
        };
        std::array::from_fn(|k| KEY[k] * lit.past_walls * (1.0 - lit.covered * (1.0 - through[k])))
    }

    /// The part of the light that comes through water, straight or scattered on.
    fn through(&self, way: f32) -> Vec3 {
        let own = own_part(self.tint);
        std::array::from_fn(|k| {
            let straight = (-(absorbed(own[k]) + SCATTER) * way / self.radius).exp();
            let least = LEAST_THROUGH[0] + LEAST_THROUGH[1] * own[k];
            least + (1.0 - least) * straight
        })
    }

    pub fn wall(&self, normal: Vec3, corner: f32, reach: Reach) -> Vec3 {
        let lamp = scaled(self.key(reach.lamp), dot(normal, self.lamp).max(0.0));
        let light = add(scaled(self.ambient(normal, reach.sky), corner), scaled(lamp, 0.5 + 0.5 * corner));
        product(linear(WALL_COLOR), light)
    }

    pub fn sphere(&self, color: Vec3, normal: Vec3, view: Vec3, reach: Reach) -> Vec3 {
        let lit = dot(normal, self.lamp).max(0.0);
        let lamp = self.key(reach.lamp);
        let light = add(self.ambient(normal, reach.sky), scaled(lamp, lit));
        let half = unit(add(self.lamp, view));
        let highlight = SPHERE_HIGHLIGHT * dot(normal, half).max(0.0).powi(40);
        add(product(color, light), scaled(lamp, highlight))
    }

    /// Water of a colour, `way` metres thick, before `behind`.
    pub fn water(&self, color: Vec3, normal: Vec3, view: Vec3, way: f32, behind: Vec3, reach: Reach) -> Vec3 {
        // A smoothed normal may look away from the eye, as no surface that is seen does: it is bent back.
        let short = LEAST_FACING - dot(normal, view);
        let normal = if short > 0.0 { unit(add(normal, scaled(view, short))) } else { normal };
        let facing = dot(normal, view).clamp(0.0, 1.0);
        let fresnel = FRESNEL + (1.0 - FRESNEL) * (1.0 - facing).powi(5);
        let radii = way / self.radius;
        let scattered = 1.0 - (-SCATTER * radii).exp();
        let clear = own_part(color).map(|own| (-absorbed(own) * radii).exp());
        let lamp = self.key(reach.lamp);
        // Light goes round edges in water: some reaches what is turned away from the lamp.
        let lit = (0.35 + 0.65 * dot(normal, self.lamp)).max(0.0);
        let light = add(self.ambient(normal, reach.sky), scaled(lamp, lit));
        let body = scaled(product(color, light), scattered);
        let inside = add(scaled(product(behind, clear), 1.0 - scattered), body);
        let mirrored = sub(scaled(normal, 2.0 * dot(normal, view)), view);
        let mirror = scaled(self.environment(mirrored), 0.25 + 0.75 * reach.sky);
        let half = unit(add(self.lamp, view));
        let shine = dot(normal, half).max(0.0);
        let highlight = WATER_HIGHLIGHT * shine.powi(260) + WATER_GLOSS * shine.powi(30);
        add(mix(inside, mirror, fresnel), scaled(lamp, highlight))
    }

    /// How far water displaces what is behind it, metres to the right and up, of a normal in the camera's axes.
    pub fn displacement(&self, right: f32, up: f32, way: f32) -> [f32; 2] {
        // A ray through much water ends in the water.
        let way = way.min(MOST_DISPLACING * self.radius);
        [-REFRACTION * right * way, -REFRACTION * up * way]
    }

    /// What water mirrors: a room with a bright ceiling, and a soft box around the lamp.
    fn environment(&self, direction: Vec3) -> Vec3 {
        let height = dot(direction, self.up);
        let sky = mix(HORIZON, CEILING, smoothstep(-0.1, 0.9, height));
        let around = mix(FLOOR, sky, smoothstep(-0.35, 0.05, height));
        let toward = dot(direction, self.lamp);
        let lamp = SOFT_BOX * smoothstep(0.80, 0.96, toward);
        // A second, faint one on the other side draws the edges that are turned away from the lamp.
        let other = dot(sub(direction, scaled(self.up, 2.0 * height)), self.lamp);
        let rim = RIM * smoothstep(0.55, 0.95, -other) * smoothstep(-0.1, 0.3, height);
        add(around, scaled(KEY, lamp + rim))
    }
}

/// The highlight of a sphere and of water in the lamp's light.
const SPHERE_HIGHLIGHT: f32 = 0.22;
const WATER_HIGHLIGHT: f32 = 0.9;
/// A wider, fainter one: ripples that are too small for the surface.
const WATER_GLOSS: f32 = 0.07;
/// The way through water that displaces most, particle radii.
const MOST_DISPLACING: f32 = 12.0;
/// What water mirrors.
const FLOOR: Vec3 = [0.10, 0.12, 0.15];
const HORIZON: Vec3 = [0.20, 0.26, 0.34];
const CEILING: Vec3 = [0.62, 0.70, 0.80];
const SOFT_BOX: f32 = 1.5;
const RIM: f32 = 0.5;

/// How much of each channel is in a colour, in parts of the strongest.
fn own_part(color: Vec3) -> Vec3 {
    let most = color.into_iter().fold(f32::MIN_POSITIVE, f32::max);
    color.map(|channel| channel / most)
}

/// What a liquid takes of a channel that has a part in its colour, a particle radius.
fn absorbed(own: f32) -> f32 {
    ABSORB[0] + ABSORB[1] * (1.0 - own)
}

/// The product of each channel.
pub(crate) fn product(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

//! The data sets of the paper as recipes, with containers and bodies of our own.

use super::{Model, Orientation, Recipe, Speed, Viscosity};
use crate::scene::{DEFAULT_DT, DEFAULT_GRAVITY};
use crate::shapes::Shape;

/// The size of the published containers, metres.
const BOX: [f32; 3] = [2.0, 4.0, 2.0];
/// The size of the published round container, metres.
const TANK: [f32; 3] = [2.4, 4.0, 2.4];

/// The containers, in the manner of Fig. 8; the first is the plain box of the published 2 x 4 x 2 m. Six are not convex.
pub const CONTAINERS: [Model; 10] = [
    Model { shape: Shape::Container, size: BOX },
    Model { shape: Shape::Tank, size: TANK },
    Model { shape: Shape::Wedge, size: BOX },
    Model { shape: Shape::Trough, size: BOX },
    Model { shape: Shape::Ditch, size: BOX },
    Model { shape: Shape::Stairs, size: BOX },
    Model { shape: Shape::Ridge, size: BOX },
    Model { shape: Shape::Waves, size: BOX },
    Model { shape: Shape::Hill, size: BOX },
    Model { shape: Shape::Post, size: BOX },
];

/// The bodies, in the manner of Fig. 9. Three are not convex.
pub const BODIES: [Model; 5] = [
    Model { shape: Shape::Box, size: [1.0; 3] },
    Model { shape: Shape::Egg, size: [1.0; 3] },
    Model { shape: Shape::Elbow, size: [1.0; 3] },
    Model { shape: Shape::Horseshoe, size: [1.0; 3] },
    Model { shape: Shape::Jack, size: [1.0; 3] },
];

/// The viscosities of Table 3.
pub const MATERIAL_TEST_VISCOSITIES: [f32; 7] = [0.044, 0.127, 0.174, 0.233, 0.269, 0.350, 0.400];

/// The viscosity of the published data sets without a viscosity of their own.
const VISCOSITY: f32 = 0.01;
/// Rest density of the published data sets, kilograms per cubic metre.
const DENSITY: f32 = 1000.0;
/// The highest initial speeds of the published data sets, metres per second.
const VELOCITY: [f32; 3] = [2.0, 0.5, 2.0];
/// The particles of default scenes. The published script has no limits; its data, 34 GB where the same number of
/// scenes of 6,000 particles takes 23 GB, have about 8,900 particles a scene.
const DEFAULT_PARTICLES: std::ops::RangeInclusive<usize> = 1_000..=20_000;
/// The particles of the simplified data set.
const BOX_PARTICLES: usize = 6_000;

/// What the published dam breaks were scaled by: their particles are 0.055 m apart, ours 0.05 m.
const DAM_BREAK_SCALE: f32 = 1.1;
/// The particles of their block along each axis, and their number.
const DAM_BREAK_BLOCK: [f32; 3] = [12.0, 24.0, 12.0];
/// How far from the low sides of their box the block may be, in their metres.
const DAM_BREAK_REACH: f32 = 0.15;
const DAM_BREAK_PARTICLES: usize = 12 * 24 * 12;

impl Recipe {
    /// The paper's main data set: one to three bodies in one of ten containers, 16 s.
    pub fn default_scenes() -> Recipe {
        Recipe {
            containers: CONTAINERS.to_vec(),
            bodies: BODIES.to_vec(),
            body_count: 1..=3,
            scale: 0.5..=1.5,
            orientation: Orientation::Any,
            reach: [f32::INFINITY; 2],
            velocity: VELOCITY,
            speed: Speed::Uniform,
            viscosity: Viscosity::Fixed(VISCOSITY),
            density: Some(DENSITY),
            particles: DEFAULT_PARTICLES,
            gravity: DEFAULT_GRAVITY,
            dt: DEFAULT_DT,
            duration: 16.0,
        }
    }

    /// The simplified data set of Table 1: the plain box, always 6,000 particles.
    pub fn box_6k() -> Recipe {
        Recipe {
            containers: vec![CONTAINERS[0]],
            particles: BOX_PARTICLES..=BOX_PARTICLES,
            ..Recipe::default_scenes()
        }
    }

    /// Default scenes with a viscosity between 0.01 and 0.3.
    pub fn viscosity() -> Recipe {
        Recipe { viscosity: Viscosity::Uniform(0.01..=0.3), ..Recipe::default_scenes() }
    }

    /// The dam break of Li et al. (2019): a block of 12 x 24 x 12 particles at rest in a box, at a random place; for
    /// position-based fluids. What they made at a spacing of 0.055 m is scaled to ours, gravity too.
    pub fn dam_break() -> Recipe {
        let spacing = 0.05;
        // Their particles' centres have 1.6 x 0.8 m; ours rest half a spacing from the walls. Theirs is open above.
        let room = [1.6, 0.8].map(|length| length / DAM_BREAK_SCALE + spacing);
        Recipe {
            containers: vec![Model { shape: Shape::Container, size: [room[0], 2.5, room[1]] }],
            bodies: vec![Model { shape: Shape::Box, size: DAM_BREAK_BLOCK.map(|count| count * spacing) }],
            body_count: 1..=1,
            scale: 1.0..=1.0,
            orientation: Orientation::Upright,
            reach: [DAM_BREAK_REACH / DAM_BREAK_SCALE; 2],
            velocity: [0.0; 3],
            viscosity: Viscosity::Unset,
            density: None,
            particles: DAM_BREAK_PARTICLES..=DAM_BREAK_PARTICLES,
            gravity: DEFAULT_GRAVITY.map(|g| g / DAM_BREAK_SCALE),
            dt: 1.0 / 60.0,
            duration: 2.5,
            ..Recipe::default_scenes()
        }
    }

    /// Table 3: the box with a cone, a shape that no other recipe has. With the same seed, scenes of different
    /// viscosities have nothing else that differs.
    pub fn material_test(viscosity: f32) -> Recipe {
        Recipe {
            containers: vec![CONTAINERS[0]],
            bodies: vec![Model { shape: Shape::Cone, size: [1.0; 3] }],
            body_count: 1..=1,
            scale: 1.2..=1.4,
            viscosity: Viscosity::Fixed(viscosity),
            duration: 2.0,
            ..Recipe::default_scenes()
        }
    }
}

//! What is measured of every frame of a run.

use std::path::Path;

use fluvia_sim::metrics::{self, Bounds};
use serde::Serialize;

use crate::record::decimal;

/// A particle is dense above this part of rest density.
const DENSE: f32 = 1.05;

/// The width of the columns in which the surface is looked for, particle radii: 0.1 m for the usual one.
const COLUMN: f32 = 4.0;

/// One number a frame; `None` where a frame has no particles.
pub type Curve = Vec<Option<f64>>;

/// The curves of a run.
#[derive(Serialize)]
pub struct Curves {
    pub label: String,
    pub path: String,
    pub particles: Vec<usize>,
    /// The mean of |v|² / 2.
    pub kinetic_energy_j_per_kg: Curve,
    /// The mean of -g · x.
    pub potential_energy_j_per_kg: Curve,
    pub center_of_mass_m: Vec<Option<[f64; 3]>>,
    /// The mean velocity.
    pub momentum_m_per_s: Vec<Option<[f64; 3]>>,
    /// The mean of |v|.
    pub mean_speed_m_per_s: Curve,
    /// The root mean square horizontal distance from the centre of mass.
    pub spread_m: Curve,
    /// The median over columns of the highest particle in each.
    pub surface_height_m: Curve,
    /// Particles more than a radius beyond the walls' bounding box; 0 without walls.
    pub outside: Vec<usize>,
    /// The highest density over rest density, of the fluid alone.
    pub highest_density: Curve,
    /// Particles above 1.05.
    pub dense_particles: Vec<usize>,
    /// The distance to the nearest other particle: the median and the smallest.
    pub nearest_median_m: Curve,
    pub nearest_smallest_m: Curve,
    #[serde(skip)]
    scene: Surroundings,
}

/// What is known of the scene of a run.
#[derive(Clone, Copy, Default)]
pub struct Surroundings {
    /// The walls' bounding box, if there are walls.
    pub walls: Option<Bounds>,
    /// Metres.
    pub particle_radius: f32,
    /// Metres per second squared.
    pub gravity: [f32; 3],
}

impl Curves {
    pub fn new(label: &str, path: &Path, scene: Surroundings) -> Curves {
        Curves {
            label: label.to_owned(),
            path: path.display().to_string(),
            particles: Vec::new(),
            kinetic_energy_j_per_kg: Vec::new(),
            potential_energy_j_per_kg: Vec::new(),
            center_of_mass_m: Vec::new(),
            momentum_m_per_s: Vec::new(),
            mean_speed_m_per_s: Vec::new(),
            spread_m: Vec::new(),
            surface_height_m: Vec::new(),
            outside: Vec::new(),
            highest_density: Vec::new(),
            dense_particles: Vec::new(),
            nearest_median_m: Vec::new(),
            nearest_smallest_m: Vec::new(),
            scene,
        }
    }

    /// Adds a frame.
    pub fn measure(&mut self, position: &[[f32; 3]], velocity: &[[f32; 3]]) {
        let Surroundings { walls, particle_radius: radius, gravity } = self.scene;
        let some = |value: f64| (!position.is_empty()).then_some(value);
        let density = metrics::density_ratios(position, &[], radius);
        let nearest = metrics::nearest_distances(position, radius);
        let smallest = nearest.iter().copied().reduce(f32::min);
        let finite = |value: Option<f32>| value.filter(|value| value.is_finite()).map(decimal);
        self.particles.push(position.len());
        self.kinetic_energy_j_per_kg.push(some(metrics::kinetic_energy(velocity)));
        self.potential_energy_j_per_kg.push(some(metrics::potential_energy(position, gravity)));
        self.center_of_mass_m.push(metrics::mean_vector(position));
        self.momentum_m_per_s.push(metrics::mean_vector(velocity));
        self.mean_speed_m_per_s.push(some(metrics::mean_speed(velocity)));
        self.spread_m.push(metrics::spread(position));
        self.surface_height_m.push(metrics::surface_height(position, COLUMN * radius).map(decimal));
        self.outside.push(walls.map_or(0, |walls| metrics::outside(position, &walls, radius)));
        self.dense_particles.push(density.iter().filter(|&&ratio| ratio > DENSE).count());
        self.highest_density.push(density.into_iter().reduce(f32::max).map(decimal));
        self.nearest_median_m.push(finite(metrics::median(nearest)));
        self.nearest_smallest_m.push(finite(smallest));
    }

    /// The height of the centre of mass, metres.
    pub fn height(&self) -> Curve {
        self.center_of_mass_m.iter().map(|center| center.map(|center| center[1])).collect()
    }
}

//! Who is near whom within the support of the kernel of SPH: what density and walls ask for in a loss.

use fluvia_neighbors::{Grids, Neighbors, Options, Point, Radius};
use fluvia_sim::kernel::{CubicSpline, SUPPORT_IN_RADII, wall_volumes};
use fluvia_sim::metrics::particle_volume;

use super::Surroundings;

/// The neighbours of particles among themselves and among walls.
pub struct Near<'a> {
    pub around: &'a Surroundings<'a>,
    pub kernel: CubicSpline,
    /// Of a particle at rest, cubic metres.
    pub volume: f32,
    /// What each wall particle stands for (Akinci et al. 2012), cubic metres.
    pub wall_volume: Vec<f32>,
    walls: Grids,
    fluid: Grids,
    of_fluid: Neighbors,
    of_walls: Neighbors,
}

impl<'a> Near<'a> {
    /// Without particles.
    pub fn of(around: &'a Surroundings<'a>) -> Near<'a> {
        let Surroundings { wall_position, wall_clouds, config, .. } = around;
        let kernel = CubicSpline::new(SUPPORT_IN_RADII * config.particle_radius);
        let volumes =
            wall_clouds.windows(2).map(|wall| wall_volumes(&wall_position[wall[0]..wall[1]], &kernel));
        let wall_volume = volumes.collect::<Vec<_>>().concat();
        let mut walls = Grids::new();
        walls.build(wall_position, wall_clouds, kernel.support());
        Near {
            around,
            kernel,
            volume: particle_volume(config.particle_radius),
            wall_volume,
            walls,
            fluid: Grids::new(),
            of_fluid: Neighbors::default(),
            of_walls: Neighbors::default(),
        }
    }

    /// Finds the neighbours of particles.
    pub fn find(&mut self, position: &[Point]) {
        let (support, clouds) = (self.kernel.support(), self.around.clouds);
        let (radius, options) = (Radius::Uniform(support), Options::default());
        self.fluid.build(position, clouds, support);
        self.fluid.search(position, clouds, radius, &options, &mut self.of_fluid);
        self.walls.search(position, clouds, radius, &options, &mut self.of_walls);
    }

    /// The particles near particle i, itself included.
    pub fn fluid(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        self.of_fluid.row(i).iter().map(|&j| j as usize)
    }

    /// The wall particles near particle i.
    pub fn walls(&self, i: usize) -> impl Iterator<Item = usize> + '_ {
        self.of_walls.row(i).iter().map(|&b| b as usize)
    }
}

/// a − b and its length.
pub fn apart(a: Point, b: Point) -> (Point, f32) {
    let d: Point = std::array::from_fn(|axis| a[axis] - b[axis]);
    (d, d.iter().map(|x| x * x).sum::<f32>().sqrt())
}

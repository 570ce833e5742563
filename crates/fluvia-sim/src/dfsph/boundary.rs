//! The walls as particles with volumes (Akinci et al. 2012): they add to the density of the fluid and press back.
//!
//! Walls do not move, so all that a step needs of them are two sums for each particle i over the wall particles b,
//!
//! ρ_i^b / ρ_0 = Σ_b V_b W(x_i - x_b)   and   g_i^b = Σ_b V_b ∇W(x_i - x_b).

use fluvia_neighbors::{Neighbors, Radius};
use rayon::prelude::*;

use super::pairs::weigh;
use super::row::Row;
use crate::kernel::CubicSpline;
use crate::particles::Boundary;
use crate::vector::{Vector, add_scaled, dot, sub};
use crate::walls::{MAX_REACH, Walls};

/// How far in front of the walls the centres of particles are kept, particle radii. Pressure keeps them farther: the nearest
/// in the reference data is at 0.71 radii. Little, so that a particle is never pushed farther than it came: at 0.5 what
/// slides over an edge is moved by millimetres at once, and the pressure that follows shoots it away.
const CLEARANCE: f32 = 0.05;

/// A particle that moves farther than this part of the support radius in a step has the walls along its way looked for.
const FAR: f32 = 0.25;

/// The walls, prepared once.
pub struct Boundaries {
    walls: Walls,
    position: Vec<Row>,
    near: Neighbors,
    /// Working memory for the particles that move far: their rows, positions and ways.
    far: (Vec<usize>, Vec<Vector>, Vec<f32>),
    near_far: Neighbors,
}

/// The sums over the walls for one particle.
#[derive(Clone, Copy, Debug, Default)]
pub struct WallSums {
    /// Σ_b V_b W, as a part of rest density.
    pub density: f32,
    /// Σ_b V_b ∇W, per metre.
    pub gradient: Row,
    /// Wall particles within the support radius.
    pub count: u32,
}

impl Boundaries {
    pub fn new(boundary: &Boundary, kernel: &CubicSpline, particle_radius: f32) -> Boundaries {
        Boundaries {
            walls: Walls::new(boundary, kernel, CLEARANCE * particle_radius),
            position: boundary.position.iter().map(|&x| Row::from(x)).collect(),
            near: Neighbors::default(),
            far: Default::default(),
            near_far: Neighbors::default(),
        }
    }

    /// Fills `sums`, one per position.
    pub fn sum(&mut self, positions: &[Vector], kernel: &CubicSpline, sums: &mut Vec<WallSums>) {
        self.walls.search(positions, Radius::Uniform(kernel.support()), &mut self.near);
        let Boundaries { walls, position, near, .. } = &*self;
        let sum = |factors: &mut Vec<f32>, (i, &x): (usize, &Vector)| {
            let (x, row) = (Row::from(x), near.row(i));
            let offset = |&b: &u32| x - position[b as usize];
            factors.clear();
            factors.extend(row.iter().map(|b| offset(b).dot(offset(b))));
            let density = weigh(kernel, factors, |k| walls.volume[row[k] as usize]);
            let mut gradient = Row::default();
            row.iter().zip(factors).for_each(|(b, factor)| gradient.add_scaled(*factor, offset(b)));
            WallSums { density, gradient, count: row.len() as u32 }
        };
        positions.par_iter().enumerate().map_init(Vec::new, sum).collect_into_vec(sums);
    }

    /// Moves particles for `h` seconds from where [`sum`](Boundaries::sum) has seen them, but not through walls: pressure
    /// alone does not stop a lone, fast particle. One that meets a wall loses the speed towards it.
    pub fn travel(&mut self, position: &mut [Vector], velocity: &mut [Row], kernel: &CubicSpline, h: f32) {
        let Boundaries { walls, near, far: (rows, starts, reach), near_far, .. } = self;
        let support = kernel.support();
        rows.clear();
        starts.clear();
        reach.clear();
        for (i, (x, v)) in position.iter().zip(&*velocity).enumerate() {
            let way = h * v.length();
            if way > FAR * support {
                rows.push(i);
                starts.push(*x);
                reach.push((support + way).min(MAX_REACH * support));
            }
        }
        walls.search(starts, Radius::PerQuery(reach), near_far);
        let (walls, near, near_far, rows) = (&*walls, &*near, &*near_far, &*rows);
        position.par_iter_mut().zip(velocity).enumerate().for_each(|(i, (position, velocity))| {
            let walls_near = rows.binary_search(&i).map_or_else(|_| near.row(i), |row| near_far.row(row));
            let free = add_scaled(*position, h, velocity.vector());
            let end = walls.travel(*position, free, walls_near);
            if end != free {
                let pushed = sub(end, free);
                let length = dot(pushed, pushed).sqrt();
                let away = pushed.map(|x| x / length);
                let towards = -dot(velocity.vector(), away);
                velocity.add_scaled((length / h).min(towards).max(0.0), Row::from(away));
            }
            *position = end;
        });
    }
}

//! Position-based fluids (Macklin & Müller 2013; equation and line numbers are theirs), with the wall
//! particles of the published scenes.
//!
//! Every particle carries the constraint that the fluid around it is not denser than allowed,
//!
//! C_i = Σ_j V W(x_i - x_j) + Σ_b V_b W(x_i - x_b) - target_i <= 0
//!
//! over the fluid j and the walls b (Eq. 1, one-sided, with the walls of Akinci et al. 2012). A substep moves
//! the particles under the external acceleration and then corrects positions until the constraints hold;
//! velocities are whatever the positions did.
//!
//! Differences from the paper, each measured on the dam break of the reference data:
//! - Bodies begin as a lattice at 0.8 of rest density. With target 1 they fall together unhindered before
//!   any pressure rises, and the front is late (26 % at 0.2 s). The reference (DFSPH) also keeps the velocity
//!   free of convergence; in positions this is a target near the density that the fluid has already
//!   ([`Params::compaction_rate`]). The other way round, particles that begin on top of each other are let
//!   apart slowly, not thrown ([`Params::expansion_rate`]).
//! - The multipliers λ_i are accumulated over the iterations and never pull, so an iteration may take back
//!   what an earlier one overdid; iterations are damped and carry momentum. Undamped Jacobi iterations
//!   overshoot, and a deep pool never comes to rest.
//! - W and its gradient are both the cubic spline of the reference, so that the density held is the density
//!   that is measured.
//! - Walls are a position constraint besides: density alone does not stop a lone particle.
//!
//! A step is a function of the particles given to it alone: nothing is remembered from step to step, so a
//! resumed run gives the same bits. All sums are gathered in a fixed order: so does any number of threads.

mod params;
mod repulsion;

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use rayon::prelude::*;

use crate::Result;
use crate::kernel::{CubicSpline, SUPPORT_IN_RADII, distance};
use crate::metrics::{highest_speed, particle_volume};
use crate::parallel::{CHUNK, most_neighbors, split_by_rows};
use crate::particles::{Acceleration, Boundary, Particles};
use crate::rollout::{Solver, StepInfo, positive};
use crate::substep::Interval;
use crate::vector::{Vector, add, add_scaled, dot, shorten, sub};
use crate::walls::{MAX_REACH, Walls};
pub use params::Params;
use repulsion::{Repulsion, made_up_offset};

/// Substeps in a frame interval at most when they are shortened for fast particles.
const MAX_SUBSTEPS: f64 = 100.0;

/// A correction in one iteration is at most this long, particle radii: a limit for wrong states, out of the
/// way of right ones.
const MAX_CORRECTION: f32 = 0.5;

/// The solver for one set of walls.
pub struct Pbf {
    params: Params,
    particle_radius: f32,
    kernel: CubicSpline,
    /// V, the volume of a fluid particle at rest, cubic metres.
    volume: f32,
    walls: Walls,
    grid: Grid,
    fluid: Fluid,
    near: Near,
}

/// The particles of a step in cell order, so that neighbours are near in memory, and what is computed of them.
#[derive(Default)]
struct Fluid {
    /// The row of each in the caller's particles.
    order: Vec<u32>,
    position: Vec<Vector>,
    velocity: Vec<Vector>,
    acceleration: Vec<Vector>,
    /// x* of the paper.
    predicted: Vec<Vector>,
    /// x* before anything was corrected.
    free: Vec<Vector>,
    /// Density over rest density that is allowed in this substep.
    target: Vec<f32>,
    /// λ accumulated over the iterations of a substep, square metres, and its last change.
    lambda: Vec<[f32; 2]>,
    /// ∇C_i with respect to x_i itself, and the part of Δx_i that does not depend on λ (Eq. 13).
    own: Vec<[Vector; 2]>,
    /// Output of a pass that reads the same quantity of the neighbours.
    next: Vec<Vector>,
    /// How far walls are searched, metres.
    reach: Vec<f32>,
}

/// Who is near whom.
#[derive(Default)]
struct Near {
    /// Fluid within h at x*; each particle is its own neighbour.
    fluid: Neighbors,
    /// V ∇W(x_i - x_j) = factor · (x_i - x_j), for every entry of `fluid`.
    factor: Vec<f32>,
    /// Wall particles within h of the way of each particle.
    walls: Neighbors,
}

impl Pbf {
    /// A solver for fluid particles of the given radius, metres, between these walls.
    ///
    /// # Errors
    /// `Parameter` if the radius or a parameter is out of range.
    pub fn new(params: Params, boundary: &Boundary, particle_radius: f32) -> Result<Pbf> {
        params.check()?;
        positive("particle radius", particle_radius)?;
        boundary.check()?;
        let kernel = CubicSpline::new(SUPPORT_IN_RADII * particle_radius);
        Ok(Pbf {
            params,
            particle_radius,
            kernel,
            volume: particle_volume(particle_radius),
            walls: Walls::new(boundary, &kernel, params.wall_clearance * particle_radius),
            grid: Grid::new(),
            fluid: Fluid::default(),
            near: Near::default(),
        })
    }

    /// Algorithm 1 of the paper, `h` seconds.
    fn substep(&mut self, h: f32) {
        self.predict(h);
        self.find_neighbors();
        self.set_targets(h);
        for _ in 0..self.params.iterations {
            self.update_multipliers();
            self.correct_positions();
        }
        self.update_velocities(h);
        self.smooth_velocities(h);
    }

    /// Lines 1-4: v = v + h a_ext, x* = x + h v, as far as the walls let it.
    fn predict(&mut self, h: f32) {
        let Fluid { position, velocity, acceleration, predicted, free, reach, .. } = &mut self.fluid;
        let support = self.kernel.support();
        for (i, velocity) in velocity.iter_mut().enumerate() {
            *velocity = add_scaled(*velocity, h, acceleration[i]);
            let way = h * dot(*velocity, *velocity).sqrt();
            reach[i] = (support + way).min(MAX_REACH * support);
        }
        self.walls.search(position, Radius::PerQuery(reach), &mut self.near.walls);
        let (walls, near, velocity) = (&self.walls, &self.near.walls, &*velocity);
        let ends = predicted.par_iter_mut().zip(free.par_iter_mut());
        position.par_iter_mut().zip(ends).enumerate().for_each(|(i, (start, (end, free)))| {
            // A particle that begins in a wall is taken out before it moves, so that it gains no speed by it.
            *start = walls.keep_clear(*start, near.row(i));
            *free = add_scaled(*start, h, velocity[i]);
            *end = walls.travel(*start, *free, near.row(i));
        });
    }

    /// Lines 5-7: who is near whom at x*.
    fn find_neighbors(&mut self) {
        let (predicted, support) = (&self.fluid.predicted, self.kernel.support());
        self.grid.build(predicted, support);
        self.grid.search(predicted, Radius::Uniform(support), &Options::default(), &mut self.near.fluid);
        self.near.factor.resize(self.near.fluid.indices.len(), 0.0);
    }

    /// The density allowed at the end of the substep: rest density, but loose fluid grows denser only slowly
    /// and fluid that is too dense need not be apart at once.
    fn set_targets(&mut self, h: f32) {
        let Fluid { position, target, lambda, .. } = &mut self.fluid;
        let (kernel, walls, near, volume) = (&self.kernel, &self.walls, &self.near, self.volume);
        let Params { loose_density, compaction_rate, expansion_rate, .. } = self.params;
        lambda.fill([0.0; 2]);
        target.par_iter_mut().enumerate().for_each(|(i, target)| {
            let x = position[i];
            let mut density = 0.0;
            for &j in near.fluid.row(i) {
                density += volume * kernel.value(distance(x, position[j as usize]));
            }
            for &b in near.walls.row(i) {
                density += walls.volume[b as usize] * kernel.value(distance(x, walls.position[b as usize]));
            }
            *target = if density > 1.0 {
                (density - h * expansion_rate).max(1.0)
            } else {
                (density.max(loose_density) + h * compaction_rate).min(1.0)
            };
        });
    }

    /// Eq. 11: Δλ_i = -C_i / (Σ_k |∇_k C_i|² + ε) with the gradients of Eq. 8; walls do not move, so they are
    /// in the gradient with respect to x_i only. λ_i never becomes positive: pressure does not pull.
    fn update_multipliers(&mut self) {
        let Fluid { predicted, target, lambda, own, .. } = &mut self.fluid;
        let Near { fluid, factor, walls: near_walls } = &mut self.near;
        let (kernel, walls, volume, params) = (&self.kernel, &self.walls, self.volume, &self.params);
        let support = kernel.support();
        let relaxation = params.relaxation / (support * support);
        let repulsion = Repulsion::new(params.artificial_pressure, kernel);
        let chunks = lambda.par_chunks_mut(CHUNK).zip(own.par_chunks_mut(CHUNK));
        let factors = split_by_rows(factor, &fluid.row_splits);
        chunks.zip(factors).enumerate().for_each(|(chunk, ((lambda, own), factors))| {
            let mut factors = factors.iter_mut();
            for (k, (lambda, own)) in lambda.iter_mut().zip(own).enumerate() {
                let i = chunk * CHUNK + k;
                let x = predicted[i];
                let (mut density, mut gradient, mut squares, mut apart) = (0.0, [0.0; 3], 0.0, [0.0; 3]);
                for (&j, factor) in fluid.row(i).iter().zip(&mut factors) {
                    let offset = sub(x, predicted[j as usize]);
                    let squared = dot(offset, offset);
                    let r = squared.sqrt();
                    let value = kernel.value(r);
                    *factor = volume * kernel.gradient_factor(r);
                    density += volume * value;
                    gradient = add_scaled(gradient, *factor, offset);
                    squares += *factor * *factor * squared;
                    if r < repulsion.reach {
                        let offset = if r > 0.0 { offset } else { made_up_offset(i, j as usize, support) };
                        apart = add_scaled(apart, repulsion.at(value) * *factor, offset);
                    }
                }
                for &b in near_walls.row(i) {
                    let offset = sub(x, walls.position[b as usize]);
                    let r = dot(offset, offset).sqrt();
                    let volume = walls.volume[b as usize];
                    density += volume * kernel.value(r);
                    gradient = add_scaled(gradient, volume * kernel.gradient_factor(r), offset);
                }
                let step = (density - target[i]) / (squares + dot(gradient, gradient) + relaxation);
                let [total, change] = *lambda;
                let moved = (total - params.damping * step + params.momentum * change).min(0.0);
                *lambda = [moved, moved - total];
                *own = [gradient, apart];
            }
        });
    }

    /// Eq. 12-14: Δx_i = Σ_j (Δλ_i + Δλ_j + s_corr) V ∇W(x_i - x_j) + Σ_b Δλ_i V_b ∇W(x_i - x_b), then the
    /// walls (line 14).
    fn correct_positions(&mut self) {
        let Fluid { predicted, next, lambda, own, .. } = &mut self.fluid;
        let (walls, near) = (&self.walls, &self.near);
        let longest = MAX_CORRECTION * self.particle_radius;
        next.par_iter_mut().enumerate().for_each(|(i, next)| {
            let x = predicted[i];
            let [gradient, apart] = own[i];
            let mut correction = add_scaled(apart, lambda[i][1], gradient);
            let factors = &near.factor[near.fluid.row_splits[i]..near.fluid.row_splits[i + 1]];
            for (&j, factor) in near.fluid.row(i).iter().zip(factors) {
                let j = j as usize;
                correction = add_scaled(correction, lambda[j][1] * factor, sub(x, predicted[j]));
            }
            *next = walls.keep_clear(add(x, shorten(correction, longest)), near.walls.row(i));
        });
        std::mem::swap(predicted, next);
    }

    /// Lines 20 and 23: v = (x* - x) / h, x = x*. Written as a change by what the corrections did, so that a
    /// particle in free fall keeps its velocity to the last bit.
    fn update_velocities(&mut self, h: f32) {
        let Fluid { position, velocity, predicted, free, .. } = &mut self.fluid;
        for (i, velocity) in velocity.iter_mut().enumerate() {
            *velocity = add_scaled(*velocity, 1.0 / h, sub(predicted[i], free[i]));
            position[i] = predicted[i];
        }
    }

    /// Eq. 17: v_i = v_i + c Σ_j V (v_j - v_i) W(x_i - x_j).
    fn smooth_velocities(&mut self, h: f32) {
        let c = (self.params.viscosity * h).min(1.0);
        let Fluid { position, velocity, next, .. } = &mut self.fluid;
        let (kernel, near, volume) = (&self.kernel, &self.near, self.volume);
        next.par_iter_mut().enumerate().for_each(|(i, next)| {
            let mut sum = [0.0; 3];
            for &j in near.fluid.row(i) {
                let j = j as usize;
                let weight = volume * kernel.value(distance(position[i], position[j]));
                sum = add_scaled(sum, weight, sub(velocity[j], velocity[i]));
            }
            *next = add_scaled(velocity[i], c, sum);
        });
        std::mem::swap(velocity, next);
    }

    /// The longest substep that the fastest particle allows in an interval of `dt` seconds, seconds.
    fn longest_substep(&self, dt: f32) -> f64 {
        let Fluid { velocity, acceleration, .. } = &self.fluid;
        let Params { substep, travel, .. } = self.params;
        substep.within(travel * self.particle_radius, f64::from(dt) / MAX_SUBSTEPS, |length| {
            f64::from(highest_speed(velocity)) + f64::from(highest_speed(acceleration)) * f64::from(length)
        })
    }
}

impl Solver for Pbf {
    fn name(&self) -> &'static str {
        "pbf"
    }

    fn step(
        &mut self,
        particles: &mut Particles,
        acceleration: Acceleration<'_>,
        dt: f32,
    ) -> Result<StepInfo> {
        self.params.substep.check(dt)?;
        acceleration.check(particles.len())?;
        self.fluid.load(particles, acceleration, &mut self.grid, self.kernel.support());
        let mut info = StepInfo { neighbor_radius: self.kernel.support(), ..StepInfo::default() };
        let mut interval = Interval::new(dt);
        while !interval.is_over() {
            let length = interval.next(self.longest_substep(dt));
            self.substep(length);
            info.substeps += 1;
            info.max_neighbors = info.max_neighbors.max(most_neighbors(&self.near.fluid));
        }
        self.fluid.store(particles);
        Ok(info)
    }
}

impl Fluid {
    /// Takes the particles over in cell order.
    fn load(&mut self, from: &Particles, acceleration: Acceleration<'_>, grid: &mut Grid, cell_size: f32) {
        grid.build(&from.position, cell_size);
        self.order.clear();
        self.order.extend_from_slice(grid.order());
        let rows = self.order.iter().map(|&row| row as usize);
        self.position.clear();
        self.position.extend(rows.clone().map(|row| from.position[row]));
        self.velocity.clear();
        self.velocity.extend(rows.clone().map(|row| from.velocity[row]));
        self.acceleration.clear();
        self.acceleration.extend(rows.map(|row| acceleration.of(row)));
        let count = from.len();
        self.predicted.resize(count, [0.0; 3]);
        self.free.resize(count, [0.0; 3]);
        self.target.resize(count, 0.0);
        self.lambda.resize(count, [0.0; 2]);
        self.own.resize(count, [[0.0; 3]; 2]);
        self.next.resize(count, [0.0; 3]);
        self.reach.resize(count, 0.0);
    }

    /// Gives them back in the caller's order.
    fn store(&self, to: &mut Particles) {
        for (i, &row) in self.order.iter().enumerate() {
            to.position[row as usize] = self.position[i];
            to.velocity[row as usize] = self.velocity[i];
        }
    }
}

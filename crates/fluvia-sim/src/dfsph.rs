//! Divergence-free smoothed particle hydrodynamics (Bender & Koschier 2015 and 2017; equations and algorithms are those
//! of 2017), with the wall particles of Akinci et al. (2012): the solver that made the published data, and ours.
//!
//! Every particle i has the density of the fluid and the walls around it,
//!
//! ρ_i / ρ_0 = Σ_j V W(x_i - x_j) + Σ_b V_b W(x_i - x_b),
//!
//! with V = 0.8 (2 r)³ and the cubic spline of support 4 r. A step (`Dfsph::advance`) makes the flow free of
//! compression, applies viscosity and external acceleration, and then finds the pressure that leaves no particle denser
//! than at rest at the end of the step. Pressure never pulls: spray and thin sheets keep a lower density.
//!
//! SPlisHSPlasH 2.16, which made the reference data, does the same steps in the same order. Differences:
//! - viscosity acts between the bodies of a scene, which are one liquid; there each body has its own;
//! - an iteration that has nothing to do (no compression anywhere) is left out.
//!
//! What a particle takes from step to step, the pressures that the iterations start from, is in
//! [`Particles::memory`]: nothing else is remembered, so a resumed run gives the same bits. All sums are gathered in a
//! fixed order: so does any number of threads.

mod boundary;
mod pairs;
mod params;
mod pressure;
mod row;
mod viscosity;

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use rayon::prelude::*;

use crate::kernel::{CubicSpline, SUPPORT_IN_RADII};
use crate::metrics::particle_volume;
use crate::parallel::most_neighbors;
use crate::particles::{Acceleration, Boundary, Particles};
use crate::rollout::{self, Solver, positive};
use crate::substep::Interval;
use crate::{Error, Result};
use boundary::{Boundaries, WallSums};
use pairs::Pairs;
pub use params::{Liquid, Params, Solve, StepInfo};
use pressure::System;
use row::Row;

/// An adaptive step is at least this long, seconds, but for what is left of a frame interval.
const SHORTEST_STEP: f64 = 1e-4;

/// A particle with fewer neighbours, walls among them, does not count in the divergence: its sums mean little.
const LEAST_NEIGHBORS: u32 = 20;

/// Σ |∇W V|² below which α_i is 0, in 1 / (support radius)²: nothing to press against.
const LEAST_GRADIENT: f32 = 1e-7;

/// The pressure that an iteration starts from at most: P h² in (support radius)², and P h in that per second.
const DENSITY_MEMORY_LIMIT: f32 = 0.025;
const DIVERGENCE_MEMORY_LIMIT: f32 = 50.0;

/// How far particles in one place are moved apart along an axis at most, in support radii.
const COINCIDENT_OFFSET: f32 = 0.002;

/// The solver for one set of walls.
pub struct Dfsph {
    params: Params,
    liquids: Vec<Liquid>,
    particle_radius: f32,
    kernel: CubicSpline,
    /// V, the volume of a fluid particle at rest, cubic metres.
    volume: f32,
    boundaries: Boundaries,
    grid: Grid,
    fluid: Fluid,
    pressure_work: pressure::Workspace,
    viscosity_work: viscosity::Workspace,
    steps: Vec<StepInfo>,
}

/// The particles in cell order, so that neighbours are near in memory, and what is computed of them.
#[derive(Default)]
struct Fluid {
    /// The row of each in the caller's particles.
    order: Vec<u32>,
    position: Vec<[f32; 3]>,
    velocity: Vec<Row>,
    external: Vec<Row>,
    /// ρ0_i over the rest density of the first liquid.
    relative_density: Vec<f32>,
    /// ν_i.
    viscosity: Vec<f32>,
    pairs: Pairs,
    walls: Vec<WallSums>,
    /// ρ_i / ρ0.
    density: Vec<f32>,
    /// α_i of Eq. 11, without its density, square metres.
    alpha: Vec<f32>,
    /// What a pressure solver has to take away.
    source: Vec<f32>,
    /// P h² of the constant-density solver, square metres.
    density_pressure: Vec<f32>,
    /// P h of the divergence solver, square metres per second.
    divergence_pressure: Vec<f32>,
}

impl Dfsph {
    /// A solver for fluid particles of the given radius, metres, between these walls. `liquids` are the materials of the
    /// bodies by their index; bodies beyond them, or all if there are none, have the default.
    ///
    /// # Errors
    /// `Parameter` if the radius, a parameter or a material is out of range.
    pub fn new(
        params: Params,
        boundary: &Boundary,
        particle_radius: f32,
        liquids: &[Liquid],
    ) -> Result<Dfsph> {
        params.check()?;
        positive("particle radius", particle_radius)?;
        boundary.check()?;
        liquids.iter().try_for_each(Liquid::check)?;
        let kernel = CubicSpline::new(SUPPORT_IN_RADII * particle_radius);
        Ok(Dfsph {
            params,
            liquids: liquids.to_vec(),
            particle_radius,
            kernel,
            volume: particle_volume(particle_radius),
            boundaries: Boundaries::new(boundary, &kernel, particle_radius),
            grid: Grid::new(),
            fluid: Fluid::default(),
            pressure_work: pressure::Workspace::default(),
            viscosity_work: viscosity::Workspace::default(),
            steps: Vec::new(),
        })
    }

    /// The solver's own steps within the last frame interval.
    pub fn steps(&self) -> &[StepInfo] {
        &self.steps
    }

    /// One step of `h` seconds.
    fn advance(&mut self, h: f32) -> StepInfo {
        self.find_neighbors();
        self.find_densities();
        let divergence = self.solve_divergence(h);
        let viscosity = self.apply_viscosity();
        self.apply_external_acceleration(h);
        let density = self.solve_density(h);
        self.move_particles(h);
        StepInfo { dt: h, divergence, viscosity, density }
    }

    /// Who is near whom.
    fn find_neighbors(&mut self) {
        let Fluid { position, pairs, walls, .. } = &mut self.fluid;
        pairs.find(position, &mut self.grid, &self.kernel);
        self.boundaries.sum(position, &self.kernel, walls);
    }

    /// ρ_i, V ∇W of every pair, and α_i = 1 / (|Σ_k V_k ∇W_ik|² + Σ_j |V ∇W_ij|²) (Eq. 11), where a lighter neighbour
    /// gives way more.
    fn find_densities(&mut self) {
        let Fluid { pairs, walls, density, alpha, relative_density, .. } = &mut self.fluid;
        pairs.weigh(&self.kernel, self.volume, density);
        let least = LEAST_GRADIENT / (self.kernel.support() * self.kernel.support());
        let stiffness = |(i, wall): (usize, &WallSums)| {
            let (mut gradient, mut squares) = (wall.gradient, 0.0);
            pairs.for_each(i, |j, factor, offset| {
                let own = offset.scaled(factor);
                gradient.add_scaled(1.0, own);
                squares += relative_density[i] / relative_density[j] * own.dot(own);
            });
            let sum = gradient.dot(gradient) + squares;
            if sum > least { 1.0 / sum } else { 0.0 }
        };
        walls.par_iter().enumerate().map(stiffness).collect_into_vec(alpha);
        density.iter_mut().zip(walls).for_each(|(density, wall)| *density += wall.density);
    }

    /// Algorithm 2: a flow that compresses the fluid nowhere.
    fn solve_divergence(&mut self, h: f32) -> Solve {
        self.find_compression_rates();
        let support = self.kernel.support();
        let Fluid { pairs, walls, alpha, relative_density, source, divergence_pressure, velocity, .. } =
            &mut self.fluid;
        let system = System {
            pairs,
            walls,
            alpha,
            relative_density,
            source,
            scale: h,
            step: h,
            least_neighbors: LEAST_NEIGHBORS,
            memory_limit: DIVERGENCE_MEMORY_LIMIT * support * support,
            tolerance: self.params.divergence_tolerance / h,
            min_iterations: 1,
            max_iterations: self.params.max_iterations,
        };
        pressure::solve(&system, divergence_pressure, velocity, &mut self.pressure_work)
    }

    /// Viscosity in the fluid and friction at the walls.
    fn apply_viscosity(&mut self) -> Solve {
        let Fluid { pairs, walls, density, relative_density, viscosity, velocity, .. } = &mut self.fluid;
        let fluid = viscosity::Fluid { pairs, walls, density, relative_density, viscosity };
        viscosity::apply(&fluid, &self.params, velocity, &mut self.viscosity_work)
    }

    /// v = v + h a_ext.
    fn apply_external_acceleration(&mut self, h: f32) {
        let Fluid { velocity, external, .. } = &mut self.fluid;
        velocity
            .iter_mut()
            .zip(&*external)
            .for_each(|(velocity, &external)| velocity.add_scaled(h, external));
    }

    /// Algorithm 3: no particle denser than at rest at the end of the step.
    fn solve_density(&mut self, h: f32) -> Solve {
        self.find_compression_rates();
        let support = self.kernel.support();
        let Fluid {
            pairs, walls, alpha, relative_density, source, density, density_pressure, velocity, ..
        } = &mut self.fluid;
        source.iter_mut().zip(&*density).for_each(|(source, density)| *source = density + h * *source - 1.0);
        let system = System {
            pairs,
            walls,
            alpha,
            relative_density,
            source,
            scale: h * h,
            step: h,
            least_neighbors: 0,
            memory_limit: DENSITY_MEMORY_LIMIT * support * support,
            tolerance: self.params.density_tolerance,
            min_iterations: self.params.min_iterations,
            max_iterations: self.params.max_iterations,
        };
        pressure::solve(&system, density_pressure, velocity, &mut self.pressure_work)
    }

    /// x = x + h v, as far as the walls let it.
    fn move_particles(&mut self, h: f32) {
        let Fluid { position, velocity, .. } = &mut self.fluid;
        self.boundaries.travel(position, velocity, &self.kernel, h);
    }

    /// The rate at which the flow compresses the fluid around each particle, per second (Eq. 9).
    fn find_compression_rates(&mut self) {
        let Fluid { pairs, walls, velocity, source, .. } = &mut self.fluid;
        let rate = |i: usize| pairs.compression_rate(i, velocity) + velocity[i].dot(walls[i].gradient);
        (0..velocity.len()).into_par_iter().map(rate).collect_into_vec(source);
    }

    /// The longest step that the fastest particle allows, seconds.
    fn longest_step(&self) -> f64 {
        let Fluid { velocity, external, .. } = &self.fluid;
        let Params { substep, travel, .. } = self.params;
        let highest = |rows: &[Row]| rows.iter().map(|row| row.length()).fold(0.0, f32::max);
        substep.within(travel * 2.0 * self.particle_radius, SHORTEST_STEP, |length| {
            f64::from(highest(velocity)) + f64::from(length * highest(external))
        })
    }
}

impl Solver for Dfsph {
    fn name(&self) -> &'static str {
        "dfsph"
    }

    fn step(
        &mut self,
        particles: &mut Particles,
        acceleration: Acceleration<'_>,
        dt: f32,
    ) -> Result<rollout::StepInfo> {
        self.params.substep.check(dt)?;
        acceleration.check(particles.len())?;
        self.load(particles, acceleration)?;
        self.steps.clear();
        let mut max_neighbors = 0;
        let mut interval = Interval::new(dt);
        while !interval.is_over() {
            let length = interval.next(self.longest_step());
            let info = self.advance(length);
            self.steps.push(info);
            max_neighbors = max_neighbors.max(most_neighbors(&self.fluid.pairs.near));
        }
        self.fluid.store(particles);
        Ok(rollout::StepInfo {
            substeps: self.steps.len() as u32,
            max_neighbors,
            neighbor_radius: self.kernel.support(),
            unconverged: self.steps.iter().map(StepInfo::unconverged).sum(),
        })
    }
}

impl Dfsph {
    /// Takes the particles over in cell order.
    fn load(&mut self, from: &Particles, acceleration: Acceleration<'_>) -> Result<()> {
        if !(from.memory.is_empty() || from.memory.len() == from.len()) {
            let message = format!("{} particles and memory of {}", from.len(), from.memory.len());
            return Err(Error::Parameter(message));
        }
        let Dfsph { fluid, grid, kernel, liquids, .. } = self;
        let mut position = from.position.clone();
        grid.build(&position, kernel.support());
        grid.search(&position, Radius::Uniform(0.0), &Options::default(), &mut fluid.pairs.near);
        separate(&mut position, &fluid.pairs.near, COINCIDENT_OFFSET * kernel.support());
        fluid.order.clear();
        fluid.order.extend_from_slice(grid.order());
        let rows = || fluid.order.iter().map(|&row| row as usize);
        let liquid = |body: u32| liquids.get(body as usize).copied().unwrap_or_default();
        let memory = |row: usize| from.memory.get(row).copied().unwrap_or_default();
        fluid.position.clear();
        fluid.position.extend(rows().map(|row| position[row]));
        fluid.velocity.clear();
        fluid.velocity.extend(rows().map(|row| Row::from(from.velocity[row])));
        fluid.external.clear();
        fluid.external.extend(rows().map(|row| Row::from(acceleration.of(row))));
        fluid.viscosity.clear();
        fluid.viscosity.extend(rows().map(|row| liquid(from.body[row]).viscosity));
        fluid.relative_density.clear();
        let first = liquid(0).density;
        fluid.relative_density.extend(rows().map(|row| liquid(from.body[row]).density / first));
        fluid.density_pressure.clear();
        fluid.density_pressure.extend(rows().map(|row| memory(row)[0]));
        fluid.divergence_pressure.clear();
        fluid.divergence_pressure.extend(rows().map(|row| memory(row)[1]));
        Ok(())
    }
}

impl Fluid {
    /// Gives the particles back in the caller's order.
    fn store(&self, to: &mut Particles) {
        to.memory.resize(to.len(), [0.0; 2]);
        for (i, &row) in self.order.iter().enumerate() {
            let row = row as usize;
            to.position[row] = self.position[i];
            to.velocity[row] = self.velocity[i].vector();
            to.memory[row] = [self.density_pressure[i], self.divergence_pressure[i]];
        }
    }
}

/// Moves particles that share a place apart, all but the first: no pressure would part them.
fn separate(position: &mut [[f32; 3]], coincident: &Neighbors, offset: f32) {
    for (i, x) in position.iter_mut().enumerate() {
        if coincident.row(i).iter().any(|&j| (j as usize) < i) {
            // Multiples of irrational numbers: all different, all over the place, the same for the same row.
            let turn =
                [0.754_877_666, 0.569_840_291, 0.430_159_709].map(|step: f64| (step * i as f64).fract());
            (0..3).for_each(|a| x[a] += offset * (2.0 * turn[a] - 1.0) as f32);
        }
    }
}

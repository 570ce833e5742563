//! The rollout loop: a [`Solver`] driven frame by frame, with emitters and removal.
//!
//! Frame 0 is the state before the first step, with what the emitters give in step 0. Step k leads from
//! frame k to frame k + 1: the solver moves the particles, those that fell out of the scene are removed, and
//! the emitters give what is due in step k + 1. N steps make N + 1 frames.

use crate::metrics::{self, Bounds};
use crate::particles::{Acceleration, Particles};
use crate::scene::{Emitter, Setup};
use crate::vector::add;
use crate::{Error, Result};

/// A particle is removed when it is below the walls' lowest point by more than this part of their height.
const FALL_BELOW_WALLS: f32 = 0.05;

/// Particles are piled up when one has this many times the neighbours that it has on the lattice of a body.
/// Rest density is 1.25 times the lattice; the published network reaches 3 in impacts.
const PILE_UP: u32 = 4;

/// Lattice spacings that a neighbour radius is taken for at most when the lattice is counted.
const MAX_LATTICE_REACH: i32 = 16;

/// What moves the particles. A rollout cannot tell which solver it drives.
///
/// A solver is made for one set of walls, which do not move.
pub trait Solver {
    /// The name written to `run.json`: "pbf", "network".
    fn name(&self) -> &'static str;

    /// Advances `particles` by one frame interval of `dt` seconds under the external acceleration
    /// a_ext of Eq. 10. Particles keep their number and order.
    ///
    /// # Errors
    /// `Parameter` if `dt` or the acceleration is not what the solver was made for. Positions and
    /// velocities that are not finite are left for the rollout to find and report.
    fn step(
        &mut self,
        particles: &mut Particles,
        acceleration: Acceleration<'_>,
        dt: f32,
    ) -> Result<StepInfo>;
}

/// What a solver reports of one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepInfo {
    /// How many steps of its own the solver took within the frame interval.
    pub substeps: u32,
    /// The largest number of fluid neighbours of a particle, itself excluded.
    pub max_neighbors: u32,
    /// The radius within which they were counted, metres.
    pub neighbor_radius: f32,
    /// Iterations of its solvers that ended at their limit, short of their tolerance.
    pub unconverged: u32,
}

/// Everything that changes in a rollout: with the scene and the solver, enough to continue to the same bits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Steps taken; the number of the frame that `particles` is.
    pub step: u64,
    /// The particles, older ones first.
    pub particles: Particles,
    /// The identity of the next particle emitted.
    pub next_id: u32,
    /// What has happened so far.
    pub summary: Summary,
}

/// What a run reports at its end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// Particles more than a radius beyond the walls' bounding box in the last frame.
    pub outside: usize,
    /// The same in the worst frame.
    pub worst_outside: usize,
    /// Particles removed because they fell out of the scene.
    pub removed: u64,
    /// The highest speed in any frame, metres per second.
    pub highest_speed: f32,
    /// Iterations of the solver that ended at their limit, short of their tolerance.
    pub unconverged: u64,
}

/// What one step did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// The number of the new frame.
    pub frame: u64,
    /// Particles in it.
    pub particles: usize,
    /// The highest speed in it, metres per second.
    pub highest_speed: f32,
    /// Particles more than a radius beyond the walls' bounding box in it.
    pub outside: usize,
    /// Particles removed in this step.
    pub removed: usize,
    /// Particles emitted into the new frame.
    pub emitted: usize,
    /// Whether particles pile up far beyond any density of a fluid: the state is wrong.
    pub piled_up: bool,
    /// What the solver says.
    pub solver: StepInfo,
}

/// The loop of one run: the scene's part of it, and the state.
#[derive(Clone, Debug)]
pub struct Rollout {
    emitters: Vec<Emitter>,
    gravity: [f32; 3],
    dt: f32,
    particle_radius: f32,
    /// The walls' bounding box; without walls nothing is outside and nothing is removed.
    walls: Option<Bounds>,
    state: State,
}

impl Rollout {
    /// A rollout that begins: its state is frame 0.
    ///
    /// # Errors
    /// `Parameter` if the time step or the particle radius is not positive, or there are too many particles.
    pub fn new(setup: &Setup) -> Result<Rollout> {
        let mut rollout = Rollout::with_state(setup, State::default())?;
        rollout.emit()?;
        rollout.observe();
        Ok(rollout)
    }

    /// A rollout that continues from the state it had after some step.
    ///
    /// # Errors
    /// As [`Rollout::new`], and `Parameter` if the state contradicts itself.
    pub fn resume(setup: &Setup, state: State) -> Result<Rollout> {
        let particles = &state.particles;
        let lengths = [particles.velocity.len(), particles.id.len(), particles.body.len()];
        if lengths.iter().any(|&n| n != particles.len()) {
            let message =
                format!("state of {} positions has {lengths:?} velocities, ids, bodies", particles.len());
            return Err(Error::Parameter(message));
        }
        if let Some(id) = particles.id.iter().find(|&&id| id >= state.next_id) {
            let message = format!("state has a particle {id}, expected ids below {}", state.next_id);
            return Err(Error::Parameter(message));
        }
        if let Some(body) = particles.body.iter().find(|&&body| body as usize >= setup.emitters.len()) {
            let fluids = setup.emitters.len();
            let message = format!("state has a particle of fluid {body}, expected one of {fluids} fluids");
            return Err(Error::Parameter(message));
        }
        Rollout::with_state(setup, state)
    }

    fn with_state(setup: &Setup, state: State) -> Result<Rollout> {
        positive("dt", setup.dt)?;
        positive("particle radius", setup.particle_radius)?;
        Ok(Rollout {
            emitters: setup.emitters.clone(),
            gravity: setup.gravity,
            dt: setup.dt,
            particle_radius: setup.particle_radius,
            walls: Bounds::of(&setup.boundary.position),
            state,
        })
    }

    /// The state: the frame to write, and what to keep for [`Rollout::resume`].
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Changes the external acceleration of the steps to come, metres per second squared.
    ///
    /// # Errors
    /// `Parameter` if it is not finite.
    pub fn set_gravity(&mut self, gravity: [f32; 3]) -> Result<()> {
        finite("gravity", gravity)?;
        self.gravity = gravity;
        Ok(())
    }

    /// Moves what emitter `index` gives from the next step on by so many metres.
    ///
    /// # Errors
    /// `Parameter` if there is no such emitter, or it would give particles that are nowhere.
    pub fn move_emitter(&mut self, index: usize, by: [f32; 3]) -> Result<()> {
        let count = self.emitters.len();
        let Some(emitter) = self.emitters.get_mut(index) else {
            return Err(Error::Parameter(format!("emitter {index}, expected one of {count}")));
        };
        let moved: Vec<_> = emitter.position.iter().map(|&x| add(x, by)).collect();
        moved.iter().try_for_each(|&x| finite("position of an emitter", x))?;
        emitter.position = moved;
        Ok(())
    }

    /// Adds a body of fluid to the frame, beside what the emitters give, as part of body `body` of the scene.
    ///
    /// # Errors
    /// `Parameter` if there is no such body, a number is not finite, or there are too many particles.
    pub fn add(&mut self, position: &[[f32; 3]], velocity: [f32; 3], body: usize) -> Result<()> {
        let count = self.emitters.len();
        if body >= count {
            return Err(Error::Parameter(format!("body {body}, expected one of {count}")));
        }
        position.iter().chain([&velocity]).try_for_each(|&x| finite("position or velocity", x))?;
        let velocity = vec![velocity; position.len()];
        self.state.append(position, &velocity, body).ok_or_else(|| too_many("particles added"))?;
        self.observe();
        Ok(())
    }

    /// Lets another solver go on: what the one before kept of the particles means nothing to it.
    pub fn forget(&mut self) {
        self.state.particles.memory.clear();
    }

    /// Takes one step under the scene's gravity.
    ///
    /// # Errors
    /// `NonFinite`, or what the solver reports; the state is then the one before the step.
    pub fn advance(&mut self, solver: &mut dyn Solver) -> Result<StepReport> {
        self.advance_under(solver, Acceleration::Uniform(self.gravity))
    }

    /// Takes one step under an external acceleration of the caller, gravity not added.
    ///
    /// # Errors
    /// As [`Rollout::advance`], and `Parameter` if there is not one acceleration per particle.
    pub fn advance_under(
        &mut self,
        solver: &mut dyn Solver,
        acceleration: Acceleration<'_>,
    ) -> Result<StepReport> {
        let (info, moved) = self.moved(solver, acceleration)?;
        let before = self.state.clone();
        self.state.particles = moved;
        self.state.step += 1;
        self.state.summary.unconverged += u64::from(info.unconverged);
        let removed = self.remove_fallen();
        let emitted = match self.emit() {
            Ok(emitted) => emitted,
            Err(error) => {
                self.state = before;
                return Err(error);
            }
        };
        let highest_speed = self.observe();
        Ok(StepReport {
            frame: self.state.step,
            particles: self.state.particles.len(),
            highest_speed,
            outside: self.state.summary.outside,
            removed,
            emitted,
            piled_up: info.max_neighbors
                > PILE_UP.saturating_mul(self.lattice_neighbors(info.neighbor_radius)),
            solver: info,
        })
    }

    /// The particles after the solver's step, checked.
    fn moved(
        &self,
        solver: &mut dyn Solver,
        acceleration: Acceleration<'_>,
    ) -> Result<(StepInfo, Particles)> {
        let mut particles = self.state.particles.clone();
        let count = particles.len();
        acceleration.check(count)?;
        let info = solver.step(&mut particles, acceleration, self.dt)?;
        if particles.len() != count {
            let message = format!("solver {} made {} of {count} particles", solver.name(), particles.len());
            return Err(Error::Parameter(message));
        }
        match metrics::first_non_finite(&particles) {
            Some((row, quantity)) => {
                Err(Error::NonFinite { step: self.state.step + 1, particle: particles.id[row], quantity })
            }
            None => Ok((info, particles)),
        }
    }

    /// Removes particles that fell out of the scene.
    fn remove_fallen(&mut self) -> usize {
        let Some(walls) = &self.walls else {
            return 0;
        };
        let lowest = walls.low[1] - FALL_BELOW_WALLS * (walls.high[1] - walls.low[1]);
        let particles = &mut self.state.particles;
        let keep: Vec<bool> = particles.position.iter().map(|x| x[1] >= lowest).collect();
        let removed = keep.iter().filter(|&&keep| !keep).count();
        if removed > 0 {
            particles.retain(&keep);
            self.state.summary.removed += removed as u64;
        }
        removed
    }

    /// Appends what the emitters give in the step that comes next.
    fn emit(&mut self) -> Result<usize> {
        let before = self.state.particles.len();
        for (body, emitter) in self.emitters.iter().enumerate() {
            if emits(emitter, self.state.step) {
                let emitted = self.state.append(&emitter.position, &emitter.velocity, body);
                emitted.ok_or_else(|| too_many(&format!("particles emitted by {}", emitter.source)))?;
            }
        }
        Ok(self.state.particles.len() - before)
    }

    /// Brings the summary up to date with a new frame; returns the highest speed in it.
    fn observe(&mut self) -> f32 {
        let State { particles, summary, .. } = &mut self.state;
        let outside = |walls| metrics::outside(&particles.position, walls, self.particle_radius);
        let highest_speed = metrics::highest_speed(&particles.velocity);
        summary.outside = self.walls.as_ref().map_or(0, outside);
        summary.worst_outside = summary.worst_outside.max(summary.outside);
        summary.highest_speed = summary.highest_speed.max(highest_speed);
        highest_speed
    }

    /// How many other points of a lattice of spacing 2 r lie within `radius` of one of them.
    fn lattice_neighbors(&self, radius: f32) -> u32 {
        let reach = radius / (2.0 * self.particle_radius);
        let limit = reach * reach * (1.0 + 1e-5);
        let cells = (reach.ceil() as i32).clamp(0, MAX_LATTICE_REACH);
        let squares = || (-cells..=cells).map(|i| (i * i) as f32);
        let points = squares().flat_map(|x| squares().flat_map(move |y| squares().map(move |z| x + y + z)));
        points.filter(|&squared| squared <= limit && squared > 0.0).count() as u32
    }
}

impl State {
    /// Adds new particles of a body; `None` if there are no identities left.
    fn append(&mut self, position: &[[f32; 3]], velocity: &[[f32; 3]], body: usize) -> Option<()> {
        let State { particles, next_id, .. } = self;
        let end = next_id.checked_add(u32::try_from(position.len()).ok()?)?;
        particles.position.extend_from_slice(position);
        particles.velocity.extend_from_slice(velocity);
        particles.id.extend(*next_id..end);
        particles.body.resize(particles.position.len(), body as u32);
        if !particles.memory.is_empty() {
            particles.memory.resize(particles.position.len(), [0.0; 2]);
        }
        *next_id = end;
        Some(())
    }
}

fn too_many(what: &str) -> Error {
    Error::Parameter(format!("more than {} {what}", u32::MAX))
}

/// An error unless all coordinates are finite.
fn finite(name: &str, vector: [f32; 3]) -> Result<()> {
    if vector.iter().all(|x| x.is_finite()) {
        return Ok(());
    }
    Err(Error::Parameter(format!("{name} {vector:?}, expected finite numbers")))
}

/// Whether an emitter gives particles in step `step`.
fn emits(emitter: &Emitter, step: u64) -> bool {
    (emitter.start..emitter.stop).contains(&step)
        && (step - emitter.start).is_multiple_of(emitter.step.max(1))
}

/// An error unless the value is positive and finite.
pub(crate) fn positive(name: &str, value: f32) -> Result<()> {
    if value > 0.0 && value.is_finite() {
        return Ok(());
    }
    Err(Error::Parameter(format!("{name} {value}, expected a positive number")))
}

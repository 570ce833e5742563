//! A scene that runs, with one solver or two, and is changed while it does.
//!
//! What is changed (gravity, viscosity, where emitters are) is changed in the set-up as well, so that it stays when the
//! scene begins again; what was poured in is gone then. All panels get the same changes.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail};
use cconv::Kernel;
use fluvia_sim::dfsph::Liquid;
use fluvia_sim::kernel::{CubicSpline, SUPPORT_IN_RADII, wall_volumes};
use fluvia_sim::metrics::{Bounds, density_ratios_within};
use fluvia_sim::pour::{Ray, Room};
use fluvia_sim::rollout::{Rollout, Solver};
use fluvia_sim::sampling::sample_volume;
use fluvia_sim::scene::{DEFAULT_DT, Emitter, Setup, up};
use fluvia_sim::shapes::Shape;
use fluvia_view::walls::Walls;
use fluvia_view::{Body, Command, Form, Frame, Mode, PanelState, Range, Recording, State};

use super::Args;
use super::menu::Menu;
use super::panel::Panel;
use super::recorder::{Recorder, Subject};
use super::stage::{Show, blank};
use super::surfaces;
use crate::record::{self, Source, decimal};
use crate::report::{Report, counted};

/// What was poured in, as the name of a body.
const POURED: &str = "poured";

/// How far above the place that was pointed at a body begins to fall, metres.
const FALL: f32 = 0.3;

/// The sizes of bodies that can be dropped, metres.
const SIZES: std::ops::RangeInclusive<f32> = 0.1..=2.0;

/// Nothing more is poured into a scene of so many particles: a step would take seconds.
const MOST_PARTICLES: usize = 500_000;

/// The strongest gravity along an axis, metres per second squared: twelve times that of the Earth.
const MOST_GRAVITY: f32 = 120.0;

pub struct Live {
    title: String,
    path: PathBuf,
    scene: Source,
    seed: u64,
    kernel: Kernel,
    /// Before anybody changed it, metres per second squared.
    gravity: [f32; 3],
    /// The scene as it was changed; its last fluid is what was poured.
    setup: Setup,
    room: Room,
    /// What each wall particle counts in a density, cubic metres; computed when densities are first wanted.
    volumes: Option<Vec<f32>>,
    menu: Menu,
    panels: Vec<Panel>,
    recorder: Arc<Recorder>,
    news: Option<String>,
}

impl Live {
    /// Loads a scene, with the solver that the arguments name.
    ///
    /// # Errors
    /// If the scene or weights cannot be read, or the solver does not take the scene.
    pub fn new(args: &Args, name: &str, recorder: Arc<Recorder>, report: &Report) -> Result<Live> {
        let (mut scene, source) = record::load_scene(name)?;
        let menu = Menu::new(args, scene.dt.unwrap_or(DEFAULT_DT))?;
        let first = &menu.get(0).choice;
        first.adapt(&mut scene)?;
        if let Some(warning) = first.warning(&scene.path, scene.materials()) {
            report.warning(warning);
        }
        let seed = args.seed.unwrap_or_default();
        let mut setup = scene.sample(seed)?;
        for warning in setup.warnings() {
            report.warning(warning);
        }
        let poured = Emitter {
            source: POURED.into(),
            path: None,
            position: Vec::new(),
            velocity: Vec::new(),
            unused_velocity: None,
            start: 0,
            stop: 0,
            step: 1,
            material: scene.material,
        };
        setup.emitters.push(poured);
        let kernel = Kernel::detect();
        let solver = first.make(&setup, kernel).with_context(|| name.to_owned())?;
        let panels = vec![Panel::new(0, solver, Rollout::new(&setup)?)];
        let title = scene.path.file_stem().unwrap_or_default().display().to_string();
        let room = Room::new(&setup);
        let path = scene.path;
        Ok(Live {
            title,
            path,
            scene: source,
            seed,
            kernel,
            gravity: setup.gravity,
            setup,
            room,
            volumes: None,
            menu,
            panels,
            recorder,
            news: None,
        })
    }

    fn make(&self, offer: usize) -> Result<Box<dyn Solver + Send>> {
        let choice = &self.menu.get(offer).choice;
        choice.check(&self.path, &self.setup)?;
        choice.make(&self.setup, self.kernel)
    }

    fn panel(&self, index: usize) -> Result<&Panel> {
        self.panels
            .get(index)
            .with_context(|| format!("picture {index}, expected one of {}", self.panels.len()))
    }

    fn reset(&mut self) -> Result<()> {
        self.stop_recording()?;
        let rollout = Rollout::new(&self.setup)?;
        self.panels.iter_mut().for_each(|panel| panel.restart(rollout.clone()));
        Ok(())
    }

    fn drop_body(&mut self, panel: usize, ray: Ray, body: Body) -> Result<()> {
        if !SIZES.contains(&body.size) {
            bail!("a body of {} m, expected {} to {}", body.size, SIZES.start(), SIZES.end());
        }
        let (name, shape) = match body.form {
            Form::Cube => ("cube", Shape::Box),
            Form::Ball => ("ball", Shape::Sphere),
        };
        let mesh = shape.mesh().map(|x| x.map(|x| x * decimal(body.size)));
        let particles =
            sample_volume(&mesh, self.setup.particle_radius).map_err(|fault| anyhow!("{name}: {fault}"))?;
        if self.panel(panel)?.position().len() + particles.len() > MOST_PARTICLES {
            bail!("{MOST_PARTICLES} particles are the most that are poured");
        }
        let hit =
            self.room.hit(ray, self.panels[panel].position()).context("there is nothing to drop it on")?;
        let fluids: Vec<&[[f32; 3]]> = self.panels.iter().map(Panel::position).collect();
        let place = self.room.place(&particles, hit, up(self.setup.gravity), FALL, &fluids);
        let Some(place) = place else { bail!("no room there for a {name} of {:.2} m", body.size) };
        let particles: Vec<_> = particles.iter().map(|x| [0, 1, 2].map(|a| x[a] + place[a])).collect();
        let poured = self.setup.emitters.len() - 1;
        self.panels.iter_mut().try_for_each(|panel| panel.add(&particles, poured))?;
        self.recorder.note(&format!("a {name} of {} m dropped at {place:?}", body.size));
        Ok(())
    }

    fn move_emitter(&mut self, index: usize, to: [f32; 3]) -> Result<()> {
        let movable = self.setup.emitters.iter().enumerate().filter(|(_, emitter)| is_movable(emitter));
        let (index, emitter) = movable.clone().nth(index).context("there is no such emitter")?;
        let middle = middle(emitter);
        let by = [0, 1, 2].map(|a| to[a] - middle[a]);
        let moved: Vec<_> = emitter.position.iter().map(|x| [0, 1, 2].map(|a| x[a] + by[a])).collect();
        if !moved.iter().flatten().all(|x| x.is_finite()) || !self.room.allows(&moved) {
            bail!("no room there for the emitter");
        }
        self.panels.iter_mut().try_for_each(|panel| panel.rollout.move_emitter(index, by))?;
        self.setup.emitters[index].position = moved;
        self.recorder.note(&format!("emitter {index} moved to {to:?}"));
        Ok(())
    }

    fn change_gravity(&mut self, to: [f32; 3]) -> Result<()> {
        if !to.iter().all(|g| g.abs() <= MOST_GRAVITY) {
            bail!("gravity {to:?}, expected at most {MOST_GRAVITY} m/s² along each axis");
        }
        self.panels.iter_mut().try_for_each(|panel| panel.rollout.set_gravity(to))?;
        self.setup.gravity = to;
        self.recorder.note(&format!("gravity {to:?} m/s²"));
        Ok(())
    }

    fn change_viscosity(&mut self, to: f32) -> Result<()> {
        let before: Vec<_> = self.setup.emitters.iter().map(|emitter| emitter.material).collect();
        self.setup.emitters.iter_mut().for_each(|emitter| emitter.material.viscosity = Some(to));
        let solvers = self.panels.iter().map(|panel| self.make(panel.offer)).collect::<Result<Vec<_>>>();
        let solvers = match solvers {
            Ok(solvers) => solvers,
            Err(error) => {
                self.setup.emitters.iter_mut().zip(before).for_each(|(emitter, old)| emitter.material = old);
                return Err(error);
            }
        };
        self.panels.iter_mut().zip(solvers).for_each(|(panel, solver)| panel.change(panel.offer, solver));
        self.recorder.note(&format!("viscosity {to}"));
        Ok(())
    }

    fn change_solver(&mut self, index: usize, name: &str) -> Result<()> {
        self.panel(index)?;
        let offer = self.menu.find(name).with_context(|| format!("no solver {name}"))?;
        let solver = self.make(offer)?;
        self.panels[index].change(offer, solver);
        self.recorder.note(&format!("solver {name} in picture {}", index + 1));
        Ok(())
    }

    fn compare(&mut self, on: bool) -> Result<()> {
        if on == (self.panels.len() > 1) {
            return Ok(());
        }
        self.stop_recording()?;
        if !on {
            self.panels.truncate(1);
            return Ok(());
        }
        let first = &self.panels[0];
        let other = self.menu.another(first.offer, &self.path, &self.setup);
        let other = other.context("no other solver takes this scene")?;
        let mut rollout = first.rollout.clone();
        rollout.forget();
        let solver = self.make(other)?;
        self.panels.push(Panel::new(other, solver, rollout));
        Ok(())
    }

    fn record(&mut self, on: bool) -> Result<()> {
        if !on {
            return self.stop_recording();
        }
        if self.recorder.directories().is_some() {
            return Ok(());
        }
        let subject = Subject {
            title: &self.title,
            scene: &self.scene,
            seed: self.seed,
            setup: &self.setup,
            kernel: self.kernel,
        };
        let panels: Vec<_> = self.panels.iter().map(|panel| (panel, self.menu.get(panel.offer))).collect();
        self.recorder.start(&subject, &panels)
    }

    fn stop_recording(&mut self) -> Result<()> {
        let ended = self.recorder.finish()?;
        let told: Vec<_> = ended
            .iter()
            .map(|(directory, frames)| format!("{} ({})", directory.display(), counted(*frames, "frame")))
            .collect();
        if !told.is_empty() {
            self.news = Some(format!("recorded {}", told.join(", ")));
        }
        Ok(())
    }

    fn find_densities(&mut self) {
        let (walls, radius) = (self.setup.boundary.position.as_slice(), self.setup.particle_radius);
        let volumes = self
            .volumes
            .get_or_insert_with(|| wall_volumes(walls, &CubicSpline::new(SUPPORT_IN_RADII * radius)));
        for panel in self.panels.iter_mut().filter(|panel| panel.density.len() != panel.position().len()) {
            panel.density = density_ratios_within(panel.position(), (walls, volumes), radius);
        }
    }

    /// The viscosity of all fluids, if it is one.
    fn viscosity(&self) -> Option<f32> {
        let mut all = self
            .setup
            .emitters
            .iter()
            .map(|emitter| emitter.material.viscosity.unwrap_or(Liquid::default().viscosity));
        let first = all.next()?;
        all.all(|other| other == first).then_some(first)
    }

    /// What all solvers take.
    fn viscosities(&self) -> Option<Range> {
        let ranges = self.panels.iter().map(|panel| self.menu.get(panel.offer).choice.viscosities());
        let common = ranges.reduce(|a, b| {
            let ([low, high], [other_low, other_high]) = (a?, b?);
            Some([low.max(other_low), high.min(other_high)])
        });
        let [low, high] = common??;
        Some(Range { low, high })
    }
}

impl Show for Live {
    fn walls(&self) -> Walls {
        surfaces::of_setup(&self.setup)
    }

    fn dt(&self) -> f64 {
        decimal(self.setup.dt)
    }

    fn advance(&mut self, frames: i64) -> Result<()> {
        if frames < 0 {
            bail!("a simulation does not run backwards");
        }
        let stepped = self.panels.iter_mut().map(Panel::advance).filter(Option::is_some).count();
        if stepped == 0 {
            return Ok(());
        }
        self.recorder.write(self.panels.iter())
    }

    fn can_skip(&self) -> bool {
        false
    }

    fn is_over(&self) -> bool {
        self.panels.iter().all(|panel| panel.error.is_some())
    }

    fn obey(&mut self, command: &Command) -> Result<()> {
        match command {
            Command::Reset => self.reset(),
            &Command::Drop { panel, origin, direction, body } => {
                self.drop_body(panel, Ray { origin, direction }, body)
            }
            &Command::MoveEmitter { index, to } => self.move_emitter(index, to),
            &Command::Gravity { to } => self.change_gravity(to),
            &Command::Viscosity { to } => self.change_viscosity(to),
            Command::Solver { panel, name } => self.change_solver(*panel, name),
            &Command::Compare { on } => self.compare(on),
            &Command::Record { on } => self.record(on),
            _ => bail!("only frames on disk can be gone through"),
        }
    }

    fn news(&mut self) -> Option<String> {
        self.news.take()
    }

    fn frame(&mut self, with_density: bool) -> Frame<'_> {
        if with_density {
            self.find_densities();
        }
        // A panel that stands still is behind.
        let number = self.panels.iter().map(|panel| panel.rollout.state().step).max().unwrap_or(0);
        Frame {
            number,
            time: number as f64 * decimal(self.setup.dt),
            panels: self.panels.iter().map(|panel| panel.shown(with_density)).collect(),
        }
    }

    fn describe(&self) -> State {
        let panel = |panel: &Panel| {
            let offer = self.menu.get(panel.offer);
            let error = panel.error.clone();
            PanelState { label: offer.label.clone(), solver: Some(offer.name.clone()), error }
        };
        let step = self.panels.iter().map(|panel| panel.rollout.state().step).max().unwrap_or(0);
        let emitter = |emitter: &Emitter| fluvia_view::Emitter {
            label: emitter.source.clone(),
            position: middle(emitter),
            active: emitter.stop > step,
        };
        State {
            title: self.title.clone(),
            dt: decimal(self.setup.dt),
            particle_radius: self.setup.particle_radius,
            up: up(self.setup.gravity),
            gravity: self.setup.gravity,
            scene_gravity: self.gravity,
            viscosity: self.viscosity(),
            viscosities: self.viscosities(),
            panels: self.panels.iter().map(panel).collect(),
            solvers: self.menu.describe(&self.path, &self.setup),
            emitters: self.setup.emitters.iter().filter(|e| is_movable(e)).map(emitter).collect(),
            recording: self.recorder.directories().map(|directories| Recording { directories }),
            ..blank(Mode::Live)
        }
    }
}

/// Whether an emitter gives more than once.
fn is_movable(emitter: &Emitter) -> bool {
    !emitter.position.is_empty() && emitter.stop > emitter.start.saturating_add(emitter.step)
}

/// The middle of what an emitter gives, metres.
fn middle(emitter: &Emitter) -> [f32; 3] {
    let bounds = Bounds::of(&emitter.position);
    bounds.map_or([0.0; 3], |Bounds { low, high }| [0, 1, 2].map(|a| 0.5 * (low[a] + high[a])))
}

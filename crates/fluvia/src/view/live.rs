//! A scene that runs, with one solver or two, and is changed while it does.
//!
//! What is changed (gravity, viscosity, where emitters are) is changed in the set-up as well, so that it stays when the
//! scene begins again; what was poured in is gone then. All panels get the same changes.

mod bodies;

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use cconv::Kernel;
use fluvia_sim::dfsph::Liquid;
use fluvia_sim::pour::{Ray, Room};
use fluvia_sim::rollout::{Rollout, Solver};
use fluvia_sim::scene::{DEFAULT_DT, Emitter, Material, Setup, up};
use fluvia_view::walls::Walls;
use fluvia_view::{Command, Frame, Mode, PanelState, Range, Recording, State};

use super::Args;
use super::densities::WallVolumes;
use super::menu::Menu;
use super::panel::Panel;
use super::recorder::{Recorder, Subject};
use super::stage::{Show, blank};
use super::surfaces;
use crate::record::{self, Source, decimal};
use crate::report::{Report, counted};

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
    /// Of the fluids, before anybody changed them.
    materials: Vec<Material>,
    /// The scene as it was changed; its last fluid is what was poured.
    setup: Setup,
    room: Room,
    volumes: WallVolumes,
    menu: Menu,
    panels: Vec<Panel>,
    recorder: Arc<Recorder>,
    /// What has happened and was not told yet.
    news: Vec<String>,
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
        setup.emitters.push(bodies::poured(&scene));
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
            materials: setup.emitters.iter().map(|emitter| emitter.material).collect(),
            setup,
            room,
            volumes: WallVolumes::default(),
            menu,
            panels,
            recorder,
            news: Vec::new(),
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

    /// The step that is shown: a panel that stands still is behind.
    fn step(&self) -> u64 {
        self.panels.iter().map(|panel| panel.rollout.state().step).max().unwrap_or(0)
    }

    fn reset(&mut self) -> Result<()> {
        let had_failed = self.is_over();
        let rollout = Rollout::new(&self.setup)?;
        self.stop_recording()?;
        self.panels.iter_mut().for_each(|panel| panel.restart(rollout.clone()));
        if had_failed {
            // Who pressed play may have expected it to go on.
            self.news.push("the scene begins again".into());
        }
        Ok(())
    }

    /// Brings a picture that has stood still to where the other is: what is side by side is the same moment.
    fn catch_up(&mut self, index: usize) -> Result<()> {
        let step = |k: usize| self.panels[k].rollout.state().step;
        let Some(ahead) = (0..self.panels.len()).find(|&k| step(k) > step(index)) else { return Ok(()) };
        let rollout = self.panels[ahead].rollout.clone();
        // Frames of the same number would be of different moments.
        self.stop_recording()?;
        self.panels[index].catch_up(rollout);
        self.news.push(format!("picture {} goes on from picture {}", index + 1, ahead + 1));
        Ok(())
    }

    fn change_gravity(&mut self, to: [f32; 3]) -> Result<()> {
        if !to.iter().all(|g| g.abs() <= MOST_GRAVITY) {
            bail!("gravity {to:?}, expected at most {MOST_GRAVITY} m/s² along each axis");
        }
        self.panels.iter_mut().try_for_each(|panel| panel.rollout.set_gravity(to))?;
        self.setup.gravity = to;
        self.recorder.note(&format!("gravity {to:?} m/s²"), Some("gravity"));
        Ok(())
    }

    /// To one viscosity, or to those of the scene.
    fn change_viscosity(&mut self, to: Option<f32>) -> Result<()> {
        let before: Vec<_> = self.setup.emitters.iter().map(|emitter| emitter.material).collect();
        for (emitter, of_scene) in self.setup.emitters.iter_mut().zip(&self.materials) {
            emitter.material.viscosity = to.or(of_scene.viscosity);
        }
        let solvers = self.panels.iter().map(|panel| self.make(panel.offer)).collect::<Result<Vec<_>>>();
        let ready = solvers.and_then(|solvers| {
            (0..self.panels.len()).try_for_each(|k| self.catch_up(k))?;
            Ok(solvers)
        });
        let solvers = match ready {
            Ok(solvers) => solvers,
            Err(error) => {
                self.setup.emitters.iter_mut().zip(before).for_each(|(emitter, old)| emitter.material = old);
                return Err(error);
            }
        };
        self.panels.iter_mut().zip(solvers).for_each(|(panel, solver)| panel.change(panel.offer, solver));
        let to = to.map_or("of the scene".into(), |to| to.to_string());
        self.recorder.note(&format!("viscosity {to}"), Some("viscosity"));
        Ok(())
    }

    fn change_solver(&mut self, index: usize, name: &str) -> Result<()> {
        self.panel(index)?;
        let offer = self.menu.find(name).with_context(|| format!("no solver {name}"))?;
        let solver = self.make(offer)?;
        self.catch_up(index)?;
        self.panels[index].change(offer, solver);
        let thing = format!("picture {}: solver", index + 1);
        self.recorder.note(&format!("{thing} {name}"), Some(&thing));
        Ok(())
    }

    fn compare(&mut self, on: bool) -> Result<()> {
        if on == (self.panels.len() > 1) {
            return Ok(());
        }
        if !on {
            self.stop_recording()?;
            self.panels.truncate(1);
            return Ok(());
        }
        let first = &self.panels[0];
        let other = self.menu.another(first.offer, &self.path, &self.setup);
        let other = other.context("no other solver takes this scene")?;
        let mut rollout = first.rollout.clone();
        rollout.forget();
        let solver = self.make(other)?;
        // From here on nothing is refused: a recording is of what it began with.
        self.stop_recording()?;
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
            self.news.push(format!("recorded {}", told.join(", ")));
        }
        Ok(())
    }

    fn find_densities(&mut self) {
        let (walls, radius) = (self.setup.boundary.position.as_slice(), self.setup.particle_radius);
        for panel in self.panels.iter_mut().filter(|panel| panel.density.len() != panel.position().len()) {
            panel.density = self.volumes.ratios(panel.position(), walls, radius);
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
        let stepped = self.panels.iter_mut().map(Panel::advance).filter(|stepped| *stepped).count();
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
        let news = std::mem::take(&mut self.news).join("; ");
        (!news.is_empty()).then_some(news)
    }

    fn frame(&mut self, with_density: bool) -> Frame<'_> {
        if with_density {
            self.find_densities();
        }
        let number = self.step();
        Frame {
            number,
            time: number as f64 * self.dt(),
            panels: self.panels.iter().map(|panel| panel.shown(with_density)).collect(),
            ..Frame::default()
        }
    }

    fn describe(&self) -> State {
        let panel = |panel: &Panel| {
            let offer = self.menu.get(panel.offer);
            let materials = self.setup.emitters.iter().map(|emitter| emitter.material);
            let advice = offer.choice.warning(&self.path, materials);
            let warnings: Vec<String> = advice.into_iter().chain(panel.warnings.clone()).collect();
            PanelState {
                label: offer.label.clone(),
                solver: Some(offer.name.clone()),
                error: panel.error.clone(),
                warning: (!warnings.is_empty()).then(|| warnings.join("; ")),
            }
        };
        let step = self.step();
        let emitter = |emitter: &Emitter| fluvia_view::Emitter {
            label: emitter.source.clone(),
            position: bodies::middle(emitter),
            active: emitter.stop > step,
        };
        State {
            title: self.title.clone(),
            dt: self.dt(),
            particle_radius: self.setup.particle_radius,
            up: up(self.setup.gravity),
            gravity: self.setup.gravity,
            scene_gravity: self.gravity,
            viscosity: self.viscosity(),
            viscosities: self.viscosities(),
            panels: self.panels.iter().map(panel).collect(),
            solvers: self.menu.describe(&self.path, &self.setup),
            emitters: self.setup.emitters.iter().filter(|e| bodies::is_movable(e)).map(emitter).collect(),
            recording: self.recorder.directories().map(|directories| Recording { directories }),
            ..blank(Mode::Live)
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::view::panel::tests::Explodes;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    /// A scene in a container, with these keys of its fluid; recordings go below the folder.
    fn live(folder: &tempfile::TempDir, fluid: &str, arguments: &str) -> Live {
        let path = folder.path().join("scene.json");
        let wall = r#"{"shape": "container", "scale": [0.5, 0.8, 0.5]}"#;
        let fluid = format!(r#"{{"shape": "box", "scale": 0.2, "translation": [0, 0.3, 0]{fluid}}}"#);
        std::fs::write(&path, format!(r#"{{"walls": [{wall}], "fluids": [{fluid}]}}"#)).unwrap();
        let line = Line::parse_from(["view"].into_iter().chain(arguments.split(' ')));
        let recorder = Arc::new(Recorder::new(Some(folder.path()), &[]));
        Live::new(&line.args, path.to_str().unwrap(), recorder, &Report::new(true, false)).unwrap()
    }

    fn steps(live: &Live) -> Vec<u64> {
        live.panels.iter().map(|panel| panel.rollout.state().step).collect()
    }

    #[test]
    fn what_stood_still_goes_on_beside_the_other() {
        let folder = tempfile::tempdir().unwrap();
        let mut live = live(&folder, "", "--solver pbf");
        live.obey(&Command::Compare { on: true }).unwrap();
        live.panels[1].solver = Box::new(Explodes(2));
        live.obey(&Command::Record { on: true }).unwrap();
        (0..3).for_each(|_| live.advance(1).unwrap());
        assert_eq!(steps(&live), [3, 0]);
        assert!(live.panels[1].error.is_some() && !live.is_over());
        live.obey(&Command::Solver { panel: 1, name: "dfsph".into() }).unwrap();
        assert_eq!(steps(&live), [3, 3]);
        assert_eq!(live.panels[0].position(), live.panels[1].position());
        assert!(live.panels[1].error.is_none() && live.recorder.directories().is_none());
        let news = live.news().unwrap();
        assert!(news.contains("(4 frames)") && news.contains("(1 frame)"), "{news}");
        assert!(news.ends_with("picture 2 goes on from picture 1"), "{news}");
        live.advance(1).unwrap();
        assert_eq!(steps(&live), [4, 4]);
        // One that is not behind goes on from where it is, and is still recorded.
        live.obey(&Command::Record { on: true }).unwrap();
        live.obey(&Command::Solver { panel: 1, name: "pbf".into() }).unwrap();
        assert!(live.news().is_none() && live.recorder.directories().is_some());
    }

    #[test]
    fn what_begins_again_after_a_failure_says_so() {
        let folder = tempfile::tempdir().unwrap();
        let mut live = live(&folder, "", "--solver pbf");
        live.advance(1).unwrap();
        live.obey(&Command::Reset).unwrap();
        assert!(live.news().is_none(), "it was asked for");
        live.advance(1).unwrap();
        live.panels[0].solver = Box::new(Explodes(2));
        live.advance(1).unwrap();
        assert!(live.is_over());
        live.obey(&Command::Reset).unwrap();
        assert_eq!((steps(&live), live.news().as_deref()), (vec![0], Some("the scene begins again")));
    }

    #[test]
    fn what_is_poured_is_what_the_scene_is_of() {
        let folder = tempfile::tempdir().unwrap();
        let mut live = live(&folder, r#", "viscosity": 0.1, "density": 800"#, "--solver dfsph");
        let poured = live.setup.emitters.last().unwrap().material;
        assert_eq!((poured.viscosity, poured.density), (Some(0.1), Some(800.0)));
        assert_eq!(live.viscosity(), Some(0.1));
        // What is thick surprises with long steps; thin as water it does not.
        let warning = |live: &Live| live.describe().panels[0].warning.clone();
        assert!(warning(&live).unwrap().contains("viscosity 0.1 acts once a step"));
        live.obey(&Command::Viscosity { to: Some(0.01) }).unwrap();
        assert_eq!(warning(&live), None);
        live.obey(&Command::Viscosity { to: Some(0.2) }).unwrap();
        assert!(warning(&live).unwrap().contains("viscosity 0.2"));
        live.obey(&Command::Viscosity { to: None }).unwrap();
        assert_eq!(live.viscosity(), Some(0.1), "that of the scene");
    }

    #[test]
    fn a_slider_that_is_drawn_is_one_change() {
        let folder = tempfile::tempdir().unwrap();
        let mut live = live(&folder, "", "--solver dfsph");
        live.obey(&Command::Record { on: true }).unwrap();
        let gravity = |y| Command::Gravity { to: [0.0, y, 0.0] };
        for command in [gravity(-1.0), Command::Viscosity { to: Some(0.1) }, gravity(-2.0), gravity(-3.0)] {
            live.obey(&command).unwrap();
        }
        live.advance(1).unwrap();
        live.obey(&gravity(-4.0)).unwrap();
        live.obey(&Command::Record { on: false }).unwrap();
        let record = std::fs::read(folder.path().join("scene-001/run.json")).unwrap();
        let record: serde_json::Value = serde_json::from_slice(&record).unwrap();
        let changes = &record["live"]["changes"];
        let change = |frame: u64, what: &str| serde_json::json!({"frame": frame, "what": what});
        assert_eq!(
            changes,
            &serde_json::json!([
                change(0, "viscosity 0.1"),
                change(0, "gravity [0.0, -3.0, 0.0] m/s²"),
                change(1, "gravity [0.0, -4.0, 0.0] m/s²"),
            ])
        );
    }
}

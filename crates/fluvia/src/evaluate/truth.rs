//! What solvers are compared with: frames on disk whose particles are the same ones in all.

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use fluvia_net::evaluate::Truth;
use fluvia_sim::frames::{ParticleData, run, sequence};
use fluvia_sim::metrics::Bounds;
use fluvia_sim::particles::{Boundary, Particles};
use fluvia_sim::scene::{Emitter, Material, Setup};

use crate::curves::{Curves, Surroundings};
use crate::frame_source::{FrameSource, NO_FRAMES, stored_materials};
use crate::record::load_scene;
use crate::report::Report;

/// The folder of a data set that is evaluated if it has one.
pub const VALID: &str = "valid";

/// That of what a network learns from.
const TRAIN: &str = "train";

/// Frames with what a solver has to know of them.
pub struct Recorded {
    /// The last part of its path.
    pub name: String,
    source: FrameSource,
    /// The bodies of the first frame as emitters, and all around them.
    pub setup: Setup,
    /// Of each particle.
    body: Vec<u32>,
    id: Option<Vec<u32>>,
}

/// The paths of all that is to be evaluated: the sequences of a data set's folder `valid` or of the folder itself, one
/// sequence, or the directory of a run.
///
/// # Errors
/// If there is nothing of the kind.
pub fn find(path: &Path) -> Result<Vec<PathBuf>> {
    let valid = path.join(VALID);
    let folder = if valid.is_dir() { valid.as_path() } else { path };
    if folder.is_dir() {
        let found = sequence::find(folder)?;
        if !found.is_empty() {
            return Ok(found.into_iter().map(|files| folder.join(files.name)).collect());
        }
        if run::list(path)?.is_empty() {
            let train = path.join(TRAIN);
            if train.is_dir() && !sequence::find(&train)?.is_empty() {
                let (path, train) = (path.display(), train.display());
                bail!(
                    "{path}: a data set without the folder {VALID}; expected one with it, or a folder like {train}"
                );
            }
            bail!("{}: {NO_FRAMES}", path.display());
        }
    }
    Ok(vec![path.to_path_buf()])
}

impl Recorded {
    /// Opens a sequence or the directory of a run; `dt` counts where none is recorded.
    ///
    /// # Errors
    /// If the first frame cannot be read, has no particles, or there are no walls where a solver looks for them.
    pub fn open(path: &Path, dt: Option<f32>, report: &Report) -> Result<Recorded> {
        let mut source = FrameSource::open(path, dt)?;
        let numbers = source.numbers();
        let (first, last) = (numbers[0], numbers[numbers.len() - 1]);
        if last - first + 1 != numbers.len() as u64 {
            bail!("{}: frames are missing between {first} and {last}", path.display());
        }
        let (data, radius) = (source.read(first)?, source.particle_radius);
        let (body, materials) = match source.frame_of_sequence(first)? {
            Some(frame) => bodies(stored_materials(frame, radius)),
            None => {
                let body = data.body.clone().unwrap_or_else(|| vec![0; data.position.len()]);
                let count = body.iter().max().map_or(0, |&body| body as usize + 1);
                (body, recorded_materials(&source, count, report))
            }
        };
        let walls = source.walls().clone();
        let boundary = Boundary { normal: walls.normal.unwrap_or_default(), position: walls.position };
        boundary.check().map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))?;
        let whole = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
        let name = whole.file_name().map_or("frames".into(), |name| name.to_string_lossy().into_owned());
        let setup = Setup {
            boundary,
            walls: Vec::new(),
            emitters: Vec::new(),
            gravity: source.gravity,
            dt: source.dt as f32,
            particle_radius: source.particle_radius,
        };
        let mut recorded = Recorded { name, setup, body, id: data.id.clone(), source };
        let particles = recorded.check(first, data)?;
        if particles.is_empty() {
            bail!("{}: no particles in frame {first}", path.display());
        }
        recorded.setup.emitters = emitters(&particles, &materials);
        Ok(recorded)
    }

    /// What was opened.
    pub fn path(&self) -> &Path {
        self.source.path()
    }

    /// Gives the memory back that its last frames took.
    pub fn unload(&mut self) {
        self.source.unload();
    }

    /// Seconds between frames.
    pub fn dt(&self) -> f64 {
        self.source.dt
    }

    /// No curves yet.
    pub fn curves(&self, label: &str) -> Curves {
        let Setup { boundary, gravity, particle_radius, .. } = &self.setup;
        let (gravity, particle_radius) = (*gravity, *particle_radius);
        let scene = Surroundings { walls: Bounds::of(&boundary.position), particle_radius, gravity };
        Curves::new(label, self.path(), scene)
    }

    /// A frame as particles, if they are those of the first.
    fn check(&self, number: u64, data: ParticleData) -> fluvia_sim::Result<Particles> {
        let ParticleData { position, velocity, id, .. } = data;
        let wrong =
            |message: String| Err(fluvia_sim::Error::file(self.path(), format!("frame {number}: {message}")));
        if position.len() == self.body.len() && id != self.id {
            return wrong("other particles than in the first frame, by their ids".into());
        }
        if position.len() != self.body.len() {
            let (found, expected) = (position.len(), self.body.len());
            return wrong(format!(
                "{found} particles, expected the {expected} of the first frame: what an emitter gives cannot be followed"
            ));
        }
        let Some(velocity) = velocity else { return wrong("no velocities".into()) };
        let finite = |x: &[f32; 3]| x.iter().all(|c| c.is_finite());
        if let Some(row) = position.iter().zip(&velocity).position(|(x, v)| !(finite(x) && finite(v))) {
            return wrong(format!("particle {row} has a number that is not finite"));
        }
        Ok(Particles { body: self.body.clone(), ..Particles::of_one_body(position, velocity) })
    }
}

impl Truth for Recorded {
    fn frames(&self) -> Range<u64> {
        let numbers = self.source.numbers();
        numbers[0]..numbers[0] + numbers.len() as u64
    }

    fn particles(&mut self, number: u64) -> fluvia_net::Result<Particles> {
        let data = self.source.read(number)?;
        Ok(self.check(number, data)?)
    }
}

/// Particles of one material are one body: the body of each particle and the material of each body.
fn bodies(materials: impl Iterator<Item = Material>) -> (Vec<u32>, Vec<Material>) {
    let mut known: Vec<Material> = Vec::new();
    let body = materials.map(|material| {
        let place = known.iter().position(|other| *other == material);
        place.unwrap_or_else(|| {
            known.push(material);
            known.len() - 1
        }) as u32
    });
    (body.collect(), known)
}

/// The materials of the bodies of a run, from its scene if that is still where it was.
fn recorded_materials(source: &FrameSource, count: usize, report: &Report) -> Vec<Material> {
    let scene = source.record().and_then(|record| {
        let (scene, file) = load_scene(&record.scene.name).ok()?;
        (file.sha256 == record.scene.sha256).then_some(scene)
    });
    let mut materials = scene.map_or_else(
        || {
            let path = source.path().display();
            report.warning(format_args!("{path}: its scene is not known: its fluids count as water"));
            Vec::new()
        },
        |scene| scene.materials(),
    );
    materials.resize(count.max(materials.len()), Material::default());
    materials
}

/// The bodies as what a scene would have emitted.
fn emitters(particles: &Particles, materials: &[Material]) -> Vec<Emitter> {
    let of_body = |body: usize, values: &[[f32; 3]]| {
        let own = particles.body.iter().zip(values).filter(|(own, _)| **own as usize == body);
        own.map(|(_, value)| *value).collect()
    };
    let emitter = |(body, &material): (usize, &Material)| Emitter {
        source: String::new(),
        path: None,
        position: of_body(body, &particles.position),
        velocity: of_body(body, &particles.velocity),
        unused_velocity: None,
        start: 0,
        stop: 1,
        step: 1,
        material,
    };
    materials.iter().enumerate().map(emitter).collect()
}

//! What a run is made from, and `run.json`, the record of that and of how it went.

use std::path::Path;

use anyhow::{Context, Result};
use fluvia_sim::metrics::Bounds;
use fluvia_sim::rollout;
use fluvia_sim::scene::{self, Scene, Setup};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

/// The record of a run, as it is on disk. Units are metres and seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The version of the program.
    pub version: String,
    pub scene: Source,
    pub weights: Option<Source>,
    /// A hash of all particles of the walls and the emitters, so that a changed mesh shows.
    pub particles_sha256: String,
    pub seed: u64,
    /// "dfsph", "pbf" or "network".
    pub solver: String,
    /// The parameters of the solver.
    pub parameters: Value,
    /// The instruction set that computes: results of one are the same bits everywhere, of two they are not.
    pub kernel: String,
    /// What computed the first steps, if the run was resumed by another version or kernel.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub earlier: Vec<Earlier>,
    pub threads: usize,
    pub formats: Vec<String>,
    /// Seconds between frames.
    pub dt: f32,
    pub particle_radius: f32,
    pub gravity: [f32; 3],
    /// Steps asked for.
    pub steps: u64,
    /// What was done to a run that somebody watched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<Live>,
    /// How the run went, once it has ended.
    pub summary: Option<Summary>,
}

/// What was done to a run that `fluvia view` recorded.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Live {
    /// The step of the simulation that is frame 0 of the recording.
    pub first_step: u64,
    pub changes: Vec<Change>,
}

/// Something that was changed while a recording ran.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// The frame of the recording that it follows.
    pub frame: u64,
    /// In words.
    pub what: String,
}

/// What computed the steps of a run up to one of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Earlier {
    pub version: String,
    pub kernel: String,
    /// The last of the steps.
    pub until_step: u64,
}

/// A file and what was in it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// The path, or the name of a shipped scene or of shipped weights.
    pub name: String,
    pub sha256: String,
}

/// The end of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Particles in the last frame.
    pub particles: usize,
    /// Steps done.
    pub steps: u64,
    /// The mean time of a step, milliseconds, files not included.
    pub ms_per_step: f64,
    /// Metres per second.
    pub highest_speed: f32,
    /// Particles more than a radius beyond the walls' bounding box, in the last frame.
    pub outside: usize,
    /// The same in the worst frame.
    pub worst_outside: usize,
    /// Particles that fell out of the scene.
    pub removed: u64,
    /// Iterations of the solver that ended at their limit, short of their tolerance.
    #[serde(default)]
    pub unconverged: u64,
}

impl Summary {
    pub fn new(state: &rollout::State, ms_per_step: f64) -> Summary {
        let rollout::Summary { outside, worst_outside, removed, highest_speed, unconverged } = state.summary;
        Summary {
            particles: state.particles.len(),
            steps: state.step,
            ms_per_step,
            highest_speed,
            outside,
            worst_outside,
            removed,
            unconverged,
        }
    }
}

impl Record {
    /// The first thing in which this run differs from the one that it would continue: its name, the old value
    /// and the new one. Threads and the number of steps may differ.
    pub fn difference(&self, old: &Record) -> Option<(String, String, String)> {
        let hash = |source: &Option<Source>| source.as_ref().map_or("none".into(), |s| s.sha256.clone());
        let fields = [
            ("scene (sha256)", &old.scene.sha256, &self.scene.sha256),
            ("weights (sha256)", &hash(&old.weights), &hash(&self.weights)),
            ("seed", &old.seed.to_string(), &self.seed.to_string()),
            ("sampled particles (sha256)", &old.particles_sha256, &self.particles_sha256),
            ("solver", &old.solver, &self.solver),
            ("formats", &old.formats.join(","), &self.formats.join(",")),
        ]
        .map(|(name, old, new)| (name.to_owned(), old.clone(), new.clone()));
        fields
            .into_iter()
            .find(|(_, old, new)| old != new)
            .or_else(|| first_difference("solver's parameters", &old.parameters, &self.parameters))
    }
}

/// The first entry in which two JSON objects differ: its key, with `prefix`, and both values.
pub fn first_difference(prefix: &str, old: &Value, new: &Value) -> Option<(String, String, String)> {
    match (old, new) {
        (Value::Object(olds), Value::Object(news)) => olds.keys().chain(news.keys()).find_map(|key| {
            let name = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
            first_difference(&name, &old[key.as_str()], &new[key.as_str()])
        }),
        _ if old == new => None,
        _ => {
            let shown = |value: &Value| if value.is_null() { "none".into() } else { value.to_string() };
            Some((prefix.to_owned(), shown(old), shown(new)))
        }
    }
}

/// Reads a file that must be there whole, and its hash.
pub fn read_source(path: &Path) -> Result<(Vec<u8>, Source)> {
    let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
    let source = Source { name: path.display().to_string(), sha256: sha256(&bytes) };
    Ok((bytes, source))
}

/// The scene of that path, or the shipped scene of that name.
pub fn load_scene(name: &str) -> Result<(Scene, Source)> {
    let path = Path::new(name);
    match scene::shipped(name) {
        // A directory of that name is likely a run of the scene.
        Some(text) if !path.is_file() => {
            let source = Source { name: name.into(), sha256: sha256(text.as_bytes()) };
            Ok((Scene::parse(text.as_bytes(), name)?, source))
        }
        _ => {
            let scene = Scene::load(path)
                .map_err(|error| or_shipped(error.into(), path, "scene", scene::shipped_names()))?;
            Ok((scene, read_source(path)?.1))
        }
    }
}

/// The error of a file that is not there, with the names that there are if one of them may have been meant.
pub fn or_shipped(
    error: anyhow::Error,
    path: &Path,
    what: &str,
    names: impl Iterator<Item = &'static str>,
) -> anyhow::Error {
    if path.extension().is_some() || path.exists() {
        return error;
    }
    error.context(format!("no shipped {what} (there are {})", names.collect::<Vec<_>>().join(", ")))
}

/// The shortest decimal number that is this float32, for JSON values, which hold float64.
pub fn decimal(x: f32) -> f64 {
    x.to_string().parse().unwrap_or(f64::from(x))
}

/// The lowest and the highest coordinates, metres.
pub fn bounds(points: &[[f32; 3]]) -> Option<[[f64; 3]; 2]> {
    Bounds::of(points).map(|bounds| [bounds.low.map(decimal), bounds.high.map(decimal)])
}

/// The hash of some bytes as hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// A hash of all particles of a set-up.
pub fn hash_particles(setup: &Setup) -> String {
    let mut hash = Sha256::new();
    let mut add = |points: &[[f32; 3]]| {
        hash.update((points.len() as u64).to_le_bytes());
        points.iter().flatten().for_each(|x| hash.update(x.to_le_bytes()));
    };
    add(&setup.boundary.position);
    add(&setup.boundary.normal);
    for emitter in &setup.emitters {
        add(&emitter.position);
        add(&emitter.velocity);
    }
    hex(&hash.finalize())
}

/// A hash of the particles of a state.
pub fn hash_state(state: &rollout::State) -> String {
    let mut hash = Sha256::new();
    let rollout::State { particles, .. } = state;
    let floats = particles.position.iter().chain(&particles.velocity).flatten();
    floats.for_each(|x| hash.update(x.to_le_bytes()));
    hex(&hash.finalize())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

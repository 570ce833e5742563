//! The state file of a run: everything that a killed run needs to go on to the same bits.
//!
//! It is an npz archive, so that it can be looked at with NumPy: `format`, `step`, `next_id`, `removed`, the particles as
//! in a frame, `memory` (N, 2) if the solver keeps something of each particle, and `counter/NAME` for statistics. It is
//! written after the frames of its step: they are whole when it names them.

use std::collections::BTreeMap;
use std::path::Path;

use super::npz::{self, Array, Values};
use super::numbers::Parsed;
use super::write_atomically;
use crate::particles::Particles;
use crate::{Error, Result};

/// The state of a run after a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// The number of steps done; frame `step` is the last that is on disk.
    pub step: u64,
    /// The particles.
    pub particles: Particles,
    /// The identity of the next particle that is emitted.
    pub next_id: u32,
    /// How many particles have been removed.
    pub removed: u64,
    /// The caller's statistics, by name; any bits, also those that are not finite.
    pub counters: BTreeMap<String, f64>,
}

impl State {
    /// Writes the state atomically.
    ///
    /// # Errors
    /// `Io`; `Parameter` if a vector has not one entry a particle.
    pub fn save(&self, path: &Path) -> Result<()> {
        let particles = &self.particles;
        let count = particles.len();
        let memory = particles.memory.len();
        let lengths = [particles.velocity.len(), particles.id.len(), particles.body.len()];
        if lengths.iter().any(|&length| length != count) || (memory != 0 && memory != count) {
            let message = format!(
                "state of {count} positions has {lengths:?} velocities, ids, bodies and {memory} memories"
            );
            return Err(Error::Parameter(message));
        }
        let (format, step, removed, next_id) = ([FORMAT], [self.step], [self.removed], [self.next_id]);
        let one = |name: &str| (name.to_owned(), Vec::new());
        let vector = |name: &str| (name.to_owned(), vec![count, 3]);
        let row = |name: &str| (name.to_owned(), vec![count]);
        let mut arrays = vec![
            (one("format"), Values::U32(&format)),
            (one("step"), Values::U64(&step)),
            (one("next_id"), Values::U32(&next_id)),
            (one("removed"), Values::U64(&removed)),
            (vector("pos"), Values::F32(particles.position.as_flattened())),
            (vector("vel"), Values::F32(particles.velocity.as_flattened())),
            (row("id"), Values::U32(&particles.id)),
            (row("body"), Values::U32(&particles.body)),
        ];
        for (name, value) in &self.counters {
            arrays.push((one(&format!("{COUNTER}{name}")), Values::F64(std::slice::from_ref(value))));
        }
        if memory > 0 {
            arrays
                .push((("memory".to_owned(), vec![count, 2]), Values::F32(particles.memory.as_flattened())));
        }
        write_atomically(path, |out| {
            npz::write_arrays(arrays.into_iter().map(|((name, shape), values)| (name, shape, values)), out)
        })
    }

    /// Reads a state.
    ///
    /// # Errors
    /// `Io`; `File` if it is damaged or of another version.
    pub fn load(path: &Path) -> Result<State> {
        let bytes = std::fs::read(path).map_err(Error::io(path))?;
        parse(&bytes).map_err(|message| Error::file(path, message))
    }
}

/// The version of this layout.
const FORMAT: u32 = 1;
const COUNTER: &str = "counter/";

fn parse(bytes: &[u8]) -> Parsed<State> {
    let mut arrays = npz::parse_arrays(bytes)?;
    let format = whole(&arrays, "format")?;
    if format != u64::from(FORMAT) {
        return Err(format!("state of version {format}, expected {FORMAT}"));
    }
    let data = npz::parse(bytes)?.check()?;
    let count = data.position.len();
    let missing = |name: &str| format!("no array '{name}' in this state");
    let particles = Particles {
        position: data.position,
        velocity: data.velocity.ok_or_else(|| missing("vel"))?,
        id: data.id.ok_or_else(|| missing("id"))?,
        body: data.body.ok_or_else(|| missing("body"))?,
        memory: Vec::new(),
    };
    let next_id = whole(&arrays, "next_id")?;
    let next_id = u32::try_from(next_id).map_err(|_| format!("'next_id' is {next_id}, expected 32 bits"))?;
    let (step, removed) = (whole(&arrays, "step")?, whole(&arrays, "removed")?);
    let mut state = State { step, particles, next_id, removed, ..State::default() };
    if let Some(memory) = arrays.remove("memory") {
        if memory.shape != [count, 2] {
            return Err(format!("array 'memory' has shape {:?}, expected ({count}, 2)", memory.shape));
        }
        let pairs = memory.values.chunks_exact(2).map(|pair| [pair[0] as f32, pair[1] as f32]);
        state.particles.memory = pairs.collect();
    }
    for (name, array) in arrays {
        if let Some(counter) = name.strip_prefix(COUNTER) {
            let [value] = array.values[..] else { return Err(format!("'{name}' is not one number")) };
            state.counters.insert(counter.to_owned(), value);
        }
    }
    Ok(state)
}

fn whole(arrays: &BTreeMap<String, Array>, name: &str) -> Parsed<u64> {
    let Some(array) = arrays.get(name) else { return Err(format!("no state of a run: no array '{name}'")) };
    match array.values[..] {
        // A cast saturates, so a fraction or a negative number does not come back equal.
        [value] if value as u64 as f64 == value => Ok(value as u64),
        _ => Err(format!("'{name}' is not one whole number")),
    }
}

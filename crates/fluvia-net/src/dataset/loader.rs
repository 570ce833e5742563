//! Reading ahead: one thread reads, decompresses and puts together batches, another takes them.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use fluvia_neighbors::Point;
use fluvia_sim::frames::sequence::Part;

use super::order::{Order, below, stream};
use super::{Batch, DataSet, FreeFall, Noise, PartFile, Rotation};
use crate::{Error, Result};

/// Batches that are ready before they are asked for.
const AHEAD: usize = 4;

/// What of the random numbers is for rotations, for noise, for particles that fall and for the lead.
const ROTATIONS: u64 = u64::MAX - 1;
const NOISE: u64 = u64::MAX - 2;
const FALL: u64 = u64::MAX - 3;
const LEAD: u64 = u64::MAX - 4;

/// What is done about a part that cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damaged {
    /// It ends the training.
    Stop,
    /// Its windows are left out, and the loader names it.
    Skip,
}

/// What batches are made of.
#[derive(Clone, Debug, PartialEq)]
pub struct Sampling {
    /// Seed of the order and of the rotations.
    pub seed: u64,
    /// Windows of a batch.
    pub batch: usize,
    /// Steps of a window that count.
    pub steps: usize,
    /// The most steps before those, without gradient: each batch has its own number of them, from 0 on.
    pub lead: usize,
    /// Parts that are together in memory.
    pub group: usize,
    /// The axis of random rotations; `None` turns nothing.
    pub axis: Option<Point>,
    /// What is added to the states that windows start from.
    pub noise: Noise,
    /// What every batch has beside its windows.
    pub free: FreeFall,
    /// Whether particles have their viscosity as an extra input.
    pub viscosity: bool,
    /// How far from the fluid wall particles are kept, metres.
    pub reach: f32,
    /// What is done about parts that cannot be read.
    pub damaged: Damaged,
}

impl Sampling {
    /// Frames of a window.
    pub fn frames(&self) -> usize {
        self.lead + self.steps + 1
    }
}

/// A batch, and the position of the stream after its last window: where a training that has used it goes on.
#[derive(Debug)]
pub struct Loaded {
    /// The batch.
    pub batch: Batch,
    /// Where to go on.
    pub next: u64,
    /// Parts that were left out since the batch before, and why.
    pub skipped: Vec<String>,
}

/// Batches from a thread of their own, in the order of the stream.
#[derive(Debug)]
pub struct Loader {
    batches: Receiver<Result<Loaded>>,
    thread: Option<JoinHandle<()>>,
}

impl Loader {
    /// Starts to read from a position of the stream.
    ///
    /// # Errors
    /// As [`DataSet::check_windows`].
    pub fn start(data: &DataSet, sampling: Sampling, position: u64) -> Result<Loader> {
        data.check_windows(sampling.frames())?;
        let windows = data.windows(sampling.frames());
        let order = Order::new(sampling.seed, windows, sampling.group);
        let files = data.parts().to_vec();
        let (sender, batches) = sync_channel(AHEAD);
        let thread = std::thread::spawn(move || {
            let mut reader = Reader { order, files, sampling, position, skipped: Vec::new() };
            // Ends when nobody takes batches any more.
            if let Err(error) = reader.run(&sender) {
                let _ = sender.send(Err(error));
            }
        });
        Ok(Loader { batches, thread: Some(thread) })
    }

    /// The next batch.
    ///
    /// # Errors
    /// As [`PartFile::read`] for a damaged part, unless those are left out; `Parameter` if nothing is left.
    pub fn take(&mut self) -> Result<Loaded> {
        self.batches.recv().unwrap_or_else(|_| Err(Error::Parameter("the data loader has ended".into())))
    }
}

impl Drop for Loader {
    fn drop(&mut self) {
        // A closed channel ends the thread.
        let (_, closed) = sync_channel(0);
        self.batches = closed;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread works with.
struct Reader {
    order: Order,
    files: Vec<PartFile>,
    sampling: Sampling,
    position: u64,
    skipped: Vec<String>,
}

impl Reader {
    /// Makes batches until nobody takes them.
    fn run(&mut self, sender: &SyncSender<Result<Loaded>>) -> Result<()> {
        let size = self.sampling.batch;
        let mut batch = self.begin();
        // Windows in a row that could not be read.
        let mut missed = 0;
        while let Some(group) = self.order.group_of(self.position) {
            let parts = self.read(group.windows.iter().map(|window| window.part))?;
            while self.position < group.positions.end {
                let window = group.windows[(self.position - group.positions.start) as usize];
                let rotation = self.rotation();
                let mut noise = stream(self.sampling.seed, [NOISE, self.position]);
                self.position += 1;
                let Some(part) = &parts[window.part] else {
                    missed += 1;
                    if missed > self.order.epoch_length() {
                        return Err(Error::Parameter("no part of the data set can be read".into()));
                    }
                    continue;
                };
                missed = 0;
                let Sampling { viscosity, reach, .. } = self.sampling;
                batch.push(part, window.first, &rotation, viscosity, reach);
                batch.disturb(self.sampling.noise, &mut noise);
                if batch.clouds.len() > size {
                    let next = self.begin();
                    let mut batch = std::mem::replace(&mut batch, next);
                    let mut fall = stream(self.sampling.seed, [FALL, self.position]);
                    batch.push_free(self.sampling.free, &mut fall);
                    let skipped = std::mem::take(&mut self.skipped);
                    let loaded = Loaded { batch, next: self.position, skipped };
                    if sender.send(Ok(loaded)).is_err() {
                        return Ok(());
                    }
                }
            }
        }
        Ok(())
    }

    /// The batch whose first window is at the position.
    fn begin(&self) -> Batch {
        let Sampling { seed, steps, lead, .. } = self.sampling;
        let lead = below(&mut stream(seed, [LEAD, self.position]), lead as u64 + 1) as usize;
        Batch::new(steps, lead)
    }

    /// The rotation of the window at the position.
    fn rotation(&self) -> Rotation {
        let Sampling { seed, axis, .. } = self.sampling;
        axis.map_or(Rotation::NONE, |axis| {
            Rotation::random(axis, &mut stream(seed, [ROTATIONS, self.position]))
        })
    }

    /// The parts that windows come from, each at its index.
    fn read(&mut self, wanted: impl Iterator<Item = usize>) -> Result<Vec<Option<Part>>> {
        let mut parts: Vec<Option<Part>> = vec![None; self.files.len()];
        let mut tried = vec![false; self.files.len()];
        for k in wanted {
            if std::mem::replace(&mut tried[k], true) {
                continue;
            }
            match self.files[k].read() {
                Ok(part) => parts[k] = Some(part),
                Err(error) if self.sampling.damaged == Damaged::Skip => self.skipped.push(error.to_string()),
                Err(error) => return Err(error),
            }
        }
        Ok(parts)
    }
}

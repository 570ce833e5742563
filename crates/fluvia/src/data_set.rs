//! What `fluvia inspect` says of a sequence and of a data set. Every frame is read, so that damage shows.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context, Result, bail};
use fluvia_sim::frames::sequence::{self, Frame, Sequence, SequenceFiles};
use fluvia_sim::scene::DEFAULT_DT;
use fluvia_sim::{frames, metrics};
use rayon::prelude::*;
use serde_json::{Map, Value, json};

use crate::frame_source::recorded_scene;
use crate::generate::MANIFEST;
use crate::record::{bounds, decimal};
use crate::report::Report;

/// Lists of more than this many entries are shown as their number.
const LONGEST_LIST: usize = 16;

/// What a sequence, or several, hold.
struct Content {
    sequences: usize,
    frames: u64,
    /// The fewest and the most in a sequence.
    particles: [usize; 2],
    /// All values there are, as the bits of numbers that are not negative: they sort alike.
    viscosities: BTreeSet<u32>,
    highest_speed: f32,
    bytes: u64,
}

/// Describes a sequence, with `dt` seconds between frames.
pub fn sequence(files: SequenceFiles, dt: f32) -> Result<Value> {
    let (sequence, content, last) = read(files)?;
    let recorded = recorded_scene(&sequence)?;
    let dt = recorded.map_or(dt, |scene| scene.dt.unwrap_or(DEFAULT_DT));
    let numbers = sequence.frames();
    let mut found = json!({
        "kind": "sequence",
        "scene": sequence.scene(),
        "parts": sequence.parts().len(),
        "frames": format!("{} to {}", numbers.start, numbers.end - 1),
        "particles": sequence.particles(),
        "wall_particles": sequence.walls().position.len(),
        "wall_bounds_m": bounds(&sequence.walls().position),
    });
    add(&mut found, content.summary(dt), &["sequences", "frames", "particles"]);
    found["mass_kg"] = json!(range(&last.mass));
    found["last_frame"] = json!({
        "bounds_m": bounds(&last.position),
        "highest_speed_m_per_s": decimal(metrics::highest_speed(&last.velocity)),
    });
    Ok(found)
}

/// Describes the data set in a folder: sequences in it and in the folders in it (`train`, `valid`). `None` if there
/// are none.
pub fn folder(path: &Path, dt: f32, report: &Report) -> Result<Option<Value>> {
    let mut groups = vec![(String::new(), sequence::find(path)?)];
    let entries = std::fs::read_dir(path).with_context(|| path.display().to_string())?;
    for entry in entries {
        let entry = entry.with_context(|| path.display().to_string())?;
        if entry.path().is_dir() {
            groups.push((entry.file_name().to_string_lossy().into_owned(), sequence::find(&entry.path())?));
        }
    }
    groups.retain(|(_, files)| !files.is_empty());
    groups.sort_by(|(a, _), (b, _)| a.cmp(b));
    let manifest = path.join(MANIFEST);
    let manifest: Value = if manifest.exists() { frames::read_json(&manifest)? } else { Value::Null };
    let dt = manifest["dt"].as_f64().map_or(dt, |dt| dt as f32);
    let complete = manifest["complete"] == true;
    let frames = manifest["frames"].as_u64().filter(|_| complete);
    let count: usize = groups.iter().map(|(_, files)| files.len()).sum();
    let expected = manifest["records"].as_array().map(Vec::len).filter(|_| complete);
    if let Some(expected) = expected.filter(|&expected| expected != count) {
        bail!("{}: {count} sequences, expected {expected} as the manifest has", path.display());
    }
    let mut found = match groups.as_slice() {
        [] => return Ok(None),
        [(name, files)] if name.is_empty() && files.len() == 1 => sequence(files[0].clone(), dt)?,
        _ => data_set(groups, dt, frames, report)?,
    };
    found["manifest"] = shortened(manifest);
    Ok(Some(found))
}

/// `frames` are those that every sequence must have, if that is known.
fn data_set(
    groups: Vec<(String, Vec<SequenceFiles>)>,
    dt: f32,
    frames: Option<u64>,
    report: &Report,
) -> Result<Value> {
    let count: usize = groups.iter().map(|(_, files)| files.len()).sum();
    let bar = report.bar(count as u64);
    let mut total: Option<Content> = None;
    let (mut folders, mut rows) = (Map::new(), Vec::new());
    for (name, files) in groups {
        // In order, so that of two damaged files the first is named.
        let read: Vec<Result<_>> = files
            .into_par_iter()
            .map(|files| {
                let read = read(files);
                bar.inc(1);
                read
            })
            .collect();
        let mut group: Option<Content> = None;
        for one in read {
            let (sequence, content, _) = one?;
            if let Some(expected) = frames.filter(|&expected| expected != content.frames) {
                let (scene, found) = (sequence.scene(), content.frames);
                bail!("{name}/{scene}: {found} frames, expected {expected} as the manifest has");
            }
            let mut row = json!({ "scene": sequence.scene(), "particles": sequence.particles() });
            add(&mut row, content.summary(dt), &["sequences", "particles", "dt_s"]);
            rows.push(row);
            group = Some(content.joined(group));
        }
        if let Some(group) = group {
            if !name.is_empty() {
                folders.insert(name, group.summary(dt));
            }
            total = Some(group.joined(total));
        }
    }
    bar.finish_and_clear();
    let mut found = json!({ "kind": "data set" });
    add(&mut found, total.map_or(Value::Null, |total| total.summary(dt)), &[]);
    found["folders"] = Value::Object(folders);
    if rows.len() <= LONGEST_LIST {
        found["scenes"] = Value::Array(rows);
    }
    Ok(found)
}

/// Reads all frames of a sequence; gives the last of them too.
fn read(files: SequenceFiles) -> Result<(Sequence, Content, Frame)> {
    let sequence = Sequence::of(files)?;
    let numbers = sequence.frames();
    let mut content = Content {
        sequences: 1,
        frames: numbers.end - numbers.start,
        particles: [sequence.particles(); 2],
        viscosities: BTreeSet::new(),
        highest_speed: 0.0,
        bytes: 0,
    };
    let mut last = Frame::default();
    for (k, path) in sequence.parts().iter().enumerate() {
        content.bytes += std::fs::metadata(path).with_context(|| path.display().to_string())?.len();
        let part = sequence.read_part(k)?;
        for frame in &part.frames {
            // A body's particles stand together and have one viscosity.
            let bodies = frame.viscosity.chunk_by(|a, b| a == b).map(|body| body[0].max(0.0).to_bits());
            content.viscosities.extend(bodies);
            content.highest_speed = content.highest_speed.max(metrics::highest_speed(&frame.velocity));
        }
        last = part.frames.into_iter().next_back().unwrap_or_default();
    }
    Ok((sequence, content, last))
}

impl Content {
    fn joined(mut self, other: Option<Content>) -> Content {
        let Some(mut other) = other else { return self };
        self.sequences += other.sequences;
        self.frames += other.frames;
        let ([low, high], [other_low, other_high]) = (self.particles, other.particles);
        self.particles = [low.min(other_low), high.max(other_high)];
        self.viscosities.append(&mut other.viscosities);
        self.highest_speed = self.highest_speed.max(other.highest_speed);
        self.bytes += other.bytes;
        self
    }

    fn summary(&self, dt: f32) -> Value {
        let intervals = self.frames - self.sequences as u64;
        let viscosities: Vec<f32> = self.viscosities.iter().map(|&bits| f32::from_bits(bits)).collect();
        let mut found = json!({
            "sequences": self.sequences,
            "frames": self.frames,
            "particles": self.particles,
            "viscosity": range(&viscosities),
            "duration_s": decimal((intervals as f64 * decimal(dt)) as f32),
            "dt_s": decimal(dt),
            "highest_speed_m_per_s": decimal(self.highest_speed),
            "bytes": self.bytes,
        });
        if (2..=LONGEST_LIST).contains(&viscosities.len()) {
            found["viscosities"] = json!(viscosities.into_iter().map(decimal).collect::<Vec<_>>());
        }
        found
    }
}

/// Adds the entries of `more` to those of `found`, but for some.
fn add(found: &mut Value, more: Value, without: &[&str]) {
    if let (Value::Object(found), Value::Object(more)) = (found, more) {
        found.extend(more.into_iter().filter(|(key, _)| !without.contains(&key.as_str())));
    }
}

/// The least and the greatest of some numbers.
fn range(values: &[f32]) -> Option<[f64; 2]> {
    let first = *values.first()?;
    let (low, high) = values.iter().fold((first, first), |(low, high), &x| (low.min(x), high.max(x)));
    Some([decimal(low), decimal(high)])
}

/// A manifest without the lists that would fill the screen: long ones, and those of objects.
fn shortened(value: Value) -> Value {
    let inner = |value: Value| match &value {
        Value::Array(items) if items.len() > LONGEST_LIST || items.iter().any(Value::is_object) => {
            json!(format!("{} entries", items.len()))
        }
        Value::Object(entries) if entries.len() > LONGEST_LIST => json!(format!("{} entries", entries.len())),
        _ => shortened(value),
    };
    match value {
        Value::Object(entries) => entries.into_iter().map(|(key, value)| (key, inner(value))).collect(),
        value => value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lists_of_a_manifest_are_counted() {
        let scenes: Vec<Value> = (0..17).map(|k| json!({ "scene": k })).collect();
        let manifest = json!({ "seed": 1, "presets": { "all": scenes, "few": [1, 2] }, "scenes": scenes });
        let few =
            json!({ "seed": 1, "presets": { "all": "17 entries", "few": [1, 2] }, "scenes": "17 entries" });
        assert_eq!(shortened(manifest), few);
    }
}

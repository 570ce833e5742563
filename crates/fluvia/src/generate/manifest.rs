//! `manifest.json` of a data set: its settings, and the records of the scenes that are done.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use fluvia_sim::frames;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::plan::{Plan, Settings, Split};
use super::scene::{Reason, Record, Replaced};
use super::{Task, folder};
use crate::record::first_difference;

/// Its name.
pub const FILE: &str = "manifest.json";

/// The folders beside it.
const FOLDERS: [&str; 2] = [Split::Train.folder(), Split::Valid.folder()];

/// The manifest, as it is on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    #[serde(flatten)]
    pub settings: Settings,
    /// Whether all scenes are done.
    pub complete: bool,
    /// Scenes that blew up and were replaced.
    pub replaced: usize,
    /// The scenes that are done, in their order.
    pub records: Vec<Record>,
}

/// Makes the directories, and sure that what is there is of the same set. Where this is no `shard`, what a killed command
/// has left of a manifest is removed: no other can be writing it.
///
/// # Errors
/// If the directory holds another data set, or something else.
pub fn begin(out: &Path, settings: &Settings, shard: bool) -> Result<()> {
    let path = out.join(FILE);
    if path.exists() {
        let old: Manifest = frames::read_json(&path)?;
        let value = |settings: &Settings| serde_json::to_value(settings);
        let (old, new) = (value(&old.settings)?, value(settings)?);
        if let Some((key, old, new)) = first_difference("", &old, &new) {
            bail!("{}: not the same data set, its {key}: {old}, now: {new}", path.display());
        }
    } else {
        refuse_other_files(out)?;
        let manifest =
            Manifest { settings: settings.clone(), complete: false, replaced: 0, records: Vec::new() };
        make_folder(out)?;
        frames::write_json(&path, &manifest)?;
    }
    if !shard {
        frames::remove_temporaries(out, |target| target == FILE)?;
    }
    FOLDERS.iter().try_for_each(|name| make_folder(&out.join(name)))
}

/// The settings of the data set that a folder of sequences belongs to; null where there is no manifest.
///
/// # Errors
/// If the manifest cannot be read.
pub fn settings_of(sequences: &Path) -> Result<Value> {
    let path = sequences.parent().unwrap_or(Path::new("")).join(FILE);
    if !path.exists() {
        return Ok(Value::Null);
    }
    Ok(serde_json::to_value(frames::read_json::<Manifest>(&path)?.settings)?)
}

fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).with_context(|| path.display().to_string())
}

/// A directory without a manifest must hold nothing but what another shard has just begun with.
fn refuse_other_files(out: &Path) -> Result<()> {
    let entries = match std::fs::read_dir(out) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        entries => entries.with_context(|| out.display().to_string())?,
    };
    for entry in entries {
        let name = entry.with_context(|| out.display().to_string())?.file_name();
        let name = name.to_string_lossy();
        if !(FOLDERS.contains(&name.as_ref()) || name.starts_with('.')) {
            let out = out.display();
            bail!("{out}: holds files ({name}), but no {FILE}; expected an empty directory or a data set");
        }
    }
    Ok(())
}

/// Writes the manifest with the scenes that are done, whoever made them.
///
/// # Errors
/// If a record cannot be read or the manifest cannot be written.
pub fn write(out: &Path, plan: &Plan) -> Result<Manifest> {
    loop {
        let manifest = collect(out, plan)?;
        frames::write_json(&out.join(FILE), &manifest)?;
        // Another shard may have finished a scene in between, and written its manifest before this one.
        if done(out, plan).count() == manifest.records.len() {
            return Ok(manifest);
        }
    }
}

fn done<'a>(out: &'a Path, plan: &'a Plan) -> impl Iterator<Item = std::path::PathBuf> + 'a {
    let path = |task: Task| folder(out, &task).join(format!("{}.json", task.name));
    plan.tasks().map(path).filter(|path| path.exists())
}

fn collect(out: &Path, plan: &Plan) -> Result<Manifest> {
    let records: Vec<Record> =
        done(out, plan).map(|path| frames::read_json(&path)).collect::<Result<_, _>>()?;
    Ok(Manifest {
        settings: plan.settings.clone(),
        complete: records.len() == plan.tasks().count(),
        replaced: records.iter().map(|record| record.replaced.len()).sum(),
        records,
    })
}

impl Manifest {
    /// The manifest with what the records have in common in place of them.
    pub fn without_scenes(&self) -> Value {
        let mut value = serde_json::to_value(&self.settings).unwrap_or_default();
        let statistics = || self.records.iter().map(|record| record.statistics);
        let highest =
            |of: fn(&super::scene::Statistics) -> f64| statistics().map(|s| of(&s)).fold(0.0, f64::max);
        let particles = || self.records.iter().map(|record| record.particles);
        value["complete"] = json!(self.complete);
        value["done"] = json!(self.records.len());
        value["replaced"] = json!(self.replaced);
        let mut reasons: BTreeMap<Reason, usize> = BTreeMap::new();
        for old in self.records.iter().flat_map(|record| &record.replaced) {
            *reasons.entry(old.reason).or_default() += 1;
        }
        value["reasons"] = json!(reasons);
        value["particles_found"] = json!([particles().min(), particles().max()]);
        value["highest_speed_m_per_s"] = json!(highest(|s| s.highest_speed));
        value["highest_density"] = json!(highest(|s| s.highest_density));
        value["worst_compression"] = json!(highest(|s| s.worst_compression));
        value["unconverged"] = json!(statistics().map(|s| s.unconverged).sum::<u64>());
        value
    }

    /// What the command says at its end.
    pub fn summary(&self, out: &Path) -> String {
        let whole = self.without_scenes();
        let Settings { scenes, valid, frames, .. } = &self.settings;
        let mut lines = vec![format!(
            "{}: {} of {} scenes, {frames} frames each, {} to {} particles",
            out.display(),
            self.records.len(),
            scenes + valid,
            whole["particles_found"][0],
            whole["particles_found"][1],
        )];
        lines.push(format!(
            "highest speed {:.2} m/s; highest density {:.4}; worst mean compression {:.4} %; unconverged solves: {}",
            whole["highest_speed_m_per_s"].as_f64().unwrap_or_default(),
            whole["highest_density"].as_f64().unwrap_or_default(),
            100.0 * whole["worst_compression"].as_f64().unwrap_or_default(),
            whole["unconverged"],
        ));
        lines.push(format!(
            "scenes replaced for a number that is not finite or a particle that left the walls: {}",
            self.replaced
        ));
        for record in &self.records {
            for Replaced { seed, frame, reason } in &record.replaced {
                let reason = reason.text();
                lines.push(format!("  {} (seed {seed}): {reason} in frame {frame}", record.name));
            }
        }
        lines.join("\n")
    }
}

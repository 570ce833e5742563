//! The numbers of a training: JSON lines that a resumed one goes on with, and TensorBoard's events.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fluvia_sim::frames;
use serde::{Deserialize, Serialize};

use super::events::Events;

/// The file of JSON lines.
pub const FILE: &str = "metrics.jsonl";

/// One line: what was found in an update.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Line {
    /// On its batch.
    Train { update: u64, loss: f64, gradient: f64, rate: f64, particles_per_s: f64 },
    /// On the validation windows; `None` where a number is not finite.
    Valid { update: u64, loss: Option<f64>, err_n1_mm: Option<f64>, err_n2_mm: Option<f64> },
}

impl Line {
    pub fn update(&self) -> u64 {
        match self {
            Line::Train { update, .. } | Line::Valid { update, .. } => *update,
        }
    }
}

/// Where lines are written to.
pub struct Log {
    path: PathBuf,
    file: File,
    folder: PathBuf,
    /// From the first line on.
    events: Option<Events>,
    /// The last line of a validation.
    validated: Option<Line>,
}

impl Log {
    /// Goes on after update `updates`: later lines, of a run that was killed, are removed.
    pub fn open(folder: &Path, updates: u64) -> Result<Log> {
        let path = folder.join(FILE);
        let kept: Vec<Line> = if path.exists() {
            read_whole(&path)?.into_iter().filter(|l| l.update() <= updates).collect()
        } else {
            Vec::new()
        };
        frames::write_atomically(&path, |out| {
            for line in &kept {
                serde_json::to_writer(&mut *out, line)?;
                out.write_all(b"\n")?;
            }
            Ok(())
        })?;
        let file = OpenOptions::new().append(true).open(&path).with_context(|| path.display().to_string())?;
        let validated = kept.into_iter().rfind(|line| matches!(line, Line::Valid { .. }));
        Ok(Log { path, file, folder: folder.to_owned(), events: None, validated })
    }

    /// What the last validation found, in an earlier run that this one goes on with as well.
    pub fn validated(&self) -> Option<&Line> {
        self.validated.as_ref()
    }

    pub fn add(&mut self, line: &Line) -> Result<()> {
        let mut text = serde_json::to_string(line)?;
        text.push('\n');
        self.file.write_all(text.as_bytes()).with_context(|| self.path.display().to_string())?;
        let events = match &mut self.events {
            Some(events) => events,
            none => none.insert(Events::create(&self.folder)?),
        };
        match *line {
            Line::Train { update, loss, gradient, rate, particles_per_s } => events.add(
                update,
                &[
                    ("train/loss", Some(loss)),
                    ("train/gradient", Some(gradient)),
                    ("train/rate", Some(rate)),
                    ("train/particles_per_s", Some(particles_per_s)),
                ],
            ),
            Line::Valid { update, loss, err_n1_mm, err_n2_mm } => {
                self.validated = Some(line.clone());
                events.add(
                    update,
                    &[("valid/loss", loss), ("valid/err_n1_mm", err_n1_mm), ("valid/err_n2_mm", err_n2_mm)],
                )
            }
        }
    }
}

/// The lines of a file.
///
/// # Errors
/// If it cannot be read, or a line other than the last is damaged; a last one without an end is left out.
pub fn read_whole(path: &Path) -> Result<Vec<Line>> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let parse = |(number, line): (usize, &str)| {
        serde_json::from_str(line).with_context(|| format!("{}: line {}", path.display(), number + 1))
    };
    whole.lines().enumerate().map(parse).collect()
}

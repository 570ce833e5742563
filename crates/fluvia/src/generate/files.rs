//! The files of one scene of a data set: those that stay and those that are there only while it is made.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use fluvia_sim::frames::sequence::{self, part_file_name};

/// Where the files of a scene are.
pub struct Files {
    pub folder: PathBuf,
    /// That of the sequence.
    pub name: String,
}

impl Files {
    pub fn record(&self) -> PathBuf {
        self.folder.join(format!("{}.json", self.name))
    }

    /// Where to go on; only while the scene is made.
    pub fn state(&self) -> PathBuf {
        self.folder.join(format!("{}.state.npz", self.name))
    }

    /// The frames of the part that is not whole yet; only while the scene is made.
    pub fn frames(&self) -> PathBuf {
        self.folder.join(format!("{}.frames", self.name))
    }

    pub fn frame(&self, number: u64) -> PathBuf {
        self.frames().join(format!("{number:04}.npz"))
    }

    pub fn remove_frames(&self) -> Result<()> {
        removed(&self.frames(), std::fs::remove_dir_all(self.frames()))
    }

    /// The scenes that blew up; only while the scene is made.
    pub fn attempts(&self) -> PathBuf {
        self.folder.join(format!("{}.replaced.json", self.name))
    }

    fn remove(path: &Path) -> Result<()> {
        removed(path, std::fs::remove_file(path))
    }

    /// Removes what is there only while the scene is made.
    pub fn remove_progress(&self) -> Result<()> {
        Files::remove(&self.state())?;
        self.remove_frames()?;
        Files::remove(&self.attempts())
    }

    /// The lengths of the first `count` parts, bytes; 0 for one that is not there.
    pub fn part_lengths(&self, count: u64) -> Vec<u64> {
        let length = |number| std::fs::metadata(self.part(number)).map_or(0, |data| data.len());
        (0..count).map(length).collect()
    }

    pub fn part(&self, number: u64) -> PathBuf {
        self.folder.join(part_file_name(&self.name, number))
    }

    /// Removes all but the scenes that blew up: what follows begins anew. The record goes first, so that a scene without
    /// parts never counts as done.
    pub fn clear(&self) -> Result<()> {
        Files::remove(&self.record())?;
        Files::remove(&self.state())?;
        self.remove_frames()?;
        let found = sequence::find(&self.folder.join(&self.name))?;
        found.iter().flat_map(|files| &files.parts).try_for_each(|path| Files::remove(path))
    }
}

/// What came of removing a file or a folder, which need not be there.
fn removed(path: &Path, result: std::io::Result<()>) -> Result<()> {
    match result {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| path.display().to_string())
        }
        _ => Ok(()),
    }
}

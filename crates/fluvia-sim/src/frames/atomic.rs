//! Writing a file whole or not at all.
//!
//! The content goes to a temporary name in the same folder and is renamed when it is complete: a killed process
//! or a full disk leaves the old file or the new one. There is no fsync: it costs milliseconds a frame and guards
//! only against a power cut, after which a run is repeated or resumed anyway (the readers notice a damaged file).

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{Error, Result};

/// Writes a file through `content`: afterwards it is complete, or as it was before. Something that is no regular
/// file (a pipe, `/dev/stdout`) is written to directly.
///
/// # Errors
/// `Io`, with nothing left behind.
pub fn write_atomically(path: &Path, content: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    write_to(path, content).map_err(Error::io(path))
}

/// A file that another program writes: under a temporary name, until it is whole.
#[derive(Debug)]
pub struct Replacement {
    target: PathBuf,
    /// `None` once it has its name.
    temporary: Option<PathBuf>,
}

impl Replacement {
    /// Makes an empty file under a temporary name beside `path`.
    ///
    /// # Errors
    /// `Io` if none can be written there, or if `path` is a directory or no regular file.
    pub fn begin(path: &Path) -> Result<Replacement> {
        // A link stays a link: what it names is replaced.
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        let refused = match fs::metadata(&target) {
            Ok(data) if data.is_dir() => Some(io::ErrorKind::IsADirectory),
            Ok(data) if !data.is_file() => Some(io::ErrorKind::Unsupported),
            _ => None,
        };
        if let Some(kind) = refused {
            return Err(Error::io(path)(kind.into()));
        }
        let temporary = temporary_name(&target).map_err(Error::io(path))?;
        File::create(&temporary).map_err(Error::io(path))?;
        Ok(Replacement { target, temporary: Some(temporary) })
    }

    /// Where the file is to be written.
    pub fn temporary(&self) -> &Path {
        self.temporary.as_deref().unwrap_or(&self.target)
    }

    /// Gives the file its name; without that it is removed.
    ///
    /// # Errors
    /// `Io`.
    pub fn commit(mut self) -> Result<()> {
        if let Some(temporary) = &self.temporary {
            fs::rename(temporary, &self.target).map_err(Error::io(&self.target))?;
            self.temporary = None;
        }
        Ok(())
    }
}

impl Drop for Replacement {
    fn drop(&mut self) {
        if let Some(temporary) = &self.temporary {
            // What cannot be removed now stays.
            let _ = fs::remove_file(temporary);
        }
    }
}

/// Makes sure that a file can be written, before the work for it is done, and removes the temporary files that killed
/// processes have left of it.
///
/// # Errors
/// `Io`, as [`Replacement::begin`]; but something that is no regular file may be written to.
pub fn prepare(path: &Path) -> Result<()> {
    if fs::metadata(path).is_ok_and(|data| !data.is_file() && !data.is_dir()) {
        return Ok(());
    }
    let replacement = Replacement::begin(path)?;
    let target = replacement.target.clone();
    drop(replacement);
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty());
    let is_it = |name: &str| target.file_name().is_some_and(|file| file == name);
    remove_temporaries(folder.unwrap_or(Path::new(".")), is_it)
}

/// Writes a text, atomically.
///
/// # Errors
/// `Io`.
pub fn write_text(path: &Path, text: &str) -> Result<()> {
    write_atomically(path, |out| out.write_all(text.as_bytes()))
}

/// Writes a value as indented JSON, atomically.
///
/// # Errors
/// `Io`.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    write_atomically(path, |out| {
        serde_json::to_writer_pretty(&mut *out, value)?;
        out.write_all(b"\n")
    })
}

/// Reads a value that was written by [`write_json`].
///
/// # Errors
/// `Io`; `File` with the line if the file is no such value.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = fs::read(path).map_err(Error::io(path))?;
    serde_json::from_slice(&text).map_err(|error| Error::file(path, error.to_string()))
}

/// The file that a temporary file of [`write_atomically`] is for; `None` for the name of another file.
pub(super) fn target_of(name: &str) -> Option<&str> {
    let (target, process) = name.strip_prefix('.')?.strip_suffix(TEMPORARY)?.rsplit_once('.')?;
    (!process.is_empty() && process.bytes().all(|byte| byte.is_ascii_digit())).then_some(target)
}

/// Removes the temporary files in a folder that killed processes have left of files whose names are among these.
///
/// # Errors
/// `Io`.
pub fn remove_temporaries(folder: &Path, is_among: impl Fn(&str) -> bool) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(Error::io(folder))? {
        let file_name = entry.map_err(Error::io(folder))?.file_name();
        if file_name.to_str().and_then(target_of).is_some_and(&is_among) {
            let path = folder.join(file_name);
            fs::remove_file(&path).map_err(Error::io(path))?;
        }
    }
    Ok(())
}

/// How temporary names end: `.NAME.NUMBER.tmp`, which no glob for the file's extension finds.
const TEMPORARY: &str = ".tmp";

fn write_to(path: &Path, content: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    // A link stays a link: what it names is replaced. A file that is not there yet has no other name.
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    match fs::metadata(&target) {
        Ok(data) if data.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        Ok(data) if !data.is_file() => return fill(File::options().write(true).open(&target)?, content),
        _ => {}
    }
    let temporary = temporary_name(&target)?;
    let written = fill(File::create(&temporary)?, content).and_then(|()| fs::rename(&temporary, &target));
    if written.is_err() {
        // The first error is the one to report; a temporary that cannot be removed changes nothing about it.
        let _ = fs::remove_file(&temporary);
    }
    written
}

fn fill(file: File, content: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut out = BufWriter::new(file);
    content(&mut out)?;
    out.flush()
}

fn temporary_name(path: &Path) -> io::Result<PathBuf> {
    let Some(name) = path.file_name() else {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "not the name of a file"));
    };
    let mut temporary = std::ffi::OsString::from(".");
    temporary.push(name);
    // Processes in two containers that share a disk may have the same number.
    let moment = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.subsec_nanos());
    temporary.push(format!(".{}{moment:09}{TEMPORARY}", std::process::id()));
    Ok(path.with_file_name(temporary))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_temporary() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.npz");
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let error = write_atomically(&path, |out| {
            out.write_all(&[0; 100_000])?;
            Err(io::ErrorKind::StorageFull.into())
        })
        .unwrap_err();
        assert!(matches!(error, Error::Io { path: p, .. } if p == path));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        write_atomically(&path, |out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }

    #[cfg(unix)]
    #[test]
    fn links_and_devices_stay_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_atomically(&link, |out| out.write_all(b"new")).unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
        write_atomically(Path::new("/dev/null"), |out| out.write_all(b"new")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[test]
    fn what_another_program_writes_has_its_name_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.mp4");
        fs::write(&path, "old").unwrap();
        let half = Replacement::begin(&path).unwrap();
        fs::write(half.temporary(), "half").unwrap();
        drop(half);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        let whole = Replacement::begin(&path).unwrap();
        assert_ne!(whole.temporary(), path);
        fs::write(whole.temporary(), "new").unwrap();
        whole.commit().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(Replacement::begin(folder.path()).is_err());
        assert!(Replacement::begin(&folder.path().join("none/film.mp4")).is_err());
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.mp4");
        fs::write(&path, "old").unwrap();
        for name in [".film.mp4.12.tmp", ".other.mp4.12.tmp"] {
            fs::write(folder.path().join(name), "half").unwrap();
        }
        prepare(&path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        let mut names: Vec<_> =
            fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, [".other.mp4.12.tmp", "film.mp4"]);
        assert!(prepare(folder.path()).is_err());
        assert!(prepare(&folder.path().join("none/film.mp4")).is_err());
        assert!(prepare(&path.join("film.mp4")).is_err());
        #[cfg(unix)]
        prepare(Path::new("/dev/null")).unwrap();
    }

    #[test]
    fn temporary_names_are_recognised() {
        let path = temporary_name(Path::new("out/box.npz")).unwrap();
        let name = path.file_name().unwrap().to_str().unwrap();
        assert_eq!(target_of(name), Some("box.npz"), "{name}");
        for other in ["box.npz", ".box.npz.tmp", ".box.npz.x1.tmp", ".box.npz.12.tmp~"] {
            assert_ne!(target_of(other), Some("box.npz"), "{other}");
        }
    }
}

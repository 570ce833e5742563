use std::io;
use std::path::{Path, PathBuf};

/// Why something in this crate failed. Every message is one line.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file or directory could not be opened, read, written or renamed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file's content is not what it must be: damaged, of another kind, or with a value out of range.
    #[error("{}: {message}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong (with line, key or index where there is one) and what was expected.
        message: String,
    },
    /// A parameter given by the caller is out of range.
    #[error("{0}")]
    Parameter(String),
    /// A number that is not finite appeared in a step; the state before the step is kept.
    #[error("step {step}: {quantity} of particle {particle} is not finite")]
    NonFinite {
        /// The step that failed, counted from 1.
        step: u64,
        /// The identity (`id`) of the particle.
        particle: u32,
        /// "position" or "velocity".
        quantity: &'static str,
    },
}

impl Error {
    /// Makes a closure for `map_err` that adds the path to an I/O error.
    pub fn io(path: impl AsRef<Path>) -> impl FnOnce(io::Error) -> Error {
        let path = path.as_ref().to_path_buf();
        move |source| Error::Io { path, source }
    }

    /// An error about the content of a file.
    pub fn file(path: impl AsRef<Path>, message: impl Into<String>) -> Error {
        Error::File { path: path.as_ref().to_path_buf(), message: message.into() }
    }
}

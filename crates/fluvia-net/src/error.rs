use std::io;
use std::path::{Path, PathBuf};

/// Why something in this crate failed. Every message is one line.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be opened, read, written or renamed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file's content is not what it must be: damaged, of another kind, or of another network.
    #[error("{}: {message}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        message: String,
    },
    /// A training has come to a number that is not finite.
    #[error("{0}")]
    NotFinite(String),
    /// A value given by the caller is out of range or does not fit the others.
    #[error("{0}")]
    Parameter(String),
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

impl From<fluvia_sim::Error> for Error {
    fn from(error: fluvia_sim::Error) -> Error {
        match error {
            fluvia_sim::Error::Io { path, source } => Error::Io { path, source },
            fluvia_sim::Error::File { path, message } => Error::File { path, message },
            other => Error::Parameter(other.to_string()),
        }
    }
}

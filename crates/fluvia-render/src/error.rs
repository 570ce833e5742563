/// Why a picture could not be made. Every message is one line.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A slice does not have one entry per particle.
    #[error("{what}: found {found} entries, expected one for each of the {expected} particles")]
    Length {
        /// Which slice.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The number of particles (or wall particles).
        expected: usize,
    },
    /// A parameter is out of range.
    #[error("{what}: found {found}, expected {expected}")]
    Parameter {
        /// The parameter and its unit.
        what: &'static str,
        /// Its value.
        found: String,
        /// What it must be.
        expected: &'static str,
    },
    /// The camera stands or looks where it sees nothing of the scene.
    #[error("nothing of the scene is in view of the camera")]
    OutOfView,
    /// The encoder of an image format refused.
    #[error("{format}: {message}")]
    Encode {
        /// "PNG" or "GIF".
        format: &'static str,
        /// What the encoder said.
        message: String,
    },
}

impl Error {
    pub(crate) fn parameter(what: &'static str, found: impl ToString, expected: &'static str) -> Error {
        Error::Parameter { what, found: found.to_string(), expected }
    }
}

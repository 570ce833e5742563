//! The learned solver: network, integration and weights.

pub mod config;
pub mod weights;

mod error;

pub use error::Error;

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

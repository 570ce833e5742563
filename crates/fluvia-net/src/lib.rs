//! The learned solver: the network of Fig. 2, its integration (Eq. 10-14) and its weights.
//!
//! [`solver::NetSolver`] moves particles as any solver of `fluvia-sim` does. [`mod@reference`] is the same step in
//! float64, the specification that it is tested against.

pub mod adam;
pub mod checkpoint;
pub mod config;
pub mod dataset;
pub mod evaluate;
pub mod integrate;
pub mod loss;
pub mod net;
pub mod reference;
pub mod solver;
pub mod step;
pub mod train;
pub mod unroll;
pub mod weights;

mod error;

pub use error::Error;

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

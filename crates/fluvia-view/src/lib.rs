//! A page that shows moving particles and steers what moves them, and the server that it comes from.
//!
//! ```text
//! program -> Server::publish_frame, _walls, _state -> newest only -> every connection, as fast as it reads
//! page    -> Command -> the receiver that Server::start gives
//! ```
//!
//! The page is a remote control: the program has one state, and whoever looks sees the same. A browser that is slow
//! gets fewer frames; it neither holds up the program nor makes the server remember anything for it
//! ([`Server`]). What goes over the wire is in [`frame`], [`walls`], [`State`] and [`Command`], and in
//! docs/formats.md.
//!
//! The server knows no solver and no file: the page is compiled in, and there is no path that could be asked for.

mod accept;
mod assets;
mod budget;
mod command;
mod connection;
pub mod frame;
mod guard;
mod patience;
mod server;
mod state;
pub mod walls;

pub use command::{Body, Command, Form};
pub use frame::{Frame, Panel};
pub use server::{Error, Server};
pub use state::{Emitter, Message, Mode, PanelState, Range, Recording, SolverOffer, State};

//! What the page knows beside the frames: a JSON text that is sent whole whenever something in it changes.

use serde::Serialize;

/// The state of the program. Units are metres and seconds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// Always "state": what the text is.
    pub kind: &'static str,
    /// What is shown: the name of a scene or of a run.
    pub title: String,
    /// Whether it is computed or was stored.
    pub mode: Mode,
    /// Whether it runs.
    pub playing: bool,
    /// Simulated seconds in a second; none: as fast as possible.
    pub speed: Option<f64>,
    /// The numbers of the stored frames, the first and the last, and how many there are.
    pub stored: Option<[u64; 3]>,
    /// Seconds between frames.
    pub dt: f64,
    /// Half the particle spacing, metres.
    pub particle_radius: f32,
    /// Against gravity, a unit vector; y without gravity.
    pub up: [f32; 3],
    /// External acceleration, metres per second squared.
    pub gravity: [f32; 3],
    /// That of the scene, before anybody changed it.
    pub scene_gravity: [f32; 3],
    /// The viscosity of all fluids, if it is one and known.
    pub viscosity: Option<f32>,
    /// Which viscosities all solvers that are shown take; none if they are made for one.
    pub viscosities: Option<Range>,
    /// Whether there is something to colour by: speeds, bodies.
    pub has_speeds: bool,
    /// As `has_speeds`.
    pub has_bodies: bool,
    /// What is shown side by side: one or two.
    pub panels: Vec<PanelState>,
    /// The solvers that there are.
    pub solvers: Vec<SolverOffer>,
    /// The emitters that can be moved.
    pub emitters: Vec<Emitter>,
    /// What is being recorded.
    pub recording: Option<Recording>,
    /// The last thing that was said.
    pub message: Option<Message>,
}

/// Where frames come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Mode {
    /// From a solver that runs.
    Live,
    /// From disk.
    Playback,
}

/// From the lowest to the highest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Range {
    /// The lowest.
    pub low: f32,
    /// The highest.
    pub high: f32,
}

/// One of the pictures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PanelState {
    /// What it is called.
    pub label: String,
    /// The name of its solver, if one runs.
    pub solver: Option<String>,
    /// Why it stands still.
    pub error: Option<String>,
    /// What is to be known of it while it runs.
    pub warning: Option<String>,
}

/// A solver that could be chosen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SolverOffer {
    /// As in [`Command::Solver`](crate::Command::Solver).
    pub name: String,
    /// For people.
    pub label: String,
    /// Why it cannot be chosen for what is shown.
    pub refused: Option<String>,
}

/// Something that gives fluid again and again.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Emitter {
    /// What it was made of, as the scene names it.
    pub label: String,
    /// Its middle, metres.
    pub position: [f32; 3],
    /// Whether it gives any more.
    pub active: bool,
}

/// A recording that runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recording {
    /// The directories, one a panel.
    pub directories: Vec<String>,
}

/// Something to be told once.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Message {
    /// Goes up by one with each.
    pub number: u64,
    /// Whether something failed.
    pub is_error: bool,
    /// One line.
    pub text: String,
}

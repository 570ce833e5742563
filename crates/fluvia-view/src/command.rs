//! What the page asks for: JSON texts, one object each, told apart by the key `do`.

use serde::Deserialize;

/// A wish of somebody who looks at the page. Numbers are as they came: the program checks them.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Command {
    /// Let it run.
    Play,
    /// Stand still.
    Pause,
    /// So many frames on, one after another, back where negative, and stand still; beside what is left of steps before.
    Step {
        /// Frames.
        by: i32,
    },
    /// Show this one of the stored frames.
    Seek {
        /// Counted from 0, whatever the number of the frame.
        index: usize,
    },
    /// How fast.
    Speed {
        /// Simulated seconds in a second; as fast as possible if there is none.
        factor: Option<f64>,
    },
    /// Begin again.
    Reset,
    /// Drop a body of fluid where a ray meets the fluid or a wall.
    Drop {
        /// In which of the pictures the fluid is that the ray may meet; the body is dropped in all.
        panel: usize,
        /// Where the ray starts, metres.
        origin: [f32; 3],
        /// Where it goes; its length does not matter.
        direction: [f32; 3],
        /// What to drop.
        body: Body,
    },
    /// Move what an emitter gives from now on.
    MoveEmitter {
        /// Which, by its place in [`State::emitters`](crate::State::emitters).
        index: usize,
        /// Where its middle is to be, metres.
        to: [f32; 3],
    },
    /// Change the external acceleration.
    Gravity {
        /// Metres per second squared.
        to: [f32; 3],
    },
    /// Change the viscosity of all fluids.
    Viscosity {
        /// The coefficient of Bender & Koschier 2017; that of the scene, of each fluid its own, if there is none.
        to: Option<f32>,
    },
    /// Go on with another solver.
    Solver {
        /// In which of the pictures.
        panel: usize,
        /// One of the names in [`State::solvers`](crate::State::solvers).
        name: String,
    },
    /// Show two solvers side by side, the second from the state of the first; or one again.
    Compare {
        /// Whether there are to be two.
        on: bool,
    },
    /// Write frames to disk.
    Record {
        /// Whether to.
        on: bool,
    },
    /// Somebody wants to see what the last frame did not have: publish it again. Not sent by the page.
    #[serde(skip)]
    Refresh,
    /// Somebody has come to look, the first of all; it comes before any other command. Not sent by the page.
    #[serde(skip)]
    Look,
}

/// A body of fluid.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Body {
    /// Its form.
    pub form: Form,
    /// Its size along every axis, metres.
    pub size: f32,
}

/// The form of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// A cube.
    Cube,
    /// A ball.
    Ball,
}

impl Command {
    /// Whether a later command of the kind makes this one pointless, as where a slider is drawn.
    pub fn is_replaced_by(&self, later: &Command) -> bool {
        match (self, later) {
            (Command::Seek { .. }, Command::Seek { .. })
            | (Command::Speed { .. }, Command::Speed { .. })
            | (Command::Gravity { .. }, Command::Gravity { .. })
            | (Command::Viscosity { .. }, Command::Viscosity { .. })
            | (Command::Refresh, Command::Refresh) => true,
            (Command::MoveEmitter { index: this, .. }, Command::MoveEmitter { index: other, .. }) => {
                this == other
            }
            _ => false,
        }
    }
}

/// What a connection receives: a command for the program, or something about the connection itself.
#[derive(Debug, PartialEq)]
pub(crate) enum Received {
    /// The frame with this sequence number, and all before it, have arrived.
    Acknowledge(u32),
    /// Whether densities are wanted.
    Density(bool),
    Command(Command),
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
enum OfConnection {
    Acknowledge { sequence: u32 },
    Density { on: bool },
}

impl Received {
    /// # Errors
    /// What is wrong with the text, in one line.
    pub(crate) fn parse(text: &str) -> Result<Received, String> {
        if let Ok(own) = serde_json::from_str(text) {
            return Ok(match own {
                OfConnection::Acknowledge { sequence } => Received::Acknowledge(sequence),
                OfConnection::Density { on } => Received::Density(on),
            });
        }
        serde_json::from_str(text).map(Received::Command).map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_commands_or_errors() {
        let parsed = |text| Received::parse(text).unwrap();
        assert_eq!(parsed(r#"{"do":"play"}"#), Received::Command(Command::Play));
        assert_eq!(parsed(r#"{"do":"acknowledge","sequence":7}"#), Received::Acknowledge(7));
        assert_eq!(parsed(r#"{"do":"density","on":true}"#), Received::Density(true));
        assert_eq!(
            parsed(r#"{"do":"viscosity","to":null}"#),
            Received::Command(Command::Viscosity { to: None })
        );
        assert_eq!(
            parsed(r#"{"do":"speed","factor":null}"#),
            Received::Command(Command::Speed { factor: None })
        );
        let drop = r#"{"do":"drop","panel":0,"origin":[0,1,2],"direction":[0,-1,0],"body":{"form":"ball","size":0.3}}"#;
        let body = Body { form: Form::Ball, size: 0.3 };
        let expected = Command::Drop { panel: 0, origin: [0.0, 1.0, 2.0], direction: [0.0, -1.0, 0.0], body };
        assert_eq!(parsed(drop), Received::Command(expected));
        assert_eq!(
            parsed(r#"{"do":"move-emitter","index":1,"to":[0,0,0]}"#),
            Received::Command(Command::MoveEmitter { index: 1, to: [0.0; 3] })
        );
        for wrong in [
            "",
            "play",
            "{}",
            r#"{"do":"stop"}"#,
            r#"{"do":"refresh"}"#,
            r#"{"do":"look"}"#,
            r#"{"do":"step"}"#,
            r#"{"do":"step","by":1.5}"#,
            r#"{"do":"step","by":1,"to":2}"#,
            r#"{"do":"seek","index":-1}"#,
            r#"{"do":"acknowledge","sequence":-1}"#,
        ] {
            assert!(Received::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn only_the_last_place_of_a_slider_counts() {
        let seek = |index| Command::Seek { index };
        let emitter = |index| Command::MoveEmitter { index, to: [0.0; 3] };
        assert!(seek(1).is_replaced_by(&seek(2)) && emitter(0).is_replaced_by(&emitter(0)));
        assert!(!emitter(0).is_replaced_by(&emitter(1)) && !seek(1).is_replaced_by(&Command::Play));
        assert!(!Command::Step { by: 1 }.is_replaced_by(&Command::Step { by: 1 }));
    }
}

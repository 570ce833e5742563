//! How a solver divides the interval between two frames into steps of its own. Frame times are hit exactly: what is
//! left of an interval is cut into equal parts no longer than asked for.

use crate::rollout::positive;
use crate::{Error, Result};

/// More steps than this in a frame interval are a slip in dt or in the step.
const TOO_MANY: f32 = 1e5;

/// The length of a solver's own steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Substep {
    /// The interval in equal parts, as few as are no longer than this, seconds.
    Fixed(f32),
    /// At most this long, seconds, and shorter while particles are fast.
    AtMost(f32),
}

impl Substep {
    /// The longest step, seconds.
    pub fn longest(self) -> f32 {
        let (Substep::Fixed(seconds) | Substep::AtMost(seconds)) = self;
        seconds
    }

    /// The longest step in which a particle moves at most `travel` metres, but at least `least` seconds. `speed` is the
    /// highest that a particle may have in a step of the longest length, metres per second.
    pub(crate) fn within(self, travel: f32, least: f64, speed: impl FnOnce(f32) -> f64) -> f64 {
        match self {
            Substep::Fixed(length) => f64::from(length),
            Substep::AtMost(length) => {
                let own = f64::from(travel) / speed(length).max(f64::MIN_POSITIVE);
                own.max(least).min(f64::from(length))
            }
        }
    }

    /// An error unless an interval of `dt` seconds can be divided so.
    pub(crate) fn check(self, dt: f32) -> Result<()> {
        positive("dt", dt)?;
        let length = self.longest();
        if dt / length > TOO_MANY {
            let message = format!("dt {dt} s in steps of {length} s, expected at most {TOO_MANY} of them");
            return Err(Error::Parameter(message));
        }
        Ok(())
    }
}

/// What is left of an interval between frames.
pub(crate) struct Interval {
    /// Seconds.
    remaining: f64,
}

impl Interval {
    pub(crate) fn new(dt: f32) -> Interval {
        Interval { remaining: f64::from(dt) }
    }

    pub(crate) fn is_over(&self) -> bool {
        self.remaining == 0.0
    }

    /// The next step: what is left, in as few equal parts as are no longer than `longest`, seconds.
    pub(crate) fn next(&mut self, longest: f64) -> f32 {
        // A hair of slack against rounding: 20 ms are five steps of 4 ms, not six.
        let parts = (self.remaining / longest - 1e-3).ceil().max(1.0);
        let length = self.remaining / parts;
        self.remaining = if parts == 1.0 { 0.0 } else { self.remaining - length };
        length as f32
    }
}

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

/// Into how many equal parts to cut `remaining` seconds so that none is longer than `longest`.
pub(crate) fn parts(remaining: f64, longest: f64) -> u32 {
    // A hair of slack against rounding: 20 ms are five steps of 4 ms, not six.
    (remaining / longest - 1e-3).ceil().max(1.0) as u32
}

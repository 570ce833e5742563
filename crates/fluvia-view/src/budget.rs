//! What all connections together may be sent: what many watch must not cost what they watch.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Bytes of frames a second, all connections together: 100 frames of 100,000 particles to one, 33 of 6,000 to each of 50. More
/// is more than anybody sees, and each byte is time that the simulation does not have.
const BYTES_PER_SECOND: f64 = 100e6;

/// Gives out times to send at, one after another.
pub(crate) struct Budget(Mutex<Option<Instant>>);

impl Budget {
    pub(crate) fn new() -> Budget {
        Budget(Mutex::new(None))
    }

    /// When so many bytes may be sent, by somebody who asks now.
    pub(crate) fn reserve(&self, bytes: usize, now: Instant) -> Instant {
        let mut next = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let start = next.map_or(now, |next| next.max(now));
        *next = Some(start + Duration::from_secs_f64(bytes as f64 / BYTES_PER_SECOND));
        start
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn together_they_get_what_there_is() {
        let (budget, now) = (Budget::new(), Instant::now());
        let half = BYTES_PER_SECOND as usize / 2;
        // What has not been used is not saved up.
        assert_eq!(budget.reserve(half, now), now);
        let later = now + Duration::from_secs(5);
        assert_eq!(budget.reserve(half, later), later);
        assert_eq!(budget.reserve(half, later), later + Duration::from_millis(500));
        assert_eq!(budget.reserve(0, later), later + Duration::from_secs(1));
    }
}

//! The rate of learning over the course of a training.

use std::f64::consts::PI;

/// The rate of every update.
#[derive(Clone, Debug, PartialEq)]
pub enum Schedule {
    /// A rate that is multiplied by a factor at each of some updates.
    Steps {
        /// The rate of the first update.
        rate: f32,
        /// What it is multiplied by.
        factor: f32,
        /// Updates, counted from 0, from which on it is.
        at: Vec<u64>,
    },
    /// A rate that rises linearly for some updates, and falls to zero along half a cosine.
    Cosine {
        /// The highest rate.
        rate: f32,
        /// Updates until it is reached.
        warmup: u64,
        /// All updates.
        updates: u64,
    },
}

impl Schedule {
    /// That of the paper: 1e-3, halved at 20,000, 25,000, ... 45,000 of 50,000 updates, of others in proportion.
    pub fn paper(updates: u64) -> Schedule {
        Schedule::Steps { rate: 1e-3, factor: 0.5, at: (4..10).map(|tenth| tenth * updates / 10).collect() }
    }

    /// That of the published scripts, which halve first at 25,000.
    pub fn published(updates: u64) -> Schedule {
        Schedule::Steps { rate: 1e-3, factor: 0.5, at: (5..10).map(|tenth| tenth * updates / 10).collect() }
    }

    /// The rate of an update, counted from 0.
    pub fn rate(&self, update: u64) -> f32 {
        match self {
            Schedule::Steps { rate, factor, at } => {
                let times = at.iter().filter(|&&start| start <= update).count();
                rate * factor.powi(times as i32)
            }
            &Schedule::Cosine { rate, warmup, updates } => {
                if update < warmup {
                    return rate * (update + 1) as f32 / warmup as f32;
                }
                let left = updates.saturating_sub(warmup).max(1);
                let part = ((update - warmup) as f64 / left as f64).min(1.0);
                (f64::from(rate) * 0.5 * (1.0 + (PI * part).cos())) as f32
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_of_the_paper() {
        let paper = Schedule::paper(50_000);
        let rates = [0, 19_999, 20_000, 24_999, 25_000, 45_000, 60_000].map(|update| paper.rate(update));
        assert_eq!(rates, [1e-3, 1e-3, 5e-4, 5e-4, 2.5e-4, 1.5625e-5, 1.5625e-5]);
        assert_eq!(
            [24_999, 25_000, 49_999].map(|u| Schedule::published(50_000).rate(u)),
            [1e-3, 5e-4, 3.125e-5]
        );
        assert_eq!([1_999, 2_000].map(|u| Schedule::paper(5_000).rate(u)), [1e-3, 5e-4]);
        let cosine = Schedule::Cosine { rate: 2e-3, warmup: 4, updates: 104 };
        assert_eq!([0, 3, 4].map(|update| cosine.rate(update)), [5e-4, 2e-3, 2e-3]);
        assert!((cosine.rate(54) - 1e-3).abs() < 1e-9 && cosine.rate(104) == 0.0 && cosine.rate(200) == 0.0);
    }
}

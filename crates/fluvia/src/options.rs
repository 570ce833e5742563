//! Values of options that several subcommands take.

use std::path::Path;
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use cconv::Precision;
use fluvia_sim::substep::Substep;
use serde::{Deserialize, Serialize};

/// A pool of the given number of threads, by default one per core.
pub fn thread_pool(threads: Option<usize>) -> Result<rayon::ThreadPool> {
    let threads = threads.unwrap_or_default();
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("cannot start the threads")
}

/// More threads than any machine has cores only wait for each other.
const MAX_THREADS: usize = 1024;

/// Parses a number of threads.
pub fn threads(text: &str) -> std::result::Result<usize, String> {
    let threads = text.parse().ok().filter(|n| (1..=MAX_THREADS).contains(n));
    threads.ok_or_else(|| format!("expected a number from 1 to {MAX_THREADS}"))
}

/// The label and the path of `LABEL=PATH` or `PATH`, whose label is all of it.
pub fn labelled(text: &str) -> (&str, &Path) {
    match text.split_once('=') {
        Some((label, path)) if !Path::new(text).exists() => (label, Path::new(path)),
        _ => (text, Path::new(text)),
    }
}

/// Parses a positive number.
pub fn positive(text: &str) -> std::result::Result<f32, String> {
    let number = text.parse().ok().filter(|x: &f32| x.is_finite() && *x > 0.0);
    number.ok_or_else(|| "expected a positive number".into())
}

/// Frames by their numbers: one, or all that there are from the first to the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameRange {
    One(u64),
    /// Both ends are in it.
    All(u64, u64),
}

/// Parses `A..B`.
pub fn pair<T: FromStr>(text: &str) -> Option<(T, T)> {
    let (first, last) = text.split_once("..")?;
    first.parse().ok().zip(last.parse().ok())
}

/// Parses `N` or `FIRST..LAST`.
pub fn frame_range(text: &str) -> std::result::Result<FrameRange, String> {
    let all = pair(text).map(|(first, last)| FrameRange::All(first, last));
    let range = all.or_else(|| text.parse().ok().map(FrameRange::One));
    let range = range.filter(|range| !matches!(range, FrameRange::All(first, last) if first > last));
    range.ok_or_else(|| "expected the number of a frame, or FIRST..LAST".into())
}

/// The frames that are asked for, of those that there are; all if none are.
///
/// # Errors
/// If a range holds none.
pub fn chosen_frames(there: &[u64], ranges: &[FrameRange]) -> Result<Vec<u64>> {
    let mut chosen = Vec::new();
    for &range in ranges {
        match range {
            FrameRange::One(number) => chosen.push(number),
            FrameRange::All(first, last) => {
                let count = chosen.len();
                chosen.extend(there.iter().filter(|number| (first..=last).contains(number)));
                if chosen.len() == count {
                    let (lowest, highest) = (there[0], there[there.len() - 1]);
                    bail!("--frames: none from {first} to {last}, there are {lowest} to {highest}");
                }
            }
        }
    }
    Ok(if ranges.is_empty() { there.to_vec() } else { chosen })
}

/// The step that `--solver-dt` or `--solver-dt-max` asks for, of a solver for frames that are `frame` seconds apart.
///
/// # Errors
/// If a fixed step is longer than that.
pub fn substep(fixed: Option<f32>, longest: Option<f32>, frame: f32) -> Result<Option<Substep>> {
    match fixed {
        Some(own) if own > frame => {
            bail!("--solver-dt: {own} s, expected at most the {frame} s between frames")
        }
        Some(own) => Ok(Some(Substep::Fixed(own))),
        None => Ok(longest.map(Substep::AtMost)),
    }
}

/// The format in which the network's large matrix products are multiplied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PrecisionName {
    /// float32.
    F32,
    /// bfloat16, summed in float32: faster with AVX512-BF16, slow without it.
    Bf16,
}

impl PrecisionName {
    /// As it is recorded.
    pub fn name(self) -> &'static str {
        match self {
            PrecisionName::F32 => "f32",
            PrecisionName::Bf16 => "bf16",
        }
    }
}

impl From<PrecisionName> for Precision {
    fn from(name: PrecisionName) -> Precision {
        match name {
            PrecisionName::F32 => Precision::F32,
            PrecisionName::Bf16 => Precision::Bf16,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused() {
        assert_eq!(threads("2"), Ok(2));
        assert!(["0", "-1", "1025", "two", ""].iter().all(|text| threads(text).is_err()));
        assert_eq!(frame_range("7"), Ok(FrameRange::One(7)));
        assert_eq!(frame_range("3..9"), Ok(FrameRange::All(3, 9)));
        assert!(["", "-1", "9..3", "..", "3..", "a..b"].iter().all(|text| frame_range(text).is_err()));
        assert_eq!(positive("0.25"), Ok(0.25));
        assert!(["0", "-1", "nan", "inf", "fast", ""].iter().all(|text| positive(text).is_err()));
    }

    #[test]
    fn ranges_hold_the_frames_that_there_are() {
        let there = [0, 5, 10, 15];
        let chosen = |ranges: &[FrameRange]| chosen_frames(&there, ranges);
        assert_eq!(chosen(&[]).unwrap(), there);
        assert_eq!(chosen(&[FrameRange::All(4, 12), FrameRange::One(3)]).unwrap(), [5, 10, 3]);
        let error = chosen(&[FrameRange::All(6, 9)]).unwrap_err().to_string();
        assert!(error.contains("6 to 9") && error.contains("0 to 15"), "{error}");
    }
}

//! The order of training windows: a stream without end, cut into epochs.
//!
//! In an epoch the parts are shuffled and taken in groups, and the windows of a group are shuffled: a group is what has to
//! be in memory. Every window comes once in an epoch.

use std::ops::Range;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// The stream of windows of a data set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Order {
    seed: u64,
    /// The windows of each part.
    windows: Vec<usize>,
    /// Parts of a group.
    group: usize,
}

/// The place of a window: its part, and its first frame counted from that of the part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Window {
    /// Index of the part.
    pub part: usize,
    /// The first frame, counted from 0.
    pub first: usize,
}

/// Windows that follow each other in the stream and come from few parts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Where the group lies in the stream.
    pub positions: Range<u64>,
    /// One for each position.
    pub windows: Vec<Window>,
}

impl Order {
    /// A stream over parts with so many windows each, of which `group` are together in memory.
    pub fn new(seed: u64, windows: Vec<usize>, group: usize) -> Order {
        Order { seed, windows, group: group.max(1) }
    }

    /// The windows of an epoch.
    pub fn epoch_length(&self) -> u64 {
        self.windows.iter().map(|&windows| windows as u64).sum()
    }

    /// The group that a position of the stream is in. `None` if there are no windows.
    pub fn group_of(&self, position: u64) -> Option<Group> {
        let length = self.epoch_length();
        if length == 0 {
            return None;
        }
        let epoch = position / length;
        let mut start = epoch * length;
        let mut parts: Vec<usize> = (0..self.windows.len()).collect();
        shuffle(&mut parts, &mut stream(self.seed, [epoch, u64::MAX]));
        for (number, parts) in (0..).zip(parts.chunks(self.group)) {
            let count: u64 = parts.iter().map(|&part| self.windows[part] as u64).sum();
            if position < start + count {
                let of_part =
                    |&part: &usize| (0..self.windows[part]).map(move |first| Window { part, first });
                let mut windows: Vec<Window> = parts.iter().flat_map(of_part).collect();
                shuffle(&mut windows, &mut stream(self.seed, [epoch, number]));
                return Some(Group { positions: start..start + count, windows });
            }
            start += count;
        }
        None
    }
}

/// Random numbers for one purpose, from a seed and the numbers that name it.
pub fn stream(seed: u64, names: [u64; 2]) -> Pcg64 {
    let [high, low] = names;
    let mut bytes = [0; 32];
    for (bytes, word) in bytes.chunks_exact_mut(8).zip([seed, high, low, 0x5851_f42d_4c95_7f2d]) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    Pcg64::from_seed(bytes)
}

/// A number from 0 to below 1.
pub fn unit(random: &mut Pcg64) -> f64 {
    // 53 bits, as many as a float64 has.
    (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// A number of the normal distribution (Box & Muller 1958).
pub fn normal(random: &mut Pcg64) -> f32 {
    // Above 0, for it has a logarithm.
    let (radius, turn) = (1.0 - unit(random), unit(random));
    ((-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * turn).cos()) as f32
}

/// Fisher and Yates.
fn shuffle<T>(values: &mut [T], random: &mut Pcg64) {
    for i in (1..values.len()).rev() {
        values.swap(i, below(random, i as u64 + 1) as usize);
    }
}

/// A number below `bound`: the upper half of a product of 128 bits (Lemire 2019), without his correction, for bounds
/// here are small beside 2^64.
pub fn below(random: &mut Pcg64, bound: u64) -> u64 {
    ((u128::from(random.next_u64()) * u128::from(bound)) >> 64) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_epoch_has_every_window_once() {
        let order = Order::new(3, vec![4, 0, 7, 1, 5], 2);
        let read = |epoch: u64| {
            let mut windows = Vec::new();
            let mut position = epoch * order.epoch_length();
            while position < (epoch + 1) * order.epoch_length() {
                let group = order.group_of(position).unwrap();
                assert_eq!(group.positions.start, position);
                assert_eq!(group.windows.len() as u64, group.positions.end - position);
                // The same group from each of its positions.
                assert_eq!(order.group_of(group.positions.end - 1), Some(group.clone()));
                position = group.positions.end;
                windows.extend(group.windows);
            }
            windows
        };
        let (first, second) = (read(0), read(1));
        assert_ne!(first, second);
        let sorted = |mut windows: Vec<Window>| {
            windows.sort_unstable();
            windows
        };
        let all: Vec<Window> = [(0, 4), (2, 7), (3, 1), (4, 5)]
            .into_iter()
            .flat_map(|(part, windows)| (0..windows).map(move |first| Window { part, first }))
            .collect();
        assert_eq!(sorted(first.clone()), all);
        assert_eq!(sorted(second), all);
        assert_ne!(Order::new(4, vec![4, 0, 7, 1, 5], 2).group_of(0), order.group_of(0));
        assert_eq!(Order::new(0, vec![0, 0], 2).group_of(0), None);
    }
}

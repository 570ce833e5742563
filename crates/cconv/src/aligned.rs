//! A vector of floats that starts at a cache line, so that no vector of floats straddles two.

use std::ops::{Deref, DerefMut};

/// Floats in a cache line.
const LINE: usize = 16;

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Line([f32; LINE]);

/// Floats in whole cache lines; the length is a multiple of [`LINE`].
#[derive(Clone, Debug, Default)]
pub struct AlignedVec {
    lines: Vec<Line>,
}

impl AlignedVec {
    /// Copies the values, and fills the last line with zeros.
    pub fn from_slice(values: &[f32]) -> AlignedVec {
        let mut aligned = AlignedVec::default();
        aligned.reserve_len(values.len());
        aligned[..values.len()].copy_from_slice(values);
        aligned
    }

    /// Makes the vector at least `len` long. New values are zero.
    pub fn reserve_len(&mut self, len: usize) {
        let lines = len.div_ceil(LINE);
        if lines > self.lines.len() {
            self.lines.resize(lines, Line([0.0; LINE]));
        }
    }
}

impl Deref for AlignedVec {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        // SAFETY: a `Line` is an array of floats without padding.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.lines.len() * LINE) }
    }
}

impl DerefMut for AlignedVec {
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as above.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.lines.len() * LINE) }
    }
}

impl AlignedVec {
    /// The same memory as bfloat16 values, two in the place of each float.
    pub fn halves(&self) -> &[u16] {
        // SAFETY: a `Line` is an array of floats without padding, and any bits are a `u16`.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), 2 * self.lines.len() * LINE) }
    }

    /// The same memory as bfloat16 values, two in the place of each float.
    pub fn halves_mut(&mut self) -> &mut [u16] {
        // SAFETY: as above, and any bits are a float.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), 2 * self.lines.len() * LINE) }
    }
}

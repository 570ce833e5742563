//! Vectors as four numbers, the last 0: they are loaded, added and stored whole.

use std::ops::{Add, Sub};

/// A vector in space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(16))]
pub struct Row([f32; 4]);

impl Row {
    /// The three components.
    #[inline]
    pub fn vector(self) -> [f32; 3] {
        [self.0[0], self.0[1], self.0[2]]
    }

    /// self + s v.
    #[inline]
    pub fn add_scaled(&mut self, s: f32, v: Row) {
        for (sum, v) in self.0.iter_mut().zip(v.0) {
            *sum += s * v;
        }
    }

    #[inline]
    pub fn scaled(self, s: f32) -> Row {
        Row(self.0.map(|x| s * x))
    }

    /// The products of the components: their [`sum`](Row::sum) is the scalar product.
    #[inline]
    pub fn times(self, other: Row) -> Row {
        Row(std::array::from_fn(|k| self.0[k] * other.0[k]))
    }

    /// The sum of the components.
    #[inline]
    pub fn sum(self) -> f32 {
        let [x, y, z, zero] = self.0;
        (x + y) + (z + zero)
    }

    #[inline]
    pub fn dot(self, other: Row) -> f32 {
        self.times(other).sum()
    }

    #[inline]
    pub fn length(self) -> f32 {
        self.dot(self).sqrt()
    }
}

impl From<[f32; 3]> for Row {
    #[inline]
    fn from([x, y, z]: [f32; 3]) -> Row {
        Row([x, y, z, 0.0])
    }
}

impl Sub for Row {
    type Output = Row;

    #[inline]
    fn sub(self, other: Row) -> Row {
        Row(std::array::from_fn(|k| self.0[k] - other.0[k]))
    }
}

impl Add for Row {
    type Output = Row;

    #[inline]
    fn add(self, other: Row) -> Row {
        Row(std::array::from_fn(|k| self.0[k] + other.0[k]))
    }
}

//! What keeps particles from clumping: the artificial pressure, and a way out of the same place.

use crate::kernel::CubicSpline;
use crate::vector::Vector;

/// |Δq| of Eq. 13 in support radii, within the paper's 0.1 to 0.3.
const ARTIFICIAL_PRESSURE_DISTANCE: f32 = 0.2;

/// The artificial pressure is left out beyond this distance, in support radii: 1 % of that at |Δq|.
const ARTIFICIAL_PRESSURE_REACH: f32 = 0.5;

/// How far apart coincident particles are taken to be, in support radii: their direction is made up.
const COINCIDENT_OFFSET: f32 = 0.002;

/// The artificial pressure of Eq. 13, s_corr = -k (W(r) / W(|Δq|))⁴.
pub struct Repulsion {
    /// k, square metres.
    strength: f32,
    /// 1 / W(|Δq|), cubic metres.
    inverse_reference: f32,
    /// Where it ends, metres.
    pub reach: f32,
}

impl Repulsion {
    /// `strength` is in squares of the support radius.
    pub fn new(strength: f32, kernel: &CubicSpline) -> Repulsion {
        let support = kernel.support();
        Repulsion {
            strength: strength * support * support,
            inverse_reference: 1.0 / kernel.value(ARTIFICIAL_PRESSURE_DISTANCE * support),
            reach: ARTIFICIAL_PRESSURE_REACH * support,
        }
    }

    /// s_corr where the kernel has this value, square metres.
    #[inline]
    pub fn at(&self, kernel_value: f32) -> f32 {
        let ratio = kernel_value * self.inverse_reference;
        -self.strength * (ratio * ratio) * (ratio * ratio)
    }
}

/// The offset x_i - x_j to assume for particles in the same place: opposite for the two of a pair.
#[inline]
pub fn made_up_offset(i: usize, j: usize, support: f32) -> Vector {
    let mut offset = [0.0; 3];
    if i != j {
        offset[(i + j) % 3] = if i < j { 1.0 } else { -1.0 } * COINCIDENT_OFFSET * support;
    }
    offset
}

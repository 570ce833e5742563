//! Smoothing kernels of smoothed particle hydrodynamics.
//!
//! The cubic spline of Monaghan (1992), with its support radius h (not the smoothing length) and q = |r| / h:
//!
//! W(r) = 8 / (π h³) · { 6 q³ - 6 q² + 1 for q <= 1/2;  2 (1 - q)³ for 1/2 < q <= 1;  0 beyond }
//!
//! Its integral over space is 1. SPlisHSPlasH, which made the published data, uses the same kernel with the
//! same normalisation and h = 4 particle radii.

use std::f64::consts::PI;

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use rayon::prelude::*;

/// The support radius of the fluid's kernel in particle radii, as in the published data.
pub const SUPPORT_IN_RADII: f32 = 4.0;

/// The cubic spline kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CubicSpline {
    support: f32,
    inverse_support: f32,
    /// 8 / (π h³), the value at the centre.
    peak: f32,
    /// 8 / (π h⁵).
    gradient_scale: f32,
}

impl CubicSpline {
    /// The kernel with the given support radius, metres.
    ///
    /// # Panics
    /// If the radius is not positive and finite.
    pub fn new(support: f32) -> Self {
        assert!(support > 0.0 && support.is_finite(), "support radius {support}, expected a positive length");
        let h = f64::from(support);
        CubicSpline {
            support,
            inverse_support: (1.0 / h) as f32,
            peak: (8.0 / (PI * h.powi(3))) as f32,
            gradient_scale: (8.0 / (PI * h.powi(5))) as f32,
        }
    }

    /// The distance from which on the kernel is zero, metres.
    pub fn support(&self) -> f32 {
        self.support
    }

    /// W at the given distance, per cubic metre.
    #[inline]
    pub fn value(&self, distance: f32) -> f32 {
        let q = distance * self.inverse_support;
        let shape = if q <= 0.5 {
            6.0 * q * q * (q - 1.0) + 1.0
        } else {
            let s = (1.0 - q).max(0.0);
            2.0 * s * s * s
        };
        self.peak * shape
    }

    /// The number f for which ∇W(r) = f · r, that is (dW/d|r|) / |r|; never positive, and finite at r = 0.
    #[inline]
    pub fn gradient_factor(&self, distance: f32) -> f32 {
        let q = distance * self.inverse_support;
        let shape = if q <= 0.5 {
            18.0 * q - 12.0
        } else {
            let s = (1.0 - q).max(0.0);
            -6.0 * s * s / q
        };
        self.gradient_scale * shape
    }
}

/// The volume that each wall particle stands for, V_b = 1 / Σ_k W(x_b - x_k) over the wall particles k
/// (Akinci et al. 2012, Eq. 4), cubic metres: dense samples count less. Times the rest density it is the
/// mass that a wall particle adds to the density of the fluid.
pub fn wall_volumes(walls: &[[f32; 3]], kernel: &CubicSpline) -> Vec<f32> {
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    grid.build(walls, kernel.support());
    grid.search(walls, Radius::Uniform(kernel.support()), &Options::default(), &mut neighbors);
    let volume = |(b, x): (usize, &[f32; 3])| {
        let values = neighbors.row(b).iter().map(|&k| kernel.value(distance(*x, walls[k as usize])));
        1.0 / values.sum::<f32>().max(f32::MIN_POSITIVE)
    };
    walls.par_iter().enumerate().map(volume).collect()
}

/// The distance between two points.
#[inline]
pub(crate) fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    (x * x + y * y + z * z).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integral_is_one() {
        let kernel = CubicSpline::new(0.1);
        let shells = 20_000;
        let width = 0.1 / f64::from(shells);
        let integral: f64 = (0..shells)
            .map(|i| (f64::from(i) + 0.5) * width)
            .map(|r| 4.0 * PI * r * r * f64::from(kernel.value(r as f32)) * width)
            .sum();
        // float32 values carry 6e-8 each; the midpoint rule is far below that.
        assert!((integral - 1.0).abs() < 1e-6, "integral {integral}");
    }

    #[test]
    fn gradient_is_the_difference_quotient() {
        let kernel = CubicSpline::new(0.1);
        for i in 1..110 {
            let r = i as f32 * 1e-3;
            let step = 5e-4_f32;
            let difference = (kernel.value(r + step) - kernel.value(r - step)) / (2.0 * step);
            let gradient = kernel.gradient_factor(r) * r;
            // The third derivative, at most 36 peak / h³, times step² / 6; twice that at the knots.
            let bound = 2.0 * 36.0 * kernel.value(0.0) / 1e-3 * step * step / 6.0;
            assert!((difference - gradient).abs() < bound, "r = {r}: {difference} and {gradient}");
        }
    }

    #[test]
    fn ends_at_the_support_and_is_finite_at_zero() {
        let kernel = CubicSpline::new(0.1);
        assert_eq!(kernel.value(0.1), 0.0);
        assert_eq!(kernel.value(1e30), 0.0);
        assert_eq!(kernel.gradient_factor(1e30), 0.0);
        assert!(kernel.gradient_factor(0.0).is_finite());
    }

    #[test]
    fn wall_volumes_sum_kernels_to_one() {
        let walls = [[0.0; 3], [0.03, 0.0, 0.0], [5.0, 0.0, 0.0]];
        let kernel = CubicSpline::new(0.1);
        let volumes = wall_volumes(&walls, &kernel);
        assert_eq!(volumes[0], 1.0 / (kernel.value(0.0) + kernel.value(0.03)));
        assert_eq!(volumes[2], 1.0 / kernel.value(0.0));
    }
}

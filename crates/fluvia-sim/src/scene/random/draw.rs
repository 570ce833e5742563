//! What is drawn at random, from a named generator by arithmetic of our own: the streams stay the same whatever
//! version of a library comes.
//!
//! Numbers have few decimals, so that a scene file is short and has the same numbers on a machine whose arctangent
//! rounds otherwise.

use rand_pcg::Pcg64;

use crate::sampling::uniform;
use crate::scene::Rotation;

/// Decimals of lengths, speeds and coefficients: 0.1 mm.
const DECIMALS: f64 = 1e4;
/// Decimals of sizes that are sought.
const FINE_DECIMALS: f64 = 1e6;
/// Decimals of angles, degrees.
const ANGLE_DECIMALS: f64 = 1e2;

/// To 0.1 mm.
pub(super) fn rounded(x: f64) -> f32 {
    ((x * DECIMALS).round() / DECIMALS) as f32
}

/// To a millionth: a body of 6,000 particles that grows by so much gets 0.02 more on average.
pub(super) fn fine(x: f64) -> f32 {
    ((x * FINE_DECIMALS).round() / FINE_DECIMALS) as f32
}

/// Uniform from `low` to `high`.
pub(super) fn between(random: &mut Pcg64, low: f32, high: f32) -> f32 {
    let (start, end) = (f64::from(low), f64::from(high));
    rounded(start + (end - start) * uniform(random)).clamp(low, high)
}

/// An index below `count`, all equally likely.
pub(super) fn index(random: &mut Pcg64, count: usize) -> usize {
    (uniform(random) * count as f64) as usize
}

/// 1 or -1.
pub(super) fn sign(random: &mut Pcg64) -> f32 {
    if uniform(random) < 0.5 { 1.0 } else { -1.0 }
}

/// Uniform among all rotations: a uniform point on the sphere of unit quaternions, from two points in the unit
/// circle (Marsaglia 1972), as axis and angle.
pub(super) fn rotation(random: &mut Pcg64) -> Rotation {
    let ([a, b], first) = in_circle(random);
    let ([c, d], second) = in_circle(random);
    let rest = ((1.0 - first) / second).sqrt();
    let (w, axis) = (a, [b, c * rest, d * rest]);
    let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
    let degrees = 2.0 * length.atan2(w).to_degrees();
    let angle = ((degrees * ANGLE_DECIMALS).round() / ANGLE_DECIMALS) as f32;
    Rotation { axis: axis.map(|x| rounded(x / length)), angle }
}

/// A uniform point in the unit circle without its middle, and the square of its distance from there.
fn in_circle(random: &mut Pcg64) -> ([f64; 2], f64) {
    loop {
        let point = [uniform(random), uniform(random)].map(|x| 2.0 * x - 1.0);
        let square = point[0] * point[0] + point[1] * point[1];
        if square > 0.0 && square < 1.0 {
            return (point, square);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand_pcg::rand_core::SeedableRng;

    use super::*;
    use crate::scene::Placement;

    #[test]
    fn numbers_are_uniform_and_in_range() {
        let random = &mut Pcg64::seed_from_u64(1);
        let numbers: Vec<f32> = (0..20_000).map(|_| between(random, -2.0, 2.0)).collect();
        assert!(numbers.iter().all(|x| (-2.0..=2.0).contains(x)));
        for part in 0..8 {
            let low = -2.0 + 0.5 * part as f32;
            let count = numbers.iter().filter(|&&x| x >= low && x < low + 0.5).count();
            // Five standard deviations of a count of 2500.
            assert!(count.abs_diff(2500) < 5 * 47, "{count} in part {part}");
        }
        let count = (0..9_000).filter(|_| index(random, 3) == 2).count();
        assert!(count.abs_diff(3000) < 5 * 45, "{count}");
        let count = (0..10_000).filter(|_| sign(random) > 0.0).count();
        assert!(count.abs_diff(5000) < 5 * 50, "{count}");
        assert_eq!((between(random, 0.7, 0.7), rounded(0.123_449)), (0.7, 0.1234));
    }

    #[test]
    fn rotations_are_uniform() {
        const COUNT: usize = 20_000;
        let random = &mut Pcg64::seed_from_u64(2);
        // Under uniform rotations a fixed direction becomes uniform on the sphere: each coordinate is uniform in
        // [-1, 1] (Archimedes), with the mean 0 and the mean square 1/3; the trace of the matrix has the mean 0
        // and the mean square 1.
        let mut sums = [[0.0; 2]; 10];
        for _ in 0..COUNT {
            let turn = Placement { rotation: Some(rotation(random)), ..Placement::default() };
            let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(turn.turn());
            let entries =
                columns.into_iter().flatten().chain([columns[0][0] + columns[1][1] + columns[2][2]]);
            for (sum, entry) in sums.iter_mut().zip(entries) {
                sum[0] += entry / COUNT as f64;
                sum[1] += entry * entry / COUNT as f64;
            }
        }
        for (k, [mean, square]) in sums.into_iter().enumerate() {
            let expected = if k < 9 { 1.0 / 3.0 } else { 1.0 };
            // Five standard errors of the trace, whose square has a standard deviation below 1.5.
            assert!(mean.abs() < 0.036 && (square - expected).abs() < 0.053, "{k}: {mean} {square}");
        }
    }
}

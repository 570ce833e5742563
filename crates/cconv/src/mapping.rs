//! The mapping Λ from the unit ball to a cube, Eq. 19-21.
//!
//! Here the cube is [−1, 1]³; the shift and halving of Eq. 21 belong to the lookup in `filter.rs`. The
//! functions are free of branches and work on vectors of points.

use std::f32::consts::FRAC_PI_4;

use crate::kernel::InstructionSet;

/// How positions in the ball of radius R are mapped to the cube of the filter grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mapping {
    /// The volume-preserving map of Griepentrog et al. (2008), Eq. 19-21.
    #[default]
    VolumePreserving,
    /// p · |p|₂ / |p|∞: moves points along their ray.
    Radial,
    /// No mapping: the filter is a cube and the ball its inscribed sphere.
    Identity,
}

impl Mapping {
    /// Maps points of the unit ball to the cube [−1, 1]³; x, y and z of as many points as a vector has lanes.
    #[inline(always)]
    pub(crate) fn apply<I: InstructionSet>(self, p: [I::Vector; 3]) -> [I::Vector; 3] {
        match self {
            Mapping::VolumePreserving => cylinder_to_cube::<I>(ball_to_cylinder::<I>(p)),
            Mapping::Radial => radial::<I>(p),
            Mapping::Identity => p,
        }
    }
}

#[inline(always)]
fn radial<I: InstructionSet>([x, y, z]: [I::Vector; 3]) -> [I::Vector; 3] {
    let largest = I::max(I::max(I::abs(x), I::abs(y)), I::abs(z));
    let norm = I::sqrt(I::add(I::add(I::mul(x, x), I::mul(y, y)), I::mul(z, z)));
    // At the centre the scale is 0; elsewhere the norm is at least the largest coordinate.
    let scale = I::div(norm, I::max(largest, I::splat(f32::MIN_POSITIVE)));
    [I::mul(x, scale), I::mul(y, scale), I::mul(z, scale)]
}

/// Λ_ball→cyl, Eq. 19.
#[inline(always)]
fn ball_to_cylinder<I: InstructionSet>([x, y, z]: [I::Vector; 3]) -> [I::Vector; 3] {
    let planar_square = I::add(I::mul(x, x), I::mul(y, y));
    let z_square = I::mul(z, z);
    let norm = I::sqrt(I::add(planar_square, z_square));
    // Both quotients are 0/0 at the centre only, where x = y = z = 0 and any finite scale gives 0. They
    // are at most 3/2 and 3 where they count; the bound keeps the one that does not count finite.
    let tiny = I::splat(f32::MIN_POSITIVE);
    let side = I::div(norm, I::max(I::sqrt(planar_square), tiny));
    let cap = I::sqrt(I::div(I::mul(I::splat(3.0), norm), I::max(I::add(norm, I::abs(z)), tiny)));
    let on_side = I::less_equal(I::mul(I::splat(1.25), z_square), planar_square);
    let scale = I::select(on_side, side, cap);
    let height = I::select(on_side, I::mul(I::splat(1.5), z), I::copysign(norm, z));
    [I::mul(x, scale), I::mul(y, scale), height]
}

/// Λ_cyl→cube, Eq. 20.
#[inline(always)]
fn cylinder_to_cube<I: InstructionSet>([x, y, z]: [I::Vector; 3]) -> [I::Vector; 3] {
    let x_leads = I::less_equal(I::abs(y), I::abs(x));
    let (long, short) = (I::select(x_leads, x, y), I::select(x_leads, y, x));
    let norm = I::copysign(I::sqrt(I::add(I::mul(x, x), I::mul(y, y))), long);
    // On the axis the ratio is 0, and so are both coordinates.
    let magnitude = I::max(I::abs(long), I::splat(f32::MIN_POSITIVE));
    let ratio = I::div(short, I::copysign(magnitude, long));
    let angle = I::mul(norm, arctan_over_quarter_turn::<I>(ratio));
    [I::select(x_leads, norm, angle), I::select(x_leads, angle, norm), z]
}

/// 4/π · arctan(t) for |t| ≤ 1, within 2e-7: the polynomial of Cephes' atanf on |t| ≤ tan(π/8), and
/// arctan(t) = π/4 + arctan((t − 1) / (t + 1)) above.
#[inline(always)]
fn arctan_over_quarter_turn<I: InstructionSet>(t: I::Vector) -> I::Vector {
    const TAN_EIGHTH_TURN: f32 = 0.414_213_57;
    const COEFFICIENTS: [f32; 4] = [8.053_744_6e-2, -1.387_768_6e-1, 1.997_771e-1, -3.333_295e-1];
    let one = I::splat(1.0);
    let magnitude = I::abs(t);
    let near = I::less_equal(magnitude, I::splat(TAN_EIGHTH_TURN));
    let turned = I::div(I::sub(magnitude, one), I::add(magnitude, one));
    let u = I::select(near, magnitude, turned);
    let v = I::mul(u, u);
    let mut polynomial = I::splat(COEFFICIENTS[0]);
    for coefficient in &COEFFICIENTS[1..] {
        polynomial = I::multiply_add(polynomial, v, I::splat(*coefficient));
    }
    let small = I::multiply_add(I::mul(polynomial, v), u, u);
    let small = I::mul(small, I::splat(1.0 / FRAC_PI_4));
    I::copysign(I::select(near, small, I::add(one, small)), t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::Portable;

    fn map(mapping: Mapping, p: [f32; 3]) -> [f32; 3] {
        mapping.apply::<Portable>(p.map(|x| [x; 4])).map(|lanes| lanes[0])
    }

    fn grid() -> impl Iterator<Item = [f32; 3]> {
        let steps = || (-20..=20).map(|k| k as f32 / 20.0);
        steps().flat_map(move |x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])))
    }

    #[test]
    fn arctan_is_exact_to_float32() {
        for k in -10_000..=10_000 {
            let t = k as f32 / 10_000.0;
            let exact = f64::from(t).atan() * 4.0 / std::f64::consts::PI;
            let error = (f64::from(arctan_over_quarter_turn::<Portable>([t; 4])[0]) - exact).abs();
            assert!(error < 2e-7, "arctan({t}) is off by {error}");
        }
    }

    #[test]
    fn the_ball_fills_the_cube() {
        for mapping in [Mapping::VolumePreserving, Mapping::Radial] {
            for p in grid() {
                let norm = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
                if norm == 0.0 {
                    assert_eq!(map(mapping, p), [0.0; 3]);
                    continue;
                }
                let on_sphere = map(mapping, p.map(|x| x / norm));
                let largest = on_sphere.iter().fold(0.0f32, |a, x| a.max(x.abs()));
                // A point of the sphere lands on the surface of the cube, up to rounding.
                assert!((largest - 1.0).abs() < 1e-6, "{mapping:?} {p:?} -> {on_sphere:?}");
            }
        }
    }

    #[test]
    fn the_volume_preserving_map_preserves_volume() {
        let h = 1e-2f32;
        for p in grid().filter(|p| {
            let norm = p.iter().map(|x| x * x).sum::<f32>().sqrt();
            let planar = p[0] * p[0] + p[1] * p[1];
            // Away from the centre and from where the pieces of Eq. 19 and 20 meet.
            norm > 0.2
                && norm < 0.95
                && (1.25 * p[2] * p[2] - planar).abs() > 0.1
                && (p[0].abs() - p[1].abs()).abs() > 0.06
                && planar > 0.05
        }) {
            let column = |axis: usize| {
                let (mut low, mut high) = (p, p);
                low[axis] -= h;
                high[axis] += h;
                let (low, high) = (map(Mapping::VolumePreserving, low), map(Mapping::VolumePreserving, high));
                std::array::from_fn::<f32, 3, _>(|i| (high[i] - low[i]) / (2.0 * h))
            };
            let [a, b, c] = [column(0), column(1), column(2)];
            let determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - b[0] * (a[1] * c[2] - a[2] * c[1])
                + c[0] * (a[1] * b[2] - a[2] * b[1]);
            // 8 / (4π/3), the ratio of the volumes; central differences over 2 h are good to a few 1e-3.
            assert!((determinant - 1.909_86).abs() < 0.02, "{p:?}: {determinant}");
        }
    }
}

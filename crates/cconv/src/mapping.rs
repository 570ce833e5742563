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

impl Mapping {
    /// (∂Λ/∂p)ᵀ u: the derivatives by points of the ball from those by their images. 0 at the centre of the ball,
    /// and across the axis on it, where Λ has none.
    #[inline(always)]
    pub(crate) fn pull_back<I: InstructionSet>(self, p: [I::Vector; 3], u: [I::Vector; 3]) -> [I::Vector; 3] {
        match self {
            Mapping::VolumePreserving => {
                let u = pull_back_cube::<I>(ball_to_cylinder::<I>(p), u);
                pull_back_cylinder::<I>(p, u)
            }
            Mapping::Radial => pull_back_radial::<I>(p, u),
            Mapping::Identity => u,
        }
    }
}

/// Where a distance counts as zero in a derivative: far below the distance of any two float32 positions of one
/// magnitude, and its square is still above zero.
const COINCIDENT: f32 = 1e-15;

#[inline(always)]
fn pull_back_radial<I: InstructionSet>([x, y, z]: [I::Vector; 3], u: [I::Vector; 3]) -> [I::Vector; 3] {
    let zero = I::splat(0.0);
    let norm = I::sqrt(I::add(I::add(I::mul(x, x), I::mul(y, y)), I::mul(z, z)));
    let at_centre = I::less_equal(norm, I::splat(COINCIDENT));
    // Of equal coordinates the first leads.
    let x_leads = I::less_equal(I::max(I::abs(y), I::abs(z)), I::abs(x));
    let y_leads = I::less_equal(I::abs(z), I::abs(y));
    let largest = I::select(x_leads, x, I::select(y_leads, y, z));
    let inverse = I::div(I::splat(1.0), largest);
    let scale = I::mul(norm, I::abs(inverse));
    let along = I::add(I::add(I::mul(u[0], x), I::mul(u[1], y)), I::mul(u[2], z));
    let by_norm = I::div(I::mul(along, I::abs(inverse)), norm);
    let by_largest = I::mul(I::mul(along, scale), inverse);
    let leading = [
        I::select(x_leads, by_largest, zero),
        I::select(x_leads, zero, I::select(y_leads, by_largest, zero)),
        I::select(x_leads, zero, I::select(y_leads, zero, by_largest)),
    ];
    let p = [x, y, z];
    std::array::from_fn(|axis| {
        let sum = I::multiply_add(p[axis], by_norm, I::mul(u[axis], scale));
        I::select(at_centre, zero, I::sub(sum, leading[axis]))
    })
}

/// The adjoint of [`ball_to_cylinder`]'s derivative.
#[inline(always)]
fn pull_back_cylinder<I: InstructionSet>([x, y, z]: [I::Vector; 3], u: [I::Vector; 3]) -> [I::Vector; 3] {
    let (zero, one, coincident) = (I::splat(0.0), I::splat(1.0), I::splat(COINCIDENT));
    let planar_square = I::add(I::mul(x, x), I::mul(y, y));
    let z_square = I::mul(z, z);
    let norm = I::sqrt(I::add(planar_square, z_square));
    let at_centre = I::less_equal(norm, coincident);
    let inverse = I::div(one, I::max(norm, coincident));
    let along = I::add(I::mul(u[0], x), I::mul(u[1], y));
    // scale = norm / planar
    let inverse_planar = I::div(one, I::max(I::sqrt(planar_square), coincident));
    let side = I::mul(norm, inverse_planar);
    let steepness = I::mul(z, inverse_planar);
    let side_planar =
        I::mul(I::mul(I::mul(steepness, steepness), I::mul(inverse, inverse_planar)), I::sub(zero, along));
    let side_height =
        I::multiply_add(I::mul(along, I::mul(z, inverse)), inverse_planar, I::mul(I::splat(1.5), u[2]));
    // scale² = 3 norm / (norm + |z|)
    let sum = I::max(I::add(norm, I::abs(z)), coincident);
    let cap = I::sqrt(I::div(I::mul(I::splat(3.0), norm), sum));
    let half = I::div(
        I::mul(I::mul(I::splat(1.5), along), inverse),
        I::max(I::mul(cap, I::mul(sum, sum)), I::splat(f32::MIN_POSITIVE)),
    );
    let sign = I::copysign(one, z);
    let upwards = I::mul(I::mul(u[2], sign), inverse);
    let cap_planar = I::multiply_add(half, I::abs(z), upwards);
    let cap_height = I::sub(I::mul(upwards, z), I::mul(half, I::mul(sign, planar_square)));
    let on_side = I::less_equal(I::mul(I::splat(1.25), z_square), planar_square);
    let scale = I::select(on_side, side, cap);
    let planar = I::select(on_side, side_planar, cap_planar);
    let height = I::select(on_side, side_height, cap_height);
    [
        I::select(at_centre, zero, I::multiply_add(x, planar, I::mul(scale, u[0]))),
        I::select(at_centre, zero, I::multiply_add(y, planar, I::mul(scale, u[1]))),
        I::select(at_centre, zero, height),
    ]
}

/// The adjoint of [`cylinder_to_cube`]'s derivative.
#[inline(always)]
fn pull_back_cube<I: InstructionSet>([x, y, _]: [I::Vector; 3], u: [I::Vector; 3]) -> [I::Vector; 3] {
    let (zero, coincident) = (I::splat(0.0), I::splat(COINCIDENT));
    let x_leads = I::less_equal(I::abs(y), I::abs(x));
    let (long, short) = (I::select(x_leads, x, y), I::select(x_leads, y, x));
    let (u_long, u_short) = (I::select(x_leads, u[0], u[1]), I::select(x_leads, u[1], u[0]));
    let planar = I::sqrt(I::add(I::mul(x, x), I::mul(y, y)));
    let on_axis = I::less_equal(planar, coincident);
    let inverse = I::div(I::splat(1.0), I::copysign(I::max(planar, coincident), long));
    let magnitude = I::max(I::abs(long), I::splat(f32::MIN_POSITIVE));
    let angle = arctan_over_quarter_turn::<I>(I::div(short, I::copysign(magnitude, long)));
    // The radius with the sign of the longer coordinate, and that times the angle.
    let by_radius = I::multiply_add(u_short, angle, u_long);
    let by_angle = I::mul(u_short, I::splat(1.0 / FRAC_PI_4));
    let by_long = I::mul(I::sub(I::mul(by_radius, long), I::mul(by_angle, short)), inverse);
    let by_short = I::mul(I::add(I::mul(by_radius, short), I::mul(by_angle, long)), inverse);
    let (by_long, by_short) = (I::select(on_axis, zero, by_long), I::select(on_axis, zero, by_short));
    [I::select(x_leads, by_long, by_short), I::select(x_leads, by_short, by_long), u[2]]
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

//! The mapping Λ from the unit ball to a cube, Eq. 19-21.
//!
//! Here the cube is [−1, 1]³; the shift and halving of Eq. 21 belong to the lookup in `filter.rs`. The
//! functions are free of branches, so that a loop over them becomes vector instructions.

use std::f32::consts::FRAC_PI_4;

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
    /// Maps a point of the unit ball to the cube [−1, 1]³.
    #[inline(always)]
    pub fn apply(self, p: [f32; 3]) -> [f32; 3] {
        match self {
            Mapping::VolumePreserving => cylinder_to_cube(ball_to_cylinder(p)),
            Mapping::Radial => radial(p),
            Mapping::Identity => p,
        }
    }
}

#[inline(always)]
fn radial([x, y, z]: [f32; 3]) -> [f32; 3] {
    let largest = x.abs().max(y.abs()).max(z.abs());
    let norm = (x * x + y * y + z * z).sqrt();
    let scale = if largest > 0.0 { norm / largest } else { 0.0 };
    [x * scale, y * scale, z * scale]
}

/// Λ_ball→cyl, Eq. 19.
#[inline(always)]
fn ball_to_cylinder([x, y, z]: [f32; 3]) -> [f32; 3] {
    let planar_square = x * x + y * y;
    let norm = (planar_square + z * z).sqrt();
    // Both quotients are 0/0 at the centre only, where x = y = z = 0 and any finite scale gives 0. They
    // are below their bounds of 3/2 and 3 elsewhere; max() keeps the unused branch finite.
    let side = norm / planar_square.sqrt().max(f32::MIN_POSITIVE);
    let cap = (3.0 * norm / (norm + z.abs()).max(f32::MIN_POSITIVE)).sqrt();
    let in_side = 1.25 * z * z <= planar_square;
    let scale = if in_side { side } else { cap };
    let height = if in_side { 1.5 * z } else { norm.copysign(z) };
    [x * scale, y * scale, height]
}

/// Λ_cyl→cube, Eq. 20.
#[inline(always)]
fn cylinder_to_cube([x, y, z]: [f32; 3]) -> [f32; 3] {
    let x_leads = y.abs() <= x.abs();
    let (long, short) = if x_leads { (x, y) } else { (y, x) };
    let norm = (x * x + y * y).sqrt().copysign(long);
    // On the axis both are 0 and so is the result.
    let ratio = if long == 0.0 { 0.0 } else { short / long };
    let angle = norm * arctan_over_quarter_turn(ratio);
    if x_leads { [norm, angle, z] } else { [angle, norm, z] }
}

/// 4/π · arctan(t) for |t| ≤ 1, within 2e-7: the polynomial of Cephes' atanf on |t| ≤ tan(π/8), and
/// arctan(t) = π/4 + arctan((t − 1) / (t + 1)) above.
#[inline(always)]
fn arctan_over_quarter_turn(t: f32) -> f32 {
    const TAN_EIGHTH_TURN: f32 = 0.414_213_57;
    let magnitude = t.abs();
    let far = magnitude > TAN_EIGHTH_TURN;
    let u = if far { (magnitude - 1.0) / (magnitude + 1.0) } else { magnitude };
    let v = u * u;
    let polynomial = ((8.053_744_6e-2 * v - 1.387_768_6e-1) * v + 1.997_771e-1) * v - 3.333_295e-1;
    let small = (polynomial * v * u + u) * (1.0 / FRAC_PI_4);
    (if far { 1.0 + small } else { small }).copysign(t)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> impl Iterator<Item = [f32; 3]> {
        let steps = || (-20..=20).map(|k| k as f32 / 20.0);
        steps().flat_map(move |x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])))
    }

    #[test]
    fn arctan_is_exact_to_float32() {
        for k in -10_000..=10_000 {
            let t = k as f32 / 10_000.0;
            let exact = f64::from(t).atan() * 4.0 / std::f64::consts::PI;
            let error = (f64::from(arctan_over_quarter_turn(t)) - exact).abs();
            assert!(error < 2e-7, "arctan({t}) is off by {error}");
        }
    }

    #[test]
    fn the_ball_fills_the_cube() {
        for mapping in [Mapping::VolumePreserving, Mapping::Radial] {
            for p in grid() {
                let norm = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
                if norm == 0.0 {
                    assert_eq!(mapping.apply(p), [0.0; 3]);
                    continue;
                }
                let on_sphere = mapping.apply(p.map(|x| x / norm));
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
                let (low, high) =
                    (Mapping::VolumePreserving.apply(low), Mapping::VolumePreserving.apply(high));
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

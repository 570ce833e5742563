//! Where a body is put: scale first, then rotation, then translation.

use crate::mesh::{Vec3, cross, dot, scaled};

/// How the coordinates of a file or shape become those of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Factors along the axes of the file, positive.
    pub scale: [f32; 3],
    /// Around the origin of the file.
    pub rotation: Option<Rotation>,
    /// Metres.
    pub translation: [f32; 3],
}

/// A right-handed rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    /// Its direction, of any length but zero.
    pub axis: [f32; 3],
    /// Degrees.
    pub angle: f32,
}

impl Default for Placement {
    fn default() -> Self {
        Placement { scale: [1.0; 3], rotation: None, translation: [0.0; 3] }
    }
}

impl Placement {
    /// What scales and rotates a position about the origin.
    pub(super) fn turn(&self) -> impl Fn(Vec3) -> Vec3 {
        let (factors, rotate) = (self.scale.map(factor), self.rotate());
        move |x| rotate([0, 1, 2].map(|k| x[k] * factors[k]))
    }

    /// What rotates a velocity.
    pub(super) fn rotate(&self) -> impl Fn(Vec3) -> Vec3 {
        let turn = self
            .rotation
            .map(|rotation| (unit(rotation.axis.map(f64::from)), sin_cos_degrees(rotation.angle.into())));
        move |v| {
            let Some((axis, (sin, cos))) = turn else { return v };
            // Rodrigues' formula: v cos + (axis × v) sin + axis (axis · v) (1 - cos).
            let (turned, along) = (cross(axis, v), dot(axis, v) * (1.0 - cos));
            [0, 1, 2].map(|k| v[k] * cos + turned[k] * sin + axis[k] * along)
        }
    }

    /// What gives the unit normal after scaling and rotating a surface; `None` for a normal without direction.
    pub(super) fn turn_normal(&self) -> impl Fn(Vec3) -> Option<Vec3> {
        let (factors, rotate) = (self.scale.map(factor), self.rotate());
        move |n| {
            let normal = rotate([0, 1, 2].map(|k| n[k] / factors[k]));
            (dot(normal, normal) > 0.0).then(|| unit(normal))
        }
    }

    /// Moves a position that was turned.
    pub(super) fn translate(&self, x: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|k| (f64::from(x[k]) + f64::from(self.translation[k])) as f32)
    }
}

/// The decimal number that the scene file has, which float32 rounded: 0.001 times 195 is 0.195 then, as a file
/// in metres would say.
fn factor(scale: f32) -> f64 {
    scale.to_string().parse().unwrap_or_else(|_| scale.into())
}

fn unit(v: Vec3) -> Vec3 {
    // By the largest coordinate first, so that no square over- or underflows.
    let largest = v.iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
    let v = scaled(v, 1.0 / largest);
    scaled(v, 1.0 / dot(v, v).sqrt())
}

/// Exact at multiples of a right angle, where sin and cos of the rounded radians are not.
fn sin_cos_degrees(angle: f64) -> (f64, f64) {
    let angle = angle.rem_euclid(360.0);
    let quarter = (angle / 90.0).round();
    let (sin, cos) = (angle - 90.0 * quarter).to_radians().sin_cos();
    match quarter as u32 % 4 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about(axis: [f32; 3], angle: f32) -> Placement {
        Placement { rotation: Some(Rotation { axis, angle }), ..Placement::default() }
    }

    #[test]
    fn quarter_turns_are_exact_and_right_handed() {
        assert_eq!(about([0.0, 0.0, 2.0], 90.0).turn()([1.0, 0.0, 5.0]), [0.0, 1.0, 5.0]);
        assert_eq!(about([0.0, 1.0, 0.0], -90.0).turn()([1.0, 2.0, 0.0]), [0.0, 2.0, 1.0]);
        assert_eq!(about([1.0, 0.0, 0.0], 540.0).turn()([1.0, 2.0, 3.0]), [1.0, -2.0, -3.0]);
    }

    #[test]
    fn thirds_of_a_turn_about_the_diagonal_swap_axes() {
        let turned = about([1e-30, 1e-30, 1e-30], 120.0).turn()([1.0, 2.0, 3.0]);
        // A handful of roundings in f64.
        assert!((0..3).all(|k| (turned[k] - [3.0, 1.0, 2.0][k]).abs() < 1e-14), "{turned:?}");
    }

    #[test]
    fn scale_comes_before_rotation_and_normals_follow_the_surface() {
        let placement = Placement { scale: [2.0, 1.0, 1.0], ..about([0.0, 0.0, 1.0], 90.0) };
        assert_eq!(placement.turn()([1.0, 0.0, 0.0]), [0.0, 2.0, 0.0]);
        // The plane x + y = 0 becomes x / 2 + y = 0, then turns.
        let normal = placement.turn_normal()([1.0, 1.0, 0.0]).expect("a direction");
        let expected = [-1.0 / 1.25_f64.sqrt(), 0.5 / 1.25_f64.sqrt(), 0.0];
        assert!((0..3).all(|k| (normal[k] - expected[k]).abs() < 1e-15), "{normal:?}");
        assert_eq!(placement.turn_normal()([0.0; 3]), None);
    }

    #[test]
    fn millimetres_become_the_same_metres() {
        let placement = Placement { scale: [0.001; 3], ..Placement::default() };
        assert_eq!(placement.turn()([195.0, 75.0, 10.0]).map(|x| x as f32), [0.195, 0.075, 0.01]);
    }
}

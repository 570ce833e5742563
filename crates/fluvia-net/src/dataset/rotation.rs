//! Rotation about the axis of gravity, by which training data are turned at random: Rodrigues' formula as a matrix.

use std::f64::consts::TAU;

use fluvia_neighbors::Point;
use rand_pcg::Pcg64;

use super::order::unit;

/// A rotation about an axis through the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    rows: [[f32; 3]; 3],
}

impl Rotation {
    /// None.
    pub const NONE: Rotation = Rotation { rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] };

    /// By an angle in radians, right-handed about `axis`; about y if that has no length.
    pub fn about(axis: Point, angle: f64) -> Rotation {
        let axis = axis.map(f64::from);
        let length = axis.iter().map(|x| x * x).sum::<f64>().sqrt();
        let [x, y, z] = if length > 0.0 { axis.map(|x| x / length) } else { [0.0, 1.0, 0.0] };
        let (sin, cos) = angle.sin_cos();
        let t = 1.0 - cos;
        let rows = [
            [cos + t * x * x, t * x * y - sin * z, t * x * z + sin * y],
            [t * x * y + sin * z, cos + t * y * y, t * y * z - sin * x],
            [t * x * z - sin * y, t * y * z + sin * x, cos + t * z * z],
        ];
        Rotation { rows: rows.map(|row| row.map(|x| x as f32)) }
    }

    /// By a random angle.
    pub fn random(axis: Point, random: &mut Pcg64) -> Rotation {
        Rotation::about(axis, TAU * unit(random))
    }

    /// A vector, turned.
    pub fn of(&self, v: Point) -> Point {
        self.rows.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_about_gravity() {
        let near = |a: Point, b: Point| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        let quarter = Rotation::about([0.0, -9.81, 0.0], TAU / 4.0);
        assert!(near(quarter.of([1.0, 2.0, 0.0]), [0.0, 2.0, 1.0]), "{quarter:?}");
        let about_z = Rotation::about([0.0, 0.0, 2.0], TAU / 4.0);
        assert!(near(about_z.of([1.0, 0.0, 3.0]), [0.0, 1.0, 3.0]), "{about_z:?}");
        assert_eq!(Rotation::NONE.of([1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
        assert!(near(Rotation::about([0.0; 3], TAU / 4.0).of([0.0, 0.0, 1.0]), [1.0, 0.0, 0.0]));
    }
}

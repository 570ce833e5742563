//! Vectors in f64, and the distance from a point to a triangle.

/// A point or a vector.
pub(crate) type Vec3 = [f64; 3];

#[inline]
pub(crate) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
pub(crate) fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline]
pub(crate) fn scaled(a: Vec3, factor: f64) -> Vec3 {
    a.map(|x| x * factor)
}

/// The distance from a point to a triangle, which may be degenerate: to the plane where the foot of the
/// perpendicular is inside, else to the nearest side.
pub(crate) fn distance_to_triangle(point: Vec3, &[a, b, c]: &[Vec3; 3]) -> f64 {
    let normal = cross(sub(b, a), sub(c, a));
    let square = dot(normal, normal);
    let left_of = |from: Vec3, to: Vec3| dot(cross(sub(to, from), sub(point, from)), normal) >= 0.0;
    if square > 0.0 && left_of(a, b) && left_of(b, c) && left_of(c, a) {
        return dot(sub(point, a), normal).abs() / square.sqrt();
    }
    let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| distance_to_segment(point, from, to));
    sides[0].min(sides[1]).min(sides[2])
}

fn distance_to_segment(point: Vec3, from: Vec3, to: Vec3) -> f64 {
    let (along, offset) = (sub(to, from), sub(point, from));
    let square = dot(along, along);
    let t = if square > 0.0 { (dot(offset, along) / square).clamp(0.0, 1.0) } else { 0.0 };
    let rest = sub(offset, scaled(along, t));
    dot(rest, rest).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_to_face_side_corner_and_needle() {
        let triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(distance_to_triangle([0.25, 0.25, 2.0], &triangle), 2.0);
        assert_eq!(distance_to_triangle([0.5, -3.0, 4.0], &triangle), 5.0);
        assert_eq!(distance_to_triangle([4.0, 0.0, 4.0], &triangle), 5.0);
        let needle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]];
        assert_eq!(distance_to_triangle([0.5, 2.0, 0.0], &needle), 2.0);
    }
}

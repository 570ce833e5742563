//! Vectors of three numbers.

pub(crate) type Vec3 = [f32; 3];

#[inline]
pub(crate) fn add(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline]
pub(crate) fn sub(a: Vec3, b: Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
pub(crate) fn scaled(a: Vec3, factor: f32) -> Vec3 {
    a.map(|x| x * factor)
}

#[inline]
pub(crate) fn dot(a: Vec3, b: Vec3) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub(crate) fn cross(a: Vec3, b: Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// `a` with the length 1; zero if it has no direction.
#[inline]
pub(crate) fn unit(a: Vec3) -> Vec3 {
    let length = dot(a, a).sqrt();
    if length > 0.0 && length.is_finite() { scaled(a, 1.0 / length) } else { [0.0; 3] }
}

/// Whether a point has a place.
#[inline]
pub(crate) fn finite(point: &Vec3) -> bool {
    point.iter().all(|x| x.is_finite())
}

/// The way from `a` (at 0) to `b` (at 1).
#[inline]
pub(crate) fn mix(a: Vec3, b: Vec3, t: f32) -> Vec3 {
    [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])]
}

/// 0 below `low`, 1 above `high`, and a smooth way between them.
#[inline]
pub(crate) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Two unit vectors across `direction`, a unit vector, and each other.
pub(crate) fn across(direction: Vec3) -> [Vec3; 2] {
    // Any vector that is not along the direction gives the first.
    let other = if direction[1].abs() < 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
    let first = unit(cross(other, direction));
    [first, cross(direction, first)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_directions_are_across_each_other() {
        for direction in [[0.0, 1.0, 0.0], [0.6, 0.0, -0.8], [0.48, 0.6, 0.64]] {
            let [a, b] = across(direction);
            for (p, q, expected) in
                [(a, a, 1.0), (b, b, 1.0), (a, b, 0.0), (a, direction, 0.0), (b, direction, 0.0)]
            {
                assert!((dot(p, q) - expected).abs() < 1e-6);
            }
        }
    }
}

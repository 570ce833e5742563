//! Arithmetic on triples.

pub type Vector = [f32; 3];

#[inline]
pub fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline]
pub fn sub(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
pub fn scale(a: Vector, s: f32) -> Vector {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// a + s b.
#[inline]
pub fn add_scaled(a: Vector, s: f32, b: Vector) -> Vector {
    [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]
}

#[inline]
pub fn dot(a: Vector, b: Vector) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a` shortened to `length` if it is longer.
#[inline]
pub fn shorten(a: Vector, length: f32) -> Vector {
    let squared = dot(a, a);
    if squared > length * length { scale(a, length / squared.sqrt()) } else { a }
}

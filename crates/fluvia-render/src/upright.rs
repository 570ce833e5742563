//! Scenes with any direction up, turned so that y is up, and back.

/// The shortest rotation that turns `up` into +y; the identity if `up` has no direction.
pub(crate) fn upright(up: [f32; 3]) -> [[f64; 3]; 3] {
    let length = up.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
    let [x, y, z] = up.map(|x| f64::from(x) / length);
    if !(x + y + z).is_finite() || y == 1.0 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    }
    if y < -1.0 + 1e-9 {
        return [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];
    }
    // Rodrigues' formula for the axis up × y = (-z, 0, x), whose length is the sine of the angle.
    let c = 1.0 / (1.0 + y);
    [[1.0 - c * x * x, -x, -c * x * z], [x, y, z], [-c * x * z, -z, 1.0 - c * z * z]]
}

/// A point in axes that are given as rows.
pub(crate) fn rotate(rows: &[[f64; 3]; 3], p: [f64; 3]) -> [f64; 3] {
    rows.map(|row| row[0] * p[0] + row[1] * p[1] + row[2] * p[2])
}

/// The inverse of [`rotate`].
pub(crate) fn rotate_back(rows: &[[f64; 3]; 3], p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| rows[0][k] * p[0] + rows[1][k] * p[1] + rows[2][k] * p[2])
}

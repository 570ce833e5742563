//! How a filter is looked up, in float64: window, mapping, interpolation and their derivatives, from the equations.

use std::f64::consts::PI;

use super::IDENTITY;
use crate::{Interpolation, Mapping, Options, Window};

/// The window a of Eq. 8 at the normalised position `r`.
pub fn window(window: Window, r: [f64; 3]) -> f64 {
    let q = norm_square(r);
    match window {
        Window::Poly6 => (1.0 - q).max(0.0).powi(3),
        Window::Triangular => (1.0 - q.sqrt()).max(0.0),
        Window::None => 1.0,
    }
}

/// ∂a/∂r.
pub fn window_slope(window: Window, r: [f64; 3]) -> [f64; 3] {
    let q = norm_square(r);
    match window {
        Window::Poly6 => r.map(|x| -6.0 * x * (1.0 - q).max(0.0).powi(2)),
        Window::Triangular if q > 0.0 && q < 1.0 => r.map(|x| -x / q.sqrt()),
        Window::Triangular | Window::None => [0.0; 3],
    }
}

fn norm_square(r: [f64; 3]) -> f64 {
    r.iter().map(|x| x * x).sum()
}

/// Λ of Eq. 19-21 before the shift to [0, 1]: from the unit ball to [−1, 1]³.
pub fn map(mapping: Mapping, r: [f64; 3]) -> [f64; 3] {
    let norm = norm_square(r).sqrt();
    if norm == 0.0 {
        return [0.0; 3];
    }
    match mapping {
        Mapping::Identity => r,
        Mapping::Radial => r.map(|c| c * norm / largest(r).abs()),
        Mapping::VolumePreserving => cylinder_to_cube(ball_to_cylinder(r)),
    }
}

/// ∂Λ/∂r, a row for each coordinate of Λ.
pub fn map_slope(mapping: Mapping, r: [f64; 3]) -> [[f64; 3]; 3] {
    let norm = norm_square(r).sqrt();
    match mapping {
        Mapping::Identity => IDENTITY,
        _ if norm == 0.0 => [[0.0; 3]; 3],
        Mapping::Radial => {
            let largest = largest(r);
            let leading = r.iter().position(|&x| x == largest).unwrap_or(0);
            let scale = norm / largest.abs();
            std::array::from_fn(|k| {
                std::array::from_fn(|axis| {
                    let by_norm = r[k] * r[axis] / (norm * largest.abs());
                    let by_largest = if axis == leading { -r[k] * scale / largest } else { 0.0 };
                    by_norm + by_largest + if axis == k { scale } else { 0.0 }
                })
            })
        }
        Mapping::VolumePreserving => {
            product(cylinder_to_cube_slope(ball_to_cylinder(r)), ball_to_cylinder_slope(r))
        }
    }
}

/// The coordinate of the largest magnitude; the first of equal ones.
fn largest(r: [f64; 3]) -> f64 {
    r.into_iter().fold(0.0, |a: f64, x| if x.abs() > a.abs() { x } else { a })
}

/// Eq. 19.
fn ball_to_cylinder([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (norm, planar) = ((x * x + y * y + z * z).sqrt(), (x * x + y * y).sqrt());
    if 1.25 * z * z <= x * x + y * y {
        [x * norm / planar, y * norm / planar, 1.5 * z]
    } else {
        let scale = (3.0 * norm / (norm + z.abs())).sqrt();
        [x * scale, y * scale, z.signum() * norm]
    }
}

fn ball_to_cylinder_slope([x, y, z]: [f64; 3]) -> [[f64; 3]; 3] {
    let (norm, planar) = ((x * x + y * y + z * z).sqrt(), (x * x + y * y).sqrt());
    let planar_rows = |scale: f64, slope: [f64; 3]| -> [[f64; 3]; 2] {
        let row = |x: f64| slope.map(|slope| x * slope);
        let (mut first, mut second) = (row(x), row(y));
        first[0] += scale;
        second[1] += scale;
        [first, second]
    };
    if 1.25 * z * z <= x * x + y * y {
        // scale = norm / planar
        let by_planar = -z * z / (norm * planar.powi(3));
        let [first, second] = planar_rows(norm / planar, [x * by_planar, y * by_planar, z / (norm * planar)]);
        [first, second, [0.0, 0.0, 1.5]]
    } else {
        // scale² = 3 norm / (norm + |z|)
        let scale = (3.0 * norm / (norm + z.abs())).sqrt();
        let half = 1.5 / (scale * norm * (norm + z.abs()).powi(2));
        let slope = [half * z.abs() * x, half * z.abs() * y, -half * z.signum() * planar * planar];
        let [first, second] = planar_rows(scale, slope);
        [first, second, [x, y, z].map(|c| z.signum() * c / norm)]
    }
}

/// Eq. 20.
fn cylinder_to_cube([x, y, z]: [f64; 3]) -> [f64; 3] {
    let planar = (x * x + y * y).sqrt();
    if planar == 0.0 {
        [0.0, 0.0, z]
    } else if y.abs() <= x.abs() {
        [x.signum() * planar, 4.0 / PI * x.signum() * planar * (y / x).atan(), z]
    } else {
        [4.0 / PI * y.signum() * planar * (x / y).atan(), y.signum() * planar, z]
    }
}

fn cylinder_to_cube_slope([x, y, _]: [f64; 3]) -> [[f64; 3]; 3] {
    let planar = (x * x + y * y).sqrt();
    // By the longer coordinate, then by the shorter: of the radius with the sign of the longer, and of that
    // times 4/π arctan(short / long).
    let slopes = |long: f64, short: f64| {
        let (sign, angle) = (long.signum(), (short / long).atan());
        let radius = [sign * long / planar, sign * short / planar];
        let turn = [-sign * short / planar, sign * long / planar];
        (radius, [0, 1].map(|k| 4.0 / PI * (radius[k] * angle + turn[k])))
    };
    if planar == 0.0 {
        [[0.0; 3], [0.0; 3], [0.0, 0.0, 1.0]]
    } else if y.abs() <= x.abs() {
        let (radius, angle) = slopes(x, y);
        [[radius[0], radius[1], 0.0], [angle[0], angle[1], 0.0], [0.0, 0.0, 1.0]]
    } else {
        let (radius, angle) = slopes(y, x);
        [[angle[1], angle[0], 0.0], [radius[1], radius[0], 0.0], [0.0, 0.0, 1.0]]
    }
}

fn product(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    a.map(|row| std::array::from_fn(|column| (0..3).map(|k| row[k] * b[k][column]).sum()))
}

/// A filter cell near a point of the cube.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    pub cell: usize,
    pub share: f64,
    /// ∂share / ∂ position in the cube, along x, y and z.
    pub slope: [f64; 3],
}

/// The filter cells around a position of the cube [−1, 1]³.
pub fn interpolate(options: &Options, position: [f64; 3]) -> Vec<Corner> {
    let [depth, height, width] = options.filter_size;
    // Cells, shares and slopes along each axis.
    let axes: [Vec<(usize, f64, f64)>; 3] = std::array::from_fn(|axis| {
        let size = [width, height, depth][axis];
        let span = if options.align_corners { size as f64 - 1.0 } else { size as f64 };
        // Eq. 21, then from [0, 1] to cells counted from the centre of the first.
        let unit = 0.5 * position[axis] + 0.5;
        let shift = if options.align_corners { 0.0 } else { -0.5 };
        let along = along(options.interpolation, unit * span + shift + f64::from(options.offset[axis]), size);
        along.into_iter().map(|(cell, share, slope)| (cell, share, 0.5 * span * slope)).collect()
    });
    let mut corners = Vec::new();
    for (z, share_z, slope_z) in &axes[2] {
        for (y, share_y, slope_y) in &axes[1] {
            for (x, share_x, slope_x) in &axes[0] {
                corners.push(Corner {
                    cell: (z * height + y) * width + x,
                    share: share_x * share_y * share_z,
                    slope: [
                        slope_x * share_y * share_z,
                        share_x * slope_y * share_z,
                        share_x * share_y * slope_z,
                    ],
                });
            }
        }
    }
    corners
}

/// Cells, their shares and the slopes of these at the coordinate x, in cells.
fn along(interpolation: Interpolation, x: f64, size: usize) -> Vec<(usize, f64, f64)> {
    let last = size as f64 - 1.0;
    match interpolation {
        Interpolation::Nearest => vec![(x.clamp(0.0, last).round() as usize, 1.0, 0.0)],
        Interpolation::Linear => {
            let slope = if (0.0..=last).contains(&x) { 1.0 } else { 0.0 };
            let x = x.clamp(0.0, last);
            // The last centre belongs to the cell before it.
            let low = x.floor().min((last - 1.0).max(0.0));
            let next = (low + 1.0).min(last);
            vec![(low as usize, 1.0 - (x - low), -slope), (next as usize, x - low, slope)]
        }
        Interpolation::LinearBorder => {
            let low = x.floor();
            [(low, 1.0 - (x - low), -1.0), (low + 1.0, x - low, 1.0)]
                .into_iter()
                .filter(|(cell, ..)| (0.0..=last).contains(cell))
                .map(|(cell, share, slope)| (cell as usize, share, slope))
                .collect()
        }
    }
}

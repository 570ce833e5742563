//! The depth buffer: spheres as discs with the depth of a sphere, and its blur.
//!
//! A sphere of radius R at depth d is seen as a disc of q = f R / d pixels around (x, y). A pixel at the
//! distance s from there shows the sphere at the depth d - R sqrt(1 - (s / q)²). Each pixel keeps the least
//! (depth, particle), so that the order of drawing does not matter and the result is the same at any
//! number of threads.

use rayon::prelude::*;

/// A sphere as the camera sees it; lengths in pixels but for the depth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Disc {
    pub x: f32,
    pub y: f32,
    /// Metres along the view.
    pub depth: f32,
    /// The radius of the disc.
    pub reach: f32,
    /// The particle.
    pub particle: u32,
}

/// Which particle each pixel shows, and how far away it is: [height, width].
pub(crate) struct DepthBuffer {
    pub width: usize,
    pub height: usize,
    /// The bits of the depth (those of positive floats sort as they do) above the particle.
    keys: Vec<u64>,
}

/// The key of a pixel that shows no particle: behind everything.
const NOTHING: u64 = u64::MAX;
/// Rows that one task draws: few enough to share the work, many enough that few discs are cut.
const BAND: usize = 32;

impl DepthBuffer {
    /// Draws spheres of `radius` metres; quickest if the nearest come first.
    pub fn draw(discs: &[Disc], radius: f32, width: usize, height: usize) -> DepthBuffer {
        let (starts, order) = bands(discs, height);
        let mut keys = vec![NOTHING; width * height];
        keys.par_chunks_mut((BAND * width).max(1)).enumerate().for_each(|(band, keys)| {
            let first_row = band * BAND;
            for &disc in &order[starts[band]..starts[band + 1]] {
                draw_disc(&discs[disc as usize], radius, width, first_row, keys);
            }
        });
        DepthBuffer { width, height, keys }
    }

    /// The particle at a pixel and its depth.
    pub fn at(&self, pixel: usize) -> Option<(u32, f32)> {
        let key = self.keys[pixel];
        (key != NOTHING).then_some((key as u32, f32::from_bits((key >> 32) as u32)))
    }

    /// The mean depth in blocks of `side` x `side` pixels, as an image; pixels that show nothing count as `far`.
    pub fn reduced(&self, side: usize, far: f32) -> Vec<f32> {
        let (width, height) = (self.width / side, self.height / side);
        let mean = |block: usize| {
            let corner = side * (block / width * self.width + block % width);
            let pixels = (0..side * side).map(|i| corner + i / side * self.width + i % side);
            let sum: f32 = pixels.map(|pixel| self.at(pixel).map_or(far, |(_, depth)| depth)).sum();
            sum / (side * side) as f32
        };
        (0..width * height).into_par_iter().map(mean).collect()
    }
}

fn draw_disc(disc: &Disc, radius: f32, width: usize, first_row: usize, keys: &mut [u64]) {
    let rows = keys.len() / width;
    let last_row = first_row + rows - 1;
    let pixels = |low: f32, high: f32, first: usize, last: usize| {
        // A pixel's centre is half a pixel in; casts of floats saturate.
        ((low - 0.5).ceil().max(first as f32) as usize, (high - 0.5).floor().min(last as f32) as i64)
    };
    let (top, bottom) = pixels(disc.y - disc.reach, disc.y + disc.reach, first_row, last_row);
    let (left, right) = pixels(disc.x - disc.reach, disc.x + disc.reach, 0, width - 1);
    let scale = 1.0 / (disc.reach * disc.reach);
    // No point of the sphere is nearer: a pixel whose key is smaller stays as it is.
    let nearest = u64::from((disc.depth - radius).max(0.0).to_bits()) << 32;
    if left as i64 > right {
        return;
    }
    for row in (top as i64)..=bottom {
        let dy = row as f32 + 0.5 - disc.y;
        let first = (row as usize - first_row) * width;
        let pixels = &mut keys[first + left..=first + right as usize];
        for (pixel, column) in pixels.iter_mut().zip(left..).filter(|(pixel, _)| **pixel > nearest) {
            let dx = column as f32 + 0.5 - disc.x;
            let inside = 1.0 - (dx * dx + dy * dy) * scale;
            if inside > 0.0 {
                let depth = (disc.depth - radius * inside.sqrt()).max(0.0);
                let key = u64::from(depth.to_bits()) << 32 | u64::from(disc.particle);
                *pixel = key.min(*pixel);
            }
        }
    }
}

/// Which discs touch which band of rows: discs `order[starts[b]..starts[b + 1]]` touch band `b`.
fn bands(discs: &[Disc], height: usize) -> (Vec<usize>, Vec<u32>) {
    let count = height.div_ceil(BAND);
    let touched = |disc: &Disc| {
        let (top, bottom) = (disc.y - disc.reach, disc.y + disc.reach);
        if bottom < 0.0 || top >= height as f32 {
            return 0..0;
        }
        (top.max(0.0) as usize / BAND).min(count)..(bottom as usize / BAND + 1).min(count)
    };
    let mut starts = vec![0; count + 1];
    for disc in discs {
        touched(disc).for_each(|band| starts[band + 1] += 1);
    }
    for band in 0..count {
        starts[band + 1] += starts[band];
    }
    let mut next = starts.clone();
    let mut order = vec![0; starts[count]];
    for (i, disc) in discs.iter().enumerate() {
        for band in touched(disc) {
            order[next[band]] = i as u32;
            next[band] += 1;
        }
    }
    (starts, order)
}

/// How often a box is applied in each direction: three come near a Gaussian of deviation `radius`.
const BOXES: usize = 3;

/// Blurs `values` [height, width] by [`BOXES`] boxes of 2 `radius` + 1 pixels in each direction.
pub(crate) fn blur(values: &[f32], width: usize, height: usize, radius: usize) -> Vec<f32> {
    if values.is_empty() {
        return Vec::new();
    }
    let radius = radius.min(width.max(height));
    let mut rows = values.to_vec();
    blur_rows(&mut rows, width, radius);
    let mut columns = transpose(&rows, width, height);
    blur_rows(&mut columns, height, radius);
    transpose(&columns, height, width)
}

fn blur_rows(values: &mut [f32], width: usize, radius: usize) {
    values.par_chunks_mut(width).for_each_init(Vec::new, |copy, row| {
        for _ in 0..BOXES {
            copy.clear();
            copy.extend_from_slice(row);
            // At the edges the mean is over the part of the box that is inside. Float64: a running sum in
            // float32 would drift along the row.
            let mut sum: f64 = copy[..radius.min(width)].iter().map(|&x| f64::from(x)).sum();
            for (x, value) in row.iter_mut().enumerate() {
                if x + radius < width {
                    sum += f64::from(copy[x + radius]);
                }
                if x > radius {
                    sum -= f64::from(copy[x - radius - 1]);
                }
                let inside = (x + radius).min(width - 1) - x.saturating_sub(radius) + 1;
                *value = (sum / inside as f64) as f32;
            }
        }
    });
}

/// Columns that one task copies: a cache line of floats.
const TRANSPOSE_BLOCK: usize = 16;

fn transpose(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let mut out = vec![0.0; values.len()];
    out.par_chunks_mut(TRANSPOSE_BLOCK * height).enumerate().for_each(|(block, out)| {
        let first = block * TRANSPOSE_BLOCK;
        let columns = out.len() / height;
        for (y, row) in values.chunks_exact(width).enumerate() {
            for (j, &value) in row[first..first + columns].iter().enumerate() {
                out[j * height + y] = value;
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blur_keeps_a_constant_and_spreads_a_peak_evenly() {
        let (width, height) = (37, 23);
        let flat = blur(&vec![2.5; width * height], width, height, 4);
        // Exact but for the rounding of sums of 9 equal values.
        assert!(flat.iter().all(|x| (x - 2.5).abs() < 1e-6));

        let mut peak = vec![0.0; width * height];
        peak[11 * width + 18] = 1.0;
        let spread = blur(&peak, width, height, 1);
        // Three boxes of 3: (1 3 6 7 6 3 1) / 27 in each direction; float32 rounding.
        let weights = [1.0, 3.0, 6.0, 7.0, 6.0, 3.0, 1.0].map(|w: f32| w / 27.0);
        for dy in 0..7 {
            for dx in 0..7 {
                let found = spread[(8 + dy) * width + 15 + dx];
                assert!((found - weights[dy] * weights[dx]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn a_blur_wider_than_the_image_is_its_mean() {
        let mean = blur(&[0.0, 1.0, 2.0, 3.0], 2, 2, 10);
        assert!(mean.iter().all(|x| (x - 1.5).abs() < 1e-6));
    }

    #[test]
    fn discs_that_reach_over_bands_and_edges_are_drawn_whole() {
        let (width, height) = (100, 3 * BAND + 5);
        let disc = Disc { x: 10.0, y: 60.0, depth: 5.0, reach: 40.0, particle: 7 };
        let buffer = DepthBuffer::draw(&[disc], 0.5, width, height);
        for pixel in 0..width * height {
            let (dx, dy) = ((pixel % width) as f32 + 0.5 - disc.x, (pixel / width) as f32 + 0.5 - disc.y);
            let inside = 1.0 - (dx * dx + dy * dy) / 1600.0;
            match buffer.at(pixel) {
                Some((particle, depth)) => {
                    assert_eq!(particle, 7);
                    assert!((depth - (5.0 - 0.5 * inside.sqrt())).abs() < 1e-5);
                }
                // The multiplication by the inverse may round the other way on the rim.
                None => assert!(inside < 1e-6),
            }
        }
    }
}

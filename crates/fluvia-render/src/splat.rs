//! Spheres to samples: a disc with the depth of a sphere.
//!
//! A sphere of radius R at depth d is seen as a disc of q = f R / d samples around (x, y). A sample at the
//! distance s from there shows the sphere at the depth d - R sqrt(1 - (s / q)²). Each sample keeps the least
//! (depth, particle), so that the order of drawing does not matter and the result is the same at any
//! number of threads.

/// A sphere as the camera sees it; lengths in samples but for the depth.
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

/// The key of a sample that shows nothing: behind everything.
pub(crate) const NOTHING: u64 = u64::MAX;

/// What a sample shows: the bits of the depth (those of positive floats sort as they do) above the index of the thing.
#[inline]
pub(crate) fn key(depth: f32, index: u32) -> u64 {
    u64::from(depth.max(0.0).to_bits()) << 32 | u64::from(index)
}

/// The depth and the thing of a key; `None` if it shows nothing.
#[inline]
pub(crate) fn shown(key: u64) -> Option<(f32, u32)> {
    (key != NOTHING).then_some((f32::from_bits((key >> 32) as u32), key as u32))
}

impl Disc {
    /// The first and the last row that it may cover; casts saturate.
    pub fn rows(&self) -> [i64; 2] {
        [(self.y - self.reach).floor() as i64, (self.y + self.reach).ceil() as i64]
    }

    /// Draws the sphere of `radius` metres into the keys of the rows from `first` on of an image `width` wide; quickest
    /// if the nearest come first.
    pub fn draw(&self, radius: f32, width: usize, first: usize, keys: &mut [u64]) {
        let last = first + keys.len() / width - 1;
        let range = |low: f32, high: f32, first: usize, last: usize| {
            // A sample's centre is half a sample in; casts saturate.
            let start = (low - 0.5).ceil().max(first as f32) as usize;
            start..((high + 0.5).floor().max(0.0) as usize).min(last + 1)
        };
        let columns = range(self.x - self.reach, self.x + self.reach, 0, width - 1);
        let scale = 1.0 / (self.reach * self.reach);
        // No point of the sphere is nearer: a sample whose key is smaller stays as it is.
        let nearest = key(self.depth - radius, 0);
        for row in range(self.y - self.reach, self.y + self.reach, first, last) {
            let dy = row as f32 + 0.5 - self.y;
            let start = (row - first) * width;
            for column in columns.clone() {
                let sample = &mut keys[start + column];
                let dx = column as f32 + 0.5 - self.x;
                let inside = 1.0 - (dx * dx + dy * dy) * scale;
                if inside > 0.0 && *sample > nearest {
                    *sample = key(self.depth - radius * inside.sqrt(), self.particle).min(*sample);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_that_reaches_over_bands_and_edges_is_drawn_whole() {
        let (width, height, band) = (100, 101, 32);
        let disc = Disc { x: 10.0, y: 60.0, depth: 5.0, reach: 40.0, particle: 7 };
        let mut keys = vec![NOTHING; width * height];
        keys.chunks_mut(band * width).enumerate().for_each(|(k, keys)| disc.draw(0.5, width, band * k, keys));
        for (at, &key) in keys.iter().enumerate() {
            let (dx, dy) = ((at % width) as f32 + 0.5 - disc.x, (at / width) as f32 + 0.5 - disc.y);
            let inside = 1.0 - (dx * dx + dy * dy) / 1600.0;
            match shown(key) {
                Some((depth, particle)) => {
                    assert_eq!(particle, 7);
                    assert!((depth - (5.0 - 0.5 * inside.sqrt())).abs() < 1e-5);
                }
                // The multiplication by the inverse may round the other way on the rim.
                None => assert!(inside < 1e-6),
            }
        }
    }
}

//! Films as files: GIF, or MP4 by ffmpeg.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use fluvia_render::{GifEncoder, Image, Palette};
use fluvia_sim::frames;

use super::mp4::Mp4;

/// Frames of a film that the colours of a GIF are chosen from.
const PALETTE_FRAMES: usize = 8;

/// Which of so many frames the colours of a GIF are chosen from.
pub fn palette_frames(count: usize) -> impl ExactSizeIterator<Item = usize> {
    (0..count).step_by(count.div_ceil(PALETTE_FRAMES).max(1))
}

/// How long each picture of a film is shown, seconds: until the next; the last as long as the one before.
fn durations(numbers: &[u64], dt: f64) -> Vec<f64> {
    steps(numbers).into_iter().map(|step| step as f64 * dt).collect()
}

/// The same in frames of the simulation.
fn steps(numbers: &[u64]) -> Vec<u64> {
    let step = |k: usize| {
        let pair = &numbers[k.min(numbers.len().saturating_sub(2))..];
        pair.get(1).map_or(1, |next| next.abs_diff(pair[0]).max(1))
    };
    (0..numbers.len()).map(step).collect()
}

/// A film that is being written.
pub enum Writer {
    Gif { encoder: Box<GifEncoder>, durations: Vec<f64> },
    Mp4 { film: Mp4, repeats: Vec<u64> },
}

impl Writer {
    /// Starts a GIF of frames of these numbers; `draw` draws the k-th of them.
    pub fn gif(
        numbers: &[u64],
        dt: f64,
        interrupted: &AtomicBool,
        mut draw: impl FnMut(usize) -> Result<Image>,
    ) -> Result<Option<Writer>> {
        let mut samples = Vec::new();
        for k in palette_frames(numbers.len()) {
            if interrupted.load(Ordering::Relaxed) {
                return Ok(None);
            }
            samples.push(draw(k)?);
        }
        let size = samples.first().context("no frames to draw")?;
        let encoder = GifEncoder::new(size.width, size.height, Palette::of(&samples))?;
        Ok(Some(Writer::Gif { encoder: Box::new(encoder), durations: durations(numbers, dt) }))
    }

    /// Starts an MP4 of frames of these numbers, the first of which is `image`.
    pub fn mp4(path: &Path, numbers: &[u64], dt: f64, image: &Image) -> Result<Writer> {
        // A film has one rate: that at which every picture is shown a whole number of times.
        let steps = steps(numbers);
        let rate = steps.iter().copied().fold(0, greatest_divisor).max(1);
        let size = [image.width, image.height].map(even);
        let film = Mp4::start(path, size, rate as f64 * dt)?;
        Ok(Writer::Mp4 { film, repeats: steps.into_iter().map(|step| step / rate).collect() })
    }

    /// Adds the k-th picture.
    pub fn push(&mut self, k: usize, image: &Image) -> Result<()> {
        match self {
            Writer::Gif { encoder, durations } => encoder.push(image, durations[k])?,
            Writer::Mp4 { film, repeats } => {
                let image = padded(image);
                (0..repeats[k]).try_for_each(|_| film.push(&image))?;
            }
        }
        Ok(())
    }

    /// Writes what is not written yet; false if it was interrupted.
    pub fn finish(self, path: &Path, interrupted: &AtomicBool) -> Result<bool> {
        match self {
            Writer::Gif { encoder, .. } => {
                let bytes = encoder.finish()?;
                frames::write_atomically(path, |file| file.write_all(&bytes))?;
                Ok(true)
            }
            Writer::Mp4 { film, .. } => film.finish(interrupted),
        }
    }
}

fn greatest_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_divisor(b, a % b) }
}

/// Sides of films are even: their colours have half the resolution.
fn even(side: u32) -> u32 {
    side + side % 2
}

/// The picture with the last column and row twice where a side is odd.
fn padded(image: &Image) -> Image {
    let (width, height) = (even(image.width), even(image.height));
    let mut data = Vec::with_capacity(3 * width as usize * height as usize);
    for y in 0..height {
        let y = y.min(image.height - 1) as usize;
        let row = &image.data[3 * y * image.width as usize..3 * (y + 1) * image.width as usize];
        data.extend_from_slice(row);
        data.extend_from_slice(&row[row.len() - 3 * (width - image.width) as usize..]);
    }
    Image { width, height, data }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_shown_until_the_next() {
        assert_eq!(durations(&[0, 2, 4, 10], 0.5), [1.0, 1.0, 3.0, 3.0]);
        assert_eq!(durations(&[7], 0.5), [0.5]);
        // Backwards, and the same frame twice.
        assert_eq!(steps(&[6, 3, 3]), [3, 1, 1]);
        assert_eq!(steps(&[0, 4, 10]).into_iter().fold(0, greatest_divisor), 2);
    }

    #[test]
    fn odd_sides_become_even() {
        let image = Image { width: 1, height: 3, data: vec![1, 2, 3, 4, 5, 6, 7, 8, 9] };
        let even = padded(&image);
        assert_eq!((even.width, even.height), (2, 4));
        assert_eq!(even.data[..6], [1, 2, 3, 1, 2, 3]);
        assert_eq!(even.data[18..], [7, 8, 9, 7, 8, 9]);
        assert_eq!(padded(&even), even);
    }
}

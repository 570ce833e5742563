//! Animated GIF: frames that share a palette; each stores only what changed. Loops for ever.

use crate::image::Image;
use crate::palette::Palette;
use crate::{Error, Result};

/// Encodes a film frame by frame. Only the file so far and the last frame are kept in memory.
pub struct GifEncoder {
    encoder: gif::Encoder<Vec<u8>>,
    palette: Palette,
    width: u16,
    height: u16,
    /// Palette entries of the last frame; empty before the first.
    shown: Vec<u8>,
    /// Seconds by which the frames so far were shown too long; delays are whole hundredths.
    late: f64,
}

/// The entry that leaves a pixel as it was: beyond those of the palette.
const UNCHANGED: u8 = 255;
/// The shortest delay that viewers obey, hundredths of a second; they show shorter ones for a tenth.
const LEAST_DELAY: f64 = 2.0;

impl GifEncoder {
    /// Starts a film of images of `width` x `height` pixels.
    ///
    /// # Errors
    /// `Parameter` if a side is 0 or above 65535.
    pub fn new(width: u32, height: u32, palette: Palette) -> Result<GifEncoder> {
        let side = |what, pixels: u32| match u16::try_from(pixels) {
            Ok(side) if side > 0 => Ok(side),
            _ => Err(Error::parameter(what, pixels, "1 to 65535")),
        };
        let (width, height) = (side("film width in pixels", width)?, side("film height in pixels", height)?);
        let mut entries = palette.colors().concat();
        entries.resize(3 * 256, 0);
        let mut encoder = gif::Encoder::new(Vec::new(), width, height, &entries).map_err(fail)?;
        encoder.set_repeat(gif::Repeat::Infinite).map_err(fail)?;
        Ok(GifEncoder { encoder, palette, width, height, shown: Vec::new(), late: 0.0 })
    }

    /// Adds an image that is shown for `seconds`: rounded to hundredths without the errors adding up, and
    /// at least 0.02.
    ///
    /// # Errors
    /// `Parameter` if the image has another size than the film.
    pub fn push(&mut self, image: &Image, seconds: f64) -> Result<()> {
        if (image.width, image.height) != (self.width.into(), self.height.into()) {
            let found = format!("{} x {}", image.width, image.height);
            return Err(Error::parameter("size of a film's frame", found, "that of the film"));
        }
        let entries: Vec<u8> =
            image.data.chunks_exact(3).map(|p| self.palette.nearest([p[0], p[1], p[2]])).collect();
        let mut frame = self.changes(&entries);
        frame.delay = self.delay(seconds);
        frame.dispose = gif::DisposalMethod::Keep;
        self.encoder.write_frame(&frame).map_err(fail)?;
        self.shown = entries;
        Ok(())
    }

    /// The film as a file.
    ///
    /// # Errors
    /// `Encode` if the encoder fails.
    pub fn finish(self) -> Result<Vec<u8>> {
        self.encoder.into_inner().map_err(|error| Error::Encode { format: "GIF", message: error.to_string() })
    }

    /// The smallest rectangle that differs from the last frame; in it, what is the same is left as it was.
    fn changes(&self, entries: &[u8]) -> gif::Frame<'static> {
        let width = usize::from(self.width);
        if self.shown.is_empty() {
            return gif::Frame {
                width: self.width,
                height: self.height,
                buffer: entries.to_vec().into(),
                ..gif::Frame::default()
            };
        }
        let (mut left, mut right, mut top, mut bottom) = (usize::MAX, 0, usize::MAX, 0);
        for pixel in (0..entries.len()).filter(|&pixel| entries[pixel] != self.shown[pixel]) {
            let (x, y) = (pixel % width, pixel / width);
            (left, right) = (left.min(x), right.max(x));
            (top, bottom) = (top.min(y), bottom.max(y));
        }
        if left > right {
            // Nothing changed: one pixel that stays as it was carries the delay.
            (left, right, top, bottom) = (0, 0, 0, 0);
        }
        let changed = |pixel: usize| {
            if entries[pixel] == self.shown[pixel] { UNCHANGED } else { entries[pixel] }
        };
        let buffer: Vec<u8> =
            (top..=bottom).flat_map(|y| (left..=right).map(move |x| y * width + x)).map(changed).collect();
        gif::Frame {
            left: left as u16,
            top: top as u16,
            width: (right - left + 1) as u16,
            height: (bottom - top + 1) as u16,
            transparent: Some(UNCHANGED),
            buffer: buffer.into(),
            ..gif::Frame::default()
        }
    }

    /// Hundredths of a second for a frame of `seconds`.
    fn delay(&mut self, seconds: f64) -> u16 {
        let wanted = 100.0 * (seconds - self.late);
        let delay = wanted.round().clamp(LEAST_DELAY, f64::from(u16::MAX));
        // What is shown too long because it would be too short is not taken from later frames.
        self.late = if wanted.round() < LEAST_DELAY { 0.0 } else { (delay - wanted) / 100.0 };
        delay as u16
    }
}

fn fail(error: gif::EncodingError) -> Error {
    Error::Encode { format: "GIF", message: error.to_string() }
}

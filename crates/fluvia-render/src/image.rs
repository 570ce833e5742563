//! A picture in memory, and PNG.

use crate::color::Rgb;
use crate::{Error, Result};

/// Pixels, 8 bits a channel, sRGB, [height, width, 3], rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Red, green, blue of each pixel; 3 width height bytes.
    pub data: Vec<u8>,
}

impl Image {
    /// An image of one colour.
    pub fn filled(width: u32, height: u32, color: Rgb) -> Image {
        Image { width, height, data: color.repeat(width as usize * height as usize) }
    }

    /// The colour of the pixel in column `x` and row `y`, `None` outside the image.
    pub fn get(&self, x: u32, y: u32) -> Option<Rgb> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let at = 3 * (y as usize * self.width as usize + x as usize);
        Some([self.data[at], self.data[at + 1], self.data[at + 2]])
    }

    /// Mixes `color` into a pixel, `alpha` in 0..=1; pixels outside the image are left out.
    pub(crate) fn blend(&mut self, x: i64, y: i64, color: Rgb, alpha: f32) {
        if x < 0 || y < 0 || x >= i64::from(self.width) || y >= i64::from(self.height) {
            return;
        }
        let at = 3 * (y as usize * self.width as usize + x as usize);
        for (pixel, ink) in self.data[at..at + 3].iter_mut().zip(color) {
            let mixed = f32::from(*pixel) + alpha.clamp(0.0, 1.0) * (f32::from(ink) - f32::from(*pixel));
            *pixel = mixed.round() as u8;
        }
    }

    /// Fills a rectangle, cut off at the edges of the image.
    pub(crate) fn fill(&mut self, left: i64, top: i64, width: i64, height: i64, color: Rgb) {
        for y in top.max(0)..(top + height).min(i64::from(self.height)) {
            for x in left.max(0)..(left + width).min(i64::from(self.width)) {
                self.blend(x, y, color, 1.0);
            }
        }
    }

    /// Copies `other` into this image with its upper left corner at (`left`, `top`), cut off at the edges.
    pub(crate) fn paste(&mut self, other: &Image, left: u32, top: u32) {
        let columns = other.width.min(self.width.saturating_sub(left)) as usize;
        let rows = other.height.min(self.height.saturating_sub(top)) as usize;
        for row in 0..rows {
            let from = 3 * row * other.width as usize;
            let to = 3 * ((top as usize + row) * self.width as usize + left as usize);
            self.data[to..to + 3 * columns].copy_from_slice(&other.data[from..from + 3 * columns]);
        }
    }
}

/// Encodes an image as a PNG file.
///
/// # Errors
/// `Encode` if the image has no pixels or its data is not 3 width height bytes.
pub fn encode_png(image: &Image) -> Result<Vec<u8>> {
    let fail = |error: png::EncodingError| Error::Encode { format: "PNG", message: error.to_string() };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width, image.height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header().map_err(fail)?;
    writer.write_image_data(&image.data).map_err(fail)?;
    writer.finish().map_err(fail)?;
    Ok(bytes)
}

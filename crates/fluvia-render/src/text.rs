//! Anti-aliased text in one typeface, Aileron Regular (public domain; see `assets/README.md`).

use ab_glyph::{Font, FontRef, GlyphId, PxScale, ScaleFont, point};

use crate::color::Rgb;
use crate::image::Image;

const TYPEFACE: &[u8] = include_bytes!("../assets/Aileron-Regular.ttf");
/// Height of a lower-case x, in ems.
const X_HEIGHT: f32 = 0.53;
/// Stands for characters that the typeface lacks.
const MISSING: char = '?';

/// On which side of its anchor a text lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Left,
    Middle,
    Right,
}

/// Draws text into images.
pub(crate) struct Pen {
    font: FontRef<'static>,
}

impl Pen {
    pub fn new() -> Pen {
        Pen { font: FontRef::try_from_slice(TYPEFACE).expect("the embedded typeface is a valid font") }
    }

    /// The width of `text`, pixels. Sizes are heights of a lower-case x in whole pixels: its top and foot
    /// then fall on pixel edges and small text is sharp.
    pub fn width(&self, text: &str, x_height: u32) -> f32 {
        self.glyphs(text, x_height).1
    }

    /// Writes `text` with its baseline at `y`.
    pub fn write(
        &self,
        image: &mut Image,
        (x, y): (f32, i64),
        anchor: Anchor,
        x_height: u32,
        ink: Rgb,
        text: &str,
    ) {
        let (glyphs, width) = self.glyphs(text, x_height);
        let start = match anchor {
            Anchor::Left => x,
            Anchor::Middle => x - 0.5 * width,
            Anchor::Right => x - width,
        };
        let scale = self.scale(x_height);
        for (glyph, offset) in glyphs {
            let glyph = glyph.with_scale_and_position(scale, point(start + offset, y as f32));
            let Some(outline) = self.font.outline_glyph(glyph) else { continue };
            let corner = outline.px_bounds().min;
            outline.draw(|column, row, cover| {
                image.blend(
                    corner.x as i64 + i64::from(column),
                    corner.y as i64 + i64::from(row),
                    ink,
                    cover,
                );
            });
        }
    }

    /// The longest start of `text`, with "..." after it if it is cut, that is at most `room` pixels wide.
    pub fn fit(&self, text: &str, x_height: u32, room: f32) -> String {
        if self.width(text, x_height) <= room {
            return text.to_owned();
        }
        let mut cut = text.to_owned();
        while cut.pop().is_some() {
            let shortened = format!("{}...", cut.trim_end());
            if self.width(&shortened, x_height) <= room {
                return shortened;
            }
        }
        String::new()
    }

    /// Glyphs with their offsets from the start, and the width of all, pixels.
    fn glyphs(&self, text: &str, x_height: u32) -> (Vec<(GlyphId, f32)>, f32) {
        let scaled = self.font.as_scaled(self.scale(x_height));
        let (mut glyphs, mut width) = (Vec::new(), 0.0);
        for character in text.chars() {
            let mut glyph = self.font.glyph_id(character);
            if glyph == GlyphId(0) {
                glyph = self.font.glyph_id(MISSING);
            }
            glyphs.push((glyph, width));
            width += scaled.h_advance(glyph);
        }
        (glyphs, width)
    }

    fn scale(&self, x_height: u32) -> PxScale {
        let em = x_height as f32 / X_HEIGHT;
        let units = self.font.units_per_em().unwrap_or(1000.0);
        PxScale::from(em * self.font.height_unscaled() / units)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_sharp_at_the_baseline_and_lies_where_its_anchor_says() {
        let pen = Pen::new();
        let mut image = Image::filled(60, 30, [0; 3]);
        pen.write(&mut image, (30.0, 20), Anchor::Right, 7, [255; 3], "xx");
        let inked: Vec<(u32, u32)> = (0..30)
            .flat_map(|y| (0..60).map(move |x| (x, y)))
            .filter(|&(x, y)| image.get(x, y) != Some([0; 3]))
            .collect();
        let columns = inked.iter().map(|p| p.0);
        let rows = inked.iter().map(|p| p.1);
        // The baseline is the lower edge of row 19 and an x is 7 pixels high.
        assert_eq!((rows.clone().min(), rows.max()), (Some(13), Some(19)));
        assert!(columns.clone().max() < Some(30));
        assert!(columns.min().unwrap() as f32 >= 29.0 - pen.width("xx", 7));
    }

    #[test]
    fn long_text_is_cut_and_unknown_characters_are_replaced() {
        let pen = Pen::new();
        let cut = pen.fit("a rather long label", 7, 60.0);
        assert!(cut.starts_with("a r") && cut.ends_with("...") && pen.width(&cut, 7) <= 60.0);
        assert_eq!(pen.fit("short", 7, 60.0), "short");
        assert_eq!(pen.fit("short", 7, 1.0), "");
        assert_eq!(pen.width("水", 7), pen.width("?", 7));
    }
}

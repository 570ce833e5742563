//! Contact sheets: rows of labelled tiles with a title and a legend. A single labelled picture, and a frame
//! of a film, are sheets of one tile.

use crate::camera::Camera;
use crate::color::{OUTSIDE, PAGE, QUIET, Ramp, Rgb, Scale, TEXT, TILE, body_color};
use crate::draw::{Style, draw_frame};
use crate::frame::Frame;
use crate::image::Image;
use crate::stage::Stage;
use crate::text::{Anchor, Pen};
use crate::{Error, Result};

/// One picture of a sheet.
#[derive(Clone, Debug, Default)]
pub struct Tile<'a> {
    /// What it shows.
    pub frame: Frame<'a>,
    /// The walls of its scene; `None`: none.
    pub stage: Option<&'a Stage>,
    /// At its upper left: "frame 20". The number of particles outside or not finite is added.
    pub label: String,
    /// At its upper right, quieter: "0.40 s". Left out where there is no room.
    pub note: String,
}

/// The largest side of a sheet, pixels.
const MAX_SIDE: u32 = 32_768;

/// A sheet that is drawn tile by tile: its frames may be too many to be in memory together. All tiles share the camera and
/// the style. Films are pages of one legend, so that all their pictures have one size.
pub struct Page<'a> {
    image: Image,
    layout: Layout,
    pen: Pen,
    camera: &'a Camera,
    style: &'a Style,
    /// Of each row the upper edge of its tiles, pixels, and their number.
    rows: Vec<(u32, usize)>,
}

/// What explains the colours of a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Legend {
    /// Nothing.
    None,
    /// The scale of [`Style::scale`].
    Scale,
    /// The names of bodies, in their order: the first [`MOST_BODIES`](Legend::MOST_BODIES).
    Bodies(Vec<String>),
}

impl Legend {
    /// Bodies that a legend names.
    pub const MOST_BODIES: usize = 8;
}

impl<'a> Page<'a> {
    /// A page with rows of a label and a number of tiles, without its tiles.
    ///
    /// # Errors
    /// `Parameter` if the page is too large.
    pub fn new(
        title: &str,
        rows: &[(&str, usize)],
        legend: Legend,
        camera: &'a Camera,
        style: &'a Style,
    ) -> Result<Page<'a>> {
        let pen = Pen::new();
        let layout = Layout::new(title, rows, legend, camera, style, &pen)?;
        let mut image = Image::filled(layout.width, layout.height, PAGE);
        let (left, room) = (2.0 * layout.pad as f32, layout.width as f32 - layout.pad as f32 * 4.0);
        let mut write = |text: &str, baseline: u32, size: u32| {
            let text = pen.fit(text, size, room);
            pen.write(&mut image, (left, i64::from(baseline)), Anchor::Left, size, TEXT, &text);
        };
        write(title, layout.px(29), layout.large);
        let (mut top, mut places) = (layout.head, Vec::new());
        for &(label, tiles) in rows {
            if !label.is_empty() {
                write(label, top + layout.px(16), layout.medium);
                top += layout.strip;
            }
            places.push((top, tiles));
            top += layout.strip + camera.height() + layout.pad;
        }
        match &layout.legend {
            Legend::None => {}
            Legend::Scale => scale_legend(&mut image, &pen, &layout, &style.scale, top),
            Legend::Bodies(names) => body_legend(&mut image, &pen, &layout, names, top),
        }
        Ok(Page { image, layout, pen, camera, style, rows: places })
    }

    /// Draws the tile in a row and a column.
    ///
    /// # Errors
    /// Those of [`draw_frame`], and `Parameter` if there is no such place.
    pub fn draw(&mut self, [row, column]: [usize; 2], tile: &Tile<'_>) -> Result<()> {
        let place = self.rows.get(row).filter(|(_, tiles)| column < *tiles);
        let Some(&(top, _)) = place else {
            let found = format!("row {row}, column {column}");
            return Err(Error::parameter("place of a tile", found, "one that is on the sheet"));
        };
        let Page { image, layout, pen, camera, style, .. } = self;
        let none = Stage::default();
        let picture = draw_frame(&tile.frame, tile.stage.unwrap_or(&none), camera, style)?;
        let left = layout.pad + column as u32 * (camera.width() + layout.pad);
        let tall = i64::from(layout.strip + camera.height());
        image.fill(left.into(), top.into(), camera.width().into(), tall, TILE);
        image.paste(&picture, left, top + layout.strip);
        label_tile(image, pen, layout, tile, (left, top), camera.width());
        Ok(())
    }

    /// The page.
    pub fn finish(self) -> Image {
        self.image
    }
}

/// Sizes of everything but the tiles, pixels.
struct Layout {
    width: u32,
    height: u32,
    /// Room above the first row: the title.
    head: u32,
    pad: u32,
    /// The line above a tile, and above a row.
    strip: u32,
    /// Heights of a lower-case x in labels and legends, row labels, the title.
    small: u32,
    medium: u32,
    large: u32,
    zoom: f32,
    legend: Legend,
}

/// Tiles wider than this get larger text, in proportion, ...
const ZOOM_WIDTH: f32 = 900.0;
/// ... up to this.
const ZOOM_LIMIT: f32 = 3.0;
/// Length of the colour bar.
const BAR: u32 = 280;
/// A page without room for a bar of this length has no scale: its numbers would lie over each other.
const LEAST_BAR: u32 = 60;

impl Layout {
    fn new(
        title: &str,
        rows: &[(&str, usize)],
        mut legend: Legend,
        camera: &Camera,
        style: &Style,
        pen: &Pen,
    ) -> Result<Layout> {
        let zoom = (camera.width() as f32 / ZOOM_WIDTH).clamp(1.0, ZOOM_LIMIT);
        let px = |length: f32| (zoom * length).round() as u32;
        let (pad, strip) = (px(6.0), px(24.0));
        let head = if title.is_empty() { pad } else { px(44.0) };
        let columns = rows.iter().map(|(_, tiles)| *tiles).max().unwrap_or(0).max(1) as u64;
        let width = u64::from(pad) + columns * u64::from(camera.width() + pad);
        let row_height = |(label, _): &(&str, usize)| {
            let label = if label.is_empty() { 0 } else { strip };
            u64::from(label + strip + camera.height() + pad)
        };
        if let Legend::Bodies(names) = &mut legend {
            names.truncate(Legend::MOST_BODIES);
        }
        let mut layout = Layout {
            width: 0,
            height: 0,
            head,
            pad,
            strip,
            small: px(7.0),
            medium: px(8.0),
            large: px(10.0),
            zoom,
            legend,
        };
        if layout.legend == Legend::Scale && layout.bar(width) < px(LEAST_BAR as f32) {
            layout.legend = Legend::None;
        }
        let foot = match &layout.legend {
            Legend::None => 0,
            Legend::Scale if layout.caption_fits(pen, &style.scale, width) => px(42.0),
            Legend::Scale => px(60.0),
            Legend::Bodies(_) => px(26.0),
        };
        let height = u64::from(head) + rows.iter().map(row_height).sum::<u64>() + u64::from(foot);
        for (what, side) in [("sheet width in pixels", width), ("sheet height in pixels", height)] {
            if side > u64::from(MAX_SIDE) {
                return Err(Error::parameter(what, side, "at most 32768; take fewer or smaller tiles"));
            }
        }
        (layout.width, layout.height) = (width as u32, height as u32);
        Ok(layout)
    }

    /// A length of the layout, enlarged with the text.
    fn px(&self, length: u32) -> u32 {
        (self.zoom * length as f32).round() as u32
    }

    /// The length of the colour bar on a page of a width.
    fn bar(&self, width: u64) -> u32 {
        u64::from(self.px(BAR)).min(width.saturating_sub(8 * u64::from(self.pad))) as u32
    }

    /// Whether the scale's caption has room beside its bar.
    fn caption_fits(&self, pen: &Pen, scale: &Scale, width: u64) -> bool {
        let needed = pen.width(&scale.label, self.small) + (self.bar(width) + self.px(50)) as f32;
        needed <= width as f32
    }
}

fn label_tile(
    page: &mut Image,
    pen: &Pen,
    layout: &Layout,
    tile: &Tile<'_>,
    (left, top): (u32, u32),
    width: u32,
) {
    let inset = layout.px(8) as f32;
    let baseline = i64::from(top + layout.px(16));
    let mut label = tile.label.clone();
    let counts = [(tile.frame.outside_count(), "outside"), (tile.frame.non_finite_count(), "not finite")];
    for (count, what) in counts.into_iter().filter(|(count, _)| *count > 0) {
        let comma = if label.is_empty() { "" } else { ", " };
        label += &format!("{comma}{count} {what}");
    }
    let ink = if counts.iter().any(|(count, _)| *count > 0) { OUTSIDE } else { TEXT };
    let room = width as f32 - 2.0 * inset;
    let label = pen.fit(&label, layout.small, room);
    pen.write(page, (left as f32 + inset, baseline), Anchor::Left, layout.small, ink, &label);
    let used = pen.width(&label, layout.small) + inset;
    if used + pen.width(&tile.note, layout.small) <= room {
        let right = (left + width) as f32 - inset;
        pen.write(page, (right, baseline), Anchor::Right, layout.small, QUIET, &tile.note);
    }
}

/// Places of the numbers under the colour bar.
const TICKS: [f32; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];

fn scale_legend(page: &mut Image, pen: &Pen, layout: &Layout, scale: &Scale, top: u32) {
    let bar = layout.bar(page.width.into());
    let thick = layout.px(11);
    let left = page.width - layout.px(26) - bar;
    let beside = layout.caption_fits(pen, scale, page.width.into());
    let y = top + if beside { layout.px(4) } else { layout.px(22) };
    let ramp = Ramp::new();
    for column in 0..bar {
        let color = ramp.at(column as f32 / (bar.max(2) - 1) as f32);
        page.fill((left + column).into(), y.into(), 1, thick.into(), color);
    }
    for place in TICKS {
        let x = left as f32 + place * bar as f32;
        let baseline = i64::from(y + layout.px(25));
        pen.write(page, (x, baseline), Anchor::Middle, layout.small, QUIET, &number(scale.value(place)));
    }
    if beside {
        let place = (left as f32 - layout.px(12) as f32, i64::from(y + layout.px(10)));
        pen.write(page, place, Anchor::Right, layout.small, QUIET, &scale.label);
    } else {
        let caption = pen.fit(&scale.label, layout.small, (left + bar - layout.pad) as f32);
        let place = ((left + bar) as f32, i64::from(top + layout.px(14)));
        pen.write(page, place, Anchor::Right, layout.small, QUIET, &caption);
    }
}

fn body_legend(page: &mut Image, pen: &Pen, layout: &Layout, names: &[String], top: u32) {
    let (side, gap) = (layout.px(11) as f32, layout.px(7) as f32);
    let room = (page.width - 2 * layout.pad) as f32 - gap;
    let widths: Vec<f32> =
        names.iter().map(|name| side + 3.0 * gap + pen.width(name, layout.small)).collect();
    // The first names that fit, against the right edge.
    let (mut shown, mut used) = (0, 0.0);
    while shown < names.len() && used + widths[shown] - 2.0 * gap <= room {
        used += widths[shown];
        shown += 1;
    }
    let mut x = layout.pad as f32 + room - (used - 2.0 * gap);
    let baseline = i64::from(top + layout.px(15));
    for (body, name) in names[..shown].iter().enumerate() {
        let color: Rgb = body_color(body as u32);
        page.fill(x as i64, i64::from(top + layout.px(5)), side as i64, side as i64, color);
        let place = (x.floor() + side + gap, baseline);
        pen.write(page, place, Anchor::Left, layout.small, QUIET, name);
        x += widths[body];
    }
}

/// A number in four significant digits, without zeros at the end.
fn number(x: f32) -> String {
    let exponent = x.abs().log10().floor();
    if x == 0.0 || !x.is_finite() {
        return if x == 0.0 { "0".to_owned() } else { x.to_string() };
    }
    if !(-4.0..6.0).contains(&exponent) {
        return format!("{x:.3e}");
    }
    let decimals = (3.0 - exponent).max(0.0) as usize;
    let digits = format!("{x:.decimals$}");
    if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.').to_owned() } else { digits }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Subject, View, Walls};

    #[test]
    fn numbers_have_four_digits_and_no_idle_zeros() {
        let cases = [
            (0.0, "0"),
            (2.25, "2.25"),
            (1.125, "1.125"),
            (4.0, "4"),
            (0.0625, "0.0625"),
            (1.0 / 3.0, "0.3333"),
            (-12.5, "-12.5"),
            (1234.0, "1234"),
            (1e-7, "1.000e-7"),
            (2.5e9, "2.500e9"),
        ];
        for (value, expected) in cases {
            assert_eq!(number(value), expected);
        }
    }

    fn camera(width: u32) -> Camera {
        let mut subject = Subject::new(Walls::default(), 0.025);
        subject.add(&[[0.0; 3], [0.4, 0.2, 0.0]]);
        Camera::fit(&subject, &View { width, ..View::default() }).unwrap()
    }

    #[test]
    fn tiles_are_drawn_in_any_order_at_the_places_that_there_are() {
        let (camera, style) = (camera(60), Style::default());
        let position = [[[0.0; 3]], [[0.2, 0.1, 0.0]], [[0.4, 0.2, 0.0]]];
        let tile = |k: usize| {
            let frame = Frame { position: &position[k], ..Frame::default() };
            Tile { frame, label: format!("frame {k}"), ..Tile::default() }
        };
        let draw = |order: [usize; 3]| {
            let rows = [("", 2), ("other", 1)];
            let mut page = Page::new("Title", &rows, Legend::None, &camera, &style).unwrap();
            for k in order {
                page.draw([[0, 0], [0, 1], [1, 0]][k], &tile(k)).unwrap();
            }
            for place in [[0, 2], [1, 1], [2, 0]] {
                assert!(matches!(page.draw(place, &tile(0)), Err(Error::Parameter { .. })), "{place:?}");
            }
            page.finish()
        };
        assert!(draw([2, 1, 0]) == draw([0, 1, 2]));
    }

    #[test]
    fn legends_are_there_where_they_have_room() {
        let style = Style::default();
        let bodies = |count: usize| Legend::Bodies((0..count).map(|body| format!("body {body}")).collect());
        for width in [1, 2, 10, 40, 100, 300] {
            let camera = camera(width);
            let page = |legend| Page::new("", &[("", 1)], legend, &camera, &style).unwrap().finish();
            let [none, scale, names] = [Legend::None, Legend::Scale, bodies(3)].map(page);
            assert_eq!(scale.height > none.height, width >= 100, "{width}");
            assert!(names.height > none.height);
            assert!(page(bodies(9)) == page(bodies(8)));
        }
    }
}

//! The colours of a GIF: one palette for all its frames, so that what does not change does not flicker.
//!
//! Colours are counted in cells of 4 levels a channel. The few that fill most of the picture are kept exactly;
//! the others are split at the mean of their widest direction in Oklab and then moved to the means of their
//! parts (Lloyd's algorithm). Weights are square roots of counts: rare colours, as the orange of lost
//! particles, keep entries of their own.

use rayon::prelude::*;

use crate::color::{Rgb, oklab_to_srgb, srgb_to_oklab};
use crate::image::Image;

/// Bits a channel that tell cells apart.
const CELL_BITS: u32 = 6;
const CELLS: usize = 1 << (3 * CELL_BITS);
/// Entries of a palette; one of a GIF's 256 stands for "unchanged".
const ENTRIES: usize = 255;
/// A colour that fills at least one pixel in this many is kept exactly.
const COMMON: u64 = 200;
/// Rounds of Lloyd's algorithm: later ones change little.
const ROUNDS: usize = 8;

/// At most 255 colours, and which of them is nearest to any other colour.
#[derive(Clone, Debug)]
pub struct Palette {
    colors: Vec<Rgb>,
    /// The entry for each cell.
    nearest: Vec<u8>,
}

/// Collects the colours of images that shall share a [`Palette`].
#[derive(Clone, Debug)]
pub struct PaletteBuilder {
    cells: Vec<Cell>,
    pixels: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    count: u64,
    sum: [u64; 3],
    /// The colour that most pixels of the cell have, if one has the majority (Boyer & Moore).
    candidate: Rgb,
    lead: u64,
}

impl Palette {
    /// The palette of some images; a handful of a film's frames, from its start to its end, is enough.
    pub fn of<'a>(images: impl IntoIterator<Item = &'a Image>) -> Palette {
        let mut builder = PaletteBuilder::new();
        images.into_iter().for_each(|image| builder.add(image));
        builder.build()
    }

    /// The colours.
    pub fn colors(&self) -> &[Rgb] {
        &self.colors
    }

    /// The entry nearest to `color`.
    pub fn nearest(&self, color: Rgb) -> u8 {
        self.nearest[cell_of(color)]
    }
}

impl Default for PaletteBuilder {
    fn default() -> PaletteBuilder {
        PaletteBuilder::new()
    }
}

impl PaletteBuilder {
    /// Without colours.
    pub fn new() -> PaletteBuilder {
        PaletteBuilder { cells: vec![Cell::default(); CELLS], pixels: 0 }
    }

    /// Counts the colours of an image.
    pub fn add(&mut self, image: &Image) {
        for pixel in image.data.chunks_exact(3) {
            let color = [pixel[0], pixel[1], pixel[2]];
            let cell = &mut self.cells[cell_of(color)];
            cell.count += 1;
            for (sum, channel) in cell.sum.iter_mut().zip(color) {
                *sum += u64::from(channel);
            }
            if cell.lead == 0 {
                cell.candidate = color;
            }
            cell.lead = if cell.candidate == color { cell.lead + 1 } else { cell.lead - 1 };
        }
        self.pixels += (image.data.len() / 3) as u64;
    }

    /// The palette of the images added so far; black alone if there are none.
    pub fn build(&self) -> Palette {
        let common = |cell: &Cell| cell.lead > 0 && cell.lead * COMMON >= self.pixels;
        let mut colors: Vec<Rgb> = self.cells.iter().filter(|c| common(c)).map(|c| c.candidate).collect();
        colors.truncate(ENTRIES / 2);
        let mut samples: Vec<Sample> =
            self.cells.iter().filter(|cell| cell.count > 0 && !common(cell)).map(Sample::of).collect();
        let means = cluster(&mut samples, ENTRIES - colors.len());
        colors.extend(means.into_iter().map(oklab_to_srgb));
        if colors.is_empty() {
            colors.push([0; 3]);
        }
        let entries: Vec<[f32; 3]> = colors.iter().map(|&color| srgb_to_oklab(color)).collect();
        let entry = |(index, cell): (usize, &Cell)| {
            let color = if common(cell) { cell.candidate } else { cell.mean().unwrap_or(middle_of(index)) };
            nearest(&entries, srgb_to_oklab(color)) as u8
        };
        let nearest = self.cells.par_iter().enumerate().map(entry).collect();
        Palette { colors, nearest }
    }
}

impl Cell {
    fn mean(&self) -> Option<Rgb> {
        let mean = |sum: u64| ((sum + self.count / 2) / self.count) as u8;
        (self.count > 0).then(|| self.sum.map(mean))
    }
}

#[derive(Clone, Copy)]
struct Sample {
    lab: [f32; 3],
    weight: f32,
}

impl Sample {
    fn of(cell: &Cell) -> Sample {
        Sample { lab: srgb_to_oklab(cell.mean().unwrap_or_default()), weight: (cell.count as f32).sqrt() }
    }
}

/// The means of at most `count` parts of `samples`, which are reordered.
fn cluster(samples: &mut [Sample], count: usize) -> Vec<[f32; 3]> {
    if samples.is_empty() || count == 0 {
        return Vec::new();
    }
    let mut parts = vec![Part::of(samples, 0..samples.len())];
    while parts.len() < count {
        let widest = (0..parts.len()).max_by(|&a, &b| parts[a].spread.total_cmp(&parts[b].spread));
        let Some(widest) = widest.filter(|&part| parts[part].spread > 0.0) else { break };
        let Part { range, axis, mean, .. } = parts.swap_remove(widest);
        let part = &mut samples[range.clone()];
        part.sort_by(|a, b| a.lab[axis].total_cmp(&b.lab[axis]));
        let below = part.partition_point(|sample| sample.lab[axis] < mean[axis]);
        // Rounding may put the mean on an end: both sides get at least one sample.
        let middle = range.start + below.clamp(1, range.len() - 1);
        parts.push(Part::of(samples, range.start..middle));
        parts.push(Part::of(samples, middle..range.end));
    }
    let mut means: Vec<[f32; 3]> = parts.iter().map(|part| part.mean).collect();
    for _ in 0..ROUNDS {
        let owners: Vec<usize> = samples.par_iter().map(|sample| nearest(&means, sample.lab)).collect();
        let mut sums = vec![([0.0f64; 3], 0.0f64); means.len()];
        for (sample, owner) in samples.iter().zip(owners) {
            let (sum, weight) = &mut sums[owner];
            (0..3).for_each(|k| sum[k] += f64::from(sample.weight * sample.lab[k]));
            *weight += f64::from(sample.weight);
        }
        for (mean, (sum, weight)) in means.iter_mut().zip(sums).filter(|(_, (_, weight))| *weight > 0.0) {
            *mean = sum.map(|x| (x / weight) as f32);
        }
    }
    means
}

/// Samples that share an entry.
struct Part {
    range: std::ops::Range<usize>,
    mean: [f32; 3],
    /// The direction in which they differ most, and how much: the sum of squares, 0 for a single sample.
    axis: usize,
    spread: f64,
}

impl Part {
    fn of(samples: &[Sample], range: std::ops::Range<usize>) -> Part {
        let part = &samples[range.clone()];
        let weight: f64 = part.iter().map(|s| f64::from(s.weight)).sum();
        let moment = |k: usize, power: i32| -> f64 {
            part.iter().map(|s| f64::from(s.weight) * f64::from(s.lab[k]).powi(power)).sum::<f64>() / weight
        };
        let mean = [0, 1, 2].map(|k| moment(k, 1));
        let spread = [0, 1, 2].map(|k| weight * (moment(k, 2) - mean[k] * mean[k]));
        let axis = (1..3).fold(0, |best, k| if spread[k] > spread[best] { k } else { best });
        let spread = if part.len() > 1 { spread[axis] } else { 0.0 };
        Part { range, mean: mean.map(|x| x as f32), axis, spread }
    }
}

fn nearest(entries: &[[f32; 3]], lab: [f32; 3]) -> usize {
    let mut best = (f32::INFINITY, 0);
    for (index, entry) in entries.iter().enumerate() {
        let squared: f32 = (0..3).map(|k| (entry[k] - lab[k]).powi(2)).sum();
        if squared < best.0 {
            best = (squared, index);
        }
    }
    best.1
}

fn cell_of(color: Rgb) -> usize {
    color.iter().fold(0, |cell, &channel| cell << CELL_BITS | usize::from(channel >> (8 - CELL_BITS)))
}

fn middle_of(cell: usize) -> Rgb {
    [2, 1, 0].map(|channel| {
        let level = cell >> (channel * CELL_BITS) & ((1 << CELL_BITS) - 1);
        (level << (8 - CELL_BITS) | 1 << (7 - CELL_BITS)) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_background_is_exact_and_a_rare_colour_keeps_an_entry() {
        let mut image = Image::filled(200, 100, [24, 29, 37]);
        for i in 0..5000u32 {
            // Many greens and blues.
            let color = [20, (i % 100 + 100) as u8, (i / 50 + 50) as u8];
            image.blend(i64::from(i % 100), i64::from(i / 100), color, 1.0);
        }
        image.blend(150, 90, [255, 110, 25], 1.0);
        let palette = Palette::of([&image]);
        assert!(palette.colors().len() <= 255);
        assert_eq!(palette.colors()[usize::from(palette.nearest([24, 29, 37]))], [24, 29, 37]);
        let orange = palette.colors()[usize::from(palette.nearest([255, 110, 25]))];
        // Oklab there and back rounds to a level or so.
        assert!((0..3).all(|k| orange[k].abs_diff([255, 110, 25][k]) <= 2), "{orange:?}");
    }

    #[test]
    fn no_image_gives_a_palette_too() {
        let palette = Palette::of([]);
        assert_eq!(palette.colors(), [[0; 3]]);
        assert_eq!(palette.nearest([255; 3]), 0);
    }
}

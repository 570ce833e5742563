//! One picture: particles as shaded spheres, walls as faint points.
//!
//! A pixel of a sphere with surface normal n shows its colour times
//! (1 - gap) (a + b max(0, L·n)) (c + d max(0, L·m)), and a small highlight. L points to the lamp; m is the
//! normal of the blurred depth, so that the liquid's surface as a whole catches light; gap is how far the
//! pixel lies behind the blurred depth, so that it is dark between the particles.

use rayon::prelude::*;

use crate::camera::Camera;
use crate::color::{NO_VALUE, OUTSIDE, Ramp, Rgb, Scale, TILE, WALL, body_color};
use crate::image::Image;
use crate::splat::{DepthBuffer, Disc, blur};
use crate::{Error, Result};

/// The particles of one moment.
#[derive(Clone, Copy, Debug, Default)]
pub struct Frame<'a> {
    /// Positions, metres. Those that are not finite are not drawn.
    pub position: &'a [[f32; 3]],
    /// What gives the particles their colours.
    pub values: Values<'a>,
    /// Which particles are marked in orange (see [`OutsideTest`](crate::OutsideTest)); empty: none.
    pub outside: &'a [bool],
}

/// What gives the particles their colours: nothing, or one entry a particle.
#[derive(Clone, Copy, Debug, Default)]
pub enum Values<'a> {
    /// All are the same grey.
    #[default]
    None,
    /// Numbers, coloured by [`Style::scale`]; those that are not finite are grey.
    Scalar(&'a [f32]),
    /// Indices of bodies, coloured by [`BODY_COLORS`](crate::BODY_COLORS).
    Body(&'a [u32]),
    /// The colours themselves.
    Color(&'a [Rgb]),
}

/// The wall particles.
#[derive(Clone, Copy, Debug, Default)]
pub struct Walls<'a> {
    /// Positions, metres.
    pub position: &'a [[f32; 3]],
    /// Unit normals that point into the fluid: walls seen from behind are not drawn. Empty: all are drawn.
    pub normal: &'a [[f32; 3]],
}

/// How things look.
#[derive(Clone, Debug, PartialEq)]
pub struct Style {
    /// Radius of a particle, metres.
    pub radius: f32,
    /// How [`Values::Scalar`] become colours.
    pub scale: Scale,
    /// What the legend calls the bodies of [`Values::Body`]; "body 0", ... for those beyond its end.
    pub bodies: Vec<String>,
    /// Pixels a side that one pixel of the picture averages, 1 to 4.
    pub supersample: u32,
}

impl Default for Style {
    fn default() -> Style {
        Style { radius: 0.025, scale: Scale::speed(4.0), bodies: Vec::new(), supersample: 3 }
    }
}

impl Frame<'_> {
    /// The number of particles that are drawn in orange.
    pub fn outside_count(&self) -> usize {
        self.outside.iter().zip(self.position).filter(|(outside, p)| **outside && finite(p)).count()
    }

    /// The number of particles that have no place in the picture because their position is not finite.
    pub fn non_finite_count(&self) -> usize {
        self.position.iter().filter(|p| !finite(p)).count()
    }

    fn check(&self) -> Result<()> {
        let entries = match self.values {
            Values::None => self.position.len(),
            Values::Scalar(values) => values.len(),
            Values::Body(bodies) => bodies.len(),
            Values::Color(colors) => colors.len(),
        };
        let marks = if self.outside.is_empty() { self.position.len() } else { self.outside.len() };
        check_length("values of a frame", entries, self.position.len())?;
        check_length("outside marks of a frame", marks, self.position.len())
    }

    fn color(&self, particle: usize, style: &Style, ramp: &Ramp) -> Rgb {
        if self.outside.get(particle) == Some(&true) {
            return OUTSIDE;
        }
        match self.values {
            Values::None => NO_VALUE,
            Values::Scalar(values) => style.scale.place(values[particle]).map_or(NO_VALUE, |t| ramp.at(t)),
            Values::Body(bodies) => body_color(bodies[particle]),
            Values::Color(colors) => colors[particle],
        }
    }
}

/// The largest picture, in samples: it takes about 9 bytes for each while it is drawn.
const MAX_SAMPLES: u64 = 1 << 27;

/// Draws the particles and walls as `camera` sees them. Particles that are not finite, behind the camera or
/// at it are left out.
///
/// # Errors
/// `Length` if a slice does not match the particles, `Parameter` if the style is out of range or the picture
/// too large.
pub fn draw_frame(frame: &Frame<'_>, walls: Walls<'_>, camera: &Camera, style: &Style) -> Result<Image> {
    frame.check()?;
    let normals = if walls.normal.is_empty() { walls.position.len() } else { walls.normal.len() };
    check_length("wall normals", normals, walls.position.len())?;
    check_style(style, camera)?;
    let samples = style.supersample as usize;
    let discs = discs(frame, camera, style);
    let (width, height) = (camera.width() as usize * samples, camera.height() as usize * samples);
    let depth = DepthBuffer::draw(&discs, style.radius, width, height);
    // At the resolution of the picture, as a blurred surface has no finer detail. Its radius and the depth of
    // the background depend on the camera alone: light must not jump from frame to frame of a film.
    let radius = BLUR * camera.focal() * style.radius / camera.middle();
    let sharp = depth.reduced(samples, camera.far());
    let smooth = blur(&sharp, width / samples, height / samples, radius.round().max(1.0) as usize);
    let dots = wall_dots(walls, &depth, camera, style);
    let mut seen = vec![[0.0; 3]; frame.position.len()];
    for disc in &discs {
        seen[disc.particle as usize] = [disc.x, disc.y, disc.reach];
    }
    let ramp = Ramp::new();
    let color: Vec<Rgb> = (0..frame.position.len()).map(|i| frame.color(i, style, &ramp)).collect();
    let (focal, radius) = (camera.focal(), style.radius);
    let scene = Scene { depth, smooth, dots, seen, color, focal, radius };
    Ok(scene.shade(samples))
}

/// Width of the blur that makes the broad surface, in particle radii.
const BLUR: f32 = 1.2;
/// The direction to the lamp, a unit vector: right, up, to the viewer.
const LIGHT: [f32; 3] = [-0.48, 0.72, 0.5];
/// Light on each sphere: in its shadow, and what the lamp adds.
const SPHERE_LIGHT: [f32; 2] = [0.42, 0.72];
/// Light on the broad surface: in its shadow, and what the lamp adds.
const BROAD_LIGHT: [f32; 2] = [0.73, 0.40];
/// Strength of the highlight, 8-bit levels.
const HIGHLIGHT: f32 = 60.0;
/// Gaps as deep as this many radii would be black, were it not for the limit.
const GAP_DEPTH: f32 = 8.0;
/// The largest part of the light that a gap takes.
const GAP_LIMIT: f32 = 0.5;

/// Everything that the colour of a pixel depends on. A pixel averages several samples, the pixels of `depth`.
struct Scene {
    depth: DepthBuffer,
    /// The blurred depth of each pixel of the picture, metres.
    smooth: Vec<f32>,
    /// How much of each sample wall points cover, 0..=255.
    dots: Vec<u8>,
    /// x, y and radius of each particle's disc, samples.
    seen: Vec<[f32; 3]>,
    color: Vec<Rgb>,
    focal: f32,
    radius: f32,
}

impl Scene {
    /// Shades all samples and averages `samples` x `samples` of them into a pixel.
    fn shade(&self, samples: usize) -> Image {
        let (width, height) = (self.depth.width / samples, self.depth.height / samples);
        let mut data = vec![0; 3 * width * height];
        data.par_chunks_mut(3 * width).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.chunks_exact_mut(3).enumerate() {
                let surface = self.surface(x, y, width, height);
                let mut sum = [0.0; 3];
                for sample in 0..samples * samples {
                    let at = [samples * x + sample % samples, samples * y + sample / samples];
                    for (sum, channel) in sum.iter_mut().zip(self.sample(at, &surface)) {
                        *sum += channel.clamp(0.0, 255.0);
                    }
                }
                for (out, sum) in pixel.iter_mut().zip(sum) {
                    *out = (sum / (samples * samples) as f32).round() as u8;
                }
            }
        });
        Image { width: width as u32, height: height as u32, data }
    }

    fn sample(&self, [x, y]: [usize; 2], surface: &Surface) -> [f32; 3] {
        let at = y * self.depth.width + x;
        let color = match self.depth.at(at) {
            Some((particle, depth)) => self.sphere([x, y], particle as usize, depth, surface),
            None => TILE.map(f32::from),
        };
        let cover = f32::from(self.dots[at]) / 255.0;
        std::array::from_fn(|k| color[k] + cover * (f32::from(WALL[k]) - color[k]))
    }

    fn sphere(&self, [x, y]: [usize; 2], particle: usize, depth: f32, surface: &Surface) -> [f32; 3] {
        let [centre_x, centre_y, reach] = self.seen[particle];
        let right = (x as f32 + 0.5 - centre_x) / reach;
        let up = (centre_y - y as f32 - 0.5) / reach;
        let front = (1.0 - right * right - up * up).max(0.0).sqrt();
        let lit = (LIGHT[0] * right + LIGHT[1] * up + LIGHT[2] * front).clamp(0.0, 1.0);

        // Metres by which the surface recedes per metre to the right and down.
        let [slope_x, slope_y] = surface.slope.map(|slope| slope * self.focal / depth);
        let broad = (LIGHT[0] * slope_x - LIGHT[1] * slope_y + LIGHT[2])
            / (1.0 + slope_x * slope_x + slope_y * slope_y).sqrt();
        let gap = ((depth - surface.depth) / (GAP_DEPTH * self.radius)).clamp(0.0, GAP_LIMIT);

        let light = (1.0 - gap)
            * (SPHERE_LIGHT[0] + SPHERE_LIGHT[1] * lit)
            * (BROAD_LIGHT[0] + BROAD_LIGHT[1] * broad.clamp(0.0, 1.0));
        let highlight = HIGHLIGHT * lit.powi(24);
        self.color[particle].map(|channel| light * f32::from(channel) + highlight)
    }

    /// The blurred surface at a pixel of the picture.
    fn surface(&self, x: usize, y: usize, width: usize, height: usize) -> Surface {
        let [left, right] = [x.saturating_sub(1), (x + 1).min(width - 1)];
        let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)];
        let across = self.smooth[y * width + right] - self.smooth[y * width + left];
        let down = self.smooth[below * width + x] - self.smooth[above * width + x];
        let slope = [across / (right - left).max(1) as f32, down / (below - above).max(1) as f32];
        Surface { depth: self.smooth[y * width + x], slope }
    }
}

/// The blurred surface at a pixel: its depth, metres, and by how much it recedes per pixel to the right and down.
struct Surface {
    depth: f32,
    slope: [f32; 2],
}

/// The least radius of a disc, supersampled pixels: a square's half diagonal, so that the smallest particle
/// still covers the centre of a pixel.
const LEAST_REACH: f32 = 0.75;

fn discs(frame: &Frame<'_>, camera: &Camera, style: &Style) -> Vec<Disc> {
    let samples = style.supersample as f32;
    let disc = |(particle, &point): (usize, &[f32; 3])| {
        let [x, y, depth] = camera.project(point)?;
        let reach = (samples * camera.focal() * style.radius / depth).max(LEAST_REACH);
        Some(Disc { x: samples * x, y: samples * y, depth, reach, particle: particle as u32 })
    };
    let mut discs: Vec<Disc> = frame.position.par_iter().enumerate().filter_map(disc).collect();
    // From front to back, for speed alone.
    discs.par_sort_unstable_by(|a, b| a.depth.total_cmp(&b.depth).then(a.particle.cmp(&b.particle)));
    discs
}

/// What a wall point covers of a pixel: in shadow, and what the lamp adds. Points that lie close add up.
const DOT_COVER: [f32; 2] = [0.22, 0.10];
/// The most that wall points cover of a pixel.
const DOT_LIMIT: f32 = 0.7;
/// The side of a wall point in particle radii, ...
const DOT_SIDE: f32 = 0.32;
/// ... and at least and at most in pixels of the picture.
const DOT_SIDE_PIXELS: [f32; 2] = [0.67, 3.0];
/// A particle radius, in pixels of the picture, below which wall points (about as far apart) run together:
/// each covers less then, so that walls stay faint.
const DOT_SPACING_PIXELS: f32 = 1.6;

/// How much of each pixel is covered by wall points that face the camera and lie before the particles.
fn wall_dots(walls: Walls<'_>, depth: &DepthBuffer, camera: &Camera, style: &Style) -> Vec<u8> {
    let samples = style.supersample as f32;
    let mut dots = vec![0u8; depth.width * depth.height];
    let limit = (255.0 * DOT_LIMIT) as u8;
    let eye = camera.eye();
    for (i, &point) in walls.position.iter().enumerate() {
        let cover = match walls.normal.get(i) {
            Some(n) if (0..3).map(|k| (eye[k] - point[k]) * n[k]).sum::<f32>() > 0.0 => {
                let lit = camera.turn(*n).iter().zip(LIGHT).map(|(n, light)| n * light).sum::<f32>();
                DOT_COVER[0] + DOT_COVER[1] * lit.clamp(0.0, 1.0)
            }
            Some(_) => continue,
            None => DOT_COVER[0],
        };
        let Some([x, y, far]) = camera.project(point).filter(|_| !camera.cuts_away(point)) else { continue };
        let reach = camera.focal() * style.radius / far;
        let thin = (reach / DOT_SPACING_PIXELS).powi(2).min(1.0);
        let side = (DOT_SIDE * reach).clamp(DOT_SIDE_PIXELS[0], DOT_SIDE_PIXELS[1]);
        let side = (samples * side).round().max(1.0) as usize;
        let corner = |centre: f32| (samples * centre - 0.5 * side as f32).round();
        let (left, top) = (corner(x), corner(y));
        if left < 0.0 || top < 0.0 || left >= depth.width as f32 || top >= depth.height as f32 {
            continue;
        }
        for row in (top as usize)..(top as usize + side).min(depth.height) {
            for column in (left as usize)..(left as usize + side).min(depth.width) {
                let pixel = row * depth.width + column;
                if depth.at(pixel).is_none_or(|(_, near)| far < near) {
                    dots[pixel] = dots[pixel].saturating_add((255.0 * cover * thin).ceil() as u8).min(limit);
                }
            }
        }
    }
    dots
}

fn finite(point: &[f32; 3]) -> bool {
    point.iter().all(|x| x.is_finite())
}

fn check_length(what: &'static str, found: usize, expected: usize) -> Result<()> {
    if found == expected { Ok(()) } else { Err(Error::Length { what, found, expected }) }
}

fn check_style(style: &Style, camera: &Camera) -> Result<()> {
    if !(style.radius > 0.0 && style.radius.is_finite()) {
        return Err(Error::parameter("particle radius in metres", style.radius, "a positive number"));
    }
    if !(1..=4).contains(&style.supersample) {
        return Err(Error::parameter("supersampling", style.supersample, "1 to 4"));
    }
    let pixels = u64::from(camera.width()) * u64::from(camera.height());
    if pixels * u64::from(style.supersample).pow(2) > MAX_SAMPLES {
        let size = format!("{} x {}", camera.width(), camera.height());
        return Err(Error::parameter("picture size in pixels", size, "less, or less supersampling"));
    }
    Ok(())
}

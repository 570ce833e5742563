//! What each sample of a band of rows shows: the liquid and the nearest wall; or the nearest wall behind the liquid.

use rayon::prelude::*;

use crate::camera::Camera;
use crate::frame::Surface;
use crate::raster::{self, BAND, Triangle};
use crate::splat::{Disc, NOTHING, key, shown};
use crate::stage::Stage;
use crate::vector::{Vec3, dot, sub};

/// All shapes as the camera sees them, at a number of samples a pixel's side.
pub(crate) struct Shapes {
    pub samples: usize,
    /// Of the image, in samples.
    pub width: usize,
    pub height: usize,
    /// Rows of samples in a band: whole rows of pixels.
    pub band: usize,
    radius: f32,
    discs: Binned<Disc>,
    surface: Mesh,
    walls: Mesh,
    dots: Binned<Dot>,
    /// Walls are cut away above this height.
    top: f32,
    /// The first triangle of the stage that is a piece behind cells, and how much farther than it is it counts, metres.
    back: (u32, f32),
    /// How far before the liquid a wall is at least that hides it, metres.
    pub before: f32,
}

/// Shapes and the bands that they touch.
struct Binned<T> {
    shapes: Vec<T>,
    starts: Vec<usize>,
    order: Vec<u32>,
}

impl<T: Sync> Binned<T> {
    fn new(shapes: Vec<T>, size: Size, rows: impl Fn(&T) -> [i64; 2]) -> Binned<T> {
        let (starts, order) = raster::bands(&shapes, size.height, size.band, rows);
        Binned { shapes, starts, order }
    }

    fn of_band(&self, band: usize) -> impl Iterator<Item = &T> {
        self.order[self.starts[band]..self.starts[band + 1]].iter().map(|&k| &self.shapes[k as usize])
    }
}

/// Of the image: samples a pixel's side, rows of samples, rows in a band.
#[derive(Clone, Copy)]
struct Size {
    samples: usize,
    height: usize,
    band: usize,
}

/// A projected mesh: of each vertex the place, the inverse depth, and its height times that.
struct Mesh {
    vertices: Vec<Vertex>,
    triangles: Binned<Face>,
}

#[derive(Clone, Copy, Default)]
struct Vertex {
    place: [f32; 2],
    inverse: f32,
    height: f32,
}

struct Face {
    triangle: Triangle,
    corners: [u32; 3],
    index: u32,
    /// Whether it reaches above the top.
    cut: bool,
}

/// A wall point without a normal: a square.
struct Dot {
    left: i64,
    top: i64,
    side: i64,
    depth: f32,
}

/// The least cosine between the normal of a round wall and the way to the eye from which on the pieces behind its cells
/// are drawn: at the outline of the wall they would stick out.
const BACK_TURN: f32 = 0.08;

/// How much farther than they are the pieces behind cells count, in particle radii: at outer edges they stick out, which the
/// wall on the other side hides.
pub(crate) const BACK_FARTHER: f32 = 1.0;

/// How far before the liquid a wall is at least that hides it, in particle radii: liquid may be drawn out to the walls that it
/// rests at, and rounding would decide which of the two is nearer.
const BEFORE: f32 = 0.1;

/// Which particles are drawn as spheres.
pub(crate) type Spheres<'a> = &'a [(u32, Vec3)];

impl Shapes {
    /// Projects what is to be drawn. Particles have the indices that they are given; triangles of the surface follow
    /// from [`SURFACE`] on.
    pub fn new(
        spheres: Spheres<'_>,
        surface: Option<&Surface<'_>>,
        stage: &Stage,
        camera: &Camera,
        radius: f32,
        samples: usize,
    ) -> Shapes {
        let (width, height) = (camera.width() as usize * samples, camera.height() as usize * samples);
        let size = Size { samples, height, band: BAND / samples * samples };
        let discs = Binned::new(discs(spheres, camera, radius, samples as f32), size, Disc::rows);
        let top = camera.top();
        let liquid = match surface {
            Some(surface) => {
                let all = surface.triangles.iter().copied().zip(0..);
                Mesh::new(surface.position.iter(), all, camera, size, f32::INFINITY)
            }
            None => Mesh::new([].iter(), std::iter::empty(), camera, size, top),
        };
        let eye = camera.eye();
        let faces = stage.triangles.iter().copied().zip(0..).filter(|(_, index): &(_, u32)| {
            let cell = stage.cell[*index as usize] as usize;
            let way = sub(eye, stage.position[cell]);
            let least = if *index as usize >= stage.first_back { BACK_TURN } else { 0.0 };
            dot(way, stage.normal[cell]) > least * dot(way, way).sqrt()
        });
        let walls = Mesh::new(stage.vertices.iter().map(|(p, _)| p), faces, camera, size, top);
        let dots = dots(stage, camera, radius, samples as f32);
        let dots = Binned::new(dots, size, |dot| [dot.top, dot.top + dot.side - 1]);
        let (band, before) = (size.band, BEFORE * radius);
        let back = (stage.first_back as u32, BACK_FARTHER * radius);
        Shapes {
            samples,
            width,
            height,
            band,
            radius,
            discs,
            surface: liquid,
            walls,
            dots,
            top,
            back,
            before,
        }
    }

    /// The rows of a band: fewer at the end of the image.
    fn rows(&self, band: usize) -> usize {
        self.band.min(self.height - band * self.band)
    }

    /// Calls `draw` with each sample of a band that a wall covers, the depth there and the triangle of the stage.
    fn fill_walls(&self, band: usize, mut draw: impl FnMut(usize, f32, u32)) {
        let (first_back, farther) = self.back;
        self.walls.fill(self, band, self.rows(band), |at, face, depth| {
            let depth = if face.index < first_back { depth } else { depth + farther };
            draw(at, depth, face.index);
        });
    }
}

impl Mesh {
    fn new<'a>(
        positions: impl Iterator<Item = &'a Vec3>,
        triangles: impl Iterator<Item = ([u32; 3], u32)>,
        camera: &Camera,
        size: Size,
        top: f32,
    ) -> Mesh {
        let up = camera.up();
        let positions: Vec<&Vec3> = positions.collect();
        let place = |p: &&Vec3| match camera.project(**p) {
            Some([x, y, depth]) => {
                let place = [x, y].map(|x| size.samples as f32 * x);
                Vertex { place, inverse: 1.0 / depth, height: dot(**p, up) / depth }
            }
            // Behind the camera: what it belongs to is left out.
            None => Vertex { place: [f32::INFINITY; 2], ..Vertex::default() },
        };
        let vertices: Vec<Vertex> = positions.par_iter().map(place).collect();
        let face = |(corners, index): ([u32; 3], u32)| {
            let heights = corners.map(|v| dot(*positions[v as usize], up));
            let triangle = Triangle::new(corners.map(|v| vertices[v as usize].place))?;
            let below = heights.iter().filter(|&&height| height <= top).count();
            (below > 0).then_some(Face { triangle, corners, index, cut: below < 3 })
        };
        let faces = triangles.filter_map(face).collect();
        let triangles = Binned::new(faces, size, |face| face.triangle.rows());
        Mesh { vertices, triangles }
    }

    /// Calls `draw` with each sample of a band that a triangle covers, the triangle and the depth there.
    fn fill(&self, shapes: &Shapes, band: usize, rows: usize, mut draw: impl FnMut(usize, &Face, f32)) {
        for face in self.triangles.of_band(band) {
            let [a, b, c] = face.corners.map(|v| self.vertices[v as usize]);
            face.triangle.fill(shapes.width, band * shapes.band, rows, |at, second, third| {
                let between = |a: f32, b: f32, c: f32| a + second * (b - a) + third * (c - a);
                let depth = 1.0 / between(a.inverse, b.inverse, c.inverse);
                if face.cut && between(a.height, b.height, c.height) * depth > shapes.top {
                    return;
                }
                draw(at, face, depth);
            });
        }
    }
}

/// What the samples of a band show, as keys of depth and index.
pub(crate) struct Layers {
    /// Particles and triangles of the surface: those that are not particles count from [`SURFACE`] on.
    pub liquid: Vec<u64>,
    /// How much of the view's ray is inside the surface, metres; empty without one.
    pub thickness: Vec<f32>,
    /// The nearest wall, a triangle of the stage.
    pub wall: Vec<u64>,
    /// How much dots cover, 0 to 1; empty without them.
    pub dots: Vec<f32>,
}

/// The index of the first triangle of a surface; those of particles are below.
pub(crate) const SURFACE: u32 = 1 << 31;

impl Layers {
    /// Draws a band of rows.
    pub fn draw(shapes: &Shapes, band: usize) -> Layers {
        let rows = shapes.rows(band);
        let (liquid, thickness) = draw_liquid(shapes, band);
        let mut wall = vec![NOTHING; liquid.len()];
        shapes.fill_walls(band, |at, depth, triangle| wall[at] = wall[at].min(key(depth, triangle)));
        let mut dots = Vec::new();
        if !shapes.dots.shapes.is_empty() {
            dots = vec![0.0; liquid.len()];
            for dot in shapes.dots.of_band(band) {
                dot.draw(shapes.width, band * shapes.band, rows, &liquid, &mut dots);
            }
        }
        Layers { liquid, thickness, wall, dots }
    }
}

/// The nearest wall behind the liquid, or the nearest without liquid: keys of the samples of a band.
pub(crate) fn behind_liquid(shapes: &Shapes, band: usize) -> Vec<u64> {
    let (liquid, _) = draw_liquid(shapes, band);
    let mut behind = vec![NOTHING; liquid.len()];
    shapes.fill_walls(band, |at, depth, triangle| {
        if shown(liquid[at]).is_none_or(|(liquid, _)| depth + shapes.before > liquid) {
            behind[at] = behind[at].min(key(depth, triangle));
        }
    });
    behind
}

/// What of the liquid the samples of a band show, and its thickness.
fn draw_liquid(shapes: &Shapes, band: usize) -> (Vec<u64>, Vec<f32>) {
    let (rows, first) = (shapes.rows(band), band * shapes.band);
    let count = rows * shapes.width;
    let mut liquid = vec![NOTHING; count];
    shapes.discs.of_band(band).for_each(|disc| disc.draw(shapes.radius, shapes.width, first, &mut liquid));
    let has_surface = !shapes.surface.triangles.shapes.is_empty();
    let mut thickness = vec![0.0; if has_surface { count } else { 0 }];
    shapes.surface.fill(shapes, band, rows, |at, face, depth| {
        thickness[at] += if face.triangle.front { -depth } else { depth };
        if face.triangle.front {
            liquid[at] = liquid[at].min(key(depth, SURFACE + face.index));
        }
    });
    (liquid, thickness)
}

/// The least radius of a disc, samples: a square's half diagonal, so that the smallest particle still covers the
/// centre of a sample.
const LEAST_REACH: f32 = 0.75;

fn discs(spheres: Spheres<'_>, camera: &Camera, radius: f32, samples: f32) -> Vec<Disc> {
    let disc = |&(particle, point): &(u32, Vec3)| {
        let [x, y, depth] = camera.project(point)?;
        let reach = (samples * camera.focal() * radius / depth).max(LEAST_REACH);
        Some(Disc { x: samples * x, y: samples * y, depth, reach, particle })
    };
    let mut discs: Vec<Disc> = spheres.par_iter().filter_map(disc).collect();
    // From front to back, for speed alone.
    discs.par_sort_unstable_by(|a, b| a.depth.total_cmp(&b.depth).then(a.particle.cmp(&b.particle)));
    discs
}

/// What a dot covers of a sample. Dots that lie close add up, ...
const DOT_COVER: f32 = 0.22;
/// ... up to this.
const DOT_LIMIT: f32 = 0.7;
/// The side of a dot in particle radii, ...
const DOT_SIDE: f32 = 0.32;
/// ... and at least and at most in pixels of the picture.
const DOT_SIDE_PIXELS: [f32; 2] = [0.67, 3.0];

fn dots(stage: &Stage, camera: &Camera, radius: f32, samples: f32) -> Vec<Dot> {
    let dot = |&point: &Vec3| {
        let [x, y, depth] = camera.project(point)?;
        if dot(point, camera.up()) > camera.top() {
            return None;
        }
        let side = DOT_SIDE * camera.focal() * radius / depth;
        let side = (samples * side.clamp(DOT_SIDE_PIXELS[0], DOT_SIDE_PIXELS[1])).round().max(1.0);
        // Casts saturate.
        let corner = |center: f32| (samples * center - 0.5 * side).round() as i64;
        Some(Dot { left: corner(x), top: corner(y), side: side as i64, depth })
    };
    stage.bare.iter().filter_map(dot).collect()
}

impl Dot {
    fn draw(&self, width: usize, first: usize, rows: usize, liquid: &[u64], dots: &mut [f32]) {
        let inside = |low: i64, limit: usize| {
            let end = low.saturating_add(self.side).clamp(0, limit as i64);
            low.clamp(0, limit as i64) as usize..end as usize
        };
        for row in inside(self.top.saturating_sub(first as i64), rows) {
            for column in inside(self.left, width) {
                let at = row * width + column;
                if shown(liquid[at]).is_none_or(|(depth, _)| self.depth < depth) {
                    dots[at] = (dots[at] + DOT_COVER).min(DOT_LIMIT);
                }
            }
        }
    }
}

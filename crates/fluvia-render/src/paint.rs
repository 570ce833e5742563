//! The colour of each pixel: of every thing that its samples show the light once, by the part of the samples that show it.

use rayon::prelude::*;

use crate::camera::Camera;
use crate::color::{DOT, TILE, Tone, linear};
use crate::frame::Surface;
use crate::image::Image;
use crate::layers::{self, BACK_FARTHER, Layers, SURFACE, Shapes};
use crate::light::{Lit, Shadow};
use crate::shade::{Light, Reach};
use crate::splat::shown;
use crate::stage::Stage;
use crate::vector::{Vec3, add, dot, scaled, sub, unit};

/// A scene with all that its light depends on.
pub(crate) struct Painter<'a> {
    pub camera: &'a Camera,
    pub light: Light,
    pub shadow: &'a Shadow,
    pub stage: &'a Stage,
    /// Of each vertex of the stage.
    pub walls: Vec<WallPoint>,
    pub spheres: &'a [Vec3],
    /// Which of them are outside; empty: none.
    pub outside: &'a [bool],
    pub sphere_color: Vec<Vec3>,
    pub sphere_sky: Vec<f32>,
    pub sphere_lamp: Vec<Lit>,
    pub surface: Surface<'a>,
    /// Of each vertex of the surface.
    pub vertices: Vec<SurfacePoint>,
}

/// What is interpolated between the vertices of walls.
#[derive(Clone, Copy)]
pub(crate) struct WallPoint {
    normal: Vec3,
    corner: f32,
    sky: f32,
}

/// What is interpolated between the vertices of the surface.
#[derive(Clone, Copy)]
pub(crate) struct SurfacePoint {
    color: Vec3,
    sky: f32,
    lamp: Lit,
}

/// How much of a particle that is outside a wall before it covers: what has left is to be seen. The liquid it hides.
const FRONT_WALL: f32 = 0.35;
/// How far over a wall what shadows it lies at least, in particle radii.
const WALL_BIAS: f32 = 0.5;
/// The same for the surface, which bends.
const SURFACE_BIAS: f32 = 0.7;

/// The properties of the stage's vertices, from those of its points.
pub(crate) fn wall_points(stage: &Stage, sky: &[f32]) -> Vec<WallPoint> {
    let point = |vertex| {
        let [x, y, z, corner, sky] = stage.at_vertex(vertex, |point| {
            let [x, y, z] = stage.normal[point];
            [x, y, z, stage.corner[point], sky[point]]
        });
        WallPoint { normal: unit([x, y, z]), corner, sky }
    };
    (0..stage.vertices.len()).into_par_iter().map(point).collect()
}

/// The properties of the surface's vertices.
pub(crate) fn surface_points(
    surface: &Surface<'_>,
    colors: &[Vec3],
    sky: &[f32],
    shadow: &Shadow,
    radius: f32,
) -> Vec<SurfacePoint> {
    let point = |v: usize| {
        let lamp = shadow.lit(surface.position[v], surface.normal[v], SURFACE_BIAS * radius);
        SurfacePoint { color: colors[v], sky: sky[v], lamp }
    };
    (0..surface.position.len()).into_par_iter().map(point).collect()
}

/// A thing that a pixel shows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Thing {
    Sphere(u32),
    /// A triangle of the surface.
    Water(u32),
    /// A triangle of the stage.
    Wall(u32),
}

/// A thing in a pixel: sums over the samples that show it.
#[derive(Clone, Copy)]
struct Group {
    thing: Thing,
    weight: f32,
    count: f32,
    /// Place in samples, and depth.
    at: Vec3,
    thickness: f32,
}

impl Painter<'_> {
    /// The picture.
    pub fn paint(&self, shapes: &Shapes, behind: &[Vec3]) -> Image {
        let samples = shapes.samples;
        let (width, height) = (shapes.width / samples, shapes.height / samples);
        let mut data = vec![0; 3 * width * height];
        let tone = Tone::new();
        data.par_chunks_mut(3 * width * (shapes.band / samples)).enumerate().for_each(|(band, pixels)| {
            let layers = Layers::draw(shapes, band);
            let mut groups = Vec::new();
            for (at, pixel) in pixels.chunks_exact_mut(3).enumerate() {
                let corner = [at % width * samples, at / width * samples];
                let color = self.pixel(shapes, &layers, band, corner, &tone, behind, &mut groups);
                // Casts round down.
                pixel.copy_from_slice(&color.map(|channel| (channel + 0.5) as u8));
            }
        });
        Image { width: width as u32, height: height as u32, data }
    }

    /// What is behind the liquid, and walls where there is none: the light of each pixel, of one sample each.
    pub fn behind(&self, shapes: &Shapes) -> Vec<Vec3> {
        let mut light = vec![linear(TILE); shapes.width * shapes.height];
        light.par_chunks_mut(shapes.width * shapes.band).enumerate().for_each(|(band, light)| {
            let keys = layers::behind_liquid(shapes, band);
            for (at, (light, key)) in light.iter_mut().zip(keys).enumerate() {
                let (x, y) = (at % shapes.width, band * shapes.band + at / shapes.width);
                if let Some((depth, triangle)) = shown(key) {
                    *light = self.wall(triangle, [x as f32 + 0.5, y as f32 + 0.5, depth]);
                }
            }
        });
        light
    }

    /// The colour of the pixel whose samples have their upper left corner at `corner` in a band.
    #[expect(clippy::too_many_arguments, reason = "what it depends on, and memory that is used again")]
    fn pixel(
        &self,
        shapes: &Shapes,
        layers: &Layers,
        band: usize,
        corner: [usize; 2],
        tone: &Tone,
        behind: &[Vec3],
        groups: &mut Vec<Group>,
    ) -> Vec3 {
        groups.clear();
        let (mut empty, mut dots) = (0.0, 0.0);
        let rows = corner[1]..corner[1] + shapes.samples;
        for (column, row) in rows.flat_map(|row| (0..shapes.samples).map(move |k| (corner[0] + k, row))) {
            let at = row * shapes.width + column;
            let place = [column as f32 + 0.5, (band * shapes.band + row) as f32 + 0.5];
            let (liquid, wall) = (shown(layers.liquid[at]), shown(layers.wall[at]));
            let mut under = 1.0;
            if let (Some((depth, index)), Some((front, triangle))) = (liquid, wall)
                && front + shapes.before < depth
            {
                let is_outside = self.outside.get(index as usize) == Some(&true);
                let cover = if is_outside { FRONT_WALL } else { 1.0 };
                under -= cover;
                collect(groups, Thing::Wall(triangle), cover, place, front, 0.0);
            }
            match (liquid, wall) {
                (Some(_), _) if under == 0.0 => {}
                (Some((depth, index)), _) if index >= SURFACE => {
                    let thickness = layers.thickness[at];
                    collect(groups, Thing::Water(index - SURFACE), under, place, depth, thickness);
                }
                (Some((depth, index)), _) => collect(groups, Thing::Sphere(index), under, place, depth, 0.0),
                (None, Some((depth, triangle))) => {
                    collect(groups, Thing::Wall(triangle), under, place, depth, 0.0);
                }
                (None, None) => empty += under,
            }
            dots += layers.dots.get(at).copied().unwrap_or(0.0);
        }
        let all = 1.0 / (shapes.samples * shapes.samples) as f32;
        let mut color = TILE.map(|channel| empty * f32::from(channel));
        let mut water: Option<Water> = None;
        for group in &*groups {
            let scale = 1.0 / (group.count * shapes.samples as f32);
            let at = [group.at[0] * scale, group.at[1] * scale, group.at[2] / group.count];
            let light = match group.thing {
                Thing::Sphere(particle) => self.sphere(particle as usize, at),
                Thing::Wall(triangle) => self.wall(triangle, at),
                Thing::Water(triangle) => {
                    let part = self.water_of(triangle, at, group.thickness / group.count);
                    water.get_or_insert_default().add(&part, group.weight);
                    continue;
                }
            };
            let bytes = tone.color(light);
            (0..3).for_each(|k| color[k] += group.weight * f32::from(bytes[k]));
        }
        if let Some(water) = water {
            let bytes = tone.color(self.water(&water, behind));
            (0..3).for_each(|k| color[k] += water.weight * f32::from(bytes[k]));
        }
        let cover = dots * all;
        std::array::from_fn(|k| {
            let color = color[k] * all;
            color + cover * (f32::from(DOT[k]) - color)
        })
    }

    /// The light of a wall at a pixel and depth.
    fn wall(&self, triangle: u32, [x, y, depth]: Vec3) -> Vec3 {
        let corners = self.stage.triangles[triangle as usize];
        let is_back = triangle as usize >= self.stage.first_back;
        let farther = if is_back { BACK_FARTHER * self.light.radius } else { 0.0 };
        let p = self.camera.unproject([x, y, depth - farther]);
        let shares = shares(p, corners.map(|v| self.stage.vertices[v as usize].0));
        let points = corners.map(|v| self.walls[v as usize]);
        let between = |of: fn(&WallPoint) -> f32| (0..3).map(|k| shares[k] * of(&points[k])).sum::<f32>();
        let normal = unit([0, 1, 2].map(|k| (0..3).map(|i| shares[i] * points[i].normal[k]).sum()));
        let lamp = self.shadow.lit(p, normal, WALL_BIAS * self.light.radius);
        let reach = Reach { sky: between(|point| point.sky), lamp };
        self.light.wall(normal, between(|point| point.corner), reach)
    }

    /// The light of a sphere at a pixel.
    fn sphere(&self, particle: usize, [x, y, depth]: Vec3) -> Vec3 {
        let center = self.spheres[particle];
        let Some([center_x, center_y, center_depth]) = self.camera.project(center) else { return [0.0; 3] };
        let reach = self.camera.focal() * self.light.radius / center_depth;
        let (right, up) = ((x - center_x) / reach, (center_y - y) / reach);
        let square = right * right + up * up;
        // A sphere smaller than a sample is seen beside its rim too.
        let shrink = if square > 1.0 { 1.0 / square.sqrt() } else { 1.0 };
        let normal = [right * shrink, up * shrink, (1.0 - square).max(0.0).sqrt()];
        let normal = self.camera.to_world(normal);
        let view = self.camera.toward_eye(self.camera.unproject([x, y, depth]));
        let reach = Reach { sky: self.sphere_sky[particle], lamp: self.sphere_lamp[particle] };
        self.light.sphere(self.sphere_color[particle], normal, view, reach)
    }

    /// What the water of a triangle is like at a pixel and depth.
    fn water_of(&self, triangle: u32, at: Vec3, thickness: f32) -> Water {
        let corners = self.surface.triangles[triangle as usize].map(|v| v as usize);
        let p = self.camera.unproject(at);
        let shares = shares(p, corners.map(|v| self.surface.position[v]));
        let mut water = Water { at, way: thickness, weight: 1.0, ..Water::default() };
        for (share, v) in shares.into_iter().zip(corners) {
            let SurfacePoint { color, sky, lamp } = self.vertices[v];
            water.normal = add(water.normal, scaled(self.surface.normal[v], share));
            water.color = add(water.color, scaled(color, share));
            water.sky += share * sky;
            water.lamp.past_walls += share * lamp.past_walls;
            water.lamp.covered += share * lamp.covered;
            water.lamp.way += share * lamp.way;
        }
        water
    }

    fn water(&self, water: &Water, behind: &[Vec3]) -> Vec3 {
        let mean = water.scaled(1.0 / water.weight);
        let p = self.camera.unproject(mean.at);
        let view = self.camera.toward_eye(p);
        let normal = unit(mean.normal);
        let [right, up, _] = self.camera.turn(normal);
        let way = mean.way.max(0.0);
        let [dx, dy] = self.light.displacement(right, up, way);
        let scale = self.camera.focal() / mean.at[2];
        let seen = self.look(behind, mean.at[0] + dx * scale, mean.at[1] - dy * scale);
        let reach = Reach { sky: mean.sky, lamp: mean.lamp };
        self.light.water(mean.color, normal, view, way, seen, reach)
    }

    /// What is behind the liquid at a place between pixels; at the edges, what is there.
    fn look(&self, behind: &[Vec3], x: f32, y: f32) -> Vec3 {
        let (width, height) = (self.camera.width() as usize, self.camera.height() as usize);
        let part = |x: f32, side: usize| {
            let x = (x - 0.5).clamp(0.0, (side - 1) as f32);
            (x as usize, (x as usize + 1).min(side - 1), x.fract())
        };
        let ((left, right, dx), (top, bottom, dy)) = (part(x, width), part(y, height));
        let at = |x: usize, y: usize| behind[y * width + x];
        let row = |y: usize| add(scaled(at(left, y), 1.0 - dx), scaled(at(right, y), dx));
        add(scaled(row(top), 1.0 - dy), scaled(row(bottom), dy))
    }
}

/// Water in a pixel; sums by weight.
#[derive(Clone, Copy, Default)]
struct Water {
    at: Vec3,
    normal: Vec3,
    color: Vec3,
    way: f32,
    sky: f32,
    lamp: Lit,
    weight: f32,
}

impl Water {
    fn add(&mut self, other: &Water, weight: f32) {
        let other = other.scaled(weight);
        self.at = add(self.at, other.at);
        self.normal = add(self.normal, other.normal);
        self.color = add(self.color, other.color);
        self.way += other.way;
        self.sky += other.sky;
        self.lamp.past_walls += other.lamp.past_walls;
        self.lamp.covered += other.lamp.covered;
        self.lamp.way += other.lamp.way;
        self.weight += other.weight;
    }

    fn scaled(&self, factor: f32) -> Water {
        let Lit { past_walls, covered, way } = self.lamp;
        Water {
            at: scaled(self.at, factor),
            normal: scaled(self.normal, factor),
            color: scaled(self.color, factor),
            way: self.way * factor,
            sky: self.sky * factor,
            lamp: Lit { past_walls: past_walls * factor, covered: covered * factor, way: way * factor },
            weight: self.weight * factor,
        }
    }
}

/// Adds a sample to the group of its thing.
fn collect(groups: &mut Vec<Group>, thing: Thing, weight: f32, [x, y]: [f32; 2], depth: f32, thickness: f32) {
    let at = [x, y, depth];
    match groups.iter_mut().find(|group| group.thing == thing) {
        Some(group) => {
            group.weight += weight;
            group.count += 1.0;
            group.at = add(group.at, at);
            group.thickness += thickness;
        }
        None => groups.push(Group { thing, weight, count: 1.0, at, thickness }),
    }
}

/// How much each corner of a triangle counts at a point in its plane; on its edge for points beside it.
fn shares(p: Vec3, [a, b, c]: [Vec3; 3]) -> [f32; 3] {
    let (u, v, w) = (sub(b, a), sub(c, a), sub(p, a));
    let (uu, uv, vv, wu, wv) = (dot(u, u), dot(u, v), dot(v, v), dot(w, u), dot(w, v));
    let area = uu * vv - uv * uv;
    let (second, third) = ((vv * wu - uv * wv) / area, (uu * wv - uv * wu) / area);
    if !(second + third).is_finite() {
        return [1.0, 0.0, 0.0];
    }
    let second = second.clamp(0.0, 1.0);
    let third = third.clamp(0.0, 1.0 - second);
    [1.0 - second - third, second, third]
}

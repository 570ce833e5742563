//! Light: one lamp far away, whose shadows are soft, and a sky, whose light reaches what is not covered.
//!
//! Both are seen along directions d towards the light. A map of a direction holds for each texel of a plane across it
//! how high along d the highest thing stands; a point is lit from there if nothing stands higher. The lamp has one fine
//! map, the sky a coarse one for each of some directions, of which a point sees a part: its sky.
//!
//! Light enters walls from behind, as the eye of the camera does: a wall is in the way only where its normal turns
//! to the light. So closed containers are light inside, and obstacles in them cast shadows.

use rayon::prelude::*;

use crate::raster::{self, BAND, Triangle};
use crate::stage::Stage;
use crate::vector::{Vec3, across, add, dot, scaled, smoothstep};

/// What may be in the way of light.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub stage: &'a Stage,
    /// Particles that count: finite ones.
    pub particles: &'a [Vec3],
    /// Their radius, metres.
    pub radius: f32,
    /// The surface that is drawn in place of particles: vertices and triangles.
    pub surface: Option<(&'a [Vec3], &'a [[u32; 3]])>,
}

/// Heights along a direction, over a plane across it.
struct Map {
    /// Right, up and towards the light.
    axes: [Vec3; 3],
    /// The lower left corner, metres along the first two axes, and texels a metre.
    origin: [f32; 2],
    scale: f32,
    width: usize,
    height: usize,
}

/// The height of what is not there.
const NOTHING: f32 = f32::NEG_INFINITY;
/// The largest side of a map, texels.
const MAX_SIDE: f32 = 1536.0;

impl Map {
    /// A map that holds the scene, with texels of a side in metres or, if it is large, as many as there may be.
    fn new(scene: &Scene<'_>, direction: Vec3, texel: f32, most: f32) -> Map {
        let [right, up] = across(direction);
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for p in scene.particles.iter().chain(&scene.stage.position) {
            for (k, axis) in [right, up].into_iter().enumerate() {
                let along = dot(*p, axis);
                (low[k], high[k]) = (low[k].min(along), high[k].max(along));
            }
        }
        // Room for what is as large as a particle, and for looking beside it.
        let rim = 3.0 * scene.radius;
        let extent = (0..2).map(|k| (high[k] - low[k]).max(0.0) + 2.0 * rim).fold(0.0, f32::max);
        let scale = (1.0 / texel).min(most / extent);
        let side = |k: usize| ((((high[k] - low[k]).max(0.0) + 2.0 * rim) * scale).ceil() as usize).max(1);
        let (width, height) = (side(0), side(1));
        Map { axes: [right, up, direction], origin: low.map(|x| x - rim), scale, width, height }
    }

    /// Where a point is on the map, texels, and its height along the direction.
    fn place(&self, p: Vec3) -> ([f32; 2], f32) {
        let along = [dot(p, self.axes[0]), dot(p, self.axes[1])];
        let at = [0, 1].map(|k| (along[k] - self.origin[k]) * self.scale);
        (at, dot(p, self.axes[2]))
    }

    fn index(&self, [x, y]: [f32; 2]) -> Option<usize> {
        // Casts saturate; what is left of the map is negative.
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| y as usize * self.width + x as usize)
    }

    /// Raises the heights to those of a sphere.
    fn add_sphere(&self, heights: &mut [f32], center: Vec3, radius: f32) {
        let ([x, y], top) = self.place(center);
        let reach = radius * self.scale;
        let range = |center: f32, limit: usize| {
            let first = (center - reach - 0.5).ceil().max(0.0) as usize;
            first..((center + reach + 0.5).floor().max(0.0) as usize).min(limit)
        };
        for row in range(y, self.height) {
            for column in range(x, self.width) {
                let (dx, dy) = (column as f32 + 0.5 - x, row as f32 + 0.5 - y);
                let inside = reach * reach - dx * dx - dy * dy;
                if inside > 0.0 {
                    let height = &mut heights[row * self.width + column];
                    *height = height.max(top + inside.sqrt() / self.scale);
                }
            }
        }
    }

    /// Raises the heights to those of a square piece of wall, `half` metres to each side of a point.
    fn add_wall(&self, heights: &mut [f32], center: Vec3, normal: Vec3, half: f32) {
        let turn = dot(normal, self.axes[2]);
        if turn < LEAST_SKY_TURN {
            return;
        }
        let ([x, y], top) = self.place(center);
        let slope = [0, 1].map(|k| -dot(normal, self.axes[k]) / turn / self.scale);
        let reach = half * self.scale;
        let range = |center: f32, limit: usize| {
            let first = (center - reach).floor().max(0.0) as usize;
            first..((center + reach).ceil().max(0.0) as usize).min(limit)
        };
        for row in range(y, self.height) {
            for column in range(x, self.width) {
                let (dx, dy) = (column as f32 + 0.5 - x, row as f32 + 0.5 - y);
                let height = &mut heights[row * self.width + column];
                *height = height.max(top + slope[0] * dx + slope[1] * dy);
            }
        }
    }
}

/// The least cosine between a wall's normal and the light at which the wall is in its way.
const LEAST_TURN: f32 = 0.08;

/// The same for the sky, whose coarse maps would have walls shade themselves.
const LEAST_SKY_TURN: f32 = 0.25;

/// What is seen of the sky from some places.
pub(crate) struct Sky {
    maps: Vec<(Map, Vec<f32>, f32)>,
    radius: f32,
}

/// Directions of the sky.
const DIRECTIONS: usize = 30;
/// The lowest of them, as a cosine with up: a little below the horizon, for what hangs over.
const LOWEST: f32 = -0.1;
/// How much brighter the sky is above than at the horizon.
const ZENITH: f32 = 1.0;
/// A texel of the sky's maps, in particle radii, and the largest side of a map.
const SKY_TEXEL: f32 = 0.5;
const SKY_SIDE: f32 = 512.0;

impl Sky {
    pub fn new(scene: &Scene<'_>, up: Vec3) -> Sky {
        let [first, second] = across(up);
        let maps = (0..DIRECTIONS).into_par_iter().map(|k| {
            // A spiral in which each direction stands for the same part of the sky.
            let cosine = 1.0 - (k as f32 + 0.5) / DIRECTIONS as f32 * (1.0 - LOWEST);
            let sine = (1.0 - cosine * cosine).sqrt();
            let angle = k as f32 * GOLDEN_ANGLE;
            let flat = add(scaled(first, sine * angle.cos()), scaled(second, sine * angle.sin()));
            let map = Map::new(scene, add(flat, scaled(up, cosine)), SKY_TEXEL * scene.radius, SKY_SIDE);
            let mut heights = vec![NOTHING; map.width * map.height];
            scene.particles.iter().for_each(|&p| map.add_sphere(&mut heights, p, scene.radius));
            let stage = scene.stage;
            for ((&x, &n), spacing) in stage.position.iter().zip(&stage.normal).zip(&stage.spacing) {
                map.add_wall(&mut heights, x, n, 0.6 * spacing);
            }
            (map, heights, 1.0 + ZENITH * cosine.max(0.0))
        });
        Sky { maps: maps.collect(), radius: scene.radius }
    }

    /// The part of the sky that particles see, 0 to 1.
    pub fn of_particles(&self, particles: &[Vec3]) -> Vec<f32> {
        let seen = |&p: &Vec3| {
            let (mut sum, mut all) = (0.0, 0.0);
            for (map, heights, light) in &self.maps {
                sum += light * self.open(map, heights, p, self.radius, [0.0; 2]);
                all += light;
            }
            sum / all
        };
        particles.par_iter().map(seen).collect()
    }

    /// The part of the sky above a surface, by the cosines with its normals, that its points see, 0 to 1.
    pub fn of_surface(&self, position: &[Vec3], normal: &[Vec3], off: f32) -> Vec<f32> {
        let seen = |(&p, &n): (&Vec3, &Vec3)| {
            let (mut sum, mut all) = (0.0, 0.0);
            for (map, heights, light) in &self.maps {
                let turn = dot(n, map.axes[2]);
                let light = light * turn;
                if light > 0.0 {
                    // How the surface itself rises beside the point, which does not cover it.
                    let slope = [0, 1].map(|k| -dot(n, map.axes[k]) / turn.max(LEAST_SKY_TURN) / map.scale);
                    sum += light * self.open(map, heights, add(p, scaled(n, off)), 0.0, slope);
                    all += light;
                }
            }
            // What looks down sees nothing of the sky; what light it gets comes from the ground.
            if all > 0.0 { sum / all } else { 1.0 }
        };
        position.par_iter().zip(normal).map(seen).collect()
    }

    /// How open the sky is in a direction, seen from `above` metres over a point of a surface that rises by `slope` a
    /// texel: 0 where something stands higher.
    fn open(&self, map: &Map, heights: &[f32], p: Vec3, above: f32, slope: [f32; 2]) -> f32 {
        let ([x, y], height) = map.place(p);
        let height = height + above;
        // Between four texels, so that nothing jumps while particles move.
        let (x, y) = (x - 0.5, y - 0.5);
        let (dx, dy) = (x - x.floor(), y - y.floor());
        let tap = |column: f32, row: f32| match map.index([column, row]) {
            Some(index) => {
                let own = height + slope[0] * (column - 0.5 - x) + slope[1] * (row - 0.5 - y);
                1.0 - smoothstep(0.4, 2.0, (heights[index] - own) / self.radius)
            }
            None => 1.0,
        };
        let (left, low) = (x.floor() + 0.5, y.floor() + 0.5);
        let lower = tap(left, low) * (1.0 - dx) + tap(left + 1.0, low) * dx;
        let upper = tap(left, low + 1.0) * (1.0 - dx) + tap(left + 1.0, low + 1.0) * dx;
        lower * (1.0 - dy) + upper * dy
    }
}

/// 137.5 degrees: points on a spiral with this step are spread evenly.
const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// What the lamp's light meets.
pub(crate) struct Shadow {
    map: Map,
    /// Heights of walls and of the liquid.
    walls: Vec<f32>,
    liquid: Vec<f32>,
    /// Metres of liquid along the light; empty if the liquid lets no light through.
    thickness: Vec<f32>,
    radius: f32,
    /// Where the search and the penumbra look, within 1.
    search: [[f32; 2]; SEARCH_TAPS],
    taps: [[f32; 2]; TAPS],
}

/// How much of the lamp reaches a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Lit {
    /// The part of the lamp that no wall covers, 0 to 1.
    pub past_walls: f32,
    /// The part that the liquid covers, 0 to 1, ...
    pub covered: f32,
    /// ... and the mean way through the liquid where it does, metres; infinite if it lets no light through.
    pub way: f32,
}

/// A texel of the lamp's map, in particle radii.
const LAMP_TEXEL: f32 = 0.16;
/// The half width of the lamp as seen from the scene, as a tangent: what the penumbra gains per metre.
const LAMP_SIZE: f32 = 0.07;
/// The least radius of the penumbra, in particle radii.
const LEAST_PENUMBRA: f32 = 0.35;
/// The least cosine between a surface and the lamp that its slope is taken from.
const LEAST_SLOPE_TURN: f32 = 0.2;
/// How far around what is in the way is looked for, in particle radii.
const SEARCH: f32 = 3.0;
/// Samples of the search and of the penumbra.
const SEARCH_TAPS: usize = 8;
const TAPS: usize = 16;

impl Shadow {
    pub fn new(scene: &Scene<'_>, lamp: Vec3) -> Shadow {
        let map = Map::new(scene, lamp, LAMP_TEXEL * scene.radius, MAX_SIDE);
        let walls = map.draw_walls(scene.stage);
        let (liquid, thickness) = match scene.surface {
            Some((vertices, triangles)) => map.draw_surface(vertices, triangles),
            None => (map.draw_spheres(scene.particles, scene.radius), Vec::new()),
        };
        Shadow { map, walls, liquid, thickness, radius: scene.radius, search: spiral(), taps: spiral() }
    }

    /// How much of the lamp reaches a point of a surface with a normal; what is less than `bias` metres above the plane
    /// through it is not in the way.
    pub fn lit(&self, p: Vec3, normal: Vec3, bias: f32) -> Lit {
        let (at, height) = self.map.place(p);
        let height = height + bias;
        let turn = dot(normal, self.map.axes[2]).max(LEAST_SLOPE_TURN) * self.map.scale;
        let slope = [0, 1].map(|k| -dot(normal, self.map.axes[k]) / turn);
        // The height of the surface itself beside the point.
        let own = |[x, y]: [f32; 2]| height + (slope[0] * (x - at[0]) + slope[1] * (y - at[1])).max(0.0);
        let search = SEARCH * self.radius * self.map.scale;
        let (mut above, mut count) = (0.0, 0);
        for [x, y] in self.search {
            let place = [at[0] + search * x, at[1] + search * y];
            let Some(index) = self.map.index(place) else { continue };
            let over = self.walls[index].max(self.liquid[index]) - own(place);
            if over > 0.0 {
                (above, count) = (above + over, count + 1);
            }
        }
        if count == 0 {
            // Nothing near, and what is small and near enough to be missed has a small shadow.
            let lit = self.map.index(at).is_none_or(|i| self.walls[i].max(self.liquid[i]) <= height);
            if lit {
                return Lit { past_walls: 1.0, covered: 0.0, way: 0.0 };
            }
        }
        let mean = above / count.max(1) as f32;
        let penumbra = (LAMP_SIZE * mean).max(LEAST_PENUMBRA * self.radius) * self.map.scale;
        let (mut walls, mut covered, mut way) = (0.0, 0.0, 0.0);
        for [x, y] in self.taps {
            let place = [at[0] + penumbra * x, at[1] + penumbra * y];
            let Some(index) = self.map.index(place) else { continue };
            let height = own(place);
            let over = |top: f32| smoothstep(0.0, 0.5, (top - height) / self.radius);
            walls += over(self.walls[index]);
            let cover = over(self.liquid[index]);
            covered += cover;
            if let Some(&thickness) = self.thickness.get(index) {
                way += cover * thickness.min(self.liquid[index] - height + bias).max(0.0);
            }
        }
        let taps = TAPS as f32;
        let way = match self.thickness.is_empty() {
            true => f32::INFINITY,
            false if covered > 0.0 => way / covered,
            false => 0.0,
        };
        Lit { past_walls: 1.0 - walls / taps, covered: covered / taps, way }
    }
}

/// Places spread evenly within a circle of radius 1.
fn spiral<const N: usize>() -> [[f32; 2]; N] {
    std::array::from_fn(|k| {
        let distance = ((k as f32 + 0.5) / N as f32).sqrt();
        let (sine, cosine) = (k as f32 * GOLDEN_ANGLE).sin_cos();
        [distance * cosine, distance * sine]
    })
}

impl Map {
    /// Draws triangles band by band; `draw` gets the value of a texel, whether the triangle there is seen from its front, and
    /// its height.
    fn draw<V: Copy + Send>(
        &self,
        empty: V,
        vertices: &[([f32; 2], f32)],
        triangles: &[(Triangle, [u32; 3])],
        draw: impl Fn(&mut V, bool, f32) + Sync,
    ) -> Vec<V> {
        let mut values = vec![empty; self.width * self.height];
        let (starts, order) = raster::bands(triangles, self.height, BAND, |(triangle, _)| triangle.rows());
        values.par_chunks_mut(BAND * self.width).enumerate().for_each(|(band, values)| {
            let rows = values.len() / self.width;
            for &index in &order[starts[band]..starts[band + 1]] {
                let (triangle, corners) = &triangles[index as usize];
                let [a, b, c] = corners.map(|v| vertices[v as usize].1);
                triangle.fill(self.width, band * BAND, rows, |at, second, third| {
                    draw(&mut values[at], triangle.front, a + second * (b - a) + third * (c - a));
                });
            }
        });
        values
    }

    fn triangles(
        &self,
        vertices: &[([f32; 2], f32)],
        triangles: impl Iterator<Item = [u32; 3]>,
    ) -> Vec<(Triangle, [u32; 3])> {
        let place = |v: u32| vertices[v as usize].0;
        triangles.filter_map(|t| Triangle::new(t.map(place)).map(|triangle| (triangle, t))).collect()
    }

    fn draw_walls(&self, stage: &Stage) -> Vec<f32> {
        let vertices: Vec<_> = stage.vertices.par_iter().map(|(p, _)| self.place(*p)).collect();
        let turned = stage
            .triangles
            .iter()
            .zip(&stage.cell)
            .filter(|(_, cell)| dot(stage.normal[**cell as usize], self.axes[2]) > LEAST_TURN);
        let triangles = self.triangles(&vertices, turned.map(|(triangle, _)| *triangle));
        self.draw(NOTHING, &vertices, &triangles, |height, _, found| *height = height.max(found))
    }

    /// The heights of a closed surface, and how much of each ray is inside it.
    fn draw_surface(&self, vertices: &[Vec3], triangles: &[[u32; 3]]) -> (Vec<f32>, Vec<f32>) {
        let vertices: Vec<_> = vertices.par_iter().map(|&p| self.place(p)).collect();
        let triangles = self.triangles(&vertices, triangles.iter().copied());
        // This map's y runs up, so that what is in front of the light is clockwise to it.
        let drawn =
            self.draw([NOTHING, 0.0], &vertices, &triangles, |value: &mut [f32; 2], front, height| {
                value[0] = value[0].max(height);
                value[1] += if front { -height } else { height };
            });
        drawn.into_iter().map(|[height, thickness]| (height, thickness)).unzip()
    }

    fn draw_spheres(&self, particles: &[Vec3], radius: f32) -> Vec<f32> {
        let mut heights = vec![NOTHING; self.width * self.height];
        particles.iter().for_each(|&p| self.add_sphere(&mut heights, p, radius));
        heights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS: f32 = 0.025;
    const UP: Vec3 = [0.0, 1.0, 0.0];

    /// A slab of particles at a height, 1 m wide, without gaps.
    fn slab(height: f32) -> Vec<Vec3> {
        let at = |i: i32| RADIUS * i as f32;
        (-20..=20).flat_map(|x| (-20..=20).map(move |z| [at(x), height, at(z)])).collect()
    }

    fn scene<'a>(stage: &'a Stage, particles: &'a [Vec3]) -> Scene<'a> {
        Scene { stage, particles, radius: RADIUS, surface: None }
    }

    #[test]
    fn the_sky_is_seen_as_far_as_nothing_is_above() {
        let stage = Stage::default();
        let mut particles = slab(0.5);
        particles.extend([[0.0, 0.7, 0.0], [0.0, 0.3, 0.0], [3.0, 0.3, 0.0]]);
        let sky = Sky::new(&scene(&stage, &particles), UP);
        let seen = sky.of_particles(&particles[particles.len() - 3..]);
        // Over the slab, under its middle, and far beside it.
        assert!(seen[0] > 0.99 && seen[1] < 0.35 && seen[2] > 0.95, "{seen:?}");
        let off = [[0.0, 0.3, 0.0], [3.0, 0.3, 0.0]];
        let below = sky.of_surface(&off, &[UP; 2], RADIUS);
        assert!(below[0] < 0.3 && below[1] > 0.95, "{below:?}");
        // What looks down sees only the lowest of it, and the slab above it does not cover that.
        assert_eq!(sky.of_surface(&[[0.2, 0.3, 0.1]], &[[0.0, -1.0, 0.0]], RADIUS), [1.0]);
    }

    #[test]
    fn the_lamp_reaches_past_the_edge_of_a_shadow_by_degrees() {
        let stage = Stage::default();
        let particles = slab(0.5);
        let shadow = Shadow::new(&scene(&stage, &particles), UP);
        let lit = |x: f32| shadow.lit([x, 0.0, 0.0], UP, 0.0).covered;
        assert_eq!((lit(0.0), lit(0.9)), (1.0, 0.0));
        // The slab ends at 0.525 m.
        let edge: Vec<f32> = (0..9).map(|k| lit(0.505 + 0.005 * k as f32)).collect();
        assert!(edge.windows(2).all(|pair| pair[1] <= pair[0] + 0.07), "{edge:?}");
        assert!(edge.iter().filter(|x| **x > 0.05 && **x < 0.95).count() >= 3, "{edge:?}");
        // On the slab nothing is in the way.
        assert_eq!(shadow.lit([0.0, 0.53, 0.0], UP, RADIUS).covered, 0.0);
        assert_eq!(shadow.lit([0.0, 0.0, 0.0], UP, 0.0).way, f32::INFINITY);
    }

    #[test]
    fn the_way_through_a_surface_is_its_thickness() {
        // A block of 0.8 x 0.3 x 0.8 m.
        let corner = |k: u32| {
            [0, 1, 2].map(|i| if k >> i & 1 == 1 { [0.4, 0.8, 0.4][i] } else { [-0.4, 0.5, -0.4][i] })
        };
        let vertices: Vec<Vec3> = (0..8).map(corner).collect();
        let faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
        // These wind clockwise seen from outside.
        let triangles: Vec<[u32; 3]> =
            faces.iter().flat_map(|&[a, b, c, d]| [[a, c, b], [a, d, c]]).collect();
        let stage = Stage::default();
        let particles = slab(0.65);
        let scene = Scene { surface: Some((&vertices, &triangles)), ..scene(&stage, &particles) };
        let shadow = Shadow::new(&scene, UP);
        let lit = shadow.lit([0.1, 0.0, 0.1], UP, 0.0);
        assert!(lit.covered == 1.0 && (lit.way - 0.3).abs() < 1e-3, "{lit:?}");
        let beside = shadow.lit([0.9, 0.0, 0.0], UP, 0.0);
        assert_eq!((beside.past_walls, beside.covered), (1.0, 0.0));
    }

    #[test]
    fn walls_are_in_the_way_of_light_that_meets_their_front() {
        let (mut position, mut normal) = (slab(0.5), Vec::new());
        position.iter_mut().for_each(|p| *p = [0.65 * p[0], p[1], 0.65 * p[2]]);
        for (turn, expected) in [(1.0, 0.0), (-1.0, 1.0)] {
            normal.clear();
            normal.resize(position.len(), [0.0, turn, 0.0]);
            let stage = Stage::new(crate::Walls { position: &position, normal: &normal });
            let below = [[0.0, 0.1, 0.0]];
            let scene = scene(&stage, &below);
            assert_eq!(Shadow::new(&scene, UP).lit(below[0], UP, 0.0).past_walls, expected);
            let seen = Sky::new(&scene, UP).of_particles(&below)[0];
            assert_eq!(seen > 0.9, turn < 0.0, "{seen}");
        }
    }
}

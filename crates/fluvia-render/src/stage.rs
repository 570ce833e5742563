//! The walls as a surface: every wall point becomes a small polygon, its share of the wall.
//!
//! The points lie about a particle radius apart on surfaces that are not known otherwise. In the plane through a point
//! across its normal, its cell is what is nearer to it than to the points beside it (Voronoi), so that on a flat wall the cells
//! join without gap or overlap. At edges the cell ends where the wall on the other side of the edge begins:
//!
//! ```text
//! n_i·n_j near 1            beside it        keep p with (p - (x_i + x_j) / 2)·(x_j - x_i) <= 0
//! else, n_i·(x_j - x_i) > 0  an inner edge    keep p with n_j·(p - x_j) >= 0
//! else                       an outer edge    keep p with n_j·(p - x_j) <= 0
//! ```

use rayon::prelude::*;

use crate::frame::Walls;
use crate::tree::Tree;
use crate::vector::{Vec3, across, add, cross, dot, finite, scaled, sub, unit};

/// Walls that are ready to be drawn; made once for all frames.
#[derive(Clone, Debug, Default)]
pub struct Stage {
    /// Points with normals, metres, and their normals.
    pub(crate) position: Vec<Vec3>,
    pub(crate) normal: Vec<Vec3>,
    /// How much of the sky each point sees past the walls beside it, 0 to 1.
    pub(crate) corner: Vec<f32>,
    /// The points of the same wall around each, with their weights, from `around_starts` of one to that of the next.
    around: Vec<(u32, f32)>,
    around_starts: Vec<usize>,
    /// How far apart the points of the wall around each are, metres.
    pub(crate) spacing: Vec<f32>,
    /// Whether the wall around each is flat.
    flat: Vec<bool>,
    /// Corners of all cells: the place, and the points whose properties count there, equally; [`NONE`] where there are
    /// fewer.
    pub(crate) vertices: Vec<(Vec3, [u32; 3])>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// The point whose cell a triangle is in.
    pub(crate) cell: Vec<u32>,
    /// From this triangle on they are pieces behind the cells of round walls.
    pub(crate) first_back: usize,
    /// Points without a normal, which are drawn as dots.
    pub(crate) bare: Vec<Vec3>,
}

/// The circumradius of a cell that nothing limits, in spacings: as far as the largest hole between points reaches.
const REACH: f32 = 1.9;
/// Corners of such a cell.
const SIDES: usize = 8;
/// How far from a point those that limit its cell may be, in spacings.
const NEIGHBORS: f32 = 3.0;
/// The cosine up to which normals belong to one surface, flat or round: 35 degrees.
const SAME: f32 = 0.82;
/// How far along another wall a point of it may be, in spacings, to limit a cell: so far is one at least.
const BESIDE: f32 = 1.9;
/// Points nearer than this to another wall, in spacings, may lie on the edge with it.
const ON_EDGE: f32 = 0.1;
/// How far behind it, in spacings, points of the limited wall may lie all the same: walls may be round.
const BEHIND: f32 = 0.3;
/// How far beyond the line between two points a cell reaches, in parts of their distance: round walls have no cracks then.
const OVERLAP: f32 = 0.02;
/// The same on round walls, and how far cells reach over inner edges there, in spacings: they are behind the other wall.
/// Over an outer edge they would stick out before it.
const ROUND_OVERLAP: f32 = 0.06;
const ROUND_INNER: f32 = 0.3;
/// Pieces of wall behind the cells of round walls: how much larger they are than those, how far behind, and how far they
/// reach over outer edges, in spacings.
const BACK_SCALE: f32 = 1.35;
const BACK_DEPTH: f32 = 0.25;
const BACK_OUTER: f32 = 0.15;
/// The cosine up to which normals belong to one flat wall: 2.5 degrees.
const FLAT: f32 = 0.999;
/// The cosine from which on a wall lies along a side of the box around all points.
const ALONG: f32 = 0.97;
/// The points around one that tell the spacing, ...
const SPACING_NEIGHBORS: usize = 6;
/// ... and the part of the distance of the last of them that the nearest is usually away.
const SPACING_PART: f32 = 0.68;
/// The most that points are apart, in distances to the nearest.
const SPACING_MOST: f32 = 1.7;
/// The most points that limit a cell: the nearest.
const MOST_NEIGHBORS: usize = 64;
/// How far around a point the light of a wall is averaged, in spacings.
const AROUND: f32 = 4.0;
/// How far walls darken each other at their edges, in spacings.
const CORNER_REACH: f32 = 7.0;
/// How dark the inner edge between two walls is.
const CORNER_DEPTH: f32 = 0.6;

impl Stage {
    /// The walls of a scene. Points that are not finite are left out; those without a normal become dots.
    pub fn new(walls: Walls<'_>) -> Stage {
        let (mut stage, mut box_of) = (Stage::default(), [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]]);
        for (i, &position) in walls.position.iter().enumerate() {
            if !finite(&position) {
                continue;
            }
            let normal = walls.normal.get(i).map_or([0.0; 3], |&normal| unit(normal));
            if normal == [0.0; 3] {
                stage.bare.push(position);
                continue;
            }
            stage.position.push(position);
            stage.normal.push(normal);
            box_of[0] = std::array::from_fn(|k| box_of[0][k].min(position[k]));
            box_of[1] = std::array::from_fn(|k| box_of[1][k].max(position[k]));
        }
        let tree = Tree::new(&stage.position);
        let places = 0..stage.position.len();
        stage.spacing = places.clone().into_par_iter().map(|i| spacing(&stage, &tree, i)).collect();
        stage.flat = places.clone().into_par_iter().map(|i| is_flat(&stage, &tree, i)).collect();
        let cells: Vec<Vec<Corner>> =
            places.clone().into_par_iter().map(|i| cell(&stage, &tree, box_of, i)).collect();
        let corners: Vec<f32> = places.clone().into_par_iter().map(|i| corner(&stage, &tree, i)).collect();
        stage.around_starts.push(0);
        for around in places.into_par_iter().map(|i| around(&stage, &tree, i)).collect::<Vec<_>>() {
            stage.around.extend(around);
            stage.around_starts.push(stage.around.len());
        }
        stage.corner = stage.smoothed(&corners);
        for (i, cell) in cells.iter().enumerate() {
            stage.add(i as u32, stage.position[i], cell);
        }
        stage.first_back = stage.triangles.len();
        for (i, cell) in cells.iter().enumerate().filter(|(_, cell)| !cell.is_empty()) {
            if !stage.flat[i] {
                let (middle, polygon) = back(&stage, i, cell);
                stage.add(i as u32, middle, &polygon);
            }
        }
        stage
    }

    /// Adds a polygon around a middle that belongs to a point.
    fn add(&mut self, i: u32, middle: Vec3, polygon: &[Corner]) {
        if polygon.len() < 3 {
            return;
        }
        let first = self.vertices.len() as u32;
        self.vertices.push((middle, [i, NONE, NONE]));
        let of = |corner: &Corner| [i, corner.before.point(), corner.after.point()];
        self.vertices.extend(polygon.iter().map(|corner| (corner.place, of(corner))));
        for k in 0..polygon.len() as u32 {
            self.triangles.push([first, first + 1 + k, first + 1 + (k + 1) % polygon.len() as u32]);
            self.cell.push(i);
        }
    }

    /// Whether two points belong to one wall, by their normals.
    fn is_same(&self, i: usize, j: usize) -> bool {
        dot(self.normal[i], self.normal[j]) > SAME
    }

    /// A property of the points, averaged over the wall around each.
    pub(crate) fn smoothed(&self, values: &[f32]) -> Vec<f32> {
        let smooth = |i: usize| {
            let around = &self.around[self.around_starts[i]..self.around_starts[i + 1]];
            around.iter().map(|&(j, weight)| weight * values[j as usize]).sum()
        };
        (0..values.len()).into_par_iter().map(smooth).collect()
    }

    /// A property of the points at a vertex of a cell.
    pub(crate) fn at_vertex<const N: usize>(
        &self,
        vertex: usize,
        of: impl Fn(usize) -> [f32; N],
    ) -> [f32; N] {
        let points = self.vertices[vertex].1;
        let (mut sum, mut count) = ([0.0; N], 0.0);
        for &point in points.iter().filter(|point| **point != NONE) {
            let value = of(point as usize);
            (0..N).for_each(|k| sum[k] += value[k]);
            count += 1.0;
        }
        sum.map(|x| x / count)
    }
}

/// No point.
const NONE: u32 = u32::MAX;

/// A corner of a cell, and what is on the other side of the edges that end and begin there.
#[derive(Clone, Copy)]
struct Corner {
    place: Vec3,
    before: Beyond,
    after: Beyond,
}

/// What is on the other side of an edge of a cell.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Beyond {
    /// The cell of a point of the same wall.
    Point(u32),
    /// Another wall that stands in the way.
    Wall,
    /// Another wall that begins where this ends, at an outer edge.
    Outer,
    /// Nothing: the wall ends.
    Nothing,
}

impl Beyond {
    fn point(self) -> u32 {
        match self {
            Beyond::Point(point) => point,
            Beyond::Wall | Beyond::Outer | Beyond::Nothing => NONE,
        }
    }
}

/// How far apart the points around a point are, of those with its normal; 0 if there are none.
fn spacing(stage: &Stage, tree: &Tree, i: usize) -> f32 {
    let mut nearest = [f32::INFINITY; SPACING_NEIGHBORS];
    let mut first = f32::INFINITY;
    tree.visit(&stage.position[i], f32::INFINITY, |j, squared, limit| {
        if squared > 0.0 {
            first = first.min(squared);
        }
        if squared > 0.0 && squared < nearest[SPACING_NEIGHBORS - 1] && stage.is_same(i, j) {
            let place = nearest.partition_point(|&other| other <= squared);
            nearest[place..].rotate_right(1);
            nearest[place] = squared;
            *limit = nearest[SPACING_NEIGHBORS - 1];
        }
    });
    let last = nearest.iter().rfind(|squared| squared.is_finite()).copied().unwrap_or(0.0);
    // Where a wall bends sharply, points with the same normal are far.
    (SPACING_PART * last.sqrt()).min(SPACING_MOST * first.sqrt())
}

/// Whether the points of the wall around a point have its normal.
fn is_flat(stage: &Stage, tree: &Tree, i: usize) -> bool {
    let mut flat = true;
    tree.visit(&stage.position[i], (NEIGHBORS * stage.spacing[i]).powi(2), |j, _, limit| {
        let cosine = dot(stage.normal[i], stage.normal[j]);
        if cosine > SAME && cosine < FLAT {
            (flat, *limit) = (false, -1.0);
        }
    });
    flat
}

/// The polygon of a point.
fn cell(stage: &Stage, tree: &Tree, [low, high]: [Vec3; 2], i: usize) -> Vec<Corner> {
    let (x, n, spacing) = (stage.position[i], stage.normal[i], stage.spacing[i]);
    if spacing == 0.0 {
        return Vec::new();
    }
    let mut polygon = disc(x, n, REACH * spacing);
    let mut near = Vec::new();
    tree.visit(&x, (NEIGHBORS * spacing).powi(2), |j, squared, _| near.push((squared, j)));
    near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.retain(|&(squared, _)| squared > 0.0);
    near.truncate(MOST_NEIGHBORS);
    let is_same = |j: usize| stage.is_same(i, j);
    for &(squared, j) in near.iter().filter(|(_, j)| is_same(*j)) {
        let way = sub(stage.position[j], x);
        // A wall below or above is not beside it.
        if dot(n, way).powi(2) < 0.25 * squared {
            let over = if stage.flat[i] && stage.flat[j] { OVERLAP } else { ROUND_OVERLAP };
            let limit = (0.5 + over) * squared;
            clip(&mut polygon, Beyond::Point(j as u32), |p| limit - dot(sub(p, x), way));
        }
    }
    for &(_, j) in near.iter().filter(|(_, j)| !is_same(*j)) {
        let (y, m) = (stage.position[j], stage.normal[j]);
        let way = sub(y, x);
        // The other wall must be there where its plane is: near the foot of the perpendicular.
        let foot = sub(way, scaled(m, dot(m, way)));
        // At an inner edge each point is before the other's wall, at an outer one behind it.
        let (height, before) = (dot(n, way), -dot(m, way));
        let clear = ON_EDGE * spacing;
        let side = if height.abs() > clear { height.signum() } else { before.signum() };
        if height.abs().max(before.abs()) <= clear {
            continue;
        }
        let inside = |p: Vec3| side * dot(m, sub(p, y));
        // And it ends where this wall goes on behind it.
        let goes_on = |&(_, k): &(f32, usize)| {
            let from = sub(stage.position[k], y);
            is_same(k)
                && inside(stage.position[k]) < -BEHIND * spacing
                && dot(from, from) < (BESIDE * spacing).powi(2)
        };
        if dot(foot, foot) < (BESIDE * spacing).powi(2) && inside(x) > -clear && !near.iter().any(goes_on) {
            // Of a round wall the plane through a point is not where the wall is beside it.
            let is_flat = stage.flat[i] && stage.flat[j];
            let (beyond, over) = match side > 0.0 {
                true => (Beyond::Wall, if is_flat { 0.0 } else { ROUND_INNER * spacing }),
                false => (Beyond::Outer, 0.0),
            };
            clip(&mut polygon, beyond, |p| inside(p) + over);
        }
    }
    // A round wall that lies along a side of the box bends inwards where its cells reach out.
    for k in 0..3 {
        let margin = if stage.flat[i] || n[k].abs() < ALONG { 0.0 } else { spacing };
        clip(&mut polygon, Beyond::Nothing, |p| p[k] - low[k] + margin);
        clip(&mut polygon, Beyond::Nothing, |p| high[k] - p[k] + margin);
    }
    polygon
}

/// The cells of a round wall do not join, nor those of two at an outer edge; what is seen between them is a piece of wall behind
/// each: its middle and its corners. It is larger than the cell, but no larger where the wall ends.
fn back(stage: &Stage, i: usize, cell: &[Corner]) -> (Vec3, Vec<Corner>) {
    let (x, n) = (stage.position[i], stage.normal[i]);
    let behind = sub(x, scaled(n, BACK_DEPTH * stage.spacing[i]));
    let grown = |corner: &Corner| {
        let place = add(behind, scaled(sub(corner.place, x), BACK_SCALE));
        Corner { place, ..*corner }
    };
    let mut polygon: Vec<Corner> = cell.iter().map(grown).collect();
    for (k, corner) in cell.iter().enumerate() {
        let over = match corner.after {
            Beyond::Nothing => 0.0,
            Beyond::Outer => BACK_OUTER * stage.spacing[i],
            Beyond::Point(_) | Beyond::Wall => continue,
        };
        let along = sub(cell[(k + 1) % cell.len()].place, corner.place);
        // Corners run counter-clockwise about the normal: this is to the left of the edge, where the cell is.
        let inwards = unit(cross(n, along));
        clip(&mut polygon, Beyond::Nothing, |p| dot(sub(p, corner.place), inwards) + over);
    }
    (behind, polygon)
}

/// A polygon of [`SIDES`] sides around a point, across its normal, counter-clockwise about it.
fn disc(middle: Vec3, normal: Vec3, reach: f32) -> Vec<Corner> {
    let [right, up] = across(normal);
    let corner = |k: usize| {
        let (sine, cosine) = (std::f32::consts::TAU * k as f32 / SIDES as f32).sin_cos();
        let place = add(middle, add(scaled(right, reach * cosine), scaled(up, reach * sine)));
        Corner { place, before: Beyond::Nothing, after: Beyond::Nothing }
    };
    (0..SIDES).map(corner).collect()
}

/// Keeps the part of a convex polygon where `inside` is not negative; `beyond` is what is on the other side.
fn clip(polygon: &mut Vec<Corner>, beyond: Beyond, inside: impl Fn(Vec3) -> f32) {
    let values: Vec<f32> = polygon.iter().map(|corner| inside(corner.place)).collect();
    if values.iter().all(|&value| value >= 0.0) {
        return;
    }
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (k, corner) in polygon.iter().enumerate() {
        let next = (k + 1) % polygon.len();
        let (value, next_value) = (values[k], values[next]);
        if value >= 0.0 {
            kept.push(*corner);
        }
        if (value >= 0.0) != (next_value >= 0.0) {
            let t = value / (value - next_value);
            let way = sub(polygon[next].place, corner.place);
            let place = add(corner.place, scaled(way, t));
            // The edge that is cut is the one after this corner.
            let (before, after) = if value >= 0.0 { (corner.after, beyond) } else { (beyond, corner.after) };
            kept.push(Corner { place, before, after });
        }
    }
    *polygon = kept;
}

/// The points of the same wall around a point, itself among them, and their weights, which add up to 1.
fn around(stage: &Stage, tree: &Tree, i: usize) -> Vec<(u32, f32)> {
    let reach = (AROUND * stage.spacing[i]).powi(2).max(f32::MIN_POSITIVE);
    let mut near = Vec::new();
    tree.visit(&stage.position[i], reach, |j, squared, _| {
        if stage.is_same(i, j) {
            near.push((j as u32, (1.0 - squared / reach).powi(2)));
        }
    });
    near.sort_unstable_by_key(|&(j, _)| j);
    let sum: f32 = near.iter().map(|&(_, weight)| weight).sum();
    near.iter().map(|&(j, weight)| (j, weight / sum)).collect()
}

/// How much light walls beside a point leave it: each wall point in front of it that faces it takes some, by the cosines
/// on both sides.
fn corner(stage: &Stage, tree: &Tree, i: usize) -> f32 {
    let (x, n) = (stage.position[i], stage.normal[i]);
    let reach = CORNER_REACH * stage.spacing[i];
    let mut taken = 0.0;
    let mut add_point = |j: usize, squared: f32| {
        let way = sub(stage.position[j], x);
        let facing = dot(n, way).max(0.0) * (-dot(stage.normal[j], way)).max(0.0);
        let fade = 1.0 - squared / (reach * reach);
        // Nearer than others usually are, a point would count for more than its part of the wall.
        let squared = squared.max(stage.spacing[i].powi(2)).max(f32::MIN_POSITIVE);
        taken += facing / (squared * squared) * fade * fade;
    };
    let mut near = Vec::new();
    tree.visit(&x, reach * reach, |j, squared, _| near.push((j, squared)));
    near.sort_unstable_by_key(|&(j, _)| j);
    near.iter().for_each(|&(j, squared)| add_point(j, squared));
    // A point stands for about a square of the spacing; half the light comes from beyond an inner edge.
    let part = (taken * stage.spacing[i].powi(2) / std::f32::consts::PI * 2.0).min(1.0);
    1.0 - CORNER_DEPTH * part
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a square of side 1 as far apart as those of sampled walls, from an origin along two axes.
    fn square(origin: Vec3, along: [Vec3; 2]) -> Vec<Vec3> {
        let count = 30;
        let at = |i: usize, j: usize| {
            // Off the lattice, as samples are, but on the rim.
            let shift = |i: usize, j: usize| {
                if i.is_multiple_of(count) { 0.0 } else { 0.25 * ((i * 7 + j * 5) % 9) as f32 / 9.0 }
            };
            let part = [(i as f32 + shift(i, j)) / count as f32, (j as f32 + shift(j, i)) / count as f32];
            add(origin, add(scaled(along[0], part[0]), scaled(along[1], part[1])))
        };
        (0..=count).flat_map(|i| (0..=count).map(move |j| at(i, j))).collect()
    }

    fn area(stage: &Stage, of: impl Fn(&Stage, usize) -> bool) -> f32 {
        let cells = (0..stage.triangles.len()).filter(|&t| of(stage, stage.cell[t] as usize));
        let areas = cells.map(|t| {
            let [a, b, c] = stage.triangles[t].map(|v| stage.vertices[v as usize].0);
            let normal = cross(sub(b, a), sub(c, a));
            0.5 * dot(normal, normal).sqrt()
        });
        areas.sum()
    }

    #[test]
    fn cells_share_a_flat_wall_without_gaps_and_overlaps() {
        let position = square([0.0; 3], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]);
        let normal = vec![[0.0, 1.0, 0.0]; position.len()];
        let stage = Stage::new(Walls { position: &position, normal: &normal });
        // Each cell reaches 4 % of the distance over the middle: 8 % of the area.
        let all = area(&stage, |_, _| true);
        assert!((1.0..1.1).contains(&all), "{all}");
        assert!(stage.vertices.iter().all(|(p, _)| p[1].abs() < 1e-6));
        // Float32 rounding of the weights.
        assert!(stage.corner.iter().all(|&open| (open - 1.0).abs() < 1e-5));
        // A property is the mean of those around.
        let smoothed = stage.smoothed(&position.iter().map(|p| p[0]).collect::<Vec<_>>());
        assert!(smoothed.iter().zip(&position).all(|(x, p)| (x - p[0]).abs() < 0.1));
    }

    #[test]
    fn cells_end_at_inner_and_outer_edges() {
        let (right, up, front) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        for (turn, name) in [(1.0, "inner"), (-1.0, "outer")] {
            let mut position = square([0.0; 3], [right, front]);
            let floor = position.len();
            position.extend(square([0.0; 3], [scaled(up, turn), front]));
            let mut normal = vec![up; floor];
            // The upright wall faces the floor's side, or, hanging down, the other one.
            normal.extend(vec![scaled(right, turn); position.len() - floor]);
            // Rows far to the other side keep the box of all points out of it.
            position.push([-3.0, -3.0, -3.0]);
            normal.push(up);
            let stage = Stage::new(Walls { position: &position, normal: &normal });
            let cells_of_floor = |stage: &Stage, cell: usize| stage.normal[cell] == up && cell < floor;
            let found = area(&stage, cells_of_floor);
            let low = stage.triangles.iter().zip(&stage.cell).filter(|(_, cell)| (**cell as usize) < floor);
            let reach = low.flat_map(|(t, _)| t.map(|v| stage.vertices[v as usize].0[0])).fold(0.0, f32::min);
            assert!(reach > -1e-4, "{name}: {reach}");
            assert!(found > 0.95, "{name}: {found}");
        }
    }

    #[test]
    fn a_round_wall_ends_at_its_rim() {
        // A quarter of a pipe around z, 1 m long, up to whose ends few points lie.
        let (mut position, mut normal) = (Vec::new(), Vec::new());
        for (i, k) in (0..20).flat_map(|i| (0..40).map(move |k| (i, k))) {
            let (sine, cosine) = (0.08 * i as f32).sin_cos();
            let z = 0.013 + 0.025 * k as f32 + 0.012 * ((i * 7 + k * 5) % 9) as f32 / 9.0;
            position.push([0.3 * cosine, 0.3 * sine, z]);
            normal.push([-cosine, -sine, 0.0]);
        }
        let stage = Stage::new(Walls { position: &position, normal: &normal });
        let ends = position
            .iter()
            .fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], p| [low.min(p[2]), high.max(p[2])]);
        assert!(stage.first_back > 0 && stage.first_back < stage.triangles.len());
        // Float32 rounding of cuts.
        let beyond = |p: Vec3| (ends[0] - p[2]).max(p[2] - ends[1]) > 1e-5;
        let out: Vec<Vec3> = stage.vertices.iter().map(|(p, _)| *p).filter(|p| beyond(*p)).collect();
        assert!(out.is_empty(), "{out:?}");
    }

    #[test]
    fn a_round_wall_ends_at_an_outer_edge_but_for_what_is_behind_it() {
        // A hump along z that ends at z = 0, and an upright wall below its end, which faces z.
        let (mut position, mut normal) = (Vec::new(), Vec::new());
        for (i, k) in (0..20).flat_map(|i| (0..30).map(move |k| (i, k))) {
            let (sine, cosine) = (0.06 * i as f32 - 0.6).sin_cos();
            let z = 0.003 + 0.025 * k as f32 + 0.012 * ((i * 7 + k * 5) % 9) as f32 / 9.0;
            position.push([0.4 * sine, 0.4 * cosine, -z]);
            normal.push([sine, cosine, 0.0]);
        }
        let hump = position.len();
        for (i, k) in (-8..=8).flat_map(|i| (0..12).map(move |k| (i, k))) {
            let (x, below) = (0.025 * i as f32, 0.003 + 0.025 * k as f32);
            position.push([x, (0.16 - x * x).sqrt() - below, 0.0]);
            normal.push([0.0, 0.0, 1.0]);
        }
        let stage = Stage::new(Walls { position: &position, normal: &normal });
        let reach = |triangles: std::ops::Range<usize>| {
            let of_hump = triangles.filter(|&t| (stage.cell[t] as usize) < hump);
            let corners = of_hump.flat_map(|t| stage.triangles[t]);
            corners.map(|v| stage.vertices[v as usize].0[2]).fold(f32::NEG_INFINITY, f32::max)
        };
        // Float32 rounding of cuts.
        let cells = reach(0..stage.first_back);
        assert!(cells.abs() < 1e-5, "{cells}");
        let behind = reach(stage.first_back..stage.triangles.len());
        assert!(behind > 0.001 && behind < 2.0 * BACK_OUTER * 0.025, "{behind}");
    }

    #[test]
    fn inner_edges_are_darker_and_outer_ones_are_not() {
        let (right, up, front) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        let mut position = square([0.0; 3], [right, front]);
        let floor = position.len();
        position.extend(square([0.0; 3], [up, front]));
        for (turn, is_darker) in [(1.0, true), (-1.0, false)] {
            let mut normal = vec![scaled(up, turn); floor];
            normal.extend(vec![scaled(right, turn); position.len() - floor]);
            let stage = Stage::new(Walls { position: &position, normal: &normal });
            let at_edge =
                (0..floor).filter(|&i| position[i][0] < 0.05 && (0.3..0.7).contains(&position[i][2]));
            let open: Vec<f32> = at_edge.map(|i| stage.corner[i]).collect();
            let mean = open.iter().sum::<f32>() / open.len() as f32;
            assert!(if is_darker { mean < 0.9 } else { mean > 0.99 }, "{mean}");
        }
    }

    #[test]
    fn points_without_neighbours_or_normals_are_no_wall() {
        let position = [[0.0; 3], [1.0, 0.0, 0.0], [f32::NAN, 0.0, 0.0]];
        let stage = Stage::new(Walls { position: &position, normal: &[] });
        assert_eq!((stage.bare.len(), stage.triangles.len()), (2, 0));
        let normal = [[0.0, 1.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0]];
        let stage = Stage::new(Walls { position: &position, normal: &normal });
        assert_eq!((stage.bare.len(), stage.position.len(), stage.triangles.len()), (1, 1, 0));
        assert_eq!(stage.smoothed(&[0.5]), [0.5]);
    }
}

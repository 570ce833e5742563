//! Triangle meshes from OBJ, PLY and STL files, and what the samplers ask of them: area, volume, open edges,
//! which points are inside.
//!
//! Faces keep the direction that the file gives them: the corners of a triangle run counter-clockwise seen
//! from where its normal (b - a) × (c - a) points. Polygons are cut into triangles, corners at equal positions
//! become one vertex, and triangles that touch a vertex twice are left out, so that a surface is closed
//! whatever way its file shares corners. Units are those of the file; a scene takes them for metres.
//!
//! Written are surfaces of liquids ([`Surface`]).

mod crossing;
mod geometry;
mod obj;
mod ply;
mod polygons;
mod stl;
mod surface;

use std::fs;
use std::path::Path;

use rayon::prelude::*;

use crate::{Error, Result};
pub(crate) use crossing::{Crossing, Filling, crossing};
pub(crate) use geometry::{Vec3, cross, distance_to_triangle, dot, scaled, sub};
pub use surface::{Surface, SurfaceFormat};

/// Meshes with more corners than this do not fit the 32-bit indices.
const MAX_CORNERS: usize = u32::MAX as usize;

/// The most strips that triangles are sorted into: so many times the memory of their indices at most.
const MAX_STRIPS: usize = 64;

/// A surface of triangles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Positions of the vertices, metres; no two are equal in a mesh that was loaded.
    pub positions: Vec<[f32; 3]>,
    /// Indices of the corners of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A format of mesh files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Wavefront OBJ.
    Obj,
    /// PLY, ASCII or binary.
    Ply,
    /// STL, ASCII or binary.
    Stl,
}

impl Format {
    /// The format that the file name announces; `None` if its extension is none of ours.
    pub fn from_path(path: &Path) -> Option<Format> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "obj" => Some(Format::Obj),
            "ply" => Some(Format::Ply),
            "stl" => Some(Format::Stl),
            _ => None,
        }
    }
}

impl TriangleMesh {
    /// Reads an OBJ, PLY or STL file; the extension tells which.
    ///
    /// # Errors
    /// `Io` if the file cannot be read, `File` if it is empty, damaged, of another kind or without faces.
    pub fn load(path: impl AsRef<Path>) -> Result<TriangleMesh> {
        let path = path.as_ref();
        let Some(format) = Format::from_path(path) else {
            return Err(Error::file(
                path,
                "not a mesh by its extension, expected .obj, .ply or .stl (particles: key `particles`)",
            ));
        };
        if fs::metadata(path).map_err(Error::io(path))?.is_dir() {
            return Err(Error::file(path, "a directory, expected a mesh file"));
        }
        let bytes = fs::read(path).map_err(Error::io(path))?;
        TriangleMesh::parse(&bytes, format).map_err(|message| Error::file(path, message))
    }

    /// Reads the content of a mesh file. Memory stays proportional to `bytes`, whatever counts they claim.
    ///
    /// # Errors
    /// What is wrong, in one line without the name of the file.
    pub fn parse(bytes: &[u8], format: Format) -> std::result::Result<TriangleMesh, String> {
        if bytes.is_empty() {
            return Err("empty (0 bytes), expected a mesh".into());
        }
        let polygons = match format {
            Format::Obj => obj::parse(bytes)?,
            Format::Ply => ply::parse(bytes)?,
            Format::Stl => stl::parse(bytes)?,
        };
        if polygons.corners.len() > MAX_CORNERS || polygons.positions.len() > MAX_CORNERS {
            return Err(format!("{} corners, at most {MAX_CORNERS} fit", polygons.corners.len()));
        }
        if polygons.ends.is_empty() {
            return Err("no faces, expected a surface of triangles or polygons".into());
        }
        polygons.into_mesh()
    }

    /// The mesh as the text of an OBJ file, to a micrometre.
    pub fn to_obj(&self) -> String {
        obj::format(self)
    }

    /// Makes a mesh of polygons: cuts them into triangles and welds corners at equal positions.
    ///
    /// # Panics
    /// If a polygon names a position that is not there, or is not convex and has more than 10,000 corners.
    pub fn from_polygons<'a>(
        positions: Vec<[f32; 3]>,
        polygons: impl IntoIterator<Item = &'a [u32]>,
    ) -> TriangleMesh {
        let mut result = polygons::Polygons { positions, ..Default::default() };
        for polygon in polygons {
            result.push(polygon.iter().copied());
        }
        result.into_mesh().expect("a polygon of few corners")
    }

    /// The corners of triangle `t`.
    pub(crate) fn corners(&self, t: usize) -> [Vec3; 3] {
        self.triangles[t].map(|v| self.positions[v as usize].map(f64::from))
    }

    /// The area of the surface.
    pub fn area(&self) -> f64 {
        (0..self.triangles.len()).map(|t| self.triangle_area(t)).sum()
    }

    pub(crate) fn triangle_area(&self, t: usize) -> f64 {
        let [a, b, c] = self.corners(t);
        let normal = cross(sub(b, a), sub(c, a));
        0.5 * dot(normal, normal).sqrt()
    }

    /// The volume inside; negative if the faces look inwards, without meaning if the surface is open.
    pub fn volume(&self) -> f64 {
        // Seen from the middle of the bounds: a body far from the origin loses no digits.
        let Some([low, high]) = self.bounds() else { return 0.0 };
        let middle = scaled([0, 1, 2].map(|k| low[k] + high[k]), 0.5);
        let six_volumes = (0..self.triangles.len()).map(|t| {
            let [a, b, c] = self.corners(t).map(|corner| sub(corner, middle));
            dot(a, cross(b, c))
        });
        six_volumes.sum::<f64>() / 6.0
    }

    /// The lowest and the highest coordinates of the corners; `None` without triangles.
    pub fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        (0..self.triangles.len()).flat_map(|t| self.corners(t)).fold(None, |bounds, corner| {
            let [low, high] = bounds.unwrap_or([corner; 2]);
            Some([[0, 1, 2].map(|k| low[k].min(corner[k])), [0, 1, 2].map(|k| high[k].max(corner[k]))])
        })
    }

    /// The number of edges on the rim of a hole: those that an odd number of triangles share. 0 if the
    /// surface is closed.
    pub fn open_edges(&self) -> usize {
        self.edges().iter().filter(|edge| edge.uses % 2 == 1).count()
    }

    /// Whether every edge is used as often in one direction as in the other: the surface is closed and its
    /// faces agree on which side is outside.
    pub fn is_oriented(&self) -> bool {
        self.edges().iter().all(|edge| edge.balance == 0)
    }

    /// The number of edges at which triangles disagree on which side is outside.
    pub fn clashing_edges(&self) -> usize {
        self.edges().iter().filter(|edge| edge.balance.unsigned_abs() as usize > edge.uses % 2).count()
    }

    fn edges(&self) -> Vec<Edge> {
        let mut uses: Vec<(u32, u32, i32)> = Vec::with_capacity(3 * self.triangles.len());
        for &[a, b, c] in &self.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                uses.push(if from < to { (from, to, 1) } else { (to, from, -1) });
            }
        }
        uses.sort_unstable();
        uses.chunk_by(|first, second| (first.0, first.1) == (second.0, second.1))
            .map(|same| Edge { uses: same.len(), balance: same.iter().map(|edge| edge.2).sum() })
            .collect()
    }

    /// Which of the points are inside the closed surface, by the triangles above each.
    pub fn contains(&self, points: &[[f32; 3]]) -> Vec<bool> {
        let Some([low, high]) = self.bounds() else { return vec![false; points.len()] };
        let filling = Filling::of(self);
        // The triangles in strips across z: a point asks those of its strip.
        let strips = ((self.triangles.len() as f64).sqrt() as usize).clamp(1, MAX_STRIPS);
        let strip_of =
            |z: f64| (((z - low[2]) / (high[2] - low[2]) * strips as f64) as usize).min(strips - 1);
        let mut triangles_of = vec![Vec::new(); strips];
        for t in 0..self.triangles.len() {
            let [a, b, c] = self.corners(t).map(|corner| corner[2]);
            for strip in &mut triangles_of[strip_of(a.min(b).min(c))..=strip_of(a.max(b).max(c))] {
                strip.push(t);
            }
        }
        let inside = |point: &[f32; 3]| {
            let point = point.map(f64::from);
            if !(0..3).all(|k| (low[k]..=high[k]).contains(&point[k])) {
                return false;
            }
            let above = triangles_of[strip_of(point[2])]
                .iter()
                .filter_map(|&t| crossing(&self.corners(t), point[0], point[2]))
                .filter(|crossing| crossing.height > point[1]);
            filling.is_inside(above.map(|crossing| crossing.direction).sum())
        };
        points.par_iter().map(inside).collect()
    }

    /// The mesh with every vertex moved.
    pub fn map(&self, place: impl Fn([f64; 3]) -> [f64; 3]) -> TriangleMesh {
        let positions = self.positions.iter().map(|x| place(x.map(f64::from)).map(|x| x as f32)).collect();
        TriangleMesh { positions, triangles: self.triangles.clone() }
    }
}

/// A finite coordinate of a text file.
fn number(word: &str) -> std::result::Result<f32, String> {
    match word.parse::<f32>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("coordinate `{}`, expected a finite number", shorten(word))),
    }
}

/// Foreign text in an error message: what can be printed of it, on one line and not all of it if it is long.
fn shorten(text: &str) -> String {
    const LONGEST: usize = 40;
    let mut short: String =
        text.chars().take(LONGEST).map(|c| if c.is_control() { '?' } else { c }).collect();
    if text.chars().nth(LONGEST).is_some() {
        short.push_str("...");
    }
    short
}

/// How the triangles use an edge.
struct Edge {
    uses: usize,
    /// Uses in one direction less uses in the other.
    balance: i32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::Shape;

    #[test]
    fn unit_cube() {
        let cube = Shape::Box.mesh();
        assert_eq!(cube.positions.len(), 8);
        assert_eq!(cube.triangles.len(), 12);
        assert_eq!(cube.area(), 6.0);
        assert_eq!(cube.volume(), 1.0);
        assert_eq!(cube.open_edges(), 0);
        assert!(cube.is_oriented());
    }

    #[test]
    fn one_face_turned_round_is_closed_but_not_oriented() {
        let mut cube = Shape::Box.mesh();
        cube.triangles[3].swap(0, 1);
        assert_eq!(cube.open_edges(), 0);
        assert!(!cube.is_oriented());
        assert_eq!(cube.clashing_edges(), 3);
        assert_eq!(cube.contains(&[[0.0; 3], [0.6, 0.0, 0.0]]), [true, false]);
    }

    #[test]
    fn points_below_edges_and_corners_are_inside_once() {
        // Straight below the diagonals of the lid and below vertices of the sphere.
        let points = [[0.0, -0.2, 0.0], [0.25, 0.0, 0.25], [0.25, 0.0, -0.25], [0.1, 0.1, 0.0]];
        for shape in [Shape::Box, Shape::Sphere, Shape::Cylinder] {
            assert_eq!(shape.mesh().contains(&points), [true; 4], "{shape:?}");
        }
        let beside = [[0.5001, 0.0, 0.0], [0.0, 0.51, 0.0], [0.0, -0.51, 0.0], [f32::NAN, 0.0, 0.0]];
        assert_eq!(Shape::Box.mesh().contains(&beside), [false; 4]);
    }

    #[test]
    fn overlapping_shells_are_filled_and_cavities_are_not() {
        let cube = Shape::Box.mesh();
        let add = |other: TriangleMesh| {
            let mut both = cube.clone();
            let first = both.positions.len() as u32;
            both.positions.extend(other.positions);
            both.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
            both
        };
        let moved = add(cube.map(|[x, y, z]| [x + 0.5, y + 0.25, z + 0.125]));
        assert_eq!(
            moved.contains(&[[0.25, 0.1, 0.1], [0.8, 0.3, 0.1], [0.8, -0.4, 0.1]]),
            [true, true, false]
        );
        let mut inner = cube.map(|x| x.map(|x| 0.5 * x));
        inner.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(add(inner).contains(&[[0.1, 0.1, 0.1], [0.4, 0.1, 0.1]]), [false, true]);
    }
}

//! From the polygons of a file to a mesh: welding and cutting into triangles.

use std::collections::HashMap;

use super::TriangleMesh;
use super::geometry::{Vec3, cross, dot, scaled, sub};

/// Corners of a polygon that is not convex: searching for ears takes time with the square of their number, some
/// seconds for so many.
const MAX_EAR_CORNERS: usize = 10_000;

/// What a parser makes of a file.
#[derive(Debug, Default)]
pub(super) struct Polygons {
    pub positions: Vec<[f32; 3]>,
    /// The corners of all polygons, one polygon after the other.
    pub corners: Vec<u32>,
    /// Where each polygon ends in `corners`.
    pub ends: Vec<usize>,
}

impl Polygons {
    pub(super) fn push(&mut self, polygon: impl IntoIterator<Item = u32>) {
        self.corners.extend(polygon);
        self.ends.push(self.corners.len());
    }

    /// Welds equal positions, drops vertices without a face and cuts the polygons into triangles.
    ///
    /// # Errors
    /// If a polygon that is not convex has too many corners.
    pub(super) fn into_mesh(self) -> Result<TriangleMesh, String> {
        let mut mesh = TriangleMesh::default();
        let mut vertex_at: HashMap<[u32; 3], u32> = HashMap::new();
        let (mut start, mut polygon) = (0, Vec::new());
        for (number, &end) in self.ends.iter().enumerate() {
            polygon.clear();
            for &corner in &self.corners[start..end] {
                // Adding zero turns -0 into 0, which is the same position.
                let position = self.positions[corner as usize].map(|x| x + 0.0);
                let vertex = *vertex_at.entry(position.map(f32::to_bits)).or_insert_with(|| {
                    mesh.positions.push(position);
                    (mesh.positions.len() - 1) as u32
                });
                if polygon.last() != Some(&vertex) {
                    polygon.push(vertex);
                }
            }
            while polygon.len() > 1 && polygon.first() == polygon.last() {
                polygon.pop();
            }
            let corners = polygon.len();
            if !triangulate(&mut polygon, &mesh.positions, &mut mesh.triangles) {
                return Err(format!(
                    "face {}: {corners} corners and not convex, expected at most {MAX_EAR_CORNERS}",
                    number + 1
                ));
            }
            start = end;
        }
        Ok(mesh)
    }
}

/// Cuts a polygon into triangles with the same direction, and keeps all of its sides: no vertex on a side is
/// lost, or a neighbour's edge would be open. False for one with too many corners.
fn triangulate(polygon: &mut Vec<u32>, positions: &[[f32; 3]], triangles: &mut Vec<[u32; 3]>) -> bool {
    let mut emit = |a: u32, b: u32, c: u32| {
        if a != b && b != c && c != a {
            triangles.push([a, b, c]);
        }
    };
    if polygon.len() > 3 {
        let at = |v: u32| positions[v as usize].map(f64::from);
        let normal = newell_normal(polygon.iter().map(|&v| at(v)));
        let turn = |a: u32, b: u32, c: u32| dot(cross(sub(at(b), at(a)), sub(at(c), at(b))), normal);
        let n = polygon.len();
        let is_reflex = |i: usize| turn(polygon[(i + n - 1) % n], polygon[i], polygon[(i + 1) % n]) < 0.0;
        if (0..n).any(is_reflex) {
            let fits = n <= MAX_EAR_CORNERS;
            if fits {
                clip_ears(polygon, turn, &mut emit);
            }
            return fits;
        }
    }
    for k in 2..polygon.len() {
        emit(polygon[0], polygon[k - 1], polygon[k]);
    }
    true
}

/// Cuts off one ear after the other: a corner that turns left with no other vertex in its triangle. An ear cut
/// off changes its two neighbours only (Eberly, "Triangulation by Ear Clipping"), so that the time grows with
/// the square of the number of corners.
/// `turn(a, b, c)` is positive if the path from a by b to c turns left.
fn clip_ears(
    polygon: &mut Vec<u32>,
    turn: impl Fn(u32, u32, u32) -> f64,
    emit: &mut impl FnMut(u32, u32, u32),
) {
    let corner = |polygon: &[u32], i: usize| {
        let n = polygon.len();
        (polygon[(i + n - 1) % n], polygon[i], polygon[(i + 1) % n])
    };
    let turns_left = |polygon: &[u32], i: usize| {
        let (a, b, c) = corner(polygon, i);
        turn(a, b, c) > 0.0
    };
    let is_ear = |polygon: &[u32], i: usize| {
        let (a, b, c) = corner(polygon, i);
        let covers = |&v: &u32| {
            ![a, b, c].contains(&v) && turn(a, b, v) >= 0.0 && turn(b, c, v) >= 0.0 && turn(c, a, v) >= 0.0
        };
        turns_left(polygon, i) && !polygon.iter().any(covers)
    };
    let mut ears: Vec<bool> = (0..polygon.len()).map(|i| is_ear(polygon, i)).collect();
    while polygon.len() > 3 {
        // A polygon that crosses itself can be without ears: any corner that turns left will do then.
        let ear = ears
            .iter()
            .position(|&is_ear| is_ear)
            .or_else(|| (0..polygon.len()).find(|&i| turns_left(polygon, i)))
            .unwrap_or(0);
        let (a, b, c) = corner(polygon, ear);
        emit(a, b, c);
        polygon.remove(ear);
        ears.remove(ear);
        let n = polygon.len();
        for neighbor in [(ear + n - 1) % n, ear % n] {
            ears[neighbor] = is_ear(polygon, neighbor);
        }
    }
    if let [a, b, c] = polygon[..] {
        emit(a, b, c);
    }
}

/// The sum of the cross products of successive corners, seen from the first one: twice the area, along the
/// mean normal.
fn newell_normal(mut corners: impl Iterator<Item = Vec3>) -> Vec3 {
    let Some(first) = corners.next() else { return [0.0; 3] };
    let (mut previous, mut sum) = ([0.0; 3], [0.0; 3]);
    for corner in corners {
        let offset = sub(corner, first);
        sum = sub(sum, scaled(cross(previous, offset), -1.0));
        previous = offset;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(positions: &[[f32; 3]], polygon: &[u32]) -> TriangleMesh {
        TriangleMesh::from_polygons(positions.to_vec(), [polygon])
    }

    #[test]
    fn hollow_polygons_keep_their_area() {
        // An L, a dart and a comb, none of which is a fan of its first corner.
        let shapes: [(&[[f32; 3]], f64); 3] = [
            (&[[0., 0., 0.], [2., 0., 0.], [2., 1., 0.], [1., 1., 0.], [1., 2., 0.], [0., 2., 0.]], 3.0),
            (&[[0., 0., 0.], [2., -1., 0.], [1., 0., 0.], [2., 1., 0.]], 1.0),
            (
                &[
                    [0., 2., 0.],
                    [0., 0., 0.],
                    [3., 0., 0.],
                    [3., 2., 0.],
                    [2., 2., 0.],
                    [2., 1., 0.],
                    [1., 1., 0.],
                    [1., 2., 0.],
                ],
                5.0,
            ),
        ];
        for (positions, area) in shapes {
            for first in 0..positions.len() as u32 {
                let n = positions.len() as u32;
                let polygon: Vec<u32> = (0..n).map(|k| (first + k) % n).collect();
                let mesh = mesh(positions, &polygon);
                assert_eq!(mesh.triangles.len(), positions.len() - 2);
                // Areas are small integers and halves: exact.
                assert_eq!(mesh.area(), area, "{positions:?} from {first}");
                assert!((0..mesh.triangles.len()).all(|t| {
                    let [a, b, c] = mesh.corners(t);
                    cross(sub(b, a), sub(c, a))[2] >= 0.0
                }));
            }
        }
    }

    #[test]
    fn vertices_on_a_side_stay() {
        let positions = [[0., 0., 0.], [1., 0., 0.], [2., 0., 0.], [2., 2., 0.], [0., 2., 0.]];
        let mesh = mesh(&positions, &[0, 1, 2, 3, 4]);
        assert_eq!(mesh.triangles.len(), 3);
        assert_eq!(mesh.open_edges(), 5);
    }

    #[test]
    fn repeated_corners_are_one() {
        let positions = [[0., 0., 0.], [1., 0., -0.0], [1., 0., 0.], [0., 1., 0.], [5., 5., 5.]];
        let mesh = mesh(&positions, &[0, 1, 2, 3, 0]);
        assert_eq!(mesh.positions.len(), 3);
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
    }
}

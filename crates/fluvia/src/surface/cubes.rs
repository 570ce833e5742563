//! The grid that a surface is cut with, and the mesh that comes of it in an order of its own.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail};
use fluvia_sim::metrics::Bounds;
use splashsurf_lib::mesh::TriMesh3d;
use splashsurf_lib::nalgebra::Vector3;

use super::Params;

/// The grid of cubes: lengths and places in cubes, near to the origin, for float32.
pub struct Cubes {
    /// Of a cube, metres.
    side: f64,
    /// The origin, cubes: a corner, so that the cubes lie at the same places whatever the particles.
    origin: [f64; 3],
}

impl Cubes {
    /// The cubes around particles.
    ///
    /// # Errors
    /// If there are no particles, a position is not finite, or particles are too far apart.
    pub fn around(position: &[[f32; 3]], radius: f32, params: &Params) -> Result<Cubes> {
        let is_lost = |point: &[f32; 3]| !point.iter().all(|x| x.is_finite());
        if let Some(particle) = position.iter().position(is_lost) {
            bail!("the position of particle {particle} is not finite");
        }
        let Bounds { low, high } = Bounds::of(position).context("there are no particles")?;
        let cube = params.cube_size * radius;
        let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
        if extent / cube > MOST_CUBES {
            bail!(
                "particles are {extent} m apart, expected at most {} m for a surface of cubes of {cube} m",
                MOST_CUBES * cube
            );
        }
        let side = f64::from(cube);
        Ok(Cubes { side, origin: low.map(|x| (f64::from(x) / side).floor()) })
    }

    /// A place in cubes.
    pub fn place(&self, metres: [f32; 3]) -> Vector3<f32> {
        Vector3::from_fn(|k, _| (f64::from(metres[k]) / self.side - self.origin[k]) as f32)
    }

    /// A place in metres.
    pub fn metres(&self, cubes: &Vector3<f32>) -> [f32; 3] {
        std::array::from_fn(|k| ((f64::from(cubes[k]) + self.origin[k]) * self.side) as f32)
    }
}

/// The mesh with its vertices in the order of their places, those at one place in that of their triangles, and its
/// triangles in that of their corners.
pub fn ordered(mesh: TriMesh3d<f32>) -> TriMesh3d<f32> {
    let TriMesh3d { vertices, mut triangles } = mesh;
    let mut order: Vec<usize> = (0..vertices.len()).collect();
    order.sort_unstable_by_key(|&v| (key(&vertices[v]), v));
    let is_tied = |i: &usize, k: &usize| key(&vertices[*i]) == key(&vertices[*k]);
    let runs = order.chunk_by(is_tied).filter(|run| run.len() > 1);
    // Around each vertex that has others at its place its triangles, by their other two corners.
    let mut around: BTreeMap<usize, Vec<[[i32; 3]; 2]>> = runs.flatten().map(|&v| (v, Vec::new())).collect();
    if !around.is_empty() {
        for (triangle, k) in triangles.iter().flat_map(|triangle| (0..3).map(move |k| (triangle, k))) {
            if let Some(around) = around.get_mut(&triangle[k]) {
                around.push([1, 2].map(|next| key(&vertices[triangle[(k + next) % 3]])));
            }
        }
        around.values_mut().for_each(|around| around.sort_unstable());
        for run in order.chunk_by_mut(is_tied).filter(|run| run.len() > 1) {
            run.sort_by(|i, k| around[i].cmp(&around[k]));
        }
    }
    let mut place = vec![0; order.len()];
    order.iter().enumerate().for_each(|(new, &old)| place[old] = new);
    for corners in &mut triangles {
        *corners = corners.map(|v| place[v]);
        // The least corner first; turning a triangle does not flip it.
        let least = (0..3).min_by_key(|&k| corners[k]).unwrap_or(0);
        corners.rotate_left(least);
    }
    triangles.sort_unstable();
    TriMesh3d { vertices: order.iter().map(|&old| vertices[old]).collect(), triangles }
}

/// What orders vertices by z, y and x, as `f32::total_cmp` does.
fn key(vertex: &Vector3<f32>) -> [i32; 3] {
    [vertex.z, vertex.y, vertex.x].map(|x| {
        let bits = x.to_bits().cast_signed();
        // Of negative numbers the larger one has the smaller bits.
        bits ^ ((bits >> 31).cast_unsigned() >> 1).cast_signed()
    })
}

/// Cubes in a row beyond which the library's 64-bit cube numbers would not do; float32 has whole numbers far beyond it.
const MOST_CUBES: f32 = 1_048_576.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mesh_has_one_order_whatever_its_vertices_come_in() {
        // A fan around a place where three vertices lie, and a triangle elsewhere.
        let at = |x: f32, y: f32| Vector3::new(x, y, 0.5);
        let outer = [at(1.0, 0.0), at(0.0, 1.0), at(-1.0, 0.0), at(0.0, -1.0)];
        let vertices: Vec<Vector3<f32>> = [&[at(0.0, 0.0); 3][..], &outer].concat();
        let triangles = vec![[0, 3, 4], [1, 4, 5], [2, 5, 6], [0, 1, 4], [2, 1, 5], [4, 5, 6]];
        let expected = ordered(TriMesh3d { vertices: vertices.clone(), triangles: triangles.clone() });
        assert_eq!(expected.triangles.len(), 6);
        // All ways to number the three, and the others backwards.
        for centre in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            let new: Vec<usize> = [&centre[..], &[6, 5, 4, 3]].concat();
            let mut moved = vertices.clone();
            new.iter().zip(&vertices).for_each(|(&new, &vertex)| moved[new] = vertex);
            let mut turned: Vec<[usize; 3]> = triangles.iter().map(|t| t.map(|v| new[v])).collect();
            turned.reverse();
            turned.iter_mut().enumerate().for_each(|(k, triangle)| triangle.rotate_left(k % 3));
            let found = ordered(TriMesh3d { vertices: moved, triangles: turned });
            assert_eq!(
                (found.vertices, found.triangles),
                (expected.vertices.clone(), expected.triangles.clone())
            );
        }
    }

    #[test]
    fn vertices_are_ordered_as_numbers_are() {
        let numbers = [f32::NEG_INFINITY, -2.5, -1.0, -0.0, 0.0, 1e-40, 1.0, 7.5];
        let keys = numbers.map(|x| key(&Vector3::repeat(x)));
        assert!(keys.is_sorted() && keys[3] < keys[4]);
    }
}

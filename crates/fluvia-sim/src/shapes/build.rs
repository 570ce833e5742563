//! How shapes are made: a profile turned around an axis or drawn along one, cells of a grid, a floor of heights.
//! The faces of all look outwards.

use std::f64::consts::TAU;

use super::SEGMENTS;
use crate::mesh::TriangleMesh;

/// Turns a profile of points (radius, y) around the y axis. The outside is to its right.
pub(super) fn revolve(profile: &[[f64; 2]]) -> TriangleMesh {
    let corner = |i: usize, j: usize| {
        let (sin, cos) = (TAU * j as f64 / SEGMENTS as f64).sin_cos();
        let [radius, y] = profile[i];
        [radius * cos, y, radius * sin].map(|x| x as f32)
    };
    let mut quads = Vec::new();
    for i in 0..profile.len() - 1 {
        for j in 0..SEGMENTS {
            let next = (j + 1) % SEGMENTS;
            quads.push(vec![corner(i, j), corner(i + 1, j), corner(i + 1, next), corner(i, next)]);
        }
    }
    from_faces(quads)
}

/// The body between z = -1/2 and z = 1/2 whose cross-section is a counter-clockwise polygon in x and y.
pub(super) fn extrude(profile: &[[f64; 2]]) -> TriangleMesh {
    let corner = |[x, y]: [f64; 2], z: f64| [x, y, z].map(|x| x as f32);
    let mut faces: Vec<Vec<[f32; 3]>> = vec![
        profile.iter().map(|&p| corner(p, 0.5)).collect(),
        profile.iter().rev().map(|&p| corner(p, -0.5)).collect(),
    ];
    for (k, &p) in profile.iter().enumerate() {
        let next = profile[(k + 1) % profile.len()];
        faces.push(vec![corner(p, -0.5), corner(next, -0.5), corner(next, 0.5), corner(p, 0.5)]);
    }
    from_faces(faces)
}

/// A container whose floor is the polyline `floor` in x and y, from x = -1/2 to x = 1/2.
pub(super) fn above(floor: &[[f64; 2]]) -> TriangleMesh {
    let mut profile = floor.to_vec();
    profile.extend([[0.5, 1.0], [-0.5, 1.0]]);
    extrude(&profile)
}

/// A container whose floor has the height `height(x, z)`, in `parts` by `parts` squares.
pub(super) fn above_heights(parts: usize, height: impl Fn(f64, f64) -> f64) -> TriangleMesh {
    let at = |i: usize| i as f64 / parts as f64 - 0.5;
    let floor = |i: usize, k: usize| [at(i), height(at(i), at(k)), at(k)].map(|x| x as f32);
    let lid = |i: usize, k: usize| [at(i), 1.0, at(k)].map(|x| x as f32);
    let mut faces = Vec::new();
    for (i, k) in (0..parts).flat_map(|i| (0..parts).map(move |k| (i, k))) {
        // The squares of the floor are not flat.
        faces.push(vec![floor(i, k), floor(i + 1, k), floor(i + 1, k + 1)]);
        faces.push(vec![floor(i, k), floor(i + 1, k + 1), floor(i, k + 1)]);
        faces.push(vec![lid(i, k), lid(i, k + 1), lid(i + 1, k + 1), lid(i + 1, k)]);
    }
    for i in 0..parts {
        let mut wall = |a: (usize, usize), b: (usize, usize)| {
            faces.push(vec![floor(a.0, a.1), lid(a.0, a.1), lid(b.0, b.1), floor(b.0, b.1)]);
        };
        wall((i, 0), (i + 1, 0));
        wall((i + 1, parts), (i, parts));
        wall((0, i + 1), (0, i));
        wall((parts, i), (parts, i + 1));
    }
    from_faces(faces)
}

/// The ground of height `height(x, z)` over the unit square, in `parts` across x and z: open above, its faces look down.
pub(super) fn ground(parts: [usize; 2], height: impl Fn(f64, f64) -> f64) -> TriangleMesh {
    let at = |i: usize, k: usize| {
        let (x, z) = (i as f64 / parts[0] as f64 - 0.5, k as f64 / parts[1] as f64 - 0.5);
        [x, height(x, z), z].map(|x| x as f32)
    };
    let squares = (0..parts[0]).flat_map(|i| (0..parts[1]).map(move |k| (i, k)));
    let faces = squares.flat_map(|(i, k)| {
        let [a, b, c, d] = [at(i, k), at(i + 1, k), at(i + 1, k + 1), at(i, k + 1)];
        [vec![a, b, c], vec![a, c, d]]
    });
    from_faces(faces.collect())
}

/// The cells (i, j, k) of a grid with the given planes across x, y and z that are `filled`.
pub(super) fn cells(planes: [&[f64]; 3], filled: impl Fn([usize; 3]) -> bool) -> TriangleMesh {
    let count = planes.map(|planes| planes.len() - 1);
    let is_filled = |cell: [isize; 3]| {
        (0..3).all(|a| cell[a] >= 0 && cell[a] < count[a] as isize) && filled(cell.map(|i| i as usize))
    };
    let corner = |index: [usize; 3]| [0, 1, 2].map(|a| planes[a][index[a]] as f32);
    let mut faces = Vec::new();
    for n in 0..count.iter().product() {
        let cell = [n % count[0], n / count[0] % count[1], n / (count[0] * count[1])];
        if !is_filled(cell.map(|i| i as isize)) {
            continue;
        }
        for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
            let mut beside = cell.map(|i| i as isize);
            beside[axis] += 2 * side as isize - 1;
            if is_filled(beside) {
                continue;
            }
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let square = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[du, dv]| {
                let mut index = cell;
                index[axis] += side;
                index[u] += du;
                index[v] += dv;
                corner(index)
            });
            let mut square = square.to_vec();
            if side == 0 {
                square.reverse();
            }
            faces.push(square);
        }
    }
    from_faces(faces)
}

fn from_faces(faces: Vec<Vec<[f32; 3]>>) -> TriangleMesh {
    let corners: Vec<u32> = (0..faces.iter().map(Vec::len).sum::<usize>() as u32).collect();
    let mut rest = &corners[..];
    let polygons: Vec<&[u32]> = faces
        .iter()
        .map(|face| {
            let (polygon, others) = rest.split_at(face.len());
            rest = others;
            polygon
        })
        .collect();
    TriangleMesh::from_polygons(faces.concat(), polygons)
}

//! Built-in shapes, named in scene files: meshes of unit size made by code.
//!
//! Solids (box to torus) are centred on the origin; containers (container to bowl) stand on y = 0 around the
//! y axis. All fit a cube of side 1, so that `scale` is the size in metres. Their faces look outwards: as
//! walls they hold the fluid inside, and with `invert_normals` a solid is an obstacle in it.

use std::f64::consts::{PI, TAU};

use crate::mesh::TriangleMesh;

/// Sides of what is round: the area of its cross-section is 0.3 % less than that of a circle.
const SEGMENTS: usize = 48;
/// Parts of a half circle from pole to pole, as fine as the sides.
const HALF_SEGMENTS: usize = SEGMENTS / 2;
/// The radius of the circle in the middle of the torus' tube, and of the tube: together 1/2.
const TORUS_RADII: (f64, f64) = (0.375, 0.125);

/// A built-in shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// `box`: a cube of side 1.
    Box,
    /// `sphere`: diameter 1.
    Sphere,
    /// `cylinder`: diameter 1, height 1 along y.
    Cylinder,
    /// `cone`: a base of diameter 1, the tip 1 above it.
    Cone,
    /// `torus`: a ring around y, 1 wide, with a tube of diameter 0.25.
    Torus,
    /// `container`: a cube of side 1 that stands on y = 0.
    Container,
    /// `step`: a container whose floor is 1/4 high where x < 0.
    Step,
    /// `ramp`: a container whose floor falls from 1/2 at the side of low x to 0 in the middle.
    Ramp,
    /// `basin`: a container without its lid.
    Basin,
    /// `bowl`: the lower half of a sphere of diameter 1, open above, its lowest point at y = 0.
    Bowl,
}

impl Shape {
    /// All shapes.
    pub const ALL: [Shape; 10] = [
        Shape::Box,
        Shape::Sphere,
        Shape::Cylinder,
        Shape::Cone,
        Shape::Torus,
        Shape::Container,
        Shape::Step,
        Shape::Ramp,
        Shape::Basin,
        Shape::Bowl,
    ];

    /// Its name in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Shape::Box => "box",
            Shape::Sphere => "sphere",
            Shape::Cylinder => "cylinder",
            Shape::Cone => "cone",
            Shape::Torus => "torus",
            Shape::Container => "container",
            Shape::Step => "step",
            Shape::Ramp => "ramp",
            Shape::Basin => "basin",
            Shape::Bowl => "bowl",
        }
    }

    /// The shape of that name.
    pub fn from_name(name: &str) -> Option<Shape> {
        Shape::ALL.into_iter().find(|shape| shape.name() == name)
    }

    /// Its surface.
    pub fn mesh(self) -> TriangleMesh {
        match self {
            Shape::Box => extrude(&[[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]),
            Shape::Sphere => revolve(&half_circle(1.0, 0.0)),
            Shape::Cylinder => revolve(&[[0.0, -0.5], [0.5, -0.5], [0.5, 0.5], [0.0, 0.5]]),
            Shape::Cone => revolve(&[[0.0, -0.5], [0.5, -0.5], [0.0, 0.5]]),
            Shape::Torus => revolve(&tube_circle()),
            Shape::Container => extrude(&[[-0.5, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]]),
            Shape::Step => {
                extrude(&[[-0.5, 0.25], [0.0, 0.25], [0.0, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]])
            }
            Shape::Ramp => extrude(&[[-0.5, 0.5], [0.0, 0.0], [0.5, 0.0], [0.5, 1.0], [-0.5, 1.0]]),
            Shape::Basin => {
                let mut mesh = Shape::Container.mesh();
                let positions = &mesh.positions;
                mesh.triangles.retain(|t| t.iter().any(|&v| positions[v as usize][1] < 1.0));
                mesh
            }
            Shape::Bowl => revolve(&half_circle(0.5, 0.5)),
        }
    }
}

/// The lower `part` of a half circle of diameter 1 from its lower pole upwards, raised by `height`.
fn half_circle(part: f64, height: f64) -> Vec<[f64; 2]> {
    let last = (part * HALF_SEGMENTS as f64) as usize;
    let point = |k: usize| {
        let angle = PI * k as f64 / HALF_SEGMENTS as f64;
        // The poles lie on the axis exactly, so that their corners are one vertex.
        let radius = if k == 0 || k == HALF_SEGMENTS { 0.0 } else { 0.5 * angle.sin() };
        [radius, height - 0.5 * angle.cos()]
    };
    (0..=last).map(point).collect()
}

/// The tube of the torus, closed, from its inner side downwards.
fn tube_circle() -> Vec<[f64; 2]> {
    let (ring, tube) = TORUS_RADII;
    let point = |k: usize| {
        let angle = TAU * (k % HALF_SEGMENTS) as f64 / HALF_SEGMENTS as f64;
        [ring - tube * angle.cos(), -tube * angle.sin()]
    };
    (0..=HALF_SEGMENTS).map(point).collect()
}

/// Turns a profile of points (radius, y) around the y axis. The outside is to its right.
fn revolve(profile: &[[f64; 2]]) -> TriangleMesh {
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
fn extrude(profile: &[[f64; 2]]) -> TriangleMesh {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_are_closed_face_outwards_and_have_their_size() {
        let (ring, tube) = TORUS_RADII;
        let volume = |shape| match shape {
            Shape::Box | Shape::Container => 1.0,
            Shape::Sphere => PI / 6.0,
            Shape::Cylinder => PI / 4.0,
            Shape::Cone => PI / 12.0,
            Shape::Torus => TAU * ring * PI * tube * tube,
            Shape::Step | Shape::Ramp => 0.875,
            Shape::Basin | Shape::Bowl => f64::NAN,
        };
        for shape in Shape::ALL {
            assert_eq!(Shape::from_name(shape.name()), Some(shape));
            let mesh = shape.mesh();
            let [low, high] = mesh.bounds().expect("triangles");
            assert!((0..3).all(|k| low[k] >= -0.5 && high[k] <= 1.0 && high[k] - low[k] <= 1.0), "{shape:?}");
            if !volume(shape).is_nan() {
                assert_eq!(mesh.open_edges(), 0, "{shape:?}");
                assert!(mesh.is_oriented(), "{shape:?}");
                // Polygons of 48 sides lose 0.3 % in each of two directions, 24 sides of the tube 1.2 %.
                assert!((mesh.volume() / volume(shape) - 1.0).abs() < 0.016, "{shape:?} {}", mesh.volume());
            }
        }
        assert_eq!(Shape::Basin.mesh().open_edges(), 4);
        assert_eq!(Shape::Bowl.mesh().open_edges(), SEGMENTS);
        // Half a sphere; its facets lose less than 0.5 % of it.
        assert!((Shape::Bowl.mesh().area() / (PI / 2.0) - 1.0).abs() < 0.005);
        assert_eq!(Shape::from_name("Box"), None);
    }

    #[test]
    fn faces_of_open_shapes_look_away_from_the_inside() {
        for shape in [Shape::Basin, Shape::Bowl] {
            let mesh = shape.mesh();
            for t in 0..mesh.triangles.len() {
                let [a, b, c] = mesh.corners(t);
                let normal = crate::mesh::cross(crate::mesh::sub(b, a), crate::mesh::sub(c, a));
                let middle = [0.0, 0.5, 0.0];
                assert!(crate::mesh::dot(normal, crate::mesh::sub(a, middle)) > 0.0, "{shape:?} {t}");
            }
        }
    }
}

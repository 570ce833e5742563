//! Built-in shapes, named in scene files: meshes of unit size made by code.
//!
//! Solids (box to jack) are centred on the origin; containers (container to course) and landscapes (river, falls) stand
//! on y = 0 around the y axis. All fit a cube of side 1, so that `scale` is the size in metres. Their faces look outwards: as
//! walls they hold the fluid inside, and with `invert_normals` a solid is an obstacle in it.
//!
//! The containers of random scenes and the bodies in them are among these shapes
//! ([`random`](crate::scene::random)); assets/models has them as OBJ files for other programs.

mod build;
mod containers;
mod landscapes;
mod solids;

use crate::mesh::TriangleMesh;
use build::{extrude, revolve};
use solids::{half_circle, tube_circle};

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
    /// `egg`: 1 high along y and about 0.8 wide, its blunt end below.
    Egg,
    /// `elbow`: a cube without a quarter, an L along z.
    Elbow,
    /// `horseshoe`: a flat ring around z, 0.5 thick, open towards +x.
    Horseshoe,
    /// `jack`: three square bars of length 1 across each other.
    Jack,
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
    /// `tank`: an upright prism of eight sides.
    Tank,
    /// `wedge`: a container whose floor falls by 1/10 along x.
    Wedge,
    /// `trough`: a container whose floor is round along x, lowest in the middle.
    Trough,
    /// `ditch`: a container with a trench across its floor.
    Ditch,
    /// `stairs`: a container whose floor has four steps down along x.
    Stairs,
    /// `ridge`: a container with a ridge across its floor.
    Ridge,
    /// `waves`: a container with a wavy floor.
    Waves,
    /// `hill`: a container with a round hill on its floor.
    Hill,
    /// `post`: a container with a square post on its floor.
    Post,
    /// `course`: two rooms with a funnel between them; below it a landing, stairs and a basin.
    Course,
    /// `river`: a valley with a winding river bed that falls along x to a lake; open above.
    River,
    /// `falls`: a cliff between a river bed above and a pool below; open above.
    Falls,
}

/// Every shape and its name in scene files.
const NAMES: [(Shape, &str); 26] = [
    (Shape::Box, "box"),
    (Shape::Sphere, "sphere"),
    (Shape::Cylinder, "cylinder"),
    (Shape::Cone, "cone"),
    (Shape::Torus, "torus"),
    (Shape::Egg, "egg"),
    (Shape::Elbow, "elbow"),
    (Shape::Horseshoe, "horseshoe"),
    (Shape::Jack, "jack"),
    (Shape::Container, "container"),
    (Shape::Step, "step"),
    (Shape::Ramp, "ramp"),
    (Shape::Basin, "basin"),
    (Shape::Bowl, "bowl"),
    (Shape::Tank, "tank"),
    (Shape::Wedge, "wedge"),
    (Shape::Trough, "trough"),
    (Shape::Ditch, "ditch"),
    (Shape::Stairs, "stairs"),
    (Shape::Ridge, "ridge"),
    (Shape::Waves, "waves"),
    (Shape::Hill, "hill"),
    (Shape::Post, "post"),
    (Shape::Course, "course"),
    (Shape::River, "river"),
    (Shape::Falls, "falls"),
];

impl Shape {
    /// All shapes.
    pub const ALL: [Shape; NAMES.len()] = {
        let mut all = [Shape::Box; NAMES.len()];
        let mut i = 0;
        while i < all.len() {
            all[i] = NAMES[i].0;
            i += 1;
        }
        all
    };

    /// Its name in scene files.
    pub fn name(self) -> &'static str {
        NAMES[self as usize].1
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
            Shape::Egg => solids::egg(),
            Shape::Elbow => solids::elbow(),
            Shape::Horseshoe => solids::horseshoe(),
            Shape::Jack => solids::jack(),
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
            Shape::Tank => containers::tank(),
            Shape::Wedge => containers::wedge(),
            Shape::Trough => containers::trough(),
            Shape::Ditch => containers::ditch(),
            Shape::Stairs => containers::stairs(),
            Shape::Ridge => containers::ridge(),
            Shape::Waves => containers::waves(),
            Shape::Hill => containers::hill(),
            Shape::Post => containers::post(),
            Shape::Course => containers::course(),
            Shape::River => landscapes::river(),
            Shape::Falls => landscapes::falls(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::*;

    #[test]
    fn names_are_in_the_order_of_the_shapes() {
        for (i, (shape, name)) in NAMES.into_iter().enumerate() {
            assert_eq!((shape as usize, shape.name(), Shape::from_name(name)), (i, name, Some(shape)));
        }
    }

    #[test]
    fn shapes_are_closed_face_outwards_and_have_their_size() {
        let (ring, tube) = TORUS_RADII;
        let volume = |shape| match shape {
            Shape::Box | Shape::Container => 1.0,
            Shape::Sphere => PI / 6.0,
            Shape::Cylinder => PI / 4.0,
            Shape::Cone => PI / 12.0,
            Shape::Torus => TAU * ring * PI * tube * tube,
            // An ellipsoid of width 0.75, and what it gains by its taper: 0.25² / 5 of that.
            Shape::Egg => PI / 6.0 * 0.75 * 0.75 * (1.0 + 0.0125),
            Shape::Elbow => 0.75,
            Shape::Horseshoe => PI * (0.25 - 0.04) * (5.0 / 6.0) * 0.5,
            Shape::Jack => 3.0 * 0.38 * 0.38 - 2.0 * 0.38 * 0.38 * 0.38,
            Shape::Step | Shape::Ramp => 0.875,
            Shape::Tank => 2.0 * (2.0_f64.sqrt() - 1.0),
            Shape::Wedge => 0.95,
            Shape::Trough => 1.0 - 0.08 / 3.0,
            Shape::Ditch => 1.0 - 0.6 * 0.0625,
            Shape::Stairs => 1.0 - 0.06,
            Shape::Ridge => 1.0 - 0.5 * 0.425 * 0.08,
            Shape::Waves => 0.97,
            // A cosine hill fills (1/2 - 2/π²) of its cylinder.
            Shape::Hill => 1.0 - (0.5 - 2.0 / (PI * PI)) * PI * 0.375 * 0.375 * 0.0875,
            Shape::Post => 1.0 - 0.25 * 0.25 * 0.125,
            // The area of its polygon, square metres.
            Shape::Course => 6.8325 / (3.2 * 3.2),
            Shape::Basin | Shape::Bowl | Shape::River | Shape::Falls => f64::NAN,
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

    /// How far the surface is from convex: the farthest that a corner lies before the plane of a face.
    fn dent(mesh: &TriangleMesh) -> f64 {
        use crate::mesh::{cross, dot, sub};
        let before = |t: usize| {
            let [a, b, c] = mesh.corners(t);
            let normal = cross(sub(b, a), sub(c, a));
            let height = |x: &[f32; 3]| dot(sub(x.map(f64::from), a), normal) / dot(normal, normal).sqrt();
            mesh.positions.iter().map(height).fold(0.0, f64::max)
        };
        (0..mesh.triangles.len()).map(before).fold(0.0, f64::max)
    }

    #[test]
    fn shapes_that_are_called_convex_are_and_the_others_are_not() {
        let convex = [
            Shape::Box,
            Shape::Sphere,
            Shape::Cylinder,
            Shape::Cone,
            Shape::Egg,
            Shape::Ramp,
            Shape::Container,
            Shape::Tank,
            Shape::Wedge,
            Shape::Trough,
        ];
        for shape in Shape::ALL {
            let dent = dent(&shape.mesh());
            // Rounding to float32 on one side; on the other the shallowest floor, of the ditch.
            let is_right = if convex.contains(&shape) { dent < 1e-6 } else { dent > 0.05 };
            assert!(is_right || matches!(shape, Shape::Basin | Shape::Bowl), "{shape:?} {dent}");
        }
    }

    #[test]
    fn models_of_random_scenes_are_closed_and_many_are_not_convex() {
        use crate::scene::random::{BODIES, CONTAINERS};
        for model in CONTAINERS.iter().chain(&BODIES) {
            let mesh = model.shape.mesh();
            assert!(mesh.is_oriented() && mesh.volume() > 0.0, "{model:?}");
        }
        let dented = |models: &[crate::scene::random::Model]| {
            models.iter().filter(|model| dent(&model.shape.mesh()) > 0.05).count()
        };
        assert_eq!((dented(&CONTAINERS), dented(&BODIES)), (6, 3));
    }

    #[test]
    fn landscapes_face_down_and_their_rim_is_the_highest_way_out() {
        for shape in [Shape::River, Shape::Falls] {
            let mesh = shape.mesh();
            let [low, high] = mesh.bounds().expect("triangles");
            assert_eq!((low[1], high[1]), (0.0, 1.0), "{shape:?}");
            for t in 0..mesh.triangles.len() {
                let [a, b, c] = mesh.corners(t);
                let normal = crate::mesh::cross(crate::mesh::sub(b, a), crate::mesh::sub(c, a));
                assert!(normal[1] < 0.0, "{shape:?} {t}");
            }
            // Water that stands at the bottom of the lake and rises finds no way over the rim below this height.
            let least_rim = if shape == Shape::River { 0.99 } else { 0.43 };
            let is_rim = |p: &&[f32; 3]| p[0].abs() > 0.499 || p[2].abs() > 0.499;
            let lowest = mesh.positions.iter().filter(is_rim).map(|p| p[1]).fold(f32::INFINITY, f32::min);
            assert!(lowest > least_rim, "{shape:?} {lowest}");
        }
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

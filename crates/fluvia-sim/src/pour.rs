//! Where a body of fluid can be put into a scene that runs: what a ray meets, and the free place above it.
//!
//! A place is free if every particle of the body
//! - is inside the closed walls that hold fluid and outside those that are obstacles;
//! - keeps a radius from wall particles and nearly a spacing from the fluid, so that nothing is pushed
//!   apart in the first step.
//!
//! Emitters give where fluid may be already, as they do in a scene: a place for one is kept clear of walls and of other
//! emitters, not of the fluid.

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};

use crate::mesh::{TriangleMesh, cross, dot, scaled, sub};
use crate::metrics::Bounds;
use crate::particles::Boundary;
use crate::scene::{Setup, up};
use crate::vector;

/// The least distance between a new particle and a wall particle, in particle radii.
const WALL_CLEARANCE: f32 = 1.0;

/// The least distance between a new particle and the fluid, in particle radii: at rest density the spacing is 1.86.
const FLUID_CLEARANCE: f32 = 1.85;

/// A wall without a surface is met within this distance of its particles, in particle radii: half the widest hole.
const WALL_PARTICLE_REACH: f64 = 1.6;

/// Fluid is met within this distance of its particles, in particle radii: there is no way between those of a lattice.
const FLUID_REACH: f64 = 1.5;

/// How far the next place is tried above or below the one before, in particle radii.
const LIFT: f32 = 1.0;

/// A half line, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts.
    pub origin: [f32; 3],
    /// Where it goes; of any length but zero.
    pub direction: [f32; 3],
}

/// Where a ray meets something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// The point, metres.
    pub point: [f32; 3],
    /// The unit normal of the wall there, into the fluid; none where fluid is met.
    pub normal: Option<[f32; 3]>,
}

/// The walls of a scene as that which bounds free space.
pub struct Room {
    radius: f32,
    walls: Boundary,
    particles: Points,
    bounds: Option<Bounds>,
    /// Against the gravity of the scene: walls that are open are open there.
    up: [f32; 3],
    surfaces: Vec<TriangleMesh>,
    /// Rows of the walls that have no surface.
    bare: Vec<usize>,
    /// Whether each of the surfaces that are closed holds fluid, or is an obstacle.
    holds: Vec<Option<bool>>,
}

impl Room {
    /// The room within the walls of a set-up.
    pub fn new(setup: &Setup) -> Room {
        let walls = setup.boundary.clone();
        let surfaces: Vec<TriangleMesh> =
            setup.walls.iter().filter_map(|wall| wall.surface.clone()).collect();
        let bare = match setup.walls.as_slice() {
            [] => (0..walls.position.len()).collect(),
            walls => walls.iter().filter(|w| w.surface.is_none()).flat_map(|w| w.range.clone()).collect(),
        };
        // Faces look into the fluid: what holds it has its faces inside out.
        let holds = |surface: &TriangleMesh| (surface.open_edges() == 0).then(|| surface.volume() < 0.0);
        Room {
            radius: setup.particle_radius,
            particles: Points::new(&walls.position, WALL_CLEARANCE * setup.particle_radius),
            bounds: Bounds::of(&walls.position),
            up: up(setup.gravity),
            walls,
            holds: surfaces.iter().map(holds).collect(),
            surfaces,
            bare,
        }
    }

    /// The first thing that a ray meets: fluid, or a wall on the side where the fluid is.
    pub fn hit(&self, ray: Ray, fluid: &[[f32; 3]]) -> Option<Hit> {
        let (origin, direction) = (ray.origin.map(f64::from), unit(ray.direction.map(f64::from))?);
        let mut nearest: Option<(f64, Option<[f64; 3]>)> = None;
        let mut meet = |distance: f64, normal: Option<[f64; 3]>| {
            if distance > 0.0 && nearest.is_none_or(|(before, _)| distance < before) {
                nearest = Some((distance, normal));
            }
        };
        let radius = f64::from(self.radius);
        let reach = FLUID_REACH * radius;
        for x in fluid {
            let offset = sub(x.map(f64::from), origin);
            let along = dot(offset, direction);
            let inside = reach * reach - (dot(offset, offset) - along * along);
            if inside > 0.0 {
                meet(along - inside.sqrt(), None);
            }
        }
        for surface in &self.surfaces {
            for t in 0..surface.triangles.len() {
                if let Some((distance, normal)) = meets_triangle(origin, direction, &surface.corners(t)) {
                    meet(distance, Some(normal));
                }
            }
        }
        for &i in &self.bare {
            let (x, normal) = (self.walls.position[i].map(f64::from), self.walls.normal[i].map(f64::from));
            let offset = sub(x, origin);
            let distance = dot(offset, normal) / dot(direction, normal);
            let aside = sub(offset, scaled(direction, distance));
            if dot(direction, normal) < 0.0 && dot(aside, aside) < (WALL_PARTICLE_REACH * radius).powi(2) {
                meet(distance, Some(normal));
            }
        }
        let (distance, normal) = nearest?;
        let point = [0, 1, 2].map(|a| (origin[a] + distance * direction[a]) as f32);
        Some(Hit { point, normal: normal.map(|normal| normal.map(|x| x as f32)) })
    }

    /// How far to move a body, given around the origin, so that it lies in free space off `hit`: at `lift` metres along
    /// `up` (a unit vector) from where it would touch; lower if that is not free, else higher. `None` if no
    /// place is free.
    pub fn place(
        &mut self,
        body: &[[f32; 3]],
        hit: Hit,
        up: [f32; 3],
        lift: f32,
        fluids: &[&[[f32; 3]]],
    ) -> Option<[f32; 3]> {
        let mut occupied = self.around(fluids);
        let away = hit.normal.unwrap_or(up);
        let reach = body.iter().map(|&x| -vector::dot(x, away)).fold(0.0, f32::max);
        let touching = vector::add_scaled(hit.point, reach + 2.0 * self.radius, away);
        let height = self.bounds.map_or(0.0, |Bounds { low, high }| {
            let size = vector::sub(high, low);
            vector::dot(size, size).sqrt()
        });
        let step = LIFT * self.radius;
        let below = (0..=(lift / step) as usize).map(|k| lift - k as f32 * step);
        let above = (1..=((height - lift).max(0.0) / step) as usize).map(|k| lift + k as f32 * step);
        let places = below.chain(above).map(|lift| vector::add_scaled(touching, lift, up));
        places.into_iter().find(|&place| {
            let moved: Vec<_> = body.iter().map(|&x| vector::add(x, place)).collect();
            // What takes longest comes last.
            self.is_clear(&moved)
                && occupied.iter_mut().all(|fluid| !fluid.touch(&moved))
                && self.holds(&moved)
        })
    }

    /// Whether an emitter could give particles there, as far as walls and the positions of other emitters go.
    pub fn allows(&mut self, positions: &[[f32; 3]], others: &[&[[f32; 3]]]) -> bool {
        self.is_clear(positions)
            && self.around(others).iter_mut().all(|other| !other.touch(positions))
            && self.holds(positions)
    }

    /// What new particles are to be kept clear of, for they would be pushed apart.
    fn around(&self, fluids: &[&[[f32; 3]]]) -> Vec<Points> {
        fluids.iter().map(|fluid| Points::new(fluid, FLUID_CLEARANCE * self.radius)).collect()
    }

    /// Whether all are within the bounds of the walls and clear of their particles.
    fn is_clear(&mut self, positions: &[[f32; 3]]) -> bool {
        let Some(mut bounds) = self.bounds else { return true };
        // Above walls that are open there is space too, as high again as they are.
        for (a, up) in self.up.into_iter().enumerate() {
            let more = up * (bounds.high[a] - bounds.low[a]);
            bounds.low[a] += more.min(0.0);
            bounds.high[a] += more.max(0.0);
        }
        positions.iter().all(|x| bounds.contains(*x, 0.0)) && !self.particles.touch(positions)
    }

    /// Whether all are inside the closed walls that hold fluid, if there are any, and outside of obstacles.
    fn holds(&self, positions: &[[f32; 3]]) -> bool {
        let mut held = None;
        for (surface, holds) in self.surfaces.iter().zip(&self.holds) {
            let Some(holds) = holds else { continue };
            let inside = surface.contains(positions);
            if *holds {
                let held = held.get_or_insert_with(|| vec![false; positions.len()]);
                held.iter_mut().zip(inside).for_each(|(held, inside)| *held |= inside);
            } else if inside.contains(&true) {
                return false;
            }
        }
        held.is_none_or(|held| held.iter().all(|held| *held))
    }
}

/// Points that are to be kept clear of.
struct Points {
    grid: Grid,
    clearance: f32,
    neighbors: Neighbors,
}

impl Points {
    fn new(points: &[[f32; 3]], clearance: f32) -> Points {
        let mut grid = Grid::new();
        grid.build(points, clearance);
        Points { grid, clearance, neighbors: Neighbors::default() }
    }

    /// Whether one of the positions is too near to one of them.
    fn touch(&mut self, positions: &[[f32; 3]]) -> bool {
        let radius = Radius::Uniform(self.clearance);
        self.grid.search(positions, radius, &Options::default(), &mut self.neighbors);
        !self.neighbors.indices.is_empty()
    }
}

/// Where a ray meets the front of a triangle: how far along it, and the unit normal (Möller & Trumbore 1997).
fn meets_triangle(
    origin: [f64; 3],
    direction: [f64; 3],
    [a, b, c]: &[[f64; 3]; 3],
) -> Option<(f64, [f64; 3])> {
    let (first, second) = (sub(*b, *a), sub(*c, *a));
    let normal = cross(first, second);
    let facing = -dot(direction, normal);
    if facing <= 0.0 {
        return None;
    }
    let offset = sub(origin, *a);
    let turned = cross(offset, direction);
    let (u, v) = (dot(second, turned) / facing, -dot(first, turned) / facing);
    let is_inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
    Some((dot(offset, normal) / facing, unit(normal)?)).filter(|_| is_inside)
}

fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(v, v).sqrt();
    (length > 0.0 && length.is_finite()).then(|| scaled(v, 1.0 / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    /// A box of 1 m with a ball of 0.4 m in its middle.
    fn room() -> (Room, Setup) {
        const SCENE: &str = r#"{"walls": [
            {"shape": "container"},
            {"shape": "sphere", "scale": 0.4, "translation": [0, 0.5, 0], "invert_normals": true}
        ], "fluids": [{"shape": "box", "scale": 0.2, "translation": [0.3, 0.2, 0.3]}]}"#;
        let setup = Scene::parse(SCENE.as_bytes(), "room.json").unwrap().sample(0).unwrap();
        (Room::new(&setup), setup)
    }

    const UP: [f32; 3] = [0.0, 1.0, 0.0];

    fn down(x: f32, z: f32) -> Ray {
        Ray { origin: [x, 3.0, z], direction: [0.0, -2.0, 0.0] }
    }

    /// 27 particles around the origin.
    fn cube() -> Vec<[f32; 3]> {
        let at = |i: i32| 0.05 * i as f32;
        let cells = (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z])));
        cells.map(|[x, y, z]| [at(x), at(y), at(z)]).collect()
    }

    #[test]
    fn a_ray_passes_the_backs_of_walls() {
        let (room, setup) = room();
        let fluid = &setup.emitters[0].position;
        // Through the lid to the floor, to the ball, to the fluid.
        let floor = room.hit(down(-0.4, -0.4), fluid).unwrap();
        assert!(floor.point[1].abs() < 1e-6 && floor.normal == Some(UP), "{floor:?}");
        // The ball is a polyhedron.
        let ball = room.hit(down(0.0, 0.0), fluid).unwrap();
        assert!((ball.point[1] - 0.7).abs() < 0.002 && ball.normal.unwrap()[1] > 0.99, "{ball:?}");
        let x = fluid[0];
        let met = room.hit(down(x[0], x[2]), fluid).unwrap();
        let highest = fluid.iter().map(|x| x[1]).fold(0.0, f32::max);
        assert!((met.point[1] - highest - 0.0375).abs() < 1e-5 && met.normal.is_none(), "{met:?}");
        // Between four of them.
        let between = room.hit(down(x[0] + 0.025, x[2] + 0.025), fluid).unwrap();
        assert!(between.normal.is_none() && between.point[1] > highest, "{between:?}");
        assert_eq!(room.hit(down(3.0, 0.0), fluid), None);
        assert_eq!(room.hit(Ray { origin: [0.0; 3], direction: [0.0; 3] }, fluid), None);
    }

    #[test]
    fn walls_of_particles_are_met_as_their_surfaces_are() {
        let (_, mut setup) = room();
        setup.walls.clear();
        let room = Room::new(&setup);
        for (x, z) in [(-0.4, -0.4), (0.123, -0.321), (0.4, 0.1)] {
            let floor = room.hit(down(x, z), &[]).unwrap();
            assert!(floor.point[1].abs() < 1e-6 && floor.normal == Some(UP), "{floor:?}");
        }
    }

    #[test]
    fn a_body_is_put_where_it_fits() {
        let (mut room, setup) = room();
        let fluid = setup.emitters[0].position.clone();
        let floor = room.hit(down(-0.3, -0.3), &fluid).unwrap();
        let on_fluid = room.hit(down(fluid[0][0], fluid[0][2]), &fluid).unwrap();
        let mut place = |hit, lift| room.place(&cube(), hit, UP, lift, &[&fluid]);
        // On the floor: half its height, and a spacing.
        let low = place(floor, 0.0).unwrap();
        assert!((low[1] - 0.1).abs() < 1e-6, "{low:?}");
        assert!((place(floor, 0.3).unwrap()[1] - 0.4).abs() < 1e-6);
        // Higher than the lid: as high as there is room.
        let high = place(floor, 2.0).unwrap();
        assert!((0.94..0.976).contains(&(high[1] + 0.05)), "{high:?}");
        // On the fluid, at its corner beside the wall.
        let above = place(on_fluid, 0.0).unwrap();
        let highest = fluid.iter().map(|x| x[1]).fold(0.0, f32::max);
        assert!(above[1] - 0.05 - highest > 0.046, "{above:?}");
        // Under the ball there is less room than the lift asks for.
        let under = Hit { point: [0.0; 3], normal: Some(UP) };
        assert!(place(under, 0.3).unwrap()[1] < 0.25);
        // In the corner of the walls nothing fits at any height.
        let corner = Hit { point: [0.49, 0.0, 0.49], normal: Some(UP) };
        assert_eq!(place(corner, 0.0), None);
    }

    #[test]
    fn outside_and_in_obstacles_there_is_no_room() {
        let (mut room, setup) = room();
        let emitted = setup.emitters[0].position.as_slice();
        assert!(room.allows(emitted, &[]));
        // Where another emitter is there is none for a second.
        assert!(!room.allows(emitted, &[emitted]) && room.allows(emitted, &[&[[-0.3, 0.2, -0.3]]]));
        for x in [[0.0, 0.5, 0.0], [0.0, 1.5, 0.0], [0.6, 0.5, 0.0], [0.0, -0.1, 0.0], [0.49, 0.1, 0.1]] {
            assert!(!room.allows(&[x], &[]), "{x:?}");
        }
        // An open basin has room above it, whatever is up.
        let basin = |keys: &str| {
            let text = format!(
                r#"{{"walls": [{{"shape": "basin"{keys}, "fluids": [{{"shape": "box", "scale": 0.2}}]}}"#
            );
            Scene::parse(text.as_bytes(), "basin.json").unwrap().sample(0).unwrap()
        };
        let upright = basin("}]");
        let mut room = Room::new(&upright);
        assert!(room.allows(&[[0.0, 1.5, 0.0]], &[]) && !room.allows(&[[0.0, 2.5, 0.0]], &[]));
        let turned = r#", "rotation": {"axis": [1, 0, 0], "angle": 90}}], "gravity": [0, 0, -9.81]"#;
        let mut room = Room::new(&basin(turned));
        assert!(room.allows(&[[0.0, 0.0, 1.5]], &[]) && !room.allows(&[[0.0, 1.5, 0.5]], &[]));
        // Without walls there is room everywhere.
        let nothing = Setup { boundary: Boundary::default(), walls: Vec::new(), ..upright };
        assert!(Room::new(&nothing).allows(&[[9.0; 3]], &[]));
    }
}

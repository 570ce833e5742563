//! Which particles are not where a fluid can be.
//!
//! A particle is outside if it lies more than a radius beyond the box around the walls, or more than a radius
//! behind every wall point that is nearly as close as the closest (n·(x - w) < -r with the wall's normal n).

use rayon::prelude::*;

use crate::frame::Walls;
use crate::tree::Tree;
use crate::vector::finite;

/// Tells which particles are outside walls that do not move; made once for all frames.
#[derive(Clone, Debug)]
pub struct OutsideTest {
    tree: Tree,
    position: Vec<[f32; 3]>,
    /// Zeros without normals: then no particle is behind a point.
    normal: Vec<[f32; 3]>,
    /// The box around the walls, grown by a radius, metres.
    low: [f32; 3],
    high: [f32; 3],
    radius: f32,
}

impl OutsideTest {
    /// The test for `walls` and particles of a radius in metres. Without walls nothing is outside, and without
    /// normals only the box counts.
    pub fn new(walls: Walls<'_>, radius: f32) -> OutsideTest {
        let with_normals = walls.normal.len() == walls.position.len();
        let normal = if with_normals { walls.normal.to_vec() } else { vec![[0.0; 3]; walls.position.len()] };
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for point in walls.position.iter().filter(|point| finite(point)) {
            low = std::array::from_fn(|k| low[k].min(point[k] - radius));
            high = std::array::from_fn(|k| high[k].max(point[k] + radius));
        }
        let tree = Tree::new(walls.position);
        OutsideTest { tree, position: walls.position.to_vec(), normal, low, high, radius }
    }

    /// Marks the particles that are outside, those that are not finite among them.
    pub fn mark(&self, position: &[[f32; 3]]) -> Vec<bool> {
        position.par_iter().map(|p| self.is_outside(p)).collect()
    }

    fn is_outside(&self, p: &[f32; 3]) -> bool {
        if !finite(p) || self.tree.is_empty() {
            return !finite(p);
        }
        if (0..3).any(|k| p[k] < self.low[k] || p[k] > self.high[k]) {
            return true;
        }
        // Wall points are about a particle radius apart: at an edge the closest may belong to either side.
        let limit = (self.tree.nearest(p).sqrt() + self.radius).powi(2);
        let mut behind_all = true;
        self.tree.visit(p, limit, |wall, _, limit| {
            let height: f32 = (0..3).map(|k| (p[k] - self.position[wall][k]) * self.normal[wall][k]).sum();
            if height >= -self.radius {
                // One is enough: nothing is nearer than this.
                (behind_all, *limit) = (false, -1.0);
            }
        });
        behind_all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box of 1 m with its lower corner at the origin: points every 4 cm, normals inwards.
    fn tank() -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let (mut position, mut normal) = (Vec::new(), Vec::new());
        for axis in 0..3 {
            for (at, direction) in [(0.0, 1.0), (1.0, -1.0)] {
                for (i, j) in (0..26).flat_map(|i| (0..26).map(move |j| (i, j))) {
                    let mut point = [i as f32 * 0.04, j as f32 * 0.04, at];
                    point.rotate_left(axis);
                    let mut inwards = [0.0, 0.0, direction];
                    inwards.rotate_left(axis);
                    position.push(point);
                    normal.push(inwards);
                }
            }
        }
        (position, normal)
    }

    #[test]
    fn a_tank_keeps_what_is_in_it_and_marks_what_is_not() {
        let (position, normal) = tank();
        let walls = Walls { position: &position, normal: &normal };
        let particles = [
            [0.5, 0.5, 0.5],
            [0.01, 0.01, 0.01],
            [-0.01, 0.5, 0.5],
            [-0.06, 0.5, 0.5],
            [-0.06, -0.06, 0.5],
            [0.5, 1.2, 0.5],
            [f32::NAN, 0.5, 0.5],
            [0.5, f32::INFINITY, 0.5],
        ];
        let expected = [false, false, false, true, true, true, true, true];
        assert_eq!(OutsideTest::new(walls, 0.025).mark(&particles), expected);
    }

    #[test]
    fn a_particle_in_an_obstacle_is_outside_and_one_on_its_edge_is_not() {
        let (mut position, mut normal) = tank();
        // The same box seen from outside, half as large, on the floor: an obstacle.
        let inner: Vec<_> = position.iter().map(|p| [p[0] * 0.5, p[1] * 0.5, p[2] * 0.5]).collect();
        normal.extend(normal.clone().iter().map(|n| n.map(|x| -x)));
        position.extend(inner);
        let walls = Walls { position: &position, normal: &normal };
        let particles = [[0.4, 0.3, 0.3], [0.48, 0.525, 0.25], [0.525, 0.48, 0.25], [0.45, 0.25, 0.25]];
        assert_eq!(OutsideTest::new(walls, 0.025).mark(&particles), [true, false, false, true]);
    }

    #[test]
    fn without_walls_only_what_is_not_finite_is_outside() {
        let particles = [[1e6, 0.0, 0.0], [0.0, 0.0, f32::NAN]];
        assert_eq!(OutsideTest::new(Walls::default(), 0.025).mark(&particles), [false, true]);
    }
}

//! The free space of a container, and where in it a body fits.
//!
//! Space is a grid of nodes of spacing r. A node is free if it is inside and so far from all surfaces and bodies that
//! every point whose nearest node it is keeps a particle spacing 2 r clear of them: the distance of the node is at
//! least 2 r + r √3 / 2.

use super::draw::rounded;
use crate::mesh::{Crossing, Filling, TriangleMesh, crossing, distance_to_triangle};

/// Half the diagonal of a cell, in radii.
const HALF_DIAGONAL: f64 = 0.866_025_5;
/// The distance that is kept clear, in radii: one particle spacing.
const CLEARANCE: f64 = 2.0;
/// What rounding of a translation may take from it, metres.
const SLACK: f64 = 1e-4;

#[derive(Clone)]
pub(super) struct Space {
    /// The lowest and the highest coordinates of free nodes, those taken by bodies included.
    pub low: [f64; 3],
    pub high: [f64; 3],
    /// The position of the first node.
    origin: [f64; 3],
    /// The distance between nodes, metres.
    spacing: f64,
    count: [usize; 3],
    /// By node, y fastest, then z.
    is_free: Vec<bool>,
}

impl Space {
    /// The space inside a closed surface, for particles of `radius` metres.
    pub(super) fn inside(surface: &TriangleMesh, radius: f32) -> Space {
        let spacing = f64::from(radius);
        let [low, high] = surface.bounds().unwrap_or_default();
        let count = [0, 1, 2].map(|k| ((high[k] - low[k]) / spacing) as usize + 1);
        let is_free = vec![false; count.iter().product()];
        // Without free nodes the highest are below the lowest.
        let mut space = Space { low: high, high: low, origin: low, spacing, count, is_free };
        space.fill(surface);
        for t in 0..surface.triangles.len() {
            let corners @ [a, b, c] = surface.corners(t);
            let lowest = [0, 1, 2].map(|k| a[k].min(b[k]).min(c[k]));
            let highest = [0, 1, 2].map(|k| a[k].max(b[k]).max(c[k]));
            space.clear(lowest, highest, |node| distance_to_triangle(node, &corners));
        }
        for (i, k) in (0..count[0]).flat_map(|i| (0..count[2]).map(move |k| (i, k))) {
            for j in 0..count[1] {
                if space.is_free[space.node([i, j, k])] {
                    let node = space.position([i, j, k]);
                    space.low = [0, 1, 2].map(|a| space.low[a].min(node[a]));
                    space.high = [0, 1, 2].map(|a| space.high[a].max(node[a]));
                }
            }
        }
        space
    }

    /// The lowest translation along y, of those that are a whole number of nodes apart, at which a body that is moved
    /// by x and z has free space for all its particles; `None` if there is none.
    pub(super) fn lowest_place(&self, particles: &[[f32; 3]], [x, z]: [f32; 2]) -> Option<f32> {
        let bottom = particles.iter().map(|p| f64::from(p[1])).fold(f64::INFINITY, f64::min);
        // At this translation the lowest particle is at the lowest node.
        let start = self.origin[1] - bottom;
        let mut nodes = Vec::with_capacity(particles.len());
        let mut top = 0;
        for particle in particles {
            let [px, py, pz] = particle.map(f64::from);
            let [i, j, k] = self.nearest([px + f64::from(x), py + start, pz + f64::from(z)])?;
            top = top.max(j);
            nodes.push(self.node([i, j, k]));
        }
        let fits = |raised: &usize| nodes.iter().all(|node| self.is_free[node + raised]);
        let raised = (0..self.count[1] - top).find(fits)?;
        Some(rounded(start + raised as f64 * self.spacing))
    }

    /// Takes the space that a body needs.
    pub(super) fn take(&mut self, particles: &[[f32; 3]]) {
        for particle in particles {
            let x = particle.map(f64::from);
            self.clear(x, x, |node| (0..3).map(|k| (node[k] - x[k]).powi(2)).sum::<f64>().sqrt());
        }
    }

    /// Frees all nodes inside the surface, by the crossings of vertical lines.
    fn fill(&mut self, surface: &TriangleMesh) {
        let filling = Filling::of(surface);
        let mut crossings: Vec<Vec<Crossing>> = vec![Vec::new(); self.count[0] * self.count[2]];
        for t in 0..surface.triangles.len() {
            let corners @ [a, b, c] = surface.corners(t);
            let [xs, zs] =
                [0, 2].map(|k| self.nodes_within(k, a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k])));
            for (i, k) in xs.flat_map(|i| zs.clone().map(move |k| (i, k))) {
                let [x, _, z] = self.position([i, 0, k]);
                crossings[i * self.count[2] + k].extend(crossing(&corners, x, z));
            }
        }
        for (column, crossings) in crossings.iter_mut().enumerate() {
            crossings.sort_by(|a, b| a.height.total_cmp(&b.height));
            let mut winding = 0;
            for pair in crossings.windows(2) {
                winding += pair[0].direction;
                if filling.is_inside(winding) {
                    for j in self.nodes_within(1, pair[0].height, pair[1].height) {
                        self.is_free[column * self.count[1] + j] = true;
                    }
                }
            }
        }
    }

    /// Takes the nodes that are too near to something between `low` and `high`.
    fn clear(&mut self, low: [f64; 3], high: [f64; 3], distance: impl Fn([f64; 3]) -> f64) {
        let reach = (CLEARANCE + HALF_DIAGONAL) * self.spacing + SLACK;
        let [xs, ys, zs] = [0, 1, 2].map(|k| self.nodes_within(k, low[k] - reach, high[k] + reach));
        for i in xs {
            for k in zs.clone() {
                for j in ys.clone() {
                    let node = self.node([i, j, k]);
                    if self.is_free[node] && distance(self.position([i, j, k])) < reach {
                        self.is_free[node] = false;
                    }
                }
            }
        }
    }

    fn node(&self, [i, j, k]: [usize; 3]) -> usize {
        (i * self.count[2] + k) * self.count[1] + j
    }

    fn position(&self, index: [usize; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| self.origin[k] + index[k] as f64 * self.spacing)
    }

    fn nearest(&self, x: [f64; 3]) -> Option<[usize; 3]> {
        let index = [0, 1, 2].map(|k| ((x[k] - self.origin[k]) / self.spacing).round());
        let is_node = |k: usize| index[k] >= 0.0 && index[k] < self.count[k] as f64;
        (0..3).all(is_node).then(|| index.map(|i| i as usize))
    }

    /// The nodes with coordinates from `low` to `high` along an axis.
    fn nodes_within(&self, axis: usize, low: f64, high: f64) -> std::ops::Range<usize> {
        let start = ((low - self.origin[axis]) / self.spacing).ceil().max(0.0) as usize;
        let end = ((high - self.origin[axis]) / self.spacing).floor() + 1.0;
        start..(end.max(0.0) as usize).min(self.count[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::Shape;

    #[test]
    fn a_particle_in_a_cube_keeps_its_distance() {
        // Nodes at multiples of 1/16 from 0 to 1, exactly; 2.87/16 + 0.0001 from the walls are those from 3/16 on.
        let space = Space::inside(&Shape::Container.mesh(), 0.0625);
        assert_eq!(space.count, [17; 3]);
        assert_eq!(space.is_free.iter().filter(|&&free| free).count(), 11 * 11 * 11);
        assert_eq!(space.lowest_place(&[[0.0; 3]], [0.0, 0.25]), Some(0.1875));
        assert_eq!(space.lowest_place(&[[0.0; 3]], [0.0, 0.35]), None);
        assert_eq!(space.lowest_place(&[[0.0; 3]], [0.0, 0.55]), None);
        // Two particles as far apart as there is space, and farther.
        assert_eq!(space.lowest_place(&[[0.0; 3], [0.0, 0.625, 0.0]], [0.0; 2]), Some(0.1875));
        assert_eq!(space.lowest_place(&[[0.0; 3], [0.0, 0.6875, 0.0]], [0.0; 2]), None);
    }

    #[test]
    fn the_lowest_place_is_beside_or_above_what_is_there() {
        let post = Shape::Post.mesh().map(|[x, y, z]| [x, 4.0 * y, z]);
        let mut space = Space::inside(&post, 0.0625);
        // The post is 0.5 high from x = -0.2 to 0.05.
        assert_eq!(space.lowest_place(&[[0.0; 3]], [-0.1, 0.0]), Some(0.6875));
        assert_eq!(space.lowest_place(&[[0.0; 3]], [0.3, 0.0]), Some(0.1875));
        space.take(&[[0.3, 0.1875, 0.0]]);
        // The next is a spacing above: 0.125, and up to the node at which it is certain.
        assert_eq!(space.lowest_place(&[[0.0; 3]], [0.3, 0.0]), Some(0.375));
    }
}

//! The walls as a position constraint: what density alone cannot promise, that nothing passes them.
//!
//! Each wall particle b is a small piece of the plane through x_b with the normal n_b; a fluid particle near
//! it must keep (x - x_b) · n_b >= clearance. Which pieces count near edges is decided by the nearest one:
//! pieces that lie in front of each other's planes form a hollow edge, where both must be kept (the inside
//! of a box); pieces behind each other's planes form a ridge, where one is enough (the outside of a block).

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};

use crate::kernel::{CubicSpline, wall_volumes};
use crate::particles::Boundary;
use crate::vector::{Vector, add_scaled, dot, sub};

/// Planes that one position is held in front of: a corner of a box has three.
const PLANES: usize = 3;

/// Wall particles farther than this from a position do not act on it, in support radii. Samples are about
/// half of that apart, so a position near a wall has some in reach.
const REACH: f32 = 0.5;

/// A piece reaches this far along its plane, in support radii. The middle of the widest hole between samples is nearly
/// as far from them; beyond the edge of a face its plane means nothing.
const PIECE: f32 = 0.375;

/// Two pieces are one plane if they lie this near to each other's, in reaches; the nearer then stands for both.
const FLAT: f32 = 1e-3;

/// A path is walked in pieces of this length, in support radii: a particle cannot be on the far side of a wall before the
/// wall has seen it.
const PATH_PIECE: f32 = 0.125;

/// Pieces of path that one move is checked in at most, so that absurd speeds cost bounded time.
const PATH_PIECES: f32 = 256.0;

/// The search for walls along a particle's way ends here, in support radii: bounds memory at absurd speeds.
pub const MAX_REACH: f32 = 10.0;

/// Wall particles, prepared once.
pub struct Walls {
    pub position: Vec<Vector>,
    normal: Vec<Vector>,
    /// Akinci et al. (2012): what each counts in the density of the fluid, cubic metres.
    pub volume: Vec<f32>,
    grid: Grid,
    /// How far in front of the walls the centres of particles are kept, metres.
    clearance: f32,
    /// Wall particles farther than this from a position do not act on it, metres.
    reach: f32,
    /// How far a piece reaches along its plane, metres.
    piece: f32,
    /// The length of the pieces that a path is walked in, metres.
    path_piece: f32,
}

impl Walls {
    pub fn new(boundary: &Boundary, kernel: &CubicSpline, clearance: f32) -> Walls {
        let mut grid = Grid::new();
        grid.build(&boundary.position, kernel.support());
        Walls {
            position: boundary.position.clone(),
            normal: boundary.normal.clone(),
            volume: wall_volumes(&boundary.position, kernel),
            grid,
            clearance,
            reach: REACH * kernel.support(),
            piece: PIECE * kernel.support(),
            path_piece: PATH_PIECE * kernel.support(),
        }
    }

    /// The wall particles within the radius of each position.
    pub fn search(&mut self, positions: &[Vector], radius: Radius<'_>, neighbors: &mut Neighbors) {
        self.grid.search(positions, radius, &Options::default(), neighbors);
    }

    /// Moves a particle from `start` to `end`, but not through the wall particles `near` the way.
    pub fn travel(&self, start: Vector, end: Vector, near: &[u32]) -> Vector {
        let way = sub(end, start);
        let pieces = (dot(way, way).sqrt() / self.path_piece).ceil().clamp(1.0, PATH_PIECES);
        if near.is_empty() || pieces.is_nan() {
            return end;
        }
        let (mut position, mut touched) = (start, false);
        for _ in 0..pieces as usize {
            let free = add_scaled(position, 1.0 / pieces, way);
            position = self.keep_clear(free, near);
            touched |= position != free;
        }
        if touched { position } else { end }
    }

    /// The position moved to the front of the walls, if it is not there.
    pub fn keep_clear(&self, mut position: Vector, near: &[u32]) -> Vector {
        for _ in 0..PLANES {
            let Some(nearest) = self.nearest(position, near) else {
                return position;
            };
            let Some((normal, depth)) = self.violated_plane(position, nearest, near) else {
                return position;
            };
            position = add_scaled(position, depth, normal);
        }
        position
    }

    /// The squared distance of a wall particle that acts on the position: it is within reach, and its piece of the
    /// wall lies below the position.
    fn acting(&self, position: Vector, b: usize) -> Option<f32> {
        let offset = sub(position, self.position[b]);
        let squared = dot(offset, offset);
        let along = squared - dot(offset, self.normal[b]).powi(2);
        (squared < self.reach * self.reach && along <= self.piece * self.piece).then_some(squared)
    }

    /// The nearest wall particle that acts; the first of `near` among equals.
    fn nearest(&self, position: Vector, near: &[u32]) -> Option<usize> {
        let mut best: Option<(f32, usize)> = None;
        for b in near.iter().map(|&b| b as usize) {
            if let Some(squared) = self.acting(position, b)
                && best.is_none_or(|(least, _)| squared < least)
            {
                best = Some((squared, b));
            }
        }
        best.map(|(_, b)| b)
    }

    /// The plane to move along and how far. On a ridge that is the plane with the shortest way out, in a hollow
    /// the one with the longest.
    fn violated_plane(&self, position: Vector, nearest: usize, near: &[u32]) -> Option<(Vector, f32)> {
        let depth = |b: usize| self.clearance - dot(sub(position, self.position[b]), self.normal[b]);
        let flat = FLAT * self.reach;
        let mut shallowest = (depth(nearest), nearest);
        let mut deepest = (0.0, None);
        for &b in near {
            let b = b as usize;
            if self.acting(position, b).is_none() {
                continue;
            }
            let edge = sub(self.position[b], self.position[nearest]);
            let (ahead, behind) = (dot(edge, self.normal[nearest]), -dot(edge, self.normal[b]));
            if ahead > flat && behind > flat {
                if depth(b) > deepest.0 {
                    deepest = (depth(b), Some(b));
                }
            } else if (ahead < -flat || behind < -flat) && depth(b) < shallowest.0 {
                shallowest = (depth(b), b);
            }
        }
        let (depth, b) = match deepest {
            (depth, Some(b)) if depth > shallowest.0 => (depth, b),
            _ => shallowest,
        };
        (depth > 0.0).then(|| (self.normal[b], depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step seen from above and from its side: y = 0 where x <= 0, and x = 0 where y <= 0.
    fn step() -> Walls {
        let spacing = 0.02;
        let mut boundary = Boundary::default();
        for i in 0..8 {
            for k in -8..8 {
                // Near the edge the nearest piece is one of the side.
                let (along, z) = (-(i as f32) * spacing, k as f32 * spacing);
                boundary.position.extend([[along - 0.03, 0.0, z], [0.0, along - 0.001, z]]);
                boundary.normal.extend([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
            }
        }
        Walls::new(&boundary, &CubicSpline::new(0.1), 0.0125)
    }

    #[test]
    fn on_a_ridge_the_shortest_way_out_is_taken() {
        let walls = step();
        let all: Vec<u32> = (0..walls.position.len() as u32).collect();
        for x in [-0.03, -0.02, -0.012, -0.008, -0.004] {
            for z in [0.0, 0.004, 0.01] {
                // A little too near to the upper face, and far behind the plane of the side.
                let position = [x, 0.01, z];
                assert_eq!(walls.keep_clear(position, &all), [x, 0.0125, z]);
                // Clear of the upper face: the side does not act.
                let position = [x, 0.03, z];
                assert_eq!(walls.keep_clear(position, &all), position);
            }
        }
        // Above the upper face, where of all pieces only one of the side is in reach: it ends far below.
        let position = [-0.005, 0.048, 0.0];
        assert_eq!(walls.keep_clear(position, &all), position);
        // In front of the side, where the upper face has ended.
        let position = [0.042, -0.02, 0.0];
        assert_eq!(walls.keep_clear(position, &all), position);
        // In front of the side, a little too near.
        assert_eq!(walls.keep_clear([0.01, -0.03, 0.0], &all), [0.0125, -0.03, 0.0]);
    }
}

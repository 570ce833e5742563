//! A cubic lattice inside a closed surface.
//!
//! The lattice is centred in the bounding box of the surface, so that a symmetric body gets symmetric
//! particles. Vertical lines through its columns are cut with the surface; between the cuts is the inside.
//! Lattice points too near to the surface are left out, so that a body that touches a wall does not start in
//! it.

use rayon::prelude::*;

use super::{Fault, MAX_FLUID_PARTICLES};
use crate::mesh::{Crossing, Filling, TriangleMesh, crossing, distance_to_triangle};

/// The least distance between a particle and the surface, in spacings (0.55 particle radii). At half a spacing
/// a box would get exactly its volume where its sides are multiples of the spacing, and lose a layer to
/// rounding; at a quarter the number of layers is the size in spacings, rounded, so that boxes of any size
/// have their volume on average. Slightly above a quarter no common size lies where rounding turns.
const MARGIN: f64 = 0.275;

/// The most columns that are cut: a bounding box of 500 m x 500 m at the usual spacing.
const MAX_COLUMNS: f64 = 1e8;

/// The most cuts of triangles with columns that are tried, by the triangles' bounds: the surface of a body of
/// [`MAX_FLUID_PARTICLES`] lies over about 10⁵ columns, twice. More are the work of a file made to take hours.
const MAX_CUTS: f64 = 1e8;

/// Points of a cubic lattice of spacing 2 `radius` (metres) inside a closed mesh, z slowest, then x.
///
/// # Errors
/// If the mesh is open, without area, so small that no particle fits, or takes more than [`MAX_FLUID_PARTICLES`].
pub fn sample_volume(mesh: &TriangleMesh, radius: f32) -> Result<Vec<[f32; 3]>, Fault> {
    let spacing = 2.0 * f64::from(radius);
    let bounds = mesh.bounds().filter(|_| mesh.area() > 0.0).ok_or(Fault::NoArea)?;
    match mesh.open_edges() {
        0 => {}
        edges => return Err(Fault::Open(edges)),
    }
    let size = [0, 1, 2].map(|k| bounds[1][k] - bounds[0][k]);
    let too_small = Fault::TooSmall { size, spacing: 2.0 * radius };
    let too_many = |count| {
        let most = MAX_FLUID_PARTICLES;
        Fault::TooMany { size, count, most, spacing: 2.0 * radius }
    };
    let layers = size.map(|length| (length / spacing + 1.0 - 2.0 * MARGIN).floor());
    if layers.iter().any(|&n| n < 1.0) {
        return Err(too_small);
    }
    let estimate = mesh.volume().abs() / spacing.powi(3);
    if estimate.is_nan() || estimate > MAX_FLUID_PARTICLES as f64 {
        return Err(too_many(estimate));
    }
    if layers[0] * layers[2] > MAX_COLUMNS || layers[1] > MAX_COLUMNS {
        return Err(too_many(layers.iter().product()));
    }
    let first = [0, 1, 2].map(|k| 0.5 * (bounds[0][k] + bounds[1][k] - (layers[k] - 1.0) * spacing));
    let lattice = Lattice::new(mesh, first, spacing, layers.map(|n| n as usize));
    if lattice.cuts() > MAX_CUTS {
        return Err(too_many(layers.iter().product()));
    }
    // The shells of a mesh may cancel in the volume: count before anything is stored.
    let count = lattice.count();
    if count > MAX_FLUID_PARTICLES {
        return Err(too_many(count as f64));
    }
    let points = lattice.points();
    if points.is_empty() { Err(too_small) } else { Ok(points) }
}

struct Lattice {
    triangles: Vec<Triangle>,
    filling: Filling,
    first: [f64; 3],
    spacing: f64,
    layers: [usize; 3],
}

struct Triangle {
    corners: [[f64; 3]; 3],
    low: [f64; 3],
    high: [f64; 3],
}

impl Lattice {
    fn new(mesh: &TriangleMesh, first: [f64; 3], spacing: f64, layers: [usize; 3]) -> Lattice {
        let triangles = (0..mesh.triangles.len()).map(|t| {
            let corners @ [a, b, c] = mesh.corners(t);
            let low = [0, 1, 2].map(|k| a[k].min(b[k]).min(c[k]));
            let high = [0, 1, 2].map(|k| a[k].max(b[k]).max(c[k]));
            Triangle { corners, low, high }
        });
        Lattice { triangles: triangles.collect(), filling: Filling::of(mesh), first, spacing, layers }
    }

    fn coordinate(&self, axis: usize, layer: usize) -> f64 {
        self.first[axis] + layer as f64 * self.spacing
    }

    /// The layers with coordinates from `low` to `high` along an axis.
    fn layers_within(&self, axis: usize, low: f64, high: f64) -> std::ops::Range<usize> {
        let start = ((low - self.first[axis]) / self.spacing).ceil().max(0.0) as usize;
        let end = ((high - self.first[axis]) / self.spacing).floor() + 1.0;
        start..(end.max(0.0) as usize).min(self.layers[axis])
    }

    /// The most cuts of triangles with columns that there can be.
    fn cuts(&self) -> f64 {
        let columns = |t: &Triangle| {
            let [x, z] = [0, 2].map(|k| self.layers_within(k, t.low[k], t.high[k]).len() as f64);
            x * z
        };
        self.triangles.iter().map(columns).sum()
    }

    /// The number of points inside, those near to the surface included.
    fn count(&self) -> u64 {
        let slab = |k| {
            let mut count = 0;
            self.for_each_interval(k, &self.near(k, 0.0), |_, layers| count += layers.len() as u64);
            count
        };
        (0..self.layers[2]).into_par_iter().map(slab).sum()
    }

    fn points(&self) -> Vec<[f32; 3]> {
        let slabs: Vec<_> = (0..self.layers[2]).into_par_iter().map(|k| self.slab(k)).collect();
        slabs.concat()
    }

    /// The particles with z in layer `k`.
    fn slab(&self, k: usize) -> Vec<[f32; 3]> {
        let margin = MARGIN * self.spacing;
        let z = self.coordinate(2, k);
        let near = self.near(k, margin);
        let mut points = Vec::new();
        let mut around: Vec<&Triangle> = Vec::new();
        let mut column = usize::MAX;
        self.for_each_interval(k, &near, |i, layers| {
            let x = self.coordinate(0, i);
            if column != i {
                column = i;
                around.clear();
                around.extend(near.iter().filter(|t| t.low[0] - margin <= x && x <= t.high[0] + margin));
            }
            for j in layers {
                let y = self.coordinate(1, j);
                let touches = |t: &&Triangle| {
                    t.low[1] - margin <= y
                        && y <= t.high[1] + margin
                        && distance_to_triangle([x, y, z], &t.corners) < margin
                };
                if !around.iter().any(touches) {
                    points.push([x, y, z].map(|x| x as f32));
                }
            }
        });
        points
    }

    /// The triangles within `margin` of layer `k` along z.
    fn near(&self, k: usize, margin: f64) -> Vec<&Triangle> {
        let z = self.coordinate(2, k);
        self.triangles.iter().filter(|t| t.low[2] - margin <= z && z <= t.high[2] + margin).collect()
    }

    /// Calls `visit(i, layers)` for each run of lattice points inside, in the columns with z in layer `k`: i is
    /// the column along x, the layers are those along y. `near` has all triangles that reach the layer.
    fn for_each_interval(
        &self,
        k: usize,
        near: &[&Triangle],
        mut visit: impl FnMut(usize, std::ops::Range<usize>),
    ) {
        let z = self.coordinate(2, k);
        let mut cuts: Vec<(usize, Crossing)> = Vec::new();
        for triangle in near {
            for i in self.layers_within(0, triangle.low[0], triangle.high[0]) {
                cuts.extend(crossing(&triangle.corners, self.coordinate(0, i), z).map(|cut| (i, cut)));
            }
        }
        cuts.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.height.total_cmp(&b.1.height)));
        for column in cuts.chunk_by(|a, b| a.0 == b.0) {
            let mut winding = 0;
            for pair in column.windows(2) {
                winding += pair[0].1.direction;
                if self.filling.is_inside(winding) {
                    visit(column[0].0, self.layers_within(1, pair[0].1.height, pair[1].1.height));
                }
            }
        }
    }
}

//! Poisson disks on a surface by weighted sample elimination (Yuksel 2015), with the weights of Open3D.
//!
//! A pool of random points, several times as many as wanted, is thinned out: the point with the largest weight
//!
//! w_i = Σ_j (1 - max(d_ij, r_min) / r_max)⁸  over the points j with d_ij < r_max
//!
//! is removed until n are left. r_max = 2 √(A / (2 √3 n)) is the largest distance that n points on an area A
//! can keep (Eq. 1 in the plane), r_min = 0.65 r_max (1 - (n / m)^1.5) for a pool of m keeps isolated pairs from
//! counting too much (Eq. 3).

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::Rng;

use super::{Fault, MAX_WALL_PARTICLES};
use crate::mesh::{TriangleMesh, cross, dot, scaled, sub};
use crate::particles::Boundary;

/// Points per disk: roughly as many as SPlisHSPlasH's sampling of surfaces, says the published script.
const DENSITY: f64 = 1.9;
/// Size of the pool in wanted points; Yuksel's and Open3D's default.
const POOL: usize = 5;
/// The exponents α and γ of Yuksel's weights, and the factor β: 0.65 as in his code and in effect in Open3D 0.19
/// (the distances to nearest neighbours agree within 0.5 %); the paper has 1/2, which spreads them less evenly.
const ALPHA: i32 = 8;
const BETA: f64 = 0.65;
const GAMMA: f64 = 1.5;

/// The most pairs of points of the pool nearer than r_max; each takes 8 bytes. A surface without folds has
/// [`PAIRS_OF_A_POINT`] for each point, and [`MAX_WALL_PARTICLES`] give 2 · 10⁸.
const MAX_PAIRS: f64 = 2.5e8;
/// The points of the pool in a circle of radius r_max: m / A π r_max² = 2 π m / (√3 n), the point itself included.
const PAIRS_OF_A_POINT: f64 = 2.0 * std::f64::consts::PI / 1.732_050_8 * POOL as f64;
/// So many points of the pool are asked for their pairs to estimate those of all.
const PROBES: usize = 100;

/// The number of points for a surface of that area (square metres): floor(1.9 A / (π r²)).
pub fn surface_count(area: f64, radius: f32) -> f64 {
    (DENSITY * area / (std::f64::consts::PI * f64::from(radius).powi(2))).floor()
}

/// Samples a surface with disks of `radius` metres. The normals are those of the faces, as the mesh has them.
///
/// # Errors
/// If the mesh is without area, so small that it gets no point, takes more than [`MAX_WALL_PARTICLES`], or lies on
/// itself hundreds of times.
pub fn sample_surface(mesh: &TriangleMesh, radius: f32, random: &mut Pcg64) -> Result<Boundary, Fault> {
    let area = mesh.area();
    let bounds = mesh.bounds().filter(|_| area > 0.0).ok_or(Fault::NoArea)?;
    let size = [0, 1, 2].map(|k| bounds[1][k] - bounds[0][k]);
    let count = surface_count(area, radius);
    if count < 1.0 {
        return Err(Fault::TooSmall { size, spacing: 2.0 * radius });
    }
    if count.is_nan() || count > MAX_WALL_PARTICLES as f64 {
        let most = MAX_WALL_PARTICLES;
        return Err(Fault::TooMany { size, count, most, spacing: 2.0 * radius });
    }
    let count = count as usize;
    let pool = random_points(mesh, area, POOL * count, random);
    let r_max = 2.0 * (area / (2.0 * 3.0_f64.sqrt() * count as f64)).sqrt();
    let kept = eliminate(&pool.position, count, r_max)?;
    Ok(Boundary {
        position: kept.iter().map(|&i| pool.position[i]).collect(),
        normal: kept.iter().map(|&i| pool.normal[i]).collect(),
    })
}

/// `count` points, uniform on the surface; each triangle gets its share, rounded.
fn random_points(mesh: &TriangleMesh, area: f64, count: usize, random: &mut Pcg64) -> Boundary {
    let mut points = Boundary::default();
    let mut covered = 0.0;
    for t in 0..mesh.triangles.len() {
        covered += mesh.triangle_area(t);
        let is_last = t + 1 == mesh.triangles.len();
        let end = if is_last { count } else { (count as f64 * covered / area).round() as usize };
        let [a, b, c] = mesh.corners(t);
        let normal = cross(sub(b, a), sub(c, a));
        let length = dot(normal, normal).sqrt();
        if length == 0.0 {
            continue;
        }
        let normal = scaled(normal, 1.0 / length).map(|x| x as f32);
        for _ in points.position.len()..end.min(count) {
            let (s, t) = (uniform(random).sqrt(), uniform(random));
            let weights = [1.0 - s, s * (1.0 - t), s * t];
            let point = [0, 1, 2].map(|k| weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k]);
            points.position.push(point.map(|x| x as f32));
            points.normal.push(normal);
        }
    }
    points
}

/// Uniform in [0, 1) with the 53 bits that an f64 has.
pub(crate) fn uniform(random: &mut Pcg64) -> f64 {
    (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// The indices, ascending, of the `count` points that remain.
fn eliminate(points: &[[f32; 3]], count: usize, r_max: f64) -> Result<Vec<usize>, Fault> {
    let r_min = r_max * BETA * (1.0 - (count as f64 / points.len() as f64).powf(GAMMA));
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    grid.build(points, r_max as f32);
    let pairs = estimate_pairs(&mut grid, points, r_max as f32);
    if pairs > MAX_PAIRS {
        return Err(Fault::Folded { times: pairs / (points.len() as f64 * PAIRS_OF_A_POINT) });
    }
    grid.search(points, Radius::Uniform(r_max as f32), &Options::default(), &mut neighbors);
    let weight = |i: usize, j: usize| {
        let d = sub(points[i].map(f64::from), points[j].map(f64::from));
        let d = dot(d, d).sqrt().clamp(r_min, r_max);
        (1.0 - d / r_max).powi(ALPHA)
    };
    let others = |i: usize| neighbors.row(i).iter().map(|&j| j as usize).filter(move |&j| j != i);
    let mut weights: Vec<f64> = (0..points.len()).map(|i| others(i).map(|j| weight(i, j)).sum()).collect();
    let mut heap: BinaryHeap<Heaviest> =
        weights.iter().enumerate().map(|(index, &weight)| Heaviest { weight, index }).collect();
    let mut is_kept = vec![true; points.len()];
    let mut left = points.len();
    while left > count {
        let Some(top) = heap.pop() else { break };
        // Weights only fall: an entry that is out of date comes back at its present weight.
        if weights[top.index] < top.weight {
            heap.push(Heaviest { weight: weights[top.index], index: top.index });
            continue;
        }
        is_kept[top.index] = false;
        left -= 1;
        for j in others(top.index) {
            weights[j] -= weight(top.index, j);
        }
    }
    Ok((0..points.len()).filter(|&i| is_kept[i]).collect())
}

/// About how many pairs of points are nearer than `r_max`: from a few points, one at a time, because their lists
/// are long if there are many.
fn estimate_pairs(grid: &mut Grid, points: &[[f32; 3]], r_max: f32) -> f64 {
    let mut neighbors = Neighbors::default();
    let stride = points.len().div_ceil(PROBES).max(1);
    let (mut pairs, mut probes) = (0, 0);
    for point in points.iter().step_by(stride) {
        grid.search(&[*point], Radius::Uniform(r_max), &Options::default(), &mut neighbors);
        pairs += neighbors.indices.len();
        probes += 1;
    }
    pairs as f64 / f64::from(probes.max(1)) * points.len() as f64
}

/// An entry of the heap: ordered by weight, then by index, so that the order is total.
struct Heaviest {
    weight: f64,
    index: usize,
}

impl Ord for Heaviest {
    fn cmp(&self, other: &Self) -> Ordering {
        self.weight.total_cmp(&other.weight).then(self.index.cmp(&other.index))
    }
}

impl PartialOrd for Heaviest {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Heaviest {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Heaviest {}

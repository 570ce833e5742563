//! The surface of the liquid that particles stand for: an isosurface of the SPH density, smoothed where the liquid is
//! bulk.
//!
//! ```text
//! positions -> density on a grid -> marching cubes -> clean-up -> weighted Laplacian smoothing -> normals, velocities
//! ```
//!
//! The steps are splashsurf's (Löschner et al. 2023, "Weighted Laplacian Smoothing for Surface Reconstruction of
//! Particle-based Fluids"). A vertex moves to the mean of its neighbours by the weight of the particles around it:
//! w = s(n / n₀), s(x) = x² (3 - 2 x), n_i = Σ_j (1 - |x_i - x_j|² / (2 h)²); n₀ = 13 (h / 2 r)³ is n in the bulk, for
//! smoothing lengths h and particle radii r. So the surface of a pool gets flat, and drops and sheets, which have few
//! neighbours, keep their volume.
//!
//! The same particles give the same bits at any number of threads and processors:
//! - the library makes its grid in subdomains, however small the liquid is; without them its threads add densities in the
//!   order in which they end;
//! - lengths are in cubes, so that the corners of cubes are whole numbers, and without vector instructions, whose sums
//!   depend on where a subdomain begins: a vertex on a border is the same for both sides, whichever comes first;
//! - vertices and triangles, which come in the order of subdomains, are put in one of their own.

mod cubes;
mod walls;

use anyhow::{Context, Result, bail};
use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use fluvia_sim::mesh::{Surface, TriangleMesh};
use rayon::prelude::*;
use splashsurf_lib::mesh::Mesh3d;
use splashsurf_lib::nalgebra::Vector3;
use splashsurf_lib::sph_interpolation::SphInterpolator;
use splashsurf_lib::{
    GridDecompositionParameters, Parameters, SpatialDecomposition, SurfaceReconstruction, postprocessing,
};

use cubes::{Cubes, ordered};
pub use walls::to_walls;

/// How a surface is made of particles.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Surface")]
pub struct Params {
    /// The smoothing length of the density, particle radii: a particle counts up to twice as far away.
    #[arg(long, value_name = "RADII", default_value_t = Params::default().smoothing_length, value_parser = smoothing_length)]
    pub smoothing_length: f32,
    /// The side of the cubes that the surface is cut with, particle radii; half of it takes four times as many
    /// triangles.
    #[arg(long, value_name = "RADII", default_value_t = Params::default().cube_size, value_parser = cube_size)]
    pub cube_size: f32,
    /// The density of the surface, parts of the density at rest.
    #[arg(long, value_name = "PART", default_value_t = Params::default().threshold, value_parser = threshold)]
    pub threshold: f32,
    /// Iterations that smooth the surface; 0 leaves the particles' bumps.
    #[arg(long, value_name = "N", default_value_t = Params::default().smoothing, value_parser = clap::value_parser!(u16).range(0..=1000))]
    pub smoothing: u16,
    /// Iterations that smooth the normals.
    #[arg(long, value_name = "N", default_value_t = Params::default().normal_smoothing, value_parser = clap::value_parser!(u16).range(0..=1000))]
    pub normal_smoothing: u16,
}

impl Default for Params {
    fn default() -> Params {
        Params { smoothing_length: 2.0, cube_size: 0.5, threshold: 0.6, smoothing: 25, normal_smoothing: 10 }
    }
}

/// Parses the side of cubes. Smaller ones than these show nothing more of a liquid and take hours; without any of its
/// corners in a particle it has no surface.
pub fn cube_size(text: &str) -> Result<f32, String> {
    radii(text, 0.2, 10.0)
}

/// Parses a smoothing length. Below these particles two radii apart do not reach each other; above, drops are lost.
fn smoothing_length(text: &str) -> Result<f32, String> {
    radii(text, 1.5, 3.0)
}

/// Parses a length in particle radii.
fn radii(text: &str, least: f32, most: f32) -> Result<f32, String> {
    let number = text.parse().ok().filter(|x| (least..=most).contains(x));
    number.ok_or_else(|| format!("expected a number of particle radii from {least} to {most}"))
}

/// Parses a part of the density at rest. From 1 on the liquid itself would be outside.
fn threshold(text: &str) -> Result<f32, String> {
    let number = text.parse().ok().filter(|x: &f32| *x > 0.0 && *x < 1.0);
    number.ok_or_else(|| "expected a number above 0 and below 1".into())
}

/// The weighted number of neighbours of a particle in the bulk at a smoothing length of two radii: 33 within twice that, of
/// weight 0.4 on average. It goes with the volume.
const BULK_NEIGHBORS: f32 = 13.0;

/// Particle radii in metres: squares of lengths do not overflow.
const RADII: std::ops::RangeInclusive<f32> = 1e-15..=1e15;

/// Iterations of the clean-up, which ends by itself when nothing is left to collapse.
const CLEANUP_ITERATIONS: usize = 5;

/// The surface of the liquid around particles of a radius in metres; without particles one without triangles.
///
/// # Errors
/// If a position is not finite, particles are too far apart for one grid or no lengths, or a vertex is not finite.
pub fn reconstruct(
    position: &[[f32; 3]],
    velocity: Option<&[[f32; 3]]>,
    radius: f32,
    params: &Params,
) -> Result<Surface> {
    if position.is_empty() {
        return Ok(Surface { velocity: velocity.map(|_| Vec::new()), ..Surface::default() });
    }
    if !RADII.contains(&radius) {
        let (least, most) = (RADII.start(), RADII.end());
        bail!("a particle radius of {radius:e} m, expected one from {least:e} to {most:e} m");
    }
    let cubes = Cubes::around(position, radius, params)?;
    let points: Vec<Vector3<f32>> = position.iter().map(|&p| cubes.place(p)).collect();
    let [radius_in_cubes, support] = [1.0, 2.0 * params.smoothing_length].map(|x| x / params.cube_size);
    let subdomains = GridDecompositionParameters { auto_disable: false, ..Default::default() };
    let parameters = Parameters {
        iso_surface_threshold: params.threshold,
        global_neighborhood_list: true,
        enable_simd: false,
        spatial_decomposition: SpatialDecomposition::UniformGrid(subdomains),
        ..Parameters::new(radius_in_cubes, support, 1.0)
    };
    let mut found: SurfaceReconstruction<i64, f32> =
        splashsurf_lib::reconstruct_surface(&points, &parameters).context("the surface")?;
    let mut mesh = ordered(std::mem::take(&mut found.mesh));
    postprocessing::marching_cubes_cleanup(&mut mesh, &found.grid, None, CLEANUP_ITERATIONS, false);

    let densities = found.particle_densities.as_deref().unwrap_or_default();
    let mass = parameters.rest_density * (2.0 * radius_in_cubes).powi(3);
    let interpolator = SphInterpolator::new(&points, densities, mass, support);
    let connectivity = mesh.vertex_vertex_connectivity();
    if params.smoothing > 0 {
        let neighbors = found.particle_neighbors.as_deref().unwrap_or_default();
        let bulk = BULK_NEIGHBORS * (0.5 * params.smoothing_length).powi(3);
        let weights = bulk_weights(&points, neighbors, support, bulk);
        let mut weights = interpolator.interpolate_scalar_quantity(&weights, &mesh.vertices, true);
        // Between cubes wider than particles lie vertices that no particle reaches: no bulk is around them.
        weights.iter_mut().filter(|weight| !weight.is_finite()).for_each(|weight| *weight = 0.0);
        let iterations = params.smoothing.into();
        postprocessing::par_laplacian_smoothing_inplace(&mut mesh, &connectivity, iterations, 1.0, &weights);
    }
    if !mesh.vertices.iter().flatten().all(|x| x.is_finite()) {
        bail!("the surface has a vertex that is not finite");
    }
    let mut normal = mesh.vertex_normal_directions();
    normal.iter_mut().for_each(normalize);
    smooth_normals(&mut normal, &connectivity, params.normal_smoothing);
    let positions: Vec<[f32; 3]> = mesh.vertices.iter().map(|vertex| cubes.metres(vertex)).collect();
    let velocity = velocity.map(|velocity| {
        let of: Vec<Vector3<f32>> = velocity.iter().map(|&v| Vector3::from(v)).collect();
        let at_vertices = interpolator.interpolate_vector_quantity(&of, &mesh.vertices, true);
        let mut at_vertices: Vec<[f32; 3]> = at_vertices.into_iter().map(Into::into).collect();
        fill_velocities(&mut at_vertices, &positions, velocity, position, radius);
        at_vertices
    });
    let triangles = mesh.triangles.into_iter().map(|triangle| triangle.map(|v| v as u32)).collect();
    let normal = normal.into_iter().map(Into::into).collect();
    Ok(Surface { mesh: TriangleMesh { positions, triangles }, normal, velocity })
}

/// For each point of the surface of `position` the particles nearby, with their weights, which add up to 1. None of them is
/// empty, unless `position` is.
pub fn shares(points: &[[f32; 3]], position: &[[f32; 3]], radius: f32) -> Vec<Vec<(usize, f32)>> {
    let mut near = NEAR * radius;
    let mut found = shares_within(near, points, position);
    let mut missing: Vec<usize> = (0..points.len()).collect();
    while !position.is_empty() && near.is_finite() {
        missing.retain(|&q| found[q].is_empty());
        if missing.is_empty() {
            break;
        }
        near *= 2.0;
        let far: Vec<[f32; 3]> = missing.iter().map(|&q| points[q]).collect();
        for (&q, shares) in missing.iter().zip(shares_within(near, &far, position)) {
            found[q] = shares;
        }
    }
    found
}

/// The same of particles that are less than `near` metres away, if there are some.
fn shares_within(near: f32, points: &[[f32; 3]], position: &[[f32; 3]]) -> Vec<Vec<(usize, f32)>> {
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    let options = Options { distances: true, ..Options::default() };
    grid.build(position, near);
    grid.search(points, Radius::Uniform(near), &options, &mut neighbors);
    let shares = |q: usize| {
        let row = neighbors.row_splits[q]..neighbors.row_splits[q + 1];
        let weight = |squared: f32| (1.0 - squared / (near * near)).powi(4);
        let weights = neighbors.distances[row.clone()].iter().map(|&squared| weight(squared));
        let sum: f32 = weights.clone().sum();
        let all = neighbors.indices[row].iter().zip(weights).map(|(&i, w)| (i as usize, w / sum));
        if sum > 0.0 { all.collect() } else { Vec::new() }
    };
    (0..points.len()).map(shares).collect()
}

/// How far from its particles a surface lies at most, particle radii; with room. Of cubes wider than particles it may be
/// farther.
const NEAR: f32 = 4.0;

/// How much of the bulk, `bulk` neighbours, each particle has around it, 0 to 1.
fn bulk_weights(points: &[Vector3<f32>], neighbors: &[Vec<usize>], support: f32, bulk: f32) -> Vec<f32> {
    let weight = |(point, neighbors): (&Vector3<f32>, &Vec<usize>)| {
        let count: f32 = neighbors
            .iter()
            .map(|&other| (1.0 - (points[other] - point).norm_squared() / (support * support)).max(0.0))
            .sum();
        let part = (count / bulk).min(1.0);
        part * part * (3.0 - 2.0 * part)
    };
    points.iter().zip(neighbors).map(weight).collect()
}

/// Gives vertices that no particle reaches, whose velocity is not finite, that of the particles nearest to them.
fn fill_velocities(
    at_vertices: &mut [[f32; 3]],
    at: &[[f32; 3]],
    velocity: &[[f32; 3]],
    position: &[[f32; 3]],
    radius: f32,
) {
    let is_missing = |v: &usize| !at_vertices[*v].iter().all(|x| x.is_finite());
    let missing: Vec<usize> = (0..at.len()).filter(is_missing).collect();
    let points: Vec<[f32; 3]> = missing.iter().map(|&v| at[v]).collect();
    for (&v, shares) in missing.iter().zip(shares(&points, position, radius)) {
        let mean = |k: usize| shares.iter().map(|&(i, share)| share * velocity[i][k]).sum::<f32>();
        at_vertices[v] = std::array::from_fn(mean);
    }
}

/// The least length of the mean of the normals around a vertex that has a direction; below it they cancel out.
const CANCELLED: f32 = 0.1;

/// Makes normals the mean of those around them, again and again. One around which they cancel out, as at the tip of a
/// drop of few triangles, stays.
fn smooth_normals(normal: &mut [Vector3<f32>], connectivity: &[Vec<usize>], iterations: u16) {
    let mut before = normal.to_vec();
    for _ in 0..iterations {
        before.copy_from_slice(normal);
        normal.par_iter_mut().zip(connectivity).for_each(|(normal, around)| {
            let sum = around.iter().fold(Vector3::zeros(), |sum, &other| sum + before[other]);
            let length = sum.norm();
            if length > CANCELLED * around.len() as f32 {
                *normal = sum / length;
            }
        });
    }
}

/// Gives a vector the length 1; one without length, at a vertex whose triangles cancel out, becomes +y.
fn normalize(vector: &mut Vector3<f32>) {
    let length = vector.norm();
    *vector = if length > 0.0 { *vector / length } else { Vector3::new(0.0, 1.0, 0.0) };
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS: f32 = 0.025;

    fn params() -> Params {
        Params::default()
    }

    /// A block of particles at rest, `side` on each side.
    fn block(side: usize, radius: f32) -> Vec<[f32; 3]> {
        let at = |i: usize| 2.0 * radius * i as f32;
        let rows = (0..side).flat_map(|x| (0..side).map(move |y| (x, y)));
        rows.flat_map(|(x, y)| (0..side).map(move |z| [at(x), at(y), at(z)])).collect()
    }

    #[test]
    fn a_block_is_closed_faces_outwards_and_keeps_its_volume() {
        // At any radius: lengths are in radii.
        for radius in [RADIUS, 0.4] {
            let position = block(12, radius);
            let surface = reconstruct(&position, None, radius, &params()).unwrap();
            let mesh = &surface.mesh;
            assert_eq!((mesh.open_edges(), mesh.is_oriented()), (0, true));
            let particles = position.len() as f64 * f64::from(2.0 * radius).powi(3);
            // Edges and corners of the block are rounded.
            let part = mesh.volume() / particles;
            assert!((0.93..1.03).contains(&part), "{part}");
            let middle = 11.0 * radius;
            for (p, n) in mesh.positions.iter().zip(&surface.normal) {
                let outwards: f32 = (0..3).map(|k| (p[k] - middle) * n[k]).sum();
                assert!(outwards > 0.0, "{p:?} {n:?}");
                // Float32 rounding.
                assert!((n.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn smoothing_makes_pools_flat_and_leaves_sheets_at_any_smoothing_length() {
        let sheet: Vec<[f32; 3]> = block(16, RADIUS).into_iter().filter(|p| p[1] == 0.0).collect();
        // A short smoothing length makes bumps of particles, which a sheet loses when it is smoothed.
        for (smoothing_length, most) in [(1.5, 0.08), (2.0, 0.035), (3.0, 0.035)] {
            let made = |position: &[[f32; 3]], smoothing: u16| {
                let params = Params { smoothing_length, smoothing, ..params() };
                reconstruct(position, None, RADIUS, &params).unwrap().mesh
            };
            // What is on top of a block, away from its edges, is flat within a millimetre; its bumps are
            // of three at the shortest length.
            let top = made(&block(12, RADIUS), 25)
                .positions
                .into_iter()
                .filter(|p| p[1] > 0.4 && [p[0], p[2]].iter().all(|x| (0.15..0.4).contains(x)));
            let heights: Vec<f32> = top.map(|p| p[1]).collect();
            assert!(heights.iter().all(|y| (y - heights[0]).abs() < 1e-3), "{smoothing_length}");
            let lost = 1.0 - made(&sheet, 25).volume() / made(&sheet, 0).volume();
            assert!(lost < most, "{smoothing_length}: {lost}");
        }
    }

    #[test]
    fn one_particle_is_a_drop_of_about_its_size() {
        let surface = reconstruct(&[[3.0, -1.0, 0.5]], Some(&[[0.0, 2.0, 0.0]]), RADIUS, &params()).unwrap();
        assert_eq!((surface.mesh.open_edges(), surface.mesh.is_oriented()), (0, true));
        let [low, high] = surface.mesh.bounds().unwrap();
        for k in 0..3 {
            let width = (high[k] - low[k]) as f32;
            assert!((1.5 * RADIUS..3.0 * RADIUS).contains(&width), "{width}");
        }
        for v in surface.velocity.unwrap() {
            assert!((v[1] - 2.0).abs() < 1e-5 && v[0].abs() < 1e-5);
        }
    }

    #[test]
    fn velocities_are_those_of_the_liquid_below() {
        let position = block(8, RADIUS);
        // A rotation about z, which is linear: interpolated at the surface it differs by what is lopsided there.
        let velocity: Vec<_> = position.iter().map(|&[x, y, _]| [-y, x, 0.5]).collect();
        let surface = reconstruct(&position, Some(&velocity), RADIUS, &params()).unwrap();
        for (p, v) in surface.mesh.positions.iter().zip(surface.velocity.unwrap()) {
            assert!((v[0] + p[1]).abs() < 2.0 * RADIUS && (v[1] - p[0]).abs() < 2.0 * RADIUS);
            assert!((v[2] - 0.5).abs() < 1e-4);
        }
    }

    /// Particles off the lattice, as those of liquids are, in a box of a size in metres.
    fn cloud(count: usize, size: [f32; 3]) -> Vec<[f32; 3]> {
        let at = |i: usize, step: f32| (step * i as f32).fract();
        let steps = [0.618_034, 0.754_877, 0.569_84];
        (0..count).map(|i| std::array::from_fn(|k| size[k] * at(i, steps[k]))).collect()
    }

    #[test]
    fn the_same_bits_at_any_number_of_threads() {
        // A liquid smaller than one of the library's subdomains, one that has several, and one that has many.
        for (position, least) in [
            (cloud(1500, [0.4; 3]), 1_000),
            (cloud(4000, [2.0, 0.3, 1.0]), 10_000),
            (cloud(6000, [3.0, 0.2, 2.5]), 50_000),
        ] {
            let velocity: Vec<_> = position.iter().map(|p| p.map(|x| x - 0.5)).collect();
            let with = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| reconstruct(&position, Some(&velocity), RADIUS, &params()).unwrap())
            };
            let one = with(1);
            assert!(one.mesh.triangles.len() > least, "{}", one.mesh.triangles.len());
            for threads in [7, 2, 7, 2, 7, 7, 1] {
                assert!(with(threads) == one, "{} particles on {threads} threads", position.len());
            }
        }
    }

    #[test]
    fn cubes_wider_than_particles_give_finite_numbers() {
        let mut position = cloud(1500, [0.4; 3]);
        // On a corner of the cubes, which the smallest reach is short of otherwise.
        position.push([0.25; 3]);
        let velocity = vec![[1.0, -2.0, 0.5]; position.len()];
        let coarse = Params { cube_size: 5.0, ..params() };
        let (mut with_triangles, mut unreached) = (0, 0);
        for params in [
            Params { threshold: 0.05, ..coarse.clone() },
            Params { smoothing_length: 0.1, ..coarse.clone() },
            Params { smoothing_length: 0.1, threshold: 0.05, smoothing: 1000, ..coarse.clone() },
            Params { smoothing_length: 0.5, threshold: 0.05, cube_size: 1.0, ..params() },
            Params { cube_size: 10.0, ..coarse },
        ] {
            let surface = reconstruct(&position, Some(&velocity), RADIUS, &params).unwrap();
            let numbers = surface.mesh.positions.iter().chain(&surface.normal);
            assert!(numbers.flatten().all(|x| x.is_finite()), "{params:?}");
            for v in surface.velocity.unwrap() {
                // Float32 rounding of a mean of equal numbers.
                assert!((0..3).all(|k| (v[k] - velocity[0][k]).abs() < 1e-4), "{params:?}: {v:?}");
            }
            with_triangles += usize::from(!surface.mesh.triangles.is_empty());
            let support = 2.0 * params.smoothing_length * RADIUS;
            let near = shares_within(support, &surface.mesh.positions, &position);
            unreached += near.iter().filter(|shares| shares.is_empty()).count();
        }
        assert!(
            with_triangles >= 3 && unreached > 10,
            "{with_triangles} with triangles, {unreached} vertices"
        );
    }

    #[test]
    fn normals_of_a_coarse_drop_point_outwards() {
        // On a corner of the grid: an octahedron, around whose tips the normals cancel out.
        let params = Params { cube_size: 2.0, ..params() };
        for center in [[0.0; 3], [0.4, 0.2, -0.1]] {
            let surface = reconstruct(&[center], None, RADIUS, &params).unwrap();
            assert!(!surface.mesh.triangles.is_empty());
            for (p, n) in surface.mesh.positions.iter().zip(&surface.normal) {
                let way: [f32; 3] = std::array::from_fn(|k| p[k] - center[k]);
                let length = way.iter().map(|x| x * x).sum::<f32>().sqrt();
                let cosine = (0..3).map(|k| way[k] * n[k]).sum::<f32>() / length;
                assert!(cosine > 0.7, "{p:?} {n:?}");
            }
        }
    }

    #[test]
    fn shares_add_up_and_the_nearest_counts_most() {
        let position = [[0.0; 3], [0.05, 0.0, 0.0], [1.0, 0.0, 0.0]];
        let found = shares(&[[0.01, 0.02, 0.0], [9.0, 0.0, 0.0]], &position, RADIUS);
        let (first, second) = (found[0][0], found[0][1]);
        assert_eq!((found[0].len(), first.0.min(second.0), first.0.max(second.0)), (2, 0, 1));
        // Float32 rounding.
        assert!((first.1 + second.1 - 1.0).abs() < 1e-6);
        let of = |i: usize| found[0].iter().find(|share| share.0 == i).map(|share| share.1);
        assert!(of(0) > of(1));
        // Far away, where the nearest count too.
        let sum: f32 = found[1].iter().map(|share| share.1).sum();
        assert!((sum - 1.0).abs() < 1e-6 && found[1].iter().any(|share| share.0 == 2), "{:?}", found[1]);
        assert!(shares(&[[0.0; 3]], &[], RADIUS)[0].is_empty());
    }

    #[test]
    fn nothing_is_a_surface_without_triangles_and_bad_numbers_are_errors() {
        assert_eq!(reconstruct(&[], None, RADIUS, &params()).unwrap(), Surface::default());
        let error = reconstruct(&[[0.0; 3], [0.0, f32::NAN, 0.0]], None, RADIUS, &params()).unwrap_err();
        assert!(error.to_string().contains("particle 1"), "{error}");
        for radius in [1e-38, 1e38, f32::INFINITY] {
            let error = reconstruct(&[[0.0; 3]], Some(&[[0.0; 3]]), radius, &params()).unwrap_err();
            assert!(error.to_string().contains("from 1e-15 to 1e15 m"), "{error}");
        }
        let error = reconstruct(&[[0.0; 3], [0.0, 1e9, 0.0]], None, RADIUS, &params()).unwrap_err();
        assert!(error.to_string().contains("1000000000 m apart"), "{error}");
        // Far away, but not too far: two drops.
        let two = reconstruct(&[[0.0; 3], [0.0, 1000.0, 0.0]], None, RADIUS, &params()).unwrap();
        assert_eq!(two.mesh.open_edges(), 0);
    }
}

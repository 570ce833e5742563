//! The surface of the liquid that particles stand for: an isosurface of the SPH density, smoothed where the liquid is
//! bulk.
//!
//! ```text
//! positions -> density on a grid -> marching cubes -> clean-up -> weighted Laplacian smoothing -> normals, velocities
//! ```
//!
//! The steps are splashsurf's (Löschner et al. 2023, "Weighted Laplacian Smoothing for Surface Reconstruction of
//! Particle-based Fluids"). A vertex moves to the mean of its neighbours by the weight of the particles around it:
//! w = s(n / 13), s(x) = x² (3 - 2 x), n_i = Σ_j (1 - |x_i - x_j|² / h²); 13 is n in the bulk. So the surface of a pool
//! gets flat, and drops and sheets, which have few neighbours, keep their volume.
//!
//! The same particles give the same bits at any number of threads: what the library leaves to the order in which its
//! threads end, the order of vertices and triangles, is made one again.

use anyhow::{Result, anyhow, bail};
use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use fluvia_sim::mesh::{Surface, TriangleMesh};
use splashsurf_lib::mesh::{Mesh3d, TriMesh3d};
use splashsurf_lib::nalgebra::Vector3;
use splashsurf_lib::sph_interpolation::SphInterpolator;
use splashsurf_lib::{Parameters, SurfaceReconstruction, postprocessing};

/// How a surface is made of particles.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Surface")]
pub struct Params {
    /// The smoothing length of the density, particle radii: a particle counts up to twice as far away.
    #[arg(long, value_name = "RADII", default_value_t = Params::default().smoothing_length, value_parser = factor)]
    pub smoothing_length: f32,
    /// The side of the cubes that the surface is cut with, particle radii; half of it takes four times as many
    /// triangles.
    #[arg(long, value_name = "RADII", default_value_t = Params::default().cube_size, value_parser = factor)]
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

/// Parses a length in particle radii. Outside of these there is no surface, or no end to its triangles.
pub fn factor(text: &str) -> Result<f32, String> {
    let number = text.parse().ok().filter(|x| (0.1..=10.0).contains(x));
    number.ok_or_else(|| "expected a number of particle radii from 0.1 to 10".into())
}

/// Parses a part of the density at rest. From 1 on the liquid itself would be outside.
fn threshold(text: &str) -> Result<f32, String> {
    let number = text.parse().ok().filter(|x: &f32| *x > 0.0 && *x < 1.0);
    number.ok_or_else(|| "expected a number above 0 and below 1".into())
}

/// Cubes in a row beyond which the library's 64-bit cube numbers would not do.
const MOST_CUBES: f32 = 1_048_576.0;

/// The weighted number of neighbours of a particle in the bulk: 33 within two smoothing lengths of two radii, of weight
/// 0.4 on average.
const BULK_NEIGHBORS: f32 = 13.0;

/// Iterations of the clean-up, which ends by itself when nothing is left to collapse.
const CLEANUP_ITERATIONS: usize = 5;

/// The surface of the liquid around particles of a radius in metres; without particles one without triangles.
///
/// # Errors
/// If a position is not finite, or particles are too far apart for one grid.
pub fn reconstruct(
    position: &[[f32; 3]],
    velocity: Option<&[[f32; 3]]>,
    radius: f32,
    params: &Params,
) -> Result<Surface> {
    if position.is_empty() {
        return Ok(Surface { velocity: velocity.map(|_| Vec::new()), ..Surface::default() });
    }
    check(position, radius, params)?;
    let points: Vec<Vector3<f32>> = position.iter().map(|&p| Vector3::from(p)).collect();
    let support = 2.0 * params.smoothing_length * radius;
    let parameters = Parameters {
        iso_surface_threshold: params.threshold,
        global_neighborhood_list: true,
        ..Parameters::new(radius, support, params.cube_size * radius)
    };
    let mut found: SurfaceReconstruction<i64, f32> =
        splashsurf_lib::reconstruct_surface(&points, &parameters)
            .map_err(|error| anyhow!("the surface: {}", chain(&error)))?;
    let mut mesh = ordered(std::mem::take(&mut found.mesh));
    postprocessing::marching_cubes_cleanup(&mut mesh, &found.grid, None, CLEANUP_ITERATIONS, false);

    let densities = found.particle_densities.as_deref().unwrap_or_default();
    let mass = parameters.rest_density * (2.0 * radius).powi(3);
    let interpolator = SphInterpolator::new(&points, densities, mass, support);
    let connectivity = mesh.vertex_vertex_connectivity();
    if params.smoothing > 0 {
        let neighbors = found.particle_neighbors.as_deref().unwrap_or_default();
        let weights = bulk_weights(&points, neighbors, support);
        let weights = interpolator.interpolate_scalar_quantity(&weights, &mesh.vertices, true);
        let iterations = params.smoothing.into();
        postprocessing::par_laplacian_smoothing_inplace(&mut mesh, &connectivity, iterations, 1.0, &weights);
    }
    let mut normal = mesh.vertex_normal_directions();
    normal.iter_mut().for_each(normalize);
    let iterations = params.normal_smoothing.into();
    postprocessing::par_laplacian_smoothing_normals_inplace(&mut normal, &connectivity, iterations);
    normal.iter_mut().for_each(normalize);
    let velocity = velocity.map(|velocity| {
        let velocity: Vec<Vector3<f32>> = velocity.iter().map(|&v| Vector3::from(v)).collect();
        let at_vertices = interpolator.interpolate_vector_quantity(&velocity, &mesh.vertices, true);
        at_vertices.into_iter().map(Into::into).collect()
    });
    let positions = mesh.vertices.into_iter().map(Into::into).collect();
    let triangles = mesh.triangles.into_iter().map(|triangle| triangle.map(|v| v as u32)).collect();
    let normal = normal.into_iter().map(Into::into).collect();
    Ok(Surface { mesh: TriangleMesh { positions, triangles }, normal, velocity })
}

/// For each point of the surface of `position` the particles nearby, with their weights, which add up to 1.
pub fn shares(points: &[[f32; 3]], position: &[[f32; 3]], radius: f32) -> Vec<Vec<(usize, f32)>> {
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    let (near, options) = (NEAR * radius, Options { distances: true, ..Options::default() });
    grid.build(position, near);
    grid.search(points, Radius::Uniform(near), &options, &mut neighbors);
    let shares = |q: usize| {
        let row = neighbors.row_splits[q]..neighbors.row_splits[q + 1];
        let weight = |squared: f32| (1.0 - squared / (near * near)).powi(4);
        let weights = neighbors.distances[row.clone()].iter().map(|&squared| weight(squared));
        let sum: f32 = weights.clone().sum();
        neighbors.indices[row].iter().zip(weights).map(|(&i, w)| (i as usize, w / sum)).collect()
    };
    (0..points.len()).map(shares).collect()
}

/// How far from its particles a surface lies at most, particle radii; with room.
const NEAR: f32 = 4.0;

/// Draws a surface out to the walls that it is near to, as a liquid wets the glass that it stands in: particles rest
/// more than a radius before a wall, and the surface around them with them. `normal` points into the liquid.
pub fn to_walls(surface: &mut Surface, position: &[[f32; 3]], normal: &[[f32; 3]], radius: f32) {
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    let [gap, reach] = WALL.map(|radii| radii * radius);
    let far = reach.hypot(WALL_BESIDE * radius);
    grid.build(position, far);
    grid.search(&surface.mesh.positions, Radius::Uniform(far), &Options::default(), &mut neighbors);
    let moved = |q: usize| {
        let mut vertex = surface.mesh.positions[q];
        // Of each wall the point that lies straightest below.
        let mut planes: Vec<(f32, usize)> = Vec::new();
        for &wall in neighbors.row(q) {
            let (x, n) = (position[wall as usize], normal[wall as usize]);
            let way: [f32; 3] = std::array::from_fn(|k| vertex[k] - x[k]);
            let height: f32 = (0..3).map(|k| way[k] * n[k]).sum();
            let beside = way.iter().map(|x| x * x).sum::<f32>() - height * height;
            if height > reach || beside > (WALL_BESIDE * radius).powi(2) {
                continue;
            }
            let cosine = |other: usize| (0..3).map(|k| normal[other][k] * n[k]).sum::<f32>();
            match planes.iter_mut().find(|(_, other)| cosine(*other) > SAME_WALL) {
                Some(found) if (beside, wall as usize) < *found => *found = (beside, wall as usize),
                Some(_) => {}
                None => planes.push((beside, wall as usize)),
            }
        }
        for (_, wall) in planes {
            let (x, n) = (position[wall], normal[wall]);
            let height: f32 = (0..3).map(|k| (vertex[k] - x[k]) * n[k]).sum();
            let wanted = ((height - gap) * reach / (reach - gap)).max(0.0);
            // The side that faces the wall alone: what moved as a whole would be flat.
            let facing = -(0..3).map(|k| surface.normal[q][k] * n[k]).sum::<f32>();
            let part = (facing / FACING).clamp(0.0, 1.0);
            vertex = std::array::from_fn(|k| vertex[k] + n[k] * part * (wanted - height));
        }
        vertex
    };
    surface.mesh.positions = (0..surface.mesh.positions.len()).map(moved).collect();
}

/// How far before a wall the surface of what rests there is at most, and up to where it is drawn out for it, particle radii.
const WALL: [f32; 2] = [1.35, 2.4];
/// How far beside a vertex the points of a wall below it may lie, particle radii.
const WALL_BESIDE: f32 = 1.6;
/// The cosine from which on a normal faces a wall.
const FACING: f32 = 0.6;
/// The cosine from which on two wall points belong to one wall.
const SAME_WALL: f32 = 0.7;

fn check(position: &[[f32; 3]], radius: f32, params: &Params) -> Result<()> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (particle, point) in position.iter().enumerate() {
        if !point.iter().all(|x| x.is_finite()) {
            bail!("the position of particle {particle} is not finite");
        }
        low = std::array::from_fn(|k| low[k].min(point[k]));
        high = std::array::from_fn(|k| high[k].max(point[k]));
    }
    let cube = params.cube_size * radius;
    let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f32::max);
    if extent / cube > MOST_CUBES {
        bail!(
            "particles are {extent} m apart, expected at most {} m for a surface of cubes of {cube} m",
            MOST_CUBES * cube
        );
    }
    Ok(())
}

/// The mesh with its vertices in the order of their positions and its triangles in that of their corners.
fn ordered(mesh: TriMesh3d<f32>) -> TriMesh3d<f32> {
    let mut order: Vec<usize> = (0..mesh.vertices.len()).collect();
    order.sort_unstable_by(|&a, &b| {
        let (a, b) = (&mesh.vertices[a], &mesh.vertices[b]);
        a.z.total_cmp(&b.z).then(a.y.total_cmp(&b.y)).then(a.x.total_cmp(&b.x))
    });
    let mut place = vec![0; order.len()];
    order.iter().enumerate().for_each(|(new, &old)| place[old] = new);
    let mut triangles: Vec<[usize; 3]> = mesh
        .triangles
        .iter()
        .map(|triangle| {
            // The least corner first; turning a triangle does not flip it.
            let mut corners = triangle.map(|v| place[v]);
            let least = (0..3).min_by_key(|&k| corners[k]).unwrap_or(0);
            corners.rotate_left(least);
            corners
        })
        .collect();
    triangles.sort_unstable();
    TriMesh3d { vertices: order.iter().map(|&old| mesh.vertices[old]).collect(), triangles }
}

/// How much of the bulk each particle has around it, 0 to 1.
fn bulk_weights(points: &[Vector3<f32>], neighbors: &[Vec<usize>], support: f32) -> Vec<f32> {
    let weight = |(point, neighbors): (&Vector3<f32>, &Vec<usize>)| {
        let count: f32 = neighbors
            .iter()
            .map(|&other| (1.0 - (points[other] - point).norm_squared() / (support * support)).max(0.0))
            .sum();
        let part = (count / BULK_NEIGHBORS).min(1.0);
        part * part * (3.0 - 2.0 * part)
    };
    points.iter().zip(neighbors).map(weight).collect()
}

/// Gives a vector the length 1; one without length, at a vertex whose triangles cancel out, becomes +y.
fn normalize(vector: &mut Vector3<f32>) {
    let length = vector.norm();
    *vector = if length > 0.0 { *vector / length } else { Vector3::new(0.0, 1.0, 0.0) };
}

/// An error and its causes in one line.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
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

    #[test]
    fn the_same_bits_at_any_number_of_threads() {
        // Wide enough for several of the library's subdomains; off the lattice, as liquids are.
        let mut position: Vec<[f32; 3]> = Vec::new();
        for i in 0..4000 {
            let at = |step: f32| (step * i as f32).fract();
            position.push([2.0 * at(0.618_034), 0.3 * at(0.754_877), at(0.569_84)]);
        }
        let velocity: Vec<_> = position.iter().map(|p| p.map(|x| x - 0.5)).collect();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| reconstruct(&position, Some(&velocity), RADIUS, &params()).unwrap())
        };
        let one = with(1);
        assert!(one.mesh.triangles.len() > 10_000);
        assert!((0..3).all(|_| with(2) == one) && with(7) == one);
    }

    #[test]
    fn a_surface_is_drawn_out_to_the_walls_that_it_rests_at_and_nowhere_else() {
        // A block that rests 1.8 radii above a floor, as liquids do, and far from a wall at its side.
        let position: Vec<[f32; 3]> =
            block(8, RADIUS).into_iter().map(|[x, y, z]| [x, y + 1.8 * RADIUS, z]).collect();
        let flat = (-10..40).flat_map(|i| (-10..40).map(move |k| (0.03 * i as f32, 0.03 * k as f32)));
        let floor = flat.clone().map(|(x, z)| ([x, 0.0, z], [0.0, 1.0, 0.0]));
        let side = flat.map(|(y, z)| ([-0.2, y, z], [1.0, 0.0, 0.0]));
        let (wall, normal): (Vec<_>, Vec<_>) = floor.chain(side).unzip();
        let mut surface = reconstruct(&position, None, RADIUS, &params()).unwrap();
        let before = surface.clone();
        to_walls(&mut surface, &wall, &normal, RADIUS);
        assert_eq!((surface.mesh.open_edges(), surface.mesh.is_oriented()), (0, true));
        let [low, high] = surface.mesh.bounds().unwrap();
        let [low_before, high_before] = before.mesh.bounds().unwrap();
        assert!(low_before[1] > 0.5 * f64::from(RADIUS));
        // At the floor, and not below it.
        assert!(low[1].abs() < 1e-6, "{low:?}");
        let at_floor = surface.mesh.positions.iter().filter(|p| p[1] < 1e-6).count();
        assert!(at_floor > 500, "{at_floor}");
        assert!((low[0], high) == (low_before[0], high_before), "what is not near stays");
    }

    #[test]
    fn shares_add_up_and_the_nearest_counts_most() {
        let position = [[0.0; 3], [0.05, 0.0, 0.0], [1.0, 0.0, 0.0]];
        let found = shares(&[[0.01, 0.02, 0.0], [9.0; 3]], &position, RADIUS);
        let (first, second) = (found[0][0], found[0][1]);
        assert_eq!((found[0].len(), first.0.min(second.0), first.0.max(second.0)), (2, 0, 1));
        // Float32 rounding.
        assert!((first.1 + second.1 - 1.0).abs() < 1e-6);
        let of = |i: usize| found[0].iter().find(|share| share.0 == i).map(|share| share.1);
        assert!(of(0) > of(1));
        assert!(found[1].is_empty());
    }

    #[test]
    fn nothing_is_a_surface_without_triangles_and_bad_numbers_are_errors() {
        assert_eq!(reconstruct(&[], None, RADIUS, &params()).unwrap(), Surface::default());
        let error = reconstruct(&[[0.0; 3], [0.0, f32::NAN, 0.0]], None, RADIUS, &params()).unwrap_err();
        assert!(error.to_string().contains("particle 1"), "{error}");
        let error = reconstruct(&[[0.0; 3], [0.0, 1e9, 0.0]], None, RADIUS, &params()).unwrap_err();
        assert!(error.to_string().contains("1000000000 m apart"), "{error}");
        // Far away, but not too far: two drops.
        let two = reconstruct(&[[0.0; 3], [0.0, 1000.0, 0.0]], None, RADIUS, &params()).unwrap();
        assert_eq!(two.mesh.open_edges(), 0);
    }
}

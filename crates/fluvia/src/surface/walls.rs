//! Surfaces at walls: drawn out to them, as a liquid wets the glass that it stands in.

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use fluvia_sim::mesh::Surface;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::{Params, reconstruct};

    const RADIUS: f32 = 0.025;

    #[test]
    fn a_surface_is_drawn_out_to_the_walls_that_it_rests_at_and_nowhere_else() {
        // A block that rests 1.8 radii above a floor, as liquids do, and far from a wall at its side.
        let at = |i: i32| 2.0 * RADIUS * i as f32;
        let rows = (0..8).flat_map(|x| (0..8).map(move |y| (x, y)));
        let position: Vec<[f32; 3]> =
            rows.flat_map(|(x, y)| (0..8).map(move |z| [at(x), at(y) + 1.8 * RADIUS, at(z)])).collect();
        let flat = (-10..40).flat_map(|i| (-10..40).map(move |k| (0.03 * i as f32, 0.03 * k as f32)));
        let floor = flat.clone().map(|(x, z)| ([x, 0.0, z], [0.0, 1.0, 0.0]));
        let side = flat.map(|(y, z)| ([-0.2, y, z], [1.0, 0.0, 0.0]));
        let (wall, normal): (Vec<_>, Vec<_>) = floor.chain(side).unzip();
        let mut surface = reconstruct(&position, None, RADIUS, &Params::default()).unwrap();
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
}

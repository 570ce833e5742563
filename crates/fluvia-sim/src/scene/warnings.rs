//! What will surprise in a set-up that can be run.

mod walls;

use fluvia_neighbors::{Grid, Neighbors, Options, Radius};

use super::{Emitter, Setup};
use crate::mesh::TriangleMesh;
use walls::against_wall;

/// Particles nearer than this many spacings are in the same place: a solver throws them apart.
const SAME_PLACE: f32 = 0.5;

/// Layers of an emitter should be a spacing apart; they are fewer than this many spacings if they overlap.
const LAYERS_APART: f32 = 0.9;

/// A particle is inside another body if that alone fills this part of its surroundings. On the face of a body
/// it is one half.
const INSIDE: f64 = 0.65;

/// The surroundings of a particle, in spacings.
const SURROUNDINGS: f32 = 2.0;

pub(super) fn warnings(setup: &Setup) -> Vec<String> {
    let mut warnings = Vec::new();
    for (i, emitter) in setup.emitters.iter().enumerate() {
        if let Some([x, y, z]) = emitter.unused_velocity {
            warnings.push(format!(
                "{}: the velocity ({x}, {y}, {z}) of the scene is not used, the file has velocities of its own",
                name("fluids", i, &emitter.source)
            ));
        }
    }
    clashing_faces(setup, &mut warnings);
    in_walls(setup, &mut warnings);
    bodies_overlap(setup, &mut warnings);
    for (i, emitter) in setup.emitters.iter().enumerate() {
        warnings.extend(layers_overlap(setup, emitter, i));
    }
    warnings
}

/// Walls whose normals are not all what they should be.
fn clashing_faces(setup: &Setup, warnings: &mut Vec<String>) {
    for (i, wall) in setup.walls.iter().enumerate() {
        let edges = wall.surface.as_ref().map_or(0, TriangleMesh::clashing_edges);
        if edges > 0 {
            warnings.push(format!(
                "{}: its faces disagree on which side is outside (at {edges} {}), so that some normals point away \
                 from the fluid",
                name("walls", i, &wall.source),
                if edges == 1 { "edge" } else { "edges" }
            ));
        }
    }
}

/// Fluid particles behind walls, or so near to one that they will be thrown away from it.
fn in_walls(setup: &Setup, warnings: &mut Vec<String>) {
    for (i, wall) in setup.walls.iter().enumerate() {
        let (mut count, mut bodies) = (0, Vec::new());
        for (k, emitter) in setup.emitters.iter().enumerate() {
            let bad = against_wall(setup, wall, &emitter.position).into_iter().filter(|&bad| bad).count();
            if bad > 0 {
                count += bad;
                bodies.push(format!("fluids[{k}]"));
            }
        }
        if count > 0 {
            let particles = if count == 1 { "particle starts" } else { "particles start" };
            warnings.push(format!(
                "{}: {count} fluid {particles} in or against it, of {}",
                name("walls", i, &wall.source),
                bodies.join(", ")
            ));
        }
    }
}

/// Bodies that enter in the same step and share space.
fn bodies_overlap(setup: &Setup, warnings: &mut Vec<String>) {
    let spacing = 2.0 * setup.particle_radius;
    for (i, first) in setup.emitters.iter().enumerate() {
        for (k, second) in setup.emitters.iter().enumerate().skip(i + 1) {
            if first.start != second.start {
                continue;
            }
            let count = count_inside(&first.position, &second.position, spacing);
            if count > 0 {
                warnings.push(format!(
                    "{} overlaps {}: {count} of its particles start inside",
                    name("fluids", k, &second.source),
                    name("fluids", i, &first.source)
                ));
            }
        }
    }
}

/// How many of `particles` are inside `body`: in the place of one of its particles, or among many of them.
fn count_inside(body: &[[f32; 3]], particles: &[[f32; 3]], spacing: f32) -> usize {
    // The weights (1 - (d / R)²)³ over a full lattice sum up to their integral, 64 π R³ / 315, by its spacing
    // cubed.
    let full = 64.0 * std::f64::consts::PI * f64::from(SURROUNDINGS).powi(3) / 315.0;
    let radius = SURROUNDINGS * spacing;
    let same_place = (SAME_PLACE * spacing).powi(2);
    let neighbors = search(body, particles, radius);
    let is_inside = |row: &&[usize]| {
        let squares = &neighbors.distances[row[0]..row[1]];
        let weight = |&square: &f32| (1.0 - f64::from(square / (radius * radius))).powi(3);
        let filled: f64 = squares.iter().map(weight).sum::<f64>() / full;
        filled > INSIDE || squares.iter().any(|&square| square < same_place)
    };
    neighbors.row_splits.windows(2).filter(is_inside).count()
}

/// An emitter that fires again before its last layer has moved out of the way, by velocity and gravity.
fn layers_overlap(setup: &Setup, emitter: &Emitter, index: usize) -> Option<String> {
    if emitter.stop - emitter.start <= emitter.step {
        return None;
    }
    let spacing = 2.0 * setup.particle_radius;
    let interval = emitter.step as f32 * setup.dt;
    let moved: Vec<[f32; 3]> = emitter
        .position
        .iter()
        .zip(&emitter.velocity)
        .map(|(x, v)| [0, 1, 2].map(|k| x[k] + (v[k] + 0.5 * setup.gravity[k] * interval) * interval))
        .collect();
    let reach = LAYERS_APART * spacing;
    let neighbors = search(&emitter.position, &moved, reach);
    let count = (0..moved.len()).filter(|&q| neighbors.count(q) > 0).count();
    (count > 0).then(|| {
        format!(
            "{}: its layers overlap, {count} of {} particles are within {reach} m of the next layer when it comes \
             {interval} s later; a larger `step` or velocity keeps them apart",
            name("fluids", index, &emitter.source),
            emitter.position.len()
        )
    })
}

fn name(list: &str, index: usize, source: &str) -> String {
    format!("{list}[{index}] ({source})")
}

/// The points within the radius of each query, with squared distances.
fn search(points: &[[f32; 3]], queries: &[[f32; 3]], radius: f32) -> Neighbors {
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    grid.build(points, radius);
    let options = Options { distances: true, ..Options::default() };
    grid.search(queries, Radius::Uniform(radius), &options, &mut neighbors);
    neighbors
}

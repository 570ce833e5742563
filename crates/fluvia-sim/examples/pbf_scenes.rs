//! Runs position-based fluids for 8 s on four scenes in a box of 2 x 4 x 2 m and prints what a release must
//! keep: particles outside, compression at rest, speeds, spacing, time.
//!
//! usage: pbf_scenes [dam|collision|emitter|pool] [DIR]
//!
//! With DIR, every frame is written there as raw float32 (positions, then velocities).

#[path = "../tests/common/mod.rs"]
mod common;

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use common::{RADIUS, block, box_walls, emitter, setup};
use fluvia_neighbors::{Grid, Neighbors, Options, Radius};
use fluvia_sim::metrics::{self, Bounds};
use fluvia_sim::particles::{Boundary, Particles};
use fluvia_sim::pbf::{Params, Pbf};
use fluvia_sim::rollout::Rollout;
use fluvia_sim::scene::{Emitter, Setup};

const FRAMES: u64 = 400;
const REPORT_EVERY: u64 = 25;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let scenes: Vec<&str> = match arguments.first() {
        Some(name) => vec![name],
        None => vec!["dam", "collision", "emitter", "pool"],
    };
    for name in scenes {
        let emitters =
            bodies(name).ok_or_else(|| format!("no scene {name}: dam, collision, emitter, pool"))?;
        println!("{name}");
        run(&setup(walls(), emitters), arguments.get(1).map(Path::new))?;
    }
    Ok(())
}

/// The box, its samples moved about so that nothing rests on a regular wall by luck.
fn walls() -> Boundary {
    let mut walls = box_walls([-1.0, 0.0, -1.0], [1.0, 4.0, 1.0], 1.2 * RADIUS);
    let mut random = 1_u32;
    for (position, normal) in walls.position.iter_mut().zip(&walls.normal) {
        for axis in (0..3).filter(|&axis| normal[axis] == 0.0) {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            position[axis] += ((random >> 8) as f32 / (1 << 24) as f32 - 0.5) * 0.5 * RADIUS;
        }
    }
    walls
}

fn bodies(scene: &str) -> Option<Vec<Emitter>> {
    let once = [0, 1, 1];
    Some(match scene {
        "dam" => vec![emitter(block([-0.95, 0.05, -0.95], [18; 3]), [0.0; 3], once)],
        "collision" => vec![
            emitter(block([-0.9, 0.5, -0.3], [12; 3]), [3.0, 0.5, 0.0], once),
            emitter(block([0.3, 0.5, -0.2], [12; 3]), [-3.0, 0.0, 0.3], once),
        ],
        // At 2.5 m/s a layer has moved one spacing when the next comes.
        "emitter" => vec![emitter(block([-0.9, 1.2, -0.125], [1, 6, 6]), [2.5, 0.0, 0.0], [0, 200, 1])],
        "pool" => vec![emitter(block([-0.95, 0.05, -0.95], [39, 12, 39]), [0.0; 3], once)],
        _ => return None,
    })
}

fn run(setup: &Setup, directory: Option<&Path>) -> Result<(), Box<dyn std::error::Error>> {
    let mut rollout = Rollout::new(setup)?;
    let mut solver = Pbf::new(Params::default(), &setup.boundary, setup.particle_radius)?;
    let (mut seconds, mut slowest) = (0.0, 0.0_f64);
    for frame in 0..=FRAMES {
        if let Some(directory) = directory {
            write(&directory.join(format!("f{frame:04}.bin")), &rollout.state().particles)?;
        }
        if frame % REPORT_EVERY == 0 {
            report(frame, &rollout.state().particles, setup);
        }
        if frame < FRAMES {
            let start = Instant::now();
            rollout.advance(&mut solver)?;
            let taken = start.elapsed().as_secs_f64();
            seconds += taken;
            slowest = slowest.max(taken);
        }
    }
    let summary = rollout.state().summary;
    let mean = 1e3 * seconds / FRAMES as f64;
    println!("  {mean:.1} ms a frame, slowest {:.1} ms; {summary:?}", 1e3 * slowest);
    Ok(())
}

fn report(frame: u64, particles: &Particles, setup: &Setup) {
    let ratios =
        metrics::density_ratios(&particles.position, &setup.boundary.position, setup.particle_radius);
    let spacing = nearest_distances(&particles.position);
    let bounds = Bounds::of(&particles.position);
    println!(
        "  frame {frame:3}: {} particles, compression {:.3} %, densest {:.3}, energy {:.3} J/kg, \
         highest speed {:.2} m/s, nearest neighbour {:.0} / {:.0} / {:.0} mm (1 %, 5 %, median), top {:.3} m",
        particles.len(),
        100.0 * metrics::mean_compression(&ratios),
        ratios.iter().copied().fold(0.0, f32::max),
        metrics::kinetic_energy(&particles.velocity),
        metrics::highest_speed(&particles.velocity),
        1e3 * quantile(&spacing, 0.01),
        1e3 * quantile(&spacing, 0.05),
        1e3 * quantile(&spacing, 0.5),
        bounds.map_or(0.0, |bounds| bounds.high[1]),
    );
}

/// The distance of every particle to the nearest other one, ascending; 0.2 m if none is nearer.
fn nearest_distances(position: &[[f32; 3]]) -> Vec<f32> {
    let (mut grid, mut neighbors) = (Grid::new(), Neighbors::default());
    let options = Options { distances: true, ..Options::default() };
    grid.build(position, 0.1);
    grid.search(position, Radius::Uniform(0.2), &options, &mut neighbors);
    let mut nearest: Vec<f32> = (0..position.len())
        .map(|i| {
            let pairs = neighbors.row_splits[i]..neighbors.row_splits[i + 1];
            let others = pairs.filter(|&pair| neighbors.indices[pair] as usize != i);
            others.map(|pair| neighbors.distances[pair]).fold(0.04, f32::min).sqrt()
        })
        .collect();
    nearest.sort_by(f32::total_cmp);
    nearest
}

fn quantile(sorted: &[f32], part: f64) -> f32 {
    sorted.get((part * sorted.len() as f64) as usize).copied().unwrap_or(f32::NAN)
}

fn write(path: &Path, particles: &Particles) -> std::io::Result<()> {
    let rows = particles.position.iter().chain(&particles.velocity);
    let bytes: Vec<u8> = rows.flatten().flat_map(|number| number.to_le_bytes()).collect();
    File::create(path)?.write_all(&bytes)
}

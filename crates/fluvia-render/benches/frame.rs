//! A picture of 6,000 particles in a tank, 1280 x 720 pixels: as spheres, and as a surface of 80,000 triangles that is
//! there already. How long a surface takes to make of particles is told by `fluvia mesh`.
//!
//! `RAYON_NUM_THREADS=2 cargo bench -p fluvia-render`

use criterion::{Criterion, criterion_group, criterion_main};
use fluvia_render::{Camera, Frame, Stage, Style, Subject, Surface, Values, View, Walls, draw_frame};

const RADIUS: f32 = 0.025;
const PARTICLES: usize = 6000;
/// Length, height and depth of the tank, metres.
const TANK: [f32; 3] = [2.0, 1.2, 1.0];

/// The height of the wave at a place, metres.
fn wave(x: f32, z: f32) -> f32 {
    0.4 + 0.16 * (3.0 * x).sin() + 0.04 * (11.0 * x + 7.0 * z).sin()
}

/// Particles below the wave, two radii apart: [`PARTICLES`] of them, which leaves the last column short.
fn particles() -> Vec<[f32; 3]> {
    let side = |length: f32| (0..(length / (2.0 * RADIUS)) as usize).map(|i| RADIUS * (2 * i + 1) as f32);
    let columns = side(TANK[0]).flat_map(|x| side(TANK[2]).map(move |z| (x, z)));
    let mut all: Vec<[f32; 3]> =
        columns.flat_map(|(x, z)| side(wave(x, z)).map(move |y| [x, y, z])).collect();
    all.truncate(PARTICLES);
    assert_eq!(all.len(), PARTICLES, "there is room for all below the wave");
    all
}

/// The walls of the tank: points with normals into it.
fn walls() -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let (mut position, mut normal) = (Vec::new(), Vec::new());
    let step = 1.3 * RADIUS;
    for axis in 0..3 {
        let others = [(axis + 1) % 3, (axis + 2) % 3];
        let counts = others.map(|k| (TANK[k] / step) as usize);
        for (at, turn) in [(0.0, 1.0), (TANK[axis], -1.0)] {
            for (i, j) in (0..=counts[0]).flat_map(|i| (0..=counts[1]).map(move |j| (i, j))) {
                let mut point = [0.0; 3];
                point[axis] = at;
                point[others[0]] = TANK[others[0]] * i as f32 / counts[0] as f32;
                point[others[1]] = TANK[others[1]] * j as f32 / counts[1] as f32;
                position.push(point);
                let mut inwards = [0.0; 3];
                inwards[axis] = turn;
                normal.push(inwards);
            }
        }
    }
    (position, normal)
}

/// Vertices, their normals, triangles.
type Mesh = (Vec<[f32; 3]>, Vec<[f32; 3]>, Vec<[u32; 3]>);

/// The wave as a closed surface: a grid above, and the same grid at the floor.
fn surface() -> Mesh {
    let (columns, rows) = (200, 100);
    let (mut position, mut normal, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for is_top in [true, false] {
        for (j, i) in (0..=rows).flat_map(|j| (0..=columns).map(move |i| (j, i))) {
            let x = 0.02 + (TANK[0] - 0.04) * i as f32 / columns as f32;
            let z = 0.02 + (TANK[2] - 0.04) * j as f32 / rows as f32;
            let rim = i == 0 || j == 0 || i == columns || j == rows;
            position.push([x, if is_top && !rim { wave(x, z) } else { 0.02 }, z]);
            normal.push([0.0, if is_top { 1.0 } else { -1.0 }, 0.0]);
        }
        let first = if is_top { 0 } else { (columns + 1) * (rows + 1) };
        for (j, i) in (0..rows).flat_map(|j| (0..columns).map(move |i| (j, i))) {
            let [a, b, c, d] = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)]
                .map(|(i, j)| (first + j * (columns + 1) + i) as u32);
            let faces = [[a, c, b], [b, c, d]];
            triangles.extend(if is_top { faces } else { faces.map(|[a, b, c]| [a, c, b]) });
        }
    }
    (position, normal, triangles)
}

fn frames(criterion: &mut Criterion) {
    let (wall, wall_normal) = walls();
    let walls = Walls { position: &wall, normal: &wall_normal };
    let particles = particles();
    let speed: Vec<f32> = particles.iter().map(|p| 2.0 * p[1]).collect();
    let mut subject = Subject::new(walls, RADIUS);
    subject.add(&particles);
    let view = View { width: 1280, height: Some(720), ..View::default() };
    let camera = Camera::fit(&subject, &view).expect("a view in range");
    let style = Style::default();
    let stage = Stage::new(walls);
    let spheres = Frame { position: &particles, values: Values::Scalar(&speed), ..Frame::default() };
    let (position, normal, triangles) = surface();
    let surface =
        Surface { position: &position, normal: &normal, triangles: &triangles, values: Values::None };
    let water = Frame { position: &particles, surface: Some(surface), ..Frame::default() };

    let mut group = criterion.benchmark_group("frame");
    group.sample_size(20);
    group.bench_function("stage", |bench| bench.iter(|| Stage::new(walls)));
    for (name, frame) in [("spheres", spheres), ("surface", water)] {
        group.bench_function(name, |bench| bench.iter(|| draw_frame(&frame, &stage, &camera, &style)));
    }
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);

//! Surfaces, shadows, walls made of points, and cameras that move: what is known of their pictures.

use fluvia_render::{
    Camera, Error, Frame, Image, Stage, Style, Subject, Surface, Values, View, Walls, draw_frame,
};

mod common;

use common::{RADIUS, TILE, assert_disc, camera};

/// A floor of 2 m at y = 0 around the origin: points as far apart as those of sampled walls, off a lattice.
fn floor() -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let step = 1.3 * RADIUS;
    let count = (2.0 / step) as i32;
    let shift = |i: i32, j: i32| ((i * 7 + j * 13) % 5) as f32 * 0.04 * step;
    let points = (0..=count).flat_map(|i| (0..=count).map(move |j| (i, j)));
    let at = |(i, j)| [-1.0 + step * i as f32 + shift(i, j), 0.0, -1.0 + step * j as f32 + shift(j, i)];
    points.map(|point| (at(point), [0.0, 1.0, 0.0])).unzip()
}

/// Vertices, their normals, triangles.
type Mesh = (Vec<[f32; 3]>, Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A closed ball as a surface.
fn ball(center: [f32; 3], radius: f32) -> Mesh {
    let (rings, sides) = (40u32, 80u32);
    let (mut position, mut normal, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for ring in 0..=rings {
        let (sine, cosine) = (std::f32::consts::PI * ring as f32 / rings as f32).sin_cos();
        for side in 0..sides {
            let (z, x) = (std::f32::consts::TAU * side as f32 / sides as f32).sin_cos();
            let n = [x * sine, cosine, z * sine];
            position.push(std::array::from_fn(|k| center[k] + radius * n[k]));
            normal.push(n);
        }
    }
    for (ring, side) in (0..rings).flat_map(|ring| (0..sides).map(move |side| (ring, side))) {
        let at = |ring: u32, side: u32| ring * sides + side % sides;
        let [a, b, c, d] = [at(ring, side), at(ring, side + 1), at(ring + 1, side), at(ring + 1, side + 1)];
        triangles.extend([[a, b, c], [b, d, c]]);
    }
    (position, normal, triangles)
}

fn brightness(image: &Image, camera: &Camera, point: [f32; 3]) -> u32 {
    let [x, y, _] = camera.project(point).expect("before the camera");
    image.get(x as u32, y as u32).expect("in the picture").iter().map(|&c| u32::from(c)).sum()
}

#[test]
fn a_surface_has_the_silhouette_of_what_it_is() {
    let (position, normal, triangles) = ball([0.1, 0.3, -0.2], 0.25);
    let camera = camera(Walls::default(), &position, &View { width: 300, ..View::default() });
    let surface =
        Surface { position: &position, normal: &normal, triangles: &triangles, values: Values::None };
    let frame = Frame { surface: Some(surface), ..Frame::default() };
    let image = draw_frame(&frame, &Stage::default(), &camera, &Style::default()).unwrap();
    let [x, y, depth] = camera.project([0.1, 0.3, -0.2]).unwrap();
    // Seen from so near the outline of a ball is a little larger than its radius at its depth.
    let reach = camera.focal() * 0.25 / (depth * depth - 0.25 * 0.25).sqrt();
    assert!(reach > 70.0, "{reach}");
    // Facets lie up to 0.1 % inside, and a pixel on the rim is partly covered; away from the middle of the picture a ball is an
    // ellipse.
    assert_disc(&image, [x, y], reach, 2.0);
}

#[test]
fn a_surface_stands_in_for_its_particles_but_those_outside() {
    let (position, normal, triangles) = ball([0.0, 0.3, 0.0], 0.1);
    let particles = [[0.0, 0.3, 0.0], [0.5, 0.3, 0.0], [-0.5, 0.3, 0.0]];
    let camera = camera(Walls::default(), &particles, &View { yaw: 0.0, width: 300, ..View::default() });
    let surface =
        Surface { position: &position, normal: &normal, triangles: &triangles, values: Values::None };
    let outside = [false, true, false];
    let frame = Frame { position: &particles, outside: &outside, surface: Some(surface), ..Frame::default() };
    let image = draw_frame(&frame, &Stage::default(), &camera, &Style::default()).unwrap();
    let at = |point| {
        let [x, y, _] = camera.project(point).unwrap();
        image.get(x as u32, y as u32).unwrap()
    };
    assert_eq!(at(particles[2]), TILE);
    let orange = at(particles[1]);
    assert!(orange[0] > 2 * orange[2], "{orange:?}");
    let water = at(particles[0]);
    assert!(water[2] > water[0], "{water:?}");
    // Without a triangle there is no liquid.
    let nothing = Frame { surface: Some(Surface::default()), outside: &[], ..frame };
    let image = draw_frame(&nothing, &Stage::default(), &camera, &Style::default()).unwrap();
    assert_eq!(image, Image::filled(image.width, image.height, TILE));
}

#[test]
fn water_takes_more_of_what_is_behind_it_the_thicker_it_is() {
    let (wall, wall_normal) = floor();
    let walls = Walls { position: &wall, normal: &wall_normal };
    let stage = Stage::new(walls);
    let view = View { yaw: 0.0, pitch: 80.0, width: 300, ..View::default() };
    let camera = camera(walls, &[], &view);
    let red = |radius: f32| {
        let (position, normal, triangles) = ball([0.0, radius + 0.02, 0.0], radius);
        let surface =
            Surface { position: &position, normal: &normal, triangles: &triangles, values: Values::None };
        let frame = Frame { surface: Some(surface), ..Frame::default() };
        let image = draw_frame(&frame, &stage, &camera, &Style::default()).unwrap();
        let [x, y, _] = camera.project([0.0, radius, 0.0]).unwrap();
        image.get(x as u32, y as u32).unwrap()[0]
    };
    let [drop, body, pool] = [0.04, 0.15, 0.45].map(red);
    assert!(drop > body + 5 && body > pool, "{drop}, {body}, {pool}");
}

#[test]
fn shadows_fall_away_from_the_lamp() {
    let (wall, wall_normal) = floor();
    let walls = Walls { position: &wall, normal: &wall_normal };
    let stage = Stage::new(walls);
    let view = View { yaw: 0.0, pitch: 60.0, width: 400, ..View::default() };
    let camera = camera(walls, &[], &view);
    let style = Style::default();
    // A ball of particles a way above the floor.
    let grid = (-4i32..=4).flat_map(|x| (-4i32..=4).flat_map(move |y| (-4i32..=4).map(move |z| [x, y, z])));
    let particles: Vec<[f32; 3]> = grid
        .filter(|p| p.iter().map(|x| x * x).sum::<i32>() <= 16)
        .map(|p| p.map(|x| 2.0 * RADIUS * x as f32))
        .map(|[x, y, z]| [x, y + 0.4, z])
        .collect();
    let (position, normal, triangles) = ball([0.0, 0.4, 0.0], 0.2);
    let surface =
        Surface { position: &position, normal: &normal, triangles: &triangles, values: Values::None };
    let bare = draw_frame(&Frame::default(), &stage, &camera, &style).unwrap();
    let spheres = Frame { position: &particles, ..Frame::default() };
    let water = Frame { position: &particles, surface: Some(surface), ..Frame::default() };
    let [spheres, water] = [spheres, water].map(|frame| draw_frame(&frame, &stage, &camera, &style).unwrap());

    // The lamp stands at the upper left before the scene, (-0.55, 0.95, 0.42): the shadow of the middle falls to the
    // right and behind.
    let shadow = [0.4 * 0.55 / 0.95, 0.0, -0.4 * 0.42 / 0.95];
    let other = [-shadow[0], 0.0, -shadow[2]];
    let (lit, dark) = (brightness(&bare, &camera, shadow), brightness(&spheres, &camera, shadow));
    // The sky's light is left.
    assert!(10 * dark < 7 * lit, "{dark} in the shadow of particles, {lit} without them");
    // Water lets light through.
    let through = brightness(&water, &camera, shadow);
    assert!(through > dark + 15 && through + 15 < lit, "{through}");
    // On the side of the lamp there is none, though the ball takes some of the sky.
    for image in [&spheres, &water] {
        let (near, bare) = (brightness(image, &camera, other), brightness(&bare, &camera, other));
        assert!(10 * near > 8 * bare && near <= bare, "{near}, {bare}");
    }
    // Softer than a step: between shadow and light there are many steps.
    let mut seen: Vec<u32> = (0..100)
        .map(|k| brightness(&spheres, &camera, [shadow[0] + 0.004 * k as f32, 0.0, shadow[2]]))
        .collect();
    seen.dedup();
    assert!(seen.len() > 15, "{seen:?}");
}

#[test]
fn the_sky_reaches_less_of_what_lies_below() {
    // A column of particles: the lower, the darker, on the side that the lamp does not reach.
    let particles: Vec<[f32; 3]> = (0..6)
        .flat_map(|x| (0..12).flat_map(move |y| (0..6).map(move |z| [x, y, z])))
        .map(|p| p.map(|x: i32| 2.0 * RADIUS * x as f32))
        .collect();
    let view = View { yaw: 0.0, pitch: 5.0, width: 200, ..View::default() };
    let camera = camera(Walls::default(), &particles, &view);
    let frame = Frame { position: &particles, ..Frame::default() };
    let image = draw_frame(&frame, &Stage::default(), &camera, &Style::default()).unwrap();
    let row = |y: f32| {
        let points = (0..6).map(|x| [0.05 * x as f32, y, 0.25 + RADIUS]);
        points.map(|point| brightness(&image, &camera, point)).sum::<u32>()
    };
    assert!(row(0.55) > row(0.25), "{} {}", row(0.55), row(0.25));
}

#[test]
fn walls_of_points_have_no_holes_and_end_at_their_edges() {
    // A box, of which three sides are seen from inside: points as sampled walls have them.
    let (mut wall, mut normal) = (Vec::new(), Vec::new());
    let (points, _) = floor();
    for axis in 0..3 {
        for (at, turn) in [(-1.0, 1.0), (1.0, -1.0)] {
            for [x, _, z] in &points {
                let mut point = [0.0; 3];
                (point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3]) = (at, x.min(1.0), z.min(1.0));
                wall.push(point);
                let mut inwards = [0.0; 3];
                inwards[axis] = turn;
                normal.push(inwards);
            }
        }
    }
    let walls = Walls { position: &wall, normal: &normal };
    let stage = Stage::new(walls);
    let camera = camera(walls, &[], &View { width: 400, top: Some(0.5), ..View::default() });
    let image = draw_frame(&Frame::default(), &stage, &camera, &Style::default()).unwrap();
    // The outline of what is seen: the box up to its top, which is convex on the picture.
    let corner = |k: usize| {
        let at = |bit: usize, high: f32| if k >> bit & 1 == 0 { -1.0 } else { high };
        camera.project([at(0, 1.0), at(1, 0.5), at(2, 1.0)]).unwrap()
    };
    let corners: Vec<[f32; 3]> = (0..8).map(corner).collect();
    // Distance outside the outline: the largest over all directions of how far a point is beyond all corners.
    let beyond = |x: f32, y: f32| {
        let farthest = |angle: usize| {
            let (sine, cosine) = (angle as f32 / 360.0 * std::f32::consts::TAU).sin_cos();
            let along = |x: f32, y: f32| cosine * x + sine * y;
            along(x, y) - corners.iter().map(|c| along(c[0], c[1])).fold(f32::NEG_INFINITY, f32::max)
        };
        (0..360).map(farthest).fold(f32::NEG_INFINITY, f32::max)
    };
    let mut inside = 0;
    for row in 0..image.height {
        for column in 0..image.width {
            let (x, y) = (column as f32 + 0.5, row as f32 + 0.5);
            let drawn = image.get(column, row) != Some(TILE);
            assert!(!drawn || beyond(x, y) < 1.5, "speck at {column}, {row}");
            // The near edges of the side walls that are not seen are no outline: what is far enough inside is floor,
            // back or side wall.
            if beyond(x, y) < -1.5 && drawn {
                inside += 1;
            }
        }
    }
    // The floor, the back and the left side up to the top, all of them: what is seen from the front and the right.
    for (axis, name) in [(1, "floor"), (2, "back"), (0, "side")] {
        for k in 0..400 {
            let along = |part: usize, other: usize| {
                let high = if other == 1 { 0.45 } else { 0.95 };
                -0.95 + (high + 0.95) * part as f32 / 19.0
            };
            let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut point = [-1.0; 3];
            (point[first], point[second]) = (along(k % 20, first), along(k / 20, second));
            let [x, y, _] = camera.project(point).unwrap();
            assert_ne!(image.get(x as u32, y as u32), Some(TILE), "hole in the {name} at {point:?}");
        }
    }
    assert!(inside > 10_000, "{inside}");
}

#[test]
fn a_wall_above_a_round_one_joins_it() {
    // A hump along x, and an upright wall at x = 0 that stands on it and faces x.
    let (points, _) = floor();
    let hump = |z: f32| (0.3_f32.powi(2) - z * z).sqrt();
    let (mut wall, mut normal) = (Vec::new(), Vec::new());
    for [along, _, across] in points {
        let (sine, cosine) = (1.2 * across).sin_cos();
        if along >= 0.0 && across.abs() < 0.3 {
            wall.push([along, 0.3 * cosine, 0.3 * sine]);
            normal.push([0.0, cosine, sine]);
        }
        if along.abs() < 0.25 && across + 0.5 > hump(along) {
            wall.push([0.0, across + 0.5, along]);
            normal.push([1.0, 0.0, 0.0]);
        }
    }
    let walls = Walls { position: &wall, normal: &normal };
    let camera = camera(walls, &[], &View { yaw: 90.0, pitch: 20.0, width: 800, ..View::default() });
    let image = draw_frame(&Frame::default(), &Stage::new(walls), &camera, &Style::default()).unwrap();
    for k in 0..200 {
        // On the upright wall, right over the hump.
        let z = 0.001 * k as f32 - 0.1;
        let [x, y, _] = camera.project([0.0, hump(z) + 0.004, z]).unwrap();
        assert_ne!(image.get(x as u32, y as u32), Some(TILE), "crack at {z}");
    }
}

#[test]
fn a_wall_hides_the_liquid_behind_it_but_not_what_is_outside() {
    let (wall, _) = floor();
    // Upright at z = 0.3, seen from its front; the sphere and the ball of water stand behind it.
    let wall: Vec<[f32; 3]> = wall.into_iter().map(|[x, _, z]| [x, z, 0.3]).collect();
    let normal = vec![[0.0, 0.0, 1.0]; wall.len()];
    let walls = Walls { position: &wall, normal: &normal };
    let view = View { yaw: 0.0, pitch: 0.0, width: 300, ..View::default() };
    let particle = [[0.0, 0.0, 0.0]];
    let camera = camera(walls, &particle, &view);
    let style = Style { radius: 0.2, ..Style::default() };
    let image = |walls, frame: &Frame<'_>| draw_frame(frame, &Stage::new(walls), &camera, &style).unwrap();
    let color = |walls, frame: &Frame<'_>| {
        let [x, y, _] = camera.project([0.0, 0.0, 0.2]).unwrap();
        image(walls, frame).get(x as u32, y as u32).unwrap()
    };
    let alone = color(walls, &Frame::default());
    let sphere = Frame { position: &particle, values: Values::Color(&[[250, 40, 40]]), ..Frame::default() };
    let (position, normal, triangles) = ball([0.0; 3], 0.2);
    let surface =
        Surface { position: &position, normal: &normal, triangles: &triangles, values: Values::None };
    let water = Frame { surface: Some(surface), ..Frame::default() };
    assert_eq!((color(walls, &sphere), color(walls, &water)), (alone, alone));
    // Outside: between both, and more of the sphere.
    let outside = Frame { outside: &[true], ..sphere };
    let (bare, both) = (color(Walls::default(), &outside), color(walls, &outside));
    let redness = |c: [u8; 3]| i32::from(c[0]) - i32::from(c[2]);
    assert!(
        redness(both) > redness(alone) + 40 && redness(both) < redness(bare) - 20,
        "{bare:?} {alone:?} {both:?}"
    );
    // With a surface that hides nothing the sphere outside shines through too.
    let stray = Frame { surface: Some(Surface::default()), ..outside };
    assert_eq!(color(walls, &stray), both);
}

#[test]
fn water_that_is_drawn_out_to_a_wall_is_not_hidden_by_it() {
    let (wall, wall_normal) = floor();
    let walls = Walls { position: &wall, normal: &wall_normal };
    // A slab whose upper side lies in the floor.
    let corner = |k: u32| [0, 1, 2].map(|i| [[-0.6, -0.2, -0.6], [0.6, 0.0, 0.6]][(k >> i & 1) as usize][i]);
    let position: Vec<[f32; 3]> = (0..8).map(corner).collect();
    let faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let triangles: Vec<[u32; 3]> = faces.iter().flat_map(|&[a, b, c, d]| [[a, c, b], [a, d, c]]).collect();
    let normal = vec![[0.0, 1.0, 0.0]; 8];
    let surface =
        Surface { position: &position, normal: &normal, triangles: &triangles, values: Values::None };
    let view = View { yaw: 20.0, pitch: 20.0, width: 300, ..View::default() };
    let (stage, camera) = (Stage::new(walls), camera(walls, &[], &view));
    let draw = |surface| {
        let frame = Frame { surface, ..Frame::default() };
        draw_frame(&frame, &stage, &camera, &Style::default()).unwrap()
    };
    let (bare, water) = (draw(None), draw(Some(surface)));
    for k in 0..2500 {
        let [x, z] = [k % 50, k / 50].map(|part| -0.55 + 1.1 * part as f32 / 49.0);
        let [x, y, _] = camera.project([x, 0.0, z]).unwrap();
        let blue = |image: &Image| image.get(x as u32, y as u32).map(|c| i32::from(c[2]) - i32::from(c[0]));
        assert!(blue(&water) > blue(&bare).map(|blue| blue + 10), "floor at {x}, {y}");
    }
}

#[test]
fn surfaces_are_the_same_bits_at_any_number_of_threads() {
    let (wall, wall_normal) = floor();
    let walls = Walls { position: &wall, normal: &wall_normal };
    let (position, normal, triangles) = ball([0.0, 0.4, 0.0], 0.35);
    let heights: Vec<f32> = position.iter().map(|p| 5.0 * p[1]).collect();
    let surface = Surface {
        position: &position,
        normal: &normal,
        triangles: &triangles,
        values: Values::Scalar(&heights),
    };
    let draw = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let camera = camera(walls, &position, &View { width: 200, ..View::default() });
            let frame = Frame { position: &position, surface: Some(surface), ..Frame::default() };
            draw_frame(&frame, &Stage::new(walls), &camera, &Style::default()).unwrap()
        })
    };
    let one = draw(1);
    assert!(draw(2) == one && draw(3) == one && draw(8) == one);
}

#[test]
fn a_camera_that_goes_around_keeps_everything_in_the_picture() {
    let (wall, normal) = floor();
    let walls = Walls { position: &wall, normal: &normal };
    let view = View { width: 300, sweep: 360.0, ..View::default() };
    let around = camera(walls, &[], &view);
    for degrees in 0..72 {
        let camera = around.turned(5.0 * degrees as f32);
        for &point in &wall {
            let [x, y, _] = camera.project(point).expect("before the camera");
            // The sweep is looked at in steps of some degrees; between them corners reach a pixel farther.
            assert!(
                x > -1.5 && x < 301.5 && y > -1.5 && y < camera.height() as f32 + 1.5,
                "{degrees}: {x} {y}"
            );
        }
    }
    // A whole turn leads back, half a turn to the other side.
    let (whole, half) = (around.turned(360.0), around.turned(180.0));
    let apart = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
    assert!(apart(whole.eye(), around.eye()) < 1e-4);
    let [x, y, z] = around.eye();
    assert!(apart(half.eye(), [-x, y, -z]) < 0.1);
}

#[test]
fn a_camera_stands_and_looks_where_it_is_told() {
    let (wall, normal) = floor();
    let walls = Walls { position: &wall, normal: &normal };
    let (eye, look_at) = ([1.0, 2.0, 3.0], [0.25, 0.5, -0.25]);
    let view = View {
        eye: Some(eye),
        look_at: Some(look_at),
        field_of_view: Some(40.0),
        width: 400,
        height: Some(300),
        ..View::default()
    };
    let camera = camera(walls, &[], &view);
    assert_eq!(camera.eye(), eye);
    let [x, y, depth] = camera.project(look_at).unwrap();
    assert!((x - 200.0).abs() < 0.01 && (y - 150.0).abs() < 0.01);
    let distance = (0..3).map(|k| (eye[k] - look_at[k]).powi(2)).sum::<f32>().sqrt();
    assert!((depth - distance).abs() < 1e-4);
    // 40 degrees from edge to edge: a point at the edge is this high above the middle.
    let half = distance * 20f32.to_radians().tan();
    assert!((camera.focal() * half / depth - 150.0).abs() < 0.1);
    // It turns around what it looks at.
    let [x, y, _] = camera.turned(33.0).project(look_at).unwrap();
    assert!((x - 200.0).abs() < 0.01 && (y - 150.0).abs() < 0.01);
}

#[test]
fn a_camera_that_sees_nothing_is_an_error() {
    let (wall, normal) = floor();
    let mut subject = Subject::new(Walls { position: &wall, normal: &normal }, RADIUS);
    subject.add(&[[0.0, 0.2, 0.0]]);
    let fit = |eye: Option<[f32; 3]>, look_at: [f32; 3], field_of_view: f32, sweep: f32| {
        let field_of_view = Some(field_of_view);
        Camera::fit(&subject, &View { eye, look_at: Some(look_at), field_of_view, sweep, ..View::default() })
    };
    // Behind it, beside it, over it; and by yaw and pitch, far behind the scene.
    let away = [
        (Some([0.0, 1.0, 5.0]), [0.0, 1.0, 10.0]),
        (Some([0.0, 1.0, 5.0]), [9.0, 1.0, 4.0]),
        (Some([0.0, 1.0, 5.0]), [0.0, 9.0, 1.0]),
        (None, [-40.0, 0.0, -90.0]),
    ];
    for (eye, look_at) in away {
        let found = fit(eye, look_at, 20.0, 0.0);
        assert!(matches!(found, Err(Error::OutOfView)), "{eye:?} {look_at:?}: {found:?}");
    }
    // From within it, near to it, and seen only in the course of a turn.
    assert!(fit(Some([0.0, 0.5, 0.0]), [0.3, 0.0, 0.2], 90.0, 0.0).is_ok());
    assert!(fit(Some([0.0, 0.3, 0.2]), [0.013, 0.0, 0.017], 1.0, 0.0).is_ok());
    assert!(fit(Some([0.0, 1.0, 5.0]), [9.0, 1.0, 4.0], 20.0, 180.0).is_ok());
}

#[test]
fn the_walls_of_several_scenes_frame_a_picture_as_one() {
    let (wall, normal) = floor();
    let high: Vec<[f32; 3]> = wall.iter().map(|[x, _, z]| [*x, z + 2.0, -1.0]).collect();
    let all = [wall.clone(), high].concat();
    let walls = Walls { position: &all, normal: &[] };
    let particles = [[0.0, 0.3, 0.0], [0.2, 0.1, 0.1]];
    let view = View { width: 300, ..View::default() };
    let alone = camera(walls, &particles, &view);
    let mut subject = Subject::new(walls, RADIUS);
    subject.add_walls(walls);
    subject.add_walls(Walls { position: &wall, normal: &normal });
    subject.add(&particles);
    // The top is that of the particles, whatever the walls.
    assert_eq!(Camera::fit(&subject, &view).unwrap(), alone);
}

#[test]
fn the_lamp_stays_where_it_is_while_the_camera_turns() {
    let (wall, normal) = floor();
    let walls = Walls { position: &wall, normal: &normal };
    let stage = Stage::new(walls);
    let particle = [[0.0, 0.5, 0.0]];
    let view = View { yaw: 0.0, pitch: 45.0, width: 300, sweep: 90.0, ..View::default() };
    let camera = camera(walls, &particle, &view);
    let style = Style { radius: 0.2, ..Style::default() };
    let frame = Frame { position: &particle, ..Frame::default() };
    let shadow = [0.5 * 0.55 / 0.95, 0.0, -0.5 * 0.42 / 0.95];
    for degrees in [0.0, 45.0, 90.0] {
        let camera = camera.turned(degrees);
        let image = draw_frame(&frame, &stage, &camera, &style).unwrap();
        let lit = brightness(&image, &camera, [-0.8, 0.0, 0.6]);
        let dark = brightness(&image, &camera, shadow);
        assert!(3 * dark < 2 * lit, "{degrees}: {dark}, {lit}");
    }
}

//! Tiny scenes whose pictures are known, the same bits at any thread count, and input that is not as it should be.

use fluvia_render::{
    BODY_COLORS, Camera, Error, Frame, Image, Legend, OutsideTest, Page, Scale, Stage, Style, Subject,
    Surface, Tile, Values, View, Walls, draw_frame, speeds,
};
use proptest::prelude::*;

mod common;

use common::{RADIUS, TILE, assert_disc, camera};

fn small() -> View {
    View { width: 120, height: Some(90), ..View::default() }
}

/// Drops thrown about by a fixed rule, with speeds.
fn spray(count: usize) -> (Vec<[f32; 3]>, Vec<f32>) {
    let at = |i: usize| [0.618_034, 0.754_877, 0.569_84].map(|step: f32| (step * i as f32).fract());
    let position: Vec<[f32; 3]> = (0..count).map(at).collect();
    let speed = speeds(&position.iter().map(|p| p.map(|x| 4.0 * x)).collect::<Vec<_>>());
    (position, speed)
}

/// A floor of 1 m and a wall at its back, a point every 5 cm; normals up and to the front.
fn corner() -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let grid = || (0..21).flat_map(|i| (0..21).map(move |j| (i as f32 * 0.05, j as f32 * 0.05)));
    let floor = grid().map(|(x, z)| ([x, 0.0, z], [0.0, 1.0, 0.0]));
    let back = grid().map(|(x, y)| ([x, y, 0.0], [0.0, 0.0, 1.0]));
    floor.chain(back).unzip()
}

/// Which of some colours a pixel is nearest to in direction, as light scales all channels.
fn hue(pixel: [u8; 3], candidates: &[[u8; 3]]) -> usize {
    let unit = |c: [u8; 3]| {
        let length = c.iter().map(|&x| f32::from(x).powi(2)).sum::<f32>().sqrt();
        c.map(|x| f32::from(x) / length)
    };
    let likeness = |c: [u8; 3]| (0..3).map(|k| unit(c)[k] * unit(pixel)[k]).sum::<f32>();
    (0..candidates.len())
        .max_by(|&a, &b| likeness(candidates[a]).total_cmp(&likeness(candidates[b])))
        .expect("candidates")
}

#[test]
fn a_sphere_is_drawn_where_the_camera_sees_it_and_as_large() {
    let position = [[0.3, 0.2, -0.1], [0.9, 0.5, 0.2]];
    let camera = camera(Walls::default(), &position, &View { width: 400, ..View::default() });
    let frame = Frame { position: &position[..1], ..Frame::default() };
    let image = draw_frame(&frame, &Stage::default(), &camera, &Style::default()).unwrap();
    let [x, y, depth] = camera.project(position[0]).unwrap();
    let reach = camera.focal() * RADIUS / depth;
    assert!(reach > 10.0, "the sphere must be large enough to measure: {reach} pixels");
    // A pixel on the rim is partly covered: half its diagonal to either side.
    assert_disc(&image, [x, y], reach, 0.71);
    // The lamp is at the upper left.
    let brightness = |dx: f32, dy: f32| {
        let pixel = image.get((x + dx * reach) as u32, (y + dy * reach) as u32).unwrap();
        pixel.iter().map(|&c| u32::from(c)).sum::<u32>()
    };
    assert!(brightness(-0.4, -0.5) > brightness(0.4, 0.5));
}

#[test]
fn the_nearer_sphere_hides_the_farther_whatever_their_order() {
    let view = View { yaw: 0.0, pitch: 0.0, ..small() };
    let (near, far) = ([0.0, 0.0, 0.1], [0.0, 0.0, -0.1]);
    let position = [near, far, [0.2, 0.1, 0.0], [-0.2, -0.1, 0.0]];
    let camera = camera(Walls::default(), &position, &view);
    for (position, expected) in [([near, far], 0), ([far, near], 1)] {
        let frame = Frame { position: &position, values: Values::Body(&[0, 1]), ..Frame::default() };
        let image = draw_frame(&frame, &Stage::default(), &camera, &Style::default()).unwrap();
        let [x, y, _] = camera.project(near).unwrap();
        assert_eq!(hue(image.get(x as u32, y as u32).unwrap(), &BODY_COLORS[..2]), expected);
    }
}

#[test]
fn spheres_that_cut_each_other_meet_half_way() {
    let view = View { yaw: 0.0, pitch: 0.0, width: 300, ..View::default() };
    // Side by side at the same depth, overlapping by a radius.
    let position = [[-0.5 * RADIUS, 0.0, 0.0], [0.5 * RADIUS, 0.0, 0.0]];
    let camera = camera(Walls::default(), &position, &view);
    let frame = Frame { position: &position, values: Values::Body(&[0, 1]), ..Frame::default() };
    let image = draw_frame(&frame, &Stage::default(), &camera, &Style::default()).unwrap();
    let [middle, y, _] = camera.project([0.0; 3]).unwrap();
    for dx in [-40.0, -3.0, 3.0, 40.0] {
        let pixel = image.get((middle + dx) as u32, y as u32).unwrap();
        assert_eq!(hue(pixel, &BODY_COLORS[..2]), usize::from(dx > 0.0), "{dx} pixels from the middle");
    }
}

#[test]
fn a_particle_outside_is_orange_and_counted_in_the_label() {
    let position = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [f32::NAN, 0.0, 0.0]];
    let camera = camera(Walls::default(), &position, &View { yaw: 0.0, ..small() });
    let outside = [false, true, true];
    let frame = Frame {
        position: &position,
        values: Values::Scalar(&[0.0; 3]),
        outside: &outside,
        ..Frame::default()
    };
    assert_eq!((frame.outside_count(), frame.non_finite_count()), (1, 1));
    let style = Style::default();
    let image = draw_frame(&frame, &Stage::default(), &camera, &style).unwrap();
    let [x, y, _] = camera.project(position[1]).unwrap();
    let orange = [255, 110, 25];
    assert_eq!(hue(image.get(x as u32, y as u32).unwrap(), &[[70, 100, 180], orange]), 1);

    let page = |outside| {
        let frame =
            Frame { outside, position: &position[..2], values: Values::Scalar(&[0.0; 2]), surface: None };
        let tile = Tile { frame, label: "frame 3".to_owned(), note: "0.06 s".to_owned(), ..Tile::default() };
        let mut page = Page::new("", &[("", 1)], Legend::Scale, &camera, &style).unwrap();
        page.draw([0, 0], &tile).unwrap();
        page.finish()
    };
    // The label's line is the first 30 rows.
    let label_ink = |image: &Image| {
        image.data[..3 * 30 * image.width as usize].chunks_exact(3).filter(|p| *p == orange).count()
    };
    assert_eq!(label_ink(&page(&[][..])), 0);
    assert!(label_ink(&page(&[false, true][..])) > 5);
}

#[test]
fn walls_are_seen_from_their_front_and_behind_the_fluid() {
    let (wall, normal) = corner();
    let behind: Vec<_> = normal.iter().map(|n| n.map(|x| -x)).collect();
    let position = [[0.5, 0.5, 0.02]];
    let front = Walls { position: &wall, normal: &normal };
    let camera = camera(front, &position, &View { width: 300, ..View::default() });
    let empty = Frame::default();
    let style = Style::default();
    let drawn = |walls| {
        let image = draw_frame(&empty, &Stage::new(walls), &camera, &style).unwrap();
        image.data.chunks_exact(3).filter(|p| *p != TILE).count()
    };
    // All of the picture but its margins and the corners beside the walls.
    assert!(drawn(front) > 300 * camera.height() as usize / 2);
    assert_eq!(drawn(Walls { position: &wall, normal: &behind }), 0);
    // Without normals they are dots: 441 points on the floor and 21 x 11 on the part of the back below the highest
    // particle.
    let dots = drawn(Walls { position: &wall, normal: &[] });
    assert!(dots > 600 && dots < drawn(front) / 2, "{dots}");

    let with = |walls| {
        draw_frame(&Frame { position: &position, ..empty }, &Stage::new(walls), &camera, &style).unwrap()
    };
    let (bare, walled) = (with(Walls::default()), with(front));
    let [x, y, _] = camera.project(position[0]).unwrap();
    assert_eq!(bare.get(x as u32, y as u32), walled.get(x as u32, y as u32));
}

#[test]
fn the_same_bits_at_any_number_of_threads() {
    let (position, speed) = spray(3000);
    let (wall, normal) = corner();
    let walls = Walls { position: &wall, normal: &normal };
    let draw = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let marks = OutsideTest::new(walls, RADIUS).mark(&position);
            let frame = Frame {
                position: &position,
                values: Values::Scalar(&speed),
                outside: &marks,
                ..Frame::default()
            };
            let stage = Stage::new(walls);
            let tile = Tile { frame, stage: Some(&stage), label: "frame 0".to_owned(), note: String::new() };
            let camera = camera(walls, &position, &View { width: 200, ..View::default() });
            let style = Style::default();
            let mut page = Page::new("title", &[("row", 2)], Legend::Scale, &camera, &style).unwrap();
            [0, 1].into_iter().for_each(|column| page.draw([0, column], &tile).unwrap());
            page.finish()
        })
    };
    let one = draw(1);
    assert!(draw(2) == one && draw(3) == one && draw(8) == one);
}

#[test]
fn walls_fill_the_picture_to_its_margins_from_every_side() {
    let (wall, normal) = corner();
    let walls = Walls { position: &wall, normal: &normal };
    for yaw in [-170.0, -60.0, 0.0, 24.0, 95.0, 204.0] {
        for pitch in [-89.0, -20.0, 0.0, 18.0, 89.0] {
            let view = View { yaw, pitch, width: 300, margin: 10, ..View::default() };
            let camera = camera(walls, &[], &view);
            let seen: Vec<_> = wall.iter().map(|&p| camera.project(p).unwrap()).collect();
            let ends = |k: usize| {
                let values = seen.iter().map(|p| p[k]);
                (values.clone().fold(f32::INFINITY, f32::min), values.fold(0.0, f32::max))
            };
            let ((left, right), (top, bottom)) = (ends(0), ends(1));
            // A hundredth of a pixel for float32.
            assert!(left > 9.99 && right < 290.01 && top > 9.99);
            assert!(bottom < camera.height() as f32 - 9.5, "height is rounded to a pixel");
            let fills = (right - left > 279.9) || (bottom - top > camera.height() as f32 - 21.0);
            assert!(fills, "yaw {yaw}, pitch {pitch}");
        }
    }
}

#[test]
fn another_direction_up_gives_the_same_picture_of_the_turned_scene() {
    let (position, _) = spray(200);
    let turned: Vec<[f32; 3]> = position.iter().map(|&[x, y, z]| [x, -z, y]).collect();
    let draw = |position: &[[f32; 3]], up| {
        let mut subject = Subject::new(Walls::default(), RADIUS).with_up(up);
        subject.add(position);
        let camera = Camera::fit(&subject, &small()).unwrap();
        position.iter().map(|&p| camera.project(p).unwrap()).collect::<Vec<_>>()
    };
    let (expected, found) = (draw(&position, [0.0, 1.0, 0.0]), draw(&turned, [0.0, 0.0, 9.81]));
    for (a, b) in expected.iter().zip(&found) {
        // Pixels, from float32 results of float64 work.
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-3), "{a:?} {b:?}");
    }
}

#[test]
fn a_particle_thrown_far_away_does_not_shrink_the_picture() {
    let (mut position, _) = spray(2000);
    let usual = camera(Walls::default(), &position, &small());
    position.push([1e7, 3e8, -2.0]);
    let with_stray = camera(Walls::default(), &position, &small());
    assert_eq!(usual, with_stray);
}

#[test]
fn nothing_and_one_particle_give_pictures() {
    let style = Style::default();
    let empty = camera(Walls::default(), &[], &small());
    let image = draw_frame(&Frame::default(), &Stage::default(), &empty, &style).unwrap();
    assert_eq!(image, Image::filled(120, 90, TILE));
    let page = Page::new("", &[], Legend::None, &empty, &style).unwrap().finish();
    assert!(page.width > 0 && page.height > 0);

    // Far from the origin float32 still has steps of 1/16 m, but the particle is in the middle.
    for at in [[0.0; 3], [1e6, -1e6, 1e6]] {
        let one = camera(Walls::default(), &[at], &small());
        let image =
            draw_frame(&Frame { position: &[at], ..Frame::default() }, &Stage::default(), &one, &style);
        assert_ne!(image.unwrap().get(60, 45), Some(TILE));
    }
}

#[test]
fn particles_behind_and_at_the_camera_are_left_out() {
    let camera = camera(Walls::default(), &[[0.0; 3], [1.0; 3]], &small());
    let eye = camera.eye();
    let behind = eye.map(|x| 2.0 * x);
    assert_eq!((camera.project(eye), camera.project(behind)), (None, None));
    let frame = Frame { position: &[eye, behind], ..Frame::default() };
    let image = draw_frame(&frame, &Stage::default(), &camera, &Style::default()).unwrap();
    assert_eq!(image, Image::filled(120, 90, TILE));
}

#[test]
fn what_does_not_match_or_is_out_of_range_is_an_error_of_one_line() {
    let camera = camera(Walls::default(), &[[0.0; 3]], &small());
    let style = Style::default();
    let frame = Frame { position: &[[0.0; 3]; 2], values: Values::Scalar(&[1.0]), ..Frame::default() };
    let error = draw_frame(&frame, &Stage::default(), &camera, &style).unwrap_err();
    assert!(matches!(error, Error::Length { found: 1, expected: 2, .. }));
    assert_eq!(
        error.to_string(),
        "values of a frame: found 1 entries, expected one for each of the 2 particles"
    );

    let position = [[0.0; 3]; 3];
    let surface = Surface { position: &position, normal: &position, ..Surface::default() };
    for surface in [
        Surface { normal: &position[..2], ..surface },
        Surface { values: Values::Scalar(&[0.0]), ..surface },
        Surface { triangles: &[[0, 1, 3]], ..surface },
    ] {
        let frame = Frame { surface: Some(surface), ..Frame::default() };
        assert!(draw_frame(&frame, &Stage::default(), &camera, &style).is_err(), "{surface:?}");
    }

    let style = Style { radius: f32::NAN, ..style };
    assert!(draw_frame(&Frame::default(), &Stage::default(), &camera, &style).is_err());
    let subject = Subject::new(Walls::default(), RADIUS);
    let bad = [
        View { width: 0, ..View::default() },
        View { width: 1 << 20, ..View::default() },
        View { height: Some(0), ..View::default() },
        View { pitch: 90.0, ..View::default() },
        View { yaw: f32::NAN, ..View::default() },
        View { top: Some(f32::INFINITY), ..View::default() },
        View { eye: Some([f32::NAN, 0.0, 0.0]), ..View::default() },
        View { eye: Some([0.0, 5.0, 0.0]), look_at: Some([0.0; 3]), ..View::default() },
        View { eye: Some([1.0; 3]), look_at: Some([1.0; 3]), ..View::default() },
        View { look_at: Some([f32::INFINITY, 0.0, 0.0]), ..View::default() },
        View { field_of_view: Some(0.0), ..View::default() },
        View { field_of_view: Some(f32::NAN), ..View::default() },
        View { sweep: f32::NAN, ..View::default() },
    ];
    for view in bad {
        assert!(matches!(Camera::fit(&subject, &view), Err(Error::Parameter { .. })), "{view:?}");
    }
}

#[test]
fn a_scale_and_its_inverse_agree() {
    for scale in [Scale::speed(4.0), Scale::height(-1.0, 3.0)] {
        for place in [0.0, 0.1, 0.5, 1.0] {
            // Float32 rounding of a square and a root.
            assert!((scale.place(scale.value(place)).unwrap() - place).abs() < 1e-6);
        }
        assert_eq!(
            (scale.place(-9.0), scale.place(9.0), scale.place(f32::NAN)),
            (Some(0.0), Some(1.0), None)
        );
    }
    assert_eq!(Scale::speed(4.0).place(1.0), Some(0.5));
    assert_eq!(Scale::height(2.0, 2.0).place(5.0), Some(0.0));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any bits at all as positions, values, normals: a picture of the right size, never a panic.
    #[test]
    fn any_numbers_give_a_picture(
        position in prop::collection::vec(prop::array::uniform3(any::<f32>()), 0..40),
        wall in prop::collection::vec(prop::array::uniform3(any::<f32>()), 0..20),
        corners in prop::collection::vec(prop::array::uniform3(any::<u32>()), 0..20),
        up in prop::array::uniform3(any::<f32>()),
        top in prop::option::of(-1e9f32..1e9),
        width in 1u32..50,
    ) {
        let walls = Walls { position: &wall, normal: &wall };
        let mut subject = Subject::new(walls, RADIUS).with_up(up);
        subject.add(&position);
        let camera = Camera::fit(&subject, &View { width, top, ..View::default() }).unwrap();
        let marks = OutsideTest::new(walls, RADIUS).mark(&position);
        let values: Vec<f32> = position.iter().map(|p| p[0]).collect();
        let triangles: Vec<_> = match position.len() as u32 {
            0 => Vec::new(),
            count => corners.iter().map(|corners| corners.map(|v| v % count)).collect(),
        };
        let surface =
            Surface { position: &position, normal: &position, triangles: &triangles, values: Values::Scalar(&values) };
        let frame = Frame {
            position: &position,
            values: Values::Scalar(&values),
            outside: &marks,
            surface: (!corners.is_empty()).then_some(surface),
        };
        let image = draw_frame(&frame, &Stage::new(walls), &camera, &Style::default()).unwrap();
        prop_assert_eq!(image.data.len(), 3 * (image.width * image.height) as usize);
        prop_assert_eq!((image.width, image.height), (camera.width(), camera.height()));
    }
}

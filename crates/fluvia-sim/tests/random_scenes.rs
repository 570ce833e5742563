//! Random scenes: reproducible, clear of walls and each other, within their ranges, never given up in silence.

use std::path::Path;
use std::time::Instant;

use fluvia_sim::mesh::TriangleMesh;
use fluvia_sim::scene::random::{
    BODIES, CONTAINERS, MATERIAL_TEST_VISCOSITIES, Model, RandomScene, Recipe, Retries, Speed, Viscosity,
    random_scene,
};
use fluvia_sim::scene::{Scene, Source};
use fluvia_sim::shapes::Shape;

/// The distance between particles.
const SPACING: f64 = 0.05;
/// What float32 takes from a distance of some metres.
const ROUNDING: f64 = 1e-6;

fn draw(recipe: &Recipe, seed: u64) -> RandomScene {
    random_scene(recipe, seed).unwrap_or_else(|error| panic!("seed {seed}: {error}"))
}

fn presets() -> [(&'static str, Recipe); 5] {
    [
        ("default", Recipe::default_scenes()),
        ("box-6k", Recipe::box_6k()),
        ("viscosity", Recipe::viscosity()),
        ("dam-break", Recipe::dam_break()),
        ("material-test", Recipe::material_test(0.127)),
    ]
}

/// The particles of each body, as a simulation has them.
fn bodies(scene: &Scene) -> Vec<Vec<[f32; 3]>> {
    let fluids = Scene { walls: Vec::new(), ..scene.clone() };
    fluids.sample(0).expect("a set-up").emitters.into_iter().map(|emitter| emitter.position).collect()
}

fn shape_of(source: &Source) -> Shape {
    let Source::Shape(shape) = source else { panic!("a built-in shape") };
    *shape
}

fn container(scene: &Scene) -> TriangleMesh {
    let wall = &scene.walls[0];
    Model { shape: shape_of(&wall.source), size: wall.placement.scale }.mesh()
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

/// The nearest point of a triangle (Ericson, Real-Time Collision Detection, 5.1.5): another way than the library's.
fn distance_to_triangle(p: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> f64 {
    let along = |from: [f64; 3], to: [f64; 3], t: f64| [0, 1, 2].map(|k| from[k] + t * (to[k] - from[k]));
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    let (d3, d4) = (dot(ab, sub(p, b)), dot(ac, sub(p, b)));
    let (d5, d6) = (dot(ab, sub(p, c)), dot(ac, sub(p, c)));
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    let nearest = if d1 <= 0.0 && d2 <= 0.0 {
        a
    } else if d3 >= 0.0 && d4 <= d3 {
        b
    } else if d6 >= 0.0 && d5 <= d6 {
        c
    } else if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        along(a, b, d1 / (d1 - d3))
    } else if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        along(a, c, d2 / (d2 - d6))
    } else if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        along(b, c, (d4 - d3) / ((d4 - d3) + (d5 - d6)))
    } else {
        let sum = va + vb + vc;
        [0, 1, 2].map(|k| a[k] + ab[k] * vb / sum + ac[k] * vc / sum)
    };
    let offset = sub(p, nearest);
    dot(offset, offset).sqrt()
}

/// Checks by brute force that all particles are inside and keep a spacing clear of walls and other bodies. Gives the
/// least distance to the wall.
fn check_clear(scene: &Scene, name: &str) -> f64 {
    let (mesh, bodies) = (container(scene), bodies(scene));
    let triangles: Vec<[[f64; 3]; 3]> =
        mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize].map(f64::from))).collect();
    let mut least = f64::INFINITY;
    for (i, body) in bodies.iter().enumerate() {
        assert!(mesh.contains(body).iter().all(|&inside| inside), "{name}: body {i} is outside");
        for particle in body.iter().map(|x| x.map(f64::from)) {
            for triangle in &triangles {
                // Nothing nearer than 0.2 m can be missed by its bounds.
                let is_far = (0..3).any(|k| {
                    triangle.iter().all(|x| x[k] > particle[k] + 0.2)
                        || triangle.iter().all(|x| x[k] < particle[k] - 0.2)
                });
                if !is_far {
                    least = least.min(distance_to_triangle(particle, *triangle));
                }
            }
        }
        for (k, other) in bodies.iter().enumerate().take(i) {
            let mut nearest = f64::INFINITY;
            for a in body.iter().map(|x| x.map(f64::from)) {
                for b in other {
                    let offset = sub(a, b.map(f64::from));
                    nearest = nearest.min(dot(offset, offset));
                }
            }
            assert!(nearest.sqrt() >= SPACING - ROUNDING, "{name}: bodies {k} and {i} at {}", nearest.sqrt());
        }
    }
    assert!(least >= SPACING - ROUNDING, "{name}: {least} from the wall");
    least
}

#[test]
fn bodies_touch_neither_walls_nor_each_other() {
    for (name, recipe) in presets() {
        let seeds = if name == "default" { 40 } else { 6 };
        for seed in 0..seeds {
            let RandomScene { scene, particles, .. } = draw(&recipe, seed);
            check_clear(&scene, &format!("{name} {seed}"));
            assert_eq!(bodies(&scene).iter().map(Vec::len).sum::<usize>(), particles, "{name} {seed}");
        }
    }
    // And in every container.
    for container in CONTAINERS {
        let recipe = Recipe { containers: vec![container], body_count: 3..=3, ..Recipe::default_scenes() };
        for seed in 0..2 {
            check_clear(&draw(&recipe, seed).scene, &format!("{} {seed}", container.shape.name()));
        }
    }
}

/// `cargo run -p fluvia-sim --example write_models` writes them.
#[test]
fn the_models_in_assets_are_those_of_the_code() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/models");
    for model in CONTAINERS.iter().chain(&BODIES) {
        let path = folder.join(model.shape.name()).with_extension("obj");
        let text = std::fs::read_to_string(&path).expect("a model");
        assert!(text.replace("\r\n", "\n") == model.mesh().to_obj(), "{}", path.display());
        let mesh = TriangleMesh::load(&path).expect("a mesh");
        assert!(mesh.is_oriented() && mesh.triangles.len() == model.mesh().triangles.len());
        assert!((mesh.volume() - model.mesh().volume()).abs() < 1e-5, "rounded to a micrometre");
    }
    let count = std::fs::read_dir(&folder).expect("a folder").count();
    assert_eq!(count, CONTAINERS.len() + BODIES.len(), "no other file");
}

#[test]
fn a_block_stands_as_low_as_it_may() {
    // The clearance, half a cell's diagonal and one cell more.
    let most = SPACING + (0.866_026 + 1.0) * 0.5 * SPACING + 1e-4;
    for seed in 0..10 {
        let scene = draw(&Recipe::dam_break(), seed).scene;
        let lowest = bodies(&scene)[0].iter().map(|x| x[1]).fold(f32::INFINITY, f32::min);
        assert!(f64::from(lowest) < most, "seed {seed}: {lowest}");
    }
}

#[test]
fn a_sampled_scene_has_no_warnings() {
    for (name, recipe) in presets() {
        let scene = draw(&recipe, 3).scene;
        let setup = scene.sample(0).expect("a set-up");
        assert_eq!(setup.warnings(), [""; 0], "{name}");
    }
}

#[test]
fn the_seed_decides_the_scene_and_the_file_keeps_it() {
    for (name, recipe) in presets() {
        let mut texts = Vec::new();
        for seed in 0..10 {
            let scene = draw(&recipe, seed).scene;
            assert_eq!(draw(&recipe, seed).scene, scene, "{name} {seed}");
            let text = scene.to_json().expect("a scene file");
            let read = Scene::parse(text.as_bytes(), &scene.path).expect("a scene");
            assert_eq!(read, scene, "{name} {seed}");
            texts.push(text);
        }
        texts.sort();
        texts.dedup();
        assert_eq!(texts.len(), 10, "{name}: seeds with the same scene");
    }
}

/// FNV-1a.
fn hash(text: &str) -> u64 {
    text.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
}

/// Data sets are made again from their seeds: a change of these is a change of every data set.
#[test]
fn streams_stay_the_same_between_versions() {
    let expected = r#"{
    "walls": [
        {"shape": "container", "scale": [2.0, 4.0, 2.0]}
    ],
    "fluids": [
        {"shape": "elbow", "scale": 1.0247, "rotation": {"axis": [-0.8876, -0.1869, -0.4209], "angle": 130.7}, "translation": [0.2237, 0.7135, 0.0579], "velocity": [-1.6907, 0.194, 0.2129]},
        {"shape": "elbow", "scale": 0.5657, "rotation": {"axis": [0.7239, 0.3595, 0.5888], "angle": 162.56}, "translation": [0.2797, 1.725, -0.2291], "velocity": [1.8585, 0.2126, -1.2361]},
        {"shape": "horseshoe", "scale": 0.776, "rotation": {"axis": [0.594, -0.3568, -0.721], "angle": 292.11}, "translation": [-0.2285, 2.3999, -0.3319], "velocity": [0.0185, -0.2196, -1.7011]}
    ],
    "gravity": [0.0, -9.81, 0.0], "dt": 0.02, "viscosity": 0.01, "density": 1000.0
}
"#;
    assert_eq!(draw(&Recipe::default_scenes(), 1).scene.to_json().expect("a scene file"), expected);
    let texts = |recipe: &Recipe| -> String {
        (0..20).map(|seed| draw(recipe, seed).scene.to_json().expect("a scene file")).collect()
    };
    let hashes = presets().map(|(name, recipe)| (name, hash(&texts(&recipe))));
    let expected = [
        ("default", 9_024_776_102_271_131_943),
        ("box-6k", 7_168_674_843_242_295_628),
        ("viscosity", 776_620_242_532_116_765),
        ("dam-break", 4_473_206_222_432_327_770),
        ("material-test", 17_197_199_140_629_981_303),
    ];
    assert_eq!(hashes, expected);
}

#[test]
fn everything_is_in_its_range() {
    let recipe = Recipe::default_scenes();
    let (mut counts, mut shapes, mut containers) = ([0; 4], Vec::new(), Vec::new());
    let mut particles = Vec::new();
    for seed in 0..120 {
        let drawn = draw(&recipe, seed);
        let scene = &drawn.scene;
        counts[scene.fluids.len()] += 1;
        assert!(recipe.particles.contains(&drawn.particles), "{seed}");
        particles.push(drawn.particles);
        containers.push(shape_of(&scene.walls[0].source).name());
        for fluid in &scene.fluids {
            shapes.push(shape_of(&fluid.source).name());
            let [x, y, z] = fluid.placement.scale;
            assert!(x == y && y == z && (0.5..=1.5).contains(&x), "{seed}: {x}");
            let [vx, vy, vz] = fluid.velocity.expect("a velocity");
            assert!(vx.abs() <= 2.0 && vy.abs() <= 0.5 && vz.abs() <= 2.0, "{seed}");
        }
        assert_eq!((scene.gravity, scene.dt), (Some([0.0, -9.81, 0.0]), Some(0.02)));
        assert_eq!((scene.material.viscosity, scene.material.density), (Some(0.01), Some(1000.0)));
    }
    // Five standard deviations of a third of 120.
    assert!(counts[1..].iter().all(|count: &i32| count.abs_diff(40) < 26), "{counts:?}");
    for (list, all) in [(&mut shapes, BODIES.len()), (&mut containers, CONTAINERS.len())] {
        list.sort_unstable();
        list.dedup();
        assert_eq!(list.len(), all, "all are drawn");
    }
    particles.sort_unstable();
    assert!((4_500..8_500).contains(&particles[60]), "a median of {} particles", particles[60]);
}

#[test]
fn a_number_of_particles_is_met_exactly() {
    for seed in 0..20 {
        let drawn = draw(&Recipe::box_6k(), seed);
        assert_eq!(drawn.particles, 6000);
        assert_eq!(shape_of(&drawn.scene.walls[0].source), Shape::Container);
    }
    for count in [1_000, 4_913, 15_001] {
        let recipe = Recipe { particles: count..=count, ..Recipe::default_scenes() };
        assert_eq!(bodies(&draw(&recipe, 5).scene).iter().map(Vec::len).sum::<usize>(), count);
    }
    let recipe = Recipe { particles: 7_000..=7_100, ..Recipe::default_scenes() };
    assert!((0..10).all(|seed| (7_000..=7_100).contains(&draw(&recipe, seed).particles)));
}

#[test]
fn the_hardest_case_has_the_highest_speeds() {
    let recipe = Recipe { speed: Speed::Highest, ..Recipe::default_scenes() };
    let mut signs = [0; 3];
    for fluid in (0..30).flat_map(|seed| draw(&recipe, seed).scene.fluids) {
        let velocity = fluid.velocity.expect("a velocity");
        assert_eq!(velocity.map(f32::abs), [2.0, 0.5, 2.0]);
        (0..3).for_each(|k| signs[k] += velocity[k].signum() as i32);
    }
    // About 60 bodies, both directions of each axis among them.
    assert!(signs.iter().all(|sum| sum.abs() < 40), "{signs:?}");
}

#[test]
fn viscosity_is_one_for_a_scene_and_changes_nothing_else() {
    let viscosities: Vec<f32> = (0..40)
        .map(|seed| draw(&Recipe::viscosity(), seed).scene.material.viscosity.expect("a viscosity"))
        .collect();
    assert!(viscosities.iter().all(|viscosity| (0.01..=0.3).contains(viscosity)));
    let mean = viscosities.iter().sum::<f32>() / 40.0;
    // Five standard errors of the mean of 40.
    assert!((mean - 0.155).abs() < 0.07, "{mean}");

    let first = draw(&Recipe::material_test(MATERIAL_TEST_VISCOSITIES[0]), 7).scene;
    assert!(BODIES.iter().all(|body| body.shape != shape_of(&first.fluids[0].source)));
    for viscosity in MATERIAL_TEST_VISCOSITIES {
        let mut scene = draw(&Recipe::material_test(viscosity), 7).scene;
        assert_eq!(scene.material.viscosity.replace(0.044), Some(viscosity));
        assert_eq!(scene, first);
    }
}

#[test]
fn the_dam_break_is_that_of_dpi_nets() {
    let setup = draw(&Recipe::dam_break(), 0).scene.sample(0).expect("a set-up");
    assert_eq!(setup.emitters[0].position.len(), 3456);
    assert!((setup.gravity[1] + 8.918_182).abs() < 1e-5 && (setup.dt - 1.0 / 60.0).abs() < 1e-7);
    assert_eq!(setup.emitters[0].velocity[0], [0.0; 3]);
    assert_eq!(setup.emitters[0].material.viscosity, None);
}

#[test]
fn all_bodies_can_be_sampled_in_their_smallest_size() {
    for model in BODIES {
        let recipe =
            Recipe { bodies: vec![model], scale: 0.5..=0.5, particles: 1..=1000, ..Recipe::default_scenes() };
        let recipe = Recipe { body_count: 1..=1, ..recipe };
        let particles = draw(&recipe, 0).particles;
        assert!((180..=1000).contains(&particles), "{}: {particles}", model.shape.name());
    }
}

#[test]
fn what_was_drawn_in_vain_is_counted() {
    let all = |recipe: &Recipe| (0..30).map(|seed| draw(recipe, seed).retries).collect::<Vec<_>>();
    let easy =
        Recipe { scale: 0.5..=0.5, body_count: 1..=1, particles: 1..=9999, ..Recipe::default_scenes() };
    assert_eq!(all(&easy), vec![Retries::default(); 30]);
    // Three large bodies in a narrow box: columns are full, bodies too large, scenes given up.
    let narrow = Model { shape: Shape::Container, size: [1.2, 2.4, 1.2] };
    let hard =
        Recipe { containers: vec![narrow], body_count: 3..=3, scale: 0.5..=1.2, ..Recipe::default_scenes() };
    let retries = all(&hard);
    assert!(retries.iter().any(|retries| retries.columns > 0));
    assert!(retries.iter().any(|retries| retries.bodies > 0));
    assert!(retries.iter().any(|retries| retries.scenes > 0));
}

#[test]
fn what_cannot_be_drawn_is_an_error_in_bounded_time() {
    let plain = Recipe::default_scenes;
    let tiny = Model { shape: Shape::Container, size: [0.3; 3] };
    let speck = Model { shape: Shape::Box, size: [0.01; 3] };
    let start = Instant::now();
    for recipe in [
        Recipe { containers: vec![tiny], ..plain() },
        Recipe { bodies: vec![speck], ..plain() },
        Recipe { particles: 1..=50, ..plain() },
        Recipe { particles: 50..=50, body_count: 1..=1, ..plain() },
        Recipe { particles: 900_000..=1_000_000, ..plain() },
        Recipe { particles: 500_000..=1_000_000, ..plain() },
        Recipe { body_count: 200..=200, ..plain() },
    ] {
        let message = random_scene(&recipe, 0).expect_err("impossible").to_string();
        assert!(message.contains("no random scene") && !message.contains('\n'), "{message}");
    }
    // Eight seconds on an idle machine.
    assert!(start.elapsed().as_secs() < 240, "{:?}", start.elapsed());
    #[allow(clippy::reversed_empty_ranges, reason = "an empty range is what is refused")]
    let empty = 3..=1;
    for (recipe, expected) in [
        (Recipe { containers: Vec::new(), ..plain() }, "containers"),
        (Recipe { bodies: Vec::new(), ..plain() }, "bodies"),
        (Recipe { body_count: 0..=1, ..plain() }, "body_count"),
        (Recipe { body_count: empty, ..plain() }, "body_count"),
        (Recipe { scale: 0.0..=1.0, ..plain() }, "scale"),
        (Recipe { scale: f32::NAN..=1.0, ..plain() }, "scale"),
        (Recipe { velocity: [f32::NAN, 0.0, 0.0], ..plain() }, "velocity"),
        (Recipe { reach: [-1.0, 0.0], ..plain() }, "reach"),
        (Recipe { viscosity: Viscosity::Uniform(0.3..=f32::INFINITY), ..plain() }, "viscosity"),
        (Recipe { density: Some(0.0), ..plain() }, "density"),
        (Recipe { particles: 0..=10, ..plain() }, "particles"),
        (Recipe { dt: 0.0, ..plain() }, "dt"),
        (Recipe { gravity: [f32::INFINITY; 3], ..plain() }, "gravity"),
    ] {
        let message = random_scene(&recipe, 0).expect_err("no recipe").to_string();
        assert!(message.starts_with("recipe: ") && message.contains(expected), "{message}");
    }
}

//! DFSPH against SPlisHSPlasH from the same state with the same walls: slow, and it reads the reference data.
//!
//! `cargo test --release -p fluvia-sim --test dfsph_reference -- --ignored --nocapture`

mod common;

use common::{GRAVITY, RADIUS, block, particles, reference};
use fluvia_sim::dfsph::{Dfsph, Liquid, Params};
use fluvia_sim::frames::sequence::Sequence;
use fluvia_sim::metrics;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::Solver;
use fluvia_sim::scene::Scene;
use fluvia_sim::substep::Substep;

const DT: f32 = 0.02;

/// The part of its range by which a curve may be off.
const WITHIN: f64 = 0.1;

/// One number a frame.
#[derive(Default)]
struct Curves {
    kinetic_energy: Vec<f64>,
    height: Vec<f64>,
    spread: Vec<f64>,
    surface: Vec<f64>,
}

impl Curves {
    fn push(&mut self, position: &[[f32; 3]], velocity: &[[f32; 3]]) {
        self.kinetic_energy.push(metrics::kinetic_energy(velocity));
        self.height.push(metrics::mean_vector(position).expect("particles")[1]);
        self.spread.push(metrics::spread(position).expect("particles"));
        self.surface.push(metrics::surface_height(position, 0.1).expect("particles").into());
    }
}

/// What our solver makes of a state.
struct Ours {
    curves: Curves,
    highest_density: f32,
    /// Mean compression of each frame but the first.
    compression: Vec<f64>,
    unconverged: u32,
}

fn simulate(walls: &Boundary, mut fluid: Particles, substep: Substep, viscosity: f32, frames: usize) -> Ours {
    let liquids = vec![Liquid { viscosity, ..Liquid::default() }; 4];
    let mut solver = Dfsph::new(Params { substep, ..Params::default() }, walls, RADIUS, &liquids)
        .expect("good parameters");
    let mut ours =
        Ours { curves: Curves::default(), highest_density: 0.0, compression: Vec::new(), unconverged: 0 };
    for frame in 0..frames {
        if frame > 0 {
            ours.unconverged +=
                solver.step(&mut fluid, Acceleration::Uniform(GRAVITY), DT).expect("a step").unconverged;
            // The state that is given may be denser.
            let ratios = metrics::density_ratios(&fluid.position, &walls.position, RADIUS);
            ours.highest_density = ratios.iter().copied().fold(ours.highest_density, f32::max);
            ours.compression.push(metrics::mean_compression(&ratios));
        }
        ours.curves.push(&fluid.position, &fluid.velocity);
    }
    ours
}

/// The largest difference of two curves as a part of the range of the second.
fn apart(name: &str, ours: &[f64], theirs: &[f64]) -> f64 {
    let range =
        theirs.iter().copied().fold(f64::MIN, f64::max) - theirs.iter().copied().fold(f64::MAX, f64::min);
    let differences: Vec<f64> = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs() / range).collect();
    let (frame, largest) =
        differences.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).expect("frames");
    let mean = differences.iter().sum::<f64>() / differences.len() as f64;
    println!(
        "  {name}: largest {:.2} % of its range (frame {frame}), mean {:.2} %",
        100.0 * largest,
        100.0 * mean
    );
    largest
}

fn mean_of_last(values: &[f64], count: usize) -> f64 {
    values[values.len() - count..].iter().sum::<f64>() / count as f64
}

#[test]
#[ignore = "minutes, and it reads the reference data"]
fn sequences() {
    let Some(folder) = reference() else { return };
    let scenes = [
        ("valid/sim_0206", 0.01, true),
        ("valid/sim_0301", 0.01, true),
        ("viscosity/sim_visc_0.044", 0.044, false),
        ("viscosity/sim_visc_0.174", 0.174, false),
        ("viscosity/sim_visc_0.4", 0.4, false),
    ];
    let mut spreads = Vec::new();
    for (name, viscosity, adaptive_too) in scenes {
        let mut sequence = Sequence::open(&folder.join("splishsplash/dataset").join(name)).unwrap();
        let (walls, numbers) = (sequence.walls().clone(), sequence.frames());
        let mut theirs = Curves::default();
        let mut start = None;
        for number in numbers.clone() {
            let frame = sequence.frame(number).unwrap();
            theirs.push(&frame.position, &frame.velocity);
            start.get_or_insert_with(|| {
                Particles::of_one_body(frame.position.clone(), frame.velocity.clone())
            });
        }
        let start = start.expect("frames");
        let count = theirs.height.len();
        let steps = if adaptive_too {
            vec![Substep::Fixed(0.001), Substep::AtMost(0.005)]
        } else {
            vec![Substep::Fixed(0.001)]
        };
        for substep in steps {
            println!("{name}, {substep:?}");
            let ours = simulate(&walls, start.clone(), substep, viscosity, count);
            assert_eq!(ours.unconverged, 0);
            assert!(apart("kinetic energy", &ours.curves.kinetic_energy, &theirs.kinetic_energy) < WITHIN);
            assert!(apart("height of the centre of mass", &ours.curves.height, &theirs.height) < WITHIN);
            let spread = apart("spread", &ours.curves.spread, &theirs.spread);
            let surface = [&ours.curves, &theirs].map(|curves| mean_of_last(&curves.surface, 10));
            println!(
                "  surface at the end: {:.4} m, theirs {:.4} m; highest density {:.5}",
                surface[0], surface[1], ours.highest_density
            );
            if substep == Substep::Fixed(0.001) {
                assert!(spread < WITHIN);
                assert!((surface[0] - surface[1]).abs() < f64::from(RADIUS));
                assert!(ours.highest_density <= 1.005);
            }
            if !adaptive_too {
                spreads.push(ours.curves.spread);
            }
        }
    }
    // The less viscous spreads more, from the impact on.
    for frame in 25..100 {
        assert!(spreads.windows(2).all(|pair| pair[0][frame] > pair[1][frame]), "frame {frame}");
    }
}

#[test]
#[ignore = "minutes, and it reads the reference data"]
fn dam_break() {
    let Some(folder) = reference() else { return };
    let text = std::fs::read_to_string(folder.join("splishsplash/dfsph_reference.json")).unwrap();
    let data: serde_json::Value = serde_json::from_str(&text).unwrap();
    // Their box, with wall particles at random as theirs are.
    let scene = r#"{"walls": [{"shape": "container", "scale": [2, 4, 2]}], "fluids": [{"shape": "box"}]}"#;
    let walls = Scene::parse(scene.as_bytes(), "box.json").unwrap().sample(0).unwrap().boundary;
    let start = particles(block([-0.95, 0.05, -0.95], [18; 3]), [0.0; 3]);
    for (run, substep) in
        [("dam_v216_fix1ms", Substep::Fixed(0.001)), ("dam_v216_cfl5ms", Substep::AtMost(0.005))]
    {
        let numbers = |value: &serde_json::Value| -> Vec<f64> {
            value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
        };
        let [fixed, own] = ["dam_v216_fix1ms", run].map(|run| &data["runs"][run]);
        let mass = own["particle_mass"].as_f64().unwrap() * start.len() as f64;
        let frames = &fixed["per_frame"];
        let energy: Vec<f64> = numbers(&frames["kinetic_energy"]).iter().map(|e| e / mass).collect();
        let height: Vec<f64> =
            frames["center_of_mass"].as_array().unwrap().iter().map(|x| x[1].as_f64().unwrap()).collect();
        println!("dam break, {substep:?}, against their 1 ms");
        let ours = simulate(&walls, start.clone(), substep, 0.01, height.len());
        assert_eq!(ours.unconverged, 0);
        assert!(apart("kinetic energy", &ours.curves.kinetic_energy, &energy) < WITHIN);
        assert!(apart("height of the centre of mass", &ours.curves.height, &height) < WITHIN);
        let theirs = numbers(&own["per_frame"]["from_frame_1"]["rho_err_mean_rel"]);
        let surface = mean_of_last(&ours.curves.surface, 10);
        let expected = own["surface_height_end"]["median"].as_f64().unwrap();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        println!(
            "  surface at the end: {surface:.4} m, theirs {expected:.4} m; highest density {:.5}, theirs {}",
            ours.highest_density, own["density_max_rel_over_run"]
        );
        println!(
            "  mean compression over all frames: {:.2e}, theirs {:.2e}",
            mean(&ours.compression),
            mean(&theirs)
        );
        assert!((surface - expected).abs() < f64::from(RADIUS));
        if run == "dam_v216_fix1ms" {
            assert!(ours.highest_density <= 1.005);
            assert!(mean(&ours.compression) <= mean(&theirs));
        }
    }
}

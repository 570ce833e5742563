//! What divergence-free SPH must do, on scenes small enough for every run of the tests.

mod common;

use common::{DT, GRAVITY, RADIUS, block, box_walls, dam_break, emitter, particles, setup};
use fluvia_sim::dfsph::{Dfsph, Liquid, Params};
use fluvia_sim::metrics::{self, Bounds};
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::rollout::{Rollout, Solver};
use fluvia_sim::scene::Scene;
use fluvia_sim::substep::Substep;

const NOWHERE: Acceleration<'_> = Acceleration::Uniform([0.0; 3]);

fn fixed(seconds: f32) -> Params {
    Params { substep: Substep::Fixed(seconds), ..Params::default() }
}

fn solver(params: Params, walls: &Boundary) -> Dfsph {
    Dfsph::new(params, walls, RADIUS, &[]).expect("good parameters")
}

fn run(solver: &mut Dfsph, particles: &mut Particles, frames: usize) {
    for _ in 0..frames {
        solver.step(particles, Acceleration::Uniform(GRAVITY), DT).expect("good parameters");
    }
}

/// Two blocks that meet.
fn collision() -> Particles {
    let (left, right) = (block([0.0; 3], [5, 5, 5]), block([0.3, 0.02, 0.01], [4, 5, 5]));
    let mut fluid = particles([left.clone(), right].concat(), [1.0, 0.2, 0.0]);
    fluid.velocity[left.len()..].fill([-1.5, 0.0, 0.3]);
    fluid.body[left.len()..].fill(1);
    fluid
}

/// Σ m v, kilogram metres per second and particle volume.
fn momentum(fluid: &Particles, density: [f64; 2]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (v, &body) in fluid.velocity.iter().zip(&fluid.body) {
        (0..3).for_each(|a| sum[a] += density[body as usize] * f64::from(v[a]));
    }
    sum
}

#[test]
fn a_drop_falls_freely() {
    let start = particles(block([0.1, 2.0, -0.3], [3, 3, 3]), [0.4, 0.0, -0.2]);
    let mut fluid = start.clone();
    run(&mut solver(fixed(0.002), &Boundary::default()), &mut fluid, 25);
    let time = 25.0 * DT;
    // Symplectic Euler falls g h t / 2 ahead of g t² / 2.
    let fall = 0.5 * 9.81 * time * (time + 0.002);
    let moved = [0.4 * time, -fall, -0.2 * time];
    for i in 0..fluid.len() {
        let found: [f32; 3] = std::array::from_fn(|a| fluid.position[i][a] - start.position[i][a]);
        // 250 roundings of 2 m in float32, and of velocities that differ in the last bit between neighbours.
        let near = found.iter().zip(moved).all(|(found, moved)| (found - moved).abs() < 1e-4);
        assert!(near, "particle {i}: {found:?}, expected {moved:?}");
        assert!((fluid.velocity[i][1] + 9.81 * time).abs() < 1e-4, "{:?}", fluid.velocity[i]);
    }
}

#[test]
fn frame_times_are_hit_exactly() {
    for substep in [Substep::Fixed(0.003), Substep::AtMost(0.007), Substep::AtMost(1.0)] {
        let mut fluid = particles(vec![[0.0; 3]], [1.0, 0.0, 0.0]);
        let mut solver = solver(Params { substep, ..Params::default() }, &Boundary::default());
        let info = solver.step(&mut fluid, NOWHERE, DT).unwrap();
        assert!((fluid.position[0][0] - DT).abs() < 1e-7, "{substep:?}: {}", fluid.position[0][0]);
        assert_eq!(info.substeps as usize, solver.steps().len());
        let total: f32 = solver.steps().iter().map(|step| step.dt).sum();
        assert!((total - DT).abs() < 1e-8, "{substep:?}: {total}");
        // 0.4 diameters at 1 m/s are 20 ms: the adaptive step is as long as it may.
        let expected =
            if substep == Substep::Fixed(0.003) { 7 } else { (DT / substep.longest().min(DT)).ceil() as u32 };
        assert_eq!(info.substeps, expected, "{substep:?}");
    }
}

#[test]
fn fast_particles_shorten_the_step() {
    let mut fluid = particles(vec![[0.0; 3]], [0.0, 8.0, 0.0]);
    let mut solver = solver(Params::default(), &Boundary::default());
    solver.step(&mut fluid, NOWHERE, DT).unwrap();
    // 0.4 diameters of 5 cm at 8 m/s: 2.5 ms.
    assert_eq!(solver.steps().len(), 8);
    fluid.velocity[0] = [0.0, 1e6, 0.0];
    solver.step(&mut fluid, NOWHERE, DT).unwrap();
    // Never below 0.1 ms.
    assert_eq!(solver.steps().len(), 200);
}

#[test]
fn a_step_depends_on_the_particles_and_their_memory_alone() {
    let (walls, mut fluid) = dam_break();
    let mut first = solver(Params::default(), &walls);
    run(&mut first, &mut fluid, 10);
    assert!(fluid.memory.iter().flatten().any(|&pressure| pressure > 0.0), "no pressure is kept");
    let mut resumed = fluid.clone();
    let mut forgetful = Particles { memory: Vec::new(), ..fluid.clone() };
    run(&mut first, &mut fluid, 5);
    run(&mut solver(Params::default(), &walls), &mut resumed, 5);
    assert_eq!(fluid, resumed);
    run(&mut solver(Params::default(), &walls), &mut forgetful, 5);
    assert_ne!(fluid.position, forgetful.position, "the memory does nothing");
}

#[test]
fn memory_moves_with_its_particle() {
    let walls = box_walls([0.0; 3], [0.6, 0.6, 0.4], RADIUS);
    let pool = block([0.05; 3], [11, 2, 7]);
    // Those that begin below the floor are removed after the first step.
    let fallen = vec![[0.3, -0.5, 0.2]; 2];
    let jet = block([0.3, 0.4, 0.2], [2, 2, 2]);
    let emitters = vec![
        emitter(fallen, [0.0; 3], [0, 1, 1]),
        emitter(pool, [0.0; 3], [0, 1, 1]),
        emitter(jet, [0.0, -2.0, 0.0], [3, 20, 4]),
    ];
    let mut rollout = Rollout::new(&setup(walls.clone(), emitters)).unwrap();
    let mut solver = solver(Params::default(), &walls);
    for frame in 1..=12 {
        let before = rollout.state().particles.clone();
        rollout.advance(&mut solver).unwrap();
        let after = &rollout.state().particles;
        assert_eq!(after.memory.len(), after.len(), "frame {frame}");
        // The same step without the loop around it.
        let mut alone = before.clone();
        solver.step(&mut alone, Acceleration::Uniform(GRAVITY), DT).unwrap();
        for (row, id) in after.id.iter().enumerate() {
            let expected = alone.id.iter().position(|other| other == id).map(|row| alone.memory[row]);
            assert_eq!(after.memory[row], expected.unwrap_or_default(), "frame {frame}, particle {id}");
        }
    }
    assert_eq!(rollout.state().summary.removed, 2);
    assert!(rollout.state().particles.memory.iter().flatten().any(|&pressure| pressure > 0.0));
}

#[test]
fn momentum_is_conserved_without_walls_and_gravity() {
    for (second, viscosity) in [(1000.0, 0.01), (1000.0, 0.5), (400.0, 0.3)] {
        let liquids = [Liquid { density: 1000.0, viscosity }, Liquid { density: second, viscosity }];
        let mut solver = Dfsph::new(fixed(0.001), &Boundary::default(), RADIUS, &liquids).unwrap();
        let mut fluid = collision();
        let density = [1000.0, f64::from(second)];
        let (before, start) = (momentum(&fluid, density), fluid.velocity.clone());
        for _ in 0..15 {
            solver.step(&mut fluid, NOWHERE, DT).unwrap();
        }
        let after = momentum(&fluid, density);
        let speeds = fluid.velocity.iter().zip(&fluid.body).map(|(v, &body)| {
            density[body as usize] * v.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>().sqrt()
        });
        let scale: f64 = speeds.sum();
        for a in 0..3 {
            let change = (after[a] - before[a]).abs() / scale;
            assert!(change < 1e-4, "density {second}, viscosity {viscosity}: {change} of the sum of m |v|");
        }
        let turned = fluid.velocity.iter().zip(&start).filter(|(v, old)| (v[0] - old[0]).abs() > 0.5).count();
        assert!(turned > 50, "the blocks did not meet: {turned}");
    }
}

#[test]
fn the_solvers_leave_no_more_than_their_tolerance() {
    let (walls, mut fluid) = dam_break();
    let params = fixed(0.001);
    let mut solver = solver(params, &walls);
    let mut iterated = 0;
    for frame in 0..40 {
        run(&mut solver, &mut fluid, 1);
        for step in solver.steps() {
            assert_eq!(step.unconverged(), 0, "frame {frame}: {step:?}");
            assert!(step.density.error <= params.density_tolerance, "frame {frame}: {step:?}");
            assert!(
                step.divergence.error * step.dt <= params.divergence_tolerance,
                "frame {frame}: {step:?}"
            );
            iterated = iterated.max(step.density.iterations);
        }
        // Positions moved by velocities whose first-order density is held: second order is left.
        let ratios = metrics::density_ratios(&fluid.position, &walls.position, RADIUS);
        let highest = ratios.iter().copied().fold(0.0, f32::max);
        assert!(highest < 1.005, "frame {frame}: density {highest}");
        let compression = metrics::mean_compression(&ratios);
        assert!(compression < 2e-4, "frame {frame}: mean compression {compression}");
    }
    assert!(iterated >= 3);
    // A limit that is too low is said.
    let few = Params { max_iterations: 3, density_tolerance: 1e-9, ..fixed(0.001) };
    let mut solver = Dfsph::new(few, &walls, RADIUS, &[]).unwrap();
    let info = solver.step(&mut fluid, Acceleration::Uniform(GRAVITY), DT).unwrap();
    assert!(info.unconverged > 0);
}

#[test]
fn fast_bodies_do_not_pass_walls() {
    let walls = box_walls([0.0; 3], [0.4; 3], RADIUS);
    let bounds = Bounds::of(&walls.position).unwrap();
    for (params, speeds) in [(Params::default(), vec![3.0, 30.0, 300.0]), (fixed(0.001), vec![3.0, 30.0])] {
        for speed in speeds {
            let mut fluid = particles(block([0.15; 3], [4, 4, 4]), [speed, -0.7 * speed, 0.4 * speed]);
            let mut solver = solver(params, &walls);
            for frame in 1..=5 {
                run(&mut solver, &mut fluid, 1);
                let what = format!("{:?}, {speed} m/s, frame {frame}", params.substep);
                assert_eq!(metrics::first_non_finite(&fluid), None, "{what}");
                assert_eq!(metrics::outside(&fluid.position, &bounds, 0.0), 0, "{what}");
            }
        }
    }
}

#[test]
fn a_lone_particle_loses_the_speed_towards_a_wall() {
    let walls = box_walls([0.0; 3], [0.6; 3], RADIUS);
    let mut fluid = particles(vec![[0.3, 0.1, 0.3]], [1.0, -40.0, 0.0]);
    let mut solver = solver(fixed(0.001), &walls);
    solver.step(&mut fluid, NOWHERE, DT).unwrap();
    let (x, v) = (fluid.position[0], fluid.velocity[0]);
    assert!((0.5 * RADIUS - 1e-5..0.1).contains(&x[1]), "{x:?}");
    // Pressure may push it off, but no faster than it came; along the wall it keeps its speed but for friction.
    assert!((-0.1..40.0).contains(&v[1]) && (0.9..1.01).contains(&v[0]), "{v:?}");
}

/// The kinetic energy per mass that is left of a shear after some time.
/// A pool that stands a layer above a step: particles at the edge are pressed against two faces at once, and what keeps
/// them out of the wall must not shoot them away.
#[test]
fn a_film_over_an_edge_comes_to_rest() {
    let text = br#"{
        "walls": [{ "shape": "step", "scale": [0.8, 1.2, 0.5] }],
        "fluids": [{ "shape": "box", "scale": [0.35, 0.65, 0.45], "translation": [0.2, 0.35, 0] }]
    }"#;
    let setup = Scene::parse(text, "film.json").expect("a scene").sample(0).expect("a set-up");
    let emitter = &setup.emitters[0];
    let mut fluid = Particles::of_one_body(emitter.position.clone(), emitter.velocity.clone());
    let mut solver = solver(fixed(0.001), &setup.boundary);
    run(&mut solver, &mut fluid, 100);
    let mut highest = 0.0f32;
    for _ in 0..50 {
        run(&mut solver, &mut fluid, 1);
        highest = highest.max(metrics::highest_speed(&fluid.velocity));
    }
    println!("{} particles, at most {highest} m/s after 2 s", fluid.len());
    assert!(highest < 1.0, "{highest} m/s");
}

fn shear_left(viscosity: f32) -> f64 {
    let position = block([0.0; 3], [8, 8, 8]);
    let mut fluid = particles(position.clone(), [0.0; 3]);
    for (velocity, x) in fluid.velocity.iter_mut().zip(&position) {
        velocity[0] = x[1];
    }
    let liquid = Liquid { viscosity, ..Liquid::default() };
    let mut solver =
        Dfsph::new(fixed(0.001), &Boundary::default(), RADIUS, &[liquid]).expect("good parameters");
    for _ in 0..5 {
        solver.step(&mut fluid, NOWHERE, DT).expect("a step");
    }
    metrics::kinetic_energy(&fluid.velocity)
}

#[test]
fn viscosity_slows_a_shear_and_none_leaves_it() {
    let start = {
        let squares = (0..8).map(|y| (0.05 * f64::from(y)).powi(2));
        0.5 * squares.sum::<f64>() / 8.0
    };
    let left = [0.0, 0.01, 0.1, 0.4].map(shear_left);
    // Pressure alone: it deforms, but loses little.
    assert!(left[0] > 0.97 * start, "{left:?} of {start}");
    assert!(left.windows(2).all(|pair| pair[1] < pair[0]), "{left:?}");
    // A shear is half a rotation, which viscosity leaves: 0.02 m/s at the middle and 3/4 of the energy in all.
    assert!(left[3] < 0.97 * left[0], "{left:?}");
}

#[test]
fn a_lighter_liquid_stays_above() {
    let walls = box_walls([0.0; 3], [0.35, 0.8, 0.35], RADIUS);
    let mut fluid =
        particles([block([0.05; 3], [6, 4, 6]), block([0.05, 0.25, 0.05], [6, 4, 6])].concat(), [0.0; 3]);
    fluid.body[144..].fill(1);
    let liquids = [1000.0, 200.0].map(|density| Liquid { density, ..Liquid::default() });
    let mut solver = Dfsph::new(Params::default(), &walls, RADIUS, &liquids).unwrap();
    run(&mut solver, &mut fluid, 100);
    let height = |rows: std::ops::Range<usize>| metrics::mean_vector(&fluid.position[rows]).unwrap()[1];
    assert!(height(144..288) > height(0..144) + 0.1, "{} and {}", height(144..288), height(0..144));
    // Upside down it turns over.
    let mut fluid = Particles { body: fluid.body.iter().map(|body| 1 - body).collect(), ..fluid };
    run(&mut solver, &mut fluid, 150);
    let height = |rows: std::ops::Range<usize>| metrics::mean_vector(&fluid.position[rows]).unwrap()[1];
    assert!(height(0..144) > height(144..288), "{} and {}", height(0..144), height(144..288));
    let ratios = metrics::density_ratios(&fluid.position, &walls.position, RADIUS);
    assert!(metrics::mean_compression(&ratios) < 1e-3);
}

#[test]
fn particles_in_one_place_come_apart() {
    let mut fluid = particles(vec![[0.2; 3]; 12], [0.0; 3]);
    let mut solver = solver(Params::default(), &Boundary::default());
    for _ in 0..50 {
        solver.step(&mut fluid, NOWHERE, DT).unwrap();
    }
    let densest = metrics::density_ratios(&fluid.position, &[], RADIUS).into_iter().fold(0.0, f32::max);
    assert!(densest < 1.05, "density {densest}, began at 3.05");
}

#[test]
fn parameters_out_of_range_are_errors() {
    let defaults = Params::default();
    let bad = [
        Params { substep: Substep::Fixed(0.0), ..defaults },
        Params { substep: Substep::AtMost(f32::NAN), ..defaults },
        Params { travel: 0.0, ..defaults },
        Params { density_tolerance: -1e-4, ..defaults },
        Params { divergence_tolerance: f32::INFINITY, ..defaults },
        Params { viscosity_tolerance: 0.0, ..defaults },
        Params { max_iterations: 0, ..defaults },
        Params { min_iterations: 200, ..defaults },
    ];
    let new = |params, liquids: &[Liquid]| Dfsph::new(params, &Boundary::default(), RADIUS, liquids);
    for params in bad {
        assert!(new(params, &[]).is_err(), "{params:?}");
    }
    for (viscosity, density) in
        [(-0.1, 1000.0), (1.1, 1000.0), (f32::NAN, 1000.0), (0.01, 0.0), (0.01, f32::NAN)]
    {
        assert!(new(defaults, &[Liquid { viscosity, density }]).is_err(), "{viscosity} {density}");
    }
    assert!(Dfsph::new(defaults, &Boundary::default(), -0.025, &[]).is_err());
    let mut solver = new(defaults, &[]).unwrap();
    let mut fluid = particles(vec![[0.0; 3]], [0.0; 3]);
    fluid.memory = vec![[0.0; 2]; 3];
    assert!(solver.step(&mut fluid, NOWHERE, DT).is_err());
}

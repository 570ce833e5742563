//! What both solvers of our own must do, on scenes small enough for every run of the tests.

mod common;

use common::{DT, GRAVITY, RADIUS, box_walls, dam_break, particles};
use fluvia_sim::dfsph::{self, Dfsph};
use fluvia_sim::metrics::{self, Bounds};
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::pbf::{self, Pbf};
use fluvia_sim::rollout::Solver;

/// The solvers with their default parameters.
fn solvers(walls: &Boundary) -> [Box<dyn Solver>; 2] {
    let dfsph = Dfsph::new(dfsph::Params::default(), walls, RADIUS, &[]).expect("good parameters");
    let pbf = Pbf::new(pbf::Params::default(), walls, RADIUS).expect("good parameters");
    [Box::new(dfsph), Box::new(pbf)]
}

fn run(solver: &mut dyn Solver, particles: &mut Particles, frames: usize) {
    for _ in 0..frames {
        solver.step(particles, Acceleration::Uniform(GRAVITY), DT).expect("good parameters");
    }
}

#[test]
fn the_same_bits_at_any_thread_count() {
    let (walls, start) = dam_break();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            solvers(&walls).map(|mut solver| {
                let mut fluid = start.clone();
                run(solver.as_mut(), &mut fluid, 12);
                fluid
            })
        })
    };
    let one = with(1);
    assert!(one.iter().all(|fluid| fluid.position != start.position));
    for threads in [2, 3, 7] {
        assert_eq!(one, with(threads), "{threads} threads");
    }
}

#[test]
fn a_dam_break_stays_in_its_box() {
    let (walls, start) = dam_break();
    let bounds = Bounds::of(&walls.position).unwrap();
    for mut solver in solvers(&walls) {
        let (mut fluid, mut farthest) = (start.clone(), 0.0_f32);
        for _ in 0..60 {
            run(solver.as_mut(), &mut fluid, 1);
            assert_eq!(metrics::outside(&fluid.position, &bounds, 0.0), 0, "{}", solver.name());
            farthest = farthest.max(Bounds::of(&fluid.position).unwrap().high[0]);
        }
        assert!(farthest > 0.55, "{}: the front reached {farthest}, the far wall is at 0.6", solver.name());
    }
}

#[test]
fn odd_sets_of_particles_stay_finite() {
    let walls = box_walls([0.0; 3], [0.4; 3], RADIUS);
    let sets = [
        vec![],
        vec![[0.2; 3]],
        vec![[0.2; 3]; 12],
        vec![[0.0; 3]; 3],
        vec![[0.2, -0.01, 0.2], [5.0, 5.0, 5.0], [-0.3, 0.2, 0.2]],
        vec![[1e30, -1e30, 0.0], [0.1; 3]],
    ];
    for mut solver in solvers(&walls) {
        for set in &sets {
            let mut fluid = particles(set.clone(), [0.0, -1.0, 0.0]);
            run(solver.as_mut(), &mut fluid, 5);
            assert_eq!(metrics::first_non_finite(&fluid), None, "{}: {set:?}", solver.name());
        }
    }
}

#[test]
fn time_steps_and_accelerations_out_of_range_are_errors() {
    for mut solver in solvers(&Boundary::default()) {
        let mut fluid = particles(vec![[0.0; 3]], [0.0; 3]);
        for dt in [0.0, -0.02, f32::NAN, f32::INFINITY, 1e6] {
            let step = solver.step(&mut fluid, Acceleration::Uniform(GRAVITY), dt);
            assert!(step.is_err(), "{}: {dt}", solver.name());
        }
        assert!(solver.step(&mut fluid, Acceleration::PerParticle(&[GRAVITY; 2]), DT).is_err());
    }
}

//! The rollout loop: emission, removal, errors, and going on from a state.

mod common;

use common::{DT, RADIUS, block, box_walls, emitter, setup};
use fluvia_sim::dfsph::Dfsph;
use fluvia_sim::particles::{Acceleration, Boundary, Particles};
use fluvia_sim::pbf::{Params, Pbf};
use fluvia_sim::rollout::{Rollout, Solver, State, StepInfo};
use fluvia_sim::scene::Setup;
use fluvia_sim::{Error, Result};

fn pbf(setup: &Setup) -> Pbf {
    Pbf::new(Params::default(), &setup.boundary, setup.particle_radius)
        .expect("the default parameters are good")
}

/// What a [`Free`] solver does to the particles at the end of a step, counted from 1.
type Spoil = fn(u64, &mut Particles);

/// Moves particles freely and does what `spoil` says to them in the given step.
struct Free {
    step: u64,
    spoil: Spoil,
    neighbors: u32,
}

impl Free {
    fn new(spoil: Spoil) -> Free {
        Free { step: 0, spoil, neighbors: 0 }
    }
}

impl Solver for Free {
    fn name(&self) -> &'static str {
        "free"
    }

    fn step(
        &mut self,
        particles: &mut Particles,
        acceleration: Acceleration<'_>,
        dt: f32,
    ) -> Result<StepInfo> {
        for i in 0..particles.len() {
            for axis in 0..3 {
                particles.velocity[i][axis] += dt * acceleration.of(i)[axis];
                particles.position[i][axis] += dt * particles.velocity[i][axis];
            }
        }
        self.step += 1;
        (self.spoil)(self.step, particles);
        Ok(StepInfo {
            substeps: 1,
            max_neighbors: self.neighbors,
            neighbor_radius: 4.0 * RADIUS,
            ..StepInfo::default()
        })
    }
}

/// A layer of 16 particles that fires in every step from 0 to 5: 1 cm has been moved when the next comes.
fn shower() -> Setup {
    let layer = emitter(block([0.425, 0.8, 0.425], [4, 1, 4]), [0.0, -0.5, 0.0], [0, 6, 1]);
    setup(box_walls([0.0; 3], [1.0; 3], RADIUS), vec![layer])
}

#[test]
fn emitters_give_to_the_frame_of_their_step() {
    let setup = shower();
    let mut rollout = Rollout::new(&setup).unwrap();
    let mut solver = pbf(&setup);
    let mut counts = vec![rollout.state().particles.len()];
    for frame in 1..=8 {
        let before = rollout.state().particles.clone();
        let report = rollout.advance(&mut solver).unwrap();
        assert_eq!((report.frame, report.particles), (frame, rollout.state().particles.len()));
        assert_eq!(report.emitted, report.particles - before.len());
        // Older ones first; the new ones are exactly what the emitter holds.
        let particles = &rollout.state().particles;
        assert_eq!(particles.id, (0..particles.len() as u32).collect::<Vec<_>>());
        assert_eq!(particles.position[before.len()..], setup.emitters[0].position[..report.emitted]);
        counts.push(report.particles);
    }
    assert_eq!(counts, [16, 32, 48, 64, 80, 96, 96, 96, 96]);
}

#[test]
fn start_stop_and_step_of_several_emitters() {
    let one = |schedule| emitter(vec![[0.5; 3]], [0.0; 3], schedule);
    let setup = setup(Boundary::default(), vec![one([1, 8, 3]), one([0, 1, 1]), one([5, 5, 1])]);
    let mut rollout = Rollout::new(&setup).unwrap();
    let mut solver = Free::new(|_, _| ());
    for _ in 0..9 {
        rollout.advance(&mut solver).unwrap();
    }
    // Emitter 1 in step 0; emitter 0 in steps 1, 4, 7; emitter 2 never.
    assert_eq!(rollout.state().particles.body, [1, 0, 0, 0]);
    assert_eq!(rollout.state().particles.id, [0, 1, 2, 3]);
}

#[test]
fn particles_beside_the_box_fall_and_are_removed() {
    let beside = emitter(block([2.95, 0.1, -0.05], [3, 3, 3]), [0.0; 3], [0, 1, 1]);
    let walls = box_walls([-0.5, 0.0, -0.5], [0.5, 1.0, 0.5], RADIUS);
    let setup = setup(walls, vec![beside]);
    let mut rollout = Rollout::new(&setup).unwrap();
    assert_eq!(rollout.state().summary.outside, 27);
    let mut solver = pbf(&setup);
    let (mut removed, mut lowest) = (0, f32::INFINITY);
    for _ in 0..60 {
        let report = rollout.advance(&mut solver).unwrap();
        removed += report.removed;
        lowest = rollout.state().particles.position.iter().map(|x| x[1]).fold(lowest, f32::min);
        assert_eq!(report.outside, report.particles);
    }
    let summary = rollout.state().summary;
    assert_eq!((removed, summary.removed, rollout.state().particles.len()), (27, 27, 0));
    assert_eq!((summary.outside, summary.worst_outside), (0, 27));
    // The line is 5 % of a height of 1 m below the floor.
    assert!((-0.05..0.0).contains(&lowest), "lowest kept at {lowest}");
    assert_eq!(rollout.state().next_id, 27);
}

#[test]
fn without_walls_nothing_is_outside_or_removed() {
    let setup = setup(Boundary::default(), vec![emitter(vec![[0.0; 3]], [0.0; 3], [0, 1, 1])]);
    let mut rollout = Rollout::new(&setup).unwrap();
    let mut solver = pbf(&setup);
    for _ in 0..100 {
        assert_eq!(rollout.advance(&mut solver).unwrap().outside, 0);
    }
    assert!(rollout.state().particles.position[0][1] < -15.0);
    assert_eq!(rollout.state().summary.removed, 0);
}

#[test]
fn a_resumed_run_gives_the_same_bits() {
    let mut setup = shower();
    setup.emitters.push(emitter(vec![[1.5, 0.1, 0.5]], [0.0; 3], [2, 9, 2]));
    let mut whole = Rollout::new(&setup).unwrap();
    let mut solver = pbf(&setup);
    let states: Vec<State> = (0..40)
        .map(|_| {
            whole.advance(&mut solver).unwrap();
            whole.state().clone()
        })
        .collect();
    assert!(whole.state().summary.removed > 0 && whole.state().summary.worst_outside > 0);
    for stop in [0, 3, 17, 38] {
        let mut resumed = Rollout::resume(&setup, states[stop].clone()).unwrap();
        let mut solver = pbf(&setup);
        for state in &states[stop + 1..] {
            resumed.advance(&mut solver).unwrap();
            assert_eq!(resumed.state(), state, "resumed after step {}", stop + 1);
        }
    }
}

#[test]
fn a_state_that_contradicts_itself_is_an_error() {
    let setup = shower();
    let good = Rollout::new(&setup).unwrap().state().clone();
    let mut short = good.clone();
    short.particles.velocity.pop();
    assert!(matches!(Rollout::resume(&setup, short), Err(Error::Parameter(_))));
    let mut stranger = good.clone();
    stranger.particles.body[0] = setup.emitters.len() as u32;
    assert!(matches!(Rollout::resume(&setup, stranger), Err(Error::Parameter(_))));
    let reused = State { next_id: 3, ..good };
    assert!(matches!(Rollout::resume(&setup, reused), Err(Error::Parameter(_))));
}

#[test]
fn numbers_that_are_not_finite_stop_the_run_and_keep_the_state() {
    let setup = shower();
    let spoils: [(Spoil, &str); 2] = [
        (
            |step, particles| {
                if step == 3 {
                    particles.position[40][1] = f32::NAN
                }
            },
            "position",
        ),
        (
            |step, particles| {
                if step == 3 {
                    particles.velocity[40][2] = f32::INFINITY
                }
            },
            "velocity",
        ),
    ];
    for (spoil, expected) in spoils {
        let mut rollout = Rollout::new(&setup).unwrap();
        let mut solver = Free::new(spoil);
        rollout.advance(&mut solver).unwrap();
        rollout.advance(&mut solver).unwrap();
        let before = rollout.state().clone();
        match rollout.advance(&mut solver) {
            Err(Error::NonFinite { step: 3, particle: 40, quantity }) => assert_eq!(quantity, expected),
            other => panic!("{other:?}"),
        }
        assert_eq!(*rollout.state(), before);
    }
}

#[test]
fn accelerations_of_the_caller() {
    let setup = shower();
    let mut rollout = Rollout::new(&setup).unwrap();
    let mut solver = Free::new(|_, _| ());
    let sideways: Vec<_> = (0..16).map(|i| [i as f32, 0.0, 0.0]).collect();
    assert!(rollout.advance_under(&mut solver, Acceleration::PerParticle(&sideways[..15])).is_err());
    rollout.advance_under(&mut solver, Acceleration::PerParticle(&sideways)).unwrap();
    let velocity = &rollout.state().particles.velocity;
    assert_eq!(velocity[7], [7.0 * DT, -0.5, 0.0]);
}

#[test]
fn only_wrong_states_are_piled_up() {
    let setup = shower();
    // A lattice has 32 neighbours within two spacings, a fluid at rest about 42.
    for (neighbors, expected) in [(42, false), (100, false), (200, true)] {
        let mut solver = Free::new(|_, _| ());
        solver.neighbors = neighbors;
        let report = Rollout::new(&setup).unwrap().advance(&mut solver).unwrap();
        assert_eq!(report.piled_up, expected, "{neighbors} neighbours");
    }
}

#[test]
fn a_solver_that_loses_particles_is_an_error() {
    let setup = shower();
    let mut solver = Free::new(|_, particles| particles.retain(&[false; 16]));
    let mut rollout = Rollout::new(&setup).unwrap();
    assert!(matches!(rollout.advance(&mut solver), Err(Error::Parameter(_))));
    assert_eq!(rollout.state().particles.len(), 16);
}

#[test]
fn a_time_step_that_is_not_positive_is_an_error() {
    let mut setup = shower();
    setup.dt = 0.0;
    assert!(matches!(Rollout::new(&setup), Err(Error::Parameter(_))));
}

#[test]
fn a_body_is_added_to_the_frame() {
    let setup = shower();
    let mut rollout = Rollout::new(&setup).unwrap();
    let mut solver = Dfsph::new(Default::default(), &setup.boundary, RADIUS, &[]).unwrap();
    rollout.advance(&mut solver).unwrap();
    // The emitter has given twice by now.
    let body = block([0.4, 0.2, 0.4], [3, 2, 3]);
    rollout.add(&body, [0.0, -1.0, 0.0], 0).unwrap();
    let particles = &rollout.state().particles;
    assert_eq!((particles.len(), particles.memory.len()), (32 + 18, 32 + 18));
    assert_eq!(particles.id, (0..50).collect::<Vec<_>>());
    assert_eq!((particles.position[49], particles.velocity[49]), (body[17], [0.0, -1.0, 0.0]));
    assert_eq!(particles.memory[49], [0.0; 2]);
    assert!(rollout.state().summary.highest_speed >= 1.0);
    // It moves with the rest, and a state with it is one to go on from.
    let resumed = Rollout::resume(&setup, rollout.state().clone()).unwrap();
    rollout.advance(&mut solver).unwrap();
    assert_eq!((rollout.state().particles.len(), resumed.state().particles.len()), (66, 50));
    rollout.forget();
    assert!(rollout.state().particles.memory.is_empty());
    rollout.advance(&mut solver).unwrap();
    for (position, velocity, body) in [
        (vec![[0.5; 3]], [0.0; 3], 1),
        (vec![[0.5, f32::NAN, 0.5]], [0.0; 3], 0),
        (vec![[0.5; 3]], [f32::INFINITY, 0.0, 0.0], 0),
    ] {
        let before = rollout.state().clone();
        assert!(matches!(rollout.add(&position, velocity, body), Err(Error::Parameter(_))));
        assert_eq!(rollout.state(), &before);
    }
}

#[test]
fn gravity_and_emitters_change_from_the_next_step_on() {
    let setup = shower();
    let mut rollout = Rollout::new(&setup).unwrap();
    let mut solver = Free::new(|_, _| ());
    rollout.set_gravity([1.0, 0.0, 0.0]).unwrap();
    rollout.move_emitter(0, [0.1, 0.0, -0.1]).unwrap();
    assert_eq!(rollout.state().particles.position, setup.emitters[0].position);
    rollout.advance(&mut solver).unwrap();
    let particles = &rollout.state().particles;
    assert_eq!((particles.velocity[0], particles.velocity[16]), ([DT, -0.5, 0.0], [0.0, -0.5, 0.0]));
    let [x, y, z] = setup.emitters[0].position[0];
    assert_eq!(particles.position[16], [x + 0.1, y, z - 0.1]);
    for wrong in [
        rollout.set_gravity([0.0, f32::NAN, 0.0]),
        rollout.move_emitter(1, [0.0; 3]),
        rollout.move_emitter(0, [f32::MAX, f32::INFINITY, 0.0]),
    ] {
        assert!(matches!(wrong, Err(Error::Parameter(_))), "{wrong:?}");
    }
    // What was wrong changed nothing.
    rollout.advance(&mut solver).unwrap();
    let particles = &rollout.state().particles;
    assert_eq!((particles.velocity[0][0], particles.position[32]), (2.0 * DT, [x + 0.1, y, z - 0.1]));
}

//! The paper's metrics of a solver against a true sequence (Tables 1, 2 and 5, Fig. 6).
//!
//! ```text
//! e_1, e_2   mean |x_i − x̂_i| one and two frames after a start from a true frame, every fifth; the last fifth apart
//! d^n        Eq. 18 between frame n of a rollout from frame 0 and the true one, both ways
//! ```
//!
//! A frame that is not finite is counted, never dropped: what it would be part of has no value.

use std::ops::Range;

use fluvia_sim::frames::sequence::Sequence;
use fluvia_sim::metrics::{self, distance_to_closest, first_non_finite};
use fluvia_sim::particles::{Acceleration, Particles};
use fluvia_sim::rollout::Solver;

use crate::Result;

/// Frames from one start to the next, and from one frame of a rollout that is compared to the next.
const EVERY: u64 = 5;

/// Frames after the last start: the published evaluator needs three more.
const AFTER_START: u64 = 3;

/// A rollout is unstable from the first frame on in which a particle is faster, metres per second.
const UNSTABLE_SPEED: f32 = 20.0;

/// The frames that a solver is compared with.
pub trait Truth {
    /// Their numbers.
    fn frames(&self) -> Range<u64>;

    /// The particles of a frame, the same ones in the same order in all.
    ///
    /// # Errors
    /// If the frame cannot be read, or has other particles.
    fn particles(&mut self, number: u64) -> Result<Particles>;
}

impl Truth for Sequence {
    fn frames(&self) -> Range<u64> {
        Sequence::frames(self)
    }

    fn particles(&mut self, number: u64) -> Result<Particles> {
        let frame = self.frame(number)?;
        Ok(Particles::of_one_body(frame.position.clone(), frame.velocity.clone()))
    }
}

/// The errors of one and of two steps from one start, metres; `None` where a number is not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartErrors {
    /// The true frame that it starts from.
    pub frame: u64,
    /// e_1 and e_2.
    pub errors: [Option<f64>; 2],
}

/// A frame of a rollout beside the true one.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Its number.
    pub frame: u64,
    /// d^n from the true particles to the closest predicted ones, metres; `None` if a number is not finite.
    pub distance: Option<f64>,
    /// The other way.
    pub distance_back: Option<f64>,
}

/// What a solver is judged by: how it starts, and what moves beside it.
pub struct Judged<'a> {
    /// A solver for these walls.
    pub solver: &'a mut dyn Solver,
    /// The external acceleration, metres per second squared.
    pub gravity: [f32; 3],
    /// Seconds between frames.
    pub dt: f32,
}

impl Judged<'_> {
    /// The particles after the next frame interval; whether all are finite.
    fn step(&mut self, particles: &mut Particles) -> Result<bool> {
        self.solver.step(particles, Acceleration::Uniform(self.gravity), self.dt)?;
        Ok(first_non_finite(particles).is_none())
    }

    /// The errors after one and two steps from every fifth frame.
    ///
    /// # Errors
    /// As the solver, and if a frame cannot be read.
    pub fn start_errors(&mut self, truth: &mut impl Truth) -> Result<Vec<StartErrors>> {
        let frames = truth.frames();
        let mut starts = Vec::new();
        let mut start = frames.start;
        while start + AFTER_START < frames.end {
            let mut particles = truth.particles(start)?;
            let mut errors = [None; 2];
            for (k, error) in (1..).zip(&mut errors) {
                if !self.step(&mut particles)? {
                    break;
                }
                *error = Some(mean_distance(&particles.position, &truth.particles(start + k)?.position));
            }
            starts.push(StartErrors { frame: start, errors });
            start += EVERY;
        }
        Ok(starts)
    }

    /// A rollout from the first frame, as long as the truth is. `observe` sees every frame of it, the first included,
    /// until one is not finite.
    ///
    /// # Errors
    /// As the solver, and if a frame cannot be read.
    pub fn roll_out(
        &mut self,
        truth: &mut impl Truth,
        mut observe: impl FnMut(&Particles),
    ) -> Result<Rolled> {
        let frames = truth.frames();
        let mut particles = truth.particles(frames.start)?;
        // The last that was compared.
        let mut exact = Particles::default();
        observe(&particles);
        let mut rolled = Rolled::default();
        for number in frames.start + 1..frames.end {
            let finite = rolled.non_finite_frames == 0 && self.step(&mut particles)?;
            rolled.non_finite_frames += u64::from(!finite);
            let is_unstable = !finite || metrics::highest_speed(&particles.velocity) > UNSTABLE_SPEED;
            if is_unstable && rolled.unstable_from.is_none() {
                rolled.unstable_from = Some(number);
            }
            if finite {
                observe(&particles);
            }
            let passed = number - frames.start;
            let between = |from: &[[f32; 3]], to: &[[f32; 3]]| {
                finite.then(|| distance_to_closest(from, to)).flatten().filter(|d| d.is_finite())
            };
            if passed.is_multiple_of(EVERY) {
                exact = truth.particles(number)?;
                rolled.compared.push(Compared {
                    frame: number,
                    distance: between(&exact.position, &particles.position),
                    distance_back: between(&particles.position, &exact.position),
                });
            }
            if passed > EVERY && (passed - 1).is_multiple_of(EVERY) {
                rolled.published.push(between(&exact.position, &particles.position));
            }
        }
        Ok(rolled)
    }
}

/// What came of a rollout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rolled {
    /// Every fifth frame.
    pub compared: Vec<Compared>,
    /// d from every fifth true frame to the predicted one after it, metres: what the published evaluator takes.
    pub published: Vec<Option<f64>>,
    /// Frames with a number that is not finite, and all after the first of them.
    pub non_finite_frames: u64,
    /// The first frame in which a number is not finite or a particle too fast.
    pub unstable_from: Option<u64>,
}

/// The acceleration of a particle alone, without walls, from rest, metres per second squared: what its velocity gains a
/// frame, the first left out, for Eq. 14 gives the velocity half a frame late. `None` if a number is not finite.
///
/// # Errors
/// As the solver, which is one without walls.
pub fn lone_acceleration(solver: &mut dyn Solver, gravity: [f32; 3], dt: f32) -> Result<Option<[f64; 3]>> {
    /// Half a second at 50 Hz, while speeds are those of the training data.
    const FRAMES: u32 = 25;
    let mut particles = Particles::of_one_body(vec![[0.0; 3]], vec![[0.0; 3]]);
    let mut first = [0.0; 3];
    for frame in 0..FRAMES {
        solver.step(&mut particles, Acceleration::Uniform(gravity), dt)?;
        if first_non_finite(&particles).is_some() {
            return Ok(None);
        }
        if frame == 0 {
            first = particles.velocity[0];
        }
    }
    let time = f64::from(FRAMES - 1) * f64::from(dt);
    Ok(Some(std::array::from_fn(|axis| f64::from(particles.velocity[0][axis] - first[axis]) / time)))
}

/// The mean of the values, `None` if one is missing or there are none.
pub fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let values: Option<Vec<f64>> = values.collect();
    values.filter(|values| !values.is_empty()).map(|values| values.iter().sum::<f64>() / values.len() as f64)
}

/// The mean of |a_i − b_i|, metres.
pub(crate) fn mean_distance(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let distance = |(a, b): (&[f32; 3], &[f32; 3])| {
        (0..3).map(|axis| f64::from(a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
    };
    a.iter().zip(b).map(distance).sum::<f64>() / a.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use fluvia_neighbors::Point;
    use fluvia_sim::rollout::StepInfo;

    use super::*;

    /// Two particles that move by 1 m a frame along x.
    struct Line(Range<u64>);

    impl Truth for Line {
        fn frames(&self) -> Range<u64> {
            self.0.clone()
        }

        fn particles(&mut self, number: u64) -> Result<Particles> {
            let position = vec![[number as f32, 0.0, 0.0], [number as f32, 100.0, 0.0]];
            Ok(Particles::of_one_body(position, vec![[1.0, 0.0, 0.0]; 2]))
        }
    }

    /// A solver that is a function of particles, acceleration and time.
    struct By<F>(F);

    impl<F: FnMut(&mut Particles, Point, f32)> Solver for By<F> {
        fn name(&self) -> &'static str {
            "function"
        }

        fn step(
            &mut self,
            particles: &mut Particles,
            acceleration: Acceleration<'_>,
            dt: f32,
        ) -> fluvia_sim::Result<StepInfo> {
            (self.0)(particles, acceleration.of(0), dt);
            Ok(StepInfo::default())
        }
    }

    /// Moves particles by a length along x, until the given x is reached: then one is nowhere.
    fn mover(length: f32, end: f32) -> impl Solver {
        By(move |particles: &mut Particles, _, _| {
            for x in &mut particles.position {
                x[0] += length;
                x[0] = if x[0] < end { x[0] } else { f32::NAN };
            }
        })
    }

    fn judged(solver: &mut impl Solver) -> Judged<'_> {
        Judged { solver, gravity: [0.0; 3], dt: 0.02 }
    }

    #[test]
    fn errors_grow_with_the_steps() {
        let starts = judged(&mut mover(1.25, 1e9)).start_errors(&mut Line(3..17)).unwrap();
        // 13 + 3 is the last frame.
        assert_eq!(starts.iter().map(|start| start.frame).collect::<Vec<_>>(), [3, 8, 13]);
        assert!(starts.iter().all(|start| start.errors == [Some(0.25), Some(0.5)]), "{starts:?}");
        let rolled = judged(&mut mover(1.25, 1e9)).roll_out(&mut Line(3..17), |_| ()).unwrap();
        let frames: Vec<_> = rolled.compared.iter().map(|one| (one.frame, one.distance)).collect();
        assert_eq!(frames, [(8, Some(1.25)), (13, Some(2.5))]);
        // Six and eleven predictions against five and ten true steps.
        assert_eq!(rolled.published, [Some(2.5), Some(3.75)]);
        assert_eq!((rolled.non_finite_frames, rolled.unstable_from), (0, None));
    }

    #[test]
    fn frames_that_are_not_finite_are_counted() {
        let mut seen = 0;
        let rolled = judged(&mut mover(1.0, 6.5)).roll_out(&mut Line(0..12), |_| seen += 1).unwrap();
        assert_eq!((rolled.non_finite_frames, rolled.unstable_from, seen), (5, Some(7), 7));
        assert_eq!(rolled.compared.iter().map(|one| one.distance).collect::<Vec<_>>(), [Some(0.0), None]);
        assert_eq!(mean(rolled.compared.iter().map(|one| one.distance)), None);
        let starts = judged(&mut mover(1.0, 6.5)).start_errors(&mut Line(0..12)).unwrap();
        assert_eq!(starts[1].errors, [Some(0.0), None]);
        assert_eq!(lone_acceleration(&mut mover(1.0, 6.5), [0.0; 3], 0.02).unwrap(), None);
    }

    #[test]
    fn velocities_of_half_a_frame_ago_are_no_error() {
        // Falls exactly, with the velocity of Eq. 14.
        let mut faller = By(|particles: &mut Particles, acceleration: Point, dt: f32| {
            let half = if particles.velocity[0] == [0.0; 3] { 0.5 } else { 1.0 };
            for (v, a) in particles.velocity[0].iter_mut().zip(acceleration) {
                *v += half * dt * a;
            }
        });
        let found = lone_acceleration(&mut faller, [0.0, -9.81, 0.0], 0.02).unwrap().unwrap();
        assert!((found[1] + 9.81).abs() < 1e-4, "{found:?}");
    }
}

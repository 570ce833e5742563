//! The numbers of a solver on one sequence or on several.

use fluvia_net::evaluate::mean;
use serde::Serialize;

use super::{Outcome, Sequence};
use crate::curves::{Curve, Curves};

/// The frame, counted from the first, at which heights are compared: bodies of the published data have fallen there.
const FALLEN: usize = 20;

/// What is reported; `None` where a number that it is made of is not finite or there is none. On several sequences means
/// are over all starts or frames, `non_finite_frames`, `outside` and `worst_outside` are sums, and the rest is of the worst.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// The mean position error one and two frames after a start from a true frame.
    pub err_n1_mm: Option<f64>,
    pub err_n2_mm: Option<f64>,
    /// The same from the last fifth of the frames.
    pub err_n1_last_fifth_mm: Option<f64>,
    pub err_n2_last_fifth_mm: Option<f64>,
    /// d of Eq. 18 over the whole rollout, and from the predicted particles to the closest true ones.
    pub whole_seq_mm: Option<f64>,
    pub whole_seq_back_mm: Option<f64>,
    /// d as the published evaluator takes it: predictions against the frame before.
    pub whole_seq_published_loop_mm: Option<f64>,
    pub non_finite_frames: u64,
    /// The first frame with a number that is not finite or a speed above 20 m/s.
    pub unstable_from: Option<u64>,
    /// The mean of |h − ĥ| of the height of the centre of mass, and h − ĥ in frame 20.
    pub height_error_mm: Option<f64>,
    pub height_error_frame_20_mm: Option<f64>,
    /// The mean length of the difference of momentum per mass.
    pub momentum_error_m_per_s: Option<f64>,
    /// The mean of |E − Ê| of kinetic and potential energy per mass.
    pub energy_error_j_per_kg: Option<f64>,
    #[serde(flatten)]
    pub state: StateFigures,
}

/// What is reported of frames alone, so that the truth has it too.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StateFigures {
    /// Particles outside the walls, in the last frame and in the worst.
    pub outside: Option<usize>,
    pub worst_outside: Option<usize>,
    /// Density over rest density, of the fluid alone.
    pub highest_density: Option<f64>,
    /// Particles above 1.05 of rest density: in the worst frame, and the mean over the last fifth.
    pub worst_dense_particles: Option<usize>,
    pub dense_particles_last_fifth: Option<f64>,
    /// The mean of |v| over the last fifth.
    pub speed_last_fifth_m_per_s: Option<f64>,
}

impl StateFigures {
    /// Of these curves together, each with the number of frames that it should have.
    pub fn of(runs: &[(&Curves, usize)]) -> StateFigures {
        // A rollout that broke off has neither a worst frame nor a mean.
        let is_whole = runs.iter().all(|(run, count)| run.particles.len() == *count);
        let worst = |counts: &dyn Fn(&Curves) -> &[usize]| -> Vec<usize> {
            runs.iter().map(|(run, _)| counts(run).iter().copied().max().unwrap_or_default()).collect()
        };
        let end = |value: &dyn Fn(&Curves, usize) -> Option<f64>| {
            let of_run = |&(run, count): &(&Curves, usize)| {
                (0..count).filter(|&k| is_late(k, count)).map(|k| value(run, k)).collect::<Vec<_>>()
            };
            mean(runs.iter().flat_map(of_run))
        };
        let densities = runs.iter().flat_map(|(run, _)| run.highest_density.iter().flatten().copied());
        StateFigures {
            outside: is_whole.then(|| runs.iter().filter_map(|(run, _)| run.outside.last()).sum()),
            worst_outside: is_whole.then(|| worst(&|run| &run.outside).into_iter().sum()),
            highest_density: densities.reduce(f64::max).filter(|_| is_whole),
            worst_dense_particles: is_whole
                .then(|| worst(&|run| &run.dense_particles).into_iter().max().unwrap_or_default()),
            dense_particles_last_fifth: end(&|run, k| run.dense_particles.get(k).map(|&n| n as f64)),
            speed_last_fifth_m_per_s: end(&|run, k| run.mean_speed_m_per_s.get(k).copied().flatten()),
        }
    }
}

impl Figures {
    /// Of these sequences together.
    pub(super) fn of(parts: &[(&Sequence, &Outcome)]) -> Figures {
        let late = |sequence: &Sequence, frame: u64| {
            is_late((frame - sequence.first) as usize, sequence.truth.particles.len())
        };
        let error = |k: usize, only_late: bool| {
            let starts = parts.iter().flat_map(|(sequence, outcome)| {
                outcome.starts.iter().filter(move |start| !only_late || late(sequence, start.frame))
            });
            mean(starts.map(|start| start.errors[k])).map(millimetres)
        };
        let outcomes = || parts.iter().map(|(_, outcome)| outcome);
        let compared = || outcomes().flat_map(|outcome| &outcome.rolled.compared);
        let published = outcomes().flat_map(|outcome| outcome.rolled.published.iter().copied());
        // Over all frames; a rollout that broke off has no mean.
        let apart = |difference: &dyn Fn(&Curves, &Curves, usize) -> Option<f64>| {
            mean(parts.iter().flat_map(|(sequence, outcome)| {
                let frames = 0..sequence.truth.particles.len();
                frames.map(|k| difference(&outcome.curves, &sequence.truth, k)).collect::<Vec<_>>()
            }))
        };
        let height = |run: &Curves, k: usize| Some(run.center_of_mass_m.get(k)?.as_ref()?[1]);
        let energy = |run: &Curves, k: usize| {
            let at = |curve: &Curve| curve.get(k).copied().flatten();
            Some(at(&run.kinetic_energy_j_per_kg)? + at(&run.potential_energy_j_per_kg)?)
        };
        let momentum = |found: &Curves, exact: &Curves, k: usize| {
            let (a, b) = (found.momentum_m_per_s.get(k)?.as_ref()?, exact.momentum_m_per_s[k].as_ref()?);
            Some((0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt())
        };
        let fallen = mean(parts.iter().map(|(sequence, outcome)| {
            Some(height(&outcome.curves, FALLEN)? - height(&sequence.truth, FALLEN)?)
        }));
        let curves: Vec<(&Curves, usize)> = parts
            .iter()
            .map(|(sequence, outcome)| (&outcome.curves, sequence.truth.particles.len()))
            .collect();
        Figures {
            err_n1_mm: error(0, false),
            err_n2_mm: error(1, false),
            err_n1_last_fifth_mm: error(0, true),
            err_n2_last_fifth_mm: error(1, true),
            whole_seq_mm: mean(compared().map(|frame| frame.distance)).map(millimetres),
            whole_seq_back_mm: mean(compared().map(|frame| frame.distance_back)).map(millimetres),
            whole_seq_published_loop_mm: mean(published).map(millimetres),
            non_finite_frames: outcomes().map(|outcome| outcome.rolled.non_finite_frames).sum(),
            unstable_from: outcomes().filter_map(|outcome| outcome.rolled.unstable_from).min(),
            height_error_mm: apart(&|a, b, k| Some((height(a, k)? - height(b, k)?).abs())).map(millimetres),
            height_error_frame_20_mm: fallen.map(millimetres),
            momentum_error_m_per_s: apart(&momentum),
            energy_error_j_per_kg: apart(&|a, b, k| Some((energy(a, k)? - energy(b, k)?).abs())),
            state: StateFigures::of(&curves),
        }
    }
}

/// Whether frame `k` of `count` is one of the last fifth.
fn is_late(k: usize, count: usize) -> bool {
    5 * k >= 4 * count
}

fn millimetres(metres: f64) -> f64 {
    1e3 * metres
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use fluvia_net::evaluate::{Compared, Rolled, StartErrors};

    use super::*;
    use crate::curves::Surroundings;

    /// Curves of a particle alone with these heights, each frame 1 m/s faster than the one before; outside below 0 m.
    fn curves(heights: &[f32]) -> Curves {
        let walls = fluvia_sim::metrics::Bounds::of(&[[-1.0, 0.0, -1.0], [1.0, 100.0, 1.0]]);
        let scene = Surroundings { walls, particle_radius: 0.025, gravity: [0.0, -10.0, 0.0] };
        let mut curves = Curves::new("", Path::new(""), scene);
        for (k, &y) in heights.iter().enumerate() {
            curves.measure(&[[0.0, y, 0.0]], &[[k as f32, 0.0, 0.0]]);
        }
        curves
    }

    fn truth(heights: &[f32]) -> Sequence {
        Sequence { name: String::new(), first: 7, dt: 0.02, truth: curves(heights) }
    }

    /// The first frames of a rollout; starts from frames 7, 12, ... with errors of as many metres.
    fn outcome(heights: &[f32], starts: &[Option<f64>]) -> Outcome {
        let starts = starts.iter().zip(0..).map(|(&error, k)| StartErrors {
            frame: 7 + 5 * k,
            errors: [error, error.map(|error| 2.0 * error)],
        });
        let compared = Compared { frame: 12, distance: Some(0.5), distance_back: None };
        let rolled = Rolled { compared: vec![compared], published: vec![Some(0.25)], ..Rolled::default() };
        Outcome { starts: starts.collect(), rolled, curves: curves(heights) }
    }

    #[test]
    fn means_of_several_sequences_are_over_all_their_frames() {
        let [a, b] = [truth(&[1.0; 10]), truth(&[1.0; 30])];
        let [of_a, of_b] = [
            outcome(&[2.0; 10], &[Some(0.001), Some(0.002)]),
            outcome(&[1.5; 30], &[Some(0.004), None, Some(0.004), Some(0.004), Some(0.004), Some(0.005)]),
        ];
        let found = Figures::of(&[(&a, &of_a)]);
        let rounded = |value: Option<f64>| (1e6 * value.unwrap()).round() / 1e6;
        assert_eq!((rounded(found.err_n1_mm), rounded(found.err_n2_mm)), (1.5, 3.0));
        // Of 10 frames the last two, of 30 the last six: the start from the 26th frame.
        assert_eq!(found.err_n1_last_fifth_mm, None);
        assert_eq!(rounded(found.height_error_mm), 1000.0);
        // There is no frame 20 in ten.
        assert_eq!(found.height_error_frame_20_mm, None);
        assert_eq!((rounded(found.whole_seq_mm), found.whole_seq_back_mm), (500.0, None));
        assert_eq!(rounded(found.whole_seq_published_loop_mm), 250.0);
        assert_eq!(rounded(found.energy_error_j_per_kg), 10.0);
        assert_eq!(found.state.speed_last_fifth_m_per_s, Some(8.5));

        let both = Figures::of(&[(&a, &of_a), (&b, &of_b)]);
        // A start whose step is not finite has no error, and so has no mean with it.
        assert_eq!(both.err_n1_mm, None);
        assert_eq!(rounded(both.err_n1_last_fifth_mm), 5.0);
        assert_eq!(rounded(both.height_error_mm), 625.0);
        assert_eq!(rounded(both.state.speed_last_fifth_m_per_s), (8.0 + 9.0 + 6.0 * 26.5) / 8.0);
        let only_b = Figures::of(&[(&b, &of_b)]);
        assert_eq!(rounded(only_b.height_error_frame_20_mm), 500.0);
    }

    #[test]
    fn particles_outside_are_sums() {
        let [a, b] = [truth(&[1.0; 3]), truth(&[1.0; 3])];
        let [of_a, of_b] = [outcome(&[1.0, -1.0, 1.0], &[]), outcome(&[-1.0, 1.0, -1.0], &[])];
        let found = Figures::of(&[(&a, &of_a), (&b, &of_b)]).state;
        assert_eq!((found.outside, found.worst_outside), (Some(1), Some(2)));
        assert_eq!(found.worst_dense_particles, Some(0));
    }

    #[test]
    fn a_rollout_that_broke_off_looks_like_none() {
        let exact = truth(&[1.0; 5]);
        let mut broken = outcome(&[1.0; 3], &[]);
        broken.rolled = Rolled { non_finite_frames: 2, unstable_from: Some(9), ..Rolled::default() };
        let found = Figures::of(&[(&exact, &broken)]);
        assert_eq!((found.non_finite_frames, found.unstable_from), (2, Some(9)));
        assert_eq!((found.whole_seq_mm, found.height_error_mm), (None, None));
        assert_eq!((found.momentum_error_m_per_s, found.energy_error_j_per_kg), (None, None));
        let nothing = StateFigures {
            outside: None,
            worst_outside: None,
            highest_density: None,
            worst_dense_particles: None,
            dense_particles_last_fifth: None,
            speed_last_fifth_m_per_s: None,
        };
        assert_eq!(found.state, nothing);
    }
}

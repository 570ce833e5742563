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

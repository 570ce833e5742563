//! How a run goes on after it was stopped: what its directory must hold, and the state file.

use std::path::Path;

use anyhow::{Context, Result, bail};
use fluvia_sim::frames::{self, Mode, RunDirectory};
use fluvia_sim::rollout::{self, Rollout};
use fluvia_sim::scene::Setup;

use crate::record::{Earlier, Record, Summary};
use crate::report::Report;

/// How to open the directory of a run that is to go on.
///
/// # Errors
/// If what is there is another run, or no run.
pub fn mode(out: &Path, record: &Record) -> Result<Mode> {
    if out.join(frames::run::STATE).exists() {
        return Ok(Mode::Resume);
    }
    if out.join(frames::run::RECORD).exists() {
        // Killed before its first state was on disk: the same run begins again, another one is left alone.
        check_same(out, record)?;
        return Ok(Mode::Overwrite);
    }
    if out.is_dir() && !frames::run::list(out)?.is_empty() {
        let (record, state) = (frames::run::RECORD, frames::run::STATE);
        bail!("{}: frames without {record} and {state}, no run that could go on", out.display());
    }
    // Killed before anything was on disk.
    Ok(Mode::New)
}

/// The record in the directory, if it is one of the same scene, solver and files.
fn check_same(out: &Path, record: &Record) -> Result<Record> {
    let path = out.join(frames::run::RECORD);
    let old: Record = frames::read_json(&path)?;
    match record.difference(&old) {
        Some((name, old, new)) => {
            bail!("{}: not the same run, its {name}: {old}, now: {new}", path.display())
        }
        None => Ok(old),
    }
}

/// The rollout in the directory, after its last step on disk, and its summary if it had ended. Where another version or
/// kernel goes on, the record says so from then on.
///
/// # Errors
/// If it is another run, or its state is damaged.
pub fn rollout(
    directory: &mut RunDirectory,
    setup: &Setup,
    record: &mut Record,
    report: &Report,
) -> Result<(Rollout, Option<Summary>)> {
    let old = check_same(directory.path(), record)?;
    if old.version != record.version {
        report.warning(format_args!(
            "the run was computed by version {}, now by {}: its continuation may not be the same bits",
            old.version, record.version
        ));
    }
    if old.kernel != record.kernel {
        report.warning(format_args!(
            "the run was computed by the kernel {}, now by {}: its continuation is right, but not the same bits",
            old.kernel, record.kernel
        ));
    }
    let state = directory.read_state()?;
    let goes_on = state.step < record.steps;
    if goes_on {
        report.note(format_args!("resuming after step {} of {}", state.step, record.steps));
    } else {
        report.note(format_args!("the run has its {} steps already", state.step));
    }
    record.earlier.clone_from(&old.earlier);
    let differs = (&old.version, &old.kernel) != (&record.version, &record.kernel);
    if goes_on && differs {
        let Record { version, kernel, .. } = old;
        record.earlier.push(Earlier { version, kernel, until_step: state.step });
        directory.write_record(record)?;
    }
    let path = directory.path().join(frames::run::STATE);
    let rollout = Rollout::resume(setup, from_disk(state)).with_context(|| path.display().to_string())?;
    Ok((rollout, old.summary))
}

/// Writes the frame of a state, then the state: a run that is killed between the two writes the frame again.
pub fn write(directory: &mut RunDirectory, state: &rollout::State) -> Result<()> {
    directory.write_frame(state.step, &state.particles)?;
    directory.write_state(&to_disk(state))?;
    Ok(())
}

const OUTSIDE: &str = "outside";
const WORST_OUTSIDE: &str = "worst_outside";
const HIGHEST_SPEED: &str = "highest_speed";
const UNCONVERGED: &str = "unconverged";

pub fn to_disk(state: &rollout::State) -> frames::State {
    let rollout::Summary { outside, worst_outside, removed, highest_speed, unconverged } = state.summary;
    frames::State {
        step: state.step,
        particles: state.particles.clone(),
        next_id: state.next_id,
        removed,
        counters: [
            (OUTSIDE.to_owned(), outside as f64),
            (WORST_OUTSIDE.to_owned(), worst_outside as f64),
            (HIGHEST_SPEED.to_owned(), f64::from(highest_speed)),
            (UNCONVERGED.to_owned(), unconverged as f64),
        ]
        .into(),
    }
}

pub fn from_disk(state: frames::State) -> rollout::State {
    let counter = |name: &str| state.counters.get(name).copied().unwrap_or_default();
    rollout::State {
        step: state.step,
        next_id: state.next_id,
        summary: rollout::Summary {
            outside: counter(OUTSIDE) as usize,
            worst_outside: counter(WORST_OUTSIDE) as usize,
            removed: state.removed,
            highest_speed: counter(HIGHEST_SPEED) as f32,
            unconverged: counter(UNCONVERGED) as u64,
        },
        particles: state.particles,
    }
}

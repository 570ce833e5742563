//! Films: every frame as a picture, of several runs side by side.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Result, bail};
use fluvia_render::{Camera, Image, Row, Sheet, Style, draw_frame, sheet};

use super::moment::{Moment, Run};
use super::writer::Writer;
use super::{Args, Kind, Seen, style, subject};
use crate::in_order::in_order;
use crate::options::chosen_frames;
use crate::report::Report;

/// Writes a film; false if it was interrupted. Frames are read twice, first for the camera and the colours of all, so that
/// few are in memory.
pub fn film(
    args: &Args,
    kind: Kind,
    runs: &[Run],
    interrupted: &AtomicBool,
    report: &Report,
) -> Result<bool> {
    let numbers = choose_frames(args, runs)?;
    let stopped = || interrupted.load(Ordering::Relaxed);
    let mut seen = Seen::default();
    let mut subject = subject(runs);
    for &number in &numbers {
        for run in runs {
            if stopped() {
                return Ok(false);
            }
            let moment = run.moment(number, args.color(), None)?;
            seen.add(&moment);
            subject.add(&moment.position);
        }
    }
    let dt = runs[0].dt;
    let turn = |k: usize| {
        args.place.orbit.map_or(0.0, |speed| speed * (numbers[k].abs_diff(numbers[0]) as f64 * dt) as f32)
    };
    let camera = Camera::fit(&subject, &args.view(false, turn(numbers.len() - 1)))?;
    let style = style(args, runs, &seen);
    let surface = args.surface();
    let moments = |k: usize| {
        let moment = |run: &Run| run.moment(numbers[k], args.color(), surface.as_ref());
        runs.iter().map(moment).collect::<Result<Vec<Moment>>>()
    };
    let draw = |k: usize, moments: &[Moment]| draw(args, runs, moments, &camera.turned(turn(k)), &style);

    let mut writer = None;
    if kind == Kind::Gif {
        writer = Writer::gif(&numbers, dt, interrupted, |k| draw(k, &moments(k)?))?;
        if writer.is_none() {
            return Ok(false);
        }
    }
    let bar = report.bar_like(numbers.len() as u64, "{bar:16} frame {pos}/{len}, {eta} left");
    let places: Vec<usize> = (0..numbers.len()).collect();
    // Surfaces are made ahead, by as many threads as draw.
    let work = |&k: &usize| if stopped() { Ok(None) } else { moments(k).map(Some) };
    in_order(rayon::current_num_threads(), &places, work, |&k, moments| {
        let Some(moments) = moments.filter(|_| !stopped()) else { return Ok(()) };
        let image = draw(k, &moments)?;
        let writer = match &mut writer {
            Some(writer) => writer,
            none => none.insert(Writer::mp4(&args.output, &numbers, dt, &image)?),
        };
        writer.push(k, &image)?;
        bar.inc(1);
        Ok(())
    })?;
    bar.finish_and_clear();
    match writer {
        Some(writer) if !stopped() => writer.finish(&args.output).map(|()| true),
        _ => Ok(false),
    }
}

/// The frames of the film: those asked for that all runs have.
fn choose_frames(args: &Args, runs: &[Run]) -> Result<Vec<u64>> {
    let mut numbers = chosen_frames(&runs[0].numbers, &args.frames)?;
    if args.frames.is_empty() {
        numbers.retain(|number| runs.iter().all(|run| run.numbers.contains(number)));
    }
    let every = args.every.map_or(1, std::num::NonZeroUsize::get);
    let numbers: Vec<u64> = numbers.into_iter().step_by(every).collect();
    if numbers.is_empty() {
        bail!("{}: no frame is in all directories", args.output.display());
    }
    Ok(numbers)
}

/// A picture of the film.
fn draw(args: &Args, runs: &[Run], moments: &[Moment], camera: &Camera, style: &Style) -> Result<Image> {
    if args.plain && runs.len() == 1 {
        return Ok(draw_frame(&moments[0].frame(), &runs[0].stage, camera, style)?);
    }
    let caption = |run: &Run| if runs.len() > 1 { run.label.clone() } else { String::new() };
    let tiles = runs.iter().zip(moments).map(|(run, moment)| moment.tile(run, &caption(run))).collect();
    let rows = vec![Row { label: String::new(), tiles }];
    Ok(sheet(&Sheet { title: args.title.clone(), rows }, camera, style)?)
}

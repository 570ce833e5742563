//! Films: every frame as a picture, of several runs side by side.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, bail};
use fluvia_render::{Camera, Image, Legend, Page, Style, draw_frame};

use super::moment::{Moment, Run};
use super::writer::{Writer, palette_frames};
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
    let (mut seen, mut subject) = (Seen::default(), subject(runs));
    let bar = report.bar_like(numbers.len() as u64, "{bar:16} looks at frame {pos}/{len}, {eta} left");
    for &number in &numbers {
        for run in runs {
            if stopped() {
                return Ok(false);
            }
            let (position, colors) = run.particles(number, args.color())?;
            seen.add(&colors);
            subject.add(&position);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let dt = runs[0].dt;
    let turn = |k: usize| {
        args.place.orbit.map_or(0.0, |speed| speed * (numbers[k].abs_diff(numbers[0]) as f64 * dt) as f32)
    };
    // Of a list of frames the last need not be the farthest.
    let farthest = |far: f32, turn: f32| if turn.abs() > far.abs() { turn } else { far };
    let camera = args.camera(&subject, false, (0..numbers.len()).map(turn).fold(0.0, farthest))?;
    seen.check(args, runs, report)?;
    // Of all frames one, so that all pictures have one size.
    let (style, legend) = (style(args, runs, &seen), seen.legend(args));
    let surface = args.surface();
    let drawn = |k: usize| {
        let moment = |run: &Run| run.moment(numbers[k], args.color(), surface.as_ref());
        let moments = runs.iter().map(moment).collect::<Result<Vec<Moment>>>()?;
        draw(args, runs, &moments, &camera.turned(turn(k)), &style, &legend)
    };

    let mut writer = None;
    if kind == Kind::Gif {
        let count = palette_frames(numbers.len()).len() as u64;
        let bar = report.bar_like(count, "{bar:16} chooses colours, frame {pos}/{len}, {eta} left");
        writer = Writer::gif(&numbers, dt, interrupted, |k| drawn(k).inspect(|_| bar.inc(1)))?;
        bar.finish_and_clear();
        if writer.is_none() {
            return Ok(false);
        }
    }
    let (bar, start) =
        (report.bar_like(numbers.len() as u64, "{bar:16} frame {pos}/{len}, {eta} left"), Instant::now());
    let places: Vec<usize> = (0..numbers.len()).collect();
    // All threads draw, each a frame; this one, which only writes, waits for them.
    let work = |&k: &usize| if stopped() { Ok(None) } else { drawn(k).map(Some) };
    in_order(rayon::current_num_threads(), &places, work, |&k, image| {
        let Some(image) = image.filter(|_| !stopped()) else { return Ok(()) };
        let writer = match &mut writer {
            Some(writer) => writer,
            none => none.insert(Writer::mp4(&args.output, &numbers, dt, &image)?),
        };
        writer.push(k, &image)?;
        bar.inc(1);
        Ok(())
    })?;
    bar.finish_and_clear();
    let Some(writer) = writer.filter(|_| !stopped()) else { return Ok(false) };
    let is_done = writer.finish(&args.output, interrupted)?;
    if is_done {
        let (output, count) = (args.output.display(), numbers.len());
        let each = 1e3 * start.elapsed().as_secs_f64() / count as f64;
        report.detail(format_args!("{output}: {count} frames, {each:.0} ms a frame"));
    }
    Ok(is_done)
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
fn draw(
    args: &Args,
    runs: &[Run],
    moments: &[Moment],
    camera: &Camera,
    style: &Style,
    legend: &Legend,
) -> Result<Image> {
    let all = runs.iter().zip(moments);
    if args.plain {
        let picture = |(run, moment): (&Run, &Moment)| draw_frame(&moment.frame(), &run.stage, camera, style);
        return Ok(beside(&all.map(picture).collect::<Result<Vec<_>, _>>()?));
    }
    let caption = |run: &Run| if runs.len() > 1 { run.label.clone() } else { String::new() };
    let mut page = Page::new(&args.title, &[("", runs.len())], legend.clone(), camera, style)?;
    for (column, (run, moment)) in all.enumerate() {
        page.draw([0, column], &moment.tile(run, &caption(run)))?;
    }
    Ok(page.finish())
}

/// Pictures of one size side by side.
fn beside(pictures: &[Image]) -> Image {
    let [width, height] = pictures.first().map_or([0; 2], |picture| [picture.width, picture.height]);
    let bytes = 3 * width as usize;
    let row = |y: usize| pictures.iter().flat_map(move |picture| &picture.data[y * bytes..(y + 1) * bytes]);
    let data = (0..height as usize).flat_map(row).copied().collect();
    Image { width: width * pictures.len() as u32, height, data }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_lie_side_by_side() {
        let picture = |first: u8| Image { width: 1, height: 2, data: (first..first + 6).collect() };
        let both = beside(&[picture(0), picture(10)]);
        assert_eq!((both.width, both.height), (2, 2));
        assert_eq!(both.data, [0, 1, 2, 10, 11, 12, 3, 4, 5, 13, 14, 15]);
        assert_eq!(beside(&[picture(7)]), picture(7));
    }
}

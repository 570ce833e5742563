//! Pictures and sheets.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use fluvia_render::{Page, draw_frame, encode_png};

use super::moment::{Moment, Run};
use super::values::Shape;
use super::{Args, Seen, style, subject};
use crate::options::chosen_frames;
use crate::report::Report;

/// A picture or a sheet, as a file; `None` if it was interrupted. Frames are read twice, first for the camera and the
/// colours of all, so that one is in memory.
pub fn picture(
    args: &Args,
    runs: &[Run],
    interrupted: &AtomicBool,
    report: &Report,
) -> Result<Option<Vec<u8>>> {
    let rows = choose_frames(args, runs)?;
    let is_sheet = args.sheet.is_some() || rows.len() > 1 || rows[0].1.len() > 1;
    if args.plain && is_sheet {
        bail!("{}: --plain is for one picture or a film", args.output.display());
    }
    let stopped = || interrupted.load(Ordering::Relaxed);
    let (mut seen, mut subject) = (Seen::default(), subject(runs));
    for (run, frames) in &rows {
        for &frame in frames {
            if stopped() {
                return Ok(None);
            }
            let (position, colors) = runs[*run].particles(frame, args.color())?;
            seen.add(&colors);
            subject.add(&position);
        }
    }
    seen.check(args, runs, report)?;
    let camera = args.camera(&subject, is_sheet, 0.0)?;
    let style = style(args, runs, &seen);
    let surface = args.surface();
    let moment = |run: &Run, frame: u64| -> Result<Option<Moment>> {
        let moment =
            if stopped() { None } else { Some(run.moment(frame, args.color(), surface.as_ref())?) };
        Ok(moment.filter(|_| !stopped()))
    };
    let image = if args.plain {
        let (run, frames) = (&runs[rows[0].0], &rows[0].1);
        let Some(moment) = moment(run, frames[0])? else { return Ok(None) };
        draw_frame(&moment.frame(), &run.stage, &camera, &style)?
    } else {
        // The rows of one run need no label.
        let label = |run: usize| if runs.len() == 1 { "" } else { runs[run].label.as_str() };
        let shape: Vec<(&str, usize)> =
            rows.iter().map(|(run, frames)| (label(*run), frames.len())).collect();
        let mut page = Page::new(&args.title, &shape, seen.legend(args), &camera, &style)?;
        for (row, (run, frames)) in rows.iter().enumerate() {
            for (column, &frame) in frames.iter().enumerate() {
                let Some(moment) = moment(&runs[*run], frame)? else { return Ok(None) };
                page.draw([row, column], &moment.tile(&runs[*run], ""))?;
            }
        }
        page.finish()
    };
    Ok(if stopped() { None } else { Some(encode_png(&image)?) })
}

/// The rows of the picture: which run, and which of its frames.
fn choose_frames(args: &Args, runs: &[Run]) -> Result<Vec<(usize, Vec<u64>)>> {
    let mut rows = Vec::new();
    for (k, run) in runs.iter().enumerate() {
        let there = run.numbers.as_slice();
        let last = *there.last().context("a run has frames")?;
        let given = if args.frames.is_empty() { Vec::new() } else { chosen_frames(there, &args.frames)? };
        let (columns, row_count) = match args.sheet {
            Some(shape) => (shape.columns, if runs.len() == 1 { shape.rows } else { 1 }),
            None => (given.len().max(1), 1),
        };
        let count = columns * row_count;
        if let Some(Shape { columns, rows }) = args.sheet {
            if !given.is_empty() && given.len() != count {
                let given = given.len();
                bail!("--frames: {given} frames for {count} places of --sheet {columns}x{rows}");
            }
            if runs.len() > 1 && rows != runs.len() {
                let count = runs.len();
                bail!("--sheet: {rows} rows for {count} directories, expected {columns}x{count}");
            }
        }
        let frames: Vec<u64> = match (given.as_slice(), args.frame) {
            ([], None) if count == 1 => vec![last],
            ([], None) => spread(there, count),
            ([], Some(frame)) => vec![frame],
            (frames, _) => frames.to_vec(),
        };
        rows.extend(frames.chunks(columns).map(|frames| (k, frames.to_vec())));
    }
    Ok(rows)
}

/// `count` of the frames, evenly spread from the first to the last.
fn spread(frames: &[u64], count: usize) -> Vec<u64> {
    let count = count.min(frames.len());
    (0..count).map(|k| frames[(k * (frames.len() - 1)).checked_div(count - 1).unwrap_or(0)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_spread_from_the_first_to_the_last() {
        assert_eq!(spread(&[0, 1, 2, 3, 4], 3), [0, 2, 4]);
        assert_eq!(spread(&[3, 7], 8), [3, 7]);
        assert_eq!(spread(&[3, 7], 1), [3]);
    }
}

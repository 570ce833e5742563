//! `fluvia mesh`: the surface of the liquid of each frame, as files for Blender, Houdini and ParaView.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use fluvia_sim::Error;
use fluvia_sim::frames::remove_temporaries;
use fluvia_sim::mesh::{Surface, SurfaceFormat};

use crate::frame_source::FrameSource;
use crate::in_order::in_order;
use crate::interrupt;
use crate::options::{FrameRange, chosen_frames, frame_range, positive, threads};
use crate::report::{Report, counted};
use crate::surface::{Params, reconstruct};

/// Options of `fluvia mesh`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia mesh out/dam -o out/dam_surface
  fluvia mesh out/dam -o out/dam_surface --format vtk --frames 0..200 --every 2
  fluvia mesh data/valid/sim_0206 -o surface --format obj --cube-size 0.75
  fluvia mesh out/dam -o out/fine --cube-size 0.25 --smoothing 50 --overwrite
  fluvia mesh out/dam -o out/fine --cube-size 0.25 --smoothing 50 --resume

Writes surface_0000.ply and so on, numbered as the frames: triangles in metres, counter-clockwise seen from outside, with \
normals that point out of the liquid and the liquid's velocities (m/s; obj has no place for them).")]
pub struct Args {
    /// The directory of a run, or a sequence of a data set: the folder of one, a part file, or the common prefix of its
    /// parts.
    #[arg(value_name = "FRAMES")]
    source: PathBuf,
    /// The directory to write to.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// The format of the files: ply, obj or vtk.
    #[arg(long, value_name = "FORMAT", default_value_t = SurfaceFormat::Ply)]
    format: SurfaceFormat,
    /// The frames, numbers and ranges FIRST..LAST; all if not given.
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = frame_range)]
    frames: Vec<FrameRange>,
    /// Every K-th of them only.
    #[arg(long, value_name = "K", default_value = "1")]
    every: NonZeroUsize,
    /// The particle radius where that is not recorded, metres; 0.025 if not given.
    #[arg(long, value_name = "METRES", value_parser = positive)]
    particle_radius: Option<f32>,
    /// Replace surfaces of these frames that are in the directory.
    #[arg(long, conflicts_with = "resume")]
    overwrite: bool,
    /// Go on where a command with the same frames and options was stopped: surfaces that are in the directory stay. Those
    /// that were made otherwise are an error.
    #[arg(long)]
    resume: bool,
    /// Threads; all cores if not given. Results do not depend on it.
    #[arg(long, value_name = "T", value_parser = threads)]
    threads: Option<usize>,
    #[command(flatten)]
    params: Params,
}

pub fn run(args: &Args, report: &Report) -> Result<ExitCode> {
    let mut source = FrameSource::open(&args.source, None)?;
    source.assume_radius(args.particle_radius);
    let radius = source.particle_radius;
    let mut numbers = chosen_frames(source.numbers(), &args.frames)?;
    // Ranges may overlap.
    numbers.sort_unstable();
    numbers.dedup();
    let numbers: Vec<u64> = numbers.into_iter().step_by(args.every.get()).collect();
    let comment = comment(args, radius);
    let mut directory = Directory::open(&args.output, args.format)?;
    let (numbers, there) = directory.choose(numbers, args, &comment)?;
    let interrupted = interrupt::watch()?;
    let threads = args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));

    let bar = report.bar_like(numbers.len() as u64, "{bar:16} surface {pos}/{len}, {msg}{eta} left");
    let (source, written) = (Mutex::new(source), AtomicBool::new(false));
    let (mut done, mut triangles, start) = (0, 0, Instant::now());
    let work = |&number: &u64| {
        if interrupted.load(Ordering::Relaxed) {
            return Ok(None);
        }
        // Frames are read one after another: of a sequence a part is kept for the next.
        let frame = source.lock().unwrap_or_else(PoisonError::into_inner).read(number)?;
        let surface = reconstruct(&frame.position, frame.velocity.as_deref(), radius, &args.params)
            .with_context(|| format!("{}: frame {number}", args.source.display()))?;
        surface.write(&directory.begin(number)?, args.format, &comment)?;
        written.store(true, Ordering::Relaxed);
        Ok(Some(surface.mesh.triangles.len()))
    };
    let result = in_order(threads, &numbers, work, |_, count| {
        if let Some(count) = count {
            done += 1;
            triangles += count;
            bar.set_message(format!("{count} triangles, "));
            bar.inc(1);
        }
        Ok(())
    });
    bar.finish_and_clear();
    if !written.into_inner() {
        directory.remove_if_made();
    }
    result?;
    let output = args.output.display();
    let each = 1e3 * start.elapsed().as_secs_f64() / done.max(1) as f64;
    report.detail(format_args!("{output}: {done} surfaces, {triangles} triangles, {each:.0} ms a surface"));
    if args.overwrite && directory.others > 0 {
        let others = counted(directory.others, "surface");
        report.note(format_args!("{output}: {others} of other frames left as they were"));
    }
    if done < numbers.len() {
        let (done, all) = (there + done, there + numbers.len());
        let instead = if args.overwrite { " in place of --overwrite" } else { "" };
        report.note(format_args!(
            "{output}: stopped after {done} of {all} surfaces; the same command with --resume{instead} goes on"
        ));
        return Ok(interrupt::exit_code());
    }
    Ok(ExitCode::SUCCESS)
}

/// How a surface is made: what stands in its file, by which --resume knows it.
fn comment(args: &Args, radius: f32) -> String {
    let Params { smoothing_length, cube_size, threshold, smoothing, normal_smoothing } = args.params;
    format!(
        "fluvia mesh --smoothing-length {smoothing_length} --cube-size {cube_size} --threshold {threshold} \
         --smoothing {smoothing} --normal-smoothing {normal_smoothing} --particle-radius {radius} {}",
        args.source.display()
    )
}

/// The directory of the surfaces.
struct Directory {
    path: PathBuf,
    format: SurfaceFormat,
    /// Whether it was made here.
    made: bool,
    /// The names of the surfaces of the format that were there.
    there: BTreeSet<String>,
    /// Those that are to be replaced.
    old: Mutex<Vec<PathBuf>>,
    /// The number of those that have nothing to do with this.
    others: usize,
}

impl Directory {
    /// Makes the directory where there is none.
    fn open(path: &Path, format: SurfaceFormat) -> Result<Directory> {
        let made = !path.exists();
        if made {
            fs::create_dir_all(path).map_err(Error::io(path))?;
        }
        let mut there = BTreeSet::new();
        for entry in fs::read_dir(path).map_err(Error::io(path))? {
            let entry = entry.map_err(Error::io(path))?;
            there.extend(entry.file_name().into_string().ok().filter(|name| is_surface(name, format)));
        }
        Ok(Directory { path: path.to_path_buf(), format, made, there, old: Mutex::default(), others: 0 })
    }

    /// The frames whose surfaces are to be made, and how many of the others have theirs.
    ///
    /// # Errors
    /// If there are surfaces of them already, and neither to be replaced nor to stay, or to stay without this comment.
    fn choose(&mut self, mut numbers: Vec<u64>, args: &Args, comment: &str) -> Result<(Vec<u64>, usize)> {
        let names: BTreeSet<String> = numbers.iter().map(|&number| self.name(number)).collect();
        let old: Vec<&String> = self.there.intersection(&names).collect();
        self.others = self.there.len() - old.len();
        let path = self.path.display();
        if let Some(name) = old.first()
            && !args.overwrite
            && !args.resume
        {
            bail!(
                "{path}: holds surfaces already ({name}), expected --overwrite, --resume or another directory"
            );
        }
        for name in old.iter().filter(|_| args.resume) {
            let file = self.path.join(name);
            if !Surface::has_comment(&file, self.format, comment)? {
                bail!("{}: was not made by `{comment}`, expected so for --resume", file.display());
            }
        }
        if args.overwrite {
            self.old = Mutex::new(old.iter().map(|name| self.path.join(name)).collect());
        }
        // Those of other frames may be another process's that works in the same directory.
        remove_temporaries(&self.path, |name| names.contains(name))?;
        let all = numbers.len();
        if args.resume {
            numbers.retain(|&number| !self.there.contains(&self.name(number)));
        }
        let there = all - numbers.len();
        Ok((numbers, there))
    }

    fn name(&self, number: u64) -> String {
        format!("{PREFIX}{number:0DIGITS$}.{}", self.format)
    }

    /// The file for a surface that is about to be written. Before the first the old ones are removed, all of them, so
    /// that those that are there when it is stopped are the new ones.
    fn begin(&self, number: u64) -> Result<PathBuf> {
        for file in self.old.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
            match fs::remove_file(&file) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(Error::io(&file)(error).into());
                }
                _ => {}
            }
        }
        Ok(self.path.join(self.name(number)))
    }

    /// Removes the directory again, if nothing is in it that was not there; it is no error if that fails.
    fn remove_if_made(&self) {
        if self.made {
            let _ = fs::remove_dir(&self.path);
        }
    }
}

/// What the names of surfaces begin with.
const PREFIX: &str = "surface_";

/// Surfaces are numbered with at least this many digits, as frames are.
const DIGITS: usize = 4;

/// Whether a file name is that of a surface of a format.
fn is_surface(name: &str, format: SurfaceFormat) -> bool {
    let parts = name.strip_prefix(PREFIX).and_then(|rest| rest.split_once('.'));
    parts.is_some_and(|(digits, extension)| {
        let is_number = digits.len() >= DIGITS && digits.bytes().all(|digit| digit.is_ascii_digit());
        is_number && extension == format.extension()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_known_by_their_names() {
        let is_ply = |name: &str| is_surface(name, SurfaceFormat::Ply);
        assert!(["surface_0000.ply", "surface_12345.ply"].into_iter().all(is_ply));
        let others =
            ["surface_1.ply", "surface_0000.obj", "surface_000x.ply", "fluid_0000.ply", "surface_0000"];
        assert!(!others.into_iter().any(is_ply));
    }
}

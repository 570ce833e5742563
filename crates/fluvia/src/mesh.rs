//! `fluvia mesh`: the surface of the liquid of each frame, as files for Blender, Houdini and ParaView.

use std::fs;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, bail};
use fluvia_sim::Error;
use fluvia_sim::frames::remove_temporaries;
use fluvia_sim::mesh::SurfaceFormat;

use crate::frame_source::FrameSource;
use crate::in_order::in_order;
use crate::interrupt;
use crate::options::{FrameRange, chosen_frames, frame_range, positive, threads};
use crate::report::Report;
use crate::surface::{Params, reconstruct};

/// Options of `fluvia mesh`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  fluvia mesh out/dam -o out/dam_surface
  fluvia mesh out/dam -o out/dam_surface --format vtk --frames 0..200 --every 2
  fluvia mesh data/valid/sim_0206 -o surface --format obj --cube-size 0.75
  fluvia mesh out/dam -o out/fine --cube-size 0.25 --smoothing 50 --overwrite

Writes surface_0000.ply and so on, numbered as the frames: triangles in metres, counter-clockwise seen from outside, with
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
    /// Replace the surfaces in the directory.
    #[arg(long)]
    overwrite: bool,
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
    let numbers = chosen_frames(source.numbers(), &args.frames)?;
    let numbers: Vec<u64> = numbers.into_iter().step_by(args.every.get()).collect();
    let directory = Directory::open(&args.output, args.format, args.overwrite)?;
    let interrupted = interrupt::watch()?;
    let threads = args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));

    let bar = report.bar_like(numbers.len() as u64, "{bar:16} surface {pos}/{len}, {msg}{eta} left");
    let (source, written) = (Mutex::new(source), AtomicBool::new(false));
    let (mut done, mut triangles) = (0, 0);
    let work = |&number: &u64| {
        if interrupted.load(Ordering::Relaxed) {
            return Ok(None);
        }
        // Frames are read one after another: of a sequence a part is kept for the next.
        let frame = source.lock().unwrap_or_else(PoisonError::into_inner).read(number)?;
        let surface = reconstruct(&frame.position, frame.velocity.as_deref(), radius, &args.params)
            .with_context(|| format!("{}: frame {number}", args.source.display()))?;
        surface.write(&directory.begin(number)?, args.format)?;
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
    report.detail(format_args!("{output}: {done} surfaces, {triangles} triangles"));
    if done < numbers.len() {
        report.note(format_args!("{output}: stopped after {done} of {} surfaces", numbers.len()));
        return Ok(interrupt::exit_code());
    }
    Ok(ExitCode::SUCCESS)
}

/// The directory of the surfaces.
struct Directory {
    path: PathBuf,
    format: SurfaceFormat,
    /// Whether it was made here.
    made: bool,
    /// Surfaces that are to be overwritten.
    old: Mutex<Vec<PathBuf>>,
}

impl Directory {
    /// Makes the directory where there is none. Surfaces in it are an error, if they are not to be overwritten.
    fn open(path: &Path, format: SurfaceFormat, overwrite: bool) -> Result<Directory> {
        let made = !path.exists();
        if made {
            fs::create_dir_all(path).map_err(Error::io(path))?;
        }
        let mut old = Vec::new();
        for entry in fs::read_dir(path).map_err(Error::io(path))? {
            let entry = entry.map_err(Error::io(path))?;
            old.extend(entry.file_name().into_string().ok().filter(|name| is_surface(name)));
        }
        old.sort();
        if let (false, Some(name)) = (overwrite, old.first()) {
            let path = path.display();
            bail!("{path}: holds surfaces already ({name}), expected --overwrite or another directory");
        }
        remove_temporaries(path, PREFIX)?;
        let old = Mutex::new(old.into_iter().map(|name| path.join(name)).collect());
        Ok(Directory { path: path.to_path_buf(), format, made, old })
    }

    /// The file for a surface that is about to be written. The old surfaces are removed before the first.
    fn begin(&self, number: u64) -> Result<PathBuf> {
        for file in self.old.lock().unwrap_or_else(PoisonError::into_inner).drain(..) {
            match fs::remove_file(&file) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(Error::io(&file)(error).into());
                }
                _ => {}
            }
        }
        Ok(self.path.join(format!("{PREFIX}{number:0DIGITS$}.{}", self.format)))
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

/// Whether a file name is that of a surface.
fn is_surface(name: &str) -> bool {
    let parts = name.strip_prefix(PREFIX).and_then(|rest| rest.split_once('.'));
    parts.is_some_and(|(digits, extension)| {
        let is_number = digits.len() >= DIGITS && digits.bytes().all(|digit| digit.is_ascii_digit());
        is_number && SurfaceFormat::ALL.iter().any(|format| format.extension() == extension)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_known_by_their_names() {
        assert!(["surface_0000.ply", "surface_12345.vtk"].into_iter().all(is_surface));
        let others =
            ["surface_1.ply", "surface_0000.stl", "surface_000x.ply", "fluid_0000.ply", "surface_0000"];
        assert!(!others.into_iter().any(is_surface));
    }
}

//! Films as MP4, by ffmpeg: it gets the pictures through a pipe, and writes under a temporary name that becomes the
//! film's when it is whole.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use fluvia_render::Image;
use fluvia_sim::frames::Replacement;

/// Quality of x264: 17 looks the same as the pictures.
const QUALITY: &str = "17";

/// How thoroughly x264 looks for what repeats: this takes two thirds of the time of its default for a twelfth more bytes.
const PRESET: &str = "faster";

/// How long ffmpeg is left alone at its end before Ctrl-C is looked for.
const POLL: Duration = Duration::from_millis(10);

/// A film that is being written; without [`finish`](Mp4::finish) nothing is left of it.
pub struct Mp4 {
    child: Child,
    /// `None` once it has been closed.
    pictures: Option<ChildStdin>,
    complaints: Option<JoinHandle<String>>,
    /// Dropped after ffmpeg has ended.
    file: Option<Replacement>,
    name: String,
    /// Of each picture, pixels.
    size: [u32; 2],
}

/// Makes sure that ffmpeg is there.
///
/// # Errors
/// If it is not.
pub fn check(path: &Path) -> Result<()> {
    let mut command = Command::new("ffmpeg");
    command.arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => bail!("{}: ffmpeg, which writes mp4, does not run ({status})", path.display()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let path = path.display();
            bail!(
                "{path}: mp4 is written by ffmpeg, which is not installed; a name that ends in .gif needs nothing"
            )
        }
        Err(error) => Err(error).context(format!("{}: ffmpeg, which writes mp4", path.display())),
    }
}

impl Mp4 {
    /// Starts a film of pictures of an even width and height, shown for `seconds` each.
    pub fn start(path: &Path, [width, height]: [u32; 2], seconds: f64) -> Result<Mp4> {
        let (file, name) = (Replacement::begin(path)?, path.display().to_string());
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-hide_banner", "-loglevel", "error", "-y"]);
        command.args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &format!("{width}x{height}")]);
        command.args(["-r", &(1.0 / seconds).to_string(), "-i", "pipe:0"]);
        // What every player takes; bt709 is what they take the colours of films of this size for.
        command.args(["-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p"]);
        command.args(["-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "iec61966-2-1"]);
        command.args(["-c:v", "libx264", "-preset", PRESET, "-crf", QUALITY]);
        command.args(["-movflags", "+faststart", "-f", "mp4"]);
        command.arg(file.temporary());
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        // Ctrl-C is for this program, which stops ffmpeg itself.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().with_context(|| format!("{name}: ffmpeg"))?;
        let pictures = child.stdin.take();
        let complaints = child.stderr.take().map(|mut stderr| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                // What cannot be read is not said.
                let _ = stderr.read_to_end(&mut bytes);
                String::from_utf8_lossy(&bytes).into_owned()
            })
        });
        Ok(Mp4 { child, pictures, complaints, file: Some(file), name, size: [width, height] })
    }

    /// Adds a picture. In the pipe they have no borders: one of another size would shear all that follow.
    pub fn push(&mut self, image: &Image) -> Result<()> {
        if [image.width, image.height] != self.size {
            let ([width, height], name) = (self.size, &self.name);
            bail!(
                "{name}: a picture of {} x {} pixels in a film of {width} x {height}",
                image.width,
                image.height
            );
        }
        let written = self.pictures.as_mut().map(|pipe| pipe.write_all(&image.data));
        match written {
            Some(Ok(())) => Ok(()),
            Some(Err(_)) | None => self.wait().and_then(|()| bail!("{}: ffmpeg has ended", self.name)),
        }
    }

    /// Ends the film and gives it its name; false if it was interrupted while ffmpeg encodes what it has.
    pub fn finish(mut self, interrupted: &AtomicBool) -> Result<bool> {
        self.pictures = None;
        while self.child.try_wait().context("ffmpeg")?.is_none() {
            if interrupted.load(Ordering::Relaxed) {
                return Ok(false);
            }
            std::thread::sleep(POLL);
        }
        self.wait()?;
        let temporary = self.file.as_ref().map(Replacement::temporary);
        if !temporary.is_some_and(|path| is_whole(path).unwrap_or(false)) {
            bail!("{}: ffmpeg wrote part of the film only, as on a full disk", self.name);
        }
        self.file.take().map_or(Ok(()), Replacement::commit)?;
        Ok(true)
    }

    /// Waits for ffmpeg; its last line is the error if there is one.
    fn wait(&mut self) -> Result<()> {
        self.pictures = None;
        let status = self.child.wait().context("ffmpeg")?;
        let said = self.complaints.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        if status.success() {
            return Ok(());
        }
        let last = said.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or("no message");
        bail!("{}: ffmpeg failed ({status}): {last}", self.name)
    }
}

/// Whether a file is an MP4 that is not cut off: boxes that fill it, each after its length and name, with the index of
/// pictures among them. At the end of a full disk ffmpeg says that all is well.
fn is_whole(path: &Path) -> io::Result<bool> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let (mut place, mut has_index) = (0, false);
    while place < length {
        file.seek(SeekFrom::Start(place))?;
        let mut head = [0; 16];
        let found = file.read(&mut head)?;
        if found < 8 {
            return Ok(false);
        }
        let number = |bytes: &[u8]| bytes.iter().fold(0u64, |number, &byte| number << 8 | u64::from(byte));
        let size = match number(&head[..4]) {
            // The length is longer than four bytes.
            1 if found == 16 => number(&head[8..]),
            size => size,
        };
        has_index |= &head[4..8] == b"moov";
        match place.checked_add(size) {
            Some(next) if size >= 8 => place = next,
            _ => return Ok(false),
        }
    }
    Ok(has_index && place == length)
}

impl Drop for Mp4 {
    fn drop(&mut self) {
        // One that has ended cannot be killed; nothing else is to be done about either.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_film_is_whole_if_its_boxes_fill_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film");
        let whole = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            is_whole(&path).unwrap()
        };
        let boxed =
            |name: &[u8], rest: usize| [&(8 + rest as u32).to_be_bytes()[..], name, &vec![7; rest]].concat();
        let long = [&[0, 0, 0, 1][..], b"mdat", &20u64.to_be_bytes(), &[7; 4]].concat();
        let film = [boxed(b"ftyp", 24), boxed(b"moov", 40), long].concat();
        assert!(whole(&film));
        // Cut off anywhere but between two boxes after the index.
        let ends = (0..film.len()).filter(|&end| whole(&film[..end]));
        assert_eq!(ends.collect::<Vec<_>>(), [80]);
        assert!(!whole(&boxed(b"ftyp", 24)) && !whole(&[0; 64]));
        assert!(!whole(&[film, vec![0, 0, 0, 1]].concat()));
        assert!(!whole(&[&[0, 0, 0, 1][..], b"moov", &[255; 8]].concat()));
    }
}

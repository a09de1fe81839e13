//! Films of a run: its frames, made an MP4 by ffmpeg, which is a program of its own and may be absent.
//!
//! The codec is the one that this ffmpeg prefers for MP4, so the same run and options give the same bytes for one version of
//! ffmpeg only.

use metamorph_protocol::time::{Span, Time};
use metamorph_scene::figure::picture::Picture;
use metamorph_scene::figure::{Figure, FigureError};
use std::io::{self, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use tempfile::TempDir;

/// The program that makes films.
const FFMPEG: &str = "ffmpeg";
/// The file that it makes, in a directory of its own.
const FILM: &str = "film.mp4";

/// Makes a film: the run until `end`, with a frame for every so much scenario time, and the end. `going` is asked before each
/// frame whether to continue. Returns the content of the file and the number of frames.
///
/// # Errors
///
/// There is nothing to draw, there are too many frames, or ffmpeg is absent or fails.
pub fn mp4(
    figure: &Figure<'_>,
    every: Span,
    end: Time,
    fps: u32,
    going: &dyn Fn() -> bool,
) -> Result<(Vec<u8>, u32), FigureError> {
    let directory = TempDir::new()?;
    let mut film: Option<Film> = None;
    let drawn = figure.series(every, end, going, |_, picture| {
        let pixmap = figure.pixels(picture)?;
        let size = [pixmap.width(), pixmap.height()];
        let begun = match &mut film {
            Some(film) => film,
            none => none.insert(Film::begin(&directory, picture, size, fps)?),
        };
        // Moving pictures have a background, so no pixel is transparent.
        begun.frames.write_all(pixmap.data()).map_err(FigureError::from)
    });
    match (drawn, film.map(|film| film.end(&directory))) {
        (Ok(frames), Some(made)) => Ok((made?, frames)),
        // If ffmpeg takes no more frames, its last words are the reason.
        (Err(FigureError::Write(_)), Some(Err(said))) => Err(said),
        (Err(error), _) => Err(error),
        (Ok(_), None) => Err(FigureError::Ffmpeg("there are no frames".to_owned())),
    }
}

/// A film that is being made.
struct Film {
    ffmpeg: Child,
    frames: ChildStdin,
}

impl Film {
    fn begin(
        directory: &TempDir,
        first: &Picture,
        [width, height]: [u32; 2],
        fps: u32,
    ) -> Result<Film, FigureError> {
        let mut ffmpeg = Command::new(FFMPEG)
            .args(["-hide_banner", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgba"])
            .args(["-video_size", &format!("{width}x{height}"), "-framerate", &fps.to_string(), "-i", "-"])
            // Codecs take even sizes, and players this format of pixels.
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p"])
            .args(["-metadata", &format!("title={}", first.title)])
            .args(["-metadata", &format!("comment={}", first.description)])
            .args(["-movflags", "+faststart", "-fflags", "+bitexact", "-f", "mp4"])
            .arg(directory.path().join(FILM))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| match error.kind() {
                io::ErrorKind::NotFound => FigureError::NoFfmpeg,
                _ => FigureError::Ffmpeg(error.to_string()),
            })?;
        let frames =
            ffmpeg.stdin.take().ok_or_else(|| FigureError::Ffmpeg("it takes no frames".to_owned()))?;
        Ok(Film { ffmpeg, frames })
    }

    fn end(self, directory: &TempDir) -> Result<Vec<u8>, FigureError> {
        drop(self.frames);
        let ended = self.ffmpeg.wait_with_output()?;
        if ended.status.success() {
            return Ok(std::fs::read(directory.path().join(FILM))?);
        }
        let said = String::from_utf8_lossy(&ended.stderr).trim().to_owned();
        Err(FigureError::Ffmpeg(if said.is_empty() { ended.status.to_string() } else { said }))
    }
}

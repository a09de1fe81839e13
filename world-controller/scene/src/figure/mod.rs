//! Figures of a run, without a browser or a display: vector graphics for papers, pixels, and moving pictures.
//!
//! A [`snapshot`] of a scene is composed from convex solids in painter's order ([`composition`]), drawn as a list of
//! paths and texts ([`picture`]), which is written as SVG or turned into pixels ([`raster`], [`animation`]). The
//! same run and options give the same bytes: no clock, no random numbers, and coordinates in hundredths of a point.

pub mod animation;
pub mod camera;
pub mod composition;
pub mod drawing;
mod legend;
mod letters;
mod links;
pub mod options;
mod order;
mod outline;
pub mod palette;
pub mod pdf;
pub mod picture;
pub mod raster;
pub mod snapshot;
pub mod solid;

use crate::bodies::ShownSwarm;
use crate::scene::Scene;
use crate::visible::Stage;
use animation::Format;
use composition::{Extent, Subject};
use drawing::Provenance;
use metamorph_core::time::{Span, Time};
use metamorph_text::format::{many, seconds};
use options::{ColorBy, Style};
use picture::Picture;
use snapshot::{Playback, Snapshot};
use std::io::{self, Write};
use thiserror::Error;
use tiny_skia::Pixmap;

/// Largest number of frames of a moving picture.
pub const MOST_FRAMES: u32 = 3_000;

/// Why a figure cannot be drawn.
#[derive(Debug, Error)]
pub enum FigureError {
    /// No module is drawn.
    #[error("--only {only}{section}: there is no such module at {at}\n  fix: {}", if .section.is_empty() {
        "name modules that exist then, or leave it out"
    } else {
        "move the section, or leave it out"
    })]
    Empty {
        /// The choice.
        only: String,
        /// The sections.
        section: String,
        /// The time.
        at: String,
    },
    /// Nothing is known by which modules could be coloured.
    #[error("--color {color}: no drawn module has one at {at}\n  fix: name another time, or `--color state`")]
    NoNumbers {
        /// The colours.
        color: &'static str,
        /// The time.
        at: String,
    },
    /// Too many pixels.
    #[error("--width {width} at {dpi} dpi are more than {most} million pixels\n  fix: name fewer")]
    TooLarge {
        /// The width.
        width: String,
        /// The resolution.
        dpi: u32,
        /// The limit in millions.
        most: u64,
    },
    /// Too many frames.
    #[error("--every {every}: {} until {end} are more than {MOST_FRAMES}\n  fix: name a longer time", many(*.frames, "frame"))]
    TooManyFrames {
        /// The time between two frames.
        every: String,
        /// The number of frames.
        frames: u64,
        /// The end of the run.
        end: String,
    },
    /// The moment is after the end of the run.
    #[error("--at {at}: the run ended at {end}\n  fix: name an earlier time, a share such as 50%, or `end`")]
    Late {
        /// The moment.
        at: String,
        /// The end of the run.
        end: String,
    },
    /// The events were too many to keep.
    #[error(
        "the run has more than {0} events; only the first ones are kept, until {1}\n  fix: name a time before that"
    )]
    Forgotten(u64, String),
    /// A moving picture of one moment.
    #[error(
        "--out: a moving picture needs the time from one frame to the next\n  fix: add --every 1s, or name a file that ends in .svg, .pdf or .png"
    )]
    NoEvery,
    /// A figure of several moments.
    #[error(
        "--every: a file that ends in .svg, .pdf or .png shows one moment\n  fix: name numbered files such as --out 'frames/{{i}}.png', or one that ends in .gif, .apng or .mp4, or leave out --every"
    )]
    Every,
    /// A moving picture without a background.
    #[error("--theme transparent: moving pictures have a background\n  fix: choose another theme")]
    Transparent,
    /// There is no program that makes films.
    #[error(
        "--out: an MP4 is made by ffmpeg, which is not in PATH\n  fix: apt install ffmpeg, or name a file that ends in .gif or .apng"
    )]
    NoFfmpeg,
    /// The program that makes films has failed.
    #[error("ffmpeg made no MP4: {0}\n  fix: see what it says, or name a file that ends in .gif or .apng")]
    Ffmpeg(String),
    /// Interrupted by a signal.
    #[error("interrupted; nothing is written")]
    Interrupted,
    /// The output cannot be written.
    #[error("the figure could not be written to its end: {0}")]
    Write(#[from] io::Error),
}

/// A run, and how it is drawn.
pub struct Figure<'a> {
    scene: &'a Scene,
    swarm: &'a dyn ShownSwarm,
    subject: Subject<'a>,
    provenance: Provenance,
}

impl<'a> Figure<'a> {
    /// Creates the figures of a run.
    pub fn new(
        scene: &'a Scene,
        swarm: &'a dyn ShownSwarm,
        style: &'a Style,
        provenance: Provenance,
    ) -> Figure<'a> {
        let (view, words) = (style.camera.view(), swarm.words());
        let Stage { floor, contacts, .. } = swarm.stage();
        Figure { scene, swarm, subject: Subject { style, view, words, floor, contacts }, provenance }
    }

    /// Draws a moment.
    ///
    /// # Errors
    ///
    /// There is nothing to draw.
    pub fn still(&self, at: Time) -> Result<Picture, FigureError> {
        let snapshot = Playback::new(self.scene, self.swarm).advance(at);
        let mut extent = Extent::default();
        self.measure(&snapshot, &mut extent)?;
        extent.add_floor(&self.subject);
        Ok(self.picture(&snapshot, &extent))
    }

    fn picture(&self, snapshot: &Snapshot, extent: &Extent) -> Picture {
        self.subject.draw(snapshot, &self.subject.compose(snapshot), extent, &self.provenance)
    }

    fn measure(&self, snapshot: &Snapshot, extent: &mut Extent) -> Result<(), FigureError> {
        let composition = self.subject.compose(snapshot);
        let style = self.subject.style;
        let at = || seconds(snapshot.at.as_secs_f64());
        if composition.modules == 0 {
            let section = style.sections.iter().map(|s| format!(" --section '{s}'")).collect();
            return Err(FigureError::Empty { only: style.only.to_string(), section, at: at() });
        }
        extent.add(&self.subject, snapshot, &composition);
        let color = match style.color {
            ColorBy::Level => "level",
            ColorBy::Gradient => "gradient",
            ColorBy::Messages if extent.most == Some(0) => "messages",
            ColorBy::Locks if extent.members.is_empty() => "locks",
            _ => return Ok(()),
        };
        let known = !matches!(style.color, ColorBy::Messages | ColorBy::Locks) && extent.most.is_some();
        if known { Ok(()) } else { Err(FigureError::NoNumbers { color, at: at() }) }
    }

    /// Returns the pixels of a picture.
    ///
    /// # Errors
    ///
    /// They are too many.
    pub fn pixels(&self, picture: &Picture) -> Result<Pixmap, FigureError> {
        let style = self.subject.style;
        raster::draw(picture, style.dpi).ok_or_else(|| FigureError::TooLarge {
            width: style.width.to_string(),
            dpi: style.dpi,
            most: raster::MOST_PIXELS / 1_000_000,
        })
    }

    /// Returns the place and the scale that show all of these moments.
    fn extent(&self, moments: &[Time], going: &dyn Fn() -> bool) -> Result<Extent, FigureError> {
        let mut extent = Extent::default();
        let mut playback = Playback::new(self.scene, self.swarm);
        let mut any = Err(FigureError::Interrupted);
        for at in moments {
            if !going() {
                return Err(FigureError::Interrupted);
            }
            // Modules may have numbers to colour them by at some moments only.
            any = any.and(Ok(())).or(self.measure(&playback.advance(*at), &mut extent));
        }
        any?;
        extent.add_floor(&self.subject);
        Ok(extent)
    }

    /// Draws pictures of one place and scale: the run until `end`, for every so much scenario time, and the end. Hands
    /// each to `take` with its number, from 0. `going` is asked before each whether to continue. Returns how many there
    /// are.
    ///
    /// # Errors
    ///
    /// There is nothing to draw, there are too many pictures, or `take` fails.
    pub fn series<E: From<FigureError>>(
        &self,
        every: Span,
        end: Time,
        going: &dyn Fn() -> bool,
        mut take: impl FnMut(u32, &Picture) -> Result<(), E>,
    ) -> Result<u32, E> {
        let moments = moments(every, end)?;
        let extent = self.extent(&moments, going)?;
        let mut playback = Playback::new(self.scene, self.swarm);
        for (number, at) in (0..).zip(&moments) {
            if !going() {
                return Err(FigureError::Interrupted.into());
            }
            take(number, &self.picture(&playback.advance(*at), &extent))?;
        }
        Ok(moments.len() as u32)
    }

    /// Writes a moving picture: the run until `end`, with a frame for every so much scenario time, and the end.
    /// `going` is asked before each frame whether to continue. Returns the number of frames.
    ///
    /// # Errors
    ///
    /// There is nothing to draw, there are too many frames, or they cannot be written.
    pub fn animate(
        &self,
        format: Format,
        every: Span,
        end: Time,
        fps: u32,
        going: &dyn Fn() -> bool,
        out: impl Write,
    ) -> Result<u32, FigureError> {
        let moments = moments(every, end)?;
        let extent = self.extent(&moments, going)?;
        let first = self.picture(&Playback::new(self.scene, self.swarm).advance(Time::ZERO), &extent);
        let mut playback = Playback::new(self.scene, self.swarm);
        let draw = |frame: u32| {
            if !going() {
                return Err(FigureError::Interrupted);
            }
            if frame == 0 {
                playback = Playback::new(self.scene, self.swarm);
            }
            self.pixels(&self.picture(&playback.advance(moments[frame as usize]), &extent))
        };
        let frames = moments.len() as u32;
        animation::write(format, &first, self.subject.style.dpi, frames, fps, draw, out)?;
        Ok(frames)
    }
}

/// Returns the times of frames: every so much, and the end.
fn moments(every: Span, end: Time) -> Result<Vec<Time>, FigureError> {
    let step = every.0.max(1);
    let frames = end.0.div_ceil(step) + 1;
    if frames > u64::from(MOST_FRAMES) {
        let (every, end) = (every.to_string(), seconds(end.as_secs_f64()));
        return Err(FigureError::TooManyFrames { every, frames, end });
    }
    Ok((0..frames).map(|i| Time((i * step).min(end.0))).collect())
}

//! Prints all output of the program. Absent: the content of that output.
//!
//! Human-readable text contains no control characters but those of this module, wherever it comes from. A
//! closed pipe is not an error: the rest of the output is dropped, as in ripgrep and git. Any other failure of
//! standard output is kept until the end ([`failure`]), where it decides the exit code, because a command has
//! other things to finish first.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "this is the one place that prints")]

use crate::stopwatch::Stopwatch;
use clap::ValueEnum;
use metamorph_text::format::fitting;
use metamorph_text::paint::Paint;
use metamorph_text::progress::{ProgressLine, Status};
use std::io::{self, IsTerminal, Write};
use std::os::fd::AsFd;
use std::sync::OnceLock;
use std::time::Duration;

/// The first failure to write standard output.
static FAILURE: OnceLock<String> = OnceLock::new();

/// Whether output is coloured: the option `--color`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorChoice {
    /// On terminals that show colours.
    Auto,
    /// Also in files and pipes.
    Always,
    /// Nowhere.
    Never,
}

/// The choice of the command line; automatic if none was made.
static COLOR: OnceLock<ColorChoice> = OnceLock::new();

/// Sets the colours of this process; only the first call has an effect.
pub fn choose_color(choice: ColorChoice) {
    let _ = COLOR.set(choice);
}

/// Returns true if output is coloured. By itself that is so on a terminal that shows colours, unless the user has disabled them
/// (<https://no-color.org>, <https://bixense.com/clicolors>).
pub fn has_color(is_terminal: bool) -> bool {
    let is = |name: &str, value: &str| std::env::var_os(name).is_some_and(|of| of == value);
    let refused = std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty());
    match COLOR.get().copied().unwrap_or(ColorChoice::Auto) {
        ColorChoice::Auto => is_terminal && !refused && !is("CLICOLOR", "0") && !is("TERM", "dumb"),
        ColorChoice::Always => true,
        ColorChoice::Never => false,
    }
}

/// Returns the colours of a stream, and the width of its lines if it is a terminal.
fn paint_of(stream: impl IsTerminal + AsFd) -> Paint {
    let paint = if has_color(stream.is_terminal()) { Paint::COLOURED } else { Paint::PLAIN };
    width_of(stream).map_or(paint, |width| paint.within(width))
}

/// Returns the columns of a terminal; `None` if the stream is none, or does not say it.
fn width_of(stream: impl AsFd) -> Option<usize> {
    let size = rustix::termios::tcgetwinsize(stream).ok()?;
    (size.ws_col > 0).then_some(size.ws_col.into())
}

/// The destination of human-readable text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Standard output.
    Out,
    /// Standard error, when standard output is read by a program.
    Err,
    /// Nowhere.
    Quiet,
}

impl Channel {
    /// Returns standard output, unless it is taken by other data.
    pub fn beside(taken: bool, quiet: bool) -> Channel {
        match (quiet, taken) {
            (true, _) => Channel::Quiet,
            (false, true) => Channel::Err,
            (false, false) => Channel::Out,
        }
    }
    /// Returns the colours that suit the channel.
    pub fn paint(self) -> Paint {
        match self {
            Channel::Out => paint_of(std::io::stdout()),
            Channel::Err => paint_of(std::io::stderr()),
            Channel::Quiet => Paint::PLAIN,
        }
    }
    /// Prints text and terminates the last line.
    pub fn say(self, text: &str) {
        match self {
            Channel::Out => print_out(text),
            Channel::Err => print_error(text),
            Channel::Quiet => {}
        }
    }
}

/// Prints human-readable text on standard output.
pub fn print_out(text: &str) {
    let paint = Channel::Out.paint();
    write_out(paint.finish(text).as_bytes());
}

/// Prints data for a program on standard output, unchanged but for the final newline.
pub fn print_data(data: &str) {
    let end = if data.ends_with('\n') { "" } else { "\n" };
    write_out(format!("{data}{end}").as_bytes());
}

fn write_out(bytes: &[u8]) {
    let mut out = std::io::stdout().lock();
    note(out.write_all(bytes).and_then(|()| out.flush()));
}

/// Records the result of writing to standard output.
pub fn note(written: io::Result<()>) {
    match written {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            // The first failure is the one reported.
            let _ = FAILURE.set(error.to_string());
        }
        _ => {}
    }
}

/// Returns why standard output could not be written, or `None`.
pub fn failure() -> Option<&'static str> {
    FAILURE.get().map(String::as_str)
}

/// Prints human-readable text on standard error.
pub fn print_error(text: &str) {
    // A failure here cannot be reported anywhere.
    let _ = std::io::stderr().lock().write_all(Channel::Err.paint().finish(text).as_bytes());
}

/// The content of the live line.
#[derive(Clone, Debug)]
pub enum Drawing {
    /// This text.
    Text(String),
    /// The progress of a run.
    Run(Status),
}

impl From<String> for Drawing {
    fn from(text: String) -> Drawing {
        Drawing::Text(text)
    }
}

impl From<Status> for Drawing {
    fn from(status: Status) -> Drawing {
        Drawing::Run(status)
    }
}

/// A line on standard error that is redrawn in place; on a terminal only.
pub struct Live {
    on: bool,
    drawn: bool,
    last: Stopwatch,
    since: Stopwatch,
    progress_line: ProgressLine,
}

impl Live {
    /// Time between two redraws.
    const EVERY: Duration = Duration::from_millis(100);

    /// Creates a line. It is drawn only if `wanted`, and if standard error is a terminal that can redraw a
    /// line.
    pub fn new(wanted: bool) -> Live {
        // A dumb terminal cannot move its cursor and would print line after line.
        let dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        let on = wanted && std::io::stderr().is_terminal() && !dumb;
        let now = Stopwatch::start();
        Live { on, drawn: false, last: now, since: now, progress_line: ProgressLine::default() }
    }
    /// Redraws the line if it is due.
    pub fn show<D: Into<Drawing>>(&mut self, line: impl FnOnce() -> D) {
        if self.on && (!self.drawn || self.last.elapsed() >= Live::EVERY) {
            self.last = Stopwatch::start();
            self.drawn = true;
            // The last column stays empty, so that no terminal wraps the line.
            let width = width_of(std::io::stderr()).unwrap_or(80) - 1;
            let line = match line().into() {
                Drawing::Text(text) => fitting(text.split("  "), width),
                Drawing::Run(status) => self.progress_line.line(self.since.elapsed(), &status, width),
            };
            let _ = write!(std::io::stderr().lock(), "\r\x1b[2K{line}");
        }
    }
    /// Removes the line.
    pub fn clear(&mut self) {
        if std::mem::take(&mut self.drawn) {
            let _ = write!(std::io::stderr().lock(), "\r\x1b[2K");
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.clear();
    }
}

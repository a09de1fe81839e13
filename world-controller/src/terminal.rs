//! The one place that prints. Absent: what is printed.
//!
//! A reader that has gone away (a closed pipe) is no error of this program: what it does not want
//! to read is not written.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "this is the one place that prints")]

use std::io::{IsTerminal, Write};
use std::time::Duration;

use crate::gauge::{Gauge, Status};
use crate::stopwatch::Stopwatch;
use crate::wording::fitting;

/// Colours, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Paint {
    on: bool,
}

impl Paint {
    /// No colours.
    pub const PLAIN: Paint = Paint { on: false };

    /// Colours on a terminal, unless the user has asked for none (<https://no-color.org>).
    pub fn for_terminal(is_terminal: bool) -> Paint {
        let refused = std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty());
        Paint { on: is_terminal && !refused }
    }
    fn wrap(self, code: &str, text: &str) -> String {
        if self.on { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_owned() }
    }
    /// As it should be.
    pub fn good(self, text: &str) -> String {
        self.wrap("1;32", text)
    }
    /// Not as it should be.
    pub fn bad(self, text: &str) -> String {
        self.wrap("1;31", text)
    }
    /// A heading.
    pub fn strong(self, text: &str) -> String {
        self.wrap("1", text)
    }
}

/// Where text for people goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Standard output.
    Out,
    /// Standard error, when standard output is for a program.
    Err,
    /// Nowhere.
    Quiet,
}

impl Channel {
    /// Standard output, unless a program reads it.
    pub fn beside(taken: bool, quiet: bool) -> Channel {
        match (quiet, taken) {
            (true, _) => Channel::Quiet,
            (false, true) => Channel::Err,
            (false, false) => Channel::Out,
        }
    }
    /// The colours that suit the channel.
    pub fn paint(self) -> Paint {
        match self {
            Channel::Out => Paint::for_terminal(std::io::stdout().is_terminal()),
            Channel::Err => Paint::for_terminal(std::io::stderr().is_terminal()),
            Channel::Quiet => Paint::PLAIN,
        }
    }
    /// Prints text and ends the line if it has not ended.
    pub fn say(self, text: &str) {
        match self {
            Channel::Out => print_out(text),
            Channel::Err => complain(text),
            Channel::Quiet => {}
        }
    }
}

/// Writes to standard output.
pub fn print_out(text: &str) {
    let end = if text.ends_with('\n') { "" } else { "\n" };
    let mut out = std::io::stdout().lock();
    let _ = write!(out, "{text}{end}").and_then(|()| out.flush());
}

/// Writes to standard error.
pub fn complain(text: &str) {
    let end = if text.ends_with('\n') { "" } else { "\n" };
    let _ = write!(std::io::stderr().lock(), "{text}{end}");
}

/// What a line shows.
#[derive(Clone, Debug)]
pub enum Drawing {
    /// This text.
    Text(String),
    /// How far a run has come.
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

/// Columns of the terminal that standard error goes to.
fn columns() -> usize {
    let size = rustix::termios::tcgetwinsize(std::io::stderr()).ok();
    // A terminal that does not know says 0.
    size.map(|size| usize::from(size.ws_col)).filter(|columns| *columns > 0).unwrap_or(80)
}

/// One line on standard error that is written over again and again; only on a terminal.
pub struct Live {
    on: bool,
    drawn: bool,
    last: Stopwatch,
    since: Stopwatch,
    gauge: Gauge,
}

impl Live {
    /// Between two drawings.
    const EVERY: Duration = Duration::from_millis(100);

    /// A line, if anybody can watch it.
    pub fn new(wanted: bool) -> Live {
        // What cannot move its cursor would get one line after the other.
        let dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        let on = wanted && std::io::stderr().is_terminal() && !dumb;
        let now = Stopwatch::start();
        Live { on, drawn: false, last: now, since: now, gauge: Gauge::default() }
    }
    /// Draws the line if it is time to.
    pub fn show<D: Into<Drawing>>(&mut self, line: impl FnOnce() -> D) {
        if self.on && (!self.drawn || self.last.elapsed() >= Live::EVERY) {
            self.last = Stopwatch::start();
            self.drawn = true;
            // The last column stays empty, so that no terminal begins a new line.
            let width = columns() - 1;
            let line = match line().into() {
                Drawing::Text(text) => fitting(text.split("  "), width),
                Drawing::Run(status) => self.gauge.line(self.since.elapsed(), &status, width),
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

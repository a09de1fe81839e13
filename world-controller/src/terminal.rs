//! The one place that prints. Absent: what is printed.
//!
//! A reader that has gone away (a closed pipe) is no error of this program: what it does not want
//! to read is not written.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "this is the one place that prints")]

use std::io::{IsTerminal, Write};
use std::time::Duration;

use crate::stopwatch::Stopwatch;

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

/// One line on standard error that is written over again and again; only on a terminal.
pub struct Live {
    on: bool,
    drawn: bool,
    last: Stopwatch,
}

impl Live {
    /// Between two drawings.
    const EVERY: Duration = Duration::from_millis(100);

    /// A line, if anybody can watch it.
    pub fn new(wanted: bool) -> Live {
        Live { on: wanted && std::io::stderr().is_terminal(), drawn: false, last: Stopwatch::start() }
    }
    /// Draws the line if it is time to.
    pub fn show(&mut self, line: impl FnOnce() -> String) {
        if self.on && (!self.drawn || self.last.elapsed() >= Live::EVERY) {
            self.last = Stopwatch::start();
            self.drawn = true;
            let _ = write!(std::io::stderr().lock(), "\r\x1b[2K{}", line());
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

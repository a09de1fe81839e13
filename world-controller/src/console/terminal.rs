//! The one place that prints. Absent: what is printed.
//!
//! Text for people has no control characters in it but those of this module, wherever it came from. A
//! reader that has gone away (a closed pipe) is no error of this program: what it does not want to read
//! is not written, as with ripgrep and git. Any other failure of standard output is kept until the end
//! ([`failure`]), where it decides the exit code: a command has other things to finish first.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "this is the one place that prints")]

use crate::console::escape::escape;
use crate::console::progress::{Gauge, Status};
use crate::console::stopwatch::Stopwatch;
use std::io::{self, IsTerminal, Write};
use std::sync::OnceLock;
use std::time::Duration;

use crate::console::format::fitting;

/// Stand for the beginnings and the end of colours until text is printed: characters that mean nothing
/// in any text, so that no colour can come from outside.
const MARKS: [(char, &str); 4] =
    [(GOOD, "\x1b[1;32m"), (BAD, "\x1b[1;31m"), (STRONG, "\x1b[1m"), (PLAIN, "\x1b[0m")];
const GOOD: char = '\u{fdd0}';
const BAD: char = '\u{fdd1}';
const STRONG: char = '\u{fdd2}';
const PLAIN: char = '\u{fdd3}';

/// Why standard output could not be written, the first time that it could not.
static FAILURE: OnceLock<String> = OnceLock::new();

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
    fn wrap(self, mark: char, text: &str) -> String {
        if self.on { format!("{mark}{text}{PLAIN}") } else { text.to_owned() }
    }
    /// The text as it is printed: harmless, with its colours and the end of its last line.
    fn finish(self, text: &str) -> String {
        let is_mark = |c: char| self.on && MARKS.iter().any(|(mark, _)| *mark == c);
        let mut text = escape(text, |c| matches!(c, '\n' | '\t') || is_mark(c)).into_owned();
        if self.on {
            text = MARKS.iter().fold(text, |text, (mark, code)| text.replace(*mark, code));
        }
        if !text.ends_with('\n') {
            text.push('\n');
        }
        text
    }
    /// As it should be.
    pub fn good(self, text: &str) -> String {
        self.wrap(GOOD, text)
    }
    /// Not as it should be.
    pub fn bad(self, text: &str) -> String {
        self.wrap(BAD, text)
    }
    /// A heading.
    pub fn strong(self, text: &str) -> String {
        self.wrap(STRONG, text)
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

/// Prints text for people on standard output.
pub fn print_out(text: &str) {
    let paint = Channel::Out.paint();
    write_out(paint.finish(text).as_bytes());
}

/// Prints what a program reads on standard output, as it is but for the end of its last line.
pub fn print_data(data: &str) {
    let end = if data.ends_with('\n') { "" } else { "\n" };
    write_out(format!("{data}{end}").as_bytes());
}

fn write_out(bytes: &[u8]) {
    let mut out = std::io::stdout().lock();
    note(out.write_all(bytes).and_then(|()| out.flush()));
}

/// Notes what came of writing to standard output.
pub fn note(written: io::Result<()>) {
    match written {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            // The first failure is the one to tell.
            let _ = FAILURE.set(error.to_string());
        }
        _ => {}
    }
}

/// Why standard output could not be written, if it could not.
pub fn failure() -> Option<&'static str> {
    FAILURE.get().map(String::as_str)
}

/// Prints text for people on standard error.
pub fn complain(text: &str) {
    // There is nowhere left to say that this failed.
    let _ = std::io::stderr().lock().write_all(Channel::Err.paint().finish(text).as_bytes());
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_our_colours_reach_a_terminal() {
        let on = Paint { on: true };
        let hostile = "a\x1b[2Jb\u{9b}31mc\u{202e}d\n";
        let escaped = "a\\u{1b}[2Jb\\u{9b}31mc\\u{202e}d\n";
        for paint in [on, Paint::PLAIN] {
            assert_eq!(paint.finish(hostile), escaped);
        }
        assert_eq!(on.finish(&on.good("built")), "\x1b[1;32mbuilt\x1b[0m\n");
        assert_eq!(Paint::PLAIN.finish(&Paint::PLAIN.bad("no")), "no\n");
        assert_eq!(Paint::PLAIN.finish("a\u{fdd0}b"), "a\\u{fdd0}b\n");
    }
}

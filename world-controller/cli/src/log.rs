//! The log on standard error: which of its lines are shown, and how many a second about connections, since anyone who reaches a
//! daemon's address can cause those.

use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{has_color, print_error};
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::Shown;
use std::ffi::OsStr;
use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use thiserror::Error;
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, Targets, dynamic_filter_fn};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{fmt, registry};

/// Name of the environment variable with filters.
const VARIABLE: &str = "METAMORPH_LOG";

/// Largest number of lines about connections in a second: who floods a host must not fill its log as well.
const LINES_MAX: u32 = 50;
/// Time in which lines are counted.
const SECOND: Duration = Duration::from_secs(1);

/// A filter cannot be read.
#[derive(Debug, PartialEq, Eq, Error)]
#[error(
    "{VARIABLE}: `{0}` is no filter\n  fix: say a level (off, error, warn, info, debug or trace) or TARGET=LEVEL, such as \
     `metamorph_processes=debug`, with commas between several"
)]
pub struct WrongFilter(String);

impl CommandError for WrongFilter {
    fn exit_code(&self) -> u8 {
        BAD_USAGE
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// Begins the log, with the filters of the environment, or else with a level for each `-v`.
///
/// # Errors
/// A filter of the environment cannot be read.
pub fn to_stderr(verbose: u8) -> Result<(), WrongFilter> {
    let targets = match std::env::var_os(VARIABLE) {
        Some(filters) => read(&filters)?,
        None => default(verbose),
    };
    let ansi = has_color(std::io::stderr().is_terminal());
    let flood = Mutex::new(Flood::default());
    let lines = fmt::layer().with_writer(std::io::stderr).with_ansi(ansi);
    let lines = lines.with_filter(dynamic_filter_fn(move |line, _| {
        if !is_of_connections(line.target()) {
            return true;
        }
        let (is_shown, left_out) = flood.lock().unwrap_or_else(PoisonError::into_inner).next();
        if left_out > 0 {
            print_error(&format!("{left_out} further lines about connections were left out"));
        }
        is_shown
    }));
    // Fails only if a subscriber is already installed.
    let _ = registry().with(lines).with(targets).try_init();
    Ok(())
}

/// The modules whose lines are about connections and what arrives on them.
const OF_CONNECTIONS: [&str; 4] =
    ["::hosts::gate", "::hosts::net::door", "::hosts::net::session", "::hosts::node"];

/// True if a line is about a connection, or about what has arrived on one.
fn is_of_connections(target: &str) -> bool {
    target.starts_with("zenoh") || OF_CONNECTIONS.iter().any(|module| target.ends_with(module))
}

/// The lines about connections in the present second.
#[derive(Debug, Default)]
struct Flood {
    second: Option<Stopwatch>,
    lines: u32,
}

impl Flood {
    /// Counts a line. Returns true if it is shown, and how many were left out in a second that is over.
    fn next(&mut self) -> (bool, u32) {
        let mut left_out = 0;
        if self.second.is_none_or(|second| second.elapsed() >= SECOND) {
            left_out = self.lines.saturating_sub(LINES_MAX);
            (self.second, self.lines) = (Some(Stopwatch::start()), 0);
        }
        self.lines = self.lines.saturating_add(1);
        (self.lines <= LINES_MAX, left_out)
    }
}

/// Returns the filters without any of the environment. zenoh reports as errors the usual end of a session; of interest is
/// whom its TLS refuses.
fn default(verbose: u8) -> Targets {
    let level = match verbose {
        0 => LevelFilter::WARN,
        1 => LevelFilter::INFO,
        2 => LevelFilter::DEBUG,
        _ => LevelFilter::TRACE,
    };
    Targets::new()
        .with_default(level)
        .with_target("zenoh", LevelFilter::OFF)
        .with_target("zenoh_link_tls", LevelFilter::WARN)
}

fn read(filters: &OsStr) -> Result<Targets, WrongFilter> {
    let wrong = |filter: &str| WrongFilter(filter.shown());
    let filters = filters.to_str().ok_or_else(|| wrong(&filters.to_string_lossy()))?;
    // Without any filter, errors are shown.
    let mut targets = Targets::new();
    if filters.trim().is_empty() {
        targets = targets.with_default(LevelFilter::ERROR);
    }
    for filter in filters.split(',').map(str::trim).filter(|filter| !filter.is_empty()) {
        let (target, level) = match filter.split_once('=') {
            Some((target, level)) => (Some(target), level),
            None => (None, filter),
        };
        let is_target = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | ':');
        if level.is_empty()
            || target.is_some_and(|target| target.is_empty() || !target.chars().all(is_target))
        {
            return Err(wrong(filter));
        }
        let level: LevelFilter = level.parse().map_err(|_| wrong(filter))?;
        targets = match target {
            Some(target) => targets.with_target(target, level),
            None => targets.with_default(level),
        };
    }
    Ok(targets)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(filters: &str, target: &str) -> LevelFilter {
        use tracing::Level;
        let targets = read(filters.as_ref()).unwrap();
        let levels = [Level::TRACE, Level::DEBUG, Level::INFO, Level::WARN, Level::ERROR];
        let most = levels.into_iter().find(|level| targets.would_enable(target, level));
        most.map_or(LevelFilter::OFF, LevelFilter::from_level)
    }

    #[test]
    fn filters_are_levels_and_levels_of_targets() {
        assert_eq!(shown("debug", "anything"), LevelFilter::DEBUG);
        assert_eq!(shown("zenoh=trace", "zenoh::net"), LevelFilter::TRACE);
        assert_eq!(shown("zenoh=trace", "metamorph"), LevelFilter::OFF);
        assert_eq!(shown(" INFO, a::b=4,a=off,", "a::b::c"), LevelFilter::DEBUG);
        assert_eq!(shown(" INFO, a::b=4,a=off,", "a::c"), LevelFilter::OFF);
        assert_eq!(shown("INFO,a=off", "b"), LevelFilter::INFO);
        assert_eq!(shown("", "b"), LevelFilter::ERROR);
    }

    #[test]
    fn lines_about_connections_are_limited_and_counted() {
        let mut flood = Flood::default();
        let shown = (0..1_000).filter(|_| flood.next().0).count();
        assert!(shown >= LINES_MAX as usize);
        // In a second that is over all lines are known.
        let mut flood = Flood { second: None, lines: LINES_MAX + 7 };
        assert_eq!((flood.next(), flood.next()), ((true, 7), (true, 0)));
        assert!(is_of_connections("zenoh_link_tls::unicast") && !is_of_connections("metamorph_cli::host"));
        assert!(is_of_connections("metamorph_processes::swarm::hosts::node"));
    }

    #[test]
    fn a_wrong_filter_is_named() {
        for wrong in ["inof", "a=", "=debug", "a=b=debug", "a[b]=debug", "a b=debug", "6"] {
            assert_eq!(read(format!("warn,{wrong}").as_ref()).unwrap_err(), WrongFilter(wrong.to_owned()));
        }
        let text = WrongFilter("inof".to_owned()).text();
        assert!(text.starts_with("metamorph: METAMORPH_LOG: `inof` is no filter\n  fix: "), "{text}");
    }

    #[test]
    fn more_is_shown_for_each_v_but_nothing_of_zenoh() {
        for (verbose, level) in
            [(0, tracing::Level::WARN), (1, tracing::Level::INFO), (9, tracing::Level::TRACE)]
        {
            assert!(default(verbose).would_enable("metamorph", &level));
            assert!(!default(verbose).would_enable("zenoh", &tracing::Level::ERROR));
            assert!(default(verbose).would_enable("zenoh_link_tls", &tracing::Level::WARN));
        }
        assert!(!default(0).would_enable("metamorph", &tracing::Level::INFO));
    }
}

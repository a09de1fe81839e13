//! The progress line of a run: bar, filled goal cells, live agents, messages per second, estimated time left.
//! A pure function of observations and their times. Absent: clocks, and the terminal .

use crate::format::{count, fitting, many, seconds};
use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

/// The progress of a run at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// Scenario time, in seconds.
    pub now_s: f64,
    /// The number of the current goal, from 1, and the number of goals.
    pub stage: (u16, u16),
    /// Filled parts of the current goal.
    pub filled: u64,
    /// Parts of the current goal.
    pub goal: u64,
    /// Name of the parts, in the plural.
    pub parts: &'static str,
    /// Live processes or agents.
    pub alive: u64,
    /// Moves completed.
    pub moves: u64,
    /// Messages sent, if known during the run.
    pub messages: Option<u64>,
    /// The speed of the clock relative to the scenario's speed.
    pub speed: f64,
}

/// Formats what is known without earlier observations.
impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Status { filled, goal, parts, alive, moves, now_s, .. } = self;
        write!(
            f,
            "{} of {} {parts}  {} alive  {}  {} in the scenario",
            count(*filled),
            count(*goal),
            count(*alive),
            many(*moves, "move"),
            seconds(*now_s)
        )
    }
}

/// Rates are computed over this time.
const MEMORY: Duration = Duration::from_secs(10);
/// No estimate is shown before this much time was observed.
const LEARNING: Duration = Duration::from_secs(1);
/// Relative clock speed below which the line says that the clock is slowed.
const UNSLOWED: f64 = 0.95;
/// Width of the bar in characters.
const BAR: u64 = 10;

/// Formats progress lines. Keeps recent observations to compute rates from.
#[derive(Clone, Debug, Default)]
pub struct ProgressLine {
    stage: (u16, u16),
    /// Time, filled parts of the goal, messages sent.
    seen: VecDeque<(Duration, u64, u64)>,
}

impl ProgressLine {
    /// Returns the line for an observation, at most `width` columns: the most important parts first, none cut
    /// in the middle. `at` is real time since any fixed start.
    pub fn line(&mut self, at: Duration, status: &Status, width: usize) -> String {
        if self.stage != status.stage {
            // Another goal has other cells: forget the observations.
            (self.stage, self.seen) = (status.stage, VecDeque::new());
        }
        self.seen.push_back((at, status.filled, status.messages.unwrap_or(0)));
        // Keep the last observation before the window, so that the window is covered.
        while self.seen.get(1).is_some_and(|(second, ..)| at.saturating_sub(*second) >= MEMORY) {
            self.seen.pop_front();
        }
        let (since, filled, messages) = self.seen[0];
        let span = at.saturating_sub(since).as_secs_f64();
        let rate =
            |now: u64, then: u64| if span > 0.0 { now.saturating_sub(then) as f64 / span } else { 0.0 };
        let share = |of: u64| status.filled.min(status.goal) * of / status.goal.max(1);
        let full = share(BAR) as usize;
        let mut parts =
            vec![format!("[{:·<width$}] {:>3}%", "#".repeat(full), share(100), width = BAR as usize)];
        if status.stage.1 > 1 {
            parts.push(format!("goal {} of {}", status.stage.0, status.stage.1));
        }
        parts.push(format!("{} of {} {}", count(status.filled), count(status.goal), status.parts));
        parts.push(format!("{} alive", count(status.alive)));
        if status.speed < UNSLOWED {
            parts.push(format!("slowed to {:.0}%", (status.speed * 100.0).max(1.0)));
        }
        let filling = rate(status.filled, filled);
        // The field stays while nothing is known, so that those behind it do not jump.
        let missing = status.goal.saturating_sub(status.filled);
        let left = match missing {
            0 => Some(0.0),
            _ if span < LEARNING.as_secs_f64() || filling == 0.0 => None,
            _ => Some(missing as f64 / filling),
        };
        parts.push(format!("{} left", left.map_or("?".to_owned(), seconds)));
        parts.push(format!("at {}", seconds(status.now_s)));
        parts.push(many(status.moves, "move"));
        if let Some(now) = status.messages {
            parts.push(format!("{} messages/s", count(rate(now, messages) as u64)));
        }
        fitting(parts.iter().map(String::as_str), width)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(filled: u64, messages: Option<u64>) -> Status {
        Status {
            now_s: 12.5,
            stage: (1, 1),
            filled,
            goal: 400,
            parts: "cells",
            alive: 1_000,
            moves: 77,
            messages,
            speed: 1.0,
        }
    }

    #[test]
    fn a_slowed_clock_is_said() {
        let mut progress_line = ProgressLine::default();
        let mut line = |speed| progress_line.line(Duration::ZERO, &Status { speed, ..status(0, None) }, 200);
        assert!(!line(1.0).contains("slowed") && !line(0.96).contains("slowed"));
        assert!(line(0.4).contains("slowed to 40%") && line(0.001).contains("slowed to 1%"));
    }

    #[test]
    fn rates_and_the_time_left_come_from_what_was_seen_lately() {
        let (mut progress_line, at) = (ProgressLine::default(), Duration::from_secs);
        let first = progress_line.line(at(0), &status(0, Some(0)), 200);
        assert!(first.starts_with("[··········]   0%  0 of 400 cells  1,000 alive"), "{first}");
        assert!(first.contains("? left"), "{first}");
        for second in 1..30 {
            progress_line.line(at(second), &status(100, Some(second * 1_000)), 200);
        }
        // Nothing was filled for ten seconds: no estimate.
        let still = progress_line.line(at(30), &status(100, Some(30_000)), 200);
        assert!(still.contains("1,000 messages/s") && still.contains("? left"), "{still}");
        let line = progress_line.line(at(31), &status(200, Some(41_000)), 200);
        assert!(line.starts_with("[#####·····]  50%  200 of 400 cells"), "{line}");
        assert!(line.contains("20.0 s left  at 12.5 s  77 moves  2,000 messages/s"), "{line}");
        assert!(progress_line.seen.len() <= 12);
    }

    #[test]
    fn a_line_fits_and_says_only_what_is_known() {
        let mut progress_line = ProgressLine::default();
        let line =
            progress_line.line(Duration::ZERO, &Status { stage: (2, 3), goal: 0, ..status(0, None) }, 60);
        assert!(line.contains("0%  goal 2 of 3") && !line.contains("messages"), "{line}");
        assert!(line.chars().count() <= 60 && line.ends_with("alive"), "{line}");
        let full = progress_line.line(Duration::from_secs(9), &status(400, None), 300);
        assert!(full.starts_with("[##########] 100%  400 of 400") && full.contains("0 s left"), "{full}");
    }

    /// The widest line: most modules, most goals, longest times.
    #[test]
    fn the_widest_line_fits_a_terminal_of_80_columns() {
        let widest = |filled, messages| Status {
            now_s: 999_999.9,
            stage: (15, 16),
            filled,
            goal: 1_000_000,
            parts: "cells",
            alive: 1_000_000,
            moves: 999_999_999,
            messages: Some(messages),
            speed: 0.014,
        };
        let mut progress_line = ProgressLine::default();
        progress_line.line(Duration::ZERO, &widest(999_998, 0), 79);
        let line = progress_line.line(Duration::from_secs(9), &widest(999_999, 999_999_999_999), 79);
        assert!(line.chars().count() <= 79, "{line}");
        assert!(line.contains("goal 15 of 16  999,999 of 1,000,000 cells  1,000,000 alive"), "{line}");
        assert!(!line.contains("message"), "what does not fit is left out whole: {line}");
    }
}

//! Lateness of an agent: how long its inputs waited, and how long after the due time it woke up, in scenario
//! time. An agent reports lateness above half of what the run tolerates to its controller, which may then let
//! scenario time pass more slowly. Not here: how the controller reacts.

use metamorph_protocol::time::{Span, Time};

/// The shortest real time between two lateness reports of one agent, in nanoseconds, in a swarm of up to 100
/// modules. In larger swarms it is multiplied by the number of hundreds, which bounds the rate of all
/// reports.
const EVERY: u64 = 25_000_000;

/// An input or a wake-up that was taken late.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Late {
    /// The scenario time at which the input was sent, or the wake-up was due.
    pub since: Time,
    /// The scenario time from then until it was taken.
    pub by: Span,
}

impl Late {
    /// Returns the one of the two that was taken with the longer delay.
    pub fn worse(self, other: Option<Late>) -> Late {
        other.filter(|o| o.by > self.by).unwrap_or(self)
    }
}

/// Holds the worst lateness until it may be reported.
#[derive(Debug)]
pub struct Lateness {
    least: Span,
    every: u64,
    worst: Option<Late>,
    reported: u64,
}

impl Lateness {
    /// Creates the record of an agent in a swarm of `count`. Lateness above half of `tolerance` is reported.
    pub fn new(tolerance: Span, count: u32) -> Lateness {
        let every = EVERY * u64::from(count.div_ceil(100)).max(1);
        Lateness { least: tolerance / 2, every, worst: None, reported: 0 }
    }

    /// Notes that an input that has waited since `since` is taken at `now`.
    pub fn taken(&mut self, since: Time, now: Time) {
        let by = now.since(since);
        if by > self.least {
            self.worst = Some(Late { since, by }.worse(self.worst));
        }
    }

    /// Takes the worst lateness noted since the last report, if a report is allowed at `monotonic`.
    pub fn report(&mut self, monotonic: u64) -> Option<Late> {
        let due = self.worst.is_some() && monotonic.saturating_sub(self.reported) >= self.every;
        if due {
            self.reported = monotonic;
            self.worst.take()
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_is_reported_now_and_then() {
        let mut lateness = Lateness::new(Span(100), 200);
        lateness.taken(Time(10), Time(60));
        assert_eq!(lateness.report(1 << 40), None, "half of what is tolerated is not late");
        for (since, now) in [(0, 70), (100, 300), (200, 310)] {
            lateness.taken(Time(since), Time(now));
        }
        // A time in the future is no lateness; it comes only from foreign frames, as all clocks agree.
        lateness.taken(Time(900), Time(310));
        assert_eq!(lateness.report(1 << 40), Some(Late { since: Time(100), by: Span(200) }));
        lateness.taken(Time(400), Time(600));
        assert_eq!(lateness.report((1 << 40) + 2 * EVERY - 1), None);
        assert_eq!(lateness.report((1 << 40) + 2 * EVERY), Some(Late { since: Time(400), by: Span(200) }));
    }
}

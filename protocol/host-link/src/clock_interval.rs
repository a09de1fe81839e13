//! How far the clock of the other end is ahead: an interval that is sure to hold the difference, not an estimate.
//!
//! An exchange of two clock stamps bounds the difference whatever time the two ways take (Cristian, 1989): a stamp `a1` of
//! this end is heard by the other at `b1`, whose stamp `b2` is heard here at `a2`; then the difference is at least
//! `b2 − a2` and at most `b1 − a1`. Intervals of several exchanges are intersected, each widened by what the clocks may
//! have drifted apart since `a1`: the other end's stamps are from an unknown time after it.

use metamorph_core::time::Time;
use std::collections::VecDeque;

/// The number of exchanges kept.
const KEPT: usize = 64;
/// The most that two clocks drift apart, in millionths of the time that passes.
const DRIFT: u64 = 600;

/// An interval of clock differences in nanoseconds: how far the other clock is ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ClockInterval {
    /// The smallest possible difference.
    pub low: i64,
    /// The largest possible difference.
    pub high: i64,
}

impl ClockInterval {
    /// Returns the middle of the interval.
    pub const fn middle(self) -> i64 {
        self.low.midpoint(self.high)
    }

    /// Returns half the width of the interval, rounded up: the largest error of its middle.
    pub const fn error(self) -> u64 {
        self.high.abs_diff(self.low).div_ceil(2)
    }

    const fn is_empty(self) -> bool {
        self.low > self.high
    }

    /// Returns the interval after `age` nanoseconds.
    fn widened(self, age: u64) -> ClockInterval {
        let drift = i64::try_from(age / 1_000_000 * DRIFT + age % 1_000_000 * DRIFT / 1_000_000 + 1);
        let drift = drift.unwrap_or(i64::MAX);
        ClockInterval { low: self.low.saturating_sub(drift), high: self.high.saturating_add(drift) }
    }
}

/// The latest exchanges, each with its first stamp.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct ClockExchanges {
    kept: VecDeque<(Time, ClockInterval)>,
}

impl ClockExchanges {
    /// Takes one exchange: the stamp `sent` of this end was heard by the other end at `heard` of its clock; the other
    /// end's stamp `answered` has been received at `now`.
    pub fn add(&mut self, sent: Time, heard: Time, answered: Time, now: Time) {
        let difference = |theirs: Time, ours: Time| theirs.0.wrapping_sub(ours.0).cast_signed();
        let interval = ClockInterval { low: difference(answered, now), high: difference(heard, sent) };
        // Stamps that contradict each other by more than the drift are not from one pair of clocks.
        if interval.widened(now.since(sent).0).is_empty() {
            return;
        }
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back((sent, interval));
    }

    /// Returns the interval at `now`; `None` before the first exchange, and if the exchanges contradict each other
    /// because a clock has jumped.
    pub fn interval(&self, now: Time) -> Option<ClockInterval> {
        let widened = self.kept.iter().map(|(sent, interval)| interval.widened(now.since(*sent).0));
        let both = |a: ClockInterval, b: ClockInterval| ClockInterval {
            low: a.low.max(b.low),
            high: a.high.min(b.high),
        };
        widened.reduce(both).filter(|i| !i.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::rng::Rng;

    /// Clocks that differ and drift, and ways of different length: the interval holds the difference at all times.
    #[test]
    fn the_interval_holds_the_difference() {
        let mut rng = Rng::named(1, "clock", 0);
        for _ in 0..200 {
            let (ahead, rate) =
                (rng.below(1_000_000_000) as i64 - 500_000_000, rng.below(1_001) as i64 - 500);
            let theirs = |at: u64| (1 << 40) + at as i64 + at as i64 * rate / 1_000_000 + ahead;
            let mut exchanges = ClockExchanges::default();
            let mut now = 1u64;
            for _ in 0..200 {
                let a1 = now;
                let b1 = a1 + 1 + rng.below(5_000_000);
                let b2 = b1 + rng.below(250_000_000);
                let longest = if rng.below(10) == 0 { 500_000_000 } else { 1_000_000 };
                let a2 = b2 + 1 + rng.below(longest);
                let at = |t: u64| Time(theirs(t) as u64);
                exchanges.add(Time((1 << 40) + a1), at(b1), at(b2), Time((1 << 40) + a2));
                now = a2 + rng.below(250_000_000);
                let truth = theirs(now) - ((1 << 40) + now) as i64;
                let found = exchanges.interval(Time((1 << 40) + now)).expect("the clocks do not jump");
                assert!((found.low..=found.high).contains(&truth), "{truth} {found:?}");
                assert!(found.middle().abs_diff(truth) <= found.error());
            }
        }
    }

    #[test]
    fn stamps_that_contradict_each_other_are_not_used() {
        let mut exchanges = ClockExchanges::default();
        exchanges.add(Time(10), Time(5), Time(100), Time(20));
        assert_eq!(exchanges.interval(Time(20)), None);
        exchanges.add(Time(10), Time(15), Time(15), Time(20));
        assert_eq!(exchanges.interval(Time(20)), Some(ClockInterval { low: -6, high: 6 }));
        exchanges.add(Time(30), Time(1_035), Time(1_035), Time(40));
        assert_eq!(exchanges.interval(Time(40)), None);
    }
}

//! The speed of scenario time: the one that the scenario asks for, unless the machine is too busy for its
//! agents to keep up.
//!
//! The controller promises scenario time to all agents in short slices (the clock page), and before each
//! slice looks at its own lateness and that of the agents. Lateness counts in scenario time: 20 ms are
//! negligible for a move of a second, and too much for a move of 20 ms. While it exceeds the tolerance of the
//! run, time passes more slowly, in proportion; without lateness, it slowly speeds up again. Messages sent
//! and wake-ups due before time was last slowed say nothing about the new speed and are not judged.
//!
//! A host far away hears of a slice late, so slices are longer than that delay: the next one arrives before the one before ends.
//!
//! An agent that is stopped or hangs takes no input, so it is not late and does not slow the run. A
//! controller that is late itself promises no time, which stands still until the controller continues.

use metamorph_module_agent::clock::lateness::Late;
use metamorph_module_agent::clock::page::Page;
use metamorph_module_agent::clock::source::ClockSource;
use metamorph_module_agent::clock::{Speed, wait};
use metamorph_protocol::time::{Span, Time};
use metamorph_report::Slowed;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Shortest length of one slice of promised time (ns of real time).
const SLICE: u64 = 25_000_000;
/// Longest length of one slice (ns of real time), for hosts far away.
const SLICE_MAX: u64 = 1_000_000_000;
/// Time by which a slice is longer than one and a half times the delay (ns of real time).
const SLICE_SPARE: u64 = 10_000_000;
/// The number that stands for full speed; lower speeds are given in parts of it.
pub const FULL: u32 = 1_000_000;
/// The lowest speed that lateness can cause: a thousandth.
const LEAST: u32 = FULL / 1_000;
/// Largest factor by which the speed falls from one slice to the next.
const STEEPEST: u64 = 4;
/// Inverse of the relative increase of speed in a slice in which no agent is late: twice as fast after half a
/// second.
const RECOVERY: u32 = 30;

/// The controller's end of the clock.
#[derive(Debug)]
pub struct Pace<C> {
    source: C,
    page: Page,
    full: Speed,
    tolerance: Span,
    /// The present speed, in parts of [`FULL`]; for display.
    share: Arc<AtomicU32>,
    /// When time was last slowed.
    slowed_at: Time,
    /// The worst lateness since the last slice.
    worst: Option<Late>,
    /// When the first slice was promised, and the scenario time then.
    begun: Option<(u64, Time)>,
    /// Real time at less than full speed (ns).
    below: u64,
    /// The lowest speed of a slice that has begun, in parts of [`FULL`].
    lowest: u32,
    /// The speed of the slice promised last, in parts of [`FULL`], and its length (ns of real time).
    promised: (u32, u64),
    /// Length of the slices to come (ns of real time).
    slice: u64,
}

impl<C: ClockSource> Pace<C> {
    /// Creates the pace of a clock that is new, or left by another controller: it stands still.
    ///
    /// # Errors
    /// If the clock page cannot be read or written.
    pub fn new(source: C, full: Speed, tolerance: Span, share: Arc<AtomicU32>) -> io::Result<Pace<C>> {
        let page = source.read_page()?;
        share.store(FULL, Ordering::Relaxed);
        Ok(Pace {
            source,
            page,
            full,
            tolerance,
            share,
            slowed_at: Time::ZERO,
            worst: None,
            begun: None,
            below: 0,
            lowest: FULL,
            promised: (FULL, SLICE),
            slice: SLICE,
        })
    }

    /// Returns the real time in nanoseconds.
    pub fn monotonic(&self) -> u64 {
        self.source.monotonic()
    }

    /// Returns the scenario time now.
    pub fn now(&self) -> Time {
        self.page.at(self.monotonic())
    }

    /// Returns how long to wait, in real time, before the next look at the clock, in order not to miss `time`
    /// or the instant at which the next slice has to be promised.
    pub fn until(&self, time: Time) -> Duration {
        let monotonic = self.monotonic();
        let renewal = Duration::from_nanos(self.page.renewal().saturating_sub(monotonic));
        wait(&self.page, self.full, monotonic, time).min(renewal)
    }

    /// Makes slices long enough for hosts that hear of them after at most `delay` nanoseconds: with half of that to spare.
    pub fn stretch(&mut self, delay: u64) {
        self.slice = delay.saturating_add(delay / 2 + SLICE_SPARE).clamp(SLICE, SLICE_MAX);
    }

    /// Notes an input or a wake-up that was late.
    pub fn late(&mut self, late: Late) {
        if late.since >= self.slowed_at {
            self.worst = Some(late.worse(self.worst));
        }
    }

    /// Returns true if another slice is due.
    pub fn is_due(&self) -> bool {
        self.page.renewal() <= self.monotonic()
    }

    /// Promises another slice if one is due. The first call starts time.
    ///
    /// # Errors
    /// If the clock page cannot be written.
    pub fn renew(&mut self) -> io::Result<()> {
        let monotonic = self.monotonic();
        if self.page.renewal() > monotonic {
            return Ok(());
        }
        while self.page.renewal() <= monotonic {
            self.extend(monotonic);
        }
        self.source.write_page(&self.page)
    }

    fn extend(&mut self, monotonic: u64) {
        let share = self.share();
        // Time stood still from the end of the last slice.
        let lapsed = self.begun.map_or(0, |_| monotonic.saturating_sub(self.page.until()));
        // The slice that was promised last begins now.
        let (before, length) = self.promised;
        self.below += lapsed + if before < FULL { length } else { 0 };
        self.lowest = self.lowest.min(before);
        self.promised = (share, self.slice);
        self.begun.get_or_insert((monotonic, self.page.at(monotonic)));
        let speed = if share == FULL { self.full } else { self.full.scaled(share, FULL) };
        self.page = self.page.extended(monotonic, self.slice, speed);
    }

    /// Decides the speed of the next slice, in parts of [`FULL`], from the worst lateness since the last
    /// slice.
    fn share(&mut self) -> u32 {
        let share = self.share.load(Ordering::Relaxed);
        let next = match self.worst.take() {
            Some(late) if late.by > self.tolerance => {
                self.slowed_at = self.page.at(self.page.until());
                let fitting = u128::from(share) * u128::from(self.tolerance.0) / u128::from(late.by.0);
                (fitting as u32).max(share / STEEPEST as u32).max(LEAST)
            }
            Some(late) if late.by > self.tolerance / 2 => share,
            _ => (share + share.div_ceil(RECOVERY)).min(FULL),
        };
        self.share.store(next, Ordering::Relaxed);
        next
    }

    /// Returns how much, and for how long, the clock has been slowed so far.
    pub fn slowed(&self) -> Slowed {
        let Some((begun, time)) = self.begun else { return Slowed::default() };
        let monotonic = self.monotonic();
        let possible = self.full.scenario(monotonic.saturating_sub(begun));
        let passed = self.page.at(monotonic).since(time).0;
        let factor = if possible == 0 { 1.0 } else { (passed as f64 / possible as f64).min(1.0) };
        let lowest = f64::from(self.lowest) / f64::from(FULL);
        Slowed { factor, lowest, time: Duration::from_nanos(self.below) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_module_agent::clock::source::{FileClock, MemoryClock};

    fn pace(tolerance: Span) -> Pace<MemoryClock> {
        Pace::new(MemoryClock::manual(), Speed::REAL, tolerance, Arc::default()).unwrap()
    }
    fn late(since: u64, by: u64) -> Late {
        Late { since: Time(since), by: Span(by) }
    }

    #[test]
    fn time_is_slowed_in_proportion_and_recovers() {
        let mut pace = pace(Span(100));
        assert_eq!(pace.share(), FULL);
        pace.late(late(0, 50));
        assert_eq!(pace.share(), FULL, "that much is tolerated");
        pace.late(late(0, 150));
        pace.late(late(0, 200));
        assert_eq!(pace.share(), FULL / 2, "the worst counts");
        pace.late(late(0, 75));
        assert_eq!(pace.share(), FULL / 2, "late by less than is tolerated, but only just");
        let slices = (0..).take_while(|_| pace.share() < FULL).count();
        assert!((15..30).contains(&slices), "{slices} slices to twice the speed");
    }

    #[test]
    fn one_that_hangs_does_not_stop_time() {
        let mut pace = pace(Span(100));
        for _ in 0..100 {
            pace.late(late(u64::MAX / 2, u64::MAX / 4));
            pace.slowed_at = Time::ZERO;
            assert!(pace.share() >= LEAST);
        }
        assert_eq!(pace.share(), LEAST + LEAST.div_ceil(RECOVERY));
    }

    #[test]
    fn what_was_sent_before_time_was_slowed_is_not_judged() {
        let mut pace = pace(Span(100));
        pace.renew().unwrap();
        pace.late(late(0, 200));
        assert_eq!(pace.share(), FULL / 2);
        assert!(pace.slowed_at > Time::ZERO);
        pace.late(late(0, 200));
        assert!(pace.share() > FULL / 2);
        pace.late(late(pace.slowed_at.0, 200));
        assert!(pace.share() < FULL / 2);
    }

    #[test]
    fn a_slowed_slice_counts_once_it_begins() {
        let mut pace = pace(Span(100));
        let clock = pace.source.clone();
        pace.renew().unwrap();
        pace.late(late(u64::MAX, 200));
        clock.advance(SLICE);
        pace.renew().unwrap();
        assert_eq!((pace.slowed().lowest, pace.slowed().time), (1.0, Duration::ZERO));
        clock.advance(SLICE);
        pace.renew().unwrap();
        assert_eq!((pace.slowed().lowest, pace.slowed().time), (0.5, Duration::from_nanos(SLICE)));
    }

    #[test]
    fn slices_are_longer_than_the_delay() {
        let mut pace = pace(Span(100));
        let lengths = [0, 5_000_000, 20_000_000, 150_000_000, u64::MAX].map(|delay| {
            pace.stretch(delay);
            pace.slice
        });
        assert_eq!(lengths, [SLICE, SLICE, 40_000_000, 235_000_000, SLICE_MAX]);
    }

    #[test]
    fn slices_are_promised_when_the_last_one_begins() {
        let mut pace = pace(Span(100));
        let clock = pace.source.clone();
        let promised = |pace: &Pace<MemoryClock>| pace.page.at(u64::MAX).0;
        pace.renew().unwrap();
        assert_eq!((pace.now(), promised(&pace)), (Time(0), SLICE * 2));
        clock.advance(SLICE - 1);
        pace.renew().unwrap();
        assert_eq!((pace.now(), promised(&pace)), (Time(SLICE - 1), SLICE * 2));
        clock.advance(1);
        pace.renew().unwrap();
        assert_eq!((pace.now(), promised(&pace)), (Time(SLICE), SLICE * 3));
        assert_eq!(clock.read_page().unwrap(), pace.page);
        // A controller that comes late finds that time has stood still.
        clock.advance(SLICE * 10);
        assert_eq!(pace.now(), Time(SLICE * 3));
        pace.renew().unwrap();
        assert_eq!(pace.now(), Time(SLICE * 3));
        assert_eq!(pace.slowed().time, Duration::from_nanos(SLICE * 8));
    }

    #[test]
    fn another_controller_goes_on_from_where_time_stood_still() {
        let dir = tempfile::tempdir().unwrap();
        let pace = |clock| Pace::new(clock, Speed::REAL, Span(100), Arc::default()).unwrap();
        let mut first = pace(FileClock::create(dir.path(), Time::ZERO).unwrap());
        assert_eq!(first.now(), Time::ZERO);
        first.renew().unwrap();
        let promised = first.page.at(u64::MAX);
        assert!(promised > Time::ZERO);
        drop(first);
        let mut next = pace(FileClock::open_writable(dir.path()).unwrap());
        assert_eq!(next.page.at(u64::MAX), promised);
        // Until the promised slice has begun.
        while next.page.at(u64::MAX) == promised {
            next.renew().unwrap();
            std::thread::yield_now();
        }
        assert!(next.page.at(u64::MAX) > promised);
    }
}

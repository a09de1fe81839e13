//! The clock of a run: scenario time, from a monotonic clock and the run's clock page ([`source`]).
//!
//! The controller decides how fast scenario time passes, between not at all and the speed of the scenario, so
//! that a busy machine slows the run down instead of making its agents late. Not here: calendar time, on
//! which no run may depend, and how the speed is chosen.

pub mod lateness;
pub mod page;
pub mod source;

use crate::clock::page::Page;
use crate::clock::source::ClockSource;
use metamorph_protocol::time::Time;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::io;
use std::time::Duration;
use thiserror::Error;

/// Limit on a wait, in real time, while scenario time passes below full speed: the speed may rise meanwhile.
const SLOW_WAIT: Duration = Duration::from_millis(50);
/// The shortest wait, in real time, after the clock page has run out and scenario time stands still.
const LAPSED_WAIT: Duration = Duration::from_millis(5);

/// The speed of scenario time relative to real time, as a ratio of integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "(u32, u32)", into = "(u32, u32)")]
pub struct Speed {
    num: u32,
    den: u32,
}

/// The denominator of a speed is zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("a speed of {0}/{1} is not possible; the second number must be above 0")]
pub struct SpeedError(u32, u32);

impl Speed {
    /// Scenario time is real time.
    pub const REAL: Speed = Speed { num: 1, den: 1 };
    /// Scenario time stands still.
    pub const STOPPED: Speed = Speed { num: 0, den: 1 };

    /// Returns the speed of `num / den` seconds of scenario time per second of real time.
    ///
    /// # Errors
    /// If `den` is zero.
    pub const fn new(num: u32, den: u32) -> Result<Speed, SpeedError> {
        if den == 0 { Err(SpeedError(num, den)) } else { Ok(Speed { num, den }) }
    }

    /// Returns this speed times `part / whole`, rounded down to a ratio of two 32-bit numbers.
    pub fn scaled(self, part: u32, whole: u32) -> Speed {
        let mut num = u64::from(self.num) * u64::from(part);
        let mut den = u64::from(self.den) * u64::from(whole);
        while num > u64::from(u32::MAX) || den > u64::from(u32::MAX) {
            num >>= 1;
            den = den.div_ceil(2);
        }
        Speed { num: num as u32, den: (den as u32).max(1) }
    }

    /// Returns the scenario time, in nanoseconds, that passes in `real` nanoseconds.
    pub fn scenario(self, real: u64) -> u64 {
        let scaled = u128::from(real) * u128::from(self.num) / u128::from(self.den);
        u64::try_from(scaled).unwrap_or(u64::MAX)
    }

    /// Returns the real time, in nanoseconds, in which at least `scenario` nanoseconds of scenario time pass.
    pub fn real(self, scenario: u64) -> u64 {
        if self.num == 0 {
            return if scenario == 0 { 0 } else { u64::MAX };
        }
        let real = (u128::from(scenario) * u128::from(self.den)).div_ceil(self.num.into());
        u64::try_from(real).unwrap_or(u64::MAX)
    }
}

impl TryFrom<(u32, u32)> for Speed {
    type Error = SpeedError;
    fn try_from((num, den): (u32, u32)) -> Result<Speed, SpeedError> {
        Speed::new(num, den)
    }
}
impl From<Speed> for (u32, u32) {
    fn from(speed: Speed) -> (u32, u32) {
        (speed.num, speed.den)
    }
}

/// Returns CLOCK_MONOTONIC in nanoseconds: the same for all processes of a machine.
pub fn monotonic() -> u64 {
    let t = clock_gettime(ClockId::Monotonic);
    // Invariant: this clock starts at zero at boot and never goes back.
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// Reads scenario time from a clock source. Keeps a copy of the clock page, and renews it when it has run
/// out.
#[derive(Debug)]
pub struct Clock<C> {
    source: C,
    page: Page,
    full: Speed,
}

impl<C: ClockSource> Clock<C> {
    /// Creates the clock of a run whose time passes with `full` speed at most.
    ///
    /// # Errors
    /// If the clock page cannot be read.
    pub fn new(source: C, full: Speed) -> io::Result<Clock<C>> {
        let page = source.read_page()?;
        Ok(Clock { source, page, full })
    }

    /// Returns the real time in nanoseconds.
    pub fn monotonic(&self) -> u64 {
        self.source.monotonic()
    }

    /// Returns the scenario time now.
    pub fn now(&mut self) -> Time {
        let monotonic = self.source.monotonic();
        self.refresh(monotonic);
        self.page.at(monotonic)
    }

    /// Returns how long to wait, in real time, before the next look at the clock, not to miss `time`.
    pub fn until(&mut self, time: Time) -> Duration {
        let monotonic = self.source.monotonic();
        self.refresh(monotonic);
        wait(&self.page, self.full, monotonic, time)
    }

    /// Reads the page if the copy does not cover this instant.
    fn refresh(&mut self, monotonic: u64) {
        if monotonic < self.page.until() {
            return;
        }
        match self.source.read_page() {
            Ok(page) => self.page = page,
            // Scenario time stands still for this process; the controller will miss it.
            Err(e) => tracing::debug!("the clock page cannot be read: {e}"),
        }
    }
}

/// Returns how long to wait from the instant `monotonic` on, in real time, before the next look at the clock,
/// in order not to miss `time`.
///
/// At full speed, this is the real time until `time`. At a lower speed, it is the real time until `time` at
/// that speed, but at most [`SLOW_WAIT`], since the speed may rise meanwhile; yet never less than at full
/// speed.
pub fn wait(page: &Page, full: Speed, monotonic: u64, time: Time) -> Duration {
    let left = time.since(page.at(monotonic)).0;
    let soonest = Duration::from_nanos(full.real(left));
    match page.speed_at(monotonic) {
        _ if left == 0 => Duration::ZERO,
        Some(speed) if speed == full => soonest,
        Some(speed) => Duration::from_nanos(speed.real(left)).min(SLOW_WAIT).max(soonest),
        None => LAPSED_WAIT.max(soonest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn scales_exactly() {
        let speed = |num, den| Speed::new(num, den).unwrap();
        assert_eq!(speed(1, 1).scenario(7), 7);
        assert_eq!(speed(10, 1).scenario(7), 70);
        assert_eq!(speed(1, 3).scenario(7), 2);
        assert_eq!(speed(u32::MAX, 1).scenario(u64::MAX), u64::MAX);
        assert_eq!(
            (Speed::STOPPED.scenario(7), Speed::STOPPED.real(7), Speed::STOPPED.real(0)),
            (0, u64::MAX, 0)
        );
        assert!(Speed::new(1, 0).is_err());
        assert_eq!(speed(3, 1).scaled(1, 2), speed(3, 2));
        assert_eq!(speed(u32::MAX, 1).scaled(1, 4), speed(u32::MAX, 4));
        assert_eq!(speed(3, 1).scaled(0, 4).scenario(u64::MAX), 0);
        // A result without an exact ratio is rounded to a slower speed.
        let odd = speed(u32::MAX, u32::MAX - 1).scaled(999_999, 1_000_000);
        assert!(odd.scenario(1 << 60) <= (1 << 60) && odd.scenario(1 << 60) > (1 << 60) / 1_000 * 998);
    }

    proptest! {
        /// After the wait at full speed the time has come, and not long before.
        #[test]
        fn waits_long_enough(now: u32, left: u32, num in 1u32..1_000, den in 1u32..1_000) {
            let (now, speed) = (u64::from(now), Speed::new(num, den).unwrap());
            let page = Page::stopped(now, Time(5)).extended(now, u64::MAX / 2, speed);
            let due = Time(5 + u64::from(left));
            let wait = wait(&page, speed, now, due).as_nanos() as u64;
            prop_assert!(page.at(now + wait) >= due);
            prop_assert!(wait == 0 || page.at(now + wait - 1) < due);
        }

        /// While time passes slowly, no wait is long enough to miss the time by more than [`SLOW_WAIT`],
        /// whatever becomes of the speed; and no wait is zero.
        #[test]
        fn waits_are_short_while_time_is_slow(left in 1u32.., part in 0u32..1_000, lapsed: bool) {
            let full = Speed::new(20, 1).unwrap();
            let page = Page::stopped(0, Time::ZERO);
            let page = if lapsed { page } else { page.extended(0, 1 << 40, full.scaled(part, 1_000)) };
            let wait = wait(&page, full, 0, Time(left.into()));
            prop_assert!(!wait.is_zero());
            prop_assert!(wait <= SLOW_WAIT.max(Duration::from_nanos(full.real(left.into()))));
        }
    }
}

//! The one clock of a real process: scenario time from CLOCK_MONOTONIC.
//!
//! All processes of a run share the epoch, which the controller reads once all agents are up, so
//! that setting up is outside scenario time. `time = (monotonic - epoch) * speed` in integers.
//! Absent: the date, which no run may depend on.

use metamorph_protocol::time::Time;
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use std::time::Duration;
use thiserror::Error;

/// How much faster than real time scenario time passes, as a ratio of integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "(u32, u32)", into = "(u32, u32)")]
pub struct Speed {
    num: u32,
    den: u32,
}

/// A speed that is zero or infinite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("a speed of {0}/{1} is not possible; both numbers must be above 0")]
pub struct SpeedError(u32, u32);

impl Speed {
    /// Scenario time is real time.
    pub const REAL: Speed = Speed { num: 1, den: 1 };

    /// `num / den` seconds of scenario time in a second of real time.
    pub const fn new(num: u32, den: u32) -> Result<Speed, SpeedError> {
        if num == 0 || den == 0 { Err(SpeedError(num, den)) } else { Ok(Speed { num, den }) }
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

/// Nanoseconds of CLOCK_MONOTONIC: the same for all processes of one machine.
pub fn monotonic() -> u64 {
    let t = clock_gettime(ClockId::Monotonic);
    // Invariant: this clock starts at zero at boot and never goes back.
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// Scenario time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    epoch: u64,
    speed: Speed,
}

impl Clock {
    /// A clock that shows zero when CLOCK_MONOTONIC shows `epoch`.
    pub const fn new(epoch: u64, speed: Speed) -> Clock {
        Clock { epoch, speed }
    }

    /// The time now; zero before the epoch.
    pub fn now(&self) -> Time {
        self.at(monotonic())
    }

    /// The time when CLOCK_MONOTONIC shows `monotonic`.
    pub fn at(&self, monotonic: u64) -> Time {
        let real = u128::from(monotonic.saturating_sub(self.epoch));
        let scaled = real * u128::from(self.speed.num) / u128::from(self.speed.den);
        Time(u64::try_from(scaled).unwrap_or(u64::MAX))
    }

    /// How long to wait, in real time, until `time`; never too short.
    pub fn until(&self, time: Time) -> Duration {
        self.wait(monotonic(), time)
    }

    fn wait(&self, monotonic: u64, time: Time) -> Duration {
        let real = (u128::from(time.0) * u128::from(self.speed.den)).div_ceil(self.speed.num.into());
        let due = u128::from(self.epoch) + real;
        let left = due.saturating_sub(monotonic.into());
        Duration::from_nanos(u64::try_from(left).unwrap_or(u64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn scales_exactly() {
        let clock = |num, den| Clock::new(1_000, Speed::new(num, den).unwrap());
        assert_eq!(clock(1, 1).at(999), Time::ZERO);
        assert_eq!(clock(1, 1).at(1_007), Time(7));
        assert_eq!(clock(10, 1).at(1_007), Time(70));
        assert_eq!(clock(1, 3).at(1_007), Time(2));
        assert_eq!(clock(1, 1).at(u64::MAX), Time(u64::MAX - 1_000));
        assert_eq!(clock(u32::MAX, 1).at(u64::MAX), Time::NEVER);
        assert!(Speed::new(0, 1).is_err() && Speed::new(1, 0).is_err());
    }

    proptest! {
        /// Having waited as long as asked, the time has come.
        #[test]
        fn waits_long_enough(epoch: u32, now: u32, time: u32, num in 1u32..1_000, den in 1u32..1_000) {
            let clock = Clock::new(epoch.into(), Speed::new(num, den).unwrap());
            let wait = clock.wait(now.into(), Time(time.into()));
            let then = u64::from(now) + wait.as_nanos() as u64;
            prop_assert!(clock.at(then) >= Time(time.into()));
        }
    }
}

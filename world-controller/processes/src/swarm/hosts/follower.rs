//! The clock page of a host on another machine: it follows the controller's page, translated by the difference of the two
//! clocks. Scenario time there never goes back, and is never ahead of the controller's by more than the difference is
//! uncertain. A host whose clock is not known well enough has its time stand still.

use metamorph_module_agent::clock::Speed;
use metamorph_module_agent::clock::page::Page;
use metamorph_module_agent::clock::source::{ClockSource, FileClock};
use metamorph_protocol::host_link::ClockInterval;
use metamorph_protocol::time::{Span, Time};
use std::io;
use std::path::Path;

/// Shortest standstill of time that is worth a line (ns of real time).
const STILL_MIN: u64 = 1_000_000_000;
/// A page that differs from the translated one by less (ns of real time) keeps its speed.
const NEGLIGIBLE: u64 = 200_000;

/// The follower.
#[derive(Debug)]
pub struct Follower {
    clock: FileClock,
    page: Page,
    /// The controller's latest page, by its own clock.
    latest: Option<Page>,
    most: Span,
    /// Since when the difference of clocks has been too uncertain.
    lost_since: Option<u64>,
    /// True if time has stood still for so long that this was told.
    is_told: bool,
}

impl Follower {
    /// Creates the clock page of the run in `root`, which stands still. `most` is the uncertainty of the difference of
    /// clocks up to which it goes on.
    ///
    /// # Errors
    /// If the page cannot be written.
    pub fn create(root: &Path, most: Span) -> io::Result<Follower> {
        let clock = FileClock::create(root, Time::ZERO)?;
        let page = clock.read_page()?;
        Ok(Follower { clock, page, latest: None, most, lost_since: None, is_told: false })
    }

    /// Takes a page of the controller.
    pub fn take(&mut self, page: Page) {
        self.latest = Some(page);
    }

    /// Forgets the page of a controller whose successor may have another clock.
    pub fn forget(&mut self) {
        self.latest = None;
    }

    /// Goes on as far as the controller's latest page allows. `ahead` is how far the controller's clock is ahead of the
    /// one of this host. Returns a change: that time stands still, since the clock is known to this only, or goes on again.
    ///
    /// # Errors
    /// If the page cannot be written.
    pub fn go_on(&mut self, now: u64, ahead: Option<ClockInterval>) -> io::Result<Option<Option<Span>>> {
        let has_begun = |page: &Page| page.at(page.until()) > Time::ZERO;
        let Some((latest, ahead)) = self.latest.filter(has_begun).zip(ahead) else { return Ok(None) };
        let is_lost = ahead.error() > self.most.0;
        self.lost_since = is_lost.then(|| self.lost_since.unwrap_or(now));
        let is_long = self.lost_since.is_some_and(|since| now.saturating_sub(since) >= STILL_MIN);
        let mut change = None;
        if is_long != self.is_told && is_lost == is_long {
            self.is_told = is_long;
            change = Some(is_lost.then_some(Span(ahead.error())));
            match is_lost {
                true => tracing::warn!(
                    "scenario time stands still here: the controller's clock is known to {} only, and {} is the maximum",
                    Span(ahead.error()),
                    self.most
                ),
                false => tracing::info!("scenario time goes on"),
            }
        }
        let target = latest.shifted(-ahead.middle());
        if is_lost || now < self.page.renewal() {
            return Ok(change);
        }
        if let Some((until, speed)) = next_slice(&self.page, &target, now) {
            let from = self.page.until().max(now);
            self.page = self.page.extended(now, until - from, speed);
            self.clock.write_page(&self.page)?;
        }
        Ok(change)
    }

    /// Returns the instant at which there may be more to do.
    pub fn due(&self) -> Option<u64> {
        self.latest.map(|_| self.page.renewal())
    }
}

/// Returns the end and the speed of the slice that follows on `page`, so that at its end it shows what `target` does.
fn next_slice(page: &Page, target: &Page, now: u64) -> Option<(u64, Speed)> {
    let from = page.until().max(now);
    // Within one slice of the target, so that a straight line between its ends is nowhere above it.
    let until = if from < target.renewal() { target.renewal() } else { target.until() };
    let (real, time) = (until.checked_sub(from).filter(|real| *real > 0)?, page.at(from));
    let usual = target.speed_at(from)?;
    let off = target.at(from).0.abs_diff(time.0);
    if off <= usual.scenario(NEGLIGIBLE) {
        return Some((until, usual));
    }
    let (mut num, mut den) = (target.at(until).0.saturating_sub(time.0), real);
    while num > u64::from(u32::MAX) || den > u64::from(u32::MAX) {
        (num, den) = (num >> 1, den.div_ceil(2));
    }
    Speed::new(num as u32, den as u32).ok().map(|speed| (until, speed))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLICE: u64 = 25_000_000;

    /// A clock whose difference is known to 0.3 ms, pages that come late now and then, and a controller that changes its
    /// speed: time here never goes back, is never ahead by more than the uncertainty, and catches up.
    #[test]
    fn the_page_follows_the_controllers() {
        let dir = tempfile::tempdir().unwrap();
        let mut follower = Follower::create(dir.path(), Span::millis(1)).unwrap();
        let begin = follower.page.until();
        let difference = 7_000_000_000_i64;
        let mut theirs = Page::stopped(begin.wrapping_add_signed(difference), Time::ZERO);
        let speeds = [Speed::new(10, 1).unwrap(), Speed::new(7, 2).unwrap(), Speed::STOPPED];
        let (mut shown, mut caught_up) = (Time::ZERO, 0);
        for step in 0..4_000_u64 {
            let now = begin + step * 1_000_000;
            let there = now.wrapping_add_signed(difference);
            if there >= theirs.renewal() {
                theirs = theirs.extended(there, SLICE, speeds[(step / 400) as usize % 3]);
            }
            // Nothing arrives for 100 ms of each second.
            if step % 1_000 >= 100 {
                follower.take(theirs);
            }
            let wrong = (step % 7) as i64 * 100_000 - 300_000;
            let ahead =
                ClockInterval { low: difference + wrong - 300_000, high: difference + wrong + 300_000 };
            follower.go_on(now, Some(ahead)).unwrap();
            let here = follower.page.at(now);
            let truth = theirs.at(there);
            assert!(here >= shown, "step {step}");
            assert!(here.0 <= truth.0 + 10 * 600_000, "step {step}: {here} is ahead of {truth}");
            shown = here;
            caught_up += u64::from(truth.0.abs_diff(here.0) <= 10 * 600_000);
        }
        assert!(caught_up > 3_300, "{caught_up}");
    }

    #[test]
    fn an_uncertain_clock_stands_still() {
        let dir = tempfile::tempdir().unwrap();
        let mut follower = Follower::create(dir.path(), Span::millis(1)).unwrap();
        let begin = follower.page.until();
        follower.take(Page::stopped(begin, Time::ZERO).extended(begin, SLICE, Speed::REAL));
        follower.go_on(begin, None).unwrap();
        let uncertain = Some(ClockInterval { low: -2_000_000, high: 2_000_000 });
        let told = [0, STILL_MIN / 2, STILL_MIN, STILL_MIN + 1]
            .map(|after| follower.go_on(begin + after, uncertain).unwrap());
        assert_eq!(told, [None, None, Some(Some(Span::millis(2))), None]);
        assert_eq!(follower.page.at(begin + SLICE), Time::ZERO);
        let change = follower.go_on(begin, Some(ClockInterval { low: -1_000_000, high: 1_000_000 })).unwrap();
        assert_eq!(change, Some(None));
        assert_eq!(follower.page.at(begin + SLICE), Time(SLICE));
    }
}

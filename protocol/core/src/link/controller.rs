//! The link between the controller and the agents, as the simulated link models it: orders and reports arrive late, in
//! order, and all of them. What is lost on the way is sent again.

use crate::ratio::Ratio;
use crate::rng::Rng;
use crate::time::{Span, Time};
use serde::{Deserialize, Serialize};

/// Largest number of sendings of a message. The last one arrives.
const SENDINGS_MAX: u32 = 64;
/// The least time after which an unacknowledged message is sent again.
const LEAST_RETRY: Span = Span::millis(10);

/// A link for orders and reports.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ControllerLink {
    /// The shortest delay.
    pub delay_min: Span,
    /// The longest delay; delays are uniform between the two.
    pub delay_max: Span,
    /// Probability that one sending of a message is lost.
    pub loss: Ratio,
}

impl ControllerLink {
    /// Returns the time after which a message is sent again: a round trip, and a little more.
    pub fn retry_after(&self) -> Span {
        self.delay_max * 2 + LEAST_RETRY
    }

    /// Draws when a message arrives that is sent at `now`, and how many sendings of it are lost before. `last` is the
    /// latest arrival in this direction so far.
    pub fn carry(&self, now: Time, rng: &mut Rng, last: &mut Time) -> (Time, u32) {
        let lost = (0..SENDINGS_MAX - 1).take_while(|_| rng.chance(self.loss)).count() as u32;
        let spread = self.delay_max - self.delay_min;
        let sent = now + self.retry_after() * u64::from(lost);
        let drawn = sent + self.delay_min + Span(rng.below(spread.0 + 1));
        *last = drawn.max(*last);
        (*last, lost)
    }

    /// Returns a time within which a message arrives but once in a million.
    pub fn usual_longest(&self) -> Span {
        let mut left = 1e6;
        let loss = f64::from(self.loss.num()) / f64::from(self.loss.den());
        let mut lost = 0;
        while left > 1.0 && lost < SENDINGS_MAX - 1 && loss > 0.0 {
            left *= loss;
            lost += 1;
        }
        self.retry_after() * u64::from(lost) + self.delay_max
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn link(loss: &str) -> ControllerLink {
        let loss = loss.parse().expect("a probability");
        ControllerLink { delay_min: Span::millis(5), delay_max: Span::millis(20), loss }
    }

    #[test]
    fn all_messages_arrive_in_order_and_most_within_the_usual_time() {
        for loss in ["0%", "5%", "50%"] {
            let (link, mut rng) = (link(loss), Rng::named(1, "link", 0));
            let (mut last, mut before, mut lost) = (Time::ZERO, Time::ZERO, 0);
            for i in 0..20_000 {
                let now = Time(i * 1_000_000_000);
                let (at, again) = link.carry(now, &mut rng, &mut last);
                assert!(at >= before && at >= now + link.delay_min, "{loss}");
                assert!(at.since(now) <= link.usual_longest(), "{loss}: {} after {}", at.since(now), i);
                (before, lost) = (at, lost + again);
            }
            let share = f64::from(lost) / f64::from(lost + 20_000);
            let expected = f64::from(link.loss.num()) / f64::from(link.loss.den());
            assert!((share - expected).abs() < 0.01, "{loss}: {share}");
        }
    }

    #[test]
    fn a_link_that_loses_nearly_everything_still_delivers() {
        let (link, mut rng, mut last) = (link("100%"), Rng::named(1, "link", 0), Time::ZERO);
        let (at, lost) = link.carry(Time::ZERO, &mut rng, &mut last);
        assert_eq!(lost, SENDINGS_MAX - 1);
        assert!(at.since(Time::ZERO) <= link.usual_longest());
    }
}

//! Delays of a link that are measured rather than uniform, and bursts: spells in which a link is worse than usual.

use crate::ratio::Ratio;
use crate::rng::Rng;
use crate::time::{Span, Time};
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The number of parts that probabilities are divided into.
const WHOLE: u64 = 1 << 32;
/// The largest number of quantiles of a link.
pub const MOST_QUANTILES: usize = 64;

/// Why quantiles are none of a delay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum QuantilesError {
    /// None, or too many.
    #[error("{0} quantiles; there must be 1 to {MOST_QUANTILES}")]
    Count(usize),
    /// The last one is not the longest delay.
    #[error("the last quantile must be that of 100%, the longest delay")]
    Open,
    /// They do not grow.
    #[error("quantile {} is not above the one before: shares must grow, and delays must not fall", .0 + 1)]
    Order(usize),
}

/// A distribution of delays, linear between its quantiles. It begins at a delay of zero, unless the quantile of 0 % is given.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Quantiles {
    /// The share of messages, in parts of [`WHOLE`], that takes at most this long; both grow.
    points: Vec<(u64, Span)>,
}

impl Quantiles {
    /// Creates a distribution: each share of the messages takes at most this long.
    ///
    /// # Errors
    /// If they are too many, do not grow, or do not end with 100 %.
    pub fn new(quantiles: &[(Ratio, Span)]) -> Result<Quantiles, QuantilesError> {
        if !(1..=MOST_QUANTILES).contains(&quantiles.len()) {
            return Err(QuantilesError::Count(quantiles.len()));
        }
        let part = |r: Ratio| u64::from(r.num()) * WHOLE / u64::from(r.den());
        let written = quantiles.iter().map(|(share, delay)| (part(*share), *delay));
        let mut points: Vec<(u64, Span)> = Vec::new();
        if quantiles[0].0 != Ratio::ZERO {
            points.push((0, Span::ZERO));
        }
        for (i, point) in written.enumerate() {
            if points.last().is_some_and(|last| last.0 >= point.0 || last.1 > point.1) {
                return Err(QuantilesError::Order(i));
            }
            points.push(point);
        }
        match points.last() {
            Some((share, _)) if *share == WHOLE && points.len() > 1 => Ok(Quantiles { points }),
            _ => Err(QuantilesError::Open),
        }
    }

    /// Returns the shortest delay.
    pub fn shortest(&self) -> Span {
        self.points.first().map_or(Span::ZERO, |point| point.1)
    }
    /// Returns the longest delay.
    pub fn longest(&self) -> Span {
        self.points.last().map_or(Span::ZERO, |point| point.1)
    }

    /// Draws a delay.
    pub fn draw(&self, rng: &mut Rng) -> Span {
        let share = rng.below(WHOLE);
        let next = self.points.partition_point(|point| point.0 <= share);
        // Invariant: the first point is at 0 and the last at WHOLE, so the drawn share is between two of them.
        let ((from, low), (to, high)) = match (self.points.get(next.wrapping_sub(1)), self.points.get(next)) {
            (Some(before), Some(after)) => (*before, *after),
            _ => return self.longest(),
        };
        let part = u128::from(high.0 - low.0) * u128::from(share - from) / u128::from(to - from);
        low + Span(part as u64)
    }
}

/// Spells in which a link is worse: a chain of two states (Gilbert 1960, Elliott 1963), one for each direction, which each message
/// advances before its fate is drawn.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Burst {
    /// The probability that a message begins a burst.
    pub enter: Ratio,
    /// The probability that a message ends it.
    pub leave: Ratio,
    /// The probability that a message within it is lost.
    pub loss: Ratio,
    /// The shortest and the longest delay within it; `None` if it is the usual one.
    pub delay: Option<(Span, Span)>,
}

/// The state of one direction of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct LinkState {
    /// The latest arrival so far, which later messages do not overtake.
    pub last: Time,
    /// True within a burst.
    pub in_burst: bool,
}

impl LinkState {
    /// Returns the state of a link that begins at a time.
    pub fn begun(at: Time) -> LinkState {
        LinkState { last: at, in_burst: false }
    }

    /// Advances to the next message.
    pub(super) fn advance(&mut self, burst: &Burst, rng: &mut Rng) {
        self.in_burst = if self.in_burst { !rng.chance(burst.leave) } else { rng.chance(burst.enter) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quantiles(all: &[(&str, u64)]) -> Result<Quantiles, QuantilesError> {
        let all: Vec<(Ratio, Span)> =
            all.iter().map(|(p, ms)| (p.parse().unwrap(), Span::millis(*ms))).collect();
        Quantiles::new(&all)
    }

    #[test]
    fn draws_have_the_quantiles_they_were_given() {
        let of = [("50%", 2), ("99%", 20), ("100%", 80)];
        let delays = quantiles(&of).unwrap();
        let mut rng = Rng::named(1, "quantiles", 0);
        let mut drawn: Vec<Span> = (0..100_000).map(|_| delays.draw(&mut rng)).collect();
        drawn.sort_unstable();
        for (share, ms) in [(25_000, 1.0), (50_000, 2.0), (74_500, 11.0), (99_000, 20.0), (99_500, 50.0)] {
            let found = drawn[share].0 as f64 / 1e6;
            assert!((found / ms - 1.0).abs() < 0.1, "{share}: {found} ms instead of {ms}");
        }
        assert!(drawn[99_999] <= delays.longest() && delays.shortest() == Span::ZERO);
        let from = quantiles(&[("0%", 5), ("100%", 5)]).unwrap();
        assert_eq!(
            (from.draw(&mut rng), from.shortest(), from.longest()),
            (Span::millis(5), Span::millis(5), Span::millis(5))
        );
    }

    #[test]
    fn quantiles_that_are_none_are_refused() {
        for (of, error) in [
            (&[][..], QuantilesError::Count(0)),
            (&[("50%", 2)], QuantilesError::Open),
            (&[("50%", 2), ("50%", 3), ("100%", 4)], QuantilesError::Order(1)),
            (&[("50%", 2), ("100%", 1)], QuantilesError::Order(1)),
        ] {
            assert_eq!(quantiles(of), Err(error));
        }
        assert_eq!(quantiles(&[("1%", 2); 65]), Err(QuantilesError::Count(65)));
    }
}

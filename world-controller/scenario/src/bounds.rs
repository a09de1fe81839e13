//! Bounds for standstills: how long a run may go without progress before that counts as a standstill. They
//! follow from the protocol's own times and from what the link does to messages; a link of usual speed that
//! loses nothing leaves them unchanged.
//!
//! A standstill must not be called a deadlock while a module may only be waiting for a message. So a bound is
//! the longest time that one step of progress takes on a link of usual speed, plus
//! - for each message that has to arrive before the next one is sent, the delay beyond the usual one;
//! - for each message that may be lost, the repeats that make the bound too short in at most one of
//!   [`ONCE_IN`] standstills.
//!
//! A damaged or overtaken message is useless to its receiver, so it counts as lost; a duplicate does no harm.
//! With p the probability of loss and q = 1 - p:
//! - *News* passes from module to module, each repeating it until something newer is there. For n of them in
//!   a row the repeats are a sum of n geometric numbers, and by Chernoff's bound (at z = 1/√p) more than `m =
//!   2·(n·log(1 + √p) + log(ONCE_IN))/log(1/p)` of them have a probability below 1/ONCE_IN.
//! - An *exchange* is repeated until it is answered. For l messages, all of which have to arrive, `k =
//!   log(ONCE_IN)/log(1/(1 - qˡ))` tries all fail with a probability below 1/ONCE_IN.
//! - An *attempt* goes over h hops, on each of which a message is repeated until it is answered, and has time for t tries
//!   in all. It succeeds if at least h of t tries do, each with the probability q²; and so do attempts after it.
//!
//! Impairments that end (`until`) are not counted: a bound starts to run when they have ended.

use metamorph_core::link::{Burst, LinkModel};
use metamorph_core::ratio::Ratio;
use metamorph_core::time::Span;

/// Number of standstills in which a bound is too short at most once.
const ONCE_IN: u64 = 1_000_000;
/// Largest number of tries and repeats counted. If more are needed, a bound guarantees nothing.
const TRIES_MAX: u64 = 4_096;
/// Fixed-point scale factor of probabilities: the representation of 1.
pub const ONE: u64 = 1 << 32;
/// Fractional bits of the fixed-point representation of logarithms.
const LOG_BITS: u32 = 16;

/// The effect of a link on messages, as bounds count it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passage {
    /// Delay of a message beyond the usual, at most.
    pub late: Span,
    /// The probability that a message is not lost, damaged or overtaken, in units of 1/[`ONE`].
    pub arrives: u64,
}

impl Passage {
    /// Returns the effect of a link whose longest delay is `delay`, where protocols assume `usual`.
    /// Impairments that end are not counted.
    pub fn of(link: &LinkModel, delay: Span, usual: Span) -> Passage {
        let lasts = link.harmless_from.is_none();
        let harms = [link.loss, link.reorder, link.corrupt].into_iter().filter(|_| lasts);
        let all = harms.fold(ONE, spared);
        let burst = link.burst.as_deref().filter(|_| lasts);
        Passage { late: delay - usual, arrives: burst.map_or(all, |burst| least(link, burst)) }
    }

    /// Returns the number of repeats within which `copies` items of news have all passed `messages` modules
    /// in a row, in all but one of [`ONCE_IN`] cases.
    pub fn repeats(self, messages: u64, copies: u64) -> u64 {
        let lost = ONE - self.arrives;
        if lost == 0 {
            return 0;
        }
        let root = (u128::from(lost) << 32).isqrt() as u64;
        // log(1 + √p) is log 2 less log(2/(1 + √p)).
        let growth = (1 << LOG_BITS) - log_inverse((ONE + root) / 2);
        let needed = 2 * (messages * growth + log(ONCE_IN * copies));
        capped(needed, log_inverse(lost))
    }

    /// Returns the number of tries after the first within which `copies` concurrent exchanges of `messages`
    /// messages all succeed, in all but one of [`ONCE_IN`] cases.
    pub fn more_tries(self, messages: u32, copies: u64) -> u64 {
        let through =
            (0..messages).fold(ONE, |all, _| ((u128::from(all) * u128::from(self.arrives)) >> 32) as u64);
        more_than_one(through, copies)
    }

    /// Returns the number of attempts after the first within which `copies` concurrent attempts all succeed, in all but one of
    /// [`ONCE_IN`] cases. An attempt goes over `hops`, one after the other, and has `tries` messages with their answers for all
    /// of them together.
    pub fn more_attempts(self, hops: u32, tries: u64, copies: u64) -> u64 {
        more_than_one(self.over_hops(hops, tries), copies)
    }

    /// Returns the probability that at least `hops` of a number of tries succeed, each of two messages; in units of 1/[`ONE`].
    fn over_hops(self, hops: u32, tries: u64) -> u64 {
        let both = (u128::from(self.arrives) * u128::from(self.arrives)) >> 32;
        if both == u128::from(ONE) {
            return if tries >= u64::from(hops) { ONE } else { 0 };
        }
        // The probability of having got over each number of hops; the last one stays.
        let mut over = vec![0u128; hops as usize + 1];
        over[0] = u128::from(ONE);
        for _ in 0..tries.min(TRIES_MAX) {
            for hop in (0..hops as usize).rev() {
                let further = (over[hop] * both) >> 32;
                over[hop] -= further;
                over[hop + 1] += further;
            }
        }
        over.last().map_or(0, |all| *all as u64)
    }
}

/// Returns the part of a probability that is left if `p` of it is lost.
fn spared(of: u64, p: Ratio) -> u64 {
    (u128::from(of) * u128::from(p.den() - p.num()) / u128::from(p.den())) as u64
}

/// Returns the probability that a message arrives, whatever became of those before: that of the worse state before it.
fn least(link: &LinkModel, burst: &Burst) -> u64 {
    let [usual, within] =
        [link.loss, burst.loss].map(|loss| [loss, link.reorder, link.corrupt].into_iter().fold(ONE, spared));
    let mixed = |p: Ratio, this: u64, other: u64| spared(this, p) + (other - spared(other, p));
    mixed(burst.enter, usual, within).min(mixed(burst.leave, within, usual))
}

/// The bounds of a swarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// The bound for a standstill.
    pub stall: Span,
    /// The number of tries after the first that it allows for.
    pub more_tries: u64,
}

impl Bounds {
    /// Returns true if the loss is too high to tell a deadlock from a long wait.
    pub fn is_beyond(&self) -> bool {
        self.more_tries + 1 >= TRIES_MAX
    }
}

/// Returns the number of tries after the first that `copies` of something need which succeeds with the probability `through`.
fn more_than_one(through: u64, copies: u64) -> u64 {
    if through == ONE { 0 } else { capped(log(ONCE_IN * copies), log_inverse(ONE - through)) - 1 }
}

/// Returns `needed / each`, rounded up, and at most [`TRIES_MAX`].
fn capped(needed: u64, each: u64) -> u64 {
    needed.checked_div(each).map_or(TRIES_MAX, |n| (n + 1).min(TRIES_MAX))
}

/// Returns the binary logarithm of a whole number, rounded up.
fn log(n: u64) -> u64 {
    u64::from(64 - n.leading_zeros()) << LOG_BITS
}

/// Returns the binary logarithm of `ONE / n`, rounded down, for `n` from 1 to [`ONE`].
fn log_inverse(n: u64) -> u64 {
    let whole = n.max(1).ilog2();
    // A mantissa from 1 to 2 in units of 2⁻³², squared repeatedly: each time it reaches 2 yields a bit.
    let mut mantissa = u128::from(n.max(1)) << (32 - whole);
    let mut fraction = 0;
    for _ in 0..LOG_BITS {
        mantissa = (mantissa * mantissa) >> 32;
        fraction <<= 1;
        if mantissa >= u128::from(2 * ONE) {
            mantissa >>= 1;
            fraction |= 1;
        }
    }
    let logarithm = (u64::from(whole) << LOG_BITS) + fraction + u64::from(mantissa > u128::from(ONE));
    (32u64 << LOG_BITS).saturating_sub(logarithm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::rng::Rng;

    const USUAL: Span = Span::millis(100);

    fn losing(loss: &str) -> Passage {
        let link = LinkModel { loss: loss.parse().unwrap_or(Ratio::ZERO), ..LinkModel::default() };
        Passage::of(&link, USUAL, USUAL)
    }

    #[test]
    fn logarithms_are_close() {
        for n in [1, 2, 3, 1_000, ONE / 10, ONE / 3, ONE / 2, ONE - 1, ONE] {
            let exact = -(n as f64 / ONE as f64).log2();
            let ours = log_inverse(n) as f64 / f64::from(1 << LOG_BITS);
            assert!((exact - 1e-4..=exact).contains(&ours), "{n}: {exact} {ours}");
        }
    }

    /// Of 20,000 draws none needs more than the formulas allow, and some need a fifth of it.
    #[test]
    fn draws_stay_within() {
        let mut stream = Rng::named(1, "bounds", 0);
        for loss in ["5%", "30%", "50%"] {
            let p: Ratio = loss.parse().unwrap_or(Ratio::ZERO);
            let passage = losing(loss);
            for messages in [1u64, 12, 50] {
                let (repeats, mut most) = (passage.repeats(messages, 1), 0);
                for _ in 0..20_000 {
                    let lost = (0..messages)
                        .map(|_| std::iter::repeat(()).take_while(|()| stream.chance(p)).count());
                    most = most.max(lost.sum::<usize>() as u64);
                }
                assert!((repeats / 5..=repeats).contains(&most), "{loss}: {most} of {repeats} repeats");
            }
            let (tries, mut over) = (passage.more_tries(2, 1) + 1, 0);
            for _ in 0..20_000 {
                let fails = |stream: &mut Rng| (0..2).any(|_| stream.chance(p));
                over += u32::from((0..tries).all(|_| fails(&mut stream)));
            }
            assert_eq!(over, 0, "{loss}: {tries} tries");
        }
    }

    /// As many attempts succeed as computed, to a hundredth.
    #[test]
    fn attempts_succeed_as_often_as_computed() {
        let mut stream = Rng::named(1, "attempts", 0);
        for (loss, hops, tries) in [("0%", 4, 4), ("0%", 4, 3), ("5%", 4, 5), ("30%", 12, 22), ("50%", 2, 9)]
        {
            let (p, passage): (Ratio, _) = (loss.parse().unwrap_or(Ratio::ZERO), losing(loss));
            let mut succeeds = || {
                let mut is_answered = || !stream.chance(p) & !stream.chance(p);
                (0..tries).filter(|_| is_answered()).count() >= hops as usize
            };
            let succeeded = (0..20_000).filter(|_| succeeds()).count() as f64 / 20_000.0;
            let computed = passage.over_hops(hops, tries) as f64 / ONE as f64;
            assert!((succeeded - computed).abs() < 0.01, "{loss}, {hops} hops: {succeeded}, {computed}");
        }
        assert_eq!(losing("0%").more_attempts(4, 4, 6), 0);
        assert_eq!(losing("0%").more_attempts(4, 3, 6), TRIES_MAX - 1, "no attempt is long enough");
    }
}

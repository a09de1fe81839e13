//! How long a standstill has to last before it is one: from the protocol's own times, and from what the link
//! does to messages. With a link of usual speed that loses nothing the bounds are what they are without one.
//!
//! A standstill must not be called a deadlock as long as somebody may only be waiting for a message. So a
//! bound is the longest that one step of progress takes on a link of usual speed, and in addition
//! - for each message that has to arrive before the next one is sent, how much later than usual it can be;
//! - for each message that may be lost, as many repeats as it takes until all have come through but once in
//!   [`ONCE_IN`] standstills.
//!
//! A message that is damaged or overtaken is of no use to whoever waits for it, so it counts as lost; one
//! that comes twice does no harm. With p the probability of being lost and q = 1 - p:
//! - *News* goes from one module to the next, each repeating it until something newer is there. For n of
//!   them in a row the repeats are a sum of n geometric numbers, and by Chernoff's bound (at z = 1/√p) more
//!   than `m = 2·(n·log(1 + √p) + log(ONCE_IN))/log(1/p)` of them have a probability below 1/ONCE_IN.
//! - An *exchange* is asked for until an answer comes. Of one with l messages, all of which have to come
//!   through, `k = log(ONCE_IN)/log(1/(1 - qˡ))` tries fail together with a probability below 1/ONCE_IN.
//!
//! What does not last (`until`) is not counted: a bound begins to run when it has ended.

use metamorph_protocol::cube::params::{Connectivity, Params as CubeParams};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::metamodule::params::Params as MetamoduleParams;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::time::Span;

/// A bound that covers what it is meant to would be too short once in so many standstills.
const ONCE_IN: u64 = 1_000_000;
/// Tries and repeats counted at most. Where more would be needed, a bound promises nothing.
const MOST: u64 = 4_096;
/// Fixed point: 1 for probabilities, and for logarithms.
const ONE: u64 = 1 << 32;
const LOG_BITS: u32 = 16;

/// What a link does to messages, as bounds count it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passage {
    /// How much later than usual a message arrives at most, if it does.
    late: Span,
    /// The probability that a message is of use, in units of 1/[`ONE`].
    arrives: u64,
}

impl Passage {
    /// Of this link, where delays of up to `delay` are reckoned with, and up to `usual` are usual.
    pub fn of(link: &LinkModel, delay: Span, usual: Span) -> Passage {
        let lasts = link.harmless_from.is_none();
        let harms = [link.loss, link.reorder, link.corrupt].into_iter().filter(|_| lasts);
        let spared = |arrives: u64, p: Ratio| {
            (u128::from(arrives) * u128::from(p.den() - p.num()) / u128::from(p.den())) as u64
        };
        Passage { late: delay - usual, arrives: harms.fold(ONE, spared) }
    }

    /// Repeats that news needs at most to pass so many modules in a row, and in so many copies.
    fn repeats(self, messages: u64, copies: u64) -> u64 {
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

    /// Tries that an exchange of so many messages needs at most besides the first, for so many at once.
    fn more_tries(self, messages: u32, copies: u64) -> u64 {
        let through =
            (0..messages).fold(ONE, |all, _| ((u128::from(all) * u128::from(self.arrives)) >> 32) as u64);
        if through == ONE {
            return 0;
        }
        capped(log(ONCE_IN * copies), log_inverse(ONE - through)) - 1
    }

    /// Whether so much is lost that a standstill may be called a deadlock although it is none.
    pub fn is_beyond(self, bounds: &Bounds) -> bool {
        self.more_tries(bounds.legs, bounds.copies) + 1 == MOST
    }
}

/// What the bounds of a swarm are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// The bound for standing still.
    pub stall: Span,
    /// Messages of the longest exchange, and how many are asked at once.
    legs: u32,
    copies: u64,
}

impl Bounds {
    /// Of cubes; `sides` is the sum of the sides of the box around start and goals.
    pub fn of_cubes(params: &CubeParams, sides: u64, passage: Passage) -> Bounds {
        // A module may have to walk all around the body before the next cell is filled: three diameters.
        let walk = sides * 3;
        // Of each of its moves, and of each module that news passes: first words of the new neighbours (1),
        // and an answer over the longest route (8), before the body moves and it is known (1).
        let late = passage.late * (walk * 10);
        let hops = if params.connectivity == Connectivity::Cycles { 8 } else { 4 };
        let legs = hops * 2;
        // So many tries fit into an attempt; after it what was granted is given back.
        let asks_for = params.usual_delay * u64::from(legs) + params.tick() * 8;
        let tries = (params.start_within().0 / asks_for.0.max(1)).max(1);
        let attempt = params.lease + params.longest_back_off();
        let copies = 6;
        let lost = params.heartbeat * passage.repeats(walk, copies)
            + attempt * passage.more_tries(legs, copies).div_ceil(tries);
        // At 2.4 moves a cell; and not before anybody may start a cell out of turn.
        let usual = (params.move_time * (walk * 12 / 5)).max(params.relax + params.relax / 5);
        Bounds { stall: usual + late + lost, legs, copies }
    }

    /// Of metamodules.
    pub fn of_metamodules(params: &MetamoduleParams, passage: Passage) -> Bounds {
        // The longest motion is some 30 steps, and waits for one other at most; and twelve times its patience
        // a metamodule may wait: for others to object, to make way, to lead, and to give up.
        let usual = params.turn_time * 120;
        // Patience has room for four exchanges.
        let late = passage.late * (12 * 8);
        // Everybody in hearing has to hear each of the twelve, and to grant what is asked for.
        let (legs, copies) = (2, 24);
        // Once by whoever makes way, once by whoever goes.
        let tries = passage.more_tries(legs, copies) * 2;
        let lost = params.repeat * passage.repeats(12, copies) + params.resend * tries;
        Bounds { stall: usual + late + lost, legs, copies }
    }
}

/// `needed / each`, rounded up, and at most [`MOST`].
fn capped(needed: u64, each: u64) -> u64 {
    needed.checked_div(each).map_or(MOST, |n| (n + 1).min(MOST))
}

/// The logarithm of a whole number to base 2, rounded up to a whole number.
fn log(n: u64) -> u64 {
    u64::from(64 - n.leading_zeros()) << LOG_BITS
}

/// The logarithm of `ONE / n` to base 2, rounded down, for `n` from 1 to [`ONE`].
fn log_inverse(n: u64) -> u64 {
    let whole = n.max(1).ilog2();
    // From 1 to 2 in units of 2⁻³², and squared again and again: each time that it comes to 2 is a bit.
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
    use crate::scenario::flaw::{LONGEST, SHORTEST};
    use metamorph_protocol::metamodule::params::Strategy;
    use metamorph_protocol::rng::Stream;
    use metamorph_protocol::time::Time;

    const MOVE: Span = Span::secs(1);
    const USUAL: Span = Span::millis(100);

    fn losing(loss: &str) -> Passage {
        let link = LinkModel { loss: loss.parse().unwrap_or(Ratio::ZERO), ..LinkModel::default() };
        Passage::of(&link, USUAL, USUAL)
    }

    fn cubes(delay: Span, passage: Passage) -> Span {
        Bounds::of_cubes(&CubeParams::scaled(MOVE, delay, 60), 17, passage).stall
    }

    fn metamodules(delay: Span, passage: Passage) -> Span {
        let params = MetamoduleParams::scaled(Strategy::Negotiated, MOVE, delay);
        Bounds::of_metamodules(&params, passage).stall
    }

    #[test]
    fn logarithms_are_close() {
        for n in [1, 2, 3, 1_000, ONE / 10, ONE / 3, ONE / 2, ONE - 1, ONE] {
            let exact = -(n as f64 / ONE as f64).log2();
            let ours = log_inverse(n) as f64 / f64::from(1 << LOG_BITS);
            assert!((exact - 1e-4..=exact).contains(&ours), "{n}: {exact} {ours}");
        }
    }

    /// A link that is not slower than usual and loses nothing for good changes no bound.
    #[test]
    fn the_usual_link_changes_nothing() {
        let ends = LinkModel { loss: Ratio::ONE, harmless_from: Some(Time(1)), ..LinkModel::default() };
        let twice = LinkModel { duplicate: Ratio::ONE, ..LinkModel::default() };
        for link in [LinkModel::default(), ends, twice] {
            for delay in [Span::ZERO, USUAL] {
                let passage = Passage::of(&link, delay, USUAL);
                assert_eq!(cubes(USUAL, passage), Span::secs(300));
                assert_eq!(metamodules(USUAL, passage), Span::secs(120));
            }
        }
    }

    #[test]
    fn slower_and_worse_links_take_longer() {
        let slow = |delay| Passage { late: delay - USUAL, arrives: ONE };
        for bound in [cubes, metamodules] {
            let delays = [USUAL, MOVE, Span::secs(10), Span::secs(100)];
            assert!(delays.map(|d| bound(d, slow(d))).is_sorted_by(|a, b| a < b));
            let losses = ["0%", "1%", "5%", "20%", "30%", "50%"];
            assert!(losses.map(|l| bound(USUAL, losing(l))).is_sorted_by(|a, b| a < b));
            // No link makes the arithmetic overflow.
            let worst = Passage { late: LONGEST, arrives: 0 };
            assert!(bound(LONGEST, worst) > bound(LONGEST, slow(LONGEST)));
        }
        let bounds = Bounds::of_cubes(&CubeParams::scaled(MOVE, USUAL, 60), 17, losing("0%"));
        assert!(!losing("50%").is_beyond(&bounds) && losing("60%").is_beyond(&bounds));
    }

    /// Of 20,000 draws none needs more than the formulas allow for, and some need a fifth of it.
    #[test]
    fn draws_stay_within() {
        let mut stream = Stream::named(1, "bounds", 0);
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
                let fails = |stream: &mut Stream| (0..2).any(|_| stream.chance(p));
                over += u32::from((0..tries).all(|_| fails(&mut stream)));
            }
            assert_eq!(over, 0, "{loss}: {tries} tries");
        }
    }

    /// No delay that a scenario may name makes a protocol wait for less than its messages take.
    #[test]
    fn timers_outlast_every_delay() {
        for beat in [SHORTEST, MOVE, LONGEST] {
            for delay in [Span::ZERO, SHORTEST, MOVE, LONGEST] {
                let cube = CubeParams::scaled(beat, delay, 60);
                // A request and its answer over the longest route, and the move.
                assert!(cube.start_within() > delay * 8 && cube.lease > delay * 8 + beat);
                assert!(cube.suspect > cube.heartbeat + delay && cube.hold > cube.heartbeat + delay);
                let cycles = cube.keeping(Connectivity::Cycles);
                assert!(cycles.start_within() > delay * 44);
                let metamodule = MetamoduleParams::scaled(Strategy::Negotiated, beat, delay);
                assert!(metamodule.resend > delay * 2 && metamodule.patience > delay * 4);
                // Asking, and a motion of 30 steps.
                assert!(metamodule.lease > delay * 2 + beat * 30);
            }
        }
    }
}

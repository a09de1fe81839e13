//! Bounds for a standstill of metamodules.

use metamorph_protocol::metamodule::params::Params;
use metamorph_scenario::bounds::{Bounds, Passage};

/// Returns the bounds of a swarm of metamodules.
pub fn bounds(params: &Params, passage: Passage) -> Bounds {
    // The longest move has about 30 steps, and waits for one other at most. A metamodule may wait for up to
    // twelve times its patience: for objections, for others to make way, for the coordinator, and until it
    // gives up.
    let usual = params.turn_time * 120;
    // The patience covers four exchanges.
    let late = passage.late * (12 * 8);
    // All metamodules in range have to receive each of the twelve, and to grant what is requested.
    let copies = 24;
    // Once for the metamodule that makes way, once for the one that moves.
    let more_tries = passage.more_tries(2, copies);
    let lost = params.repeat * passage.repeats(12, copies) + params.resend * (more_tries * 2);
    Bounds { stall: usual + late + lost, more_tries }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::link::LinkModel;
    use metamorph_protocol::metamodule::params::Strategy;
    use metamorph_protocol::ratio::Ratio;
    use metamorph_protocol::time::{Span, Time};
    use metamorph_scenario::bounds::ONE;
    use metamorph_scenario::error::{LONGEST, SHORTEST};

    const MOVE: Span = Span::secs(1);
    const USUAL: Span = Span::millis(100);

    fn losing(loss: &str) -> Passage {
        let link = LinkModel { loss: loss.parse().unwrap_or(Ratio::ZERO), ..LinkModel::default() };
        Passage::of(&link, USUAL, USUAL)
    }

    fn stall(delay: Span, passage: Passage) -> Span {
        let params = Params::scaled(Strategy::Negotiated, MOVE, delay);
        bounds(&params, passage).stall
    }

    /// A link that is not slower than usual and loses nothing permanently changes no bound.
    #[test]
    fn the_usual_link_changes_nothing() {
        let ends = LinkModel { loss: Ratio::ONE, harmless_from: Some(Time(1)), ..LinkModel::default() };
        let twice = LinkModel { duplicate: Ratio::ONE, ..LinkModel::default() };
        for link in [LinkModel::default(), ends, twice] {
            for delay in [Span::ZERO, USUAL] {
                let passage = Passage::of(&link, delay, USUAL);
                assert_eq!(stall(USUAL, passage), Span::secs(120));
            }
        }
    }

    #[test]
    fn slower_and_worse_links_take_longer() {
        let slow = |delay| Passage { late: delay - USUAL, arrives: ONE };
        let delays = [USUAL, MOVE, Span::secs(10), Span::secs(100)];
        assert!(delays.map(|d| stall(d, slow(d))).is_sorted_by(|a, b| a < b));
        let losses = ["0%", "1%", "5%", "20%", "30%", "50%"];
        assert!(losses.map(|l| stall(USUAL, losing(l))).is_sorted_by(|a, b| a < b));
        // No link overflows the arithmetic.
        let worst = Passage { late: LONGEST, arrives: 0 };
        assert!(stall(LONGEST, worst) > stall(LONGEST, slow(LONGEST)));
    }

    /// With any valid delay, every protocol waits longer than its messages take.
    #[test]
    fn timers_outlast_every_delay() {
        for time_step in [SHORTEST, MOVE, LONGEST] {
            for delay in [Span::ZERO, SHORTEST, MOVE, LONGEST] {
                let metamodule = Params::scaled(Strategy::Negotiated, time_step, delay);
                assert!(metamodule.resend > delay * 2 && metamodule.patience > delay * 4);
                // A request, and a move of 30 steps.
                assert!(metamodule.lease > delay * 2 + time_step * 30);
            }
        }
    }
}

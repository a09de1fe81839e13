//! Bounds for a standstill of cubes.

use metamorph_protocol::cube::params::{Connectivity, Params};
use metamorph_protocol::time::Span;
use metamorph_scenario::bounds::{Bounds, Passage};

/// Returns the bounds of a swarm of cubes; `sides` is the sum of the sides of the box around start and goals.
pub fn bounds(params: &Params, sides: u64, passage: Passage) -> Bounds {
    // A module may have to walk around the whole body before the next cell is filled: three diameters.
    let walk = sides * 3;
    // Per move, and per module that news passes: the first messages of the new neighbours (1), an answer over
    // the longest route (8) before the body moves, and the news of the move (1).
    let late = passage.late * (walk * 10);
    let (hops, searches) = match params.connectivity {
        Connectivity::Cycles => (8, params.longest_search()),
        Connectivity::Forest | Connectivity::Gradient => (4, Span::ZERO),
    };
    // At the end of an attempt all grants are returned.
    let tries = params.start_within().0 / params.answer_over(1).0.max(1);
    let attempt = params.lease + params.longest_back_off() + searches;
    let copies = 6;
    let more_tries = passage.more_attempts(hops, tries, copies);
    let lost = params.heartbeat * passage.repeats(walk, copies) + attempt * more_tries;
    // 2.4 moves per cell, and at least the time until cells may be started out of turn.
    let usual =
        (params.move_time * (walk * 12 / 5)).max(params.out_of_turn_after + params.out_of_turn_after / 5);
    Bounds { stall: usual + late + lost, more_tries }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::link::LinkModel;
    use metamorph_protocol::ratio::Ratio;
    use metamorph_protocol::time::Time;
    use metamorph_scenario::bounds::ONE;
    use metamorph_scenario::error::{LONGEST, SHORTEST};

    const MOVE: Span = Span::secs(1);
    const USUAL: Span = Span::millis(100);

    fn losing(loss: &str) -> Passage {
        let link = LinkModel { loss: loss.parse().unwrap_or(Ratio::ZERO), ..LinkModel::default() };
        Passage::of(&link, USUAL, USUAL)
    }

    fn stall(delay: Span, passage: Passage) -> Span {
        bounds(&Params::scaled(MOVE, delay, 60), 17, passage).stall
    }

    /// A link that is not slower than usual and loses nothing permanently changes no bound.
    #[test]
    fn the_usual_link_changes_nothing() {
        let ends = LinkModel { loss: Ratio::ONE, harmless_from: Some(Time(1)), ..LinkModel::default() };
        let twice = LinkModel { duplicate: Ratio::ONE, ..LinkModel::default() };
        for link in [LinkModel::default(), ends, twice] {
            for delay in [Span::ZERO, USUAL] {
                let passage = Passage::of(&link, delay, USUAL);
                assert_eq!(stall(USUAL, passage), Span::secs(300));
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
        let is_beyond = |loss| bounds(&Params::scaled(MOVE, USUAL, 60), 17, losing(loss)).is_beyond();
        assert!(!is_beyond("60%") && is_beyond("90%"));
    }

    /// With any valid delay, every protocol waits longer than its messages take.
    #[test]
    fn timers_outlast_every_delay() {
        for time_step in [SHORTEST, MOVE, LONGEST] {
            for delay in [Span::ZERO, SHORTEST, MOVE, LONGEST] {
                let cube = Params::scaled(time_step, delay, 60);
                // A request and its answer over the longest route, and the move.
                assert!(cube.start_within() > delay * 8 && cube.lease > delay * 8 + time_step);
                assert!(cube.suspect > cube.heartbeat + delay && cube.hold > cube.heartbeat + delay);
                let cycles = cube.keeping(Connectivity::Cycles);
                assert!(cycles.start_within() > delay * 44);
            }
        }
    }
}

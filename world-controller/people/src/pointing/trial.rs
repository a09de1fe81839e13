//! Tries of pointing at a tile with a tracker that has noise, and how often the tile is selected.

use super::dwell::{DWELL, Dwell, Rule};
use super::filter::Filter;
use super::ray::{TILE, tile};
use metamorph_free_modules::gait::ask_tell::{normal, uniform};
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use serde::Serialize;
use std::f64::consts::TAU;

/// Samples a second of a tracker.
const RATE: u64 = 30;
/// The time of a try.
pub const TRY: Span = Span::secs(6);
/// Height of the head in metres.
const HEAD: f64 = 1.7;
/// Distance from the head to the hand in metres.
const ARM: f64 = 0.6;

/// Parameters of a try. Lengths are in metres.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Setup {
    /// Standard deviation of each coordinate of head and hand, drawn for each sample.
    pub noise_m: f64,
    /// Distance on the floor from the person to the tile, in a drawn direction.
    pub distance_m: f64,
    /// How far beside the middle of the tile is aimed at most, along each of its edges, in edges.
    pub aside_tiles: f64,
}

/// The results of many tries.
#[derive(Clone, Debug, Serialize)]
pub struct Tally {
    /// Number of tries.
    pub tries: u64,
    /// Tries in which the first tile selected was the right one.
    pub right: u64,
    /// Tries in which it was another one.
    pub wrong: u64,
    /// Median time to the right tile in seconds; none if it was never selected.
    pub median_s: Option<f64>,
}

/// Returns whether the right tile is selected, and after which time; `None` if no tile is.
fn one(setup: &Setup, rule: Rule, filtered: bool, seed: u64) -> Option<(bool, Span)> {
    let mut rng = Rng::named(seed, "pointing", 0);
    let between = |rng: &mut Rng, low: f64, high: f64| low + (high - low) * uniform(rng);
    let angle = between(&mut rng, 0.0, TAU);
    let near = [libm::cos(angle), libm::sin(angle)].map(|x| libm::round(setup.distance_m * x / TILE));
    let aim = near.map(|x| (x + between(&mut rng, -setup.aside_tiles, setup.aside_tiles)) * TILE);
    let length = libm::hypot(libm::hypot(aim[0], aim[1]), HEAD);
    let hand = [aim[0], aim[1], -HEAD].map(|x| x / length * ARM);
    let truth = [0.0, 0.0, HEAD, hand[0], hand[1], HEAD + hand[2]];
    let mut filter = Filter::default();
    let mut dwell = Dwell::new(rule);
    for sample in 0..TRY.0 * RATE / Span::secs(1).0 {
        let now = Time(sample * Span::secs(1).0 / RATE);
        let seen = truth.map(|x| x + setup.noise_m * normal(&mut rng));
        let [a, b, c, d, e, f] = if filtered { filter.next(seen) } else { seen };
        let hit = tile([a, b, c], [d, e, f]);
        if dwell.point(now, hit).is_selected {
            return Some((hit == Some(near.map(|x| x as i32)), now.since(Time::ZERO)));
        }
    }
    None
}

/// Tries once for each seed.
pub fn tries(setup: &Setup, rule: Rule, filtered: bool, seeds: impl Iterator<Item = u64>) -> Tally {
    let mut tally = Tally { tries: 0, right: 0, wrong: 0, median_s: None };
    let mut times = Vec::new();
    for seed in seeds {
        tally.tries += 1;
        match one(setup, rule, filtered, seed) {
            Some((true, time)) => times.push(time),
            Some((false, _)) => tally.wrong += 1,
            None => {}
        }
    }
    tally.right = times.len() as u64;
    times.sort_unstable();
    tally.median_s = times.get(times.len() / 2).map(|time| time.as_secs_f64());
    debug_assert!(times.first().is_none_or(|time| *time >= DWELL));
    tally
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setup(noise_m: f64) -> Setup {
        Setup { noise_m, distance_m: 2.0, aside_tiles: 0.0 }
    }

    #[test]
    fn filters_and_charges_find_the_tile_that_noise_hides() {
        let seeds = 0..200;
        let exact = tries(&setup(0.0), Rule::Strict, false, seeds.clone());
        assert_eq!((exact.right, exact.median_s), (200, Some(2.0)), "{exact:?}");
        let raw = tries(&setup(0.02), Rule::Strict, false, seeds.clone());
        assert_eq!((raw.right, raw.wrong), (0, 0), "{raw:?}");
        let strict = tries(&setup(0.02), Rule::Strict, true, seeds.clone());
        let charge = tries(&setup(0.02), Rule::Charge, true, seeds);
        assert!(
            strict.right < charge.right && charge.right >= 196 && charge.wrong <= 2,
            "{strict:?} {charge:?}"
        );
    }

    #[test]
    fn the_same_seeds_give_the_same_tries() {
        let run = || format!("{:?}", tries(&setup(0.03), Rule::Charge, true, 5..50));
        assert_eq!(run(), run());
    }
}

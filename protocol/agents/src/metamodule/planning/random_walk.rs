//! Randomised fallback: random walks until a body can fill a seed; redundant trips are then removed.
//!
//! In a dense group a plan involves many bodies, each with steps that bring none of them closer to a seed. A
//! best-first search (`state_space`) drowns in those states; a random walk does not, as long as the floor is
//! not too full. The generator has a constant seed, so equal standstills give equal plans.
//!
//! Not here: a proof that there is no plan.

use crate::metamodule::planning::cooperative::{Move, Standstill};
use crate::metamodule::planning::state_space::StateSpace;
use crate::metamodule::pose::Pose;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::rng::Rng;

/// Number of trips of the first try; each later one takes twice as many.
const FIRST: usize = 16;
/// Largest number of trips of a try.
const LONGEST: usize = 512;
/// Factor of the work spent on shorter plans after the first one, relative to the work that the first one took.
const SHORTER_PLANS_FACTOR: usize = 3;
/// Divisor of the work: the share that shortening one plan may take.
const SHORTENING_DIVISOR: usize = 8;

/// One body moves to another pose while all others stay.
#[derive(Clone, Copy)]
struct Trip {
    body: usize,
    to: Pose,
}

/// Returns the shortest plan for `movers` found with about `work`; the search ends sooner after the first
/// plan. Shortening the last one may exceed the bound.
pub(super) fn random_walk_search(
    standstill: &Standstill,
    movers: &[usize],
    work: usize,
) -> Option<Vec<Move>> {
    let mut rng = Rng::named(0, "wander", 0);
    let (mut most, mut left, mut best) = (FIRST, work, None::<Vec<Move>>);
    while !movers.is_empty() && left > 0 {
        // Each try has a state space of its own: one for all would take too much memory.
        let mut state_space = StateSpace::new(standstill, standstill.fixed.clone());
        let path = Path::by_random_walk(standstill, movers, &mut state_space, most, left, &mut rng);
        let until = state_space.work + work / SHORTENING_DIVISOR;
        let moves = path.and_then(|path| path.shortened(standstill, &mut state_space, until));
        left = left.saturating_sub(state_space.work);
        if moves.is_some() && best.is_none() {
            hit(CoveragePoint::MetaByLuck);
            left = left.min((work - left).saturating_mul(SHORTER_PLANS_FACTOR));
        }
        best = best.into_iter().chain(moves).min_by_key(Vec::len);
        most = LONGEST.min(most * 2);
    }
    best
}

/// Trips after which a body can fill a seed.
struct Path {
    body: usize,
    trips: Vec<Trip>,
}

impl Path {
    /// Draws trips of random bodies to random poses, at most about `most`, until a body can fill a seed.
    fn by_random_walk(
        standstill: &Standstill,
        movers: &[usize],
        state_space: &mut StateSpace<'_>,
        most: usize,
        until: usize,
        rng: &mut Rng,
    ) -> Option<Path> {
        let mut pick = |n: usize| rng.below(n as u64) as usize;
        let (mut poses, mut trips) = (standstill.free.clone(), Vec::new());
        while trips.len() <= most && state_space.work < until {
            let body = movers[pick(movers.len())];
            let reachable = state_space.reachable(&poses, body);
            if reachable.fills.is_some() {
                return Some(Path { body, trips });
            }
            // A body may stay where it rests, so there is at least one choice.
            let rest = reachable.rests.get(pick(reachable.rests.len()));
            let to = rest.map_or(poses[body], |rest| reachable.pose(*rest));
            poses[body] = to;
            trips.push(Trip { body, to });
        }
        None
    }

    /// Returns the moves of the path without its redundant trips.
    fn shortened(
        mut self,
        standstill: &Standstill,
        state_space: &mut StateSpace<'_>,
        until: usize,
    ) -> Option<Vec<Move>> {
        let mut best = go(standstill, state_space, &self)?;
        let mut size = self.trips.len();
        while size > 0 {
            let mut at = 0;
            while at < self.trips.len() && state_space.work < until {
                let mut trips = self.trips.clone();
                trips.drain(at..(at + size).min(trips.len()));
                let less = Path { body: self.body, trips };
                match go(standstill, state_space, &less) {
                    Some(moves) => (self, best) = (less, moves),
                    None => at += size,
                }
            }
            size /= 2;
        }
        Some(best)
    }
}

/// Returns the moves of a path; `None` if a trip is impossible or no seed can be filled at the end.
fn go(standstill: &Standstill, state_space: &mut StateSpace<'_>, path: &Path) -> Option<Vec<Move>> {
    let (mut poses, mut moves) = (standstill.free.clone(), Vec::new());
    let does_something = |m: &Move| m.lands || m.posture != m.from.posture;
    for trip in &path.trips {
        let reachable = state_space.reachable(&poses, trip.body);
        let to = reachable.rests.iter().find(|rest| reachable.pose(**rest) == trip.to)?;
        moves.extend(reachable.moves(*to).into_iter().filter(does_something));
        poses[trip.body] = trip.to;
    }
    let reachable = state_space.reachable(&poses, path.body);
    moves.extend(reachable.moves(reachable.fills?));
    Some(moves)
}

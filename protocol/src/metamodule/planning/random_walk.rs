//! Ways by luck: bodies go here and there until one of them can fill a seed, and what was for nothing is left out.
//!
//! Where many stand close together, a way takes many of them, each some steps that bring nobody nearer to a
//! seed. A search that begins with what looks nearest (`state_space`) drowns in them; going anywhere does not, as
//! long as the floor is not too full. Its chance is the same every time, so who searches twice finds the same.
//!
//! Absent: the proof that there is no way.

use crate::coverage::{CoveragePoint, hit};
use crate::metamodule::planning::cooperative::{Move, Standstill};
use crate::metamodule::planning::state_space::StateSpace;
use crate::metamodule::pose::Pose;
use crate::rng::Rng;

/// After so many trips the first try begins anew, each later one after twice as many.
const FIRST: usize = 16;
/// No try is longer.
const LONGEST: usize = 512;
/// Once there is a way, so many times the work that it took goes into shorter ones.
const MORE: usize = 3;
/// Each way is made short with at most such a part of the work.
const SHORTENING: usize = 8;

/// One body goes somewhere else while all others stay.
#[derive(Clone, Copy)]
struct Trip {
    body: usize,
    to: Pose,
}

/// The shortest of the ways of these that are found with so much work, or soon after the first one. Making the
/// last one short may take a little more.
pub(super) fn random_walk_search(
    standstill: &Standstill,
    movers: &[usize],
    work: usize,
) -> Option<Vec<Move>> {
    let mut rng = Rng::named(0, "wander", 0);
    let (mut most, mut left, mut best) = (FIRST, work, None::<Vec<Move>>);
    while !movers.is_empty() && left > 0 {
        // Each try has its own: what all of them look at would take too much memory.
        let mut state_space = StateSpace::new(standstill, standstill.fixed.clone());
        let path = Path::by_random_walk(standstill, movers, &mut state_space, most, left, &mut rng);
        let until = state_space.work + work / SHORTENING;
        let moves = path.and_then(|path| path.shortened(standstill, &mut state_space, until));
        left = left.saturating_sub(state_space.work);
        if moves.is_some() && best.is_none() {
            hit(CoveragePoint::MetaByLuck);
            left = left.min((work - left).saturating_mul(MORE));
        }
        best = best.into_iter().chain(moves).min_by_key(Vec::len);
        most = LONGEST.min(most * 2);
    }
    best
}

/// After these trips this body can fill a seed.
struct Path {
    body: usize,
    trips: Vec<Trip>,
}

impl Path {
    /// So many trips at most of anybody to anywhere, until somebody can fill a seed.
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
            // Everybody may rest where it rests already, so somewhere.
            let rest = reachable.rests.get(pick(reachable.rests.len()));
            let to = rest.map_or(poses[body], |rest| reachable.pose(*rest));
            poses[body] = to;
            trips.push(Trip { body, to });
        }
        None
    }

    /// Its moves, without trips that it does not take.
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

/// The moves of a way, if it is one.
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

//! Ways by luck: bodies go here and there until one of them can fill a seed, and what was for nothing is left out.
//!
//! Where many stand close together, a way takes many of them, each some steps that bring nobody nearer to a
//! seed. A search that begins with what looks nearest (`board`) drowns in them; going anywhere does not, as
//! long as the floor is not too full. Its chance is the same every time, so who searches twice finds the same.
//!
//! Absent: the proof that there is no way.

use crate::coverage::{Mark, hit};
use crate::metamodule::planning::cooperative::{Move, Standstill};
use crate::metamodule::planning::state_space::Board;
use crate::metamodule::pose::Pose;
use crate::rng::Stream;

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
pub(super) fn wander(standstill: &Standstill, movers: &[usize], work: usize) -> Option<Vec<Move>> {
    let mut stream = Stream::named(0, "wander", 0);
    let (mut most, mut left, mut best) = (FIRST, work, None::<Vec<Move>>);
    while !movers.is_empty() && left > 0 {
        // Each try has its own: what all of them look at would take too much memory.
        let mut board = Board::new(standstill, standstill.fixed.clone());
        let way = Way::by_luck(standstill, movers, &mut board, most, left, &mut stream);
        let until = board.work + work / SHORTENING;
        let moves = way.and_then(|way| way.shortened(standstill, &mut board, until));
        left = left.saturating_sub(board.work);
        if moves.is_some() && best.is_none() {
            hit(Mark::MetaByLuck);
            left = left.min((work - left).saturating_mul(MORE));
        }
        best = best.into_iter().chain(moves).min_by_key(Vec::len);
        most = LONGEST.min(most * 2);
    }
    best
}

/// After these trips this body can fill a seed.
struct Way {
    body: usize,
    trips: Vec<Trip>,
}

impl Way {
    /// So many trips at most of anybody to anywhere, until somebody can fill a seed.
    fn by_luck(
        standstill: &Standstill,
        movers: &[usize],
        board: &mut Board<'_>,
        most: usize,
        until: usize,
        stream: &mut Stream,
    ) -> Option<Way> {
        let mut pick = |n: usize| stream.below(n as u64) as usize;
        let (mut poses, mut trips) = (standstill.free.clone(), Vec::new());
        while trips.len() <= most && board.work < until {
            let body = movers[pick(movers.len())];
            let roam = board.roam(&poses, body);
            if roam.fills.is_some() {
                return Some(Way { body, trips });
            }
            // Everybody may rest where it rests already, so somewhere.
            let rest = roam.rests.get(pick(roam.rests.len()));
            let to = rest.map_or(poses[body], |rest| roam.pose(*rest));
            poses[body] = to;
            trips.push(Trip { body, to });
        }
        None
    }

    /// Its moves, without trips that it does not take.
    fn shortened(
        mut self,
        standstill: &Standstill,
        board: &mut Board<'_>,
        until: usize,
    ) -> Option<Vec<Move>> {
        let mut best = go(standstill, board, &self)?;
        let mut size = self.trips.len();
        while size > 0 {
            let mut at = 0;
            while at < self.trips.len() && board.work < until {
                let mut trips = self.trips.clone();
                trips.drain(at..(at + size).min(trips.len()));
                let less = Way { body: self.body, trips };
                match go(standstill, board, &less) {
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
fn go(standstill: &Standstill, board: &mut Board<'_>, way: &Way) -> Option<Vec<Move>> {
    let (mut poses, mut moves) = (standstill.free.clone(), Vec::new());
    let does_something = |m: &Move| m.lands || m.posture != m.from.posture;
    for trip in &way.trips {
        let roam = board.roam(&poses, trip.body);
        let to = roam.rests.iter().find(|rest| roam.pose(**rest) == trip.to)?;
        moves.extend(roam.moves(*to).into_iter().filter(does_something));
        poses[trip.body] = trip.to;
    }
    let roam = board.roam(&poses, way.body);
    moves.extend(roam.moves(roam.fills?));
    Some(moves)
}

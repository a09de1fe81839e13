//! Better places for pieces: the nearest one for one piece, and the least change of all.

use super::constraint::{check, first};
use super::model::{Placement, Room};
use serde::Serialize;
use std::collections::HashSet;

/// Largest number of rooms that [`put_right`] examines.
const MAX_LOOKED_AT: usize = 200_000;

/// Returns the nearest place for a piece at which it violates nothing, first by distance and then by turn, y and x;
/// `None` if there is none, or `going` no longer holds.
pub fn snap(room: &Room, piece: usize, going: &dyn Fn() -> bool) -> Option<Placement> {
    let from = room.pieces[piece].place;
    let mut room = room.clone();
    let all = (0..4u8).flat_map(|turn| {
        (0..room.size.1).flat_map(move |y| (0..room.size.0).map(move |x| Placement { at: (x, y), turn }))
    });
    let mut all: Vec<Placement> = all.collect();
    all.sort_by_key(|place| (from.distance(*place), place.turn, place.at.1, place.at.0));
    all.into_iter().take_while(|_| going()).find(|place| {
        room.pieces[piece].place = *place;
        check(&room).iter().all(|v| v.wish || !v.movers.contains(&piece))
    })
}

/// How far an answer is proven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Least {
    /// No smaller total displacement puts the room right.
    Proven,
    /// The search has ended before that was known.
    Heuristic,
}

/// A room put right.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Mended {
    /// Where the pieces stand, in the order of the room.
    pub placements: Vec<Placement>,
    /// The sum of all displacements.
    pub total: u32,
    /// Whether that is the least.
    pub least: Least,
}

/// Moves pieces so that no constraint is violated but wishes and `reach`, by the least total displacement; `None` if
/// no way was found.
///
/// Iterative deepening over the total. In every solution that is `n` steps away at least one piece of a constraint
/// that is violated now stands elsewhere, so a step of one of its pieces leads to `n - 1`: to branch over the pieces
/// of one violated constraint loses no solution. The least is looked for while `searching` holds, any other while
/// `mending` does.
pub fn put_right(room: &Room, searching: &dyn Fn() -> bool, mending: &dyn Fn() -> bool) -> Option<Mended> {
    let (from, room_now, seen) = (room.placements(), room.clone(), HashSet::new());
    let mut search = Search { from, room: room_now, seen, left: MAX_LOOKED_AT, searching };
    for total in 0.. {
        search.seen.clear();
        if let Some(placements) = search.within(total) {
            return Some(Mended { placements, total, least: Least::Proven });
        }
        if search.left == 0 {
            break;
        }
    }
    one_by_one(room, mending)
}

struct Search<'a> {
    from: Vec<Placement>,
    room: Room,
    /// Rooms looked at in this round, with what was left of the total.
    seen: HashSet<(Vec<Placement>, u32)>,
    left: usize,
    searching: &'a dyn Fn() -> bool,
}

impl Search<'_> {
    fn within(&mut self, budget: u32) -> Option<Vec<Placement>> {
        let now = self.room.placements();
        if !(self.searching)() {
            self.left = 0;
        }
        if self.left == 0 || !self.seen.insert((now.clone(), budget)) {
            return None;
        }
        self.left -= 1;
        let Some(violation) = first(&self.room) else { return Some(now) };
        for piece in violation.movers {
            for (step, cost) in steps(now[piece]) {
                // Only away from where it stood: every shortest sequence of steps is one of these.
                let farther = self.from[piece].distance(step) == self.from[piece].distance(now[piece]) + cost;
                if cost > budget || !farther {
                    continue;
                }
                self.room.pieces[piece].place = step;
                if let Some(found) = self.within(budget - cost) {
                    return Some(found);
                }
                self.room.pieces[piece].place = now[piece];
            }
        }
        None
    }
}

/// The single steps of a piece, with their costs.
fn steps(place: Placement) -> [(Placement, u32); 6] {
    let (x, y) = place.at;
    let to = |x, y| (Placement { at: (x, y), ..place }, 1);
    let turned = |by| (Placement { turn: (place.turn + by) % 4, ..place }, 2);
    [to(x - 1, y), to(x + 1, y), to(x, y - 1), to(x, y + 1), turned(1), turned(3)]
}

/// Moves one piece after the other to the nearest place where it violates nothing.
fn one_by_one(room: &Room, going: &dyn Fn() -> bool) -> Option<Mended> {
    let mut mended = room.clone();
    for _ in 0..=room.pieces.len() {
        let Some(violation) = first(&mended) else {
            let placements = mended.placements();
            let moved = room.pieces.iter().zip(&placements);
            let total = moved.map(|(piece, place)| piece.place.distance(*place)).sum();
            return Some(Mended { placements, total, least: Least::Heuristic });
        };
        let places = violation.movers.iter().filter_map(|p| Some((*p, snap(&mended, *p, going)?)));
        let nearest = places.min_by_key(|(p, place)| mended.pieces[*p].place.distance(*place));
        let (piece, place) = nearest?;
        mended.pieces[piece].place = place;
    }
    None
}

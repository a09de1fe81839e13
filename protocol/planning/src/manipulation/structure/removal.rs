//! Which bundles of a structure can be taken away: the AND/OR search of the disassembly, with its ways out.
//!
//! A bundle is a metamodule, a metamodule with a piece that it holds, or a piece that a further metamodule takes away. What
//! stands afterwards must be stable, and there must be a way out with it as an obstacle. Ways out do not depend on where
//! the other metamodules are: the metamodule reaches a place beside the structure, or the piece one where it rests.

use super::isolation::Isolation;
use super::{Piece, Reason, Structure};
use crate::manipulation::rest::rests;
use crate::manipulation::scene::{Foothold, Hold, NO_SET};
use crate::manipulation::terrain::world_cell;
use crate::manipulation::walking::{Body, WalkingGround, leaves};
use crate::plan::and_or::{Items, RemovalRefusal, Removals};
use metamorph_core::lattice::Cell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Largest number of bundles that one search examines.
pub const MAX_BUNDLES: usize = 20_000;
/// Least distance in connectors, along x or y, from the feet of the structure to a place beside it.
const BESIDE: u16 = 2;

/// How a bundle leaves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Departure {
    /// The metamodule in this seat walks away.
    Walk(usize),
    /// The metamodule in this seat carries this piece away.
    Carry {
        /// The seat.
        seat: usize,
        /// The piece.
        piece: usize,
    },
    /// One of these further metamodules takes this piece over and away.
    Taken {
        /// The piece.
        piece: usize,
        /// Where such a metamodule holds it at its goal.
        holds: Vec<(Hold, u16)>,
    },
}

/// The disassembly of a structure.
pub struct Taking<'a> {
    structure: &'a Structure,
    isolation: Isolation,
    grounds: Vec<WalkingGround<'a>>,
    /// The cache of results, by the standing set and the bundle.
    known: BTreeMap<(Items, Items), Result<Departure, RemovalRefusal<Reason>>>,
}

impl<'a> Taking<'a> {
    /// Creates the disassembly of a structure.
    pub fn new(structure: &'a Structure) -> Taking<'a> {
        let grounds =
            structure.pieces.iter().map(|piece| WalkingGround::new(&piece.scene, |_| true)).collect();
        Taking { structure, isolation: Isolation::new(structure), grounds, known: BTreeMap::new() }
    }

    /// Returns the ground for a piece.
    pub(super) fn ground(&self, piece: usize) -> &WalkingGround<'a> {
        &self.grounds[piece]
    }

    /// Forbids to take a bundle away from what stands, since it cannot be placed there.
    pub(super) fn refute(&mut self, standing: Items, bundle: Items, refusal: RemovalRefusal<Reason>) {
        self.known.insert((standing, bundle), Err(refusal));
    }

    fn examine(&self, standing: Items, bundle: Items) -> Result<Departure, RemovalRefusal<Reason>> {
        let (structure, rest) = (self.structure, standing.without(bundle));
        let proved = |reason| RemovalRefusal { reason, is_proved: true };
        structure.stable(rest).map_err(proved)?;
        let obstacles: BTreeSet<Cell> = structure.cells_of(rest).collect();
        let (seat, piece) = (structure.seats_in(bundle).next(), structure.pieces_in(bundle).next());
        match (seat, piece) {
            (Some(seat), None) => {
                let ends = structure.ends(seat);
                let is_out =
                    |body: &&Body| leaves(&self.grounds[0], &obstacles, **body, |f| structure.is_beside(f));
                let way = ends.iter().find(is_out).map(|_| Departure::Walk(seat));
                way.ok_or(proved(Reason::NoWayOut))
            }
            (Some(seat), Some(piece)) => self.carries(seat, piece, &obstacles),
            (None, Some(piece)) => self.taken(piece, &obstacles),
            (None, None) => Err(proved(Reason::NoWayOut)),
        }
    }

    /// Returns whether the metamodule in a seat can carry a piece away, or can hand it over on the way.
    fn carries(
        &self,
        seat: usize,
        piece: usize,
        obstacles: &BTreeSet<Cell>,
    ) -> Result<Departure, RemovalRefusal<Reason>> {
        let (structure, of) = (self.structure, &self.structure.pieces[piece]);
        let (mut is_held, mut is_proved) = (false, true);
        for (hold, posture) in structure.holds_within(piece, seat) {
            is_held = true;
            match structure.route_to_rest(of, hold, posture, obstacles, &self.grounds[piece]) {
                ToRest::Exists => return Ok(Departure::Carry { seat, piece }),
                ToRest::None => {}
                ToRest::Unknown => is_proved = false,
            }
        }
        let reason = if is_held { Reason::NoCarry } else { Reason::TooHeavy(piece) };
        Err(RemovalRefusal { reason, is_proved })
    }

    /// Returns whether a metamodule that is not part of the structure can take a piece away.
    fn taken(&self, piece: usize, obstacles: &BTreeSet<Cell>) -> Result<Departure, RemovalRefusal<Reason>> {
        let (structure, of) = (self.structure, &self.structure.pieces[piece]);
        let around: BTreeSet<Cell> = obstacles.iter().chain(&of.part.goal).copied().collect();
        let (mut is_proved, mut seen, mut holds) = (of.is_complete, BTreeSet::new(), Vec::new());
        for (hold, posture) in &of.holds {
            let body = Body { foothold: hold.foothold, posture: *posture };
            let cells = of.scene.body(body.foothold, body.posture);
            let is_free = !cells.iter().any(|c| around.contains(c));
            let within = || of.standing(*hold, *posture).within(structure.site.limits);
            if !is_free || !within() {
                continue;
            }
            let key = (hold.foothold, hold.grip, posture);
            if !seen.insert(key) || !leaves(&self.grounds[piece], &around, body, |f| structure.is_beside(f)) {
                continue;
            }
            match structure.route_to_rest(of, *hold, *posture, obstacles, &self.grounds[piece]) {
                ToRest::Exists => holds.push((*hold, *posture)),
                ToRest::None => {}
                ToRest::Unknown => is_proved = false,
            }
        }
        if holds.is_empty() {
            return Err(RemovalRefusal { reason: Reason::NoCarrier, is_proved });
        }
        Ok(Departure::Taken { piece, holds })
    }
}

impl Removals for Taking<'_> {
    type Departure = Departure;
    type Reason = Reason;

    fn bundles(&self, standing: Items) -> Vec<Items> {
        self.structure.bundles(&self.isolation, standing)
    }
    fn remove(&mut self, standing: Items, bundle: Items) -> Result<Departure, RemovalRefusal<Reason>> {
        if let Some(known) = self.known.get(&(standing, bundle)) {
            return known.clone();
        }
        let found = self.examine(standing, bundle);
        self.known.insert((standing, bundle), found.clone());
        found
    }
}

/// Whether a metamodule that holds a piece can bring it to a place where it rests.
enum ToRest {
    Exists,
    /// There is no way.
    None,
    /// There may be one, by hand-overs that are not in the tables.
    Unknown,
}

impl Structure {
    /// Returns the poses in which a metamodule fills a seat; those in which it holds a piece at its goal, if it is to hold one.
    pub(super) fn ends(&self, seat: usize) -> Vec<Body> {
        let held = (0..self.pieces.len()).find(|piece| self.is_bond(*piece, seat));
        let Some(piece) = held else { return self.fillings[seat].clone() };
        let body = |(hold, posture): (Hold, u16)| Body { foothold: hold.foothold, posture };
        let mut ends: Vec<Body> = self.holds_within(piece, seat).map(body).collect();
        ends.sort_unstable_by_key(|b| (b.foothold, b.posture));
        ends.dedup();
        ends
    }

    /// Returns true if a foothold is beside the structure: away from its feet, and not below a piece.
    fn is_beside(&self, foothold: Foothold) -> bool {
        let foot = world_cell(self.scene().pose(foothold), Cell::default());
        let away = |c: &Cell| foot.x.abs_diff(c.x).max(foot.y.abs_diff(c.y)) >= BESIDE;
        let below = |piece: &Piece| piece.part.goal.iter().any(|c| (c.x, c.y) == (foot.x, foot.y));
        self.seats.iter().all(|seat| away(&seat[0])) && !self.pieces.iter().any(below)
    }

    /// Returns true if a piece in these cells rests on the floor, where no metamodule of the structure stands.
    fn is_rest(&self, piece: &Piece, cells: &[Cell]) -> bool {
        let on_feet = |c: &Cell| self.seats.iter().any(|seat| seat.contains(c));
        let floor = |c: Cell| {
            let connectors = self.site.floor.connectors();
            connectors.iter().any(|g| (g.half[0], g.half[1]) == (2 * c.x, 2 * c.y))
        };
        cells == piece.part.start || (!cells.iter().any(on_feet) && rests(cells, floor))
    }

    fn route_to_rest(
        &self,
        piece: &Piece,
        hold: Hold,
        posture: u16,
        obstacles: &BTreeSet<Cell>,
        ground: &WalkingGround<'_>,
    ) -> ToRest {
        let scene = &piece.scene;
        let (carry, pose) = (&scene.carry()[usize::from(hold.grip)], scene.pose(hold.foothold));
        let blocked = carry.set(|cell| {
            let cell = world_cell(pose, cell);
            scene.terrain().is_blocked(cell) || obstacles.contains(&cell)
        });
        let stands = |p: u16| !carry.fills(p).is_some_and(|cells| cells.meets(&blocked));
        let passes = |step: usize| {
            !carry.steps()[step].swept.meets(&blocked)
                && scene.is_within_limits(hold.foothold, hold.grip, step)
        };
        let sets = carry.connected(stands, passes);
        let set = sets.into_iter().find(|set| set.binary_search(&posture).is_ok()).unwrap_or_default();
        let at_rest = |p: &u16| {
            scene.held(hold.foothold, hold.grip, *p).is_some_and(|cells| self.is_rest(piece, &cells))
        };
        if set.iter().any(at_rest) {
            return ToRest::Exists;
        }
        if self.hands_over_to_rest(piece, hold, ground) {
            return ToRest::Exists;
        }
        // A metamodule that cannot move with the piece cannot bring it anywhere. That another one takes it is another bundle.
        if piece.is_complete || set.len() <= 1 { ToRest::None } else { ToRest::Unknown }
    }

    /// Returns true if hand-overs lead from a hold to one in which the piece comes to rest, without other bodies.
    fn hands_over_to_rest(&self, piece: &Piece, from: Hold, ground: &WalkingGround<'_>) -> bool {
        let scene = &piece.scene;
        let comes_to_rest = |hold: &Hold| {
            let sets = scene.holding(hold.foothold, hold.grip);
            let mut of_set = (0..).zip(sets.iter()).filter(|(_, set)| **set == hold.set && **set != NO_SET);
            of_set.any(|(p, _)| {
                scene.held(hold.foothold, hold.grip, p).is_some_and(|cells| self.is_rest(piece, &cells))
            })
        };
        let mut seen = BTreeSet::from([from]);
        let mut open = VecDeque::from([from]);
        while let Some(at) = open.pop_front() {
            if at != from && comes_to_rest(&at) {
                return true;
            }
            open.extend(ground.ways_from(&at).map(|(to, _)| to).filter(|to| seen.insert(*to)));
        }
        false
    }
}

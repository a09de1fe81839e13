//! Connecting cycles (thesis 4.2.2, after Fitch and Butler): a module may leave if its neighbours stay
//! connected without it, over modules that it has locked until it is gone.
//!
//! Neighbours count as connected over a module that touches both, over finalized modules (which never leave
//! and are all connected with each other), or over a route that a search has found. Every route is locked; a lock is
//! denied rather than waited for, so locks cannot deadlock.

use super::Cube;
use super::message::{Ask, Beacon, Message, RequestId, Role};
use super::route::Route;
use crate::counters::Class;
use crate::coverage::{CoveragePoint, hit};
use crate::defects::Defect;
use crate::lattice::Face;
use crate::time::Time;

/// Depths of successive searches, in hops.
const DEPTHS: [u8; 4] = [4, 8, 14, 22];
/// The number of searches remembered, so that each is passed on once.
const MAX_SEEN: usize = 64;
/// The index in `SearchState::part` that stands for all finalized modules; the faces have the indices below it.
const ROOT: usize = 6;

/// Which neighbours of the mover are known to be connected with each other without it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct SearchState {
    /// For each face and for the finalized modules ([`ROOT`]), the number of its connected part.
    part: [u8; 7],
    /// Faces with a neighbour that must stay connected.
    nodes: u8,
    depth: usize,
    /// The routes to be locked. They are locked only when all are found: a module that searches for long
    /// without success must not keep others from leaving.
    routes: Vec<Route>,
}

impl SearchState {
    fn join(&mut self, a: usize, b: usize) -> bool {
        let (keep, drop) = (self.part[a], self.part[b]);
        for part in &mut self.part {
            if *part == drop {
                *part = keep;
            }
        }
        keep != drop
    }
    /// Returns true if all neighbours belong to one part.
    fn is_whole(&self) -> bool {
        let mut parts =
            Face::ALL.into_iter().filter(|f| self.nodes & f.bit() != 0).map(|f| self.part[f.index()]);
        let first = parts.next();
        parts.all(|part| Some(part) == first)
    }
}

impl Cube {
    /// Asks for the locks that keep the neighbours connected. Returns false if a search has to come first.
    pub(super) fn ask_for_cycles(&mut self, now: Time) -> bool {
        let mut state = SearchState { part: [0, 1, 2, 3, 4, 5, 6], nodes: 0, depth: 0, routes: Vec::new() };
        let neighbours: Vec<(Face, Role, u8, u8)> = Face::ALL
            .into_iter()
            .filter_map(|f| match (self.sides.support(f), self.sides.peer(f)) {
                (Some(b), _) => Some((f, b.role, b.supports, b.finals)),
                // A dead finalized module stays where it is, and what hangs on it must not be cut off from
                // it; but it answers no more.
                (None, Some(b)) if b.role == Role::Final => Some((f, b.role, 0, 0)),
                (None, _) if self.view(now).died_finalized(f) => Some((f, Role::Final, 0, 0)),
                _ => None,
            })
            .collect();
        for (face, role, _, finals) in &neighbours {
            state.nodes |= face.bit();
            if *role == Role::Final || *finals != 0 {
                state.join(ROOT, face.index());
            }
            // Every neighbour that could leave is locked, whatever connects it.
            if *role != Role::Final {
                state.routes.extend(Route::new(&[*face]));
            }
        }
        for (u, _, supports, _) in &neighbours {
            for (v, _, back, _) in &neighbours {
                let touches = supports & v.bit() != 0 && back & u.bit() != 0;
                if u < v && v.slot_in(*u).is_some() && touches && state.join(u.index(), v.index()) {
                    state.routes.extend(Route::new(&[*u, *v, u.opposite()]));
                }
            }
        }
        let connected = state.is_whole() || self.own.has(Defect::ShallowSearch);
        if connected {
            self.lock(now, state);
        } else if let Some(attempt) = &mut self.attempt {
            hit(CoveragePoint::CubeSearchStarted);
            attempt.search = Some(state);
            self.search(now);
        }
        connected
    }

    /// Asks for all locks that keep the neighbours connected.
    fn lock(&mut self, now: Time, state: SearchState) {
        for route in state.routes {
            self.ask(now, route, Ask::Lock);
        }
    }

    /// Floods a search from every neighbour that is not known to be connected with the finalized modules. A flood ends
    /// at each module that touches the mover, where another flood may have to continue. So each flood has an id of its
    /// own, and a module can pass on several of them.
    fn search(&mut self, now: Time) {
        let Some(attempt) = &mut self.attempt else { return };
        let Some(state) = &attempt.search else { return };
        let ttl = DEPTHS[state.depth];
        let (origin, token, depth) = (self.own.id, attempt.token, state.depth as u8);
        let root = state.part[ROOT];
        let is_lost = |f: &Face| state.nodes & f.bit() != 0 && state.part[f.index()] != root;
        let from: Vec<Face> = Face::ALL.into_iter().filter(is_lost).collect();
        let p = self.own.params();
        attempt.timeout = now + p.usual_delay * (2 * (u64::from(ttl) + 2)) + p.tick() * 8;
        for face in from {
            let id = RequestId { origin, token, number: depth * 8 + face as u8 };
            if let Some(route) = Route::new(&[face]) {
                self.out.send(&self.sides, face, Class::Connectivity, Message::Search { id, ttl, route });
            }
        }
    }

    /// Repeats the search with the next depth. Returns false if the last depth has been tried, or if there is no
    /// search.
    pub(super) fn widen_search(&mut self, now: Time) -> bool {
        let Some(state) = self.attempt.as_mut().and_then(|a| a.search.as_mut()) else { return false };
        if state.depth + 1 == DEPTHS.len() {
            hit(CoveragePoint::CubeSearchExhausted);
            return false;
        }
        hit(CoveragePoint::CubeSearchWidened);
        state.depth += 1;
        self.search(now);
        true
    }

    pub(super) fn on_search(&mut self, now: Time, from: Face, id: RequestId, ttl: u8, route: Route) {
        let last = route.hop(route.hop_count() - 1).map(Face::opposite);
        // Only modules that are finalized for the same goal hang together.
        let same_goal = |f: Face| self.sides.support(f).is_some_and(|b| b.epoch == self.own.epoch);
        let passes = last == Some(from)
            && id.origin != self.own.id
            && self.own.role != Role::Walker
            && self.moving.is_none()
            && self.attempt.as_ref().is_none_or(|a| a.search.is_some())
            && !self.own.is_quarantined(now)
            && !self.searches.contains(&id)
            && same_goal(from);
        if !passes {
            return;
        }
        if self.searches.len() == MAX_SEEN {
            self.searches.pop_front();
        }
        self.searches.push_back(id);
        let is_root = |b: &Beacon| b.role == Role::Final && b.epoch == self.own.epoch;
        let touches_root = self.own.role == Role::Final
            || Face::ALL.into_iter().any(|f| self.sides.live(f).is_some_and(is_root));
        let touches_origin = Face::ALL
            .into_iter()
            .find(|f| *f != from && self.sides.peer(*f).is_some_and(|b| b.id == id.origin));
        if touches_root || touches_origin.is_some() {
            let back = if touches_root { None } else { touches_origin };
            let hop = route.hop_count() as u8 - 1;
            return self.out.send(
                &self.sides,
                from,
                Class::Connectivity,
                Message::Found { id, hop, back, route },
            );
        }
        if ttl == 0 {
            return;
        }
        for face in Face::ALL.into_iter().filter(|f| *f != from) {
            let on = self.sides.support(face).is_some_and(|b| b.epoch == self.own.epoch);
            if on && let Some(route) = route.then(face) {
                self.out.send(
                    &self.sides,
                    face,
                    Class::Connectivity,
                    Message::Search { id, ttl: ttl - 1, route },
                );
            }
        }
    }

    pub(super) fn on_found(
        &mut self,
        now: Time,
        from: Face,
        id: RequestId,
        hop: u8,
        back: Option<Face>,
        route: Route,
    ) {
        let depth = usize::from(hop);
        if route.hop(depth) != Some(from) {
            return;
        }
        if depth > 0 {
            if let Some(to) = route.hop(depth - 1).map(Face::opposite) {
                let message = Message::Found { id, hop: hop - 1, back, route };
                self.out.send(&self.sides, to, Class::Connectivity, message);
            }
            return;
        }
        let Some(attempt) = self.attempt.as_mut().filter(|a| a.token == id.token && id.origin == self.own.id)
        else {
            return;
        };
        let Some(state) = &mut attempt.search else { return };
        hit(if back.is_none() { CoveragePoint::CubeFoundRoot } else { CoveragePoint::CubeFoundRound });
        let other = back.map_or(ROOT, |f| f.opposite().index());
        if !state.join(from.index(), other) {
            return;
        }
        state.routes.push(route);
        if !state.is_whole() {
            return;
        }
        if let Some(state) = attempt.search.take() {
            // Leases begin now; no lock has been asked for before.
            attempt.deadline = now + self.own.params().start_within();
            self.lock(now, state);
            self.ask_for_destination(now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{Agent, Input};
    use crate::cube::control::Order;
    use crate::cube::message::{Claim, Entry, Rank};
    use crate::cube::params::{Connectivity, Params, Setup};
    use crate::goal::{Goal, Growth};
    use crate::ids::{ModuleId, Port, Session};
    use crate::lattice::Cell;
    use crate::time::Span;

    /// Returns a module in reserve at the origin with a live neighbour in the east and a dead one in the
    /// west.
    fn between(west_was_final: bool) -> Cube {
        let seed = Cell::new(-2, 0, 0);
        let setup = Setup {
            params: Params::scaled(Span::secs(1), Span::millis(10), 100).keeping(Connectivity::Cycles),
            goals: vec![Goal::compile(&[seed, Cell::new(-1, 0, 0)], seed, Growth::Solid).unwrap()],
        };
        let mut cube = Cube::first(setup);
        let (east, west, session) = (Port(Face::East as u8), Port(Face::West as u8), Session(1));
        for port in [east, west] {
            cube.handle(Time::ZERO, Input::Contact { port, session: Some(session) });
        }
        let beacon = Beacon {
            id: ModuleId(1),
            sequence: 1,
            epoch: 0,
            role: Role::Reserve,
            attached: true,
            immobile: false,
            supported_here: false,
            wants_you: false,
            quarantined: false,
            final_hops: Beacon::NO_FINAL,
            supports: Face::West.bit(),
            finals: 0,
            filled: 0,
            rank: Rank { rooted: Time::ZERO, label: 3 },
            renew: Time::ZERO,
            claim: Claim::None,
            ack: None,
            corners: 0,
            subtree: 0,
            field: [Entry::NONE; 4],
        };
        cube.handle(Time::ZERO, Input::Message { port: east, message: Message::Beacon(beacon) });
        let now = Time::ZERO;
        let order = Order::Condemn { port: west, session, epoch: 0, finalized: west_was_final, died: now };
        cube.handle(Time::ZERO, Input::Order(order));
        cube
    }

    /// A module that may let go of a dead neighbour asks whether the others stay connected with it.
    #[test]
    fn modules_that_hang_on_dead_strangers_are_not_cut_off() {
        let now = Time::ZERO;
        assert!(between(false).may_leave(now).is_err(), "the dead neighbour may carry modules");
        let mut cube = between(true);
        assert_eq!(cube.may_leave(now), Ok(()), "it carries no module");
        assert!(!cube.ask_for_cycles(now), "the east is connected over this module alone");
    }
}

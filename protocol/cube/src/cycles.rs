//! Connecting cycles (thesis 4.2.2, after Fitch and Butler): a module may leave if its neighbours stay
//! connected without it, over modules that it has locked until it is gone.
//!
//! Neighbours count as connected over a module that touches both, over finalized modules (which never leave
//! and are all connected with each other), or over a route that a search has found. Every route is locked; a lock is
//! denied rather than waited for, so locks cannot deadlock.
//!
//! A dead neighbour has to stay connected like any other. If it was finalized in the present goal, or touches a finalized
//! module, it is connected with these. Otherwise a search looks for a module that touches it: no route leads over the
//! dead, but the locked module at the end of the route holds the dead one while the mover leaves.

use super::Cube;
use super::message::{Ask, Message, Reached, RequestId, Role};
use super::params::Params;
use super::route::Route;
use super::view::View;
use alloc::vec::Vec;
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::{Span, Time};

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
    /// Those of them with a dead neighbour that is not known to be connected with the finalized modules permanently.
    dead: u8,
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
    /// Returns the faces among `of` whose neighbour is not known to be connected with the finalized modules.
    fn lost(&self, of: u8) -> u8 {
        let is_lost = |f: &Face| of & f.bit() != 0 && self.part[f.index()] != self.part[ROOT];
        Face::mask(Face::ALL.into_iter().filter(is_lost))
    }
    /// Returns true if all neighbours belong to one part.
    fn is_whole(&self) -> bool {
        let mut parts = Face::in_mask(self.nodes).map(|f| self.part[f.index()]);
        let first = parts.next();
        parts.all(|part| Some(part) == first)
    }
}

/// Returns how long a search of this depth waits for answers.
fn search_lasts(p: &Params, depth: u8) -> Span {
    p.usual_delay * (2 * (u64::from(depth) + 2)) + p.tick() * 8
}

impl Params {
    /// Returns how long the searches of one attempt last at most, all depths together.
    pub fn longest_search(&self) -> Span {
        DEPTHS.iter().fold(Span::ZERO, |all, depth| all + search_lasts(self, *depth))
    }
}

impl Cube {
    /// Asks for the locks that keep the neighbours connected. Returns false if a search has to come first.
    pub(super) fn ask_for_cycles(&mut self, now: Time) -> bool {
        let (part, routes) = ([0, 1, 2, 3, 4, 5, 6], Vec::new());
        let mut state = SearchState { part, nodes: 0, dead: 0, depth: 0, routes };
        let v = self.view(now);
        let was_final = |f: Face| v.peer(f).is_some_and(|b| b.role == Role::Final);
        let is_rooted = |f: Face| {
            self.is_dead_root(v, f)
                || (v.has(Defect::RootOfOldGoal) && was_final(f))
                || v.has(Defect::IgnoreDead)
        };
        for face in Face::in_mask(v.sides.certified_mask()).filter(|f| !is_rooted(*f)) {
            state.nodes |= face.bit();
            state.dead |= face.bit();
        }
        let neighbours: Vec<(Face, Role, u8, u8)> = Face::ALL
            .into_iter()
            .filter(|f| state.dead & f.bit() == 0)
            .filter_map(|f| match (v.support(f), v.peer(f)) {
                (Some(b), _) => Some((f, b.role, b.supports, b.finals)),
                // A dead or silent finalized module stays where it is, and what hangs on it must not be cut off
                // from it; but it answers no more.
                (None, Some(b)) if v.is_final(b) => Some((f, b.role, 0, 0)),
                (None, _) if v.sides.is_certified_dead(f) && !v.has(Defect::IgnoreDead) => {
                    Some((f, Role::Final, 0, 0))
                }
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

    /// Returns true if the neighbour on a face is dead and connected with the finalized modules permanently: it was
    /// one of them, or touches one.
    fn is_dead_root(&self, v: View<'_>, face: Face) -> bool {
        v.died_finalized(face) || self.forest.custody().is_fixed(face)
    }

    /// Asks for all locks that keep the neighbours connected.
    fn lock(&mut self, now: Time, state: SearchState) {
        for route in state.routes {
            self.ask(now, route, Ask::Lock);
        }
    }

    /// Floods a search from every neighbour that is not known to be connected with the finalized modules; from all, if that is a
    /// dead one, which answers nothing. A flood ends at each module that touches the mover, where another flood may have to
    /// continue. So each flood has an id of its own, and a module can pass on several of them.
    fn search(&mut self, now: Time) {
        let Some(attempt) = &mut self.attempt else { return };
        let Some(state) = &attempt.search else { return };
        let ttl = DEPTHS[state.depth];
        let (origin, token, depth) = (self.own.id, attempt.token, state.depth as u8);
        let (live, dead) = (state.nodes & !state.dead, state.lost(state.dead));
        let from = if dead != 0 { live } else { state.lost(live) };
        attempt.timeout = now + search_lasts(self.own.params(), ttl);
        for face in Face::in_mask(from) {
            let id = RequestId { origin, token, number: depth * 8 + face as u8 };
            if let Some(route) = Route::new(&[face]) {
                self.pass_on(now, face, |number| Message::Search { id, ttl, dead, route, number });
            }
        }
    }

    /// Sends a message of a search over a face, and repeats it until it is acknowledged.
    fn pass_on(&mut self, now: Time, face: Face, numbered: impl FnOnce(u16) -> Message) {
        if self.sides.is_touching(face) {
            let message = self.retransmission.send(face, now + self.own.params().answer_over(1), numbered);
            self.out.send(&self.sides, face, Class::Connectivity, message);
        }
    }

    /// Acknowledges a message of a search. Returns false if it has come before.
    pub(super) fn acknowledge(&mut self, face: Face, number: u16) -> bool {
        self.out.send(&self.sides, face, Class::Connectivity, Message::Heard { number });
        self.retransmission.hear(face, number)
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

    /// Answers a search or passes it on, with the hops still allowed and the faces of the origin behind which a dead neighbour is
    /// looked for.
    pub(super) fn on_search(
        &mut self,
        now: Time,
        from: Face,
        id: RequestId,
        (ttl, dead): (u8, u8),
        route: Route,
    ) {
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
        let v = self.view(now);
        let is_root = |f: Face| v.live(f).is_some_and(|b| v.is_final(b)) || self.is_dead_root(v, f);
        let touches_root = self.own.role == Role::Final || Face::ALL.into_iter().any(is_root);
        let touches_origin = Face::ALL
            .into_iter()
            .find(|f| *f != from && self.sides.peer(*f).is_some_and(|b| b.id == id.origin));
        let beside = self.dead_beside(route) & dead;
        let mut reached: Vec<Reached> = Vec::new();
        reached.extend(Face::in_mask(beside).map(Reached::Dead));
        let is_answered = touches_root || touches_origin.is_some();
        reached.extend(if touches_root {
            Some(Reached::Root)
        } else {
            touches_origin.map(Reached::Neighbour)
        });
        let hop = route.hop_count() as u8 - 1;
        for reached in reached {
            self.pass_on(now, from, |number| Message::Found { id, hop, reached, route, number });
        }
        let dead = dead & !beside;
        if ttl == 0 || (is_answered && dead == 0) {
            return;
        }
        for face in Face::ALL.into_iter().filter(|f| *f != from) {
            let on = self.sides.support(face).is_some_and(|b| b.epoch == self.own.epoch);
            if on && let Some(route) = route.then(face) {
                let ttl = ttl - 1;
                self.pass_on(now, face, |number| Message::Search { id, ttl, dead, route, number });
            }
        }
    }

    /// Returns the faces of the origin of a route behind which a cell is that this module touches and that holds a module
    /// certified dead.
    fn dead_beside(&self, route: Route) -> u8 {
        let own = route.faces().fold(Cell::default(), |at, f| at.step(f));
        let certified = Face::in_mask(self.sides.certified_mask());
        let faces = certified.filter_map(|f| Cell::default().face_to(own.step(f)));
        Face::mask(faces)
    }

    pub(super) fn on_found(
        &mut self,
        now: Time,
        from: Face,
        id: RequestId,
        hop: u8,
        reached: Reached,
        route: Route,
    ) {
        let depth = usize::from(hop);
        if route.hop(depth) != Some(from) {
            return;
        }
        if depth > 0 {
            if let Some(to) = route.hop(depth - 1).map(Face::opposite) {
                let hop = hop - 1;
                self.pass_on(now, to, |number| Message::Found { id, hop, reached, route, number });
            }
            return;
        }
        let Some(attempt) = self.attempt.as_mut().filter(|a| a.token == id.token && id.origin == self.own.id)
        else {
            return;
        };
        let Some(state) = &mut attempt.search else { return };
        let (point, other) = match reached {
            Reached::Root => (CoveragePoint::CubeFoundRoot, ROOT),
            Reached::Neighbour(face) => (CoveragePoint::CubeFoundRound, face.opposite().index()),
            Reached::Dead(face) => (CoveragePoint::CubeFoundDead, face.index()),
        };
        hit(point);
        if !state.join(from.index(), other) {
            return;
        }
        state.routes.push(route);
        if !state.is_whole() {
            return;
        }
        if let Some(state) = attempt.search.take() {
            // Leases begin now; no lock has been asked for before.
            let motion = attempt.motion;
            let deadline = self.latest_start(now, motion);
            self.attempt.iter_mut().for_each(|attempt| attempt.deadline = deadline);
            self.lock(now, state);
            self.ask_for_destination(now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Order;
    use crate::epoch::Epoch;
    use crate::message::Beacon;
    use crate::params::{Connectivity, Setup};
    use metamorph_core::agent::{Agent, Input};
    use metamorph_core::goal::{Goal, Growth};
    use metamorph_core::ids::{ModuleId, Port, Session, Token};
    use metamorph_core::lattice::{Motion, MotionKind};

    /// Returns a module in reserve at the origin with a live neighbour in the east and a dead one in the
    /// west.
    fn between(west_was_final: bool) -> Cube {
        beside_a_dead_one(west_was_final, None, None)
    }

    /// Returns a module as [`between`] does, with a defect, that heard its neighbour in the west before that died.
    fn beside_a_dead_one(west_was_final: bool, heard: Option<Beacon>, defect: Option<Defect>) -> Cube {
        let seed = Cell::new(-2, 0, 0);
        let params = Params::scaled(Span::secs(1), Span::millis(10), 100).keeping(Connectivity::Cycles);
        let setup = Setup {
            params: Params { defect, ..params },
            goals: vec![Goal::compile(&[seed, Cell::new(-1, 0, 0)], seed, Growth::Solid).unwrap()],
        };
        let mut cube = Cube::first(setup);
        let (east, west, session) = (Port(Face::East as u8), Port(Face::West as u8), Session(1));
        for port in [east, west] {
            cube.handle(Time::ZERO, Input::Contact { port, session: Some(session) });
        }
        let beacon = Beacon { supports: Face::West.bit(), ..Beacon::first(ModuleId(1)) };
        cube.handle(Time::ZERO, Input::Message { port: east, message: Message::Beacon(beacon) });
        if let Some(beacon) = heard {
            cube.handle(Time::ZERO, Input::Message { port: west, message: Message::Beacon(beacon) });
        }
        let now = Time::ZERO;
        let order = Order::Condemn {
            port: west,
            session,
            epoch: Epoch::first(0),
            finalized: west_was_final,
            died: now,
        };
        cube.handle(Time::ZERO, Input::Order(order));
        cube
    }

    const NOW: Time = Time::ZERO;
    const EAST: Port = Port(Face::East as u8);

    /// Begins a motion of a module between two others, and returns the search that it sends to the east.
    fn search_of(cube: &mut Cube) -> (RequestId, u8, Route) {
        assert_eq!(cube.may_leave(NOW), Ok(()));
        cube.sent();
        let motion = Motion { kind: MotionKind::Slide, support: Face::East, heading: Face::North };
        cube.begin_attempt(NOW, motion);
        match cube.sent()[..] {
            [(EAST, Message::Search { id, dead, route, .. })] => (id, dead, route),
            ref other => panic!("{other:?}"),
        }
    }

    /// A module that leaves a dead neighbour asks whether the others stay connected with it: over the finalized modules if it
    /// was one of them, over any other module that touches it otherwise.
    #[test]
    fn dead_neighbours_are_kept_connected() {
        for (was_final, looked_for, reached) in
            [(true, 0, Reached::Root), (false, Face::West.bit(), Reached::Dead(Face::West))]
        {
            let mut cube = between(was_final);
            let (id, dead, route) = search_of(&mut cube);
            assert_eq!(dead, looked_for);
            let found = Message::Found { id, hop: 0, reached, route, number: 0 };
            cube.handle(NOW, Input::Message { port: EAST, message: found });
            let asked = cube.sent();
            let is_lock = |(_, m): &&(Port, Message)| matches!(m, Message::Request { ask: Ask::Lock, .. });
            assert_eq!(asked.iter().filter(is_lock).count(), 2, "the neighbour and the route: {asked:?}");
        }
        let mut ignores = beside_a_dead_one(false, None, Some(Defect::IgnoreDead));
        assert!(ignores.ask_for_cycles(NOW) && !between(false).ask_for_cycles(NOW));
    }

    /// A dead neighbour that said it was finalized, and was not for the goal in which it died, is looked for.
    #[test]
    fn the_finalized_of_an_earlier_goal_are_no_root() {
        let heard = || Some(Beacon { role: Role::Final, ..Beacon::first(ModuleId(2)) });
        let (_, dead, _) = search_of(&mut beside_a_dead_one(false, heard(), None));
        assert_eq!(dead, Face::West.bit());
        let mut trusts = beside_a_dead_one(false, heard(), Some(Defect::RootOfOldGoal));
        let (_, dead, _) = search_of(&mut trusts);
        assert_eq!(dead, 0);
    }

    /// A module answers a search if it touches the dead module that is looked for.
    #[test]
    fn modules_beside_the_dead_answer() {
        let mut cube = between(false);
        cube.sent();
        let id = RequestId { origin: ModuleId(9), token: Token(4), number: 0 };
        // The dead module is in the west. The first origin is to its north.
        for (number, (hops, dead, is_answered)) in (0u16..).zip([
            (&[Face::East, Face::East, Face::South, Face::West][..], Face::South, true),
            (&[Face::East, Face::East, Face::South, Face::West], Face::West, false),
            (&[Face::East, Face::South, Face::West], Face::South, false),
        ]) {
            let route = Route::new(hops).unwrap();
            let message = Message::Search { id, ttl: 3, dead: dead.bit(), route, number };
            cube.searches.clear();
            cube.handle(NOW, Input::Message { port: EAST, message });
            let found = cube.sent().into_iter().any(
                |(_, m)| matches!(m, Message::Found { reached: Reached::Dead(face), .. } if face == dead),
            );
            assert_eq!(found, is_answered, "{hops:?}");
        }
    }
}

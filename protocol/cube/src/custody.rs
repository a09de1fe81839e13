//! Custody of the dead: which module stays for a dead neighbour, so that all others may leave.
//!
//! A dead module may have children, and stays part of the body. As far as its neighbours know, each of them
//! may be its only connection to the rest. One of them is enough, for all the dead that hang together: a module whose path to the
//! finalized modules was confirmed after the death announces that it holds the dead one, and when its path was confirmed
//! ([`CustodyAnnouncement`]). The world-controller, which certifies deaths, forwards the best announcement to all modules
//! that touch the same cluster of dead ones, as far as it is later than the deaths in between. A module lets go if it has
//! announced nothing itself, or if the other was confirmed later than itself ([`CustodyKey`]).
//!
//! *Nothing falls off.* Let a dead module D count on the holder H, over a chain of dead modules that died before H's path was
//! confirmed. The dead do not move, so D hangs together with H. H's path does not lead over the chain, and never will: a dead module
//! passes no confirmation on, and ranks never get worse. That a dead module is registered as a child does not prove this: the
//! registration may be out of date. Follow D's connection to H and along H's path. It ends at a finalized module, or at a module that
//! has let go, or at a dead one. A module that has let go counts on one that was confirmed later. A dead one died after H's
//! path was confirmed, and who holds it was confirmed after that. So times of confirmation rise along the connection, it meets no
//! module twice, and it ends at a finalized module. An order by places alone would not do: H dies, its parent lets go of it because of
//! an early announcement of a module that has let go for H (`Defect::ClusterOrder`).
//!
//! *A finalized holder that touches only other dead modules* holds D as long as the chain between them is dead. The controller says
//! at which time that was certain, and a module lets go for it only if its own path was not confirmed later; otherwise the order
//! may be older than a restart in the chain, after which D counts on this module.
//!
//! *A dead module in a chain restarts.* It touches dead modules that it has not heard, holds them for that reason, and believes nothing
//! about them as long as it stands there ([`believes`]). So it stays, and both parts of the chain hang together over it. If a holder
//! restarts, the same is true of it; if it dies, it stays where it is. Two neighbours in a chain that restart together do not hold each
//! other once one of them has a parent. But that parent's path was confirmed after the restart, so it does not lead over the chain: a
//! module that hangs on dead ones confirms no path later than they were certainly connected, unless the dead one that it touches
//! touches a finalized module itself.
//!
//! An announcement is a fact that stays true for one death and one goal: late, lost and repeated ones cost time only. Only a
//! certificate of death begins custody; silence proves nothing. With connecting cycles only finalized modules announce
//! themselves; any other neighbour of a dead module may leave, once it has locked a cycle that keeps the dead one connected.

use super::control::{CustodyAnnouncement, CustodyKey};
use super::message::Role;
use super::params::Connectivity;
use super::view::View;
use alloc::boxed::Box;
use core::cmp::Reverse;
use core::hash::Hash;
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::Time;

/// A dead neighbour: what its certificate says, and which holders have been announced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Death {
    /// The time after which the neighbour's process did nothing more; it identifies the death.
    died: Time,
    /// When the path of this module was confirmed, as it has announced together with that it holds the neighbour, for the
    /// present goal. Not changed any more after it has let go.
    announced: Option<Time>,
    /// The best other holder that was announced for the present goal.
    other: Option<CustodyKey>,
    /// True if the neighbour touches a finalized module of the present goal, which never leaves: one was announced as its holder, or
    /// its last words name one (`last_words`).
    is_fixed: bool,
    /// When it was last sure that the neighbour hangs together with the finalized modules of the present goal over dead ones.
    connected: Option<Time>,
}

/// Knowledge of a module about the custody of its dead neighbours.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct Custody {
    /// The deaths by face; `None` if there are none, as in nearly all modules.
    deaths: Option<Box<[Option<Death>; 6]>>,
}

impl Custody {
    /// Feeds the deaths into a hash; nothing if there are none.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        for (face, death) in (0u8..).zip(self.deaths.iter().flat_map(|deaths| &**deaths)) {
            if let Some(Death { died, announced, other, is_fixed, connected }) = death {
                (face, died, announced, other, is_fixed, connected).hash(hasher);
            }
        }
    }
    /// Notes that the neighbour on a face is certified dead.
    pub fn begin(&mut self, face: Face, died: Time) {
        let known = &mut self.deaths.get_or_insert_default()[face.index()];
        if known.is_none_or(|death| death.died != died) {
            *known = Some(Death { died, announced: None, other: None, is_fixed: false, connected: None });
        }
    }
    /// Forgets the neighbour on a face, whose contact session has ended.
    pub fn forget(&mut self, face: Face) {
        if let Some(deaths) = &mut self.deaths {
            deaths[face.index()] = None;
            self.deaths.take_if(|deaths| **deaths == [None; 6]);
        }
    }
    fn death(&self, face: Face) -> Option<&Death> {
        self.deaths.as_ref()?[face.index()].as_ref()
    }
    fn death_mut(&mut self, face: Face) -> Option<&mut Death> {
        self.deaths.as_mut()?[face.index()].as_mut()
    }
    /// Forgets all that was announced for an earlier goal.
    pub fn on_goal(&mut self) {
        for death in self.deaths.iter_mut().flat_map(|deaths| deaths.iter_mut()).flatten() {
            (death.announced, death.other) = (None, None);
            (death.is_fixed, death.connected) = (false, None);
        }
    }
    pub fn is_empty(&self) -> bool {
        self.deaths.is_none()
    }
    /// Returns the time of death of the neighbour on a face, if it is certified dead.
    pub fn died(&self, face: Face) -> Option<Time> {
        self.death(face).map(|death| death.died)
    }
    /// Returns true if this module has announced that it holds the neighbour on a face.
    pub fn is_announced(&self, face: Face) -> bool {
        self.death(face).is_some_and(|death| death.announced.is_some())
    }
    /// Returns for each face the time of death of the neighbour, if this module announces that it holds it and has not let go;
    /// zero otherwise. And the time at which its path was confirmed for all these.
    pub fn announced(&self, v: View<'_>) -> ([Time; 6], Time) {
        if self.is_empty() {
            return ([Time::ZERO; 6], Time::ZERO);
        }
        let held = |f: &Face| self.is_announced(*f) && !self.is_released(v, *f);
        let held = Face::mask(Face::ALL.into_iter().filter(held));
        let confirmed = Face::in_mask(held).filter_map(|f| self.death(f)?.announced).min();
        let died = Face::ALL.map(|f| if held & f.bit() != 0 { self.died(f) } else { None });
        (died.map(|died| died.unwrap_or(Time::ZERO)), confirmed.unwrap_or(Time::ZERO))
    }
    /// Returns the place of this module in the order of holders, as it has announced it for the neighbour on a face, unless it
    /// has let go.
    pub fn own(&self, v: View<'_>, face: Face) -> Option<CustodyKey> {
        let confirmed = self.death(face)?.announced.filter(|_| !self.is_released(v, face))?;
        Some(own_key(v, confirmed))
    }
    /// Announces that this module holds the neighbour on a face, and when its path was confirmed. Returns true if it had not
    /// announced it before.
    pub fn announce(&mut self, face: Face, confirmed: Time) -> bool {
        self.death_mut(face).is_some_and(|death| death.announced.replace(confirmed).is_none())
    }

    /// Notes the announcement of another holder. Returns the face of the dead neighbour if the announcement is for the
    /// present goal and for a death that this module knows of.
    pub fn hear(&mut self, v: View<'_>, of: &CustodyAnnouncement) -> Option<Face> {
        if of.epoch != v.own.epoch && !v.has(Defect::EpochWords) {
            return None;
        }
        let face = v.own.cell.face_to(of.dead)?;
        let death = self.death_mut(face)?;
        // Its own announcement in an earlier incarnation is none of another holder.
        let is_other = of.holder.cell != v.own.cell;
        if (death.died != of.died && !v.has(Defect::LetGoOldDeath)) || !is_other {
            return None;
        }
        let key = of.holder;
        let touches = key.cell.manhattan(of.dead) == 1;
        death.is_fixed |= !key.is_loose && touches;
        if !key.is_loose && !touches {
            death.connected = death.connected.max(Some(key.confirmed.0));
        }
        let is_better = |other| ordered(v, key, of.dead) < ordered(v, other, of.dead);
        death.other = death.other.filter(|other| !is_better(*other)).or(Some(key));
        Some(face)
    }

    /// Returns true if the neighbour on a face is known to touch a finalized module.
    pub fn is_fixed(&self, face: Face) -> bool {
        self.death(face).is_some_and(|death| death.is_fixed)
    }

    /// Notes that the neighbour on a face touches a finalized module. Returns true if this is news.
    pub fn set_fixed(&mut self, face: Face) -> bool {
        self.death_mut(face).is_some_and(|death| !core::mem::replace(&mut death.is_fixed, true))
    }

    /// Returns when it was last sure that the neighbour on a face hangs together with the finalized modules over dead ones.
    pub fn connected(&self, face: Face) -> Option<Time> {
        self.death(face)?.connected
    }

    /// Returns true if this module knows of a better holder than itself of the neighbour on a face. A dead module counts on the best
    /// holder that was ever announced. That one lets go only for a better one, so it is never the last to let go.
    pub fn is_released(&self, v: View<'_>, face: Face) -> bool {
        if !believes(v) {
            return false;
        }
        let Some(Death { announced, other: Some(other), .. }) = self.death(face) else { return false };
        let dead = v.own.cell.step(face);
        announced.is_none_or(|confirmed| ordered(v, *other, dead) < ordered(v, own_key(v, confirmed), dead))
    }
}

/// Returns true if a module lets go of dead neighbours because of what others say. A restarted one does not: one of the dead may
/// be connected over it, which it has forgotten.
pub(super) fn believes(v: View<'_>) -> bool {
    !v.own.restarted || v.has(Defect::BelieveAfterRestart)
}

/// Returns the order by which holders of the dead module in a cell are compared.
fn ordered(v: View<'_>, key: CustodyKey, dead: Cell) -> impl Ord + use<> {
    let by_places = CustodyKey { confirmed: Reverse(Time::ZERO), ..key };
    if v.has(Defect::ClusterOrder) { by_places.order_for(dead) } else { key.order_for(dead) }
}

/// Returns the place of this module in the order of holders, if its path was confirmed at `confirmed`.
pub(super) fn own_key(v: View<'_>, confirmed: Time) -> CustodyKey {
    CustodyKey::new(v.own.cell, v.own.role == Role::Final, confirmed, v.own.goal().seed())
}

/// Returns true if modules announce that they hold dead neighbours. With connecting cycles only finalized modules do, which
/// stay in any case; the published gradient knows nothing of the dead.
pub(super) fn is_announced(v: View<'_>) -> bool {
    v.own.connectivity() != Connectivity::Gradient
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::Cube;
    use crate::control::{Order, Status};
    use crate::epoch::{Epoch, Opening};
    use crate::message::{Beacon, Claim, Message, Rank};
    use crate::params::{Params, Setup};
    use metamorph_core::agent::{Agent, Input, Output};
    use metamorph_core::goal::{Goal, Growth};
    use metamorph_core::ids::{ModuleId, Port, Session};
    use metamorph_core::lattice::Cell;
    use metamorph_core::time::Span;

    pub(crate) const PARENT: Face = Face::East;
    pub(crate) const DEAD: Face = Face::West;
    /// When the neighbour dies, in nanoseconds of scenario time.
    pub(crate) const DIED: Time = Time(1_000_000_000);
    /// Faces of the dead module: of two holders that were confirmed at the same time, one on `NEARER` is nearer to the seed than the
    /// module under test, and so better; one on `FARTHER` is worse.
    pub(crate) const NEARER: Face = Face::North;
    const FARTHER: Face = Face::South;

    /// A module in reserve at the origin, with a parent in the east and, in the west, a neighbour that dies
    /// unheard.
    pub(crate) struct Bench {
        pub cube: Cube,
        pub now: Time,
        sequence: u32,
        reports: Vec<Status>,
        beacons: Vec<(Port, Beacon)>,
    }

    impl Bench {
        pub fn new(defect: Option<Defect>) -> Bench {
            let mut bench = Bench::living(defect);
            bench.now = DIED + Span::secs(1);
            bench.condemn(Session(1));
            bench
        }
        /// Returns the module before its neighbour has died.
        pub fn living(defect: Option<Defect>) -> Bench {
            let seed = Cell::new(0, 4, 0);
            let goal = || Goal::compile(&[seed, Cell::new(0, 5, 0)], seed, Growth::Solid).unwrap();
            let mut params = Params::scaled(Span::secs(1), Span::millis(10), 100);
            params.defect = defect;
            let setup = Setup { params, goals: vec![goal(), goal()] };
            let cube = Cube::first(setup);
            let mut bench = Bench { cube, now: Time::ZERO, sequence: 0, reports: vec![], beacons: vec![] };
            for face in [PARENT, DEAD] {
                let (port, session) = (Port(face as u8), Some(Session(1)));
                bench.hand_in(Input::Contact { port, session });
            }
            bench.adopt();
            bench
        }
        pub fn hand_in(&mut self, input: Input<Message, super::super::Percept, Order>) {
            self.cube.handle(self.now, input);
            while let Some(output) = self.cube.poll() {
                match output {
                    Output::Report(status) => self.reports.push(status),
                    Output::Send { port, message: Message::Beacon(beacon), .. } => {
                        self.beacons.push((port, beacon));
                    }
                    _ => {}
                }
            }
        }
        /// Certifies the death of the neighbour.
        pub fn condemn(&mut self, session: Session) {
            let (port, epoch) = (Port(DEAD as u8), Epoch::first(0));
            self.order(Order::Condemn { port, session, epoch, finalized: false, died: DIED });
        }
        pub fn order(&mut self, order: Order) {
            self.hand_in(Input::Order(order));
        }
        /// Lets the neighbour on a face speak.
        pub fn speaks(&mut self, face: Face, rank: Rank, set: impl Fn(&mut Beacon)) {
            self.sequence += 1;
            let (sequence, epoch) = (self.sequence, self.cube.epoch());
            let id = ModuleId(1 + face as u32);
            let mut beacon = Beacon { sequence, epoch, rank, ..Beacon::first(id) };
            set(&mut beacon);
            self.hand_in(Input::Message { port: Port(face as u8), message: Message::Beacon(beacon) });
        }
        /// Lets a further neighbour come.
        pub fn touches(&mut self, face: Face) {
            self.hand_in(Input::Contact { port: Port(face as u8), session: Some(Session(1)) });
        }
        /// Lets the module adopt its parent.
        pub fn adopt(&mut self) {
            let rank = Rank { rooted: Time::ZERO, label: 3 };
            self.speaks(PARENT, rank, |_| {});
            self.now += Span::millis(500);
            self.hand_in(Input::Wake);
            let wants = |(port, b): &(Port, Beacon)| match b.claim {
                Claim::Want(token) if *port == Port(PARENT as u8) => Some(token),
                _ => None,
            };
            let token = self.beacons.iter().find_map(wants).expect("it asks for a parent");
            self.speaks(PARENT, rank, |b| b.ack = Some(token));
            assert_eq!(self.cube.parent(), Some(PARENT));
        }
        /// Lets the module adopt its parent in a further epoch.
        pub fn adopt_again(&mut self) {
            self.beacons.clear();
            self.adopt();
        }
        /// Confirms the parent's path again, later than the death.
        pub fn confirm(&mut self) {
            self.speaks(PARENT, Rank { rooted: DIED + Span(1), label: 3 }, |_| {});
        }
        fn announces(&self, face: Face) -> CustodyAnnouncement {
            self.confirms(face, DIED + Span(1))
        }
        /// Returns the announcement of a holder whose path was confirmed at `confirmed`.
        fn confirms(&self, face: Face, confirmed: Time) -> CustodyAnnouncement {
            let dead = Cell::default().step(DEAD);
            let holder = CustodyKey::new(dead.step(face), false, confirmed, self.cube.own.goal().seed());
            CustodyAnnouncement { dead, died: DIED, epoch: self.cube.epoch(), holder }
        }
        pub fn is_free(&self) -> bool {
            self.cube.may_leave(self.now).is_ok()
        }
        fn has_announced(&self) -> bool {
            self.reports.last().is_some_and(|s| s.custody[DEAD.index()] == DIED)
        }
    }

    #[test]
    fn a_holder_announces_itself_when_its_path_is_confirmed() {
        let mut bench = Bench::new(None);
        assert!(!bench.is_free() && !bench.has_announced());
        let asked = |b: &Bench| b.beacons.iter().any(|(_, beacon)| beacon.renew == DIED + Span(1));
        bench.now += Span::secs(1);
        bench.hand_in(Input::Wake);
        assert!(asked(&bench), "it asks for a path later than the death");
        bench.confirm();
        assert!(bench.has_announced() && !bench.is_free());
        assert!(Bench::new(Some(Defect::LetGoUnproved)).has_announced());
    }

    #[test]
    fn what_the_dead_last_said_is_no_proof() {
        let dies_after = |defect, said: fn(&mut Beacon)| {
            let mut bench = Bench::new(defect);
            let (port, session) = (Port(DEAD as u8), Session(2));
            bench.hand_in(Input::Contact { port, session: Some(session) });
            bench.speaks(DEAD, Rank { rooted: Time::ZERO, label: 5 }, said);
            let is_child = bench.cube.has_child(DEAD);
            bench.condemn(session);
            (is_child, bench.has_announced(), bench.is_free())
        };
        let is_child = |b: &mut Beacon| b.claim = Claim::Parent(metamorph_core::ids::Token(1));
        let is_carried = |b: &mut Beacon| (b.role, b.supported_here) = (Role::Walker, true);
        assert_eq!(dies_after(None, is_child), (true, false, false));
        assert_eq!(dies_after(Some(Defect::ChildProves), is_child), (true, true, false));
        assert_eq!(dies_after(None, is_carried), (false, false, false));
    }

    #[test]
    fn modules_let_go_for_a_better_holder_only() {
        let holder = |defect| {
            let mut bench = Bench::new(defect);
            bench.confirm();
            assert!(bench.has_announced());
            bench
        };
        let is_free = |defect, of: fn(&Bench) -> CustodyAnnouncement| {
            let mut bench = holder(defect);
            bench.order(Order::Custody(of(&bench)));
            bench.is_free()
        };
        let same = |b: &Bench| b.announces(NEARER);
        let earlier = |b: &Bench| b.confirms(NEARER, DIED);
        let later = |b: &Bench| b.confirms(FARTHER, DIED + Span(2));
        assert!(is_free(None, same) && is_free(None, later));
        assert!(!is_free(None, |b| b.announces(FARTHER)), "the other is farther from the seed");
        assert!(!is_free(None, earlier), "the other was confirmed earlier, and may count on this one");
        assert!(is_free(Some(Defect::ClusterOrder), earlier) && !is_free(Some(Defect::ClusterOrder), later));
        let finalized = |b: &Bench| {
            let of = b.announces(FARTHER);
            CustodyAnnouncement { holder: CustodyKey { is_loose: false, ..of.holder }, ..of }
        };
        assert!(is_free(None, finalized), "a finalized holder is better than any other");
        fn apart(b: &Bench, at: Time) -> CustodyAnnouncement {
            let of = b.confirms(FARTHER, at);
            let cell = Cell::new(-3, 0, 0);
            CustodyAnnouncement { holder: CustodyKey { is_loose: false, cell, ..of.holder }, ..of }
        }
        assert!(is_free(None, |b| apart(b, DIED + Span(1))), "it was certain when this path was confirmed");
        assert!(!is_free(None, |b| apart(b, DIED)), "one of the dead in between may have restarted since");
        // Its own announcement, of an earlier incarnation.
        assert!(!is_free(None, |b| b.confirms(DEAD.opposite(), DIED + Span(2))));
    }

    /// A module that has not announced itself has no one who counts on it.
    #[test]
    fn modules_that_have_announced_nothing_let_go_for_any_holder() {
        let mut bench = Bench::new(None);
        bench.order(Order::Custody(bench.announces(FARTHER)));
        assert!(bench.is_free());
    }

    /// Others can let go only for what was confirmed later than they were.
    #[test]
    fn holders_announce_later_confirmations_until_they_let_go() {
        let mut bench = Bench::new(None);
        let confirmed = |b: &Bench| b.reports.last().map(|s| s.confirmed);
        bench.confirm();
        assert_eq!(confirmed(&bench), Some(DIED + Span(1)));
        let confirm_again =
            |bench: &mut Bench, at| bench.speaks(PARENT, Rank { rooted: at, label: 3 }, |_| {});
        confirm_again(&mut bench, DIED + Span(5));
        assert_eq!(confirmed(&bench), Some(DIED + Span(5)));
        bench.order(Order::Custody(bench.confirms(FARTHER, DIED + Span(6))));
        confirm_again(&mut bench, DIED + Span(7));
        assert!(bench.is_free() && !bench.has_announced());
    }

    /// A module that hangs on the dead confirms its path only as late as they were certainly connected.
    #[test]
    fn dead_modules_that_hang_together_with_finalized_ones_are_parents_as_of_a_time() {
        let sure = DIED + Span(5);
        let hangs_on = |distance: i16| {
            let mut bench = Bench::new(None);
            bench.hand_in(Input::Contact { port: Port(PARENT as u8), session: None });
            let of = bench.confirms(NEARER, sure);
            let cell = Cell::new(-1, distance, 0);
            let holder = CustodyKey { is_loose: false, cell, ..of.holder };
            bench.order(Order::Custody(CustodyAnnouncement { holder, ..of }));
            assert_eq!(bench.cube.parent(), Some(DEAD));
            bench.touches(PARENT);
            bench.speaks(PARENT, Rank { rooted: Time::ZERO, label: 3 }, |b| b.renew = sure + Span(1));
            bench.cube.rank().rooted
        };
        assert_eq!(hangs_on(2), sure);
        assert!(hangs_on(1) > sure, "the dead one touches a finalized module");
    }

    #[test]
    fn announcements_count_for_one_death_and_one_goal() {
        let after = |defect, set: fn(&mut CustodyAnnouncement)| {
            let mut bench = Bench::new(defect);
            let mut of = bench.announces(NEARER);
            set(&mut of);
            bench.order(Order::Custody(of));
            bench.is_free()
        };
        assert!(after(None, |_| {}));
        assert!(!after(None, |of| of.died = Time(5)));
        assert!(after(Some(Defect::LetGoOldDeath), |of| of.died = Time(5)));
        let later = |defect| {
            let mut bench = Bench::new(defect);
            let of = bench.announces(NEARER);
            bench.order(Order::Custody(of));
            bench.order(Order::Goal(Opening::of(Epoch::first(1), bench.now)));
            assert!(!bench.is_free());
            bench.adopt_again();
            let before = bench.is_free();
            bench.order(Order::Custody(of));
            (before, bench.is_free())
        };
        assert_eq!(later(None), (false, false));
        assert_eq!(later(Some(Defect::EpochWords)), (false, true));
    }

    #[test]
    fn late_beacons_of_the_dead_end_nothing() {
        let after = |defect| {
            let mut bench = Bench::new(defect);
            bench.confirm();
            assert!(bench.has_announced());
            bench.speaks(DEAD, Rank { rooted: Time::ZERO, label: 2 }, |_| {});
            bench.is_free()
        };
        assert!(!after(None));
        assert!(after(Some(Defect::ForgetSaid)));
    }
}

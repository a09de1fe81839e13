//! Custody of the dead: which module stays for a dead neighbour, so that all others may leave.
//!
//! A dead module may have children, and stays part of the body. As far as its neighbours know, each of them
//! may be its only connection to the rest. One of them is enough: a module whose path to the finalized modules
//! was confirmed after the death announces that it holds the dead one ([`CustodyAnnouncement`]), and a neighbour
//! that hears of a better holder than itself may leave. The order of holders depends on cells and the goal
//! alone, so all modules order them alike, also after a restart.
//!
//! *No circle.* The rank of a holder is better than any rank that the dead module has announced, because the holder's
//! path was confirmed after the death, and ranks never get worse. So the holder's path does not lead over the dead
//! module, and never will. That the dead module is registered as a child does not prove this: the registration may
//! be out of date.
//!
//! *One holder stays.* The best of all modules that have announced themselves would leave only for a better one, so
//! it never does. If it dies, it stays where it is; if it restarts, it touches a dead module that it has never heard,
//! and holds it for that reason.
//!
//! An announcement is a fact that stays true for one death and one goal: late, lost and repeated ones cost
//! time only. The world-controller forwards them. Only a certificate of death begins custody; silence proves
//! nothing. With connecting cycles only finalized modules announce themselves; any other
//! neighbour of a dead module may leave, once it has locked a cycle that keeps the dead one connected.

use super::control::{CustodyAnnouncement, CustodyKey};
use super::message::Role;
use super::params::Connectivity;
use super::view::View;
use alloc::boxed::Box;
use core::hash::Hash;
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::lattice::Face;
use metamorph_core::time::Time;

/// A dead neighbour: what its certificate says, and which holders have been announced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Death {
    /// The time after which the neighbour's process did nothing more; it identifies the death.
    died: Time,
    /// True if this module has announced that it holds the neighbour, for the present goal.
    announced: bool,
    /// The best other holder that was announced for the present goal.
    other: Option<CustodyKey>,
    /// True if a finalized module was announced as a holder for the present goal. It never leaves, so the dead module
    /// stays connected permanently.
    is_fixed: bool,
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
            if let Some(Death { died, announced, other, is_fixed }) = death {
                (face, died, announced, other, is_fixed).hash(hasher);
            }
        }
    }
    /// Notes that the neighbour on a face is certified dead.
    pub fn begin(&mut self, face: Face, died: Time) {
        let known = &mut self.deaths.get_or_insert_default()[face.index()];
        if known.is_none_or(|death| death.died != died) {
            *known = Some(Death { died, announced: false, other: None, is_fixed: false });
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
            (death.announced, death.other, death.is_fixed) = (false, None, false);
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
        self.death(face).is_some_and(|death| death.announced)
    }
    /// Returns for each face the time of death of the neighbour, if this module has announced that it holds it; zero
    /// otherwise.
    pub fn announced(&self) -> [Time; 6] {
        let Some(deaths) = &self.deaths else { return [Time::ZERO; 6] };
        deaths.map(|death| death.filter(|d| d.announced).map_or(Time::ZERO, |d| d.died))
    }
    /// Announces that this module holds the neighbour on a face.
    pub fn announce(&mut self, face: Face) {
        if let Some(death) = self.death_mut(face) {
            death.announced = true;
        }
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
        let is_other = of.holder() != v.own.cell;
        if (death.died != of.died && !v.has(Defect::LetGoOldDeath)) || !is_other {
            return None;
        }
        let key = of.key(v.own.goal().seed());
        death.is_fixed |= !key.is_loose;
        death.other = Some(death.other.map_or(key, |other| other.min(key)));
        Some(face)
    }

    /// Returns true if another module holds the neighbour on a face, and never leaves.
    pub fn is_fixed(&self, face: Face) -> bool {
        self.death(face).is_some_and(|death| death.is_fixed)
    }

    /// Returns true if this module knows of a better holder than itself of the neighbour on a face.
    pub fn is_released(&self, v: View<'_>, face: Face) -> bool {
        let other = self.death(face).and_then(|death| death.other);
        other.is_some_and(|other| other < own_key(v))
    }
}

/// Returns the place of this module in the order of holders.
pub(super) fn own_key(v: View<'_>) -> CustodyKey {
    CustodyKey {
        is_loose: !(v.own.role == Role::Final || v.own.masks.seed),
        distance: v.own.cell.manhattan(v.own.goal().seed()),
        holder: v.own.cell,
    }
}

/// Returns true if modules announce that they hold dead neighbours. With connecting cycles only finalized modules do, which
/// stay in any case; the published gradient knows nothing of the dead.
pub(super) fn is_announced(v: View<'_>) -> bool {
    v.own.connectivity() != Connectivity::Gradient
}

#[cfg(test)]
mod tests {
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

    const PARENT: Face = Face::East;
    const DEAD: Face = Face::West;
    const DIED: Time = Time(1_000_000_000);
    /// Faces of the dead module: a holder on `NEARER` is nearer to the seed than the module under test, and so better;
    /// one on `FARTHER` is worse.
    const NEARER: Face = Face::North;
    const FARTHER: Face = Face::South;

    /// A module in reserve at the origin, with a parent in the east and, in the west, a neighbour that dies
    /// unheard.
    struct Bench {
        cube: Cube,
        now: Time,
        sequence: u32,
        reports: Vec<Status>,
        beacons: Vec<(Port, Beacon)>,
    }

    impl Bench {
        fn new(defect: Option<Defect>) -> Bench {
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
            bench.now = DIED + Span::secs(1);
            bench.condemn(Session(1));
            bench
        }
        fn hand_in(&mut self, input: Input<Message, super::super::Percept, Order>) {
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
        fn condemn(&mut self, session: Session) {
            let (port, epoch) = (Port(DEAD as u8), Epoch::first(0));
            self.order(Order::Condemn { port, session, epoch, finalized: false, died: DIED });
        }
        fn order(&mut self, order: Order) {
            self.hand_in(Input::Order(order));
        }
        /// Lets the neighbour on a face speak.
        fn speaks(&mut self, face: Face, rank: Rank, set: impl Fn(&mut Beacon)) {
            self.sequence += 1;
            let (sequence, epoch) = (self.sequence, self.cube.epoch());
            let id = ModuleId(1 + face as u32);
            let mut beacon = Beacon { sequence, epoch, rank, ..Beacon::first(id) };
            set(&mut beacon);
            self.hand_in(Input::Message { port: Port(face as u8), message: Message::Beacon(beacon) });
        }
        /// Lets the module adopt its parent.
        fn adopt(&mut self) {
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
        /// Confirms the parent's path again, later than the death.
        fn confirm(&mut self) {
            self.speaks(PARENT, Rank { rooted: DIED + Span(1), label: 3 }, |_| {});
        }
        fn announces(&self, face: Face) -> CustodyAnnouncement {
            let dead = Cell::default().step(DEAD);
            CustodyAnnouncement { dead, died: DIED, epoch: self.cube.epoch(), face, is_final: false }
        }
        fn is_free(&self) -> bool {
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
        let mut bench = Bench::new(None);
        bench.order(Order::Custody(bench.announces(FARTHER)));
        assert!(!bench.is_free(), "the other is farther from the seed");
        // Its own announcement, of an earlier incarnation.
        let own = CustodyAnnouncement { is_final: true, ..bench.announces(DEAD.opposite()) };
        bench.order(Order::Custody(own));
        assert!(!bench.is_free());
        bench.order(Order::Custody(bench.announces(NEARER)));
        assert!(bench.is_free());
        let mut bench = Bench::new(None);
        bench.order(Order::Custody(CustodyAnnouncement { is_final: true, ..bench.announces(FARTHER) }));
        assert!(bench.is_free(), "a finalized holder is better than any other");
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
            bench.beacons.clear();
            bench.adopt();
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

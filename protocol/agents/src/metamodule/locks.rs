//! Locks on the cells of a motion, each with a lease.
//!
//! A metamodule asks all neighbours in range and moves once all have granted. A request is answered at once,
//! and a denied attempt is given up, so locks cannot deadlock. A grant ends with its lease. The lease of the
//! holder runs from its request on, so it always ends first, whatever the message delay.
//!
//! Two metamodules whose motions meet ask each other, and the one that is asked refuses or gives its own attempt up. That keeps them
//! apart even if grants are forgotten; a grant that is remembered saves attempts, and protects what a body still does for an
//! earlier life of its agent.

use super::message::{Denial, Message, Rank};
use super::motions::Sweep;
use super::neighbour_table::slot;
use super::phase::Phase;
use super::plan::Plan;
use super::pose::Pose;
use super::setup::Setup;
use super::view::View;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::ids::{ModuleId, Port, PortSet, Token};
use metamorph_core::lattice::Cell;
use metamorph_core::rng::Rng;
use metamorph_core::time::{Span, Time};
use std::cmp::Reverse;

/// A lock granted to a neighbour. The digest hashes its fields in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Grant {
    /// The attempt of the neighbour.
    pub token: Token,
    /// The pose in which its motion begins.
    pub pose: Pose,
    pub sweep: Sweep,
    /// The posture at the end of the motion.
    pub ends: u16,
    /// When the lease ends.
    pub until: Time,
}

/// The locks of the neighbour on one port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
struct PortLocks {
    grant: Option<Grant>,
    /// The latest attempt that is over. Requests of it or of earlier ones are late copies.
    over: Token,
}

/// The locks that a metamodule has granted, by port. Grows with the highest port in use.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct LockTable(Vec<PortLocks>);

impl LockTable {
    /// Clears a port at the start of a contact: another neighbour is there now.
    pub fn begin(&mut self, port: Port) {
        *slot(&mut self.0, port) = PortLocks::default();
    }
    pub fn grant_of(&self, port: Port) -> Option<&Grant> {
        self.0.get(port.index())?.grant.as_ref()
    }
    /// Returns the latest attempt of the neighbour on a port that is over.
    pub fn over(&self, port: Port) -> Token {
        self.0.get(port.index()).map_or(Token(0), |slot| slot.over)
    }
    /// Iterates over all grants, by port.
    pub fn iter(&self) -> impl Iterator<Item = (Port, &Grant)> {
        self.0.iter().enumerate().filter_map(|(i, slot)| Some((Port(i as u8), slot.grant.as_ref()?)))
    }
    /// Iterates over the cells granted to neighbours.
    pub fn cells<'a>(&'a self, setup: &'a Setup) -> impl Iterator<Item = Cell> + 'a {
        self.iter().flat_map(|(_, g)| setup.lock_cells(g.pose, g.sweep, g.ends))
    }
    pub fn grant(&mut self, port: Port, grant: Grant) {
        if let Some(slot) = self.0.get_mut(port.index()) {
            slot.grant = Some(grant);
        }
    }
    /// Drops the grant of a neighbour that is dead.
    pub fn revoke(&mut self, port: Port) {
        if let Some(slot) = self.0.get_mut(port.index()) {
            slot.grant = None;
        }
    }
    /// Ends an attempt of a neighbour and all earlier ones. Returns true if a grant has ended.
    pub fn release(&mut self, port: Port, token: Token) -> bool {
        let Some(slot) = self.0.get_mut(port.index()) else { return false };
        slot.over = slot.over.max(token);
        slot.grant.take_if(|g| g.token <= token).is_some()
    }
    /// Drops grants whose lease has ended. Returns when the next one ends.
    pub fn expire(&mut self, now: Time) -> Time {
        let mut next = Time::NEVER;
        for slot in &mut self.0 {
            if slot.grant.take_if(|g| g.until <= now).is_some() {
                hit(CoveragePoint::MetaGrantExpired);
            }
            next = slot.grant.map_or(next, |g| next.min(g.until));
        }
        next
    }
}

/// A neighbour's request for a lock.
#[derive(Clone, Copy)]
pub(super) struct Request {
    pub origin: ModuleId,
    pub token: Token,
    pub rank: Rank,
    pub age: Span,
    pub pose: Pose,
    pub sweep: Sweep,
    pub ends: u16,
}

impl Request {
    fn precedence(&self) -> Precedence {
        (self.rank, Reverse(self.age), self.origin)
    }
}

/// Order of attempts that lock the same cells: the attempt with the least value wins.
pub(super) type Precedence = (Rank, Reverse<Span>, ModuleId);

/// The answer to a request.
pub(super) enum Verdict {
    Granted,
    /// Granted on condition that this metamodule gives up its own attempt, which ranks lower.
    GrantedBefore,
    Denied(Denial),
}

/// Decides whether a neighbour is granted all cells of a motion. `own` is the precedence of this metamodule's
/// own attempt.
pub(super) fn judge(v: View<'_>, phase: &Phase, own: Precedence, request: &Request) -> Verdict {
    if v.has(Defect::GrantEverything) {
        return Verdict::Granted;
    }
    if v.now < v.own.quarantine_until && !v.has(Defect::GrantAfterRestart) {
        return Verdict::Denied(Denial::Quarantined);
    }
    let asked = || v.setup.lock_cells(request.pose, request.sweep, request.ends);
    let meets = |cells: &[Cell]| asked().any(|c| cells.contains(&c));
    let crosses = |plan: &Plan| {
        let cells: Vec<Cell> = plan.cells(v.setup).collect();
        meets(&cells)
    };
    // An element that both hold belongs to neither.
    let occupied: Vec<Cell> = v.setup.occupied(v.own.pose).collect();
    if meets(&occupied) {
        return Verdict::Denied(Denial::Occupied);
    }
    match phase {
        Phase::Moving(_) if v.has(Defect::ForgetLocks) => Verdict::Granted,
        Phase::Moving(motion) if crosses(&motion.plan) => Verdict::Denied(Denial::Held),
        Phase::Asking(attempt) if crosses(&attempt.plan) => {
            if own < request.precedence() {
                Verdict::Denied(Denial::Younger)
            } else {
                Verdict::GrantedBefore
            }
        }
        Phase::Idle { .. } | Phase::Asking(_) | Phase::Moving(_) => Verdict::Granted,
    }
}

/// The asking side of the locks: the state of this metamodule's attempts.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Requester {
    /// The number of the latest attempt.
    pub token: Token,
    /// When the metamodule last made progress; of equal ranks the longest wait goes first.
    pub waiting_since: Time,
    /// The time before which no further attempt is made.
    pub rest_until: Time,
    /// The neighbour that denied last, or that has precedence.
    pub waits_for: Option<ModuleId>,
    /// Number of attempts denied because two bodies would have met.
    pub prevented: u32,
    pub rng: Rng,
}

impl Requester {
    pub fn precedence(&self, v: View<'_>, rank: Rank) -> Precedence {
        (rank, Reverse(v.now.since(self.waiting_since)), v.own.id)
    }
    /// Draws the time until the next attempt, from `least` to twice as much.
    pub fn back_off(&mut self, least: Span) -> Span {
        least + Span(self.rng.below(least.0 + 1))
    }
    /// Returns the request for a motion.
    pub fn request(&self, v: View<'_>, rank: Rank, plan: &Plan) -> Message {
        Message::Request {
            origin: v.own.id,
            token: self.token,
            rank,
            age: v.now.since(self.waiting_since),
            pose: plan.from,
            sweep: plan.sweep,
            ends: plan.ends,
        }
    }
    /// Returns the ports of the neighbours whose consent a motion needs: live ones that may move.
    pub fn ports_to_ask(v: View<'_>) -> PortSet {
        if v.has(Defect::AskNone) {
            return PortSet::default();
        }
        let may_move = |s: &super::message::State| !v.stays(s) && !v.neighbours.is_dead(s.id);
        v.neighbours.states().filter(|(_, s)| may_move(s)).map(|(port, _)| port).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_roombots::grid::GridState;

    fn grant(token: u32, until: u64) -> Grant {
        let pose = Pose::standing(GridState::new(0, 0, 0), 0);
        Grant { token: Token(token), pose, sweep: Sweep(1), ends: 0, until: Time(until) }
    }

    #[test]
    fn a_grant_ends_by_release_lease_or_session() {
        let (a, b) = (Port(0), Port(1));
        let mut locks = LockTable::default();
        locks.begin(a);
        locks.begin(b);
        let held = |locks: &LockTable| locks.iter().map(|(port, g)| (port.0, g.token.0)).collect::<Vec<_>>();
        locks.grant(a, grant(5, 10));
        locks.grant(b, grant(7, 20));
        // A release of an earlier attempt ends no grant.
        assert!(!locks.release(a, Token(4)));
        assert_eq!((locks.over(a), held(&locks)), (Token(4), vec![(0, 5), (1, 7)]));
        assert_eq!(locks.expire(Time(9)), Time(10));
        assert_eq!(locks.expire(Time(10)), Time(20));
        assert_eq!(held(&locks), [(1, 7)]);
        // A release that comes after the end of the lease still outdates the request.
        assert!(!locks.release(a, Token(5)));
        assert!(locks.release(b, Token(8)));
        assert_eq!((locks.over(a), locks.over(b), held(&locks)), (Token(5), Token(8), vec![]));
        assert_eq!(locks.expire(Time(30)), Time::NEVER);
        // Death ends the grant, and late copies remain late; a new session begins again.
        locks.grant(b, grant(9, 40));
        locks.revoke(b);
        assert_eq!((locks.over(b), held(&locks)), (Token(8), vec![]));
        locks.begin(b);
        assert_eq!(locks.over(b), Token(0));
    }
}

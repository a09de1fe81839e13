//! The part that worlds of bodies share: actions under way, contacts, percepts, failures and violations.

use crate::world::invariants::{Invariant, Violation};
use metamorph_core::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_core::ratio::Ratio;
use metamorph_core::rng::Rng;
use metamorph_core::runtime::{Contact, Sensed};
use metamorph_core::time::Time;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::hash::{Hash, Hasher};

/// The ports of a body. `C` holds a contact for each.
#[derive(Clone, Debug, Hash)]
pub struct Ports<C> {
    /// The incarnation of the process that the body belongs to.
    pub incarnation: Incarnation,
    /// Counts the changes of contacts.
    pub revision: Revision,
    /// The contact of each port.
    pub contacts: C,
}

impl<C> Ports<C> {
    /// Returns the ports of a body whose process has not been restarted.
    pub fn new(contacts: C) -> Ports<C> {
        Ports { incarnation: Incarnation(0), revision: Revision(0), contacts }
    }
    /// Returns this end of a contact, as the peer sees it.
    pub fn end(&self, session: Session, peer: ModuleId, peer_port: Port) -> Contact {
        Contact { session, peer, peer_incarnation: self.incarnation, peer_port }
    }
}

fn joints(seed: u64) -> Rng {
    Rng::named(seed, "joints", 0)
}

/// Actions under way and what bodies sensed. `P` is the percept of a body.
#[derive(Clone, Debug)]
pub struct BodyQueue<P> {
    due: BinaryHeap<Reverse<(Time, u64, ModuleId)>>,
    /// The number of actions begun, which orders those that end at the same time.
    begun: u64,
    sensed: VecDeque<(ModuleId, Sensed<P>)>,
    sessions: u32,
    failure: Ratio,
    joints: Rng,
    violations: Vec<Violation>,
}

impl<P> BodyQueue<P> {
    /// Creates an empty queue. The seed is that of the run.
    pub fn new(seed: u64) -> BodyQueue<P> {
        BodyQueue {
            due: BinaryHeap::new(),
            begun: 0,
            sensed: VecDeque::new(),
            sessions: 0,
            failure: Ratio::ZERO,
            joints: joints(seed),
            violations: Vec::new(),
        }
    }

    /// Begins an action of a body that ends at `until`.
    #[inline]
    pub fn begin(&mut self, until: Time, id: ModuleId) {
        self.begun += 1;
        self.due.push(Reverse((until, self.begun, id)));
    }
    /// Returns when the next action ends.
    #[inline]
    pub fn next_end(&self) -> Time {
        self.due.peek().map_or(Time::NEVER, |Reverse((at, _, _))| *at)
    }
    /// Removes the next action that ends at or before `now`, in the order in which they end and began.
    #[inline]
    pub fn pop(&mut self, now: Time) -> Option<(Time, ModuleId)> {
        self.due.peek().filter(|Reverse((at, _, _))| *at <= now)?;
        self.due.pop().map(|Reverse((at, _, id))| (at, id))
    }
    /// Returns when the action of a body ends, if it acts.
    pub fn acting_until(&self, id: ModuleId) -> Option<Time> {
        self.due.iter().find(|Reverse((_, _, of))| *of == id).map(|Reverse((at, _, _))| *at)
    }
    /// Sets the probability of failures.
    pub fn set_failure(&mut self, failure: Ratio) {
        self.failure = failure;
    }
    /// Draws failures from another seed.
    pub fn reseed(&mut self, seed: u64) {
        self.joints = joints(seed);
    }
    /// Draws whether a joint or a connection fails.
    pub fn draw_failure(&mut self) -> bool {
        self.joints.chance(self.failure)
    }
    /// Returns the probability of failures, and what they are drawn from.
    pub fn chances(&mut self) -> (Ratio, &mut Rng) {
        (self.failure, &mut self.joints)
    }

    /// Lets a body sense something.
    #[inline]
    pub fn perceive(&mut self, id: ModuleId, percept: P) {
        self.sensed.push_back((id, Sensed::Percept(percept)));
    }
    /// Returns what a body sensed, in order.
    #[inline]
    pub fn poll(&mut self) -> Option<(ModuleId, Sensed<P>)> {
        self.sensed.pop_front()
    }
    /// Opens a contact session.
    pub fn open_session(&mut self) -> Session {
        self.sessions += 1;
        Session(self.sessions)
    }
    /// Changes a contact of a body, which hears of it if `tell`.
    pub fn set_contact<C: AsMut<[Option<Contact>]>>(
        &mut self,
        (id, ports): (ModuleId, &mut Ports<C>),
        port: Port,
        contact: Option<Contact>,
        tell: bool,
    ) {
        ports.contacts.as_mut()[port.index()] = contact;
        ports.revision.0 += 1;
        if tell {
            self.sensed.push_back((id, Sensed::Contact { port, revision: ports.revision, contact }));
        }
    }
    /// Starts a process in a body. Returns true if it is a later incarnation, whose contacts need new sessions. The first one
    /// hears of all contacts: their sessions are as old as the world.
    pub fn start<C: AsRef<[Option<Contact>]>>(
        &mut self,
        (id, ports): (ModuleId, &mut Ports<C>),
        incarnation: Incarnation,
    ) -> bool {
        if std::mem::replace(&mut ports.incarnation, incarnation) != incarnation {
            return true;
        }
        for (i, contact) in ports.contacts.as_ref().iter().enumerate().filter(|(_, c)| c.is_some()) {
            let (port, revision, contact) = (Port(i as u8), ports.revision, *contact);
            self.sensed.push_back((id, Sensed::Contact { port, revision, contact }));
        }
        false
    }

    /// Notes a broken invariant.
    pub fn violate(&mut self, invariant: Invariant, at: Time, what: String) {
        self.violations.push(Violation { invariant, at, what });
    }
    /// Returns the invariants broken since the last call.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        std::mem::take(&mut self.violations)
    }
}

/// The state that later events depend on. Actions are fed in the order in which they end, independently of the layout of the
/// heap.
impl<P> Hash for BodyQueue<P> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let mut due: Vec<_> = self.due.iter().map(|Reverse(due)| *due).collect();
        due.sort_unstable();
        let due: Vec<(Time, ModuleId)> = due.into_iter().map(|(at, _, id)| (at, id)).collect();
        (due, self.sessions, &self.joints).hash(state);
    }
}

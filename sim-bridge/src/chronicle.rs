//! Records what reaches a world and a director, and what they say: wrappers of both that write a
//! journal, for any driver. Runs without a journal do without the wrappers.
//!
//! Absent: what agents do (drivers record that, where inputs are handed in), and files.

use crate::direct::{Command, Direct};
use crate::faults::{Fault, Struck};
use crate::invariants::Violation;
use crate::sim::{Agents, Audited};
use crate::world::{Contact, Sensed, World};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::journal::{Blob, Event, Outside, Record, Sensation, Sink, Touch, Wanted, Who};
use metamorph_protocol::time::Time;
use std::cell::RefCell;
use std::rc::Rc;

/// Where all records of a driver go.
pub type Log = Rc<RefCell<dyn Sink>>;

fn put(log: &Log, at: Time, event: Event) {
    log.borrow_mut().put(&Record { at, who: Who::Controller, event });
}

/// What a body senses, as it is recorded.
pub fn sensation<A: Agent>(sensed: &Sensed<A::Percept>) -> Sensation {
    match sensed {
        Sensed::Contact { port, revision, contact } => {
            Sensation::Contact { port: *port, revision: *revision, contact: contact.map(touch) }
        }
        Sensed::Percept(percept) => Sensation::Percept(Blob::of(percept)),
    }
}

fn touch(contact: Contact) -> Touch {
    let Contact { session, peer, peer_incarnation, peer_port } = contact;
    Touch { session, peer, peer_life: peer_incarnation, peer_port }
}

/// A command, as it is recorded.
pub fn wanted<A: Agent>(command: &Command<A::Order>) -> Wanted {
    match command {
        Command::Kill(id) => Wanted::Kill(*id),
        Command::Pause(id) => Wanted::Pause(*id),
        Command::Resume(id) => Wanted::Resume(*id),
        Command::Restart(id) => Wanted::Restart(*id),
        Command::Order(id, order) => Wanted::Order(*id, Blob::of(order)),
        Command::Finish => Wanted::Finish,
    }
}

/// A fault that has struck, as it is recorded.
pub fn struck(struck: &Struck) -> Event {
    let cell = match struck.fault {
        Fault::Block(cell) | Fault::Unblock(cell) => Some(cell),
        _ => None,
    };
    Event::Struck {
        fault: struck.fault.to_string(),
        module: struck.fault.module(),
        cell,
        effect: struck.effect.clone(),
    }
}

/// A world that writes down what happens to it.
pub struct RecordedWorld<W: World> {
    inner: W,
    log: Log,
    now: Time,
    /// Where each body was last said to stand.
    places: Vec<Blob>,
}

impl<W: World> RecordedWorld<W> {
    /// Records everything from here on.
    pub fn new(inner: W, log: Log) -> RecordedWorld<W> {
        let places = (0..inner.len() as u32).map(|id| Blob::of(&inner.place(ModuleId(id)))).collect();
        RecordedWorld { inner, log, now: Time::ZERO, places }
    }
    /// The world itself.
    pub fn inner(&self) -> &W {
        &self.inner
    }
    /// The world itself, when the run is over.
    pub fn into_inner(self) -> W {
        self.inner
    }

    fn put(&self, event: Event) {
        put(&self.log, self.now, event);
    }
    fn put_violations<'v>(&self, found: impl IntoIterator<Item = &'v Violation>) {
        for Violation { invariant, at, what } in found {
            let event = Event::Violated { invariant: invariant.name().to_owned(), what: what.clone() };
            put(&self.log, *at, event);
        }
    }
}

impl<W: World> World for RecordedWorld<W> {
    type Agent = W::Agent;

    fn len(&self) -> usize {
        self.inner.len()
    }
    fn place(&self, id: ModuleId) -> <W::Agent as Agent>::Place {
        self.inner.place(id)
    }
    fn start(&mut self, now: Time, id: ModuleId, life: Incarnation) {
        self.now = now;
        self.put(Event::Start { id, life, place: Blob::of(&self.inner.place(id)) });
        self.inner.start(now, id, life);
    }
    fn act(&mut self, now: Time, id: ModuleId, revision: Revision, action: &<W::Agent as Agent>::Action) {
        self.now = now;
        self.put(Event::Act { id, revision, action: Blob::of(action) });
        self.inner.act(now, id, revision, action);
    }
    fn next_event(&self) -> Time {
        self.inner.next_event()
    }
    fn advance(&mut self, now: Time) {
        self.now = now;
        // Without anything due, this changes nothing.
        if self.inner.next_event() <= now {
            self.put(Event::Advance);
        }
        self.inner.advance(now);
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<<W::Agent as Agent>::Percept>)> {
        let (id, sensed) = self.inner.poll()?;
        self.put(Event::Sensed { id, sensed: sensation::<W::Agent>(&sensed) });
        if matches!(sensed, Sensed::Percept(_)) {
            let place = Blob::of(&self.inner.place(id));
            if self.places[id.index()] != place {
                self.places[id.index()].clone_from(&place);
                self.put(Event::Placed { id, place });
            }
        }
        Some((id, sensed))
    }
}

impl<W: Audited> Audited for RecordedWorld<W> {
    fn audit_agent(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, W::Agent>,
        found: &mut Vec<Violation>,
    ) {
        let before = found.len();
        self.inner.audit_agent(now, id, agents, found);
        self.put_violations(&found[before..]);
    }
    fn audit_action(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, W::Agent>,
        found: &mut Vec<Violation>,
    ) {
        let before = found.len();
        self.inner.audit_action(now, id, agents, found);
        self.put_violations(&found[before..]);
    }
    fn audit_all(&mut self, now: Time, agents: &Agents<'_, W::Agent>, found: &mut Vec<Violation>) {
        let before = found.len();
        self.inner.audit_all(now, agents, found);
        self.put_violations(&found[before..]);
    }
    fn take_violations(&mut self) -> Vec<Violation> {
        let found = self.inner.take_violations();
        self.put_violations(&found);
        found
    }
}

/// A director that writes down what it hears and wants.
pub struct RecordedDirector<D> {
    inner: D,
    log: Log,
    now: Time,
    struck: usize,
}

impl<D> RecordedDirector<D> {
    /// Records everything from here on.
    pub fn new(inner: D, log: Log) -> RecordedDirector<D> {
        RecordedDirector::after(inner, log, 0)
    }
    /// The same for one of whose faults so many have been recorded.
    pub fn after(inner: D, log: Log, struck: usize) -> RecordedDirector<D> {
        RecordedDirector { inner, log, now: Time::ZERO, struck }
    }
    /// The director itself.
    pub fn inner(&self) -> &D {
        &self.inner
    }
    /// The director itself, when the run is over.
    pub fn into_inner(self) -> D {
        self.inner
    }

    fn put(&mut self, now: Time, event: Event) {
        self.now = now;
        put(&self.log, now, event);
    }
    /// Records the faults that have struck since the last call.
    fn put_struck<W: World>(&mut self, now: Time)
    where
        D: Direct<W>,
    {
        let new: Vec<Event> = self.inner.struck().iter().skip(self.struck).map(struck).collect();
        self.struck += new.len();
        new.into_iter().for_each(|event| self.put(now, event));
    }
}

impl<W: World, D: Direct<W>> Direct<RecordedWorld<W>> for RecordedDirector<D> {
    fn report(&mut self, now: Time, id: ModuleId, report: <W::Agent as Agent>::Report) {
        self.put(now, Event::Report { id, report: Blob::of(&report) });
        self.inner.report(now, id, report);
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.put(now, Event::Died { id });
        self.inner.died(now, id);
    }
    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &RecordedWorld<W>) {
        self.put(now, Event::External { id, what: what.clone() });
        self.inner.external(now, id, what, &world.inner);
        self.put_struck::<W>(now);
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        self.put(now, Event::Started { id });
        self.inner.started(now, id);
    }
    fn wake(&mut self, now: Time, world: &mut RecordedWorld<W>) {
        self.put(now, Event::Wake);
        self.inner.wake(now, &mut world.inner);
        self.put_struck::<W>(now);
    }
    fn wake_at(&self) -> Time {
        self.inner.wake_at()
    }
    fn poll(&mut self) -> Option<Command<<W::Agent as Agent>::Order>> {
        let command = self.inner.poll()?;
        let (now, event) = (self.now, Event::Command(wanted::<W::Agent>(&command)));
        self.put(now, event);
        Some(command)
    }
    fn struck(&self) -> &[Struck] {
        self.inner.struck()
    }
    fn commit(&mut self) {
        self.log.borrow_mut().commit();
    }
}

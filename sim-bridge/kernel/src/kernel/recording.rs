//! Records the inputs and outputs of a world and a director: wrappers of both that write a journal, for any
//! driver. Runs without a journal do without the wrappers.
//!
//! Absent: steps of agents (the agent host records those), and files.

use crate::director::faults::{Fault, FaultRecord, Target};
use crate::director::port::DirectorPort;
use crate::director::rescue::Rescue;
use crate::kernel::audited::{Agents, Audited};
use crate::world::World;
use crate::world::invariants::Violation;
use metamorph_core::agent::Agent;
use metamorph_core::ids::{Incarnation, ModuleId, Revision};
use metamorph_core::record::{Blob, Event, Outside, Record, Sink, Who};
use metamorph_core::runtime::{Command, Sensed};
use metamorph_core::time::Time;
use std::collections::VecDeque;
use std::hash::Hasher;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The destination of all records of a driver, shared by everything that writes them.
#[derive(Clone)]
pub struct Log(Arc<Mutex<dyn Sink + Send>>);

impl Log {
    /// Creates a log that writes to this sink.
    pub fn new(sink: Arc<Mutex<impl Sink + Send + 'static>>) -> Log {
        Log(sink)
    }
    /// Returns the sink, locked. A run is driven by one thread at a time, so nothing waits for it for long.
    pub fn lock(&self) -> MutexGuard<'_, dyn Sink + Send + 'static> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn put(log: &Log, at: Time, event: Event) {
    log.lock().put(&Record { at, who: Who::Controller, event });
}

/// Converts the record of a fault to an event.
pub fn struck(struck: &FaultRecord) -> Event {
    let cell = match struck.fault {
        Fault::World(_, Target::Cell(cell)) => Some(cell),
        _ => None,
    };
    Event::Injected {
        fault: struck.fault.to_string(),
        module: struck.fault.module(),
        cell,
        by: struck.by.to_string(),
        effect: struck.effect.clone(),
    }
}

/// A world that records its inputs and outputs.
pub struct RecordedWorld<W: World> {
    inner: W,
    log: Log,
    now: Time,
    /// Inputs that bodies sensed, taken from the world in order to see which actions ended, and not polled yet.
    sensed: VecDeque<Emitted<W>>,
}

type Emitted<W> = (ModuleId, Sensed<<<W as World>::Agent as Agent>::Percept>);

impl<W: World> RecordedWorld<W> {
    /// Starts recording.
    pub fn new(inner: W, log: Log) -> RecordedWorld<W> {
        let mut world = RecordedWorld { inner, log, now: Time::ZERO, sensed: VecDeque::new() };
        world.collect();
        world
    }
    /// Returns the world itself.
    pub fn inner(&self) -> &W {
        &self.inner
    }
    /// Returns the world itself, at the end of the run.
    pub fn into_inner(self) -> W {
        self.inner
    }

    fn put(&self, event: Event) {
        put(&self.log, self.now, event);
    }
    /// Takes everything sensed from the world, and returns the modules whose actions ended, in order.
    fn collect(&mut self) -> Vec<ModuleId> {
        let first = self.sensed.len();
        self.sensed.extend(std::iter::from_fn(|| self.inner.poll()));
        let new = self.sensed.iter().skip(first);
        new.filter(|(_, sensed)| matches!(sensed, Sensed::Percept(_))).map(|(id, _)| *id).collect()
    }
    fn put_violations<'v>(&self, found: impl IntoIterator<Item = &'v Violation>) {
        for Violation { invariant, at, what } in found {
            let event = Event::Violated { invariant: invariant.name.to_owned(), what: what.clone() };
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
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation) {
        self.now = now;
        self.put(Event::Start { id, incarnation, place: Blob::of(&self.inner.place(id)) });
        self.inner.start(now, id, incarnation);
    }
    fn act(&mut self, now: Time, id: ModuleId, revision: Revision, action: &<W::Agent as Agent>::Action) {
        self.now = now;
        self.collect();
        self.inner.act(now, id, revision, action);
        // A refused action is answered at once.
        let begun = !self.collect().contains(&id);
        self.put(Event::Act { id, revision, action: Blob::of(action), begun });
    }
    fn next_event(&self) -> Time {
        self.inner.next_event()
    }
    fn advance(&mut self, now: Time) {
        self.now = now;
        self.collect();
        // If no event is due, this changes nothing.
        let due = self.inner.next_event() <= now;
        self.inner.advance(now);
        if due {
            let ended = self.collect();
            let place = |id| (id, Blob::of(&self.inner.place(id)));
            let ended = ended.into_iter().map(place).collect();
            self.put(Event::Advance { ended });
        }
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        self.inner.digest(hasher);
    }
    // The driver records changes.
    fn reseed(&mut self, seed: u64) {
        self.inner.reseed(seed);
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<<W::Agent as Agent>::Percept>)> {
        self.collect();
        let (id, sensed) = self.sensed.pop_front()?;
        self.put(Event::Sensed { id, sensed: sensed.map(Blob::of) });
        Some((id, sensed))
    }
}

impl<W: Audited> Audited for RecordedWorld<W> {
    fn audit_agent(
        &mut self,
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

/// A director that records its inputs and outputs.
pub struct RecordedDirector<D> {
    inner: D,
    log: Log,
    now: Time,
    struck: usize,
}

impl<D> RecordedDirector<D> {
    /// Starts recording.
    pub fn new(inner: D, log: Log) -> RecordedDirector<D> {
        RecordedDirector::after(inner, log, 0)
    }
    /// Starts recording for a director of which the first `struck` faults have been recorded.
    pub fn after(inner: D, log: Log, struck: usize) -> RecordedDirector<D> {
        RecordedDirector { inner, log, now: Time::ZERO, struck }
    }
    /// Returns the director itself.
    pub fn inner(&self) -> &D {
        &self.inner
    }
    /// Returns the director itself, at the end of the run.
    pub fn into_inner(self) -> D {
        self.inner
    }

    fn put(&mut self, now: Time, event: Event) {
        self.now = now;
        put(&self.log, now, event);
    }
    /// Records the faults injected since the last call.
    fn put_struck<W: World>(&mut self, now: Time)
    where
        D: DirectorPort<W>,
    {
        let new: Vec<Event> = self.inner.struck().iter().skip(self.struck).map(struck).collect();
        self.struck += new.len();
        new.into_iter().for_each(|event| self.put(now, event));
    }
}

impl<W: World, D: DirectorPort<W>> DirectorPort<RecordedWorld<W>> for RecordedDirector<D> {
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
    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        // A refused input has no effect, so it is no part of the run.
        self.inner.input(now, kind, bytes)?;
        self.put(now, Event::Input { kind: kind.to_owned(), bytes: bytes.to_owned() });
        Ok(())
    }
    fn reseed(&mut self, seed: u64) {
        self.inner.reseed(seed);
    }
    fn set_rescue(&mut self, level: Rescue) {
        self.inner.set_rescue(level);
    }
    fn wake_at(&self) -> Time {
        self.inner.wake_at()
    }
    fn poll(&mut self) -> Option<Command<<W::Agent as Agent>::Order>> {
        let command = self.inner.poll()?;
        let (now, event) = (self.now, Event::Command(command.map(Blob::of)));
        self.put(now, event);
        Some(command)
    }
    fn struck(&self) -> &[FaultRecord] {
        self.inner.struck()
    }
    fn commit(&mut self) {
        self.log.lock().commit();
    }
}

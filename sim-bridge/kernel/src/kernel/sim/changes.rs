//! Changes of a run at its events.

use super::bodies::Stream;
use super::module::Process;
use super::{Sim, Step};
use crate::director::port::DirectorPort;
use crate::kernel::audited::Audited;
use crate::kernel::change::{Change, ChangeKind};
use metamorph_core::ids::ModuleId;
use metamorph_core::record::{Event, MessageName, Record, Who};
use metamorph_core::rng::Rng;
use metamorph_core::time::{Span, Time};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The changes of a run: those still to come, and those in force.
#[derive(Clone, Default)]
pub(super) struct Changes {
    /// The number of events so far.
    pub events: u64,
    /// The time of the last of them. The present may be later, if nothing has happened since.
    last: Time,
    coming: VecDeque<Change>,
    /// Messages that do not arrive.
    lost: BTreeSet<MessageName>,
    /// Modules whose process sleeps, by the number of the sleep.
    asleep: BTreeMap<u32, ModuleId>,
    /// The number of sleeps so far.
    sleeps: u32,
}

impl Changes {
    /// Returns true if a message does not arrive.
    pub fn loses(&self, name: impl FnOnce() -> Option<MessageName>) -> bool {
        !self.lost.is_empty() && name().is_some_and(|name| self.lost.contains(&name))
    }
    /// Takes note that something else has stopped, continued, ended or started a process: a change no longer ends its sleep.
    pub fn wakes_no_longer(&mut self, id: ModuleId) {
        self.asleep.retain(|_, asleep| *asleep != id);
    }
}

impl<W: Audited, D: DirectorPort<W>> Sim<W, D> {
    /// Plans changes, which take effect in the order of their events. Those that are due are carried out at once.
    pub fn plan_changes(&mut self, mut changes: Vec<Change>) {
        changes.sort_by_key(|change| change.after);
        self.changes.coming = changes.into();
        self.make_changes();
    }

    /// Changes the run now. Returns the change: a run with it in its plan takes the same events.
    pub fn change(&mut self, kind: ChangeKind) -> Change {
        let change = Change { after: self.changes.events, kind };
        self.carry_out_change(change);
        change
    }

    /// Returns the number of events so far.
    pub fn events(&self) -> u64 {
        self.changes.events
    }

    /// Counts an event, and carries out the changes that follow it.
    pub(super) fn count_event(&mut self) -> Step {
        self.changes.events += 1;
        self.changes.last = self.now;
        if !self.changes.coming.is_empty() {
            self.make_changes();
        }
        Step::Done
    }

    fn make_changes(&mut self) {
        while self.changes.coming.front().is_some_and(|change| change.after <= self.changes.events) {
            let change = self.changes.coming.pop_front();
            change.into_iter().for_each(|change| self.carry_out_change(change));
        }
    }

    fn carry_out_change(&mut self, change: Change) {
        if let Some(log) = &self.log {
            let event = Event::Changed { change: change.to_string() };
            log.lock().put(&Record { at: self.changes.last, who: Who::Controller, event });
        }
        if let Some(seed) = change.seed(self.config.seed) {
            self.renew_links(seed);
            if matches!(change.kind, ChangeKind::All(_)) {
                self.renew_others(seed);
            }
        }
        match change.kind {
            ChangeKind::Links(_) | ChangeKind::All(_) => {}
            ChangeKind::Rescue(level) => self.director.set_rescue(level),
            ChangeKind::Lose(name) => drop(self.changes.lost.insert(name)),
            ChangeKind::Sleep(id, span) => self.send_to_sleep(id, span),
        }
    }

    fn send_to_sleep(&mut self, id: ModuleId, span: Span) {
        if let Some(module) = self.modules.get_mut(id.index()).filter(|m| m.process == Process::Running) {
            module.process = Process::Stopped;
            let sleep = self.changes.sleeps;
            self.changes.sleeps += 1;
            self.changes.asleep.insert(sleep, id);
            self.trace.event(self.changes.last, 6, id.0, 0);
            // A sleep that is over by now ends now.
            self.queue.push((self.changes.last + span).max(self.now), super::Event::Awake(sleep));
        }
    }

    /// Ends a sleep, unless something else has stopped, continued, ended or started the process since.
    pub(super) fn awake(&mut self, sleep: u32) {
        if let Some(id) = self.changes.asleep.remove(&sleep) {
            self.resume(id);
        }
    }

    fn renew_links(&mut self, seed: u64) {
        for (i, module) in self.modules.iter_mut().enumerate() {
            module.rng = Rng::named(seed, "link", i as u64);
        }
        if let Some(hosts) = &mut self.hosts {
            Stream::renew(&mut hosts.streams, seed, "hosts");
        }
        if let Some(controller) = &mut self.controller {
            Stream::renew(&mut controller.streams, seed, "controller link");
        }
    }

    fn renew_others(&mut self, seed: u64) {
        self.births = seed;
        let living = self.modules.iter_mut().filter(|module| module.is_alive());
        living.filter_map(|module| module.agent.as_mut()).for_each(|agent| agent.reseed(seed));
        self.world.reseed(seed);
        self.director.reseed(seed);
    }
}

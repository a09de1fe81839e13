//! Changes of a run at its events.

use super::bodies::Stream;
use super::{Sim, Step};
use crate::director::port::DirectorPort;
use crate::kernel::audited::Audited;
use crate::kernel::change::{Change, ChangeKind};
use metamorph_core::record::{Event, Record, Who};
use metamorph_core::rng::Rng;
use std::collections::VecDeque;

/// The changes of a run that are still to come.
#[derive(Clone, Default)]
pub(super) struct Changes {
    /// The number of events so far.
    pub events: u64,
    coming: VecDeque<Change>,
}

impl<W: Audited, D: DirectorPort<W>> Sim<W, D> {
    /// Plans changes, in the order of their events. Those that are due are carried out at once.
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
            log.lock().put(&Record { at: self.now, who: Who::Controller, event });
        }
        if let Some(seed) = change.seed(self.config.seed) {
            self.renew_links(seed);
            if matches!(change.kind, ChangeKind::All(_)) {
                self.renew_others(seed);
            }
        }
        if let ChangeKind::Rescue(level) = change.kind {
            self.director.set_rescue(level);
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

//! Audits of a simulated run, and the hashes by which two runs are compared.

use super::Sim;
use crate::director::port::DirectorPort;
use crate::kernel::audited::{Agents, Audited};
use crate::kernel::sim::module::Waiting;
use crate::kernel::state::{self, Hashes, Held};
use crate::world::invariants::{self, MESSAGES_BALANCE, TIME_PASSES, Violation};
use metamorph_core::host::AgentHost;

/// The largest number of violations kept; a broken protocol makes many, and the first ones suffice for a
/// diagnosis.
const MAX_VIOLATIONS: usize = 100;

/// The result of all checks of a run.
#[derive(Clone, Default)]
pub(super) struct Findings {
    violations: Vec<Violation>,
    broken: u64,
    pub checked: u64,
}

impl Findings {
    pub fn note(&mut self, violation: Violation) {
        self.broken += 1;
        if self.violations.len() < MAX_VIOLATIONS {
            self.violations.push(violation);
        }
    }
    /// Returns the first violations, and the number of all.
    pub fn violations(&self) -> (&[Violation], u64) {
        (&self.violations, self.broken)
    }
}

impl<W: Audited, D: DirectorPort<W>> Sim<W, D> {
    /// Counts the inputs of an instant, and ends a run in which time does not advance: it would never end by itself.
    pub(super) fn count_input(&mut self) {
        let (at, inputs) = self.instant;
        self.instant = (self.now, if at == self.now { inputs + 1 } else { 1 });
        if self.finished {
            return;
        }
        if let Err(what) = self.time_passes() {
            self.findings.note(Violation { invariant: TIME_PASSES, at: self.now, what });
            self.finished = true;
        }
    }

    pub(super) fn time_passes(&self) -> Result<(), String> {
        invariants::time_passes(self.instant.1, self.modules.len())
    }

    pub(super) fn audit_all(&mut self) {
        self.findings.checked += 1;
        let (agents, mut found) = (Agents::of(&self.modules), Vec::new());
        self.world.audit_all(self.now, &agents, &mut found);
        found.extend(self.world.take_violations());
        if let Err(what) = invariants::messages_balance(&self.tally, &self.in_flight()) {
            found.push(Violation { invariant: MESSAGES_BALANCE, at: self.now, what });
        }
        found.into_iter().for_each(|v| self.findings.note(v));
    }

    /// Returns the number of messages of each class that are under way, or unread at a stopped module.
    fn in_flight(&self) -> invariants::PerClass {
        let mut of = invariants::PerClass::default();
        self.parcels.iter().for_each(|(_, parcel)| of[parcel.class.index()] += 1);
        for waiting in self.backlogs.values().flat_map(|b| &b.waiting) {
            if let Waiting::Message(parcel) = waiting {
                of[parcel.class.index()] += 1;
            }
        }
        of
    }

    /// Returns the hash of the current state of all agents.
    pub fn agents_hash(&self) -> u64 {
        state::agents_hash(self.modules.iter().map(|m| Held {
            is_alive: m.is_alive(),
            incarnation: m.incarnation,
            agent: m.agent.as_ref().map(AgentHost::agent),
        }))
    }

    /// Returns the hashes of the current state and of the sampled states. Independent of how the run was
    /// sliced.
    pub fn hashes(&self) -> Hashes {
        let (agents, world) = (self.agents_hash(), state::world_hash(&self.world));
        let mut states = self.states.clone();
        states.fold(self.trace.events(), agents, world);
        Hashes { states: states.value(), agents, world }
    }

    pub(super) fn look_at_states(&mut self) {
        let (agents, world) = (self.agents_hash(), state::world_hash(&self.world));
        self.states.fold(self.trace.events(), agents, world);
    }
}

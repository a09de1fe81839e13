//! The invariants of metamodules that only agents and world together show.

use crate::invariants::{self, Invariant, Violation};
use crate::metamodule_world::MetamoduleWorld;
use crate::sim::{Agents, Audited};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::time::Time;

fn locks(now: Time, id: ModuleId, agents: &Agents<'_, Metamodule>, found: &mut Vec<Violation>) {
    let mut mine: Vec<Cell> = agents.get(id).into_iter().flat_map(|a| a.held(now)).collect();
    if mine.is_empty() {
        return;
    }
    mine.sort_unstable();
    for (other, agent) in agents.iter().filter(|(o, _)| *o != id) {
        if let Err(what) = invariants::one_holder_per_lock(&mine, agent.held(now)) {
            let what = format!("{id} and {other}: {what}");
            found.push(Violation { invariant: Invariant::OneHolderPerLock, at: now, what });
        }
    }
}

impl Audited for MetamoduleWorld {
    fn audit_agent(&self, _: Time, _: ModuleId, _: &Agents<'_, Metamodule>, _: &mut Vec<Violation>) {
        // Locks change hands with actions, which are audited one by one.
    }

    fn audit_action(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, Metamodule>,
        found: &mut Vec<Violation>,
    ) {
        locks(now, id, agents, found);
    }

    fn audit_all(&mut self, now: Time, agents: &Agents<'_, Metamodule>, found: &mut Vec<Violation>) {
        self.check_all(now);
        for (id, _) in agents.iter() {
            locks(now, id, agents, found);
        }
    }

    fn take_violations(&mut self) -> Vec<Violation> {
        MetamoduleWorld::take_violations(self)
    }
}

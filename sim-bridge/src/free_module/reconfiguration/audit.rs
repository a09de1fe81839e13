//! Invariants of free modules that involve agents and the world.

use super::invariants::{BRANCH_LOCKED, branch_locked};
use super::world::FreeModuleWorld;
use metamorph_kernel::kernel::audited::{Agents, Audited};
use metamorph_kernel::world::invariants::{MOVE_WITHIN_LEASE, Violation, move_within_lease};
use metamorph_protocol::free_module::reconfiguration::LatticeModule;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Time;

impl Audited for FreeModuleWorld {
    // Locks matter when a turn begins.
    fn audit_action(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, LatticeModule>,
        found: &mut Vec<Violation>,
    ) {
        // Without one the action has been refused, or is not a turn.
        let Some(moving) = self.carried_by(id) else { return };
        let Some(until) = self.acting_until(id).filter(|until| now + self.setup().turn_time == *until) else {
            return;
        };
        let mut add = |invariant, what| {
            let what = format!("module {id}: {what}");
            found.push(Violation { invariant, at: now, what });
        };
        // The dead do nothing, and the restarted keep still by themselves.
        let still = moving.iter().map(|m| ModuleId(*m as u32)).map(|other| {
            let local = agents.clock(other).local(now);
            (other, agents.get(other).is_none_or(|agent| agent.keeps_still_for(local, id)))
        });
        if let Err(what) = branch_locked(still) {
            add(BRANCH_LOCKED, what);
        }
        if let Some(agent) = agents.get(id) {
            let locked_until = agent.locked_until().map(|at| agents.clock(id).global(at));
            if let Err(what) = move_within_lease(now, until.since(now), locked_until) {
                add(MOVE_WITHIN_LEASE, what);
            }
        }
    }

    fn audit_all(&mut self, now: Time, _: &Agents<'_, LatticeModule>, _: &mut Vec<Violation>) {
        self.check_all(now);
    }

    fn take_violations(&mut self) -> Vec<Violation> {
        FreeModuleWorld::take_violations(self)
    }
}

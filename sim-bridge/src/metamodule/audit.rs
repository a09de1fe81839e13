//! Invariants of metamodules that involve agents and the world.

use crate::metamodule::invariants::{HeldCells, ONE_HOLDER_PER_LOCK, one_holder_per_lock};
use crate::metamodule::world::MetamoduleWorld;
use metamorph_kernel::kernel::audited::{Agents, Audited};
use metamorph_kernel::world::World;
use metamorph_kernel::world::invariants::{MOVE_WITHIN_LEASE, Violation, move_within_lease};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::time::Time;

/// Checks that no cell locked by metamodule `id` is also locked by another, or taken by another body. A body may
/// complete an action that its process asked for before it died, and takes the swept cells until then.
fn locks(
    world: &MetamoduleWorld,
    now: Time,
    id: ModuleId,
    agents: &Agents<'_, Metamodule>,
    found: &mut Vec<Violation>,
) {
    let held = |id| agents.get(id).into_iter().flat_map(move |a| a.held(agents.clock(id).local(now)));
    let Some(mine) = HeldCells::of(held(id)) else { return };
    for other in (0..world.len() as u32).map(ModuleId).filter(|o| *o != id) {
        let theirs = held(other).chain(world.taken(other).iter().copied());
        if let Err(what) = one_holder_per_lock(&mine, theirs) {
            let what = format!("{id} and {other}: {what}");
            found.push(Violation { invariant: ONE_HOLDER_PER_LOCK, at: now, what });
        }
    }
}

impl Audited for MetamoduleWorld {
    // Locks change hands with actions, which are audited one by one.
    fn audit_action(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, Metamodule>,
        found: &mut Vec<Violation>,
    ) {
        locks(self, now, id, agents, found);
        // A refused action has not begun.
        if let Some((agent, until)) = agents.get(id).zip(self.acting_until(id)) {
            let takes = until.since(now);
            let locked_until = agent.locked_until().map(|at| agents.clock(id).global(at));
            if let Err(what) = move_within_lease(now, takes, locked_until) {
                let what = format!("module {id}: {what}");
                found.push(Violation { invariant: MOVE_WITHIN_LEASE, at: now, what });
            }
        }
    }

    fn audit_all(&mut self, now: Time, agents: &Agents<'_, Metamodule>, found: &mut Vec<Violation>) {
        self.check_all(now);
        for (id, _) in agents.iter() {
            locks(self, now, id, agents, found);
        }
    }

    fn take_violations(&mut self) -> Vec<Violation> {
        MetamoduleWorld::take_violations(self)
    }
}

//! Invariants of cubes that involve agents and the world.

use crate::cube::invariants::{
    self, FIELD_LOOP_FREE, FINAL_GROWS, LANDING_STAYS, MOVER_HAS_NO_DEPENDANTS, MOVES_ALONE, PARENT_DESCENDS,
    RESERVED_ONCE,
};
use crate::cube::world::CubeWorld;
use metamorph_kernel::kernel::audited::{Agents, Audited};
use metamorph_kernel::world::World;
use metamorph_kernel::world::invariants::{Invariant, MOVE_WITHIN_LEASE, Violation, move_within_lease};
use metamorph_protocol::cube::epoch::Epoch;
use metamorph_protocol::cube::message::{Rank, Role};
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::cube::{Cube, Successor};
use metamorph_protocol::ids::{ModuleId, Revision};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::time::{Span, Time};

impl CubeWorld {
    pub(super) fn neighbour(&self, id: ModuleId, face: Face) -> Option<ModuleId> {
        self.body_at(self.cell(id).step(face))
    }

    fn parent_descends(
        &self,
        now: Time,
        cube: &Cube,
        id: ModuleId,
        agents: &Agents<'_, Cube>,
    ) -> Result<(), String> {
        // A stopped process does not know yet that its body has arrived elsewhere.
        if cube.role() != Role::Reserve || cube.cell() != self.cell(id) {
            return Ok(());
        }
        let Some(face) = cube.parent() else { return Ok(()) };
        let Some((parent_id, parent)) = self.neighbour(id, face).and_then(|p| Some((p, agents.get(p)?)))
        else {
            return Ok(());
        };
        // A restarted parent, or one of another goal, has to learn of its children again; until then it does
        // not leave. A finalized one never does.
        let learning = parent.is_listening(agents.clock(parent_id).local(now))
            || parent.is_unlabelled()
            || parent.epoch() != cube.epoch()
            || !parent.has_heard(face.opposite());
        if learning || parent.role() == Role::Final {
            return Ok(());
        }
        invariants::parent_descends(cube.rank(), parent.rank(), parent.has_child(face.opposite()))
    }

    fn final_grows(&self, cube: &Cube, id: ModuleId, agents: &Agents<'_, Cube>) -> Result<(), String> {
        if cube.role() != Role::Final {
            return Ok(());
        }
        // A dead neighbour may have been finalized, and so may one that has gone on to a later goal; its
        // former role is not known any more.
        let may_be = |a: &Cube| a.role() == Role::Final || a.has_restarted() || a.epoch() > cube.epoch();
        let finals = Face::ALL
            .into_iter()
            .filter_map(|f| self.neighbour(id, f))
            .filter(|n| agents.get(*n).is_none_or(may_be))
            .count();
        invariants::final_grows(cube.is_root(), finals)
    }

    /// Follows the attraction field from a face, as long as the successor has the same source and version.
    fn field_loop_free(&self, id: ModuleId, face: Face, agents: &Agents<'_, Cube>) -> Result<(), String> {
        // A stopped process does not know yet that its body has arrived elsewhere: its distances are those of
        // its old cell.
        let settled = |id: ModuleId| agents.get(id).filter(|a| a.cell() == self.cell(id));
        let next = |(id, face): (ModuleId, Face)| {
            let (entry, successor, heard) = settled(id)?.attraction(face);
            if !entry.is_known() || entry.distance == 0 {
                return None;
            }
            let successor = match successor? {
                Successor::Own(other) => (id, other),
                Successor::Beside { heading, same_cell } => {
                    let beside = self.neighbour(id, heading)?;
                    if same_cell {
                        (self.neighbour(beside, face)?, heading.opposite())
                    } else {
                        (beside, face)
                    }
                }
            };
            let agent = settled(successor.0)?;
            // A module that came later is not the one that was followed, which has left.
            let settled_at = agents.clock(successor.0).global(agent.settled());
            if settled_at > agents.clock(id).global(heard) {
                return None;
            }
            let (theirs, ..) = agent.attraction(successor.1);
            (theirs.source == entry.source && theirs.version == entry.version && theirs.is_known())
                .then_some(successor)
        };
        invariants::field_loop_free((id, face), 6 * self.len() + 1, next)
    }
}

/// All that the check of [`PARENT_DESCENDS`] reads of one module. As long as it is unchanged for the module and its
/// neighbours, so is the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AuditKey {
    rank: Rank,
    cell: Cell,
    /// The contacts of the body, and so its neighbours.
    revision: Revision,
    epoch: Epoch,
    role: Role,
    parent: Option<Face>,
    heard: u8,
    children: u8,
    is_listening: bool,
    is_unlabelled: bool,
    /// True if the agent knows the cell that its body is in.
    is_home: bool,
}

impl CubeWorld {
    /// Returns the key of a module at time `now` of its clock.
    fn audit_key(&self, now: Time, cube: &Cube, id: ModuleId) -> AuditKey {
        AuditKey {
            rank: cube.rank(),
            cell: self.cell(id),
            revision: self.revision(id),
            epoch: cube.epoch(),
            role: cube.role(),
            parent: cube.parent(),
            heard: cube.heard_faces(),
            children: cube.child_faces(),
            is_listening: cube.is_listening(now),
            is_unlabelled: cube.is_unlabelled(),
            is_home: cube.cell() == self.cell(id),
        }
    }

    /// Checks a module against its parent and its children, if anything has changed that the check reads. A
    /// debug build checks in any case, and compares.
    fn audit_forest_by_key(
        &mut self,
        now: Time,
        cube: &Cube,
        id: ModuleId,
        agents: &Agents<'_, Cube>,
        found: &mut Vec<Violation>,
    ) {
        let key = self.audit_key(agents.clock(id).local(now), cube, id);
        if self.is_audited(id, &key) {
            debug_assert_eq!(self.unsound(now, cube, id, agents), [], "{id} was taken to be sound");
            return;
        }
        let unsound = self.unsound(now, cube, id, agents);
        if unsound.is_empty() {
            return self.note_audit(id, key);
        }
        // Both ends of a broken relation are checked until it is sound.
        self.forget_audit(id);
        for (child, parent, what) in unsound {
            self.forget_audit(child);
            self.forget_audit(parent);
            note(found, PARENT_DESCENDS, now, child, Err(what));
        }
    }

    /// Returns the broken relations of a module with its parent and its children, as child, parent and what
    /// is wrong.
    fn unsound(
        &self,
        now: Time,
        cube: &Cube,
        id: ModuleId,
        agents: &Agents<'_, Cube>,
    ) -> Vec<(ModuleId, ModuleId, String)> {
        let mut unsound = Vec::new();
        if let Err(what) = self.parent_descends(now, cube, id, agents) {
            let parent = cube.parent().and_then(|f| self.neighbour(id, f));
            unsound.push((id, parent.unwrap_or(id), what));
        }
        for face in Face::ALL {
            let Some(child) = self.neighbour(id, face) else { continue };
            let Some(agent) = agents.get(child).filter(|a| a.parent() == Some(face.opposite())) else {
                continue;
            };
            if !self.is_moving(child)
                && let Err(what) = self.parent_descends(now, agent, child, agents)
            {
                unsound.push((child, id, what));
            }
        }
        unsound
    }
}

pub(super) fn note(
    found: &mut Vec<Violation>,
    invariant: Invariant,
    at: Time,
    id: ModuleId,
    check: Result<(), String>,
) {
    if let Err(what) = check {
        found.push(Violation { invariant, at, what: format!("module {id}: {what}") });
    }
}

impl Audited for CubeWorld {
    fn audit_agent(
        &mut self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, Cube>,
        found: &mut Vec<Violation>,
    ) {
        let Some(cube) = agents.get(id) else { return };
        if cube.connectivity() == Connectivity::Forest {
            if self.is_moving(id) {
                self.forget_audit(id);
            } else {
                self.audit_forest_by_key(now, cube, id, agents, found);
            }
        }
        if cube.connectivity() == Connectivity::Forest {
            self.audit_custody(now, id, agents, found);
        }
        if cube.granted() > 1 {
            note(found, RESERVED_ONCE, now, id, invariants::reserved_once(&cube.reservations()));
        }
    }

    fn audit_action(&self, now: Time, id: ModuleId, agents: &Agents<'_, Cube>, found: &mut Vec<Violation>) {
        // Only moves that have begun are checked.
        let (Some(cube), Some(landing)) = (agents.get(id), self.landing(id)) else { return };
        if cube.role() == Role::Reserve {
            let check = invariants::mover_has_no_dependants(cube.children());
            note(found, MOVER_HAS_NO_DEPENDANTS, now, id, check);
        }
        if cube.connectivity() == Connectivity::Forest {
            self.audit_left_behind(now, id, agents, found);
        }
        if cube.is_closed() {
            let moves = |other: &ModuleId| *other != id && self.is_moving(*other);
            let others: Vec<ModuleId> = (0..self.len() as u32).map(ModuleId).filter(moves).collect();
            return note(found, MOVES_ALONE, now, id, invariants::moves_alone(&others));
        }
        if let Some(grantor) = agents.get(landing)
            // Finalized modules stay in any case, also after a restart, and restarted ones until they have listened.
            && grantor.role() != Role::Final
            && !grantor.is_listening(agents.clock(landing).local(now))
            && !grantor.may_be_final(agents.clock(landing).local(now))
        {
            let clock = agents.clock(landing);
            let granted = grantor.locked_for(id).map(|until| clock.global(until));
            // A stopped module may have kept a grant that has ended.
            let ends = now + self.move_time();
            if granted.is_none_or(|until| until < ends)
                && !cube.is_called()
                && let Some(dead) = self.dead_support(id, agents)
            {
                let (begins, ends) = (clock.local(now), clock.local(ends));
                // An agent that has not heard of the contact with the dead one cannot begin a move, and listens when it has.
                let stays = !self.has_heard_of(grantor, landing, dead) || grantor.stays_in_turn(begins, ends);
                return note(found, LANDING_STAYS, now, id, invariants::landing_stays(stays));
            }
            let check = move_within_lease(now, self.move_time(), granted);
            note(found, MOVE_WITHIN_LEASE, now, id, check);
        }
    }

    fn audit_all(&mut self, now: Time, agents: &Agents<'_, Cube>, found: &mut Vec<Violation>) {
        self.check_connected(now);
        for (id, cube) in agents.iter() {
            note(found, FINAL_GROWS, now, id, self.final_grows(cube, id, agents));
            for face in Face::ALL {
                let check = self.field_loop_free(id, face, agents);
                note(found, FIELD_LOOP_FREE, now, id, check);
            }
        }
    }

    fn take_violations(&mut self) -> Vec<Violation> {
        CubeWorld::take_violations(self)
    }
}

/// Returns the default interval of full audits.
pub fn audit_every(move_time: Span) -> Span {
    move_time * 20
}

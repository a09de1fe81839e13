//! Invariants of the custody of dead modules.

use crate::cube::audit::note;
use crate::cube::invariants::{self, BEST_HOLDER_STAYS, DEAD_HELD, HOLDER_DESCENDS};
use crate::cube::reachability::spread;
use crate::cube::world::CubeWorld;
use metamorph_kernel::kernel::audited::Agents;
use metamorph_kernel::world::invariants::Violation;
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::control::CustodyKey;
use metamorph_protocol::cube::epoch::Epoch;
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::{Cell, Face, MotionKind};
use metamorph_protocol::time::Time;
use std::collections::BTreeMap;

/// One death and goal: the module, where it lies, its time of death and the goal.
type Custody = (ModuleId, Cell, Time, Epoch);

/// For every death and goal, the best holder beside the dead module that has ever announced itself.
#[derive(Clone, Debug, Default, Hash)]
pub(super) struct Announced(BTreeMap<Custody, (CustodyKey, ModuleId)>);

impl CubeWorld {
    /// Checks the custody of the dead neighbours of a module that may have changed it.
    pub(super) fn audit_custody(
        &mut self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, Cube>,
        found: &mut Vec<Violation>,
    ) {
        let Some(cube) = agents.get(id).filter(|cube| cube.certified_faces() != 0) else { return };
        if cube.cell() != self.cell(id) {
            return;
        }
        for face in Face::in_mask(cube.certified_faces()) {
            let Some(dead) = self.neighbour(id, face).filter(|d| agents.get(*d).is_none()) else { continue };
            let Some(last) = agents.last(dead) else { continue };
            // An agent that has not heard of this contact yet speaks of an earlier death.
            if let Some(died) = cube.custody(face).filter(|_| self.has_heard_of_contact(cube, id, face)) {
                let rank = (cube.role() != Role::Final).then(|| cube.rank());
                // Of an epoch in which it never worked it has no rank.
                let has_rank = last.role() != Role::Walker && last.epoch() == cube.epoch();
                let theirs = has_rank.then(|| last.rank());
                note(found, HOLDER_DESCENDS, now, id, invariants::holder_descends(rank, theirs));
                if let Some(key) = cube.custody_key(face) {
                    let best = self.announced.0.entry((dead, self.cell(dead), died, cube.epoch()));
                    best.and_modify(|best| *best = (key, id).min(*best)).or_insert((key, id));
                }
            }
            self.audit_dead(now, dead, cube, agents, found);
        }
    }

    /// Checks the custody of the dead neighbours of a module that leaves.
    pub(super) fn audit_left_behind(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, Cube>,
        found: &mut Vec<Violation>,
    ) {
        let Some(cube) = agents.get(id) else { return };
        for dead in Face::ALL.into_iter().filter_map(|f| self.neighbour(id, f)) {
            if agents.get(dead).is_none() {
                self.audit_dead(now, dead, cube, agents, found);
            }
        }
    }

    /// Checks that a dead module is held, as a module sees it that works for this goal.
    fn audit_dead(
        &self,
        now: Time,
        dead: ModuleId,
        of: &Cube,
        agents: &Agents<'_, Cube>,
        found: &mut Vec<Violation>,
    ) {
        let Some(last) = agents.last(dead).filter(|_| !self.is_moving(dead)) else { return };
        let beside: Vec<(ModuleId, Face)> = self.resting_beside(dead).collect();
        // Growth starts from the seed: the module there hangs on no other, whatever it has forgotten.
        let was_root = last.role() == Role::Final || last.is_root();
        let is_root_for = |(id, _): &(ModuleId, Face)| {
            agents.get(*id).is_none_or(|cube| {
                cube.seed() == self.cell(dead) || (was_root && cube.epoch() <= last.epoch())
            })
        };
        let is_root = was_root || of.seed() == self.cell(dead);
        let is_touched = beside.iter().any(|(id, _)| agents.get(*id).is_some());
        if (is_root || is_touched) && beside.iter().all(is_root_for) {
            return;
        }
        // A dead parent stays, and is held itself.
        let is_dead_parent =
            |id: ModuleId, face: Face| agents.get(id).is_none() && last.parent() == Some(face.opposite());
        let holds = |(id, face): &&(ModuleId, Face)| {
            is_dead_parent(*id, *face) || self.stays(now, *id, *face, agents)
        };
        let cluster = self.cluster(dead, agents);
        let holders = match beside.iter().filter(holds).count() {
            0 => self.holders_of_cluster(now, &cluster, of.epoch(), agents),
            holders => holders,
        };
        note(found, DEAD_HELD, now, dead, invariants::dead_held(holders));
        let stays = self.best_holder_stays(now, &cluster, of.epoch(), agents);
        note(found, BEST_HOLDER_STAYS, now, dead, invariants::best_holder_stays(stays));
    }

    /// Returns the dead modules at rest that hang together with one of them, over dead modules.
    fn cluster(&self, dead: ModuleId, agents: &Agents<'_, Cube>) -> Vec<ModuleId> {
        let dead_in =
            |cell: &Cell| self.body_at(*cell).filter(|id| agents.get(*id).is_none() && !self.is_moving(*id));
        let cells = spread([self.cell(dead)].into_iter(), &|cell| dead_in(cell).is_some());
        cells.iter().filter_map(dead_in).collect()
    }

    /// Returns true if the best of all holders that have announced themselves around a cluster of dead modules, for the present
    /// deaths and an epoch, stays. It may be dead, or not know any more that it is one. Nothing is asked of clusters with a module
    /// that was finalized, which needs no holder, or beside one that was restarted: it keeps parts together that have counted on
    /// a holder of one of them.
    fn best_holder_stays(
        &self,
        now: Time,
        cluster: &[ModuleId],
        epoch: Epoch,
        agents: &Agents<'_, Cube>,
    ) -> bool {
        let best = cluster.iter().filter_map(|dead| {
            let at = self.cell(*dead);
            let all = (*dead, at, Time::ZERO, Epoch::default())..=(*dead, at, Time::NEVER, Epoch::LAST);
            let ((.., of), (key, id)) = self.announced.0.range(all).next_back()?;
            (*of == epoch).then_some((*key, *id, at))
        });
        let Some((_, holder, at)) = best.min() else { return true };
        let of_epoch = |id: &ModuleId| agents.last(*id).filter(|cube| cube.epoch() == epoch);
        let was_final = |id: &ModuleId| of_epoch(id).is_some_and(|cube| cube.role() == Role::Final);
        let touching = || cluster.iter().flat_map(|dead| self.resting_beside(*dead)).map(|(id, _)| id);
        let has_restarted = |id: ModuleId| agents.last(id).is_some_and(Cube::has_restarted);
        if agents.get(holder).is_none()
            || of_epoch(&holder).is_none()
            || cluster.iter().any(was_final)
            || touching().any(has_restarted)
        {
            return true;
        }
        let face = self.cell(holder).face_to(at);
        !self.is_moving(holder) && face.is_some_and(|face| self.stays(now, holder, face, agents))
    }

    /// Iterates over the resting neighbours of a module, each with the face on which it has the module.
    fn resting_beside(&self, id: ModuleId) -> impl Iterator<Item = (ModuleId, Face)> {
        let beside = Face::ALL.into_iter().filter_map(move |f| Some((self.neighbour(id, f)?, f.opposite())));
        beside.filter(|(id, _)| !self.is_moving(*id))
    }

    /// Returns the number of modules that stay for one of a cluster of dead modules, and of those of the dead that were finalized in
    /// an epoch. Dead modules stay, so they hold each other.
    fn holders_of_cluster(
        &self,
        now: Time,
        cluster: &[ModuleId],
        epoch: Epoch,
        agents: &Agents<'_, Cube>,
    ) -> usize {
        // A module without a place in the forest stays, but may hang on the dead ones itself, unless it has just begun another epoch.
        let is_placed = |cube: &Cube| !cube.is_unlabelled() || cube.epoch() != epoch;
        let holds = |cube: &Cube| cube.role() == Role::Final || cube.has_restarted() || is_placed(cube);
        let is_holder = |(id, face): &(ModuleId, Face)| match (agents.get(*id), agents.last(*id)) {
            (None, last) => last.is_some_and(|cube| cube.role() == Role::Final && cube.epoch() == epoch),
            (Some(cube), _) => holds(cube) && self.stays(now, *id, *face, agents),
        };
        cluster.iter().flat_map(|id| self.resting_beside(*id)).filter(is_holder).count()
    }

    /// Returns true if a module cannot leave the dead module on a face: it is alive and in a closed epoch, in which a module leaves
    /// only when no other moves; or the last state of its agent keeps the dead module; or the agent, which is stopped or dead,
    /// has not heard of this contact yet and cannot begin a move.
    fn stays(&self, now: Time, id: ModuleId, face: Face, agents: &Agents<'_, Cube>) -> bool {
        let stays = |cube: &Cube| !self.has_heard_of_contact(cube, id, face) || cube.keeps(now, face);
        agents.get(id).is_some_and(Cube::is_closed) || agents.last(id).is_some_and(stays)
    }

    /// Returns true if the agent of a module has heard of its present contact on a face.
    fn has_heard_of_contact(&self, cube: &Cube, id: ModuleId, face: Face) -> bool {
        cube.session(face) == self.contact(id, face).map(|contact| contact.session)
    }

    /// Returns the module that a mover slides from, if that is dead.
    pub(super) fn dead_support(&self, mover: ModuleId, agents: &Agents<'_, Cube>) -> Option<ModuleId> {
        let motion = self.motion(mover).filter(|motion| motion.kind == MotionKind::Slide)?;
        self.body_at(self.cell(mover).step(motion.support)).filter(|support| agents.get(*support).is_none())
    }

    /// Returns true if the agent of a module has heard of its present contact with another one.
    pub(super) fn has_heard_of(&self, cube: &Cube, id: ModuleId, other: ModuleId) -> bool {
        let face = self.cell(id).face_to(self.cell(other));
        face.is_some_and(|face| self.has_heard_of_contact(cube, id, face))
    }

    /// Forgets the announcements about a module that is started again.
    pub(super) fn forget_announced(&mut self, id: ModuleId) {
        self.announced.0.retain(|(dead, ..), _| *dead != id);
    }
}

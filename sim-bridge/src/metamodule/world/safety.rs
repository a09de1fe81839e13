//! Safety of metamodules, checked at every action: no two bodies are in one cell, not even in the cells that
//! they sweep, and every body grips the floor.
//!
//! A check looks only at the cells of the action. For that, a record of the body in each cell is kept apart
//! from the bodies (`claims`); the interlock works from the bodies, so that a fault of either shows.

use super::{MetamoduleWorld, Occupant};
use crate::metamodule::invariants::{ATTACHED, attached};
use metamorph_kernel::world::invariants::ONE_MODULE_PER_CELL;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::message::BodyAction;
use metamorph_protocol::time::Time;

impl MetamoduleWorld {
    /// Records the body in all cells that it takes; a cell that already has a body in the record keeps that one.
    pub(super) fn claim(&mut self, id: ModuleId) {
        for cell in self.bodies[id.index()].taken() {
            if self.claims.get(*cell).is_none() {
                self.claims.set(*cell, Some(Occupant::Body(id)));
            }
        }
    }

    /// Checks an action that has just begun, and the cells that it is going to sweep.
    pub(super) fn check_begin(&mut self, now: Time, id: ModuleId) {
        self.check_grips(now, id);
        let taken = self.bodies[id.index()].taken();
        let own = Some(Occupant::Body(id));
        let not_free =
            |c: &&Cell| self.obstacles.contains(c) || self.claims.get(**c).is_some_and(|by| Some(by) != own);
        let found = taken.iter().find(not_free).copied();
        if let Some(cell) = found.or_else(|| self.element_in(id, taken)) {
            self.taken_already(now, id, cell);
        }
        self.claim(id);
    }

    /// Checks an action that is over, completed or failed, and releases the cells that the body swept.
    pub(super) fn check_end(&mut self, now: Time, id: ModuleId, swept: &[Cell]) {
        self.check_grips(now, id);
        let (cells, own) = (self.bodies[id.index()].cells, Some(Occupant::Body(id)));
        let is_lost = |c: &&Cell| self.obstacles.contains(c) || self.claims.get(**c) != own;
        if let Some(cell) = cells.iter().find(is_lost).copied() {
            self.taken_already(now, id, cell);
        }
        self.check_elements(now);
        for cell in swept.iter().filter(|c| !cells.contains(c)) {
            if self.claims.get(*cell) == own {
                self.claims.set(*cell, None);
            }
        }
    }

    fn taken_already(&mut self, now: Time, id: ModuleId, cell: Cell) {
        let what = match self.claims.get(cell) {
            _ if self.obstacles.contains(&cell) => format!("{id} and something foreign at {cell}"),
            Some(Occupant::Body(other) | Occupant::Path(other)) => format!("{other} and {id} at {cell}"),
            None => format!("{id} at {cell}, which it had not claimed"),
        };
        self.queue.violate(ONE_MODULE_PER_CELL, now, what);
    }

    /// Checks that a body grips the floor; while an end detaches, with the other end.
    fn check_grips(&mut self, now: Time, id: ModuleId) {
        let body = &self.bodies[id.index()];
        let lets_go = body.under_way.as_ref().is_some_and(|u| u.body_action == BodyAction::Detach);
        let floor = |x, y| self.setup.floor.has(x, y);
        let mut ends = Vec::new();
        if body.grips[body.pose.end as usize] && !lets_go {
            ends.push(floor(body.pose.state.x, body.pose.state.y));
        }
        if body.grips[body.pose.end.other() as usize] {
            ends.push(self.setup.motions.landing(body.pose).is_some_and(|s| floor(s.x, s.y)));
        }
        if let Err(what) = attached(&ends) {
            self.queue.violate(ATTACHED, now, format!("module {id}: {what}"));
        }
    }

    /// Checks one body against all others, and its grips, without the record.
    pub(super) fn check(&mut self, now: Time, id: ModuleId) {
        self.check_grips(now, id);
        let body = &self.bodies[id.index()];
        let shared = self.bodies.iter().enumerate().filter(|(i, _)| *i != id.index()).find_map(|(i, o)| {
            o.taken().iter().find(|c| body.cells.contains(c)).map(|cell| (ModuleId(i as u32), *cell))
        });
        let foreign = body.cells.iter().find(|c| self.obstacles.contains(c)).copied();
        if let Some((other, cell)) = shared {
            self.queue.violate(ONE_MODULE_PER_CELL, now, format!("{other} and {id} at {cell}"));
        }
        if let Some(cell) = foreign {
            self.queue.violate(ONE_MODULE_PER_CELL, now, format!("{id} and something foreign at {cell}"));
        }
    }

    /// Checks every body: the whole check, for the start, the end and now and then.
    pub fn check_all(&mut self, now: Time) {
        (0..self.bodies.len() as u32).for_each(|id| self.check(now, ModuleId(id)));
        self.check_elements(now);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{act, setup, upright};
    use super::*;
    use metamorph_kernel::world::World;
    use metamorph_kernel::world::invariants::Invariant;
    use metamorph_protocol::metamodule::message::{Action, Percept};
    use metamorph_protocol::metamodule::motions::Sweep;
    use metamorph_protocol::metamodule::params::Setup;
    use metamorph_protocol::metamodule::pose::Pose;
    use std::sync::Arc;

    fn fired(world: &mut MetamoduleWorld) -> Vec<Invariant> {
        world.take_violations().into_iter().map(|v| v.invariant).collect()
    }

    /// Returns a step from this pose, and a cell that it sweeps beside the body.
    fn step(setup: &Setup, from: Pose) -> (BodyAction, Cell) {
        let body = setup.motions.cells(from);
        let mut steps = 0..setup.motions.table().steps().len() as u16;
        let found = steps.find_map(|number| {
            let (_, swept) = setup.motions.graph().step(from.posture, number)?;
            let beside = setup.motions.swept(from.state, Sweep(swept)).find(|c| !body.contains(c))?;
            Some((BodyAction::Turn(number), beside))
        });
        found.expect("some step sweeps a cell")
    }

    #[test]
    fn one_module_per_cell_and_attached_fire() {
        let setup = setup();
        let fired = |poses: &[Pose]| {
            let mut world = MetamoduleWorld::new(Arc::clone(&setup), poses, 1);
            world.check_all(Time::ZERO);
            fired(&mut world)
        };
        let (a, b) = (upright(&setup, 3, 3), upright(&setup, 4, 3));
        assert_eq!(fired(&[a, b]), []);
        assert!(fired(&[a, a]).contains(&ONE_MODULE_PER_CELL));
        assert!(fired(&[upright(&setup, 13, 3)]).contains(&ATTACHED));
    }

    /// The interlock ignores a body that is still there.
    #[test]
    fn a_step_into_another_body_fires_when_it_begins() {
        let setup = setup();
        let from = upright(&setup, 6, 6);
        let (body_action, cell) = step(&setup, from);
        let mut world = MetamoduleWorld::new(Arc::clone(&setup), &[from, upright(&setup, 1, 1)], 1);
        world.claims.set(cell, Some(Occupant::Body(ModuleId(1))));
        assert!(matches!(act(&mut world, body_action), Percept::Done(_)));
        assert_eq!(fired(&mut world).first(), Some(&ONE_MODULE_PER_CELL));
    }

    #[test]
    fn a_failed_step_is_checked_where_it_began() {
        let setup = setup();
        let from = upright(&setup, 6, 6);
        let (body_action, _) = step(&setup, from);
        let fails = |spoil: fn(&mut MetamoduleWorld)| {
            let mut world = MetamoduleWorld::new(Arc::clone(&setup), &[from], 1);
            world.set_stuck(ModuleId(0), true);
            let revision = world.bodies[0].ports.revision;
            let action = Action { body_action, not_after: Time::ZERO };
            world.act(Time::ZERO, ModuleId(0), revision, &action);
            assert_eq!(fired(&mut world), []);
            spoil(&mut world);
            world.advance(Time(u64::MAX - 1));
            assert_eq!(world.action_counts().failed, 1);
            fired(&mut world)
        };
        assert_eq!(fails(|_| {}), []);
        let foreign = |world: &mut MetamoduleWorld| {
            world.obstacles.insert(world.cells(ModuleId(0))[1]);
        };
        assert_eq!(fails(foreign), [ONE_MODULE_PER_CELL]);
        assert_eq!(fails(|world| world.bodies[0].grips = [false; 2]), [ATTACHED]);
    }

    /// The swept cells of a body are free again after the action, whether it failed or not.
    #[test]
    fn swept_cells_are_released() {
        let setup = setup();
        let from = upright(&setup, 6, 6);
        let (body_action, _) = step(&setup, from);
        for stuck in [false, true] {
            let mut world = MetamoduleWorld::new(Arc::clone(&setup), &[from], 1);
            world.set_stuck(ModuleId(0), stuck);
            act(&mut world, body_action);
            assert_eq!(fired(&mut world), []);
            let all = (-9..20).flat_map(|x| (-9..20).flat_map(move |y| (-9..20).map(move |z| (x, y, z))));
            let claimed = all.filter(|(x, y, z)| world.claims.get(Cell::new(*x, *y, *z)).is_some()).count();
            assert_eq!(claimed, 4);
        }
    }
}

//! The director's view of passive elements: what agents are told of them, whether they are placed, and which are pinned.

use super::MetamoduleDirector;
use super::plan_execution::{ElementNow, Swarm};
use crate::metamodule::world::{Drop, MetamoduleWorld};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::manipulation::colour::colours_differ;
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::planning::transport::is_at_goal;
use std::collections::BTreeSet;

/// The dead metamodules that are taken away on trial, at most: each takes a search.
const MAX_SUSPECTS: usize = 8;

impl MetamoduleDirector {
    /// Tells all metamodules which cells have become blocked or free: those of foreign objects and of elements at rest.
    pub(super) fn tell_obstacles(&mut self, world: &MetamoduleWorld) {
        let now: BTreeSet<Cell> = world.obstacles().iter().copied().chain(world.resting()).collect();
        let before = std::mem::replace(&mut self.obstacles, now.clone());
        for cell in before.symmetric_difference(&now) {
            self.order_all(Order::Obstacle { cell: *cell, there: now.contains(cell) });
        }
    }

    /// Drops an element, and has everything planned anew. Returns what became of it.
    pub(super) fn drop_element(&mut self, element: usize, world: &mut MetamoduleWorld) -> String {
        let Some(name) = self.setup.elements.all().get(element).map(|e| e.name.clone()) else {
            return format!("there is no element {element}");
        };
        match world.drop_element(element) {
            Drop::NotHeld => format!("{name}: it was not held"),
            Drop::Fell { from, cells, on } => {
                // Where the dead are is told with what they hold.
                self.untold.extend(from.iter().filter(|id| self.dead.contains(id)));
                self.tell_obstacles(world);
                self.disturb();
                let on = on.map_or_else(String::new, |id| format!(", on module {id}"));
                format!("{name}: it fell {cells} cells{on}")
            }
        }
    }

    /// Returns what is known of the swarm, for planning.
    pub(super) fn swarm<'a>(&'a self, world: &MetamoduleWorld) -> Swarm<'a> {
        let stays = self.foreign(world).into_iter().collect();
        let element =
            |e| ElementNow { cells: world.element(e).to_vec(), holders: world.holders(e).collect() };
        let elements = (0..world.elements()).map(element).collect();
        let (setup, task, filled) = (&self.setup, self.task, self.filled);
        Swarm { setup, scenes: &self.scenes, known: &self.known, task, filled, stays, elements }
    }

    /// Returns the elements that are not at their goals, each with a dead metamodule whose latch on it stays closed.
    pub fn pinned(&self, world: &MetamoduleWorld) -> Vec<(usize, ModuleId)> {
        let by = |e| world.holders(e).find(|id| self.dead.contains(id)).map(|id| (e, id));
        let goal = self.task.goal;
        let away = (0..world.elements()).filter(|e| !is_at_goal(&self.setup, goal, *e, world.element(*e)));
        away.filter_map(by).collect()
    }

    /// Returns the next element if there is no transport to its goal, with the dead metamodules in the way: those without
    /// each of which there would be one, or all if there would be one without any of them. `None` if the element is pinned,
    /// or there is a transport.
    pub fn blocked(&self, world: &MetamoduleWorld) -> Option<(usize, Vec<ModuleId>)> {
        let mut swarm = self.swarm(world);
        let has_dead_holder = |e: &usize| swarm.elements[*e].holders.iter().any(|id| self.dead.contains(id));
        let left: Vec<usize> = swarm.elements_left().filter(|e| !has_dead_holder(e)).collect();
        let element = left.into_iter().find(|e| !swarm.has_transport(*e))?;
        let stays = swarm.stays.clone();
        let mut has_way_without = |gone: &[ModuleId]| {
            let is_gone = |cell: &Cell| gone.iter().any(|id| world.cells(*id).contains(cell));
            swarm.stays = stays.iter().copied().filter(|cell| !is_gone(cell)).collect();
            swarm.has_transport(element)
        };
        let dead: Vec<ModuleId> = self.dead.iter().copied().take(MAX_SUSPECTS).collect();
        let one: Vec<ModuleId> = dead.iter().copied().filter(|id| has_way_without(&[*id])).collect();
        let all = one.is_empty() && has_way_without(&dead);
        Some((element, if all { dead } else { one }))
    }

    /// Returns true if an element is not at its goal, or is still held where it is to lie.
    pub fn has_elements_left(&self, world: &MetamoduleWorld) -> bool {
        self.swarm(world).elements_left().next().is_some()
    }

    /// Returns true if an element is in cells of the other colour than those of its goal, after a fall.
    pub(super) fn is_off_colour(&self, world: &MetamoduleWorld) -> bool {
        let elements = self.setup.elements.all().iter().enumerate();
        let mut off = elements.filter(|(e, of)| colours_differ(world.element(*e), of.goal(self.task.goal)));
        off.next().is_some()
    }

    /// Returns true if all elements are at their goals, gripped by all metamodules in seeds whose heads face them.
    pub(super) fn are_elements_placed(&self, world: &MetamoduleWorld) -> bool {
        world.elements() == 0 || self.swarm(world).is_built()
    }
}

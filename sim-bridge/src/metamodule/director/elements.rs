//! The director's view of passive elements: which cells agents are told of, whether elements are placed, and which are pinned.

use super::members::{Members, Orders};
use super::plan_execution::{ElementNow, Swarm};
use super::view::View;
use crate::metamodule::world::MetamoduleWorld;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::manipulation::colour::colours_differ;
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::planning::transport::{Scenes, is_at_goal};
use std::collections::BTreeSet;

/// The largest number of dead metamodules whose removal is tried; each takes a search.
const SUSPECTS_MAX: usize = 8;

/// Foreign objects and elements, as agents know them.
#[derive(Clone)]
pub(super) struct Elements {
    /// Cells with a foreign object or an element at rest in them, as announced.
    obstacles: BTreeSet<Cell>,
    /// The graphs that transports are planned on.
    scenes: Scenes,
}

impl Elements {
    pub fn new(scenes: Scenes) -> Elements {
        Elements { obstacles: BTreeSet::new(), scenes }
    }
    /// Returns the cells that agents have been ordered to avoid.
    pub fn obstacles(&self) -> &BTreeSet<Cell> {
        &self.obstacles
    }
    /// Takes over the blocked cells of the world. Returns those before.
    pub fn look(&mut self, world: &MetamoduleWorld) -> BTreeSet<Cell> {
        let now = world.obstacles().iter().copied().chain(world.resting()).collect();
        std::mem::replace(&mut self.obstacles, now)
    }
    /// Tells all metamodules which cells have become blocked or free: those of foreign objects and of elements at rest.
    pub fn announce(&mut self, world: &MetamoduleWorld, members: &Members, orders: &mut Orders) {
        let before = self.look(world);
        for cell in before.symmetric_difference(&self.obstacles) {
            members.order_all(Order::Obstacle { cell: *cell, there: self.obstacles.contains(cell) }, orders);
        }
    }

    /// Returns what is known of the swarm, for planning.
    pub fn swarm<'a>(&'a self, view: View<'a>) -> Swarm<'a> {
        let View { setup, world, members, goal } = view;
        let element =
            |e| ElementNow { cells: world.element(e).to_vec(), holders: world.holders(e).collect() };
        Swarm {
            setup,
            scenes: &self.scenes,
            known: members.known(),
            task: goal.task(),
            filled: goal.filled(),
            stays: view.foreign().into_iter().collect(),
            elements: (0..world.elements()).map(element).collect(),
        }
    }
    /// Returns true if all elements are at their goals, gripped by all metamodules in seeds whose heads face them.
    pub fn are_placed(&self, view: View<'_>) -> bool {
        view.world.elements() == 0 || self.swarm(view).is_built()
    }
    /// Returns true if an element is not at its goal, or is still held where it is to lie.
    pub fn are_left(&self, view: View<'_>) -> bool {
        self.swarm(view).elements_left().next().is_some()
    }

    /// Returns the next element if there is no transport to its goal, with the dead metamodules in the way: those without
    /// each of which there would be one, or all if there would be one without any of them. `None` if the element is pinned,
    /// or there is a transport.
    pub fn blocked(&self, view: View<'_>) -> Option<(usize, Vec<ModuleId>)> {
        let (mut swarm, dead) = (self.swarm(view), view.members.dead());
        let has_dead_holder = |e: &usize| swarm.elements[*e].holders.iter().any(|id| dead.contains(id));
        let left: Vec<usize> = swarm.elements_left().filter(|e| !has_dead_holder(e)).collect();
        let element = left.into_iter().find(|e| !swarm.has_transport(*e))?;
        let stays = swarm.stays.clone();
        let mut has_way_without = |gone: &[ModuleId]| {
            let is_gone = |cell: &Cell| gone.iter().any(|id| view.world.cells(*id).contains(cell));
            swarm.stays = stays.iter().copied().filter(|cell| !is_gone(cell)).collect();
            swarm.has_transport(element)
        };
        let dead: Vec<ModuleId> = dead.iter().copied().take(SUSPECTS_MAX).collect();
        let one: Vec<ModuleId> = dead.iter().copied().filter(|id| has_way_without(&[*id])).collect();
        let all = one.is_empty() && has_way_without(&dead);
        Some((element, if all { dead } else { one }))
    }
}

/// Returns the elements that are not at their goals, each with a dead metamodule whose latch on it stays closed.
pub(super) fn pinned(view: View<'_>) -> Vec<(usize, ModuleId)> {
    let View { setup, world, members, goal } = view;
    let by = |e| world.holders(e).find(|id| members.dead().contains(id)).map(|id| (e, id));
    let goal = goal.task().goal;
    let away = (0..world.elements()).filter(|e| !is_at_goal(setup, goal, *e, world.element(*e)));
    away.filter_map(by).collect()
}

/// Returns true if an element is in cells of the other colour than those of its goal, after a fall.
pub(super) fn is_off_colour(view: View<'_>) -> bool {
    let goal = view.goal.task().goal;
    let mut elements = view.setup.elements.all().iter().enumerate();
    elements.any(|(e, of)| colours_differ(view.world.element(e), of.goal(goal)))
}

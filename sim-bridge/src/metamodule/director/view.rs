//! Inputs of the director's parts: the setup, the bodies, the reports and the goal.

use super::goal::Goal;
use super::members::{Known, Members};
use crate::metamodule::world::MetamoduleWorld;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::SeedSet;
use metamorph_protocol::metamodule::params::Setup;
use metamorph_protocol::metamodule::planning::cooperative::Standstill;
use std::collections::BTreeSet;
use std::sync::Arc;

/// The swarm at a moment.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub setup: &'a Arc<Setup>,
    pub world: &'a MetamoduleWorld,
    pub members: &'a Members,
    pub goal: &'a Goal,
}

impl<'a> View<'a> {
    /// Iterates over the metamodules that live and whose joints are not stuck.
    pub fn movable(self) -> impl Iterator<Item = (ModuleId, &'a Known)> {
        self.members.iter().filter(move |(id, known)| known.alive && !self.world.is_stuck(*id))
    }

    /// Returns the seeds that are filled, by reports and bodies.
    pub fn filled(self) -> SeedSet {
        let mut filled = SeedSet::default();
        for (i, seed) in self.setup.seeds(self.goal.task()) {
            let cells = seed.cells();
            let fills = |(id, known): (ModuleId, &Known)| {
                let stays = !known.alive || known.status.is_some_and(|s| s.settled == Some(i));
                stays && *self.world.cells(id) == cells
            };
            if self.members.iter().any(fills) {
                filled = filled.with(i);
            }
        }
        filled
    }

    /// Returns the cells that no living metamodule can clear: those of dead bodies and of obstacles.
    pub fn foreign(self) -> BTreeSet<Cell> {
        let dead = self.members.dead().iter().flat_map(|id| self.world.cells(*id));
        dead.chain(self.world.obstacles()).copied().collect()
    }

    /// Returns true if one of these cells is in a seed that is not filled.
    pub fn is_seed_blocked(self, cells: &BTreeSet<Cell>) -> bool {
        let mut unfilled = self.goal.unfilled(self.setup);
        unfilled.any(|(_, seed)| seed.cells().iter().any(|c| cells.contains(c)))
    }

    /// Returns true if an open seed is unreachable for every metamodule that could fill it.
    pub fn is_out_of_reach(self) -> bool {
        let free = || self.movable().filter_map(|(_, k)| k.status).filter(|s| s.settled.is_none());
        let open = self.goal.open(self.setup);
        free().next().is_some() && open.iter().any(|seed| free().all(|s| s.unreachable.has(seed)))
    }

    /// Returns the input of a search about the goal as it stands: metamodules in seeds stay.
    pub fn snapshot(self) -> Standstill {
        self.standstill(|known| known.status.is_none_or(|s| s.settled.is_none()))
    }
    /// Returns the input of a search for another place of the goal: all metamodules that can move are free.
    pub fn all_free(self) -> Standstill {
        Standstill { filled: SeedSet::default(), ..self.standstill(|_| true) }
    }
    fn standstill(self, is_free: impl Fn(&Known) -> bool) -> Standstill {
        let View { setup, world, .. } = self;
        let (mut free, mut fixed) = (Vec::new(), Vec::from_iter(world.obstacles().iter().copied()));
        for (id, known) in self.members.iter() {
            let pose = world.pose(id);
            if known.alive && !world.is_stuck(id) && is_free(known) {
                // A metamodule held at both ends releases the older one first.
                let around = setup.motions.turned_around(pose).filter(|_| pose.both);
                free.push(around.unwrap_or(pose));
            } else {
                fixed.extend(world.cells(id));
            }
        }
        fixed.extend((0..world.elements()).flat_map(|e| world.element(e)));
        let setup = Arc::clone(setup);
        Standstill { setup, task: self.goal.task(), filled: self.goal.filled(), free, fixed }
    }
}

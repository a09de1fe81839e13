//! What the parts of a metamodule read: the module itself, its neighbours, what it has granted, and the time
//! of the step.

use super::blueprint::{Blueprint, SeedSet, Task};
use super::locks::LockTable;
use super::message::State;
use super::motions::Motions;
use super::neighbour_table::NeighbourTable;
use super::params::{Params, SeedAuthority, Setup};
use super::planning::paths::Ground;
use super::pose::Pose;
use crate::defects::Defect;
use crate::ids::ModuleId;
use crate::lattice::Cell;
use crate::time::Time;
use std::sync::Arc;

/// What a metamodule knows of itself and of its task.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Own {
    pub id: ModuleId,
    pub pose: Pose,
    pub task: Task,
    /// Seeds of the task that the world-controller has opened.
    pub open: SeedSet,
    /// Seeds of the task that are known to be filled.
    pub filled: SeedSet,
    /// The seed that it fills.
    pub settled: Option<u8>,
    /// Its joints did not turn when they should have; they are tried again at this time.
    pub stuck: Option<Time>,
    /// Until then a restarted agent asks and grants nothing: it may have granted something before.
    pub quarantine_until: Time,
}

/// What one step of a part reads.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub now: Time,
    pub setup: &'a Arc<Setup>,
    pub own: &'a Own,
    pub neighbours: &'a NeighbourTable,
    pub locks: &'a LockTable,
}

impl<'a> View<'a> {
    pub fn params(self) -> &'a Params {
        &self.setup.params
    }
    pub fn motions(self) -> &'a Motions {
        &self.setup.motions
    }
    /// Whether a test has switched this defect on.
    pub fn has(self, defect: Defect) -> bool {
        self.setup.params.defect == Some(defect)
    }
    /// The goal of the task, where its blueprint has it.
    pub fn goal(self) -> &'a Blueprint {
        self.setup.goal(self.own.task)
    }
    /// Seeds that may be filled now.
    pub fn open(self) -> SeedSet {
        match self.params().seed_authority {
            SeedAuthority::Controller => self.own.open.without(self.own.filled),
            SeedAuthority::Neighbours => self.goal().open(self.own.filled),
        }
    }
    /// The seed that a metamodule in `pose` fills, if any.
    pub fn seed_filled_in(self, pose: Pose) -> Option<u8> {
        let cells = self.motions().cells(pose);
        Some(self.setup.seeds(self.own.task).find(|(_, seed)| seed.cells() == cells)?.0)
    }
    /// Whether a neighbour stays where it is while the task is what it is. Before it leaves for another task
    /// it asks this one; if each of two took the other for settled in an old task, both would not ask.
    pub fn stays(self, state: &State) -> bool {
        state.settled && state.task == self.own.task
    }
    /// Whether a neighbour in range has not been heard yet and may be alive. However long it is silent, it
    /// may be about to move, and would not be asked.
    pub fn any_unheard(self) -> bool {
        self.neighbours.any_unheard(self.own.pose.foot(), self.params().communication_range)
    }
    /// Cells of the dead and of obstacles.
    pub fn fixed(self) -> Vec<Cell> {
        let dead = self.neighbours.dead.values().flat_map(|p| self.motions().cells(*p));
        self.neighbours.obstacles.iter().copied().chain(dead).collect()
    }
    /// The floor with these cells taken.
    pub fn ground<'b>(self, taken: &'b [Cell]) -> Ground<'b>
    where
        'a: 'b,
    {
        Ground { motions: self.motions(), floor: self.setup.floor, taken }
    }
}

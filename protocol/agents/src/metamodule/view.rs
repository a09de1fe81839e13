//! Inputs that the parts of a metamodule read: the module itself, its neighbours, the locks that it has granted, and
//! the time of the step.

use super::blueprint::{Blueprint, SeedSet, Task};
use super::elements::is_at_goal;
use super::locks::LockTable;
use super::message::{Claim, State};
use super::motions::Motions;
use super::neighbour_table::NeighbourTable;
use super::params::{Params, SeedAuthority};
use super::planning::paths::Ground;
use super::pose::Pose;
use super::setup::Setup;
use super::steering::Steered;
use metamorph_core::defects::Defect;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use std::sync::Arc;

/// State of a metamodule itself and of its task.
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
    /// When stuck joints are tried again; `None` if no joint is stuck.
    pub stuck: Option<Time>,
    /// The command of an operator, and its end.
    pub steered: Option<Steered>,
    /// Before this time a restarted agent neither requests nor grants a lock: an earlier incarnation may have granted
    /// a lock that still holds.
    pub quarantine_until: Time,
}

/// The part of a strategy's state that is announced to neighbours and the world-controller.
#[derive(Clone, Copy, Default)]
pub(super) struct Advertised {
    pub claim: Option<Claim>,
    /// Seeds to which the metamodule has found no route.
    pub unreachable: SeedSet,
    /// It stands in a more important path and cannot leave it.
    pub blocked: bool,
}

/// Inputs of a part of the agent in one step.
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
    /// Returns the goal of the task, without the task's shift.
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
    /// The seed that a metamodule in `pose` settles in: one that it fills, with the element that it holds at its goal.
    pub fn settles_in(self, pose: Pose) -> Option<u8> {
        let goal = self.own.task.goal;
        let held = self.setup.held(pose);
        let is_placed = held.is_none_or(|(element, cells)| is_at_goal(self.setup, goal, element, &cells));
        self.seed_filled_in(pose).filter(|_| is_placed)
    }
    /// Returns true if a neighbour stays where it is until the task changes: it is settled, and has the same task as
    /// this metamodule. One that is settled in another task may leave, so it is asked for its consent. Otherwise two
    /// metamodules that each take the other for settled in an old task would move without asking each other.
    pub fn stays(self, state: &State) -> bool {
        state.settled && state.task == self.own.task
    }
    /// Returns true if a neighbour in range has not been heard yet and may be alive. Such a neighbour may be about to
    /// move, however long it has been silent, and a metamodule that moved now would not ask it.
    pub fn any_unheard(self) -> bool {
        self.neighbours.any_unheard(self.own.pose, self.params().communication_range)
    }
    /// Returns true if another metamodule is known to hold the element that this one holds. The dead hold on.
    pub fn shares_element(self) -> bool {
        let own = self.setup.elements.of(self.own.pose.load);
        let neighbours = self.neighbours.states().map(|(_, state)| state.pose);
        let mut others = neighbours.chain(self.neighbours.dead.values().copied());
        own.is_some() && others.any(|pose| self.setup.elements.of(pose.load) == own)
    }
    /// Returns true if the element that it holds rests on the floor, so that it may be released.
    pub fn element_rests(self) -> bool {
        self.setup.held(self.own.pose).is_some_and(|(_, cells)| self.setup.rests(&cells))
    }
    /// Cells of the dead and of obstacles.
    pub fn fixed(self) -> Vec<Cell> {
        let dead = self.neighbours.dead.values().flat_map(|p| self.setup.occupied(*p));
        self.neighbours.obstacles.iter().copied().chain(dead).collect()
    }
    /// Returns the floor with the cells `taken`, for route searches.
    pub fn ground<'b>(self, taken: &'b [Cell]) -> Ground<'b>
    where
        'a: 'b,
    {
        Ground { motions: self.motions(), floor: self.setup.floor, taken }
    }
}

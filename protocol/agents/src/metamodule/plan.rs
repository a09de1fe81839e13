//! One motion of a metamodule, to be locked as a whole.

use super::motions::Sweep;
use super::planning::paths::Ground;
use super::pose::{Load, Pose};
use super::setup::Setup;
use metamorph_core::lattice::Cell;

/// Purpose of a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Aim {
    /// Attaching the free end to a connector, then detaching the other end.
    Land,
    /// Filling this seed.
    Settle(u8),
    /// Taking another shape, to be less in the way.
    Shift,
    /// Gripping an element or letting it go; this is what the free end holds then.
    Handle(Load),
}

/// A motion from one pose. The digest hashes its fields in this order.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Plan {
    /// Where it begins.
    pub from: Pose,
    /// The steps, by their numbers in the database.
    pub steps: Vec<u16>,
    /// All cells that the motion needs, seen from `from`: those that its steps sweep (core and graze), and those that
    /// the body fills at the beginning. Empty with an element: see [`Setup::lock_cells`].
    pub sweep: Sweep,
    /// The posture at the end.
    pub ends: u16,
    /// Its purpose.
    pub aim: Aim,
    /// It was chosen because it ends where it blocks no other metamodule (`negotiated` only).
    pub non_blocking: bool,
}

impl Plan {
    /// Finds the shortest motion to a posture over free ground.
    pub fn to(ground: &Ground<'_>, from: Pose, posture: u16, aim: Aim) -> Option<Plan> {
        let graph = ground.motions.graph();
        let path = graph.path(from.posture, posture, ground.taken_at(from))?;
        let sweep = Sweep(path.swept | graph.filled_bits(from.posture));
        Some(Plan { from, steps: path.steps.to_vec(), sweep, ends: posture, aim, non_blocking: false })
    }

    /// Returns the motion of one step with the element that the metamodule holds; `None` if there is no such step, it
    /// meets a taken cell, or it is over the limits of torque. The motion has no step if the metamodule stands so already:
    /// an earlier incarnation may have made the step that fills its seed.
    pub fn carry(setup: &Setup, from: Pose, posture: u16, taken: &[Cell], aim: Aim) -> Option<Plan> {
        if posture == from.posture {
            return Some(Plan { aim, ..Plan::let_go(from) });
        }
        let step = setup.carried_step(from, posture)?;
        let allowed = step.peak.within(setup.elements.limits());
        let is_free = || !step.cells.iter().any(|cell| taken.contains(cell));
        let (steps, sweep) = (vec![step.number], Sweep::default());
        (allowed && is_free()).then_some(Plan { from, steps, sweep, ends: posture, aim, non_blocking: false })
    }

    /// Returns the motion that grips an element or releases it. It sweeps no cell.
    pub fn handle(from: Pose, load: Load) -> Plan {
        Plan { aim: Aim::Handle(load), ..Plan::let_go(from) }
    }

    /// Returns all cells that the motion needs.
    pub fn cells<'a>(&self, setup: &'a Setup) -> impl Iterator<Item = Cell> + use<'a> {
        setup.lock_cells(self.from, self.sweep, self.ends)
    }

    /// Returns the motion that only detaches the end that has been attached for longer. It sweeps no cell.
    pub fn let_go(from: Pose) -> Plan {
        let (steps, sweep, ends) = (Vec::new(), Sweep::default(), from.posture);
        Plan { from, steps, sweep, ends, aim: Aim::Land, non_blocking: false }
    }
}

/// A motion that tries whether stuck joints turn again.
pub(super) enum JointTrial {
    /// Turn a joint by a step that is free.
    Turn(Plan),
    /// Attach the other end first: seen from there a step is free, whereas seen from the present end none is.
    OtherEnd(Plan),
}

impl JointTrial {
    pub fn find(ground: &Ground<'_>, pose: Pose) -> Option<JointTrial> {
        let free = |at: Pose| ground.motions.graph().neighbour(at.posture, ground.taken_at(at));
        if let Some(plan) = free(pose).and_then(|posture| Plan::to(ground, pose, posture, Aim::Shift)) {
            return Some(JointTrial::Turn(plan));
        }
        ground.landed(pose, pose.posture).and_then(free)?;
        Plan::to(ground, pose, pose.posture, Aim::Land).map(JointTrial::OtherEnd)
    }
}

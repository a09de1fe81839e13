//! Orders of the world-controller to a metamodule, and reports of a metamodule to it.

use super::Instruction;
use crate::metamodule::blueprint::{MAX_SEEDS, SeedSet, Task};
use crate::metamodule::pose::Pose;
use crate::metamodule::steering::Steering;
use crate::metamodule::tuning::Tuning;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Field, Wire, WireError};

/// An order of the world-controller to a metamodule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Order {
    /// The task, and which of its seeds are open and which are filled. While the task is the same, the set of filled
    /// seeds only grows, so of two orders the one with the larger set is later.
    Seeds {
        /// The current task.
        task: Task,
        /// The seeds that may be filled now.
        open: SeedSet,
        /// The filled seeds.
        filled: SeedSet,
    },
    /// The process of a metamodule is gone and cannot come back in its present sessions; its body
    /// stays here as an obstacle.
    Dead {
        /// The metamodule.
        id: ModuleId,
        /// Where the body is.
        pose: Pose,
    },
    /// A metamodule that was dead has a process again.
    Alive {
        /// The metamodule.
        id: ModuleId,
    },
    /// An obstacle has appeared in a cell, or has gone from it.
    Obstacle {
        /// The cell.
        cell: Cell,
        /// Whether it is there.
        there: bool,
    },
    /// The next instruction for this metamodule (`planned` only). It replaces those with smaller numbers.
    Instruct {
        /// Counts the instructions of a run.
        number: u32,
        /// `Over` lets it decide for itself, as under `negotiated`.
        instruction: Instruction,
    },
    /// A command of an operator to this metamodule. It replaces the command before.
    Steer {
        /// The command.
        steering: Steering,
        /// The end of its lease.
        until: Time,
    },
    /// The new parameters of the published strategies.
    Tune(Tuning),
}

/// Whether one of the sets has seeds beyond the first 32: it is then written in full, in a message of another kind.
fn is_wide(a: SeedSet, b: SeedSet) -> bool {
    a.narrow().is_none() || b.narrow().is_none()
}

impl Wire for Order {
    fn kind(&self) -> u8 {
        match self {
            Order::Seeds { open, filled, .. } if is_wide(*open, *filled) => 22,
            Order::Seeds { .. } => 16,
            Order::Dead { .. } => 17,
            Order::Obstacle { .. } => 18,
            Order::Alive { .. } => 19,
            Order::Instruct { .. } => 20,
            Order::Steer { .. } => 21,
            Order::Tune(_) => 23,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            Order::Seeds { task, open, filled } => {
                task.put(out);
                let wide = is_wide(*open, *filled);
                open.encode(wide, out);
                filled.encode(wide, out);
            }
            Order::Dead { id, pose } => {
                out.u32(id.0);
                pose.put(out);
            }
            Order::Alive { id } => out.u32(id.0),
            Order::Obstacle { cell, there } => {
                out.cell(*cell);
                out.bool(*there);
            }
            Order::Instruct { number, instruction } => {
                out.u32(*number);
                instruction.put(out);
            }
            Order::Steer { steering, until } => {
                steering.put(out);
                out.u64(until.0);
            }
            Order::Tune(tuning) => tuning.put(out),
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Order, WireError> {
        Ok(match kind {
            16 | 22 => {
                let (task, wide) = (Task::take("task", from)?, kind == 22);
                let (open, filled) = (SeedSet::decode(wide, from)?, SeedSet::decode(wide, from)?);
                if is_wide(open, filled) != wide {
                    return Err(WireError::Field("seeds"));
                }
                Order::Seeds { task, open, filled }
            }
            18 => Order::Obstacle { cell: from.cell()?, there: from.bool("there")? },
            17 => Order::Dead { id: ModuleId(from.u32()?), pose: Pose::take("pose", from)? },
            19 => Order::Alive { id: ModuleId(from.u32()?) },
            20 => {
                Order::Instruct { number: from.u32()?, instruction: Instruction::take("instruction", from)? }
            }
            21 => Order::Steer { steering: Steering::take("steering", from)?, until: Time(from.u64()?) },
            23 => Order::Tune(Tuning::take("tuning", from)?),
            _ => return Err(WireError::Kind(kind)),
        })
    }
}

/// Status report to the world-controller, sent on each change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Status {
    /// The pose that it believes itself to be in.
    pub pose: Pose,
    /// The seed it fills.
    pub settled: Option<u8>,
    /// The number of its attempts that it gave up because two bodies would have met.
    pub prevented: u32,
    /// The metamodule that denied its last attempt or goes first, until the next motion begins.
    pub waits_for: Option<ModuleId>,
    /// Seeds to which it has found no route.
    pub unreachable: SeedSet,
    /// It has found out that no metamodule can continue.
    pub deadlocked: bool,
    /// It moves, or has asked for a lock to move (reported under `planned` only).
    pub busy: bool,
    /// Under `planned`: its joints did not turn when they should have, and have not turned since. Under `negotiated`: it
    /// asks the operator, since it would search for a plan of all together.
    pub stuck: bool,
}

impl Status {
    fn is_wide(&self) -> bool {
        self.unreachable.narrow().is_none()
    }
}

impl Wire for Status {
    fn kind(&self) -> u8 {
        if self.is_wide() { 17 } else { 16 }
    }
    fn encode(&self, out: &mut Encoder) {
        self.pose.put(out);
        out.u8(self.settled.unwrap_or(u8::MAX));
        out.u32(self.prevented);
        self.waits_for.put(out);
        self.unreachable.encode(self.is_wide(), out);
        out.bool(self.deadlocked);
        out.bool(self.busy);
        out.bool(self.stuck);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Status, WireError> {
        if !matches!(kind, 16 | 17) {
            return Err(WireError::Kind(kind));
        }
        let pose = Pose::take("pose", from)?;
        let settled = match from.u8()? {
            u8::MAX => None,
            s if usize::from(s) < MAX_SEEDS => Some(s),
            _ => return Err(WireError::Field("settled")),
        };
        let prevented = from.u32()?;
        let waits_for = Field::take("waits_for", from)?;
        let unreachable = SeedSet::decode(kind == 17, from)?;
        let deadlocked = from.bool("deadlocked")?;
        let (busy, stuck) = (from.bool("busy")?, from.bool("stuck")?);
        let status = Status { pose, settled, prevented, waits_for, unreachable, deadlocked, busy, stuck };
        if status.is_wide() == (kind == 17) { Ok(status) } else { Err(WireError::Field("unreachable")) }
    }
}

//! Faults of the world of metamodules, and commands that change their goal.

use crate::director::faults::WorldFault;

/// A foreign object comes into a cell.
pub const OBSTACLE: WorldFault = WorldFault { name: "block", harms: true, shifts: false };
/// The foreign object is removed.
pub const OBSTACLE_GONE: WorldFault = WorldFault { name: "unblock", harms: false, shifts: false };
/// All latches on an element open by themselves, and it falls.
pub const DROP: WorldFault = WorldFault { name: "drop", harms: true, shifts: false };
/// The goal moves along the floor: by this many connectors along x and y.
pub const GOAL_MOVED: WorldFault = WorldFault { name: "goal.move", harms: false, shifts: true };
/// What operators can command besides faults.
pub const COMMANDS: [&WorldFault; 1] = [&GOAL_MOVED];

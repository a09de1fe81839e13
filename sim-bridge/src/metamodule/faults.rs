//! Faults of the world of metamodules.

use crate::director::faults::WorldFault;

/// A foreign object comes into a cell.
pub const OBSTACLE: WorldFault = WorldFault { name: "block", harms: true };
/// The foreign object is removed.
pub const OBSTACLE_GONE: WorldFault = WorldFault { name: "unblock", harms: false };

//! Reasons for which a structure does not walk as asked.

use metamorph_kernel::director::reason::{Excuse, Reason, Why};

/// No module is left whose joints could move.
pub const NO_JOINT: Reason =
    Reason::new("no-joint", Excuse::Always, "infeasible: all modules are dead, so no joint can move");
/// The structure stays where it is.
pub const STILL: Reason = Reason::new(
    "still",
    Excuse::IfBroken,
    "deadlock: the structure stays where it is, whatever gait it tries",
);
/// The structure moves, but not as fast as asked.
pub const SLOW: Reason =
    Reason::new("slow", Excuse::IfBroken, "livelock: the structure moves, but more slowly than asked");

/// The module is dead.
pub const DEAD: Why = Why("is dead");

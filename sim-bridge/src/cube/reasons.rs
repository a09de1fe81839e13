//! Reasons for a standstill of cubes.

use metamorph_kernel::director::reason::{Excuse, Reason, Why};

/// Every spare module that could walk holds a dead or stuck one and must stay, or waits for one that does.
/// Holding on to a broken module keeps it from falling off.
pub const PINNED: Reason = Reason::new(
    "pinned",
    Excuse::IfBroken,
    "pinned: every spare module that has a way holds a dead or stuck module, or waits for one that does",
);
/// The joints of the module do not turn.
pub const IMMOBILE: Why = Why("cannot turn its joints");
/// The module has no parent that it could leave.
pub const UNATTACHED: Why = Why("has no parent in the forest");
/// The module holds one that seems dead.
pub const HOLDS_DEAD: Why = Why("holds a module that seems dead");
/// No distance to a goal cell reaches the module.
pub const HEARS_OF_NO_TARGET: Why = Why("hears of no goal cell");

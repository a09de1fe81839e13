//! Reasons for a standstill of free modules.

use metamorph_kernel::director::reason::{Excuse, Reason, Why};

/// The planner has examined every configuration that can be reached.
pub const NO_PLAN: Reason =
    Reason::new("no-plan", Excuse::Always, "no plan: every configuration that can be reached was examined");
/// The planner reached its limits.
pub const UNDECIDED: Reason =
    Reason::new("undecided", Excuse::IfBroken, "undecided: memory or work ended before a plan was found");
/// Plan after plan could not be carried out.
pub const NOT_CARRIED_OUT: Reason = Reason::new(
    "not-carried-out",
    Excuse::IfBroken,
    "deadlock: steps of one plan after the other could not be carried out",
);

/// The joint of the module does not turn.
pub const STUCK: Why = Why("has a joint that does not turn");
/// The module does not answer.
pub const SILENT: Why = Why("does not answer");
/// The module is dead.
pub const DEAD: Why = Why("is dead");

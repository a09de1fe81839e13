//! Reasons for a standstill: descriptors, of which each family declares its own besides those here.

use std::fmt;

/// The reason for a standstill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reason {
    /// The name used in reports.
    pub name: &'static str,
    /// The reason in words, for reports.
    pub text: &'static str,
    /// The condition under which a run that ended for this reason does not count as a fault of the protocol, without
    /// further proof.
    pub excuse: Excuse,
    /// The proof that the reason itself gives.
    pub proves: Proves,
}

/// The condition under which a standstill does not count as a fault of the protocol, without further proof.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Excuse {
    /// Never: a module could have continued.
    Never,
    /// If a process has died.
    IfDead,
    /// If a process has died or a joint sticks.
    IfBroken,
    /// Always, by design of the protocol: published strategies have local minima.
    ByDesign,
    /// Always: no module could have continued as the others stand.
    Always,
}

/// Proof that a reason gives about the cells that could have been filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proves {
    /// Nothing.
    Nothing,
    /// No more cells can be filled in any way, by counting.
    Counted,
    /// The whole goal cannot be built in any way; more of it may be.
    Incomplete,
    /// Nothing, and neither does a search at the present place: at another place of the goal more may be possible.
    NotHere,
}

impl Reason {
    /// Creates a reason that proves nothing.
    pub const fn new(name: &'static str, excuse: Excuse, text: &'static str) -> Reason {
        Reason { name, text, excuse, proves: Proves::Nothing }
    }
    /// Returns the reason with what it proves.
    pub const fn proving(self, proves: Proves) -> Reason {
        Reason { proves, ..self }
    }
    /// Returns true if no module could have continued as the others stand, so that the standstill is not the fault
    /// of a module. To prove that no plan exists at all takes a search.
    pub fn is_infeasible(self) -> bool {
        matches!(self.excuse, Excuse::Always) || self == NO_ACTIVE_TARGET
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// A spare module could walk to a goal cell, but does not: a fault of the protocol.
pub const BLOCKED: Reason = Reason::new(
    "blocked",
    Excuse::Never,
    "deadlock: a spare module has a way to a goal cell and does not take it",
);
/// There are fewer live spare modules that can move than cells to fill, so the goal cannot be completed.
pub const MATERIAL_EXHAUSTED: Reason = Reason::new(
    "material-exhausted",
    Excuse::Always,
    "material exhausted: fewer live spare modules than goal cells to fill",
)
.proving(Proves::Incomplete);
/// There is no live spare module that can move.
pub const NO_SPARE: Reason = Reason::new(
    MATERIAL_EXHAUSTED.name,
    Excuse::Always,
    "material exhausted: no live spare module is left that can move to a goal cell",
)
.proving(Proves::Counted);
/// No path leads to a goal cell, even over dead modules.
pub const NO_PATH: Reason = Reason::new(
    "no-way",
    Excuse::Always,
    "no way: no module could walk to a goal cell while the others stay where they are",
);
/// No live finalized module touches an unfilled goal cell that it could start.
pub const NO_ACTIVE_TARGET: Reason = Reason::new(
    "no-active-target",
    Excuse::IfDead,
    "no active target: no live finalized module can start one of the unfilled goal cells",
);

/// The modules have brought themselves into a state from which the goal cannot be built.
pub const SELF_BLOCKED: Reason = Reason::new(
    "self-blocked",
    Excuse::Never,
    "self-blocked: where the last fault left the modules the goal could still be built, and now it cannot",
);

/// Why a free module does not continue, as far as it has reported: in words, after its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Why(pub &'static str);

impl Why {
    /// The module waits for a dead one.
    pub const WAITS_FOR_DEAD: Why = Why("waits for a dead module");
    /// The module waits for another: its child, one that has locked it or refused it, or one in its path.
    pub const WAITS: Why = Why("waits");
    /// Nothing that the module has reported holds it.
    pub const UNKNOWN: Why = Why("does not move, for no reason that it has told");
}

//! Reasons for a standstill of metamodules.

use metamorph_kernel::director::reason::{Excuse, Proves, Reason, Why};

/// An operator has given up the goal, and no other one was to come.
pub const GOAL_GIVEN_UP: Reason = Reason::new(
    "goal-given-up",
    Excuse::Always,
    "goal given up: an operator has dropped the goal, and set no other one",
);
/// An immovable body or obstacle is in a cell of an unfilled seed.
pub const SEED_BLOCKED: Reason = Reason::new(
    "seed-blocked",
    Excuse::Always,
    "seed blocked: something that cannot move is in a cell of an unfilled seed",
)
.proving(Proves::Incomplete);
/// A dead metamodule holds an element that is not at its goal. Its latch stays closed.
pub const ELEMENT_PINNED: Reason = Reason::new(
    "element-pinned",
    Excuse::Always,
    "element pinned: a dead metamodule holds an element that is not at its goal",
)
.proving(Proves::Incomplete);
/// A fall has put an element into cells of the other colour than those of its goal, and no lattice motion changes that.
pub const ELEMENT_OFF_COLOUR: Reason = Reason::new(
    "element-off-colour",
    Excuse::Always,
    "element off colour: an element has fallen into cells from which no lattice motion leads to its goal",
)
.proving(Proves::Incomplete);
/// No transport was found for an element that is not at its goal: something that stands still is in the way.
pub const ELEMENT_BLOCKED: Reason = Reason::new(
    "element-blocked",
    Excuse::ByDesign,
    "element blocked: no way was found to bring an element to its goal as the others stand",
);
/// No free metamodule has a better place to go to: a local minimum of the field.
pub const NO_BETTER_PLACE: Reason = Reason::new(
    "no-better-place",
    Excuse::ByDesign,
    "deadlock: no free metamodule can get to a place that the force field prefers to its own",
);
/// A free metamodule has a better place to go to, but is refused the path.
pub const NO_LOCK: Reason = Reason::new(
    "no-lock",
    Excuse::ByDesign,
    "deadlock: a free metamodule is refused the way to a better place",
);
/// Nothing more is built at the present place of the goal, which may be moved, and it is not proved that the
/// goal cannot be built elsewhere.
pub const MISPLACED: Reason = Reason::new(
    "misplaced",
    Excuse::Never,
    "misplaced: nothing more is built where the goal is now, and it may be possible at another place",
)
.proving(Proves::NotHere);

/// The metamodule knows no path to any open seed.
pub const BARRED: Why = Why("knows no way to an open seed");
/// The metamodule could bring an element to its goal if the other one, which is dead, were not where it is.
pub const KEPT_FROM_ELEMENT: Why = Why("has no way with the element past a dead metamodule");
/// No place within reach is better than the present one.
pub const HAS_NO_BETTER_PLACE: Why = Why("has no better place to go to");

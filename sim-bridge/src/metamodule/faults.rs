//! Faults of the world of metamodules, and commands that change their goal or how they decide.

use metamorph_kernel::director::faults::{Form, WorldFault};
use metamorph_protocol::metamodule::blueprint::SeedOrder;

/// A foreign object comes into a cell.
pub const OBSTACLE: WorldFault =
    WorldFault { name: "block", harms: true, form: Form::Cell, about: "an obstacle comes into the cell" };
/// The foreign object is removed.
pub const OBSTACLE_GONE: WorldFault =
    WorldFault { name: "unblock", harms: false, form: Form::Cell, about: "the obstacle is removed" };
/// All latches on an element open by themselves, and it falls.
pub const DROP: WorldFault =
    WorldFault { name: "drop", harms: true, form: Form::Element, about: "the element falls" };
/// The goal moves along the floor: by this many connectors along x and y.
pub const GOAL_MOVED: WorldFault = WorldFault {
    name: "goal.move",
    harms: false,
    form: Form::Shift,
    about: "the goal moves by that many connectors",
};
/// Another goal of the scenario, by its number from 0, is built from now on, in its own place.
pub const GOAL_SET: WorldFault = WorldFault {
    name: "goal.set",
    harms: false,
    form: Form::Number,
    about: "another goal of the scenario, counted from 0, is built",
};
/// The goal turns where it stands, by this many quarters from x to y.
pub const GOAL_TURNED: WorldFault = WorldFault {
    name: "goal.turn",
    harms: false,
    form: Form::Number,
    about: "the goal turns where it stands, by that many quarters from x to y",
};
/// The seeds of the goal open in another order.
pub const GOAL_ORDERED: WorldFault = WorldFault {
    name: "goal.order",
    harms: false,
    form: Form::Word(&ORDERS),
    about: "the seeds of the goal open in another order",
};
/// The goal is given up, and nothing is built until another one begins.
pub const GOAL_DROPPED: WorldFault = WorldFault {
    name: "goal.drop",
    harms: false,
    form: Form::Nothing,
    about: "the goal is given up: nothing is built until another goal is set",
};
/// A parameter of the published strategies is another one from now on.
pub const TUNED: WorldFault = WorldFault {
    name: "tune",
    harms: false,
    form: Form::Word(&TUNABLE),
    about: "a parameter of the strategy changes",
};
/// Commands of operators other than faults.
pub const COMMANDS: [&WorldFault; 6] =
    [&GOAL_MOVED, &GOAL_SET, &TUNED, &GOAL_TURNED, &GOAL_ORDERED, &GOAL_DROPPED];

/// The orders in which seeds can open, as a scenario writes them.
pub const ORDERS: [&str; 3] = [SeedOrder::ALL[0].name(), SeedOrder::ALL[1].name(), SeedOrder::ALL[2].name()];

/// The parameters with their values, as a scenario writes them. A strategy brings its own repulsion and precedence.
pub const TUNABLE: [&str; 11] = [
    "strategy=greedy",
    "strategy=slope",
    "strategy=step",
    "repulsion=off",
    "repulsion=slope",
    "repulsion=step",
    "precedence=off",
    "precedence=seed-distance",
    "precedence=id",
    "settled_repel=true",
    "settled_repel=false",
];

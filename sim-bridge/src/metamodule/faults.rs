//! Faults of the world of metamodules, and commands that change their goal or how they decide.

use crate::director::faults::{Form, WorldFault};

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
/// A parameter of the published strategies is another one from now on.
pub const TUNED: WorldFault = WorldFault {
    name: "tune",
    harms: false,
    form: Form::Word(&TUNABLE),
    about: "a parameter of the strategy changes",
};
/// What operators can command besides faults.
pub const COMMANDS: [&WorldFault; 3] = [&GOAL_MOVED, &GOAL_SET, &TUNED];

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

//! The look of modules of a protocol in Python: they are drawn as cubes. A message is named by its class and its first whole
//! number.

use super::agent::PyAgent;
use super::message::Payload;
use super::setup::Setup;
use metamorph_protocol::cube::body::{Move, Percept};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::wire::Never;
use metamorph_world_controller::family::cube;
use metamorph_world_controller::report::message_timeline::{FAR, MessageLabel};
use metamorph_world_controller::run::replay::Worded;
use metamorph_world_controller::view::parts::{Motion, Part, Shape, Tone};
use metamorph_world_controller::view::visible::{
    ActionOutcome, Colour, GoalView, ModuleView, Role, Stage, Targets, Visible, Words,
};

const MODULE: Role = Role { name: "module", colour: Colour::Idle, legend: "module", about: "a module" };

impl Visible for PyAgent {
    const WORDS: Words = Words {
        module: "Module",
        modules: "modules",
        target: "target",
        targets: "targets",
        distance: ["step", "steps"],
        actions: "moves",
        levels: ["first", "last"],
        roles: [MODULE, MODULE, MODULE],
        moving_role: None,
        scale: 0.95,
        scale_among_messages: Some(0.42),
    };

    fn stage(setup: &Setup) -> Stage {
        let goals = vec![Vec::new()];
        Stage {
            time_step: setup.move_time,
            goals,
            targets: Targets::Cells,
            floor: None,
            contacts: Vec::new(),
        }
    }
    fn at_rest(_: &Setup, cell: &Cell) -> Vec<Part> {
        vec![Part::in_cell(Shape::Box { size: [1.0; 3] }, *cell, Default::default(), Tone::Plain)]
    }
    fn motion(setup: &Setup, cell: &Cell, action: &Move) -> Option<(Motion, Cell)> {
        Some(cube::motion(setup.move_time, cell, action))
    }
    fn cell(cell: &Cell) -> Cell {
        *cell
    }
    fn whereabouts(cell: &Cell) -> String {
        cell.to_string()
    }
    fn fate(percept: &Percept) -> ActionOutcome {
        match percept {
            Percept::Arrived(_) => ActionOutcome::Done,
            Percept::Failed => ActionOutcome::Failed(""),
            Percept::Refused(_) => ActionOutcome::Refused,
        }
    }
    fn standing(_: &Payload) -> ModuleView {
        ModuleView { role: 0, flags: 0, place: 0, waits_for: None }
    }
    fn said(setup: &Setup, message: &Payload) -> MessageLabel {
        setup.label(message)
    }
    fn moves(_: Option<u32>) -> u16 {
        FAR
    }
    fn goal(order: &Never) -> Option<GoalView> {
        match *order {}
    }
}

impl Worded for PyAgent {
    fn place(cell: &Cell) -> String {
        cell.to_string()
    }
    fn action(action: &Move) -> String {
        format!("{action:?}")
    }
    fn percept(percept: &Percept) -> String {
        format!("{percept:?}")
    }
    fn order(order: &Never) -> String {
        match *order {}
    }
    fn report(report: &Payload) -> String {
        format!("{report:?}")
    }
}

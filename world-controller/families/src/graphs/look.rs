//! The appearance of modules with a graph of contacts, and the descriptions of what they say.

use super::{GraphProtocol, view};
use crate::visible::Visible;
use crate::worded::Worded;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::wire::Never;
use metamorph_report::message_timeline::{FAR, MessageLabel};
use metamorph_scene::parts::{Motion, Part, Shape, Tone};
use metamorph_scene::visible::{ActionOutcome, Colour, GoalView, ModuleView, Role, Stage, Targets, Words};
use nalgebra::UnitQuaternion;

const fn role(name: &'static str, colour: Colour) -> Role {
    Role { name, colour, legend: name, about: name }
}

/// Roles for protocols that declare none: at work, busy, done.
pub const ROLES: [Role; 3] =
    [role("at work", Colour::Idle), role("busy", Colour::Active), role("done", Colour::Done)];

impl<P: GraphProtocol> Visible for P {
    const WORDS: Words = Words {
        module: "Module",
        modules: "modules",
        target: "goal",
        targets: "modules",
        distance: ["step", "steps"],
        actions: "moves",
        levels: ["first", "last"],
        roles: P::ROLES,
        moving_role: None,
        scale: 1.0,
        scale_among_messages: None,
    };

    fn stage(_: &P::Setup) -> Stage {
        let time_step = metamorph_scenario::plan::BEAT;
        Stage {
            time_step,
            goals: vec![Vec::new()],
            targets: Targets::Cells,
            floor: None,
            contacts: Vec::new(),
        }
    }
    fn at_rest(_: &P::Setup, cell: &Cell) -> Vec<Part> {
        let shape = Shape::Box { size: [1.0; 3] };
        vec![Part::in_cell(shape, *cell, UnitQuaternion::identity(), Tone::Plain)]
    }
    fn motion(_: &P::Setup, _: &Cell, action: &Never) -> Option<(Motion, Cell)> {
        match *action {}
    }
    fn cell(cell: &Cell) -> Cell {
        *cell
    }
    fn whereabouts(cell: &Cell) -> String {
        cell.to_string()
    }
    fn fate(percept: &Never) -> ActionOutcome {
        match *percept {}
    }
    fn standing(report: &P::Report) -> ModuleView {
        view::<P>(report)
    }
    fn said(_: &P::Setup, message: &P::Message) -> MessageLabel {
        P::label(message)
    }
    fn moves(_: Option<u32>) -> u16 {
        FAR
    }
    fn goal(order: &Never) -> Option<GoalView> {
        match *order {}
    }
}

impl<P: GraphProtocol> Worded for P {
    fn place(cell: &Cell) -> String {
        cell.to_string()
    }
    fn action(action: &Never) -> String {
        match *action {}
    }
    fn percept(percept: &Never) -> String {
        match *percept {}
    }
    fn order(order: &Never) -> String {
        match *order {}
    }
    fn report(report: &P::Report) -> String {
        P::describe(report)
    }
}

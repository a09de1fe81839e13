//! How modules of an election look, and what they say, for the page and for `metamorph replay`.

use crate::leader::{Leader, Lowest, Setup};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::wire::Never;
use metamorph_world_controller::report::message_timeline::{FAR, MessageLabel};
use metamorph_world_controller::run::replay::Worded;
use metamorph_world_controller::view::parts::{Motion, Part, Shape, Tone};
use metamorph_world_controller::view::visible::{
    ActionOutcome, Colour, GoalView, ModuleView, Role, Stage, Targets, Visible, Words,
};

const VOTER: Role = Role { name: "voter", colour: Colour::Idle, legend: "votes", about: "votes" };

impl Visible for Leader {
    const WORDS: Words = Words {
        module: "Module",
        modules: "modules",
        target: "vote",
        targets: "votes",
        distance: ["step", "steps"],
        actions: "moves",
        levels: ["first", "last"],
        roles: [
            VOTER,
            VOTER,
            Role {
                name: "agreed",
                colour: Colour::Done,
                legend: "names the lowest",
                about: "names module {}",
            },
        ],
        moving_role: None,
        scale: 0.95,
        scale_among_messages: Some(0.42),
    };

    fn stage(setup: &Setup) -> Stage {
        Stage { time_step: setup.repeat, goals: vec![Vec::new()], targets: Targets::Cells, floor: None }
    }
    fn at_rest(_: &Setup, cell: &Cell) -> Vec<Part> {
        vec![Part::in_cell(Shape::Box { size: [1.0; 3] }, *cell, Default::default(), Tone::Plain)]
    }
    fn motion(_: &Setup, _: &Cell, action: &Never) -> Option<(Motion, Cell)> {
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
    fn standing(Lowest(lowest): &Lowest) -> ModuleView {
        let role = if lowest.0 == 0 { 2 } else { 0 };
        ModuleView { role, flags: 0, place: lowest.0 as i32, waits_for: None }
    }
    fn said(Lowest(lowest): &Lowest) -> MessageLabel {
        MessageLabel::about("the lowest is", *lowest)
    }
    fn moves(_: Option<u32>) -> u16 {
        FAR
    }
    fn goal(order: &Never) -> Option<GoalView> {
        match *order {}
    }
}

impl Worded for Leader {
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
    fn report(Lowest(lowest): &Lowest) -> String {
        format!("the lowest number is {lowest}")
    }
}

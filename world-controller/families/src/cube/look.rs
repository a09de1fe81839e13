//! The appearance of cubes, and the labels of their messages and states.

use crate::visible::Visible;
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::body::{Move, Percept};
use metamorph_protocol::cube::control::{Order, Status};
use metamorph_protocol::cube::message::{Ask, Denial, Entry, Message};
use metamorph_protocol::cube::params::Setup;
use metamorph_protocol::lattice::{Cell, Face, MotionKind};
use metamorph_protocol::time::Span;
use metamorph_report::message_timeline::{FAR, MessageLabel};
use metamorph_scene::parts::{Displacement, Motion, Part, Segment, Shape, Step, Tone};
use metamorph_scene::visible::{ActionOutcome, Colour, GoalView, ModuleView, Role, Stage, Targets, Words};
use nalgebra::UnitQuaternion;

/// Returns the motion of a cube, and its cell afterwards. It goes straight, or around the edge of a neighbour, which it does not
/// cut.
pub fn motion(move_time: Span, cell: &Cell, Move { motion, .. }: &Move) -> (Motion, Cell) {
    let slide = |until, towards: Face| {
        let by = <[i16; 3]>::from(towards.offset()).map(f64::from);
        Segment { until, steps: vec![Step { parts: 0..1, by: Displacement::Slide(by) }] }
    };
    let (name, segments) = match motion.kind {
        MotionKind::Slide => ("slides", vec![slide(1.0, motion.heading)]),
        MotionKind::Convex => {
            ("goes around an edge", vec![slide(0.5, motion.heading), slide(1.0, motion.support)])
        }
    };
    (Motion { takes: move_time, name: name.to_owned(), segments }, motion.destination(*cell))
}

impl Visible for Cube {
    const WORDS: Words = Words {
        module: "Module",
        modules: "modules",
        target: "target",
        targets: "cells",
        distance: ["move", "moves"],
        actions: "moves",
        levels: ["seed", "last level"],
        roles: [
            Role { name: "reserve", colour: Colour::Idle, legend: "in reserve", about: "in reserve" },
            Role { name: "walker", colour: Colour::Active, legend: "wandering", about: "wandering" },
            Role { name: "final", colour: Colour::Done, legend: "finalized", about: "finalized" },
        ],
        moving_role: None,
        scale: 0.95,
        scale_among_messages: Some(0.42),
    };

    fn stage(setup: &Setup) -> Stage {
        let goals = setup.goals.iter();
        let goals = goals.map(|goal| goal.cells().map(|c| (c.x, c.y, c.z, goal.level(c))).collect());
        Stage {
            time_step: setup.params.move_time,
            goals: goals.collect(),
            targets: Targets::Cells,
            floor: None,
            contacts: Vec::new(),
        }
    }

    fn at_rest(_: &Setup, cell: &Cell) -> Vec<Part> {
        let shape = Shape::Box { size: [1.0; 3] };
        vec![Part::in_cell(shape, *cell, UnitQuaternion::identity(), Tone::Plain)]
    }

    fn motion(setup: &Setup, cell: &Cell, action: &Move) -> Option<(Motion, Cell)> {
        Some(motion(setup.params.move_time, cell, action))
    }

    fn cell(cell: &Cell) -> Cell {
        *cell
    }
    fn whereabouts(cell: &Cell) -> String {
        format!("[{}, {}, {}]", cell.x, cell.y, cell.z)
    }

    fn fate(percept: &Percept) -> ActionOutcome {
        match percept {
            Percept::Arrived(_) => ActionOutcome::Done,
            Percept::Failed => ActionOutcome::Failed(""),
            Percept::Refused(_) => ActionOutcome::Refused,
        }
    }

    fn standing(s: &Status) -> ModuleView {
        let flags = [s.attached, s.immobile, s.pinned, s.attracted];
        let flags = flags.into_iter().rev().fold(0, |bits, flag| bits << 1 | u8::from(flag));
        ModuleView { role: s.role as u8, flags, place: s.epoch.goal().into(), waits_for: s.waits_for }
    }

    fn said(_: &Setup, message: &Message) -> MessageLabel {
        match message {
            Message::Beacon(b) => {
                let known = b.field.iter().filter(|e| e.is_known()).map(|e| e.moves()).min();
                MessageLabel { distance: Some(known.unwrap_or(FAR)), ..MessageLabel::of("beacon") }
            }
            Message::Request { id, ask: Ask::Lock, .. } => MessageLabel::about("stay, for", id.origin),
            Message::Request { id, ask: Ask::Reserve(_), .. } => {
                MessageLabel::about("keep a cell free, for", id.origin)
            }
            Message::Response { id, denial: None, .. } => MessageLabel::about("granted, to", id.origin),
            Message::Response { denial: Some(why), blocker, .. } => MessageLabel {
                number: blocker.map(|id| id.0.into()),
                ..MessageLabel::of(match (why, blocker) {
                    (Denial::Occupied, None) => "denied: occupied",
                    (Denial::Occupied, Some(_)) => "denied: occupied by",
                    (Denial::Reserved, None) => "denied: reserved",
                    (Denial::Reserved, Some(_)) => "denied: reserved for",
                    (Denial::Busy, None) => "denied: leaving",
                    (Denial::Busy, Some(_)) => "denied: leaving is",
                    (Denial::Younger, None) => "denied: another has waited longer",
                    (Denial::Younger, Some(_)) => "denied: longer has waited",
                    (Denial::NoSupport, _) => "denied: no support",
                    (Denial::Quarantined, _) => "denied: just restarted",
                })
            },
            Message::Release { origin, .. } => MessageLabel::about("released, by", *origin),
            Message::Search { id, .. } => MessageLabel::about("looking for a way around", id.origin),
            Message::Heard { .. } => MessageLabel::of("heard a search"),
            Message::Found { id, .. } => MessageLabel::about("found a way around", id.origin),
        }
    }

    fn moves(gradient: Option<u32>) -> u16 {
        let moves = gradient.map(|distance| distance / u32::from(Entry::MOVE));
        moves.and_then(|moves| u16::try_from(moves).ok()).unwrap_or(FAR)
    }

    fn goal(order: &Order) -> Option<GoalView> {
        match order {
            Order::Goal(opening) => Some(GoalView { number: opening.epoch.goal(), ..GoalView::default() }),
            Order::Condemn { .. }
            | Order::Custody(_)
            | Order::Steer { .. }
            | Order::Call { .. }
            | Order::Carry { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::cube::params::Params;
    use metamorph_protocol::lattice::Motion as LatticeMotion;
    use metamorph_protocol::time::{Span, Time};

    /// Where a motion ends is where the body is at rest then, and it is drawn through the corner.
    #[test]
    fn motions_end_where_the_body_is_then() {
        let params = Params::scaled(Span::secs(1), Span::millis(10), 8);
        let setup = Setup { params, goals: Vec::new() };
        let from = Cell::new(3, -4, 5);
        for kind in [MotionKind::Slide, MotionKind::Convex] {
            for support in Face::ALL {
                for heading in support.perpendicular() {
                    let motion = LatticeMotion { kind, support, heading };
                    let action = Move { motion, not_after: Time::ZERO };
                    let (_, to) = Cube::motion(&setup, &from, &action).unwrap();
                    let at = |fraction| Cube::parts(&setup, &from, Some((&action, fraction)));
                    assert_eq!(to, motion.destination(from));
                    assert_eq!(at(1.0), Cube::at_rest(&setup, &to), "{motion:?}");
                    let corner = motion.corner(from).map(|cell| Cube::at_rest(&setup, &cell));
                    assert!(corner.is_none_or(|corner| at(0.5) == corner), "{motion:?}");
                    assert_eq!(at(1.0)[0].cell(), to);
                }
            }
        }
    }
}

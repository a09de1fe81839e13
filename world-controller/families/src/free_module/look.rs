//! The appearance of free modules, their messages, and their reports.
//!
//! A module has four half cubes. A joint turns all halves behind it, and carries the modules behind it as a whole.

use crate::visible::Visible;
use metamorph_protocol::assembly::tables::TABLES;
use metamorph_protocol::free_module::reconfiguration::message::{
    LatticeAction, LatticeBodyAction, LatticeDenial, LatticeMessage, LatticeOrder, LatticePercept,
    LatticeStatus, LockMessage, Swing,
};
use metamorph_protocol::free_module::reconfiguration::place::LatticePlace;
use metamorph_protocol::free_module::reconfiguration::{LatticeModule, LatticeSetup};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::roombots::lattice_pose::LatticeRotation;
use metamorph_protocol::roombots::{HALF_EDGE, OUTER_RADIUS};
use metamorph_report::message_timeline::{FAR, MessageLabel};
use metamorph_scene::parts::{Displacement, Motion, Part, Segment, Shape, Step, Tone, centre};
use metamorph_scene::visible::{
    ActionOutcome, Colour, GoalView, MISALIGNED, ModuleView, Role, Stage, Targets, Words,
};
use nalgebra::{Rotation3, Unit, UnitQuaternion, Vector3};

/// Number of half cubes of a module.
const HALVES: usize = 4;

/// Returns the cells of both cubes of a module.
fn cells(place: &LatticePlace) -> [Cell; 2] {
    // The axes of the outer joints go through the centres of the two cubes.
    [0, 2].map(|joint| place.axis(joint).1)
}

/// Returns the motion of parts about an axis.
pub(super) fn swing(
    setup: &LatticeSetup,
    place: &LatticePlace,
    by: &Swing,
    parts: std::ops::Range<usize>,
    name: String,
) -> Motion {
    let by = Displacement::Turn {
        axis: by.axis.map(f64::from),
        degrees: by.degrees.into(),
        through: (centre(by.pivot) - centre(place.cell)).into(),
    };
    let segments = vec![Segment { until: 1.0, steps: vec![Step { parts, by }] }];
    Motion { takes: setup.turn_time, name, segments }
}

/// Returns the place of a module that was carried.
fn carried(place: &LatticePlace, by: &Swing) -> Option<LatticePlace> {
    let axis = Unit::new_normalize(Vector3::from(by.axis.map(f64::from)));
    let matrix = Rotation3::from_axis_angle(&axis, f64::from(by.degrees).to_radians());
    let turn = LatticeRotation::nearest(matrix.matrix(), 1e-6)?;
    let rotation = turn * TABLES.rotations[usize::from(place.rotation)];
    let Cell { x, y, z } = place.cell;
    let [dx, dy, dz] = turn.apply([x - by.pivot.x, y - by.pivot.y, z - by.pivot.z]);
    Some(LatticePlace {
        cell: Cell::new(by.pivot.x + dx, by.pivot.y + dy, by.pivot.z + dz),
        rotation: TABLES.rotations.iter().position(|r| *r == rotation)? as u8,
        ..*place
    })
}

impl Visible for LatticeModule {
    const WORDS: Words = Words {
        module: "Module",
        modules: "modules",
        target: "joined face",
        targets: "joined faces",
        distance: ["step", "steps"],
        actions: "actions",
        levels: ["first", "last"],
        roles: [
            Role { name: "resting", colour: Colour::Idle, legend: "resting", about: "resting" },
            Role { name: "acting", colour: Colour::Active, legend: "acting", about: "acting" },
            Role {
                name: "done",
                colour: Colour::Done,
                legend: "its latest step is done",
                about: "its latest step is done",
            },
        ],
        moving_role: Some(1),
        scale: 0.985,
        scale_among_messages: None,
    };

    fn stage(setup: &LatticeSetup) -> Stage {
        Stage {
            time_step: setup.turn_time,
            goals: vec![Vec::new()],
            targets: Targets::Cells,
            floor: None,
            contacts: Vec::new(),
        }
    }

    fn at_rest(_: &LatticeSetup, place: &LatticePlace) -> Vec<Part> {
        let shape = Shape::HalfCube { radius: OUTER_RADIUS, half_edge: HALF_EDGE };
        let (cells, t) = (cells(place), &**TABLES);
        let half = |h: usize| {
            let frame = t.times(place.rotation, t.hemisphere[usize::from(place.posture)][h]);
            let frame = t.rotations[usize::from(frame)];
            // The first half of each cube looks the other way.
            let frame = if h.is_multiple_of(2) { frame * LatticeRotation::FLIP } else { frame };
            let rotation = Rotation3::from_matrix_unchecked(frame.matrix());
            let tone = if h < HALVES / 2 { Tone::Plain } else { Tone::Light };
            Part::in_cell(shape, cells[h / 2], UnitQuaternion::from_rotation_matrix(&rotation), tone)
        };
        (0..HALVES).map(half).collect()
    }

    fn motion(
        setup: &LatticeSetup,
        from: &LatticePlace,
        action: &LatticeAction,
    ) -> Option<(Motion, LatticePlace)> {
        let still =
            |name: &str| Motion { takes: setup.connect_time, name: name.to_owned(), segments: Vec::new() };
        Some(match action.body_action {
            LatticeBodyAction::Attach(connector) => {
                let closed = from.closed | 1 << connector;
                (still("closes a connector"), LatticePlace { closed, ..*from })
            }
            LatticeBodyAction::Detach(connector) => {
                let closed = from.closed & !(1 << connector);
                (still("opens a connector"), LatticePlace { closed, ..*from })
            }
            LatticeBodyAction::Turn { joint, positive } => {
                let (axis, pivot) = from.axis(joint);
                let step = if joint == 1 { 90 } else { 120 };
                let degrees = if positive { step } else { -step };
                let by = Swing { pivot, axis: axis.map(|a| a as i8), degrees };
                let behind = usize::from(joint) + 1..HALVES;
                let posture =
                    TABLES.turned[usize::from(from.posture)][usize::from(joint)][usize::from(positive)];
                let name = format!("turns joint {}", joint + 1);
                (swing(setup, from, &by, behind, name), LatticePlace { posture, ..*from })
            }
        })
    }

    fn carried(
        setup: &LatticeSetup,
        place: &LatticePlace,
        percept: &LatticePercept,
    ) -> Option<(Motion, LatticePlace)> {
        let LatticePercept::Carried(by) = percept else { return None };
        let motion = swing(setup, place, by, 0..HALVES, "is carried".to_owned());
        Some((motion, carried(place, by)?))
    }

    fn cell(place: &LatticePlace) -> Cell {
        place.cell
    }
    fn whereabouts(place: &LatticePlace) -> String {
        let [a, b, c] = place.degrees();
        format!("{}, joints at {a}°, {b}°, {c}°", place.cell)
    }

    fn fate(percept: &LatticePercept) -> ActionOutcome {
        match percept {
            LatticePercept::Done(_) => ActionOutcome::Done,
            LatticePercept::Failed | LatticePercept::Settled { moved: false, .. } => {
                ActionOutcome::Failed("")
            }
            LatticePercept::Misaligned => ActionOutcome::Failed(MISALIGNED),
            LatticePercept::Refused(_) => ActionOutcome::Refused,
            LatticePercept::Carried(_) | LatticePercept::Settled { moved: true, .. } => {
                ActionOutcome::Carried
            }
        }
    }

    fn standing(s: &LatticeStatus) -> ModuleView {
        let is_done = s.last.is_some_and(|(_, result)| result.is_ok());
        let role = if s.busy { 1 } else { u8::from(is_done) * 2 };
        ModuleView { role, flags: 0, place: -1, waits_for: s.waits_for }
    }

    fn said(_: &Self::Setup, message: &LatticeMessage) -> MessageLabel {
        let LatticeMessage { origin, what, .. } = *message;
        match what {
            LockMessage::Request => MessageLabel::about("keep still, for", origin),
            LockMessage::Release => MessageLabel::about("branch lock released, by", origin),
            LockMessage::Response(None) => MessageLabel::of("branch lock granted"),
            LockMessage::Response(Some((why, _))) => MessageLabel::of(match why {
                LatticeDenial::Busy => "branch lock refused: has a pending action",
                LatticeDenial::Held => "branch lock refused: keeps still for another",
                LatticeDenial::Loop => "branch lock refused: a loop",
                LatticeDenial::Quarantined => "branch lock refused: just restarted",
                LatticeDenial::Changed => "branch lock refused: a connection has changed",
            }),
        }
    }

    fn moves(_: Option<u32>) -> u16 {
        FAR
    }
    fn goal(_: &LatticeOrder) -> Option<GoalView> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::assembly::checker::{PhysicalAction, Physics, World};
    use metamorph_protocol::assembly::collision::Model;
    use metamorph_protocol::free_module::reconfiguration::message::StepName;
    use metamorph_protocol::time::{Span, Time};
    use std::collections::BTreeSet;

    fn seen(parts: &[Part]) -> Vec<[Vector3<f64>; 2]> {
        parts.iter().map(|p| [p.centre(), p.pose.rotation * Vector3::repeat(1.0)]).collect()
    }

    /// After a turn the parts are where the joints have taken them, of the module and of one that it carries.
    #[test]
    fn turning_halves_go_where_the_joints_take_them() {
        let setup = LatticeSetup::scaled(Span::secs(1), Span::millis(100));
        let physics = Physics { collision: Model::Final, active: false, standing: None };
        let mut turns = 0;
        for rotation in 0..24 {
            for posture in 0..36 {
                let cell = Cell::new(2, -3, 4);
                let from = LatticePlace { cell, rotation, posture, closed: 0 };
                for (joint, positive) in [(0, true), (0, false), (1, true), (1, false), (2, true)] {
                    let action = LatticeAction {
                        step: StepName::default(),
                        body_action: LatticeBodyAction::Turn { joint, positive },
                        not_after: Time::ZERO,
                    };
                    let world = World { robots: vec![from.robot()], held: BTreeSet::new() };
                    let turn = PhysicalAction::Turn(0, joint.into(), positive);
                    let after = LatticePlace::of_robot(&world.act(turn, physics).unwrap().robots[0], 0);
                    let (_, to) = LatticeModule::motion(&setup, &from, &action).unwrap();
                    assert_eq!(to, after);
                    let moved = seen(&LatticeModule::parts(&setup, &from, Some((&action, 1.0))));
                    let rest = seen(&LatticeModule::at_rest(&setup, &to));
                    let far = moved.iter().flatten().zip(rest.iter().flatten()).map(|(a, b)| (a - b).norm());
                    assert!(far.fold(0.0, f64::max) < 1e-9, "{from:?} {action:?}");
                    turns += 1;
                }
                let by = Swing { pivot: Cell::new(1, 0, 4), axis: [1, -1, 1], degrees: 120 };
                let (motion, to) =
                    LatticeModule::carried(&setup, &from, &LatticePercept::Carried(by)).unwrap();
                let mut parts = LatticeModule::at_rest(&setup, &from);
                motion.carry(&mut parts, 1.0);
                let (moved, rest) = (seen(&parts), seen(&LatticeModule::at_rest(&setup, &to)));
                let far = moved.iter().flatten().zip(rest.iter().flatten()).map(|(a, b)| (a - b).norm());
                assert!(far.fold(0.0, f64::max) < 1e-9, "{from:?} carried");
            }
        }
        assert_eq!(turns, 24 * 36 * 5);
    }
}

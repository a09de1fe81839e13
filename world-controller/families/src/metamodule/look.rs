//! The appearance of metamodules, and the words for their state. A metamodule has eight parts, the halves of
//! its four cubes from the foot on; the axes of its joints go through the centres of cubes.

use crate::visible::Visible;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::metamodule::message::{Action, BodyAction, Denial, Message, Order, Percept, Status};
use metamorph_protocol::metamodule::params::{Ask, Setup, Strategy};
use metamorph_protocol::metamodule::pose::{End, Load, Pose};
use metamorph_protocol::roombots::lattice_pose::{Half, LatticeRotation};
use metamorph_protocol::roombots::posture::{is_middle, values};
use metamorph_protocol::roombots::{HALF_EDGE, OUTER_RADIUS};
use metamorph_protocol::time::Span;
use metamorph_report::message_timeline::{FAR, MessageLabel};
use metamorph_scene::parts::{Displacement, Motion, Part, Segment, Shape, Step, Tone, centre};
use metamorph_scene::visible::{
    ActionOutcome, Colour, Floor, GoalView, MISALIGNED, ModuleView, Role, Stage, Targets, Words,
};
use nalgebra::{Rotation3, UnitQuaternion};
use std::ops::Range;

/// Number of half cubes of a metamodule.
const HALVES: usize = 8;
/// Number of joints of a metamodule.
const JOINTS: usize = 6;
/// Height of an upright metamodule in cells.
const HEIGHT: i16 = 4;

/// A metamodule at rest, from the attached end on.
#[derive(Default)]
struct Skeleton {
    /// The rotation of each half cube, and its cell.
    halves: Vec<(LatticeRotation, Cell)>,
    /// The axis of each joint, and a cell whose centre it goes through.
    hinges: Vec<(Half, Cell)>,
}

/// Returns the skeleton of a pose; empty if the motion database lacks its posture.
fn skeleton(setup: &Setup, pose: &Pose) -> Skeleton {
    let mut skeleton = Skeleton::default();
    let motions = &setup.motions;
    let Some(entry) = motions.table().postures().get(usize::from(pose.posture)) else { return skeleton };
    let mut rotation = LatticeRotation::QUARTER.power(pose.state.class);
    let mut cell = Cell::new(pose.state.x, pose.state.y, 0);
    for (joint, steps) in entry.posture.steps().iter().enumerate() {
        if joint == 3 {
            cell = cell.step(rotation.up());
            rotation = rotation * LatticeRotation::QUARTER.power(motions.kind().quarter_turns());
        }
        if is_middle(joint) {
            skeleton.hinges.push((rotation.apply([0, 0, 1]), cell));
            rotation = rotation * LatticeRotation::QUARTER.power(*steps);
            cell = cell.step(rotation.up());
        } else {
            // The lower half of the cube is before the joint, the upper one behind it.
            skeleton.halves.push((rotation * LatticeRotation::FLIP, cell));
            skeleton.hinges.push((rotation.apply([1, 1, 1]), cell));
            rotation = rotation * LatticeRotation::DIAGONAL.power(*steps);
            skeleton.halves.push((rotation, cell));
        }
    }
    skeleton
}

/// Returns the halves that a joint moves while an end holds. The joint is counted from that end on, the
/// halves always from the foot on.
fn behind(joint: usize, end: End) -> Range<usize> {
    let before = joint + 1 + usize::from(joint >= JOINTS / 2);
    match end {
        End::Foot => before..HALVES,
        End::Head => 0..HALVES - before,
    }
}

/// Flag bits of a metamodule that asks the operator, as in [`ModuleView::flags`].
const ASKS: u8 = 16;

impl Visible for Metamodule {
    const WORDS: Words = Words {
        module: "Metamodule",
        modules: "metamodules",
        target: "seed",
        targets: "seeds",
        distance: ["move", "moves"],
        // Single steps of joints, connections and releases are counted.
        actions: "actions",
        levels: ["seed", "top level"],
        roles: [
            Role { name: "free", colour: Colour::Idle, legend: "free", about: "free" },
            Role { name: "moving", colour: Colour::Active, legend: "moving", about: "moving" },
            Role { name: "settled", colour: Colour::Done, legend: "settled", about: "settled in seed {}" },
        ],
        moving_role: Some(1),
        scale: 0.985,
        scale_among_messages: None,
    };

    fn stage(setup: &Setup) -> Stage {
        let goals = (0..setup.goals.len() as u8).map(|goal| {
            let blueprint = setup.goal(Task { goal, ..Task::default() });
            let mut seeds = blueprint.seeds().iter();
            let mut cells = Vec::new();
            for (level, seeds_of_it) in blueprint.levels().iter().enumerate() {
                let of_level = seeds.by_ref().take(usize::from(*seeds_of_it)).flat_map(|s| s.cells());
                cells.extend(of_level.map(|c| (c.x, c.y, c.z, level as u16)));
            }
            cells
        });
        let (min, max) = (setup.floor.min.into(), setup.floor.max.into());
        Stage {
            time_step: setup.params.turn_time,
            goals: goals.collect(),
            targets: Targets::Groups(HALVES / 2),
            floor: Some(Floor { min, max, headroom: HEIGHT }),
            contacts: Vec::new(),
        }
    }

    fn at_rest(setup: &Setup, pose: &Pose) -> Vec<Part> {
        let shape = Shape::HalfCube { radius: OUTER_RADIUS, half_edge: HALF_EDGE };
        let mut halves = skeleton(setup, pose).halves;
        if pose.end == End::Head {
            halves.reverse();
        }
        let part = |(i, (rotation, cell)): (usize, (LatticeRotation, Cell))| {
            let rotation = Rotation3::from_matrix_unchecked(rotation.matrix());
            let tone = if i < HALVES / 2 { Tone::Plain } else { Tone::Light };
            Part::in_cell(shape, cell, UnitQuaternion::from_rotation_matrix(&rotation), tone)
        };
        halves.into_iter().enumerate().map(part).collect()
    }

    fn motion(setup: &Setup, from: &Pose, action: &Action) -> Option<(Motion, Pose)> {
        let (params, motions) = (&setup.params, &setup.motions);
        let still =
            |name: &str| Motion { takes: params.connect_time, name: name.to_owned(), segments: Vec::new() };
        match action.body_action {
            BodyAction::Turn(number) => {
                let (posture, _) = motions.graph().step(from.posture, number)?;
                Some((turn(setup, from, posture)?, Pose { posture, ..*from }))
            }
            BodyAction::Attach => Some((still("grips"), Pose { both: true, ..*from })),
            BodyAction::Detach => {
                Some((still("lets go"), Pose { both: false, ..motions.turned_around(*from)? }))
            }
            BodyAction::Grip(load) => Some((still("grips an element"), Pose { load, ..*from })),
            BodyAction::LetGo => Some((still("lets go of an element"), Pose { load: Load::NONE, ..*from })),
        }
    }

    fn answer_within(setup: &Setup) -> Option<Span> {
        let asks = setup.params.strategy == Strategy::Negotiated && setup.params.ask != Ask::Never;
        asks.then_some(setup.params.answer_within)
    }

    fn elements(setup: &Setup) -> Vec<Vec<Cell>> {
        setup.elements.all().iter().map(|element| element.start.clone()).collect()
    }
    fn held(setup: &Setup, pose: &Pose) -> Option<(usize, Vec<Cell>)> {
        setup.held(*pose)
    }

    fn cell(pose: &Pose) -> Cell {
        let (x, y) = pose.foot();
        Cell::new(x, y, 0)
    }
    fn whereabouts(pose: &Pose) -> String {
        let end = match (pose.both, pose.end) {
            (true, _) => "both ends",
            (false, End::Foot) => "foot",
            (false, End::Head) => "head",
        };
        let (x, y) = pose.foot();
        format!("({x}, {y}), turned {}°, {end}", u16::from(pose.state.class) * 90)
    }

    fn fate(percept: &Percept) -> ActionOutcome {
        match percept {
            Percept::Done(_) => ActionOutcome::Done,
            Percept::Failed => ActionOutcome::Failed(""),
            Percept::Misaligned => ActionOutcome::Failed(MISALIGNED),
            Percept::Refused(_) => ActionOutcome::Refused,
        }
    }

    fn standing(s: &Status) -> ModuleView {
        let (role, place) = s.settled.map_or((0, -1), |seed| (2, i32::from(seed)));
        ModuleView { role, flags: if s.stuck { ASKS } else { 0 }, place, waits_for: s.waits_for }
    }

    fn said(_: &Setup, message: &Message) -> MessageLabel {
        match message {
            Message::State(s) => {
                let far = s.claim.map_or(FAR, |c| c.cost.into());
                MessageLabel { distance: Some(if s.settled { 0 } else { far }), ..MessageLabel::of("state") }
            }
            Message::Directive(_) => MessageLabel::of("leads: says who moves next"),
            Message::Probe(_) => MessageLabel::of("asks whether any module can go on"),
            Message::Path(w) if w.segments().is_empty() => MessageLabel::of("is where it wants to be"),
            Message::Path(_) => MessageLabel::of("tells its way"),
            Message::Request { origin, .. } => MessageLabel::about("asks for a lock, for", *origin),
            Message::Response { denial: None, .. } => MessageLabel::of("lock granted"),
            Message::Response { denial: Some(why), .. } => MessageLabel::of(match why {
                Denial::Occupied => "lock refused: stands in the way",
                Denial::Held => "lock refused: is moving through",
                Denial::Younger => "lock refused: has waited longer",
                Denial::Quarantined => "lock refused: just restarted",
            }),
            Message::Release { origin, .. } => MessageLabel::about("lock released, by", *origin),
        }
    }

    fn moves(gradient: Option<u32>) -> u16 {
        gradient.and_then(|moves| u16::try_from(moves).ok()).unwrap_or(FAR)
    }

    fn goal(order: &Order) -> Option<GoalView> {
        match order {
            Order::Seeds { task, .. } => Some(GoalView {
                number: if task.is_dropped { GoalView::NONE } else { task.goal.into() },
                quarters: task.quarters,
                shift: task.shift,
            }),
            Order::Dead { .. }
            | Order::Alive { .. }
            | Order::Obstacle { .. }
            | Order::Instruct { .. }
            | Order::Steer { .. }
            | Order::Tune(_) => None,
        }
    }
}

/// Returns the motion that turns all joints that differ at once, the short way.
fn turn(setup: &Setup, from: &Pose, to: u16) -> Option<Motion> {
    let postures = setup.motions.table().postures();
    let steps_of = |posture: u16| postures.get(usize::from(posture)).map(|entry| entry.posture);
    let (before, after) = (steps_of(from.posture)?, steps_of(to)?);
    let Skeleton { halves, hinges } = skeleton(setup, from);
    let foot = if from.end == End::Foot { halves.first() } else { halves.last() };
    let origin = centre(foot?.1);
    let (mut steps, mut first) = (Vec::new(), 0);
    for (joint, (axis, cell)) in hinges.into_iter().enumerate().rev() {
        let all = values(joint);
        let by = (after.steps()[joint] + all - before.steps()[joint]) % all;
        if by == 0 {
            continue;
        }
        let signed = if by == all - 1 { -1.0 } else { f64::from(by) };
        let by = Displacement::Turn {
            axis: axis.map(f64::from),
            degrees: signed * 360.0 / f64::from(all),
            through: (centre(cell) - origin).into(),
        };
        steps.push(Step { parts: behind(joint, from.end), by });
        first = joint;
    }
    let segments = vec![Segment { until: 1.0, steps }];
    Some(Motion { takes: setup.params.turn_time, name: format!("turns joint {}", first + 1), segments })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families;
    use crate::metamodule::Metamodules;
    use metamorph_protocol::roombots::chain::hemispheres;
    use metamorph_protocol::roombots::grid::GridState;
    use metamorph_protocol::time::Time;
    use metamorph_scenario::{LinkKind, Overrides};
    use metamorph_text::sources::NoFiles;
    use nalgebra::Vector3;
    use std::path::Path;
    use std::sync::Arc;

    fn setup() -> Arc<Setup> {
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        let plan = metamorph_scenario::read_file(families(&NoFiles), Path::new("chair"), &overrides)
            .unwrap_or_else(|p| panic!("{p}"));
        Arc::clone(&plan.swarm.of::<Metamodules>().expect("metamodules").setup)
    }

    /// Returns the visible features of halves: their centres and the tips of their domes. A turn by a third
    /// about the tip changes neither.
    fn seen(parts: &[Part]) -> Vec<[Vector3<f64>; 2]> {
        parts.iter().map(|p| [p.centre(), p.pose.rotation * Vector3::repeat(1.0)]).collect()
    }

    fn check_alike(one: &[[Vector3<f64>; 2]], other: &[[Vector3<f64>; 2]], about: &str) {
        assert_eq!(one.len(), other.len(), "{about}");
        let far = one.iter().flatten().zip(other.iter().flatten()).map(|(a, b)| (a - b).norm());
        assert!(far.fold(0.0, f64::max) < 1e-9, "{about}: {one:?} and {other:?}");
    }

    /// All moments of all turns agree with the kinematics of the module with continuous angles.
    #[test]
    fn turning_halves_go_where_the_joints_take_them() {
        let setup = setup();
        let (kind, table) = (setup.motions.kind(), setup.motions.table());
        let mut turns = 0;
        for (i, entry) in table.postures().iter().enumerate() {
            let numbers = table.steps().iter().enumerate();
            let numbers = numbers.filter(|(_, s)| s.from == i as u16 || s.to == i as u16);
            for (number, _) in numbers {
                turns += 1;
                let (class, end) = (turns % 4, if turns % 2 == 0 { End::Foot } else { End::Head });
                let state = GridState::new(2, -3, class as u8);
                let from = Pose { end, ..Pose::standing(state, i as u16) };
                let action = Action { body_action: BodyAction::Turn(number as u16), not_after: Time::ZERO };
                let Some((_, to)) = Metamodule::motion(&setup, &from, &action) else { continue };
                let after = table.postures()[usize::from(to.posture)].posture;
                let world = LatticeRotation::QUARTER.power(state.class).matrix();
                let foot = Vector3::new(state.x.into(), state.y.into(), 0.0);
                for fraction in [0.0f64, 0.3, 0.5, 1.0] {
                    let eased = fraction * fraction * (3.0 - 2.0 * fraction);
                    let angle = |(a, b): (f64, f64)| {
                        let by = (b - a).rem_euclid(std::f64::consts::TAU);
                        let short = if by > 3.2 { by - std::f64::consts::TAU } else { by };
                        a + eased * short
                    };
                    let q = entry.posture.radians().into_iter().zip(after.radians()).map(angle);
                    let half = |(h, pose): (usize, &metamorph_protocol::roombots::chain::Pose)| {
                        let own = if h % 2 == 0 { -1.0 } else { 1.0 };
                        let tip = world * pose.rotation * Vector3::repeat(own);
                        [foot + world * pose.origin, tip]
                    };
                    let exact = hemispheres(kind, &q.collect::<Vec<_>>()).unwrap();
                    let mut exact: Vec<_> = exact.iter().enumerate().map(half).collect();
                    if end == End::Head {
                        exact.reverse();
                    }
                    let parts = Metamodule::parts(&setup, &from, Some((&action, fraction)));
                    check_alike(&seen(&parts), &exact, &format!("{action:?} from {from:?} at {fraction}"));
                }
                let mut carried = Metamodule::parts(&setup, &from, Some((&action, 1.0)));
                check_alike(&seen(&carried), &seen(&Metamodule::at_rest(&setup, &to)), "at the end");
                carried.truncate(HALVES / 2);
                assert!(carried.iter().all(|part| part.tone == Tone::Plain));
            }
        }
        assert!(turns > 1000, "{turns}");
    }

    /// The parts stay the same when the other end takes over.
    #[test]
    fn halves_keep_their_places_when_the_other_end_holds() {
        let setup = setup();
        let mut swapped = 0;
        for posture in 0..setup.motions.table().postures().len() as u16 {
            for end in [End::Foot, End::Head] {
                let from = Pose { end, both: true, ..Pose::standing(GridState::new(-1, 6, 3), posture) };
                let action = Action { body_action: BodyAction::Detach, not_after: Time::ZERO };
                let Some((motion, to)) = Metamodule::motion(&setup, &from, &action) else { continue };
                assert_eq!((motion.segments, to.end), (Vec::new(), end.other()));
                let [before, after] = [from, to].map(|pose| seen(&Metamodule::at_rest(&setup, &pose)));
                check_alike(&before, &after, &format!("{from:?}, {to:?}"));
                swapped += 1;
            }
        }
        assert!(swapped > 10, "{swapped}");
    }
}

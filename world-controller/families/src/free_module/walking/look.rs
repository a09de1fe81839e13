//! The appearance of walking modules, and their messages.
//!
//! Bodies tell their poses ten times a second; between two of them parts move evenly.

use crate::visible::Visible;
use metamorph_protocol::free_module::gait::body::{
    BodyPlace, BodyPose, JointTask, QUATERNION_SCALE, WalkStatus,
};
use metamorph_protocol::free_module::gait::message::{Follow, WalkMessage, WalkOrder};
use metamorph_protocol::free_module::gait::{FreeModule, WalkSetup};
use metamorph_protocol::free_module::network::Role as Articulation;
use metamorph_protocol::free_module::oscillator::Angle;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::roombots::chain::{Pose as Frame, flip, hemispheres};
use metamorph_protocol::roombots::{CELL_METRES, HALF_EDGE, Kind, OUTER_RADIUS};
use metamorph_protocol::time::Span;
use metamorph_report::message_timeline::{FAR, MessageLabel};
use metamorph_scene::parts::{Displacement, Motion, Part, Segment, Shape, Step, Tone};
use metamorph_scene::visible::{ActionOutcome, Colour, GoalView, ModuleView, Role, Stage, Targets, Words};
use metamorph_sim_bridge::free_module::physics_world::POSE_PERIOD;
use nalgebra::{Isometry3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Length of the edge of a cell in micrometres.
const CELL: f64 = CELL_METRES * 1e6;
/// Number of cubes of a module.
const CUBES: usize = 2;

/// Returns the parts of a body.
fn parts(pose: &BodyPose) -> Vec<Part> {
    let [x, y, z, w] = pose.rotation.map(|q| f64::from(q) / f64::from(QUATERNION_SCALE));
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)).to_rotation_matrix();
    let origin = Vector3::from(pose.position.map(|x| f64::from(x) / CELL));
    let angles = pose.angles.map(|a| f64::from(a.0) / f64::from(Angle::RADIAN.0));
    let halves =
        hemispheres(Kind::Single, &angles).expect("invariant: three finite angles of a single module");
    let first = Frame { rotation: rotation.into_inner(), origin };
    let foot = first.compose(&halves[0].inverse());
    let shape = Shape::HalfCube { radius: OUTER_RADIUS, half_edge: HALF_EDGE };
    let part = |(h, half): (usize, &Frame)| {
        let Frame { rotation, origin } = foot.compose(half);
        // The first half of each cube looks the other way.
        let rotation = if h.is_multiple_of(2) { rotation * flip() } else { rotation };
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let tone = if h < CUBES { Tone::Plain } else { Tone::Light };
        Part { shape, pose: Isometry3::from_parts(Translation3::from(origin), rotation), tone }
    };
    halves.iter().enumerate().map(part).collect()
}

/// Returns the motion of parts from one pose to another.
fn motion(from: &[Part], to: &[Part]) -> Motion {
    let origin = from[0].centre();
    let steps = from.iter().zip(to).enumerate().flat_map(|(i, (from, to))| {
        let turn = (to.pose.rotation * from.pose.rotation.inverse()).scaled_axis();
        let by = [
            Displacement::Turn {
                axis: if turn.norm() > 0.0 { turn.into() } else { [0.0, 0.0, 1.0] },
                degrees: turn.norm().to_degrees(),
                through: (from.centre() - origin).into(),
            },
            Displacement::Slide((to.centre() - from.centre()).into()),
        ];
        by.map(|by| Step { parts: i..i + 1, by })
    });
    let segments = vec![Segment { until: 1.0, steps: steps.collect() }];
    Motion { takes: POSE_PERIOD, name: "walks".to_owned(), segments }
}

impl Visible for FreeModule {
    const WORDS: Words = Words {
        module: "Module",
        modules: "modules",
        target: "place",
        targets: "places",
        distance: ["step", "steps"],
        actions: "actions",
        levels: ["first", "last"],
        roles: [
            Role { name: "locked", colour: Colour::Idle, legend: "locked", about: "its joints are locked" },
            Role {
                name: "body",
                colour: Colour::Active,
                legend: "spine or hip",
                about: "it moves a spine or a hip",
            },
            Role {
                name: "limb",
                colour: Colour::Done,
                legend: "knee or ankle",
                about: "it moves a knee or an ankle",
            },
        ],
        moving_role: None,
        scale: 0.985,
        scale_among_messages: None,
    };

    fn stage(_: &WalkSetup) -> Stage {
        // The floor has no end, and views show all of a floor.
        Stage {
            time_step: Span::secs(1),
            goals: vec![Vec::new()],
            targets: Targets::Cells,
            floor: None,
            contacts: Vec::new(),
        }
    }
    fn at_rest(_: &WalkSetup, place: &BodyPlace) -> Vec<Part> {
        parts(&place.pose)
    }
    /// Commands are followed with a delay, so only poses that bodies tell are drawn.
    fn motion(_: &WalkSetup, _: &BodyPlace, _: &Follow) -> Option<(Motion, BodyPlace)> {
        None
    }
    fn carried(_: &WalkSetup, place: &BodyPlace, percept: &BodyPose) -> Option<(Motion, BodyPlace)> {
        let to = BodyPlace { pose: *percept, ..*place };
        Some((motion(&parts(&place.pose), &parts(percept)), to))
    }
    fn cell(place: &BodyPlace) -> Cell {
        let [x, y, z] = place.pose.position.map(|x| f64::from(x) / CELL);
        Cell::new(x.round() as i16, y.round() as i16, z.floor() as i16)
    }
    fn whereabouts(place: &BodyPlace) -> String {
        let [x, y, _] = place.pose.position.map(|x| f64::from(x) / 1000.0);
        format!("{x:.0} mm, {y:.0} mm")
    }
    fn fate(_: &BodyPose) -> ActionOutcome {
        ActionOutcome::Carried
    }
    fn standing(status: &WalkStatus) -> ModuleView {
        let has = |of: fn(JointTask) -> bool| status.tasks.iter().any(|task| of(*task));
        let role = if has(|t| {
            matches!(
                t,
                JointTask::Oscillates | JointTask::Articulation(Articulation::Spine | Articulation::Hip)
            )
        }) {
            1
        } else {
            u8::from(has(|t| t != JointTask::Locked)) * 2
        };
        ModuleView { role, flags: 0, place: -1, waits_for: None }
    }
    fn said(_: &Self::Setup, message: &WalkMessage) -> MessageLabel {
        MessageLabel::of(match message {
            WalkMessage::LinkState(_) => "what a module is docked to",
            WalkMessage::Known { .. } => "what is known of the structure",
            WalkMessage::Phases { .. } => "phases",
        })
    }
    fn moves(_: Option<u32>) -> u16 {
        FAR
    }
    fn goal(_: &WalkOrder) -> Option<GoalView> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::free_module::gait::message::Docking;
    use metamorph_protocol::free_module::named;
    use metamorph_protocol::free_module::structure::Joint;
    use metamorph_protocol::ids::ModuleId;
    use metamorph_sim_bridge::free_module::physics::{Down, Physics};
    use metamorph_sim_bridge::free_module::physics_world::PhysicsWorld;
    use metamorph_sim_bridge::free_module::rapier::Bodies;
    use metamorph_sim_bridge::world::World;

    /// Drawn parts are where the engine has the hemispheres, after the joints have moved, and motions lead there.
    #[test]
    fn parts_are_where_the_bodies_are() {
        let structure = named::structure("quad5-unsym").unwrap();
        let bodies = Bodies::new(&structure, &[[0.0; 3]; 5], Down::DEFAULT, 0.8).unwrap();
        let start = PhysicsWorld::new(structure.clone(), bodies);
        let before: Vec<BodyPlace> = (0..5).map(|m| start.place(ModuleId(m))).collect();
        let mut bodies = Bodies::new(&structure, &[[0.0; 3]; 5], Down::DEFAULT, 0.8).unwrap();
        (0..15).for_each(|j| bodies.set_target(Joint(j), 0.1 * f32::from(j) - 0.6));
        (0..100).for_each(|_| bodies.step());
        let world = PhysicsWorld::new(structure, bodies);
        for (m, before) in (0..5).map(ModuleId).zip(&before) {
            assert_ne!(before.docking, Docking::default());
            let place = world.place(m);
            let parts = parts(&place.pose);
            for (h, part) in parts.iter().enumerate() {
                let placed = world.physics().pose(m, h);
                let at = Vector3::from(placed.position.map(f64::from)) / CELL_METRES;
                assert!((part.centre() - at).norm() < 1e-3, "module {m}, hemisphere {h}");
                let [x, y, z, w] = placed.rotation.map(f64::from);
                let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
                let sign = if h % 2 == 0 { -1.0 } else { 1.0 };
                let plates = rotation * Vector3::repeat(sign);
                assert!((part.pose.rotation * Vector3::repeat(1.0) - plates).norm() < 1e-3, "{m} {h}");
            }
            let setup = WalkSetup::new(metamorph_protocol::free_module::network::NetworkKind::Fo);
            let (motion, to) = FreeModule::carried(&setup, before, &place.pose).unwrap();
            let mut moved = FreeModule::at_rest(&setup, before);
            motion.carry(&mut moved, 1.0);
            let off =
                moved.iter().zip(&parts).map(|(a, b)| (a.pose.inverse() * b.pose).translation.vector.norm());
            assert!(off.fold(0.0, f64::max) < 1e-9 && to.pose == place.pose, "module {m}");
        }
    }
}

//! Describes the inputs and outputs of a walking module.

use crate::worded::{Worded, at};
use metamorph_protocol::free_module::gait::FreeModule;
use metamorph_protocol::free_module::gait::body::{BodyPlace, BodyPose, JointTask, WalkStatus};
use metamorph_protocol::free_module::gait::message::{Follow, WalkOrder};
use metamorph_protocol::free_module::oscillator::Angle;
use metamorph_protocol::free_module::structure::JOINTS;
use std::fmt::Write;

/// Returns joint angles in degrees.
fn degrees(angles: &[Angle; JOINTS as usize]) -> String {
    let degrees = angles.map(|a| f64::from(a.0) / f64::from(Angle::RADIAN.0) * 57.295_779_513);
    let [a, b, c] = degrees;
    format!("{a:.1}°, {b:.1}°, {c:.1}°")
}

fn pose(pose: &BodyPose) -> String {
    let [x, y, z] = pose.position.map(|x| f64::from(x) / 1000.0);
    format!("({x:.1}, {y:.1}, {z:.1}) mm, joints at {}", degrees(&pose.angles))
}

impl Worded for FreeModule {
    fn place(place: &BodyPlace) -> String {
        pose(&place.pose)
    }
    fn action(follow: &Follow) -> String {
        format!("follow {} until {}", degrees(&follow.angles), at(follow.not_after).trim_start())
    }
    fn percept(percept: &BodyPose) -> String {
        format!("is at {}", pose(percept))
    }
    fn order(order: &WalkOrder) -> String {
        match order {
            WalkOrder::Dead { module, incarnation } => {
                format!("incarnation {incarnation} of module {module} is dead")
            }
            WalkOrder::Gait(gait) => {
                let mut text = format!("gait {} from {} on", gait.epoch, at(gait.start).trim_start());
                for (j, joint) in gait.joints.iter().enumerate() {
                    let Some(p) = joint else { continue };
                    let radians = |a: Angle| f64::from(a.0) / f64::from(Angle::RADIAN.0);
                    let turns = f64::from(p.phase.0) / 4_294_967_296.0;
                    // Writing to a string cannot fail.
                    let _ = write!(
                        text,
                        "; q{}: amplitude {:.3} rad, offset {:.3} rad, phase {turns:.3}",
                        j + 1,
                        radians(p.amplitude),
                        radians(p.offset)
                    );
                }
                text
            }
        }
    }
    fn report(status: &WalkStatus) -> String {
        let tasks = status.tasks.map(JointTask::name).join(", ");
        format!("its joints are {tasks} in the structure {:016x}", status.known)
    }
}

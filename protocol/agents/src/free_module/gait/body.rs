//! Messages between bodies and agents of walking modules: the place of a body, and the task of each joint.

use super::message::Docking;
use crate::free_module::network::Role;
use crate::free_module::oscillator::Angle;
use crate::free_module::structure::JOINTS;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};
use metamorph_core::{fields, only_message};

/// Scale of a quaternion's components: 2^30 is 1.
pub const QUATERNION_SCALE: i32 = 1 << 30;

/// Where a body is: the pose of its first hemisphere and the angles of its joints, in integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BodyPose {
    /// The centre of the hemisphere's cube in micrometres; z points up, and the floor is 0.
    pub position: [i32; 3],
    /// The rotation of the hemisphere's frame (x, y, z, w), in units of 2^-30.
    pub rotation: [i32; 4],
    /// The angles of q1, q2 and q3.
    pub angles: [Angle; JOINTS as usize],
}

impl Default for BodyPose {
    fn default() -> BodyPose {
        BodyPose {
            position: [0; 3],
            rotation: [0, 0, 0, QUATERNION_SCALE],
            angles: [Angle::default(); JOINTS as usize],
        }
    }
}

fields!(BodyPose { position, rotation, angles });
only_message!(BodyPose = 0);

/// The modules docked at a module, and the place of its body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct BodyPlace {
    /// The docked modules.
    pub docking: Docking,
    /// Where the body is.
    pub pose: BodyPose,
}

fields!(BodyPlace { docking, pose });
only_message!(BodyPlace = 0);

/// Role of a joint in the network in use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum JointTask {
    /// It has no oscillator and stays at 0.
    #[default]
    Locked,
    /// It has an oscillator in a network without articulations.
    Oscillates,
    /// It is an articulation.
    Articulation(Role),
}

impl JointTask {
    /// All tasks, in the order of their numbers in messages.
    pub const ALL: [JointTask; 6] = [
        JointTask::Locked,
        JointTask::Oscillates,
        JointTask::Articulation(Role::Spine),
        JointTask::Articulation(Role::Hip),
        JointTask::Articulation(Role::Knee),
        JointTask::Articulation(Role::Ankle),
    ];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            JointTask::Locked => "locked",
            JointTask::Oscillates => "oscillates",
            JointTask::Articulation(role) => role.name(),
        }
    }
}

/// Report of an agent that changes to another network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct WalkStatus {
    /// The hash of the link states that the network was made from.
    pub known: u64,
    /// The tasks of q1, q2 and q3.
    pub tasks: [JointTask; JOINTS as usize],
}

impl Field for JointTask {
    fn put(&self, out: &mut Encoder) {
        // Invariant: the list has all tasks.
        out.u8(JointTask::ALL.iter().position(|task| task == self).unwrap_or_default() as u8);
    }
    fn take(name: &'static str, from: &mut Decoder<'_>) -> Result<JointTask, WireError> {
        JointTask::ALL.get(usize::from(from.u8()?)).copied().ok_or(WireError::Field(name))
    }
}

fields!(WalkStatus { known, tasks as "task" });
only_message!(WalkStatus = 0);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_module::gait::message::{CONNECTORS, Docked};
    use metamorph_core::ids::ModuleId;
    use metamorph_core::wire::{PAYLOAD, from_payload, payload};
    use metamorph_roombots::connector::Connector;

    #[test]
    fn places_and_reports_fit_and_come_back() {
        let docked = Docked { peer: ModuleId(255), connector: Connector::C3Z, rotation: 3 };
        let pose = BodyPose {
            position: [-1, 2, i32::MAX],
            rotation: [i32::MIN, 0, 1, -QUATERNION_SCALE],
            angles: [Angle(-7); 3],
        };
        let place = BodyPlace { docking: Docking([Some(docked); CONNECTORS]), pose };
        assert_eq!((payload(&pose).len(), payload(&place).len()), (40, 70));
        assert!(payload(&place).len() <= PAYLOAD);
        assert_eq!(from_payload(0, &payload(&place)), Ok(place));
        assert_eq!(from_payload(0, &payload(&pose)), Ok(pose));
        for task in JointTask::ALL {
            let status = WalkStatus { known: u64::MAX, tasks: [task, JointTask::Locked, task] };
            assert_eq!(from_payload(0, &payload(&status)), Ok(status));
        }
        let mut bytes = payload(&WalkStatus::default());
        bytes[8] = 6;
        assert_eq!(from_payload::<WalkStatus>(0, &bytes), Err(WireError::Field("task")));
        assert_eq!(from_payload::<BodyPose>(1, &payload(&pose)), Err(WireError::Kind(1)));
    }
}

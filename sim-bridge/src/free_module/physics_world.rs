//! A structure with rigid bodies: agents command joint angles, and an engine moves the bodies on a floor.
//!
//! All bodies share one event: the tick of the engine. A command holds from the tick after it, and until it expires; then
//! the joints stay where they are. So do those of a module whose process has died: its connections hold, too.

use super::audit;
use super::falls::{self, Falls};
use super::physics::{Physics, TICK};
use super::structure_world::StructureWorld;
use metamorph_kernel::kernel::audited::Audited;
use metamorph_kernel::world::World;
use metamorph_kernel::world::invariants::Violation;
use metamorph_protocol::free_module::gait::FreeModule;
use metamorph_protocol::free_module::gait::body::{BodyPlace, BodyPose, QUATERNION_SCALE};
use metamorph_protocol::free_module::gait::message::Follow;
use metamorph_protocol::free_module::oscillator::Angle;
use metamorph_protocol::free_module::structure::{JOINTS, Joint, Structure};
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::{Span, Time};
use std::collections::VecDeque;
use std::hash::Hasher;

/// The depth of an overlap of two modules in metres from which it is a self-collision.
pub const COLLISION: f32 = 0.002;
/// Ticks between two checks of which modules touch the floor, and of whether the structure has fallen.
const CONTACT_PERIOD: u64 = 10;
/// The time between two poses that bodies tell, if they do.
pub const POSE_PERIOD: Span = Span::millis(100);

/// A world of rigid bodies.
pub struct PhysicsWorld<P> {
    connections: StructureWorld,
    physics: P,
    tick: Time,
    /// The command in force of each module.
    commands: Vec<Option<Follow>>,
    /// The angles of all joints at the start, from which commands count: in a ring no joint can be at 0.
    posture: Vec<f32>,
    /// The angles of all joints at the last tick.
    angles: Vec<f32>,
    stuck: Vec<bool>,
    /// The latest self-collision.
    collided: Option<Time>,
    /// The first violation. The bodies stay where they are from then on.
    broken: Option<Violation>,
    told: bool,
    /// How often each module was seen on the floor, and the number of looks.
    on_floor: (Vec<u32>, u32),
    falls: Falls,
    /// The pose of each module that it told last, and the one before, if bodies tell theirs.
    poses: Option<Vec<[BodyPose; 2]>>,
    sensed: VecDeque<(ModuleId, Sensed<BodyPose>)>,
}

impl<P: Physics> PhysicsWorld<P> {
    /// Creates a world of bodies of this structure.
    pub fn new(structure: Structure, physics: P) -> PhysicsWorld<P> {
        let bound = structure.bound();
        let angles: Vec<f32> = (0..JOINTS * bound as u16).map(|j| physics.angle(Joint(j))).collect();
        let falls = Falls::new(&structure, |module, h| falls::up(&physics.pose(module, h)));
        PhysicsWorld {
            connections: StructureWorld::new(structure),
            physics,
            tick: Time::ZERO + TICK,
            commands: vec![None; bound],
            posture: angles.clone(),
            angles,
            stuck: vec![false; bound],
            collided: None,
            broken: None,
            told: false,
            on_floor: (vec![0; bound], 0),
            falls,
            poses: None,
            sensed: VecDeque::new(),
        }
    }
    /// Lets every body tell its pose once in [`POSE_PERIOD`].
    pub fn telling_poses(mut self) -> PhysicsWorld<P> {
        let modules = (0..self.len() as u32).map(ModuleId);
        self.poses = Some(modules.map(|m| [self.pose(m); 2]).collect());
        self
    }

    /// Returns the bodies.
    pub fn physics(&self) -> &P {
        &self.physics
    }
    /// Sets whether the joints of a module stick where they are.
    pub fn set_stuck(&mut self, id: ModuleId, stuck: bool) {
        self.stuck[id.index()] = stuck;
        if stuck {
            self.commands[id.index()] = None;
            self.hold(id);
        }
    }
    /// Lets the joints of a module stay where they are.
    fn hold(&mut self, id: ModuleId) {
        for joint in (0..JOINTS).map(|j| Joint::new(id, j)) {
            self.physics.set_target(joint, self.physics.angle(joint));
        }
    }
    fn pose(&self, id: ModuleId) -> BodyPose {
        let placed = self.physics.pose(id, 0);
        let whole = |x: f32, unit: f64| (f64::from(x) * unit).round() as i32;
        BodyPose {
            position: placed.position.map(|x| whole(x, 1e6)),
            rotation: placed.rotation.map(|x| whole(x, QUATERNION_SCALE.into())),
            angles: [0, 1, 2]
                .map(|j| Angle(whole(self.physics.angle(Joint::new(id, j)), f64::from(Angle::RADIAN.0)))),
        }
    }
    /// Lets every body tell its pose.
    fn tell_poses(&mut self) {
        let Some(mut poses) = self.poses.take() else { return };
        for (id, pose) in (0..).map(ModuleId).zip(&mut poses) {
            *pose = [self.pose(id), pose[0]];
            self.sensed.push_back((id, Sensed::Percept(pose[0])));
        }
        self.poses = Some(poses);
    }
    /// Returns the time of the latest self-collision.
    pub fn collided(&self) -> Option<Time> {
        self.collided
    }
    /// Returns true if an invariant was violated, after which nothing moves.
    pub fn is_broken(&self) -> bool {
        self.broken.is_some()
    }
    /// Returns the share of time that each module has touched the floor.
    pub fn duty(&self) -> Vec<f64> {
        let (seen, looks) = &self.on_floor;
        seen.iter().map(|n| f64::from(*n) / f64::from((*looks).max(1))).collect()
    }
    /// Returns how often the body turned upside down.
    pub fn falls(&self) -> u32 {
        self.falls.count()
    }
    /// Sets the targets of all motors for a tick.
    fn command(&mut self) {
        for (m, command) in self.commands.iter_mut().enumerate() {
            let Some(follow) = command else { continue };
            let holds = follow.not_after >= self.tick;
            for j in 0..JOINTS {
                let joint = Joint::new(ModuleId(m as u32), j);
                let target = if holds {
                    self.posture[joint.index()] + radians(follow.angles[usize::from(j)])
                } else {
                    self.physics.angle(joint)
                };
                self.physics.set_target(joint, target);
            }
            if !holds {
                *command = None;
            }
        }
    }

    fn step(&mut self) {
        self.command();
        self.physics.step();
        if let Err((invariant, what)) =
            audit::check(&self.physics, self.connections.structure(), &mut self.angles)
        {
            self.broken = Some(Violation { invariant, at: self.tick, what });
            return;
        }
        if self.physics.overlap() > COLLISION {
            self.collided = Some(self.tick);
        }
        if self.tick.0.is_multiple_of(CONTACT_PERIOD * TICK.0) {
            let physics = &self.physics;
            self.falls.look(|module, h| falls::up(&physics.pose(module, h)));
            let (seen, looks) = &mut self.on_floor;
            *looks += 1;
            for (m, seen) in seen.iter_mut().enumerate() {
                *seen += u32::from(self.physics.touches_floor(ModuleId(m as u32)));
            }
        }
        if self.tick.0.is_multiple_of(POSE_PERIOD.0) {
            self.tell_poses();
        }
    }
}

/// Returns an angle in radians; exact for those that commands can have, up to the bits of a 32-bit float.
fn radians(angle: Angle) -> f32 {
    (f64::from(angle.0) / f64::from(Angle::RADIAN.0)) as f32
}

impl<P: Physics> World for PhysicsWorld<P> {
    type Agent = FreeModule;

    fn len(&self) -> usize {
        self.connections.len()
    }
    /// Returns the pose that the body told last but one: views move it from there to the one told last.
    fn place(&self, id: ModuleId) -> BodyPlace {
        let pose = self.poses.as_ref().map_or_else(|| self.pose(id), |poses| poses[id.index()][1]);
        BodyPlace { pose, ..self.connections.place(id) }
    }
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation) {
        self.connections.start(now, id, incarnation);
    }
    fn act(&mut self, _now: Time, id: ModuleId, _sensed: Revision, action: &Follow) {
        if !self.stuck[id.index()] {
            self.commands[id.index()] = Some(*action);
        }
    }
    fn next_event(&self) -> Time {
        if self.is_broken() { Time::NEVER } else { self.tick }
    }
    fn advance(&mut self, now: Time) {
        while self.tick <= now && !self.is_broken() {
            self.step();
            self.tick += TICK;
        }
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        self.physics.digest(hasher);
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<BodyPose>)> {
        self.connections.poll().or_else(|| self.sensed.pop_front())
    }
}

impl<P: Physics> Audited for PhysicsWorld<P> {
    fn take_violations(&mut self) -> Vec<Violation> {
        let news = self.broken.iter().filter(|_| !self.told).cloned().collect();
        self.told = self.broken.is_some();
        news
    }
}

//! Bodies in the engine rapier3d: joints in reduced coordinates (multibody), 32-bit floats, one thread.
//!
//! Where modules form a ring, one joint of it closes the ring by a constraint instead.
//!
//! The engine is built with `enhanced-determinism`, so that the same calls give the same bits on every machine.

use crate::floor::FloorContacts;
use crate::hull;
use crate::work::Work;
use crate::{Down, HEMISPHERES, NO_LOAD, Physics, PhysicsError, Placed, SERVO_GAIN, TICK, TORQUE};
use metamorph_protocol::free_module::geometry::place;
use metamorph_protocol::free_module::structure::{JOINTS, Joint, Structure};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::roombots::chain::{self, Chain};
use metamorph_protocol::roombots::{CELL_METRES, HEMISPHERE_MASS, Kind};
use rapier3d::parry::query::{DefaultQueryDispatcher, QueryDispatcher};
use rapier3d::prelude::{
    ColliderBuilder, ColliderHandle, GenericJoint, ImpulseJointHandle, JointAxis, MultibodyJointHandle,
    PhysicsWorld, Pose, RevoluteJointBuilder, RigidBodyBuilder, RigidBodyHandle, Rotation, SharedShape,
    Vector,
};
use std::collections::BTreeMap;
use std::hash::Hasher;

/// The name and version of the engine, and the number of how bodies are made for it, as gait files have them. With another
/// one, bodies move differently.
pub const ENGINE: &str = "rapier3d 0.36.1, bodies 2";
/// Substeps of a tick. Each computes the mass matrix of the multibody again, which is most of the time.
const SUBSTEPS: usize = 1;
/// Number of sweeps over all contacts and motors in a substep. With one sweep, as the engine has it, a structure at
/// rest creeps.
const SWEEPS: usize = 16;
/// How fast a motor reaches its speed if its torque suffices, 1/s.
const MOTOR_DAMPING: f32 = 1e5;
/// The length in metres that the engine's tolerances are made for.
const LENGTH_UNIT: f32 = 0.1;

/// The acceleration of gravity in m/s².
const GRAVITY: f32 = 9.81;

/// A hemisphere in a rigid body.
#[derive(Clone, Copy)]
struct Half {
    body: RigidBodyHandle,
    /// Its frame in that of the body.
    at: Pose,
}

/// How the engine has a joint.
#[derive(Clone, Copy)]
enum Hinge {
    /// In the tree of the multibody.
    Tree(MultibodyJointHandle),
    /// Between two bodies of the tree. The angle at the last tick since the start: it counts turns.
    Closing(ImpulseJointHandle, f32),
}

/// A joint with its motor.
#[derive(Clone, Copy)]
struct Motor {
    hinge: Hinge,
    /// The angle at the start, where the engine counts from.
    start: f32,
    /// The angle to move to.
    target: f32,
    kind: usize,
}

/// The bodies of a structure.
pub struct Bodies {
    world: PhysicsWorld,
    /// By `4 * module + hemisphere`.
    halves: Vec<Half>,
    motors: BTreeMap<Joint, Motor>,
    floor: ColliderHandle,
    /// The work of motors; `None` if there are rings, in which forces have more than one way.
    work: Option<Work>,
}

/// Where hemispheres and joints are at the start, in metres on the floor.
struct Start {
    halves: Vec<Pose>,
    /// By joint: a point on the axis, and its direction.
    axes: Vec<(Vector, Vector)>,
}

impl Bodies {
    /// Places a structure with these joint angles in degrees on the floor, at rest.
    ///
    /// # Errors
    /// Refuses a structure that has no place in space, as a ring that does not close, and friction that is none.
    pub fn new(
        structure: &Structure,
        joints_deg: &[[f64; 3]],
        down: Down,
        friction: f32,
    ) -> Result<Bodies, PhysicsError> {
        if !(friction.is_finite() && friction >= 0.0) {
            return Err(PhysicsError::Friction(friction));
        }
        let start = Start::of(structure, joints_deg, down)?;
        let mut world = PhysicsWorld { gravity: Vector::new(0.0, 0.0, -GRAVITY), ..PhysicsWorld::default() };
        let parameters = &mut world.integration_parameters;
        parameters.dt = TICK.as_secs_f64() as f32;
        parameters.num_solver_iterations = SUBSTEPS;
        parameters.num_internal_pgs_iterations = SWEEPS;
        parameters.length_unit = LENGTH_UNIT;
        // Depths of contacts are measured, so they must not be those of an earlier tick.
        parameters.contact_recycling = false;
        parameters.max_ccd_substeps = 0;
        world.narrow_phase.set_query_dispatcher(FloorContacts.chain(DefaultQueryDispatcher));
        let ground = ColliderBuilder::new(SharedShape::halfspace(Vector::Z));
        let floor = world.insert_collider(ground.friction(friction), None);
        let halves = insert_halves(&mut world, structure, &start, friction);
        let mut bodies = Bodies { world, halves, motors: BTreeMap::new(), floor, work: None };
        bodies.insert_joints(structure, joints_deg, &start);
        Ok(bodies)
    }

    /// Lets the floor rise towards +x by an angle in radians. Coordinates stay those of the floor, so gravity turns.
    pub fn tilt(&mut self, slope: f32) {
        self.world.gravity = Vector::new(-libm::sinf(slope), 0.0, -libm::cosf(slope)) * GRAVITY;
    }

    /// Lifts everything by a height in metres.
    #[cfg(test)]
    pub(super) fn lift(&mut self, height: f32) {
        for (_, body) in self.world.rigid_bodies_mut() {
            let up = body.translation() + Vector::new(0.0, 0.0, height);
            body.set_translation(up, true);
        }
    }

    /// Takes the weight from everything.
    #[cfg(test)]
    pub(super) fn weightless(&mut self) {
        self.world.gravity = Vector::ZERO;
    }

    /// Returns all contacts with the floor: the hemisphere, the normal of the floor, and the height of the point in metres.
    #[cfg(test)]
    pub(super) fn floor_contacts(&self) -> Vec<(usize, [f32; 3], f32)> {
        let pairs = self.world.contact_pairs_with(self.floor);
        let contacts = pairs.flat_map(|pair| {
            let (other, sign) =
                if pair.collider1 == self.floor { (pair.collider2, 1.0) } else { (pair.collider1, -1.0) };
            let hemisphere = self.world.colliders[other].user_data as usize;
            pair.manifolds().iter().flat_map(move |manifold| {
                let normal = (manifold.data.normal * sign).to_array();
                manifold.points.iter().map(move |point| (hemisphere, normal, point.dist))
            })
        });
        contacts.collect()
    }

    /// Returns the height in metres of the lowest point of the hull of a hemisphere.
    #[cfg(test)]
    pub(super) fn lowest(&self, hemisphere: usize) -> f32 {
        let half = &self.halves[hemisphere];
        let pose = *self.world.bodies[half.body].position() * half.at;
        let heights =
            hull::points(hemisphere).into_iter().map(|p| pose.transform_point(Vector::from_array(p)).z);
        heights.fold(f32::MAX, f32::min)
    }

    /// Joins the bodies from the first module on. The last joint of a ring that is reached closes it.
    fn insert_joints(&mut self, structure: &Structure, joints_deg: &[[f64; 3]], start: &Start) {
        let mut open: Vec<Joint> =
            structure.modules().flat_map(|m| (0..JOINTS).map(move |j| Joint::new(m, j))).collect();
        let first = structure.modules().next().map_or(0, ModuleId::index);
        let mut reached = vec![self.halves[HEMISPHERES * first].body];
        let mut work = Some(Work::new(reached[0]));
        let halves = self.halves.clone();
        let ends = |joint: &Joint| {
            let lower = HEMISPHERES * joint.module().index() + usize::from(joint.within());
            [halves[lower].body, halves[lower + 1].body]
        };
        let mut next = 0;
        while let Some(parent) = reached.get(next).copied() {
            next += 1;
            let (here, others): (Vec<Joint>, Vec<Joint>) =
                open.into_iter().partition(|joint| ends(joint).contains(&parent));
            open = others;
            for joint in here {
                let [lower, upper] = ends(&joint);
                let (child, sign) = if lower == parent { (upper, 1.0) } else { (lower, -1.0) };
                let (point, axis) = start.axes[joint.index()];
                let angle =
                    joints_deg[joint.module().index()][usize::from(joint.within())].to_radians() as f32;
                let kind = usize::from(joint.within());
                let data = self.hinge([parent, child], kind, point, axis * sign);
                let hinge = if reached.contains(&child) {
                    work = None;
                    Hinge::Closing(self.world.insert_impulse_joint(parent, child, data), 0.0)
                } else {
                    if let Some(work) = &mut work {
                        let frame = data.local_frame1;
                        work.join(parent, child, frame.translation, frame.rotation * Vector::X);
                    }
                    reached.push(child);
                    let handle = self.world.insert_multibody_joint(parent, child, data);
                    // Invariant: the child was not reached before, so it is a body of its own.
                    Hinge::Tree(handle.expect("a body joins a tree once"))
                };
                self.motors.insert(joint, Motor { hinge, start: angle, target: angle, kind });
            }
        }
        self.work = work;
    }

    /// Returns a joint about an axis through a point.
    fn hinge(
        &self,
        [parent, child]: [RigidBodyHandle; 2],
        kind: usize,
        point: Vector,
        axis: Vector,
    ) -> GenericJoint {
        let frame = Pose::from_parts(point, Rotation::from_rotation_arc(Vector::X, axis));
        let local = |body: RigidBodyHandle| self.world.bodies[body].position().inv_mul(&frame);
        let mut data = RevoluteJointBuilder::new(Vector::X).contacts_enabled(false).build().data;
        data.set_local_frame1(local(parent)).set_local_frame2(local(child));
        data.set_motor_max_force(JointAxis::AngX, TORQUE[kind]);
        data
    }

    /// Returns the angle of a motor since the start.
    fn turned(&self, motor: &Motor) -> f32 {
        match motor.hinge {
            // Invariant: joints are never removed. A revolute joint turns about the first of three axes.
            Hinge::Tree(handle) => {
                let link =
                    self.world.multibody_joints.get(handle).and_then(|(multibody, id)| multibody.link(id));
                link.map_or(0.0, |link| link.joint().coords()[3])
            }
            Hinge::Closing(_, turned) => turned,
        }
    }

    /// Measures the angles of joints that close rings.
    fn measure(&mut self) {
        for motor in self.motors.values_mut() {
            let Hinge::Closing(handle, turned) = &mut motor.hinge else { continue };
            let Some(joint) = self.world.impulse_joints.get(*handle) else { continue };
            let frame = |body: RigidBodyHandle, local: Pose| *self.world.bodies[body].position() * local;
            let [first, second] = [
                frame(joint.body1(), joint.data.local_frame1),
                frame(joint.body2(), joint.data.local_frame2),
            ];
            let between = first.rotation.inverse() * second.rotation;
            let angle = 2.0 * libm::atan2f(between.x, between.w);
            *turned += libm::remainderf(angle - *turned, std::f32::consts::TAU);
        }
    }

    /// Commands all motors for a tick: a speed of [`SERVO_GAIN`] times the error, which the engine computes at the end of
    /// the tick, so that motors at rest do not swing. The error is cut off where the speed is that without load.
    fn command(&mut self) {
        for motor in self.motors.values() {
            let turned = self.turned(motor);
            let most = NO_LOAD[motor.kind] / SERVO_GAIN;
            let target = turned + (motor.target - motor.start - turned).clamp(-most, most);
            let data = match motor.hinge {
                Hinge::Tree(handle) => {
                    let found = self.world.multibody_joints.get_mut(handle);
                    found.and_then(|(multibody, link)| Some(&mut multibody.link_mut(link)?.joint.data))
                }
                Hinge::Closing(handle, _) => {
                    self.world.impulse_joints.get_mut(handle, true).map(|joint| &mut joint.data)
                }
            };
            if let Some(data) = data {
                data.set_motor_position(JointAxis::AngX, target, SERVO_GAIN * MOTOR_DAMPING, MOTOR_DAMPING);
            }
        }
    }

    /// Returns the work of motors.
    #[cfg(test)]
    pub(super) fn motors(&self) -> &Work {
        self.work.as_ref().expect("no rings")
    }
    /// Returns how far the two sides of joints that close rings are apart, in metres.
    #[cfg(test)]
    pub(super) fn gap(&self) -> f32 {
        let gaps = self.world.impulse_joints().map(|(_, joint)| {
            let end = |body: RigidBodyHandle, local: Pose| {
                (*self.world.bodies[body].position() * local).translation
            };
            (end(joint.body1(), joint.data.local_frame1) - end(joint.body2(), joint.data.local_frame2))
                .length()
        });
        gaps.fold(0.0, f32::max)
    }

    /// Returns the module whose hemisphere has a collider.
    fn module(&self, collider: ColliderHandle) -> ModuleId {
        ModuleId(self.world.colliders[collider].user_data as u32 / HEMISPHERES as u32)
    }
}

impl Start {
    fn of(structure: &Structure, joints_deg: &[[f64; 3]], down: Down) -> Result<Start, PhysicsError> {
        let poses = place(structure, joints_deg)?;
        let bound = structure.bound();
        let mut start = Start {
            halves: vec![Pose::IDENTITY; HEMISPHERES * bound],
            axes: vec![(Vector::ZERO, Vector::X); usize::from(JOINTS) * bound],
        };
        let upright = upright(down);
        let metres = |v: nalgebra::Vector3<f64>| {
            let v = upright * v * CELL_METRES;
            Vector::new(v.x as f32, v.y as f32, v.z as f32)
        };
        let chain = Chain::of(Kind::Single);
        for (module, pose) in &poses {
            let angles = joints_deg[module.index()].map(f64::to_radians);
            let halves = chain::hemispheres(Kind::Single, &angles);
            let halves = halves.expect("invariant: three finite angles of a single module");
            for (h, half) in halves.iter().enumerate() {
                let half = pose.compose(half);
                let rotation = quaternion(&(upright * half.rotation));
                start.halves[HEMISPHERES * module.index() + h] =
                    Pose::from_parts(metres(half.origin), rotation);
            }
            for (j, motion) in chain.motions(&angles).iter().take(usize::from(JOINTS)).enumerate() {
                let motion = pose.compose(motion);
                let axis = metres(motion.rotation * chain.joints[j].axis).normalize();
                let joint = Joint::new(*module, j as u16);
                start.axes[joint.index()] = (metres(motion.point(&chain.joints[j].pivot)), axis);
            }
        }
        start.drop_to_floor(structure);
        Ok(start)
    }

    /// Moves everything so that the lowest point touches the floor.
    fn drop_to_floor(&mut self, structure: &Structure) {
        let mut lowest = f32::MAX;
        for index in structure.modules().flat_map(halves_of) {
            for point in hull::points(index) {
                lowest = lowest.min(self.halves[index].transform_point(Vector::from_array(point)).z);
            }
        }
        let lift = Vector::new(0.0, 0.0, -lowest);
        self.halves.iter_mut().for_each(|pose| pose.translation += lift);
        self.axes.iter_mut().for_each(|(point, _)| *point += lift);
    }
}

fn halves_of(module: ModuleId) -> std::ops::Range<usize> {
    HEMISPHERES * module.index()..HEMISPHERES * (module.index() + 1)
}

/// Returns the rotation by which a direction of the foot frame points down.
fn upright(down: Down) -> nalgebra::Matrix3<f64> {
    let mut up = nalgebra::Vector3::zeros();
    up[down.axis] = if down.negative { 1.0 } else { -1.0 };
    let mut east = nalgebra::Vector3::zeros();
    east[(down.axis + 2) % 3] = 1.0;
    let north = up.cross(&east);
    nalgebra::Matrix3::from_rows(&[east.transpose(), north.transpose(), up.transpose()])
}

fn quaternion(matrix: &nalgebra::Matrix3<f64>) -> Rotation {
    let columns = [0, 1, 2].map(|c| matrix.column(c).map(|x| x as f32));
    let [x, y, z] = columns.map(|c| Vector::new(c.x, c.y, c.z));
    Rotation::from_mat3(&rapier3d::glamx::Mat3::from_cols(x, y, z)).normalize()
}

/// Inserts a body for each set of hemispheres that connections make rigid, and returns all hemispheres.
fn insert_halves(world: &mut PhysicsWorld, structure: &Structure, start: &Start, friction: f32) -> Vec<Half> {
    let mut body: Vec<usize> = (0..start.halves.len()).collect();
    for connection in structure.connections() {
        let ends = connection.ends().map(|(m, c)| body[HEMISPHERES * m.index() + c.hemisphere()]);
        let (from, to) = (ends[0].max(ends[1]), ends[0].min(ends[1]));
        body.iter_mut().filter(|b| **b == from).for_each(|b| *b = to);
    }
    let mut handles: BTreeMap<usize, RigidBodyHandle> = BTreeMap::new();
    let none = Half { body: RigidBodyHandle::invalid(), at: Pose::IDENTITY };
    let mut halves = vec![none; start.halves.len()];
    for index in structure.modules().flat_map(halves_of) {
        let origin = start.halves[body[index]].translation;
        let handle = *handles.entry(body[index]).or_insert_with(|| {
            world.insert_body(RigidBodyBuilder::dynamic().translation(origin).can_sleep(false))
        });
        let at = Pose::from_translation(-origin) * start.halves[index];
        let points: Vec<Vector> = hull::points(index).into_iter().map(Vector::from_array).collect();
        let collider =
            ColliderBuilder::convex_hull(&points).expect("invariant: 40 points in general position");
        let collider = collider.position(at).mass(HEMISPHERE_MASS as f32).friction(friction);
        world.insert_collider(collider.user_data(index as u128), Some(handle));
        halves[index] = Half { body: handle, at };
    }
    halves
}

impl Physics for Bodies {
    fn step(&mut self) {
        self.command();
        if let Some(work) = &mut self.work {
            work.before(&self.world);
        }
        self.world.step();
        if let Some(work) = &mut self.work {
            work.after(&self.world);
        }
        self.measure();
    }
    fn set_target(&mut self, joint: Joint, angle: f32) {
        if let Some(motor) = self.motors.get_mut(&joint) {
            motor.target = angle;
        }
    }
    fn angle(&self, joint: Joint) -> f32 {
        self.motors.get(&joint).map_or(0.0, |motor| motor.start + self.turned(motor))
    }
    fn pose(&self, module: ModuleId, hemisphere: usize) -> Placed {
        let half = &self.halves[HEMISPHERES * module.index() + hemisphere];
        let pose = *self.world.bodies[half.body].position() * half.at;
        Placed { position: pose.translation.to_array(), rotation: pose.rotation.to_array() }
    }
    fn centre_of_mass(&self) -> [f32; 3] {
        let (mut sum, mut mass) = (Vector::ZERO, 0.0);
        for (_, body) in self.world.rigid_bodies() {
            sum += body.center_of_mass() * body.mass();
            mass += body.mass();
        }
        (sum / mass).to_array()
    }
    fn kinetic_energy(&self) -> f32 {
        self.world.rigid_bodies().map(|(_, body)| body.kinetic_energy()).sum()
    }
    fn weight(&self) -> f32 {
        GRAVITY * self.world.rigid_bodies().map(|(_, body)| body.mass()).sum::<f32>()
    }
    fn work(&self) -> Option<f64> {
        self.work.as_ref().map(Work::joules)
    }
    fn touches_floor(&self, module: ModuleId) -> bool {
        let mut pairs = self.world.contact_pairs_with(self.floor).filter(|p| p.has_any_active_contact());
        pairs.any(|p| {
            let other = if p.collider1 == self.floor { p.collider2 } else { p.collider1 };
            self.module(other) == module
        })
    }
    fn overlap(&self) -> f32 {
        let own = |c: ColliderHandle| c != self.floor;
        let pairs = self.world.contact_pairs().filter(|p| own(p.collider1) && own(p.collider2));
        let between = pairs.filter(|p| self.module(p.collider1) != self.module(p.collider2));
        let depths = between.filter_map(|p| Some(-p.find_deepest_contact()?.1.dist));
        depths.fold(0.0, f32::max)
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        let mut put = |x: f32| hasher.write(&x.to_bits().to_le_bytes());
        for (_, body) in self.world.rigid_bodies() {
            let pose = body.position();
            pose.translation.to_array().into_iter().chain(pose.rotation.to_array()).for_each(&mut put);
        }
        for motor in self.motors.values() {
            put(self.turned(motor));
        }
    }
}

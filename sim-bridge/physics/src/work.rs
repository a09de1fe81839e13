//! The work of motors: by what bodies gain, and what gravity and contacts give them.
//!
//! The engine does not tell the torques of motors in a multibody. All that a part of a tree of bodies gains beyond gravity and
//! contacts comes through the joint at its root, and the share about the axis of that joint is its motor's.

use rapier3d::prelude::{ColliderHandle, PhysicsWorld, Pose, RigidBody, RigidBodyHandle, Vector};
use std::collections::BTreeMap;

/// A body of the tree.
struct Link {
    body: RigidBodyHandle,
    /// The joint to the body nearer to the root: the index of that body, and a point and the axis in its frame.
    joint: Option<(usize, Vector, Vector)>,
}

/// State of a body before a tick.
#[derive(Clone, Copy)]
struct Before {
    pose: Pose,
    centre: Vector,
    spin: Vector,
    linear: Vector,
    angular: Vector,
}

/// A sum of impulses, and of their moments about the origin.
#[derive(Clone, Copy, Default)]
struct Impulse {
    linear: Vector,
    angular: Vector,
}

impl Impulse {
    fn add(&mut self, impulse: Vector, at: Vector) {
        self.linear += impulse;
        self.angular += at.cross(impulse);
    }
}

/// Counts the work of the motors of a tree of bodies.
pub struct Work {
    links: Vec<Link>,
    /// The index of each body, by the parts of its handle.
    index: BTreeMap<(u32, u32), usize>,
    before: Vec<Before>,
    contacts: Vec<Impulse>,
    /// The angular impulse of each motor in the last tick in Nms, by the body that it turns; 0 for the root.
    impulses: Vec<f32>,
    /// The work of the motors, in joules, where it is positive. A motor that is driven from outside returns no
    /// energy.
    given: f64,
    /// The same less what they took.
    net: f64,
}

/// Returns the angular momentum of a body about its centre of mass.
fn angular(body: &RigidBody) -> Vector {
    let mass = &body.mass_properties().local_mprops;
    let axes = body.position().rotation * mass.principal_inertia_local_frame;
    axes * (mass.principal_inertia() * (axes.inverse() * body.angvel()))
}

impl Work {
    /// Begins with the root of a tree.
    pub fn new(root: RigidBodyHandle) -> Work {
        let mut work = Work {
            links: Vec::new(),
            index: BTreeMap::new(),
            before: Vec::new(),
            contacts: Vec::new(),
            impulses: Vec::new(),
            given: 0.0,
            net: 0.0,
        };
        work.push(Link { body: root, joint: None });
        work
    }

    fn push(&mut self, link: Link) {
        self.index.insert(link.body.into_raw_parts(), self.links.len());
        self.links.push(link);
    }

    /// Adds a body with the joint to one that is there already: a point and the axis in the frame of that one.
    pub fn join(&mut self, parent: RigidBodyHandle, child: RigidBodyHandle, point: Vector, axis: Vector) {
        // Invariant: the tree grows from its root.
        let at = self.index[&parent.into_raw_parts()];
        self.push(Link { body: child, joint: Some((at, point, axis)) });
    }

    /// Looks at the bodies before a tick.
    pub fn before(&mut self, world: &PhysicsWorld) {
        self.before.clear();
        self.before.extend(self.links.iter().map(|link| {
            let body = &world.bodies[link.body];
            Before {
                pose: *body.position(),
                centre: body.center_of_mass(),
                spin: body.angvel(),
                linear: body.linvel() * body.mass(),
                angular: angular(body),
            }
        }));
    }

    /// Looks at them after the tick, and counts the work.
    pub fn after(&mut self, world: &PhysicsWorld) {
        self.sum_contacts(world);
        let seconds = world.integration_parameters.dt;
        let gained =
            self.links.iter().zip(&self.before).zip(&self.contacts).map(|((link, before), contacts)| {
                let body = &world.bodies[link.body];
                let linear =
                    body.linvel() * body.mass() - before.linear - world.gravity * body.mass() * seconds;
                Impulse {
                    linear: linear - contacts.linear,
                    angular: angular(body) - before.angular + before.centre.cross(linear) - contacts.angular,
                }
            });
        let mut through: Vec<Impulse> = gained.collect();
        self.impulses.clear();
        self.impulses.resize(self.links.len(), 0.0);
        for i in (1..self.links.len()).rev() {
            let Some((parent, point, axis)) = self.links[i].joint else { continue };
            let pose = self.before[parent].pose;
            let (point, axis) = (pose.transform_point(point), pose.rotation * axis);
            let Impulse { linear, angular } = through[i];
            through[parent].linear += linear;
            through[parent].angular += angular;
            let impulse = axis.dot(angular - point.cross(linear));
            let spin = |i: usize| (self.before[i].spin + world.bodies[self.links[i].body].angvel()) * 0.5;
            let work = f64::from(impulse * axis.dot(spin(i) - spin(parent)));
            self.impulses[i] = impulse;
            self.given += work.max(0.0);
            self.net += work;
        }
    }

    /// Sums what contacts gave to each body.
    fn sum_contacts(&mut self, world: &PhysicsWorld) {
        self.contacts.clear();
        self.contacts.resize(self.links.len(), Impulse::default());
        for pair in world.contact_pairs() {
            let body = |collider: ColliderHandle| {
                let body = world.colliders[collider].parent()?;
                self.index.get(&body.into_raw_parts())
            };
            let ends = [body(pair.collider1).copied(), body(pair.collider2).copied()];
            for manifold in pair.manifolds() {
                for point in &manifold.points {
                    let data = &point.data;
                    let on_first = data.warmstart_tangent_world - manifold.data.normal * data.impulse;
                    for (end, impulse, arm) in
                        [(ends[0], on_first, data.solver_dp1), (ends[1], -on_first, data.solver_dp2)]
                    {
                        if let Some(i) = end {
                            self.contacts[i].add(impulse, self.before[i].centre + arm);
                        }
                    }
                }
            }
        }
    }

    /// Returns what motors gave since the start in joules.
    pub fn joules(&self) -> f64 {
        self.given
    }
    /// Returns what motors gave less what they took.
    pub fn net_joules(&self) -> f64 {
        self.net
    }
    /// Returns the largest angular impulse of a motor in the last tick in Nms.
    pub fn largest_impulse(&self) -> f32 {
        self.impulses.iter().map(|impulse| impulse.abs()).fold(0.0, f32::max)
    }
}

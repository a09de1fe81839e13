//! A structure of modules at an instant, as rigid links and joints, for files of other simulators.
//!
//! Lengths are metres, masses kilograms, angles radians; z points up, and the lowest cells stand on z = 0. All frames
//! of links are in the pose of the instant, so joints are at zero there.

use metamorph_protocol::lattice::Cell;
use metamorph_scene::figure::snapshot::{Body, Process, Snapshot};
use metamorph_scene::parts::{Part, Shape, Tone};
use nalgebra::{Isometry3, Matrix3, Unit, UnitQuaternion, Vector3};
use std::collections::{BTreeMap, VecDeque};
use thiserror::Error;

/// Number of parts of a Roombots module: the halves of its two cubes. The joints are between them; a fixed connection
/// is between the last half of one module and the first of the next.
const HALVES: usize = 4;
/// Distance in cells below which coordinates are equal.
const NEAR: f64 = 1e-6;

/// Measures that a run does not have.
#[derive(Clone, Copy, Debug)]
pub struct Measures {
    /// The edge of a cell in metres.
    pub cell: f64,
    /// The mass of a module in kilograms.
    pub mass: f64,
}

/// A convex body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Geometry {
    /// A box, by the lengths of its edges.
    Box([f64; 3]),
    /// A ball, by its radius.
    Sphere(f64),
}

/// The state of a module, which is shown as a colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Look {
    /// It runs.
    Alive,
    /// Its process is stopped.
    Paused,
    /// Its process is dead.
    Dead,
    /// A foreign object.
    Obstacle,
}

impl Look {
    /// All of them.
    pub const ALL: [Look; 4] = [Look::Alive, Look::Paused, Look::Dead, Look::Obstacle];
    /// Returns its name.
    pub fn name(self) -> &'static str {
        match self {
            Look::Alive => "alive",
            Look::Paused => "paused",
            Look::Dead => "dead",
            Look::Obstacle => "obstacle",
        }
    }
    /// Returns red, green, blue and opacity.
    pub fn colour(self) -> &'static str {
        match self {
            Look::Alive => "0 0.45 0.7 1",
            Look::Paused => "0.8 0.47 0.65 1",
            Look::Dead => "0.17 0.17 0.17 1",
            Look::Obstacle => "0.5 0.5 0.5 1",
        }
    }
}

/// A solid of a link.
#[derive(Clone, Debug)]
pub struct Solid {
    /// The number of the module and of its part, for its name.
    pub name: String,
    /// Its pose in the link.
    pub pose: Isometry3<f64>,
    /// Its form.
    pub geometry: Geometry,
    /// Its colour.
    pub look: Look,
    mass: f64,
}

/// A rigid link.
#[derive(Clone, Debug)]
pub struct Link {
    /// Its name.
    pub name: String,
    /// Its pose in the world.
    pub pose: Isometry3<f64>,
    /// The solids that the link consists of.
    pub solids: Vec<Solid>,
}

/// Mass, centre of mass and the inertia about it, in axes of the link.
#[derive(Clone, Copy, Debug)]
pub struct Inertial {
    /// The mass.
    pub mass: f64,
    /// The centre.
    pub centre: Vector3<f64>,
    /// The inertia.
    pub inertia: Matrix3<f64>,
}

impl Link {
    /// Returns its inertia, of homogeneous solids.
    pub fn inertial(&self) -> Inertial {
        let mass: f64 = self.solids.iter().map(|solid| solid.mass).sum();
        let weighted = self.solids.iter().map(|solid| solid.pose.translation.vector * solid.mass);
        let centre = weighted.sum::<Vector3<f64>>() / mass;
        let mut inertia = Matrix3::zeros();
        for solid in &self.solids {
            let own = Vector3::from(match solid.geometry {
                Geometry::Box([x, y, z]) => {
                    [y * y + z * z, x * x + z * z, x * x + y * y].map(|sum| sum / 12.0)
                }
                Geometry::Sphere(radius) => [0.4 * radius * radius; 3],
            });
            let turned = solid.pose.rotation.to_rotation_matrix();
            let off = solid.pose.translation.vector - centre;
            let away = Matrix3::identity() * off.norm_squared() - off * off.transpose();
            inertia += (turned * Matrix3::from_diagonal(&own) * turned.transpose() + away) * solid.mass;
        }
        Inertial { mass, centre, inertia }
    }
}

/// Degree of freedom of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// Nothing.
    Fixed,
    /// Turns about an axis in the frame of the child, without end.
    Turns(Unit<Vector3<f64>>),
}

/// A joint at the origin of the child.
#[derive(Clone, Debug)]
pub struct Joint {
    /// The number of the link nearer to the base; `None` for the base.
    pub parent: Option<usize>,
    /// The number of the other link.
    pub child: usize,
    /// Degree of freedom.
    pub motion: Motion,
}

/// A structure.
#[derive(Clone, Debug, Default)]
pub struct Structure {
    /// Its links.
    pub links: Vec<Link>,
    /// Joints that make a tree of the links, rooted at the base.
    pub tree: Vec<Joint>,
    /// Connections that would close loops.
    pub loops: Vec<Joint>,
    /// Foreign objects, fixed to the world.
    pub obstacles: Vec<Link>,
}

/// The structure is not one piece.
#[derive(Debug, Error)]
#[error(
    "module {module} is connected to no other at that time\n  fix: name another time, or --bodies merged with --sdf"
)]
pub struct NotConnected {
    /// A module that cannot be reached.
    pub module: usize,
}

fn look(body: &Body) -> Look {
    match body.process {
        Process::Alive => Look::Alive,
        Process::Paused => Look::Paused,
        Process::Dead => Look::Dead,
    }
}

/// Returns the solid of a part, at the origin of its link.
fn solid(part: &Part, name: String, look: Look, mass: f64, cell: f64) -> Solid {
    let geometry = match part.shape {
        Shape::Box { size } => Geometry::Box(size.map(|edge| edge * cell)),
        Shape::HalfCube { half_edge, .. } => Geometry::Sphere(half_edge * cell),
    };
    Solid { name, pose: Isometry3::identity(), geometry, look, mass }
}

fn scaled(pose: &Isometry3<f64>, cell: f64) -> Isometry3<f64> {
    let mut pose = *pose;
    pose.translation.vector *= cell;
    pose
}

impl Structure {
    /// Returns the structure at a moment. `grounded` is true if every body holds on to a floor.
    ///
    /// # Errors
    /// If a module is connected to no other and to no floor.
    pub fn of(snapshot: &Snapshot, grounded: bool, measures: Measures) -> Result<Structure, NotConnected> {
        let mut structure = Structure::default();
        let mut first = Vec::new();
        for (id, body) in snapshot.bodies.iter().enumerate() {
            first.push(structure.links.len());
            structure.add_body(id, body, measures);
        }
        structure.obstacles = snapshot.obstacles.iter().map(|cell| obstacle(*cell, measures)).collect();
        let connections = if grounded { Vec::new() } else { connections(&snapshot.bodies) };
        let mut reached = vec![grounded; snapshot.bodies.len()];
        if grounded {
            for (id, body) in snapshot.bodies.iter().enumerate() {
                structure.hold(first[id], body);
            }
        } else if let Some(body) = reached.first_mut() {
            *body = true;
            structure.tree.push(Joint { parent: None, child: 0, motion: Motion::Fixed });
            structure.connect(&connections, &first, &mut reached);
        }
        match reached.iter().position(|reached| !reached) {
            Some(module) => Err(NotConnected { module }),
            None => Ok(structure),
        }
    }

    /// Returns the same with all solids in one link at the origin, for structures whose modules have no joints.
    pub fn merged(snapshot: &Snapshot, measures: Measures) -> Structure {
        let mut apart = Structure::default();
        for (id, body) in snapshot.bodies.iter().enumerate() {
            apart.add_body(id, body, measures);
        }
        let solids = apart.links.into_iter().flat_map(|link| {
            let pose = link.pose;
            link.solids.into_iter().map(move |solid| Solid { pose: pose * solid.pose, ..solid })
        });
        let link =
            Link { name: "structure".to_owned(), pose: Isometry3::identity(), solids: solids.collect() };
        Structure {
            links: vec![link],
            tree: vec![Joint { parent: None, child: 0, motion: Motion::Fixed }],
            loops: Vec::new(),
            obstacles: snapshot.obstacles.iter().map(|cell| obstacle(*cell, measures)).collect(),
        }
    }

    /// Adds the links of a body, without joints.
    fn add_body(&mut self, id: usize, body: &Body, Measures { cell, mass }: Measures) {
        let modules = body.parts.len().div_ceil(HALVES).max(1) as f64;
        let mass = mass * modules / body.parts.len() as f64;
        for (number, part) in body.parts.iter().enumerate() {
            let name = match body.parts.len() {
                1 => format!("module_{id}"),
                _ => format!("module_{id}_part_{number}"),
            };
            let solids = vec![solid(part, name.clone(), look(body), mass, cell)];
            self.links.push(Link { name, pose: scaled(&part.pose, cell), solids });
        }
    }

    /// Fixes the lowest part of a body to the base, and joins the others to it on both sides.
    fn hold(&mut self, first: usize, body: &Body) {
        let height = |n: &usize| body.parts[*n].centre().z;
        let Some(root) = (0..body.parts.len()).min_by(|a, b| height(a).total_cmp(&height(b))) else { return };
        self.tree.push(Joint { parent: None, child: first + root, motion: Motion::Fixed });
        let above = (root + 1..body.parts.len()).map(|child| (child - 1, child));
        let below = (0..root).rev().map(|child| (child + 1, child));
        for (parent, child) in above.chain(below) {
            let motion = joint(&body.parts, parent.min(child), &body.parts[child]);
            self.tree.push(Joint { parent: Some(first + parent), child: first + child, motion });
        }
    }

    /// Connects all bodies that can be reached from the first one, breadth first.
    fn connect(&mut self, connections: &[Vec<usize>], first: &[usize], reached: &mut [bool]) {
        let mut queue = VecDeque::from([0]);
        let mut parents = vec![None; reached.len()];
        while let Some(from) = queue.pop_front() {
            for &to in &connections[from] {
                let joint = Joint { parent: Some(first[from]), child: first[to], motion: Motion::Fixed };
                if !std::mem::replace(&mut reached[to], true) {
                    self.tree.push(joint);
                    parents[to] = Some(from);
                    queue.push_back(to);
                } else if from < to && parents[from] != Some(to) {
                    self.loops.push(joint);
                }
            }
        }
    }
}

/// Returns what the joint between a part and the next one allows, in the frame of the child.
fn joint(parts: &[Part], lower: usize, child: &Part) -> Motion {
    let (low, high) = (&parts[lower], &parts[lower + 1]);
    let between = high.centre() - low.centre();
    let axis = match (lower % HALVES, between.norm() < NEAR) {
        // Two halves of a cube turn about its diagonal.
        (_, true) => high.pose.rotation * Vector3::new(1.0, 1.0, 1.0),
        (1, false) => between,
        (_, false) => return Motion::Fixed,
    };
    Motion::Turns(Unit::new_normalize(child.pose.rotation.inverse() * axis))
}

fn obstacle(cell: Cell, measures: Measures) -> Link {
    let part = Part::in_cell(Shape::Box { size: [1.0; 3] }, cell, UnitQuaternion::identity(), Tone::Plain);
    let name = format!("obstacle_{}_{}_{}", cell.x, cell.y, cell.z).replace('-', "m");
    let solids = vec![solid(&part, name.clone(), Look::Obstacle, measures.mass, measures.cell)];
    Link { name, pose: scaled(&part.pose, measures.cell), solids }
}

/// Returns the bodies that each body touches: those across a face; of a body that touches none, as some movers on
/// their way, those across an edge.
fn connections(bodies: &[Body]) -> Vec<Vec<usize>> {
    let centres: Vec<Option<Vector3<f64>>> =
        bodies.iter().map(|body| body.parts.first().map(Part::centre)).collect();
    let mut buckets: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    let bucket = |centre: &Vector3<f64>| [centre.x, centre.y, centre.z].map(|c| c.floor() as i64);
    for (id, centre) in centres.iter().enumerate() {
        if let Some(centre) = centre {
            buckets.entry(bucket(centre)).or_default().push(id);
        }
    }
    let near = |id: usize, touches: fn(Vector3<f64>) -> bool| -> Vec<usize> {
        let Some(centre) = centres[id] else { return Vec::new() };
        let [x, y, z] = bucket(&centre);
        let around =
            (-2..=2).flat_map(|i| (-2..=2).flat_map(move |j| (-2..=2).map(move |k| [x + i, y + j, z + k])));
        let others = around.filter_map(|key| buckets.get(&key)).flatten().copied();
        let mut others: Vec<usize> = others
            .filter(|other| *other != id && centres[*other].is_some_and(|c| touches((c - centre).abs())))
            .collect();
        others.sort_unstable();
        others
    };
    let mut all: Vec<Vec<usize>> = (0..bodies.len()).map(|id| near(id, touch_faces)).collect();
    for id in 0..bodies.len() {
        if all[id].is_empty() {
            all[id] = near(id, touch_edges);
            for other in all[id].clone() {
                all[other].push(id);
            }
        }
    }
    all
}

fn touch_faces(off: Vector3<f64>) -> bool {
    let apart = off.iter().filter(|d| **d > 1.0 - NEAR).count();
    apart == 1 && off.max() < 1.0 + NEAR
}

fn touch_edges(off: Vector3<f64>) -> bool {
    off.max() < 1.0 + NEAR
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::time::Time;

    const MEASURES: Measures = Measures { cell: 0.5, mass: 2.0 };

    fn snapshot(cells: &[[i16; 3]]) -> Snapshot {
        let body = |[x, y, z]: &[i16; 3]| {
            let cell = Cell::new(*x, *y, *z);
            let part =
                Part::in_cell(Shape::Box { size: [1.0; 3] }, cell, UnitQuaternion::identity(), Tone::Plain);
            Body { parts: vec![part], moving: false, view: None, process: Process::Alive }
        };
        Snapshot {
            at: Time::ZERO,
            bodies: cells.iter().map(body).collect(),
            obstacles: Vec::new(),
            elements: BTreeMap::new(),
            goal: Vec::new(),
            omitted: 0,
            gradient: Vec::new(),
            messages: Vec::new(),
            bin: 1.0,
            edges: Vec::new(),
            locks: BTreeMap::new(),
        }
    }

    /// A square of four has a tree of three connections, and one that closes the loop.
    #[test]
    fn connections_make_a_tree_and_loops() {
        let square = snapshot(&[[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]);
        let made = Structure::of(&square, false, MEASURES).unwrap();
        assert_eq!((made.links.len(), made.tree.len(), made.loops.len()), (4, 4, 1));
        let children: Vec<usize> = made.tree.iter().map(|joint| joint.child).collect();
        assert_eq!(children, [0, 1, 2, 3]);
        assert_eq!(made.links[3].pose.translation.vector, Vector3::new(0.5, 0.5, 0.25));
        let apart = snapshot(&[[0, 0, 0], [3, 0, 0]]);
        assert_eq!(Structure::of(&apart, false, MEASURES).unwrap_err().module, 1);
        assert_eq!(Structure::merged(&apart, MEASURES).links.len(), 1);
    }

    /// Two cubes side by side have the inertia of one box of both.
    #[test]
    fn inertia_of_merged_cubes_is_that_of_the_box() {
        let merged = Structure::merged(&snapshot(&[[0, 0, 0], [1, 0, 0]]), MEASURES);
        let Inertial { mass, centre, inertia } = merged.links[0].inertial();
        assert_eq!(mass, 4.0);
        assert!((centre - Vector3::new(0.25, 0.0, 0.25)).norm() < 1e-12);
        let (x, y) = (1.0_f64, 0.5_f64);
        let expected = [y * y + y * y, x * x + y * y, x * x + y * y].map(|sum| mass * sum / 12.0);
        assert!((inertia - Matrix3::from_diagonal(&Vector3::from(expected))).norm() < 1e-12, "{inertia}");
    }
}

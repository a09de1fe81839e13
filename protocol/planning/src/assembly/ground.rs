//! Structures on the ground: one hemisphere is held, the floor is solid, and joints bear the weight.
//!
//! In free assembly a structure floats, and it does not matter which side of a joint moves. On the ground the side
//! without the held hemisphere moves. Frame: +z is up; the cube at the origin cell is held by its outer hemisphere.
//!
//! Statics determine the load of a joint if all that is beyond it hangs on it. They do not where a loop or a cube that
//! lies on the floor bears a part of it; such joints are not limited.

use super::collision::Model;
use super::configuration::{Configuration, Links, MAX_MODULES, Module, Pair, at_hemispheres};
use super::tables::{Rot, TABLES, Vec3, add, sub};
use metamorph_roombots::body::Body;
use metamorph_roombots::chain::{Pose, diagonal, rotation};
use metamorph_roombots::sweep::{CORE_DEPTH, GRAZE_DEPTH};
use metamorph_roombots::torque::{GRAVITY, Limits};
use metamorph_roombots::{CELL_METRES, HEMISPHERE_MASS, OUTER_RADIUS};
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::{FRAC_PI_2, TAU};
use thiserror::Error;

/// The cell of the cube that is held.
pub const HELD: Vec3 = [0; 3];

/// Number of samples of a turn for the depth into the floor: one every 1.4° or less. The checker takes the same.
pub const SAMPLES: u32 = 90;

/// Restrictions by the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ground {
    /// The lowest z that cubes may fill, where the floor is solid.
    pub floor: Option<i8>,
    /// True if the static torque of joints is limited: 4.9 Nm outer, 3.6 Nm middle (thesis table 2.1).
    pub gravity: bool,
}

/// Why a structure does not stand.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Fall {
    /// No cube is at the held cell.
    #[error("no module is held")]
    NotHeld,
    /// A cube is in the floor.
    #[error("module {0} is below the floor")]
    BelowFloor(usize),
    /// A joint bears more than it can.
    #[error("joint {joint} of module {module} bears {torque:.2} Nm; it can bear {limit} Nm", joint = .joint + 1)]
    Overloaded {
        /// The module.
        module: usize,
        /// The joint, from 0.
        joint: usize,
        /// The torque in Nm.
        torque: f64,
        /// The limit in Nm.
        limit: f64,
    },
}

/// Moves a configuration so that a module's foot (or its head) is the one that is held.
pub fn held_at(configuration: &Configuration, module: usize, head: bool) -> Option<Configuration> {
    let at = configuration.modules().get(module)?.cells()[usize::from(head)];
    let mut moved = *configuration;
    moved.modules_mut().iter_mut().for_each(|m| m.cell = sub(m.cell, at));
    Some(moved)
}

/// Turns a configuration about the origin.
pub fn rotated(configuration: &Configuration, by: Rot) -> Configuration {
    let mut turned = *configuration;
    for m in turned.modules_mut() {
        m.cell = TABLES.rotate(by, m.cell);
        m.rotation = TABLES.times(by, m.rotation);
    }
    turned
}

/// The held module: its number, and true if it is held by its head.
fn held(configuration: &Configuration) -> Option<(usize, bool)> {
    configuration
        .modules()
        .iter()
        .enumerate()
        .find_map(|(i, m)| m.cells().iter().position(|c| *c == HELD).map(|cube| (i, cube == 1)))
}

/// A turn of a joint, as the planner expands it: with everything behind the joint moved.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    /// The module.
    pub module: usize,
    /// The joint, from 0.
    pub joint: u8,
    /// True for the positive direction.
    pub positive: bool,
    /// The modules behind the joint.
    pub behind: u16,
}

/// A structure in the course of a turn.
struct TurningStructure {
    /// For each module, the frames of its hemispheres and the centres of its cubes, in cells.
    frames: Vec<[Matrix3<f64>; 4]>,
    centres: Vec<[Vector3<f64>; 2]>,
    /// For each module, which hemispheres move.
    moves: Vec<[bool; 4]>,
    axis: Vector3<f64>,
    pivot: Vector3<f64>,
    /// The whole angle in radians.
    angle: f64,
}

impl Ground {
    /// Returns the configuration after a turn, with what is held where it was; `None` if the structure would not stand
    /// at the end or on the way.
    pub fn after(
        &self,
        before: &Configuration,
        next: &Configuration,
        turn: &Turn,
        model: Model,
    ) -> Option<Configuration> {
        let (holder, head) = held(before)?;
        let held_moves = if holder == turn.module { head } else { turn.behind >> holder & 1 != 0 };
        let next = if held_moves { brought_back(before, next, holder, head) } else { *next };
        if self.floor.is_some_and(|floor| lowest(&next).1 < floor) {
            return None;
        }
        let course = TurningStructure::of(before, turn, held_moves);
        let depth = match model {
            Model::Final => None,
            Model::Core => Some(CORE_DEPTH),
            Model::Strict => Some(GRAZE_DEPTH),
        };
        if let (Some(floor), Some(depth)) = (self.floor, depth)
            && course.dips(f64::from(floor) - 0.5 - depth)
        {
            return None;
        }
        (!self.gravity || course.overloaded(&joints(before, holder, head), self.floor).is_none())
            .then_some(next)
    }

    /// Checks that a configuration stands.
    pub fn check(&self, configuration: &Configuration) -> Result<(), Fall> {
        let (holder, head) = held(configuration).ok_or(Fall::NotHeld)?;
        if let Some(floor) = self.floor
            && let (module, z) = lowest(configuration)
            && z < floor
        {
            return Err(Fall::BelowFloor(module));
        }
        let found = self.gravity.then(|| {
            TurningStructure::still(configuration)
                .overloaded(&joints(configuration, holder, head), self.floor)
        });
        found.flatten().map_or(Ok(()), Err)
    }
}

/// Returns the lowest cube: its module and its z.
fn lowest(configuration: &Configuration) -> (usize, i8) {
    let cells = configuration.modules().iter().enumerate().flat_map(|(i, m)| m.cells().map(|c| (i, c[2])));
    cells.min_by_key(|(i, z)| (*z, *i)).unwrap_or((0, i8::MAX))
}

/// Moves the whole of `next` so that the held hemisphere has the pose that it has in `before`.
fn brought_back(before: &Configuration, next: &Configuration, holder: usize, head: bool) -> Configuration {
    let end = |c: &Configuration| -> Module {
        let m = c.modules()[holder];
        if head { m.reversed() } else { m }
    };
    let (from, to) = (end(next), end(before));
    let by = TABLES.times(to.rotation, TABLES.inverse[usize::from(from.rotation)]);
    let mut back = *next;
    for m in back.modules_mut() {
        m.cell = add(to.cell, TABLES.rotate(by, sub(m.cell, from.cell)));
        m.rotation = TABLES.times(by, m.rotation);
    }
    back
}

/// A joint that bears load, and what hangs on it: the modules on the side away from what is held, and on which side
/// the module's own hemispheres are.
struct Joint {
    module: usize,
    joint: usize,
    far: u16,
    /// True if the far side is behind the joint.
    behind: bool,
}

impl Joint {
    /// Returns the far hemispheres: the module and the number.
    fn far(&self) -> impl Iterator<Item = (usize, usize)> {
        let others = (0..MAX_MODULES).filter(|k| self.far >> k & 1 != 0);
        let own = (0..4).filter(|h| (*h > self.joint) == self.behind);
        others.flat_map(|k| (0..4).map(move |h| (k, h))).chain(own.map(|h| (self.module, h)))
    }
}

/// Returns the joints that are not in a loop.
fn joints(configuration: &Configuration, holder: usize, head: bool) -> Vec<Joint> {
    let connections: Vec<Pair> = configuration.connections();
    let links = Links::of(configuration.len(), connections.iter().copied());
    let mut found = Vec::with_capacity(3 * configuration.len());
    for module in 0..configuration.len() {
        let at = at_hemispheres(&links, &connections, module as u8);
        for joint in 0..3 {
            let [front, behind] =
                [&at[..=joint], &at[joint + 1..]].map(|s| s.iter().fold(0_u16, |all, m| all | m));
            if front & behind == 0 {
                let held_behind = if holder == module { head } else { behind >> holder & 1 != 0 };
                let far = if held_behind { front } else { behind };
                found.push(Joint { module, joint, far, behind: !held_behind });
            }
        }
    }
    found
}

impl TurningStructure {
    fn still(configuration: &Configuration) -> TurningStructure {
        let t = &**TABLES;
        let matrix = |m: &Module, h: usize| {
            let r = t.times(m.rotation, t.hemisphere[usize::from(m.posture)][h]);
            t.rotations[usize::from(r)].matrix()
        };
        let modules = configuration.modules();
        TurningStructure {
            frames: modules.iter().map(|m| [0, 1, 2, 3].map(|h| matrix(m, h))).collect(),
            centres: modules.iter().map(|m| m.cells().map(|c| Vector3::from(c.map(f64::from)))).collect(),
            moves: vec![[false; 4]; modules.len()],
            axis: Vector3::z(),
            pivot: Vector3::zeros(),
            angle: 0.0,
        }
    }

    fn of(before: &Configuration, turn: &Turn, held_moves: bool) -> TurningStructure {
        let mut course = TurningStructure::still(before);
        for (i, moves) in course.moves.iter_mut().enumerate() {
            for (h, moves) in moves.iter_mut().enumerate() {
                let behind = if i == turn.module { h > turn.joint.into() } else { turn.behind >> i & 1 != 0 };
                *moves = behind != held_moves;
            }
        }
        let joint = usize::from(turn.joint);
        let (axis, step) = if joint == 1 { (Vector3::z(), FRAC_PI_2) } else { (diagonal(), TAU / 3.0) };
        course.axis = course.frames[turn.module][joint] * axis;
        course.pivot = course.centres[turn.module][usize::from(joint == 2)];
        course.angle = if turn.positive == held_moves { -step } else { step };
        course
    }

    fn turned(&self, angle: f64) -> (Matrix3<f64>, impl Fn(&Vector3<f64>) -> Vector3<f64>) {
        let turn = rotation(&self.axis, angle);
        let pivot = self.pivot;
        (turn, move |p| turn * (p - pivot) + pivot)
    }

    /// Returns true if a cube goes lower than `limit` on the way.
    fn dips(&self, limit: f64) -> bool {
        let cubes = (0..self.frames.len()).flat_map(|i| [(i, 0), (i, 1)]);
        let near = cubes.filter(|(i, cube)| {
            let far = (self.centres[*i][*cube] - self.pivot).norm();
            let moves = self.moves[*i][2 * cube] || self.moves[*i][2 * cube + 1];
            moves && self.pivot.z - far - OUTER_RADIUS < limit
        });
        let near: Vec<(usize, usize)> = near.collect();
        !near.is_empty()
            && (0..=SAMPLES).any(|sample| {
                let (turn, moved) = self.turned(self.angle * f64::from(sample) / f64::from(SAMPLES));
                near.iter().any(|(i, cube)| {
                    let centre = self.centres[*i][*cube];
                    let pose = |h: usize| {
                        let frame = self.frames[*i][2 * cube + h];
                        if self.moves[*i][2 * cube + h] {
                            Pose { rotation: turn * frame, origin: moved(&centre) }
                        } else {
                            Pose { rotation: frame, origin: centre }
                        }
                    };
                    // The joint that twists a cube goes through its centre, so both poses have one origin.
                    Body::of_hemispheres(&pose(0), &pose(1)).lowest() < limit + 1e-9
                })
            })
    }

    /// Returns the centre of a hemisphere's cube after a part of the turn.
    fn centre(&self, (i, h): (usize, usize), moved: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> Vector3<f64> {
        let centre = self.centres[i][h / 2];
        if self.moves[i][h] { moved(&centre) } else { centre }
    }

    /// Returns true if a far hemisphere that does not move lies on the floor.
    fn is_supported(&self, joint: &Joint, floor: Option<i8>) -> bool {
        let Some(floor) = floor.map(f64::from) else { return false };
        joint.far().any(|(i, h)| !self.moves[i][h] && self.centres[i][h / 2].z <= floor)
    }

    /// Returns a joint that bears too much somewhere on the way. Torques are sinusoids of the angle, because everything
    /// that moves turns about one axis; so three values give the largest one exactly.
    fn overloaded(&self, joints: &[Joint], floor: Option<i8>) -> Option<Fall> {
        let hanging: Vec<&Joint> = joints.iter().filter(|j| !self.is_supported(j, floor)).collect();
        let thirds = if self.angle == 0.0 { 1 } else { 3 };
        let mut torques = vec![[0.0; 3]; hanging.len()];
        for third in 0..thirds {
            let (turn, moved) = self.turned(TAU * third as f64 / 3.0);
            for (joint, torque) in hanging.iter().zip(&mut torques) {
                let (i, j) = (joint.module, joint.joint);
                let axis = self.frames[i][j] * if j == 1 { Vector3::z() } else { diagonal() };
                let axis = if self.moves[i][j] { turn * axis } else { axis };
                let pivot = self.centre((i, j), &moved);
                let lever: Vector3<f64> = joint.far().map(|far| self.centre(far, &moved) - pivot).sum();
                torque[third] =
                    HEMISPHERE_MASS * GRAVITY * CELL_METRES * axis.dot(&lever.cross(&-Vector3::z()));
            }
        }
        hanging.iter().zip(&torques).find_map(|(joint, torque)| {
            let largest = if thirds == 1 { torque[0].abs() } else { largest(torque, self.angle) };
            let limit = Limits::NOMINAL.of(joint.joint);
            (largest > limit + 1e-9).then_some(Fall::Overloaded {
                module: joint.module,
                joint: joint.joint,
                torque: largest,
                limit,
            })
        })
    }
}

/// Returns the largest size of a sinusoid between 0 and `end`, from its values at 0°, 120° and 240°.
fn largest(at: &[f64; 3], end: f64) -> f64 {
    let mean = at.iter().sum::<f64>() / 3.0;
    let wave = |f: fn(f64) -> f64| (0..3).map(|k| at[k] * f(TAU * k as f64 / 3.0)).sum::<f64>() * 2.0 / 3.0;
    let (cosine, sine) = (wave(f64::cos), wave(f64::sin));
    let value = |angle: f64| (mean + cosine * angle.cos() + sine * angle.sin()).abs();
    let peak = sine.atan2(cosine);
    let inside = |angle: &f64| (angle * end.signum()) > 0.0 && angle.abs() < end.abs();
    let turning_points = (-1..=1).flat_map(|k| [peak, peak + TAU / 2.0].map(|p| p + TAU * f64::from(k)));
    turning_points.filter(inside).chain([0.0, end]).map(value).fold(0.0, f64::max)
}

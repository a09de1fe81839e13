//! Checks plans of free modules, with nothing taken from the planner.
//!
//! Poses are matrices, hemispheres are the nodes of a graph, swept space is sampled with the exact bodies: slow, and
//! written against the model of [`roombots`](metamorph_roombots) alone.

use super::collision::Model;
use super::standing::{Standing, Turned};
use metamorph_core::lattice::Cell;
use metamorph_roombots::body::Body;
use metamorph_roombots::chain::{Pose, diagonal, rotation};
use metamorph_roombots::collision::{SHRINK, cubes_collide};
use metamorph_roombots::connector::Connector;
use metamorph_roombots::convex::{Cuboid, overlap};
use metamorph_roombots::lattice_pose::{LatticePose, LatticeRotation};
use metamorph_roombots::posture::Posture;
use metamorph_roombots::sweep::CORE_DEPTH;
use metamorph_roombots::{HALF_EDGE, Kind};
use nalgebra::Vector3;
use siphasher::sip::SipHasher13;
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::hash::Hasher;
use thiserror::Error;

/// A connector of a module.
pub type Place = (usize, Connector);

/// A module as the checker sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Robot {
    /// The foot frame; its origin is the plate of C0X.
    pub foot: LatticePose,
    /// The joint values.
    pub posture: Posture,
}

/// A configuration as the checker sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct World {
    /// The modules.
    pub robots: Vec<Robot>,
    /// The connections, the smaller place first.
    pub held: BTreeSet<(Place, Place)>,
}

/// An action of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhysicalAction {
    /// Two connectors begin to hold.
    Attach(Place, Place),
    /// A connection ends.
    Detach(Place, Place),
    /// A joint turns by one step: the module, the joint (from 0), and true for the positive direction.
    Turn(usize, usize, bool),
}

/// Why an action is not possible.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// There is no such module.
    #[error("there is no module {0}")]
    NoModule(usize),
    /// The connectors do not face each other.
    #[error("{} and {} do not face each other", name(.0), name(.1))]
    NotFacing(Place, Place),
    /// A connector is part of another connection already.
    #[error("{} is connected already", name(.0))]
    InUse(Place),
    /// The model has no such connection.
    #[error("neither {} nor {} is an active connector", name(.0), name(.1))]
    Passive(Place, Place),
    /// There is no such connection.
    #[error("{} and {} are not connected", name(.0), name(.1))]
    NotHeld(Place, Place),
    /// The structure would fall apart.
    #[error("module {0} would no longer be connected with module 0")]
    Parted(usize),
    /// A joint is part of a loop.
    #[error("joint {joint} of module {module} is locked by a loop", joint = .1 + 1, module = .0)]
    Locked(usize, usize),
    /// Two modules would share a cell.
    #[error("modules {0} and {1} would share the cell {2}")]
    Collision(usize, usize, Cell),
    /// Two modules touch on the way.
    #[error("modules {0} and {1} touch during the turn")]
    Touch(usize, usize),
    /// A module is below the floor.
    #[error("module {0} is below the floor")]
    BelowFloor(usize),
    /// A module goes into the floor on the way.
    #[error("module {0} goes into the floor during the turn")]
    IntoFloor(usize),
    /// A joint bears more than it can.
    #[error(
        "joint {joint} of module {module} bears {torque} Nm, more than it can",
        joint = .joint + 1,
        torque = f64::from(*.millis) / 1000.0
    )]
    Overloaded {
        /// The module.
        module: usize,
        /// The joint, from 0.
        joint: usize,
        /// The torque in mNm.
        millis: u32,
    },
}

fn name((module, connector): &Place) -> String {
    format!("{connector} of module {module}")
}

/// The model that a plan is checked against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Physics {
    /// The collision model.
    pub collision: Model,
    /// True if one connector of each connection must be active: C0X or C3X.
    pub active: bool,
    /// What the structure stands on; `None` in free assembly.
    pub standing: Option<Standing>,
}

impl Robot {
    /// Returns the frames of its hemispheres.
    pub(super) fn hemispheres(&self) -> [LatticeRotation; 4] {
        let placement = self.posture.placement();
        [0, 1, 2, 3].map(|h| self.foot.rotation * placement.rotations[h])
    }
    /// Returns the centres of its cubes, in half cells.
    pub(super) fn centres(&self) -> [[i16; 3]; 2] {
        let placement = self.posture.placement();
        [0, 1].map(|c| {
            let cell = placement.cells[c];
            let half = [2 * cell.x, 2 * cell.y, 2 * cell.z + 1];
            self.foot.compose(LatticePose { rotation: LatticeRotation::IDENTITY, half }).half
        })
    }
    /// Returns the centre of a connector's plate and its outward normal.
    fn plate(&self, connector: Connector) -> ([i16; 3], [i16; 3]) {
        let frame = self.hemispheres()[connector.hemisphere()] * connector.frame();
        let normal = frame.apply([0, 0, -1]);
        let centre = self.centres()[connector.hemisphere() / 2];
        ([0, 1, 2].map(|i| centre[i] + normal[i]), normal)
    }
}

impl World {
    /// Returns a number that two worlds share exactly if they are the same but for a rigid motion of the whole.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = SipHasher13::new_with_keys(0, 0);
        let root = self.robots.first().map_or(LatticePose::IDENTITY, |r| r.foot.inverse());
        for robot in &self.robots {
            let pose = root.compose(robot.foot);
            let rows = pose.rotation.rows().concat();
            rows.iter().for_each(|x| hasher.write_i8(*x));
            pose.half.iter().for_each(|x| hasher.write_u16(x.rem_euclid(4096) as u16));
            hasher.write(robot.posture.steps());
        }
        for ((a, c), (b, d)) in &self.held {
            hasher.write(&[*a as u8, *c as u8, *b as u8, *d as u8]);
        }
        hasher.finish()
    }

    /// Refuses a world in which modules overlap, or connections do not meet or do not hold it together.
    pub fn check(&self) -> Result<(), Refusal> {
        self.apart()?;
        for (a, b) in &self.held {
            self.facing(*a, *b)?;
        }
        self.whole()
    }

    /// Returns twice the height of its lowest cube's bottom, in cells.
    pub fn lowest(&self) -> i16 {
        self.robots.iter().flat_map(|r| r.centres()).map(|c| c[2] - 1).min().unwrap_or(0)
    }
    /// Returns the connector that faces a connector.
    pub fn partner(&self, of: Place) -> Option<Place> {
        let all = (0..self.robots.len()).flat_map(|m| Connector::ALL.map(|c| (m, c)));
        all.into_iter().find(|other| self.facing(of, *other).is_ok())
    }
    /// Returns the other modules behind a joint; `None` if a loop locks it.
    pub fn moving_side(&self, module: usize, joint: usize) -> Option<Vec<usize>> {
        let behind = self.flood((module, joint + 1), Some((module, joint)));
        let others = (0..self.robots.len()).filter(|m| *m != module && behind.contains(&(*m, 0)));
        (!behind.contains(&(module, joint))).then(|| others.collect())
    }
    /// Returns the box of cells, in half cells, that the modules of a turn can reach, with `moving` those behind the joint.
    pub fn reach(&self, module: usize, joint: usize, moving: &[usize]) -> [[i16; 3]; 2] {
        let pivot = self.robots[module].centres()[usize::from(joint == 2)];
        let cubes = moving.iter().chain([&module]).flat_map(|m| self.robots[*m].centres());
        let square = |c: [i16; 3]| (0..3).map(|i| i32::from(c[i] - pivot[i]).pow(2)).sum::<i32>();
        // A cube reaches 0.58 cells from its centre, so one cell beyond the distance is enough.
        let reach = cubes.map(square).max().unwrap_or(0).isqrt() as i16 + 3;
        [pivot.map(|x| x - reach), pivot.map(|x| x + reach)]
    }

    fn robot(&self, module: usize) -> Result<&Robot, Refusal> {
        self.robots.get(module).ok_or(Refusal::NoModule(module))
    }
    fn facing(&self, a: Place, b: Place) -> Result<(), Refusal> {
        let (plate_a, normal_a) = self.robot(a.0)?.plate(a.1);
        let (plate_b, normal_b) = self.robot(b.0)?.plate(b.1);
        let meet = a.0 != b.0 && plate_a == plate_b && normal_a == normal_b.map(|x| -x);
        if meet { Ok(()) } else { Err(Refusal::NotFacing(a, b)) }
    }
    /// Refuses a world in which modules overlap.
    pub fn apart(&self) -> Result<(), Refusal> {
        let mut filled: Vec<([i16; 3], usize)> = Vec::new();
        for (i, robot) in self.robots.iter().enumerate() {
            for centre in robot.centres() {
                if let Some((_, other)) = filled.iter().find(|(c, _)| *c == centre) {
                    let [x, y, z] = centre.map(|h| h.div_euclid(2));
                    return Err(Refusal::Collision(*other, i, Cell::new(x, y, z)));
                }
                filled.push((centre, i));
            }
        }
        Ok(())
    }
    /// Refuses a world that is not in one piece.
    pub fn whole(&self) -> Result<(), Refusal> {
        let reached = self.flood((0, 0), None);
        let lost = (0..self.robots.len()).find(|m| !reached.contains(&(*m, 0)));
        lost.map_or(Ok(()), |m| Err(Refusal::Parted(m)))
    }
    /// Returns the hemispheres connected with `from` when the joint `without` (module and joint) is cut.
    pub(super) fn flood(
        &self,
        from: (usize, usize),
        without: Option<(usize, usize)>,
    ) -> BTreeSet<(usize, usize)> {
        let mut reached = BTreeSet::from([from]);
        let mut edge = vec![from];
        while let Some((m, h)) = edge.pop() {
            let mut next = Vec::new();
            // Joint j is between the hemispheres j and j + 1.
            if h > 0 && without != Some((m, h - 1)) {
                next.push((m, h - 1));
            }
            if h < 3 && without != Some((m, h)) {
                next.push((m, h + 1));
            }
            for ((a, c), (b, d)) in &self.held {
                let ends = [(*a, c.hemisphere()), (*b, d.hemisphere())];
                if ends[0] == (m, h) {
                    next.push(ends[1]);
                }
                if ends[1] == (m, h) {
                    next.push(ends[0]);
                }
            }
            edge.extend(next.into_iter().filter(|n| reached.insert(*n)));
        }
        reached
    }

    /// Returns the world after an action, or why the action is not possible.
    pub fn act(&self, action: PhysicalAction, physics: Physics) -> Result<World, Refusal> {
        let mut next = self.clone();
        match action {
            PhysicalAction::Attach(a, b) => {
                self.facing(a, b)?;
                for place in [a, b] {
                    if self.held.iter().any(|(c, d)| *c == place || *d == place) {
                        return Err(Refusal::InUse(place));
                    }
                }
                if physics.active && !a.1.is_active() && !b.1.is_active() {
                    return Err(Refusal::Passive(a, b));
                }
                next.held.insert((a.min(b), a.max(b)));
            }
            PhysicalAction::Detach(a, b) => {
                if !next.held.remove(&(a.min(b), a.max(b))) {
                    return Err(Refusal::NotHeld(a, b));
                }
                next.whole()?;
            }
            PhysicalAction::Turn(module, joint, positive) => {
                let robot = self.robot(module)?;
                let behind = self.flood((module, joint + 1), Some((module, joint)));
                if behind.contains(&(module, joint)) {
                    return Err(Refusal::Locked(module, joint));
                }
                self.sweep(module, joint, positive, &behind, physics.collision)?;
                let standing = physics.standing.as_ref();
                let held_moves = standing.is_some_and(|s| behind.contains(&s.held));
                if let Some(standing) = standing {
                    let front;
                    let moves = if held_moves {
                        front = self.flood((module, joint), Some((module, joint)));
                        &front
                    } else {
                        &behind
                    };
                    standing.sweep(self, &Turned { module, joint, positive, moves }, physics.collision)?;
                }
                let axis = robot.hemispheres()[joint];
                let one = if joint == 1 { LatticeRotation::QUARTER } else { LatticeRotation::DIAGONAL };
                let one = if positive { one } else { one.inverse() };
                let turn = axis * one * axis.inverse();
                let pivot = robot.centres()[usize::from(joint == 2)];
                let back = LatticePose { rotation: LatticeRotation::IDENTITY, half: pivot.map(|x| -x) };
                let about = LatticePose { rotation: turn, half: pivot }.compose(back);
                for (i, other) in next.robots.iter_mut().enumerate() {
                    if i != module && behind.contains(&(i, 0)) {
                        other.foot = about.compose(other.foot);
                    }
                }
                let times = if positive {
                    1
                } else if joint == 1 {
                    3
                } else {
                    2
                };
                let posture = &mut next.robots[module].posture;
                *posture = (0..times).fold(*posture, |p, _| p.turned(joint));
                if held_moves {
                    next.robots.iter_mut().for_each(|r| r.foot = about.inverse().compose(r.foot));
                }
                next.check()?;
            }
        }
        physics.standing.map_or(Ok(()), |standing| standing.check(&next))?;
        Ok(next)
    }

    /// Samples a turn, and refuses it if cubes touch on the way, as the collision model defines it.
    fn sweep(
        &self,
        module: usize,
        joint: usize,
        positive: bool,
        behind: &BTreeSet<(usize, usize)>,
        model: Model,
    ) -> Result<(), Refusal> {
        if model == Model::Final {
            return Ok(());
        }
        let robot = &self.robots[module];
        let axis_frame = robot.hemispheres()[joint].matrix();
        let axis = axis_frame * if joint == 1 { Vector3::z() } else { diagonal() };
        let full = if joint == 1 { FRAC_PI_2 } else { TAU / 3.0 } * if positive { 1.0 } else { -1.0 };
        let point = |half: [i16; 3]| Vector3::from(half.map(|h| f64::from(h) / 2.0));
        let pivot = point(robot.centres()[usize::from(joint == 2)]);
        const SAMPLES: u32 = 90;
        for sample in 0..=SAMPLES {
            let turn = rotation(&axis, full * f64::from(sample) / f64::from(SAMPLES));
            let mut cubes: Vec<(usize, bool, bool, Body)> = Vec::new();
            for (i, r) in self.robots.iter().enumerate() {
                let frames = r.hemispheres();
                for cube in 0..2 {
                    let moves = [0, 1].map(|h| behind.contains(&(i, 2 * cube + h)));
                    let centre = point(r.centres()[cube]);
                    let pose = |h: usize| {
                        let still = Pose { rotation: frames[2 * cube + h].matrix(), origin: centre };
                        let moved =
                            Pose { rotation: turn * still.rotation, origin: turn * (centre - pivot) + pivot };
                        if moves[h] { moved } else { still }
                    };
                    cubes.push((i, moves[0], moves[1], Body::of_hemispheres(&pose(0), &pose(1))));
                }
            }
            for (n, a) in cubes.iter().enumerate() {
                for b in &cubes[n + 1..] {
                    let (twisted_a, twisted_b) = (a.1 != a.2, b.1 != b.2);
                    let together = !twisted_a && !twisted_b && a.1 == b.1;
                    if !together && touch(model, a, b) {
                        return Err(Refusal::Touch(a.0, b.0));
                    }
                }
            }
        }
        Ok(())
    }
}

fn touch(model: Model, a: &(usize, bool, bool, Body), b: &(usize, bool, bool, Body)) -> bool {
    let twisted = a.1 != a.2 || b.1 != b.2;
    // A cube that twists fills its own cell whatever its angle: only what moves can enter it.
    let passive = twisted && !(a.1 && a.2 || b.1 && b.2);
    match model {
        Model::Final => false,
        Model::Core if passive => false,
        Model::Core if !twisted => {
            let (mover, cell) = if a.1 { (&a.3, &b.3) } else { (&b.3, &a.3) };
            let near = (mover.centre - cell.centre).norm() < 2.0;
            near && overlap(mover, &Cuboid { centre: cell.centre, half: HALF_EDGE - CORE_DEPTH })
        }
        Model::Core | Model::Strict => cubes_collide(&a.3, &b.3, SHRINK),
    }
}

/// Returns a module at a lattice pose given by the cell of its first cube.
pub fn robot(cell: [i16; 3], rotation: LatticeRotation, steps: &[u8; 3]) -> Robot {
    let normal = rotation.apply([0, 0, 1]);
    let half = [0, 1, 2].map(|i| 2 * cell[i] - normal[i]);
    let posture = Posture::from_steps(Kind::Single, steps).expect("invariant: a module has three joints");
    Robot { foot: LatticePose { rotation, half }, posture }
}

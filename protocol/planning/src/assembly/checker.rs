//! Checks plans of free modules, with nothing taken from the planner.
//!
//! Poses are matrices, hemispheres are the nodes of a graph, swept space is sampled with the exact bodies: slow, and
//! written against the model of [`roombots`](metamorph_roombots) alone.

use super::collision::Model;
use super::standing::{Standing, Turned};
pub use super::world::{Place, Refusal, Robot, World, robot};
use metamorph_roombots::HALF_EDGE;
use metamorph_roombots::body::Body;
use metamorph_roombots::chain::{Pose, diagonal, rotation};
use metamorph_roombots::collision::{SHRINK, cubes_collide};
use metamorph_roombots::convex::{Cuboid, overlap};
use metamorph_roombots::lattice_pose::{LatticePose, LatticeRotation};
use metamorph_roombots::sweep::CORE_DEPTH;
use nalgebra::Vector3;
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, TAU};

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

/// The model that a plan is checked against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Physics {
    /// The collision model.
    pub collision: Model,
    /// True if one connector of each connection must be active: C0X or C3X.
    pub active: bool,
    /// The place where the structure stands; `None` in free assembly.
    pub standing: Option<Standing>,
}

impl World {
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
        /// Number of samples of a turn.
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
                    if !together && collide(model, a, b) {
                        return Err(Refusal::Touch(a.0, b.0));
                    }
                }
            }
        }
        Ok(())
    }
}

fn collide(model: Model, a: &(usize, bool, bool, Body), b: &(usize, bool, bool, Body)) -> bool {
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

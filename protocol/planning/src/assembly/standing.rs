//! Checks that a structure stands, for the [checker](super::checker): with nothing taken from the planner, by samples.

use super::collision::Model;
use super::ground::SAMPLES;
use super::world::{Refusal, Robot, World};
use metamorph_roombots::body::Body;
use metamorph_roombots::chain::{Pose, diagonal, rotation};
use metamorph_roombots::sweep::{CORE_DEPTH, GRAZE_DEPTH};
use metamorph_roombots::torque::{GRAVITY, Limits};
use metamorph_roombots::{CELL_METRES, HEMISPHERE_MASS};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Place where a structure stands. Up is +z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Standing {
    /// The hemisphere that is held: the module, and 0 for its foot or 3 for its head.
    pub held: (usize, usize),
    /// Twice the height of the floor, in cells, if it is solid.
    pub floor: Option<i16>,
    /// True if the static torque of joints is limited.
    pub gravity: bool,
}

/// A turn of a joint, and the hemispheres that it moves.
pub(super) struct Turned<'a> {
    pub module: usize,
    pub joint: usize,
    pub positive: bool,
    pub moves: &'a BTreeSet<(usize, usize)>,
}

impl Standing {
    /// Refuses a world that does not stand.
    pub fn check(&self, world: &World) -> Result<(), Refusal> {
        let cubes = world.robots.iter().enumerate().flat_map(|(i, r)| r.centres().map(|c| (i, c[2])));
        for (module, height) in cubes {
            if self.floor.is_some_and(|floor| height - 1 < floor) {
                return Err(Refusal::BelowFloor(module));
            }
        }
        self.bears(world, &poses(world, None, 0.0), &BTreeSet::new())
    }

    /// Samples a turn, and refuses it if something goes into the floor or bears too much on the way.
    pub(super) fn sweep(&self, world: &World, turn: &Turned<'_>, model: Model) -> Result<(), Refusal> {
        let depth = match model {
            Model::Final => f64::INFINITY,
            Model::Core => CORE_DEPTH,
            Model::Strict => GRAZE_DEPTH,
        };
        for sample in 0..=SAMPLES {
            let poses = poses(world, Some(turn), f64::from(sample) / f64::from(SAMPLES));
            for (module, poses) in poses.iter().enumerate() {
                let moves = |cube: usize| (0..2).any(|h| turn.moves.contains(&(module, 2 * cube + h)));
                for cube in (0..2).filter(|cube| moves(*cube)) {
                    let body = Body::of_hemispheres(&poses[2 * cube], &poses[2 * cube + 1]);
                    let floor = self.floor.map(|floor| f64::from(floor) / 2.0 - depth);
                    if floor.is_some_and(|floor| body.lowest() < floor - 1e-9) {
                        return Err(Refusal::IntoFloor(module));
                    }
                }
            }
            self.bears(world, &poses, turn.moves)?;
        }
        Ok(())
    }

    /// Refuses a joint that bears too much. The load of joints in a loop, or with something beyond them that lies on the
    /// floor, is not determined.
    fn bears(
        &self,
        world: &World,
        poses: &[[Pose; 4]],
        moves: &BTreeSet<(usize, usize)>,
    ) -> Result<(), Refusal> {
        if !self.gravity {
            return Ok(());
        }
        for module in 0..world.robots.len() {
            for joint in 0..3 {
                let behind = world.flood((module, joint + 1), Some((module, joint)));
                if behind.contains(&(module, joint)) {
                    continue;
                }
                let far = if behind.contains(&self.held) {
                    world.flood((module, joint), Some((module, joint)))
                } else {
                    behind
                };
                let lies = |(m, h): &(usize, usize)| {
                    let height = world.robots[*m].centres()[h / 2][2];
                    !moves.contains(&(*m, *h)) && self.floor.is_some_and(|floor| height - 1 <= floor)
                };
                if far.iter().any(lies) {
                    continue;
                }
                let frame = &poses[module][joint];
                let axis = frame.rotation * if joint == 1 { Vector3::z() } else { diagonal() };
                let moment: Vector3<f64> = far
                    .iter()
                    .map(|(m, h)| (poses[*m][*h].origin - frame.origin).cross(&-Vector3::z()))
                    .sum();
                let torque = (HEMISPHERE_MASS * GRAVITY * CELL_METRES * axis.dot(&moment)).abs();
                if torque > Limits::NOMINAL.of(joint) + 2e-9 {
                    return Err(Refusal::Overloaded { module, joint, millis: (torque * 1000.0) as u32 });
                }
            }
        }
        Ok(())
    }
}

/// Returns the poses of all hemispheres after a part of a turn.
fn poses(world: &World, turn: Option<&Turned<'_>>, fraction: f64) -> Vec<[Pose; 4]> {
    let still = |r: &Robot| {
        let (frames, centres) = (r.hemispheres(), r.centres());
        [0, 1, 2, 3].map(|h| Pose {
            rotation: frames[h].matrix(),
            origin: Vector3::from(centres[h / 2].map(|x| f64::from(x) / 2.0)),
        })
    };
    let mut all: Vec<[Pose; 4]> = world.robots.iter().map(still).collect();
    let Some(turn) = turn else { return all };
    let hinge = &all[turn.module][turn.joint];
    let axis = hinge.rotation * if turn.joint == 1 { Vector3::z() } else { diagonal() };
    let pivot = hinge.origin;
    // The moving part is in front of the joint or behind it; behind it, the sense of the turn is the opposite.
    let behind = turn.moves.contains(&(turn.module, turn.joint + 1));
    let full = if turn.joint == 1 { FRAC_PI_2 } else { TAU / 3.0 };
    let angle = if behind == turn.positive { full } else { -full };
    let by: Matrix3<f64> = rotation(&axis, angle * fraction);
    for (m, h) in turn.moves {
        let pose = &mut all[*m][*h];
        *pose = Pose { rotation: by * pose.rotation, origin: by * (pose.origin - pivot) + pivot };
    }
    all
}

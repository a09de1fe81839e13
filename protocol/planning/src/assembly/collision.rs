//! Collision rules of turns: the final cells only, as in the report, or the swept space by two measures.
//!
//! In the frame of a joint all turns are one of two: 120° about (1,1,1) through the centre of a cube, 90° about z
//! through the plate between two. A verdict about a cube that moves and one that stays depends on their places in
//! that frame only, so it is computed once with the exact bodies ([`Body`]) and kept as a bit.

use super::tables::{Rot, TABLES, Vec3, sub};
use metamorph_roombots::body::Body;
use metamorph_roombots::chain::{Pose, diagonal, rotation};
use metamorph_roombots::collision::{SHRINK, cubes_collide};
use metamorph_roombots::convex::{Cuboid, overlap};
use metamorph_roombots::sweep::CORE_DEPTH;
use metamorph_roombots::{HALF_EDGE, OUTER_RADIUS};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, TAU};

/// A collision model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// The final cells must be free (report, chapter 3).
    Final,
    /// As [`Model::Final`], and no cube that moves enters the cell of one that stays deeper than 11 mm.
    Core,
    /// As [`Model::Final`], and no two exact bodies, both shrunk by 1 %, touch on the way.
    #[default]
    Strict,
}

/// A turn of a joint to be judged.
#[derive(Clone, Copy, Debug)]
pub struct Turning<'a> {
    /// The cells of all modules before the turn.
    pub cells: &'a [[Vec3; 2]],
    /// The module that turns.
    pub module: usize,
    /// Its joint, from 0.
    pub joint: u8,
    /// True for the positive direction.
    pub positive: bool,
    /// The frame of the hemisphere in front of the joint.
    pub frame: Rot,
    /// The modules behind the joint.
    pub moving: u16,
}

/// A cube in the frame of a joint: twice its place from the pivot, and whether it is the one that the joint twists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Still(Vec3),
    /// The cube of an outer joint: its half in front stays, its half behind turns.
    Own,
    Moving(Vec3),
}

/// The verdicts of one collision model, cached. A clone has a cache of its own.
#[derive(Clone, Debug)]
pub struct Collision {
    model: Model,
    /// A defect for tests: the half of its own cube that stays is left out.
    pub(super) ignores_own_half: bool,
    known: RefCell<BTreeMap<(bool, Part, Part), bool>>,
}

/// Number of samples of a turn: one every degree or less.
const SAMPLES: u32 = 120;

impl Collision {
    /// Creates an empty cache of the verdicts of a model.
    pub fn new(model: Model) -> Collision {
        Collision { model, ignores_own_half: false, known: RefCell::default() }
    }
    /// Returns the model.
    pub fn model(&self) -> Model {
        self.model
    }

    /// Returns true if the model permits a turn whose final cells are free.
    pub fn is_free(&self, turning: &Turning<'_>) -> bool {
        if self.model == Model::Final {
            return true;
        }
        let mut parts = parts(turning);
        if self.ignores_own_half {
            parts.retain(|part| *part != Part::Own);
        }
        let outer = turning.joint != 1;
        parts.iter().enumerate().all(|(i, a)| {
            parts[i + 1..].iter().all(|b| {
                let (a, b) = if a <= b { (*a, *b) } else { (*b, *a) };
                !self.collide(outer, a, b)
            })
        })
    }

    fn collide(&self, outer: bool, a: Part, b: Part) -> bool {
        match (a, b) {
            (Part::Still(_), Part::Still(_)) | (Part::Moving(_), Part::Moving(_)) => return false,
            // A cell is filled by its own cube whatever its angle.
            (Part::Still(_), Part::Own) | (Part::Own, Part::Still(_)) if self.model == Model::Core => {
                return false;
            }
            // Twice the places; bodies of two cubes touch within two outer radii.
            (Part::Still(p), Part::Moving(q)) if are_apart(outer, p, q) => return false,
            _ => {}
        }
        if let Some(known) = self.known.borrow().get(&(outer, a, b)) {
            return *known;
        }
        let verdict = self.model.collide(outer, a, b);
        self.known.borrow_mut().insert((outer, a, b), verdict);
        verdict
    }
}

/// Returns true if a cube that turns never comes within reach of another: its height along the axis and its distance from
/// the pivot stay as they are.
fn are_apart(outer: bool, still: Vec3, moving: Vec3) -> bool {
    /// Square of a distance of four outer radii, in half cells: (4 · 0.5816)² = 5.41, rounded up.
    const REACH_SQUARED: i32 = 6;
    let [p, q] = [still, moving].map(|v| v.map(i32::from));
    let square = |v: [i32; 3]| v.iter().map(|x| x * x).sum::<i32>();
    let along = if outer { p.iter().sum::<i32>() - q.iter().sum::<i32>() } else { p[2] - q[2] };
    let unit = if outer { 3 } else { 1 };
    // (|p| − |q|)² > reach, without a root.
    let sum = square(p) + square(q) - REACH_SQUARED;
    along * along >= REACH_SQUARED * unit || (sum > 0 && sum * sum > 4 * square(p) * square(q))
}

/// Returns all cubes in the frame of the joint, for a turn in positive direction: one in negative direction sweeps
/// the same as its reverse.
fn parts(turning: &Turning<'_>) -> Vec<Part> {
    let t = &**TABLES;
    let own = turning.cells[turning.module];
    let pivot = own[usize::from(turning.joint == 2)];
    let to_joint = t.inverse[usize::from(turning.frame)];
    let one = if turning.joint == 1 { t.quarter } else { t.diagonal };
    let reverse = if turning.positive { 0 } else { t.inverse[usize::from(one)] };
    // Twice the place from the centre of the pivot's cube, which for the middle joint is half a cell off the axis.
    let place = |cell: Vec3| t.rotate(to_joint, sub(cell, pivot).map(|x| 2 * x));
    let middle = turning.joint == 1;
    let shift = |p: Vec3| if middle { [p[0], p[1], p[2] - 1] } else { p };
    let moved = |cell: Vec3| Part::Moving(shift(t.rotate(reverse, place(cell))));
    let still = |cell: Vec3| Part::Still(shift(place(cell)));
    let mut parts = Vec::with_capacity(2 * turning.cells.len());
    for (i, cells) in turning.cells.iter().enumerate() {
        if i != turning.module {
            let behind = turning.moving & 1 << i != 0;
            parts.extend(cells.map(|c| if behind { moved(c) } else { still(c) }));
        }
    }
    match turning.joint {
        0 => parts.extend([Part::Own, moved(own[1])]),
        1 => parts.extend([still(own[0]), moved(own[1])]),
        _ => parts.extend([still(own[0]), Part::Own]),
    }
    parts
}

impl Model {
    fn collide(self, outer: bool, a: Part, b: Part) -> bool {
        (0..=SAMPLES).any(|i| {
            let fraction = f64::from(i) / f64::from(SAMPLES);
            let turn = if outer {
                rotation(&diagonal(), fraction * TAU / 3.0)
            } else {
                rotation(&Vector3::z(), fraction * FRAC_PI_2)
            };
            match self {
                Model::Final => false,
                // The cube that twists has no cell of its own for what it carries: by its exact body.
                Model::Core if a != Part::Own && b != Part::Own => {
                    enters(&body(a, &turn), &body(b, &turn), a, b)
                }
                Model::Core | Model::Strict => cubes_collide(&body(a, &turn), &body(b, &turn), SHRINK),
            }
        })
    }
}

fn body(part: Part, turn: &Matrix3<f64>) -> Body {
    let at = |p: Vec3| Vector3::from(p.map(|x| f64::from(x) / 2.0));
    match part {
        Part::Still(p) => Body::aligned(at(p)),
        Part::Own => {
            Body::of_hemispheres(&Pose::identity(), &Pose { rotation: *turn, origin: Vector3::zeros() })
        }
        Part::Moving(p) => {
            let pose = Pose { rotation: *turn, origin: turn * at(p) };
            Body::of_hemispheres(&pose, &pose)
        }
    }
}

/// Returns true if the cube that moves enters the cell of the other one deeper than a core cell allows.
fn enters(a: &Body, b: &Body, part_a: Part, part_b: Part) -> bool {
    let (mover, cell) = match (part_a, part_b) {
        (Part::Moving(_), _) => (a, b),
        (_, Part::Moving(_)) => (b, a),
        _ => return false,
    };
    let core = Cuboid { centre: cell.centre, half: HALF_EDGE - CORE_DEPTH };
    let outside = (mover.centre - core.centre).map(|x| (x.abs() - core.half).max(0.0)).norm();
    outside < OUTER_RADIUS && overlap(mover, &core)
}

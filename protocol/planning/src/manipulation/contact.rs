//! Contacts and swept space of an element while one joint of its holder turns, with exact bodies.
//!
//! A cell of an element is a full cube. As in [`metamorph_roombots::sweep`] all steps of a joint look alike in its
//! frame, so each place of a cell is swept once.

use super::element::centre_of;
use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::collision::SHRINK;
use metamorph_roombots::convex::{Convex, Cuboid, overlap};
use metamorph_roombots::lattice_pose::Half;
use metamorph_roombots::posture::Posture;
use metamorph_roombots::sweep::{
    FloorContact, Frame, GRAZE_DEPTH, Part, SAMPLES, Turn, maximum, near_places, refined,
};
use metamorph_roombots::{CELL_METRES, HALF_EDGE, OUTER_RADIUS};
use nalgebra::{Matrix3, Vector3};
use std::collections::{BTreeMap, BTreeSet};

/// Distance in cells from the centre of a cell to its corners: √3 / 2.
pub(super) const CORNER_RADIUS: f64 = 0.866_025_403_784_438_6;

/// A cube of an element at any angle.
pub(super) struct Block {
    pub centre: Vector3<f64>,
    pub rotation: Matrix3<f64>,
    pub half: f64,
}

impl Block {
    /// Returns the cube at `place` of the frame of a joint that has turned by `turn`.
    fn at(place: Half, turn: &Matrix3<f64>, half: f64) -> Block {
        let start = Vector3::from(place.map(|x| f64::from(x) / 2.0));
        Block { centre: turn * start, rotation: *turn, half }
    }
    /// Returns how far the cube reaches from the origin in a direction of the axes.
    pub fn reach(&self, axis: &Vector3<f64>) -> f64 {
        self.support(axis).dot(axis)
    }
}

impl Convex for Block {
    fn support(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        let own = self.rotation.transpose() * direction;
        self.centre + self.rotation * own.map(|x| if x < 0.0 { -self.half } else { self.half })
    }
    fn centre(&self) -> Vector3<f64> {
        self.centre
    }
}

/// Sweep of one cell of an element during a step, in the frame of the joint.
struct BlockSweep {
    /// How far it reaches from the pivot towards each face.
    reach: [f64; 6],
    /// The places of cells that it enters deeper than 2.2 mm.
    entered: Vec<Half>,
}

/// Sweeps of all places met so far.
#[derive(Default)]
pub struct ElementSweeper {
    blocks: BTreeMap<(Turn, Half), BlockSweep>,
    pairs: BTreeMap<(Turn, Part, Half), bool>,
    floor_depths: BTreeSet<i32>,
}

impl ElementSweeper {
    /// Creates an empty store.
    pub fn new() -> ElementSweeper {
        ElementSweeper::default()
    }

    /// Returns the cells that an element enters deeper than 2.2 mm during the step of joint `joint` (from 0) by
    /// +120° or +90° from `posture`; `None` if it meets the floor or the holder. `cells` are those at the start,
    /// in the foot frame.
    pub fn step(&mut self, posture: Posture, joint: usize, cells: &[Cell]) -> Option<BTreeSet<Cell>> {
        let start = posture.placement();
        let frame = Frame::of(posture.kind(), &start, joint);
        let places: Vec<Half> = cells.iter().map(|c| frame.place(centre_of(*c))).collect();
        let down = frame.to_joint.face(Face::Down).index();
        let pivot_height = f64::from(frame.pivot[2]) / 2.0;
        for place in &places {
            let depth = self.block(frame.turn, *place).reach[down] - pivot_height;
            self.floor_depths.insert((depth * CELL_METRES * 1e6).round() as i32);
            if FloorContact::of_depth(depth) != FloorContact::Free {
                return None;
            }
        }
        for cube in 0..posture.kind().cubes() {
            let part = frame.part(&start, cube);
            if places.iter().any(|place| self.pair_collides(frame.turn, part, *place)) {
                return None;
            }
        }
        let mut entered = BTreeSet::new();
        for place in places {
            entered.extend(self.block(frame.turn, place).entered.iter().map(|p| frame.cell(*p)));
        }
        Some(entered)
    }

    fn block(&mut self, turn: Turn, place: Half) -> &BlockSweep {
        self.blocks.entry((turn, place)).or_insert_with(|| sweep(turn, place))
    }

    fn pair_collides(&mut self, turn: Turn, part: Part, place: Half) -> bool {
        if matches!(part, Part::Moving(_)) {
            return false;
        }
        *self.pairs.entry((turn, part, place)).or_insert_with(|| {
            (0..=SAMPLES).any(|i| {
                let at = turn.at(fraction(i));
                let block = Block::at(place, &at, HALF_EDGE * SHRINK);
                let body = part.body(&at).scaled(SHRINK);
                (block.centre - body.centre).norm() < (CORNER_RADIUS + OUTER_RADIUS) * SHRINK
                    && overlap(&block, &body)
            })
        })
    }

    /// Returns how deep elements went into the floor during the steps so far, in millimetres; negative for those
    /// that stayed above it.
    pub fn depths_into_floor(&self) -> Vec<f64> {
        self.floor_depths.iter().map(|d| f64::from(*d) / 1000.0).collect()
    }
}

fn fraction(sample: u32) -> f64 {
    f64::from(sample) / f64::from(SAMPLES)
}

fn sweep(turn: Turn, place: Half) -> BlockSweep {
    let block = |t: f64| Block::at(place, &turn.at(t), HALF_EDGE);
    let blocks: Vec<Block> = (0..=SAMPLES).map(|i| block(fraction(i))).collect();
    let reach = Face::ALL.map(|face| {
        let axis = Vector3::from(<[i16; 3]>::from(face.offset()).map(f64::from));
        let best = maximum(blocks.iter().map(|b| b.reach(&axis)));
        refined(best.0, best.1, |t| block(t).reach(&axis))
    });
    let near = blocks.iter().flat_map(|b| near_places(turn, &b.centre, CORNER_RADIUS));
    let near: BTreeSet<Half> = near.collect();
    // A cell shrunk by 2.2 mm on every side meets the cube exactly if the cube enters the cell deeper than that.
    let entered = near.into_iter().filter(|place| {
        let centre = Vector3::from(place.map(|x| f64::from(x) / 2.0));
        let cell = Cuboid { centre, half: HALF_EDGE - GRAZE_DEPTH };
        blocks.iter().any(|b| (b.centre - centre).norm() < 2.0 * CORNER_RADIUS && overlap(b, &cell))
    });
    BlockSweep { reach, entered: entered.collect() }
}

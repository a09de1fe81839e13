//! The cells that a single step of a joint sweeps, and its contacts with the floor and with the robot itself.
//!
//! All steps of a joint look alike in the frame of the joint: an outer joint turns by 120° about
//! (1,1,1), a middle joint by 90° about z, and every cube behind it starts on a lattice place. So
//! each place is swept once, with a fine and refined search over the angle, and every step of the
//! motion database is put together from these by integer rotations.
//!
//! Depths fall into well separated classes (see [`FloorContact`] and the tests), so that the
//! verdicts do not depend on the last digits of a sine.

use super::body::Body;
use super::chain::{Pose, diagonal, rotation};
use super::collision::{SHRINK, cubes_collide, distant_pairs, overlap_depth};
use super::convex::{Cuboid, overlap};
use super::lattice_pose::{Half, LatticeRotation};
use super::posture::{Placement, Posture, is_middle};
use super::{CELL_METRES, HALF_EDGE, Kind, OUTER_RADIUS};
use metamorph_core::lattice::{Cell, Face};
use nalgebra::{Matrix3, Vector3};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Depth of entry, in cells, above which cells are core cells: 11 mm.
pub const CORE_DEPTH: f64 = 0.1;
/// Depth of entry, in cells, above which cells are graze cells unless they are core cells: 2.2 mm.
pub const GRAZE_DEPTH: f64 = 0.02;

/// Contact of a step with the floor. The depths that occur are 0, 3.2, 9.0 and more than 25 mm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum FloorContact {
    /// No contact (less than 0.3 mm).
    Free = 0,
    /// A plate enters the floor by 3.2 mm at the start or the end, within the 4 mm that the connectors tolerate.
    Plate = 1,
    /// A cube turns in place next to the floor, and one of its ribs enters it by 9.0 mm.
    Rib = 2,
    /// A cube enters the floor deeper than that.
    Deep = 3,
}

impl FloorContact {
    /// Returns the class of a depth in cells.
    pub fn of_depth(depth: f64) -> FloorContact {
        match depth * CELL_METRES * 1000.0 {
            mm if mm < 0.3 => FloorContact::Free,
            mm if mm < 6.0 => FloorContact::Plate,
            mm if mm < 15.0 => FloorContact::Rib,
            _ => FloorContact::Deep,
        }
    }
    /// Returns the contact of this number, if there is one.
    pub fn from_index(index: u8) -> Option<FloorContact> {
        [FloorContact::Free, FloorContact::Plate, FloorContact::Rib, FloorContact::Deep]
            .get(usize::from(index))
            .copied()
    }
}

/// The cells and contacts of a single step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepSweep {
    /// Contact with the floor.
    pub floor: FloorContact,
    /// True if cubes that are not neighbours collide.
    pub own_body: bool,
    /// Cells entered deeper than 11 mm, and all cells of the start and the end; sorted.
    pub core: Vec<Cell>,
    /// Cells entered 2.2 to 11 mm deep; sorted, none of them core.
    pub graze: Vec<Cell>,
}

/// Depth in cells, 14 mm, above which a cell is certainly a core cell and its exact depth is not computed.
const CERTAIN_DEPTH: f64 = 14.0 / 110.0;

/// The two ways a joint turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Turn {
    /// 120° about (1,1,1) through the centre of a cube.
    Outer,
    /// 90° about z through the plate between two cubes.
    Middle,
}

impl Turn {
    /// Returns the rotation after this part of the turn, 0 to 1.
    pub fn at(self, fraction: f64) -> Matrix3<f64> {
        match self {
            Turn::Outer => rotation(&diagonal(), fraction * TAU / 3.0),
            Turn::Middle => rotation(&Vector3::z(), fraction * FRAC_PI_2),
        }
    }
}

/// A cube in the frame of the joint: place in half cells from the pivot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// In front of the joint.
    Still(Half),
    /// The cube of an outer joint: its lower half stays, its upper half turns.
    Own,
    /// Behind the joint.
    Moving(Half),
}

impl Part {
    /// Returns the body in the frame of a joint that has turned by `turn`.
    pub fn body(self, turn: &Matrix3<f64>) -> Body {
        let at = |h: Half| Vector3::from(h.map(|x| f64::from(x) / 2.0));
        let still = Pose::identity();
        match self {
            Part::Still(h) => Body::aligned(at(h)),
            Part::Own => Body::of_hemispheres(&still, &Pose { rotation: *turn, origin: Vector3::zeros() }),
            Part::Moving(h) => {
                let pose = Pose { rotation: *turn, origin: turn * at(h) };
                Body::of_hemispheres(&pose, &pose)
            }
        }
    }
}

/// The cells swept by one cube in the frame of the joint.
#[derive(Clone, Debug)]
struct PartSweep {
    /// How far it reaches from the pivot towards each face.
    reach: [f64; 6],
    /// Cells entered: place in half cells from the pivot, and the depth in cells.
    entered: Vec<(Half, f64)>,
}

/// Number of samples per step: one every degree or less.
pub const SAMPLES: u32 = 120;

/// Sweeps of all places met so far.
#[derive(Debug, Default)]
pub struct Sweeper {
    parts: BTreeMap<(Turn, Part), PartSweep>,
    pairs: BTreeMap<(Turn, Part, Part), bool>,
    /// Depths into the floor that occurred, in micrometres.
    floor_depths: BTreeSet<i32>,
}

impl Sweeper {
    /// Creates an empty store.
    pub fn new() -> Sweeper {
        Sweeper::default()
    }

    /// Returns the sweep of the step of joint `joint` (from 0) by +120° or +90° from `posture`.
    pub fn step(&mut self, posture: Posture, joint: usize) -> StepSweep {
        let kind = posture.kind();
        let start = posture.placement();
        let end = posture.turned(joint).placement();
        let frame = Frame::of(kind, &start, joint);

        let mut own_body = false;
        for (a, b) in distant_pairs(kind.cubes()) {
            let (a, b) = (frame.part(&start, a), frame.part(&start, b));
            own_body |= self.pair_collides(frame.turn, a, b);
        }

        let down = frame.to_joint.face(Face::Down).index();
        let pivot_height = f64::from(frame.pivot[2]) / 2.0;
        let mut depth = f64::MIN;
        let mut entered: BTreeMap<Cell, f64> = BTreeMap::new();
        for cube in 0..kind.cubes() {
            let part = frame.part(&start, cube);
            if matches!(part, Part::Still(_)) {
                continue;
            }
            let sweep = self.part(frame.turn, part);
            depth = depth.max(sweep.reach[down] - pivot_height);
            for (place, deep) in &sweep.entered {
                let known = entered.entry(frame.cell(*place)).or_insert(0.0);
                *known = known.max(*deep);
            }
        }
        self.floor_depths.insert((depth * CELL_METRES * 1e6).round() as i32);
        for placement in [&start, &end] {
            for cell in &placement.cells[..kind.cubes()] {
                entered.insert(*cell, HALF_EDGE);
            }
        }
        let deeper = |limit: f64, until: f64| {
            entered.iter().filter(|(_, d)| **d > limit && **d <= until).map(|(c, _)| *c).collect()
        };
        StepSweep {
            floor: FloorContact::of_depth(depth),
            own_body,
            core: deeper(CORE_DEPTH, f64::MAX),
            graze: deeper(GRAZE_DEPTH, CORE_DEPTH),
        }
    }

    fn part(&mut self, turn: Turn, part: Part) -> &PartSweep {
        self.parts.entry((turn, part)).or_insert_with(|| sweep_part(turn, part))
    }

    fn pair_collides(&mut self, turn: Turn, a: Part, b: Part) -> bool {
        match (a, b) {
            (Part::Still(_), Part::Still(_)) | (Part::Moving(_), Part::Moving(_)) => false,
            _ => *self.pairs.entry((turn, a, b)).or_insert_with(|| {
                (0..=SAMPLES).any(|i| {
                    let at = turn.at(f64::from(i) / f64::from(SAMPLES));
                    cubes_collide(&a.body(&at), &b.body(&at), SHRINK)
                })
            }),
        }
    }

    /// Returns the depths in millimetres at which cells were entered, for tests of how well the classes are
    /// separated. Depths beyond 14 mm are not exact.
    pub fn depths_of_entry(&self) -> Vec<f64> {
        let all = self.parts.values().flat_map(|s| &s.entered);
        all.map(|(_, d)| d * CELL_METRES * 1000.0).collect()
    }

    /// Returns how deep cubes went into the floor during the steps so far, in millimetres; negative for cubes
    /// that stayed above it.
    pub fn depths_into_floor(&self) -> Vec<f64> {
        self.floor_depths.iter().map(|d| f64::from(*d) / 1000.0).collect()
    }

    /// Returns how deep cubes that are not neighbours overlapped during the steps so far, in millimetres.
    pub fn own_contacts(&self) -> Vec<f64> {
        let contact = |(turn, a, b): &(Turn, Part, Part)| {
            let depth = (0..=SAMPLES).map(|i| {
                let at = turn.at(f64::from(i) / f64::from(SAMPLES));
                overlap_depth(&a.body(&at), &b.body(&at))
            });
            depth.fold(0.0, f64::max) * CELL_METRES * 1000.0
        };
        self.pairs.keys().map(contact).collect()
    }
}

/// The frame of a joint at the start of a step.
pub struct Frame {
    /// How the joint turns.
    pub turn: Turn,
    joint: usize,
    /// The pivot in half cells of the foot frame.
    pub pivot: Half,
    rotation: LatticeRotation,
    /// Turns directions of the foot frame into the frame of the joint.
    pub to_joint: LatticeRotation,
}

impl Frame {
    /// Returns the frame of a joint of a metamodule that stands as placed.
    pub fn of(kind: Kind, start: &Placement, joint: usize) -> Frame {
        debug_assert!(joint < kind.joints());
        // Cubes 0, 0-1, 1 for the first module, 2, 2-3, 3 for the second.
        let cube = joint / 3 * 2 + usize::from(joint % 3 == 2);
        let mut pivot = half(start.cells[cube]);
        let turn = if is_middle(joint) { Turn::Middle } else { Turn::Outer };
        if turn == Turn::Middle {
            let along = half_offset(start.directions[cube]);
            pivot = [0, 1, 2].map(|i| pivot[i] + along[i]);
        }
        let rotation = start.rotations[joint];
        Frame { turn, joint, pivot, rotation, to_joint: rotation.inverse() }
    }
    /// Returns the place in the frame of the joint of a point of the foot frame.
    pub fn place(&self, at: Half) -> Half {
        self.to_joint.apply([0, 1, 2].map(|i| at[i] - self.pivot[i]))
    }
    /// Returns one of the four cubes as a part of the joint's frame.
    pub fn part(&self, start: &Placement, cube: usize) -> Part {
        let place = self.place(half(start.cells[cube]));
        // The joint between a cube's own halves; joints in front of that one move the whole cube.
        match self.joint.cmp(&[0, 2, 3, 5][cube]) {
            Ordering::Less => Part::Moving(place),
            Ordering::Equal => Part::Own,
            Ordering::Greater => Part::Still(place),
        }
    }
    /// Returns the cell of the foot frame at a place of the frame of the joint.
    pub fn cell(&self, place: Half) -> Cell {
        let at = self.rotation.apply(place);
        let [x, y, z] = [0, 1, 2].map(|i| self.pivot[i] + at[i]);
        Cell::new(x / 2, y / 2, (z - 1) / 2)
    }
}

fn half(c: Cell) -> Half {
    [2 * c.x, 2 * c.y, 2 * c.z + 1]
}

fn half_offset(f: Face) -> Half {
    f.offset().into()
}

fn sweep_part(turn: Turn, part: Part) -> PartSweep {
    let body = |t: f64| part.body(&turn.at(t));
    let sample = |i: u32| f64::from(i) / f64::from(SAMPLES);
    let bodies: Vec<Body> = (0..=SAMPLES).map(|i| body(sample(i))).collect();

    let reach = Face::ALL.map(|face| {
        let o = face.offset();
        let u = Vector3::new(f64::from(o.x), f64::from(o.y), f64::from(o.z));
        let at = |b: &Body| b.centre.dot(&u) + b.extent(&u);
        let best = maximum(bodies.iter().map(at));
        refined(best.0, best.1, |t| at(&body(t)))
    });

    // Cells whose centres are odd or even in half cells like the start place of the cube.
    let places = bodies.iter().flat_map(|b| near_places(turn, &b.centre, OUTER_RADIUS));
    let places: BTreeSet<Half> = places.collect();
    let mut entered = Vec::new();
    for place in places {
        let centre = Vector3::from(place.map(|x| f64::from(x) / 2.0));
        let mut best = (GRAZE_DEPTH / 2.0, None);
        for (i, b) in bodies.iter().enumerate() {
            // Deep enough for the verdict; the exact depth is not needed.
            if best.0 > CERTAIN_DEPTH {
                break;
            }
            if let Some(deeper) = entry_depth(b, &centre, best.0) {
                best = (deeper, Some(i));
            }
        }
        let Some(i) = best.1 else { continue };
        if best.0 <= CERTAIN_DEPTH {
            best.0 = refined(best.0, i, |t| entry_depth(&body(t), &centre, 0.0).unwrap_or(0.0));
        }
        entered.push((place, best.0));
    }
    PartSweep { reach, entered }
}

/// Returns the places of cells that a body of this radius centred here may enter.
pub fn near_places(turn: Turn, centre: &Vector3<f64>, radius: f64) -> Vec<Half> {
    // For an outer joint the pivot is a cell centre, for a middle one a face centre along z.
    let offset = [0.0, 0.0, if turn == Turn::Middle { 0.5 } else { 0.0 }];
    let range = |i: usize| {
        let low = (centre[i] - offset[i] - radius - HALF_EDGE).ceil() as i16;
        let high = (centre[i] - offset[i] + radius + HALF_EDGE).floor() as i16;
        (low..=high).map(move |n| 2 * n + (2.0 * offset[i]) as i16)
    };
    let mut all = Vec::new();
    for x in range(0) {
        for y in range(1) {
            all.extend(range(2).map(|z| [x, y, z]));
        }
    }
    all
}

/// Returns how deep a body enters the cell centred at `cell`: the largest d such that it meets the cell
/// shrunk by d on every side; `None` if it is not deeper than `than`.
pub fn entry_depth(body: &Body, cell: &Vector3<f64>, than: f64) -> Option<f64> {
    /// Resolution of the depth, a length in cells.
    const RESOLUTION: f64 = 1e-5;
    let meets = |d: f64| overlap(body, &Cuboid { centre: *cell, half: HALF_EDGE - d });
    // The ball around the body decides most cases.
    let outside = (body.centre - cell).map(|x| (x.abs() - (HALF_EDGE - than)).max(0.0)).norm();
    if outside >= OUTER_RADIUS * body.scale || than + RESOLUTION >= HALF_EDGE || !meets(than + RESOLUTION) {
        return None;
    }
    let (mut low, mut high) = (than + RESOLUTION, HALF_EDGE);
    while high - low > RESOLUTION {
        let middle = (low + high) / 2.0;
        if meets(middle) { low = middle } else { high = middle }
    }
    Some(low)
}

/// Returns the largest value and its index.
pub fn maximum(values: impl Iterator<Item = f64>) -> (f64, usize) {
    values.enumerate().fold((f64::MIN, 0), |best, (i, v)| if v > best.0 { (v, i) } else { best })
}

/// Refines the maximum of `f` near sample `i`, where it is `best`, by golden section.
pub fn refined(best: f64, i: usize, f: impl Fn(f64) -> f64) -> f64 {
    /// The golden ratio less one.
    const GOLDEN_RATIO: f64 = 0.618_033_988_749_895;
    let step = 1.0 / f64::from(SAMPLES);
    let at = i as f64 * step;
    let (mut low, mut high) = ((at - step).max(0.0), (at + step).min(1.0));
    let mut best = best;
    for _ in 0..16 {
        let (a, b) = (high - GOLDEN_RATIO * (high - low), low + GOLDEN_RATIO * (high - low));
        let (fa, fb) = (f(a), f(b));
        best = best.max(fa).max(fb);
        if fa >= fb { high = b } else { low = a }
    }
    best
}

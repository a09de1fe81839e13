//! Metamodules of two Roombots that walk over a floor: an independent integer kinematics, and the cells that
//! steps of joints sweep from the bytes of the motion database.

use super::{Bodies, Broken, Cell, Rule, demand, plus};
use std::collections::BTreeSet;

/// Angles in lattice steps, from the foot on.
type Joints = [u8; 6];
/// The number of values of each joint.
const VALUES: Joints = [3, 4, 3, 3, 4, 3];

/// A rotation of the lattice, by rows.
type Rotation = [[i32; 3]; 3];
const NONE: Rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
/// 120° about (1, 1, 1).
const DIAGONAL: Rotation = [[0, 0, 1], [1, 0, 0], [0, 1, 0]];
/// 90° about z.
const QUARTER: Rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]];
/// The frame of the head plate, seen from the head.
const FLIP: Rotation = [[0, -1, 0], [-1, 0, 0], [0, 0, -1]];

fn times(a: Rotation, b: Rotation) -> Rotation {
    std::array::from_fn(|r| std::array::from_fn(|c| (0..3).map(|i| a[r][i] * b[i][c]).sum()))
}

fn turned(a: Rotation, by: Rotation, steps: u8) -> Rotation {
    (0..steps).fold(a, |a, _| times(a, by))
}

/// An attachment to the floor: the connector, and quarter turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Foot {
    x: i32,
    y: i32,
    turns: u8,
}

impl Foot {
    fn to_world(self, [x, y, z]: Cell) -> Cell {
        let [x, y] = (0..self.turns).fold([x, y], |[x, y], _| [-y, x]);
        plus([self.x, self.y, 0], [x, y, z])
    }
}

/// A body seen from the end that holds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pose {
    foot: Foot,
    /// True if the head holds.
    head: bool,
    /// True if the other end holds as well.
    both: bool,
    joints: Joints,
}

/// A step of a joint.
struct Step {
    from: u16,
    joint: u8,
    /// True if it stays clear of the floor.
    clear: bool,
    swept: Vec<Cell>,
}

/// The geometry of a kind of metamodule and of its floor.
pub struct Geometry {
    /// Quarter turns between the two Roombots.
    twist: u8,
    postures: Vec<Joints>,
    steps: Vec<Step>,
    /// Connectors: smallest and largest coordinates.
    floor: [(i32, i32); 2],
}

impl Geometry {
    /// Reads the part of a motion database that belongs to the kind with this name.
    pub fn read(database: &[u8], kind: &str, floor: [(i16, i16); 2]) -> Option<Geometry> {
        let wanted = ["PAR", "SRS", "PER", "SRZ"].iter().position(|k| *k == kind)? as u8;
        let mut rest = database.strip_prefix(b"MMRBDB\x01\0")?.iter().copied();
        let mut byte = || rest.next();
        let mut cells: Vec<Cell> = Vec::new();
        for _ in 0..word(&mut byte)? {
            let [x, y, z] = [byte()?, byte()?, byte()?].map(|c| i32::from(c as i8));
            cells.push([x, y, z]);
        }
        loop {
            let kind = byte()?;
            let (postures, steps) = (word(&mut byte)?, word(&mut byte)?);
            let mut geometry = Geometry {
                twist: wanted,
                postures: Vec::new(),
                steps: Vec::new(),
                floor: floor.map(|(x, y)| (x.into(), y.into())),
            };
            for _ in 0..postures {
                geometry.postures.push(joints(word(&mut byte)?));
                byte()?;
            }
            for _ in 0..steps {
                let (from, joint, clear) = (word(&mut byte)?, byte()?, byte()? == 0);
                let mut swept = Vec::new();
                for _ in 0..2 {
                    for _ in 0..byte()? {
                        swept.push(*cells.get(usize::from(byte()?))?);
                    }
                }
                geometry.steps.push(Step { from, joint, clear, swept });
            }
            for _ in 0..usize::from(word(&mut byte)?).pow(2) {
                byte()?;
            }
            // Number 0 is the single Roombots module.
            if kind == wanted + 1 {
                return Some(geometry);
            }
        }
    }

    /// Returns the cells of a body in the frame of its foot, and the place where its other end can attach, if
    /// that lies on the floor.
    fn chain(&self, joints: Joints) -> ([Cell; 4], Option<Foot>) {
        let (mut rotation, mut cell, mut cells) = (NONE, [0; 3], vec![[0; 3]]);
        for (joint, steps) in joints.into_iter().enumerate() {
            if joint == 3 {
                rotation = turned(rotation, QUARTER, self.twist);
            }
            rotation = turned(rotation, if joint % 3 == 1 { QUARTER } else { DIAGONAL }, steps);
            if joint % 3 != 1 {
                cell = plus(cell, rotation.map(|row| row[2]));
                cells.push(cell);
            }
        }
        let below = cells.pop().unwrap_or_default();
        let cells: [Cell; 4] = std::array::from_fn(|i| cells[i]);
        let [.., last] = cells;
        let frame = times(rotation, FLIP);
        let turns = (0..4).find(|n| turned(NONE, QUARTER, *n) == frame);
        // The plate is between the last cell and the one below it.
        let lies = last[2] == 0 && below == plus(last, [0, 0, -1]) && cells.iter().all(|c| c[2] >= 0);
        let foot = turns.filter(|_| lies).map(|turns| Foot { x: last[0], y: last[1], turns });
        (cells, foot)
    }

    fn cells(&self, pose: Pose) -> Vec<Cell> {
        self.chain(pose.joints).0.map(|c| pose.foot.to_world(c)).to_vec()
    }

    /// Returns the connector that the free end lies on, and its rotation there.
    fn landing(&self, pose: Pose) -> Option<Foot> {
        let by = self.chain(pose.joints).1?;
        let [x, y, _] = pose.foot.to_world([by.x, by.y, 0]);
        let foot = Foot { x, y, turns: (pose.foot.turns + by.turns) % 4 };
        self.has(foot).then_some(foot)
    }

    fn has(&self, foot: Foot) -> bool {
        let [min, max] = self.floor;
        (min.0..=max.0).contains(&foot.x) && (min.1..=max.1).contains(&foot.y)
    }

    fn pose(&self, place: &[u8]) -> Result<Pose, Broken> {
        let wrong = || (Rule::Readable, format!("{place:?} is not a pose"));
        let [a, b, c, d, flags, _, e, f] = *place else { return Err(wrong()) };
        let [x, y] = [[a, b], [c, d]].map(|c| i16::from_le_bytes(c).into());
        let foot = Foot { x, y, turns: flags & 3 };
        let joints = *self.postures.get(usize::from(u16::from_le_bytes([e, f]))).ok_or_else(wrong)?;
        Ok(Pose { foot, head: flags & 4 != 0, both: flags & 8 != 0, joints })
    }
}

fn word(byte: &mut impl FnMut() -> Option<u8>) -> Option<u16> {
    Some(u16::from_le_bytes([byte()?, byte()?]))
}

/// Returns the joints of a code, in which the last joint is the least significant.
fn joints(code: u16) -> Joints {
    let (mut rest, mut joints) = (code, [0; 6]);
    for (joint, values) in joints.iter_mut().zip(VALUES).rev() {
        *joint = (rest % u16::from(values)) as u8;
        rest /= u16::from(values);
    }
    joints
}

struct Body {
    pose: Pose,
    /// The result of the action under way.
    to: Option<Pose>,
    /// The cells of the body, including those it may be in while it acts.
    taken: BTreeSet<Cell>,
}

/// The positions of all metamodules.
pub struct Metamodules<'a> {
    geometry: &'a Geometry,
    bodies: Vec<Option<Body>>,
    obstacles: BTreeSet<Cell>,
}

impl<'a> Metamodules<'a> {
    /// Creates metamodules without places.
    pub fn new(count: usize, geometry: &'a Geometry) -> Metamodules<'a> {
        let bodies = std::iter::repeat_with(|| None).take(count).collect();
        Metamodules { geometry, bodies, obstacles: BTreeSet::new() }
    }

    fn body(&self, id: u32) -> Result<&Body, Broken> {
        let known = self.bodies.get(id as usize).and_then(Option::as_ref);
        known.ok_or_else(|| (Rule::Follows, format!("metamodule {id} has no place")))
    }

    /// Checks that no other body is in these cells or moves through them.
    fn check_free(&self, id: u32, cells: &BTreeSet<Cell>) -> Result<(), Broken> {
        for (other, body) in self.bodies.iter().enumerate() {
            let Some(body) = body.as_ref().filter(|_| other != id as usize) else { continue };
            let Some(cell) = body.taken.intersection(cells).next() else { continue };
            let rule = match self.geometry.cells(body.pose).contains(cell) {
                true => Rule::OneBodyPerCell,
                false => Rule::Reserved,
            };
            return Err((rule, format!("{id} and {other} are in {cell:?}")));
        }
        let foreign = cells.intersection(&self.obstacles).next();
        demand(foreign.is_none(), Rule::OneBodyPerCell, || format!("{id} meets an obstacle in {foreign:?}"))
    }

    fn check_stands(&self, id: u32, pose: Pose) -> Result<(), Broken> {
        let lies = !pose.both || self.geometry.landing(pose).is_some();
        demand(self.geometry.has(pose.foot) && lies, Rule::Attached, || {
            format!("{id} is attached where there is no connector: {pose:?}")
        })?;
        let above = self.geometry.cells(pose).iter().all(|c| c[2] >= 0);
        demand(above, Rule::Possible, || format!("{id} is below the floor: {pose:?}"))
    }

    /// Returns the result of an action, and the cells that it sweeps.
    fn outcome(&self, id: u32, pose: Pose, kind: u8, action: &[u8]) -> Result<(Pose, Vec<Cell>), Broken> {
        let impossible = |why: &str| Err((Rule::Possible, format!("{id} in {pose:?} {why}")));
        match (kind, action) {
            (16, [.., low, high]) => {
                let number = u16::from_le_bytes([*low, *high]);
                let Some(step) = self.geometry.steps.get(usize::from(number)) else {
                    return impossible("turns a joint that it does not have");
                };
                if pose.both {
                    return impossible("turns a joint although both ends hold");
                }
                if !step.clear {
                    return impossible("turns into the floor");
                }
                let joint = usize::from(step.joint);
                let from = self.geometry.postures[usize::from(step.from)];
                let mut ahead = from;
                ahead[joint] = (ahead[joint] + 1) % VALUES[joint];
                let joints = match pose.joints {
                    joints if joints == from => ahead,
                    joints if joints == ahead => from,
                    _ => {
                        return Err((
                            Rule::Follows,
                            format!("{id} in {pose:?} turns from {from:?} to {ahead:?}"),
                        ));
                    }
                };
                let swept = step.swept.iter().map(|c| pose.foot.to_world(*c)).collect();
                Ok((Pose { joints, ..pose }, swept))
            }
            (17, _) if pose.both => impossible("attaches an end that holds"),
            (17, _) if self.geometry.landing(pose).is_none() => {
                Err((Rule::Attached, format!("{id} in {pose:?} attaches where there is no connector")))
            }
            (17, _) => Ok((Pose { both: true, ..pose }, Vec::new())),
            (18, _) => match self.geometry.landing(pose).filter(|_| pose.both) {
                None => Err((Rule::Attached, format!("{id} in {pose:?} releases the only end that holds"))),
                Some(foot) => {
                    let mut joints = pose.joints;
                    joints.reverse();
                    Ok((Pose { foot, head: !pose.head, both: false, joints }, Vec::new()))
                }
            },
            _ => Err((Rule::Readable, format!("{kind} and {action:?} are not an action"))),
        }
    }
}

impl Bodies for Metamodules<'_> {
    fn place(&mut self, id: u32, place: &[u8]) -> Result<(), Broken> {
        let pose = self.geometry.pose(place)?;
        if let Ok(Body { pose: known, .. }) = self.body(id) {
            return demand(*known == pose, Rule::Follows, || format!("{id} is in {known:?}, not {pose:?}"));
        }
        self.check_stands(id, pose)?;
        let taken = self.geometry.cells(pose).into_iter().collect();
        self.check_free(id, &taken)?;
        let Some(slot) = self.bodies.get_mut(id as usize) else {
            return Err((Rule::Readable, format!("there is no metamodule {id}")));
        };
        *slot = Some(Body { pose, to: None, taken });
        Ok(())
    }

    fn settle(&mut self) -> Result<(), Broken> {
        (0..self.bodies.len() as u32).try_for_each(|id| self.body(id).map(drop))
    }

    fn begin(&mut self, id: u32, kind: u8, action: &[u8]) -> Result<(), Broken> {
        let body = self.body(id)?;
        demand(body.to.is_none(), Rule::Follows, || format!("{id} acts already"))?;
        let (to, mut swept) = self.outcome(id, body.pose, kind, action)?;
        self.check_stands(id, to)?;
        swept.extend(self.geometry.cells(body.pose));
        swept.extend(self.geometry.cells(to));
        let taken = swept.into_iter().collect();
        self.check_free(id, &taken)?;
        if let Some(body) = self.bodies[id as usize].as_mut() {
            (body.to, body.taken) = (Some(to), taken);
        }
        Ok(())
    }

    fn end(&mut self, id: u32, place: &[u8]) -> Result<bool, Broken> {
        let (pose, body) = (self.geometry.pose(place)?, self.body(id)?);
        let (from, Some(to)) = (body.pose, body.to) else {
            return Err((Rule::Follows, format!("{id} ends an action that it had not begun")));
        };
        demand([from, to].contains(&pose), Rule::Follows, || {
            format!("{id} acts from {from:?} to {to:?} and is in {pose:?}")
        })?;
        let taken = self.geometry.cells(pose).into_iter().collect();
        self.bodies[id as usize] = Some(Body { pose, to: None, taken });
        Ok(pose != from)
    }

    fn obstacle(&mut self, cell: Cell, there: bool) -> Result<(), Broken> {
        if !there {
            self.obstacles.remove(&cell);
            return Ok(());
        }
        self.obstacles.insert(cell);
        let met = self.bodies.iter().flatten().find(|body| body.taken.contains(&cell));
        demand(met.is_none(), Rule::OneBodyPerCell, || format!("an obstacle comes into a body at {cell:?}"))
    }
}

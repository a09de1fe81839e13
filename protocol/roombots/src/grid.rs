//! States of the connector grid and landings on it.

use super::Kind;
use super::lattice_pose::{LatticePose, LatticeRotation};
use super::posture::Posture;
use metamorph_core::lattice::Face;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// The attachment of a plate to the grid: the connector's cell and the connection class, the number of
/// quarter turns of the attached frame about +z (the four ways of thesis 5.1.3, level 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[serde(from = "(i16, i16, u8)", into = "(i16, i16, u8)")]
pub struct GridState {
    /// Along +x.
    pub x: i16,
    /// Along +y.
    pub y: i16,
    /// The connection class: quarter turns, 0..3.
    pub class: u8,
}

impl GridState {
    /// Creates the state at this connector with this class, taken modulo 4.
    pub const fn new(x: i16, y: i16, class: u8) -> GridState {
        GridState { x, y, class: class % 4 }
    }
    /// Returns the state reached from this one by a landing given in the foot frame.
    pub fn then(self, landing: GridState) -> GridState {
        let [dx, dy, _] = LatticeRotation::QUARTER.power(self.class).apply([landing.x, landing.y, 0]);
        GridState::new(self.x + dx, self.y + dy, self.class + landing.class)
    }
    /// Returns the landing that leads back.
    pub fn inverse(self) -> GridState {
        let class = (4 - self.class) % 4;
        let [x, y, _] = LatticeRotation::QUARTER.power(class).apply([-self.x, -self.y, 0]);
        GridState::new(x, y, class)
    }
    /// Returns the mirror image x↔y.
    pub const fn mirrored(self) -> GridState {
        GridState::new(self.y, self.x, (4 - self.class) % 4)
    }
    /// Returns the pose of the attached frame.
    pub fn pose(self) -> LatticePose {
        LatticePose {
            rotation: LatticeRotation::QUARTER.power(self.class),
            half: [2 * self.x, 2 * self.y, 0],
        }
    }
    /// Returns the state of a frame that lies on the grid with +z up.
    pub fn of_pose(pose: LatticePose) -> Option<GridState> {
        let [x, y, z] = pose.half;
        let class = pose.rotation.class()?;
        (z == 0 && x % 2 == 0 && y % 2 == 0).then(|| GridState::new(x / 2, y / 2, class))
    }
}

impl From<(i16, i16, u8)> for GridState {
    fn from((x, y, class): (i16, i16, u8)) -> GridState {
        GridState::new(x, y, class)
    }
}
impl From<GridState> for (i16, i16, u8) {
    fn from(s: GridState) -> (i16, i16, u8) {
        (s.x, s.y, s.class)
    }
}
impl fmt::Display for GridState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {}, {})", self.x, self.y, self.class)
    }
}

/// Returns the landing of a posture; `None` unless the head plate lies on the floor and all cubes are above it.
pub fn landing(posture: Posture) -> Option<GridState> {
    let placement = posture.placement();
    let last = placement.directions[posture.kind().cubes() - 1];
    if last != Face::Down || !placement.above_floor() {
        return None;
    }
    GridState::of_pose(placement.head)
}

/// Returns every landing of a kind with the postures that have it, in order.
pub fn landings(kind: Kind) -> BTreeMap<GridState, Vec<Posture>> {
    let mut all: BTreeMap<GridState, Vec<Posture>> = BTreeMap::new();
    for posture in Posture::all(kind) {
        if let Some(state) = landing(posture) {
            all.entry(state).or_default().push(posture);
        }
    }
    all
}

/// Returns the fewest landings that lead to every state within `radius` cells of the start on the open grid,
/// all connectors free. States that are not reached are missing.
pub fn fewest_moves(kind: Kind, radius: i16) -> BTreeMap<GridState, u32> {
    let landings: Vec<GridState> = landings(kind).into_keys().collect();
    // Every process that moves metamodules computes this, so moves are turned once for each class, and states
    // are marked in an array.
    let turned = |class| landings.iter().map(move |m| GridState::new(0, 0, class).then(*m));
    let moves: [Vec<GridState>; 4] = [0, 1, 2, 3].map(|class| turned(class).collect());
    // Paths may leave the square they end in; four cells more are enough for moves of three cells.
    let margin = radius + 4;
    let side = 2 * usize::from(margin.unsigned_abs()) + 1;
    let place =
        |s: GridState| ((s.x + margin) as usize * side + (s.y + margin) as usize) * 4 + usize::from(s.class);
    let mut seen = vec![false; side * side * 4];
    seen[place(GridState::default())] = true;
    let mut found = BTreeMap::from([(GridState::default(), 0)]);
    let mut edge = vec![GridState::default()];
    let mut count = 0;
    while !edge.is_empty() {
        count += 1;
        let mut next = Vec::new();
        for state in edge {
            for m in &moves[usize::from(state.class)] {
                let to = GridState { x: state.x + m.x, y: state.y + m.y, class: m.class };
                if to.x.abs().max(to.y.abs()) <= margin && !std::mem::replace(&mut seen[place(to)], true) {
                    next.push(to);
                }
            }
        }
        found.extend(next.iter().filter(|s| s.x.abs().max(s.y.abs()) <= radius).map(|s| (*s, count)));
        edge = next;
    }
    found
}

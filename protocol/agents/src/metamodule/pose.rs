//! Where a metamodule stands: the attached end on the grid, the posture seen from there, and the
//! cells that follow from the two.

use metamorph_core::lattice::Cell;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};
use metamorph_core::{fields, only_message};
use metamorph_roombots::grid::GridState;
use serde::{Deserialize, Serialize};
use std::hash::{Hash, Hasher};

/// One of the two ends that can grip (thesis 4.1.3: the foot connector and the head connector).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum End {
    /// C0X of the first module.
    Foot = 0,
    /// C3X of the second module.
    Head = 1,
}

impl End {
    /// Returns the opposite end.
    pub const fn other(self) -> End {
        match self {
            End::Foot => End::Head,
            End::Head => End::Foot,
        }
    }
}

/// Load of the free end of a metamodule: nothing, or an element in one of the grips of
/// [`Elements`](super::elements::Elements).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Load(u8);

impl Load {
    /// No element.
    pub const NONE: Load = Load(0);
    /// The largest number of grips.
    pub const MAX_GRIPS: usize = u8::MAX as usize;

    /// Returns the load in the grip with this number; `None` from [`Load::MAX_GRIPS`] on.
    pub fn of_grip(grip: usize) -> Option<Load> {
        u8::try_from(grip + 1).ok().map(Load)
    }
    /// Returns the number of the grip; `None` without an element.
    pub const fn grip(self) -> Option<usize> {
        match self.0 {
            0 => None,
            n => Some(n as usize - 1),
        }
    }
}

fields!(Load { 0 });

/// Where a metamodule stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Pose {
    /// The connector that holds it, and how it is turned there.
    pub state: GridState,
    /// The end that is attached there. Postures are seen from this end.
    pub end: End,
    /// The other end is attached too.
    pub both: bool,
    /// The number of the posture in the motion database of its kind.
    pub posture: u16,
    /// The load of the free end.
    pub load: Load,
}

/// Without an element a pose hashes as before there were elements, so that traces stay comparable.
impl Hash for Pose {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Pose { state, end, both, posture, load } = self;
        (state, end, both, posture).hash(hasher);
        if *load != Load::NONE {
            load.hash(hasher);
        }
    }
}

impl Pose {
    /// Returns the pose of a metamodule that is attached by its foot only and holds nothing.
    pub const fn standing(state: GridState, posture: u16) -> Pose {
        Pose { state, end: End::Foot, both: false, posture, load: Load::NONE }
    }

    /// The connector cell that holds it.
    pub const fn foot(self) -> (i16, i16) {
        (self.state.x, self.state.y)
    }
    /// Returns true if the connector that holds `other` is at most `range` connectors away along x and along y.
    pub const fn is_within(self, range: u16, other: Pose) -> bool {
        let (a, b) = (self.foot(), other.foot());
        a.0.abs_diff(b.0) <= range && a.1.abs_diff(b.1) <= range
    }
}

/// Eight bytes.
impl Field for Pose {
    fn put(&self, out: &mut Encoder) {
        out.u16(self.state.x as u16);
        out.u16(self.state.y as u16);
        out.u8(self.state.class | (self.end as u8) << 2 | u8::from(self.both) << 3);
        self.load.put(out);
        out.u16(self.posture);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Pose, WireError> {
        let (x, y) = (from.u16()? as i16, from.u16()? as i16);
        let flags = from.u8()?;
        let load = Load::take("load", from)?;
        let posture = from.u16()?;
        let far = |c: i16| c.unsigned_abs() > Cell::LIMIT.unsigned_abs();
        if flags > 15 || far(x) || far(y) || posture >= MAX_POSTURES {
            return Err(WireError::Field("pose"));
        }
        let end = if flags & 4 == 0 { End::Foot } else { End::Head };
        let state = GridState::new(x, y, flags & 3);
        Ok(Pose { state, end, both: flags & 8 != 0, posture, load })
    }
}

/// Bound of posture numbers: the number of combinations of the lattice angles of six joints.
const MAX_POSTURES: u16 = 1296;

only_message!(Pose = 0);

/// Converts a cell from the foot frame of `state` to world coordinates.
pub fn to_world(state: GridState, cell: Cell) -> Cell {
    let (x, y) = match state.class {
        0 => (cell.x, cell.y),
        1 => (-cell.y, cell.x),
        2 => (-cell.x, -cell.y),
        _ => (cell.y, -cell.x),
    };
    Cell::new(state.x.wrapping_add(x), state.y.wrapping_add(y), cell.z)
}

/// Converts a cell from world coordinates to the foot frame of `state`.
pub fn to_frame(state: GridState, cell: Cell) -> Cell {
    let (x, y) = (cell.x.wrapping_sub(state.x), cell.y.wrapping_sub(state.y));
    let (x, y) = match state.class {
        0 => (x, y),
        1 => (y, x.wrapping_neg()),
        2 => (x.wrapping_neg(), y.wrapping_neg()),
        _ => (y.wrapping_neg(), x),
    };
    Cell::new(x, y, cell.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_inverse_and_agree_with_landings() {
        for class in 0..4 {
            let state = GridState::new(5, -3, class);
            for (x, y, z) in [(0, 0, 0), (1, 2, 3), (-2, 1, 0)] {
                let cell = Cell::new(x, y, z);
                assert_eq!(to_frame(state, to_world(state, cell)), cell);
                let landed = state.then(GridState::new(x, y, 1));
                assert_eq!(to_world(state, Cell::new(x, y, 0)), Cell::new(landed.x, landed.y, 0));
            }
        }
    }
}

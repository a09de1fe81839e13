//! Epochs: which goal the cubes work for, and how often the world-controller has opened it again. In each epoch a part of the
//! goal may be withheld, so that modules that were finalized there can leave.

use crate::goal::Goal;
use crate::lattice::Cell;
use crate::time::Time;
use crate::wire::{Decoder, Encoder, WireError};
use std::cmp::Ordering;
use std::fmt;

/// The largest number of cells that an epoch withholds; they fit into one order.
pub const MOST_WITHHELD: usize = 36;

/// A goal, and how often it has been opened again.
///
/// The lower byte is the number of the goal and the upper one counts the openings after the first, so that the first
/// epoch of a goal is the number of the goal. Epochs are ordered by goal, then by opening. There are at most 255 goals; the
/// reader of scenarios allows 32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Epoch(u16);

impl Epoch {
    /// No epoch is later.
    pub const LAST: Epoch = Epoch(u16::MAX);

    /// Returns the epoch in which a goal is opened for the first time.
    pub const fn first(goal: u8) -> Epoch {
        Epoch(goal as u16)
    }
    /// Returns the number of the goal, from zero.
    pub const fn goal(self) -> u16 {
        self.0 & 0xff
    }
    /// Returns how often the goal has been opened again.
    pub const fn opening(self) -> u8 {
        (self.0 >> 8) as u8
    }
    /// Returns the epoch in which the goal is opened once more, or `None` if it cannot be counted.
    pub const fn reopened(self) -> Option<Epoch> {
        match self.0.checked_add(1 << 8) {
            Some(next) => Some(Epoch(next)),
            None => None,
        }
    }
    /// Returns the first epoch of the next goal.
    pub const fn next_goal(self) -> Epoch {
        Epoch(self.goal() + 1)
    }

    pub(super) fn encode(self, out: &mut Encoder) {
        out.u16(self.0);
    }
    pub(super) fn decode(from: &mut Decoder<'_>) -> Result<Epoch, WireError> {
        Ok(Epoch(from.u16()?))
    }
}

impl Ord for Epoch {
    fn cmp(&self, other: &Epoch) -> Ordering {
        (self.goal(), self.opening()).cmp(&(other.goal(), other.opening()))
    }
}
impl PartialOrd for Epoch {
    fn partial_cmp(&self, other: &Epoch) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl fmt::Display for Epoch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.opening() {
            0 => write!(f, "{}", self.goal()),
            again => write!(f, "{}, opening {}", self.goal(), u16::from(again) + 1),
        }
    }
}

/// The goal cells that an epoch withholds, as their places among the goal's cells in ascending order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Withheld {
    len: u8,
    /// The places in ascending order; zero behind the last.
    places: [u16; MOST_WITHHELD],
}

impl Withheld {
    /// No cell.
    pub const NONE: Withheld = Withheld { len: 0, places: [0; MOST_WITHHELD] };

    /// Returns the withheld cells of a goal, or `None` if there are more than [`MOST_WITHHELD`]. Cells outside the goal are
    /// left out.
    pub fn new(goal: &Goal, cells: &[Cell]) -> Option<Withheld> {
        let mut withheld = Withheld::NONE;
        for (place, _) in (0u16..).zip(goal.cells()).filter(|(_, cell)| cells.contains(cell)) {
            *withheld.places.get_mut(usize::from(withheld.len))? = place;
            withheld.len += 1;
        }
        Some(withheld)
    }
    /// Returns true if no cell is withheld.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
    /// Returns the number of cells.
    pub fn len(&self) -> usize {
        self.len.into()
    }
    /// Returns the places.
    fn places(&self) -> &[u16] {
        &self.places[..usize::from(self.len)]
    }
    /// Returns the goal without the withheld cells and what only these connect with the seed, or `None` if no cell is
    /// withheld.
    pub fn left_of(&self, goal: &Goal) -> Option<Goal> {
        let is_withheld = |place: &u16| self.places().binary_search(place).is_ok();
        let left = (0u16..).zip(goal.cells()).filter(|(place, _)| !is_withheld(place)).map(|(_, cell)| cell);
        (!self.is_empty()).then(|| goal.part(left))
    }

    fn encode(&self, out: &mut Encoder) {
        out.u8(self.len);
        self.places().iter().for_each(|place| out.u16(*place));
    }
    fn decode(from: &mut Decoder<'_>) -> Result<Withheld, WireError> {
        let mut withheld = Withheld { len: from.u8()?, places: [0; MOST_WITHHELD] };
        let slots = withheld.places.get_mut(..usize::from(withheld.len));
        let mut least = 0;
        for slot in slots.ok_or(WireError::Field("withheld"))? {
            *slot = from.u16()?;
            if *slot < least {
                return Err(WireError::Field("withheld"));
            }
            least = slot.checked_add(1).ok_or(WireError::Field("withheld"))?;
        }
        Ok(withheld)
    }
}

/// What the world-controller tells of an epoch when it begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Opening {
    /// The epoch.
    pub epoch: Epoch,
    /// When it began, by the controller's clock.
    pub opened: Time,
    /// The cells in which no module is finalized.
    pub withheld: Withheld,
}

impl Opening {
    /// Returns an opening that withholds nothing.
    pub fn whole(epoch: Epoch, opened: Time) -> Opening {
        Opening { epoch, opened, withheld: Withheld::NONE }
    }
    pub(super) fn encode(&self, out: &mut Encoder) {
        self.epoch.encode(out);
        out.time(self.opened);
        self.withheld.encode(out);
    }
    pub(super) fn decode(from: &mut Decoder<'_>) -> Result<Opening, WireError> {
        Ok(Opening { epoch: Epoch::decode(from)?, opened: from.time()?, withheld: Withheld::decode(from)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goal::Growth;

    #[test]
    fn epochs_are_ordered_by_goal_then_by_opening() {
        let first = Epoch::first(1);
        let again = first.reopened().unwrap();
        assert!(Epoch::first(0).reopened().unwrap() < first && first < again && again < again.next_goal());
        assert_eq!((again.goal(), again.opening(), again.next_goal()), (1, 1, Epoch::first(2)));
        assert_eq!(again.to_string(), "1, opening 2");
        let last = std::iter::successors(Some(first), |e| e.reopened()).last().unwrap();
        assert_eq!((last.goal(), last.opening()), (1, u8::MAX));
    }

    #[test]
    fn what_is_left_is_connected_with_the_seed() {
        let row: Vec<Cell> = (0..5).map(|x| Cell::new(x, 0, 0)).collect();
        let goal = Goal::compile(&row, row[1], Growth::Solid).unwrap();
        let left = |cells: &[Cell]| {
            let withheld = Withheld::new(&goal, cells).unwrap();
            withheld.left_of(&goal).map(|left| left.cells().collect::<Vec<Cell>>())
        };
        assert_eq!(left(&[]), None);
        assert_eq!(left(&[Cell::new(9, 9, 9)]), None);
        assert_eq!(left(&[row[0], row[3]]), Some(row[1..3].to_vec()));
        let many: Vec<Cell> = (0..40).map(|x| Cell::new(x, 0, 0)).collect();
        let long = Goal::compile(&many, many[0], Growth::Solid).unwrap();
        assert!(Withheld::new(&long, &many[1..=MOST_WITHHELD]).is_some());
        assert!(Withheld::new(&long, &many[1..MOST_WITHHELD + 2]).is_none());
    }
}

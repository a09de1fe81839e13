//! Epochs: which goal the cubes work for, and how often the world-controller has opened it again. In a closed epoch nothing is
//! built, so that modules that were finalized can leave when the controller leads them.

use core::cmp::Ordering;
use core::fmt;
use metamorph_core::fields;
use metamorph_core::time::Time;

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
}

fields!(Epoch { 0 });

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

/// The world-controller's description of an epoch at its beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Opening {
    /// The epoch.
    pub epoch: Epoch,
    /// When it began, by the controller's clock.
    pub opened: Time,
    /// True if no module is finalized and none has a reason to move, so that the controller can lead them.
    pub is_closed: bool,
}

impl Opening {
    /// Returns the opening of an epoch in which the goal is built.
    pub fn of(epoch: Epoch, opened: Time) -> Opening {
        Opening { epoch, opened, is_closed: false }
    }
}

fields!(Opening { epoch, opened, is_closed as "closed" });

#[cfg(test)]
mod tests {
    use super::*;

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
}

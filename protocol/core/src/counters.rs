//! Counters of protocol messages, by class.
//!
//! Every copy of a message has exactly one fate. So for every class, once a run has ended:
//! `sent + duplicated = delivered + lost + overflowed + expired + refused + in flight`.

use crate::names;
use core::fmt;
use core::ops::{AddAssign, Index, IndexMut};
use serde::{Deserialize, Serialize};

/// Purpose of a protocol message; messages are counted by class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Class {
    /// Attraction: distances.
    Gradient = 0,
    /// Growth: roles, goal cells wanted and filled, progress counts.
    Seed = 1,
    /// Connectivity: keeping the structure in one piece.
    Connectivity = 2,
    /// Asking for and granting space.
    Negotiation = 3,
    /// Between agents and the world-controller.
    World = 4,
    /// Liveness: repeats that carry nothing new, first contact.
    Liveness = 5,
    /// Locomotion: phases of oscillators.
    Gait = 6,
}

names!(Class {
    Gradient => "gradient",
    Seed => "seed",
    Connectivity => "connectivity",
    Negotiation => "negotiation",
    World => "world",
    Liveness => "liveness",
    Gait => "gait",
});

impl Class {
    /// Returns the class with this number, if there is one.
    pub const fn from_index(index: u8) -> Option<Class> {
        if (index as usize) < Class::ALL.len() { Some(Class::ALL[index as usize]) } else { None }
    }
    /// Returns the index of the class in arrays of one entry per class.
    pub const fn index(self) -> usize {
        self as usize
    }
}

impl fmt::Display for Class {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Counts of one class of messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Counts {
    /// Handed to the link by an agent.
    pub sent: u64,
    /// Handed to an agent by the link.
    pub delivered: u64,
    /// Lost by the link model, or cut off by a partition.
    pub lost: u64,
    /// Extra copies that the link made.
    pub duplicated: u64,
    /// Dropped because the receiver's inbox was full.
    pub overflowed: u64,
    /// Arrived after their contact had ended, or at a module whose process was dead.
    pub expired: u64,
    /// Arrived damaged, and refused by the decoder.
    pub refused: u64,
    /// Bytes of the messages sent, headers included.
    pub bytes: u64,
}

impl Counts {
    /// Returns the number of messages that are still under way.
    pub fn in_flight(&self) -> i64 {
        let out = self.delivered + self.lost + self.overflowed + self.expired + self.refused;
        (self.sent + self.duplicated) as i64 - out as i64
    }
}

impl AddAssign for Counts {
    fn add_assign(&mut self, o: Counts) {
        self.sent += o.sent;
        self.delivered += o.delivered;
        self.lost += o.lost;
        self.duplicated += o.duplicated;
        self.overflowed += o.overflowed;
        self.expired += o.expired;
        self.refused += o.refused;
        self.bytes += o.bytes;
    }
}

/// Counts of all classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Tally {
    by_class: [Counts; Class::ALL.len()],
}

impl Tally {
    /// Returns the sum over all classes.
    pub fn total(&self) -> Counts {
        let mut sum = Counts::default();
        for counts in self.by_class {
            sum += counts;
        }
        sum
    }
    /// Iterates over the classes and their counts.
    pub fn iter(&self) -> impl Iterator<Item = (Class, &Counts)> {
        Class::ALL.into_iter().zip(&self.by_class)
    }
}

impl Index<Class> for Tally {
    type Output = Counts;
    fn index(&self, class: Class) -> &Counts {
        &self.by_class[class.index()]
    }
}
impl IndexMut<Class> for Tally {
    fn index_mut(&mut self, class: Class) -> &mut Counts {
        &mut self.by_class[class.index()]
    }
}
impl AddAssign for Tally {
    fn add_assign(&mut self, o: Tally) {
        for (mine, theirs) in self.by_class.iter_mut().zip(o.by_class) {
            *mine += theirs;
        }
    }
}

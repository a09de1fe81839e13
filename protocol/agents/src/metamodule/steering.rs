//! Commands of an operator to one metamodule: go to a connector, fill a seed, stay. They replace the strategy for a
//! while, and nothing else: every motion needs the same locks as any other, and requests of others are answered.

use super::blueprint::{MAX_SEEDS, Seed};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};

/// The most seeds, as the number that a command carries.
const SEEDS: i16 = MAX_SEEDS as i16;

/// A command of an operator to a metamodule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Steering {
    /// It decides for itself again.
    Release,
    /// It stays where it is.
    Hold,
    /// It goes to this connector, stands up there, and stays.
    GoTo((i16, i16)),
    /// It fills this seed. It waits beside the goal until the seed is open.
    Take(u8),
}

impl Field for Steering {
    fn put(&self, out: &mut Encoder) {
        let (kind, a, b) = match *self {
            Steering::Release => (0, 0, 0),
            Steering::Hold => (1, 0, 0),
            Steering::GoTo((x, y)) => (2, x, y),
            Steering::Take(seed) => (3, i16::from(seed), 0),
        };
        out.u8(kind);
        out.u16(a as u16);
        out.u16(b as u16);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Steering, WireError> {
        let (kind, a, b) = (from.u8()?, from.u16()? as i16, from.u16()? as i16);
        let far = |c: i16| c.unsigned_abs() > Cell::LIMIT.unsigned_abs();
        match (kind, a, b) {
            (0, 0, 0) => Ok(Steering::Release),
            (1, 0, 0) => Ok(Steering::Hold),
            (2, x, y) if !far(x) && !far(y) => Ok(Steering::GoTo((x, y))),
            (3, seed @ 0..SEEDS, 0) => Ok(Steering::Take(seed as u8)),
            _ => Err(WireError::Field("steering")),
        }
    }
}

/// A command and the end of its lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Steered {
    pub steering: Steering,
    pub until: Time,
}

/// Returns the place that a metamodule fills when it stands upright on a connector.
pub fn upright(foot: (i16, i16)) -> Seed {
    Seed { foot, directions: [Face::Up; 3] }
}

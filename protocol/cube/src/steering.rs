//! Commands of an operator to one cube: stay, or go towards a cell. They choose among the motions that the module could ask
//! for anyway: every motion needs the same locks, and a module in reserve leaves only if it may.

use super::Cube;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};

/// A command of an operator to a cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Steering {
    /// It decides for itself again.
    Release,
    /// It stays where it is.
    Hold,
    /// It goes towards this cell, as long as a move brings it nearer, and stays there.
    GoTo(Cell),
}

impl Field for Steering {
    fn put(&self, out: &mut Encoder) {
        let (kind, cell) = match *self {
            Steering::Release => (0, Cell::default()),
            Steering::Hold => (1, Cell::default()),
            Steering::GoTo(cell) => (2, cell),
        };
        out.u8(kind);
        out.cell(cell);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Steering, WireError> {
        match (from.u8()?, from.cell()?) {
            (0, cell) if cell == Cell::default() => Ok(Steering::Release),
            (1, cell) if cell == Cell::default() => Ok(Steering::Hold),
            (2, cell) => Ok(Steering::GoTo(cell)),
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

impl Cube {
    /// Takes a command. A finalized module stays what it is.
    pub(super) fn on_steering(&mut self, now: Time, steering: Steering, until: Time) {
        hit(CoveragePoint::CubeSteered);
        let is_over = steering == Steering::Release || until <= now;
        self.steered = if is_over { None } else { Some(Steered { steering, until }) };
        // The current attempt belongs to the module's own decision, not to the command.
        self.abort_attempt(now, None);
        self.decide_soon(now);
    }

    /// Returns the command that holds at this time.
    pub(super) fn steered_at(&mut self, now: Time) -> Option<Steered> {
        self.steered.take_if(|steered| now >= steered.until);
        self.steered
    }
}

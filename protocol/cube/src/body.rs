//! Actions that a cube asks of its body, and percepts that the body returns.

use metamorph_core::lattice::{Cell, Motion, MotionKind};
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Wire, WireError};
use metamorph_core::{codes, messages};

/// The action of a cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Move {
    /// The transition to make: its kind, the support that carries the module, and the heading.
    pub motion: Motion,
    /// The latest start: the body must refuse to begin later.
    pub not_after: Time,
}

impl Wire for Move {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        out.u8(self.motion.kind as u8);
        out.face(self.motion.support);
        out.face(self.motion.heading);
        out.time(self.not_after);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Move, WireError> {
        if kind != 0 {
            return Err(WireError::Kind(kind));
        }
        let kind = match from.u8()? {
            0 => MotionKind::Slide,
            1 => MotionKind::Convex,
            _ => return Err(WireError::Field("motion")),
        };
        let (support, heading) = (from.face("support")?, from.face("heading")?);
        if heading.slot_in(support).is_none() {
            return Err(WireError::Field("heading"));
        }
        Ok(Move { motion: Motion { kind, support, heading }, not_after: from.time()? })
    }
}

/// Why a body did not start a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Refusal {
    /// A cell that the move needs free is not free, or a support is missing.
    Blocked = 0,
    /// The action reached the body after [`Move::not_after`].
    Late = 1,
    /// The contacts had changed since the agent decided.
    Stale = 2,
    /// The body is moving already.
    Moving = 3,
}

codes!(Refusal, "refusal" { Blocked, Late, Stale, Moving });

/// The outcome of a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Percept {
    /// The module has arrived at a new cell.
    Arrived(Cell),
    /// The move was tried and failed; the module is at its old cell.
    Failed,
    /// The move was not started.
    Refused(Refusal),
}

messages!(Percept { 0 => Arrived(cell), 1 => Failed, 2 => Refused(refusal) });

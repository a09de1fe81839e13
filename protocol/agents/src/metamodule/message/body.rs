//! Actions that a metamodule requests of its body, and the answers of the body.

use crate::metamodule::pose::{Load, Pose};
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Field, Wire, WireError};
use metamorph_core::{codes, messages};

/// One action of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BodyAction {
    /// One joint turns by one position: the step with this number in the motion database.
    Turn(u16),
    /// The free end, which lies on a connector, grips it.
    Attach,
    /// The end that has been attached for longer detaches; the other one holds from now on.
    Detach,
    /// The free end grips an element, which is where this load would be.
    Grip(Load),
    /// The free end releases the element.
    LetGo,
}

/// An action for the body, with the latest time to begin it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Action {
    /// The action of the body.
    pub body_action: BodyAction,
    /// The body refuses to begin after this time.
    pub not_after: Time,
}

impl Wire for Action {
    fn kind(&self) -> u8 {
        match self.body_action {
            BodyAction::Turn(_) => 16,
            BodyAction::Attach => 17,
            BodyAction::Detach => 18,
            BodyAction::Grip(_) => 19,
            BodyAction::LetGo => 20,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        out.time(self.not_after);
        match self.body_action {
            BodyAction::Turn(step) => out.u16(step),
            BodyAction::Grip(load) => load.put(out),
            BodyAction::Attach | BodyAction::Detach | BodyAction::LetGo => {}
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Action, WireError> {
        let not_after = from.time()?;
        let body_action = match kind {
            16 => BodyAction::Turn(from.u16()?),
            17 => BodyAction::Attach,
            18 => BodyAction::Detach,
            19 => BodyAction::Grip(Load::take("load", from)?),
            20 => BodyAction::LetGo,
            _ => return Err(WireError::Kind(kind)),
        };
        Ok(Action { body_action, not_after })
    }
}

/// Why a body does not begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Refusal {
    /// Something is in the way.
    Blocked = 0,
    /// The action reached the body after [`Action::not_after`].
    Late = 1,
    /// The contacts have changed since the agent decided.
    Stale = 2,
    /// The body is still carrying out an earlier action.
    Busy = 3,
    /// The body cannot do that from where it is: also, an element would fall, two bodies hold it, or it is too heavy.
    Impossible = 4,
}

codes!(Refusal, "refusal" { Blocked, Late, Stale, Busy, Impossible });

/// How an action went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Percept {
    /// It is done, and this is where the body is now.
    Done(Pose),
    /// It failed; the body is where it was.
    Failed,
    /// It was not begun.
    Refused(Refusal),
    /// The connector was too far from its target to close; the body is where it was.
    Misaligned,
}

messages!(Percept { 16 => Done(pose), 17 => Failed, 18 => Refused(refusal), 19 => Misaligned });

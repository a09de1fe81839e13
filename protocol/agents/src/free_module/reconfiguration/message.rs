//! Messages of free modules to each other, to their bodies and to the controller.

use super::place::{CONNECTORS, LatticePlace, connectors};
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Field, Wire, WireError};
use metamorph_core::{codes, fields, messages};
use metamorph_planning::assembly::tables::POSTURES;

/// Part of one module in a step of a plan. A connection is made, or given up, by both sides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum LatticeBodyAction {
    /// Closes a connector, which faces another one.
    Attach(u8),
    /// Opens a connector.
    Detach(u8),
    /// Turns a joint by one step.
    Turn {
        /// The joint, from 0.
        joint: u8,
        /// True for the positive direction.
        positive: bool,
    },
}

impl LatticeBodyAction {
    const fn number(self) -> u8 {
        match self {
            LatticeBodyAction::Attach(_) => 0,
            LatticeBodyAction::Detach(_) => 1,
            LatticeBodyAction::Turn { .. } => 2,
        }
    }
}

impl Field for LatticeBodyAction {
    fn put(&self, out: &mut Encoder) {
        out.u8(self.number());
        match *self {
            LatticeBodyAction::Attach(connector) | LatticeBodyAction::Detach(connector) => out.u8(connector),
            LatticeBodyAction::Turn { joint, positive } => out.u8(2 * joint + u8::from(positive)),
        }
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<LatticeBodyAction, WireError> {
        let (number, what) = (from.u8()?, from.u8()?);
        match number {
            0 if usize::from(what) < CONNECTORS => Ok(LatticeBodyAction::Attach(what)),
            1 if usize::from(what) < CONNECTORS => Ok(LatticeBodyAction::Detach(what)),
            2 if what < 6 => Ok(LatticeBodyAction::Turn { joint: what / 2, positive: what % 2 == 1 }),
            _ => Err(WireError::Field("body_action")),
        }
    }
}

/// The name of a step: orders are idempotent by it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StepName {
    /// The plan; a later one has a larger number.
    pub epoch: u32,
    /// The action of the plan.
    pub index: u16,
    /// Counts the tries after the first.
    pub attempt: u8,
}

fields!(StepName { epoch, index, attempt });

/// An order of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LatticeOrder {
    /// Orders of earlier epochs are over. What is under way is finished.
    Hold {
        /// The epoch that begins.
        epoch: u32,
    },
    /// A step of a plan.
    Step {
        /// Its name.
        step: StepName,
        /// The action of the body.
        body_action: LatticeBodyAction,
        /// The joint values and closed connectors for which it was planned.
        expect: (u8, u16),
        /// It does not begin later.
        not_after: Time,
    },
}

messages!(LatticeOrder {
    16 => Hold { epoch },
    17 => Step { step, body_action, expect, not_after }
        if usize::from(expect.0) < POSTURES => "posture"
        if connectors(expect.1).is_ok() => "connectors",
});

/// Why a step was not carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Failure {
    /// The connector did not close.
    Connection = 0,
    /// The joint did not turn.
    Joint = 1,
    /// Another module is in the way.
    Blocked = 2,
    /// The joint is part of a loop, or the module cannot do it from where it is.
    Impossible = 3,
    /// The module is not in the state for which it was planned.
    Stale = 4,
    /// It could not begin in time.
    Late = 5,
}

impl Failure {
    const ALL: [Failure; 6] = [
        Failure::Connection,
        Failure::Joint,
        Failure::Blocked,
        Failure::Impossible,
        Failure::Stale,
        Failure::Late,
    ];
}

/// Result of a step.
pub type StepResult = Result<(), Failure>;

/// Status report to the controller, sent on each change and in answer to a repeated order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LatticeStatus {
    /// The latest epoch that it knows.
    pub epoch: u32,
    /// Where it is.
    pub place: LatticePlace,
    /// It carries out a step, or is carried by another module's turn.
    pub busy: bool,
    /// Its latest step that is over, in this incarnation.
    pub last: Option<(StepName, StepResult)>,
    /// How often a branch lock was refused.
    pub prevented: u32,
    /// The module that refused the latest branch lock, while its own step waits for it.
    pub waits_for: Option<ModuleId>,
}

impl Wire for LatticeStatus {
    fn kind(&self) -> u8 {
        16
    }
    fn encode(&self, out: &mut Encoder) {
        out.u32(self.epoch);
        self.place.put(out);
        out.bool(self.busy);
        let (step, result) = self.last.map_or((StepName::default(), u8::MAX), |(step, result)| {
            (step, result.map_or_else(|failure| failure as u8 + 1, |()| 0))
        });
        step.put(out);
        out.u8(result);
        out.u32(self.prevented);
        self.waits_for.put(out);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<LatticeStatus, WireError> {
        if kind != 16 {
            return Err(WireError::Kind(kind));
        }
        let (epoch, place, busy) = (from.u32()?, LatticePlace::take("place", from)?, from.bool("busy")?);
        let step = StepName::take("step", from)?;
        let last = match from.u8()? {
            u8::MAX if step == StepName::default() => None,
            0 => Some((step, Ok(()))),
            n => {
                let failure = Failure::ALL.get(usize::from(n) - 1);
                Some((step, Err(*failure.ok_or(WireError::Field("result"))?)))
            }
        };
        let prevented = from.u32()?;
        let waits_for = Field::take("waits_for", from)?;
        Ok(LatticeStatus { epoch, place, busy, last, prevented, waits_for })
    }
}

/// An action for the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LatticeAction {
    /// The step that it carries out.
    pub step: StepName,
    /// The action of the body.
    pub body_action: LatticeBodyAction,
    /// The body refuses to begin after this time.
    pub not_after: Time,
}

impl Wire for LatticeAction {
    fn kind(&self) -> u8 {
        16 + self.body_action.number()
    }
    fn encode(&self, out: &mut Encoder) {
        (self.step, self.body_action, self.not_after).put(out);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<LatticeAction, WireError> {
        let (step, body_action): (StepName, LatticeBodyAction) = Field::take("action", from)?;
        if kind != 16 + body_action.number() {
            return Err(WireError::Kind(kind));
        }
        Ok(LatticeAction { step, body_action, not_after: from.time()? })
    }
}

/// Why a body does not begin an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum LatticeRefusal {
    /// Another module is in the way.
    Blocked = 0,
    /// The action reached the body after [`LatticeAction::not_after`].
    Late = 1,
    /// The contacts have changed since the agent decided.
    Stale = 2,
    /// The body acts, or is carried by a turn.
    Busy = 3,
    /// A loop locks the joint, the connection holds the structure together, or the connector faces nothing.
    Impossible = 4,
}

codes!(LatticeRefusal, "refusal" { Blocked, Late, Stale, Busy, Impossible });

/// The rotation of a part of the structure about a joint's axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Swing {
    /// A cell whose centre the axis goes through.
    pub pivot: Cell,
    /// The direction of the axis, of any length.
    pub axis: [i8; 3],
    /// The angle in degrees, by the right-hand rule about the axis.
    pub degrees: i16,
}

fields!(Swing { pivot, axis, degrees });

/// Answer of a body to an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LatticePercept {
    /// The action is done, and this is where the body is now.
    Done(LatticePlace),
    /// It failed; the body is where it was.
    Failed,
    /// It was not begun.
    Refused(LatticeRefusal),
    /// Another module's turn begins, which carries this body.
    Carried(Swing),
    /// That turn is over. `moved` is false if it failed.
    Settled {
        /// Where the body is now.
        place: LatticePlace,
        /// Whether it was moved.
        moved: bool,
    },
    /// The connector was too far from its target to close; the body is where it was.
    Misaligned,
}

messages!(LatticePercept {
    16 => Done(place),
    17 => Failed,
    18 => Refused(refusal),
    19 => Carried(swing),
    20 => Settled { place, moved },
    21 => Misaligned,
});

/// Why a branch lock is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum LatticeDenial {
    /// The module has a pending action.
    Busy = 0,
    /// The module keeps still for another turn.
    Held = 1,
    /// The joint is part of a loop.
    Loop = 2,
    /// The module has just restarted, and may have granted a lock that it does not know of.
    Quarantined = 3,
    /// A connection ended while the answer was awaited.
    Changed = 4,
}

impl LatticeDenial {
    const ALL: [LatticeDenial; 5] = [
        LatticeDenial::Busy,
        LatticeDenial::Held,
        LatticeDenial::Loop,
        LatticeDenial::Quarantined,
        LatticeDenial::Changed,
    ];
}

/// A message between modules: it is about the branch lock of a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LatticeMessage {
    /// The module that turns.
    pub origin: ModuleId,
    /// Its attempt; a later one is larger.
    pub token: u32,
    /// Its content.
    pub what: LockMessage,
}

/// A message about a branch lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LockMessage {
    /// Keep still, and ask those behind.
    Request,
    /// All behind keep still, or one of them refuses.
    Response(Option<(LatticeDenial, ModuleId)>),
    /// The lock is over.
    Release,
}

impl Wire for LatticeMessage {
    fn kind(&self) -> u8 {
        match self.what {
            LockMessage::Request => 16,
            LockMessage::Response(_) => 17,
            LockMessage::Release => 18,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        out.u32(self.origin.0);
        out.u32(self.token);
        if let LockMessage::Response(denial) = self.what {
            let (why, by) = denial.map_or((u8::MAX, u32::MAX), |(why, by)| (why as u8, by.0));
            out.u8(why);
            out.u32(by);
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<LatticeMessage, WireError> {
        let (origin, token) = (ModuleId(from.u32()?), from.u32()?);
        let what = match kind {
            16 => LockMessage::Request,
            17 => LockMessage::Response(match (from.u8()?, from.u32()?) {
                (u8::MAX, u32::MAX) => None,
                (why, by) => {
                    let why = LatticeDenial::ALL.get(usize::from(why)).ok_or(WireError::Field("denial"))?;
                    Some((*why, ModuleId(by)))
                }
            }),
            18 => LockMessage::Release,
            _ => return Err(WireError::Kind(kind)),
        };
        Ok(LatticeMessage { origin, token, what })
    }
}

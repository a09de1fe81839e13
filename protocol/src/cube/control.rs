//! What the world-controller asks of a cube, and what a cube reports to it.

use super::message::{NOBODY, Role};
use crate::ids::{ModuleId, Port, Session};
use crate::wire::{Decoder, Encoder, Wire, WireError};

/// What the world-controller asks of a cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Order {
    /// Work for this goal from now on.
    Goal {
        /// The place of the goal in the list of goals.
        epoch: u16,
    },
    /// Whoever is behind this contact is certified dead: fenced off, not merely silent.
    Condemn {
        /// The port of the contact.
        port: Port,
        /// Its session.
        session: Session,
        /// The latest goal that it can have worked for.
        epoch: u16,
        /// In that goal it was finalized: it is for good, and so is all that it hangs on.
        finalized: bool,
    },
}

impl Wire for Order {
    fn kind(&self) -> u8 {
        match self {
            Order::Goal { .. } => 0,
            Order::Condemn { .. } => 1,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            Order::Goal { epoch } => out.u16(*epoch),
            Order::Condemn { port, session, epoch, finalized } => {
                out.u8(port.0);
                out.u32(session.0);
                out.u16(*epoch);
                out.bool(*finalized);
            }
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Order, WireError> {
        match kind {
            0 => Ok(Order::Goal { epoch: from.u16()? }),
            1 => Ok(Order::Condemn {
                port: Port(from.face("port")? as u8),
                session: Session(from.u32()?),
                epoch: from.u16()?,
                finalized: from.bool("finalized")?,
            }),
            _ => Err(WireError::Kind(kind)),
        }
    }
}

/// What a cube tells the world-controller when it changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Status {
    /// Which goal it works for.
    pub epoch: u16,
    /// Its part in the growth.
    pub role: Role,
    /// It is finalized or has a parent.
    pub attached: bool,
    /// It cannot move any more.
    pub immobile: bool,
    /// It holds a child that it believes dead, and so cannot leave.
    pub pinned: bool,
    /// It knows a way to a target.
    pub attracted: bool,
    /// Faces behind which it wants a cell filled.
    pub wants: u8,
    /// Finalized modules that it stands for; at the seed, all of them.
    pub subtree: u32,
    /// How often another module held the cell it wanted, so that it did not collide.
    pub prevented: u32,
    /// Whom it waits for, if it does.
    pub waits_for: Option<ModuleId>,
}

impl Wire for Status {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        out.u16(self.epoch);
        out.u8(self.role as u8);
        for flag in [self.attached, self.immobile, self.pinned, self.attracted] {
            out.bool(flag);
        }
        out.u8(self.wants);
        out.u32(self.subtree);
        out.u32(self.prevented);
        out.u32(self.waits_for.map_or(NOBODY, |id| id.0));
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Status, WireError> {
        if kind != 0 {
            return Err(WireError::Kind(kind));
        }
        Ok(Status {
            epoch: from.u16()?,
            role: Role::decode(from.u8()?)?,
            attached: from.bool("attached")?,
            immobile: from.bool("immobile")?,
            pinned: from.bool("pinned")?,
            attracted: from.bool("attracted")?,
            wants: from.u8()?,
            subtree: from.u32()?,
            prevented: from.u32()?,
            waits_for: Some(from.u32()?).filter(|id| *id != NOBODY).map(ModuleId),
        })
    }
}

//! Orders of the world-controller to a cube, and reports of a cube to it.

use super::message::{NO_MODULE, Role};
use crate::ids::{ModuleId, Port, Session};
use crate::wire::{Decoder, Encoder, Wire, WireError};

/// An order of the world-controller to a cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Order {
    /// Work for this goal from now on.
    Goal {
        /// The index of the goal in the list of goals.
        epoch: u16,
    },
    /// The module at this contact is certified dead: its process has been stopped for good, it is not merely
    /// silent.
    Condemn {
        /// The port of the contact.
        port: Port,
        /// The session of the contact.
        session: Session,
        /// The latest goal that it can have worked for.
        epoch: u16,
        /// True if it was finalized in that goal: it stays for good, and so does all that it hangs on.
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

/// The report of a cube to the world-controller when it changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Status {
    /// The goal that it works for.
    pub epoch: u16,
    /// Its role in the growth.
    pub role: Role,
    /// True if it is finalized or has a parent.
    pub attached: bool,
    /// True if it cannot move any more.
    pub immobile: bool,
    /// True if it holds a child that it believes dead, and so cannot leave.
    pub pinned: bool,
    /// True if it knows a route to a target.
    pub attracted: bool,
    /// Faces outside which it wants a cell filled.
    pub wants: u8,
    /// The number of finalized modules that it counts for; at the seed, all of them.
    pub subtree: u32,
    /// How often another module held the cell that it wanted, so that a collision was prevented.
    pub prevented: u32,
    /// The module that it waits for.
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
        out.u32(self.waits_for.map_or(NO_MODULE, |id| id.0));
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
            waits_for: Some(from.u32()?).filter(|id| *id != NO_MODULE).map(ModuleId),
        })
    }
}

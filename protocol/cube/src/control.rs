//! Orders of the world-controller to a cube, and reports of a cube to it.

use super::call::Walk;
use super::epoch::{Epoch, Opening};
use super::message::Role;
use super::steering::Steering;
use core::cmp::Reverse;
use metamorph_core::ids::{ModuleId, Port, Session, Token};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Field, Wire, WireError};
use metamorph_core::{fields, messages};

/// An order of the world-controller to a cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Order {
    /// Work for this goal from now on.
    Goal(Opening),
    /// The module at this contact is certified dead: its process has been stopped permanently, it is not merely
    /// silent.
    Condemn {
        /// The port of the contact.
        port: Port,
        /// The session of the contact.
        session: Session,
        /// The latest epoch that it can have worked in.
        epoch: Epoch,
        /// True if it was finalized in that epoch: it stays permanently, and so does all that it hangs on.
        finalized: bool,
        /// The time after which it did nothing more. It names the death: no two deaths have the same.
        died: Time,
    },
    /// A module has announced that it holds a dead neighbour.
    Custody(CustodyAnnouncement),
    /// A command of an operator to this module. It replaces the command before.
    Steer {
        /// The command.
        steering: Steering,
        /// The end of its lease.
        until: Time,
    },
    /// Walk along this way, and stay at its end, since nothing moves any more. In a closed epoch nothing else moves until the call
    /// ends, and the module asks no other one.
    Call {
        /// The epoch for which this holds.
        epoch: Epoch,
        /// The end of the call.
        until: Time,
        /// The way.
        way: Walk,
    },
    /// Stay, and keep a cell free for a module that is called over a dead one and cannot ask for it itself.
    Carry {
        /// The epoch for which this holds.
        epoch: Epoch,
        /// The module that is called.
        mover: ModuleId,
        /// Identifies the request.
        token: Token,
        /// The face outside which the cell is.
        face: Face,
    },
}

/// "This module holds a dead one, or another of the dead that hang together with it, and does not hang on any of them."
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CustodyAnnouncement {
    /// The cell of the dead module.
    pub dead: Cell,
    /// Its time of death.
    pub died: Time,
    /// The epoch for which this holds.
    pub epoch: Epoch,
    /// The holder's place in the order of holders.
    pub holder: CustodyKey,
}

/// The place of a module in the order of holders; the smallest key is the best holder. Finalized modules come first, since they
/// never leave; then those whose path to the finalized modules was confirmed last, so that a module lets go only for one that
/// has been confirmed later than itself (`custody`). For one dead module see [`CustodyKey::order_for`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct CustodyKey {
    /// False if the module is finalized, or stands in the seed cell.
    pub is_loose: bool,
    /// When its path was confirmed, as it has announced.
    pub confirmed: Reverse<Time>,
    /// Its distance from the seed. Modules near the seed are finalized first.
    pub distance: u32,
    /// Its cell.
    pub cell: Cell,
}

impl CustodyKey {
    /// Returns the place of the module in `cell`, for the goal that grows from `seed`.
    pub fn new(cell: Cell, is_final: bool, confirmed: Time, seed: Cell) -> CustodyKey {
        let is_loose = !(is_final || cell == seed);
        CustodyKey { is_loose, confirmed: Reverse(confirmed), distance: cell.manhattan(seed), cell }
    }
    /// Returns the place in the order of holders of the dead module in a cell; the least is the best. A finalized holder that touches
    /// it comes first. One that holds it over others of the dead is as good as the time at which that was certain: if one of those
    /// in between restarts, it holds the dead module no more.
    pub fn order_for(&self, dead: Cell) -> (bool, Reverse<Time>, CustodyKey) {
        let touches = self.cell.manhattan(dead) == 1;
        (self.is_loose || !touches, self.confirmed, *self)
    }
    /// Returns true if the holder does not hang on a module that died at `died`, by its announcement.
    pub fn is_after(&self, died: Time) -> bool {
        !self.is_loose || self.confirmed.0 > died
    }
}

impl Field for CustodyKey {
    fn put(&self, out: &mut Encoder) {
        out.bool(self.is_loose);
        out.time(self.confirmed.0);
        out.u32(self.distance);
        self.cell.put(out);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<CustodyKey, WireError> {
        let (is_loose, confirmed, distance) = (from.bool("loose")?, Reverse(from.time()?), from.u32()?);
        Ok(CustodyKey { is_loose, confirmed, distance, cell: Cell::take("holder", from)? })
    }
}

fields!(CustodyAnnouncement { dead, died, epoch, holder });

messages!(Order {
    0 => Goal(opening),
    1 => Condemn { port, session, epoch, finalized, died } if port.index() < Face::ALL.len() => "port",
    2 => Custody(announcement),
    3 => Steer { steering, until },
    4 => Call { epoch, until, way },
    5 => Carry { epoch, mover, token, face },
});

/// A report of a cube to the world-controller, sent when one of its fields has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Status {
    /// The epoch that it works in.
    pub epoch: Epoch,
    /// Its role in the growth.
    pub role: Role,
    /// True if it is finalized or has a parent.
    pub attached: bool,
    /// True if it cannot move any more.
    pub immobile: bool,
    /// True if a neighbour that is dead or silent keeps it from ever leaving.
    pub pinned: bool,
    /// True if it knows a route to a target.
    pub attracted: bool,
    /// Faces outside which it wants a cell filled.
    pub wants: u8,
    /// In the seed cell, the number of finalized modules of the goal; zero elsewhere.
    pub subtree: u32,
    /// How often a reservation was denied to it because the cell was occupied or reserved: collisions prevented.
    pub prevented: u32,
    /// The module that it waits for.
    pub waits_for: Option<ModuleId>,
    /// The latest request of the controller that it has granted, until the grant ends ([`Order::Carry`]).
    pub carries: Option<Token>,
    /// For each face, the time of death of a dead neighbour that the module announces to hold; zero if there is
    /// none.
    pub custody: [Time; 6],
    /// When its path was confirmed, for these announcements; zero if there are none.
    pub confirmed: Time,
}

impl Wire for Status {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        self.epoch.put(out);
        out.u8(self.role as u8);
        for flag in [self.attached, self.immobile, self.pinned, self.attracted] {
            out.bool(flag);
        }
        out.u8(self.wants);
        out.u32(self.subtree);
        out.u32(self.prevented);
        self.waits_for.put(out);
        self.carries.put(out);
        let held = Face::ALL.into_iter().filter(|f| self.custody[f.index()] != Time::ZERO);
        out.u8(Face::mask(held.clone()));
        held.for_each(|f| out.time(self.custody[f.index()]));
        out.time(self.confirmed);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Status, WireError> {
        if kind != 0 {
            return Err(WireError::Kind(kind));
        }
        let mut status = Status {
            epoch: Epoch::take("epoch", from)?,
            role: Role::decode(from.u8()?)?,
            attached: from.bool("attached")?,
            immobile: from.bool("immobile")?,
            pinned: from.bool("pinned")?,
            attracted: from.bool("attracted")?,
            wants: from.u8()?,
            subtree: from.u32()?,
            prevented: from.u32()?,
            waits_for: Field::take("waits_for", from)?,
            carries: Field::take("carries", from)?,
            custody: [Time::ZERO; 6],
            confirmed: Time::ZERO,
        };
        let held = from.u8()?;
        if held >= 64 {
            return Err(WireError::Field("custody"));
        }
        for face in Face::in_mask(held) {
            let died = from.time()?;
            if died == Time::ZERO {
                return Err(WireError::Field("died"));
            }
            status.custody[face.index()] = died;
        }
        status.confirmed = from.time()?;
        Ok(status)
    }
}

//! Messages between cubes.

use super::epoch::Epoch;
use super::route::Route;
use core::fmt;
use metamorph_core::coverage::CoveragePoint;
use metamorph_core::ids::{ModuleId, Token};
use metamorph_core::lattice::Face;
use metamorph_core::time::{Span, Time};
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};
use metamorph_core::{codes, fields, messages};

/// The role of a module in the growth of the goal (thesis 4.1.2: wandering, finalized; a module of the
/// initial body that has not been recruited yet is in reserve).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Role {
    /// Part of the initial body.
    Reserve = 0,
    /// Walks over the surface, carried by one support.
    Walker = 1,
    /// Finalized: fills a goal cell permanently.
    Final = 2,
}

impl Role {
    pub(super) fn decode(v: u8) -> Result<Role, WireError> {
        match v {
            0 => Ok(Role::Reserve),
            1 => Ok(Role::Walker),
            2 => Ok(Role::Final),
            _ => Err(WireError::Field("role")),
        }
    }
}

/// A place in the parent forest: when the path to the finalized modules was last confirmed, and how long it is.
/// A module's rank never gets worse while the module stays, and a parent's rank is always better than its child's: so
/// no module is its own ancestor, even if messages are late or modules forget. Sequence numbers do the same for routes
/// in radio networks (RFC 3561, section 6; RFC 8966, section 2.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Rank {
    /// The path over the parents is known to have led to a finalized module at this time or later; zero stands for the
    /// start of the goal.
    pub rooted: Time,
    /// Depth in the forest, 0 if finalized.
    pub label: u16,
}

impl fmt::Display for Rank {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "label {} of {}", self.label, self.rooted)
    }
}

impl Rank {
    /// Returns true if a module of this rank may be the parent of one of rank `other`.
    pub fn is_above(self, other: Rank) -> bool {
        self.rooted > other.rooted || (self.rooted == other.rooted && self.label < other.label)
    }
    /// Returns the rank of a child.
    pub(super) fn below(self) -> Rank {
        Rank { label: self.label.saturating_add(1), ..self }
    }
}

/// Request of a module to a neighbour, made in order to stay connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Claim {
    /// Nothing.
    None,
    /// "Be my parent."
    Want(Token),
    /// "You are my parent": do not leave.
    Parent(Token),
}

/// A value of the attraction field: the distance of the nearest target, and the module and face that announced it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Entry {
    /// The distance of the target: [`Entry::MOVE`] per move, and 1 for each time it was passed on between
    /// modules that touch the same cell; [`Entry::FAR`] if no target is known. Without the additional 1 two
    /// such modules could each believe that the other knows a route.
    pub distance: u16,
    /// Module and face that the target touches, packed as `module·8 + face`.
    pub source: u32,
    /// The source's version; later ones are newer, modulo 2¹⁶.
    pub version: u16,
}

impl Entry {
    /// The distance that stands for "no target known".
    pub const FAR: u16 = u16::MAX;
    /// The distance of one move.
    pub const MOVE: u16 = 16;
    /// The largest distance, in moves.
    pub const MAX_MOVES: u16 = Entry::FAR / Entry::MOVE - 1;
    /// No target known.
    pub const NONE: Entry = Entry { distance: Entry::FAR, source: 0, version: 0 };

    /// Returns the distance in moves.
    pub fn moves(self) -> u16 {
        self.distance / Entry::MOVE
    }
    /// Returns true if a target is known.
    pub fn is_known(self) -> bool {
        self.distance != Entry::FAR
    }
}

/// All that a module tells the neighbour on one face about itself; repeated, so that a lost message costs
/// only time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Beacon {
    /// The sender.
    pub id: ModuleId,
    /// The number of the beacon in its session and direction.
    pub sequence: u32,
    /// The goal that the sender works for.
    pub epoch: Epoch,
    /// The sender's role in the growth.
    pub role: Role,
    /// True if the sender is finalized or has a parent.
    pub attached: bool,
    /// True if the sender cannot move any more.
    pub immobile: bool,
    /// True if the receiver supports the sender, a walker, or made it finalized.
    pub supported_here: bool,
    /// True if the sender wants the receiver's cell filled, permanently.
    pub wants_you: bool,
    /// True if the sender has restarted and grants nothing yet.
    pub quarantined: bool,
    /// True if the sender has heard that a module of the body has died.
    pub knows_of_death: bool,
    /// When the beacon was sent, by the sender's clock: in quarters of a move ([`Beacon::QUARTERS`]), modulo 2¹⁶.
    pub spoken: u16,
    /// The number of hops from the sender to a finalized module, over modules that have restarted and forgotten
    /// their role. Zero if the sender is finalized, or has restarted in the seed; [`Beacon::NO_FINAL`] if it cannot
    /// have been finalized before.
    pub final_hops: u8,
    /// Faces behind which the sender knows live modules that can carry a walker.
    pub supports: u8,
    /// Faces behind which the sender knows finalized modules.
    pub finals: u8,
    /// Faces outside which the sender knows goal cells that are filled permanently: those of [`Beacon::finals`], and
    /// goal cells with a dead module.
    pub filled: u8,
    /// Faces outside which a module is certified dead.
    pub dead: u8,
    /// Those of them whose module needs no holder, since it was finalized or touches a finalized module.
    pub fixed: u8,
    /// The sender's place in the parent forest.
    pub rank: Rank,
    /// The sender asks for the receiver's path to the finalized modules to be confirmed at this time or later
    /// ([`Rank::rooted`]); zero if it has no request.
    pub renew: Time,
    /// The claim of the sender on the receiver.
    pub claim: Claim,
    /// The token of the receiver's claim, if the sender has registered the receiver as a child.
    pub ack: Option<Token>,
    /// Directions in which the sender, a walker, found the corner over the edge of the receiver blocked.
    pub corners: u8,
    /// Directions in which the cell over the sender's edge is taken for now, by a walker or for another module than the receiver.
    /// Told to walkers, which cannot see that cell, and to neighbours that have not been heard.
    pub taken: u8,
    /// The number of finalized modules in the sender's subtree, itself included, if the receiver made the sender
    /// finalized; zero otherwise.
    pub subtree: u32,
    /// Distances for the four headings at right angles to the shared face.
    pub field: [Entry; 4],
}

impl Beacon {
    /// The number of hops in [`Beacon::final_hops`] of a module that cannot have been finalized before.
    pub const NO_FINAL: u8 = u8::MAX;
    /// The number of units of [`Beacon::spoken`] in the duration of a move.
    pub const QUARTERS: u64 = 4;

    /// Returns the first beacon of a module in reserve that is attached and knows of nothing else.
    #[cfg(test)]
    pub(super) fn first(id: ModuleId) -> Beacon {
        Beacon {
            id,
            sequence: 1,
            epoch: Epoch::first(0),
            role: Role::Reserve,
            attached: true,
            immobile: false,
            supported_here: false,
            wants_you: false,
            quarantined: false,
            knows_of_death: false,
            spoken: 0,
            final_hops: Beacon::NO_FINAL,
            supports: 0,
            finals: 0,
            filled: 0,
            dead: 0,
            fixed: 0,
            rank: Rank { rooted: Time::ZERO, label: 3 },
            renew: Time::ZERO,
            claim: Claim::None,
            ack: None,
            corners: 0,
            taken: 0,
            subtree: 0,
            field: [Entry::NONE; 4],
        }
    }

    /// Returns the same beacon as a repetition of another one, with its number and time.
    pub(super) fn repeating(&self, other: &Beacon) -> Beacon {
        Beacon { sequence: other.sequence, spoken: other.spoken, ..*self }
    }
    /// Returns true if another beacon is the same except for the distances, the sequence number and the time.
    pub(super) fn differs_in_field_only(&self, other: &Beacon) -> bool {
        (Beacon { field: self.field, ..other.repeating(self) }) == *self
    }
}

/// Request to the last module of a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Ask {
    /// Stay at its cell.
    Lock,
    /// Stay, and keep the cell outside this face free for the origin.
    Reserve(Face),
}

impl Field for Ask {
    fn put(&self, out: &mut Encoder) {
        match self {
            Ask::Lock => out.u8(0xFF),
            Ask::Reserve(face) => out.face(*face),
        }
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Ask, WireError> {
        match from.u8()? {
            0xFF => Ok(Ask::Lock),
            face => Face::from_index(face).map(Ask::Reserve).ok_or(WireError::Field("ask")),
        }
    }
}

/// Why a request is denied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Denial {
    /// The cell is occupied.
    Occupied = 1,
    /// The cell is reserved for another module.
    Reserved = 2,
    /// A module of the route is moving, or has no room for another lock.
    Busy = 3,
    /// A module of the route wants to leave and has waited longer.
    Younger = 4,
    /// A module of the route is absent or silent, is a walker, or is the one that asks.
    NoSupport = 5,
    /// A module of the route has just restarted.
    Quarantined = 6,
}

impl Denial {
    /// Returns true if granting would have let two modules into one cell.
    pub fn is_collision(self) -> bool {
        matches!(self, Denial::Occupied | Denial::Reserved)
    }
    pub(super) fn coverage_point(self) -> CoveragePoint {
        match self {
            Denial::Occupied => CoveragePoint::CubeDeniedOccupied,
            Denial::Reserved => CoveragePoint::CubeDeniedReserved,
            Denial::Busy => CoveragePoint::CubeDeniedBusy,
            Denial::Younger => CoveragePoint::CubeDeniedYounger,
            Denial::NoSupport => CoveragePoint::CubeDeniedNoSupport,
            Denial::Quarantined => CoveragePoint::CubeDeniedQuarantined,
        }
    }
}

codes!(Denial or none, "denial" { Occupied, Reserved, Busy, Younger, NoSupport, Quarantined });

/// Identifies one request: its origin, the attempt, and the number within it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId {
    /// The module that asks.
    pub origin: ModuleId,
    /// The origin's attempt.
    pub token: Token,
    /// The request within the attempt.
    pub number: u8,
}

fields!(RequestId { origin, token, number });

/// A message between cubes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(clippy::large_enum_variant, reason = "all travel in frames of one size")]
pub enum Message {
    /// The state of the sender.
    Beacon(Beacon),
    /// Asks the modules along a route to stay, and the last one also for what `ask` says.
    Request {
        /// The request.
        id: RequestId,
        /// How long the origin has been waiting to move. Of two modules that want to move, the one that has waited
        /// longer goes first.
        age: Span,
        /// Hops already taken, at least 1.
        hop: u8,
        /// The request to the last module.
        ask: Ask,
        /// The route.
        route: Route,
    },
    /// The answer to a request, passed back along its route.
    Response {
        /// The request.
        id: RequestId,
        /// Hops left to the origin.
        hop: u8,
        /// The reason for a denial; `None` if the request is granted.
        denial: Option<Denial>,
        /// The module in the way, if there is one.
        blocker: Option<ModuleId>,
        /// Directions in which the last module of the route has a neighbour with a module next to the reserved cell.
        co_owners: u8,
        /// The route.
        route: Route,
    },
    /// The attempt is over: all locks granted for it can be dropped.
    Release {
        /// The module that asked.
        origin: ModuleId,
        /// Its attempt.
        token: Token,
    },
    /// Searches for a route around a module that wants to leave.
    Search {
        /// The module that wants to leave, and which of its searches this is.
        id: RequestId,
        /// Hops still allowed.
        ttl: u8,
        /// The faces of the origin with a dead neighbour that must stay connected too.
        dead: u8,
        /// The route so far.
        route: Route,
        /// The number among the messages over this face that are acknowledged.
        number: u16,
    },
    /// A search has reached another neighbour of its origin, a finalized module, or one that touches a dead neighbour of the
    /// origin.
    Found {
        /// The search.
        id: RequestId,
        /// Hops left to the origin.
        hop: u8,
        /// The module, or the dead neighbour, that the search has reached.
        reached: Reached,
        /// The route.
        route: Route,
        /// The number among the messages over this face that are acknowledged.
        number: u16,
    },
    /// Acknowledges a [`Message::Search`] or a [`Message::Found`].
    Heard {
        /// Its number.
        number: u16,
    },
}

/// Module that a search has reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reached {
    /// A finalized module.
    Root,
    /// Another neighbour of the origin, which touches the origin by this face.
    Neighbour(Face),
    /// A module that touches the dead neighbour on this face of the origin.
    Dead(Face),
}

impl Reached {
    /// Code of [`Reached::Root`].
    const ROOT_CODE: u8 = 0xFF;
    /// Mask of the bit that marks [`Reached::Dead`]; the others hold the face.
    const DEAD_MASK: u8 = 0x10;
}

impl Field for Reached {
    fn put(&self, out: &mut Encoder) {
        out.u8(match self {
            Reached::Root => Reached::ROOT_CODE,
            Reached::Neighbour(face) => *face as u8,
            Reached::Dead(face) => Reached::DEAD_MASK | *face as u8,
        });
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Reached, WireError> {
        let face = |index| Face::from_index(index).ok_or(WireError::Field("reached"));
        match from.u8()? {
            Reached::ROOT_CODE => Ok(Reached::Root),
            byte if byte & Reached::DEAD_MASK != 0 => face(byte & !Reached::DEAD_MASK).map(Reached::Dead),
            byte => face(byte).map(Reached::Neighbour),
        }
    }
}

/// Reads a set of faces: one bit for each of the six.
fn face_mask(bits: u8) -> Result<u8, WireError> {
    if bits < 64 { Ok(bits) } else { Err(WireError::Field("face mask")) }
}

impl Field for Beacon {
    fn put(&self, out: &mut Encoder) {
        let b = self;
        out.u32(b.id.0);
        out.u32(b.sequence);
        b.epoch.put(out);
        let flags = [b.attached, b.immobile, b.supported_here, b.wants_you, b.quarantined, b.knows_of_death];
        let bits = flags.iter().rev().fold(0u8, |bits, f| bits << 1 | u8::from(*f));
        out.u8(bits << 2 | b.role as u8);
        out.u8(b.supports);
        out.u8(b.finals);
        out.u8(b.filled);
        out.u8(b.dead);
        out.u8(b.fixed);
        out.u16(b.spoken);
        out.u16(b.rank.label);
        out.u64(b.rank.rooted.0);
        out.u64(b.renew.0);
        out.u8(b.final_hops);
        let (claim, token) = match b.claim {
            Claim::None => (0, 0),
            Claim::Want(t) => (1, t.0),
            Claim::Parent(t) => (2, t.0),
        };
        out.u8(claim);
        out.u32(token);
        out.bool(b.ack.is_some());
        out.u32(b.ack.map_or(0, |t| t.0));
        out.u8(b.corners);
        out.u8(b.taken);
        out.u32(b.subtree);
        for e in b.field {
            out.u16(e.distance);
            out.u32(e.source);
            out.u16(e.version);
        }
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Beacon, WireError> {
        let (id, sequence, epoch) = (ModuleId(from.u32()?), from.u32()?, Epoch::take("epoch", from)?);
        let bits = from.u8()?;
        let flag = |i: u8| bits >> (2 + i) & 1 == 1;
        let (supports, finals) = (face_mask(from.u8()?)?, face_mask(from.u8()?)?);
        let filled = face_mask(from.u8()?)?;
        let (dead, fixed, spoken) = (face_mask(from.u8()?)?, face_mask(from.u8()?)?, from.u16()?);
        let (label, rooted, renew) = (from.u16()?, Time(from.u64()?), Time(from.u64()?));
        let final_hops = from.u8()?;
        let claim = match (from.u8()?, Token(from.u32()?)) {
            (0, Token(0)) => Claim::None,
            (1, t) => Claim::Want(t),
            (2, t) => Claim::Parent(t),
            _ => return Err(WireError::Field("claim")),
        };
        let (acked, token) = (from.bool("ack")?, Token(from.u32()?));
        if !acked && token != Token(0) {
            return Err(WireError::Field("ack"));
        }
        let (corners, taken, subtree) = (face_mask(from.u8()?)?, face_mask(from.u8()?)?, from.u32()?);
        let mut field = [Entry::NONE; 4];
        for e in &mut field {
            *e = Entry { distance: from.u16()?, source: from.u32()?, version: from.u16()? };
        }
        Ok(Beacon {
            id,
            sequence,
            epoch,
            role: Role::decode(bits & 3)?,
            attached: flag(0),
            immobile: flag(1),
            supported_here: flag(2),
            wants_you: flag(3),
            quarantined: flag(4),
            knows_of_death: flag(5),
            spoken,
            final_hops,
            supports,
            finals,
            filled,
            dead,
            fixed,
            rank: Rank { rooted, label },
            renew,
            claim,
            ack: acked.then_some(token),
            corners,
            taken,
            subtree,
            field,
        })
    }
}

/// Returns whether a hop is one of a route's.
fn is_inside(hop: u8, route: &Route, least: u8) -> bool {
    hop >= least && usize::from(hop) <= route.hop_count()
}

messages!(Message {
    0 => Beacon(beacon),
    1 => Request { id, age, hop, ask, route } if is_inside(hop, &route, 1) => "hop",
    2 => Response { id, hop, denial, blocker, co_owners, route }
        if co_owners < 64 => "face mask"
        if is_inside(hop, &route, 0) => "hop",
    3 => Release { origin, token },
    4 => Search { id, ttl, dead, route, number } if dead < 64 => "dead",
    5 => Found { id, hop, reached, route, number } if is_inside(hop, &route, 0) => "hop",
    6 => Heard { number },
}
    fn wire_len(&self) -> usize {
        // Fixed layouts; a test compares them with what `encode` writes.
        metamorph_core::wire::HEADER
            + match self {
                Message::Beacon(_) => 85,
                Message::Request { .. } => 30,
                Message::Response { .. } => 27,
                Message::Release { .. } => 8,
                Message::Search { .. } => 24,
                Message::Found { .. } => 24,
                Message::Heard { .. } => 2,
            }
    }
);

#[cfg(test)]
mod tests;

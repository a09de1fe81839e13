//! What metamodules say to each other, to their bodies and to the world-controller.

use super::blueprint::SeedSet;
use super::motions::Sweep;
use super::pose::Pose;
use crate::ids::{ModuleId, Token};
use crate::time::{Span, Time};
use crate::wire::{Decoder, Encoder, Wire, WireError};

/// Where a metamodule is and what it knows; repeated, so that losing one costs only time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct State {
    /// The sender.
    pub id: ModuleId,
    /// Grows with every state that a life of the sender tells; later ones count.
    pub sequence: u32,
    /// Where it is.
    pub pose: Pose,
    /// It fills a seed and stays.
    pub settled: bool,
    /// The seeds it knows to be filled.
    pub filled: SeedSet,
}

/// Why a lock is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Denial {
    /// The one that is asked stands in the way.
    Occupied = 1,
    /// It is moving through.
    Held = 2,
    /// It wants to move through, and has waited longer.
    Younger = 3,
    /// It has just restarted and does not know what it has granted.
    Quarantined = 4,
}

impl Denial {
    /// Whether granting would have led two bodies into one space.
    pub const fn is_collision(self) -> bool {
        matches!(self, Denial::Occupied | Denial::Held | Denial::Younger)
    }
    fn decode(v: u8) -> Result<Option<Denial>, WireError> {
        Ok(Some(match v {
            0 => return Ok(None),
            1 => Denial::Occupied,
            2 => Denial::Held,
            3 => Denial::Younger,
            4 => Denial::Quarantined,
            _ => return Err(WireError::Field("denial")),
        }))
    }
}

/// What metamodules say to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Message {
    /// Where the sender is.
    State(State),
    /// Asks to keep out of all cells of a move, and to grant them to nobody else.
    Request {
        /// Who asks.
        origin: ModuleId,
        /// Its attempt.
        token: Token,
        /// For how long the origin has been waiting; the longer wins.
        age: Span,
        /// Where it stands.
        pose: Pose,
        /// All cells of the move, seen from there.
        sweep: Sweep,
    },
    /// The answer.
    Response {
        /// Who answers.
        from: ModuleId,
        /// The attempt it is about.
        token: Token,
        /// Why not; nothing if granted.
        denial: Option<Denial>,
    },
    /// The sender needs the lock of an attempt, and of all before, no more.
    Release {
        /// Who asked.
        origin: ModuleId,
        /// Its attempt.
        token: Token,
    },
}

fn pose(out: &mut Encoder, p: Pose) {
    p.encode(out);
}

fn wide(out: &mut Encoder, v: u128) {
    out.u64(v as u64);
    out.u64((v >> 64) as u64);
}

impl Wire for Message {
    fn kind(&self) -> u8 {
        match self {
            Message::State(_) => 16,
            Message::Request { .. } => 17,
            Message::Response { .. } => 18,
            Message::Release { .. } => 19,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match *self {
            Message::State(s) => {
                out.u32(s.id.0);
                out.u32(s.sequence);
                pose(out, s.pose);
                out.bool(s.settled);
                out.u32(s.filled.0);
            }
            Message::Request { origin, token, age, pose: p, sweep } => {
                out.u32(origin.0);
                out.u32(token.0);
                out.u64(age.0);
                pose(out, p);
                wide(out, sweep.0);
            }
            Message::Response { from, token, denial } => {
                out.u32(from.0);
                out.u32(token.0);
                out.u8(denial.map_or(0, |d| d as u8));
            }
            Message::Release { origin, token } => {
                out.u32(origin.0);
                out.u32(token.0);
            }
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Message, WireError> {
        Ok(match kind {
            16 => Message::State(State {
                id: ModuleId(from.u32()?),
                sequence: from.u32()?,
                pose: Pose::decode(from)?,
                settled: from.bool("settled")?,
                filled: SeedSet(from.u32()?),
            }),
            17 => Message::Request {
                origin: ModuleId(from.u32()?),
                token: Token(from.u32()?),
                age: Span(from.u64()?),
                pose: Pose::decode(from)?,
                sweep: Sweep(u128::from(from.u64()?) | u128::from(from.u64()?) << 64),
            },
            18 => Message::Response {
                from: ModuleId(from.u32()?),
                token: Token(from.u32()?),
                denial: Denial::decode(from.u8()?)?,
            },
            19 => Message::Release { origin: ModuleId(from.u32()?), token: Token(from.u32()?) },
            _ => return Err(WireError::Kind(kind)),
        })
    }
}

/// What a body does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Deed {
    /// One joint turns by one step, given by its number in the motion database.
    Turn(u16),
    /// The free end, which lies on a connector, grips it.
    Attach,
    /// The end that has been attached for longer lets go; the other one holds from now on.
    Detach,
}

/// Asks the body to do something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Action {
    /// What.
    pub deed: Deed,
    /// The body refuses to begin after this time.
    pub not_after: Time,
}

impl Wire for Action {
    fn kind(&self) -> u8 {
        match self.deed {
            Deed::Turn(_) => 16,
            Deed::Attach => 17,
            Deed::Detach => 18,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        out.time(self.not_after);
        if let Deed::Turn(step) = self.deed {
            out.u16(step);
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Action, WireError> {
        let not_after = from.time()?;
        let deed = match kind {
            16 => Deed::Turn(from.u16()?),
            17 => Deed::Attach,
            18 => Deed::Detach,
            _ => return Err(WireError::Kind(kind)),
        };
        Ok(Action { deed, not_after })
    }
}

/// Why a body does not begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Refusal {
    /// Something is in the way.
    Blocked = 0,
    /// It is too late.
    Late = 1,
    /// The neighbourhood has changed.
    Stale = 2,
    /// It is acting already.
    Busy = 3,
    /// The body cannot do that from where it is.
    Impossible = 4,
}

/// How an action went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Percept {
    /// It is done, and this is where the body is now.
    Done(Pose),
    /// It failed; the body is where it was.
    Failed,
    /// It was not begun.
    Refused(Refusal),
}

impl Wire for Percept {
    fn kind(&self) -> u8 {
        match self {
            Percept::Done(_) => 16,
            Percept::Failed => 17,
            Percept::Refused(_) => 18,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            Percept::Done(p) => pose(out, *p),
            Percept::Failed => {}
            Percept::Refused(why) => out.u8(*why as u8),
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Percept, WireError> {
        Ok(match kind {
            16 => Percept::Done(Pose::decode(from)?),
            17 => Percept::Failed,
            18 => Percept::Refused(match from.u8()? {
                0 => Refusal::Blocked,
                1 => Refusal::Late,
                2 => Refusal::Stale,
                3 => Refusal::Busy,
                4 => Refusal::Impossible,
                _ => return Err(WireError::Field("refusal")),
            }),
            _ => return Err(WireError::Kind(kind)),
        })
    }
}

/// What the world-controller tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Order {
    /// These seeds attract, those are filled. Sets of filled seeds only grow, so the larger is later.
    Seeds {
        /// What attracts.
        open: SeedSet,
        /// What is filled.
        filled: SeedSet,
    },
    /// The process of a metamodule is gone and cannot come back in its present sessions; its body
    /// stays here as an obstacle.
    Dead {
        /// Whose.
        id: ModuleId,
        /// Where the body is.
        pose: Pose,
    },
}

impl Wire for Order {
    fn kind(&self) -> u8 {
        match self {
            Order::Seeds { .. } => 16,
            Order::Dead { .. } => 17,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            Order::Seeds { open, filled } => {
                out.u32(open.0);
                out.u32(filled.0);
            }
            Order::Dead { id, pose: p } => {
                out.u32(id.0);
                pose(out, *p);
            }
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Order, WireError> {
        Ok(match kind {
            16 => Order::Seeds { open: SeedSet(from.u32()?), filled: SeedSet(from.u32()?) },
            17 => Order::Dead { id: ModuleId(from.u32()?), pose: Pose::decode(from)? },
            _ => return Err(WireError::Kind(kind)),
        })
    }
}

/// What a metamodule tells the world-controller whenever it changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Status {
    /// Where it believes to be.
    pub pose: Pose,
    /// The seed it fills.
    pub settled: Option<u8>,
    /// Locks refused because two would have met.
    pub prevented: u32,
    /// Who refused last, while it waits.
    pub waits_for: Option<ModuleId>,
}

impl Wire for Status {
    fn kind(&self) -> u8 {
        16
    }
    fn encode(&self, out: &mut Encoder) {
        pose(out, self.pose);
        out.u8(self.settled.unwrap_or(u8::MAX));
        out.u32(self.prevented);
        out.u32(self.waits_for.map_or(u32::MAX, |id| id.0));
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Status, WireError> {
        if kind != 16 {
            return Err(WireError::Kind(kind));
        }
        let pose = Pose::decode(from)?;
        let settled = match from.u8()? {
            u8::MAX => None,
            s if s < 32 => Some(s),
            _ => return Err(WireError::Field("settled")),
        };
        let prevented = from.u32()?;
        let waits_for = Some(from.u32()?).filter(|id| *id != u32::MAX).map(ModuleId);
        Ok(Status { pose, settled, prevented, waits_for })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::Class;
    use crate::ids::{Incarnation, Port};
    use crate::metamodule::pose::End;
    use crate::roombots::grid::GridState;
    use crate::wire::{Channel, Frame, HEADER, Header};
    use proptest::prelude::*;

    fn header(kind: u8) -> Header {
        Header {
            channel: Channel::Peer,
            kind,
            class: Class::Negotiation,
            port: Port(1),
            incarnation: Incarnation(0),
            source: ModuleId(1),
            destination: ModuleId(2),
            session: 3,
            sequence: 4,
        }
    }

    fn a_pose() -> Pose {
        Pose { state: GridState::new(-2, 5, 3), end: End::Head, both: true, posture: 0x0102 }
    }

    fn round_trip<W: Wire>(message: &W) {
        let frame = Frame::seal(header(message.kind()), message);
        frame.open().unwrap();
        assert_eq!(&frame.message::<W>().unwrap(), message);
    }

    #[test]
    fn everything_survives_the_wire() {
        let p = a_pose();
        let filled = SeedSet(0x8000_0001);
        round_trip(&p);
        round_trip(&Message::State(State { id: ModuleId(3), sequence: 9, pose: p, settled: true, filled }));
        let (origin, token, sweep) = (ModuleId(7), Token(8), Sweep(1 << 127 | 5));
        round_trip(&Message::Request { origin, token, age: Span(u64::MAX), pose: p, sweep });
        for d in 0..5 {
            let denial = Denial::decode(d).unwrap();
            round_trip(&Message::Response { from: origin, token, denial });
        }
        round_trip(&Message::Release { origin, token });
        for deed in [Deed::Turn(4031), Deed::Attach, Deed::Detach] {
            round_trip(&Action { deed, not_after: Time(77) });
        }
        use Refusal::{Blocked, Busy, Impossible, Late, Stale};
        for why in [Blocked, Late, Stale, Busy, Impossible] {
            round_trip(&Percept::Refused(why));
        }
        round_trip(&Percept::Done(p));
        round_trip(&Percept::Failed);
        round_trip(&Order::Seeds { open: SeedSet(6), filled });
        round_trip(&Order::Dead { id: origin, pose: p });
        for settled in [None, Some(31)] {
            round_trip(&Status { pose: p, settled, prevented: 3, waits_for: settled.map(|_| origin) });
        }
    }

    /// The layout is part of the format: these bytes change only together with its version.
    #[test]
    fn golden_request() {
        let message = Message::Request {
            origin: ModuleId(7),
            token: Token(0x0A0B),
            age: Span(9),
            pose: a_pose(),
            sweep: Sweep(0x0102 | 0x03 << 120),
        };
        let bytes = Frame::seal(header(17), &message).to_bytes();
        assert_eq!(
            &bytes[HEADER..HEADER + 40],
            &[
                7, 0, 0, 0, 0x0B, 0x0A, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 0xFE, 0xFF, 5, 0, 15, 0, 2, 1, 2, 1, 0,
                0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3
            ]
        );
        assert_eq!(message.wire_len(), HEADER + 40);
    }

    #[test]
    fn golden_state() {
        let state = State { id: ModuleId(1), sequence: 2, pose: a_pose(), settled: true, filled: SeedSet(3) };
        let bytes = Frame::seal(header(16), &Message::State(state)).to_bytes();
        assert_eq!(
            &bytes[HEADER..HEADER + 21],
            &[1, 0, 0, 0, 2, 0, 0, 0, 0xFE, 0xFF, 5, 0, 15, 0, 2, 1, 1, 3, 0, 0, 0]
        );
    }

    proptest! {
        /// Whatever lies in shared memory is either refused or a message that encodes to the same.
        #[test]
        fn no_bytes_make_the_reader_panic(kind in 14u8..22, bytes in proptest::array::uniform32(any::<u8>())) {
            let mut cells = [0u8; Frame::SIZE];
            cells[HEADER..HEADER + 32].copy_from_slice(&bytes);
            for length in 0..=32u8 {
                cells[5] = length;
                cells[2] = kind;
                let frame = Frame::from_bytes(&cells);
                if let Ok(message) = frame.message::<Message>() {
                    prop_assert_eq!(message.wire_len(), HEADER + usize::from(length));
                }
                let _ = (frame.message::<Action>(), frame.message::<Percept>());
                let _ = (frame.message::<Order>(), frame.message::<Status>(), frame.message::<Pose>());
            }
        }
    }
}

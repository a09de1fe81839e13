//! What metamodules say to each other, to their bodies and to the world-controller.

use super::blueprint::{MAX_SEEDS, SeedSet, Task};
use super::motions::Sweep;
use super::pose::Pose;
use crate::coverage::Mark;
use crate::ids::{ModuleId, Token};
use crate::lattice::Cell;
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
    /// Its joints do not turn.
    pub stuck: bool,
    /// It has no way out of a more important way now.
    pub cornered: bool,
    /// What it builds.
    pub task: Task,
    /// The seeds of it that it knows to be filled.
    pub filled: SeedSet,
    /// The seed it is on its way to, and how far that was when it set out.
    pub claim: Option<Claim>,
    /// Seeds that it has no way to.
    pub barred: SeedSet,
}

/// A seed that a metamodule has made its own (`negotiated` only).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Claim {
    /// Which.
    pub seed: u8,
    /// Strides to it when it was claimed; of two that claim one seed the nearer keeps it.
    pub cost: u8,
}

/// Who goes first (`negotiated` only): smaller is more important. The rank of a claim is the place of
/// its seed in the order of seeds; whoever makes way for a rank has the next one below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Rank(pub u16);

impl Rank {
    /// Of whoever is about nothing.
    pub const NONE: Rank = Rank(u16::MAX);
    const DEPTHS: u16 = 16;

    /// Of whoever is on the way to a seed.
    pub const fn of_seed(seed: u8) -> Rank {
        Rank(seed as u16 * Rank::DEPTHS)
    }
    /// Of whoever makes way for this rank.
    pub const fn below(self) -> Rank {
        match self.0 % Rank::DEPTHS {
            Rank::LAST => self,
            _ => Rank(self.0 + 1),
        }
    }
    const LAST: u16 = Rank::DEPTHS - 1;
}

/// The most legs of a way that one message tells.
pub const LEGS: usize = 4;

/// One leg of a way: a turn to a posture that lands, or the last one to a posture that does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Leg {
    /// The posture at its end, seen from the end that is attached on the way to it.
    pub posture: u16,
    /// All cells of it.
    pub sweep: Sweep,
}

/// Where the sender means to go; whoever is less important keeps out of it. Empty when it is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Way {
    /// The sender.
    pub id: ModuleId,
    /// Of the same count as the sender's states.
    pub sequence: u32,
    /// How important it is.
    pub rank: Rank,
    /// Where it begins.
    pub from: Pose,
    /// The next legs of it, as many as there is room for.
    pub legs: [Leg; LEGS],
    /// How many of them there are.
    pub count: u8,
}

impl Way {
    /// The legs.
    pub fn legs(&self) -> &[Leg] {
        &self.legs[..usize::from(self.count).min(LEGS)]
    }
}

/// What whoever leads says next, while nobody gets on by itself (`negotiated` only).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Call {
    /// The sender; of two who lead, the one with the smaller number is heeded.
    pub leader: ModuleId,
    /// Of the same count as the sender's states.
    pub sequence: u32,
    /// What is to be done.
    pub bid: Bid,
}

/// What is to be done by all who hear it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Bid {
    /// Nobody leads any more.
    Over,
    /// All stay where they are.
    Stay,
    /// All stay but one.
    Move {
        /// Who does not.
        who: ModuleId,
        /// Where it stands.
        from: Pose,
        /// The posture to turn to.
        posture: u16,
        /// Whether it lands then.
        lands: bool,
    },
}

impl Bid {
    fn encode(self, out: &mut Encoder) {
        match self {
            Bid::Over => out.u8(0),
            Bid::Stay => out.u8(1),
            Bid::Move { who, from, posture, lands } => {
                out.u8(2);
                out.u32(who.0);
                pose(out, from);
                out.u16(posture);
                out.bool(lands);
            }
        }
    }
    fn decode(from: &mut Decoder<'_>) -> Result<Bid, WireError> {
        Ok(match from.u8()? {
            0 => Bid::Over,
            1 => Bid::Stay,
            2 => Bid::Move {
                who: ModuleId(from.u32()?),
                from: Pose::decode(from)?,
                posture: from.u16()?,
                lands: from.bool("lands")?,
            },
            _ => return Err(WireError::Field("bid")),
        })
    }
}

/// Of a wave that finds out whether anybody can go on (see `detector`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Probe {
    /// Who wants to know.
    pub initiator: ModuleId,
    /// The number of the wave among those of the initiator.
    pub wave: u32,
    /// Of the latest state that the sender has told.
    pub sequence: u32,
    /// The answer; nothing if it is the question.
    pub answer: Option<Counted>,
}

/// What a wave has counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Counted {
    /// Metamodules that do nothing until they hear something new.
    pub metamodules: u16,
    /// How often they all have stirred.
    pub stirs: u32,
}

impl Counted {
    /// Both together.
    pub const fn and(self, other: Counted) -> Counted {
        Counted {
            metamodules: self.metamodules.saturating_add(other.metamodules),
            stirs: self.stirs.wrapping_add(other.stirs),
        }
    }
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
    pub(super) fn mark(self) -> Mark {
        match self {
            Denial::Occupied => Mark::MetaDeniedOccupied,
            Denial::Held => Mark::MetaDeniedHeld,
            Denial::Younger => Mark::MetaDeniedYounger,
            Denial::Quarantined => Mark::MetaDeniedQuarantined,
        }
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
    /// Where it means to go.
    Way(Way),
    /// What all in hearing are to do.
    Call(Call),
    /// Asks whether anybody can go on, or answers that nobody it has asked can.
    Probe(Probe),
    /// Asks to keep out of all cells of a move, and to grant them to nobody else.
    Request {
        /// Who asks.
        origin: ModuleId,
        /// Its attempt.
        token: Token,
        /// How important its move is.
        rank: Rank,
        /// For how long the origin has been waiting; of equally important ones the longer wins.
        age: Span,
        /// Where it stands.
        pose: Pose,
        /// All cells of the move, seen from there.
        sweep: Sweep,
        /// The posture at its end.
        ends: u16,
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
        /// Where it has got to.
        pose: Pose,
    },
}

fn pose(out: &mut Encoder, p: Pose) {
    p.encode(out);
}

fn wide(out: &mut Encoder, v: u128) {
    out.u64(v as u64);
    out.u64((v >> 64) as u64);
}

fn sweep(from: &mut Decoder<'_>) -> Result<Sweep, WireError> {
    Ok(Sweep(u128::from(from.u64()?) | u128::from(from.u64()?) << 64))
}

impl Wire for Message {
    fn kind(&self) -> u8 {
        match self {
            Message::State(_) => 16,
            Message::Request { .. } => 17,
            Message::Response { .. } => 18,
            Message::Release { .. } => 19,
            Message::Way(_) => 20,
            Message::Probe(_) => 21,
            Message::Call(_) => 22,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match *self {
            Message::State(s) => {
                out.u32(s.id.0);
                out.u32(s.sequence);
                pose(out, s.pose);
                out.u8(u8::from(s.settled) | u8::from(s.stuck) << 1 | u8::from(s.cornered) << 2);
                s.task.encode(out);
                out.u32(s.filled.0);
                out.u8(s.claim.map_or(u8::MAX, |c| c.seed));
                out.u8(s.claim.map_or(0, |c| c.cost));
                out.u32(s.barred.0);
            }
            Message::Way(w) => {
                out.u32(w.id.0);
                out.u32(w.sequence);
                out.u16(w.rank.0);
                pose(out, w.from);
                out.u8(w.legs().len() as u8);
                for leg in w.legs() {
                    out.u16(leg.posture);
                    wide(out, leg.sweep.0);
                }
            }
            Message::Probe(p) => {
                out.u32(p.initiator.0);
                out.u32(p.wave);
                out.u32(p.sequence);
                out.bool(p.answer.is_some());
                let counted = p.answer.unwrap_or_default();
                out.u16(counted.metamodules);
                out.u32(counted.stirs);
            }
            Message::Call(c) => {
                out.u32(c.leader.0);
                out.u32(c.sequence);
                c.bid.encode(out);
            }
            Message::Request { origin, token, rank, age, pose: p, sweep, ends } => {
                out.u32(origin.0);
                out.u32(token.0);
                out.u16(rank.0);
                out.u64(age.0);
                pose(out, p);
                wide(out, sweep.0);
                out.u16(ends);
            }
            Message::Response { from, token, denial } => {
                out.u32(from.0);
                out.u32(token.0);
                out.u8(denial.map_or(0, |d| d as u8));
            }
            Message::Release { origin, token, pose: p } => {
                out.u32(origin.0);
                out.u32(token.0);
                pose(out, p);
            }
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Message, WireError> {
        Ok(match kind {
            16 => {
                let (id, sequence) = (ModuleId(from.u32()?), from.u32()?);
                let pose = Pose::decode(from)?;
                let flags = from.u8()?;
                if flags > 7 {
                    return Err(WireError::Field("flags"));
                }
                let (task, filled) = (Task::decode(from)?, SeedSet(from.u32()?));
                let claim = match (from.u8()?, from.u8()?) {
                    (u8::MAX, 0) => None,
                    (seed, cost) if usize::from(seed) < MAX_SEEDS => Some(Claim { seed, cost }),
                    _ => return Err(WireError::Field("claim")),
                };
                let [settled, stuck, cornered] = [1, 2, 4].map(|flag| flags & flag != 0);
                let barred = SeedSet(from.u32()?);
                Message::State(State {
                    id,
                    sequence,
                    pose,
                    settled,
                    stuck,
                    cornered,
                    task,
                    filled,
                    claim,
                    barred,
                })
            }
            17 => Message::Request {
                origin: ModuleId(from.u32()?),
                token: Token(from.u32()?),
                rank: Rank(from.u16()?),
                age: Span(from.u64()?),
                pose: Pose::decode(from)?,
                sweep: sweep(from)?,
                ends: from.u16()?,
            },
            20 => {
                let (id, sequence, rank) = (ModuleId(from.u32()?), from.u32()?, Rank(from.u16()?));
                let begins = Pose::decode(from)?;
                let (count, mut legs) = (from.u8()?, [Leg::default(); LEGS]);
                let told = legs.get_mut(..usize::from(count)).ok_or(WireError::Field("legs"))?;
                for leg in told {
                    *leg = Leg { posture: from.u16()?, sweep: sweep(from)? };
                }
                Message::Way(Way { id, sequence, rank, from: begins, legs, count })
            }
            21 => {
                let (initiator, wave, sequence) = (ModuleId(from.u32()?), from.u32()?, from.u32()?);
                let answers = from.bool("answer")?;
                let counted = Counted { metamodules: from.u16()?, stirs: from.u32()? };
                if !answers && counted != Counted::default() {
                    return Err(WireError::Field("counted"));
                }
                Message::Probe(Probe { initiator, wave, sequence, answer: answers.then_some(counted) })
            }
            22 => Message::Call(Call {
                leader: ModuleId(from.u32()?),
                sequence: from.u32()?,
                bid: Bid::decode(from)?,
            }),
            18 => Message::Response {
                from: ModuleId(from.u32()?),
                token: Token(from.u32()?),
                denial: Denial::decode(from.u8()?)?,
            },
            19 => Message::Release {
                origin: ModuleId(from.u32()?),
                token: Token(from.u32()?),
                pose: Pose::decode(from)?,
            },
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
    /// This is to be built; these seeds of it attract, those are filled. Sets of filled seeds only grow
    /// while the task is the same, so the larger is later.
    Seeds {
        /// What is to be built.
        task: Task,
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
    /// A metamodule that was dead has a process again.
    Alive {
        /// Whose.
        id: ModuleId,
    },
    /// Something foreign is in a cell, or is there no more.
    Obstacle {
        /// Where.
        cell: Cell,
        /// Whether it is there.
        there: bool,
    },
}

impl Wire for Order {
    fn kind(&self) -> u8 {
        match self {
            Order::Seeds { .. } => 16,
            Order::Dead { .. } => 17,
            Order::Obstacle { .. } => 18,
            Order::Alive { .. } => 19,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            Order::Seeds { task, open, filled } => {
                task.encode(out);
                out.u32(open.0);
                out.u32(filled.0);
            }
            Order::Dead { id, pose: p } => {
                out.u32(id.0);
                pose(out, *p);
            }
            Order::Alive { id } => out.u32(id.0),
            Order::Obstacle { cell, there } => {
                out.cell(*cell);
                out.bool(*there);
            }
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Order, WireError> {
        Ok(match kind {
            16 => Order::Seeds {
                task: Task::decode(from)?,
                open: SeedSet(from.u32()?),
                filled: SeedSet(from.u32()?),
            },
            18 => Order::Obstacle { cell: from.cell()?, there: from.bool("there")? },
            17 => Order::Dead { id: ModuleId(from.u32()?), pose: Pose::decode(from)? },
            19 => Order::Alive { id: ModuleId(from.u32()?) },
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
    /// Seeds that it has no way to.
    pub barred: SeedSet,
    /// It has found out that nobody can go on.
    pub deadlocked: bool,
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
        out.u32(self.barred.0);
        out.bool(self.deadlocked);
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
        let barred = SeedSet(from.u32()?);
        let deadlocked = from.bool("deadlocked")?;
        Ok(Status { pose, settled, prevented, waits_for, barred, deadlocked })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::counters::Class;
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

    fn a_task() -> Task {
        Task { epoch: 2, goal: 1, shift: (-3, 4) }
    }

    fn a_state() -> State {
        State {
            id: ModuleId(1),
            sequence: 2,
            pose: a_pose(),
            settled: true,
            stuck: false,
            cornered: true,
            task: a_task(),
            filled: SeedSet(3),
            claim: None,
            barred: SeedSet(4),
        }
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
        for claim in [None, Some(Claim { seed: 31, cost: 7 })] {
            round_trip(&Message::State(State { claim, ..a_state() }));
        }
        let leg = Leg { posture: 77, sweep: Sweep(3 << 90) };
        for count in 0..=LEGS as u8 {
            let mut legs = [Leg::default(); LEGS];
            legs[..usize::from(count)].fill(leg);
            let (id, rank) = (ModuleId(3), Rank::of_seed(31).below());
            round_trip(&Message::Way(Way { id, sequence: 9, rank, from: p, legs, count }));
        }
        for lands in [false, true] {
            let bid = Bid::Move { who: ModuleId(5), from: p, posture: 0x0304, lands };
            for bid in [Bid::Over, Bid::Stay, bid] {
                round_trip(&Message::Call(Call { leader: ModuleId(4), sequence: 9, bid }));
            }
        }
        let rank = Rank::NONE;
        let (origin, token, sweep) = (ModuleId(7), Token(8), Sweep(1 << 127 | 5));
        round_trip(&Message::Request { origin, token, rank, age: Span(u64::MAX), pose: p, sweep, ends: 7 });
        for d in 0..5 {
            let denial = Denial::decode(d).unwrap();
            round_trip(&Message::Response { from: origin, token, denial });
        }
        round_trip(&Message::Release { origin, token, pose: p });
        for deed in [Deed::Turn(4031), Deed::Attach, Deed::Detach] {
            round_trip(&Action { deed, not_after: Time(77) });
        }
        use Refusal::{Blocked, Busy, Impossible, Late, Stale};
        for why in [Blocked, Late, Stale, Busy, Impossible] {
            round_trip(&Percept::Refused(why));
        }
        round_trip(&Percept::Done(p));
        round_trip(&Percept::Failed);
        round_trip(&Order::Seeds { task: a_task(), open: SeedSet(6), filled });
        round_trip(&Order::Obstacle { cell: Cell::new(-3, 4, 1), there: true });
        round_trip(&Order::Dead { id: origin, pose: p });
        round_trip(&Order::Alive { id: origin });
        for settled in [None, Some(31)] {
            round_trip(&Status {
                pose: p,
                settled,
                prevented: 3,
                waits_for: settled.map(|_| origin),
                barred: filled,
                deadlocked: settled.is_some(),
            });
            let answer = settled.map(|s| Counted { metamodules: s.into(), stirs: u32::MAX });
            round_trip(&Message::Probe(Probe { initiator: origin, wave: 5, sequence: 6, answer }));
        }
    }

    /// The layout is part of the format: these bytes change only together with its version.
    #[test]
    fn golden_request() {
        let message = Message::Request {
            origin: ModuleId(7),
            token: Token(0x0A0B),
            rank: Rank(0x0304),
            age: Span(9),
            pose: a_pose(),
            sweep: Sweep(0x0102 | 0x03 << 120),
            ends: 0x0506,
        };
        let bytes = Frame::seal(header(17), &message).to_bytes();
        assert_eq!(
            &bytes[HEADER..HEADER + 44],
            &[
                7, 0, 0, 0, 0x0B, 0x0A, 0, 0, 4, 3, 9, 0, 0, 0, 0, 0, 0, 0, 0xFE, 0xFF, 5, 0, 15, 0, 2, 1, 2,
                1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3, 6, 5
            ]
        );
        assert_eq!(message.wire_len(), HEADER + 44);
    }

    #[test]
    fn golden_state() {
        let bytes = Frame::seal(header(16), &Message::State(a_state())).to_bytes();
        assert_eq!(
            &bytes[HEADER..HEADER + 34],
            &[
                1, 0, 0, 0, 2, 0, 0, 0, 0xFE, 0xFF, 5, 0, 15, 0, 2, 1, 5, 2, 0, 1, 0xFD, 0xFF, 4, 0, 3, 0, 0,
                0, 255, 0, 4, 0, 0, 0
            ]
        );
    }

    proptest! {
        /// Whatever lies in shared memory is either refused or a message that encodes to the same.
        #[test]
        fn no_bytes_make_the_reader_panic(kind in 14u8..24, bytes in proptest::array::uniform32(any::<u8>())) {
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

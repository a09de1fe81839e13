//! The messages between metamodules; `body` has those to and from the body, `control` those to and from the
//! world-controller.

mod body;
mod control;
#[cfg(test)]
mod tests;

pub use body::{Action, BodyAction, Percept, Refusal};
pub use control::{Order, Status};

use super::blueprint::{MAX_SEEDS, SeedSet, Task};
use super::motions::Sweep;
use super::pose::{Load, Pose};
use metamorph_core::coverage::CoveragePoint;
use metamorph_core::ids::{ModuleId, Token};
use metamorph_core::time::Span;
use metamorph_core::wire::{Decoder, Encoder, Field, Wire, WireError};
use metamorph_core::{choice, codes, fields};

/// Where a metamodule is and what it knows; repeated, so that losing one costs only time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct State {
    /// The sender.
    pub id: ModuleId,
    /// Grows with every state, path and directive that an incarnation of the sender sends; of two states the one with
    /// the larger number is later.
    pub sequence: u32,
    /// Where it is.
    pub pose: Pose,
    /// It fills a seed and stays.
    pub settled: bool,
    /// Its joints do not turn.
    pub stuck: bool,
    /// It is blocked: it stands in the path of a more important metamodule and cannot leave it now.
    pub blocked: bool,
    /// The current task.
    pub task: Task,
    /// The seeds of the task that the sender knows to be filled.
    pub filled: SeedSet,
    /// The seed it is on its way to, and how far that was when it set out.
    pub claim: Option<Claim>,
    /// Seeds to which it has found no route.
    pub unreachable: SeedSet,
}

impl State {
    /// Whether it names seeds beyond the first 32.
    fn is_wide(&self) -> bool {
        self.filled.narrow().is_none() || self.unreachable.narrow().is_none()
    }
    fn encode(self, out: &mut Encoder) {
        out.u32(self.id.0);
        out.u32(self.sequence);
        self.pose.put(out);
        out.u8(u8::from(self.settled) | u8::from(self.stuck) << 1 | u8::from(self.blocked) << 2);
        self.task.put(out);
        let wide = self.is_wide();
        self.filled.encode(wide, out);
        out.u8(self.claim.map_or(u8::MAX, |c| c.seed));
        out.u8(self.claim.map_or(0, |c| c.cost));
        self.unreachable.encode(wide, out);
    }
    fn decode(wide: bool, from: &mut Decoder<'_>) -> Result<State, WireError> {
        let (id, sequence) = (ModuleId(from.u32()?), from.u32()?);
        let pose = Pose::take("pose", from)?;
        let flags = from.u8()?;
        if flags > 7 {
            return Err(WireError::Field("flags"));
        }
        let (task, filled) = (Task::take("task", from)?, SeedSet::decode(wide, from)?);
        let claim = match (from.u8()?, from.u8()?) {
            (u8::MAX, 0) => None,
            (seed, cost) if usize::from(seed) < MAX_SEEDS => Some(Claim { seed, cost }),
            _ => return Err(WireError::Field("claim")),
        };
        let [settled, stuck, blocked] = [1, 2, 4].map(|flag| flags & flag != 0);
        let unreachable = SeedSet::decode(wide, from)?;
        let state = State { id, sequence, pose, settled, stuck, blocked, task, filled, claim, unreachable };
        if state.is_wide() == wide { Ok(state) } else { Err(WireError::Field("filled")) }
    }
}

/// A seed that a metamodule has made its own (`negotiated` only).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Claim {
    /// The seed.
    pub seed: u8,
    /// The number of moves to it when it was claimed; of two metamodules that claim the same seed, the one with the
    /// smaller cost keeps it.
    pub cost: u8,
}

/// The importance of what a metamodule does (`negotiated` only); smaller is more important. The rank of a
/// claim is the place of its seed in the order of seeds; a metamodule that makes way for a rank has the next
/// one below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Rank(pub u16);

impl Rank {
    /// Rank of a metamodule without a claim.
    pub const NONE: Rank = Rank(u16::MAX);
    /// Number of ranks per seed; bounds how many metamodules in a chain that make way have ranks of their own.
    const DEPTHS: u16 = 16;
    /// Number of the last rank of a seed.
    const LAST: u16 = Rank::DEPTHS - 1;

    /// Rank of a metamodule that has claimed this seed.
    pub const fn of_seed(seed: u8) -> Rank {
        Rank(seed as u16 * Rank::DEPTHS)
    }
    /// Rank of a metamodule that makes way for this rank.
    pub const fn below(self) -> Rank {
        match self.0 % Rank::DEPTHS {
            Rank::LAST => self,
            _ => Rank(self.0 + 1),
        }
    }
}

fields!(Rank { 0 });

/// The largest number of segments in a [`Path`].
pub const LEGS: usize = 4;

/// One segment of a path: the turns to a posture that lands or, at the end of a path, to one that does not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Segment {
    /// The posture after the turns, seen from the end that is attached during them.
    pub posture: u16,
    /// All cells that the segment needs: those that the turns sweep, and those filled at the beginning.
    pub sweep: Sweep,
}

fields!(Segment { posture, sweep });

/// The path that the sender intends to take; less important metamodules keep out of its cells. Empty if the sender
/// intends to stay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Path {
    /// The sender.
    pub id: ModuleId,
    /// Counted together with the sender's states.
    pub sequence: u32,
    /// How important it is.
    pub rank: Rank,
    /// Where it begins.
    pub from: Pose,
    /// The next segments, as many as fit; those from `count` on are unused.
    pub segments: [Segment; LEGS],
    /// The number of segments in use.
    pub count: u8,
}

impl Path {
    /// The segments.
    pub fn segments(&self) -> &[Segment] {
        &self.segments[..usize::from(self.count).min(LEGS)]
    }
}

impl Field for Path {
    fn put(&self, out: &mut Encoder) {
        self.id.put(out);
        self.sequence.put(out);
        self.rank.put(out);
        self.from.put(out);
        out.u8(self.segments().len() as u8);
        self.segments().iter().for_each(|segment| segment.put(out));
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Path, WireError> {
        let mut path = Path {
            id: Field::take("id", from)?,
            sequence: from.u32()?,
            rank: Field::take("rank", from)?,
            from: Field::take("from", from)?,
            count: from.u8()?,
            segments: [Segment::default(); LEGS],
        };
        let told = path.segments.get_mut(..usize::from(path.count)).ok_or(WireError::Field("legs"))?;
        for segment in told {
            *segment = Field::take("segment", from)?;
        }
        Ok(path)
    }
}

/// Directive of a coordinator, sent while the group makes no progress by itself (`negotiated` only).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Directive {
    /// The sender; of two coordinators, the one with the smaller number is followed.
    pub coordinator: ModuleId,
    /// Counted together with the sender's states.
    pub sequence: u32,
    /// The instruction.
    pub instruction: Instruction,
}

fields!(Directive { coordinator, sequence, instruction });

/// Instruction to all metamodules in range of a coordinator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Instruction {
    /// The sender no longer coordinates.
    Over,
    /// All stay where they are.
    Stay,
    /// All stay but one.
    Move {
        /// The one that moves.
        mover: ModuleId,
        /// Where it stands.
        from: Pose,
        /// The posture to turn to.
        posture: u16,
        /// The action after the turns.
        end: MoveEnd,
    },
    /// All stay, and one grips an element or releases it (`planned` only).
    Handle {
        /// The one that does.
        mover: ModuleId,
        /// Where it stands.
        from: Pose,
        /// The load afterwards.
        load: Load,
    },
}

/// Action of a metamodule that has turned to the posture of a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MoveEnd {
    /// It stays as it is, free, also where it could fill a seed.
    Rests,
    /// The free end connects to the floor, and the other end detaches.
    Lands,
    /// It fills the open seed in whose cells it is then; if there is none it rests.
    Settles,
}

impl MoveEnd {
    /// Returns the end of a move that lands, or of one that fills a seed if it does not.
    pub fn of(lands: bool, fills: bool) -> MoveEnd {
        match (lands, fills) {
            (true, _) => MoveEnd::Lands,
            (false, true) => MoveEnd::Settles,
            (false, false) => MoveEnd::Rests,
        }
    }
}

codes!(MoveEnd, "end" { Rests, Lands, Settles });

choice!(Instruction, "instruction" {
    0 => Over,
    1 => Stay,
    2 => Move { mover, from, posture, end },
    3 => Handle { mover, from, load },
});

/// A question or an answer of a wave that finds out whether any metamodule can continue (see `detector`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Probe {
    /// The metamodule that began the wave.
    pub initiator: ModuleId,
    /// The number of the wave among those of the initiator.
    pub wave: u32,
    /// The number of the latest state that the sender has announced.
    pub sequence: u32,
    /// The answer; `None` in a question.
    pub answer: Option<Counted>,
}

impl Field for Probe {
    fn put(&self, out: &mut Encoder) {
        self.initiator.put(out);
        out.u32(self.wave);
        out.u32(self.sequence);
        out.bool(self.answer.is_some());
        self.answer.unwrap_or_default().put(out);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Probe, WireError> {
        let (initiator, wave, sequence) = (ModuleId(from.u32()?), from.u32()?, from.u32()?);
        let answers = from.bool("answer")?;
        let counted = Counted::take("counted", from)?;
        if !answers && counted != Counted::default() {
            return Err(WireError::Field("counted"));
        }
        Ok(Probe { initiator, wave, sequence, answer: answers.then_some(counted) })
    }
}

/// Counts of a wave.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Counted {
    /// Metamodules that do nothing until they hear something new.
    pub metamodules: u16,
    /// The sum of their stirs.
    pub stirs: u32,
}

impl Counted {
    /// Adds two counts.
    pub const fn and(self, other: Counted) -> Counted {
        Counted {
            metamodules: self.metamodules.saturating_add(other.metamodules),
            stirs: self.stirs.wrapping_add(other.stirs),
        }
    }
}

fields!(Counted { metamodules, stirs });

/// Why a lock is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Denial {
    /// The metamodule that is asked stands in the way.
    Occupied = 1,
    /// The metamodule that is asked is moving through the requested cells.
    Held = 2,
    /// It has asked for a motion through the requested cells, and is more important or has waited longer.
    Younger = 3,
    /// It has just restarted and does not know what it has granted.
    Quarantined = 4,
}

impl Denial {
    /// Whether granting would have led two bodies into one space.
    pub const fn is_collision(self) -> bool {
        matches!(self, Denial::Occupied | Denial::Held | Denial::Younger)
    }
    pub(super) fn coverage_point(self) -> CoveragePoint {
        match self {
            Denial::Occupied => CoveragePoint::MetaDeniedOccupied,
            Denial::Held => CoveragePoint::MetaDeniedHeld,
            Denial::Younger => CoveragePoint::MetaDeniedYounger,
            Denial::Quarantined => CoveragePoint::MetaDeniedQuarantined,
        }
    }
}

codes!(Denial or none, "denial" { Occupied, Held, Younger, Quarantined });

/// A message between metamodules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Message {
    /// Where the sender is.
    State(State),
    /// Where the sender intends to go.
    Path(Path),
    /// A directive to all in range.
    Directive(Directive),
    /// Asks whether any metamodule can continue, or answers that none of those asked can.
    Probe(Probe),
    /// Asks to keep out of all cells of a move, and to grant them to no other metamodule.
    Request {
        /// The sender.
        origin: ModuleId,
        /// Its attempt.
        token: Token,
        /// The importance of its move.
        rank: Rank,
        /// How long the origin has been waiting; of equally important attempts, the one that has waited longest goes
        /// first.
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
        /// The sender.
        from: ModuleId,
        /// The attempt of the request.
        token: Token,
        /// Why the request is denied; `None` if it is granted.
        denial: Option<Denial>,
    },
    /// The sender no longer needs the lock of this attempt, or of any earlier one.
    Release {
        /// The sender.
        origin: ModuleId,
        /// Its attempt.
        token: Token,
        /// Where it stands now.
        pose: Pose,
    },
}

impl Wire for Message {
    fn kind(&self) -> u8 {
        match self {
            Message::State(state) if state.is_wide() => 23,
            Message::State(_) => 16,
            Message::Request { .. } => 17,
            Message::Response { .. } => 18,
            Message::Release { .. } => 19,
            Message::Path(_) => 20,
            Message::Probe(_) => 21,
            Message::Directive(_) => 22,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match *self {
            Message::State(state) => state.encode(out),
            Message::Path(path) => path.put(out),
            Message::Probe(probe) => probe.put(out),
            Message::Directive(directive) => directive.put(out),
            Message::Request { origin, token, rank, age, pose, sweep, ends } => {
                (origin, token, rank, age, pose, sweep, ends).put(out);
            }
            Message::Response { from, token, denial } => (from, token, denial).put(out),
            Message::Release { origin, token, pose } => (origin, token, pose).put(out),
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Message, WireError> {
        Ok(match kind {
            16 | 23 => Message::State(State::decode(kind == 23, from)?),
            17 => {
                let (origin, token, rank, age, pose, sweep, ends) = Field::take("request", from)?;
                Message::Request { origin, token, rank, age, pose, sweep, ends }
            }
            18 => {
                let (from, token, denial) = Field::take("response", from)?;
                Message::Response { from, token, denial }
            }
            19 => {
                let (origin, token, pose) = Field::take("release", from)?;
                Message::Release { origin, token, pose }
            }
            20 => Message::Path(Field::take("path", from)?),
            21 => Message::Probe(Field::take("probe", from)?),
            22 => Message::Directive(Field::take("directive", from)?),
            _ => return Err(WireError::Kind(kind)),
        })
    }
}

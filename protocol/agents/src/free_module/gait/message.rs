//! Messages between agents of walking modules, their knowledge at the start, and the orders of the controller.

use crate::free_module::oscillator::{Angle, Phase};
use crate::free_module::structure::{JOINTS, Joint, MAX_MODULES, Structure};
use metamorph_core::ids::{Incarnation, ModuleId};
use metamorph_core::only_message;
use metamorph_core::time::Time;
use metamorph_core::wire::{Decoder, Encoder, Field, Wire, WireError};
use metamorph_roombots::connector::Connector;
use serde::{Deserialize, Serialize};

/// Number of connectors of a module.
pub const CONNECTORS: usize = Connector::ALL.len();
/// The largest number of phases in a frame.
pub const PHASES: usize = 5;
/// The number that stands for no module.
const UNDOCKED: u16 = u16::MAX;

/// A module docked at a connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Docked {
    /// The module.
    pub peer: ModuleId,
    /// Its connector.
    pub connector: Connector,
    /// Quarter turns 0..3; see [`crate::free_module::structure::Connection::rotation`].
    pub rotation: u8,
}

/// Modules docked at each connector, as sensed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Docking(pub [Option<Docked>; CONNECTORS]);

impl Docking {
    /// Returns what a module of a structure is docked to.
    pub fn of(structure: &Structure, module: ModuleId) -> Docking {
        let mut docking = Docking::default();
        let ends = structure.connections().iter().flat_map(|c| [*c, c.reversed()]);
        for c in ends.filter(|c| c.a == module) {
            let docked = Docked { peer: c.b, connector: c.to, rotation: c.rotation };
            docking.0[c.at as usize] = Some(docked);
        }
        docking
    }
}

impl Field for Docking {
    fn put(&self, out: &mut Encoder) {
        for docked in &self.0 {
            let (peer, how) =
                docked.map_or((UNDOCKED, 0), |d| (d.peer.0 as u16, 4 * d.connector as u8 + d.rotation));
            out.u16(peer);
            out.u8(how);
        }
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Docking, WireError> {
        let mut docking = Docking::default();
        for docked in &mut docking.0 {
            let (peer, how) = (from.u16()?, from.u8()?);
            let connector = Connector::ALL.get(usize::from(how / 4)).copied();
            *docked = match peer {
                UNDOCKED if how == 0 => None,
                UNDOCKED => return Err(WireError::Field("connector")),
                _ => Some(Docked {
                    peer: module(peer)?,
                    connector: connector.ok_or(WireError::Field("connector"))?,
                    rotation: how % 4,
                }),
            };
        }
        Ok(docking)
    }
}

fn module(number: u16) -> Result<ModuleId, WireError> {
    let id = ModuleId(number.into());
    if id.index() < MAX_MODULES { Ok(id) } else { Err(WireError::Field("module")) }
}

only_message!(Docking = 0);

/// Statement of a module about itself, flooded to all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LinkState {
    /// The module.
    pub module: ModuleId,
    /// Its incarnation.
    pub incarnation: Incarnation,
    /// The number of the statement; of an incarnation the largest one counts.
    pub number: u32,
    /// The docked modules.
    pub docking: Docking,
}

impl LinkState {
    /// Returns true if this statement replaces another of the same module.
    pub fn is_newer_than(&self, other: &LinkState) -> bool {
        (self.incarnation, self.number) > (other.incarnation, other.number)
    }
}

impl Field for LinkState {
    fn put(&self, out: &mut Encoder) {
        out.u16(self.module.0 as u16);
        self.incarnation.put(out);
        out.u32(self.number);
        self.docking.put(out);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<LinkState, WireError> {
        Ok(LinkState {
            module: module(from.u16()?)?,
            incarnation: Field::take("incarnation", from)?,
            number: from.u32()?,
            docking: Field::take("docking", from)?,
        })
    }
}

/// The phase of an oscillator at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PhaseAt {
    /// The oscillator.
    pub oscillator: Joint,
    /// Its phase less the phase that the gait gives it, so that oscillators in lock have equal values.
    pub phase: Phase,
    /// Its amplitude.
    pub amplitude: Angle,
    /// The time at which it had them.
    pub at: Time,
}

/// The longest amplitude and offset in messages and orders: 4 rad.
pub const LARGEST: Angle = Angle(4 << 20);

impl Field for PhaseAt {
    fn put(&self, out: &mut Encoder) {
        out.u16(self.oscillator.0);
        out.u32(self.phase.0);
        out.u32(self.amplitude.0 as u32);
        out.time(self.at);
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<PhaseAt, WireError> {
        let oscillator = Joint(from.u16()?);
        if usize::from(oscillator.0) >= MAX_MODULES * usize::from(JOINTS) {
            return Err(WireError::Field("oscillator"));
        }
        let (phase, amplitude) = (Phase(from.u32()?), angle(from, "amplitude")?);
        Ok(PhaseAt { oscillator, phase, amplitude, at: from.time()? })
    }
}

fn angle(from: &mut Decoder<'_>, field: &'static str) -> Result<Angle, WireError> {
    let angle = Angle(from.u32()? as i32);
    if (-LARGEST.0..=LARGEST.0).contains(&angle.0) { Ok(angle) } else { Err(WireError::Field(field)) }
}

/// A message between agents.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum WalkMessage {
    /// The modules that a module is docked to; flooded to all.
    LinkState(LinkState),
    /// A comparison of what is known.
    Known {
        /// A hash of all link states that the sender knows.
        hash: u64,
        /// True if the sender uses the network made from them; otherwise it waits for an answer.
        settled: bool,
    },
    /// Phases of one epoch of the gait.
    Phases {
        /// The epoch.
        epoch: u16,
        /// At most [`PHASES`].
        phases: Vec<PhaseAt>,
    },
}

impl Wire for WalkMessage {
    fn kind(&self) -> u8 {
        match self {
            WalkMessage::LinkState(_) => 0,
            WalkMessage::Known { .. } => 1,
            WalkMessage::Phases { .. } => 2,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            WalkMessage::LinkState(link) => link.put(out),
            WalkMessage::Known { hash, settled } => (*hash, *settled).put(out),
            WalkMessage::Phases { epoch, phases } => {
                out.u16(*epoch);
                // Invariant: at most PHASES, which fit into a frame.
                out.u8(phases.len() as u8);
                phases.iter().for_each(|phase| phase.put(out));
            }
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<WalkMessage, WireError> {
        match kind {
            0 => Field::take("link", from).map(WalkMessage::LinkState),
            1 => Ok(WalkMessage::Known { hash: from.u64()?, settled: from.bool("settled")? }),
            2 => {
                let (epoch, count) = (from.u16()?, usize::from(from.u8()?));
                if count > PHASES {
                    return Err(WireError::Field("count"));
                }
                let phases = (0..count).map(|_| Field::take("phases", from)).collect::<Result<_, _>>()?;
                Ok(WalkMessage::Phases { epoch, phases })
            }
            _ => Err(WireError::Kind(kind)),
        }
    }
}

/// The parameters of an oscillator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Parameters {
    /// The amplitude.
    pub amplitude: Angle,
    /// The offset.
    pub offset: Angle,
    /// The phase when locked. Lags are differences of phases, so those around a cycle add up to 0.
    pub phase: Phase,
}

/// The part of one agent in a gait.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Gait {
    /// The number of the gait; of several the largest one counts.
    pub epoch: u16,
    /// The time at which it begins, the same for all agents.
    pub start: Time,
    /// The parameters by joint; `None` for a joint that is locked at 0.
    pub joints: [Option<Parameters>; JOINTS as usize],
}

impl Field for Gait {
    fn put(&self, out: &mut Encoder) {
        out.u16(self.epoch);
        out.time(self.start);
        for joint in &self.joints {
            out.bool(joint.is_some());
            let p = joint.unwrap_or_default();
            out.u32(p.amplitude.0 as u32);
            out.u32(p.offset.0 as u32);
            out.u32(p.phase.0);
        }
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Gait, WireError> {
        let (epoch, start) = (from.u16()?, from.time()?);
        let mut joints = [None; JOINTS as usize];
        for joint in &mut joints {
            let there = from.bool("joint")?;
            let (amplitude, offset) = (angle(from, "amplitude")?, angle(from, "offset")?);
            let parameters = Parameters { amplitude, offset, phase: Phase(from.u32()?) };
            *joint = there.then_some(parameters);
        }
        Ok(Gait { epoch, start, joints })
    }
}

/// Request of an agent to its body: to move to these angles, and to stop where it is if no newer request arrives in
/// time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Follow {
    /// The angles of q1, q2 and q3.
    pub angles: [Angle; JOINTS as usize],
    /// The time from which the command no longer holds.
    pub not_after: Time,
}

impl Wire for Follow {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        self.angles.iter().for_each(|a| out.u32(a.0 as u32));
        out.time(self.not_after);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Follow, WireError> {
        if kind != 0 {
            return Err(WireError::Kind(kind));
        }
        let mut angles = [Angle::default(); JOINTS as usize];
        for angle in &mut angles {
            // An amplitude and an offset, each at most LARGEST.
            *angle = Angle(from.u32()? as i32);
            if angle.0.unsigned_abs() > 2 * LARGEST.0.unsigned_abs() {
                return Err(WireError::Field("angle"));
            }
        }
        Ok(Follow { angles, not_after: from.time()? })
    }
}

/// An order of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum WalkOrder {
    /// A gait.
    Gait(Gait),
    /// The process of a module has ended, and its joints do not move.
    Dead {
        /// The module.
        module: ModuleId,
        /// The incarnation that has ended; later ones are alive.
        incarnation: Incarnation,
    },
}

impl Wire for WalkOrder {
    fn kind(&self) -> u8 {
        match self {
            WalkOrder::Gait(_) => 0,
            WalkOrder::Dead { .. } => 1,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            WalkOrder::Gait(gait) => gait.put(out),
            WalkOrder::Dead { module, incarnation } => {
                out.u16(module.0 as u16);
                out.u16(incarnation.0);
            }
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<WalkOrder, WireError> {
        match kind {
            0 => Field::take("gait", from).map(WalkOrder::Gait),
            1 => Ok(WalkOrder::Dead { module: module(from.u16()?)?, incarnation: Incarnation(from.u16()?) }),
            _ => Err(WireError::Kind(kind)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::wire::{PAYLOAD, from_payload, payload};
    use proptest::prelude::*;

    fn longest() -> [WalkMessage; 3] {
        let docked = Docked { peer: ModuleId(255), connector: Connector::C3Z, rotation: 3 };
        let link = LinkState {
            module: ModuleId(255),
            incarnation: Incarnation(u16::MAX),
            number: u32::MAX,
            docking: Docking([Some(docked); CONNECTORS]),
        };
        let phase = PhaseAt {
            oscillator: Joint(767),
            phase: Phase(u32::MAX),
            amplitude: Angle(-LARGEST.0),
            at: Time::NEVER,
        };
        [
            WalkMessage::LinkState(link),
            WalkMessage::Known { hash: u64::MAX, settled: true },
            WalkMessage::Phases { epoch: u16::MAX, phases: vec![phase; PHASES] },
        ]
    }

    #[test]
    fn the_longest_messages_fit_and_come_back() {
        let lengths = longest().map(|message| {
            let bytes = payload(&message);
            assert_eq!(from_payload(message.kind(), &bytes), Ok(message));
            bytes.len()
        });
        assert_eq!(lengths, [38, 9, 93]);
        assert!(lengths.iter().all(|l| *l <= PAYLOAD));
        let gait = Gait { epoch: 1, start: Time(2), joints: [None, Some(Parameters::default()), None] };
        let dead = WalkOrder::Dead { module: ModuleId(255), incarnation: Incarnation(3) };
        for order in [WalkOrder::Gait(gait), dead] {
            assert_eq!(from_payload(order.kind(), &payload(&order)), Ok(order));
        }
        assert_eq!(payload(&Docking::default()).len(), 30);
        let follow = Follow { angles: [Angle(1), Angle(-2), Angle(2 * LARGEST.0)], not_after: Time(7) };
        assert_eq!(from_payload(0, &payload(&follow)), Ok(follow));
        let beyond = Follow { angles: [Angle(2 * LARGEST.0 + 1); 3], ..follow };
        assert_eq!(from_payload::<Follow>(0, &payload(&beyond)), Err(WireError::Field("angle")));
    }

    /// The layout is part of the format.
    #[test]
    fn golden_bytes() {
        let phase = PhaseAt { oscillator: Joint(0x102), phase: Phase(3), amplitude: Angle(-1), at: Time(4) };
        let bytes = payload(&WalkMessage::Phases { epoch: 5, phases: vec![phase] });
        assert_eq!(bytes, [5, 0, 1, 2, 1, 3, 0, 0, 0, 255, 255, 255, 255, 4, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn each_wrong_field_is_refused_by_name() {
        let changed = |message: &WalkMessage, at: usize, to: u8| {
            let mut bytes = payload(message);
            bytes[at] = to;
            from_payload::<WalkMessage>(message.kind(), &bytes)
        };
        let [link, known, phases] = longest();
        assert_eq!(changed(&link, 1, 1), Err(WireError::Field("module")));
        assert_eq!(changed(&link, 10, 40), Err(WireError::Field("connector")));
        assert_eq!(changed(&known, 8, 2), Err(WireError::Field("settled")));
        assert_eq!(changed(&phases, 2, 6), Err(WireError::Field("count")));
        assert_eq!(changed(&phases, 2, 4), Err(WireError::Length));
        assert_eq!(changed(&phases, 4, 3), Err(WireError::Field("oscillator")));
        assert_eq!(changed(&phases, 12, 0), Err(WireError::Field("amplitude")));
        assert_eq!(from_payload::<WalkMessage>(3, &payload(&known)), Err(WireError::Kind(3)));
    }

    proptest! {
        #[test]
        fn garbage_never_panics(kind in 0u8..4, bytes in proptest::collection::vec(any::<u8>(), 0..PAYLOAD)) {
            let _ = from_payload::<WalkMessage>(kind, &bytes);
            let _ = from_payload::<WalkOrder>(kind, &bytes);
            let _ = from_payload::<Follow>(kind, &bytes);
            let _ = from_payload::<Docking>(kind, &bytes);
        }
    }
}

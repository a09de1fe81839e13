//! The packets of a host link. Little endian; a packet is at most [`MAX_PACKET`] bytes long.
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 4 | `MMTR` |
//! | 4 | 2 | version, [`VERSION`] |
//! | 6 | 1 | kind |
//! | 7 | 2 | host of the sender |
//! | 9 | 2 | host of the receiver |
//! | 11 | 8 | run |
//! | 19 | 8 | life of the sender |
//! | 27 | 8 | life of the receiver as known to the sender; 0 if it is not known yet |
//! | 35 | 4 | CRC-32/ISO-HDLC over all other bytes |
//! | 39 | | content, by kind |
//!
//! | kind | content |
//! |---|---|
//! | 1 hello | attempt 8, terms |
//! | 2 accept | attempt of the hello 8, challenge 8, terms, proof 32 |
//! | 3 confirm | challenge of the accept 8, proof 32 |
//! | 4 frames | number of the first frame 8, count 2, the frames cut to their length |
//! | 5 stream, 6 bulk | offset 8, the bytes |
//! | 7 ack | stream and bulk taken up to 8 + 8, frames expected 8, frames taken by class 6 × 8, own clock 8, echo flag 1, echo 8, heard 8 |
//! | 8 bye | nothing |
//!
//! Terms are the versions and hashes that both ends have to share, and what the sender offers: program 4, build 8, swarm
//! 8, room 4.

use metamorph_core::ids::HostId;
use metamorph_core::time::Time;
use metamorph_core::wire::{Frame, HEADER as FRAME_HEADER};
use thiserror::Error;

/// The version of the layout.
pub const VERSION: u16 = 1;
/// The largest packet in bytes: carriers need not split it.
pub const MAX_PACKET: usize = 60_000;
/// The place of the kind in a packet, as a number of bytes from its start: carriers may give kinds different urgency.
pub const KIND_AT: usize = 6;
/// The length of the header of a packet in bytes.
pub const HEADER: usize = 39;
/// The largest part of a stream in one packet, in bytes.
pub const MAX_PART: usize = MAX_PACKET - HEADER - 8;
/// The length of the content of a packet of frames before its frames, in bytes.
pub const FRAMES_HEADER: usize = 10;

const MAGIC: [u8; 4] = *b"MMTR";
const CLASS_COUNT: usize = metamorph_core::counters::Class::ALL.len();

/// One start of a host daemon: 64 random bits. A restarted daemon has another life.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Life(pub u64);

impl Life {
    /// The life of a peer that has not been heard yet.
    pub const UNKNOWN: Life = Life(0);
}

/// The run that hosts work for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Run(pub u64);

/// Proof that the sender knows the token of the run.
pub type Proof = [u8; 32];

/// Terms on which both ends must agree, and the offer of the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Terms {
    /// The version of the program.
    pub program: u32,
    /// The hash of the program's build.
    pub build: u64,
    /// The hash of the swarm file.
    pub swarm: u64,
    /// The number of modules that the sender has room for.
    pub room: u32,
}

/// Acknowledgement: the frames and bytes that an end has received and sent, and its clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Ack {
    /// All bytes of the stream before this offset have been taken.
    pub stream: u64,
    /// The same of the bulk stream.
    pub bulk: u64,
    /// The number of the next frame; all before it have been taken or are lost.
    pub expected: u64,
    /// The number of frames taken, by class.
    pub taken: [u64; CLASS_COUNT],
    /// The sender's clock when it sent this.
    pub clock: Time,
    /// The clock in the latest ack that the sender has received, and the sender's own clock when it received that.
    pub echo: Option<(Time, Time)>,
}

/// The content of a packet.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Content {
    /// Asks for a link.
    Hello {
        /// Numbers the attempts of this life.
        attempt: u64,
        /// The terms of the sender.
        terms: Terms,
    },
    /// Answers a hello.
    Accept {
        /// The attempt that it answers.
        attempt: u64,
        /// The number that the confirmation must repeat.
        challenge: u64,
        /// The terms of the sender.
        terms: Terms,
        /// The proof of the sender.
        proof: Proof,
    },
    /// Answers an accept.
    Confirm {
        /// The challenge of the accept.
        challenge: u64,
        /// The proof of the sender.
        proof: Proof,
    },
    /// Frames with consecutive numbers; none if it only tells the number of the next one.
    Frames {
        /// The number of the first frame.
        first: u64,
        /// The frames.
        frames: Vec<Frame>,
    },
    /// A part of the stream.
    Stream {
        /// The place of the first byte.
        offset: u64,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// A part of the bulk stream.
    Bulk {
        /// The place of the first byte.
        offset: u64,
        /// The bytes.
        bytes: Vec<u8>,
    },
    /// The acknowledgement of the sender.
    Ack(Ack),
    /// The sender leaves.
    Bye,
}

/// A packet.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Packet {
    /// The host of the sender.
    pub from: HostId,
    /// The host of the receiver.
    pub to: HostId,
    /// The run.
    pub run: Run,
    /// The life of the sender.
    pub life: Life,
    /// The life of the receiver, as far as the sender knows it.
    pub peer_life: Life,
    /// The content.
    pub content: Content,
}

/// Why a packet is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum PacketError {
    /// Not a packet of a host link.
    #[error("not a packet of a host link")]
    Magic,
    /// Another version of the layout.
    #[error("version {0} of the packet layout; this program reads version {VERSION}")]
    Version(u16),
    /// The checksum does not match.
    #[error("the checksum does not match the content")]
    Checksum,
    /// An unknown kind.
    #[error("unknown kind of packet {0}")]
    Kind(u8),
    /// Too short, too long, or not as long as its content says.
    #[error("the length of the packet is wrong")]
    Length,
    /// A frame in it is damaged.
    #[error("a frame in the packet is damaged")]
    Frame,
    /// A field with an impossible value.
    #[error("the field `{0}` has an impossible value")]
    Field(&'static str),
}

impl Content {
    /// Returns how much of a window the content fills, so that an acknowledgement comes before the window is full: 64 for a
    /// quarter of the frames or bytes that may be under way.
    pub(super) fn weight(&self) -> u32 {
        let (part, whole) = match self {
            Content::Frames { frames, .. } => (frames.len(), super::FRAME_WINDOW / 4),
            Content::Stream { bytes, .. } | Content::Bulk { bytes, .. } => {
                (bytes.len(), super::STREAM_WINDOW / 4)
            }
            _ => (0, 1),
        };
        // Invariant: a packet is at most 60,000 bytes long.
        (64 * part / whole) as u32
    }

    const fn kind(&self) -> u8 {
        match self {
            Content::Hello { .. } => 1,
            Content::Accept { .. } => 2,
            Content::Confirm { .. } => 3,
            Content::Frames { .. } => 4,
            Content::Stream { .. } => 5,
            Content::Bulk { .. } => 6,
            Content::Ack(_) => 7,
            Content::Bye => 8,
        }
    }
}

impl Packet {
    /// Returns the packet as bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = MAGIC.to_vec();
        out.extend(VERSION.to_le_bytes());
        out.push(self.content.kind());
        out.extend(self.from.0.to_le_bytes());
        out.extend(self.to.0.to_le_bytes());
        for field in [self.run.0, self.life.0, self.peer_life.0] {
            out.extend(field.to_le_bytes());
        }
        out.extend([0; 4]);
        write_content(&self.content, &mut out);
        let crc = checksum(&out);
        out[HEADER - 4..HEADER].copy_from_slice(&crc.to_le_bytes());
        out
    }

    /// Reads a packet.
    ///
    /// # Errors
    /// If it is foreign, damaged, of another version, or not complete.
    pub fn decode(bytes: &[u8]) -> Result<Packet, PacketError> {
        let mut from = Reader(bytes);
        if from.array::<4>().ok() != Some(MAGIC) {
            return Err(PacketError::Magic);
        }
        let version = from.u16()?;
        if version != VERSION {
            return Err(PacketError::Version(version));
        }
        if bytes.len() > MAX_PACKET {
            return Err(PacketError::Length);
        }
        let kind = from.u8()?;
        let (source, to) = (HostId(from.u16()?), HostId(from.u16()?));
        let (run, life, peer_life) = (Run(from.u64()?), Life(from.u64()?), Life(from.u64()?));
        if from.u32()? != checksum(bytes) {
            return Err(PacketError::Checksum);
        }
        if life == Life::UNKNOWN {
            return Err(PacketError::Field("life"));
        }
        let content = read_content(kind, &mut from)?;
        if !from.0.is_empty() {
            return Err(PacketError::Length);
        }
        Ok(Packet { from: source, to, run, life, peer_life, content })
    }
}

fn write_content(content: &Content, out: &mut Vec<u8>) {
    match content {
        Content::Hello { attempt, terms } => {
            out.extend(attempt.to_le_bytes());
            write_terms(terms, out);
        }
        Content::Accept { attempt, challenge, terms, proof } => {
            out.extend(attempt.to_le_bytes());
            out.extend(challenge.to_le_bytes());
            write_terms(terms, out);
            out.extend(proof);
        }
        Content::Confirm { challenge, proof } => {
            out.extend(challenge.to_le_bytes());
            out.extend(proof);
        }
        Content::Frames { first, frames } => {
            out.extend(first.to_le_bytes());
            // Invariant: a packet has fewer than 2^16 frames, since each is at least 32 bytes long.
            out.extend((frames.len() as u16).to_le_bytes());
            for frame in frames {
                out.extend(&frame.as_bytes()[..frame.wire_len().min(Frame::SIZE)]);
            }
        }
        Content::Stream { offset, bytes } | Content::Bulk { offset, bytes } => {
            out.extend(offset.to_le_bytes());
            out.extend(bytes);
        }
        Content::Ack(ack) => write_ack(ack, out),
        Content::Bye => {}
    }
}

fn write_terms(terms: &Terms, out: &mut Vec<u8>) {
    out.extend(terms.program.to_le_bytes());
    out.extend(terms.build.to_le_bytes());
    out.extend(terms.swarm.to_le_bytes());
    out.extend(terms.room.to_le_bytes());
}

fn write_ack(ack: &Ack, out: &mut Vec<u8>) {
    let (echo, heard) = ack.echo.unwrap_or_default();
    let counts = [ack.stream, ack.bulk, ack.expected].into_iter().chain(ack.taken).chain([ack.clock.0]);
    counts.for_each(|count| out.extend(count.to_le_bytes()));
    out.push(u8::from(ack.echo.is_some()));
    out.extend(echo.0.to_le_bytes());
    out.extend(heard.0.to_le_bytes());
}

fn read_content(kind: u8, from: &mut Reader<'_>) -> Result<Content, PacketError> {
    Ok(match kind {
        1 => Content::Hello { attempt: from.u64()?, terms: read_terms(from)? },
        2 => Content::Accept {
            attempt: from.u64()?,
            challenge: from.u64()?,
            terms: read_terms(from)?,
            proof: from.array()?,
        },
        3 => Content::Confirm { challenge: from.u64()?, proof: from.array()? },
        4 => {
            let (first, count) = (from.u64()?, from.u16()?);
            let frames: Vec<Frame> = (0..count).map(|_| read_frame(from)).collect::<Result<_, _>>()?;
            Content::Frames { first, frames }
        }
        5 => Content::Stream { offset: from.u64()?, bytes: from.rest() },
        6 => Content::Bulk { offset: from.u64()?, bytes: from.rest() },
        7 => Content::Ack(read_ack(from)?),
        8 => Content::Bye,
        other => return Err(PacketError::Kind(other)),
    })
}

fn read_terms(from: &mut Reader<'_>) -> Result<Terms, PacketError> {
    Ok(Terms { program: from.u32()?, build: from.u64()?, swarm: from.u64()?, room: from.u32()? })
}

fn read_frame(from: &mut Reader<'_>) -> Result<Frame, PacketError> {
    // The length of the payload is in the header of a frame.
    let length = FRAME_HEADER + usize::from(*from.0.get(5).ok_or(PacketError::Length)?);
    let mut bytes = [0; Frame::SIZE];
    bytes.get_mut(..length).ok_or(PacketError::Frame)?.copy_from_slice(from.take(length)?);
    let frame = Frame::from_bytes(bytes);
    frame.open().map(|_| frame).map_err(|_| PacketError::Frame)
}

fn read_ack(from: &mut Reader<'_>) -> Result<Ack, PacketError> {
    let (stream, bulk, expected) = (from.u64()?, from.u64()?, from.u64()?);
    let mut taken = [0; CLASS_COUNT];
    for count in &mut taken {
        *count = from.u64()?;
    }
    let clock = Time(from.u64()?);
    let has_echo = from.u8()?;
    let echo = (Time(from.u64()?), Time(from.u64()?));
    let echo = match has_echo {
        0 if echo == (Time::ZERO, Time::ZERO) => None,
        1 => Some(echo),
        _ => return Err(PacketError::Field("echo")),
    };
    Ok(Ack { stream, bulk, expected, taken, clock, echo })
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes[..HEADER - 4]);
    hasher.update(bytes.get(HEADER..).unwrap_or_default());
    hasher.finalize()
}

/// Takes fields off the front of a packet.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, length: usize) -> Result<&'a [u8], PacketError> {
        let (front, rest) = self.0.split_at_checked(length).ok_or(PacketError::Length)?;
        self.0 = rest;
        Ok(front)
    }
    fn array<const N: usize>(&mut self) -> Result<[u8; N], PacketError> {
        let (front, rest) = self.0.split_first_chunk().ok_or(PacketError::Length)?;
        self.0 = rest;
        Ok(*front)
    }
    fn u8(&mut self) -> Result<u8, PacketError> {
        self.array().map(|[byte]| byte)
    }
    fn u16(&mut self) -> Result<u16, PacketError> {
        self.array().map(u16::from_le_bytes)
    }
    fn u32(&mut self) -> Result<u32, PacketError> {
        self.array().map(u32::from_le_bytes)
    }
    fn u64(&mut self) -> Result<u64, PacketError> {
        self.array().map(u64::from_le_bytes)
    }
    fn rest(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0).to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::counters::Class;
    use metamorph_core::ids::{Incarnation, ModuleId, Port};
    use metamorph_core::lattice::Cell;
    use metamorph_core::wire::{Channel, Header};
    use proptest::prelude::*;

    fn frame(sequence: u32) -> Frame {
        let header = Header {
            channel: Channel::Peer,
            kind: 0,
            class: Class::Seed,
            port: Port(3),
            incarnation: Incarnation(2),
            source: ModuleId(7),
            destination: ModuleId(9),
            session: 5,
            sequence,
        };
        Frame::seal(header, &Cell::new(1, -2, 3))
    }

    fn packet(content: Content) -> Packet {
        let (run, life, peer_life) = (Run(0x1122_3344_5566_7788), Life(0xA1), Life(0xB2));
        Packet { from: HostId(1), to: HostId(0x0203), run, life, peer_life, content }
    }

    fn contents() -> impl Strategy<Value = Content> {
        let terms = any::<(u32, u64, u64, u32)>().prop_map(|(program, build, swarm, room)| Terms {
            program,
            build,
            swarm,
            room,
        });
        let bytes = || proptest::collection::vec(any::<u8>(), 0..300);
        let echo = any::<Option<(u64, u64)>>().prop_map(|echo| echo.map(|(a, b)| (Time(a), Time(b))));
        prop_oneof![
            (any::<u64>(), terms.clone()).prop_map(|(attempt, terms)| Content::Hello { attempt, terms }),
            (any::<(u64, u64)>(), terms, any::<Proof>()).prop_map(|((attempt, challenge), terms, proof)| {
                Content::Accept { attempt, challenge, terms, proof }
            }),
            any::<(u64, Proof)>().prop_map(|(challenge, proof)| Content::Confirm { challenge, proof }),
            (any::<u64>(), 0..40u32)
                .prop_map(|(first, n)| Content::Frames { first, frames: (0..n).map(frame).collect() }),
            (any::<u64>(), bytes()).prop_map(|(offset, bytes)| Content::Stream { offset, bytes }),
            (any::<u64>(), bytes()).prop_map(|(offset, bytes)| Content::Bulk { offset, bytes }),
            (any::<[u64; 4]>(), any::<[u64; CLASS_COUNT]>(), echo).prop_map(
                |([stream, bulk, expected, clock], taken, echo)| {
                    Content::Ack(Ack { stream, bulk, expected, taken, clock: Time(clock), echo })
                }
            ),
            Just(Content::Bye),
        ]
    }

    proptest! {
        #[test]
        fn reads_what_it_writes(content in contents()) {
            let packet = packet(content);
            prop_assert_eq!(Packet::decode(&packet.encode()), Ok(packet));
        }

        /// One changed byte is noticed, wherever it is; and so is a packet that ends early or continues.
        #[test]
        fn damage_is_noticed(content in contents(), at in any::<prop::sample::Index>(), change in 1u8..) {
            let mut bytes = packet(content).encode();
            let end = at.index(bytes.len());
            prop_assert!(Packet::decode(&bytes[..end]).is_err());
            bytes.push(change);
            prop_assert!(Packet::decode(&bytes).is_err());
            bytes.pop();
            bytes[end] ^= change;
            prop_assert!(Packet::decode(&bytes).is_err());
        }

        /// Content that a foreign program sealed is refused or read; nothing panics.
        #[test]
        fn foreign_content_never_panics(kind in 0u8..12, body in proptest::collection::vec(any::<u8>(), 0..300)) {
            let mut bytes = packet(Content::Bye).encode();
            bytes[6] = kind;
            bytes.extend(body);
            let crc = checksum(&bytes);
            bytes[HEADER - 4..HEADER].copy_from_slice(&crc.to_le_bytes());
            if let Ok(packet) = Packet::decode(&bytes) {
                prop_assert_eq!(packet.encode(), bytes);
            }
        }

        #[test]
        fn garbage_is_refused(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(Packet::decode(&bytes).is_err());
        }
    }

    /// The layout is a contract: a change of it needs a new version.
    #[test]
    fn golden_bytes() {
        let bytes = packet(Content::Stream { offset: 0x0102, bytes: vec![0xEE, 0xFF] }).encode();
        let expected: [&[u8]; 9] = [
            b"MMTR",
            &[1, 0, 5],
            &[1, 0, 3, 2],
            &[0x88, 0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11],
            &[0xA1, 0, 0, 0, 0, 0, 0, 0],
            &[0xB2, 0, 0, 0, 0, 0, 0, 0],
            &checksum(&bytes).to_le_bytes(),
            &[2, 1, 0, 0, 0, 0, 0, 0],
            &[0xEE, 0xFF],
        ];
        assert_eq!(bytes, expected.concat());
        assert_eq!(checksum(&bytes), CRC);
    }

    /// The checksum of the packet above, by another program (`zlib.crc32` of Python).
    const CRC: u32 = 0x45B06327;

    #[test]
    fn says_what_is_wrong() {
        let good = packet(Content::Frames { first: 1, frames: vec![frame(1), frame(2)] });
        let with = |edit: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = good.encode();
            edit(&mut bytes);
            let crc = checksum(&bytes);
            bytes[HEADER - 4..HEADER].copy_from_slice(&crc.to_le_bytes());
            Packet::decode(&bytes)
        };
        assert_eq!(with(&|_| ()), Ok(good.clone()));
        assert_eq!(with(&|b| b[0] = b'X'), Err(PacketError::Magic));
        assert_eq!(with(&|b| b[4] = 9), Err(PacketError::Version(9)));
        assert_eq!(with(&|b| b[6] = 9), Err(PacketError::Kind(9)));
        assert_eq!(with(&|b| b[19..27].fill(0)), Err(PacketError::Field("life")));
        assert_eq!(with(&|b| b.resize(MAX_PACKET + 1, 0)), Err(PacketError::Length));
        // The length of a payload, a byte of a payload, and the number of frames.
        assert_eq!(with(&|b| b[HEADER + FRAMES_HEADER + 5] = 200), Err(PacketError::Frame));
        assert_eq!(with(&|b| b[HEADER + FRAMES_HEADER + 33] ^= 1), Err(PacketError::Frame));
        assert_eq!(with(&|b| b[HEADER + 8] = 3), Err(PacketError::Length));
        assert_eq!(with(&|b| b[HEADER + 8] = 1), Err(PacketError::Length));
        let mut damaged = good.encode();
        damaged[HEADER] ^= 1;
        assert_eq!(Packet::decode(&damaged), Err(PacketError::Checksum));
    }
}

//! The one message layout, in shared memory, in journals and on networks.
//!
//! A [`Frame`] is 128 bytes, without pointers, little endian, and valid for
//! every bit pattern: bytes that a killed or foreign writer left in shared memory are checked by
//! [`Frame::open`] before they are used.
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 1 | version, [`VERSION`] |
//! | 1 | 1 | channel, [`Channel`] |
//! | 2 | 1 | kind within the channel |
//! | 3 | 1 | class, [`Class`] |
//! | 4 | 1 | port of the sender |
//! | 5 | 1 | payload length in bytes, at most 96 |
//! | 6 | 2 | incarnation of the sender |
//! | 8 | 4 | sender |
//! | 12 | 4 | receiver |
//! | 16 | 4 | contact session (peer channel) or contact revision (body channel) |
//! | 20 | 4 | sequence number |
//! | 24 | 4 | CRC-32/ISO-HDLC over the header with this field zero, then the payload |
//! | 28 | 4 | zero |
//! | 32 | 96 | payload, zero beyond its length |

mod fields;

pub use fields::{Absent, Field};

use crate::counters::Class;
use crate::ids::{Incarnation, ModuleId, Port};
use crate::lattice::{Cell, Face};
use crate::time::Time;
use alloc::vec::Vec;
use core::fmt::Debug;
use thiserror::Error;

/// The version number of the layout and of every message in it.
pub const VERSION: u8 = 13;
/// The length of the header in bytes.
pub const HEADER: usize = 32;
/// The maximum length of a payload in bytes.
pub const PAYLOAD: usize = 96;

/// The two ends that a frame goes between.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Channel {
    /// Agent to agent: protocol messages, the only ones counted as such.
    Peer = 0,
    /// Agent to body: actions; body to agent: percepts.
    Body = 1,
    /// Controller to agent: orders; agent to controller: reports.
    Control = 2,
    /// Driver to driver: life cycle and contacts.
    Runtime = 3,
}

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum WireError {
    /// An unsupported version of the layout.
    #[error("version {0} of the wire format; this program reads version {VERSION}")]
    Version(u8),
    /// The checksum does not match.
    #[error("the checksum does not match the content")]
    Checksum,
    /// The payload length is impossible, or does not match the message.
    #[error("the payload length is wrong")]
    Length,
    /// A kind that the channel does not have.
    #[error("unknown message kind {0}")]
    Kind(u8),
    /// A field with an impossible value.
    #[error("the field `{0}` has an impossible value")]
    Field(&'static str),
}

/// A value that travels as a payload.
pub trait Wire: Clone + Debug + PartialEq + Eq + Send + Sync {
    /// Returns the number of this kind of message within its channel.
    fn kind(&self) -> u8;
    /// Writes the payload.
    fn encode(&self, out: &mut Encoder);
    /// Reads a payload of this kind, checking every field.
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Self, WireError>;
    /// Returns the number of bytes on the wire, header included.
    fn wire_len(&self) -> usize {
        let mut out = Encoder::new();
        self.encode(&mut out);
        out.len
    }
}

/// Encodes the payload of a message, without a frame around it.
pub fn payload<W: Wire>(message: &W) -> Vec<u8> {
    let mut out = Encoder::new();
    message.encode(&mut out);
    out.bytes[HEADER..out.len].to_vec()
}

/// Reads a payload that has no frame around it.
pub fn from_payload<W: Wire>(kind: u8, bytes: &[u8]) -> Result<W, WireError> {
    let mut from = Decoder { bytes };
    let message = W::decode(kind, &mut from)?;
    if from.bytes.is_empty() { Ok(message) } else { Err(WireError::Length) }
}

/// A message type without values, for families that lack some kind of message, for example orders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Never {}

impl Wire for Never {
    fn kind(&self) -> u8 {
        match *self {}
    }
    fn encode(&self, _: &mut Encoder) {
        match *self {}
    }
    fn decode(kind: u8, _: &mut Decoder<'_>) -> Result<Never, WireError> {
        Err(WireError::Kind(kind))
    }
}

crate::only_message!(Cell = 0);

/// All fields of a frame but its payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// The two ends.
    pub channel: Channel,
    /// The kind of message within the channel.
    pub kind: u8,
    /// The class of a peer message.
    pub class: Class,
    /// The sender's port.
    pub port: Port,
    /// The sender's incarnation.
    pub incarnation: Incarnation,
    /// The sender; the controller uses [`CONTROLLER`].
    pub source: ModuleId,
    /// The receiver.
    pub destination: ModuleId,
    /// Contact session (peer channel) or contact revision (body channel).
    pub session: u32,
    /// The number of the frame among those of its sender.
    pub sequence: u32,
}

/// The id of the world-controller in headers.
pub const CONTROLLER: ModuleId = ModuleId(u32::MAX);

/// One message in its fixed layout: its bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(transparent)]
pub struct Frame([u8; HEADER + PAYLOAD]);

/// Offset of the checksum in bytes.
const CRC: usize = 24;
/// Offset of the reserved bytes.
const RESERVED: usize = 28;

impl Frame {
    /// The length of a frame in bytes.
    pub const SIZE: usize = size_of::<Frame>();

    /// Packs a message.
    pub fn seal<W: Wire>(header: Header, message: &W) -> Frame {
        let mut out = Encoder::new();
        message.encode(&mut out);
        let length = (out.len - HEADER) as u8;
        out.len = 0;
        out.put(&[VERSION, header.channel as u8, message.kind(), header.class as u8, header.port.0, length]);
        out.u16(header.incarnation.0);
        out.u32(header.source.0);
        out.u32(header.destination.0);
        out.u32(header.session);
        out.u32(header.sequence);
        Frame(out.bytes).summed()
    }

    /// Checks a frame and reads its header.
    ///
    /// # Errors
    /// Refuses a frame of another version, or one that is damaged or has an impossible field.
    #[inline]
    pub fn open(&self) -> Result<Header, WireError> {
        let [version, channel, kind, class, port, length, ..] = self.0;
        if version != VERSION {
            return Err(WireError::Version(version));
        }
        if usize::from(length) > PAYLOAD {
            return Err(WireError::Length);
        }
        if u32::from_le_bytes(self.part(CRC)) != self.checksum() {
            return Err(WireError::Checksum);
        }
        if self.part(RESERVED) != [0; 4] {
            return Err(WireError::Field("reserved"));
        }
        let channel = match channel {
            0 => Channel::Peer,
            1 => Channel::Body,
            2 => Channel::Control,
            3 => Channel::Runtime,
            _ => return Err(WireError::Field("channel")),
        };
        Ok(Header {
            channel,
            kind,
            class: Class::from_index(class).ok_or(WireError::Field("class"))?,
            port: Port(port),
            incarnation: Incarnation(u16::from_le_bytes(self.part(6))),
            source: ModuleId(u32::from_le_bytes(self.part(8))),
            destination: ModuleId(u32::from_le_bytes(self.part(12))),
            session: u32::from_le_bytes(self.part(16)),
            sequence: u32::from_le_bytes(self.part(20)),
        })
    }

    /// Reads the payload of a frame that [`Frame::open`] accepted.
    pub fn message<W: Wire>(&self) -> Result<W, WireError> {
        let bytes = self.0.get(HEADER..self.wire_len()).ok_or(WireError::Length)?;
        from_payload(self.0[2], bytes)
    }

    /// Returns the class that the header claims, for counting a frame that is refused.
    pub fn claimed_class(&self) -> Class {
        Class::from_index(self.0[3]).unwrap_or(Class::Liveness)
    }

    /// Returns the number of bytes in use: header and payload.
    pub fn wire_len(&self) -> usize {
        HEADER + usize::from(self.0[5])
    }

    /// Flips one bit, as a noisy link would. Bits are counted from the start of the frame; only bytes in use
    /// are touched.
    pub fn flip(&mut self, bit: u64) {
        let bit = bit as usize % (self.wire_len().min(Frame::SIZE) * 8);
        self.0[bit / 8] ^= 1 << (bit % 8);
    }

    /// Returns the frame as bytes, in the layout of this module.
    #[inline]
    pub const fn as_bytes(&self) -> &[u8; Frame::SIZE] {
        &self.0
    }

    /// Creates a frame from unchecked bytes; see [`Frame::open`].
    #[inline]
    pub const fn from_bytes(bytes: [u8; Frame::SIZE]) -> Frame {
        Frame(bytes)
    }

    /// Returns the bytes at an offset, which is a constant within the header.
    #[inline]
    fn part<const N: usize>(&self, at: usize) -> [u8; N] {
        core::array::from_fn(|i| self.0[at + i])
    }

    /// Returns the frame with its checksum in its place.
    fn summed(mut self) -> Frame {
        let sum = self.checksum();
        self.0[CRC..RESERVED].copy_from_slice(&sum.to_le_bytes());
        self
    }

    /// Returns the checksum of the bytes in use, with that of the field itself taken as zero.
    fn checksum(&self) -> u32 {
        let mut bytes = self.0;
        bytes[CRC..RESERVED].fill(0);
        crc32fast::hash(&bytes[..self.wire_len().min(Frame::SIZE)])
    }
}

/// Writes a payload, in its place within a frame.
pub struct Encoder {
    bytes: [u8; Frame::SIZE],
    len: usize,
}

impl Encoder {
    fn new() -> Encoder {
        Encoder { bytes: [0; Frame::SIZE], len: HEADER }
    }
    #[inline]
    fn put(&mut self, bytes: &[u8]) {
        let end = self.len + bytes.len();
        // Invariant: every message type has a fixed layout, and a test encodes its longest value.
        self.bytes[self.len..end].copy_from_slice(bytes);
        self.len = end;
    }
    /// Writes one byte.
    #[inline]
    pub fn u8(&mut self, v: u8) {
        self.put(&[v]);
    }
    /// Writes a flag as one byte.
    #[inline]
    pub fn bool(&mut self, v: bool) {
        self.u8(v.into());
    }
    /// Writes two bytes.
    #[inline]
    pub fn u16(&mut self, v: u16) {
        self.put(&v.to_le_bytes());
    }
    /// Writes four bytes.
    #[inline]
    pub fn u32(&mut self, v: u32) {
        self.put(&v.to_le_bytes());
    }
    /// Writes eight bytes.
    #[inline]
    pub fn u64(&mut self, v: u64) {
        self.put(&v.to_le_bytes());
    }
    /// Writes a time as eight bytes.
    #[inline]
    pub fn time(&mut self, v: Time) {
        self.u64(v.0);
    }
    /// Writes a cell as six bytes.
    #[inline]
    pub fn cell(&mut self, v: Cell) {
        for c in [v.x, v.y, v.z] {
            self.put(&c.to_le_bytes());
        }
    }
    /// Writes a face as one byte.
    #[inline]
    pub fn face(&mut self, v: Face) {
        self.u8(v as u8);
    }
}

/// Reads a payload; a read past its end returns [`WireError::Length`].
pub struct Decoder<'a> {
    bytes: &'a [u8],
}

impl Decoder<'_> {
    #[inline]
    fn take<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let (head, rest) = self.bytes.split_first_chunk::<N>().ok_or(WireError::Length)?;
        self.bytes = rest;
        Ok(*head)
    }
    /// Reads one byte.
    #[inline]
    pub fn u8(&mut self) -> Result<u8, WireError> {
        Ok(self.take::<1>()?[0])
    }
    /// Reads a flag; values other than 0 and 1 are refused.
    #[inline]
    pub fn bool(&mut self, field: &'static str) -> Result<bool, WireError> {
        match self.u8()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(WireError::Field(field)),
        }
    }
    /// Reads two bytes.
    #[inline]
    pub fn u16(&mut self) -> Result<u16, WireError> {
        Ok(u16::from_le_bytes(self.take()?))
    }
    /// Reads four bytes.
    #[inline]
    pub fn u32(&mut self) -> Result<u32, WireError> {
        Ok(u32::from_le_bytes(self.take()?))
    }
    /// Reads eight bytes.
    #[inline]
    pub fn u64(&mut self) -> Result<u64, WireError> {
        Ok(u64::from_le_bytes(self.take()?))
    }
    /// Reads a time of eight bytes.
    #[inline]
    pub fn time(&mut self) -> Result<Time, WireError> {
        self.u64().map(Time)
    }
    /// Reads a cell of six bytes; cells outside [`Cell::LIMIT`] are refused.
    #[inline]
    pub fn cell(&mut self) -> Result<Cell, WireError> {
        let mut c = [0i16; 3];
        for v in &mut c {
            *v = i16::from_le_bytes(self.take()?);
        }
        let cell = Cell::from(c);
        if cell.in_range() { Ok(cell) } else { Err(WireError::Field("cell")) }
    }
    /// Reads a face of one byte; values that are not a face number are refused.
    #[inline]
    pub fn face(&mut self, field: &'static str) -> Result<Face, WireError> {
        Face::from_index(self.u8()?).ok_or(WireError::Field(field))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn header() -> Header {
        Header {
            channel: Channel::Peer,
            kind: 0,
            class: Class::Seed,
            port: Port(3),
            incarnation: Incarnation(2),
            source: ModuleId(7),
            destination: ModuleId(8),
            session: 0x0102_0304,
            sequence: 5,
        }
    }

    /// The layout is part of the format: these bytes change only together with [`VERSION`].
    #[test]
    fn golden_bytes() {
        let frame = Frame::seal(header(), &Cell::new(1, -2, 3));
        let mut expected = [0u8; Frame::SIZE];
        expected[..24]
            .copy_from_slice(&[13, 0, 0, 1, 3, 6, 2, 0, 7, 0, 0, 0, 8, 0, 0, 0, 4, 3, 2, 1, 5, 0, 0, 0]);
        expected[24..28].copy_from_slice(&frame.0[24..28]);
        expected[32..38].copy_from_slice(&[1, 0, 0xFE, 0xFF, 3, 0]);
        assert_eq!(frame.0, expected);
        assert_eq!(u32::from_le_bytes(frame.part(CRC)), 0xD360_3D6A);
        assert_eq!(frame.open(), Ok(header()));
        assert_eq!(frame.message::<Cell>(), Ok(Cell::new(1, -2, 3)));
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let frame = Frame::seal(header(), &Cell::new(1, -2, 3));
        for bit in 0..frame.wire_len() as u64 * 8 {
            let mut bad = frame;
            bad.flip(bit);
            assert!(bad != frame && bad.open().is_err(), "bit {bit}");
        }
    }

    #[test]
    fn refuses_each_wrong_field_by_name() {
        let good = Frame::seal(header(), &Cell::default());
        let resealed = |edit: fn(&mut Frame)| {
            let mut frame = good;
            edit(&mut frame);
            let frame = frame.summed();
            frame.open().and_then(|_| frame.message::<Cell>().map(drop))
        };
        assert_eq!(resealed(|f| f.0[0] = VERSION + 1), Err(WireError::Version(VERSION + 1)));
        assert_eq!(resealed(|f| f.0[1] = 9), Err(WireError::Field("channel")));
        assert_eq!(resealed(|f| f.0[3] = 7), Err(WireError::Field("class")));
        assert_eq!(resealed(|f| f.0[RESERVED] = 1), Err(WireError::Field("reserved")));
        assert_eq!(resealed(|f| f.0[5] = 97), Err(WireError::Length));
        assert_eq!(resealed(|f| f.0[5] = 7), Err(WireError::Length));
        assert_eq!(resealed(|f| f.0[5] = 5), Err(WireError::Length));
        assert_eq!(resealed(|f| f.0[2] = 1), Err(WireError::Kind(1)));
        assert_eq!(resealed(|f| f.0[HEADER + 1] = 0x7F), Err(WireError::Field("cell")));
    }

    proptest! {
        /// Random bytes are refused or read, and never cause a panic.
        #[test]
        fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), Frame::SIZE)) {
            let array: [u8; Frame::SIZE] = bytes.try_into().unwrap();
            let frame = Frame::from_bytes(array);
            let _ = frame.open();
            let _ = frame.message::<Cell>();
            let mut flipped = frame;
            flipped.flip(123_456_789);
        }
    }
}

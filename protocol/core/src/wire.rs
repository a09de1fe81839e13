//! The one message layout, in shared memory, in journals and on networks.
//!
//! A [`Frame`] is 128 bytes, `repr(C)`, without pointers or implicit padding, little endian, and valid for
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
pub const VERSION: u8 = 12;
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
        HEADER + out.len
    }
}

/// Encodes the payload of a message, without a frame around it.
pub fn payload<W: Wire>(message: &W) -> Vec<u8> {
    let mut out = Encoder::new();
    message.encode(&mut out);
    out.bytes[..out.len].to_vec()
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

/// One message in its fixed layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(C)]
pub struct Frame {
    version: u8,
    channel: u8,
    kind: u8,
    class: u8,
    port: u8,
    length: u8,
    incarnation: [u8; 2],
    source: [u8; 4],
    destination: [u8; 4],
    session: [u8; 4],
    sequence: [u8; 4],
    crc: [u8; 4],
    reserved: [u8; 4],
    payload: [u8; PAYLOAD],
}

const _: () = assert!(size_of::<Frame>() == HEADER + PAYLOAD && align_of::<Frame>() == 1);

impl Frame {
    /// The length of a frame in bytes.
    pub const SIZE: usize = size_of::<Frame>();

    /// Packs a message.
    pub fn seal<W: Wire>(header: Header, message: &W) -> Frame {
        let mut out = Encoder::new();
        message.encode(&mut out);
        let mut frame = Frame {
            version: VERSION,
            channel: header.channel as u8,
            kind: message.kind(),
            class: header.class as u8,
            port: header.port.0,
            length: out.len as u8,
            incarnation: header.incarnation.0.to_le_bytes(),
            source: header.source.0.to_le_bytes(),
            destination: header.destination.0.to_le_bytes(),
            session: header.session.to_le_bytes(),
            sequence: header.sequence.to_le_bytes(),
            crc: [0; 4],
            reserved: [0; 4],
            payload: out.bytes,
        };
        frame.crc = frame.checksum().to_le_bytes();
        frame
    }

    /// Checks a frame and reads its header.
    ///
    /// # Errors
    /// Refuses a frame of another version, or one that is damaged or has an impossible field.
    #[inline]
    pub fn open(&self) -> Result<Header, WireError> {
        if self.version != VERSION {
            return Err(WireError::Version(self.version));
        }
        if usize::from(self.length) > PAYLOAD {
            return Err(WireError::Length);
        }
        if u32::from_le_bytes(self.crc) != self.checksum() {
            return Err(WireError::Checksum);
        }
        if self.reserved != [0; 4] {
            return Err(WireError::Field("reserved"));
        }
        let channel = match self.channel {
            0 => Channel::Peer,
            1 => Channel::Body,
            2 => Channel::Control,
            3 => Channel::Runtime,
            _ => return Err(WireError::Field("channel")),
        };
        Ok(Header {
            channel,
            kind: self.kind,
            class: Class::from_index(self.class).ok_or(WireError::Field("class"))?,
            port: Port(self.port),
            incarnation: Incarnation(u16::from_le_bytes(self.incarnation)),
            source: ModuleId(u32::from_le_bytes(self.source)),
            destination: ModuleId(u32::from_le_bytes(self.destination)),
            session: u32::from_le_bytes(self.session),
            sequence: u32::from_le_bytes(self.sequence),
        })
    }

    /// Reads the payload of a frame that [`Frame::open`] accepted.
    pub fn message<W: Wire>(&self) -> Result<W, WireError> {
        let bytes = self.payload.get(..usize::from(self.length)).ok_or(WireError::Length)?;
        from_payload(self.kind, bytes)
    }

    /// Returns the class that the header claims, for counting a frame that is refused.
    pub fn claimed_class(&self) -> Class {
        Class::from_index(self.class).unwrap_or(Class::Liveness)
    }

    /// Returns the number of bytes in use: header and payload.
    pub fn wire_len(&self) -> usize {
        HEADER + usize::from(self.length)
    }

    /// Flips one bit, as a noisy link would. Bits are counted from the start of the frame; only bytes in use
    /// are touched.
    pub fn flip(&mut self, bit: u64) {
        let mut bytes = self.to_bytes();
        let bit = bit as usize % (self.wire_len().min(Frame::SIZE) * 8);
        bytes[bit / 8] ^= 1 << (bit % 8);
        *self = Frame::from_bytes(&bytes);
    }

    /// Returns the frame as bytes, in the layout of this module.
    #[inline]
    pub fn to_bytes(&self) -> [u8; Frame::SIZE] {
        let mut bytes = [0; Frame::SIZE];
        bytes[..6].copy_from_slice(&[
            self.version,
            self.channel,
            self.kind,
            self.class,
            self.port,
            self.length,
        ]);
        bytes[6..8].copy_from_slice(&self.incarnation);
        bytes[8..12].copy_from_slice(&self.source);
        bytes[12..16].copy_from_slice(&self.destination);
        bytes[16..20].copy_from_slice(&self.session);
        bytes[20..24].copy_from_slice(&self.sequence);
        bytes[24..28].copy_from_slice(&self.crc);
        bytes[28..32].copy_from_slice(&self.reserved);
        bytes[HEADER..].copy_from_slice(&self.payload);
        bytes
    }

    /// Creates a frame from unchecked bytes; see [`Frame::open`].
    #[inline]
    pub fn from_bytes(bytes: &[u8; Frame::SIZE]) -> Frame {
        fn part<const N: usize>(bytes: &[u8; Frame::SIZE], at: usize) -> [u8; N] {
            core::array::from_fn(|i| bytes[at + i])
        }
        Frame {
            version: bytes[0],
            channel: bytes[1],
            kind: bytes[2],
            class: bytes[3],
            port: bytes[4],
            length: bytes[5],
            incarnation: part(bytes, 6),
            source: part(bytes, 8),
            destination: part(bytes, 12),
            session: part(bytes, 16),
            sequence: part(bytes, 20),
            crc: part(bytes, 24),
            reserved: part(bytes, 28),
            payload: part(bytes, HEADER),
        }
    }

    fn checksum(&self) -> u32 {
        let mut bytes = self.to_bytes();
        bytes[24..28].fill(0);
        crc32fast::hash(&bytes[..self.wire_len().min(Frame::SIZE)])
    }
}

/// Writes a payload.
pub struct Encoder {
    bytes: [u8; PAYLOAD],
    len: usize,
}

impl Encoder {
    fn new() -> Encoder {
        Encoder { bytes: [0; PAYLOAD], len: 0 }
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
            .copy_from_slice(&[12, 0, 0, 1, 3, 6, 2, 0, 7, 0, 0, 0, 8, 0, 0, 0, 4, 3, 2, 1, 5, 0, 0, 0]);
        expected[24..28].copy_from_slice(&frame.crc);
        expected[32..38].copy_from_slice(&[1, 0, 0xFE, 0xFF, 3, 0]);
        assert_eq!(frame.to_bytes(), expected);
        assert_eq!(u32::from_le_bytes(frame.crc), 0x5EE8_C088);
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
            frame.crc = frame.checksum().to_le_bytes();
            frame.open().and_then(|_| frame.message::<Cell>().map(drop))
        };
        assert_eq!(resealed(|f| f.version = VERSION + 1), Err(WireError::Version(VERSION + 1)));
        assert_eq!(resealed(|f| f.channel = 9), Err(WireError::Field("channel")));
        assert_eq!(resealed(|f| f.class = 7), Err(WireError::Field("class")));
        assert_eq!(resealed(|f| f.reserved = [1, 0, 0, 0]), Err(WireError::Field("reserved")));
        assert_eq!(resealed(|f| f.length = 97), Err(WireError::Length));
        assert_eq!(resealed(|f| f.length = 7), Err(WireError::Length));
        assert_eq!(resealed(|f| f.length = 5), Err(WireError::Length));
        assert_eq!(resealed(|f| f.kind = 1), Err(WireError::Kind(1)));
        assert_eq!(resealed(|f| f.payload[1] = 0x7F), Err(WireError::Field("cell")));
    }

    proptest! {
        /// Random bytes are refused or read, and never cause a panic.
        #[test]
        fn garbage_never_panics(bytes in proptest::collection::vec(any::<u8>(), Frame::SIZE)) {
            let array: [u8; Frame::SIZE] = bytes.try_into().unwrap();
            let frame = Frame::from_bytes(&array);
            prop_assert_eq!(frame.to_bytes(), array);
            let _ = frame.open();
            let _ = frame.message::<Cell>();
            let mut flipped = frame;
            flipped.flip(123_456_789);
        }
    }
}

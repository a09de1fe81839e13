//! The one type that lies in shared memory: the bytes of a [`Frame`].
//!
//! `Frame` itself knows nothing of iceoryx2; this wrapper gives it the name under which all
//! processes of a run must agree on the layout. Every bit pattern is valid; nothing in it is
//! believed before [`Frame::open`] has checked it.

use iceoryx2::prelude::ZeroCopySend;
use metamorph_protocol::wire::Frame;

/// The bytes of a frame in shared memory.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("metamorph/frame/1")]
pub struct Packet {
    bytes: [u8; Frame::SIZE],
}

impl Packet {
    /// A packet of arbitrary bytes, as a foreign or broken writer would leave them.
    pub const fn from_bytes(bytes: [u8; Frame::SIZE]) -> Packet {
        Packet { bytes }
    }
    /// The frame, unchecked.
    pub fn frame(&self) -> Frame {
        Frame::from_bytes(&self.bytes)
    }
}

impl From<&Frame> for Packet {
    fn from(frame: &Frame) -> Packet {
        Packet { bytes: frame.to_bytes() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_nothing_but_the_bytes_of_a_frame() {
        assert_eq!((size_of::<Packet>(), align_of::<Packet>()), (Frame::SIZE, 1));
        let mut bytes = [0; Frame::SIZE];
        for (i, b) in bytes.iter_mut().enumerate() {
            *b = i as u8;
        }
        assert_eq!(Packet::from(&Packet::from_bytes(bytes).frame()).bytes, bytes);
    }
}

//! The unit of a transport: the bytes of a [`Frame`] with the transport's own data, which the link model does
//! not touch.
//!
//! It is the only type in shared memory. `Frame` is independent of iceoryx2; this wrapper gives it the name
//! under which all processes of a run must agree on the layout. Every bit pattern is valid, and nothing in it
//! is trusted before [`Frame::open`] has checked it.

use iceoryx2::prelude::ZeroCopySend;
use metamorph_protocol::counters::Class;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Frame;

/// Tag bit of a frame that the link model has damaged.
const DAMAGED_MASK: u8 = 0x80;

/// A frame on its way.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("metamorph/frame/3")]
pub struct SharedFrame {
    bytes: [u8; Frame::SIZE],
    sent: [u8; 8],
    handed: [u8; 8],
    tag: u8,
}

impl SharedFrame {
    /// Creates a frame of arbitrary bytes, as from a foreign or broken writer.
    pub const fn from_bytes(bytes: [u8; Frame::SIZE]) -> SharedFrame {
        SharedFrame { bytes, sent: [0; 8], handed: [0xFF; 8], tag: 0 }
    }

    /// Creates a frame that enters a channel at `sent`.
    pub fn new(frame: &Frame, sent: Time) -> SharedFrame {
        SharedFrame { sent: sent.0.to_le_bytes(), ..SharedFrame::from_bytes(*frame.as_bytes()) }
    }

    /// Returns the frame with the time at which an agent handed it to its link, which may have held it back.
    pub fn handed_over(self, handed: Time) -> SharedFrame {
        SharedFrame { handed: handed.0.to_le_bytes(), ..self }
    }

    /// Returns the frame marked as damaged; `class` is the class that it was sent in.
    pub fn damaged(self, class: Class) -> SharedFrame {
        SharedFrame { tag: DAMAGED_MASK | class.index() as u8, ..self }
    }

    /// Returns the frame, unchecked.
    pub fn frame(&self) -> Frame {
        Frame::from_bytes(self.bytes)
    }

    /// Returns when the frame entered the channel, in scenario time.
    pub fn sent(&self) -> Time {
        Time(u64::from_le_bytes(self.sent))
    }

    /// Returns when an agent handed the frame to its link, in scenario time; `None` if that is not known.
    pub fn handed(&self) -> Option<Time> {
        Some(Time(u64::from_le_bytes(self.handed))).filter(|handed| *handed != Time::NEVER)
    }

    /// Returns the class that a damaged frame was sent in; `None` if the link has not damaged it.
    pub fn damaged_class(&self) -> Option<Class> {
        (self.tag & DAMAGED_MASK != 0).then(|| Class::from_index(self.tag & !DAMAGED_MASK)).flatten()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn carries_the_bytes_of_a_frame_and_what_is_known_of_them() {
        assert_eq!((size_of::<SharedFrame>(), align_of::<SharedFrame>()), (Frame::SIZE + 17, 1));
        let mut bytes = [0; Frame::SIZE];
        for (i, b) in bytes.iter_mut().enumerate() {
            *b = i as u8;
        }
        let shared = SharedFrame::new(&SharedFrame::from_bytes(bytes).frame(), Time(77));
        assert_eq!((shared.bytes, shared.sent(), shared.damaged_class()), (bytes, Time(77), None));
        assert_eq!((shared.handed(), shared.handed_over(Time(5)).handed()), (None, Some(Time(5))));
        for class in Class::ALL {
            let damaged = shared.damaged(class);
            assert_eq!((damaged.bytes, damaged.damaged_class()), (bytes, Some(class)));
        }
        // A foreign writer may set any byte.
        assert_eq!(SharedFrame { tag: 0xFF, ..shared }.damaged_class(), None);
    }
}

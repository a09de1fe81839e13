//! The lossless streams of a host link: bytes in order, kept until they are acknowledged, and sent again from the first
//! gap.

use super::packet::MAX_PART;
use metamorph_core::time::{Span, Time};
use std::collections::VecDeque;

/// The most bytes of a stream that are kept until they are acknowledged.
pub const STREAM_WINDOW: usize = 512 << 10;

/// The sending end of a stream.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct StreamSender {
    /// The place of the first byte that is kept.
    base: u64,
    kept: VecDeque<u8>,
    /// The number of kept bytes that have been sent since the last gap.
    sent: usize,
    /// When the first of them was sent; `None` if none is open.
    since: Option<Time>,
}

impl StreamSender {
    /// Takes as many bytes as there is room for, and returns their number.
    pub fn write(&mut self, bytes: &[u8]) -> usize {
        let taken = bytes.len().min(STREAM_WINDOW - self.kept.len());
        self.kept.extend(&bytes[..taken]);
        taken
    }

    /// Returns the next part to send, with its place.
    pub fn next_part(&mut self, now: Time) -> Option<(u64, Vec<u8>)> {
        let length = (self.kept.len() - self.sent).min(MAX_PART);
        if length == 0 {
            return None;
        }
        let part = self.kept.range(self.sent..self.sent + length).copied().collect();
        let offset = self.base + self.sent as u64;
        self.sent += length;
        self.since.get_or_insert(now);
        Some((offset, part))
    }

    /// Returns true if all bytes before `taken` may have been sent.
    pub fn has_sent(&self, taken: u64) -> bool {
        taken <= self.base + self.kept.len() as u64
    }

    /// Notes that all bytes before `taken` have arrived.
    pub fn acknowledge(&mut self, taken: u64, now: Time) {
        let Some(done) = taken.checked_sub(self.base).filter(|done| *done > 0) else { return };
        let done = done.min(self.kept.len() as u64);
        self.kept.drain(..done as usize);
        self.base += done;
        // After sending again from a gap more may have arrived than has been sent since.
        self.sent = self.sent.saturating_sub(done as usize);
        self.since = (self.sent > 0).then_some(now);
    }

    /// Returns when to send again what has not been acknowledged, if it is open for longer than `patience`.
    pub fn repeat_at(&self, patience: Span) -> Time {
        self.since.map_or(Time::NEVER, |since| since + patience)
    }

    /// Sends again from the first byte that is not acknowledged.
    pub fn repeat(&mut self) {
        (self.sent, self.since) = (0, None);
    }

    /// Returns the number of bytes that are not acknowledged.
    pub fn open(&self) -> usize {
        self.kept.len()
    }
}

/// The receiving end of a stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct StreamReceiver {
    taken: u64,
}

impl StreamReceiver {
    /// Returns the place of the next byte: all before it have been taken.
    pub fn taken(self) -> u64 {
        self.taken
    }

    /// Gives up the bytes before `offset`, as only a defect does.
    pub fn skip_to(&mut self, offset: u64) {
        self.taken = offset;
    }

    /// Takes a part, and returns the bytes that come next; none if they have come already or if there is a gap before
    /// them. So the bytes taken are at any time a beginning of those written.
    pub fn take(&mut self, offset: u64, bytes: &[u8]) -> Vec<u8> {
        let next = self.taken.checked_sub(offset).and_then(|known| bytes.get(usize::try_from(known).ok()?..));
        let next = next.unwrap_or_default().to_vec();
        self.taken += next.len() as u64;
        next
    }
}

//! Frames between modules on a host link: numbered, at most once and in order, never sent again; what is lost is counted
//! by class.

use metamorph_core::counters::Class;
use metamorph_core::wire::Frame;
use std::collections::VecDeque;

/// The largest number of frames under way.
pub const FRAME_WINDOW: usize = 4_096;
/// The most bytes of frames under way.
pub const BYTE_WINDOW: usize = 512 << 10;

/// A count for each class.
pub type PerClass = [u64; Class::ALL.len()];

/// Counts of the frames handed to a link, by class and result. For every class `offered = taken + lost + overflowed +
/// expired + unaccounted + open`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct FrameCounts {
    /// Handed to the link.
    pub offered: PerClass,
    /// Taken by the other end, as far as it has said.
    pub taken: PerClass,
    /// Lost on the way, or not sent because the other end was silent.
    pub lost: PerClass,
    /// Not sent because too many were under way.
    pub overflowed: PerClass,
    /// Not sent because there was no other end.
    pub expired: PerClass,
    /// Under way when the other end was gone permanently; perhaps taken.
    pub unaccounted: PerClass,
    /// Under way.
    pub open: PerClass,
}

impl FrameCounts {
    /// Returns true if every frame is counted once.
    pub fn balance(&self) -> bool {
        Class::ALL.iter().all(|class| {
            let i = class.index();
            let fates = [self.taken, self.lost, self.overflowed, self.expired, self.unaccounted, self.open];
            self.offered[i] == fates.iter().map(|fate| fate[i]).sum::<u64>()
        })
    }
}

/// The sending end: numbers and classes of the frames under way.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct FrameSender {
    /// The number of the oldest frame under way.
    base: u64,
    under_way: VecDeque<(Class, u8)>,
    bytes: usize,
    /// Frames of this pair of lives that are no longer under way, and those that the other end took, by class.
    settled: PerClass,
    taken: PerClass,
}

impl FrameSender {
    /// Returns the number of the next frame.
    pub fn next(&self) -> u64 {
        self.base + self.under_way.len() as u64
    }
    /// Returns the number of frames under way.
    pub fn open(&self) -> usize {
        self.under_way.len()
    }
    /// Returns true if there is room for a frame.
    pub fn has_room(&self, frame: &Frame, window: usize) -> bool {
        self.under_way.len() < window && self.bytes + frame.wire_len() <= BYTE_WINDOW
    }
    /// Notes that a frame is under way.
    pub fn add(&mut self, frame: &Frame) {
        self.bytes += frame.wire_len();
        // Invariant: a frame is at most 128 bytes long.
        self.under_way.push_back((frame.claimed_class(), frame.wire_len() as u8));
    }

    /// Notes what the other end expects and has taken, and books it. Returns false if that is impossible; an older
    /// acknowledgement is possible and changes nothing.
    pub fn acknowledge(&mut self, expected: u64, taken: &PerClass, counts: &mut FrameCounts) -> bool {
        let Some(done) = expected.checked_sub(self.base) else { return true };
        if done > self.under_way.len() as u64 {
            return false;
        }
        let mut settled = self.settled;
        for (class, _) in self.under_way.range(..done as usize) {
            settled[class.index()] += 1;
        }
        let is_possible = |i: usize| self.taken[i] <= taken[i] && taken[i] <= settled[i];
        if !(0..taken.len()).all(is_possible) {
            return false;
        }
        for (class, length) in self.under_way.drain(..done as usize) {
            self.bytes -= usize::from(length);
            counts.open[class.index()] -= 1;
        }
        for i in 0..taken.len() {
            let newly_taken = taken[i] - self.taken[i];
            counts.taken[i] += newly_taken;
            counts.lost[i] += (settled[i] - self.settled[i]) - newly_taken;
        }
        (self.base, self.settled, self.taken) = (expected, settled, *taken);
        true
    }

    /// Books what is under way as unaccounted, because the other end is gone permanently.
    pub fn give_up(&mut self, counts: &mut FrameCounts) {
        for (class, _) in self.under_way.drain(..) {
            counts.open[class.index()] -= 1;
            counts.unaccounted[class.index()] += 1;
        }
        self.bytes = 0;
    }
}

/// The receiving end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct FrameReceiver {
    expected: u64,
    taken: PerClass,
    /// Numbers that were skipped.
    pub missed: u64,
    /// Frames that came again, or after a later one.
    pub doubled: u64,
}

impl FrameReceiver {
    /// Returns the number of the next frame.
    pub fn expected(&self) -> u64 {
        self.expected
    }
    /// Returns the number of frames taken.
    pub fn taken(&self) -> &PerClass {
        &self.taken
    }

    /// Takes the frame with this number, if it is not too late; frames between are lost.
    pub fn take(&mut self, number: u64, frame: &Frame) -> bool {
        if number < self.expected {
            self.doubled += 1;
            return false;
        }
        self.skip_to(number);
        self.expected += 1;
        self.taken[frame.claimed_class().index()] += 1;
        true
    }

    /// Notes that all frames before `next` have been sent, so that those that have not come are lost.
    pub fn skip_to(&mut self, next: u64) {
        self.missed += next.saturating_sub(self.expected);
        self.expected = self.expected.max(next);
    }
}

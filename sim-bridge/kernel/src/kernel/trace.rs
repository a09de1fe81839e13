//! The rolling hash of the events of a simulated run: equal if the events were the same, by time, module and
//! kind. Contents are hashed by `state`.

use metamorph_core::time::Time;
use siphasher::sip::SipHasher13;
use std::hash::Hasher;

/// Increased whenever the meaning of the hash changes.
const TRACE_VERSION: u64 = 1;

/// The size of an event in bytes.
const EVENT: usize = 24;
/// The number of events gathered before they are hashed: one long write is faster than many short ones.
const GATHERED: usize = 32;

/// A hash over events.
#[derive(Clone)]
pub struct Trace {
    hasher: SipHasher13,
    gathered: [u8; GATHERED * EVENT],
    /// Bytes of `gathered` in use.
    used: usize,
    events: u64,
}

impl Default for Trace {
    fn default() -> Trace {
        let mut hasher = SipHasher13::new_with_keys(0x4D65_7461_6D6F_7270, TRACE_VERSION);
        hasher.write_u64(TRACE_VERSION);
        Trace { hasher, gathered: [0; GATHERED * EVENT], used: 0, events: 0 }
    }
}

impl Trace {
    /// Adds one event: its time, its kind, and up to two numbers that tell it from others.
    pub fn event(&mut self, at: Time, kind: u8, who: u32, what: u64) {
        self.events += 1;
        let numbers = [at.0, u64::from(kind) << 32 | u64::from(who), what];
        for (to, n) in self.gathered[self.used..self.used + EVENT].chunks_exact_mut(8).zip(numbers) {
            to.copy_from_slice(&n.to_le_bytes());
        }
        self.used += EVENT;
        if self.used == self.gathered.len() {
            self.hasher.write(&self.gathered);
            self.used = 0;
        }
    }
    /// Returns the hash so far.
    pub fn value(&self) -> u64 {
        let mut hasher = self.hasher;
        hasher.write(&self.gathered[..self.used]);
        hasher.finish()
    }
    /// Returns the number of events so far.
    pub fn events(&self) -> u64 {
        self.events
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tells_runs_apart() {
        let hash = |events: &[(u64, u8, u32, u64)]| {
            let mut trace = Trace::default();
            events.iter().for_each(|(t, k, who, what)| trace.event(Time(*t), *k, *who, *what));
            trace.value()
        };
        let base = hash(&[(1, 2, 3, 4), (5, 6, 7, 8)]);
        assert_eq!(base, hash(&[(1, 2, 3, 4), (5, 6, 7, 8)]));
        for other in [&[(1, 2, 3, 4)][..], &[(5, 6, 7, 8), (1, 2, 3, 4)], &[(1, 2, 3, 4), (5, 6, 7, 9)]] {
            assert_ne!(base, hash(other));
        }
    }

    /// Part of the format: reports of different versions of this program are compared by it.
    #[test]
    fn golden_value() {
        let mut trace = Trace::default();
        trace.event(Time(1), 2, 3, 4);
        assert_eq!(trace.value(), 0x6536_0A67_D2D9_C5C2);
    }
}

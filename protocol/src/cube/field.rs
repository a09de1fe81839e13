//! The attraction field of one face: how many moves from the cell outside it to the nearest target.
//!
//! A distance is followed only if it is *feasible*: closer to the source than everything advertised
//! here for the same version of that source. So the successors of one version never form a loop,
//! whatever is late, lost or doubled, and a source that is gone is forgotten with its last version
//! instead of being counted to infinity.

use super::message::Entry;
use crate::marks::{Mark, hit};
use crate::time::{Span, Time};

/// Sources remembered per face.
const MAX_RECORDS: usize = 16;

/// What is remembered of one source.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Record {
    source: u32,
    version: u16,
    /// The least distance advertised here for this version.
    feasible: u16,
    /// When this version was first heard.
    first: Time,
    /// When it was last chosen.
    used: Time,
}

/// A distance offered by a neighbour, or by another face of the same module.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offer {
    /// What is offered.
    pub entry: Entry,
    /// How much farther it is from here; at least 1.
    pub cost: u16,
    /// Names who offers it, among those who can.
    pub via: u8,
}

/// Limits within which distances are used.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub hold: Span,
    /// The largest distance.
    pub range: u16,
    pub accept_stale: bool,
}

/// The value of one face and the memory behind it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct FaceField {
    value: Entry,
    via: u8,
    records: Vec<Record>,
}

/// Whether version `a` is newer than `b`, modulo 2¹⁶.
pub(super) fn newer(a: u16, b: u16) -> bool {
    (1..0x8000).contains(&a.wrapping_sub(b))
}

impl FaceField {
    pub(super) fn new() -> FaceField {
        FaceField { value: Entry::NONE, via: u8::MAX, records: Vec::new() }
    }

    pub(super) fn value(&self) -> Entry {
        self.value
    }

    /// Which of the offers the value came from.
    pub(super) fn via(&self) -> u8 {
        self.via
    }

    /// Sets a value that needs no choice: this face is a target itself, or not open at all.
    pub(super) fn set(&mut self, value: Entry) -> bool {
        let changed = self.value != value;
        (self.value, self.via) = (value, u8::MAX);
        changed
    }

    /// Chooses the nearest feasible offer. Says whether the value changed.
    pub(super) fn choose(&mut self, now: Time, limits: Limits, offers: &[Offer]) -> bool {
        let mut best: Option<(u16, Offer)> = None;
        for offer in offers {
            let distance = offer.entry.distance.saturating_add(offer.cost);
            if !offer.entry.is_known() || distance > limits.range || !self.feasible(now, limits, offer) {
                continue;
            }
            let better = best.is_none_or(|(least, b)| {
                distance < least || (distance == least && newer(offer.entry.version, b.entry.version))
            });
            if better {
                best = Some((distance, *offer));
            }
        }
        let Some((distance, offer)) = best.filter(|(d, o)| self.remember(now, limits, *d, o)) else {
            return self.set(Entry::NONE);
        };
        let value = Entry { distance, ..offer.entry };
        let changed = self.value != value;
        (self.value, self.via) = (value, offer.via);
        changed
    }

    fn feasible(&self, now: Time, limits: Limits, offer: &Offer) -> bool {
        let Some(record) = self.records.iter().find(|r| r.source == offer.entry.source) else {
            return true;
        };
        let version = offer.entry.version;
        if newer(version, record.version) || limits.accept_stale {
            return true;
        }
        let (current, fresh) = (version == record.version, now.since(record.first) <= limits.hold);
        let closer = offer.entry.distance < record.feasible;
        match (current, fresh, closer) {
            (false, ..) => hit(Mark::CubeStaleVersion),
            (_, false, _) => hit(Mark::CubeVersionExpired),
            (.., false) => hit(Mark::CubeNotCloser),
            _ => {}
        }
        current && fresh && closer
    }

    /// Notes the choice; false if there is no room to remember its source.
    fn remember(&mut self, now: Time, limits: Limits, distance: u16, offer: &Offer) -> bool {
        let (source, version) = (offer.entry.source, offer.entry.version);
        if let Some(record) = self.records.iter_mut().find(|r| r.source == source) {
            if record.version == version {
                record.feasible = record.feasible.min(distance);
            } else {
                (record.version, record.feasible, record.first) = (version, distance, now);
            }
            record.used = now;
            return true;
        }
        if self.records.len() == MAX_RECORDS {
            let oldest = (0..MAX_RECORDS).min_by_key(|i| self.records[*i].used);
            match oldest {
                Some(i) if now.since(self.records[i].used) > limits.hold * 2 => {
                    hit(Mark::CubeSourceForgotten);
                    self.records.swap_remove(i);
                }
                _ => {
                    hit(Mark::CubeSourcesFull);
                    return false;
                }
            }
        }
        self.records.push(Record { source, version, feasible: distance, first: now, used: now });
        true
    }

    /// When the version of the current value was first heard of.
    pub(super) fn heard(&self) -> Time {
        self.records.iter().find(|r| r.source == self.value.source).map_or(Time::NEVER, |r| r.first)
    }

    /// When the current value ceases to be usable unless it is renewed.
    pub(super) fn expires(&self, hold: Span) -> Time {
        if !self.value.is_known() || self.via == u8::MAX {
            return Time::NEVER;
        }
        self.records
            .iter()
            .find(|r| r.source == self.value.source)
            .map_or(Time::NEVER, |r| r.first + hold + Span(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { hold: Span(100), range: 50, accept_stale: false };

    fn offer(distance: u16, source: u32, version: u16, via: u8) -> Offer {
        Offer { entry: Entry { distance, source, version }, cost: 1, via }
    }

    #[test]
    fn follows_only_what_is_closer_than_anything_it_said() {
        let mut face = FaceField::new();
        assert!(face.choose(Time(0), LIMITS, &[offer(4, 1, 1, 0)]));
        assert_eq!(face.value().distance, 5);
        // The neighbour's neighbour that follows us offers 6 when our own source has gone: refused.
        face.choose(Time(1), LIMITS, &[offer(6, 1, 1, 1)]);
        assert!(!face.value().is_known());
        // The next version of the source is believed again.
        face.choose(Time(2), LIMITS, &[offer(6, 1, 2, 1)]);
        assert_eq!(face.value().distance, 7);
        // An older version is not.
        face.choose(Time(3), LIMITS, &[offer(1, 1, 1, 0)]);
        assert!(!face.value().is_known());
    }

    #[test]
    fn a_version_ends_when_its_time_is_up() {
        let mut face = FaceField::new();
        face.choose(Time(0), LIMITS, &[offer(4, 1, 1, 0)]);
        assert_eq!(face.expires(LIMITS.hold), Time(101));
        face.choose(Time(100), LIMITS, &[offer(4, 1, 1, 0)]);
        assert!(face.value().is_known());
        face.choose(Time(101), LIMITS, &[offer(4, 1, 1, 0)]);
        assert!(!face.value().is_known());
    }

    #[test]
    fn versions_wrap_around() {
        assert!(newer(0, u16::MAX) && !newer(u16::MAX, 0) && !newer(5, 5));
    }

    #[test]
    fn memory_is_bounded_and_the_oldest_goes_first() {
        let mut face = FaceField::new();
        for source in 0..MAX_RECORDS as u32 {
            face.choose(Time(u64::from(source)), LIMITS, &[offer(1, source, 1, 0)]);
        }
        face.choose(Time(20), LIMITS, &[offer(1, 99, 1, 0)]);
        assert!(!face.value().is_known(), "no room yet");
        face.choose(Time(201), LIMITS, &[offer(1, 99, 1, 0)]);
        assert!(face.value().is_known() && face.records.len() == MAX_RECORDS);
        assert!(face.records.iter().all(|r| r.source != 0));
    }

    #[test]
    fn nothing_beyond_the_range() {
        let mut face = FaceField::new();
        assert!(!face.choose(Time(0), LIMITS, &[offer(50, 1, 1, 0)]));
        assert!(face.choose(Time(0), LIMITS, &[offer(49, 1, 1, 0)]));
    }
}

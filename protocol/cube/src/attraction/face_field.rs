//! The attraction of one face: the distances offered to it, the one it follows, and the memory that keeps it
//! from following its own echo.

use super::super::message::Entry;
use alloc::vec::Vec;
use core::hash::{Hash, Hasher};
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::time::{Span, Time};

/// The largest number of sources remembered per face.
pub(super) const MAX_RECORDS: usize = 16;

/// Stored values of one source.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Record {
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
    /// The offered value.
    pub entry: Entry,
    /// The distance to add to `entry`'s, in the unit of [`Entry::distance`]; at least 1.
    pub cost: u16,
    /// The face over which the offer came, plus [`super::OWN`] or [`super::SAME_CELL`] where that applies.
    pub via: u8,
}

/// Limits within which distances are used.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub hold: Span,
    /// The largest distance, in the unit of [`Entry::distance`].
    pub range: u16,
    pub accept_stale: bool,
}

/// The value of one face and the memory behind it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct FaceField {
    value: Entry,
    /// `Offer::via` of the chosen offer; 255 if none was chosen.
    pub via: u8,
    /// The index of the record of the value's source, if an offer was chosen.
    chosen: u8,
    pub records: Vec<Record>,
}

impl Hash for FaceField {
    /// Leaves out `chosen`, which follows from the other fields.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let FaceField { value, via, chosen: _, records } = self;
        (value, via, records).hash(hasher);
    }
}

/// Returns true if version `a` is newer than `b`, modulo 2¹⁶.
pub(super) fn newer(a: u16, b: u16) -> bool {
    (1..0x8000).contains(&a.wrapping_sub(b))
}

impl FaceField {
    pub fn new() -> FaceField {
        FaceField { value: Entry::NONE, via: u8::MAX, chosen: 0, records: Vec::new() }
    }

    pub fn value(&self) -> Entry {
        self.value
    }

    /// Sets a value that comes from no offer. Returns true if the value changed.
    pub fn set(&mut self, value: Entry) -> bool {
        let changed = self.value != value;
        (self.value, self.via, self.chosen) = (value, u8::MAX, 0);
        changed
    }

    /// Chooses the nearest feasible offer. Returns true if the value changed.
    pub fn choose(&mut self, now: Time, limits: Limits, offers: &[Offer]) -> bool {
        let mut best: Option<(u16, Offer)> = None;
        for offer in offers {
            let distance = offer.entry.distance.saturating_add(offer.cost);
            if !offer.entry.is_known() || distance > limits.range {
                continue;
            }
            let better = best.is_none_or(|(least, b)| {
                distance < least || (distance == least && newer(offer.entry.version, b.entry.version))
            });
            if better && self.feasible(now, limits, offer) {
                best = Some((distance, *offer));
            }
        }
        let Some((distance, offer)) = best else { return self.set(Entry::NONE) };
        let Some(chosen) = self.remember(now, limits, distance, &offer) else {
            return self.set(Entry::NONE);
        };
        let value = Entry { distance, ..offer.entry };
        let changed = self.value != value;
        (self.value, self.via, self.chosen) = (value, offer.via, chosen);
        changed
    }

    /// Notes that the same choice has been made again.
    pub fn renew(&mut self, now: Time) {
        if self.via != u8::MAX
            && let Some(record) = self.records.get_mut(usize::from(self.chosen))
        {
            record.used = now;
        }
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
            (false, ..) => hit(CoveragePoint::CubeStaleVersion),
            (_, false, _) => hit(CoveragePoint::CubeVersionExpired),
            (.., false) => hit(CoveragePoint::CubeNotCloser),
            _ => {}
        }
        current && fresh && closer
    }

    /// Notes the choice and returns the index of its record; `None` if there is no room to remember its
    /// source.
    fn remember(&mut self, now: Time, limits: Limits, distance: u16, offer: &Offer) -> Option<u8> {
        let (source, version) = (offer.entry.source, offer.entry.version);
        if let Some(i) = self.records.iter().position(|r| r.source == source) {
            let record = &mut self.records[i];
            if record.version == version {
                record.feasible = record.feasible.min(distance);
            } else {
                (record.version, record.feasible, record.first) = (version, distance, now);
            }
            record.used = now;
            return Some(i as u8);
        }
        if self.records.len() == MAX_RECORDS {
            let oldest = (0..MAX_RECORDS).min_by_key(|i| self.records[*i].used);
            match oldest {
                Some(i) if now.since(self.records[i].used) > limits.hold * 2 => {
                    hit(CoveragePoint::CubeSourceForgotten);
                    self.records.swap_remove(i);
                }
                _ => {
                    hit(CoveragePoint::CubeSourcesFull);
                    return None;
                }
            }
        }
        self.records.push(Record { source, version, feasible: distance, first: now, used: now });
        Some(self.records.len() as u8 - 1)
    }

    /// Returns when the version of the current value was first heard.
    pub fn heard(&self) -> Time {
        self.records.iter().find(|r| r.source == self.value.source).map_or(Time::NEVER, |r| r.first)
    }

    /// Returns when the current value ceases to be usable unless it is renewed.
    pub fn expires(&self, hold: Span) -> Time {
        if self.via == u8::MAX {
            return Time::NEVER;
        }
        self.records.get(usize::from(self.chosen)).map_or(Time::NEVER, |r| r.first + hold + Span(1))
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
    fn follows_only_offers_closer_than_all_it_has_advertised() {
        let mut face = FaceField::new();
        assert!(face.choose(Time(0), LIMITS, &[offer(4, 1, 1, 0)]));
        assert_eq!(face.value().distance, 5);
        // The neighbour's neighbour that follows this one offers 6 when the source has gone: refused.
        face.choose(Time(1), LIMITS, &[offer(6, 1, 1, 1)]);
        assert!(!face.value().is_known());
        // The next version of the source is accepted again.
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
        assert!(!face.value().is_known(), "no room for another source");
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

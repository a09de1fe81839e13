//! The attraction of one face: the distances offered to it, the one it follows, and the memory that keeps it
//! from following its own echo.

use super::super::message::Entry;
use alloc::vec::Vec;
use core::hash::{Hash, Hasher};
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::time::{Span, Time};

/// The largest number of sources remembered per face.
const MAX_RECORDS: usize = 16;

/// Stored values of one source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
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
#[derive(Clone, Debug)]
pub(super) struct FaceField {
    value: Entry,
    /// `Offer::via` of the chosen offer; 255 if none was chosen.
    pub via: u8,
    /// The index of the record of the value's source, if an offer was chosen.
    chosen: u8,
    /// That record. It is kept here, and not in `records`, because most offers are of the source that is followed already, and
    /// in a large swarm each look at the heap waits for the memory.
    current: Record,
    /// The records of all sources; the one of `current` is outdated.
    records: Vec<Record>,
}

impl PartialEq for FaceField {
    fn eq(&self, other: &FaceField) -> bool {
        self.parts() == other.parts() && self.records().eq(other.records())
    }
}

impl Eq for FaceField {}

impl Hash for FaceField {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.parts().hash(hasher);
        self.records.len().hash(hasher);
        self.records().for_each(|record| record.hash(hasher));
    }
}

/// Returns true if version `a` is newer than `b`, modulo 2¹⁶.
pub(super) fn newer(a: u16, b: u16) -> bool {
    (1..0x8000).contains(&a.wrapping_sub(b))
}

impl FaceField {
    pub fn new() -> FaceField {
        let current = Record { source: 0, version: 0, feasible: 0, first: Time::ZERO, used: Time::ZERO };
        FaceField { value: Entry::NONE, via: u8::MAX, chosen: 0, current, records: Vec::new() }
    }

    /// Returns the state without its memory.
    fn parts(&self) -> (Entry, u8) {
        (self.value, self.via)
    }
    /// Returns the record that is kept apart, if an offer was chosen.
    fn current(&self) -> Option<&Record> {
        (self.via != u8::MAX).then_some(&self.current)
    }
    /// Iterates over the records of all sources.
    fn records(&self) -> impl Iterator<Item = &Record> {
        let current = self.current();
        let chosen = usize::from(self.chosen);
        let up_to_date = move |(i, record)| current.filter(|_| i == chosen).unwrap_or(record);
        self.records.iter().enumerate().map(up_to_date)
    }
    /// Returns the record of a source.
    fn record(&self, source: u32) -> Option<&Record> {
        let current = self.current().filter(|record| record.source == source);
        current.or_else(|| self.records.iter().find(|record| record.source == source))
    }
    /// Returns true if no other source can be remembered.
    pub fn is_full(&self) -> bool {
        self.records.len() == MAX_RECORDS
    }

    pub fn value(&self) -> Entry {
        self.value
    }

    /// Sets a value that comes from no offer. Returns true if the value changed.
    pub fn set(&mut self, value: Entry) -> bool {
        let changed = self.value != value;
        self.put_back();
        self.value = value;
        changed
    }

    /// Puts the record that is kept apart back among the others.
    fn put_back(&mut self) {
        if let Some(current) = self.current().copied()
            && let Some(record) = self.records.get_mut(usize::from(self.chosen))
        {
            *record = current;
        }
        self.via = u8::MAX;
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
        if !self.remember(now, limits, distance, &offer) {
            return self.set(Entry::NONE);
        }
        let value = Entry { distance, ..offer.entry };
        let changed = self.value != value;
        (self.value, self.via) = (value, offer.via);
        changed
    }

    /// Notes that the same choice has been made again.
    pub fn renew(&mut self, now: Time) {
        // Outdated if no offer was chosen, which does no harm.
        self.current.used = now;
    }

    fn feasible(&self, now: Time, limits: Limits, offer: &Offer) -> bool {
        let Some(record) = self.record(offer.entry.source) else { return true };
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

    /// Notes the choice, and keeps the record of its source apart. Returns false if there is no room to remember its source.
    fn remember(&mut self, now: Time, limits: Limits, distance: u16, offer: &Offer) -> bool {
        let (source, version) = (offer.entry.source, offer.entry.version);
        if self.current().is_none_or(|record| record.source != source) {
            self.put_back();
            let new = Record { source, version, feasible: distance, first: now, used: now };
            let Some(chosen) = self.place_of(now, limits, new) else { return false };
            (self.chosen, self.current) = (chosen as u8, self.records[chosen]);
        }
        let record = &mut self.current;
        if record.version == version {
            record.feasible = record.feasible.min(distance);
        } else {
            (record.version, record.feasible, record.first) = (version, distance, now);
        }
        record.used = now;
        true
    }

    /// Returns the index of the record of a source, which is `new` if there was none; `None` if there is no room for it.
    fn place_of(&mut self, now: Time, limits: Limits, new: Record) -> Option<usize> {
        let known = self.records.iter().position(|record| record.source == new.source);
        if known.is_some() {
            return known;
        }
        if self.is_full() {
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
        self.records.push(new);
        Some(self.records.len() - 1)
    }

    /// Returns when the version of the current value was first heard.
    pub fn heard(&self) -> Time {
        self.record(self.value.source).map_or(Time::NEVER, |record| record.first)
    }

    /// Returns when the current value ceases to be usable unless it is renewed.
    pub fn expires(&self, hold: Span) -> Time {
        self.current().map_or(Time::NEVER, |record| record.first + hold + Span(1))
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
        assert!(face.value().is_known() && face.is_full());
        assert!(face.records().all(|record| record.source != 0));
    }

    #[test]
    fn nothing_beyond_the_range() {
        let mut face = FaceField::new();
        assert!(!face.choose(Time(0), LIMITS, &[offer(50, 1, 1, 0)]));
        assert!(face.choose(Time(0), LIMITS, &[offer(49, 1, 1, 0)]));
    }
}

//! Sets of postures of a metamodule as bits, and turns of a joint applied to a whole set.
//!
//! A posture is six joint values with 3, 4, 3, 3, 4 and 3 positions. The outer joints of the first module and
//! the first joint of the second choose a word, the other three a bit in it, so that turning one of those
//! three moves bits within words.

use metamorph_roombots::posture::{MAX_JOINTS, Posture};

/// Number of words of 64 bits, of which 48 are in use.
const WORDS: usize = 27;
/// Mask of the bits in use in each word.
const USED: u64 = (1 << 48) - 1;

/// A set of postures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PostureSet([u64; WORDS]);

/// The number of a posture in a [`PostureSet`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PostureIndex(u16);

impl PostureIndex {
    /// Bound of the numbers.
    pub const COUNT: usize = WORDS * 64;

    /// Returns the number of a posture of a metamodule.
    pub fn of(posture: Posture) -> PostureIndex {
        match *posture.steps() {
            [a, b, c, d, e, f] => {
                PostureIndex((u16::from((a * 3 + c) * 3 + d)) << 6 | u16::from(f * 16 + b * 4 + e))
            }
            // Invariant: only metamodules have a graph, and all of theirs have six joints.
            _ => PostureIndex(0),
        }
    }
    /// Returns the number as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// By joint: the postures from which it may turn one position forwards.
pub type Turns = [PostureSet; MAX_JOINTS];

impl PostureSet {
    /// The empty set.
    pub const NONE: PostureSet = PostureSet([0; WORDS]);
    /// No joint may turn.
    pub const NO_TURNS: Turns = [PostureSet::NONE; MAX_JOINTS];

    /// Adds a posture.
    pub fn add(&mut self, place: PostureIndex) {
        self.0[place.index() / 64] |= 1 << (place.0 % 64);
    }
    /// True if the posture is in the set.
    pub fn has(&self, place: PostureIndex) -> bool {
        self.0[place.index() / 64] >> (place.0 % 64) & 1 == 1
    }
    /// True if the set is empty.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|w| *w == 0)
    }
    /// Adds all postures of another set.
    #[inline]
    pub fn add_all(&mut self, other: &PostureSet) {
        self.0.iter_mut().zip(&other.0).for_each(|(word, other)| *word |= other);
    }
    /// Removes all postures of another set.
    #[inline]
    pub fn remove_all(&mut self, other: &PostureSet) {
        self.0.iter_mut().zip(&other.0).for_each(|(word, other)| *word &= !other);
    }
    /// Returns the postures in both sets.
    #[inline]
    pub fn and(mut self, other: &PostureSet) -> PostureSet {
        self.0.iter_mut().zip(&other.0).for_each(|(word, other)| *word &= other);
        self
    }
    /// Returns the postures that are not in `other`.
    #[inline]
    pub fn without(mut self, other: &PostureSet) -> PostureSet {
        self.remove_all(other);
        self
    }
    /// Iterates over the set in ascending order.
    pub fn iter(&self) -> impl Iterator<Item = PostureIndex> + '_ {
        (0..WORDS as u16).zip(&self.0).flat_map(|(i, word)| {
            let mut word = *word;
            std::iter::from_fn(move || {
                let bit = (word != 0).then(|| word.trailing_zeros() as u16)?;
                word &= word - 1;
                Some(PostureIndex(i << 6 | bit))
            })
        })
    }

    /// Returns the postures one turn away from the set. For each joint `turns` holds the postures from which
    /// it may turn one position forwards, or into which it may turn back.
    pub fn spread(&self, turns: &Turns) -> PostureSet {
        let mut to = PostureSet::NONE;
        self.turn_between_words::<9>(&turns[0], &mut to);
        self.turn_within_words(&turns[1], &mut to, 4, 0xFFF0_FFF0_FFF0, 12);
        self.turn_between_words::<3>(&turns[2], &mut to);
        self.turn_between_words::<1>(&turns[3], &mut to);
        self.turn_within_words(&turns[4], &mut to, 1, 0xEEEE_EEEE_EEEE, 3);
        self.turn_within_words(&turns[5], &mut to, 16, 0xFFFF_FFFF_0000, 32);
        to
    }

    /// Turns a joint whose three values lie `APART` words apart.
    #[inline]
    fn turn_between_words<const APART: usize>(&self, free: &PostureSet, to: &mut PostureSet) {
        for block in (0..WORDS).step_by(3 * APART) {
            for value in 0..3 {
                let (from, next) = (block + value * APART, block + (value + 1) % 3 * APART);
                for i in 0..APART {
                    let free = free.0[from + i];
                    to.0[next + i] |= self.0[from + i] & free;
                    to.0[from + i] |= self.0[next + i] & free;
                }
            }
        }
    }

    /// Turns a joint whose values lie within each word: forwards moves bits up into `moved`, or down to the
    /// other bits at the end of the range.
    #[inline]
    fn turn_within_words(&self, free: &PostureSet, to: &mut PostureSet, up: u32, moved: u64, down: u32) {
        let wrapped = USED & !moved;
        for i in 0..WORDS {
            let (word, free) = (self.0[i], free.0[i]);
            let from = word & free;
            let forwards = from << up & moved | from >> down & wrapped;
            let back = word >> up & moved >> up | word << down & wrapped << down;
            to.0[i] |= forwards | back & free;
        }
    }

    /// Returns the postures reachable by any number of turns, the set itself included.
    pub fn flood(mut self, turns: &Turns) -> PostureSet {
        loop {
            let more = self.spread(turns).without(&self);
            if more.is_empty() {
                return self;
            }
            self.add_all(&more);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_roombots::Kind;
    use metamorph_roombots::posture::values;

    #[test]
    fn turning_a_set_turns_each_of_it() {
        let mut seen = PostureSet::NONE;
        for posture in Posture::all(Kind::Par) {
            let place = PostureIndex::of(posture);
            assert!(!seen.has(place) && place.index() < PostureIndex::COUNT);
            seen.add(place);
            let mut one = PostureSet::NONE;
            one.add(place);
            for joint in 0..MAX_JOINTS {
                let back = (1..values(joint)).fold(posture, |p, _| p.turned(joint));
                let (mut turns, mut to) = (PostureSet::NO_TURNS, PostureSet::NONE);
                assert!(one.spread(&turns).is_empty());
                turns[joint].add(place);
                to.add(PostureIndex::of(posture.turned(joint)));
                assert_eq!(one.spread(&turns), to, "{posture:?} {joint}");
                turns[joint].add(PostureIndex::of(back));
                to.add(PostureIndex::of(back));
                assert_eq!(one.spread(&turns), to, "{posture:?} {joint}");
            }
        }
        assert_eq!(seen.iter().count(), 1296);
        let all = [seen; MAX_JOINTS];
        let mut zero = PostureSet::NONE;
        zero.add(PostureIndex::of(Posture::zero(Kind::Par)));
        assert_eq!(zero.spread(&all).iter().count(), 12);
        assert_eq!(zero.flood(&all), seen);
        assert_eq!(zero.flood(&PostureSet::NO_TURNS), zero);
    }
}

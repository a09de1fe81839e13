//! Sets of postures of a metamodule as bits, and what turning a joint does to all of a set at once.
//!
//! A posture is six joint values (three, four, three, and again). The outer joints of the first module
//! and the first of the second choose a word; the other three choose a bit in it, so that turning one of
//! them moves bits within words.

use crate::roombots::posture::{MAX_JOINTS, Posture};

const WORDS: usize = 27;

/// A set of postures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Postures([u64; WORDS]);

/// The number of a posture in such sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place(u16);

impl Place {
    /// There are no more numbers than this.
    pub const COUNT: usize = WORDS * 64;

    /// That of a posture of a metamodule.
    pub fn of(posture: Posture) -> Place {
        match *posture.steps() {
            [a, b, c, d, e, f] => {
                Place((u16::from((a * 3 + c) * 3 + d)) << 6 | u16::from(f * 16 + b * 4 + e))
            }
            _ => Place(0),
        }
    }
    /// The same as an index.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// For every joint the postures that it may turn from, one step forwards.
pub type Turns = [Postures; MAX_JOINTS];

impl Postures {
    /// No posture.
    pub const NONE: Postures = Postures([0; WORDS]);
    /// No joint may turn.
    pub const NO_TURNS: Turns = [Postures::NONE; MAX_JOINTS];

    /// Adds one.
    pub fn add(&mut self, place: Place) {
        self.0[place.index() / 64] |= 1 << (place.0 % 64);
    }
    /// Whether it is in the set.
    pub fn has(&self, place: Place) -> bool {
        self.0[place.index() / 64] >> (place.0 % 64) & 1 == 1
    }
    /// Whether no posture is in the set.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|w| *w == 0)
    }
    /// Whether a posture is in both sets.
    pub fn meets(&self, other: &Postures) -> bool {
        self.0.iter().zip(&other.0).any(|(a, b)| a & b != 0)
    }
    /// Those in either set.
    #[inline(always)]
    pub fn or(&self, other: &Postures) -> Postures {
        self.with(other, |a, b| a | b)
    }
    /// Those in both sets.
    #[inline(always)]
    pub fn and(&self, other: &Postures) -> Postures {
        self.with(other, |a, b| a & b)
    }
    /// Those that are not in the other set.
    #[inline(always)]
    pub fn without(&self, other: &Postures) -> Postures {
        self.with(other, |a, b| a & !b)
    }
    // Loops over words, not iterators that make arrays: these become vector instructions.
    #[inline(always)]
    fn with(&self, other: &Postures, f: impl Fn(u64, u64) -> u64) -> Postures {
        let mut to = *self;
        for (word, other) in to.0.iter_mut().zip(&other.0) {
            *word = f(*word, *other);
        }
        to
    }
    /// All of them, in the order of their numbers.
    pub fn iter(&self) -> impl Iterator<Item = Place> + '_ {
        (0..WORDS as u16).zip(&self.0).flat_map(|(i, word)| {
            let mut word = *word;
            std::iter::from_fn(move || {
                let bit = (word != 0).then(|| word.trailing_zeros() as u16)?;
                word &= word - 1;
                Some(Place(i << 6 | bit))
            })
        })
    }

    /// All postures of the set after a joint has turned one step forwards.
    #[inline(always)]
    pub fn turned(&self, joint: usize) -> Postures {
        match joint {
            0 => self.rows::<9>(1),
            1 => self.bits(4, 0xFFF0_FFF0_FFF0, 12, 0x000F_000F_000F),
            2 => self.rows::<3>(1),
            3 => self.rows::<1>(1),
            4 => self.bits(1, 0xEEEE_EEEE_EEEE, 3, 0x1111_1111_1111),
            _ => self.bits(16, 0xFFFF_FFFF_0000, 32, 0xFFFF),
        }
    }
    /// All postures of the set before a joint has turned one step forwards.
    #[inline(always)]
    pub fn turned_back(&self, joint: usize) -> Postures {
        match joint {
            0 => self.rows::<9>(2),
            1 => self.bits(12, 0xF000_F000_F000, 4, 0x0FFF_0FFF_0FFF),
            2 => self.rows::<3>(2),
            3 => self.rows::<1>(2),
            4 => self.bits(3, 0x8888_8888_8888, 1, 0x7777_7777_7777),
            _ => self.bits(32, 0xFFFF_0000_0000, 16, 0xFFFF_FFFF),
        }
    }
    /// Words move on by so many steps of the joint whose values are this far apart.
    #[inline(always)]
    fn rows<const APART: usize>(&self, steps: usize) -> Postures {
        let mut to = [0; WORDS];
        for (from, block) in self.0.chunks_exact(3 * APART).enumerate() {
            let first = from * 3 * APART;
            for value in 0..3 {
                let at = first + (value + steps) % 3 * APART;
                to[at..at + APART].copy_from_slice(&block[value * APART..(value + 1) * APART]);
            }
        }
        Postures(to)
    }
    /// Bits move up, and those at the end of their range down to its beginning.
    #[inline(always)]
    fn bits(&self, up: u32, moved: u64, down: u32, wrapped: u64) -> Postures {
        let mut to = *self;
        for word in &mut to.0 {
            *word = *word << up & moved | *word >> down & wrapped;
        }
        to
    }

    /// What turning one joint once, either way, leads to from the set.
    #[inline(always)]
    fn turns_of(&self, joint: usize, free: &Postures) -> Postures {
        self.and(free).turned(joint).or(&self.turned_back(joint).and(free))
    }
    /// What one turn leads to from the set.
    pub fn spread(&self, turns: &Turns) -> Postures {
        let mut to = self.turns_of(0, &turns[0]);
        to = to.or(&self.turns_of(1, &turns[1]));
        to = to.or(&self.turns_of(2, &turns[2]));
        to = to.or(&self.turns_of(3, &turns[3]));
        to = to.or(&self.turns_of(4, &turns[4]));
        to.or(&self.turns_of(5, &turns[5]))
    }
    /// What any number of turns lead to from the set, with the set itself.
    pub fn flood(mut self, turns: &Turns) -> Postures {
        loop {
            let before = self;
            self = self.or(&self.turns_of(0, &turns[0]));
            self = self.or(&self.turns_of(1, &turns[1]));
            self = self.or(&self.turns_of(2, &turns[2]));
            self = self.or(&self.turns_of(3, &turns[3]));
            self = self.or(&self.turns_of(4, &turns[4]));
            self = self.or(&self.turns_of(5, &turns[5]));
            if self == before {
                return self;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::roombots::Kind;

    #[test]
    fn turning_a_set_turns_each_of_it() {
        let mut seen = Postures::NONE;
        for posture in Posture::all(Kind::Par) {
            let place = Place::of(posture);
            assert!(!seen.has(place) && place.index() < Place::COUNT);
            seen.add(place);
            let mut one = Postures::NONE;
            one.add(place);
            for joint in 0..MAX_JOINTS {
                let mut to = Postures::NONE;
                to.add(Place::of(posture.turned(joint)));
                assert_eq!(one.turned(joint), to, "{posture:?} {joint}");
                assert_eq!(to.turned_back(joint), one, "{posture:?} {joint}");
            }
        }
        assert_eq!(seen.iter().count(), 1296);
        let all = [seen; MAX_JOINTS];
        let mut zero = Postures::NONE;
        zero.add(Place::of(Posture::zero(Kind::Par)));
        assert_eq!(zero.spread(&all).iter().count(), 12);
        assert_eq!(zero.flood(&all), seen);
        assert_eq!(zero.flood(&Postures::NO_TURNS), zero);
    }
}

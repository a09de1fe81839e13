//! Named random streams: every source of randomness in a run draws from its own, derived from the seed of the
//! run, so that an additional draw in one place changes no other.
//!
//! SplitMix64 (Steele, Lea, Flood: "Fast splittable pseudorandom number generators", 2014). It is written out
//! here because its output is part of the determinism contract and its whole state must be a hashable integer
//! inside an agent's state.

use crate::ratio::Ratio;
use serde::{Deserialize, Serialize};

/// One stream of random numbers.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Rng {
    state: u64,
}

impl Rng {
    /// Returns the stream number `index` of `source` in the run of `seed`.
    // Inlined into a loop that draws many streams, its chain of mixing keeps the vectorizer of LLVM 22 busy forever.
    #[inline(never)]
    pub fn named(seed: u64, source: &str, index: u64) -> Rng {
        let mut state = mix(seed ^ 0x9E37_79B9_7F4A_7C15);
        for byte in source.bytes() {
            state = mix(state ^ u64::from(byte));
        }
        Rng { state: mix(state ^ index.wrapping_mul(0xD6E8_FEB8_6659_FD93)) }
    }

    /// Draws 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        mix(self.state)
    }

    /// Draws a number below `n`, and 0 for `n = 0`. The bias is below 2^-32 for every `n` in use.
    pub fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.next_u64()) * u128::from(n)) >> 64) as u64
    }

    /// Draws whether an event of this probability happens. Draws nothing if the probability is 0.
    pub fn chance(&mut self, p: Ratio) -> bool {
        !p.is_zero() && self.below(p.den().into()) < p.num().into()
    }
}

const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The published first outputs of SplitMix64 for state 0.
    #[test]
    fn is_splitmix64() {
        let mut s = Rng { state: 0 };
        assert_eq!(
            [s.next_u64(), s.next_u64(), s.next_u64()],
            [0xE220_A839_7B1D_CDAF, 0x6E78_9E6A_A1B9_65F4, 0x06C4_5D18_8009_454F]
        );
    }

    #[test]
    fn streams_differ_by_seed_name_and_index() {
        let first = |seed, name, index| Rng::named(seed, name, index).next_u64();
        let all = [first(1, "link", 0), first(2, "link", 0), first(1, "body", 0), first(1, "link", 1)];
        for (i, a) in all.iter().enumerate() {
            assert!(all[i + 1..].iter().all(|b| a != b));
        }
    }

    #[test]
    fn chance_matches_its_ratio() {
        let mut s = Rng::named(7, "test", 0);
        let p: Ratio = "5%".parse().unwrap();
        let hits = (0..100_000).filter(|_| s.chance(p)).count();
        assert!((4_700..5_300).contains(&hits), "{hits}");
        assert!(!s.chance(Ratio::ZERO) && s.chance(Ratio::ONE));
    }
}

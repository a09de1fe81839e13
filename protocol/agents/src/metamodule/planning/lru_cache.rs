//! A cache for recurring questions. It affects the time an answer takes, never the answer, so agents that
//! share one stay independent of each other.

use std::sync::{Mutex, PoisonError};

/// Answers by question, in sets of four with LRU replacement.
pub struct Memo<K, V> {
    sets: Mutex<Vec<Set<K, V>>>,
    count: usize,
}

/// Number of entries of a set: the cache is set-associative.
const SET_LEN: usize = 4;
/// Most recently used first.
type Set<K, V> = [Option<(K, V)>; SET_LEN];

impl<K, V> Memo<K, V> {
    /// Returns an empty cache for `answers` answers, a multiple of four. Memory is allocated on first use.
    pub const fn new(answers: usize) -> Memo<K, V> {
        Memo { sets: Mutex::new(Vec::new()), count: answers / SET_LEN }
    }

    fn put(&self, hash: u64, question: K, answer: V) {
        let mut sets = self.sets.lock().unwrap_or_else(PoisonError::into_inner);
        if sets.is_empty() {
            sets.resize_with(self.count, || [const { None }; SET_LEN]);
        }
        let set = &mut sets[hash as usize % self.count];
        let free = set.iter().position(Option::is_none).unwrap_or(SET_LEN - 1);
        set[..=free].rotate_right(1);
        set[0] = Some((question, answer));
    }

    /// Returns the cached answer, or the one that `find` computes.
    pub fn answer(&self, hash: u64, question: K, find: impl FnOnce(&K) -> V) -> V
    where
        K: PartialEq,
        V: Clone,
    {
        {
            let mut sets = self.sets.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(set) = sets.get_mut(hash as usize % self.count) {
                let is_it = |slot: &Option<(K, V)>| slot.as_ref().is_some_and(|(k, _)| *k == question);
                if let Some(at) = set.iter().position(is_it) {
                    set[..=at].rotate_right(1);
                    if let Some((_, answer)) = &set[0] {
                        return answer.clone();
                    }
                }
            }
        }
        let answer = find(&question);
        self.put(hash, question, answer.clone());
        answer
    }
}

/// Mixes a number into a hash.
pub fn mix(hash: u64, number: u64) -> u64 {
    let mixed = (hash ^ number).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    mixed ^ mixed >> 29
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_the_latest_and_forgets_the_least_used() {
        let memo: Memo<u32, u32> = Memo::new(4);
        let found = std::cell::Cell::new(0);
        let ask = |q: u32| {
            memo.answer(0, q, |q| {
                found.set(found.get() + 1);
                q * 10
            })
        };
        assert_eq!([1, 2, 3, 4, 1].map(ask), [10, 20, 30, 40, 10]);
        assert_eq!(found.get(), 4);
        ask(5);
        assert_eq!(ask(1), 10);
        assert_eq!(found.get(), 5, "1 was used last but for 5 and is still there");
        ask(2);
        assert_eq!(found.get(), 6, "2 had to go");
    }
}

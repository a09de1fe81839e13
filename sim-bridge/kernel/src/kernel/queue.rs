//! The queue of the event kernel: ordered by due time, and at the same instant by the order of scheduling.
//!
//! A calendar of two wheels (Varghese and Lauck, 1987; Brown, 1988), because delays of messages are bounded:
//! the near wheel has a slot for every part of a block of time, the far wheel one for each of the blocks that
//! follow, and a heap holds the few events beyond. Scheduling is a push to the end of a slot. A slot is
//! sorted when its turn comes, by time alone: the sort is stable, and entries are in a slot in the order in
//! which they were scheduled, so no entry has to carry its number. Not here: cancelling events; the caller
//! knows whether an event still counts.

use metamorph_core::time::{Span, Time};
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// Number of slots of the near wheel.
const SLOT_COUNT: usize = 1 << SLOT_BITS;
const SLOT_BITS: u32 = 10;
/// Number of blocks of the far wheel, including the present one; a power of two.
const BLOCKS: u64 = 256;
/// The least time that a block covers, however short the delays: timers are longer.
const SHORTEST_BLOCK: Span = Span::millis(200);

/// An event in the queue.
#[derive(Clone, Copy)]
pub struct Entry<T> {
    /// The due time.
    pub at: Time,
    /// The event.
    pub what: T,
}

/// An entry of a heap, numbered because a heap does not keep entries of the same time in order.
#[derive(Clone)]
struct Numbered<T> {
    number: u64,
    entry: Entry<T>,
}

impl<T> Numbered<T> {
    fn key(&self) -> (Time, u64) {
        (self.entry.at, self.number)
    }
}
impl<T> PartialEq for Numbered<T> {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}
impl<T> Eq for Numbered<T> {}
impl<T> PartialOrd for Numbered<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl<T> Ord for Numbered<T> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key().cmp(&other.key())
    }
}

/// A queue of events.
#[derive(Clone)]
pub struct Queue<T> {
    /// Logarithm of the duration of a slot in nanoseconds. Slots are numbered from time zero, blocks as well.
    shift: u32,
    /// All slots before this one have been opened; entries scheduled for them are late.
    opened: u64,
    /// The block whose slots are the near wheel.
    block: u64,
    /// The slot opened last, sorted, and the number of its entries that have been taken.
    current: Vec<Entry<T>>,
    taken: usize,
    late: BinaryHeap<Reverse<Numbered<T>>>,
    near: Vec<Vec<Entry<T>>>,
    /// The slots of the near wheel that hold anything, a bit each.
    occupied: [u64; SLOT_COUNT / 64],
    blocks: Vec<Vec<Entry<T>>>,
    in_blocks: usize,
    beyond: BinaryHeap<Reverse<Numbered<T>>>,
    number: u64,
    /// Empty lists that keep their memory, for slots that need one.
    spare: Vec<Vec<Entry<T>>>,
    /// The same for blocks, which hold a thousand times as much as a slot.
    spare_blocks: Vec<Vec<Entry<T>>>,
}

impl<T: Copy> Queue<T> {
    /// Creates an empty queue, laid out for delays of up to `longest`; longer ones are only slower.
    pub fn new(longest: Span) -> Queue<T> {
        let block = (longest * 4).max(SHORTEST_BLOCK).0.checked_next_power_of_two().unwrap_or(1 << 63);
        Queue {
            shift: block.trailing_zeros() - SLOT_BITS,
            opened: 0,
            block: 0,
            current: Vec::new(),
            taken: 0,
            late: BinaryHeap::new(),
            near: (0..SLOT_COUNT).map(|_| Vec::new()).collect(),
            occupied: [0; SLOT_COUNT / 64],
            blocks: (0..BLOCKS).map(|_| Vec::new()).collect(),
            in_blocks: 0,
            beyond: BinaryHeap::new(),
            number: 0,
            spare: Vec::new(),
            spare_blocks: Vec::new(),
        }
    }

    /// Schedules `what`.
    pub fn push(&mut self, at: Time, what: T) {
        let entry = Entry { at, what };
        let slot = at.0 >> self.shift;
        let block = slot >> SLOT_BITS;
        if slot < self.opened {
            self.number += 1;
            self.late.push(Reverse(Numbered { number: self.number, entry }));
        } else if block == self.block {
            self.put_near(slot, entry);
        } else if block - self.block < BLOCKS {
            self.put_far(block, entry);
        } else {
            self.number += 1;
            self.beyond.push(Reverse(Numbered { number: self.number, entry }));
        }
    }

    /// Returns when the next event is due; [`Time::NEVER`] if there is none.
    pub fn next_at(&mut self) -> Time {
        self.open_next();
        let current = self.current.get(self.taken).map_or(Time::NEVER, |e| e.at);
        self.late.peek().map_or(current, |Reverse(l)| l.entry.at.min(current))
    }

    /// Returns the sorted entries that come next, unless others are scheduled before them.
    pub fn coming(&self) -> &[Entry<T>] {
        &self.current[self.taken..]
    }
    /// Returns how many of them have been taken since they were sorted.
    pub fn taken(&self) -> usize {
        self.taken
    }

    /// Takes the next event.
    pub fn pop(&mut self) -> Option<(Time, T)> {
        self.open_next();
        let current = self.current.get(self.taken).copied();
        // A late entry was scheduled after all entries of the slot.
        let late = self.late.peek().is_some_and(|Reverse(l)| current.is_none_or(|c| l.entry.at < c.at));
        let entry = if late {
            self.late.pop().map(|Reverse(l)| l.entry)
        } else {
            self.taken += usize::from(current.is_some());
            current
        };
        entry.map(|e| (e.at, e.what))
    }

    fn put_near(&mut self, slot: u64, entry: Entry<T>) {
        let i = slot as usize % SLOT_COUNT;
        let list = &mut self.near[i];
        if list.is_empty() {
            self.occupied[i / 64] |= 1 << (i % 64);
            if list.capacity() == 0 {
                *list = self.spare.pop().unwrap_or_default();
            }
        }
        list.push(entry);
    }

    fn put_far(&mut self, block: u64, entry: Entry<T>) {
        let list = &mut self.blocks[(block % BLOCKS) as usize];
        if list.capacity() == 0 {
            *list = self.spare_blocks.pop().unwrap_or_default();
        }
        list.push(entry);
        self.in_blocks += 1;
    }

    /// Opens slots until there is an entry to take, or none at all.
    fn open_next(&mut self) {
        // Late entries are due before every slot that is still closed.
        while self.taken == self.current.len() && self.late.is_empty() {
            if let Some(i) = self.first_occupied() {
                self.occupied[i / 64] &= !(1 << (i % 64));
                let mut done = std::mem::replace(&mut self.current, std::mem::take(&mut self.near[i]));
                done.clear();
                self.spare.push(done);
                self.taken = 0;
                self.current.sort_by_key(|e| e.at);
                self.opened = (self.block << SLOT_BITS) + i as u64 + 1;
            } else if !self.next_block() {
                return;
            }
        }
    }

    /// Returns the first slot of the block, not yet opened, that holds anything.
    fn first_occupied(&self) -> Option<usize> {
        // Opened slots are empty, so all bits may be read.
        let word = self.occupied.iter().position(|w| *w != 0)?;
        Some(word * 64 + self.occupied[word].trailing_zeros() as usize)
    }

    /// Advances to the next block that holds anything; returns false if there is none.
    fn next_block(&mut self) -> bool {
        let holds = |b: &u64| !self.blocks[(b % BLOCKS) as usize].is_empty();
        let beyond = self.beyond.peek().map(|Reverse(b)| self.block_of(b.entry.at));
        let next = match self.in_blocks {
            0 => beyond,
            _ => (self.block + 1..self.block + BLOCKS).find(holds),
        };
        let Some(next) = next else { return false };
        self.block = next;
        self.opened = next << SLOT_BITS;
        // Entries that come into reach go first, so that they lie before those scheduled from now on.
        while let Some(Reverse(first)) = self.beyond.peek()
            && self.block_of(first.entry.at) - next < BLOCKS
        {
            let Some(Reverse(Numbered { entry, .. })) = self.beyond.pop() else { break };
            self.put_far(self.block_of(entry.at), entry);
        }
        let mut list = std::mem::take(&mut self.blocks[(next % BLOCKS) as usize]);
        self.in_blocks -= list.len();
        for entry in list.drain(..) {
            self.put_near(entry.at.0 >> self.shift, entry);
        }
        self.spare_blocks.push(list);
        true
    }

    fn block_of(&self, at: Time) -> u64 {
        at.0 >> self.shift >> SLOT_BITS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::rng::Rng;

    /// The same pushes and pops as a heap by time and number, for all delays.
    #[test]
    fn behaves_like_a_heap() {
        for (seed, reach) in [(1, 40), (2, 30), (3, 26), (4, 20), (5, 0)] {
            let mut rng = Rng::named(seed, "queue", 0);
            let mut queue = Queue::new(Span::millis(100));
            let (mut heap, mut now) = (BinaryHeap::new(), Time::ZERO);
            for number in 0..20_000u32 {
                if rng.below(100) < 48 {
                    let expected = heap.pop().map(|Reverse((at, n))| (at, n));
                    assert_eq!(queue.next_at(), expected.map_or(Time::NEVER, |(at, _)| at));
                    assert_eq!(queue.pop(), expected);
                    now = expected.map_or(now, |(at, _)| at);
                } else {
                    // Often the same instants; now and then far away.
                    let reach = if rng.below(50) == 0 { 45 } else { rng.below(reach + 1) };
                    let at = Time((now.0 + rng.below(1 << reach)) >> (reach / 2) << (reach / 2)).max(now);
                    queue.push(at, number);
                    heap.push(Reverse((at, number)));
                }
            }
            while let Some(Reverse(expected)) = heap.pop() {
                assert_eq!(queue.pop(), Some(expected));
            }
            assert_eq!((queue.next_at(), queue.pop()), (Time::NEVER, None));
        }
    }

    /// Asking for the next time does not exclude entries that are scheduled before it.
    #[test]
    fn late_entries_come_in_time() {
        let mut queue = Queue::new(Span::ZERO);
        queue.push(Time(1 << 50), 1);
        assert_eq!(queue.next_at(), Time(1 << 50));
        for (at, what) in [(1 << 50, 2), (5, 3), (7, 4), (5, 5), (u64::MAX - 1, 6), ((1 << 50) + 1, 7)] {
            queue.push(Time(at), what);
        }
        let order: Vec<i32> = std::iter::from_fn(|| queue.pop()).map(|(_, what)| what).collect();
        assert_eq!(order, [3, 5, 4, 1, 2, 7, 6]);
    }
}

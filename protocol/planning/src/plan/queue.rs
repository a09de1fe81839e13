//! The open states of a search by priority: buckets of blocks; states of one priority are last in, first out.

use super::table::Id;
use std::collections::BTreeMap;

/// Number of states of a block; with the link to the next one it has 1 KiB.
const BLOCK_LEN: usize = 255;

struct Block {
    ids: [Id; BLOCK_LEN],
    next: u32,
}

/// The number that stands for no further block.
const END: u32 = u32::MAX;

struct Bucket {
    block: u32,
    used: usize,
}

/// A queue of states by priority, smallest first.
pub(super) struct Queue<P> {
    buckets: BTreeMap<P, Bucket>,
    // Boxes, so that growing the list moves pointers only.
    #[allow(clippy::vec_box)]
    blocks: Vec<Box<Block>>,
    free: u32,
}

impl<P: Ord + Copy> Queue<P> {
    pub(super) fn new() -> Queue<P> {
        Queue { buckets: BTreeMap::new(), blocks: Vec::new(), free: END }
    }
    pub(super) fn bytes(&self) -> usize {
        self.blocks.len() * size_of::<Block>()
    }
    pub(super) fn first(&self) -> Option<P> {
        self.buckets.keys().next().copied()
    }
    pub(super) fn clear(&mut self) {
        *self = Queue::new();
    }

    pub(super) fn push(&mut self, priority: P, id: Id) {
        let bucket = self.buckets.entry(priority).or_insert(Bucket { block: END, used: BLOCK_LEN });
        if bucket.used == BLOCK_LEN {
            let block = if self.free == END {
                self.blocks.push(Box::new(Block { ids: [0; BLOCK_LEN], next: END }));
                self.blocks.len() as u32 - 1
            } else {
                let block = self.free;
                self.free = self.blocks[block as usize].next;
                block
            };
            self.blocks[block as usize].next = bucket.block;
            *bucket = Bucket { block, used: 0 };
        }
        self.blocks[bucket.block as usize].ids[bucket.used] = id;
        bucket.used += 1;
    }

    pub(super) fn pop(&mut self) -> Option<(P, Id)> {
        let mut entry = self.buckets.first_entry()?;
        let priority = *entry.key();
        let bucket = entry.get_mut();
        bucket.used -= 1;
        let block = &mut self.blocks[bucket.block as usize];
        let id = block.ids[bucket.used];
        if bucket.used == 0 {
            let next = std::mem::replace(&mut block.next, self.free);
            self.free = bucket.block;
            if next == END {
                entry.remove();
            } else {
                *bucket = Bucket { block: next, used: BLOCK_LEN };
            }
        }
        Some((priority, id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smallest_priority_and_last_added_first() {
        let mut queue = Queue::new();
        for id in 0..2_000 {
            queue.push(id % 3, id);
        }
        let bytes = queue.bytes();
        let mut expected: Vec<u32> = (0..2_000).rev().collect();
        expected.sort_by_key(|id| id % 3);
        let popped: Vec<u32> = std::iter::from_fn(|| queue.pop().map(|p| p.1)).collect();
        assert_eq!(popped, expected);
        for id in 0..1_000 {
            queue.push(9, id);
        }
        assert_eq!((queue.first(), queue.bytes()), (Some(9), bytes));
    }
}

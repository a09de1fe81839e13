//! The states that a search keeps: packed keys with cost, bound and parent, found by an index of hashes.
//!
//! Records are kept in chunks that never move, so that growing needs no room for a copy; the index
//! is dropped before a larger one is made from the records.

use super::Cost;

/// Number of records of a chunk.
const CHUNK_LEN: usize = 4096;
/// Number of slots of the smallest index.
const SLOTS_MIN: usize = 1024;
/// The share of used slots at which the index grows, in percent.
const FULL: usize = 80;
/// The largest share of used slots near the memory limit, in percent.
const CRAMMED: usize = 92;

/// The number of a kept state.
pub type Id = u32;

/// The parent of the start.
pub const NO_PARENT: Id = Id::MAX;

/// The bit of [`Node::cost`] that marks an expanded state.
const EXPANDED_MASK: u16 = 0x8000;

/// Fields of a state that are stored apart from its key.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    parent: Id,
    /// The cost from the start, and [`EXPANDED_MASK`].
    cost: u16,
    lower: u16,
}

/// A set of states.
pub struct Table {
    width: usize,
    keys: Vec<Box<[u8]>>,
    nodes: Vec<Box<[Node]>>,
    len: usize,
    /// Of each slot 0 if empty, else 7 bits of the hash and the mark 0x80.
    tags: Vec<u8>,
    ids: Vec<Id>,
}

impl std::fmt::Debug for Table {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Table").field("width", &self.width).field("len", &self.len).finish_non_exhaustive()
    }
}

impl Table {
    /// Creates an empty table for keys of `width` bytes.
    pub fn new(width: usize) -> Table {
        let (tags, ids) = (vec![0; SLOTS_MIN], vec![0; SLOTS_MIN]);
        Table { width, keys: Vec::new(), nodes: Vec::new(), len: 0, tags, ids }
    }

    /// Returns the number of states.
    pub fn len(&self) -> usize {
        self.len
    }
    /// Returns true if there is no state.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
    /// Returns the bytes used.
    pub fn bytes(&self) -> usize {
        self.keys.len() * CHUNK_LEN * (self.width + size_of::<Node>())
            + self.tags.len() * (1 + size_of::<Id>())
    }
    /// Returns the bytes that a chunk of records takes.
    pub fn chunk_bytes(&self) -> usize {
        CHUNK_LEN * (self.width + size_of::<Node>())
    }

    /// Returns the key of a state.
    pub fn key(&self, id: Id) -> &[u8] {
        let at = id as usize % CHUNK_LEN * self.width;
        &self.keys[id as usize / CHUNK_LEN][at..at + self.width]
    }
    /// Returns the cost from the start.
    pub fn cost(&self, id: Id) -> Cost {
        Cost::from(self.node(id).cost & !EXPANDED_MASK)
    }
    /// Returns the lower bound of the cost to the goal.
    pub fn lower(&self, id: Id) -> Cost {
        Cost::from(self.node(id).lower)
    }
    /// Returns the state that this one was generated from, [`NO_PARENT`] for the start.
    pub fn parent(&self, id: Id) -> Id {
        self.node(id).parent
    }
    /// Returns true if the state has been expanded with its present cost.
    pub fn is_expanded(&self, id: Id) -> bool {
        self.node(id).cost & EXPANDED_MASK != 0
    }
    /// Marks a state as expanded with its present cost.
    pub fn set_expanded(&mut self, id: Id) {
        self.node_mut(id).cost |= EXPANDED_MASK;
    }
    /// Gives a state a smaller cost, from another parent; it is no longer expanded.
    pub fn improve(&mut self, id: Id, cost: Cost, parent: Id) {
        let node = self.node_mut(id);
        node.cost = cost as u16 & !EXPANDED_MASK;
        node.parent = parent;
    }

    fn node(&self, id: Id) -> &Node {
        &self.nodes[id as usize / CHUNK_LEN][id as usize % CHUNK_LEN]
    }
    fn node_mut(&mut self, id: Id) -> &mut Node {
        &mut self.nodes[id as usize / CHUNK_LEN][id as usize % CHUNK_LEN]
    }

    /// Finds the state with a key.
    pub fn find(&self, key: &[u8]) -> Option<Id> {
        self.probe(hash(key), key).ok()
    }

    /// Returns the state with a key, or the slot where it belongs.
    fn probe(&self, hash: u64, key: &[u8]) -> Result<Id, usize> {
        let tag = tag(hash);
        let mut slot = self.slot(hash);
        loop {
            match self.tags[slot] {
                0 => return Err(slot),
                t if t == tag && self.key(self.ids[slot]) == key => return Ok(self.ids[slot]),
                _ => slot = if slot + 1 == self.tags.len() { 0 } else { slot + 1 },
            }
        }
    }
    fn slot(&self, hash: u64) -> usize {
        ((u128::from(hash) * self.tags.len() as u128) >> 64) as usize
    }

    /// Finds a key or adds it with the values of `new`: its cost, lower bound and parent. Returns its number, and true
    /// if it was added. `limit` is the number of bytes that the table should not exceed; the caller stops adding
    /// when it is reached.
    pub fn insert(&mut self, key: &[u8], limit: usize, new: impl FnOnce() -> (Cost, Cost, Id)) -> (Id, bool) {
        let hash = hash(key);
        let mut slot = match self.probe(hash, key) {
            Ok(id) => return (id, false),
            Err(slot) => slot,
        };
        if (self.len + 1) * 100 > self.tags.len() * FULL && self.grow(limit) {
            slot = self.probe(hash, key).expect_err("invariant: the key was not found above");
        }
        let id = self.len as Id;
        if self.len.is_multiple_of(CHUNK_LEN) {
            self.keys.push(vec![0; CHUNK_LEN * self.width].into());
            self.nodes.push(vec![Node::default(); CHUNK_LEN].into());
        }
        self.len += 1;
        let at = id as usize % CHUNK_LEN * self.width;
        self.keys[id as usize / CHUNK_LEN][at..at + self.width].copy_from_slice(key);
        let (cost, lower, parent) = new();
        *self.node_mut(id) = Node { parent, cost: cost as u16 & !EXPANDED_MASK, lower: lower as u16 };
        self.tags[slot] = tag(hash);
        self.ids[slot] = id;
        (id, true)
    }

    /// Enlarges the index, and returns true if it was rebuilt. Near the limit it gets only as many slots as the
    /// records that still fit will need.
    fn grow(&mut self, limit: usize) -> bool {
        let slots = self.tags.len();
        let per_slot = 1 + size_of::<Id>();
        let records = self.keys.len() * self.chunk_bytes();
        let mut next = slots + slots / 2;
        if records + next * per_slot > limit {
            let record = self.width + size_of::<Node>();
            let states = limit / (record + per_slot * 100 / FULL);
            next = (states.max(self.len + CHUNK_LEN) * 100 / FULL).min(next);
        }
        if next <= slots {
            if self.len * 100 < slots * CRAMMED {
                return false;
            }
            next = slots + slots / 16 + 1;
        }
        (self.tags, self.ids) = (Vec::new(), Vec::new());
        (self.tags, self.ids) = (vec![0; next], vec![0; next]);
        for id in 0..self.len as Id {
            let hash = hash(self.key(id));
            let mut slot = self.slot(hash);
            while self.tags[slot] != 0 {
                slot = if slot + 1 == next { 0 } else { slot + 1 };
            }
            self.tags[slot] = tag(hash);
            self.ids[slot] = id;
        }
        true
    }
}

fn tag(hash: u64) -> u8 {
    hash as u8 | 0x80
}

/// Hashes a key, equally on every machine: a beam search breaks ties by it.
pub fn hash(key: &[u8]) -> u64 {
    /// Factor of the multiplicative hash: 2^64 divided by the golden ratio.
    const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;
    let mut state = key.len() as u64;
    for word in key.chunks(8) {
        let mut bytes = [0; 8];
        bytes[..word.len()].copy_from_slice(word);
        state = (state ^ u64::from_le_bytes(bytes)).wrapping_mul(FACTOR);
        state ^= state >> 29;
    }
    state = state.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    state ^ (state >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_again_through_every_growth() {
        let mut table = Table::new(5);
        let key = |n: u32| {
            let b = n.wrapping_mul(2_654_435_761).to_le_bytes();
            [b[0], b[1], b[2], b[3], 7]
        };
        for n in 0..50_000_u32 {
            let (id, new) = table.insert(&key(n), usize::MAX, || (n % 100, 3, n / 2));
            assert_eq!((id, new), (n, true));
            assert_eq!(table.insert(&key(n / 3), usize::MAX, || (0, 0, 0)), (n / 3, false));
        }
        for n in 0..50_000 {
            assert_eq!(table.find(&key(n)), Some(n));
            assert_eq!((table.key(n), table.cost(n), table.lower(n)), (&key(n)[..], n % 100, 3));
        }
        assert_eq!(table.find(&key(50_000)), None);
        table.set_expanded(7);
        assert!(table.is_expanded(7) && table.cost(7) == 7);
        table.improve(7, 5, 1);
        assert_eq!((table.is_expanded(7), table.cost(7), table.parent(7)), (false, 5, 1));
    }

    /// At the limit the index gets as many slots as the records need that fit beside it.
    #[test]
    fn a_table_fills_its_limit() {
        for limit in [1 << 20, 3 << 20, 10_000_000] {
            let mut table = Table::new(16);
            let mut n = 0_u128;
            while table.bytes() + table.chunk_bytes() <= limit {
                table.insert(&n.to_le_bytes(), limit, || (0, 0, 0));
                n += 1;
            }
            let used = table.bytes() as f64 / limit as f64;
            assert!((0.88..1.01).contains(&used), "{used} of {limit}");
            assert!(limit as f64 / (n as f64) < 40.0, "{} bytes a state", limit as f64 / n as f64);
        }
    }
}

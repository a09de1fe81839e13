//! The motion database of one kind, laid out for searching: which landings and shapes a body can get
//! to from a posture when some of the cells around its foot are taken.
//!
//! Answers are exact: every strict step of the database is considered, with all cells that it sweeps.
//! They depend on the posture and on the taken cells only, and the same questions come again and again,
//! so the latest answers are kept. What is kept changes how long an answer takes and nothing else.

use super::memo::{Memo, mix};
use crate::lattice::Cell;
use crate::roombots::database::{Database, Table};
use crate::roombots::grid::GridState;
use crate::roombots::sweep::FloorContact;
use std::sync::Arc;

/// Cells of the database as bits: bit *i* is the *i*-th cell.
pub type Bits = u128;

/// A posture that lies with its free end on a connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Landed {
    /// The posture.
    pub posture: u16,
    /// Steps to it.
    pub turns: u8,
}

/// What can be got to from one posture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reach {
    /// Landings, nearest first; those equally near in the order of the steps.
    pub landings: Box<[Landed]>,
    /// The same as bits, by [`Graph::rest`].
    pub lands: u128,
    /// The nearest posture of every chain of cells, with the steps to it, by the chain's number.
    pub chains: Box<[Option<(u16, u8)>]>,
}

/// Which landings lead to which around some taken cells, without leaving the place.
#[derive(Debug, PartialEq, Eq)]
pub struct Parts {
    /// The part of every posture that lands, by [`Graph::rest`].
    of: [u8; 128],
    lands: Box<[u128]>,
}

impl Parts {
    /// The part of a posture that lands, by [`Graph::rest`].
    pub fn of(&self, rest: u8) -> usize {
        self.of.get(usize::from(rest)).copied().map_or(0, usize::from)
    }
    /// The landings of every part, as bits by [`Graph::rest`].
    pub fn lands(&self) -> &[u128] {
        &self.lands
    }
}

/// A way from one posture to another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Steps {
    /// The steps, by their numbers in the database.
    pub steps: Box<[u16]>,
    /// All cells they sweep.
    pub swept: Bits,
}

#[derive(Clone, Copy, Debug)]
struct Edge {
    to: u16,
    step: u16,
}

/// Answers kept about what can be got to, about parts, and about ways.
const KEPT: (usize, usize, usize) = (1 << 13, 1 << 15, 1 << 13);

/// The graph of strict steps of one kind.
pub struct Graph {
    /// The edges of posture `i` are those from `first[i]` to `first[i + 1]`.
    first: Vec<u32>,
    edges: Vec<Edge>,
    /// What every step sweeps, by its number.
    swept: Vec<Bits>,
    /// For every cell the steps that sweep it, as bits.
    sweepers: Vec<Box<[u64]>>,
    /// The cells of every posture.
    filled: Vec<[Cell; 4]>,
    filled_bits: Vec<Bits>,
    chain: Vec<u16>,
    landing: Vec<Option<(GridState, u16)>>,
    /// The number of a posture among those that land.
    rests: Vec<u8>,
    /// And the other way round.
    resting: Vec<u16>,
    chains: usize,
    cells: Vec<Cell>,
    /// The number of a cell, by [`Graph::slot`]; [`UNKNOWN`] if no motion ever sweeps it.
    numbers: Vec<u8>,
    reached: Memo<(u16, Bits), Arc<Reach>>,
    parts: Memo<Bits, Arc<Parts>>,
    ways: Memo<(u16, u16, Bits), Option<Arc<Steps>>>,
}

/// So many postures of one search are mostly equally far away, at most; more are no harm.
const LEVEL: usize = 128;

/// Postures that a search has come to, as bits.
struct Visited(Vec<u64>);

impl Visited {
    /// Adds one; whether it is new.
    fn add(&mut self, posture: u16) -> bool {
        let (word, bit) = (&mut self.0[usize::from(posture) / 64], 1 << (posture % 64));
        let new = *word & bit == 0;
        *word |= bit;
        new
    }
}

const UNKNOWN: u8 = u8::MAX;
/// Motions stay within this distance of the foot, along x and y, and below twice of it.
const RADIUS: i16 = 4;
const SIDE: usize = 2 * RADIUS as usize + 1;

impl Graph {
    /// Lays a table out. Invariant: the caller has checked that 128 bits are enough for the cells.
    pub fn new(database: &Database, table: &Table) -> Graph {
        let cells = database.cells().to_vec();
        let mut numbers = vec![UNKNOWN; SIDE * SIDE * SIDE];
        for (i, cell) in cells.iter().enumerate() {
            if let Some(slot) = Graph::slot(*cell) {
                numbers[slot] = i as u8;
            }
        }
        let bits = |set: &crate::roombots::database::CellSet| {
            set.indices().filter(|i| *i < 128).fold(0, |bits: Bits, i| bits | 1 << i)
        };
        let count = table.postures().len();
        let mut at: Vec<Vec<Edge>> = vec![Vec::new(); count];
        let swept: Vec<Bits> = table.steps().iter().map(|s| bits(&s.core) | bits(&s.graze)).collect();
        let mut sweepers = vec![vec![0u64; swept.len().div_ceil(64)].into_boxed_slice(); cells.len()];
        for (i, step) in table.steps().iter().enumerate().filter(|(_, s)| s.floor == FloorContact::Free) {
            at[usize::from(step.from)].push(Edge { to: step.to, step: i as u16 });
            at[usize::from(step.to)].push(Edge { to: step.from, step: i as u16 });
            for (cell, steps) in sweepers.iter_mut().enumerate() {
                steps[i / 64] |= ((swept[i] >> cell & 1) as u64) << (i % 64);
            }
        }
        let (mut first, mut edges) = (vec![0], Vec::new());
        for mut list in at {
            list.sort_by_key(|e| e.step);
            edges.extend(list);
            first.push(edges.len() as u32);
        }
        let of = |chain: u16| &table.chains()[usize::from(chain)].cells;
        let four = |chain: u16| std::array::from_fn(|i| of(chain).get(i).copied().unwrap_or_default());
        let landing = |(i, e): (usize, &crate::roombots::database::PostureEntry)| {
            let state = table.landings()[usize::from(e.landing?)].state;
            Some((state, table.reversed(i as u16)?))
        };
        let landing: Vec<Option<(GridState, u16)>> =
            table.postures().iter().enumerate().map(landing).collect();
        let mut lands = 0..UNKNOWN;
        let number = |l: &Option<(GridState, u16)>| l.and_then(|_| lands.next()).unwrap_or(UNKNOWN);
        let filled: Vec<[Cell; 4]> = table.postures().iter().map(|e| four(e.chain)).collect();
        Graph {
            first,
            edges,
            swept,
            sweepers,
            filled_bits: filled.iter().map(|f| bits(&database.cell_set(f.iter().copied()))).collect(),
            filled,
            chain: table.postures().iter().map(|e| e.chain).collect(),
            resting: (0..).zip(&landing).filter_map(|(p, l)| l.map(|_| p)).collect(),
            rests: landing.iter().map(number).collect(),
            landing,
            chains: table.chains().len(),
            cells,
            numbers,
            reached: Memo::new(KEPT.0),
            parts: Memo::new(KEPT.1),
            ways: Memo::new(KEPT.2),
        }
    }

    fn slot(cell: Cell) -> Option<usize> {
        let along = |c: i16| usize::try_from(c + RADIUS).ok().filter(|i| *i < SIDE);
        let up = usize::try_from(cell.z).ok().filter(|i| *i < SIDE)?;
        Some((along(cell.x)? * SIDE + along(cell.y)?) * SIDE + up)
    }

    /// The bit of a cell of the foot frame; none if no motion sweeps it.
    pub fn bit(&self, cell: Cell) -> Bits {
        match Graph::slot(cell).map_or(UNKNOWN, |s| self.numbers[s]) {
            UNKNOWN => 0,
            i => 1 << i,
        }
    }
    /// The cells of a set, in the foot frame.
    pub fn cells(&self, mut bits: Bits) -> impl Iterator<Item = Cell> + '_ {
        std::iter::from_fn(move || {
            let i = (bits != 0).then(|| bits.trailing_zeros())?;
            bits &= bits - 1;
            self.cells.get(i as usize).copied()
        })
    }
    /// The cells of a posture, from the foot on; of an unknown one those of the first.
    pub fn filled(&self, posture: u16) -> [Cell; 4] {
        self.filled.get(usize::from(posture)).copied().unwrap_or_default()
    }
    /// The same as bits.
    pub fn filled_bits(&self, posture: u16) -> Bits {
        self.filled_bits.get(usize::from(posture)).copied().unwrap_or_default()
    }
    /// The number of the chain of cells that a posture fills.
    pub fn chain(&self, posture: u16) -> Option<u16> {
        self.chain.get(usize::from(posture)).copied()
    }
    /// Where the free end lies if it lies on the floor, and the posture seen from there.
    pub fn landing(&self, posture: u16) -> Option<(GridState, u16)> {
        self.landing.get(usize::from(posture)).copied().flatten()
    }

    /// The number of a posture that lands among those that do. Whoever has landed is in such a posture,
    /// seen from the end that did: the other end is still where it was.
    pub fn rest(&self, posture: u16) -> Option<u8> {
        self.rests.get(usize::from(posture)).copied().filter(|i| *i < 128)
    }

    fn edges(&self, posture: u16) -> &[Edge] {
        let i = usize::from(posture);
        match (self.first.get(i), self.first.get(i + 1)) {
            (Some(a), Some(b)) => &self.edges[*a as usize..*b as usize],
            _ => &[],
        }
    }

    /// The steps that sweep a taken cell, as bits.
    fn blocked(&self, taken: Bits) -> Vec<u64> {
        let mut blocked = vec![0u64; self.swept.len().div_ceil(64)];
        let mut bits = taken;
        while bits != 0 {
            let sweepers = &self.sweepers[bits.trailing_zeros() as usize];
            blocked.iter_mut().zip(sweepers).for_each(|(b, s)| *b |= s);
            bits &= bits - 1;
        }
        blocked
    }

    /// Visits every posture that can be got to and has not been visited, nearest first, until `see` says
    /// to stop. `came` is told which posture is come to from which by which step.
    fn search(
        &self,
        from: u16,
        blocked: &[u64],
        visited: &mut Visited,
        mut see: impl FnMut(u16, u8) -> bool,
        mut came: impl FnMut(u16, u16, u16),
    ) {
        if usize::from(from) >= self.filled.len() || !visited.add(from) {
            return;
        }
        let (mut level, mut next) = (Vec::with_capacity(LEVEL), Vec::with_capacity(LEVEL));
        level.push(from);
        for turns in 0..=u8::MAX {
            for at in level.drain(..) {
                if see(at, turns) {
                    return;
                }
                for edge in self.edges(at) {
                    let step = usize::from(edge.step);
                    if blocked[step / 64] >> (step % 64) & 1 == 0 && visited.add(edge.to) {
                        came(edge.to, at, edge.step);
                        next.push(edge.to);
                    }
                }
            }
            if next.is_empty() {
                return;
            }
            std::mem::swap(&mut level, &mut next);
        }
    }

    fn unvisited(&self) -> Visited {
        Visited(vec![0; self.filled.len().div_ceil(64)])
    }

    /// The landings that can be got to without sweeping a taken cell, as bits by [`Graph::rest`]. This is
    /// [`Reach::lands`], for less.
    pub fn lands(&self, from: u16, taken: Bits) -> u128 {
        let Some(rest) = self.rest(from) else { return self.reach(from, taken).lands };
        let parts = self.parts(taken);
        parts.lands[parts.of(rest)]
    }

    /// Which landings lead to which without sweeping a taken cell.
    pub fn parts(&self, taken: Bits) -> Arc<Parts> {
        self.parts.answer(hash(taken), taken, |_| Arc::new(self.find_parts(taken)))
    }

    fn find_parts(&self, taken: Bits) -> Parts {
        let (blocked, mut visited) = (self.blocked(taken), self.unvisited());
        let (mut of, mut lands) = ([0; 128], Vec::new());
        for from in self.resting.iter().copied().filter(|p| self.rest(*p).is_some()) {
            let mut part: u128 = 0;
            let see = |posture, _| {
                part |= self.rest(posture).map_or(0, |i| 1 << i);
                false
            };
            self.search(from, &blocked, &mut visited, see, |_, _, _| {});
            if part == 0 {
                // It is in the part of an earlier one.
                continue;
            }
            (0..of.len()).filter(|i| part >> i & 1 == 1).for_each(|i| of[i] = lands.len() as u8);
            lands.push(part);
        }
        Parts { of, lands: lands.into() }
    }

    /// The postures of a set of landings.
    pub fn landings(&self, mut lands: u128) -> impl Iterator<Item = u16> + '_ {
        std::iter::from_fn(move || {
            let i = (lands != 0).then(|| lands.trailing_zeros())?;
            lands &= lands - 1;
            self.resting.get(i as usize).copied()
        })
    }

    /// Everything that strict steps lead to from a posture without sweeping a taken cell.
    pub fn reach(&self, from: u16, taken: Bits) -> Arc<Reach> {
        let hash = mix(hash(taken), u64::from(from));
        self.reached.answer(hash, (from, taken), |_| Arc::new(self.find(from, taken)))
    }

    fn find(&self, from: u16, taken: Bits) -> Reach {
        let (mut landings, mut lands) = (Vec::new(), 0);
        let mut chains = vec![None; self.chains].into_boxed_slice();
        let see = |posture: u16, turns| {
            let chain = &mut chains[usize::from(self.chain[usize::from(posture)])];
            if chain.is_none() {
                *chain = Some((posture, turns));
            }
            if let Some(rest) = self.rest(posture) {
                landings.push(Landed { posture, turns });
                lands |= 1 << rest;
            }
            false
        };
        self.search(from, &self.blocked(taken), &mut self.unvisited(), see, |_, _, _| {});
        Reach { landings: landings.into_boxed_slice(), lands, chains }
    }

    /// The shortest way to a posture; none if there is no way.
    pub fn way(&self, from: u16, to: u16, taken: Bits) -> Option<Arc<Steps>> {
        let hash = mix(hash(taken), u64::from(from) << 16 | u64::from(to));
        self.ways.answer(hash, (from, to, taken), |_| self.find_way(from, to, taken).map(Arc::new))
    }

    fn find_way(&self, from: u16, to: u16, taken: Bits) -> Option<Steps> {
        let mut came_by = vec![None; self.filled.len()];
        self.search(
            from,
            &self.blocked(taken),
            &mut self.unvisited(),
            |at, _| at == to,
            |to, at, step| came_by[usize::from(to)] = Some((at, step)),
        );
        let (mut steps, mut swept, mut at) = (Vec::new(), 0, to);
        while at != from {
            let (before, step) = came_by.get(usize::from(at)).copied().flatten()?;
            swept |= self.swept[usize::from(step)];
            steps.push(step);
            at = before;
        }
        steps.reverse();
        Some(Steps { steps: steps.into(), swept })
    }

    /// A posture one free step away.
    pub fn neighbour(&self, posture: u16, taken: Bits) -> Option<u16> {
        let free = |e: &&Edge| self.swept[usize::from(e.step)] & taken == 0;
        self.edges(posture).iter().find(free).map(|e| e.to)
    }

    /// What a step leads to from a posture and what it sweeps, if it is strict and begins there.
    pub fn step(&self, posture: u16, number: u16) -> Option<(u16, Bits)> {
        let edge = self.edges(posture).iter().find(|e| e.step == number)?;
        Some((edge.to, self.swept[usize::from(number)]))
    }
}

fn hash(bits: Bits) -> u64 {
    mix(mix(0, bits as u64), (bits >> 64) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::roombots::Kind;
    use crate::roombots::database::CellSet;
    use crate::stream::Stream;

    fn sorted(postures: impl Iterator<Item = u16>) -> Vec<u16> {
        let mut postures: Vec<u16> = postures.collect();
        postures.sort_unstable();
        postures
    }

    /// The database's own search, which is written for reading and not for speed, says the same.
    #[test]
    fn agrees_with_the_database() {
        let database = Database::build();
        let mut stream = Stream::named(1, "taken", 0);
        for kind in Kind::METAMODULES {
            let table = database.table(kind);
            let graph = Graph::new(&database, table);
            for round in 0..60 {
                let from = stream.below(table.postures().len() as u64) as u16;
                let taken: Vec<Cell> = (0..round / 6)
                    .map(|_| database.cells()[stream.below(database.cells().len() as u64) as usize])
                    .collect();
                let bits = taken.iter().fold(0, |b, c| b | graph.bit(*c));
                let set: CellSet = database.cell_set(taken.iter().copied());
                let slow = table.reach(from, &set);
                let expected: Vec<(u16, u8)> =
                    slow.postures().filter(|(p, _)| graph.landing(*p).is_some()).collect();
                for _ in 0..2 {
                    let fast = graph.reach(from, bits);
                    let found: Vec<(u16, u8)> = fast.landings.iter().map(|l| (l.posture, l.turns)).collect();
                    assert_eq!(found, expected, "{kind} {from} {taken:?}");
                    let lands = graph.lands(from, bits);
                    assert_eq!(lands, fast.lands);
                    assert!(graph.landings(lands).eq(sorted(found.iter().map(|(p, _)| *p))));
                    for (chain, nearest) in fast.chains.iter().enumerate() {
                        let fills = |p: u16| usize::from(table.postures()[usize::from(p)].chain) == chain;
                        assert_eq!(*nearest, slow.postures().find(|(p, _)| fills(*p)));
                    }
                }
                for (to, _) in expected.into_iter().take(3) {
                    let way = table.way_within(&slow, from, to).unwrap();
                    let found = graph.way(from, to, bits).unwrap();
                    assert_eq!(*found.steps, *way.steps.iter().map(|s| s.0).collect::<Vec<_>>());
                    let cells: Vec<Cell> = graph.cells(found.swept).collect();
                    assert_eq!(cells, database.resolve(&way.core.union(&way.graze)).collect::<Vec<_>>());
                }
            }
            assert_eq!(graph.way(0, u16::MAX, 0), None);
            let turned = (0..graph.filled.len() as u16).filter_map(|p| graph.landing(p)).map(|(_, t)| t);
            assert!(turned.into_iter().all(|t| graph.rest(t).is_some()), "who has landed can land back");
            assert!(database.cells().iter().all(|c| graph.bit(*c) != 0), "every cell has a bit");
        }
    }
}

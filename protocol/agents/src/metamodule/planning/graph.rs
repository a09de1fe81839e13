//! The motion database of one kind, laid out for searching: the landings and shapes that a body can get to
//! from a posture while some of the cells around its foot are taken.
//!
//! Answers are exact: every strict step of the database is considered, with all cells that it sweeps. They
//! depend on the posture and the taken cells only, and questions recur, so the latest answers are cached. The
//! cache affects the time an answer takes, never the answer.

use crate::metamodule::planning::lru_cache::{Memo, mix};
use crate::metamodule::planning::posture_set::{PostureIndex, PostureSet, Turns};
use crate::metamodule::pose::to_world;
use metamorph_core::lattice::Cell;
use metamorph_roombots::database::{Database, Table};
use metamorph_roombots::grid::GridState;
use metamorph_roombots::sweep::FloorContact;
use std::sync::{Arc, Mutex, PoisonError};

/// Cells of the database as bits: bit *i* is the *i*-th cell.
pub type Bits = u128;

/// A posture with its free end on a connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Landed {
    /// The posture.
    pub posture: u16,
    /// Number of turns to it.
    pub turns: u8,
}

/// Landings and postures that can be reached from one posture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reach {
    /// Landings by number of turns, then by number of the posture.
    pub landings: Box<[Landed]>,
    /// The same set as bits, by [`MotionGraph::rest`].
    pub lands: u128,
    /// By chain of cells: the nearest posture that fills it, and the number of turns to it.
    pub chains: Box<[Option<(u16, u8)>]>,
}

/// A connected component: postures that turn into each other, and into no others, while some cells are taken.
struct Part {
    postures: PostureSet,
    /// Its landings, as bits by [`MotionGraph::rest`].
    lands: u128,
    /// Taken cells that suffice to confine it; computed on demand.
    wall: Option<Bits>,
}

/// A path from one posture to another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Steps {
    /// The steps, by their numbers in the database.
    pub steps: Box<[u16]>,
    /// All cells that the steps sweep.
    pub swept: Bits,
}

/// Entries that the caches of reachable sets, of components and of paths hold.
const KEPT: (usize, usize, usize) = (1 << 13, 1 << 14, 1 << 13);

/// The graph of the strict steps of one kind.
pub struct MotionGraph {
    /// By joint: the postures from which a strict step turns it forwards.
    strict: Turns,
    /// By cell: the turns that sweep it.
    sweepers: Vec<Turns>,
    /// By posture: the steps that begin or end in it, with the posture at the other end.
    steps: Vec<Vec<(u16, u16)>>,
    /// By step: the cells that it sweeps.
    swept: Vec<Bits>,
    /// The place of each posture in sets, and the inverse.
    places: Vec<PostureIndex>,
    posture_at: Vec<u16>,
    /// The postures that land, and the postures of each chain.
    landers: PostureSet,
    of_chain: Vec<PostureSet>,
    /// By posture: the cells that it fills.
    filled: Vec<[Cell; 4]>,
    filled_bits: Vec<Bits>,
    chain: Vec<u16>,
    landing: Vec<Option<(GridState, u16)>>,
    /// By posture: its number among those that land; [`UNKNOWN`] for the others.
    rests: Vec<u8>,
    /// The inverse of `rests`.
    resting: Vec<u16>,
    cells: Vec<Cell>,
    /// By class of the foot and by [`slot`] around it: the number of a cell; [`UNKNOWN`] if no motion sweeps
    /// it.
    numbers: [Vec<u8>; 4],
    reached: Memo<(u16, Bits), Arc<Reach>>,
    /// By taken cells: the components found so far.
    parts: Memo<Bits, Arc<Mutex<Vec<Part>>>>,
    paths: Memo<(u16, u16, Bits), Option<Arc<Steps>>>,
}

/// The number that stands for no posture, or for no cell.
const UNKNOWN: u8 = u8::MAX;
/// Range of motions along x and y, in cells from the foot; along z they stay below twice as much.
pub(super) const RADIUS: i16 = 4;
/// Width of the range of motions, in cells.
const SIDE_CELLS: usize = 2 * RADIUS as usize + 1;

/// Returns the number of a cell around the foot; `None` if it is out of range.
fn slot(cell: Cell) -> Option<usize> {
    let along = |c: i16| usize::from(c.wrapping_add(RADIUS) as u16);
    let (x, y, z) = (along(cell.x), along(cell.y), usize::from(cell.z as u16));
    (x < SIDE_CELLS && y < SIDE_CELLS && z < SIDE_CELLS).then_some((x * SIDE_CELLS + y) * SIDE_CELLS + z)
}

impl MotionGraph {
    /// Lays out a table. Invariant: the caller has checked that the cells of the database fit 128 bits.
    pub fn new(database: &Database, table: &Table) -> MotionGraph {
        let cells = database.cells().to_vec();
        let numbers = [0, 1, 2, 3].map(|class| {
            let mut numbers = vec![UNKNOWN; SIDE_CELLS * SIDE_CELLS * SIDE_CELLS];
            let seen = |cell: &Cell| slot(to_world(GridState::new(0, 0, class), *cell));
            (0..).zip(&cells).for_each(|(i, cell)| seen(cell).into_iter().for_each(|slot| numbers[slot] = i));
            numbers
        });
        let bits = |set: &metamorph_roombots::database::CellSet| {
            set.indices().filter(|i| *i < 128).fold(0, |bits: Bits, i| bits | 1 << i)
        };
        let places: Vec<PostureIndex> =
            table.postures().iter().map(|e| PostureIndex::of(e.posture)).collect();
        let mut posture_at = vec![u16::MAX; PostureIndex::COUNT];
        (0..).zip(&places).for_each(|(posture, place)| posture_at[place.index()] = posture);
        let swept: Vec<Bits> = table.steps().iter().map(|s| bits(&s.core) | bits(&s.graze)).collect();
        let mut strict = PostureSet::NO_TURNS;
        let mut sweepers = vec![PostureSet::NO_TURNS; cells.len()];
        let mut steps = vec![Vec::new(); places.len()];
        for (i, step) in table.steps().iter().enumerate().filter(|(_, s)| s.floor == FloorContact::Free) {
            let (from, joint) = (usize::from(step.from), usize::from(step.joint));
            strict[joint].add(places[from]);
            steps[from].push((i as u16, step.to));
            steps[usize::from(step.to)].push((i as u16, step.from));
            ones(swept[i]).for_each(|cell| sweepers[cell][joint].add(places[from]));
        }
        let mut of_chain = vec![PostureSet::NONE; table.chains().len()];
        for (entry, place) in table.postures().iter().zip(&places) {
            of_chain[usize::from(entry.chain)].add(*place);
        }
        let of = |chain: u16| &table.chains()[usize::from(chain)].cells;
        let four = |chain: u16| std::array::from_fn(|i| of(chain).get(i).copied().unwrap_or_default());
        let landing = |(i, e): (usize, &metamorph_roombots::database::PostureEntry)| {
            let state = table.landings()[usize::from(e.landing?)].state;
            Some((state, table.reversed(i as u16)?))
        };
        let landing: Vec<Option<(GridState, u16)>> =
            table.postures().iter().enumerate().map(landing).collect();
        let mut lands = 0..UNKNOWN;
        let number = |l: &Option<(GridState, u16)>| l.and_then(|_| lands.next()).unwrap_or(UNKNOWN);
        let filled: Vec<[Cell; 4]> = table.postures().iter().map(|e| four(e.chain)).collect();
        let mut landers = PostureSet::NONE;
        for (place, _) in places.iter().zip(&landing).filter(|(_, l)| l.is_some()) {
            landers.add(*place);
        }
        MotionGraph {
            strict,
            sweepers,
            steps,
            swept,
            places,
            posture_at,
            landers,
            of_chain,
            filled_bits: filled.iter().map(|f| bits(&database.cell_set(f.iter().copied()))).collect(),
            filled,
            chain: table.postures().iter().map(|e| e.chain).collect(),
            resting: (0..).zip(&landing).filter_map(|(p, l)| l.map(|_| p)).collect(),
            rests: landing.iter().map(number).collect(),
            landing,
            cells,
            numbers,
            reached: Memo::new(KEPT.0),
            parts: Memo::new(KEPT.1),
            paths: Memo::new(KEPT.2),
        }
    }

    /// Returns those of `cells`, in world coordinates, that motions from a foot may sweep.
    pub fn seen_from(&self, foot: GridState, cells: &[Cell]) -> Bits {
        let numbers = &self.numbers[usize::from(foot.class % 4)];
        let mut bits = 0;
        for cell in cells {
            let (x, y) = (cell.x.wrapping_sub(foot.x), cell.y.wrapping_sub(foot.y));
            let number = slot(Cell::new(x, y, cell.z)).map_or(UNKNOWN, |slot| numbers[slot]);
            bits |= 1u128.checked_shl(u32::from(number)).unwrap_or(0);
        }
        bits
    }
    /// Iterates over the cells of a set, in the foot frame.
    pub fn cells(&self, bits: Bits) -> impl Iterator<Item = Cell> + '_ {
        ones(bits).filter_map(|i| self.cells.get(i).copied())
    }
    /// Returns the cells of a posture, from the foot on; all zero for an unknown one.
    pub fn filled(&self, posture: u16) -> [Cell; 4] {
        self.filled.get(usize::from(posture)).copied().unwrap_or_default()
    }
    /// Returns the cells of a posture as bits.
    pub fn filled_bits(&self, posture: u16) -> Bits {
        self.filled_bits.get(usize::from(posture)).copied().unwrap_or_default()
    }
    /// Returns the number of the chain of cells that a posture fills.
    pub fn chain(&self, posture: u16) -> Option<u16> {
        self.chain.get(usize::from(posture)).copied()
    }
    /// Returns where the free end connects to the floor, if it does, and the posture seen from there.
    pub fn landing(&self, posture: u16) -> Option<(GridState, u16)> {
        self.landing.get(usize::from(posture)).copied().flatten()
    }

    /// Returns the number of a posture among those that land. After a landing the body is in such a posture,
    /// seen from the end that landed, as the other end is still on its connector.
    pub fn rest(&self, posture: u16) -> Option<u8> {
        self.rests.get(usize::from(posture)).copied().filter(|i| *i < 128)
    }

    /// Returns the strict turns that sweep no taken cell.
    fn free(&self, taken: Bits) -> Turns {
        let mut free = self.strict;
        for cell in ones(taken) {
            let sweepers = &self.sweepers[cell];
            free.iter_mut().zip(sweepers).for_each(|(f, s)| f.remove_all(s));
        }
        free
    }

    fn only(&self, posture: u16) -> Option<PostureSet> {
        let mut only = PostureSet::NONE;
        only.add(*self.places.get(usize::from(posture))?);
        Some(only)
    }
    fn postures<'a>(&'a self, set: &'a PostureSet) -> impl Iterator<Item = u16> + 'a {
        set.iter().map(|place| self.posture_at[place.index()])
    }
    /// Returns the landings in a set, as bits by [`MotionGraph::rest`].
    fn landing_bits(&self, set: &PostureSet) -> u128 {
        let landers = set.and(&self.landers);
        self.postures(&landers).filter_map(|p| self.rest(p)).fold(0, |bits, i| bits | 1 << i)
    }

    /// Passes the postures at each distance in turns to `see`, nearest first, until it returns true.
    fn levels(&self, from: u16, free: &Turns, mut see: impl FnMut(u8, &PostureSet) -> bool) {
        let Some(mut level) = self.only(from) else { return };
        let mut visited = PostureSet::NONE;
        for turns in 0..=u8::MAX {
            if level.is_empty() || see(turns, &level) {
                return;
            }
            visited.add_all(&level);
            level = level.spread(free).without(&visited);
        }
    }

    /// Returns the landings that can be reached without sweeping a taken cell, as bits by [`MotionGraph::rest`]:
    /// the same as [`Reach::lands`], computed faster.
    pub fn lands(&self, from: u16, taken: Bits) -> u128 {
        self.part(from, taken, |part| part.lands).unwrap_or(0)
    }

    /// Returns a subset of the taken cells that leaves no more landings than all of them.
    pub fn wall(&self, from: u16, taken: Bits) -> Bits {
        let wall = |part: &mut Part| {
            let postures = &part.postures;
            *part.wall.get_or_insert_with(|| self.find_wall(postures, taken))
        };
        self.part(from, taken, wall).unwrap_or(taken)
    }

    /// Applies `ask` to the component of a posture.
    fn part<T>(&self, from: u16, taken: Bits, ask: impl FnOnce(&mut Part) -> T) -> Option<T> {
        let place = *self.places.get(usize::from(from))?;
        let parts = self.parts.answer(hash(taken), taken, |_| Arc::default());
        let mut parts = parts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(part) = parts.iter_mut().find(|p| p.postures.has(place)) {
            return Some(ask(part));
        }
        let postures = self.only(from)?.flood(&self.free(taken));
        let mut part = Part { lands: self.landing_bits(&postures), postures, wall: None };
        let answer = ask(&mut part);
        parts.push(part);
        Some(answer)
    }

    /// Returns taken cells that together block all steps out of a component.
    fn find_wall(&self, part: &PostureSet, taken: Bits) -> Bits {
        let mut wall = 0;
        for (step, to) in self.postures(part).flat_map(|posture| self.steps(posture)) {
            let blocked_by = self.swept[usize::from(*step)] & taken;
            if blocked_by & wall == 0 && !part.has(self.places[usize::from(*to)]) {
                wall |= blocked_by & blocked_by.wrapping_neg();
            }
        }
        wall
    }

    /// Iterates over the postures of a set of landings.
    pub fn landings(&self, lands: u128) -> impl Iterator<Item = u16> + '_ {
        ones(lands).filter_map(|i| self.resting.get(i).copied())
    }

    /// Returns everything that strict steps reach from a posture without sweeping a taken cell.
    pub fn reach(&self, from: u16, taken: Bits) -> Arc<Reach> {
        let hash = mix(hash(taken), u64::from(from));
        self.reached.answer(hash, (from, taken), |_| Arc::new(self.find(from, taken)))
    }

    fn find(&self, from: u16, taken: Bits) -> Reach {
        let (mut landings, mut lands) = (Vec::new(), 0);
        let mut chains: Box<[Option<(u16, u8)>]> = vec![None; self.of_chain.len()].into();
        let mut known = PostureSet::NONE;
        self.levels(from, &self.free(taken), |turns, level| {
            let first = landings.len();
            for posture in self.postures(&level.and(&self.landers)) {
                landings.push(Landed { posture, turns });
                lands |= self.rest(posture).map_or(0, |i| 1 << i);
            }
            landings[first..].sort_unstable_by_key(|l| l.posture);
            let before = known;
            for posture in self.postures(&level.without(&before)) {
                let chain = usize::from(self.chain[usize::from(posture)]);
                match &mut chains[chain] {
                    Some((nearest, _)) => *nearest = posture.min(*nearest),
                    new => {
                        *new = Some((posture, turns));
                        known.add_all(&self.of_chain[chain]);
                    }
                }
            }
            false
        });
        Reach { landings: landings.into_boxed_slice(), lands, chains }
    }

    /// Returns everything that strict steps reach from any of these postures without sweeping a taken cell,
    /// grouped by shape: connected postures that fill the same cells.
    pub fn shapes(&self, from: &[u16], taken: Bits) -> Vec<Vec<u16>> {
        let (free, mut seen, mut shapes) = (self.free(taken), PostureSet::NONE, Vec::new());
        for posture in from {
            let Some(place) = self.places.get(usize::from(*posture)).filter(|p| !seen.has(**p)) else {
                continue;
            };
            let mut part = PostureSet::NONE;
            part.add(*place);
            part = part.flood(&free);
            seen.add_all(&part);
            let of_chains = self.of_chain.iter().map(|chain| part.and(chain)).filter(|set| !set.is_empty());
            shapes.extend(of_chains.map(|set| self.postures(&set).collect::<Vec<u16>>()));
        }
        shapes
    }

    /// Returns a shortest path to a posture; `None` if there is none.
    pub fn path(&self, from: u16, to: u16, taken: Bits) -> Option<Arc<Steps>> {
        let hash = mix(hash(taken), u64::from(from) << 16 | u64::from(to));
        self.paths.answer(hash, (from, to, taken), |_| self.find_path(from, to, taken).map(Arc::new))
    }

    fn find_path(&self, from: u16, to: u16, taken: Bits) -> Option<Steps> {
        let goal = *self.places.get(usize::from(to))?;
        let free = self.free(taken);
        let mut levels = Vec::with_capacity(16);
        self.levels(from, &free, |_, level| {
            levels.push(*level);
            level.has(goal)
        });
        if !levels.pop()?.has(goal) {
            return None;
        }
        let (mut steps, mut swept, mut at) = (Vec::with_capacity(levels.len()), 0, to);
        while let Some(level) = levels.pop() {
            let is_before = |(_, before): &(u16, u16)| level.has(self.places[usize::from(*before)]);
            let is_free = |(step, _): &(u16, u16)| self.swept[usize::from(*step)] & taken == 0;
            let (step, before) = *self.steps(at).iter().find(|s| is_before(s) && is_free(s))?;
            swept |= self.swept[usize::from(step)];
            steps.push(step);
            at = before;
        }
        steps.reverse();
        Some(Steps { steps: steps.into(), swept })
    }

    /// Returns the strict steps that begin or end in a posture, with the posture at the other end.
    fn steps(&self, posture: u16) -> &[(u16, u16)] {
        self.steps.get(usize::from(posture)).map_or(&[], |steps| steps)
    }

    /// Returns the number of the strict step from one posture to another.
    pub fn number_of_step(&self, from: u16, to: u16) -> Option<u16> {
        self.steps(from).iter().find(|(_, other)| *other == to).map(|(number, _)| *number)
    }

    /// Returns a posture one free step away.
    pub fn neighbour(&self, posture: u16, taken: Bits) -> Option<u16> {
        let is_free = |(step, _): &&(u16, u16)| self.swept[usize::from(*step)] & taken == 0;
        self.steps(posture).iter().find(is_free).map(|(_, to)| *to)
    }

    /// Returns the posture that a strict step leads to from `posture` and the cells that it sweeps.
    pub fn step(&self, posture: u16, number: u16) -> Option<(u16, Bits)> {
        let (_, to) = *self.steps(posture).iter().find(|(step, _)| *step == number)?;
        Some((to, self.swept[usize::from(number)]))
    }
}

/// Iterates over the indices of the bits that are set.
pub(super) fn ones(mut bits: Bits) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let i = (bits != 0).then(|| bits.trailing_zeros() as usize)?;
        bits &= bits - 1;
        Some(i)
    })
}

fn hash(bits: Bits) -> u64 {
    mix(mix(0, bits as u64), (bits >> 64) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::rng::Rng;
    use metamorph_roombots::Kind;
    use metamorph_roombots::database::CellSet;

    fn sorted(postures: impl Iterator<Item = u16>) -> Vec<u16> {
        let mut postures: Vec<u16> = postures.collect();
        postures.sort_unstable();
        postures
    }

    /// The graph agrees with the database's own search, which is simple and slow.
    #[test]
    fn agrees_with_the_database() {
        let database = Database::build();
        let mut rng = Rng::named(1, "taken", 0);
        for kind in Kind::METAMODULES {
            let table = database.table(kind);
            let graph = MotionGraph::new(&database, table);
            for round in 0..60 {
                let from = rng.below(table.postures().len() as u64) as u16;
                let taken: Vec<Cell> = (0..round / 6)
                    .map(|_| database.cells()[rng.below(database.cells().len() as u64) as usize])
                    .collect();
                let bits = graph.seen_from(GridState::new(0, 0, 0), &taken);
                let set: CellSet = database.cell_set(taken.iter().copied());
                let slow = table.reach(from, &set);
                let mut nearest: Vec<(u16, u8)> = slow.postures().collect();
                nearest.sort_by_key(|(posture, turns)| (*turns, *posture));
                let lands = |(p, _): &(u16, u8)| graph.landing(*p).is_some();
                let expected: Vec<(u16, u8)> = nearest.iter().copied().filter(lands).collect();
                for _ in 0..2 {
                    let fast = graph.reach(from, bits);
                    let found: Vec<(u16, u8)> = fast.landings.iter().map(|l| (l.posture, l.turns)).collect();
                    assert_eq!(found, expected, "{kind} {from} {taken:?}");
                    let lands = graph.lands(from, bits);
                    assert_eq!(lands, fast.lands);
                    assert!(graph.landings(lands).eq(sorted(found.iter().map(|(p, _)| *p))));
                    for (chain, found) in fast.chains.iter().enumerate() {
                        let fills = |p: u16| usize::from(table.postures()[usize::from(p)].chain) == chain;
                        assert_eq!(*found, nearest.iter().copied().find(|(p, _)| fills(*p)));
                    }
                    let wall = graph.wall(from, bits);
                    assert_eq!(wall & !bits, 0, "a wall is of what is taken");
                    assert_eq!(graph.lands(from, wall), lands, "it holds by itself");
                }
                for (to, _) in expected.into_iter().take(3) {
                    let path = table.path_within(&slow, from, to).unwrap();
                    let found = graph.path(from, to, bits).unwrap();
                    assert_eq!(found.steps.len(), path.steps.len());
                    let (mut at, mut swept) = (from, 0);
                    for step in &found.steps {
                        let (next, cells) = graph.step(at, *step).unwrap();
                        assert_eq!(table.steps()[usize::from(*step)].floor, FloorContact::Free);
                        (at, swept) = (next, swept | cells);
                    }
                    assert_eq!((at, swept), (to, found.swept));
                    assert_eq!(swept & bits, 0);
                }
            }
            assert_eq!(graph.path(0, u16::MAX, 0), None);
            let turned = (0..graph.filled.len() as u16).filter_map(|p| graph.landing(p)).map(|(_, t)| t);
            assert!(turned.into_iter().all(|t| graph.rest(t).is_some()), "who has landed can land back");
            let seen = graph.seen_from(GridState::new(0, 0, 0), database.cells());
            assert_eq!(seen.count_ones() as usize, database.cells().len(), "every cell has a bit");
            for class in 0..4 {
                let state = GridState::new(7, -2, class);
                let around: Vec<Cell> = database.cells().iter().map(|c| to_world(state, *c)).collect();
                assert!((0..).zip(&around).all(|(i, c)| graph.seen_from(state, &[*c]) == 1 << i));
            }
        }
    }
}

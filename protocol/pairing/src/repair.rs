//! The recommender: which cells to add or remove so that a structure can be built of modules.
//!
//! The least number of changes is the number of cells left over, d. One change alters it by one; some cell whose
//! removal lowers it is no cut cell; and the columns along x pair a structure with its free surroundings, so that
//! additions alone suffice too. Sets of d changes that work, connectivity ignored, are the bases of a gammoid: taking
//! changes in order of their costs, each if it lowers the number left over, gives the cheapest set. Where such a set
//! cuts the structure apart, changes are taken one at a time and cut cells are kept; the number stays d, the cost is
//! then not proven least.
//!
//! No repair takes a pinned cell away. With pins, additions or removals alone may not suffice.

use super::matching::Matching;
use super::symmetry::Symmetry;
use super::{Going, NONE, Pairing, Surroundings, key};
use metamorph_core::lattice::{Cell, Face};
use petgraph::algo::articulation_points::articulation_points;
use petgraph::graph::NodeIndex;
use serde::Serialize;
use std::collections::BTreeSet;

/// Weight of an added cell in the cost of a repair.
pub const ADDITION: u32 = 2;
/// Weight of a removed cell. The thesis prefers additions (C.6.4).
pub const REMOVAL: u32 = 3;
/// Weight of each symmetry of the structure that does not map the changed cell to itself.
pub const BROKEN_SYMMETRY: u32 = 1;
/// Weight of an added cell above the lowest layer with no cell below it, besides that of its addition.
pub const OVERHANG: u32 = 1;
/// The largest number of sets that the search for a symmetric repair tries.
const MAX_TRIED: usize = 2_000;
/// The largest number of cells that it examines, over all sets.
const MAX_LOOKED_AT: usize = 2_000_000;

/// A change of one cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Change {
    /// A free cell beside the structure is filled.
    Add(Cell),
    /// A drawn cell is taken away.
    Remove(Cell),
}

impl Change {
    /// Returns the cell.
    pub fn cell(self) -> Cell {
        match self {
            Change::Add(cell) | Change::Remove(cell) => cell,
        }
    }
    /// Returns true if the cell is taken away.
    pub fn removes(self) -> bool {
        matches!(self, Change::Remove(_))
    }
    fn key(self) -> (bool, u64) {
        (self.removes(), key(self.cell()))
    }
}

/// Which changes a repair may make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Allowed {
    /// Additions only.
    Add,
    /// Removals only.
    Remove,
    /// Both.
    Any,
}

/// How a repair was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Choice {
    /// The cheapest additions.
    Additions,
    /// The cheapest additions and removals.
    Mixture,
    /// The cheapest removals.
    Removals,
    /// Changes that keep every symmetry of the structure.
    Symmetric,
    /// The cheapest additions without the first one of [`Choice::Additions`].
    NextAdditions,
}

/// Whether a cost is known to be the least.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Cheapest {
    /// No set of as few allowed changes costs less.
    Proven,
    /// A cheaper one may exist.
    Heuristic,
}

/// Changes after which the structure is connected and can be built of modules.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Repair {
    /// How it was chosen.
    pub choice: Choice,
    /// In the order in which they were chosen.
    pub changes: Vec<Change>,
    /// The sum of the costs.
    pub cost: u32,
    /// Whether that is the least.
    pub cheapest: Cheapest,
}

/// A change with its cost, ready to be tried.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    change: Change,
    index: u32,
    cost: u32,
}

/// A search for orbits of cells that are changed together.
struct Orbits<'a> {
    orbits: &'a [Vec<Candidate>],
    /// Sets that may still be tried.
    left: usize,
    going: Going<'a>,
}

impl Repair {
    /// Returns the cells after the changes, ascending.
    pub fn apply(&self, cells: impl IntoIterator<Item = Cell>) -> Vec<Cell> {
        let mut cells: BTreeSet<Cell> = cells.into_iter().collect();
        for change in &self.changes {
            match change {
                Change::Add(cell) => cells.insert(*cell),
                Change::Remove(cell) => cells.remove(cell),
            };
        }
        cells.into_iter().collect()
    }
}

impl Pairing {
    /// Returns up to five different repairs, the preferred one first; none if no cell is left over, or if pins leave no
    /// way. All have [`Pairing::unpaired`] changes, except that a symmetric one may have two more.
    pub fn repairs(&self, allowed: Allowed) -> Vec<Repair> {
        self.repairs_while(allowed, &|| true).collect()
    }

    /// Returns the repairs as [`Pairing::repairs`] does, each searched for when it is asked for, but for those that are not
    /// found before `going` returns false.
    pub fn repairs_while<'a>(
        &'a self,
        allowed: Allowed,
        going: Going<'a>,
    ) -> impl Iterator<Item = Repair> + 'a {
        use Choice::{Additions, Mixture, NextAdditions, Removals, Symmetric};
        let choices: &[Choice] = match allowed {
            _ if self.unpaired() == 0 => &[],
            Allowed::Add => &[Additions, Symmetric, NextAdditions],
            Allowed::Remove => &[Removals, Symmetric],
            Allowed::Any => &[Additions, Mixture, Removals, Symmetric, NextAdditions],
        };
        let symmetries = if choices.is_empty() { Vec::new() } else { Symmetry::all(&self.around) };
        let mut all = if choices.is_empty() { Vec::new() } else { self.candidates(&symmetries) };
        all.retain(|c| match allowed {
            Allowed::Add => !c.change.removes(),
            Allowed::Remove => c.change.removes(),
            Allowed::Any => true,
        });
        let (mut offered, mut first) = (BTreeSet::new(), None);
        choices.iter().filter_map(move |choice| {
            let only = |keep: &dyn Fn(&Change) -> bool| -> Vec<Candidate> {
                all.iter().copied().filter(|c| keep(&c.change)).collect()
            };
            let repair = match choice {
                Additions => {
                    let repair = self.cheapest(*choice, &only(&|c| !c.removes()), going);
                    first = repair.as_ref().and_then(|r| r.changes.first().copied());
                    repair
                }
                Mixture => self.cheapest(*choice, &all, going),
                Removals => self.cheapest(*choice, &only(&|c| c.removes()), going),
                Symmetric => self.symmetric(&symmetries, &all, going),
                NextAdditions => self.cheapest(*choice, &only(&|c| !c.removes() && Some(*c) != first), going),
            }?;
            let set: BTreeSet<_> = repair.changes.iter().map(|c| c.key()).collect();
            offered.insert(set).then_some(repair)
        })
    }

    /// Returns the least cost of the changes that leave no cell over, and those changes; connectivity is ignored.
    /// `None` if these changes do not suffice. Additions elsewhere than beside the structure, and removals of other cells,
    /// are left out.
    pub fn least_cost(&self, priced: &[(Change, u32)]) -> Option<(u32, Vec<Change>)> {
        let mut candidates: Vec<Candidate> = priced
            .iter()
            .filter_map(|(change, cost)| {
                let index = self.around.index(change.cell())?;
                let fits = self.around.drawn[index as usize] == change.removes();
                fits.then_some(Candidate { change: *change, index, cost: *cost })
            })
            .collect();
        sort(&mut candidates);
        let (chosen, _) = self.greedy(&candidates, &|| true)?;
        Some((chosen.iter().map(|c| c.cost).sum(), chosen.iter().map(|c| c.change).collect()))
    }

    /// Returns all changes with their costs, cheapest first.
    fn candidates(&self, symmetries: &[Symmetry]) -> Vec<Candidate> {
        let around = &self.around;
        // A single cell is not removed: nothing would be left.
        let alone = around.drawn.iter().filter(|d| **d).count() == 1;
        let mut covered: BTreeSet<(i16, i16)> = BTreeSet::new();
        let mut all = Vec::new();
        // Cells ascend by z, so the cells below one have been seen.
        for (index, cell) in around.cells.iter().enumerate() {
            let drawn = around.drawn[index];
            let broken = symmetries.iter().filter(|s| s.image(*cell) != Some(*cell)).count() as u32;
            let hangs = cell.z > around.floor && !covered.contains(&(cell.x, cell.y));
            let (change, cost) = match drawn {
                true => (Change::Remove(*cell), REMOVAL),
                false => (Change::Add(*cell), ADDITION + if hangs { OVERHANG } else { 0 }),
            };
            if drawn {
                covered.insert((cell.x, cell.y));
            }
            // A structure stands on its lowest layer.
            let below = cell.z < around.floor;
            let pinned = around.pinned_to(index as u32).is_some();
            if !(below || pinned || drawn && alone) {
                all.push(Candidate { change, index: index as u32, cost: cost + BROKEN_SYMMETRY * broken });
            }
        }
        sort(&mut all);
        all
    }

    /// Takes each change that lowers the number left over, in order, until none is left over.
    fn greedy(&self, candidates: &[Candidate], going: Going<'_>) -> Option<(Vec<Candidate>, Matching)> {
        let mut matching = self.matching.clone();
        let mut chosen = Vec::new();
        matching.forget();
        // A maximum matching after a change that was taken is, without it, one from before. So cells that may be left over
        // become fewer, and a change that is useless at first stays so.
        let free = matching.free(&self.around);
        for candidate in candidates.iter().filter(|c| self.lowers(&free, c)) {
            if chosen.len() == self.unpaired() || !going() {
                break;
            }
            if change(&mut matching, &self.around, candidate, &free) {
                chosen.push(*candidate);
            }
        }
        (chosen.len() == self.unpaired()).then_some((chosen, matching))
    }

    fn cheapest(&self, choice: Choice, candidates: &[Candidate], going: Going<'_>) -> Option<Repair> {
        let (chosen, matching) = self.greedy(candidates, going)?;
        let (chosen, cheapest) = match self.around.is_connected(matching.present()) {
            true => (chosen, Cheapest::Proven),
            false => (self.one_at_a_time(candidates, going)?, Cheapest::Heuristic),
        };
        Some(repair(choice, &chosen, cheapest))
    }

    /// Returns true if a change leaves one cell less over, where `free` says of each cell whether some maximum matching leaves
    /// it over.
    fn lowers(&self, free: &[bool], candidate: &Candidate) -> bool {
        match candidate.change {
            Change::Remove(_) => free[candidate.index as usize],
            Change::Add(_) => {
                self.around.choices(candidate.index).iter().any(|n| *n != NONE && free[*n as usize])
            }
        }
    }

    /// Takes the cheapest change that lowers the number left over and keeps the structure connected, again and
    /// again. A removal of that kind always exists.
    fn one_at_a_time(&self, candidates: &[Candidate], going: Going<'_>) -> Option<Vec<Candidate>> {
        let around = &self.around;
        let mut matching = self.matching.clone();
        let mut chosen: Vec<Candidate> = Vec::new();
        while chosen.len() < self.unpaired() {
            if !going() {
                return None;
            }
            let cuts = articulation_points(&around.graph(matching.present()));
            let free = matching.free(around);
            let fits = |c: &Candidate| match c.change {
                Change::Remove(_) => !cuts.contains(&NodeIndex::from(c.index)),
                Change::Add(_) => !matching.present()[c.index as usize],
            };
            let next = candidates.iter().find(|c| self.lowers(&free, c) && fits(c))?;
            matching.forget();
            if !change(&mut matching, around, next, &free) {
                return None;
            }
            chosen.push(*next);
        }
        Some(chosen)
    }

    /// Searches for changes that keep every symmetry: orbits of cells are changed together. Bounded, so that a repair
    /// may be missed.
    fn symmetric(
        &self,
        symmetries: &[Symmetry],
        candidates: &[Candidate],
        going: Going<'_>,
    ) -> Option<Repair> {
        if symmetries.is_empty() {
            return None;
        }
        let orbits = self.orbits(symmetries, candidates);
        let mut left = MAX_TRIED.min(MAX_LOOKED_AT / self.around.cells.len().max(1));
        for size in [self.unpaired(), self.unpaired() + 2] {
            let mut chosen = Vec::new();
            let mut search = Orbits { orbits: &orbits, left, going };
            if self.extend(&mut search, size, &self.matching, &mut chosen) {
                let changes: Vec<Candidate> = chosen.into_iter().flat_map(|o| orbits[o].clone()).collect();
                return Some(repair(Choice::Symmetric, &changes, Cheapest::Heuristic));
            }
            left = search.left;
        }
        None
    }

    /// Returns the candidates in orbits, the cheapest orbit first.
    fn orbits(&self, symmetries: &[Symmetry], candidates: &[Candidate]) -> Vec<Vec<Candidate>> {
        let mut of = vec![None; self.around.cells.len()];
        for candidate in candidates {
            of[candidate.index as usize] = Some(*candidate);
        }
        let mut orbits = Vec::new();
        for candidate in candidates {
            // The symmetries form a group, so the images of one cell are its orbit.
            let cell = candidate.change.cell();
            let images = symmetries.iter().filter_map(|s| self.around.index(s.image(cell)?));
            let images: BTreeSet<u32> = images.chain([candidate.index]).collect();
            let orbit: Vec<Candidate> = images.iter().filter_map(|i| of[*i as usize].take()).collect();
            if orbit.len() == images.len() {
                orbits.push(orbit);
            }
        }
        orbits.sort_by_key(|orbit| orbit.iter().map(|c| c.cost).sum::<u32>());
        orbits
    }

    /// Extends the chosen orbits to `size` cells after which the structure is connected and pairs up. A change alters
    /// the number left over by one at most, which cuts the search.
    fn extend(
        &self,
        search: &mut Orbits<'_>,
        size: usize,
        matching: &Matching,
        chosen: &mut Vec<usize>,
    ) -> bool {
        if size == 0 {
            return matching.unpaired().next().is_none() && self.around.is_connected(matching.present());
        }
        let first = chosen.last().map_or(0, |last| last + 1);
        let orbits = search.orbits.iter().enumerate().skip(first);
        for (i, orbit) in orbits.filter(|(_, orbit)| orbit.len() <= size) {
            if search.left == 0 || !(search.going)() {
                return false;
            }
            search.left -= 1;
            let mut changed = matching.clone();
            for candidate in orbit {
                changed.toggle(candidate.index);
            }
            changed.complete(&self.around, Face::ALL, None);
            if changed.unpaired().count() > size - orbit.len() {
                continue;
            }
            chosen.push(i);
            if self.extend(search, size - orbit.len(), &changed, chosen) {
                return true;
            }
            chosen.pop();
        }
        false
    }
}

fn sort(candidates: &mut [Candidate]) {
    candidates.sort_by_key(|c| (c.cost, c.change.key()));
}

fn change(matching: &mut Matching, around: &Surroundings, candidate: &Candidate, free: &[bool]) -> bool {
    match candidate.change {
        Change::Add(_) => matching.add(around, candidate.index, free),
        Change::Remove(_) => matching.remove(around, candidate.index, free),
    }
}

fn repair(choice: Choice, chosen: &[Candidate], cheapest: Cheapest) -> Repair {
    let changes = chosen.iter().map(|c| c.change).collect();
    Repair { choice, changes, cost: chosen.iter().map(|c| c.cost).sum(), cheapest }
}

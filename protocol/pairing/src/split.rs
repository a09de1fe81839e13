//! Splits of a structure into metamodules: chains of four cells, two modules each.
//!
//! Splitting a graph into paths of four is NP-hard. Two matchings in turn find a split quickly where there are many:
//! one of cells to modules, one of modules that touch. If they fail for a number of drawn orders, a bounded exact
//! search decides. A chain with a foot has an end in the lowest layer, as a seed of a metamodule swarm has.

use super::exact_cover::{Cover, cover};
use super::matching::Matching;
use super::{Going, NONE, Pairing};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::rng::Rng;
use petgraph::algo::maximum_matching;
use petgraph::graph::UnGraph;
use std::collections::{BTreeMap, BTreeSet};

/// The largest number of cells of a structure that is split. The general matching of the library recurses along
/// paths, so that its stack grows with the structure.
pub const MAX_SPLIT: usize = 4_096;
/// The number of pairings that are drawn before the exact search.
const DRAWN: u64 = 20;
/// The largest number of cells for the exact search.
const MAX_EXACT: usize = 1_024;
/// The number of choices that the exact search tries.
const MAX_CHOICES: u64 = 200_000;

/// Where chains may stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Footing {
    /// Anywhere.
    Free,
    /// Each chain has an end in the lowest layer.
    Floor,
}

/// Whether a structure splits into chains.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Split {
    /// The chains, ascending. Each begins with its end in the lowest layer if [`Footing::Floor`] is asked for.
    Yes(Vec<[Cell; 4]>),
    /// There is no split.
    No(NoSplit),
    /// The limits came first.
    Undecided,
}

/// Why there is no split.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoSplit {
    /// The number of cells is not a multiple of four.
    Count(usize),
    /// Cells stay without a partner; holds their number.
    Unpaired(usize),
    /// A cell is more than three layers above the lowest one.
    TooHigh(Cell),
    /// The lowest layer has fewer cells than there are chains.
    TooFewFeet {
        /// Cells in the lowest layer.
        feet: usize,
        /// Chains.
        chains: usize,
    },
    /// Every possibility was tried.
    Exhausted,
}

impl Pairing {
    /// Splits the structure into chains.
    pub fn split(&self, footing: Footing) -> Split {
        self.split_while(footing, &|| true)
    }

    /// Splits the structure into chains; undecided once `going` returns false.
    pub fn split_while(&self, footing: Footing, going: Going<'_>) -> Split {
        if let Some(reason) = self.no_split(footing) {
            return Split::No(reason);
        }
        let cells = self.cells().count();
        if cells > MAX_SPLIT {
            return Split::Undecided;
        }
        for attempt in 0..DRAWN {
            if !going() {
                return Split::Undecided;
            }
            if let Some(chains) = self.chains(&self.drawn_pairs(footing, attempt), footing) {
                return Split::Yes(chains);
            }
        }
        self.exact_split_while(footing, going)
    }

    /// Searches for a split by exact cover alone, within its limit.
    pub fn exact_split(&self, footing: Footing) -> Split {
        self.exact_split_while(footing, &|| true)
    }

    fn exact_split_while(&self, footing: Footing, going: Going<'_>) -> Split {
        if let Some(reason) = self.no_split(footing) {
            return Split::No(reason);
        }
        if self.cells().count() > MAX_EXACT {
            return Split::Undecided;
        }
        let chains = self.all_chains(footing);
        let index: BTreeMap<u32, u32> = self.drawn().zip(0..).collect();
        let pieces: Vec<[u32; 4]> = chains.iter().map(|chain| chain.map(|cell| index[&cell])).collect();
        match cover(index.len(), &pieces, MAX_CHOICES, going) {
            Cover::Found(chosen) => {
                Split::Yes(chosen.into_iter().map(|c| self.named(chains[c], footing)).collect())
            }
            Cover::None => Split::No(NoSplit::Exhausted),
            Cover::Undecided => Split::Undecided,
        }
    }

    fn no_split(&self, footing: Footing) -> Option<NoSplit> {
        let (cells, floor) = (self.cells().count(), self.around.floor);
        if !cells.is_multiple_of(4) {
            return Some(NoSplit::Count(cells));
        }
        if self.unpaired() > 0 {
            return Some(NoSplit::Unpaired(self.unpaired()));
        }
        if footing == Footing::Free {
            return None;
        }
        if let Some(high) = self.cells().find(|c| c.z > floor + 3) {
            return Some(NoSplit::TooHigh(high));
        }
        let (feet, chains) = (self.cells().filter(|c| c.z == floor).count(), cells / 4);
        (feet < chains).then_some(NoSplit::TooFewFeet { feet, chains })
    }

    fn drawn(&self) -> impl Iterator<Item = u32> + '_ {
        self.around.drawn.iter().zip(0..).filter(|(drawn, _)| **drawn).map(|(_, i)| i)
    }
    fn is_foot(&self, cell: u32) -> bool {
        self.around.cells[cell as usize].z == self.around.floor
    }
    /// Returns the cells that may make a module with this one.
    fn partners(&self, cell: u32) -> impl Iterator<Item = u32> + '_ {
        let near = self.around.choices(cell).iter().copied();
        near.filter(|n| *n != NONE && self.around.drawn[*n as usize])
    }
    fn drawn_neighbours(&self, cell: u32) -> impl Iterator<Item = u32> + '_ {
        let near = self.around.neighbours[cell as usize].into_iter();
        near.filter(|n| *n != NONE && self.around.drawn[*n as usize])
    }

    /// Returns a perfect pairing: the canonical one first, then one in a drawn order of cells and faces. Where feet
    /// are needed, upright pairs come first.
    fn drawn_pairs(&self, footing: Footing, attempt: u64) -> Vec<[u32; 2]> {
        let mut rng = Rng::named(0, "split", attempt);
        let mut order: Vec<u32> = self.drawn().collect();
        let mut faces = Face::ALL;
        if attempt > 0 {
            shuffle(&mut order, &mut rng);
            shuffle(&mut faces, &mut rng);
        }
        if footing == Footing::Floor && attempt.is_multiple_of(2) {
            faces.sort_by_key(|f| f.offset().z == 0);
        }
        let mut matching = Matching::new(&self.around);
        matching.complete(&self.around, faces, Some(&order));
        let mates = matching.mates();
        self.drawn().filter(|c| *c < mates[*c as usize]).map(|c| [c, mates[c as usize]]).collect()
    }

    /// Joins modules that touch to chains, if all can be joined.
    fn chains(&self, modules: &[[u32; 2]], footing: Footing) -> Option<Vec<[Cell; 4]>> {
        let mut module = vec![NONE; self.around.cells.len()];
        for (i, cells) in modules.iter().enumerate() {
            for cell in cells {
                module[*cell as usize] = i as u32;
            }
        }
        let mut joints: BTreeMap<[u32; 2], [u32; 4]> = BTreeMap::new();
        for (i, cells) in modules.iter().enumerate() {
            for [outer, inner] in [*cells, [cells[1], cells[0]]] {
                for near in self.drawn_neighbours(inner).filter(|n| module[*n as usize] > i as u32) {
                    let other = module[near as usize];
                    let [a, b] = modules[other as usize];
                    let chain = [outer, inner, near, if near == a { b } else { a }];
                    if self.may_stand(chain, footing) {
                        joints.entry([i as u32, other]).or_insert(chain);
                    }
                }
            }
        }
        let mut graph: UnGraph<(), (), u32> = UnGraph::with_capacity(modules.len(), joints.len());
        for _ in modules {
            graph.add_node(());
        }
        for [a, b] in joints.keys() {
            graph.add_edge((*a).into(), (*b).into(), ());
        }
        let matching = maximum_matching(&graph);
        if 2 * matching.len() < modules.len() {
            return None;
        }
        let joined = matching.edges().map(|(a, b)| {
            let (a, b) = (a.index() as u32, b.index() as u32);
            self.named(joints[&[a.min(b), a.max(b)]], footing)
        });
        let mut chains: Vec<[Cell; 4]> = joined.collect();
        chains.sort_unstable_by_key(|chain| super::key(chain[0]));
        Some(chains)
    }

    fn may_stand(&self, chain: [u32; 4], footing: Footing) -> bool {
        footing == Footing::Free || self.is_foot(chain[0]) || self.is_foot(chain[3])
    }

    /// Returns one chain for each set of four cells that a chain can cover and keep the pins.
    fn all_chains(&self, footing: Footing) -> Vec<[u32; 4]> {
        let mut seen = BTreeSet::new();
        let mut chains = Vec::new();
        for a in self.drawn() {
            for b in self.partners(a) {
                for c in self.drawn_neighbours(b).filter(|c| *c != a) {
                    for d in self.partners(c).filter(|d| *d != b) {
                        let chain = [a, b, c, d];
                        let mut set = chain;
                        set.sort_unstable();
                        if d != a && self.may_stand(chain, footing) && seen.insert(set) {
                            chains.push(chain);
                        }
                    }
                }
            }
        }
        chains
    }

    /// Returns the cells of a chain from its foot on, or from its lesser end on.
    fn named(&self, mut chain: [u32; 4], footing: Footing) -> [Cell; 4] {
        let foot = |cell: u32| footing == Footing::Floor && self.is_foot(cell);
        if (!foot(chain[0]), chain[0]) > (!foot(chain[3]), chain[3]) {
            chain.reverse();
        }
        chain.map(|cell| self.around.cells[cell as usize])
    }
}

fn shuffle<T>(items: &mut [T], rng: &mut Rng) {
    for i in (1..items.len()).rev() {
        items.swap(i, rng.below(i as u64 + 1) as usize);
    }
}

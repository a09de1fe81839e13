//! The graphs of thesis B.3 and the order of B.5: levels and isolation of the nodes of a structure.
//!
//! Nodes are modules, elements, and the connectors that hold feet. The *isolation* of a node is its degree centrality DC in
//! the density graph (equation B.1): the sum of the distances of its centre of mass to those of all other nodes. The *level*
//! is its distance from a connector in the connection graph. A kinematic chain is a metamodule, or one with an element
//! that it holds.
//!
//! Lengths are in millionths of a cell, so that the order is the same on every machine. The other measure of B.3, subgraph
//! centrality, is not used: on distances it overflows, and its order depends on the unit of length.

use super::Structure;
use crate::plan::and_or::Items;
use metamorph_core::lattice::Cell;
use std::cmp::Reverse;

/// One cell as a number of millionths.
pub const CELL: i64 = 1_000_000;

/// A place in millionths of a cell. The floor is at z = 0.
pub type Place = [i64; 3];

/// Returns the centre of mass of cells.
pub fn centre(cells: &[Cell]) -> Place {
    let n = cells.len().max(1) as i64;
    let sum = cells.iter().fold([0i64; 3], |s, c| {
        [s[0] + 2 * i64::from(c.x), s[1] + 2 * i64::from(c.y), s[2] + 2 * i64::from(c.z) + 1]
    });
    sum.map(|x| x * CELL / (2 * n))
}

/// Returns the degree centrality of a place among others: the sum of the distances to them, in millionths of a cell.
pub fn degree_centrality(place: Place, others: &[Place]) -> u64 {
    let square = |a: i64, b: i64| a.abs_diff(b).saturating_mul(a.abs_diff(b));
    let distance = |other: &Place| (0..3).map(|i| square(place[i], other[i])).sum::<u64>().isqrt();
    others.iter().map(distance).sum()
}

/// A set of items as thesis B.5 sorts it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Rank {
    /// The mean isolation of its modules and elements, in millionths of a cell.
    pub isolation: u64,
    /// The highest level.
    pub level: u32,
    /// The items.
    pub items: Items,
}

/// Levels and isolation of a structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Isolation {
    /// Of each item, the isolation of its modules from the foot on, or that of the element.
    nodes: Vec<Vec<u64>>,
    levels: Vec<u32>,
}

impl Isolation {
    /// Measures a structure.
    pub fn new(structure: &Structure) -> Isolation {
        let modules = |seat: &[Cell; 4]| vec![centre(&seat[..2]), centre(&seat[2..])];
        let seats = structure.seats.iter().map(modules);
        let pieces = structure.pieces.iter().map(|piece| vec![centre(&piece.part.goal)]);
        let places: Vec<Vec<Place>> = seats.chain(pieces).collect();
        let connector = |seat: &[Cell; 4]| {
            let [x, y, _] = centre(&seat[..1]);
            [x, y, 0]
        };
        let mut all: Vec<Place> = places.iter().flatten().copied().collect();
        all.extend(structure.seats.iter().map(connector));
        let isolation = |places: &Vec<Place>| places.iter().map(|p| degree_centrality(*p, &all)).collect();
        // The upper module of a seat is at level 2, an element that it holds at level 3.
        let levels = (0..structure.seats.len()).map(|_| 2).chain(structure.pieces.iter().map(|_| 3));
        Isolation { nodes: places.iter().map(isolation).collect(), levels: levels.collect() }
    }

    /// Returns the isolation of the nodes of an item: of the two modules of a seat from the foot on, or of an element.
    pub fn of(&self, item: usize) -> &[u64] {
        &self.nodes[item]
    }

    /// Ranks a set of items.
    pub fn rank(&self, items: Items) -> Rank {
        let nodes: Vec<u64> = items.iter().flat_map(|i| self.nodes[i].iter().copied()).collect();
        let level = items.iter().map(|i| self.levels[i]).max().unwrap_or(0);
        Rank { isolation: nodes.iter().sum::<u64>() / nodes.len().max(1) as u64, level, items }
    }
}

/// The order of thesis B.5.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ThesisOrder {
    /// All kinematic chains of the structure, as B.5 sorts them.
    pub chains: Vec<Rank>,
    /// The chains that are taken, in order.
    pub taken: Vec<Rank>,
    /// The elements whose metamodules have all been taken without them.
    pub left_over: Vec<usize>,
}

/// Returns the order of thesis B.5: kinematic chains by their mean isolation, the lowest first. What stands is stable at
/// any time by the same rules as in the search; nothing is taken back.
pub fn thesis_order(structure: &Structure) -> ThesisOrder {
    let isolation = Isolation::new(structure);
    let whole = structure.whole();
    let mut chains: Vec<Rank> = structure.chains(whole).into_iter().map(|c| isolation.rank(c)).collect();
    chains.sort_unstable();
    let (mut standing, mut taken) = (Items::default(), Vec::new());
    for chain in &chains {
        let is_new = standing.without(chain.items) == standing;
        if is_new && structure.stable(standing.with(chain.items)).is_ok() {
            standing = standing.with(chain.items);
            taken.push(*chain);
        }
    }
    ThesisOrder { chains, taken, left_over: structure.pieces_in(whole.without(standing)).collect() }
}

impl Structure {
    /// Returns the kinematic chains of a set of items: each metamodule, and each with a piece that it holds.
    pub fn chains(&self, items: Items) -> Vec<Items> {
        let mut chains: Vec<Items> = self.seats_in(items).map(Items::one).collect();
        for piece in self.pieces_in(items) {
            let of = self.seats_in(items).filter(|seat| self.is_bond(piece, *seat));
            chains.extend(of.map(|seat| Items::one(seat).with(Items::one(self.item_of(piece)))));
        }
        chains
    }

    /// Returns the bundles of a set of items in the order of trying. Metamodules alone leave first, so that pieces are placed
    /// early, while there is room and many metamodules are free. Otherwise the order is that of B.5 reversed: highest
    /// level, then highest isolation first. Pieces alone come last, since a further metamodule is needed.
    pub(super) fn bundles(&self, isolation: &Isolation, items: Items) -> Vec<Items> {
        let mut chains: Vec<Rank> = self.chains(items).into_iter().map(|c| isolation.rank(c)).collect();
        let pieces = |r: &Rank| self.pieces_in(r.items).count();
        chains.sort_unstable_by_key(|r| (pieces(r), Reverse(r.level), Reverse(r.isolation), r.items));
        let alone = self.pieces_in(items).map(|piece| Items::one(self.item_of(piece)));
        chains.into_iter().map(|r| r.items).chain(alone).collect()
    }
}

//! From cubes to modules: which drawn cubes pair up, why some do not, and what to change.
//!
//! A module covers two cells that share a face. A structure can be built of modules if its graph of cells has a
//! perfect matching (thesis C.6.3). The cells of a lattice are two-coloured by the parity of x + y + z, so the graph
//! is bipartite. `matching` finds a maximum matching, `reason` the certificate of Hall for the cells left over,
//! `repair` the least changes that make a structure buildable, `split` chains of two modules; `pins` are pairs that a
//! person wants. `thesis` has the published algorithm and `generated` random structures, for comparison.
//!
//! Everything follows from the sets of cells and pins alone: cells are taken in ascending order of (z, y, x) and neighbours in
//! the order of the faces. Lengths are cells. Absent: where modules walk, and whether their joints carry the structure.

mod exact_cover;
pub mod generated;
mod matching;
pub mod pins;
pub mod reason;
pub mod repair;
pub mod split;
mod symmetry;
pub mod thesis;

use matching::Matching;
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::shape::components;
use petgraph::graph::UnGraph;
use pins::Pin;
use serde::Serialize;
use std::collections::BTreeSet;
use thiserror::Error;

/// The largest number of cells of a structure that is analysed.
pub const MAX_CELLS: usize = 200_000;

/// Is asked in the course of a long search whether to continue.
pub type Going<'a> = &'a dyn Fn() -> bool;

/// The number that stands for no cell.
const NONE: u32 = u32::MAX;

/// Why a set of cells is not analysed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PairingError {
    /// There is no cell.
    #[error("there is no cell")]
    Empty,
    /// More than [`MAX_CELLS`].
    #[error("there are {0} cells; {MAX_CELLS} is the maximum")]
    TooMany(usize),
    /// A cell is too far away.
    #[error("the cell {0} is out of range; coordinates go from -16383 to 16383")]
    OutOfRange(Cell),
    /// The cells are not connected through faces.
    #[error("the cells are in {parts} parts; no path through faces leads from {from} to {to}")]
    Disconnected {
        /// The number of parts.
        parts: usize,
        /// A cell of the first part.
        from: Cell,
        /// A cell of the second part.
        to: Cell,
    },
    /// A pin names a cell that is not drawn.
    #[error("the pin {} {} names the cell {free}, which is not there", pin[0], pin[1])]
    PinWithoutCell {
        /// The pin.
        pin: Pin,
        /// The cell that is not drawn.
        free: Cell,
    },
    /// The cells of a pin share no face.
    #[error("the cells {} and {} of a pin share no face", .0[0], .0[1])]
    PinApart(Pin),
    /// A cell is in two pins.
    #[error("the cell {0} is in two pins; a module has two cells")]
    PinnedTwice(Cell),
}

/// Returns the key by which cells are ordered here: by z, y and x.
fn key(cell: Cell) -> u64 {
    [cell.z, cell.y, cell.x].iter().fold(0, |key, c| key << 16 | u64::from(c.wrapping_sub(i16::MIN) as u16))
}

/// Returns true if x + y + z is even.
fn is_even(cell: Cell) -> bool {
    (i32::from(cell.x) + i32::from(cell.y) + i32::from(cell.z)) % 2 == 0
}

/// The drawn cells and the free cells beside them, with their neighbours.
///
/// *Invariant.* `cells` ascends by [`key`]; `drawn` cells are connected.
#[derive(Clone, Debug)]
struct Surroundings {
    cells: Vec<Cell>,
    /// By cell and face; [`NONE`] where there is no cell.
    neighbours: Vec<[u32; 6]>,
    /// The neighbours that may be partners, by cell and face; `None` if all may be, since there are no pins.
    choices: Option<Vec<[u32; 6]>>,
    /// By cell, what a pin joins it with, or [`NONE`]; empty if there are no pins.
    pinned: Vec<u32>,
    drawn: Vec<bool>,
    /// The lowest drawn layer.
    floor: i16,
}

impl Surroundings {
    fn of(drawn: &BTreeSet<Cell>) -> Surroundings {
        let floor = drawn.iter().map(|c| c.z).min().unwrap_or(0);
        let beside = drawn.iter().flat_map(|c| c.neighbours()).filter(|c| c.in_range());
        // A drawn cell comes before the same cell beside another one, and is the one that is kept.
        let mut keyed: Vec<(u64, Cell)> = beside.map(|c| (key(c) << 1 | 1, c)).collect();
        keyed.extend(drawn.iter().map(|c| (key(*c) << 1, *c)));
        keyed.sort_unstable_by_key(|(key, _)| *key);
        keyed.dedup_by_key(|(key, _)| *key >> 1);
        let cells: Vec<Cell> = keyed.iter().map(|(_, cell)| *cell).collect();
        let mut neighbours = vec![[NONE; 6]; cells.len()];
        for face in Face::ALL {
            // Neighbours on one side ascend as the cells do.
            let mut near = 0;
            for (i, cell) in cells.iter().enumerate() {
                let wanted = key(cell.step(face));
                while keyed.get(near).is_some_and(|(key, _)| key >> 1 < wanted) {
                    near += 1;
                }
                if keyed.get(near).is_some_and(|(key, _)| key >> 1 == wanted) {
                    neighbours[i][face.index()] = near as u32;
                }
            }
        }
        let drawn = keyed.iter().map(|(key, _)| key & 1 == 0).collect();
        Surroundings { cells, neighbours, choices: None, pinned: Vec::new(), drawn, floor }
    }
    /// Returns true if the present cells are connected; no cell is not.
    fn is_connected(&self, present: &[bool]) -> bool {
        let Some(start) = present.iter().position(|p| *p) else { return false };
        let mut seen = vec![false; present.len()];
        seen[start] = true;
        let (mut queue, mut reached) = (vec![start as u32], 0);
        while let Some(cell) = queue.pop() {
            reached += 1;
            for near in self.neighbours[cell as usize].into_iter().filter(|n| *n != NONE) {
                if present[near as usize] && !seen[near as usize] {
                    seen[near as usize] = true;
                    queue.push(near);
                }
            }
        }
        reached == present.iter().filter(|p| **p).count()
    }
    /// Returns the neighbours that may be partners of a cell, by face.
    fn choices(&self, cell: u32) -> &[u32; 6] {
        &self.choices.as_ref().unwrap_or(&self.neighbours)[cell as usize]
    }
    fn index(&self, cell: Cell) -> Option<u32> {
        self.cells.binary_search_by_key(&key(cell), |c| key(*c)).ok().map(|i| i as u32)
    }
    /// Returns the present cells as a graph, in which a node has the index of its cell.
    fn graph(&self, present: &[bool]) -> UnGraph<(), (), u32> {
        let mut graph = UnGraph::with_capacity(self.cells.len(), 3 * self.cells.len());
        for _ in &self.cells {
            graph.add_node(());
        }
        for (i, neighbours) in self.neighbours.iter().enumerate().filter(|(i, _)| present[*i]) {
            for n in neighbours.iter().filter(|n| **n != NONE && (**n as usize) < i && present[**n as usize])
            {
                graph.add_edge((i as u32).into(), (*n).into(), ());
            }
        }
        graph
    }
}

/// A structure with a maximum matching of its cells.
#[derive(Clone, Debug)]
pub struct Pairing {
    around: Surroundings,
    matching: Matching,
    /// Cells that some maximum matching leaves over.
    free: Vec<bool>,
    unpaired: usize,
    /// In ascending order.
    pins: Vec<Pin>,
}

/// The cells of each colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Colours {
    /// With x + y + z even.
    pub even: usize,
    /// With x + y + z odd.
    pub odd: usize,
}

impl Pairing {
    /// Pairs the cells; a cell that is listed twice counts once.
    ///
    /// # Errors
    /// Refuses a set that is empty, too large, out of range or not connected.
    pub fn of(cells: &[Cell]) -> Result<Pairing, PairingError> {
        Pairing::pinned(cells, &[])
    }

    /// Pairs the cells so that those of each pin are partners; a pin that is listed twice counts once.
    ///
    /// # Errors
    /// Refuses what [`Pairing::of`] does, and pins whose cells are not drawn, share no face, or are in another pin.
    pub fn pinned(cells: &[Cell], pins: &[Pin]) -> Result<Pairing, PairingError> {
        let drawn: BTreeSet<Cell> = cells.iter().copied().collect();
        if drawn.is_empty() {
            return Err(PairingError::Empty);
        }
        if drawn.len() > MAX_CELLS {
            return Err(PairingError::TooMany(drawn.len()));
        }
        if let Some(far) = drawn.iter().find(|c| !c.in_range()) {
            return Err(PairingError::OutOfRange(*far));
        }
        let mut around = Surroundings::of(&drawn);
        if !around.is_connected(&around.drawn) {
            let parts = components(cells);
            // A part begins with its least cell.
            let (from, to) = (parts[0][0], parts[1][0]);
            return Err(PairingError::Disconnected { parts: parts.len(), from, to });
        }
        let pins = pins::checked(&drawn, pins)?;
        around.pin(&pins);
        let mut matching = Matching::new(&around);
        matching.complete(&around, Face::ALL, None);
        let free = matching.free(&around);
        let unpaired = matching.unpaired().count();
        Ok(Pairing { around, matching, free, unpaired, pins })
    }

    /// Returns the cells in ascending order of (z, y, x).
    pub fn cells(&self) -> impl Iterator<Item = Cell> + '_ {
        self.around.cells.iter().zip(&self.around.drawn).filter(|(_, drawn)| **drawn).map(|(cell, _)| *cell)
    }
    /// Returns the number of cells that no pairing covers, at least: 0 if the structure can be built of modules.
    pub fn unpaired(&self) -> usize {
        self.unpaired
    }
    /// Returns the pairs, each with its smaller cell first.
    pub fn pairs(&self) -> Vec<[Cell; 2]> {
        self.named_pairs(&self.matching)
    }
    fn named_pairs(&self, matching: &Matching) -> Vec<[Cell; 2]> {
        let cells = &self.around.cells;
        let mates = matching.mates().iter().enumerate();
        mates
            .filter(|(i, mate)| **mate != NONE && *i < **mate as usize)
            .map(|(i, mate)| [cells[i], cells[*mate as usize]])
            .collect()
    }
    /// Returns the cells that this pairing leaves over.
    pub fn left_over(&self) -> Vec<Cell> {
        self.matching.unpaired().map(|i| self.around.cells[i as usize]).collect()
    }
    /// Returns a maximum matching that has as many of these pairs as alternating searches leave, and the cells that it
    /// leaves over: what is shown does not jump about while cells are drawn. Pairs that do not fit are passed over.
    pub fn keeping(&self, pairs: &[[Cell; 2]]) -> (Vec<[Cell; 2]>, Vec<Cell>) {
        let around = &self.around;
        let mut matching = Matching::new(around);
        for [a, b] in pairs {
            if let (Some(i), Some(j)) = (around.index(*a), around.index(*b)) {
                matching.pair(around, i, j);
            }
        }
        matching.complete(around, Face::ALL, None);
        (self.named_pairs(&matching), matching.unpaired().map(|i| around.cells[i as usize]).collect())
    }
    /// Counts the cells of each colour. Unequal counts are the simplest reason why cells stay left over.
    pub fn colours(&self) -> Colours {
        let even = self.cells().filter(|c| is_even(*c)).count();
        Colours { even, odd: self.cells().count() - even }
    }
}

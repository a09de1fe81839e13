//! Why cells stay left over: a certificate of Hall, which can be counted by hand.

use super::pins::Pin;
use super::{NONE, Pairing};
use metamorph_core::lattice::Cell;
use serde::Serialize;
use std::collections::BTreeSet;

/// Cells of one colour that together touch fewer cells than they are, pinned ones aside.
///
/// *Invariant.* `cells` has more cells than `neighbours`. `neighbours` and the cells of `pins` contain all the drawn cells
/// that share a face with one of `cells`. All ascend by (z, y, x).
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Reason {
    /// The cells that need partners.
    pub cells: Vec<Cell>,
    /// All their possible partners.
    pub neighbours: Vec<Cell>,
    /// The pins that keep a cell beside them from being their partner.
    pub pins: Vec<Pin>,
}

impl Reason {
    /// Returns the number of cells that find no partner.
    pub fn missing(&self) -> usize {
        self.cells.len() - self.neighbours.len()
    }
}

impl Pairing {
    /// Returns the cells that some maximum matching leaves over (D in the decomposition of Gallai and Edmonds).
    pub fn free(&self) -> Vec<Cell> {
        self.marked(&self.free)
    }
    /// Returns the neighbours of [`Pairing::free`] (A).
    pub fn touched(&self) -> Vec<Cell> {
        self.marked(&self.touched_marks())
    }
    /// Returns the certificates. Their [`Reason::missing`] add up to [`Pairing::unpaired`].
    pub fn reasons(&self) -> Vec<Reason> {
        let touched = self.touched_marks();
        let mut seen = vec![false; touched.len()];
        let mut reasons = Vec::new();
        for start in (0..touched.len()).filter(|i| self.free[*i]) {
            if seen[start] {
                continue;
            }
            seen[start] = true;
            let (mut cells, mut neighbours) = (BTreeSet::new(), BTreeSet::new());
            let mut queue = vec![start as u32];
            while let Some(at) = queue.pop() {
                let of_free = self.free[at as usize];
                if of_free {
                    cells.insert(at)
                } else {
                    neighbours.insert(at)
                };
                for near in self.around.choices(at).iter().copied().filter(|n| *n != NONE) {
                    let other = if of_free { touched[near as usize] } else { self.free[near as usize] };
                    if other && !seen[near as usize] {
                        seen[near as usize] = true;
                        queue.push(near);
                    }
                }
            }
            let named = |set: BTreeSet<u32>| set.into_iter().map(|i| self.around.cells[i as usize]).collect();
            let pins = self.pins_beside(&cells);
            reasons.push(Reason { cells: named(cells), neighbours: named(neighbours), pins });
        }
        reasons
    }

    /// Returns the pins with a cell beside one of these, in ascending order.
    fn pins_beside(&self, cells: &BTreeSet<u32>) -> Vec<Pin> {
        if self.pins.is_empty() {
            return Vec::new();
        }
        let near = cells.iter().flat_map(|i| self.around.neighbours[*i as usize]).filter(|n| *n != NONE);
        let pins: BTreeSet<[u32; 2]> = near
            .filter_map(|one| self.around.pinned_to(one).map(|other| [one.min(other), one.max(other)]))
            .collect();
        pins.into_iter().map(|pin| pin.map(|i| self.around.cells[i as usize])).collect()
    }

    fn touched_marks(&self) -> Vec<bool> {
        let mut touched = vec![false; self.free.len()];
        for i in (0..self.free.len()).filter(|i| self.free[*i]) {
            debug_assert!(self.around.drawn[i], "only drawn cells are left over");
            for near in self
                .around
                .choices(i as u32)
                .iter()
                .filter(|n| **n != NONE && self.around.drawn[**n as usize])
            {
                touched[*near as usize] = true;
            }
        }
        touched
    }
    fn marked(&self, marks: &[bool]) -> Vec<Cell> {
        self.around.cells.iter().zip(marks).filter(|(_, marked)| **marked).map(|(cell, _)| *cell).collect()
    }
}

//! The passive elements of a scene: where they are, and who holds them.

use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use serde::Serialize;
use std::collections::BTreeSet;

/// How an element is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Hold {
    /// It rests.
    Rests,
    /// One module holds it.
    Held,
    /// Several modules hold it: it is handed over, or at its goal.
    Shared,
    /// It has fallen.
    Fallen,
}

/// An element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ElementView {
    /// Its cells, sorted.
    pub cells: Vec<Cell>,
    /// How it is held.
    pub hold: Hold,
}

/// The elements, and how far they are known.
#[derive(Clone, Debug, Default)]
pub struct Elements {
    all: Vec<ElementView>,
    holders: Vec<BTreeSet<ModuleId>>,
}

impl Elements {
    /// Sets where the elements lie at the start, unless that is known; returns true if it was not.
    pub fn lay_out(&mut self, cells: Vec<Vec<Cell>>) -> bool {
        let is_new = self.all.len() != cells.len();
        if is_new {
            self.holders = vec![BTreeSet::new(); cells.len()];
            let rests = |cells| ElementView { cells, hold: Hold::Rests };
            self.all = cells.into_iter().map(rests).collect();
        }
        is_new
    }

    /// Notes which element a module holds, and where it is then; returns true if something changed.
    pub fn carried(&mut self, id: ModuleId, held: Option<(usize, Vec<Cell>)>) -> bool {
        let before = self.all.clone();
        let of = held.as_ref().map(|(element, _)| *element);
        for (i, (view, holders)) in self.all.iter_mut().zip(&mut self.holders).enumerate() {
            let changed = if of == Some(i) { holders.insert(id) } else { holders.remove(&id) };
            if changed {
                view.hold = match holders.len() {
                    0 => Hold::Rests,
                    1 => Hold::Held,
                    _ => Hold::Shared,
                };
            }
        }
        if let Some((element, cells)) = held
            && let Some(view) = self.all.get_mut(element)
        {
            view.cells = cells;
        }
        before != self.all
    }

    /// Notes that an element fell; `effect` says how far, in the words of the record of the fault.
    pub fn fell(&mut self, element: usize, effect: &str) -> bool {
        let words = effect.split_once("it fell ").and_then(|(_, rest)| rest.split_once(" cells"));
        let Some((view, down)) =
            self.all.get_mut(element).zip(words.and_then(|(n, _)| n.parse::<i16>().ok()))
        else {
            return false;
        };
        view.cells.iter_mut().for_each(|cell| cell.z -= down);
        view.hold = Hold::Fallen;
        self.holders[element].clear();
        true
    }

    /// Returns all elements.
    pub fn all(&self) -> &[ElementView] {
        &self.all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_carried_handed_over_and_dropped() {
        let (a, b, cell) = (ModuleId(0), ModuleId(1), |z| vec![Cell::new(0, 0, z)]);
        let mut elements = Elements::default();
        assert!(elements.lay_out(vec![cell(0)]) && !elements.lay_out(vec![cell(5)]));
        assert!(elements.carried(a, Some((0, cell(3)))));
        assert_eq!(elements.all(), [ElementView { cells: cell(3), hold: Hold::Held }]);
        assert!(elements.carried(b, Some((0, cell(3)))) && !elements.carried(b, Some((0, cell(3)))));
        assert_eq!(elements.all()[0].hold, Hold::Shared);
        assert!(elements.carried(a, None));
        assert_eq!(elements.all()[0].hold, Hold::Held);
        assert!(elements.fell(0, "top: it fell 2 cells") && !elements.fell(0, "top: it was not held"));
        assert_eq!(elements.all(), [ElementView { cells: cell(1), hold: Hold::Fallen }]);
        assert!(!elements.fell(7, "it fell 1 cells"));
    }
}

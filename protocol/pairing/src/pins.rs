//! Pins: two neighbouring cells that a person wants to be one module (thesis C.3.2). All other edges of the two are
//! dropped, so that every matching has the pin, and everything that follows from matchings keeps it.
//!
//! A pin may cost a module. Which ones do is found by giving them one after the other, in ascending order: a pin that
//! lowers the number of pairs is left out, and named. Without the named ones, as many cells have partners as without any
//! pin; each of them together with the others lowers that number.

use super::matching::Matching;
use super::{Going, NONE, Pairing, PairingError, Surroundings, key};
use metamorph_core::lattice::{Cell, Face};
use std::collections::{BTreeMap, BTreeSet};

/// Two cells that are one module, the one with the smaller (z, y, x) first.
pub type Pin = [Cell; 2];

/// Returns the pins in ascending order, each once.
///
/// # Errors
/// Refuses pins whose cells are not drawn, share no face, or are in another pin.
pub fn checked(drawn: &BTreeSet<Cell>, pins: &[Pin]) -> Result<Vec<Pin>, PairingError> {
    let mut partners: BTreeMap<Cell, Cell> = BTreeMap::new();
    let mut checked: BTreeMap<[u64; 2], Pin> = BTreeMap::new();
    for [a, b] in pins {
        let pin = if key(*a) <= key(*b) { [*a, *b] } else { [*b, *a] };
        if let Some(free) = pin.into_iter().find(|cell| !drawn.contains(cell)) {
            return Err(PairingError::PinWithoutCell { pin, free });
        }
        if a.face_to(*b).is_none() {
            return Err(PairingError::PinApart(pin));
        }
        for (one, other) in [(*a, *b), (*b, *a)] {
            if partners.insert(one, other).is_some_and(|before| before != other) {
                return Err(PairingError::PinnedTwice(one));
            }
        }
        checked.insert(pin.map(key), pin);
    }
    Ok(checked.into_values().collect())
}

/// The structure that pairing without pins would give.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WithoutPins {
    /// The cells that every pairing would leave over at least.
    pub unpaired: usize,
    /// The pins that cannot be kept together with that number and the pins before them, in ascending order.
    pub costly: Vec<Pin>,
}

impl Surroundings {
    /// Drops all edges of pinned cells but those of the pins.
    pub(super) fn pin(&mut self, pins: &[Pin]) {
        if pins.is_empty() {
            return;
        }
        let mut of = vec![NONE; self.cells.len()];
        for [a, b] in pins {
            // Invariant: `checked` has passed these pins, so both are drawn.
            if let (Some(i), Some(j)) = (self.index(*a), self.index(*b)) {
                (of[i as usize], of[j as usize]) = (j, i);
            }
        }
        let mut choices = self.neighbours.clone();
        for (i, near) in choices.iter_mut().enumerate() {
            for n in near.iter_mut().filter(|n| **n != NONE) {
                let is_kept = if of[i] == NONE { of[*n as usize] == NONE } else { of[i] == *n };
                if !is_kept {
                    *n = NONE;
                }
            }
        }
        self.choices = Some(choices);
        self.pinned = of;
    }
    /// Returns the cell that a pin joins with this one.
    pub(super) fn pinned_to(&self, cell: u32) -> Option<u32> {
        self.pinned.get(cell as usize).copied().filter(|other| *other != NONE)
    }
}

impl Pairing {
    /// Returns the pins in ascending order.
    pub fn pins(&self) -> &[Pin] {
        &self.pins
    }

    /// Returns what would be left over without pins, and which of them are to be given up for that.
    pub fn without_pins(&self) -> WithoutPins {
        self.without_pins_while(&|| true)
    }

    /// Answers as [`Pairing::without_pins`] does, with those pins that are found before `going` returns false.
    pub fn without_pins_while(&self, going: Going<'_>) -> WithoutPins {
        let mut without = WithoutPins { unpaired: self.unpaired, costly: Vec::new() };
        if self.pins.is_empty() || self.unpaired == 0 {
            return without;
        }
        let free = Surroundings { choices: None, ..self.around.clone() };
        let mut matching = Matching::new(&free);
        matching.complete(&free, Face::ALL, None);
        without.unpaired = matching.unpaired().count();
        for pin in &self.pins {
            let [Some(a), Some(b)] = pin.map(|cell| free.index(cell)) else { continue };
            if !going() {
                break;
            }
            if !matching.pin(&free, a, b) {
                without.costly.push(*pin);
            }
        }
        without
    }
}

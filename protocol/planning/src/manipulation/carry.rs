//! Carry tables: the postures of a metamodule that holds an element, and the steps between them.
//!
//! As in the motion database, postures are numbered as in [`Table::postures`], and cells are in the foot frame with
//! class 0. A step is in the table if the metamodule takes it strictly, and the element meets neither the floor nor the
//! metamodule.

use super::contact::ElementSweeper;
use super::element::{Element, Grip, cell_at, moved};
use metamorph_core::lattice::Cell;
use metamorph_roombots::Kind;
use metamorph_roombots::database::Database;
use metamorph_roombots::posture::Placement;
use metamorph_roombots::sweep::FloorContact;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A set of the cells of a carry table, one bit each.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cells(Box<[u64]>);

impl Cells {
    /// Returns true if the sets have a cell in common.
    pub fn meets(&self, other: &Cells) -> bool {
        self.0.iter().zip(&other.0).any(|(a, b)| a & b != 0)
    }
    /// Returns the bits.
    pub fn words(&self) -> &[u64] {
        &self.0
    }
    /// Returns true if the set has no cell.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(|word| *word == 0)
    }
    /// Returns the number of cells.
    pub fn len(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }
}

/// A step of one joint by +120° or +90° with an element; backwards it sweeps the same cells.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CarryStep {
    /// The posture before.
    pub from: u16,
    /// The posture after.
    pub to: u16,
    /// The joint that turns, from 0.
    pub joint: u8,
    /// The cells that metamodule and element enter deeper than 2.2 mm; they must be free.
    pub swept: Cells,
}

/// Postures and steps of a kind with an element in one grip.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CarryTable {
    kind: Kind,
    grip: Grip,
    /// The cells that postures fill and steps sweep, sorted; sets of cells refer to them by number.
    cells: Vec<Cell>,
    /// The cells of the element in each posture, sorted; `None` where it collides.
    held: Vec<Option<Vec<Cell>>>,
    /// The cells of metamodule and element in each posture.
    fills: Vec<Option<Cells>>,
    steps: Vec<CarryStep>,
    /// For each posture, the steps that begin or end at it.
    steps_at: Vec<Vec<u16>>,
}

impl CarryTable {
    /// Generates the table of a grip.
    pub fn new(database: &Database, kind: Kind, grip: &Grip, sweeper: &mut ElementSweeper) -> CarryTable {
        let table = database.table(kind);
        let held: Vec<Option<Vec<Cell>>> =
            table.postures().iter().map(|entry| held_by(&entry.posture.placement(), grip)).collect();
        let body = |p: usize| table.postures()[p].posture.placement().cells;
        let filled = |(p, held): (usize, &Option<Vec<Cell>>)| Some([held.as_ref()?, &body(p)[..]].concat());
        let filled: Vec<Option<Vec<Cell>>> = held.iter().enumerate().map(filled).collect();
        let mut cells: BTreeSet<Cell> = filled.iter().flatten().flatten().copied().collect();
        let mut found = Vec::new();
        for step in table.steps().iter().filter(|s| s.floor == FloorContact::Free) {
            let (Some(before), Some(after)) = (&held[usize::from(step.from)], &held[usize::from(step.to)])
            else {
                continue;
            };
            let posture = table.postures()[usize::from(step.from)].posture;
            let Some(mut swept) = sweeper.step(posture, usize::from(step.joint), before) else { continue };
            swept.extend(before.iter().chain(after));
            swept.extend(database.resolve(&step.core.union(&step.graze)));
            cells.extend(swept.iter().copied());
            found.push((step, swept));
        }
        let mut carry = CarryTable {
            kind,
            grip: grip.clone(),
            cells: cells.into_iter().collect(),
            steps_at: vec![Vec::new(); held.len()],
            held,
            fills: Vec::new(),
            steps: Vec::with_capacity(found.len()),
        };
        let fills = |cells: &Option<Vec<Cell>>| cells.as_ref().map(|f| carry.set(|cell| f.contains(&cell)));
        carry.fills = filled.iter().map(fills).collect();
        for (step, swept) in found {
            for posture in [step.from, step.to] {
                carry.steps_at[usize::from(posture)].push(carry.steps.len() as u16);
            }
            let swept = carry.set(|cell| swept.contains(&cell));
            carry.steps.push(CarryStep { from: step.from, to: step.to, joint: step.joint, swept });
        }
        carry
    }

    /// Generates the tables of all grips of an element.
    pub fn all(database: &Database, kind: Kind, element: &Element) -> Vec<CarryTable> {
        let mut sweeper = ElementSweeper::new();
        element.grips().iter().map(|grip| CarryTable::new(database, kind, grip, &mut sweeper)).collect()
    }

    /// Returns the table of the grip that allows the most: the largest connected set, then the most steps.
    pub fn best(tables: &[CarryTable]) -> Option<&CarryTable> {
        // The first of equal ones.
        tables.iter().rev().max_by_key(|t| (t.main_set().len(), t.steps.len()))
    }

    /// Returns the kind of metamodule.
    pub fn kind(&self) -> Kind {
        self.kind
    }
    /// Returns the grip.
    pub fn grip(&self) -> &Grip {
        &self.grip
    }
    /// Returns the steps.
    pub fn steps(&self) -> &[CarryStep] {
        &self.steps
    }
    /// Returns the number of postures, valid or not.
    pub fn postures(&self) -> usize {
        self.held.len()
    }
    /// Returns the postures in which the element collides with nothing, ascending.
    pub fn valid_postures(&self) -> Vec<u16> {
        (0..self.held.len() as u16).filter(|p| self.held(*p).is_some()).collect()
    }
    /// Returns the cells of metamodule and element in a posture; `None` if the element collides.
    pub fn fills(&self, posture: u16) -> Option<&Cells> {
        self.fills.get(usize::from(posture))?.as_ref()
    }
    /// Returns the number of postures in which the element collides with nothing.
    pub fn valid(&self) -> usize {
        self.held.iter().flatten().count()
    }
    /// Returns the cells of the element in a posture, sorted; `None` if it collides there.
    pub fn held(&self, posture: u16) -> Option<&[Cell]> {
        self.held.get(usize::from(posture))?.as_deref()
    }
    /// Returns the cells that postures fill and steps sweep, sorted.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }
    /// Returns the set of the cells of [`CarryTable::cells`] for which `is_in` holds.
    pub fn set(&self, is_in: impl Fn(Cell) -> bool) -> Cells {
        let mut words = vec![0; self.cells.len().div_ceil(64)];
        for (i, cell) in self.cells.iter().enumerate() {
            words[i / 64] |= u64::from(is_in(*cell)) << (i % 64);
        }
        Cells(words.into())
    }

    /// Returns the cells of a set.
    pub fn resolve<'a>(&'a self, set: &'a Cells) -> impl Iterator<Item = Cell> + 'a {
        let is_in = |i: usize| set.0.get(i / 64).is_some_and(|word| word >> (i % 64) & 1 == 1);
        self.cells.iter().enumerate().filter(move |(i, _)| is_in(*i)).map(|(_, cell)| *cell)
    }
    /// Returns the number of the step between two postures, in either direction.
    pub fn step_between(&self, from: u16, to: u16) -> Option<usize> {
        let mut at = self.steps_at.get(usize::from(from))?.iter().map(|i| usize::from(*i));
        at.find(|i| [(from, to), (to, from)].contains(&(self.steps[*i].from, self.steps[*i].to)))
    }

    /// Returns the sets of postures that steps connect, largest first, postures ascending. Only valid postures that
    /// `stands` accepts and steps that `passes` accepts count.
    pub fn connected(&self, stands: impl Fn(u16) -> bool, passes: impl Fn(usize) -> bool) -> Vec<Vec<u16>> {
        let mut open: Vec<bool> =
            (0..self.held.len()).map(|p| self.held[p].is_some() && stands(p as u16)).collect();
        let mut sets = Vec::new();
        for first in 0..self.held.len() {
            if !std::mem::replace(&mut open[first], false) {
                continue;
            }
            let mut set = vec![first as u16];
            let mut next = 0;
            while let Some(at) = set.get(next).copied() {
                next += 1;
                for i in self.steps_at[usize::from(at)].iter().map(|i| usize::from(*i)) {
                    let step = &self.steps[i];
                    let to = if step.from == at { step.to } else { step.from };
                    if open[usize::from(to)] && passes(i) {
                        open[usize::from(to)] = false;
                        set.push(to);
                    }
                }
            }
            set.sort_unstable();
            sets.push(set);
        }
        sets.sort_by_key(|set| (std::cmp::Reverse(set.len()), set[0]));
        sets
    }

    /// Returns the shortest path of steps that `passes` accepts: the steps with the posture after each. `None` if
    /// there is none.
    pub fn path(&self, from: u16, to: u16, passes: impl Fn(usize) -> bool) -> Option<Vec<(usize, u16)>> {
        let mut came_by: Vec<Option<(usize, u16)>> = vec![None; self.held.len()];
        let mut order = vec![from];
        let mut next = 0;
        while let Some(at) = order.get(next).copied().filter(|at| *at != to) {
            next += 1;
            for i in self.steps_at[usize::from(at)].iter().map(|i| usize::from(*i)) {
                let step = &self.steps[i];
                let after = if step.from == at { step.to } else { step.from };
                if after != from && came_by[usize::from(after)].is_none() && passes(i) {
                    came_by[usize::from(after)] = Some((i, at));
                    order.push(after);
                }
            }
        }
        let mut path = Vec::new();
        let mut at = to;
        while at != from {
            let (step, before) = came_by[usize::from(at)]?;
            path.push((step, at));
            at = before;
        }
        path.reverse();
        Some(path)
    }

    /// Returns the largest set of postures that steps connect on an open floor.
    pub fn main_set(&self) -> Vec<u16> {
        self.connected(|_| true, |_| true).into_iter().next().unwrap_or_default()
    }
}

/// Returns the cells of the element that a metamodule holds, sorted; `None` if one is below the floor or in the
/// metamodule.
pub fn held_by(placement: &Placement, grip: &Grip) -> Option<Vec<Cell>> {
    let mut cells: Vec<Cell> = grip.centres.iter().map(|c| cell_at(moved(placement.head, *c))).collect();
    cells.sort_unstable();
    let free = cells.iter().all(|c| c.z >= 0 && !placement.cells.contains(c));
    free.then_some(cells)
}

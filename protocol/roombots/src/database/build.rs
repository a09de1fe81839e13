//! Generates the database.

use super::format::with_places;
use super::{CellSet, Database, NOT_CONNECTED, PostureEntry, Step, Table};
use crate::Kind;
use crate::posture::Posture;
use crate::shape::Shape;
use crate::sweep::{FloorContact, StepSweep, Sweeper};
use metamorph_core::lattice::Cell;
use std::collections::{BTreeSet, VecDeque};

pub(super) fn build() -> Database {
    let mut sweeper = Sweeper::new();
    let builders: Vec<TableBuilder> =
        Kind::ALL.into_iter().map(|kind| table_builder(kind, &mut sweeper)).collect();
    let mut cells: BTreeSet<Cell> = BTreeSet::new();
    for (_, _, _, sweep) in builders.iter().flat_map(|d| &d.steps) {
        cells.extend(sweep.core.iter().chain(&sweep.graze).filter(|c| c.z >= 0));
    }
    let cells: Vec<Cell> = cells.into_iter().collect();
    // Numbers of cells are bytes. The chains reach three cells far, and 130 cells occur.
    debug_assert!(cells.len() <= 256);
    let mut database = Database { cells, tables: Vec::new() };
    database.tables = builders.into_iter().map(|d| table(d, &database)).collect();
    database
}

/// Postures and steps before cells have numbers.
struct TableBuilder {
    kind: Kind,
    postures: Vec<Posture>,
    steps: Vec<(u16, u16, u8, StepSweep)>,
}

fn table_builder(kind: Kind, sweeper: &mut Sweeper) -> TableBuilder {
    let postures: Vec<Posture> = Posture::all(kind).filter(|p| p.placement().above_floor()).collect();
    let mut steps = Vec::new();
    for (from, posture) in postures.iter().enumerate() {
        for joint in 0..kind.joints() {
            let Ok(to) = postures.binary_search(&posture.turned(joint)) else { continue };
            let sweep = sweeper.step(*posture, joint);
            if !sweep.own_body && sweep.floor <= FloorContact::Plate {
                steps.push((from as u16, to as u16, joint as u8, sweep));
            }
        }
    }
    TableBuilder { kind, postures, steps }
}

fn table(builder: TableBuilder, database: &Database) -> Table {
    let TableBuilder { kind, postures, steps } = builder;
    let set = |cells: &[Cell]| database.cell_set(cells.iter().copied());
    let steps: Vec<Step> = steps
        .into_iter()
        .map(|(from, to, joint, sweep)| {
            let (core, graze): (CellSet, CellSet) = (set(&sweep.core), set(&sweep.graze));
            Step { from, to, joint, floor: sweep.floor, core, graze }
        })
        .collect();

    let entries = postures
        .into_iter()
        .map(|posture| PostureEntry { posture, chain: 0, landing: None, main: false })
        .collect();
    let mut table = with_places(kind, entries);
    table.steps = steps;
    table.index_steps();
    table.set_main_set();
    table.min_steps = table.all_min_steps();
    table
}

/// Returns the shape of a chain of cells; two cells are straight.
pub(super) fn shape_of(cells: &[Cell]) -> Shape {
    let direction = |i: usize| cells[i].face_to(cells[i + 1]);
    match cells.len() {
        4 => direction(0)
            .zip(direction(1))
            .zip(direction(2))
            .and_then(|((a, b), c)| Shape::of([a, b, c]))
            .unwrap_or(Shape::I),
        _ => Shape::I,
    }
}

impl Table {
    pub(super) fn index_steps(&mut self) {
        self.steps_at = vec![Vec::new(); self.postures.len()];
        for (i, step) in self.steps.iter().enumerate() {
            self.steps_at[usize::from(step.from)].push(i as u16);
            self.steps_at[usize::from(step.to)].push(i as u16);
        }
    }

    /// Returns the number of strict steps from the nearest of `starts`; `u8::MAX` where there is no path.
    fn distances(&self, starts: &[u16]) -> Vec<u8> {
        let mut distance = vec![NOT_CONNECTED; self.postures.len()];
        let mut queue: VecDeque<u16> = starts.iter().copied().collect();
        for s in starts {
            distance[usize::from(*s)] = 0;
        }
        while let Some(at) = queue.pop_front() {
            for i in &self.steps_at[usize::from(at)] {
                let step = &self.steps[usize::from(*i)];
                let next = if step.from == at { step.to } else { step.from };
                if step.floor == FloorContact::Free && distance[usize::from(next)] == NOT_CONNECTED {
                    distance[usize::from(next)] = distance[usize::from(at)] + 1;
                    queue.push_back(next);
                }
            }
        }
        distance
    }

    fn set_main_set(&mut self) {
        let mut known = vec![false; self.postures.len()];
        let mut largest: Vec<usize> = Vec::new();
        for start in 0..self.postures.len() {
            if known[start] {
                continue;
            }
            let reach = self.distances(&[start as u16]);
            let set: Vec<usize> = (0..reach.len()).filter(|i| reach[*i] != NOT_CONNECTED).collect();
            for i in &set {
                known[*i] = true;
            }
            if set.len() > largest.len() {
                largest = set;
            }
        }
        for i in largest {
            self.postures[i].main = true;
        }
    }

    fn all_min_steps(&self) -> Vec<u8> {
        let mut all = Vec::with_capacity(self.chains.len().pow(2));
        for from in &self.chains {
            let distance = self.distances(&from.postures);
            for to in &self.chains {
                let best = to.postures.iter().map(|p| distance[usize::from(*p)]).min();
                all.push(best.unwrap_or(NOT_CONNECTED));
            }
        }
        all
    }
}

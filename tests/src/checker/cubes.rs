//! Cubes that slide over each other: a second implementation of the rules of the sliding-cube model.

use super::{Bodies, Broken, Cell, Rule, demand, plus};
use std::collections::{BTreeMap, BTreeSet};

/// East, west, north, south, up, down, in the order of their numbers on the wire.
const DIRECTIONS: [Cell; 6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];

/// A move under way.
struct Move {
    to: Cell,
    corner: Option<Cell>,
    /// The cubes that it moves over.
    supports: [u32; 2],
}

/// The positions of all cubes.
pub struct Cubes {
    cells: Vec<Option<Cell>>,
    /// The cube in each cell.
    at: BTreeMap<Cell, u32>,
    /// The cube that moves into a cell, or through it.
    reserved: BTreeMap<Cell, u32>,
    moving: BTreeMap<u32, Move>,
}

fn cell(place: &[u8]) -> Result<Cell, Broken> {
    let [a, b, c, d, e, f] = *place else {
        return Err((Rule::Readable, format!("{place:?} is not a cell")));
    };
    Ok([[a, b], [c, d], [e, f]].map(|c| i16::from_le_bytes(c).into()))
}

impl Cubes {
    /// Creates cubes without places.
    pub fn new(count: usize) -> Cubes {
        let (at, reserved) = (BTreeMap::new(), BTreeMap::new());
        Cubes { cells: vec![None; count], at, reserved, moving: BTreeMap::new() }
    }

    fn cell_of(&self, id: u32) -> Result<Cell, Broken> {
        let known = self.cells.get(id as usize).copied().flatten();
        known.ok_or_else(|| (Rule::Follows, format!("module {id} has no place")))
    }

    /// Returns the cube in a cell, if it rests.
    fn resting(&self, cell: Cell) -> Option<u32> {
        self.at.get(&cell).copied().filter(|id| !self.moving.contains_key(id))
    }

    fn check_connected(&self) -> Result<(), Broken> {
        let resting: BTreeSet<Cell> =
            self.at.iter().filter(|(_, id)| !self.moving.contains_key(id)).map(|(cell, _)| *cell).collect();
        let Some(first) = resting.first() else { return Ok(()) };
        let (mut seen, mut stack) = (BTreeSet::from([*first]), vec![*first]);
        while let Some(cell) = stack.pop() {
            let next = DIRECTIONS.map(|d| plus(cell, d)).into_iter().filter(|c| resting.contains(c));
            stack.extend(next.filter(|c| seen.insert(*c)));
        }
        demand(seen.len() == resting.len(), Rule::Connected, || {
            format!("{} of {} cubes at rest are cut off", resting.len() - seen.len(), resting.len())
        })
    }
}

impl Bodies for Cubes {
    fn place(&mut self, id: u32, place: &[u8]) -> Result<(), Broken> {
        let at = cell(place)?;
        let Some(slot) = self.cells.get_mut(id as usize) else {
            return Err((Rule::Readable, format!("there is no module {id}")));
        };
        if let Some(known) = *slot {
            return demand(known == at, Rule::Follows, || format!("module {id} is at {known:?}, not {at:?}"));
        }
        *slot = Some(at);
        let other = self.at.insert(at, id);
        demand(other.is_none(), Rule::OneBodyPerCell, || format!("{id} and {other:?} are at {at:?}"))
    }

    fn settle(&mut self) -> Result<(), Broken> {
        (0..self.cells.len() as u32).try_for_each(|id| self.cell_of(id).map(drop))?;
        self.check_connected()
    }

    fn begin(&mut self, id: u32, kind: u8, action: &[u8]) -> Result<(), Broken> {
        let from = self.cell_of(id)?;
        demand(!self.moving.contains_key(&id), Rule::Follows, || format!("{id} moves already"))?;
        let (0, [bend, support, heading, ..]) = (kind, action) else {
            return Err((Rule::Readable, format!("{action:?} is not a move")));
        };
        let (bend, axes) = (*bend == 1, [support, heading].map(|d| usize::from(*d)));
        let possible = axes.iter().all(|d| *d < 6) && axes[0] / 2 != axes[1] / 2;
        demand(possible, Rule::Possible, || format!("{id} moves along {axes:?}"))?;
        let [down, along] = axes.map(|d| DIRECTIONS[d]);
        let ahead = plus(from, along);
        // Around the edge of the cube below, or from that one to the next.
        let (to, corner, landing) = match bend {
            true => (plus(ahead, down), Some(ahead), plus(from, down)),
            false => (ahead, None, plus(ahead, down)),
        };
        let supports = [plus(from, down), landing].map(|c| self.resting(c));
        let [Some(first), Some(last)] = supports else {
            return Err((Rule::Supported, format!("{id} moves from {from:?} to {to:?} over {supports:?}")));
        };
        for cell in corner.into_iter().chain([to]) {
            let (body, reserved) = (self.at.get(&cell), self.reserved.get(&cell));
            demand(body.is_none(), Rule::OneBodyPerCell, || {
                format!("{id} enters {cell:?}, where {body:?} is")
            })?;
            demand(reserved.is_none(), Rule::Reserved, || {
                format!("{id} enters {cell:?}, which {reserved:?} is entering")
            })?;
            self.reserved.insert(cell, id);
        }
        let needs = self.moving.iter().find(|(_, m)| m.supports.contains(&id)).map(|(other, _)| other);
        demand(needs.is_none(), Rule::SupportStays, || format!("{id} leaves while {needs:?} moves over it"))?;
        self.moving.insert(id, Move { to, corner, supports: [first, last] });
        self.check_connected()
    }

    fn end(&mut self, id: u32, place: &[u8]) -> Result<bool, Broken> {
        let (from, at) = (self.cell_of(id)?, cell(place)?);
        let Some(Move { to, corner, .. }) = self.moving.remove(&id) else {
            return Err((Rule::Follows, format!("{id} ends a move that it had not begun")));
        };
        demand([from, to].contains(&at), Rule::Follows, || {
            format!("{id} moves from {from:?} to {to:?} and arrives at {at:?}")
        })?;
        for cell in corner.into_iter().chain([to]) {
            self.reserved.remove(&cell);
        }
        if at != from {
            self.at.remove(&from);
            let other = self.at.insert(at, id);
            demand(other.is_none(), Rule::OneBodyPerCell, || format!("{id} and {other:?} are at {at:?}"))?;
            self.cells[id as usize] = Some(at);
        }
        self.check_connected()?;
        Ok(at != from)
    }

    fn obstacle(&mut self, cell: Cell, _: bool) -> Result<(), Broken> {
        Err((Rule::Possible, format!("cubes have no obstacles, but one is at {cell:?}")))
    }
}

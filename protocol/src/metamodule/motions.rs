//! The motion database as agents and bodies share it, and sets of swept cells as they travel.

use super::pose::{Pose, to_frame, to_world};
use crate::lattice::Cell;
use crate::roombots::Kind;
use crate::roombots::database::{CellSet, Database, Step, Table};
use crate::roombots::grid::{GridState, fewest_moves};
use crate::roombots::sweep::FloorContact;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};
use std::sync::Arc;
use thiserror::Error;

/// Why a database cannot be used here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MotionsError {
    /// A sweep is a set of 128 bits.
    #[error("the motion database names {0} cells; 128 is the most that a message can carry")]
    TooManyCells(usize),
    /// A single module is no metamodule.
    #[error("a single module cannot be used as a metamodule; use PAR, SRS, PER or SRZ")]
    Single,
}

/// The motions of one kind of metamodule.
///
/// Serialised as the bytes of the database, so that whoever reads it has the same one to the bit.
#[derive(Clone, Debug)]
pub struct Motions {
    database: Arc<Database>,
    kind: Kind,
    strides: Arc<Strides>,
}

/// The fewest moves from a foot to every connector around it, whatever the class there, when nothing
/// is in the way. Offsets are in the foot frame.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Strides(Vec<u8>);

impl Strides {
    /// Offsets up to this are in the table.
    const RADIUS: i16 = 16;
    const SIDE: usize = 2 * Strides::RADIUS as usize + 1;

    fn of(kind: Kind) -> Strides {
        let mut table = vec![u8::MAX; Strides::SIDE * Strides::SIDE];
        for (state, moves) in fewest_moves(kind, Strides::RADIUS) {
            if let Some(slot) = Strides::index(state.x, state.y).and_then(|i| table.get_mut(i)) {
                *slot = (*slot).min(u8::try_from(moves).unwrap_or(u8::MAX));
            }
        }
        Strides(table)
    }
    fn index(x: i16, y: i16) -> Option<usize> {
        let along = |c: i16| usize::try_from(c + Strides::RADIUS).ok().filter(|i| *i < Strides::SIDE);
        Some(along(x)? * Strides::SIDE + along(y)?)
    }
}

/// A set of cells of the database, seen from a grid state; bit *i* is the *i*-th cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Sweep(pub u128);

impl Sweep {
    /// Of a set of the database. Invariant: [`Motions::new`] has checked that 128 bits are enough.
    pub fn of(set: &CellSet) -> Sweep {
        Sweep(set.indices().filter(|i| *i < 128).fold(0, |bits, i| bits | 1 << i))
    }
}

impl Motions {
    /// The motions of `kind` in a database.
    pub fn new(database: Arc<Database>, kind: Kind) -> Result<Motions, MotionsError> {
        if kind == Kind::Single {
            return Err(MotionsError::Single);
        }
        match database.cells().len() {
            0..=128 => Ok(Motions { database, kind, strides: Arc::new(Strides::of(kind)) }),
            n => Err(MotionsError::TooManyCells(n)),
        }
    }
    /// Whose motions these are.
    pub fn kind(&self) -> Kind {
        self.kind
    }
    /// The table of the kind.
    pub fn table(&self) -> &Table {
        self.database.table(self.kind)
    }

    /// The four cells of a metamodule in the world, from the attached end on. Empty if the database
    /// has no such posture, which no checked pose has.
    pub fn cells(&self, pose: Pose) -> Vec<Cell> {
        let table = self.table();
        let Some(entry) = table.postures().get(usize::from(pose.posture)) else { return Vec::new() };
        table.chains()[usize::from(entry.chain)].cells.iter().map(|c| to_world(pose.state, *c)).collect()
    }

    /// The cells of a sweep seen from a grid state.
    pub fn swept(&self, state: GridState, sweep: Sweep) -> impl Iterator<Item = Cell> + '_ {
        let cells = self.database.cells();
        (0..cells.len()).filter(move |i| sweep.0 >> i & 1 == 1).map(move |i| to_world(state, cells[i]))
    }

    /// Those of `cells` that motions from a grid state can sweep at all.
    pub fn blocked(&self, state: GridState, cells: impl IntoIterator<Item = Cell>) -> CellSet {
        self.database.cell_set(cells.into_iter().map(|c| to_frame(state, c)))
    }

    /// The step of this number and where it leads from a posture, if it is strict and begins there.
    pub fn step_from(&self, posture: u16, number: u16) -> Option<(&Step, u16)> {
        let step = self.table().steps().get(usize::from(number))?;
        let to = match posture {
            p if p == step.from => step.to,
            p if p == step.to => step.from,
            _ => return None,
        };
        (step.floor == FloorContact::Free).then_some((step, to))
    }

    /// The fewest moves from a state to a connector, on the open grid. Farther away than the table
    /// reaches, what is left of the way is counted in strides of three cells.
    pub fn moves_to(&self, from: GridState, to: (i16, i16)) -> u16 {
        let at = to_frame(from, Cell::new(to.0, to.1, 0));
        let near = |c: i16| c.clamp(-Strides::RADIUS, Strides::RADIUS);
        let beyond = at.x.abs_diff(near(at.x)) + at.y.abs_diff(near(at.y));
        let known = Strides::index(near(at.x), near(at.y)).map_or(u8::MAX, |i| self.strides.0[i]);
        u16::from(known) + beyond / 3
    }

    /// Where the free end lies, if it lies on a connector of the floor.
    pub fn landing(&self, pose: Pose) -> Option<GridState> {
        let table = self.table();
        let landing = table.postures().get(usize::from(pose.posture))?.landing?;
        Some(pose.state.then(table.landings()[usize::from(landing)].state))
    }

    /// The same place and posture seen from the other end, which lies on the floor.
    pub fn turned_around(&self, pose: Pose) -> Option<Pose> {
        let state = self.landing(pose)?;
        let posture = self.table().reversed(pose.posture)?;
        Some(Pose { state, end: pose.end.other(), posture, ..pose })
    }
}

impl Serialize for Motions {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        (self.kind, self.database.to_bytes()).serialize(s)
    }
}

impl<'de> Deserialize<'de> for Motions {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Motions, D::Error> {
        let (kind, bytes) = <(Kind, Vec<u8>)>::deserialize(d)?;
        let database = Database::from_bytes(&bytes).map_err(D::Error::custom)?;
        Motions::new(Arc::new(database), kind).map_err(D::Error::custom)
    }
}

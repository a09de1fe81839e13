//! The motion database: every floor-valid lattice posture, every single-joint step with the cells it sweeps,
//! every landing and every shape. Generated, not written by hand.
//!
//! Cells and states are in the foot frame with class 0; turn them by the class and shift them by the foot
//! cell. Everything is an integer, and [`Database::to_bytes`] gives the same bytes on every machine. The
//! caller decides where the bytes are stored.

mod build;
mod format;
mod path;

pub use format::{DatabaseError, VERSION};
pub use path::{Direction, Reach, Transition};

use super::Kind;
use super::grid::GridState;
use super::posture::Posture;
use super::shape::Shape;
use super::sweep::FloorContact;
use metamorph_core::lattice::Cell;

/// The database of all kinds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Database {
    cells: Vec<Cell>,
    tables: Vec<Table>,
}

/// A set of cells of the database.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct CellSet([u64; 4]);

/// The part of the database for one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    kind: Kind,
    postures: Vec<PostureEntry>,
    steps: Vec<Step>,
    landings: Vec<Landing>,
    chains: Vec<CellChain>,
    min_steps: Vec<u8>,
    /// For each posture, the indices of the steps that begin or end at it; not part of the bytes.
    steps_at: Vec<Vec<u16>>,
}

/// A floor-valid posture. Its number is its index in [`Table::postures`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PostureEntry {
    /// The joint values.
    pub posture: Posture,
    /// The index in [`Table::chains`] of the cells that it fills.
    pub chain: u16,
    /// The index in [`Table::landings`] of the landing, if the head plate lies on the floor.
    pub landing: Option<u16>,
    /// True if it belongs to the main set, the largest one connected by strict steps.
    pub main: bool,
}

/// A step of one joint by +120° or +90°; backwards it sweeps the same cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// The posture before.
    pub from: u16,
    /// The posture after.
    pub to: u16,
    /// The joint that turns, from 0.
    pub joint: u8,
    /// [`FloorContact::Free`] for strict steps; [`FloorContact::Plate`] for steps that need the tolerance of
    /// the connectors. Others are not in the database.
    pub floor: FloorContact,
    /// Cells entered deeper than 11 mm, and the cells of both postures; they must be free.
    pub core: CellSet,
    /// Cells entered 2.2 to 11 mm deep; they must also be free in the strict model.
    pub graze: CellSet,
}

/// A state of the head plate on the floor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Landing {
    /// The state of the head, which becomes the foot.
    pub state: GridState,
    /// The postures that have it, ascending.
    pub postures: Vec<u16>,
}

/// An ordered chain of cells and the postures that fill it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellChain {
    /// The cells from the foot on; two for a single module.
    pub cells: Vec<Cell>,
    /// The shape; that of a single module is I.
    pub shape: Shape,
    /// The postures that fill it, ascending.
    pub postures: Vec<u16>,
}

impl Database {
    /// Generates the database of all kinds.
    pub fn build() -> Database {
        build::build()
    }
    /// Returns the cells that sets of cells refer to, sorted.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }
    /// Returns the table of a kind.
    pub fn table(&self, kind: Kind) -> &Table {
        &self.tables[kind as usize]
    }
    /// Iterates over the cells of a set.
    pub fn resolve(&self, set: &CellSet) -> impl Iterator<Item = Cell> {
        set.indices().filter_map(|i| self.cells.get(usize::from(i)).copied())
    }
    /// Returns the set of `cells`. Cells that the database does not know are left out: no step sweeps them.
    pub fn cell_set(&self, cells: impl IntoIterator<Item = Cell>) -> CellSet {
        let mut set = CellSet::default();
        for cell in cells {
            if let Ok(i) = self.cells.binary_search(&cell) {
                set.insert(i as u8);
            }
        }
        set
    }
}

impl CellSet {
    fn insert(&mut self, index: u8) {
        self.0[usize::from(index / 64)] |= 1 << (index % 64);
    }
    /// Iterates over the numbers of the cells, ascending.
    pub fn indices(&self) -> impl Iterator<Item = u8> + use<> {
        self.0.into_iter().zip([0, 64, 128, 192]).flat_map(|(mut word, first)| {
            std::iter::from_fn(move || {
                let bit = (word != 0).then(|| word.trailing_zeros() as u8)?;
                // Without its lowest bit.
                word &= word - 1;
                Some(first + bit)
            })
        })
    }
    /// Returns the number of cells in the set.
    pub fn len(&self) -> usize {
        self.0.iter().map(|w| w.count_ones() as usize).sum()
    }
    /// Returns true if the set has no cell.
    pub fn is_empty(&self) -> bool {
        *self == CellSet::default()
    }
    /// Returns the cells of either set.
    pub fn union(&self, o: &CellSet) -> CellSet {
        CellSet([0, 1, 2, 3].map(|i| self.0[i] | o.0[i]))
    }
    /// Returns the cells of this set that are not in the other.
    pub fn without(&self, o: &CellSet) -> CellSet {
        CellSet([0, 1, 2, 3].map(|i| self.0[i] & !o.0[i]))
    }
    /// Returns true if the sets have a cell in common.
    pub fn meets(&self, o: &CellSet) -> bool {
        self.0.iter().zip(o.0).any(|(a, b)| a & b != 0)
    }
}

impl Table {
    /// Returns the kind of the table.
    pub fn kind(&self) -> Kind {
        self.kind
    }
    /// Returns all floor-valid postures in the order of their joint values.
    pub fn postures(&self) -> &[PostureEntry] {
        &self.postures
    }
    /// Returns all strict and plate-tolerant steps, by first posture and joint.
    pub fn steps(&self) -> &[Step] {
        &self.steps
    }
    /// Iterates over the strict steps.
    pub fn strict_steps(&self) -> impl Iterator<Item = &Step> {
        self.steps.iter().filter(|s| s.floor == FloorContact::Free)
    }
    /// Returns all landings in the order of their states.
    pub fn landings(&self) -> &[Landing] {
        &self.landings
    }
    /// Returns all chains of cells in order.
    pub fn chains(&self) -> &[CellChain] {
        &self.chains
    }
    /// Returns the number of a posture, if it is floor-valid and of this kind.
    pub fn find(&self, posture: Posture) -> Option<u16> {
        self.postures.binary_search_by_key(&posture, |e| e.posture).ok().map(|i| i as u16)
    }
    /// Returns the number of the posture seen from the head, for a posture whose head plate is on the floor.
    pub fn reversed(&self, posture: u16) -> Option<u16> {
        let entry = self.postures.get(usize::from(posture))?;
        entry.landing?;
        self.find(entry.posture.reversed())
    }
    /// Returns the landing of this state.
    pub fn landing(&self, state: GridState) -> Option<&Landing> {
        self.landings.binary_search_by_key(&state, |l| l.state).ok().map(|i| &self.landings[i])
    }
    /// Returns true if a posture of the main set has this landing.
    pub fn is_usable(&self, landing: &Landing) -> bool {
        landing.postures.iter().any(|p| self.postures[usize::from(*p)].main)
    }
    /// Returns the fewest strict steps from some posture of one chain to some posture of another.
    pub fn min_steps(&self, from: u16, to: u16) -> Option<u8> {
        let n = self.chains.len();
        let (from, to) = (usize::from(from), usize::from(to));
        let known = (from < n && to < n).then(|| self.min_steps[from * n + to])?;
        (known != NOT_CONNECTED).then_some(known)
    }
    /// Returns true if some posture of this chain is in the main set.
    pub fn chain_is_main(&self, chain: &CellChain) -> bool {
        chain.postures.iter().any(|p| self.postures[usize::from(*p)].main)
    }
}

/// The value of [`Table::min_steps`] in the bytes where there is no path.
const NOT_CONNECTED: u8 = u8::MAX;

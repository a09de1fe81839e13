//! The motion database as agents and bodies share it, and sets of swept cells as they travel.

use super::blueprint::{Floor, Seed};
use super::pose::{Pose, to_world};
use crate::metamodule::planning::distances::Distances;
use crate::metamodule::planning::enclosure::EnclosureCache;
use crate::metamodule::planning::graph::{Bits, MotionGraph};
use crate::metamodule::planning::lru_cache::{Memo, mix};
use metamorph_core::lattice::Cell;
use metamorph_roombots::Kind;
use metamorph_roombots::database::{Database, Table};
use metamorph_roombots::grid::GridState;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};
use std::fmt;
use std::sync::Arc;
use thiserror::Error;

/// Why a database cannot be used here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum MotionsError {
    /// A sweep is a set of 128 bits.
    #[error("the motion database has {0} cells, but a message can carry at most 128")]
    TooManyCells(usize),
    /// A single module is no metamodule.
    #[error("a single module cannot be used as a metamodule; use PAR, SRS, PER or SRZ")]
    Single,
}

/// The motions of one kind of metamodule.
///
/// Serialised as the bytes of the database, so that every reader has the same one to the bit.
#[derive(Clone)]
pub struct Motions {
    database: Arc<Database>,
    kind: Kind,
    laid_out: Arc<LaidOut>,
}

impl fmt::Debug for Motions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Motions({})", self.kind)
    }
}

/// Lookup tables derived from the database, and caches of searches; shared by all clones of a [`Motions`].
struct LaidOut {
    graph: MotionGraph,
    distances: Memo<Counted, Arc<Distances>>,
    learnt: EnclosureCache,
}

/// The key of cached distances: the floor, the seed, and the cells that stay taken.
type Counted = (Floor, Seed, Vec<Cell>);

/// Number of [`Distances`] kept in the cache.
const KEPT: usize = 256;

impl LaidOut {
    fn new(database: &Database, kind: Kind) -> LaidOut {
        let table = database.table(kind);
        LaidOut {
            graph: MotionGraph::new(database, table),
            distances: Memo::new(KEPT),
            learnt: EnclosureCache::new(),
        }
    }
}

/// A set of cells of the database, seen from a grid state; bit *i* is the *i*-th cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Sweep(pub Bits);

metamorph_core::fields!(Sweep { 0 });

/// Four times the middle of the four cells of a metamodule, along the floor.
pub type Middle = (i64, i64);

impl Motions {
    /// The motions of `kind` in a database.
    pub fn new(database: Arc<Database>, kind: Kind) -> Result<Motions, MotionsError> {
        if kind == Kind::Single {
            return Err(MotionsError::Single);
        }
        match database.cells().len() {
            0..=128 => {
                let laid_out = Arc::new(LaidOut::new(&database, kind));
                Ok(Motions { database, kind, laid_out })
            }
            n => Err(MotionsError::TooManyCells(n)),
        }
    }
    /// The kind whose motions these are.
    pub fn kind(&self) -> Kind {
        self.kind
    }
    /// Returns the motion database.
    pub fn database(&self) -> &Arc<Database> {
        &self.database
    }
    /// The table of the kind.
    pub fn table(&self) -> &Table {
        self.database.table(self.kind)
    }
    /// The table, laid out for searching.
    pub fn graph(&self) -> &MotionGraph {
        &self.laid_out.graph
    }
    /// Returns the bit of a posture in a set of landing postures ([`MotionGraph::rest`]); zero if the posture does
    /// not land.
    pub fn rest_bit(&self, posture: u16) -> u128 {
        self.graph().rest(posture).map_or(0, |i| 1 << i)
    }
    /// Returns the number of moves to a seed from every place on the floor, around the cells `fixed` that stay taken.
    pub fn distances(&self, floor: Floor, seed: Seed, fixed: &[Cell]) -> Arc<Distances> {
        let mut fixed = fixed.to_vec();
        fixed.sort_unstable();
        fixed.dedup();
        let turn = seed.directions.into_iter().fold(0, |h, d| h << 8 | d as u64);
        let hash = mix(mix(hash(&fixed), pack(seed.foot.0, seed.foot.1, 0)), turn);
        let count = |(floor, seed, fixed): &Counted| Arc::new(Distances::new(self, *floor, *seed, fixed));
        self.laid_out.distances.answer(hash, (floor, seed, fixed), count)
    }
    /// Returns the results of earlier searches for a way out of an enclosure.
    pub(super) fn learnt(&self) -> &EnclosureCache {
        &self.laid_out.learnt
    }
    /// Returns the number of the chain that consists of these cells, given in the foot frame.
    pub fn chain_of(&self, cells: [Cell; 4]) -> Option<u16> {
        self.table().chains().iter().position(|c| c.cells == cells).map(|i| i as u16)
    }

    /// The postures that fill a chain.
    pub fn filling(&self, chain: u16) -> &[u16] {
        self.table().chains().get(usize::from(chain)).map_or(&[], |c| &c.postures)
    }

    /// The four cells of a metamodule in the world, from the attached end on.
    pub fn cells(&self, pose: Pose) -> [Cell; 4] {
        self.graph().filled(pose.posture).map(|c| to_world(pose.state, c))
    }

    /// Returns the middle of a metamodule: the sums of the x and y coordinates of its four cells.
    pub fn middle(&self, pose: Pose) -> Middle {
        self.cells(pose).iter().fold((0, 0), |(x, y), c| (x + i64::from(c.x), y + i64::from(c.y)))
    }

    /// The cells of a sweep seen from a grid state.
    pub fn swept(&self, state: GridState, sweep: Sweep) -> impl Iterator<Item = Cell> + '_ {
        self.graph().cells(sweep.0).map(move |c| to_world(state, c))
    }

    /// Where the free end lies, if it lies on a connector of the floor.
    pub fn landing(&self, pose: Pose) -> Option<GridState> {
        self.graph().landing(pose.posture).map(|(by, _)| then(pose.state, by))
    }

    /// Returns the pose seen from the other end; `None` if that end does not lie on a connector.
    pub fn turned_around(&self, pose: Pose) -> Option<Pose> {
        let (by, posture) = self.graph().landing(pose.posture)?;
        Some(Pose { state: then(pose.state, by), end: pose.end.other(), posture, ..pose })
    }
}

fn pack(a: i16, b: i16, c: i16) -> u64 {
    [a, b, c].into_iter().fold(0, |h, v| h << 16 | u64::from(v as u16))
}

fn hash(cells: &[Cell]) -> u64 {
    cells.iter().fold(0, |h, c| mix(h, pack(c.x, c.y, c.z)))
}

/// [`GridState::then`] without matrices.
fn then(from: GridState, by: GridState) -> GridState {
    let at = to_world(from, Cell::new(by.x, by.y, 0));
    GridState::new(at.x, at.y, from.class + by.class)
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

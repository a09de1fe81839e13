//! The bytes of the database: little-endian, versioned, with a checksum, validated on reading.
//!
//! ```text
//! "MMRBDB"  u16 version  u16 cells  cells × 3 i8
//! per kind: u8 kind  u16 postures  u16 steps
//!           postures × (u16 code, u8 main)
//!           steps × (u16 from, u8 joint, u8 floor, u8 n, n × u8 core, u8 m, m × u8 graze)
//!           u16 chains  chains² × u8 fewest steps
//! u32 CRC-32 of all before
//! ```
//!
//! Data that follows from the joint values (cells, shapes, landings) is not stored but computed.

use super::build::shape_of;
use super::{CellChain, CellSet, Database, Landing, PostureEntry, Step, Table};
use crate::Kind;
use crate::grid::{self, GridState};
use crate::posture::Posture;
use crate::sweep::FloorContact;
use metamorph_core::lattice::Cell;
use std::collections::BTreeMap;
use thiserror::Error;

/// The version of the bytes, raised with every change of the format or of the generator's results.
pub const VERSION: u16 = 1;
const MAGIC: &[u8; 6] = b"MMRBDB";

/// Why bytes cannot be read as a motion database.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DatabaseError {
    /// The bytes are not a motion database.
    #[error("these bytes are not a motion database; build it anew")]
    NotADatabase,
    /// Written by another version of the generator.
    #[error(
        "the motion database has version {found}, this program writes and reads {VERSION}; build it anew"
    )]
    Version {
        /// The version in the bytes.
        found: u16,
    },
    /// Cut off or changed.
    #[error("the motion database is damaged (its checksum is wrong); build it anew")]
    Checksum,
    /// The checksum is right, but the content is impossible.
    #[error("the motion database is damaged at byte {at}: {what}; build it anew")]
    Content {
        /// The position in bytes.
        at: usize,
        /// The defect.
        what: &'static str,
    },
}

impl Database {
    /// Returns the bytes, the same on every machine.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(1 << 19);
        out.extend(MAGIC);
        put(&mut out, VERSION);
        put(&mut out, self.cells.len() as u16);
        for c in &self.cells {
            out.extend([c.x, c.y, c.z].map(|v| v as i8 as u8));
        }
        for t in &self.tables {
            out.push(t.kind as u8);
            put(&mut out, t.postures.len() as u16);
            put(&mut out, t.steps.len() as u16);
            for p in &t.postures {
                put(&mut out, p.posture.code());
                out.push(u8::from(p.main));
            }
            for s in &t.steps {
                put(&mut out, s.from);
                out.extend([s.joint, s.floor as u8]);
                for set in [&s.core, &s.graze] {
                    out.push(set.len() as u8);
                    out.extend(set.indices());
                }
            }
            put(&mut out, t.chains.len() as u16);
            out.extend(&t.min_steps);
        }
        let sum = crc32fast::hash(&out);
        out.extend(sum.to_le_bytes());
        out
    }

    /// Reads the bytes of [`Database::to_bytes`].
    ///
    /// # Errors
    /// Refuses all other bytes, with the position of the first defect.
    pub fn from_bytes(bytes: &[u8]) -> Result<Database, DatabaseError> {
        let rest = bytes.strip_prefix(MAGIC).ok_or(DatabaseError::NotADatabase)?;
        let found = rest.first_chunk().map(|b| u16::from_le_bytes(*b)).ok_or(DatabaseError::NotADatabase)?;
        if found != VERSION {
            return Err(DatabaseError::Version { found });
        }
        let (content, sum) = bytes.split_last_chunk::<4>().ok_or(DatabaseError::Checksum)?;
        if crc32fast::hash(content) != u32::from_le_bytes(*sum) {
            return Err(DatabaseError::Checksum);
        }
        let mut reader = Reader { bytes: content, at: MAGIC.len() + 2 };
        let database = reader.database()?;
        if reader.at != content.len() {
            return Err(reader.wrong("bytes follow the last table"));
        }
        Ok(database)
    }
}

fn put(out: &mut Vec<u8>, value: u16) {
    out.extend(value.to_le_bytes());
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn wrong(&self, what: &'static str) -> DatabaseError {
        DatabaseError::Content { at: self.at, what }
    }
    fn take(&mut self, n: usize) -> Result<&[u8], DatabaseError> {
        let end = self.at.saturating_add(n);
        match self.bytes.get(self.at..end) {
            Some(part) => {
                self.at = end;
                Ok(part)
            }
            None => Err(self.wrong("it ends too early")),
        }
    }
    fn byte(&mut self) -> Result<u8, DatabaseError> {
        Ok(self.take(1)?[0])
    }
    fn u16(&mut self) -> Result<u16, DatabaseError> {
        let part = self.take(2)?;
        Ok(u16::from_le_bytes([part[0], part[1]]))
    }

    fn database(&mut self) -> Result<Database, DatabaseError> {
        let count = usize::from(self.u16()?);
        let raw = self.take(3 * count)?;
        let signed = |b: u8| i16::from(b as i8);
        let cells: Vec<Cell> =
            raw.chunks_exact(3).map(|c| Cell::new(signed(c[0]), signed(c[1]), signed(c[2]))).collect();
        if count > 256 || !cells.is_sorted_by(|a, b| a < b) {
            return Err(self.wrong("the cells are not sorted"));
        }
        let mut tables = Vec::new();
        for kind in Kind::ALL {
            tables.push(self.table(kind, count)?);
        }
        Ok(Database { cells, tables })
    }

    fn table(&mut self, kind: Kind, cells: usize) -> Result<Table, DatabaseError> {
        if self.byte()? != kind as u8 {
            return Err(self.wrong("the kinds are not in order"));
        }
        let (posture_count, step_count) = (self.u16()?, self.u16()?);
        let mut postures: Vec<PostureEntry> = Vec::new();
        for _ in 0..posture_count {
            let (code, main) = (self.u16()?, self.byte()? != 0);
            if code >= Posture::count(kind) {
                return Err(self.wrong("there is no such posture"));
            }
            let posture = Posture::from_code(kind, code);
            if postures.last().is_some_and(|l| l.posture >= posture) || !posture.placement().above_floor() {
                return Err(self.wrong("the postures are not sorted and above the floor"));
            }
            postures.push(PostureEntry { posture, chain: 0, landing: None, main });
        }
        let mut table = with_places(kind, postures);
        for _ in 0..step_count {
            let step = self.step(&table, cells)?;
            table.steps.push(step);
        }
        let chains = usize::from(self.u16()?);
        if chains != table.chains.len() {
            return Err(self.wrong("the number of chains is wrong"));
        }
        table.min_steps = self.take(chains * chains)?.to_vec();
        table.index_steps();
        Ok(table)
    }

    fn step(&mut self, table: &Table, cells: usize) -> Result<Step, DatabaseError> {
        let (from, joint) = (self.u16()?, self.byte()?);
        let floor = FloorContact::from_index(self.byte()?)
            .filter(|f| *f <= FloorContact::Plate)
            .ok_or_else(|| self.wrong("there is no such contact with the floor"))?;
        let entry =
            table.postures.get(usize::from(from)).filter(|_| usize::from(joint) < table.kind.joints());
        let to = entry
            .and_then(|e| table.find(e.posture.turned(joint.into())))
            .ok_or_else(|| self.wrong("a step leads nowhere"))?;
        let (core, graze) = (self.cell_set(cells)?, self.cell_set(cells)?);
        Ok(Step { from, to, joint, floor, core, graze })
    }

    fn cell_set(&mut self, cells: usize) -> Result<CellSet, DatabaseError> {
        let n = usize::from(self.byte()?);
        let mut set = CellSet::default();
        let mut known = true;
        for i in self.take(n)? {
            known &= usize::from(*i) < cells;
            set.insert(*i);
        }
        if set.len() != n || !known {
            return Err(self.wrong("a set of cells names one twice or one that is not there"));
        }
        Ok(set)
    }
}

/// Creates a table of these postures with the chains and landings that follow from them.
pub(super) fn with_places(kind: Kind, mut postures: Vec<PostureEntry>) -> Table {
    let mut chains: BTreeMap<Vec<Cell>, Vec<u16>> = BTreeMap::new();
    let mut landings: BTreeMap<GridState, Vec<u16>> = BTreeMap::new();
    for (i, entry) in postures.iter().enumerate() {
        let cells = entry.posture.placement().cells[..kind.cubes()].to_vec();
        chains.entry(cells).or_default().push(i as u16);
        if let Some(state) = grid::landing(entry.posture) {
            landings.entry(state).or_default().push(i as u16);
        }
    }
    for (i, members) in chains.values().enumerate() {
        for p in members {
            postures[usize::from(*p)].chain = i as u16;
        }
    }
    for (i, members) in landings.values().enumerate() {
        for p in members {
            postures[usize::from(*p)].landing = Some(i as u16);
        }
    }
    let chains = chains
        .into_iter()
        .map(|(cells, postures)| CellChain { shape: shape_of(&cells), cells, postures })
        .collect();
    let landings = landings.into_iter().map(|(state, postures)| Landing { state, postures }).collect();
    Table { kind, postures, steps: Vec::new(), landings, chains, min_steps: Vec::new(), steps_at: Vec::new() }
}

//! The counters of one incarnation of an agent, in a small file that outlives it.
//!
//! A killed process cannot be asked for its counts, so each agent writes its counters before the effects that
//! they count become visible: a message that was received has been counted as sent. The file holds two slots,
//! written in turn, so that a torn write leaves the older one; the reader takes the newest slot whose check
//! sum fits. Latencies follow the slots. They are large and only figures, so they are written after every
//! [`LATENCY_BATCH`] messages and at the end: those of the last messages before a kill are not known.

use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::{Counts, Tally};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::latency::Latencies;
use std::fmt::Debug;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use thiserror::Error;

const MAGIC: [u8; 8] = *b"MMLEDGER";
/// The version of the layout.
pub const VERSION: u32 = 5;
/// Size of the header.
const HEADER_BYTES: usize = 32;
/// Number of 64-bit numbers in a slot: the generation; ten for each class, of which eight are its tally, one
/// the messages left, and one those that may be lost; and four for foreign frames, wake-ups, records missing
/// from the journal, and whether the counters are final.
const NUMBERS: usize = 1 + Class::ALL.len() * 10 + 4;
/// Size of a slot: the numbers, and a checksum.
const SLOT_BYTES: usize = NUMBERS * 8 + 4;
/// Position of the number of wake-ups in a slot.
const WAKES: usize = NUMBERS - 3;
/// The numbers of a slot.
type Numbers = [u64; NUMBERS];
/// Offset of the latencies in the file: their length and check sum, 32 bits each, then their encoding.
const LATENCY_OFFSET: usize = HEADER_BYTES + 2 * SLOT_BYTES;
/// Number of messages delivered between two writes of the latencies.
const LATENCY_BATCH: u64 = 256;

/// The counters of one incarnation of an agent.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct AgentCounters {
    /// Protocol messages by class.
    pub tally: Tally,
    /// Messages by class that were under way when the run ended: held back by the link model of this
    /// agent, or in its inbox.
    pub left: [u64; Class::ALL.len()],
    /// Messages by class that may be lost with links that were closed (`Contacts::loose`).
    pub loose: [u64; Class::ALL.len()],
    /// True if this incarnation ended regularly, with all of its messages counted.
    pub closed: bool,
    /// Frames that no member of the run wrote: malformed, of unknown kinds, or with a false source.
    pub foreign: u64,
    /// Number of times that the process returned from waiting; for a killed one, as of the last change of
    /// another counter.
    pub wakes: u64,
    /// Number of records that could not be written to the journal.
    pub unrecorded: u64,
    /// Latencies of the messages delivered; of a killed agent, those of the last are missing.
    pub latencies: Latencies,
}

/// Errors of writing and reading counters.
#[derive(Debug, Error)]
pub enum CounterFileError {
    /// The file cannot be created, written or read.
    #[error("cannot access the counters in {0}: {1}")]
    Io(PathBuf, io::Error),
    /// Not a counter file, or one of another agent.
    #[error("{0} does not hold the counters of this agent")]
    Foreign(PathBuf),
    /// Another version.
    #[error("the counter file {0} has version {1}; this program reads version {VERSION}")]
    Version(PathBuf, u32),
    /// No slot has a fitting check sum.
    #[error("the counter file {0} is damaged: no slot has a fitting check sum")]
    Damaged(PathBuf),
}

/// Returns the directory of the counter files of a run.
pub fn directory(root: &Path) -> PathBuf {
    root.join("ledgers")
}
fn path(root: &Path, id: ModuleId, incarnation: Incarnation) -> PathBuf {
    directory(root).join(format!("{id}.{incarnation}"))
}

/// Where an agent keeps its counters, so that they outlive it.
pub trait CounterStore: Debug {
    /// Replaces the counters.
    ///
    /// # Errors
    /// If the store has failed.
    fn write(&mut self, counters: &AgentCounters) -> Result<(), CounterFileError>;
}

/// Counters in memory, for agents that are threads. Clones share the counters.
#[derive(Clone, Debug, Default)]
pub struct SharedCounters(Arc<Mutex<AgentCounters>>);

impl SharedCounters {
    /// Returns the counters as last written.
    pub fn read(&self) -> AgentCounters {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl CounterStore for SharedCounters {
    fn write(&mut self, counters: &AgentCounters) -> Result<(), CounterFileError> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone_from(counters);
        Ok(())
    }
}

/// A counter file that is being written.
#[derive(Debug)]
pub struct CounterFile {
    file: File,
    path: PathBuf,
    generation: u64,
    /// The numbers as last written.
    written: Numbers,
    /// The number of messages whose latencies are written.
    measured: u64,
}

impl CounterFile {
    /// Creates the file of one incarnation of an agent, with all counters zero.
    ///
    /// # Errors
    /// If the file cannot be created.
    pub fn create(
        root: &Path,
        id: ModuleId,
        incarnation: Incarnation,
    ) -> Result<CounterFile, CounterFileError> {
        let path = path(root, id, incarnation);
        let io = |e| CounterFileError::Io(path.clone(), e);
        let file = File::create(&path).map_err(io)?;
        file.write_all_at(&header(id, incarnation), 0).map_err(io)?;
        let none = numbers(&AgentCounters::default());
        let mut created = CounterFile { file, path: path.clone(), generation: 0, written: none, measured: 0 };
        created.put(none)?;
        Ok(created)
    }

    fn put(&mut self, numbers: Numbers) -> Result<(), CounterFileError> {
        self.generation += 1;
        let offset = HEADER_BYTES + (self.generation % 2) as usize * SLOT_BYTES;
        self.put_at(offset, &slot(self.generation, numbers))?;
        self.written = numbers;
        Ok(())
    }

    fn put_latencies(&mut self, latencies: &Latencies) -> Result<(), CounterFileError> {
        let body = bincode::serde::encode_to_vec(latencies, bincode::config::standard())
            .map_err(|e| CounterFileError::Io(self.path.clone(), io::Error::other(e)))?;
        let mut bytes = [(body.len() as u32).to_le_bytes(), crc32fast::hash(&body).to_le_bytes()].concat();
        bytes.extend(body);
        self.put_at(LATENCY_OFFSET, &bytes)
    }

    fn put_at(&self, offset: usize, bytes: &[u8]) -> Result<(), CounterFileError> {
        self.file.write_all_at(bytes, offset as u64).map_err(|e| CounterFileError::Io(self.path.clone(), e))
    }

    /// Reads the counters of one incarnation of an agent; `None` if it never started.
    ///
    /// # Errors
    /// If the file cannot be read, is foreign or of another version, or has no whole slot.
    pub fn read(
        root: &Path,
        id: ModuleId,
        incarnation: Incarnation,
    ) -> Result<Option<AgentCounters>, CounterFileError> {
        let path = path(root, id, incarnation);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(CounterFileError::Io(path, e)),
        };
        let expected = header(id, incarnation);
        if !bytes.starts_with(&MAGIC) || bytes.len() < HEADER_BYTES {
            // The process was killed while it created the file.
            return if bytes.is_empty() { Ok(None) } else { Err(CounterFileError::Foreign(path)) };
        }
        let version = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
        if version != VERSION {
            return Err(CounterFileError::Version(path, version));
        }
        if bytes[..HEADER_BYTES] != expected {
            return Err(CounterFileError::Foreign(path));
        }
        if bytes.len() == HEADER_BYTES {
            return Ok(None);
        }
        let slots =
            [0, 1].map(|i| bytes.get(HEADER_BYTES + i * SLOT_BYTES..HEADER_BYTES + (i + 1) * SLOT_BYTES));
        slots
            .into_iter()
            .flatten()
            .filter_map(read_slot)
            .max_by_key(|(generation, _)| *generation)
            .map(|(_, counters)| Some(AgentCounters { latencies: read_latencies(&bytes), ..counters }))
            .ok_or(CounterFileError::Damaged(path))
    }
}

impl CounterStore for CounterFile {
    /// Writes the counters if they have changed. A changed number of wake-ups alone is not worth a write.
    fn write(&mut self, counters: &AgentCounters) -> Result<(), CounterFileError> {
        let numbers = numbers(counters);
        let mut since = self.written;
        since[WAKES] = numbers[WAKES];
        if numbers == since {
            return Ok(());
        }
        let delivered = counters.tally.total().delivered;
        if delivered - self.measured >= if counters.closed { 1 } else { LATENCY_BATCH } {
            self.put_latencies(&counters.latencies)?;
            self.measured = delivered;
        }
        self.put(numbers)
    }
}

/// Returns the messages of all incarnations of all agents of a run so far. A file that is being created, or
/// cannot be read, counts as zero.
///
/// # Errors
/// If the directory cannot be read.
pub fn tally(root: &Path) -> io::Result<Tally> {
    let name = |name: &str| -> Option<(ModuleId, Incarnation)> {
        let (id, incarnation) = name.split_once('.')?;
        Some((ModuleId(id.parse().ok()?), Incarnation(incarnation.parse().ok()?)))
    };
    let mut tally = Tally::default();
    for entry in fs::read_dir(directory(root))? {
        let Some((id, incarnation)) = entry?.file_name().to_str().and_then(name) else { continue };
        if let Ok(Some(counters)) = CounterFile::read(root, id, incarnation) {
            tally += counters.tally;
        }
    }
    Ok(tally)
}

fn header(id: ModuleId, incarnation: Incarnation) -> [u8; HEADER_BYTES] {
    let mut bytes = [0; HEADER_BYTES];
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
    bytes[12..16].copy_from_slice(&id.0.to_le_bytes());
    bytes[16..18].copy_from_slice(&incarnation.0.to_le_bytes());
    bytes
}

/// Returns the numbers of a slot, with a generation of zero.
fn numbers(counters: &AgentCounters) -> Numbers {
    let mut numbers = [0u64; NUMBERS];
    for (i, (_, c)) in counters.tally.iter().enumerate() {
        // All fields are named, so that a new count cannot be forgotten here.
        let Counts { sent, delivered, lost, duplicated, overflowed, expired, refused, bytes } = *c;
        numbers[1 + i * 8..][..8]
            .copy_from_slice(&[sent, delivered, lost, duplicated, overflowed, expired, refused, bytes]);
    }
    let &AgentCounters { tally: _, left, loose, closed, foreign, wakes, unrecorded, latencies: _ } = counters;
    numbers[1 + Class::ALL.len() * 8..][..left.len()].copy_from_slice(&left);
    numbers[1 + Class::ALL.len() * 9..][..loose.len()].copy_from_slice(&loose);
    numbers[NUMBERS - 4..].copy_from_slice(&[foreign, wakes, unrecorded, closed.into()]);
    numbers
}

fn slot(generation: u64, mut numbers: Numbers) -> [u8; SLOT_BYTES] {
    numbers[0] = generation;
    let mut bytes = [0; SLOT_BYTES];
    for (chunk, n) in bytes.chunks_exact_mut(8).zip(numbers) {
        chunk.copy_from_slice(&n.to_le_bytes());
    }
    let sum = crc32fast::hash(&bytes[..SLOT_BYTES - 4]);
    bytes[SLOT_BYTES - 4..].copy_from_slice(&sum.to_le_bytes());
    bytes
}

fn read_slot(bytes: &[u8]) -> Option<(u64, AgentCounters)> {
    let (body, sum) = bytes.split_last_chunk::<4>()?;
    if crc32fast::hash(body) != u32::from_le_bytes(*sum) {
        return None;
    }
    let mut numbers = body.chunks_exact(8).map(|c| c.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)));
    let generation = numbers.next()?;
    let mut counters = AgentCounters::default();
    for class in Class::ALL {
        counters.tally[class] = Counts {
            sent: numbers.next()?,
            delivered: numbers.next()?,
            lost: numbers.next()?,
            duplicated: numbers.next()?,
            overflowed: numbers.next()?,
            expired: numbers.next()?,
            refused: numbers.next()?,
            bytes: numbers.next()?,
        };
    }
    for count in counters.left.iter_mut().chain(&mut counters.loose) {
        *count = numbers.next()?;
    }
    counters.foreign = numbers.next()?;
    counters.wakes = numbers.next()?;
    counters.unrecorded = numbers.next()?;
    counters.closed = numbers.next()? != 0;
    Some((generation, counters))
}

/// Returns the latencies in a file; none if they were never written, or a kill has torn them.
fn read_latencies(file: &[u8]) -> Latencies {
    let part =
        |range| file.get(range).and_then(|bytes: &[u8]| Some(u32::from_le_bytes(bytes.try_into().ok()?)));
    let body = LATENCY_OFFSET + 8;
    let read = || {
        let [length, sum] = [part(LATENCY_OFFSET..LATENCY_OFFSET + 4)?, part(LATENCY_OFFSET + 4..body)?];
        let bytes = file.get(body..body + length as usize).filter(|bytes| crc32fast::hash(bytes) == sum)?;
        Some(bincode::serde::decode_from_slice(bytes, bincode::config::standard()).ok()?.0)
    };
    read().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::time::Span;

    const ME: (ModuleId, Incarnation) = (ModuleId(3), Incarnation(1));

    fn counters(n: u64) -> AgentCounters {
        let mut counters = AgentCounters {
            left: std::array::from_fn(|i| n + i as u64),
            loose: std::array::from_fn(|i| n * 2 + i as u64),
            closed: n.is_multiple_of(2),
            foreign: n,
            wakes: n + 1,
            unrecorded: n + 2,
            ..AgentCounters::default()
        };
        for (i, class) in Class::ALL.into_iter().enumerate() {
            let i = i as u64 * 100 + n;
            counters.tally[class] = Counts {
                sent: i,
                delivered: i + 1,
                lost: i + 2,
                duplicated: i + 3,
                overflowed: i + 4,
                expired: i + 5,
                refused: i + 6,
                bytes: i + 7,
            };
        }
        counters
    }

    fn dir() -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(directory(dir.path())).unwrap();
        dir
    }

    #[test]
    fn the_newest_write_is_read() {
        let dir = dir();
        assert_eq!(CounterFile::read(dir.path(), ME.0, ME.1).unwrap(), None);
        let mut file = CounterFile::create(dir.path(), ME.0, ME.1).unwrap();
        assert_eq!(CounterFile::read(dir.path(), ME.0, ME.1).unwrap(), Some(AgentCounters::default()));
        for n in 1..6 {
            file.write(&counters(n)).unwrap();
            assert_eq!(CounterFile::read(dir.path(), ME.0, ME.1).unwrap(), Some(counters(n)));
        }
    }

    #[test]
    fn what_all_have_sent_is_added_up() {
        let dir = dir();
        let sent = || tally(dir.path()).unwrap().total().sent;
        assert_eq!(sent(), 0);
        for (id, incarnation, n) in [(4, 0, 1), (4, 1, 2), (7, 0, 3)] {
            let mut file = CounterFile::create(dir.path(), ModuleId(id), Incarnation(incarnation)).unwrap();
            file.write(&counters(n)).unwrap();
        }
        let each = |n| counters(n).tally.total().sent;
        assert!(each(1) > 0);
        fs::write(directory(dir.path()).join("9.0"), b"").unwrap();
        fs::write(directory(dir.path()).join("stranger"), b"no counters").unwrap();
        assert_eq!(sent(), each(1) + each(2) + each(3));
    }

    /// Latencies are written in batches, whole or not at all, and all of them at the end.
    #[test]
    fn latencies_are_written_in_batches_and_at_the_end() {
        let dir = dir();
        let mut file = CounterFile::create(dir.path(), ME.0, ME.1).unwrap();
        let mut counters = AgentCounters::default();
        let mut deliver = |n: u64, closed, file: &mut CounterFile| {
            for i in 0..n {
                counters.tally[Class::Seed].delivered += 1;
                counters.latencies[Class::Seed].record(Span(i));
            }
            counters.closed = closed;
            file.write(&counters).unwrap();
            CounterFile::read(dir.path(), ME.0, ME.1).unwrap().unwrap().latencies.total().count()
        };
        assert_eq!(deliver(1, false, &mut file), 0);
        assert_eq!(deliver(LATENCY_BATCH - 1, false, &mut file), LATENCY_BATCH);
        assert_eq!(deliver(7, false, &mut file), LATENCY_BATCH);
        assert_eq!(deliver(0, true, &mut file), LATENCY_BATCH + 7);
        file.put_at(LATENCY_OFFSET + 9, &[0xFF; 3]).unwrap();
        let torn = CounterFile::read(dir.path(), ME.0, ME.1).unwrap().unwrap();
        assert_eq!((torn.latencies, torn.closed), (Latencies::default(), true));
    }

    #[test]
    fn a_torn_write_leaves_the_one_before() {
        let dir = dir();
        let mut file = CounterFile::create(dir.path(), ME.0, ME.1).unwrap();
        file.write(&counters(1)).unwrap();
        file.write(&counters(2)).unwrap();
        // Generation 3 is in slot 1; tear it.
        file.file.write_all_at(&[0xFF; 40], HEADER_BYTES as u64 + SLOT_BYTES as u64).unwrap();
        assert_eq!(CounterFile::read(dir.path(), ME.0, ME.1).unwrap(), Some(counters(1)));
        file.file.write_all_at(&[0xFF; 40], HEADER_BYTES as u64).unwrap();
        assert!(matches!(CounterFile::read(dir.path(), ME.0, ME.1), Err(CounterFileError::Damaged(_))));
    }

    #[test]
    fn refuses_strangers() {
        let dir = dir();
        let file = path(dir.path(), ME.0, ME.1);
        let read = || CounterFile::read(dir.path(), ME.0, ME.1);
        fs::write(&file, b"").unwrap();
        assert!(matches!(read(), Ok(None)));
        fs::write(&file, b"hello").unwrap();
        assert!(matches!(read(), Err(CounterFileError::Foreign(_))));
        fs::write(&file, header(ModuleId(4), ME.1)).unwrap();
        assert!(matches!(read(), Err(CounterFileError::Foreign(_))));
        fs::write(&file, header(ME.0, ME.1)).unwrap();
        assert!(matches!(read(), Ok(None)));
        let mut newer = header(ME.0, ME.1);
        newer[8] += 1;
        fs::write(&file, newer).unwrap();
        assert!(matches!(read(), Err(CounterFileError::Version(_, v)) if v == VERSION + 1));
        let mut garbage = header(ME.0, ME.1).to_vec();
        garbage.extend([7; SLOT_BYTES * 3]);
        fs::write(&file, garbage).unwrap();
        assert!(matches!(read(), Err(CounterFileError::Damaged(_))));
    }
}

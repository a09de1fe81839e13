//! The counts of one life of an agent, in a small file that outlives it.
//!
//! A killed process cannot be asked what it had counted, so each agent writes its counts down
//! before what they stand for can be seen by others: a message that anybody received has been
//! counted as sent by somebody. The file holds two slots, written in turn, so that a torn write
//! leaves the older one; the reader takes the newest slot whose check sum fits.

use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::{Counts, Tally};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use thiserror::Error;

const MAGIC: [u8; 8] = *b"MMLEDGER";
const VERSION: u32 = 3;
const HEADER: usize = 32;
/// Numbers of a slot: its generation, the counts of all classes, what was left of each and what may be lost, foreign
/// frames, wake-ups, records that are missing from the journal, whether the ledger is closed.
const NUMBERS: usize = 1 + Class::ALL.len() * 10 + 4;
const SLOT: usize = NUMBERS * 8 + 4;

/// What one life of an agent has counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Account {
    /// Protocol messages by class.
    pub tally: Tally,
    /// Messages by class that were under way when the run ended: held back by the link model of this
    /// agent, or in its inbox.
    pub left: [u64; Class::ALL.len()],
    /// Messages by class that may be lost with ways that were closed ([`crate::process::contacts::Contacts::loose`]).
    pub loose: [u64; Class::ALL.len()],
    /// Whether this life ended in order, with all of its messages counted.
    pub closed: bool,
    /// Frames that no member of the run wrote: malformed, of unknown kinds, or under a false name.
    pub foreign: u64,
    /// How often the process woke up; of a killed one, until the last message was counted.
    pub wakes: u64,
    /// Records that could not be written to the journal.
    pub unrecorded: u64,
}

/// Why a ledger cannot be written or read.
#[derive(Debug, Error)]
pub enum LedgerError {
    /// The file cannot be created, written or read.
    #[error("cannot access the ledger {0}: {1}")]
    Io(PathBuf, io::Error),
    /// Not a ledger, or one of another agent.
    #[error("{0} is not the ledger of this agent")]
    Foreign(PathBuf),
    /// Another version.
    #[error("the ledger {0} has version {1}; this program reads version {VERSION}")]
    Version(PathBuf, u32),
    /// No slot has a fitting check sum.
    #[error("the ledger {0} is damaged: no slot has a fitting check sum")]
    Damaged(PathBuf),
}

/// The directory of the ledgers of a run.
pub fn directory(root: &Path) -> PathBuf {
    root.join("ledgers")
}
fn path(root: &Path, id: ModuleId, incarnation: Incarnation) -> PathBuf {
    directory(root).join(format!("{id}.{incarnation}"))
}

/// A ledger that is being written.
#[derive(Debug)]
pub struct Ledger {
    file: File,
    path: PathBuf,
    generation: u64,
    written: Account,
}

impl Ledger {
    /// Creates the ledger of one life of an agent, with nothing counted.
    pub fn create(root: &Path, id: ModuleId, incarnation: Incarnation) -> Result<Ledger, LedgerError> {
        let path = path(root, id, incarnation);
        let io = |e| LedgerError::Io(path.clone(), e);
        let file = File::create(&path).map_err(io)?;
        file.write_all_at(&header(id, incarnation), 0).map_err(io)?;
        let mut ledger = Ledger { file, path: path.clone(), generation: 0, written: Account::default() };
        ledger.put(&Account::default())?;
        Ok(ledger)
    }

    /// Writes the counts down if they have changed. Waking up for nothing is not worth a write.
    pub fn write(&mut self, account: &Account) -> Result<(), LedgerError> {
        let since = Account { wakes: account.wakes, ..self.written };
        if *account == since { Ok(()) } else { self.put(account) }
    }

    /// Writes the counts down for the last time.
    pub fn close(mut self, account: &Account) -> Result<(), LedgerError> {
        self.put(&Account { closed: true, ..*account })
    }

    fn put(&mut self, account: &Account) -> Result<(), LedgerError> {
        self.generation += 1;
        let offset = HEADER + (self.generation % 2) as usize * SLOT;
        self.file
            .write_all_at(&slot(self.generation, account), offset as u64)
            .map_err(|e| LedgerError::Io(self.path.clone(), e))?;
        self.written = *account;
        Ok(())
    }

    /// Reads what one life of an agent has counted; none if it never came so far as to start.
    pub fn read(root: &Path, id: ModuleId, incarnation: Incarnation) -> Result<Option<Account>, LedgerError> {
        let path = path(root, id, incarnation);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(LedgerError::Io(path, e)),
        };
        let expected = header(id, incarnation);
        if !bytes.starts_with(&MAGIC) || bytes.len() < HEADER {
            // Killed while creating it.
            return if bytes.is_empty() { Ok(None) } else { Err(LedgerError::Foreign(path)) };
        }
        let version = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
        if version != VERSION {
            return Err(LedgerError::Version(path, version));
        }
        if bytes[..HEADER] != expected {
            return Err(LedgerError::Foreign(path));
        }
        if bytes.len() == HEADER {
            return Ok(None);
        }
        let slots = [0, 1].map(|i| bytes.get(HEADER + i * SLOT..HEADER + (i + 1) * SLOT));
        slots
            .into_iter()
            .flatten()
            .filter_map(read_slot)
            .max_by_key(|(generation, _)| *generation)
            .map(|(_, account)| Some(account))
            .ok_or(LedgerError::Damaged(path))
    }
}

/// Messages that all lives of all agents of a run have sent so far. Ledgers that are being created count
/// as nothing.
pub fn sent(root: &Path) -> io::Result<u64> {
    let name = |name: &str| -> Option<(ModuleId, Incarnation)> {
        let (id, life) = name.split_once('.')?;
        Some((ModuleId(id.parse().ok()?), Incarnation(life.parse().ok()?)))
    };
    let mut sent = 0;
    for entry in fs::read_dir(directory(root))? {
        let Some((id, life)) = entry?.file_name().to_str().and_then(name) else { continue };
        if let Ok(Some(account)) = Ledger::read(root, id, life) {
            sent += account.tally.total().sent;
        }
    }
    Ok(sent)
}

fn header(id: ModuleId, incarnation: Incarnation) -> [u8; HEADER] {
    let mut bytes = [0; HEADER];
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
    bytes[12..16].copy_from_slice(&id.0.to_le_bytes());
    bytes[16..18].copy_from_slice(&incarnation.0.to_le_bytes());
    bytes
}

fn slot(generation: u64, account: &Account) -> [u8; SLOT] {
    let mut numbers = [0u64; NUMBERS];
    numbers[0] = generation;
    for (i, (_, c)) in account.tally.iter().enumerate() {
        // Taken apart in full, so that a new count cannot be forgotten here.
        let Counts { sent, delivered, lost, duplicated, overflowed, expired, refused, bytes } = *c;
        numbers[1 + i * 8..][..8]
            .copy_from_slice(&[sent, delivered, lost, duplicated, overflowed, expired, refused, bytes]);
    }
    let Account { tally: _, left, loose, closed, foreign, wakes, unrecorded } = *account;
    numbers[1 + Class::ALL.len() * 8..][..left.len()].copy_from_slice(&left);
    numbers[1 + Class::ALL.len() * 9..][..loose.len()].copy_from_slice(&loose);
    numbers[NUMBERS - 4..].copy_from_slice(&[foreign, wakes, unrecorded, closed.into()]);
    let mut bytes = [0; SLOT];
    for (chunk, n) in bytes.chunks_exact_mut(8).zip(numbers) {
        chunk.copy_from_slice(&n.to_le_bytes());
    }
    let sum = crc32fast::hash(&bytes[..SLOT - 4]);
    bytes[SLOT - 4..].copy_from_slice(&sum.to_le_bytes());
    bytes
}

fn read_slot(bytes: &[u8]) -> Option<(u64, Account)> {
    let (body, sum) = bytes.split_last_chunk::<4>()?;
    if crc32fast::hash(body) != u32::from_le_bytes(*sum) {
        return None;
    }
    let mut numbers = body.chunks_exact(8).map(|c| c.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)));
    let generation = numbers.next()?;
    let mut account = Account::default();
    for class in Class::ALL {
        account.tally[class] = Counts {
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
    for count in account.left.iter_mut().chain(&mut account.loose) {
        *count = numbers.next()?;
    }
    account.foreign = numbers.next()?;
    account.wakes = numbers.next()?;
    account.unrecorded = numbers.next()?;
    account.closed = numbers.next()? != 0;
    Some((generation, account))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ME: (ModuleId, Incarnation) = (ModuleId(3), Incarnation(1));

    fn account(n: u64) -> Account {
        let mut account = Account {
            left: std::array::from_fn(|i| n + i as u64),
            loose: std::array::from_fn(|i| n * 2 + i as u64),
            closed: n.is_multiple_of(2),
            foreign: n,
            wakes: n + 1,
            unrecorded: n + 2,
            ..Account::default()
        };
        for (i, class) in Class::ALL.into_iter().enumerate() {
            let i = i as u64 * 100 + n;
            account.tally[class] = Counts {
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
        account
    }

    fn dir() -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(directory(dir.path())).unwrap();
        dir
    }

    #[test]
    fn the_newest_write_is_read() {
        let dir = dir();
        assert_eq!(Ledger::read(dir.path(), ME.0, ME.1).unwrap(), None);
        let mut ledger = Ledger::create(dir.path(), ME.0, ME.1).unwrap();
        assert_eq!(Ledger::read(dir.path(), ME.0, ME.1).unwrap(), Some(Account::default()));
        for n in 1..6 {
            ledger.write(&account(n)).unwrap();
            assert_eq!(Ledger::read(dir.path(), ME.0, ME.1).unwrap(), Some(account(n)));
        }
    }

    #[test]
    fn what_all_have_sent_is_added_up() {
        let dir = dir();
        assert_eq!(sent(dir.path()).unwrap(), 0);
        for (id, life, n) in [(4, 0, 1), (4, 1, 2), (7, 0, 3)] {
            let mut ledger = Ledger::create(dir.path(), ModuleId(id), Incarnation(life)).unwrap();
            ledger.write(&account(n)).unwrap();
        }
        let each = |n| account(n).tally.total().sent;
        assert!(each(1) > 0);
        fs::write(directory(dir.path()).join("9.0"), b"").unwrap();
        fs::write(directory(dir.path()).join("stranger"), b"no ledger").unwrap();
        assert_eq!(sent(dir.path()).unwrap(), each(1) + each(2) + each(3));
    }

    #[test]
    fn a_torn_write_leaves_the_one_before() {
        let dir = dir();
        let mut ledger = Ledger::create(dir.path(), ME.0, ME.1).unwrap();
        ledger.write(&account(1)).unwrap();
        ledger.write(&account(2)).unwrap();
        // Generation 3 lies in slot 1; tear it.
        ledger.file.write_all_at(&[0xFF; 40], HEADER as u64 + SLOT as u64).unwrap();
        assert_eq!(Ledger::read(dir.path(), ME.0, ME.1).unwrap(), Some(account(1)));
        ledger.file.write_all_at(&[0xFF; 40], HEADER as u64).unwrap();
        assert!(matches!(Ledger::read(dir.path(), ME.0, ME.1), Err(LedgerError::Damaged(_))));
    }

    #[test]
    fn refuses_strangers() {
        let dir = dir();
        let file = path(dir.path(), ME.0, ME.1);
        let read = || Ledger::read(dir.path(), ME.0, ME.1);
        fs::write(&file, b"").unwrap();
        assert!(matches!(read(), Ok(None)));
        fs::write(&file, b"hello").unwrap();
        assert!(matches!(read(), Err(LedgerError::Foreign(_))));
        fs::write(&file, header(ModuleId(4), ME.1)).unwrap();
        assert!(matches!(read(), Err(LedgerError::Foreign(_))));
        fs::write(&file, header(ME.0, ME.1)).unwrap();
        assert!(matches!(read(), Ok(None)));
        let mut newer = header(ME.0, ME.1);
        newer[8] += 1;
        fs::write(&file, newer).unwrap();
        assert!(matches!(read(), Err(LedgerError::Version(_, 4))));
        let mut garbage = header(ME.0, ME.1).to_vec();
        garbage.extend([7; SLOT * 3]);
        fs::write(&file, garbage).unwrap();
        assert!(matches!(read(), Err(LedgerError::Damaged(_))));
    }
}

//! Journal files: [`Record`]s on their way to a file and back.
//!
//! `MMJOURNL`, a version (2 bytes), then frames: length (4), CRC-32/ISO-HDLC of the content (4), content
//! in bincode. The first frame is a [`Head`], all others are records. All numbers are little endian.
//!
//! A writer that is killed leaves at most one frame torn, at the end; readers cut it off and say so. A
//! writer that cannot write any more stops for good and counts what is lost, because a journal with a
//! gap could not be replayed. Absent: which records there are, and joining the files of one run.

use bincode::config::standard;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::journal::{Record, Sink};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use thiserror::Error;

const MAGIC: [u8; 8] = *b"MMJOURNL";
/// The version of the layout and of all records.
pub const VERSION: u16 = 4;
/// No frame is longer; the longest is a head with a scenario in it.
const LONGEST: usize = 32 << 20;
/// Bytes gathered before they are written.
const GATHER: usize = 64 << 10;
/// Bytes read at once; joining a run reads many files together.
const READ_AHEAD: usize = 16 << 10;

/// What a journal file begins with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Head {
    /// The journal of a run, or the controller's part of it.
    Run(RunHead),
    /// The part of one life of an agent.
    Part {
        /// The name of the run.
        run: String,
        /// Which module.
        id: ModuleId,
        /// Which life of it.
        life: Incarnation,
    },
}

/// What one has to know to understand the records of a run, and to replay it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunHead {
    /// The version of the program that wrote it.
    pub program: String,
    /// The family of its agents.
    pub family: String,
    /// What carried messages: `ipc` or `sim`.
    pub link: String,
    /// The seed of all chance.
    pub seed: u64,
    /// How many modules there are.
    pub modules: u32,
    /// The file that the scenario came from.
    pub origin: String,
    /// The text of the scenario.
    pub scenario: String,
    /// What the command line changed, as it was typed.
    pub options: Vec<String>,
}

/// Why a journal cannot be written or read at all.
#[derive(Debug, Error)]
pub enum JournalError {
    /// The file cannot be created.
    #[error("cannot write the journal {0}: {1}; name a file in a directory that exists and is yours")]
    Create(PathBuf, io::Error),
    /// The file cannot be read.
    #[error("cannot read the journal {0}: {1}")]
    Read(PathBuf, io::Error),
    /// Not a journal.
    #[error("{0} is not a journal; `metamorph run SCENARIO --journal FILE` writes one")]
    Magic(PathBuf),
    /// Another version.
    #[error(
        "{0} is a journal of version {1}; this program reads version {VERSION}: use the program that wrote it"
    )]
    Version(PathBuf, u16),
    /// The head is damaged.
    #[error("the head of the journal {0} is damaged: {1}")]
    Head(PathBuf, String),
}

/// The file that the controller's part of a run is written to, in the directory of parts.
pub fn controller_part(parts: &Path) -> PathBuf {
    parts.join("controller")
}
/// The file that the part of one life of an agent is written to.
pub fn agent_part(parts: &Path, id: ModuleId, life: Incarnation) -> PathBuf {
    parts.join(format!("{id}.{life}"))
}

/// A journal file that is being written.
#[derive(Debug)]
pub struct Writer {
    file: Option<File>,
    path: PathBuf,
    gathered: Vec<u8>,
    /// Records in `gathered`.
    waiting: u64,
    /// Length of what is written in whole frames.
    length: u64,
    lost: u64,
    trouble: Option<String>,
}

impl Writer {
    /// Creates a journal file; one that is there is replaced.
    pub fn create(path: &Path, head: &Head) -> Result<Writer, JournalError> {
        let file = File::create(path).map_err(|e| JournalError::Create(path.to_owned(), e))?;
        let mut writer = Writer {
            file: Some(file),
            path: path.to_owned(),
            gathered: [&MAGIC[..], &VERSION.to_le_bytes()].concat(),
            waiting: 0,
            length: 0,
            lost: 0,
            trouble: None,
        };
        if let Err(e) = writer.frame(head).and_then(|()| writer.write()) {
            return Err(JournalError::Create(path.to_owned(), e));
        }
        Ok(writer)
    }

    /// Goes on with a file of which `length` bytes are whole.
    pub fn go_on(path: &Path, length: u64) -> Result<Writer, JournalError> {
        let open = || -> io::Result<File> {
            let mut file = File::options().write(true).open(path)?;
            file.set_len(length)?;
            io::Seek::seek(&mut file, io::SeekFrom::End(0))?;
            Ok(file)
        };
        let file = open().map_err(|e| JournalError::Create(path.to_owned(), e))?;
        Ok(Writer {
            file: Some(file),
            path: path.to_owned(),
            gathered: Vec::new(),
            waiting: 0,
            length,
            lost: 0,
            trouble: None,
        })
    }

    /// Records that could not be written, and why.
    pub fn lost(&self) -> (u64, Option<&str>) {
        (self.lost, self.trouble.as_deref())
    }

    fn frame<T: Serialize>(&mut self, content: &T) -> io::Result<()> {
        let start = self.gathered.len();
        self.gathered.extend([0; 8]);
        bincode::serde::encode_into_std_write(content, &mut self.gathered, standard())
            .map_err(io::Error::other)?;
        let content = &self.gathered[start + 8..];
        if content.len() > LONGEST {
            let length = content.len();
            self.gathered.truncate(start);
            return Err(io::Error::other(format!("a frame of {length} bytes is too long")));
        }
        let (length, sum) = (content.len() as u32, crc32fast::hash(content));
        self.gathered[start..start + 4].copy_from_slice(&length.to_le_bytes());
        self.gathered[start + 4..start + 8].copy_from_slice(&sum.to_le_bytes());
        Ok(())
    }

    fn write(&mut self) -> io::Result<()> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.write_all(&self.gathered)?;
        self.length += self.gathered.len() as u64;
        self.gathered.clear();
        self.waiting = 0;
        Ok(())
    }

    fn give_up(&mut self, error: &io::Error) {
        tracing::warn!("the journal {} ends here: {error}", self.path.display());
        // What is whole stays; that the rest cannot be cut off is found out by its check sum.
        if let Some(file) = self.file.take() {
            let _ = file.set_len(self.length);
        }
        self.lost += self.waiting;
        self.gathered = Vec::new();
        self.waiting = 0;
        self.trouble = Some(error.to_string());
    }
}

impl Sink for Writer {
    fn put(&mut self, record: &Record) {
        if self.file.is_none() {
            self.lost += 1;
            return;
        }
        self.waiting += 1;
        if let Err(e) = self.frame(record) {
            self.give_up(&e);
        } else if self.gathered.len() >= GATHER {
            self.commit();
        }
    }

    fn commit(&mut self) {
        if !self.gathered.is_empty()
            && let Err(e) = self.write()
        {
            self.give_up(&e);
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.commit();
    }
}

/// The end of a journal that could not be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Torn {
    /// The file.
    pub path: PathBuf,
    /// Bytes of it that are whole.
    pub whole: u64,
    /// Bytes behind them.
    pub cut: u64,
    /// What is wrong there.
    pub why: &'static str,
}

impl std::fmt::Display for Torn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Torn { path, whole, cut, why } = self;
        write!(f, "{}: cut off after {whole} bytes, {cut} bytes before the end: {why}", path.display())
    }
}

/// A journal file that is being read.
#[derive(Debug)]
pub struct Reader {
    file: BufReader<File>,
    path: PathBuf,
    head: Head,
    size: u64,
    whole: u64,
    torn: Option<Torn>,
    over: bool,
}

impl Reader {
    /// Opens a journal file and reads its head.
    pub fn open(path: &Path) -> Result<Reader, JournalError> {
        let io = |e| JournalError::Read(path.to_owned(), e);
        let file = File::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        let mut file = BufReader::with_capacity(READ_AHEAD, file);
        let mut start = [0; MAGIC.len() + 2];
        if file.read_exact(&mut start).is_err() || start[..MAGIC.len()] != MAGIC {
            return Err(JournalError::Magic(path.to_owned()));
        }
        let version = u16::from_le_bytes([start[8], start[9]]);
        if version != VERSION {
            return Err(JournalError::Version(path.to_owned(), version));
        }
        let mut whole = start.len() as u64;
        let head = read_frame(&mut file, size, &mut whole)
            .map_err(|why| JournalError::Head(path.to_owned(), why.to_owned()))?
            .ok_or_else(|| JournalError::Head(path.to_owned(), "it is missing".to_owned()))?;
        Ok(Reader { file, path: path.to_owned(), head, size, whole, torn: None, over: false })
    }

    /// What the file begins with.
    pub fn head(&self) -> &Head {
        &self.head
    }
    /// What was wrong with the end, once all records have been read.
    pub fn torn(&self) -> Option<&Torn> {
        self.torn.as_ref()
    }
    /// How many bytes have been read in whole frames.
    pub fn whole(&self) -> u64 {
        self.whole
    }
}

impl Iterator for Reader {
    type Item = Record;

    fn next(&mut self) -> Option<Record> {
        if self.over {
            return None;
        }
        match read_frame(&mut self.file, self.size, &mut self.whole) {
            Ok(Some(record)) => return Some(record),
            Ok(None) => {}
            Err(why) => {
                let (path, cut) = (self.path.clone(), self.size.saturating_sub(self.whole));
                self.torn = Some(Torn { path, whole: self.whole, cut, why });
            }
        }
        self.over = true;
        None
    }
}

/// The next frame; none at the end of the file. `whole` is moved behind it.
fn read_frame<T: DeserializeOwned>(
    from: &mut impl Read,
    size: u64,
    whole: &mut u64,
) -> Result<Option<T>, &'static str> {
    let left = size.saturating_sub(*whole);
    if left == 0 {
        return Ok(None);
    }
    let mut start = [0; 8];
    if left < 8 || from.read_exact(&mut start).is_err() {
        return Err("a frame begins and does not go on");
    }
    let [a, b, c, d, e, f, g, h] = start;
    let length = u32::from_le_bytes([a, b, c, d]) as usize;
    if length > LONGEST {
        return Err("a frame is longer than any can be");
    }
    if left - 8 < length as u64 {
        return Err("a frame is not complete");
    }
    let mut content = vec![0; length];
    if from.read_exact(&mut content).is_err() {
        return Err("a frame is not complete");
    }
    if crc32fast::hash(&content) != u32::from_le_bytes([e, f, g, h]) {
        return Err("the check sum of a frame does not match its content");
    }
    let decoded = bincode::serde::decode_from_slice(&content, standard().with_limit::<LONGEST>());
    let (value, used) = decoded.map_err(|_| "a frame holds no record of this version")?;
    if used != length {
        return Err("a frame holds more than one record");
    }
    *whole += 8 + length as u64;
    Ok(Some(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::journal::{Event, Who};
    use metamorph_protocol::time::Time;
    use proptest::prelude::*;
    use std::fs;

    fn head() -> Head {
        Head::Part { run: "mm0000000000".into(), id: ModuleId(3), life: Incarnation(1) }
    }
    fn record(n: u64) -> Record {
        let event = Event::Violated { invariant: "x".into(), what: "y".repeat(n as usize % 50) };
        Record { at: Time(n), who: Who::Agent(ModuleId(3), Incarnation(1)), event }
    }
    fn sample(path: &Path) -> Vec<u8> {
        let mut writer = Writer::create(path, &head()).unwrap();
        (0..20).for_each(|n| writer.put(&record(n)));
        drop(writer);
        fs::read(path).unwrap()
    }
    fn read(path: &Path) -> (Vec<Record>, Option<Torn>) {
        let mut reader = Reader::open(path).unwrap();
        let records = reader.by_ref().collect();
        (records, reader.torn().cloned())
    }

    #[test]
    fn reads_what_it_writes_and_goes_on() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        sample(&path);
        let all: Vec<Record> = (0..20).map(record).collect();
        assert_eq!(read(&path), (all.clone(), None));
        let mut reader = Reader::open(&path).unwrap();
        assert_eq!(reader.head(), &head());
        assert_eq!(reader.by_ref().take(7).count(), 7);
        let mut writer = Writer::go_on(&path, reader.whole()).unwrap();
        writer.put(&record(99));
        drop(writer);
        assert_eq!(read(&path), ([&all[..7], &[record(99)]].concat(), None));
    }

    /// Whatever a crash leaves of the end: all whole records are read, and the cut is told.
    #[test]
    fn a_torn_tail_is_cut_and_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let bytes = sample(&path);
        let all: Vec<Record> = (0..20).map(record).collect();
        let mut ends = vec![];
        let mut reader = Reader::open(&path).unwrap();
        ends.push(reader.whole());
        while reader.next().is_some() {
            ends.push(reader.whole());
        }
        for length in ends[0]..bytes.len() as u64 {
            fs::write(&path, &bytes[..length as usize]).unwrap();
            let (records, torn) = read(&path);
            let whole = ends.iter().filter(|e| **e <= length).count() - 1;
            assert_eq!(records, all[..whole]);
            assert_eq!(
                torn.map(|t| (t.whole, t.cut)),
                (!ends.contains(&length)).then(|| { (ends[whole], length - ends[whole]) })
            );
        }
    }

    #[test]
    fn refuses_what_it_does_not_know_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let good = sample(&path);
        let error = |edit: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = good.clone();
            edit(&mut bytes);
            fs::write(&path, bytes).unwrap();
            Reader::open(&path).unwrap_err()
        };
        assert!(matches!(error(&|b| b[0] = b'X'), JournalError::Magic(_)));
        assert!(matches!(error(&|b| b.truncate(9)), JournalError::Magic(_)));
        let newer = error(&|b| b[8] = 7);
        assert!(matches!(newer, JournalError::Version(_, 7)));
        let ours = format!("this program reads version {VERSION}:");
        assert!(newer.to_string().contains("version 7") && newer.to_string().contains(&ours));
        assert!(matches!(error(&|b| b[20] ^= 1), JournalError::Head(..)));
        assert!(matches!(error(&|b| b.truncate(12)), JournalError::Head(..)));
        assert!(matches!(Reader::open(dir.path()), Err(JournalError::Magic(_) | JournalError::Read(..))));
    }

    /// `/dev/full` takes nothing: writing to it fails as on a full disk.
    #[test]
    fn a_full_disk_stops_the_journal_and_is_counted() {
        let full = Writer::create(Path::new("/dev/full"), &head());
        assert!(matches!(full, Err(JournalError::Create(..))));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let mut writer = Writer::create(&path, &head()).unwrap();
        writer.put(&record(1));
        writer.commit();
        writer.file = Some(File::options().write(true).open("/dev/full").unwrap());
        writer.put(&record(2));
        writer.put(&record(3));
        assert_eq!(writer.lost(), (0, None));
        writer.commit();
        writer.put(&record(4));
        writer.commit();
        assert_eq!(writer.lost().0, 3);
        assert!(writer.lost().1.is_some_and(|why| why.contains("space")));
        assert_eq!(read(&path), (vec![record(1)], None));
    }

    proptest! {
        /// Damage anywhere is found; no record is read that was not written.
        #[test]
        fn damage_is_found(at in 0usize..2_000, bit in 0u8..8) {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("j");
            let mut bytes = sample(&path);
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            fs::write(&path, bytes).unwrap();
            if let Ok(reader) = Reader::open(&path) {
                for (n, got) in reader.enumerate() {
                    prop_assert_eq!(got, record(n as u64));
                }
            }
        }
    }
}

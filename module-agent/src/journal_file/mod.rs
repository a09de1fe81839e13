//! Journal files: [`Record`]s on their way to a file and back.
//!
//! `MMJOURNL`, a version (2 bytes), then frames (`frame`) whose content is in bincode. The first frame is a
//! [`Head`], all others are records; what the head's check sum calls the frame before it is the CRC-32 of
//! the ten bytes in front of it. Every file names its run, and no frame fits into another file.
//!
//! A writer that is killed leaves at most one frame torn, at the end; readers cut it off and say so.
//! Everything else that is not as it was written is an error (`damage`). A writer that cannot write any
//! more stops for good and counts what is lost, because a journal with a gap could not be replayed. Absent:
//! which records there are, and joining the files of one run.

mod damage;
mod frame;

pub use damage::{Damage, DamageKind, JournalError, Torn};

use bincode::config::standard;
use frame::{HEADER, Header};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::record::{Record, Sink};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const MAGIC: [u8; 8] = *b"MMJOURNL";
/// Bytes in front of the first frame.
const START: usize = MAGIC.len() + 2;
/// The version of the layout and of all records.
pub const VERSION: u16 = 5;
/// Bytes of the longest head, which has a scenario in it.
const LONGEST_HEAD: usize = 32 << 20;
/// Bytes of the longest record.
const LONGEST: usize = 1 << 20;
/// Bytes gathered before they are written.
const GATHER: usize = 64 << 10;
/// Bytes read at once; joining a run reads many files together.
const READ_AHEAD: usize = 16 << 10;

/// Tells the files of one run from those of all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct RunId(pub [u8; 16]);

impl fmt::Display for RunId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// A value in bincode, of a type that only its owner knows.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Packed(Vec<u8>);

impl Packed {
    /// Packs a value.
    ///
    /// # Errors
    /// Says why the value has no form in bincode.
    pub fn of<T: Serialize>(value: &T) -> Result<Packed, String> {
        bincode::serde::encode_to_vec(value, standard()).map(Packed).map_err(|e| e.to_string())
    }
    /// Unpacks the value.
    ///
    /// # Errors
    /// Says why it is no value of this type.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, String> {
        decode(&self.0)
    }
    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }
}

fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    match bincode::serde::decode_from_slice(bytes, standard().with_limit::<LONGEST_HEAD>()) {
        Ok((value, used)) if used == bytes.len() => Ok(value),
        Ok((_, used)) => Err(format!("{} bytes are left over", bytes.len() - used)),
        Err(e) => Err(e.to_string()),
    }
}

/// What a journal file begins with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Head {
    /// The journal of a run, or the controller's part of it.
    Run(RunHead),
    /// The part of one life of an agent.
    Part {
        /// The run that it is a part of.
        run: RunId,
        /// Which module.
        id: ModuleId,
        /// Which life of it.
        incarnation: Incarnation,
    },
}

/// What one has to know to understand the records of a run, and to replay it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunHead {
    /// Which run.
    pub run: RunId,
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
    /// What was changed in the scenario, in a form that the driver knows.
    pub overrides: Packed,
    /// The hosts of a run on several machines; empty for a run on one.
    pub hosts: Vec<String>,
}

/// Where the parts of a run's journal are written.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Parts {
    /// The directory.
    pub dir: PathBuf,
    /// The run.
    pub run: RunId,
}

/// The file that the controller's part of a run is written to, in the directory of parts.
pub fn controller_part(parts: &Path) -> PathBuf {
    parts.join("controller")
}
/// The file that the part of one life of an agent is written to.
pub fn agent_part(parts: &Path, id: ModuleId, incarnation: Incarnation) -> PathBuf {
    parts.join(format!("{id}.{incarnation}"))
}

/// The end of what is whole of a file, from which a writer can go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct End {
    /// Bytes up to there.
    pub bytes: u64,
    /// The check sum of the last frame.
    sum: u32,
}

/// A journal file that is being written.
#[derive(Debug)]
pub struct Writer {
    file: Option<File>,
    path: PathBuf,
    gathered: Vec<u8>,
    /// The check sum of the last frame.
    sum: u32,
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
        Writer::onto(file, path, head)
    }

    /// Begins a journal in a file that is open and empty; `path` is what messages call it.
    pub fn onto(file: File, path: &Path, head: &Head) -> Result<Writer, JournalError> {
        let error = |e| JournalError::Create(path.to_owned(), e);
        let start = [&MAGIC[..], &VERSION.to_le_bytes()].concat();
        let mut writer = Writer::new(file, path, End { bytes: 0, sum: crc32fast::hash(&start) });
        writer.gathered = start;
        writer.frame(head, LONGEST_HEAD).and_then(|()| writer.write()).map_err(error)?;
        Ok(writer)
    }

    /// Goes on with a file from the end of what is whole.
    pub fn go_on(path: &Path, end: End) -> Result<Writer, JournalError> {
        let open = || -> io::Result<File> {
            let mut file = File::options().write(true).open(path)?;
            file.set_len(end.bytes)?;
            file.seek(SeekFrom::End(0))?;
            Ok(file)
        };
        let file = open().map_err(|e| JournalError::Create(path.to_owned(), e))?;
        Ok(Writer::new(file, path, end))
    }

    fn new(file: File, path: &Path, end: End) -> Writer {
        Writer {
            file: Some(file),
            path: path.to_owned(),
            gathered: Vec::new(),
            sum: end.sum,
            waiting: 0,
            length: end.bytes,
            lost: 0,
            trouble: None,
        }
    }

    /// Records that could not be written, and why.
    pub fn lost(&self) -> (u64, Option<&str>) {
        (self.lost, self.trouble.as_deref())
    }

    fn frame<T: Serialize>(&mut self, content: &T, longest: usize) -> io::Result<()> {
        self.sum = frame::append(&mut self.gathered, self.sum, content, longest)?;
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
        if let Err(e) = self.frame(record, LONGEST) {
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

/// Why there is no next frame although the file goes on.
enum Stop {
    /// The writer was killed.
    Torn,
    /// Something is wrong.
    Damaged(DamageKind),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Stop {
        Stop::Damaged(DamageKind::Unreadable(error.to_string()))
    }
}

/// A journal file that is being read: an iterator over its records that ends with the first damage.
#[derive(Debug)]
pub struct Reader {
    file: BufReader<File>,
    path: PathBuf,
    head: Head,
    size: u64,
    end: End,
    torn: Option<Torn>,
    over: bool,
}

impl Reader {
    /// Opens a journal file and reads its head.
    pub fn open(path: &Path) -> Result<Reader, JournalError> {
        let io = |e| JournalError::Read(path.to_owned(), e);
        let file = crate::regular_file::open(path).map_err(io)?;
        let size = file.metadata().map_err(io)?.len();
        let mut file = BufReader::with_capacity(READ_AHEAD, file);
        let mut start = Vec::with_capacity(START);
        file.by_ref().take(START as u64).read_to_end(&mut start).map_err(io)?;
        let known = start.len().min(MAGIC.len());
        if start[..known] != MAGIC[..known] {
            return Err(JournalError::Magic(path.to_owned()));
        }
        let Some(version) = start[known..].first_chunk().map(|v| u16::from_le_bytes(*v)) else {
            return Err(JournalError::NoHead(path.to_owned()));
        };
        if version != VERSION {
            return Err(JournalError::Version(path.to_owned(), version));
        }
        let mut end = End { bytes: START as u64, sum: crc32fast::hash(&start) };
        let damage = |kind| Damage { path: path.to_owned(), at: START as u64, kind };
        let head = match next_frame(&mut file, size, &mut end, LONGEST_HEAD) {
            Ok(Some(content)) => decode(&content).map_err(|why| damage(DamageKind::Content(why)))?,
            Ok(None) | Err(Stop::Torn) => return Err(JournalError::NoHead(path.to_owned())),
            Err(Stop::Damaged(kind)) => return Err(damage(kind).into()),
        };
        Ok(Reader { file, path: path.to_owned(), head, size, end, torn: None, over: false })
    }

    /// What the file begins with.
    pub fn head(&self) -> &Head {
        &self.head
    }
    /// What was wrong with the end, once all records have been read.
    pub fn torn(&self) -> Option<&Torn> {
        self.torn.as_ref()
    }
    /// The end of what has been read.
    pub fn end(&self) -> End {
        self.end
    }
    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Iterator for Reader {
    type Item = Result<Record, Damage>;

    fn next(&mut self) -> Option<Result<Record, Damage>> {
        if self.over {
            return None;
        }
        let at = self.end.bytes;
        let damage = |kind| Some(Err(Damage { path: self.path.clone(), at, kind }));
        let next = match next_frame(&mut self.file, self.size, &mut self.end, LONGEST) {
            Ok(Some(content)) => match decode(&content) {
                Ok(record) => return Some(Ok(record)),
                Err(why) => damage(DamageKind::Content(why)),
            },
            Ok(None) => None,
            Err(Stop::Torn) => {
                let cut = self.size.saturating_sub(at);
                self.torn = Some(Torn { path: self.path.clone(), whole: at, cut });
                None
            }
            Err(Stop::Damaged(kind)) => damage(kind),
        };
        self.over = true;
        next
    }
}

/// The content of the next frame; `None` at the end of the file. `end` is moved behind it.
fn next_frame(
    file: &mut BufReader<File>,
    size: u64,
    end: &mut End,
    longest: usize,
) -> Result<Option<Vec<u8>>, Stop> {
    let left = usize::try_from(size.saturating_sub(end.bytes)).unwrap_or(usize::MAX);
    if left == 0 {
        return Ok(None);
    }
    let mut start = [0; HEADER];
    if left >= HEADER {
        file.read_exact(&mut start)?;
    }
    let header = Header::read(start);
    if left < HEADER || header.length > longest || header.length > left - HEADER {
        return Err(broken(file, end.bytes, left, longest)?);
    }
    let mut content = vec![0; header.length];
    file.read_exact(&mut content)?;
    if !header.fits(&content) {
        return Err(Stop::Damaged(DamageKind::Changed));
    }
    if header.previous != end.sum {
        return Err(Stop::Damaged(DamageKind::Order));
    }
    *end = End { bytes: end.bytes + (HEADER + header.length) as u64, sum: header.sum };
    Ok(Some(content))
}

/// Why the frame at `at` is longer than what is left of the file.
fn broken(file: &mut BufReader<File>, at: u64, left: usize, longest: usize) -> io::Result<Stop> {
    let mut rest = Vec::new();
    if left < HEADER + longest {
        file.seek(SeekFrom::Start(at))?;
        file.by_ref().take(left as u64).read_to_end(&mut rest)?;
        if frame::is_torn(&rest, longest) {
            return Ok(Stop::Torn);
        }
    }
    Ok(Stop::Damaged(DamageKind::Changed))
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::record::{Event, Who};
    use metamorph_protocol::time::Time;
    use std::fs;

    fn head() -> Head {
        Head::Part { run: RunId([7; 16]), id: ModuleId(3), incarnation: Incarnation(1) }
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
        let records = reader.by_ref().map(Result::unwrap).collect();
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
        let mut writer = Writer::go_on(&path, reader.end()).unwrap();
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
        ends.push(reader.end().bytes);
        while reader.next().is_some() {
            ends.push(reader.end().bytes);
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
        assert!(matches!(error(&|b| b.truncate(9)), JournalError::NoHead(_)));
        let newer = error(&|b| b[8] = 7);
        assert!(matches!(newer, JournalError::Version(_, 7)));
        let ours = format!("this program reads version {VERSION}:");
        assert!(newer.to_string().contains("version 7") && newer.to_string().contains(&ours));
        assert!(matches!(error(&|b| b[20] ^= 1), JournalError::Damaged(_)));
        assert!(matches!(error(&|b| b.truncate(12)), JournalError::NoHead(_)));
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

    /// The first damage of a file, after records that are all as they were written.
    fn damage(path: &Path) -> Option<(u64, DamageKind)> {
        let reader = match Reader::open(path) {
            Ok(reader) => reader,
            Err(JournalError::Damaged(damage)) => return Some((damage.at, damage.kind)),
            Err(_) => return None,
        };
        for (n, got) in reader.enumerate() {
            match got {
                Ok(got) => assert_eq!(got, record(n as u64)),
                Err(damage) => {
                    assert!(damage.to_string().contains("damaged at byte"), "{damage}");
                    return Some((damage.at, damage.kind));
                }
            }
        }
        None
    }

    /// The places of all frames of a file.
    fn frames(bytes: &[u8]) -> Vec<std::ops::Range<usize>> {
        let mut at = START;
        std::iter::from_fn(|| {
            let header = Header::read(*bytes.get(at..)?.first_chunk()?);
            let frame = at..at + HEADER + header.length;
            at = frame.end;
            Some(frame)
        })
        .collect()
    }

    /// Every single changed bit behind the version is damage, also in the last frame and in lengths.
    #[test]
    fn every_changed_bit_is_damage_at_its_frame() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let good = sample(&path);
        // The head, one in the middle, and the last.
        for frame in frames(&good).into_iter().step_by(10) {
            for bit in 8 * frame.start..8 * frame.end {
                let mut bytes = good.clone();
                bytes[bit / 8] ^= 1 << (bit % 8);
                fs::write(&path, bytes).unwrap();
                assert_eq!(damage(&path), Some((frame.start as u64, DamageKind::Changed)), "bit {bit}");
            }
        }
    }

    /// Frames that were removed, repeated, swapped, or taken from the file of another run do not fit.
    #[test]
    fn frames_out_of_their_place_are_damage() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("j");
        let good = sample(&path);
        let frames = frames(&good);
        let (before, a, b) = (&good[..frames[5].start], &good[frames[5].clone()], &good[frames[6].clone()]);
        let after = &good[frames[6].end..];
        let other = Head::Part { run: RunId([8; 16]), id: ModuleId(3), incarnation: Incarnation(1) };
        let mut writer = Writer::create(&path, &other).unwrap();
        (0..20).for_each(|n| writer.put(&record(n)));
        drop(writer);
        let foreign = fs::read(&path).unwrap();
        assert_eq!(foreign.len(), good.len());
        for (bytes, at) in [
            ([before, b, after].concat(), 5),
            ([before, a, a, b, after].concat(), 6),
            ([before, b, a, after].concat(), 5),
            ([before, a, after].concat(), 6),
            ([before, &foreign[frames[5].start..]].concat(), 5),
        ] {
            fs::write(&path, bytes).unwrap();
            assert_eq!(damage(&path), Some((frames[at].start as u64, DamageKind::Order)));
        }
    }
}

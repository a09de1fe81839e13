//! Journal files: [`Record`]s on their way to a file and back.
//!
//! A file consists of `MMJOURNL`, a version (2 bytes), and frames (`frame`) whose content is in bincode. The
//! first frame is a [`Head`], all others are records. For the head, the CRC-32 of the ten bytes before it
//! takes the place of the previous check sum. Every file names its run, and no frame fits into another file.
//!
//! A killed writer leaves at most one torn frame, at the end; readers cut it off and report it. Any other
//! difference from what was written is an error (`damage`). A writer that fails stops permanently and counts the
//! lost records, because a journal with a gap cannot be replayed. Not here: the kinds of records, and joining
//! the files of one run.

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
/// Number of bytes in front of the first frame.
const START: usize = MAGIC.len() + 2;
/// The version of the layout and of all records.
pub const VERSION: u16 = 18;
/// Largest size of a head, which contains a scenario, in bytes.
const LONGEST_HEAD: usize = 32 << 20;
/// Largest size of a record in bytes.
const LONGEST: usize = 1 << 20;
/// Number of bytes gathered before a write.
const GATHER: usize = 64 << 10;
/// Number of bytes read at once; joining a run reads many files together.
const READ_AHEAD: usize = 16 << 10;

/// Identifies the files of one run.
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
    /// Encodes a value.
    ///
    /// # Errors
    /// Returns the reason why the value cannot be encoded.
    pub fn of<T: Serialize>(value: &T) -> Result<Packed, String> {
        bincode::serde::encode_to_vec(value, standard()).map(Packed).map_err(|e| e.to_string())
    }
    /// Decodes the value.
    ///
    /// # Errors
    /// Returns the reason why the bytes are not a value of this type.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, String> {
        decode(&self.0)
    }
    /// Returns the bytes.
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

/// The first frame of a journal file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Head {
    /// The journal of a run, or the controller's part of it.
    Run(RunHead),
    /// The part of one incarnation of an agent.
    Part {
        /// The run that it belongs to.
        run: RunId,
        /// The module.
        id: ModuleId,
        /// Its incarnation.
        incarnation: Incarnation,
    },
}

/// The facts needed to understand the records of a run, and to replay it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunHead {
    /// The run.
    pub run: RunId,
    /// The version of the program that wrote it.
    pub program: String,
    /// The family of its agents.
    pub family: String,
    /// The driver that carried messages: `ipc` or `sim`.
    pub link: String,
    /// The seed of all randomness.
    pub seed: u64,
    /// The number of modules.
    pub modules: u32,
    /// The file that the scenario came from.
    pub origin: String,
    /// The text of the scenario.
    pub scenario: String,
    /// The changes of the scenario by options, in a form that the driver knows.
    pub overrides: Packed,
    /// The hosts of a run on several machines; empty for a run on one.
    pub hosts: Vec<String>,
}

/// The location of the parts of a run's journal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Parts {
    /// The directory.
    pub dir: PathBuf,
    /// The run.
    pub run: RunId,
}

/// Returns the file of the controller's part of a run, in the directory of parts.
pub fn controller_part(parts: &Path) -> PathBuf {
    parts.join("controller")
}
/// Returns the file of the part of one incarnation of an agent.
pub fn agent_part(parts: &Path, id: ModuleId, incarnation: Incarnation) -> PathBuf {
    parts.join(format!("{id}.{incarnation}"))
}
/// Returns the module and the incarnation that a file is named after, as the parts of agents are.
pub fn agent_of(name: &str) -> Option<(ModuleId, Incarnation)> {
    let (id, incarnation) = name.split_once('.')?;
    Some((ModuleId(id.parse().ok()?), Incarnation(incarnation.parse().ok()?)))
}

/// The end of the whole frames of a file, from which a writer can continue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct End {
    /// Its offset in bytes.
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
    /// Number of records in `gathered`.
    waiting: u64,
    /// Length of the whole frames written, in bytes.
    length: u64,
    lost: u64,
    trouble: Option<String>,
}

impl Writer {
    /// Creates a journal file, or replaces it.
    pub fn create(path: &Path, head: &Head) -> Result<Writer, JournalError> {
        let file = File::create(path).map_err(|e| JournalError::Create(path.to_owned(), e))?;
        Writer::onto(file, path, head)
    }

    /// Begins a journal in an open, empty file; `path` is its name in error messages.
    pub fn onto(file: File, path: &Path, head: &Head) -> Result<Writer, JournalError> {
        let error = |e| JournalError::Create(path.to_owned(), e);
        let start = [&MAGIC[..], &VERSION.to_le_bytes()].concat();
        let mut writer = Writer::new(file, path, End { bytes: 0, sum: crc32fast::hash(&start) });
        writer.gathered = start;
        writer.frame(head, LONGEST_HEAD).and_then(|()| writer.write()).map_err(error)?;
        Ok(writer)
    }

    /// Opens a journal file to append records after `end`, and removes everything behind it.
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

    /// Returns the number of records that could not be written, and the reason.
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
        // The whole frames stay. If the torn one cannot be cut off, readers detect it by its check sum.
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

/// Why there is no next frame before the end of the file.
enum Stop {
    /// The writer was killed.
    Torn,
    /// The file is damaged.
    Damaged(DamageKind),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Stop {
        Stop::Damaged(DamageKind::Unreadable(error.to_string()))
    }
}

/// A journal file that is being read: an iterator over its records that ends at the first damage.
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

    /// Returns the head of the file.
    pub fn head(&self) -> &Head {
        &self.head
    }
    /// Returns the incomplete frame at the end of the file, if any; known once all records have been read.
    pub fn torn(&self) -> Option<&Torn> {
        self.torn.as_ref()
    }
    /// Returns the end of the last frame that has been read.
    pub fn end(&self) -> End {
        self.end
    }
    /// Returns the path of the file.
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

/// Returns the content of the next frame and moves `end` behind it; `None` at the end of the file.
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

/// Decides whether the incomplete or too long frame at `at` is torn or damaged.
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
mod tests;

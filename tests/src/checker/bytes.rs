//! The bytes of a journal, read independently of the program: version 18 of the format, and of its records
//! those about bodies.

use super::Cell;

const START: usize = 10;
const HEADER: usize = 12;

/// A record.
pub struct Entry {
    /// The number, from 1.
    pub record: usize,
    /// The time, in nanoseconds of scenario time.
    pub at: u64,
    /// The event.
    pub event: Event,
}

/// An event that concerns bodies.
pub enum Event {
    /// A process starts.
    Start {
        /// The module.
        id: u32,
        /// The number of its earlier incarnations.
        life: u64,
        /// The place of the body.
        place: Vec<u8>,
    },
    /// A body is asked to act.
    Act {
        /// The module.
        id: u32,
        /// The kind of action.
        kind: u8,
        /// The action of that kind.
        action: Vec<u8>,
        /// True if the body began it.
        begun: bool,
    },
    /// Actions have ended: the modules, and the places of their bodies.
    Advance(Vec<(u32, Vec<u8>)>),
    /// A cell is blocked, or free again.
    Obstacle {
        /// The cell.
        cell: Cell,
        /// True if an obstacle is there.
        there: bool,
    },
    /// Anything else.
    Other,
}

/// A journal.
pub struct Journal {
    /// The family of its agents.
    pub family: String,
    /// The number of modules.
    pub modules: u32,
    /// The records.
    pub entries: Vec<Entry>,
}

impl Journal {
    /// Reads a journal from the bytes of a file.
    pub fn read(bytes: &[u8]) -> Result<Journal, String> {
        if bytes.len() < START || bytes[..START] != *b"MMJOURNL\x12\0" {
            return Err("this is not a journal of version 18".into());
        }
        let mut sum = crc32fast::hash(&bytes[..START]);
        let mut rest = &bytes[START..];
        let head = frame(&mut rest, &mut sum)?;
        let (family, modules) = read_head(&mut Bytes(head)).ok_or("the head cannot be read")?;
        let mut entries = Vec::new();
        while !rest.is_empty() {
            let content = frame(&mut rest, &mut sum)?;
            let record = entries.len() + 1;
            let unreadable = || format!("record {record} cannot be read");
            let (at, event) = read_record(&mut Bytes(content)).ok_or_else(unreadable)?;
            entries.push(Entry { record, at, event });
        }
        Ok(Journal { family, modules, entries })
    }
}

/// Takes a frame that follows the one with the checksum `sum`.
fn frame<'a>(rest: &mut &'a [u8], sum: &mut u32) -> Result<&'a [u8], String> {
    let number = |i: usize| -> Option<u32> { Some(u32::from_le_bytes(*rest.get(4 * i..)?.first_chunk()?)) };
    let (Some(length), Some(previous), Some(own)) = (number(0), number(1), number(2)) else {
        return Err("the last frame has no header".into());
    };
    let Some(content) = rest.get(HEADER..HEADER + length as usize) else {
        return Err("the last frame is not complete".into());
    };
    if crc32fast::hash(&[&rest[..8], content].concat()) != own || previous != *sum {
        return Err("a frame has a wrong check sum".into());
    }
    *sum = own;
    *rest = &rest[HEADER + length as usize..];
    Ok(content)
}

/// The rest of a sequence of bytes in the encoding of bincode 2: numbers of variable length, lists with their
/// length in front, variants by their numbers.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, n: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(taken)
    }
    fn byte(&mut self) -> Option<u8> {
        self.take(1).map(|b| b[0])
    }
    fn number(&mut self) -> Option<u64> {
        let width = match self.byte()? {
            251 => 2,
            252 => 4,
            253 => 8,
            254.. => return None,
            small => return Some(small.into()),
        };
        let mut all = [0; 8];
        all[..width].copy_from_slice(self.take(width)?);
        Some(u64::from_le_bytes(all))
    }
    fn id(&mut self) -> Option<u32> {
        self.number()?.try_into().ok()
    }
    fn list(&mut self) -> Option<&'a [u8]> {
        let length = self.number()?.try_into().ok()?;
        self.take(length)
    }
    fn text(&mut self) -> Option<String> {
        String::from_utf8(self.list()?.to_vec()).ok()
    }
    /// Reads a value in its wire form: its kind and its bytes.
    fn blob(&mut self) -> Option<(u8, Vec<u8>)> {
        Some((self.byte()?, self.list()?.to_vec()))
    }
}

fn read_head(bytes: &mut Bytes<'_>) -> Option<(String, u32)> {
    if bytes.number()? != 0 {
        return None;
    }
    bytes.take(16)?;
    let (_program, family, _link) = (bytes.text()?, bytes.text()?, bytes.text()?);
    let _seed = bytes.number()?;
    Some((family, bytes.id()?))
}

fn read_record(bytes: &mut Bytes<'_>) -> Option<(u64, Event)> {
    let at = bytes.number()?;
    // Records of agents do not concern bodies.
    if bytes.number()? != 0 {
        return Some((at, Event::Other));
    }
    let event = match bytes.number()? {
        3 => Event::Start { id: bytes.id()?, life: bytes.number()?, place: bytes.blob()?.1 },
        4 => {
            let (id, _revision) = (bytes.id()?, bytes.number()?);
            let (kind, action) = bytes.blob()?;
            Event::Act { id, kind, action, begun: bytes.byte()? == 1 }
        }
        5 => {
            let count = bytes.number()?;
            let ended = (0..count).map(|_| Some((bytes.id()?, bytes.blob()?.1)));
            Event::Advance(ended.collect::<Option<_>>()?)
        }
        14 => read_fault(bytes)?,
        _ => return Some((at, Event::Other)),
    };
    bytes.0.is_empty().then_some((at, event))
}

fn read_fault(bytes: &mut Bytes<'_>) -> Option<Event> {
    let fault = bytes.text()?;
    if bytes.byte()? == 1 {
        bytes.id()?;
    }
    if bytes.byte()? == 1 {
        for _ in 0..3 {
            bytes.number()?;
        }
    }
    let _by = bytes.text()?;
    let effect = bytes.text()?;
    let there = effect.ends_with("the cell was free");
    if !there && !effect.ends_with("the obstacle is gone") {
        return Some(Event::Other);
    }
    let inside = fault.split_once('[')?.1.trim_end_matches(']');
    let cell: Vec<i32> = inside.split(',').map(|c| c.trim().parse().ok()).collect::<Option<_>>()?;
    Some(Event::Obstacle { cell: cell.try_into().ok()?, there })
}

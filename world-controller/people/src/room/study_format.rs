//! The format of session logs, and the file that a log is appended to. What a log means, `study` says.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use thiserror::Error;

/// The version of the format.
pub const VERSION: u32 = 1;
/// Bytes of a log at most: an hour of eye positions has a tenth of that.
pub const MAX_BYTES: u64 = 64 << 20;
/// Mode bits of the file of a new log. Private: it holds personal data.
const MODE: u32 = 0o600;

/// How the person saw the room.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Representation {
    /// On a screen, without the room behind it.
    Virtual,
    /// Over a picture of the real room.
    Augmented,
}

/// Whether the eye could move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mobility {
    /// It could only turn.
    Static,
    /// It could move.
    Dynamic,
}

/// The first line.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// The version.
    pub study: u32,
    /// How the person saw the room.
    pub representation: Representation,
    /// Whether the eye could move.
    pub mobility: Mobility,
    /// The name of the piece in the middle.
    pub table: String,
    /// Pieces in the room at the start of the session.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub pieces: BTreeMap<String, Placed>,
}

/// Where a piece stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Placed {
    /// Its middle in metres.
    pub centre: [f64; 2],
    /// Its colour, if it was given one.
    pub colour: Option<String>,
}

/// An action of a person on pieces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Action {
    /// A new piece.
    Create,
    /// A piece is taken out.
    Delete,
    /// A piece is selected.
    Select,
    /// It no longer is.
    Deselect,
    /// A piece is moved.
    Move,
    /// A piece is turned.
    Turn,
    /// A piece gets another colour.
    Colour,
    /// The eye is turned or moved.
    Look,
}

/// Any other line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// Seconds since the beginning.
    pub t: f64,
    /// The action, if the event is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub action: Option<Action>,
    /// The piece that it is done to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub piece: Option<String>,
    /// The middle of the piece after the action, in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub centre: Option<[f64; 2]>,
    /// Its colour after the action.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colour: Option<String>,
    /// Where the eye is, in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eye: Option<[f64; 3]>,
    /// Where it looks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f64; 3]>,
}

/// Why lines are not written.
#[derive(Debug, Error)]
pub enum AppendError {
    /// The log would be longer than what is read.
    #[error("the session log has {} MiB, which is the most", MAX_BYTES >> 20)]
    Full,
    /// The system refuses.
    #[error("the session log cannot be written: {0}")]
    System(#[from] io::Error),
}

/// A log that is being written.
#[derive(Debug)]
pub struct LogFile {
    file: File,
    bytes: u64,
}

impl LogFile {
    /// Creates a file that only its owner can read.
    ///
    /// # Errors
    /// If the file exists already, or the system refuses.
    pub fn create(path: &Path) -> io::Result<LogFile> {
        LogFile::at_end(File::options().write(true).create_new(true).mode(MODE).open(path)?)
    }

    /// Continues an open file at its end.
    ///
    /// # Errors
    /// If the system does not say how long it is.
    pub fn at_end(file: File) -> io::Result<LogFile> {
        let bytes = file.metadata()?.len();
        Ok(LogFile { file, bytes })
    }

    /// Appends whole lines, or none.
    ///
    /// # Errors
    /// If the log would be too long, or the system refuses.
    pub fn append(&mut self, lines: &str) -> Result<(), AppendError> {
        let bytes = self.bytes.saturating_add(lines.len() as u64);
        if bytes > MAX_BYTES {
            return Err(AppendError::Full);
        }
        if let Err(error) = self.file.write_all(lines.as_bytes()).and_then(|()| self.file.flush()) {
            // A part of a line would make the log unreadable. The error before says more than one of this.
            let _ = self.file.set_len(self.bytes);
            return Err(error.into());
        }
        self.bytes = bytes;
        Ok(())
    }
}

/// Appends a value as a line of JSON.
///
/// # Errors
/// If the value is no JSON.
pub fn push_line<T: Serialize>(lines: &mut String, value: &T) -> io::Result<()> {
    lines.push_str(&serde_json::to_string(value)?);
    lines.push('\n');
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::PermissionsExt as _;

    #[test]
    fn a_log_is_new_private_and_bounded() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("log");
        let mut log = LogFile::create(&path).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, MODE);
        assert_eq!(LogFile::create(&path).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        log.append("one\n").unwrap();
        log.append("two\n").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "one\ntwo\n");
        File::options().write(true).open(&path).unwrap().set_len(MAX_BYTES - 3).unwrap();
        let mut full = LogFile::at_end(File::options().write(true).open(&path).unwrap()).unwrap();
        assert!(matches!(full.append("four"), Err(AppendError::Full)));
        let mut unwritable = LogFile::at_end(File::open(directory.path()).unwrap()).unwrap();
        assert!(matches!(unwritable.append("x\n"), Err(AppendError::System(_))));
    }
}

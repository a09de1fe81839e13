//! Errors of journals. Readers tell the incomplete last frame of a killed writer ([`Torn`]) from damage,
//! which has another cause ([`Damage`]).

use super::{RunId, VERSION};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Errors of a whole journal.
#[derive(Debug, Error)]
pub enum JournalError {
    /// The file cannot be created.
    #[error("cannot write the journal {0}: {1}; name a file in a directory that exists and is yours")]
    Create(PathBuf, io::Error),
    /// The file cannot be read.
    #[error("cannot read the journal {0}: {1}{REMEDY}")]
    Read(PathBuf, io::Error),
    /// Not a journal.
    #[error("{0} is not a journal; `metamorph run SCENARIO --journal FILE` writes one{REMEDY}")]
    Magic(PathBuf),
    /// Another version.
    #[error(
        "{0} is a journal of version {1}; this program reads version {VERSION}: use the program that wrote it{REMEDY}"
    )]
    Version(PathBuf, u16),
    /// The writer was killed before the head was written.
    #[error("the journal {0} ends within its head, so nothing of it can be read{REMEDY}")]
    NoHead(PathBuf),
    /// A journal that cannot be used here.
    #[error("{0}: {1}{REMEDY}")]
    Unfit(PathBuf, String),
    /// The content of a file differs from what its writer wrote.
    #[error(transparent)]
    Damaged(#[from] Damage),
}

const REMEDY: &str = "\n  fix: name a whole journal that `metamorph run --journal` of this version wrote";

impl JournalError {
    /// True if a file was changed after it was written, or is missing.
    pub fn is_damage(&self) -> bool {
        matches!(self, JournalError::Damaged(_))
    }
}

/// A place in a journal where it differs from what its writer wrote. A killed writer does not cause this.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{}: the journal is damaged at byte {at}: {kind}\n  fix: {}", .path.display(), .kind.remedy())]
pub struct Damage {
    /// The file.
    pub path: PathBuf,
    /// Offset of the first wrong byte.
    pub at: u64,
    /// The kind of damage.
    pub kind: DamageKind,
}

/// The kind of damage in a journal.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DamageKind {
    /// Bytes were changed.
    #[error("a frame was changed: its check sum does not match")]
    Changed,
    /// Frames were moved.
    #[error(
        "a frame does not follow the one before it: frames were removed, repeated or put in another order"
    )]
    Order,
    /// A whole frame holds something other than a record.
    #[error("a complete frame does not hold a record of this version: {0}")]
    Content(String),
    /// The file cannot be read at this place.
    #[error("it cannot be read there: {0}")]
    Unreadable(String),
    /// A file that should be a part is not one of this version.
    #[error("this is no part of a journal of version {VERSION}")]
    NoPart,
    /// The part of another run.
    #[error("this is a part of run {found}, but the controller's part is of run {expected}")]
    OtherRun {
        /// The run of the controller's part.
        expected: RunId,
        /// The run of this part.
        found: RunId,
    },
    /// A part has the name of another.
    #[error("this is the part of module {id} in incarnation {incarnation}, under the name of another part")]
    OtherPart {
        /// The module.
        id: ModuleId,
        /// Its incarnation.
        incarnation: Incarnation,
    },
    /// A part is missing, or empty.
    #[error(
        "the controller started module {id} in incarnation {incarnation}, but its part of the journal is missing or empty"
    )]
    MissingPart {
        /// The module.
        id: ModuleId,
        /// Its incarnation.
        incarnation: Incarnation,
    },
}

impl DamageKind {
    fn remedy(&self) -> &'static str {
        match self {
            DamageKind::Changed | DamageKind::Order | DamageKind::Content(_) | DamageKind::Unreadable(_) => {
                "use an undamaged copy; `metamorph view` shows what comes before the damage"
            }
            DamageKind::NoPart | DamageKind::OtherRun { .. } | DamageKind::OtherPart { .. } => {
                "take the file out of the directory, and put the right one in its place"
            }
            DamageKind::MissingPart { .. } => "put the file back; without it the run cannot be replayed",
        }
    }
}

/// The incomplete end of a journal whose writer was killed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Torn {
    /// The file.
    pub path: PathBuf,
    /// Length of the file in bytes up to the end of the last whole frame.
    pub whole: u64,
    /// Number of bytes of the incomplete frame after that.
    pub cut: u64,
}

impl std::fmt::Display for Torn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Torn { path, whole, cut } = self;
        write!(f, "{}: cut off after {whole} bytes; the last frame has {cut} bytes only", path.display())
    }
}

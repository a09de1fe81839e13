//! Reads the journals of runs, of either link, however the run ended.
//!
//! [`Journal::open`] returns the head of a journal and then its records, in an order in which causes come
//! before effects. A run of processes writes one file for the controller and one for each incarnation of an
//! agent, in a directory beside the journal (`FILE.parts`), and joins them at its end (`join`); if the run
//! was killed before, reading joins them. `session` creates and completes a journal for the drivers. The file
//! layout is in `metamorph_module_agent::journal_file`, the records are in `metamorph_protocol::record`.

mod error;
mod join;
mod session;

pub use error::{HeadError, JournalFailure, ReadError, exit_code};

pub use metamorph_module_agent::journal_file::{Damage, DamageKind, JournalError, RunHead};
pub use metamorph_protocol::record::{Blob, Consumed, Emitted, Event, MessageName, Record, Sent, Step, Who};
pub use session::JournalSession;

use join::Join;
use metamorph_module_agent::journal_file::{Head, Packed, Reader, RunId};
use metamorph_scenario::family::Families;
use metamorph_scenario::{LinkKind, Overrides, Plan, read_text};
use siphasher::sip128::SipHasher13;
use std::hash::{BuildHasher, RandomState};
use std::path::{Path, PathBuf};

/// A journal opened for reading: an iterator over its records that ends with the first damage.
pub struct Journal {
    head: RunHead,
    source: Source,
    unfinished: bool,
    /// True once the record was read that ends a finished run.
    has_ended: bool,
    /// True once all records have been read.
    is_read: bool,
}

enum Source {
    File(Box<Reader>),
    Parts(Box<Join>),
}

/// Returns the directory that holds the parts of a journal until they are joined.
pub fn parts_of(file: &Path) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

impl Journal {
    /// Opens a journal; if its run was killed or is active, the parts that exist.
    ///
    /// # Errors
    ///
    /// There is no journal, it is of another version, or a part does not belong to it. Damage further on is
    /// an item of the iterator.
    pub fn open(path: &Path) -> Result<Journal, JournalError> {
        let parts = if path.is_dir() { path.to_owned() } else { parts_of(path) };
        if parts.is_dir() {
            let join = Join::open(&parts)?;
            let head = join.head().clone();
            return Ok(Journal::of(head, Source::Parts(Box::new(join)), true));
        }
        let reader = Reader::open(path)?;
        match reader.head() {
            Head::Run(head) => {
                let head = head.clone();
                Ok(Journal::of(head, Source::File(Box::new(reader)), false))
            }
            Head::Part { id, .. } => {
                let what =
                    format!("this is the part of module {id}; name the journal or the directory of parts");
                Err(JournalError::Unfit(path.to_owned(), what))
            }
        }
    }

    fn of(head: RunHead, source: Source, unfinished: bool) -> Journal {
        Journal { head, source, unfinished, has_ended: false, is_read: false }
    }

    /// Returns the head of the journal.
    pub fn head(&self) -> &RunHead {
        &self.head
    }

    /// Returns what is incomplete about the files, once all records have been read: torn ends, empty parts,
    /// an unfinished run.
    pub fn troubles(&self) -> Vec<String> {
        let mut troubles = match &self.source {
            Source::File(reader) => reader.torn().map(ToString::to_string).into_iter().collect(),
            Source::Parts(join) => join.troubles(),
        };
        if self.unfinished {
            troubles.push("the run was not finished; its parts were joined".to_owned());
        } else if self.is_read && !self.has_ended {
            let why = "its run was killed, its disk was full, or the file was cut off";
            troubles.push(format!("the journal has no end: {why}; what came after it is missing"));
        }
        troubles
    }
}

impl Iterator for Journal {
    type Item = Result<Record, Damage>;

    fn next(&mut self) -> Option<Result<Record, Damage>> {
        let next = match &mut self.source {
            Source::File(reader) => reader.next(),
            Source::Parts(join) => join.next(),
        };
        match &next {
            Some(Ok(record)) => self.has_ended |= matches!(record.event, Event::Ended { .. }),
            Some(Err(_)) => {}
            None => self.is_read = true,
        }
        next
    }
}

/// Returns the head of the journal of a run of this plan. Simulated runs of one plan have the same identity,
/// so that their journals are equal; each run of processes has its own.
///
/// # Errors
///
/// A plan that cannot be recorded.
pub fn head_of(plan: &Plan) -> Result<RunHead, String> {
    let overrides = Overrides { seed: Some(plan.seed), ..plan.overrides.clone() };
    let mut head = RunHead {
        run: RunId::default(),
        program: metamorph_text::version::version().to_owned(),
        family: plan.swarm.family().to_owned(),
        link: plan.overrides.link.name().to_owned(),
        seed: plan.seed,
        modules: plan.swarm.len() as u32,
        origin: plan.origin.clone(),
        scenario: plan.text.to_string(),
        overrides: Packed::of(&overrides)?,
        hosts: Vec::new(),
    };
    head.run = match plan.overrides.link {
        LinkKind::Sim => RunId(SipHasher13::new().hash(Packed::of(&head)?.bytes()).as_bytes()),
        LinkKind::Ipc => {
            let mut random = [0; 16];
            for half in random.chunks_mut(8) {
                half.copy_from_slice(&RandomState::new().hash_one(0).to_le_bytes());
            }
            RunId(random)
        }
    };
    Ok(head)
}

/// Reads the plan of a journal's run.
pub fn plan_of(families: Families, head: &RunHead) -> Result<Plan, HeadError> {
    let overrides: Overrides = head.overrides.read().map_err(HeadError::Overrides)?;
    read_text(families, &head.origin, &head.scenario, &overrides)
        .map_err(|diagnostics| HeadError::Scenario(diagnostics.to_string()))
}

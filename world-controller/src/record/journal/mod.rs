//! Journals of runs: reading them, on whatever link they were written and however the run ended.
//!
//! [`Journal::open`] gives the head of a journal and then its records, in an order in which causes come
//! before effects. A run of processes writes one file for the controller and one for each life of an
//! agent, in a directory beside the journal (`FILE.parts`), and joins them at its end (`join`); if it
//! did not come so far, reading joins them. `keep` begins and ends a journal for the drivers. The layout
//! of files is in `metamorph_module_agent::journal_file`, the records are in `metamorph_protocol::record`.

mod join;
mod keep;

pub use keep::Keeping;
pub use metamorph_module_agent::journal_file::{Damage, Flaw, JournalError, RunHead};
pub use metamorph_protocol::record::{Blob, Event, MessageName, Record, Sent, Step, Taken, Told, Who};

use crate::scenario::family::Families;
use crate::scenario::{LinkKind, Overrides, Plan, read_text};
use join::Join;
use metamorph_module_agent::journal_file::{Head, Packed, Reader, RunId};
use siphasher::sip128::SipHasher13;
use std::hash::{BuildHasher, RandomState};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a journal's scenario cannot be read again.
#[derive(Debug, Error)]
pub enum HeadError {
    /// What was changed in the scenario does not make sense to this program.
    #[error("what the head of the journal says was changed in the scenario is not of this program: {0}")]
    Overrides(String),
    /// The scenario does not make sense to this program.
    #[error("the scenario in the head of the journal cannot be read:\n{0}")]
    Scenario(String),
}

/// A journal that is being read: an iterator over its records that ends with the first damage.
pub struct Journal {
    head: RunHead,
    source: Source,
    unfinished: bool,
}

enum Source {
    File(Box<Reader>),
    Parts(Box<Join>),
}

/// The directory in which the parts of a journal lie until they are joined.
pub fn parts_of(file: &Path) -> PathBuf {
    let mut name = file.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

impl Journal {
    /// Opens a journal. If the run that writes it was killed, or is not over, what is there of it.
    pub fn open(path: &Path) -> Result<Journal, JournalError> {
        let parts = if path.is_dir() { path.to_owned() } else { parts_of(path) };
        if parts.is_dir() {
            let join = Join::open(&parts)?;
            let head = join.head().clone();
            return Ok(Journal { head, source: Source::Parts(Box::new(join)), unfinished: true });
        }
        let reader = Reader::open(path)?;
        match reader.head() {
            Head::Run(head) => {
                let head = head.clone();
                Ok(Journal { head, source: Source::File(Box::new(reader)), unfinished: false })
            }
            Head::Part { id, .. } => {
                let what =
                    format!("this is the part of module {id}; name the journal or the directory of parts");
                Err(JournalError::Unfit(path.to_owned(), what))
            }
        }
    }

    /// What the run was.
    pub fn head(&self) -> &RunHead {
        &self.head
    }

    /// What is incomplete about the files, once all records have been read: torn ends, empty parts, a run
    /// that was not over.
    pub fn troubles(&self) -> Vec<String> {
        let mut troubles = match &self.source {
            Source::File(reader) => reader.torn().map(ToString::to_string).into_iter().collect(),
            Source::Parts(join) => join.troubles(),
        };
        if self.unfinished {
            troubles.push("the run was not over; what its parts hold was joined".to_owned());
        }
        troubles
    }
}

impl Iterator for Journal {
    type Item = Result<Record, Damage>;

    fn next(&mut self) -> Option<Result<Record, Damage>> {
        match &mut self.source {
            Source::File(reader) => reader.next(),
            Source::Parts(join) => join.next(),
        }
    }
}

/// What the journal of a run of this plan begins with. Simulated runs of one plan have one identity, so that
/// their journals are the same; runs of processes each have their own.
///
/// # Errors
/// Says why the plan cannot be written down.
pub fn head_of(plan: &Plan) -> Result<RunHead, String> {
    let overrides = Overrides { seed: Some(plan.seed), ..plan.overrides.clone() };
    let mut head = RunHead {
        run: RunId::default(),
        program: env!("CARGO_PKG_VERSION").to_owned(),
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

/// The plan that a journal's run was made by.
pub fn plan_of(families: Families, head: &RunHead) -> Result<Plan, HeadError> {
    let overrides: Overrides = head.overrides.read().map_err(HeadError::Overrides)?;
    read_text(families, &head.origin, &head.scenario, &overrides)
        .map_err(|problems| HeadError::Scenario(problems.to_string()))
}

//! Begins and ends the journal of a run, for the drivers.

use super::join::Join;
use super::{Event, JournalError, Record, Who, head_of, parts_of};
use crate::scenario::Plan;
use crate::wording::many;
use metamorph_module_agent::journal::{Head, Writer, controller_part};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::journal::Sink;
use metamorph_protocol::tally::Tally;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::chronicle::Log;
use std::cell::RefCell;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// A journal that is being kept.
pub struct Keeping {
    file: PathBuf,
    parts: Option<PathBuf>,
    writer: Rc<RefCell<Writer>>,
}

impl Keeping {
    /// Begins the journal of a simulated run: one file.
    pub fn simulated(file: &Path, plan: &Plan) -> Result<Keeping, JournalError> {
        let writer = Writer::create(file, &Head::Run(head_of(plan)))?;
        Ok(Keeping { file: file.to_owned(), parts: None, writer: Rc::new(RefCell::new(writer)) })
    }

    /// Begins the journal of a run of processes: a directory of parts.
    pub fn of_processes(file: &Path, plan: &Plan) -> Result<Keeping, JournalError> {
        // Agents are told where to write.
        let file = std::path::absolute(file).map_err(|e| JournalError::Create(file.to_owned(), e))?;
        let parts = parts_of(&file);
        fs::create_dir(&parts).map_err(|e| {
            let taken = e.kind() == io::ErrorKind::AlreadyExists;
            let why = "it is left of a run that was not finished, or another run writes it; \
                       `metamorph replay` reads it, and without it the name is free again";
            JournalError::Create(parts.clone(), if taken { io::Error::other(why) } else { e })
        })?;
        let writer = Writer::create(&controller_part(&parts), &Head::Run(head_of(plan)))?;
        Ok(Keeping { file, parts: Some(parts), writer: Rc::new(RefCell::new(writer)) })
    }

    /// Goes on with the journal of a run of processes whose controller was killed. `whole` is how many
    /// bytes of the controller's part are whole.
    pub fn going_on(file: &Path, whole: u64, at: Time) -> Result<Keeping, JournalError> {
        let parts = parts_of(file);
        let mut writer = Writer::go_on(&controller_part(&parts), whole)?;
        writer.put(&Record { at, who: Who::Controller, event: Event::Resumed });
        writer.commit();
        Ok(Keeping { file: file.to_owned(), parts: Some(parts), writer: Rc::new(RefCell::new(writer)) })
    }

    /// Where records of this process go.
    pub fn log(&self) -> Log {
        self.writer.clone()
    }
    /// Where agents write their parts.
    pub fn parts(&self) -> Option<&Path> {
        self.parts.as_deref()
    }

    /// The run is over. `counts` are those of every life of an agent, where they are known apart, and
    /// `unrecorded` how many records agents could not write. Returns what a reader of the report should
    /// know.
    pub fn finish(
        self,
        end: Time,
        outcome: &str,
        tally: &Tally,
        counts: &[(ModuleId, Incarnation, Tally)],
        unrecorded: u64,
    ) -> Vec<String> {
        let mut notes = Vec::new();
        let mut writer = self.writer.borrow_mut();
        let mut put = |event| writer.put(&Record { at: end, who: Who::Controller, event });
        for (id, life, tally) in counts {
            put(Event::Counted { id: *id, life: *life, tally: *tally });
        }
        put(Event::Ended { outcome: outcome.to_owned(), tally: *tally });
        writer.commit();
        let (lost, why) = writer.lost();
        if lost + unrecorded > 0 {
            let why = why.unwrap_or("agents could not write their parts");
            notes.push(format!("missing from the journal: {}: {why}", many(lost + unrecorded, "record")));
        }
        if let Some(parts) = &self.parts
            && let Err(e) = self.join(parts)
        {
            notes.push(format!("the parts of the journal stay in {}: {e}", parts.display()));
        }
        notes
    }

    /// The run could not be finished; what there is of the journal is kept.
    pub fn give_up(&self) {
        self.writer.borrow_mut().commit();
        if let Some(parts) = &self.parts
            && let Err(e) = self.join(parts)
        {
            tracing::warn!("the parts of the journal stay in {}: {e}", parts.display());
        }
    }

    /// Joins the parts to one file, and removes them.
    fn join(&self, parts: &Path) -> Result<(), JournalError> {
        let mut join = Join::open(parts)?;
        let mut joined = Writer::create(&self.file, &Head::Run(join.head().clone()))?;
        join.by_ref().for_each(|record| joined.put(&record));
        joined.commit();
        if let (1.., why) = joined.lost() {
            let error = io::Error::other(why.unwrap_or_default().to_owned());
            let _ = fs::remove_file(&self.file);
            return Err(JournalError::Create(self.file.clone(), error));
        }
        for trouble in join.troubles() {
            tracing::warn!("{trouble}");
        }
        fs::remove_dir_all(parts).map_err(|e| JournalError::Create(parts.to_owned(), e))
    }
}

//! Begins and ends the journal of a run, for the drivers.

use super::join::Join;
use super::{Event, JournalError, Record, RunHead, Who, head_of, parts_of};
use metamorph_console::output::{OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_module_agent::journal_file::{End, Head, Parts, RunId, Writer, controller_part};
use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::record::Sink;
use metamorph_protocol::time::Time;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::kernel::recording::Log;
use metamorph_text::escape::{Shown, portable};
use metamorph_text::format::many;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A journal that is being written.
pub struct JournalSession {
    file: PathBuf,
    parts: Option<Parts>,
    writer: Arc<Mutex<Writer>>,
}

impl JournalSession {
    /// Creates the journal of a simulated run: one file.
    pub fn simulated(file: &Path, plan: &Plan) -> Result<JournalSession, JournalError> {
        let writer = Writer::create(file, &Head::Run(head(file, plan)?))?;
        Ok(JournalSession { file: file.to_owned(), parts: None, writer: Arc::new(Mutex::new(writer)) })
    }

    /// Creates the journal of a run of processes: a directory of parts.
    pub fn of_processes(file: &Path, plan: &Plan) -> Result<JournalSession, JournalError> {
        // Agents receive the path, and may have another working directory.
        let file = std::path::absolute(file).map_err(|e| JournalError::Create(file.to_owned(), e))?;
        let parts = parts_of(&file);
        fs::create_dir(&parts).map_err(|e| {
            let taken = e.kind() == io::ErrorKind::AlreadyExists;
            let why = "it belongs to an unfinished run, or another run is writing it; \
                       `metamorph replay` reads it; remove it to use the name again";
            JournalError::Create(parts.clone(), if taken { io::Error::other(why) } else { e })
        })?;
        let head = head(&file, plan)?;
        let run = head.run;
        let writer = Writer::create(&controller_part(&parts), &Head::Run(head))?;
        let parts = Some(Parts { dir: parts, run });
        Ok(JournalSession { file, parts, writer: Arc::new(Mutex::new(writer)) })
    }

    /// Continues the journal of a run of processes whose controller was killed, after the intact records of
    /// the controller's part.
    pub fn going_on(file: &Path, run: RunId, end: End, at: Time) -> Result<JournalSession, JournalError> {
        let parts = Parts { dir: parts_of(file), run };
        let mut writer = Writer::go_on(&controller_part(&parts.dir), end)?;
        writer.put(&Record { at, who: Who::Controller, event: Event::Resumed });
        writer.commit();
        Ok(JournalSession { file: file.to_owned(), parts: Some(parts), writer: Arc::new(Mutex::new(writer)) })
    }

    /// Returns the log for records of this process.
    pub fn log(&self) -> Log {
        Log::new(Arc::clone(&self.writer))
    }
    /// Returns the directory for the agents' parts, if there is one.
    pub fn parts(&self) -> Option<&Parts> {
        self.parts.as_ref()
    }

    /// Completes the journal of a finished run. `counts` are those of each incarnation of an agent, where
    /// known separately; `unrecorded` is the number of records that agents could not write. Returns why the journal is not
    /// whole, if it is not.
    pub fn finish(
        self,
        end: Time,
        outcome: &str,
        tally: &Tally,
        counts: &[(ModuleId, Incarnation, Tally)],
        unrecorded: u64,
    ) -> Option<String> {
        let mut notes = Vec::new();
        let mut writer = self.writer.lock().unwrap_or_else(PoisonError::into_inner);
        let mut put = |event| writer.put(&Record { at: end, who: Who::Controller, event });
        for (id, incarnation, tally) in counts {
            put(Event::Counted { id: *id, incarnation: *incarnation, tally: *tally });
        }
        put(Event::Ended { outcome: outcome.to_owned(), tally: *tally });
        writer.commit();
        let (lost, why) = writer.lost();
        if lost + unrecorded > 0 {
            let why = why.unwrap_or("agents could not write their parts");
            notes.push(format!("missing from the journal: {}: {why}", many(lost + unrecorded, "record")));
        }
        if let Some(parts) = &self.parts
            && let Err(e) = self.join(&parts.dir)
        {
            tracing::warn!("the parts of the journal stay in {}: {e}", parts.dir.shown());
            notes.push(format!(
                "the parts of the journal could not be joined, and stay in {}",
                portable(&parts.dir)
            ));
        }
        (!notes.is_empty()).then(|| notes.join("; "))
    }

    /// Abandons the journal of a run that could not be finished; its files are kept.
    pub fn give_up(&self) {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner).commit();
        if let Some(parts) = &self.parts
            && let Err(e) = self.join(&parts.dir)
        {
            tracing::warn!("the parts of the journal stay in {}: {e}", parts.dir.shown());
        }
    }

    /// Joins the parts into one file, and removes them.
    fn join(&self, parts: &Path) -> Result<(), JournalError> {
        let mut join = Join::open(parts)?;
        let failed = |e: OutputError| JournalError::Create(self.file.clone(), io::Error::other(e));
        let output =
            Outputs::default().writes("--journal", &self.file, OutputKind::Journal).map_err(failed)?;
        let draft = output.begin().map_err(failed)?;
        let handle = draft.handle().map_err(|e| JournalError::Create(self.file.clone(), e))?;
        let mut joined = Writer::onto(handle, &self.file, &Head::Run(join.head().clone()))?;
        for record in join.by_ref() {
            joined.put(&record?);
        }
        joined.commit();
        if let (1.., why) = joined.lost() {
            let error = io::Error::other(why.unwrap_or_default().to_owned());
            return Err(JournalError::Create(self.file.clone(), error));
        }
        drop(joined);
        output.finish(draft).map_err(failed)?;
        for trouble in join.troubles() {
            tracing::warn!("{trouble}");
        }
        fs::remove_dir_all(parts).map_err(|e| JournalError::Create(parts.to_owned(), e))
    }
}

fn head(file: &Path, plan: &Plan) -> Result<RunHead, JournalError> {
    head_of(plan).map_err(|why| JournalError::Create(file.to_owned(), io::Error::other(why)))
}

//! Write-ahead of an agent process: its part of the journal, then its counters, are written before their
//! effects are visible to others. A killed process has thus counted and recorded everything that it has sent.

use crate::journal_file::Writer;
use crate::run_dir::counter_file::{AgentCounters, CounterFileError, CounterStore};
use metamorph_protocol::record::Sink;

/// The counters and the part of the journal of one incarnation.
#[derive(Debug)]
pub struct WriteAhead {
    /// The counters.
    pub counters: AgentCounters,
    /// This incarnation's part of the journal; `None` if none is kept.
    pub journal: Option<Writer>,
    store: Box<dyn CounterStore>,
}

impl WriteAhead {
    /// Creates a record with all counters zero.
    pub fn new(store: Box<dyn CounterStore>, journal: Option<Writer>) -> WriteAhead {
        WriteAhead { counters: AgentCounters::default(), journal, store }
    }

    /// Writes the journal and the counters. Comes before every flush of a link.
    ///
    /// # Errors
    /// If the counters cannot be written.
    pub fn commit(&mut self) -> Result<(), CounterFileError> {
        if let Some(writer) = &mut self.journal {
            writer.commit();
            self.counters.unrecorded = writer.lost().0;
        }
        self.store.write(&self.counters)
    }

    /// Writes the journal and the final counters.
    ///
    /// # Errors
    /// If the counters cannot be written.
    pub fn close(mut self) -> Result<(), CounterFileError> {
        self.counters.closed = true;
        self.commit()
    }
}

//! What an agent process writes down before others can see it: its part of the journal, then its counters.
//! A process that is killed afterwards has counted and recorded all that it has sent.

use crate::journal_file::Writer;
use crate::run_dir::counter_file::{AgentCounters, CounterFileError, CounterStore};
use metamorph_protocol::record::Sink;

/// The counters and the part of the journal of one incarnation.
#[derive(Debug)]
pub struct WriteAhead {
    /// What has been counted.
    pub counters: AgentCounters,
    /// This incarnation's part of the journal, if one is kept.
    pub journal: Option<Writer>,
    store: Box<dyn CounterStore>,
}

impl WriteAhead {
    /// Nothing counted yet.
    pub fn new(store: Box<dyn CounterStore>, journal: Option<Writer>) -> WriteAhead {
        WriteAhead { counters: AgentCounters::default(), journal, store }
    }

    /// Writes down what has happened. Comes before every flush of a link.
    pub fn commit(&mut self) -> Result<(), CounterFileError> {
        if let Some(writer) = &mut self.journal {
            writer.commit();
            self.counters.unrecorded = writer.lost().0;
        }
        self.store.write(&self.counters)
    }

    /// The same for the last time.
    pub fn close(mut self) -> Result<(), CounterFileError> {
        self.counters.closed = true;
        self.commit()
    }
}

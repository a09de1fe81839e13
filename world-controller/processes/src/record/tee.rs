//! A log that forwards records to two logs.

use metamorph_protocol::record::{Record, Sink};
use metamorph_sim_bridge::kernel::recording::Log;
use std::sync::{Arc, Mutex};

/// Combines two logs, if both are given.
pub fn both(first: Option<Log>, second: Option<Log>) -> Option<Log> {
    match (first, second) {
        (Some(first), Some(second)) => Some(Log::new(Arc::new(Mutex::new(Both(first, second))))),
        (first, second) => first.or(second),
    }
}

struct Both(Log, Log);

impl Sink for Both {
    fn put(&mut self, record: &Record) {
        self.0.lock().put(record);
        self.1.lock().put(record);
    }
    fn commit(&mut self) {
        self.0.lock().commit();
        self.1.lock().commit();
    }
}

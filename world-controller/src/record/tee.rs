//! A log that forwards records to two logs.

use metamorph_protocol::record::{Record, Sink};
use metamorph_sim_bridge::kernel::recording::Log;
use std::cell::RefCell;
use std::rc::Rc;

/// Combines two logs, if both are given.
pub fn both(first: Option<Log>, second: Option<Log>) -> Option<Log> {
    match (first, second) {
        (Some(first), Some(second)) => Some(Rc::new(RefCell::new(Both(first, second)))),
        (first, second) => first.or(second),
    }
}

struct Both(Log, Log);

impl Sink for Both {
    fn put(&mut self, record: &Record) {
        self.0.borrow_mut().put(record);
        self.1.borrow_mut().put(record);
    }
    fn commit(&mut self) {
        self.0.borrow_mut().commit();
        self.1.borrow_mut().commit();
    }
}

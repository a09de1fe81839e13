//! What the directors of all families share: the port to the driver, faults, and how a run can end.

pub mod fault_injector;
pub mod faults;
pub mod outcome;
pub mod port;
pub mod progress;
pub mod proof;
pub mod reason;

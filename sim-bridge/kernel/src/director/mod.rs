//! The common parts of the directors of all families: the port to the driver, faults, and outcomes.

pub mod commands;
pub mod fault_injector;
pub mod faults;
pub mod link_faults;
pub mod monitor;
pub mod operator;
pub mod outcome;
pub mod port;
pub mod progress;
pub mod proof;
pub mod reason;
pub mod rescue;
pub mod standstills;
pub mod steering;
pub mod team;

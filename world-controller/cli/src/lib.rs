//! The command line: one file a command, with its arguments, its help and its exit codes, and the list of all commands.
//!
//! `commands` has the list, `dispatch` goes from arguments to an exit code, `reference` makes what is generated from the
//! definitions. `scenario_args`, `metrics` and `exit_codes` are shared by several commands, `runs` by those that run a scenario or show
//! a run.

mod agent;
mod assemblies;
mod bench;
mod check;
mod clean;
#[cfg(feature = "hosts")]
mod cluster;
pub mod commands;
mod diff;
pub mod dispatch;
mod doctor;
mod exit_codes;
mod explore;
mod export;
mod host;
pub mod learn;
mod licences;
mod log;
mod metrics;
mod modules;
mod new;
mod new_protocol;
pub mod plan;
mod plots;
pub mod reference;
mod render;
mod replay;
mod reproduce;
mod resume;
pub mod robot;
mod run;
mod runs;
mod scenario_args;
mod scenarios;
pub mod shape;
pub mod structure;
mod sweep;
mod view;
mod why;

pub use modules::SCHEMA as PAIRING_SCHEMA;

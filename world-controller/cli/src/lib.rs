//! The command line: arguments, the function that executes each command, and the generated reference.

pub mod args;
mod assemblies;
pub mod commands;
pub mod dispatch;
mod doctor;
mod examples;
mod figures;
mod host;
pub mod learn;
mod log;
mod modules;
mod new;
mod new_protocol;
pub mod plan;
mod plots;
pub mod reference;
pub mod robot;
mod runs;
mod scenarios;
pub mod shape;
pub mod structure;
mod structures;

pub use modules::SCHEMA as PAIRING_SCHEMA;

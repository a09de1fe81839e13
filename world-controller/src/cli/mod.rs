//! The command line: arguments, the function that executes each command, and the generated reference.

pub mod args;
mod assemblies;
pub mod commands;
pub mod dispatch;
mod doctor;
mod examples;
mod figures;
mod host;
mod modules;
mod new;
mod new_protocol;
mod plots;
pub mod reference;
mod runs;
mod scenarios;
mod structures;

//! The terminal, output files, signals and real time: all that commands ask of the operating system for people.

pub mod command;
pub mod files;
pub mod interrupt;
pub mod output;
pub mod output_kind;
pub mod shutdown;
pub mod stopwatch;
pub mod terminal;

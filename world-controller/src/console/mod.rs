//! The terminal, output files, signals, and how numbers and foreign text are written.

pub mod command_error;
pub mod escape;
pub mod format;
pub mod interrupt;
pub mod output;
pub mod progress;
pub mod shutdown;
pub mod stopwatch;
pub mod table;
pub mod terminal;

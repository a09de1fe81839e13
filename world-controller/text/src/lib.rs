//! Text in and out: where files come from, how numbers are written, how text from outside is made harmless, tables, colours, the progress
//! line, name and version of the program, and how a command fails. Nothing here asks the operating system.

pub mod command_error;
pub mod escape;
pub mod format;
pub mod paint;
pub mod program;
pub mod progress;
pub mod sources;
pub mod table;
pub mod version;

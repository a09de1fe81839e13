//! The command line: arguments, the command that each subcommand calls, and the generated reference.

pub mod args;
pub mod dispatch;
pub mod reference;

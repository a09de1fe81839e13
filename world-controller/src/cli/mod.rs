//! The command line: arguments, the command that each subcommand calls, and the generated reference.

pub mod args;
pub mod dispatch;
mod examples;
pub mod reference;

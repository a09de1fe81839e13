//! Errors of commands: a text and an exit code.

use std::error::Error;

/// Exit code: the program itself failed.
pub const FAILED: u8 = 1;
/// Exit code: the command line or the scenario is wrong.
pub const BAD_USAGE: u8 = 2;
/// Exit code: a replay differs from the journal.
pub const DIFFERENT: u8 = 8;
/// Exit code: a journal is damaged.
pub const DAMAGED: u8 = 9;

/// Why a command ended without an outcome.
pub trait CommandError: Error {
    /// Returns the exit code.
    fn exit_code(&self) -> u8 {
        FAILED
    }
    /// Returns the text for people.
    fn text(&self) -> String {
        self.to_string()
    }
}

/// The error of a command, as the program ends with it.
#[derive(Debug)]
pub struct Failure {
    /// The text for people.
    pub text: String,
    /// The exit code.
    pub exit_code: u8,
}

impl<E: CommandError> From<E> for Failure {
    fn from(error: E) -> Failure {
        Failure { text: error.text(), exit_code: error.exit_code() }
    }
}

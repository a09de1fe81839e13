//! Errors of reading and showing a journal.

use super::{Damage, JournalError};
use metamorph_text::command_error::{BAD_USAGE, CommandError, DAMAGED};
use thiserror::Error;

/// An error of a journal, as a command ends with it.
#[derive(Debug, Error)]
#[error(transparent)]
pub struct JournalFailure(#[from] pub JournalError);

impl From<Damage> for JournalFailure {
    fn from(damage: Damage) -> JournalFailure {
        JournalFailure(damage.into())
    }
}

/// Returns the exit code of a command that ends with an error of a journal.
pub fn exit_code(error: &JournalError) -> u8 {
    if error.is_damage() { DAMAGED } else { BAD_USAGE }
}

impl CommandError for JournalFailure {
    fn exit_code(&self) -> u8 {
        exit_code(&self.0)
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// The reason why a journal's scenario cannot be read.
#[derive(Debug, Error)]
pub enum HeadError {
    /// The recorded overrides are invalid.
    #[error("the overrides of the scenario in the head of the journal are not valid for this program: {0}")]
    Overrides(String),
    /// The recorded scenario is invalid.
    #[error("the scenario in the head of the journal cannot be read:\n{0}")]
    Scenario(String),
}

/// Errors of showing a journal.
#[derive(Debug, Error)]
pub enum ReadError {
    /// It cannot be read.
    #[error(transparent)]
    Journal(#[from] JournalFailure),
    /// Its head cannot be understood.
    #[error("{0}\n  fix: use the program that wrote the journal")]
    Head(#[from] HeadError),
}

impl CommandError for ReadError {
    fn exit_code(&self) -> u8 {
        match self {
            ReadError::Journal(error) => error.exit_code(),
            ReadError::Head(_) => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        match self {
            ReadError::Journal(error) if error.0.is_damage() => error.text(),
            _ => format!("metamorph: {self}, or a scenario that ends in .toml"),
        }
    }
}

impl From<JournalError> for ReadError {
    fn from(error: JournalError) -> ReadError {
        ReadError::Journal(error.into())
    }
}

impl From<Damage> for ReadError {
    fn from(damage: Damage) -> ReadError {
        ReadError::Journal(damage.into())
    }
}

//! Why a run is not explained.

use metamorph_console::output::OutputError;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::format::many;
use std::io;
use thiserror::Error;

/// Why there is no answer.
#[derive(Debug, Error)]
pub enum WhyError {
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(io::Error),
    /// The run was built. Holds the number of its standstills.
    #[error("the run was built, and {}\n  fix: {}", stood(*.0), if *.0 > 0 { "name one of them, such as --standstill 1" } else { "name the seed of a run that was not, with --seed" })]
    Built(usize),
    /// There is no standstill of this number.
    #[error("--standstill {number}: the run {}\n  fix: {}", stood(*.of), if *.of > 0 { format!("name one from 1 to {}", .of) } else { "leave it out".to_owned() })]
    NoStandstill {
        /// The number.
        number: usize,
        /// The number of standstills.
        of: usize,
    },
    /// Ctrl-C, before there was an answer.
    #[error("stopped before there was an answer")]
    Stopped,
    /// The answer cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

fn stood(standstills: usize) -> String {
    match standstills {
        0 => "never stood still".to_owned(),
        n => format!("stood still {}", many(n as u64, "time")),
    }
}

impl CommandError for WhyError {
    fn exit_code(&self) -> u8 {
        match self {
            WhyError::Signals(_) => FAILED,
            WhyError::Stopped => Outcome::Aborted.exit_code(),
            WhyError::Output(error) => error.exit_code(),
            WhyError::Built(_) | WhyError::NoStandstill { .. } => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

//! Errors of a reproduction: the reasons why an experiment cannot be repeated.

use crate::planners::trials::TrialsError;
use metamorph_console::output::OutputError;
use metamorph_experiments::sweep::SweepError;
use metamorph_experiments::sweep::store::StoreError;
use metamorph_free_modules::plan::PlanError;
use metamorph_people::room::study::LogError;
use metamorph_scenario::grid::GridError;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use thiserror::Error;

/// Why an experiment cannot be repeated.
#[derive(Debug, Error)]
pub enum ReproduceError {
    /// A sweep of the experiment failed.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// An experiment of a planner is not a sweep.
    #[error(
        "{0}: this experiment of a planner is not a sweep, so there are no runs to keep or to print with others\n  fix: name it alone, without --out, which only `stoy`, `why` and `transport` have of these; --json FILE has its numbers"
    )]
    NotTogether(&'static str),
    /// A plot of another experiment.
    #[error(
        "--plot: only `why` has a plot\n  fix: name it alone, or leave --plot out; --out DIR of 4.1, 4.2 and fig4.5 writes a report with plots"
    )]
    OfWhy,
    /// A gait file is wrong.
    #[error(transparent)]
    Gaits(#[from] PlanError),
    /// The trials of an experiment cannot be kept, or those that are there be used.
    #[error(transparent)]
    Trials(TrialsError),
    /// A session log cannot be read.
    #[error("metamorph: --study {0}")]
    Study(#[from] LogError),
}

impl CommandError for ReproduceError {
    fn exit_code(&self) -> u8 {
        match self {
            ReproduceError::Sweep(error) => error.exit_code(),
            ReproduceError::Gaits(error) => error.exit_code(),
            ReproduceError::NotTogether(_)
            | ReproduceError::OfWhy
            | ReproduceError::Study(_)
            | ReproduceError::Trials(_) => BAD_USAGE,
        }
    }
}

impl From<GridError> for ReproduceError {
    fn from(error: GridError) -> ReproduceError {
        SweepError::from(error).into()
    }
}

impl From<StoreError> for ReproduceError {
    fn from(error: StoreError) -> ReproduceError {
        SweepError::from(error).into()
    }
}

impl From<OutputError> for ReproduceError {
    fn from(error: OutputError) -> ReproduceError {
        SweepError::from(error).into()
    }
}

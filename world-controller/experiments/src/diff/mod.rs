//! `metamorph diff`: compares two sweeps by statistics, or two reports field by field.

mod reports;
mod sweeps;

use clap::Args;
use metamorph_console::output::{Json, OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::Channel;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::escape::Shown;
use serde_json::Value;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Version of the JSON output.
pub const SCHEMA: u32 = 1;

/// Arguments of `diff`.
#[derive(Debug, Args)]
pub struct DiffArgs {
    /// A directory that `sweep --out` wrote, or a report that `run --json` wrote
    #[arg(value_name = "A")]
    pub a: PathBuf,
    /// Another one of the same kind
    #[arg(value_name = "B")]
    pub b: PathBuf,
    /// Of sweeps: say that a measure differs only if its whole interval is beyond this share of its median in A
    /// (of rates: this many percentage points)
    #[arg(long, value_name = "P%", value_parser = percentage, default_value = "0%")]
    pub at_least: f64,
    /// Of sweeps: compare for each value of this key, whatever the values of other keys (repeatable); default: for each
    /// combination of the keys that both vary
    #[arg(long, value_name = "KEY")]
    pub by: Vec<String>,
    /// Of sweeps: draw the differences with their intervals to this file, as SVG (a forest plot); differences of
    /// numbers are shares of the median in A; default: none
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Write the comparison as JSON to a file, or to standard output with `-` (text for people then goes to
    /// standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

fn percentage(text: &str) -> Result<f64, String> {
    let number = text.strip_suffix('%').and_then(|number| number.parse::<f64>().ok());
    let share = number.filter(|percent| (0.0..=1000.0).contains(percent)).map(|percent| percent / 100.0);
    share.ok_or_else(|| "a share is written as a percentage: 5%".to_owned())
}

/// Errors of `diff`.
#[derive(Debug, Error)]
pub enum DiffError {
    /// One is a sweep and the other one is not.
    #[error("{} and {}: one is a directory and the other one is a file\n  fix: name two directories of sweeps, or two reports", .0.shown(), .1.shown())]
    Kinds(PathBuf, PathBuf),
    /// It is not what a sweep wrote.
    #[error("{}: {reason}\n  fix: name a directory that `metamorph sweep --out` wrote", .path.shown())]
    Sweep {
        /// The directory.
        path: PathBuf,
        /// The cause.
        reason: String,
    },
    /// It is not a report.
    #[error("{}: {reason}\n  fix: name a file that `metamorph run --json` wrote", .path.shown())]
    Report {
        /// The file.
        path: PathBuf,
        /// The cause.
        reason: String,
    },
    /// A key that the sweeps do not both vary.
    #[error("--by {}: the two sweeps do not both vary this key\n  fix: name one of {known}", .key.shown())]
    By {
        /// The key.
        key: String,
        /// The keys that both vary.
        known: String,
    },
    /// It has no meaning for reports.
    #[error(
        "{0}: two reports have no keys and no intervals\n  fix: leave it out, or name directories of sweeps"
    )]
    OfSweeps(&'static str),
    /// The sweeps have no values in common.
    #[error("{} and {}: no combination of values occurs in both sweeps\n  fix: compare sweeps that vary the same keys", .0.shown(), .1.shown())]
    Nothing(PathBuf, PathBuf),
    /// The comparison cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError for DiffError {
    fn exit_code(&self) -> u8 {
        match self {
            DiffError::Output(error) if !error.is_input() => FAILED,
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// A comparison, for people and for programs.
struct Comparison {
    text: String,
    json: Value,
    /// Of sweeps, the forest plot.
    plot: Option<String>,
}

/// Compares two sweeps or two reports.
///
/// # Errors
///
/// They cannot be read, or have nothing to compare.
pub fn diff(args: &DiffArgs) -> Result<u8, DiffError> {
    let mut outputs = Outputs::new();
    for path in [&args.a, &args.b] {
        outputs.reads("a report", path);
        outputs.reads_directory("a file of a sweep,", path);
    }
    let json = Json::of(args.json.as_deref(), &mut outputs)?;
    let plot =
        args.plot.as_deref().map(|file| outputs.writes("--plot", file, OutputKind::Picture)).transpose()?;
    let channel = Channel::beside(json.is_out(), args.quiet);
    let is_sweep = |path: &Path| path.is_dir();
    let comparison = match (is_sweep(&args.a), is_sweep(&args.b)) {
        (true, true) => sweeps::compare(&args.a, &args.b, &args.by, args.at_least, channel.paint())?,
        (false, false) if !args.by.is_empty() => return Err(DiffError::OfSweeps("--by")),
        (false, false) if args.plot.is_some() => return Err(DiffError::OfSweeps("--plot")),
        (false, false) => reports::compare(&args.a, &args.b, channel.paint())?,
        _ => return Err(DiffError::Kinds(args.a.clone(), args.b.clone())),
    };
    channel.say(&comparison.text);
    if let (Some(output), Some(plot)) = (plot, &comparison.plot) {
        output.write(plot)?;
    }
    json.write(&comparison.json)?;
    Ok(0)
}

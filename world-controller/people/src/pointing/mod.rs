//! `metamorph point`: which floor tile a tracked person points at (thesis 9), from the samples of a tracker, or how often
//! noise leads to a wrong one.

mod dwell;
mod filter;
mod ray;
mod stream;
mod trial;

use clap::Args;
use dwell::Rule;
use metamorph_console::output::{Json, OutputError, Outputs};
use metamorph_console::terminal::{Channel, failure, print_data};
use metamorph_protocol::time::{Span, SpanError};
use metamorph_scenario::grid::{GridError, Seeds};
use metamorph_sim_bridge::director::steering::LONGEST_LEASE;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_view::control_client::{ClientError, ControlClient};
use ray::Tile;
use serde::Serialize;
use serde_json::Value;
use std::fmt::Write;
use std::io::{self, BufRead, Read as _};
use std::path::PathBuf;
use stream::{LONGEST, Pointed, SampleError, Track};
use thiserror::Error;
use trial::{Setup, Tally, tries};

/// The end of the command's help.
pub const EXAMPLES: &str = "\
Examples:
  tracker | metamorph point                                      a line of JSON for each sample
  tracker | metamorph point --control address --module 3         metamodule 3 goes to each selected tile
  metamorph point --noise 20mm --distance 2m --seeds 0..1000     how often the right tile is selected

A sample is a line of standard input: {\"t\": 0.033, \"head\": [0, 0, 1.7], \"hand\": [0.5, 0.1, 1.3]}, in
seconds and metres, z up, the floor at z = 0. The answer has the tile that is pointed at (its centre is at
0.11 m times its numbers), its charge from 0 to 1, and whether it is selected now; with --control also the
command that was sent, and the answer of the run.

Exit codes:
  0  the input was read to its end, or the tries were made
  1  the program itself failed, or the run cannot be reached
  2  the command line or a sample is wrong; the error names its line, reason and fix";

/// Version of the JSON output.
pub const SCHEMA: u32 = 1;
/// Largest number of tries.
const MAX_TRIES: u64 = 1_000_000;

/// Arguments of `point`.
#[derive(Debug, Args)]
pub struct PointArgs {
    /// Simulate tries with this standard deviation of each tracked coordinate, such as 20mm; default: none,
    /// samples are read from standard input
    #[arg(long, value_name = "LENGTH", value_parser = length)]
    pub noise: Option<f64>,
    /// Distance on the floor from the person to the tile
    #[arg(long, value_name = "LENGTH", value_parser = length, default_value = "2m", requires = "noise")]
    pub distance: f64,
    /// Aim beside the middle of the tile, by at most this share of its edge
    #[arg(long, value_name = "SHARE", value_parser = share, default_value = "0", requires = "noise")]
    pub aside: f64,
    /// Seeds of the tries, one each
    #[arg(long, value_name = "A..B", default_value = "0..1000", requires = "noise")]
    pub seeds: String,
    /// Send a metamodule of a run under control to each tile that is selected; the file holds the second
    /// address that `metamorph run --view --control` prints. Default: none, tiles are only reported
    #[arg(long, value_name = "FILE", requires = "module", conflicts_with = "noise")]
    pub control: Option<PathBuf>,
    /// The metamodule, or the cube, that is sent; default: none, which --control refuses
    #[arg(long, value_name = "N", requires = "control")]
    pub module: Option<u32>,
    /// How long it stays there, such as 60s, at most 600s
    #[arg(long = "for", value_name = "T", default_value = "60s", requires = "control", value_parser = lease)]
    pub lease: Span,
    /// Write the results as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true, requires = "noise")]
    pub json: Option<PathBuf>,
}

fn length(text: &str) -> Result<f64, String> {
    let (number, unit) = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)]
        .into_iter()
        .find_map(|(name, unit)| Some((text.strip_suffix(name)?, unit)))
        .ok_or("write a length with its unit, such as 20mm, 2cm or 1.5m")?;
    let metres = number.parse::<f64>().map_err(|_| "write a length such as 20mm, 2cm or 1.5m")? * unit;
    if (0.0..=100.0).contains(&metres) { Ok(metres) } else { Err("lengths are from 0 to 100 m".to_owned()) }
}

fn lease(text: &str) -> Result<Span, String> {
    let lease: Span = text.parse().map_err(|e: SpanError| e.to_string())?;
    match lease {
        _ if lease > Span::ZERO && lease <= LONGEST_LEASE => Ok(lease),
        _ => Err(format!("leases are above 0 and at most {LONGEST_LEASE}")),
    }
}

fn share(text: &str) -> Result<f64, String> {
    let share = text.parse::<f64>().ok().filter(|share| (0.0..=0.5).contains(share));
    share.ok_or_else(|| "write a number from 0 to 0.5".to_owned())
}

/// Why pointing is not analysed.
#[derive(Debug, Error)]
pub enum PointError {
    /// A line of the input is wrong.
    #[error("standard input, line {0}: {1}")]
    Sample(u64, SampleError),
    /// The input cannot be read.
    #[error("standard input: {0}")]
    Input(#[from] io::Error),
    /// The seeds are wrong.
    #[error(transparent)]
    Seeds(#[from] GridError),
    /// Too many tries.
    #[error("--seeds {0}: {MAX_TRIES} is the maximum\n  fix: take fewer seeds")]
    TooMany(Seeds),
    /// The run cannot be commanded.
    #[error(transparent)]
    Control(#[from] ClientError),
    /// An output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError for PointError {
    fn exit_code(&self) -> u8 {
        match self {
            PointError::Output(error) => error.exit_code(),
            PointError::Control(ClientError::Unreachable(_) | ClientError::System(_)) => FAILED,
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// The tries of one way of selecting.
#[derive(Debug, Serialize)]
struct Row {
    name: &'static str,
    #[serde(flatten)]
    tally: Tally,
}

#[derive(Debug, Serialize)]
struct Answer {
    schema: u32,
    version: &'static str,
    #[serde(flatten)]
    setup: Setup,
    rows: Vec<Row>,
}

/// Reads samples, or makes tries.
///
/// # Errors
/// If a sample or an option is wrong, or an output cannot be written.
pub fn point(args: &PointArgs) -> Result<(), PointError> {
    let Some(noise) = args.noise else {
        let messenger = match (&args.control, args.module) {
            (Some(path), Some(module)) => {
                Some(Messenger { client: ControlClient::open(path)?, module, lease: args.lease })
            }
            _ => None,
        };
        return follow(&mut io::stdin().lock(), messenger);
    };
    let seeds = Seeds::parse(&args.seeds)?;
    if seeds.len() > MAX_TRIES {
        return Err(PointError::TooMany(seeds));
    }
    let json = Json::of(args.json.as_deref(), &mut Outputs::new())?;
    let setup = Setup { noise_m: noise, distance_m: args.distance, aside_tiles: args.aside };
    let ways = [
        ("two seconds without a break, no filter", Rule::Strict, false),
        ("two seconds without a break (thesis 9.2)", Rule::Strict, true),
        ("charge", Rule::Charge, true),
    ];
    let rows = ways.map(|(name, rule, filtered)| Row {
        name,
        tally: tries(&setup, rule, filtered, seeds.from..seeds.until),
    });
    let answer =
        Answer { schema: SCHEMA, version: metamorph_text::version::version(), setup, rows: rows.into() };
    Channel::beside(json.is_out(), false).say(&text(&answer));
    Ok(json.write(&answer)?)
}

/// Sends one module of a run to tiles.
struct Messenger {
    client: ControlClient,
    module: u32,
    lease: Span,
}

/// The command that a selected tile led to.
#[derive(Debug, Serialize)]
struct Commanded {
    command: String,
    /// The answer of the run.
    answer: Value,
}

impl Messenger {
    fn send(&mut self, [x, y]: Tile) -> Result<Commanded, ClientError> {
        let command = format!("goto {} [{x}, {y}, 0] for {}", self.module, self.lease);
        let answer = self.client.command(std::slice::from_ref(&command))?;
        Ok(Commanded { command, answer })
    }
}

/// The answer to a sample.
#[derive(Debug, Serialize)]
struct Answered {
    #[serde(flatten)]
    pointed: Pointed,
    /// Only in a sample that selects a tile, under control.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    commanded: Option<Commanded>,
}

/// Answers each sample, and sends the module to each tile that is selected.
fn follow(input: &mut impl BufRead, mut messenger: Option<Messenger>) -> Result<(), PointError> {
    let mut track = Track::default();
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        // A line that is too long is cut, and refused.
        if input.take(LONGEST as u64 + 2).read_until(b'\n', &mut line)? == 0 || failure().is_some() {
            break;
        }
        let pointed = track.line(line.trim_ascii()).map_err(|e| PointError::Sample(number, e))?;
        let selected = pointed.tile.filter(|_| pointed.selected);
        let commanded = match (&mut messenger, selected) {
            (Some(messenger), Some(tile)) => Some(messenger.send(tile)?),
            _ => None,
        };
        print_data(&serde_json::to_string(&Answered { pointed, commanded }).map_err(io::Error::from)?);
    }
    Ok(())
}

fn text(answer: &Answer) -> String {
    let Setup { noise_m, distance_m, aside_tiles } = answer.setup;
    let mut text = format!(
        "noise {:.0} mm, tile {distance_m} m away, aimed at most {aside_tiles} of its edge beside its middle; 6 s a try\n\n",
        noise_m * 1e3
    );
    let _ = writeln!(
        text,
        "  {:<42} {:>8} {:>8} {:>8} {:>10}",
        "selected by", "right", "wrong", "none", "median"
    );
    for Row { name, tally } in &answer.rows {
        let share = |count: u64| format!("{:.1} %", count as f64 * 100.0 / tally.tries as f64);
        let median = tally.median_s.map_or_else(|| "-".to_owned(), |s| format!("{s:.2} s"));
        let none = tally.tries - tally.right - tally.wrong;
        let _ = writeln!(
            text,
            "  {name:<42} {:>8} {:>8} {:>8} {median:>10}",
            share(tally.right),
            share(tally.wrong),
            share(none)
        );
    }
    text
}

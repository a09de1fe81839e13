//! Plots of `render`: of the directory of a sweep, or of a report.

use crate::render::RenderArgs;
use clap::ValueEnum;
use maud::Markup;
use metamorph_console::output::{OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::{Channel, print_data};
use metamorph_experiments::sweep::plot::{self, Quantity};
use metamorph_experiments::sweep::summary::Summary;
use metamorph_module_agent::regular_file;
use metamorph_protocol::counters::Class;
use metamorph_report::plot_file;
use metamorph_report::plots::{Row, bars};
use metamorph_scenario::quote;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED, Failure};
use metamorph_text::escape::{Shown, portable};
use metamorph_text::program;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The file of a sweep that is plotted.
const SUMMARY: &str = "summary.json";
/// The largest file that is read, in bytes.
const MOST: u64 = 256 << 20;

/// Errors of plots.
#[derive(Debug, Error)]
enum PlotError {
    #[error("{}: {reason}\n  fix: name a directory that `metamorph sweep --out` wrote, or a file that `metamorph run --json` wrote", .file.shown())]
    Unreadable { file: PathBuf, reason: String },
    #[error(
        "--plot {0}: a report has one plot, messages\n  fix: leave it out, or name the directory of a sweep"
    )]
    OfReport(String),
    #[error("--plot {0}: no run was built\n  fix: plot `built`")]
    Nothing(String),
    #[error("--out {}: a plot is an SVG\n  fix: name a file that ends in .svg", .0.shown())]
    Format(PathBuf),
    #[error("standard output is a terminal\n  fix: name a file with --out or --table, or redirect it")]
    Terminal,
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError for PlotError {
    fn exit_code(&self) -> u8 {
        match self {
            PlotError::Output(error) if !error.is_input() => FAILED,
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// A plot, what it shows, and the table behind it.
struct Plotted {
    plot: Markup,
    about: String,
    name: String,
    table: Vec<Vec<String>>,
}

/// Returns true if a path is the directory of a sweep or the file of a report.
pub fn is_plotted(path: &Path) -> bool {
    path.join(SUMMARY).is_file() || path.extension().is_some_and(|extension| extension == "json")
}

fn read<T: DeserializeOwned>(file: &Path) -> Result<T, PlotError> {
    let unreadable = |reason: String| PlotError::Unreadable { file: file.to_owned(), reason };
    let bytes = regular_file::read(file, MOST).map_err(|error| unreadable(error.to_string()))?;
    serde_json::from_slice(&bytes).map_err(|error| unreadable(error.to_string()))
}

fn name(quantity: Quantity) -> String {
    quantity.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

fn of_sweep(file: &Path, quantity: Quantity) -> Result<Plotted, PlotError> {
    let summary: Summary = read(&file.join(SUMMARY))?;
    let about = format!("{}: {}, seeds {}", summary.scenario, quantity.about(), summary.seeds);
    let (plot, table) = (plot::plot(&summary, quantity), plot::table(&summary, quantity));
    Ok(Plotted { plot, about, name: name(quantity), table })
}

/// Plots the messages of a report by class.
fn of_report(file: &Path) -> Result<Plotted, PlotError> {
    let report: Value = read(file)?;
    let unreadable =
        || PlotError::Unreadable { file: file.to_owned(), reason: "this is no report".to_owned() };
    let classes = report["messages"]["by_class"].as_object().ok_or_else(unreadable)?;
    let mut table = vec![["class", "sent", "delivered", "lost"].map(str::to_owned).to_vec()];
    let mut rows = Vec::new();
    for class in Class::ALL {
        let count =
            |key: &str| classes.get(class.name()).and_then(|counts| counts[key].as_u64()).unwrap_or(0);
        let value = Some(count("sent") as f64);
        rows.push(Row { label: class.name().to_owned(), begins: false, value });
        let counts = ["sent", "delivered", "lost"].map(|key| count(key).to_string());
        table.push([vec![class.name().to_owned()], counts.to_vec()].concat());
    }
    let scenario = report["scenario"].as_str().unwrap_or_default();
    let about = format!("{scenario}, seed {}: messages sent by class", report["seed"]);
    Ok(Plotted { plot: bars(&rows, &about), about, name: name(Quantity::Messages), table })
}

fn csv(table: &[Vec<String>]) -> Vec<u8> {
    let mut out = csv::Writer::from_writer(Vec::new());
    let written = table.iter().try_for_each(|row| out.write_record(row));
    written
        .ok()
        .and_then(|()| out.into_inner().ok())
        .expect("invariant: rows of one length are written to memory")
}

/// Draws the plot of a sweep or of a report.
pub fn render(args: &RenderArgs) -> Result<u8, Failure> {
    Ok(write(args)?)
}

fn write(args: &RenderArgs) -> Result<u8, PlotError> {
    let mut outputs = Outputs::new();
    if args.file.is_dir() {
        outputs.reads_directory("a file of the sweep,", &args.file);
    } else {
        outputs.reads("the report", &args.file);
    }
    let table =
        args.table.as_deref().map(|file| outputs.writes("--table", file, OutputKind::Csv)).transpose()?;
    let out =
        args.out.as_deref().map(|file| outputs.writes("--out", file, OutputKind::Picture)).transpose()?;
    if let Some(file) = args.out.as_ref().filter(|file| file.extension().is_none_or(|e| e != "svg")) {
        return Err(PlotError::Format(file.clone()));
    }
    if out.is_none() && table.is_none() && std::io::stdout().is_terminal() {
        return Err(PlotError::Terminal);
    }
    let plotted = match (args.file.is_dir(), args.plot) {
        (true, quantity) => of_sweep(&args.file, quantity.unwrap_or(Quantity::Built))?,
        (false, None | Some(Quantity::Messages)) => of_report(&args.file)?,
        (false, Some(quantity)) => return Err(PlotError::OfReport(name(quantity))),
    };
    let command = format!(
        "{} render {} --plot {}",
        quote(program::name().to_owned()),
        portable(&args.file),
        plotted.name
    );
    let about = format!("{}. Made by metamorph {}: {command}", plotted.about, env!("CARGO_PKG_VERSION"));
    let svg = plot_file::file(plotted.plot, &about).ok_or(PlotError::Nothing(plotted.name))?;
    if let Some(table) = &table {
        table.write(csv(&plotted.table))?;
    }
    match &out {
        Some(out) => out.write(svg)?,
        None if table.is_none() => print_data(&svg),
        None => {}
    }
    let files: Vec<String> =
        [&args.out, &args.table].into_iter().flatten().map(|file| file.shown().to_string()).collect();
    if !files.is_empty() {
        Channel::beside(false, args.quiet).say(&format!("{}: {}\n", files.join(", "), plotted.about));
    }
    Ok(0)
}

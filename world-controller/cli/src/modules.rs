//! `metamorph shape --modules`: the modules that cells become, and what to change where that is impossible.

use crate::shape::{RepairArg, ShapeArgs, ShapeError, describe, read};
use metamorph_console::output::{Json, OutputError, Outputs};
use metamorph_console::terminal::Channel;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::MAX_SEEDS;
use metamorph_protocol::pairing::pins::Pin;
use metamorph_protocol::pairing::repair::{Allowed, Change, Cheapest};
use metamorph_protocol::pairing::{Colours, Pairing, PairingError};
use metamorph_shapes::analysis::Analysis;
use metamorph_shapes::drawing;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::{Shown as _, portable};
use metamorph_text::format::{count, many};
use serde::Serialize;
use std::fmt::{Display, Write};
use thiserror::Error;

/// Exit code: the cells do not pair up.
const NOT_PAIRED: u8 = 3;
/// The version of the JSON output.
pub const SCHEMA: u32 = 1;
/// Cells, changes or reasons that a line of text lists at most. JSON has all.
const LISTED: usize = 12;

/// Why cells are not analysed.
#[derive(Debug, Error)]
pub enum ModulesError {
    /// The file or its conversion.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// The cells are no structure.
    #[error("{file}: {error}\n  fix: {}", fix(.error))]
    Pairing {
        /// The file.
        file: String,
        /// The reason.
        error: PairingError,
    },
    /// An output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

fn fix(error: &PairingError) -> &'static str {
    match error {
        PairingError::Empty => "draw a cell",
        PairingError::TooMany(_) => "choose a larger pitch, or name fewer cells",
        PairingError::OutOfRange(_) => "move it towards the origin",
        PairingError::PinWithoutCell { .. } | PairingError::PinApart(_) | PairingError::PinnedTwice(_) => {
            "remove the pin"
        }
        PairingError::Disconnected { .. } => "join the parts, or analyse each in a file of its own",
    }
}

impl CommandError for ModulesError {
    fn exit_code(&self) -> u8 {
        match self {
            ModulesError::Shape(error) => error.exit_code(),
            ModulesError::Output(error) => error.exit_code(),
            ModulesError::Pairing { .. } => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        match self {
            ModulesError::Shape(error) => error.text(),
            _ => format!("metamorph: {self}"),
        }
    }
}

/// The answer, as JSON. Cells are `[x, y, z]`.
#[derive(Debug, Serialize)]
struct Answer {
    schema: u32,
    version: &'static str,
    file: String,
    cells: Vec<Cell>,
    #[serde(flatten)]
    analysis: Analysis,
}

/// Analyses the cells of a file, prints the answer, and returns the exit code.
pub fn modules(args: &ShapeArgs) -> Result<u8, ModulesError> {
    let mut outputs = Outputs::new();
    outputs.reads("the file", &args.file);
    let written = args.write.as_ref().map(|path| outputs.creates("--write", path)).transpose()?;
    let json = Json::of(args.json.as_deref(), &mut outputs)?;
    let (_, imported) = read(args)?;
    if let Some(thin) = imported.thin.clone().filter(|_| !args.drop_thin) {
        return Err(ShapeError::Solid(thin).into());
    }
    let pairing = Pairing::pinned(&imported.cells, &imported.pins)
        .map_err(|error| ModulesError::Pairing { file: args.file.shown(), error })?;
    let allowed = match args.repair {
        RepairArg::Add => Allowed::Add,
        RepairArg::Remove => Allowed::Remove,
        RepairArg::Any => Allowed::Any,
    };
    let answer = Answer {
        schema: SCHEMA,
        version: metamorph_text::version::version(),
        file: args.file.shown(),
        cells: pairing.cells().collect(),
        analysis: Analysis::of(&pairing, Some(allowed), args.split, &|| true),
    };
    json.write(&answer)?;
    let mut shown = String::new();
    describe(&mut shown, &args.file, &imported);
    text(&mut shown, &answer.analysis);
    if let (Some(path), Some(file)) = (&args.write, written) {
        let first = answer.analysis.repairs.first();
        if answer.analysis.d == 0 || first.is_some() {
            let cells = first.map_or_else(|| imported.cells.clone(), |r| r.apply(pairing.cells()));
            let name = args.file.file_stem().map(|n| n.to_string_lossy().into_owned());
            file.write(drawing::text(&portable(&args.file), name.as_deref(), &cells, &imported.pins))?;
            let what = if first.is_some() { "repair 1 is" } else { "the cells are" };
            let _ = writeln!(shown, "\n{what} written to {}", path.shown());
        }
    }
    Channel::beside(json.is_out(), false).say(&shown);
    Ok(if answer.analysis.d == 0 { 0 } else { NOT_PAIRED })
}

fn text(out: &mut String, answer: &Analysis) {
    let Colours { even, odd } = answer.colours;
    let _ = writeln!(out, "  colours   {} even, {} odd (x + y + z)", count(even as u64), count(odd as u64));
    let _ = writeln!(out, "  modules   {}", count(answer.pairs.len() as u64));
    if let pins @ 1.. = answer.pins.len() {
        let _ = writeln!(out, "  pins      {}", count(pins as u64));
    }
    if answer.d == 0 {
        let _ = writeln!(out, "  every cell has a partner: it can be built of modules");
    } else {
        let _ = writeln!(out, "  cannot be built of modules: {} left over", many(answer.d as u64, "cell"));
        for reason in answer.reasons.iter().take(LISTED) {
            let (cells, near) = (&reason.cells, &reason.neighbours);
            let _ = match (cells.len(), near.len()) {
                (1, 0) if reason.pins.is_empty() => {
                    writeln!(out, "    the cell {} touches no other", cells[0])
                }
                (1, 0) => writeln!(out, "    the cell {} touches only pinned cells", cells[0]),
                (n, m) => writeln!(
                    out,
                    "    these {n} cells touch only {}{}: {}\n      cells  {}",
                    if m == 1 { "this one".to_owned() } else { format!("these {m}") },
                    if reason.pins.is_empty() { "" } else { " that are not pinned" },
                    listed(near.iter()),
                    listed(cells.iter()),
                ),
            };
            if !reason.pins.is_empty() {
                let _ = writeln!(out, "      pins   {}", listed(named(&reason.pins).iter()));
            }
        }
        more(out, answer.reasons.len(), "reason");
        if !answer.costly_pins.is_empty() {
            let pins = listed(named(&answer.costly_pins).iter());
            let subject =
                if answer.costly_pins.len() == 1 { "this pin forbids" } else { "these pins forbid" };
            let _ = match answer.d_without_pins {
                0 => writeln!(out, "  {subject} that every cell has a partner: {pins}"),
                d => writeln!(
                    out,
                    "  {subject} that fewer are left over, {} without: {pins}",
                    many(d as u64, "cell")
                ),
            };
        }
        let _ = writeln!(out, "  repairs");
        for (i, repair) in answer.repairs.iter().enumerate() {
            let of = |removes| {
                repair.changes.iter().filter(move |c| c.removes() == removes).map(|c: &Change| c.cell())
            };
            let part = |verb: &str, cells: Vec<Cell>| {
                (!cells.is_empty()).then(|| format!("{verb} {}", listed(cells.iter())))
            };
            let parts = [part("add", of(false).collect()), part("remove", of(true).collect())];
            let proof = match repair.cheapest {
                Cheapest::Proven => "the least",
                Cheapest::Heuristic => "not proven least",
            };
            let changes = parts.into_iter().flatten().collect::<Vec<_>>().join("; ");
            let _ = writeln!(out, "    {}  {changes}  (cost {}, {proof})", i + 1, repair.cost);
        }
        if answer.repairs.is_empty() {
            let _ = writeln!(
                out,
                "    none of this kind: {}",
                if answer.pins.is_empty() {
                    "a single cell is not removed"
                } else {
                    "all of them would break a pin"
                }
            );
        }
    }
    let splits = answer.split.iter().flat_map(|s| [("chains", &s.free), ("standing", &s.standing)]);
    for (what, split) in splits {
        let _ = write!(out, "  {what:<9} {}", split.answer);
        if let Some(reason) = &split.reason {
            let _ = write!(out, ": {reason}");
        } else {
            let _ = write!(out, ": {} of four cells", many(split.chains.len() as u64, "chain"));
            if what == "standing" && split.chains.len() > MAX_SEEDS {
                let _ = write!(out, "; a goal of metamodules has {MAX_SEEDS} seeds at most");
            }
        }
        out.push('\n');
    }
}

/// Puts pins into words.
fn named(pins: &[Pin]) -> Vec<String> {
    pins.iter().map(|[a, b]| format!("{a}-{b}")).collect()
}

fn listed<'a, T: Display + 'a>(cells: impl ExactSizeIterator<Item = &'a T>) -> String {
    let hidden = cells.len().saturating_sub(LISTED);
    let mut shown: Vec<String> = cells.take(LISTED).map(T::to_string).collect();
    if hidden > 0 {
        shown.push(format!("and {} more", count(hidden as u64)));
    }
    shown.join(" ")
}

fn more(out: &mut String, all: usize, noun: &str) {
    if let hidden @ 1.. = all.saturating_sub(LISTED) {
        let _ = writeln!(out, "    and {} (--json has all)", many(hidden as u64, noun));
    }
}

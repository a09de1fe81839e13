//! `metamorph shape`: shows the cells of a file, reports what of them cannot be built, and writes a scenario
//! that builds them.

use crate::modules::modules;
use clap::{Args, ValueEnum};
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::output::{OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::print_out;
use metamorph_processes::family::families;
use metamorph_processes::family::sources;
use metamorph_protocol::goal::{Goal, Growth};
use metamorph_protocol::lattice::Cell;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::family::Families;
use metamorph_scenario::{LinkKind, Overrides, read_text};
use metamorph_shapes::error::SolidError;
use metamorph_shapes::preview::{self, Written};
use metamorph_shapes::printability::{corners, printability};
use metamorph_shapes::{Format, Import, Imported, Part, Up, import, pitch_for};
use metamorph_text::command_error::Failure;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::{Shown as _, portable};
use metamorph_text::format::{count, many};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Default length of the longest side in cells.
const CELLS: u16 = 16;

/// Arguments of `shape`.
#[derive(Debug, Args)]
pub struct ShapeArgs {
    /// A solid (.stl, .obj), a scene of MagicaVoxel (.vox), a configuration of VisibleSim (.xml), or a drawing (.toml)
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The edge of a cell in the units of the file; default: as --cells says
    #[arg(long, value_name = "P", conflicts_with = "cells")]
    pub pitch: Option<f64>,
    /// Length of the longest side in cells, instead of --pitch; default: 16
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub cells: Option<u16>,
    /// Which axis of the file points up; default: z
    #[arg(long, value_enum)]
    pub up: Option<UpArg>,
    /// Position of the centre of the lowest layer; of a file made of cells, its origin. Default: 0,0,0
    #[arg(long, value_name = "X,Y,Z", value_parser = cell, allow_hyphen_values = true)]
    pub at: Option<Cell>,
    /// The part of a configuration to show; default: targets
    #[arg(long, value_enum)]
    pub part: Option<PartArg>,
    /// Accept the loss of parts that are thinner than a cell
    #[arg(long)]
    pub drop_thin: bool,
    /// Fill inner voids
    #[arg(long)]
    pub fill_voids: bool,
    /// The growth of the goal
    #[arg(long, value_enum, default_value_t = GrowthArg::Solid)]
    pub growth: GrowthArg,
    /// Write a picture to this file
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
    /// Write a scenario that builds it to this file, which must not exist; with --modules, write a drawing, with the
    /// first repair if it needs one
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// Pair the cells to Roombots modules of two, and say what to change where that is impossible
    #[arg(long, conflicts_with = "svg")]
    pub modules: bool,
    /// With --modules: what repairs may do
    #[arg(long, value_enum, requires = "modules", default_value_t = RepairArg::Add)]
    pub repair: RepairArg,
    /// With --modules: split the cells into metamodules, chains of four
    #[arg(long, requires = "modules")]
    pub split: bool,
    /// With --modules: write the answer as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true, requires = "modules")]
    pub json: Option<PathBuf>,
}

/// What repairs may do, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RepairArg {
    /// Add cells
    Add,
    /// Remove cells
    Remove,
    /// Both
    Any,
}

/// The axis that points up, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum UpArg {
    /// z, as in scenarios
    Z,
    /// y
    Y,
}

/// A part of a configuration, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PartArg {
    /// The modules at the start
    Blocks,
    /// The cells to be filled
    Targets,
}

/// How a goal grows, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GrowthArg {
    /// All cells
    Solid,
    /// Corners and edges, with tunnels in between
    Scaffold,
}

/// Why a shape cannot be shown.
#[derive(Debug, Error)]
pub enum ShapeError {
    /// The file.
    #[error("{0}\n  fix: {fix}", fix = .0.fix())]
    Solid(#[from] SolidError),
    /// The scenario would be invalid.
    #[error("the scenario was not written, because it could not be run:\n{0}")]
    Scenario(Diagnostics),
    /// A file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError for ShapeError {
    fn exit_code(&self) -> u8 {
        match self {
            ShapeError::Output(error) => error.exit_code(),
            ShapeError::Solid(_) | ShapeError::Scenario(_) => BAD_USAGE,
        }
    }
}

/// The result of the command.
pub struct Shown {
    /// Text for people.
    pub text: String,
    /// True if all of it can be built.
    pub buildable: bool,
}

fn cell(text: &str) -> Result<Cell, String> {
    let wrong = || format!("expected three whole numbers such as 0,0,2, each from -{0} to {0}", Cell::LIMIT);
    let numbers: Option<Vec<i16>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    let cell = <[i16; 3]>::try_from(numbers.unwrap_or_default()).map(Cell::from).map_err(|_| wrong())?;
    if cell.in_range() { Ok(cell) } else { Err(wrong()) }
}

/// Reads the file as the arguments say.
pub fn read(args: &ShapeArgs) -> Result<(Import, Imported), ShapeError> {
    let format = Format::of(&args.file)?;
    let mut how = Import {
        pitch: args.pitch,
        up: args.up.map(|up| if up == UpArg::Y { Up::Y } else { Up::Z }),
        at: args.at.unwrap_or_default(),
        part: args.part.map(|part| if part == PartArg::Blocks { Part::Blocks } else { Part::Targets }),
        drop_thin: args.drop_thin,
        fill_voids: args.fill_voids,
    };
    if format.is_mesh() && how.pitch.is_none() {
        how.pitch = Some(pitch_for(sources(), &args.file, args.cells.unwrap_or(CELLS))?);
    }
    let imported = import(sources(), &args.file, &how)?;
    Ok((how, imported))
}

/// Reads and checks the file, and writes the requested output.
pub fn shape(args: &ShapeArgs, families: Families) -> Result<Shown, ShapeError> {
    let mut outputs = Outputs::new();
    outputs.reads("the file", &args.file);
    let svg = args.svg.as_ref().map(|path| outputs.writes("--svg", path, OutputKind::Picture)).transpose()?;
    let written = args.write.as_ref().map(|path| outputs.creates("--write", path)).transpose()?;
    let growth = match args.growth {
        GrowthArg::Solid => Growth::Solid,
        GrowthArg::Scaffold => Growth::Scaffold,
    };
    let (how, imported) = read(args)?;
    let mut text = String::new();
    describe(&mut text, &args.file, &imported);
    let mut buildable = true;
    if let Some(thin) = &imported.thin {
        buildable &= args.drop_thin;
        let verdict = if args.drop_thin { "left out" } else { "cannot be built" };
        let _ = writeln!(text, "  {verdict}: {thin}");
        if !args.drop_thin {
            let _ =
                writeln!(text, "  fix: {}", thin.fix().replace("write `thin = \"drop\"`", "add --drop-thin"));
        }
    }
    let seed = middle(&imported.cells);
    for finding in printability(&imported.cells, seed, growth) {
        buildable &= !finding.forbids();
        let verdict = if finding.forbids() { "cannot be built" } else { "note" };
        let _ = writeln!(text, "  {verdict}: {finding}");
    }
    if let (Growth::Scaffold, Ok(goal)) = (growth, Goal::compile(&imported.cells, seed, growth)) {
        let _ = writeln!(text, "  scaffold  {} of them are filled", count(goal.len() as u64));
    }
    if buildable {
        let _ = writeln!(text, "  can be built as far as can be said before a run");
    }
    match preview::layers(&imported.cells) {
        Some(layers) => {
            let _ = write!(text, "\n{layers}");
        }
        None => {
            let _ = writeln!(text, "\n  too large to be shown as text; --svg FILE draws it");
        }
    }
    if let (Some(path), Some(file)) = (&args.svg, svg) {
        file.write(preview::svg(&imported.cells))?;
        let _ = writeln!(text, "\ndrawn to {}", path.shown());
    }
    if let (Some(path), Some(file), true) = (&args.write, written, buildable) {
        file.write(scenario(path, args, &how, &imported, growth, families)?)?;
        let _ = writeln!(text, "\nwritten to {0}; run it with metamorph run {0} --link sim", path.shown());
    }
    Ok(Shown { text, buildable })
}

/// Describes the file and its cells.
pub fn describe(text: &mut String, file: &Path, Imported { cells, mesh, notes, .. }: &Imported) {
    let _ = writeln!(text, "{}", file.shown());
    if let Some(mesh) = mesh {
        let [x, y, z] = mesh.size.map(|s| s as f32);
        let _ = writeln!(text, "  mesh      {}, {x} x {y} x {z}", many(mesh.triangles as u64, "triangle"));
        let _ = writeln!(text, "  pitch     {}", mesh.pitch);
    }
    let (min, max) = corners(cells).unwrap_or_default();
    let _ = writeln!(text, "  cells     {}, from {min} to {max}", count(cells.len() as u64));
    for note in notes {
        let _ = writeln!(text, "  note: {note}");
    }
}

/// Returns the cell nearest to the centre of the bounding box.
fn middle(cells: &[Cell]) -> Cell {
    let (min, max) = corners(cells).unwrap_or_default();
    let twice = |c: i16, low: i16, high: i16| (2 * i64::from(c) - i64::from(low) - i64::from(high)).pow(2);
    let distance = |c: &Cell| twice(c.x, min.x, max.x) + twice(c.y, min.y, max.y) + twice(c.z, min.z, max.z);
    cells.iter().copied().min_by_key(|c| (distance(c), *c)).unwrap_or_default()
}

/// Returns the text of a scenario that builds an imported shape.
fn scenario(
    path: &Path,
    args: &ShapeArgs,
    how: &Import,
    imported: &Imported,
    growth: Growth,
    families: Families,
) -> Result<String, ShapeError> {
    let part =
        |part| import(sources(), &args.file, &Import { part: Some(part), ..how.clone() }).map(|i| i.cells);
    let (start, goal) = if Format::of(&args.file)? != Format::VisibleSim {
        (preview::start(&imported.cells), imported.cells.clone())
    } else {
        (part(Part::Blocks)?, part(Part::Targets)?)
    };
    let name = args.file.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let origin = format!("shape` from {}", portable(&args.file));
    let text =
        preview::scenario(&Written { origin: &origin, name: &name, start: &start, goal: &goal, growth });
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    read_text(families, &path.display().to_string(), &text, &overrides).map_err(ShapeError::Scenario)?;
    Ok(text)
}

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph shape deploy/shapes/table.obj --pitch 10
  metamorph shape deploy/shapes/rabbit.stl --cells 14 --svg rabbit.svg --write rabbit.toml
  metamorph shape config.xml --part blocks
  metamorph shape config.xml --write case.toml
  metamorph shape deploy/shapes/chair.toml --modules --split
  metamorph shape deploy/shapes/chair.toml --modules --repair any --write repaired.toml

A cell is filled if its centre is inside the solid. In a scenario, the same goal is
    shape = { file = { path = \"rabbit.stl\", pitch = 10 } }
The written scenario lists the cells themselves and does not need the file. Its modules start in a
slab below the goal, or at the places of the configuration.

A drawing is a TOML file with `version = 1` and `cells = [[0, 0, 0], [1, 0, 0]]`. With --modules, cells that
share a face become modules of two; repairs are the fewest changes after which every cell has a partner.

Exit codes:
  0  no obstacle to building it was found before a run
  1  a file could not be written
  2  the command line or the file is wrong, or something cannot be built; every error names its
     place, reason and fix
  3  with --modules: cells stay without a partner; the answer says which, and what to change";

fn execute(args: &ShapeArgs) -> Result<u8, Failure> {
    if args.modules {
        return Ok(modules(args)?);
    }
    let shown = shape(args, families())?;
    print_out(&shown.text);
    Ok(if shown.buildable { 0 } else { BAD_USAGE })
}

/// The command.
pub static COMMAND: CommandOf<ShapeArgs> = CommandOf {
    name: "shape",
    group: Some(Group::Look),
    about: "Convert a solid to cells, write it as a scenario, or pair the cells to modules",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| execute(&args),
};

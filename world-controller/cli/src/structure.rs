//! `metamorph structure`: body and limbs of a structure, its articulations, and its networks of oscillators.

mod text;

use clap::{Args, ValueEnum};
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::output::{Json, OutputError, Outputs};
use metamorph_console::terminal::Channel;
use metamorph_free_modules::plan::PlanError;
use metamorph_free_modules::plan::connected::{Connected, connected};
use metamorph_free_modules::plan::input::read_structure_file;
use metamorph_free_modules::structure::Answer;
use metamorph_processes::family::sources;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::{Morphology, NetworkKind};
use metamorph_protocol::free_module::structure::Structure;
use metamorph_protocol::ids::ModuleId;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::Shown;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The end of the command's help.
const EXAMPLES: &str = "\
Examples:
  metamorph structure quad5-sym            body, limbs, roles and networks
  metamorph structure deploy/structures/struct10.json --network fo
  metamorph structure quad5-sym --dead 0   the same with the joints of module 0 locked
  metamorph structure quad5-sym --json - | jq .networks

A structure is a file, or one of quad5-sym, quad5-unsym, struct10, quad9 and tripod4.
`metamorph schema structure` describes files. Joints are written MODULE.q1 to q3; in JSON they are
numbers: 3 * module + 0, 1 or 2.

Exit codes:
  0  the structure was analysed
  1  the program itself failed, for example because a file could not be written
  2  the command line or the file is wrong; the error names its place, reason and fix
  3  no joint can move: all modules are dead";

/// Exit code: there is no network, since no joint moves.
const INFEASIBLE: u8 = 3;

/// Arguments of `structure`.
#[derive(Debug, Args)]
pub struct StructureArgs {
    /// A structure file, or the name of a structure
    #[arg(value_name = "FILE|NAME")]
    pub structure: String,
    /// List the couplings of this network
    #[arg(long, value_enum, default_value_t = NetworkArg::BlfSym)]
    pub network: NetworkArg,
    /// Modules whose joints do not move, such as 0,3; default: none
    #[arg(long, value_name = "MODULES", value_delimiter = ',')]
    pub dead: Vec<u32>,
    /// Write the answer as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// A network, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NetworkArg {
    /// An oscillator per joint
    Fo,
    /// An oscillator per articulation
    Blf,
    /// An oscillator per articulation; symmetric limbs share amplitude and offset
    BlfSym,
    /// An oscillator per joint; symmetric limbs share amplitude and offset
    Sym,
}

impl From<NetworkArg> for NetworkKind {
    fn from(arg: NetworkArg) -> NetworkKind {
        match arg {
            NetworkArg::Fo => NetworkKind::Fo,
            NetworkArg::Blf => NetworkKind::Blf,
            NetworkArg::BlfSym => NetworkKind::BlfSym,
            NetworkArg::Sym => NetworkKind::Sym,
        }
    }
}

/// Why a structure is not analysed.
#[derive(Debug, Error)]
pub enum StructureCommandError {
    /// The argument is neither a name nor a file that can be read.
    #[error(
        "structure {argument}: it is not the name of a structure, and no file that can be read: {error}\n  fix: name a \
         file, or {}", named::NAMES.join(", ")
    )]
    Unknown {
        /// The argument.
        argument: String,
        /// Why there is no file.
        error: std::io::Error,
    },
    /// The file is wrong.
    #[error(transparent)]
    File(#[from] PlanError),
    /// A dead module is not there.
    #[error("--dead {module}: the structure has no module {module}\n  fix: modules are numbered 0 to {last}")]
    NoModule {
        /// The number.
        module: u32,
        /// The largest one.
        last: u32,
    },
    /// An output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// No joint moves.
    #[error(
        "structure {argument}: no joint moves, since all modules are dead\n  fix: name fewer modules with --dead"
    )]
    Infeasible {
        /// The structure.
        argument: String,
    },
}

impl CommandError for StructureCommandError {
    fn exit_code(&self) -> u8 {
        match self {
            StructureCommandError::File(error) => error.exit_code(),
            StructureCommandError::Output(error) => error.exit_code(),
            StructureCommandError::Infeasible { .. } => INFEASIBLE,
            StructureCommandError::Unknown { .. } | StructureCommandError::NoModule { .. } => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// Analyses a structure, prints it, and returns the exit code.
pub fn structure(args: &StructureArgs) -> Result<u8, StructureCommandError> {
    let mut outputs = Outputs::new();
    if named::structure(&args.structure).is_none() {
        outputs.reads("the structure", args.structure.as_ref());
    }
    let json = Json::of(args.json.as_deref(), &mut outputs)?;
    let (mut read, passive) = read_with_dead(&args.structure, &args.dead)?;
    read.structure = passive;
    let answer = Answer::of(&args.structure.shown(), &read, args.network.into())
        .map_err(|_| StructureCommandError::Infeasible { argument: args.structure.shown() })?;
    json.write(&answer)?;
    let channel = Channel::beside(json.is_out(), args.quiet);
    channel.say(&text::text(&answer, channel.paint()));
    Ok(0)
}

/// Reads a structure by its name, or a file. Returns it, and the same with the joints of dead modules locked.
///
/// # Errors
/// Refuses dead modules that are not there, besides what is wrong with the structure.
pub fn read_with_dead(argument: &str, dead: &[u32]) -> Result<(Connected, Structure), StructureCommandError> {
    let read = read(argument)?;
    let last = read.structure.bound() as u32 - 1;
    let mut passive = read.structure.clone();
    for module in dead {
        if *module > last {
            return Err(StructureCommandError::NoModule { module: *module, last });
        }
        passive.set_passive(ModuleId(*module));
    }
    Ok((read, passive))
}

/// Returns true if a structure has a body, cyclic or linear.
pub fn has_body(structure: &Structure) -> bool {
    Morphology::of(structure).partition.has_body()
}

/// Reads a structure by its name, or a file.
fn read(argument: &str) -> Result<Connected, StructureCommandError> {
    if let Some(structure) = named::structure(argument) {
        return Ok(Connected { structure, joints_deg: None });
    }
    let place = format!("structure {}", argument.shown());
    match read_structure_file(sources(), &place, Path::new(argument)) {
        Err(PlanError::Read { error, .. }) => {
            Err(StructureCommandError::Unknown { argument: argument.shown(), error })
        }
        file => Ok(connected(&place, &file?)?),
    }
}

/// The command.
pub static COMMAND: CommandOf<StructureArgs> = CommandOf {
    name: "structure",
    group: Some(Group::Study),
    about: "Find body and limbs of a structure, and its networks of oscillators",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| Ok(structure(&args)?),
};

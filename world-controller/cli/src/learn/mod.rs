//! `metamorph learn`: learns a gait of a structure in simulation, with bodies.
//!
//! `progress` has the runs over all seeds, and `text` what is printed; learners, trials and gait files are in
//! [`gait`](metamorph_free_modules::gait).
//!
//! *Invariant.* A gait file depends on the structure, the options and the engine only: not on the number of threads, the
//! machine, or interruptions.

mod progress;
mod text;

use crate::structure::{self, NetworkArg, StructureCommandError};
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Output, OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::terminal::{Channel, Live};
use metamorph_free_modules::gait::ask_tell::Method;
use metamorph_free_modules::gait::document::{FORMAT, GaitFile, StudyPart, VERSION, written};
use metamorph_free_modules::gait::file;
use metamorph_free_modules::gait::space::{Gait, Space};
use metamorph_free_modules::gait::study::{Fitness, Study};
use metamorph_free_modules::plan::PlanError;
use metamorph_processes::family::sources;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, SpanError};
use metamorph_scenario::grid::{GridError, Seeds};
use metamorph_sim_bridge::free_module::physics::{Down, NotADirection, PhysicsError};
use metamorph_sim_bridge::free_module::rapier::ENGINE;
use metamorph_sim_bridge::free_module::trial::TrialSetup;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::{Shown, json};
use metamorph_text::format::digits;
use progress::Runs;
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The end of the command's help.
const EXAMPLES: &str = "\
Examples:
  metamorph learn quad5-sym --write gait.json              120 gaits, each with three frictions
  metamorph learn quad5-sym --trials 40 --trial 15s --fitness thesis
  metamorph learn quad5-sym --write gait.json --resume     go on where a study was ended
  metamorph learn quad5-sym --dead 2 --from gait.json      learn again after a module died
  metamorph learn quad5-sym --seeds 1..21 --network fo --json - | jq .best.fitness_mm_s

A structure is a file, or one of quad5-sym, quad5-unsym, quad9 and tripod4. A ring needs a file,
with joint angles that close it.
`metamorph schema gait` describes gait files. A gait file and the JSON output are the same.

Exit codes:
  0  the gaits were tried
  1  the program itself failed, for example because a file could not be written
  2  the command line or a file is wrong; the error names its place, reason and fix
  3  no joint can move: all modules are dead
  7  ended by a signal; --write has what was done";

/// Exit code: ended by a signal before all trials were done.
const ABORTED: u8 = 7;
/// Shortest time of a trial: a period of the oscillators.
const TRIAL_MIN: Span = Span::secs(5);
/// Longest time of a trial.
const TRIAL_MAX: Span = Span::secs(600);
/// The largest number of gaits of a run.
const MOST: u64 = 100_000;

/// Arguments of `learn`.
#[derive(Debug, Args)]
pub struct LearnArgs {
    /// A structure file, or the name of a structure
    #[arg(value_name = "FILE|NAME")]
    pub structure: String,
    /// The learner
    #[arg(long, value_enum, default_value_t = Method::Cma)]
    pub method: Method,
    /// The network of oscillators
    #[arg(long, value_enum, default_value_t = NetworkArg::BlfSym)]
    pub network: NetworkArg,
    /// Gaits that each run tries
    #[arg(long, value_name = "N", default_value_t = 120)]
    pub trials: u64,
    /// Time of a trial, after 2 s at rest: at least 5s, a period of the oscillators
    #[arg(long, value_name = "TIME", default_value = "30s")]
    pub trial: String,
    /// What a gait is worth
    #[arg(long, value_enum, default_value_t = Fitness::Robust)]
    pub fitness: Fitness,
    /// Count the distance in this direction only, such as 45deg, from +x towards +y. Default: any
    #[arg(long, value_name = "ANGLE", allow_hyphen_values = true)]
    pub heading: Option<String>,
    /// A fall ends a trial, and its speed counts a thousandth, as after a self-collision
    #[arg(long)]
    pub upright: bool,
    /// Largest offset of an oscillator, from 1deg to 180deg; the thesis gives no bound
    #[arg(long, value_name = "ANGLE", default_value = "30deg")]
    pub offsets: String,
    /// Seeds from A up to but not including B, one run each
    #[arg(long, value_name = "A..B", default_value = "1..2")]
    pub seeds: String,
    /// Modules whose process dies before the gait begins, such as 0,3; their joints stay where they are.
    /// Default: none
    #[arg(long, value_name = "MODULES", value_delimiter = ',')]
    pub dead: Vec<u32>,
    /// Begin at the best gait of this file (with cma); joints that it does not have begin in the middle
    #[arg(long, value_name = "FILE")]
    pub from: Option<PathBuf>,
    /// Direction of module 0's foot frame that points down at the start: +x, -x, +y, -y, +z or -z
    #[arg(long, value_name = "DIRECTION", default_value = "-y", allow_hyphen_values = true)]
    pub down: String,
    /// Write the gait file, after every round of trials
    #[arg(long, value_name = "FILE")]
    pub write: Option<PathBuf>,
    /// Take the trials that the file of --write has; the options must be the same, but for --trials and
    /// --seeds
    #[arg(long, requires = "write")]
    pub resume: bool,
    /// Concurrent trials; default: the number of processors
    #[arg(short, long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Write the gait file as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// Why nothing is learnt.
#[derive(Debug, Error)]
pub enum LearnError {
    /// The structure is wrong.
    #[error(transparent)]
    Structure(#[from] StructureCommandError),
    /// An option or a gait file is wrong.
    #[error(transparent)]
    Option(#[from] PlanError),
    /// The seeds are wrong.
    #[error(transparent)]
    Seeds(#[from] GridError),
    /// An output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError for LearnError {
    fn exit_code(&self) -> u8 {
        match self {
            LearnError::Structure(error) => error.exit_code(),
            LearnError::Option(error) => error.exit_code(),
            LearnError::Seeds(_) => BAD_USAGE,
            LearnError::Output(error) => error.exit_code(),
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// Study, seeds and start that the arguments describe.
struct Asked {
    study: Study,
    part: StudyPart,
    from: Option<Gait>,
    seeds: Seeds,
    notes: Vec<String>,
}

/// Learns, prints what was learnt, and returns the exit code.
pub fn learn(args: &LearnArgs, interrupt: &Interrupt) -> Result<u8, LearnError> {
    let mut outputs = Outputs::new();
    if named::structure(&args.structure).is_none() {
        outputs.reads("the structure", args.structure.as_ref());
    }
    args.from.iter().for_each(|path| outputs.reads("--from", path));
    let json_output = Json::of(args.json.as_deref(), &mut outputs)?;
    let write =
        args.write.as_deref().map(|path| outputs.writes("--write", path, OutputKind::Json)).transpose()?;
    let asked = asked(args)?;
    let mut file = GaitFile {
        format: FORMAT.to_owned(),
        version: VERSION,
        study: asked.part.clone(),
        best: None,
        runs: Vec::new(),
    };
    if let Some(path) = args.write.as_deref().filter(|path| args.resume && path.exists()) {
        file.runs = resumed(path, &asked.part)?.runs;
    }
    let channel = Channel::beside(json_output.is_out(), args.quiet);
    asked.notes.iter().for_each(|note| channel.say(&format!("note: {note}")));
    let cannot = |error: PhysicsError| PlanError::option(&args.structure.shown(), format!("{error}"), BODIES);
    if let Some(gait) = &asked.from {
        let outcomes = asked.study.outcomes(gait).map_err(cannot)?;
        channel.say(&text::known(&asked.study, &outcomes));
    }
    interrupt.begin();
    let jobs = args.jobs.or_else(|| std::thread::available_parallelism().ok()).unwrap_or(NonZeroUsize::MIN);
    let mut live = Live::new(!args.quiet);
    let mut keep = |file: &GaitFile| write.as_ref().map_or(Ok(()), |output| save(output, file));
    let start = asked.from.as_ref().map(|gait| asked.study.space.point(gait));
    let runs = Runs { study: &asked.study, part: &asked.part, start, seeds: asked.seeds, jobs, interrupt };
    runs.all(&mut file, &mut live, &mut keep)?;
    drop(live);
    json_output.write(&file)?;
    channel.say(&text::text(&asked.study, &file, channel.paint()));
    let done = file.runs.iter().filter(|run| asked.seeds.from <= run.seed && run.seed < asked.seeds.until);
    let wanted = asked.seeds.len() * args.trials;
    Ok(if done.map(|run| run.trials.len() as u64).sum::<u64>() < wanted { ABORTED } else { 0 })
}

/// Fix for a structure that cannot have bodies.
const BODIES: &str =
    "name a structure whose modules do not overlap, and a file with joints_deg if it has rings";

fn save(output: &Output, file: &GaitFile) -> Result<(), LearnError> {
    Ok(output.write(json(file) + "\n")?)
}

fn asked(args: &LearnArgs) -> Result<Asked, LearnError> {
    let time: Span = args.trial.parse().map_err(|error: SpanError| {
        PlanError::option("--trial", format!("{error}"), "write a time such as 30s")
    })?;
    if !(TRIAL_MIN..=TRIAL_MAX).contains(&time) {
        let reason = format!("{time} is not between {TRIAL_MIN} and {TRIAL_MAX}");
        return Err(PlanError::option("--trial", reason, "5s is a period of the oscillators").into());
    }
    if args.trials == 0 || args.trials > MOST {
        let reason = format!("{} is not between 1 and {MOST}", args.trials);
        return Err(PlanError::option("--trials", reason, "name another number").into());
    }
    let heading_deg =
        args.heading.as_deref().map(|text| degrees("--heading", text, -360.0..=360.0)).transpose()?;
    let offsets_deg = degrees("--offsets", &args.offsets, 1.0..=180.0)?;
    let down: Down = args.down.parse().map_err(|error: NotADirection| {
        PlanError::option("--down", format!("{error}"), "-y is right for the named structures")
    })?;
    let (read, passive) = structure::read_with_dead(&args.structure, &args.dead)?;
    let bound = read.structure.bound();
    let joints_deg = read.joints_deg.clone().unwrap_or_else(|| vec![[0.0; 3]; bound]);
    let network = NetworkKind::from(args.network);
    let infeasible = |_| StructureCommandError::Infeasible { argument: args.structure.shown() };
    let space = Space::with_offsets(&passive, network, offsets_deg).map_err(infeasible)?;
    let mut dead: Vec<u32> = args.dead.clone();
    dead.sort_unstable();
    dead.dedup();
    let fingerprint = digits(read.structure.fingerprint());
    let from = args.from.as_deref().map(|path| known(path, &fingerprint, bound)).transpose()?;
    if from.is_some() && args.method != Method::Cma {
        let reason = format!("{} does not begin at a gait", args.method);
        return Err(PlanError::option("--from", reason, "use --method cma, or leave out --from").into());
    }
    let course = TrialSetup {
        structure: read.structure,
        joints_deg,
        down,
        network,
        dead: dead.iter().map(|m| ModuleId(*m)).collect(),
        time,
        heading_deg,
        upright: args.upright,
        seed: 1,
    };
    // Refused here, before anything is written.
    let refused =
        |error: PhysicsError| PlanError::option(&args.structure.shown(), format!("{error}"), BODIES);
    drop(course.run(Gait::new(), 0.0).map_err(refused)?);
    let part = StudyPart {
        structure: args.structure.shown(),
        fingerprint,
        down: down.to_string(),
        dead,
        network: network.name().to_owned(),
        method: args.method,
        fitness: args.fitness,
        heading_deg,
        upright: args.upright,
        offsets_deg,
        trial_s: time.as_secs_f64(),
        trials: args.trials,
        from: from.as_ref().map(written),
        engine: ENGINE.to_owned(),
    };
    let study = Study { course, space, fitness: args.fitness };
    let reduced = !matches!(network, NetworkKind::Fo | NetworkKind::Sym);
    let has_body = structure::has_body(&passive);
    let note = "no body was found: the reduced network is the full one".to_owned();
    let notes = (reduced && !has_body).then_some(note).into_iter().collect();
    Ok(Asked { study, part, from, seeds: Seeds::parse(&args.seeds)?, notes })
}

/// Reads an angle in degrees.
fn degrees(option: &'static str, text: &str, range: RangeInclusive<f64>) -> Result<f64, PlanError> {
    let number = text.strip_suffix("deg").and_then(|n| n.trim().parse::<f64>().ok());
    number.filter(|n| range.contains(n)).ok_or_else(|| {
        let (from, to) = (range.start(), range.end());
        let reason = format!("{} is not an angle between {from}deg and {to}deg", text.shown());
        PlanError::option(option, reason, "write an angle such as 45deg")
    })
}

/// Reads the best gait of a file.
fn known(path: &Path, fingerprint: &str, modules: usize) -> Result<Gait, PlanError> {
    let place = format!("--from {}", path.shown());
    file::best(&place, &file::read(sources(), &place, path)?, fingerprint, modules)
}

/// Reads the file of a study to be resumed.
fn resumed(path: &Path, part: &StudyPart) -> Result<GaitFile, PlanError> {
    let place = format!("--resume {}", path.shown());
    let file = file::read(sources(), &place, path)?;
    match part.difference(&file.study) {
        None => Ok(file),
        Some((what, ours, theirs)) => {
            let reason = format!("{what} is {ours}, but {theirs} in the file");
            Err(PlanError::option(&place, reason, "use the options of the file, or write another one"))
        }
    }
}

/// The command.
pub static COMMAND: CommandOf<LearnArgs> = CommandOf {
    name: "learn",
    group: Some(Group::Study),
    about: "Learn a gait of a structure in simulation, with bodies",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, call| Ok(learn(&args, call.interrupt)?),
};

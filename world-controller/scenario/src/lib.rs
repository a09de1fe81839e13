//! Scenarios: TOML written by people, checked and turned into a plan that a driver can run.
//!
//! `settings` puts values of the command line into the document; `table` and `shapes` read values with their
//! places, `raw` and `faults` a whole document and the other options; `plan` checks what depends on several
//! values; `family` is the interface of families for both; `schema` describes the format to programs;
//! `packed_files` are files in the text itself, and `pack` puts them there; `error`
//! and `diagnostics` say what is wrong, where, and how to fix it; `shipped` has the scenarios that are in the program, and `template` writes new ones. All problems are collected and shown at once.
//!
//! Reading is slow and done once; [`Plan::with_seed`] is fast and returns the same plan with other random
//! places and crashes.
//!
//! *Invariants.* No text makes the reader panic or exceed the memory and time that the limits in `error`
//! allow. Absent: running anything.

pub mod bounds;
mod changes;
pub mod commands;
mod controller_link;
pub mod definitions;
pub mod diagnostics;
pub mod error;
pub mod family;
mod fault_plan;
pub mod faults;
pub mod grid;
pub mod hosts;
mod hosts_summary;
pub mod json;
mod link_between;
mod link_burst;
pub mod operator;
mod outages;
pub mod pack;
pub mod packed_files;
mod placement;
pub mod plan;
pub mod plan_summary;
pub mod raw;
pub mod rescue;
pub mod schema;
pub mod settings;
pub mod shapes;
pub mod shipped;
pub mod table;
pub mod template;

pub use plan::{NEVER, TIME_SCALE};
pub use raw::SEED;

use diagnostics::Diagnostics;
use error::{MAX_BYTES, ScenarioError};
use family::{Families, Swarm};
use fault_plan::Planned;
use metamorph_core::link::LinkModel;
use metamorph_core::ratio::Ratio;
use metamorph_kernel::director::faults::Schedule;
use metamorph_kernel::director::progress::Stop;
use metamorph_kernel::director::rescue::Rescue;
use metamorph_kernel::kernel::change::Change;
use metamorph_text::escape::portable;
use metamorph_text::program;
use metamorph_text::sources::Sources;
use operator::OperatorPlan;
pub use plan::LinkChange;
use serde::{Deserialize, Serialize};
use settings::Setting;
use shipped::Named;
use std::cell::LazyCell;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum LinkKind {
    /// One process per module, over shared memory.
    #[default]
    Ipc,
    /// One thread, in virtual time.
    Sim,
}

impl LinkKind {
    /// Returns the name used on the command line and in reports.
    pub const fn name(self) -> &'static str {
        match self {
            LinkKind::Ipc => "ipc",
            LinkKind::Sim => "sim",
        }
    }
}

/// Overrides of the command line. Texts are checked together with the scenario, so that errors in options are
/// reported like errors in the file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Overrides {
    /// The link.
    pub link: LinkKind,
    /// The seed of the run.
    pub seed: Option<u64>,
    /// `ID@T`, in addition to the scenario's faults.
    pub kill: Vec<String>,
    /// `ID@T..T`, in addition to the scenario's faults.
    pub pause: Vec<String>,
    /// `ID@T`, in addition to the scenario's faults.
    pub restart: Vec<String>,
    /// `ID,ID@T..T`, in addition to the scenario's faults.
    pub partition: Vec<String>,
    /// Probability of loss.
    pub loss: Option<String>,
    /// Delay: `T` or `T..T`.
    pub delay: Option<String>,
    /// Probability of duplication.
    pub duplicate: Option<String>,
    /// Probability of reordering.
    pub reorder: Option<String>,
    /// Scenario seconds per second on the process link.
    pub time_scale: Option<String>,
    /// `KIND=VALUE@EVENTS`, in addition to the scenario's changes.
    pub change: Vec<String>,
    /// Values put into the scenario before it is read.
    pub settings: Vec<Setting>,
}

impl Overrides {
    /// Returns the options that give the same plan when typed.
    pub fn options(&self) -> Vec<String> {
        let many = |name: &'static str, texts: &[String]| -> Vec<String> {
            texts.iter().flat_map(|t| [name.to_owned(), t.clone()]).collect()
        };
        let one = |name: &'static str, text: &Option<String>| many(name, text.as_slice());
        let settings: Vec<String> = self.settings.iter().map(|s| s.text.clone()).collect();
        [
            many("--set", &settings),
            many("--kill", &self.kill),
            many("--pause", &self.pause),
            many("--restart", &self.restart),
            many("--partition", &self.partition),
            one("--loss", &self.loss),
            one("--delay", &self.delay),
            one("--dup", &self.duplicate),
            one("--reorder", &self.reorder),
            one("--time-scale", &self.time_scale),
            many("--change", &self.change),
        ]
        .concat()
    }
}

/// One goal of a plan, as shown to people; its cells are in the setup.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StagePlan {
    /// Its name.
    pub name: String,
}

/// A checked scenario with the overrides of the command line.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scenario's name.
    pub name: Option<String>,
    /// The scenario's description.
    pub description: Option<String>,
    /// The scenario file, as named by the user.
    pub origin: String,
    /// Other files that the scenario names, such as those of shapes.
    pub files: Vec<PathBuf>,
    /// Their names as the scenario writes them, in the same order.
    pub names: Vec<String>,
    /// Notes about these files: faults that were read over, and content that was left out.
    pub notes: Vec<String>,
    /// The text of the scenario.
    pub text: Arc<str>,
    /// The overrides of the command line.
    pub overrides: Overrides,
    /// The seed of the run.
    pub seed: u64,
    /// The family's part.
    pub swarm: Swarm,
    /// The goals, one after the other. As many as in the setup.
    pub stages: Vec<StagePlan>,
    /// The link model. On the process link it is applied on top of the real link.
    pub link: LinkModel,
    /// The probability that a move or a connection fails.
    pub failure: Ratio,
    /// The faults before their random targets and times are drawn.
    pub faults: Arc<[Planned]>,
    /// The faults with this seed.
    pub schedule: Schedule,
    /// The end conditions of the run.
    pub stop: Stop,
    /// The changes of a simulated run at its events.
    pub changes: Vec<Change>,
    /// How far the controller helps a swarm that stands still, if the family has a rescue.
    pub rescue: Rescue,
    /// The operator, if the scenario names one.
    pub operator: Option<OperatorPlan>,
    /// True if messages are lost so often that the default bound for a deadlock may be too short.
    pub is_beyond: bool,
    /// Scenario seconds per second on the process link.
    pub time_scale: f64,
}

impl Plan {
    /// Returns the name of the scenario, or of its file.
    pub fn title(&self) -> String {
        self.name.clone().unwrap_or_else(|| self.file())
    }

    /// Returns the scenario file as it was typed, or the last part of an absolute path: for output that is
    /// passed on to others.
    pub fn file(&self) -> String {
        portable(Path::new(&self.origin))
    }

    /// Adds a change of the run, as an option of the command line would.
    pub fn add_change(&mut self, change: Change) {
        self.overrides.change.push(change.to_string());
        self.changes.push(change);
    }

    /// Returns the same plan with another seed. Cheap: what does not depend on the seed is shared.
    pub fn with_seed(&self, seed: u64) -> Result<Plan, ScenarioError> {
        let swarm = self.swarm.with_seed(seed)?.unwrap_or_else(|| self.swarm.clone());
        Ok(Plan { seed, schedule: fault_plan::draw(&self.faults, seed), swarm, ..self.clone() })
    }

    /// Returns the command that repeats the run, with the file as [`Plan::file`] names it: for output that is
    /// passed on to others.
    pub fn repeat_with(&self) -> String {
        self.repeat(self.file())
    }

    /// Returns the command that repeats the run from the working directory.
    pub fn repeat_here(&self) -> String {
        self.repeat(self.origin.clone())
    }

    /// Returns the command that runs the same with another file of the scenario.
    pub fn repeat_as(&self, file: String) -> String {
        self.repeat(file)
    }

    fn repeat(&self, file: String) -> String {
        let mut words = vec![quote(program::name().to_owned()), "run".to_owned(), quote(file)];
        words.extend(["--link".to_owned(), self.overrides.link.name().to_owned()]);
        words.extend(["--seed".to_owned(), self.seed.to_string()]);
        words.extend(self.overrides.options().into_iter().map(quote));
        words.join(" ")
    }
}

/// Quotes a word for a shell.
pub fn quote(text: String) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-@%+=:,".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        text
    } else {
        format!("'{}'", text.replace('\'', r"'\''"))
    }
}

/// Reads and checks a scenario: a file, or the name of one that ships with the program.
///
/// # Errors
///
/// All problems of the scenario.
pub fn read_file(families: Families, path: &Path, overrides: &Overrides) -> Result<Plan, Diagnostics> {
    let Loaded { origin, text } = load(families.sources, path)?;
    read_text(families, &origin, &text, overrides)
}

/// The text of a scenario.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// Its file, or the name of a shipped scenario.
    pub origin: String,
    /// The text.
    pub text: String,
}

/// Reads the text of a scenario: of a file, or of one that ships with the program.
pub fn load(sources: &dyn Sources, argument: &Path) -> Result<Loaded, Diagnostics> {
    match shipped::find(sources, argument) {
        Named::File(path) => {
            Ok(Loaded { origin: path.display().to_string(), text: load_file(sources, &path)? })
        }
        Named::Shipped(name) => {
            let text = shipped::text(name).unwrap_or_default().to_owned();
            Ok(Loaded { origin: name.to_owned(), text })
        }
    }
}

fn load_file(sources: &dyn Sources, path: &Path) -> Result<String, Diagnostics> {
    let origin = path.display().to_string();
    let bytes = sources.read_argument(path, MAX_BYTES).map_err(|error| match error.kind() {
        ErrorKind::InvalidInput => Diagnostics::of_file(&origin, ScenarioError::NoFile(error.to_string())),
        ErrorKind::NotFound | ErrorKind::NotADirectory => {
            let suggestions = shipped::suggestions(sources, path);
            Diagnostics::of_file(&origin, ScenarioError::NoSuchFile { suggestions })
        }
        ErrorKind::FileTooLarge => Diagnostics::of_file(&origin, ScenarioError::FileTooLarge),
        _ => Diagnostics::of_file(&origin, ScenarioError::Unreadable(error.to_string())),
    })?;
    String::from_utf8(bytes).map_err(|_| Diagnostics::of_file(&origin, ScenarioError::NotUtf8))
}

/// Reads a document of TOML, or the TOML value that a text in JSON became; syntax errors are noted.
fn parse<'i>(text: &'i str, json: Option<&'i str>, diagnostics: &mut Diagnostics) -> Spanned<DeTable<'i>> {
    let (document, errors) = match json {
        None => DeTable::parse_recoverable(text),
        Some(json) => {
            let (value, errors) = DeValue::parse_recoverable(json);
            let span = value.span();
            match value.into_inner() {
                DeValue::Table(table) => (Spanned::new(span, table), errors),
                _ => (Spanned::new(span, DeTable::new()), errors),
            }
        }
    };
    for error in errors {
        let message = error.message().to_owned();
        let scenario_error =
            if json.is_some() { ScenarioError::JsonSyntax(message) } else { ScenarioError::Syntax(message) };
        match error.span() {
            Some(span) => diagnostics.add(span, scenario_error),
            None => diagnostics.add(diagnostics::Place::File, scenario_error),
        }
    }
    document
}

/// Reads and checks the text of a scenario in TOML or JSON; `origin` names it in messages.
pub fn read_text(
    families: Families,
    origin: &str,
    text: &str,
    overrides: &Overrides,
) -> Result<Plan, Diagnostics> {
    // A value of TOML has no blanks around it.
    let text = if json::is_json(text) { text.trim() } else { text };
    let mut diagnostics = Diagnostics::new(families, origin, text);
    let json = json::is_json(text).then(|| json::as_toml(text));
    let mut document = parse(text, json.as_deref(), &mut diagnostics);
    // A partly read document cannot be checked.
    if !diagnostics.is_empty() {
        return Err(diagnostics.sorted());
    }
    settings::apply(document.get_mut(), &overrides.settings, text, &mut diagnostics);
    let families = diagnostics.families();
    // A document may have many unknown keys.
    let schema = LazyCell::new(|| schema::schema(families));
    let elsewhere = |key: &str, family: &str| schema::with_section(&schema, key, family);
    let raw = raw::Raw::read(document.get_ref(), overrides, elsewhere, &mut diagnostics);
    match plan::make(&raw, overrides, &mut diagnostics) {
        Some(plan) if diagnostics.is_empty() => {
            let (names, files) = diagnostics.files().iter().cloned().unzip();
            let notes = diagnostics.notes().to_vec();
            Ok(Plan { origin: origin.to_owned(), files, names, notes, text: Arc::from(text), ..plan })
        }
        _ => Err(diagnostics.sorted()),
    }
}

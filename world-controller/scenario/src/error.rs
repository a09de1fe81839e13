//! All errors in scenarios, with their fixes.
//!
//! One variant per reason, so that tests and callers can tell them apart; the text of a variant is the
//! reason, [`ScenarioError::fix`] says what to do. Absent: the place of the error (see `diagnostics`).

use super::changes;
use super::hosts::HostsProblem;
use super::settings::KeyError;
use metamorph_core::goal::GoalError;
use metamorph_core::lattice::Cell;
use metamorph_core::link::QuantilesError;
use metamorph_core::ratio::RatioError;
use metamorph_core::shape::ShapeError;
use metamorph_core::time::{Span, SpanError};
use metamorph_shapes::error::SolidError;
use metamorph_text::escape::Shown;
use thiserror::Error;

/// The scenario format that this program reads.
pub const VERSION: u64 = 1;
/// Modules of one swarm at most.
pub const MAX_MODULES: usize = 1_000_000;
/// Bytes of a scenario file at most.
pub const MAX_BYTES: u64 = 16 << 20;
/// Cells of the box around the start and all goals at most, and of the boxes around each goal together.
pub const MAX_VOLUME: u64 = 64_000_000;
/// Cells of the boxes around all parts of all shapes of a scenario together at most.
pub const MAX_LAID_OUT: u64 = 24_000_000;
/// Largest number of unions, differences and intersections nested within each other.
pub const MAX_DEPTH: usize = 16;
/// Largest number of shapes from files in one scenario.
pub const MAX_FILES: usize = 16;
/// Largest number of goals of one scenario.
pub const MAX_GOALS: usize = 32;
/// Longest time of a move, and of an injected delay.
pub const LONGEST: Span = Span(3_600_000_000_000);
/// Shortest time of a move.
pub const SHORTEST: Span = Span(1_000_000);

/// An error in a scenario.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ScenarioError {
    /// The file cannot be opened or read.
    #[error("cannot read the scenario: {0}")]
    Unreadable(String),
    /// There is no such file.
    #[error("cannot read the scenario: there is no such file, and none of this name ships with the program")]
    NoSuchFile {
        /// Similar names.
        suggestions: Vec<String>,
    },
    /// A directory, a pipe or a device.
    #[error("cannot read the scenario: {0}")]
    NoFile(String),
    /// The file is not text.
    #[error("the file is not UTF-8 text")]
    NotUtf8,
    /// The file is too large to be a scenario.
    #[error("the file is larger than {} MiB", MAX_BYTES >> 20)]
    FileTooLarge,
    /// The text is not TOML.
    #[error("this is not TOML: {0}")]
    Syntax(String),
    /// The text begins like JSON and is not.
    #[error("this is not JSON: {0}")]
    JsonSyntax(String),
    /// The scenario is for a later version of the program.
    #[error("the scenario has version {found}; this program (metamorph {program}) reads version {VERSION}",
        program = metamorph_text::version::version())]
    Newer {
        /// The version of the scenario.
        found: i64,
    },
    /// A key that is unknown here.
    #[error("unknown key `{key}` in {section}")]
    UnknownKey {
        /// The key.
        key: String,
        /// Its section.
        section: String,
        /// The keys known there.
        known: Vec<&'static str>,
        /// The same key with its section, if a section of the scenario has it.
        elsewhere: Option<String>,
    },
    /// A key of another family.
    #[error("`{key}` in {section} is for the family `{theirs}`; this scenario is of the family `{ours}`")]
    Foreign {
        /// The key.
        key: String,
        /// Its section.
        section: String,
        /// The family of the key.
        theirs: &'static str,
        /// The family of the scenario.
        ours: &'static str,
    },
    /// A required key is missing.
    #[error("{section} has no `{key}`")]
    Missing {
        /// The key.
        key: &'static str,
        /// Its section.
        section: String,
        /// An example.
        example: &'static str,
    },
    /// A value of the wrong kind.
    #[error("expected {expected}, found {found}")]
    Kind {
        /// The expected kind.
        expected: &'static str,
        /// The kind found.
        found: &'static str,
        /// An example.
        example: &'static str,
    },
    /// An unknown name.
    #[error("unknown {what} `{got}`")]
    Name {
        /// Kind of thing that the name refers to.
        what: &'static str,
        /// The name.
        got: String,
        /// The known names.
        known: Vec<&'static str>,
    },
    /// A known feature that no link supports yet; never silently ignored.
    #[error("{what} is not supported yet")]
    NotYet {
        /// The feature.
        what: String,
        /// Suggested alternative.
        instead: &'static str,
    },
    /// Not a command of an operator.
    #[error("{0}")]
    Command(String),
    /// Quantiles that are none of a delay.
    #[error("{0}")]
    Quantiles(QuantilesError),
    /// A number outside its range.
    #[error("{what} is {got}, which is not between {low} and {high}")]
    Range {
        /// Quantity that the number stands for.
        what: &'static str,
        /// The number.
        got: String,
        /// The minimum.
        low: String,
        /// The maximum.
        high: String,
    },
    /// Not a time.
    #[error(transparent)]
    Time(#[from] SpanError),
    /// Not a probability.
    #[error(transparent)]
    Probability(#[from] RatioError),
    /// Two times in the wrong order.
    #[error("it begins at {from} and ends at {until}, which is not later")]
    Order {
        /// The beginning.
        from: Span,
        /// The end.
        until: Span,
    },
    /// Not a shape.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// An error in the file of a shape.
    #[error(transparent)]
    Solid(#[from] SolidError),
    /// Too many files.
    #[error("the scenario takes shapes from more than {MAX_FILES} files")]
    TooManyFiles,
    /// Shapes are nested too deeply.
    #[error("shapes are nested more than {MAX_DEPTH} deep")]
    TooDeep,
    /// The shapes have too many cells to be laid out.
    #[error("laying out the shapes up to this one takes {0} cells; {MAX_LAID_OUT} is the maximum")]
    TooMuch(u64),
    /// The world is too wide.
    #[error(
        "the box around the start and the goals, or those around each goal together, have {0} cells; {MAX_VOLUME} is the maximum"
    )]
    TooWide(u64),
    /// The swarm is too large.
    #[error("the swarm has {0} modules; {MAX_MODULES} is the maximum")]
    TooMany(usize),
    /// The start is not connected.
    #[error("the start is in {count} parts that do not touch; cells of different parts: {examples}")]
    DisconnectedStart {
        /// The number of parts.
        count: usize,
        /// A cell of each of the first few.
        examples: String,
    },
    /// There is no goal.
    #[error("the scenario has no [[goal]]")]
    NoGoal,
    /// A goal in a scenario of a family whose protocol has its own.
    #[error("the family `{0}` has no [[goal]]")]
    GoalOfProtocol(&'static str),
    /// There are too many goals.
    #[error("the scenario has {0} goals; {MAX_GOALS} is the maximum")]
    TooManyGoals(usize),
    /// The goal cannot be grown.
    #[error(transparent)]
    Goal(#[from] GoalError),
    /// The goal has more cells than the swarm has modules.
    #[error("the goal has {goal} cells and the swarm has {modules} modules: {} too few", goal - modules)]
    TooFewModules {
        /// Cells of the goal.
        goal: usize,
        /// Modules of the swarm.
        modules: usize,
        /// Whether a scaffold would fill less of the shape.
        has_scaffold: bool,
    },
    /// No goal cell is occupied, so growth cannot start.
    #[error("no cell of the goal is occupied {when}, so that growth has no cell to begin from")]
    NoOverlap {
        /// At the start or by the previous goal.
        when: &'static str,
    },
    /// The seed is not occupied.
    #[error("the seed {seed} is not occupied {when}")]
    SeedEmpty {
        /// The seed.
        seed: Cell,
        /// At the start or by the previous goal.
        when: &'static str,
        /// A cell that would be possible.
        example: Option<Cell>,
    },
    /// An error particular to one family.
    #[error("{reason}")]
    OfFamily {
        /// The reason.
        reason: String,
        /// The fix.
        fix: String,
    },
    /// A fault names a module that does not exist.
    #[error("there is no module {module}; the swarm has modules 0 to {last}")]
    NoSuchModule {
        /// The number named.
        module: u64,
        /// The last number of a module.
        last: usize,
    },
    /// A fault with no kind or several.
    #[error("a [[fault]] has one kind; this one has {names}")]
    OneVerb {
        /// The kinds that it names.
        names: String,
        /// The kinds that the family has.
        kinds: Vec<&'static str>,
    },
    /// A fault after the end of the run.
    #[error("it happens at {at}, but the run ends at {timeout} at the latest")]
    AfterTheEnd {
        /// When the fault is due.
        at: Span,
        /// The end of the run.
        timeout: Span,
    },
    /// The hosts are invalid.
    #[error(transparent)]
    Hosts(#[from] HostsProblem),
    /// A setting for an invalid key.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// Two files of one name in the scenario.
    #[error("there are two [[file]] with the name `{}`", .0.shown())]
    FileTwice(String),
    /// The content of a file in the scenario is not Base64.
    #[error("this is not Base64")]
    NotBase64,
    /// A change without exactly one kind.
    #[error("a [[change]] has one kind; this one has {0}")]
    OneChange(String),
    /// An option of the wrong form.
    #[error("`{0}` is not of the form {1}")]
    Form(String, &'static str),
}

impl ScenarioError {
    /// Returns what to do about it.
    pub fn fix(&self) -> String {
        match self {
            ScenarioError::Unreadable(_) => "check the path and its permissions".into(),
            ScenarioError::NoSuchFile { suggestions } if suggestions.is_empty() => {
                "check the path; `metamorph scenarios` lists the scenarios that ship with the program".into()
            }
            ScenarioError::NoSuchFile { suggestions } => {
                let quoted: Vec<String> =
                    suggestions.iter().map(|name| format!("`{}`", name.shown())).collect();
                format!("did you mean {}?", quoted.join(" or "))
            }
            ScenarioError::NoFile(_) => {
                "name a file; what another program prints is read from /dev/stdin or <(program)".into()
            }
            ScenarioError::NotUtf8 => "save it as UTF-8; is it really a scenario?".into(),
            ScenarioError::FileTooLarge => {
                "describe large shapes with box, sphere, union, not cell by cell".into()
            }
            ScenarioError::JsonSyntax(_) => {
                "see https://json.org for the syntax; `null` has no meaning, a key is left out instead".into()
            }
            ScenarioError::Syntax(_) => "see https://toml.io for the syntax; text values need quotes".into(),
            ScenarioError::Newer { .. } => format!("use a newer metamorph, or write `version = {VERSION}`"),
            ScenarioError::UnknownKey { elsewhere: Some(whole), .. } => format!("did you mean `{whole}`?"),
            ScenarioError::UnknownKey { key, known, .. } => did_you_mean(key, known),
            ScenarioError::Name { got, known, .. } => did_you_mean(got, known),
            ScenarioError::Foreign { theirs, .. } => {
                format!("remove it, or write `family = \"{theirs}\"` in [swarm]")
            }
            ScenarioError::Command(_) => "see the commands in docs/commands.md".into(),
            ScenarioError::Missing { example, .. } | ScenarioError::Kind { example, .. } => {
                format!("write for example `{example}`")
            }
            ScenarioError::NotYet { instead, .. } => (*instead).into(),
            ScenarioError::Quantiles(_) => {
                "write growing shares up to 100%, for example `[[\"50%\", \"2ms\"], [\"100%\", \"80ms\"]]`"
                    .into()
            }
            ScenarioError::Range { low, high, .. } => format!("write a value from {low} to {high}"),
            ScenarioError::Time(_) => "write a number and a unit, such as `200ms`, `1.5s` or `2min`".into(),
            ScenarioError::Probability(_) => "write a value from `0%` to `100%`".into(),
            ScenarioError::Order { .. } => "choose an end after the beginning".into(),
            ScenarioError::Shape(error) => shape_fix(error).into(),
            ScenarioError::Solid(error) => error.fix().into(),
            ScenarioError::TooManyFiles => "unite the solids before they are exported".into(),
            ScenarioError::TooDeep => "a union can hold any number of shapes side by side".into(),
            ScenarioError::TooMuch(_) | ScenarioError::TooWide(_) | ScenarioError::TooMany(_) => {
                "make it smaller".into()
            }
            ScenarioError::DisconnectedStart { .. } => "connect every module to the rest by a face".into(),
            ScenarioError::TooManyGoals(_) => "run it in parts".into(),
            ScenarioError::GoalOfProtocol(_) => {
                "remove it; the protocol says when its modules have reached their goal".to_owned()
            }
            ScenarioError::NoGoal => {
                "add for example\n    [[goal]]\n    shape = { box = { min = [0, 0, 0], max = [4, 4, 0] } }"
                    .into()
            }
            ScenarioError::Goal(GoalError::SeedOutside(_)) => {
                "name a cell of the goal's shape, or leave `seed` out to have one chosen".into()
            }
            ScenarioError::Goal(GoalError::Disconnected { .. }) => "make the goal one piece".into(),
            ScenarioError::Goal(GoalError::TooDeep(_)) => {
                "make the goal smaller, or put the seed in its middle".into()
            }
            ScenarioError::TooFewModules { has_scaffold: true, .. } => {
                "make `start` larger or the goal's `shape` smaller, or write `growth = \"scaffold\"`, which fills about half of the shape".into()
            }
            ScenarioError::TooFewModules { .. } => "make `start` larger or the goal's `shape` smaller".into(),
            ScenarioError::NoOverlap { .. } => {
                "move one of the shapes so that they share at least one cell".into()
            }
            ScenarioError::SeedEmpty { example: Some(cell), .. } => {
                format!("name a cell of both, such as {cell}, or leave `seed` out to have one chosen")
            }
            ScenarioError::SeedEmpty { .. } => {
                "move one of the shapes so that they share at least one cell".into()
            }
            ScenarioError::OfFamily { fix, .. } => fix.clone(),
            ScenarioError::NoSuchModule { last, .. } => format!("name a module from 0 to {last}"),
            ScenarioError::OneVerb { kinds, .. } => {
                format!("write one of {} per [[fault]]", kinds.join(", "))
            }
            ScenarioError::AfterTheEnd { .. } => {
                "choose an earlier time, or raise `timeout` in [stop]".into()
            }
            ScenarioError::Hosts(problem) => problem.fix(),
            ScenarioError::Key(error) => error.fix(),
            ScenarioError::FileTwice(_) => "remove one of the two".into(),
            ScenarioError::OneChange(_) => "write for example `reseed = { links = 17 }`".into(),
            ScenarioError::NotBase64 => "write what `base64 FILE` prints, or text as `text`".into(),
            ScenarioError::Form(_, form) => format!("write for example `{}`", option_example(form)),
        }
    }
}

fn option_example(form: &str) -> &'static str {
    match form {
        "ID@T..T" => "2@1s..3s",
        "T or T..T" => "10ms..100ms",
        "T..T" => "0s..60s",
        "KEY=VALUE" => "link.loss=5%",
        changes::FORM => "links=17@48213",
        changes::MESSAGE => "7.0.213",
        _ => "3@2s",
    }
}

fn shape_fix(error: &ShapeError) -> &'static str {
    match error {
        ShapeError::Twice(_) => "remove one of the two",
        ShapeError::InsideOut { .. } => "swap the coordinates that are in the wrong order",
        ShapeError::OutOfRange(_) => "move the shape towards the origin",
        ShapeError::TooLarge => "make it smaller",
        ShapeError::Empty => "describe at least one cell",
        ShapeError::NoOperand => "list the shapes that overlap",
        ShapeError::NoMinuend => "list the shape to keep first, then those to take away",
    }
}

/// Suggests the nearest known name, if one is near, and lists all of them.
fn did_you_mean(got: &str, known: &[&str]) -> String {
    let lower: String = got.chars().take(64).flat_map(char::to_lowercase).collect();
    let near = known
        .iter()
        .map(|k| (strsim::damerau_levenshtein(&lower, &k.to_lowercase()), *k))
        .filter(|(distance, k)| *distance <= 1 + k.len() / 3)
        .min();
    let all = known.join(", ");
    match near {
        Some((_, near)) => format!("did you mean `{near}`? Known here: {all}"),
        None => format!("known here: {all}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suggests_the_nearest_name_only_if_it_is_near() {
        assert!(did_you_mean("lose", &["loss", "delay"]).starts_with("did you mean `loss`?"));
        assert!(did_you_mean("Loss", &["loss", "delay"]).starts_with("did you mean `loss`?"));
        assert_eq!(did_you_mean("banana", &["loss", "delay"]), "known here: loss, delay");
    }
}

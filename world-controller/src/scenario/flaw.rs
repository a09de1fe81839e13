//! Everything that can be wrong with a scenario, and what to do about it.
//!
//! One variant per reason, so that tests and callers can tell them apart; the text of a variant is
//! the reason, [`Flaw::fix`] the way out. Absent: where it was found (see `problems`).

use super::settings::KeyError;
use crate::scenario::mesh_import::flaw::SolidError;
use metamorph_protocol::goal::GoalError;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::ratio::RatioError;
use metamorph_protocol::shape::ShapeError;
use metamorph_protocol::time::{Span, SpanError};
use thiserror::Error;

/// The scenario format that this program reads.
pub const VERSION: u64 = 1;
/// The most modules of one swarm.
pub const MAX_MODULES: usize = 1_000_000;
/// The largest file that is read as a scenario, in bytes.
pub const MAX_BYTES: u64 = 16 << 20;
/// The most cells of the box around the start and all goals, and of the boxes around each goal together.
pub const MAX_VOLUME: u64 = 64_000_000;
/// The most cells that the boxes around all parts of all shapes of a scenario may have together.
pub const MAX_LAID_OUT: u64 = 24_000_000;
/// How deep unions, differences and intersections may be nested.
pub const MAX_DEPTH: usize = 16;
/// The most shapes from files in one scenario.
pub const MAX_FILES: usize = 16;
/// The most goals of one scenario.
pub const MAX_GOALS: usize = 32;
/// The longest move and the longest injected delay.
pub const LONGEST: Span = Span(3_600_000_000_000);
/// The shortest move.
pub const SHORTEST: Span = Span(1_000_000);

/// What is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Flaw {
    /// The file cannot be opened or read.
    #[error("cannot read the scenario: {0}")]
    Unreadable(String),
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
    /// Written for a later program.
    #[error("the scenario has version {found}; this program (metamorph {program}) reads version {VERSION}",
        program = env!("CARGO_PKG_VERSION"))]
    Newer {
        /// The version of the scenario.
        found: i64,
    },
    /// A key that means nothing here.
    #[error("unknown key `{key}` in {section}")]
    UnknownKey {
        /// The key.
        key: String,
        /// Where it stands.
        section: String,
        /// The keys that mean something there.
        known: Vec<&'static str>,
    },
    /// A key that means something in scenarios of another family.
    #[error("`{key}` in {section} is for the family `{theirs}`; this scenario is of the family `{ours}`")]
    Foreign {
        /// The key.
        key: String,
        /// Where it stands.
        section: String,
        /// The family whose it is.
        theirs: &'static str,
        /// The family of the scenario.
        ours: &'static str,
    },
    /// A key that must be there is not.
    #[error("{section} has no `{key}`")]
    Missing {
        /// The key.
        key: &'static str,
        /// Where it should stand.
        section: String,
        /// How to write it.
        example: &'static str,
    },
    /// A value of the wrong kind.
    #[error("expected {expected}, found {found}")]
    Kind {
        /// What should be there.
        expected: &'static str,
        /// What is there.
        found: &'static str,
        /// How to write it.
        example: &'static str,
    },
    /// A name that is not among those known.
    #[error("unknown {what} `{got}`")]
    Name {
        /// What is named.
        what: &'static str,
        /// The name.
        got: String,
        /// The names that are known.
        known: Vec<&'static str>,
    },
    /// Known, but not carried out by any link yet; never silently ignored.
    #[error("{what} is not built in yet")]
    NotYet {
        /// What was asked for.
        what: String,
        /// What can be done instead.
        instead: &'static str,
    },
    /// A number outside its range.
    #[error("{what} is {got}, which is not between {low} and {high}")]
    Range {
        /// What the number is.
        what: &'static str,
        /// The number.
        got: String,
        /// The smallest allowed.
        low: String,
        /// The largest allowed.
        high: String,
    },
    /// No length of time.
    #[error(transparent)]
    Time(#[from] SpanError),
    /// No probability.
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
    /// No cell set.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// A file that a shape is made of.
    #[error(transparent)]
    Solid(#[from] SolidError),
    /// Too many files.
    #[error("the scenario takes shapes from more than {MAX_FILES} files")]
    TooManyFiles,
    /// Shapes within shapes within shapes.
    #[error("shapes are nested more than {MAX_DEPTH} deep")]
    TooDeep,
    /// More cells to look at than is sensible.
    #[error("laying out the shapes up to this one means looking at {0} cells; {MAX_LAID_OUT} is the most")]
    TooMuch(u64),
    /// A world too wide.
    #[error(
        "the box around the start and the goals, or those around each goal together, have {0} cells; {MAX_VOLUME} is the most"
    )]
    TooWide(u64),
    /// A swarm too large.
    #[error("the swarm has {0} modules; {MAX_MODULES} is the most")]
    TooMany(usize),
    /// The start is in pieces.
    #[error("the start is in {count} parts that do not touch; cells of different parts: {examples}")]
    DisconnectedStart {
        /// How many parts.
        count: usize,
        /// A cell of each of the first few.
        examples: String,
    },
    /// No goal.
    #[error("the scenario has no [[goal]]")]
    NoGoal,
    /// Too many goals.
    #[error("the scenario has {0} goals; {MAX_GOALS} is the most")]
    TooManyGoals(usize),
    /// The shape cannot be grown.
    #[error(transparent)]
    Goal(#[from] GoalError),
    /// More cells than modules.
    #[error("the goal has {goal} cells and the swarm has {modules} modules: {} too few", goal - modules)]
    TooFewModules {
        /// Cells of the goal.
        goal: usize,
        /// Modules of the swarm.
        modules: usize,
    },
    /// Growth has nowhere to begin.
    #[error("no cell of the goal is occupied {when}, so that growth has no cell to begin from")]
    NoOverlap {
        /// At the start or by the goal before.
        when: &'static str,
    },
    /// Growth shall begin from nothing.
    #[error("the seed {seed} is not occupied {when}")]
    SeedEmpty {
        /// The seed.
        seed: Cell,
        /// At the start or by the goal before.
        when: &'static str,
        /// A cell that would do.
        example: Option<Cell>,
    },
    /// What only one family knows to be wrong.
    #[error("{reason}")]
    OfFamily {
        /// What is wrong.
        reason: String,
        /// What to do about it.
        fix: String,
    },
    /// A fault hits nobody.
    #[error("there is no module {module}; the swarm has modules 0 to {last}")]
    NoSuchModule {
        /// The number named.
        module: u64,
        /// The last that exists.
        last: usize,
    },
    /// A fault with no or several verbs.
    #[error("a [[fault]] does one thing; this one names {0}")]
    OneVerb(String),
    /// A fault that would never happen.
    #[error("it happens at {at}, but the run ends at {timeout} at the latest")]
    AfterTheEnd {
        /// When the fault is due.
        at: Span,
        /// When the run ends.
        timeout: Span,
    },
    /// A value for a key that leads nowhere.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// An option that cannot be taken apart.
    #[error("`{0}` is not of the form {1}")]
    Form(String, &'static str),
}

impl Flaw {
    /// What to do about it.
    pub fn fix(&self) -> String {
        match self {
            Flaw::Unreadable(_) => "check the path and its permissions".into(),
            Flaw::NoFile(_) => {
                "name a file; what another program prints is read from /dev/stdin or <(program)".into()
            }
            Flaw::NotUtf8 => "save it as UTF-8; is it really a scenario?".into(),
            Flaw::FileTooLarge => "describe large shapes with box, sphere, union, not cell by cell".into(),
            Flaw::Syntax(_) => "see https://toml.io for the syntax; text values need quotes".into(),
            Flaw::Newer { .. } => format!("use a newer metamorph, or write `version = {VERSION}`"),
            Flaw::UnknownKey { key, known, .. } => did_you_mean(key, known),
            Flaw::Name { got, known, .. } => did_you_mean(got, known),
            Flaw::Foreign { theirs, .. } => {
                format!("remove it, or write `family = \"{theirs}\"` in [swarm]")
            }
            Flaw::Missing { example, .. } | Flaw::Kind { example, .. } => {
                format!("write for example `{example}`")
            }
            Flaw::NotYet { instead, .. } => (*instead).into(),
            Flaw::Range { low, high, .. } => format!("write a value from {low} to {high}"),
            Flaw::Time(_) => "write a number and a unit, such as `200ms`, `1.5s` or `2min`".into(),
            Flaw::Probability(_) => "write a value from `0%` to `100%`".into(),
            Flaw::Order { .. } => "let it end after it begins".into(),
            Flaw::Shape(error) => shape_fix(error).into(),
            Flaw::Solid(error) => error.fix().into(),
            Flaw::TooManyFiles => "unite the solids before they are exported".into(),
            Flaw::TooDeep => "a union can hold any number of shapes side by side".into(),
            Flaw::TooMuch(_) | Flaw::TooWide(_) | Flaw::TooMany(_) => "make it smaller".into(),
            Flaw::DisconnectedStart { .. } => "let every module touch the rest with a face".into(),
            Flaw::TooManyGoals(_) => "run it in parts".into(),
            Flaw::NoGoal => {
                "add for example\n    [[goal]]\n    shape = { box = { min = [0, 0, 0], max = [4, 4, 0] } }"
                    .into()
            }
            Flaw::Goal(GoalError::SeedOutside(_)) => {
                "name a cell of the goal's shape, or leave `seed` out to have one chosen".into()
            }
            Flaw::Goal(GoalError::Disconnected { .. }) => "make the goal one piece".into(),
            Flaw::Goal(GoalError::TooDeep(_)) => {
                "make the goal smaller, or put the seed in its middle".into()
            }
            Flaw::TooFewModules { .. } => "make `start` larger or the goal's `shape` smaller".into(),
            Flaw::NoOverlap { .. } => "move one of the shapes so that they share at least one cell".into(),
            Flaw::SeedEmpty { example: Some(cell), .. } => {
                format!("name a cell of both, such as {cell}, or leave `seed` out to have one chosen")
            }
            Flaw::SeedEmpty { .. } => "move one of the shapes so that they share at least one cell".into(),
            Flaw::OfFamily { fix, .. } => fix.clone(),
            Flaw::NoSuchModule { last, .. } => format!("name a module from 0 to {last}"),
            Flaw::OneVerb(_) => {
                "write one of kill, pause, restart, stick, crash, partition, obstacle per [[fault]]".into()
            }
            Flaw::AfterTheEnd { .. } => "let it happen earlier, or raise `timeout` in [stop]".into(),
            Flaw::Key(error) => error.fix(),
            Flaw::Form(_, form) => format!("write for example `{}`", option_example(form)),
        }
    }
}

fn option_example(form: &str) -> &'static str {
    match form {
        "ID@T..T" => "2@1s..3s",
        "T or T..T" => "10ms..100ms",
        "T..T" => "0s..60s",
        "KEY=VALUE" => "link.loss=5%",
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
        ShapeError::NoOperand => "list the shapes that shall overlap",
        ShapeError::NoMinuend => "list the shape to keep first, then those to take away",
    }
}

/// The nearest known name, if one is near, and all of them.
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

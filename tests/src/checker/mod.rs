//! An independent checker of journals: reconstructs from the bytes of a journal where every body was at
//! every instant, and checks that it could be there.
//!
//! It shares nothing with the worlds, nor with the lattice and the kinematics of the protocol: `bytes`
//! reads files and records by itself, `cubes` and `metamodules` have rules of their own. Only what a step
//! of a metamodule's joint sweeps comes from the bytes of the motion database, because it takes minutes of
//! geometry to work out; which postures there are is checked against integer kinematics of its own.
//!
//! Absent: what agents say and decide, and whether the goal was built.

mod bytes;
mod cubes;
mod metamodules;

pub use metamodules::Geometry;

use bytes::{Entry, Event, Journal};
use std::fmt;
use std::fs;
use std::path::Path;

/// What a body may not do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// The file is a whole journal of this version.
    Readable,
    /// Two bodies are never in one cell, nor is a body in an obstacle.
    OneBodyPerCell,
    /// No body enters a cell that another one is moving into or through.
    Reserved,
    /// All cubes that rest are connected with each other.
    Connected,
    /// A cube moves over cubes that are there, and at rest.
    Supported,
    /// A cube that another one moves over stays where it is.
    SupportStays,
    /// A metamodule holds on to a connector of the floor with at least one end.
    Attached,
    /// A body can do what it does from where it is.
    Possible,
    /// An action begins where the last one has ended, and ends where it leads to or where it began.
    Follows,
}

/// A rule that was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Breach {
    /// The rule.
    pub rule: Rule,
    /// The number of the record, from 1; 0 is the file.
    pub record: usize,
    /// When, in nanoseconds of scenario time.
    pub at: u64,
    /// What was seen.
    pub what: String,
}

impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Breach { rule, record, at, what } = self;
        write!(f, "{rule:?} is broken by record {record} at {} ms: {what}", at / 1_000_000)
    }
}

/// What a sound journal holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// Bodies.
    pub bodies: usize,
    /// Actions begun.
    pub begun: u64,
    /// Actions that ended elsewhere or in another posture.
    pub done: u64,
    /// Actions that ended where they began.
    pub failed: u64,
}

/// A cell.
type Cell = [i32; 3];

fn plus(a: Cell, b: Cell) -> Cell {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// A rule that is broken, and how.
type Broken = (Rule, String);

fn demand(holds: bool, rule: Rule, what: impl FnOnce() -> String) -> Result<(), Broken> {
    if holds { Ok(()) } else { Err((rule, what())) }
}

/// The bodies of a run.
trait Bodies {
    /// A body stands here at first. Later lives begin where the body is.
    fn place(&mut self, id: u32, place: &[u8]) -> Result<(), Broken>;
    /// All bodies have their places.
    fn settle(&mut self) -> Result<(), Broken>;
    /// A body begins an action.
    fn begin(&mut self, id: u32, kind: u8, action: &[u8]) -> Result<(), Broken>;
    /// The actions of these bodies end one after the other. Returns how many ended elsewhere.
    fn end(&mut self, id: u32, place: &[u8]) -> Result<bool, Broken>;
    /// Something foreign comes into a cell, or is taken away.
    fn obstacle(&mut self, cell: Cell, there: bool) -> Result<(), Broken>;
}

/// Checks a whole journal of one file. `geometry` is of metamodules only.
///
/// # Errors
/// Returns the first rule that is broken.
pub fn check(journal: &Path, geometry: Option<&Geometry>) -> Result<Checked, Breach> {
    let unreadable = |what| Breach { rule: Rule::Readable, record: 0, at: 0, what };
    let bytes = fs::read(journal).map_err(|e| unreadable(e.to_string()))?;
    let journal = Journal::read(&bytes).map_err(unreadable)?;
    let modules = journal.modules as usize;
    match (journal.family.as_str(), geometry) {
        ("cube", None) => run(cubes::Cubes::new(modules), &journal),
        ("metamodule", Some(geometry)) => run(metamodules::Metamodules::new(modules, geometry), &journal),
        (family, _) => Err(unreadable(format!("geometry does not fit the family {family}"))),
    }
}

fn run(mut bodies: impl Bodies, journal: &Journal) -> Result<Checked, Breach> {
    let mut checked = Checked { bodies: journal.modules as usize, ..Checked::default() };
    // Bodies are there before their processes, so the first lives come first.
    for entry in &journal.entries {
        if let Event::Start { id, life: 0, place } = &entry.event {
            bodies.place(*id, place).map_err(|broken| entry.breach(broken))?;
        }
    }
    let start = Entry { record: 0, at: 0, event: Event::Other };
    bodies.settle().map_err(|broken| start.breach(broken))?;
    for entry in &journal.entries {
        step(&mut bodies, entry, &mut checked).map_err(|broken| entry.breach(broken))?;
    }
    Ok(checked)
}

fn step(bodies: &mut impl Bodies, entry: &Entry, checked: &mut Checked) -> Result<(), Broken> {
    match &entry.event {
        Event::Start { id, life: 1.., place } => bodies.place(*id, place),
        Event::Act { id, kind, action, begun: true } => {
            checked.begun += 1;
            bodies.begin(*id, *kind, action)
        }
        Event::Advance(ended) => {
            for (id, place) in ended {
                let done = bodies.end(*id, place)?;
                *(if done { &mut checked.done } else { &mut checked.failed }) += 1;
            }
            Ok(())
        }
        Event::Obstacle { cell, there } => bodies.obstacle(*cell, *there),
        Event::Start { .. } | Event::Act { .. } | Event::Other => Ok(()),
    }
}

impl Entry {
    fn breach(&self, (rule, what): Broken) -> Breach {
        Breach { rule, record: self.record, at: self.at, what }
    }
}

//! An independent checker of journals: reconstructs from the bytes of a journal the position of every body at
//! every instant, and checks that it is possible.
//!
//! It shares no code with the worlds, nor with the lattice and the kinematics of the protocol: `bytes` reads
//! files and records, `cubes` and `metamodules` have rules of their own. Only the cells that a step of a
//! metamodule's joint sweeps come from the bytes of the motion database, because their geometry takes minutes
//! to compute; the postures are checked against an independent integer kinematics.
//!
//! Absent: messages and decisions of agents, and whether the goal was built.

mod bytes;
mod cubes;
mod metamodules;

pub use metamodules::Geometry;

use bytes::{Entry, Event, Journal};
use std::fmt;
use std::fs;
use std::path::Path;

/// A rule about journals and bodies.
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
    /// A cube moves over cubes that are present and at rest.
    Supported,
    /// A cube that another one moves over stays where it is.
    SupportStays,
    /// A metamodule holds on to a connector of the floor with at least one end.
    Attached,
    /// A body is able to do its action from its place.
    Possible,
    /// An action begins where the last one has ended, and ends at its destination or where it began.
    Follows,
}

/// A violation of a rule.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Breach {
    /// The rule.
    pub rule: Rule,
    /// The number of the record, from 1; 0 is the file.
    pub record: usize,
    /// The time, in nanoseconds of scenario time.
    pub at: u64,
    /// The observation.
    pub what: String,
}

impl fmt::Display for Breach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Breach { rule, record, at, what } = self;
        write!(f, "{rule:?} is broken by record {record} at {} ms: {what}", at / 1_000_000)
    }
}

/// The counts of a valid journal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Checked {
    /// The number of bodies.
    pub bodies: usize,
    /// The number of actions begun.
    pub begun: u64,
    /// The number of actions that ended at another place or in another posture.
    pub done: u64,
    /// The number of actions that ended where they began.
    pub failed: u64,
}

/// A cell.
type Cell = [i32; 3];

fn plus(a: Cell, b: Cell) -> Cell {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// A rule that was broken, and the observation.
type Broken = (Rule, String);

fn demand(holds: bool, rule: Rule, what: impl FnOnce() -> String) -> Result<(), Broken> {
    if holds { Ok(()) } else { Err((rule, what())) }
}

/// The bodies of a run.
trait Bodies {
    /// Notes the initial place of a body. Later incarnations begin at the present place.
    fn place(&mut self, id: u32, place: &[u8]) -> Result<(), Broken>;
    /// Notes that all bodies have their places.
    fn settle(&mut self) -> Result<(), Broken>;
    /// Notes that a body begins an action.
    fn begin(&mut self, id: u32, kind: u8, action: &[u8]) -> Result<(), Broken>;
    /// Notes that the action of a body ends. Returns true if it has moved.
    fn end(&mut self, id: u32, place: &[u8]) -> Result<bool, Broken>;
    /// Notes that an obstacle comes into a cell, or is removed.
    fn obstacle(&mut self, cell: Cell, there: bool) -> Result<(), Broken>;
}

/// Checks a whole journal of one file. `geometry` is for metamodules only.
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
    // Bodies exist before their processes, so the first incarnations come first.
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

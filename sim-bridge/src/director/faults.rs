//! Faults as data. A fault schedule is a value of its own, separate from the run that it is injected into, so
//! that it can be printed, repeated and shrunk.

use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Time;
use std::fmt;
use std::str::FromStr;

/// A fault of the world that only some families know, such as an obstacle that appears. The family's director
/// injects it; everything else needs only what is here.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct WorldFault {
    /// The name used in reports.
    pub name: &'static str,
    /// True if it makes things worse, rather than ending another fault.
    pub harms: bool,
}

/// What a [`WorldFault`] hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Target {
    /// A cell.
    Cell(Cell),
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::Cell(cell) => cell.fmt(f),
        }
    }
}

/// One fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Fault {
    /// The process is killed. The body stays, as an obstacle.
    Kill(ModuleId),
    /// The process is stopped.
    Pause(ModuleId),
    /// A stopped process goes on.
    Resume(ModuleId),
    /// A dead process is restarted without its memory; a living one is killed first.
    Restart(ModuleId),
    /// The joint sticks: moves fail from now on.
    Stick(ModuleId),
    /// The joint is free again.
    Unstick(ModuleId),
    /// Something happens to the world that only some families know.
    World(&'static WorldFault, Target),
    /// A process was killed, stopped or continued from outside the run; no schedule contains this.
    External(ModuleId),
}

impl Fault {
    /// Returns the module that it hits; `None` if it hits the world.
    pub const fn module(self) -> Option<ModuleId> {
        Some(match self {
            Fault::Kill(id)
            | Fault::Pause(id)
            | Fault::Resume(id)
            | Fault::Restart(id)
            | Fault::Stick(id)
            | Fault::Unstick(id)
            | Fault::External(id) => id,
            Fault::World(..) => return None,
        })
    }
    /// Returns true if it makes things worse, rather than ending another fault.
    pub const fn harms(self) -> bool {
        match self {
            Fault::World(kind, _) => kind.harms,
            _ => !matches!(self, Fault::Resume(_) | Fault::Unstick(_)),
        }
    }
}

impl FromStr for Fault {
    type Err = String;

    /// Reads a fault that hits a module, as [`Display`](fmt::Display) writes it: `kill 7`.
    fn from_str(text: &str) -> Result<Fault, String> {
        let form = || {
            format!(
                "`{text}` is no fault; write one of kill, pause, resume, restart, stick, unstick, and a module, such as `kill 7`"
            )
        };
        let (verb, id) = text.trim().split_once(' ').ok_or_else(form)?;
        let id = ModuleId(id.trim().parse().map_err(|_| form())?);
        Ok(match verb {
            "kill" => Fault::Kill(id),
            "pause" => Fault::Pause(id),
            "resume" => Fault::Resume(id),
            "restart" => Fault::Restart(id),
            "stick" => Fault::Stick(id),
            "unstick" => Fault::Unstick(id),
            _ => return Err(form()),
        })
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Fault::Kill(id) => write!(f, "kill {id}"),
            Fault::Pause(id) => write!(f, "pause {id}"),
            Fault::Resume(id) => write!(f, "resume {id}"),
            Fault::Restart(id) => write!(f, "restart {id}"),
            Fault::Stick(id) => write!(f, "stick {id}"),
            Fault::Unstick(id) => write!(f, "unstick {id}"),
            Fault::World(kind, target) => write!(f, "{} {target}", kind.name),
            Fault::External(id) => write!(f, "external {id}"),
        }
    }
}

/// A fault and its visible effect at the moment of injection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultRecord {
    /// The time.
    pub at: Time,
    /// The fault.
    pub fault: Fault,
    /// The state of the module or of the world.
    pub effect: String,
}

/// A schedule of faults in the order of time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Schedule {
    faults: Vec<(Time, Fault)>,
}

impl Schedule {
    /// Creates a schedule of these faults; those of one instant keep their order.
    pub fn new(mut faults: Vec<(Time, Fault)>) -> Schedule {
        faults.sort_by_key(|(at, _)| *at);
        Schedule { faults }
    }
    /// Adds a fault at the end of those that are due at or before its time, but not before the index `first`.
    pub fn insert(&mut self, first: usize, at: Time, fault: Fault) {
        let after = first + self.faults[first..].partition_point(|(due, _)| *due <= at);
        self.faults.insert(after, (at, fault));
    }
    /// Iterates over the faults in order.
    pub fn iter(&self) -> impl Iterator<Item = &(Time, Fault)> {
        self.faults.iter()
    }
    /// Returns the number of faults.
    pub fn len(&self) -> usize {
        self.faults.len()
    }
    /// Returns true if there are no faults.
    pub fn is_empty(&self) -> bool {
        self.faults.is_empty()
    }
    /// Returns the fault with this index in the order.
    pub fn get(&self, i: usize) -> Option<(Time, Fault)> {
        self.faults.get(i).copied()
    }
}

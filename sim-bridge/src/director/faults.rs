//! Faults as data. A fault schedule is a value of its own, separate from the run that it is injected into, so
//! that it can be printed, repeated and shrunk.

use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Time;
use serde::Serialize;
use std::fmt;

/// One fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
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
    /// A foreign object comes into a cell.
    Block(Cell),
    /// The foreign object is removed.
    Unblock(Cell),
    /// A process was killed, stopped or continued from outside the run; no schedule contains this.
    External(ModuleId),
}

impl Fault {
    /// Returns the module that it hits; `None` if it hits a cell.
    pub const fn module(self) -> Option<ModuleId> {
        Some(match self {
            Fault::Kill(id)
            | Fault::Pause(id)
            | Fault::Resume(id)
            | Fault::Restart(id)
            | Fault::Stick(id)
            | Fault::Unstick(id)
            | Fault::External(id) => id,
            Fault::Block(_) | Fault::Unblock(_) => return None,
        })
    }
    /// Returns true if it makes things worse, rather than ending another fault.
    pub const fn harms(self) -> bool {
        !matches!(self, Fault::Resume(_) | Fault::Unstick(_) | Fault::Unblock(_))
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
            Fault::Block(cell) => write!(f, "block {cell}"),
            Fault::Unblock(cell) => write!(f, "unblock {cell}"),
            Fault::External(id) => write!(f, "external {id}"),
        }
    }
}

/// A fault and its visible effect at the moment of injection.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FaultRecord {
    /// The time.
    pub at: Time,
    /// The fault.
    pub fault: Fault,
    /// The state of the module or cell.
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

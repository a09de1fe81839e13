//! The events of a run as records: the content of a journal, in every driver.
//!
//! An agent's records are its inputs, each with the hash of what followed, so that a replay can hand the same
//! inputs to the same agent and compare the states. The controller's records are the inputs and outputs of
//! its world and its director. Messages are named by sender, incarnation and number, so that a message
//! received leads back to the step that sent it. Not here: files, and their layout.

use crate::agent::Summary;
use crate::counters::Class;
use crate::counters::Tally;
use crate::ids::{HostId, Incarnation, ModuleId, Port, Revision, Session};
use crate::lattice::Cell;
use crate::runtime::{Command, Sensed};
use crate::time::Time;
use crate::wire::{self, Wire, WireError};
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;
use serde::{Deserialize, Serialize};

/// A message, action, percept, order, report or place in its wire form. Its type follows from its position in
/// the record and from the family of the run.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Blob {
    /// The kind of value within its type.
    pub kind: u8,
    /// The payload.
    pub bytes: Vec<u8>,
}

impl Blob {
    /// Encodes a value.
    pub fn of<W: Wire>(value: &W) -> Blob {
        Blob { kind: value.kind(), bytes: wire::payload(value) }
    }
    /// Decodes the value, checking every field.
    pub fn read<W: Wire>(&self) -> Result<W, WireError> {
        wire::from_payload(self.kind, &self.bytes)
    }
}

/// The owner of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Who {
    /// The world-controller with the world that it hosts.
    Controller,
    /// One incarnation of an agent.
    Agent(ModuleId, Incarnation),
}

impl fmt::Display for Who {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Who::Controller => f.write_str("the controller"),
            Who::Agent(id, Incarnation(0)) => write!(f, "module {id}"),
            Who::Agent(id, incarnation) => write!(f, "module {id} in incarnation {incarnation}"),
        }
    }
}

/// One recorded event.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// The scenario time of the event.
    pub at: Time,
    /// The owner of the record.
    pub who: Who,
    /// The event.
    pub event: Event,
}

/// An event of a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// Agent: its process starts, with its body at this place.
    Born {
        /// The place of the body.
        place: Blob,
    },
    /// Agent: it took one input.
    Step(Step),
    /// Agent: its summary changed. Follows from the step before.
    State(Summary),
    /// World, input: the process of a module starts.
    Start {
        /// The module.
        id: ModuleId,
        /// Its incarnation.
        incarnation: Incarnation,
        /// The place of its body.
        place: Blob,
    },
    /// World, input: a body is asked to act.
    Act {
        /// The module.
        id: ModuleId,
        /// The number of contact changes that its agent knew of.
        revision: Revision,
        /// The action.
        action: Blob,
        /// True if the body began it. It is over with the next [`Event::Advance`] that names the module.
        begun: bool,
    },
    /// World, input: an event that was due takes place.
    Advance {
        /// The bodies whose action ended, in the order of their ends, and the place of each: a new one, or
        /// the old one if the action failed.
        ended: Vec<(ModuleId, Blob)>,
    },
    /// World, output: what a body senses.
    Sensed {
        /// The module.
        id: ModuleId,
        /// The input that the body senses.
        sensed: Sensed<Blob>,
    },
    /// World, output: an invariant broke.
    Violated {
        /// The name of the invariant.
        invariant: String,
        /// The observation.
        what: String,
    },
    /// Director, input: an agent reports its state.
    Report {
        /// The module.
        id: ModuleId,
        /// The report.
        report: Blob,
    },
    /// Director, input: a process is up and its agent has started.
    Started {
        /// The module.
        id: ModuleId,
    },
    /// Director, input: a process has ended.
    Died {
        /// The module.
        id: ModuleId,
    },
    /// Director, input: it examines the world and decides.
    Wake,
    /// Director, input: anything else that it has to take into account.
    Input {
        /// The kind of input, which defines how to read it.
        kind: String,
        /// Its content.
        bytes: Vec<u8>,
    },
    /// Director, output: a command to the driver.
    Command(Command<Blob>),
    /// Director, output: a fault was injected.
    Injected {
        /// The fault, in the words of reports.
        fault: String,
        /// The module that it hit; `None` if it hit a cell.
        module: Option<ModuleId>,
        /// The cell that it hit.
        cell: Option<Cell>,
        /// The origin, in the words of reports.
        by: String,
        /// The effect, in the words of reports.
        effect: String,
    },
    /// Driver: a controller has taken over the run.
    Resumed,
    /// Driver: a change of the scenario takes effect, such as other random numbers.
    Changed {
        /// The change, as options write it.
        change: String,
    },
    /// Driver: the records of one owner end here although the owner continued, because its file was torn or its disk
    /// was full. Its later events are missing, and what follows from them cannot be checked.
    Torn,
    /// Director, input: a process was killed, stopped or continued from outside the run, or a host was lost.
    External {
        /// The module; the first one that is lost with a host.
        id: ModuleId,
        /// The event.
        what: Outside,
    },
    /// Driver, at the end: the counters of one incarnation of an agent.
    Counted {
        /// The module.
        id: ModuleId,
        /// Its incarnation.
        incarnation: Incarnation,
        /// Its counters.
        tally: Tally,
    },
    /// Driver: the run is over; nothing follows.
    Ended {
        /// The outcome, in the words of reports.
        outcome: String,
        /// The messages of the whole run.
        tally: Tally,
    },
}

/// An event of a process, or of all processes of a host, that comes from outside its run, such as by `kill`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outside {
    /// Killed.
    Killed {
        /// The name of the signal, such as `SIGKILL`.
        signal: String,
    },
    /// Stopped.
    Stopped {
        /// The name of the signal, such as `SIGSTOP`.
        signal: String,
    },
    /// Continued after a stop from outside.
    Continued,
    /// Lost with all others of its host.
    HostLost {
        /// The host.
        host: HostId,
        /// Number of modules that are lost with it.
        modules: u32,
        /// Those of them that are started again.
        restarts: Vec<ModuleId>,
        /// Why it counts as lost, in words.
        why: String,
    },
    /// A host that was lost takes modules again.
    HostBack {
        /// The host.
        host: HostId,
        /// Modules that had no host, and are started now.
        restarts: Vec<ModuleId>,
    },
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Outside::Killed { signal } => write!(f, "killed by {signal} from outside"),
            Outside::Stopped { signal } => write!(f, "stopped by {signal} from outside"),
            Outside::Continued => f.write_str("continued by SIGCONT from outside"),
            Outside::HostBack { host, restarts } if restarts.is_empty() => {
                write!(f, "{host}: it takes modules")
            }
            Outside::HostBack { host, restarts } => {
                write!(f, "{host}: it takes modules, {} of which had no host", restarts.len())
            }
            Outside::HostLost { host, modules, restarts, why } => {
                let plural = if *modules == 1 { "" } else { "s" };
                write!(f, "{host} with {modules} module{plural}")?;
                if !restarts.is_empty() {
                    write!(f, ", of which {} start again", restarts.len())?;
                }
                write!(f, ": {why}")
            }
        }
    }
}

/// One input of an agent, and what followed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// The input.
    pub input: Consumed,
    /// The number of the first message sent; the others follow it.
    pub first: u32,
    /// The messages sent.
    pub sent: Vec<Sent>,
    /// The actions and reports, in order.
    pub told: Vec<Emitted>,
    /// The hash of all outputs and of the state after them.
    pub digest: u64,
}

/// An input as it is recorded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Consumed {
    /// The contact on a port changed.
    Contact {
        /// The port.
        port: Port,
        /// The session from now on.
        session: Option<Session>,
    },
    /// A message arrived.
    Message {
        /// The port that it came in by.
        port: Port,
        /// Its class.
        class: Class,
        /// Its name.
        name: MessageName,
        /// Its content.
        message: Blob,
    },
    /// How an action went.
    Percept(Blob),
    /// An order of the controller.
    Order(Blob),
    /// The requested wake-up time has come.
    Wake,
}

/// The name of one message of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MessageName {
    /// The sender.
    pub from: ModuleId,
    /// The incarnation of the sender.
    pub incarnation: Incarnation,
    /// Its number among all messages of that incarnation, from 0.
    pub number: u32,
}

/// One message sent; its content is in the record of its receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sent {
    /// The port that it left by.
    pub port: Port,
    /// Its class.
    pub class: Class,
    /// The module at the port; `None` if the contact had ended.
    pub to: Option<ModuleId>,
}

/// An output of an agent to its body or to the controller.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Emitted {
    /// An action.
    Act {
        /// The number of contact changes that the agent knew of.
        revision: Revision,
        /// The action.
        action: Blob,
    },
    /// A report.
    Report(Blob),
}

/// The destination of records.
pub trait Sink {
    /// Takes one record. Never fails: a sink that cannot keep records counts the lost ones.
    fn put(&mut self, record: &Record);
    /// Makes the records so far durable: their effects are about to be carried out, so they must not be lost
    /// with this process.
    fn commit(&mut self);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blobs_are_read_back_and_checked() {
        let cell = Cell::new(1, -2, 3);
        let blob = Blob::of(&cell);
        assert_eq!(blob.read::<Cell>(), Ok(cell));
        assert!(Blob { kind: 9, ..blob.clone() }.read::<Cell>().is_err());
        assert!(Blob { bytes: vec![0; 7], ..blob.clone() }.read::<Cell>().is_err());
        assert!(Blob { bytes: vec![0; 500], ..blob }.read::<Cell>().is_err());
    }
}

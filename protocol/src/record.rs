//! What happens in a run, as records: what a journal holds, whoever writes it.
//!
//! An agent's records are its inputs, each with the hash of what followed, so that the same agent can
//! be handed the same inputs again and must come to the same state. The controller's records are what
//! reached its world and its director, and what those said. Messages are named by sender, life and
//! number, so that a message heard leads back to the step that sent it. Absent: files, and their layout.

use crate::agent::Summary;
use crate::counters::Class;
use crate::counters::Tally;
use crate::ids::{Incarnation, ModuleId, Port, Revision, Session};
use crate::lattice::Cell;
use crate::runtime::{Command, Sensed};
use crate::time::Time;
use crate::wire::{self, Wire, WireError};
use serde::{Deserialize, Serialize};
use std::fmt;

/// A message, action, percept, order, report or place in its wire form. Which type it is of follows
/// from where it stands and from the family of the run.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Blob {
    /// The kind within its type.
    pub kind: u8,
    /// The payload.
    pub bytes: Vec<u8>,
}

impl Blob {
    /// The wire form of a value.
    pub fn of<W: Wire>(value: &W) -> Blob {
        Blob { kind: value.kind(), bytes: wire::payload(value) }
    }
    /// The value, every field checked.
    pub fn read<W: Wire>(&self) -> Result<W, WireError> {
        wire::from_payload(self.kind, &self.bytes)
    }
}

/// Whose record it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Who {
    /// The world-controller with the world it hosts.
    Controller,
    /// One life of an agent.
    Agent(ModuleId, Incarnation),
}

impl fmt::Display for Who {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Who::Controller => f.write_str("the controller"),
            Who::Agent(id, Incarnation(0)) => write!(f, "module {id}"),
            Who::Agent(id, life) => write!(f, "module {id} in life {life}"),
        }
    }
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// When, in scenario time.
    pub at: Time,
    /// Whose record it is.
    pub who: Who,
    /// What happened.
    pub event: Event,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Event {
    /// Agent: it begins, with its body at this place.
    Born {
        /// Where the body stands.
        place: Blob,
    },
    /// Agent: it took one input.
    Step(Step),
    /// Agent: what it is about is not what it was. Follows from the step before.
    State(Summary),
    /// World, input: the process of a module starts.
    Start {
        /// Which module.
        id: ModuleId,
        /// Which life of it.
        life: Incarnation,
        /// Where its body stands.
        place: Blob,
    },
    /// World, input: a body is asked to act.
    Act {
        /// Which module.
        id: ModuleId,
        /// The contact changes that its agent knew of.
        revision: Revision,
        /// What it asks for.
        action: Blob,
        /// Whether the body began it. It is over with the [`Event::Advance`] that names the module next.
        begun: bool,
    },
    /// World, input: what was due has come.
    Advance {
        /// The bodies whose action ended, in the order of their ends, and where each stands now: elsewhere,
        /// or where it was if the action failed.
        ended: Vec<(ModuleId, Blob)>,
    },
    /// World, output: what a body senses.
    Sensed {
        /// Which module.
        id: ModuleId,
        /// What.
        sensed: Sensed<Blob>,
    },
    /// World, output: an invariant broke.
    Violated {
        /// The name of the invariant.
        invariant: String,
        /// What was seen.
        what: String,
    },
    /// Director, input: an agent reports its state.
    Report {
        /// Which module.
        id: ModuleId,
        /// What it says.
        report: Blob,
    },
    /// Director, input: a process is up and its agent has started.
    Started {
        /// Which module.
        id: ModuleId,
    },
    /// Director, input: a process is gone.
    Died {
        /// Which module.
        id: ModuleId,
    },
    /// Director, input: it looks at the world and decides.
    Wake,
    /// Director, input: anything else that it has to take into account.
    Input {
        /// What it is, which says how to read it.
        kind: String,
        /// Its content.
        bytes: Vec<u8>,
    },
    /// Director, output: what it wants done.
    Command(Command<Blob>),
    /// Director, output: a fault of the scenario has struck.
    Struck {
        /// The fault, in the words of reports.
        fault: String,
        /// Whom it hit, unless it hit a cell.
        module: Option<ModuleId>,
        /// The cell that it hit.
        cell: Option<Cell>,
        /// The state it found.
        effect: String,
    },
    /// Driver: the controller was gone, and goes on from here.
    Resumed,
    /// Driver: the records of somebody end here although it went on, because its file was torn or its
    /// disk full. What follows from them cannot be checked.
    Torn,
    /// Director, input: something outside the run did this to a process.
    External {
        /// Which module.
        id: ModuleId,
        /// What.
        what: Outside,
    },
    /// Driver, at the end: what one life of an agent has counted.
    Counted {
        /// Which module.
        id: ModuleId,
        /// Which life of it.
        life: Incarnation,
        /// What it counted.
        tally: Tally,
    },
    /// Driver: the run is over; nothing follows.
    Ended {
        /// How, in the words of reports.
        outcome: String,
        /// Messages of the whole run.
        tally: Tally,
    },
}

/// What something outside a run, such as a person with `kill`, does to a process of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outside {
    /// Ends it.
    Killed {
        /// The name of the signal, such as `SIGKILL`.
        signal: String,
    },
    /// Stops it.
    Stopped {
        /// The name of the signal, such as `SIGSTOP`.
        signal: String,
    },
    /// Lets a process go on that was stopped from outside.
    Continued,
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Outside::Killed { signal } => write!(f, "killed by {signal} from outside"),
            Outside::Stopped { signal } => write!(f, "stopped by {signal} from outside"),
            Outside::Continued => f.write_str("continued by SIGCONT from outside"),
        }
    }
}

/// One input of an agent, and what followed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// The input.
    pub input: Taken,
    /// The number of the first message sent; the others follow it.
    pub first: u32,
    /// The messages sent.
    pub sent: Vec<Sent>,
    /// What was asked of the body and told to the controller, in order.
    pub told: Vec<Told>,
    /// The hash of all outputs and of the state after them.
    pub digest: u64,
}

/// An input as it is recorded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Taken {
    /// The contact on a port changed.
    Contact {
        /// Which port.
        port: Port,
        /// The session that holds from now on.
        session: Option<Session>,
    },
    /// A message arrived.
    Message {
        /// The port it came in by.
        port: Port,
        /// What it is for.
        class: Class,
        /// Which message of whom it is.
        name: MessageName,
        /// What it says.
        message: Blob,
    },
    /// How an action went.
    Percept(Blob),
    /// What the controller wants.
    Order(Blob),
    /// The time asked for has come.
    Wake,
}

/// Names one message of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MessageName {
    /// Who sent it.
    pub from: ModuleId,
    /// In which life.
    pub life: Incarnation,
    /// Its number among all messages of that life, from 0.
    pub number: u32,
}

/// One message sent; what it says is found where it was heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sent {
    /// The port it left by.
    pub port: Port,
    /// What it is for.
    pub class: Class,
    /// Who was there; nobody if the contact had ended.
    pub to: Option<ModuleId>,
}

/// What an agent told its body or the controller.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Told {
    /// An action asked for.
    Act {
        /// The contact changes that the agent knew of.
        revision: Revision,
        /// What it asks for.
        action: Blob,
    },
    /// A report.
    Report(Blob),
}

/// Where records go.
pub trait Sink {
    /// Takes one record. Never fails: what cannot be kept is counted where it is lost.
    fn put(&mut self, record: &Record);
    /// What was put so far is about to be acted on, so it must not be lost with this process.
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

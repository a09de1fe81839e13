//! The one trait every protocol implements, and the inputs and outputs it is driven with.
//!
//! An agent is a state machine without IO. A driver (the simulator, an agent process, a network
//! bridge) hands in one [`Input`] at a time with the current time, polls [`Agent::poll`] until it
//! is empty, and asks [`Agent::wake_at`] when to come back. Nothing else may change an agent.
//! Deliberately absent: everything that differs between drivers.

use crate::counters::Class;
use crate::ids::{Incarnation, ModuleId, Port, Session};
use crate::time::Time;
use crate::wire::Wire;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::hash::Hasher;
use std::sync::Arc;

/// What an agent is about, in terms that all families share; for whoever looks on. No protocol depends
/// on it.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Its part, such as `reserve`, `walker`, `final`, or `free`, `settled`.
    pub role: String,
    /// What it does at the moment, such as `moving`.
    pub activity: String,
    /// Which goal it works for.
    pub goal: u16,
    /// Its depth in the structure that it hangs on; for metamodules, the seed it fills or goes to.
    pub level: Option<u16>,
    /// How far it is to what attracts it, in moves times the unit of its family.
    pub gradient: Option<u32>,
    /// Whom it has promised to keep space or stand still for.
    pub lock: Option<ModuleId>,
    /// Whom it waits for.
    pub waits_for: Option<ModuleId>,
}

/// What an agent knows when its process starts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Birth<P> {
    /// Which module it is.
    pub id: ModuleId,
    /// Which life of it this is. Above 0 the agent has lost its memory and must ask around first.
    pub incarnation: Incarnation,
    /// Where its body stands.
    pub place: P,
    /// The seed of the run, from which the agent's own random stream is derived.
    pub seed: u64,
}

/// What happens to an agent.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Input<M, P, O> {
    /// The contact on a port changed: a new session, or none.
    Contact {
        /// Which port.
        port: Port,
        /// The session that holds from now on; none if nothing touches the port.
        session: Option<Session>,
    },
    /// A message arrived in the current session of a port. Drivers drop all others.
    Message {
        /// The port it came in by.
        port: Port,
        /// What it says.
        message: M,
    },
    /// The body tells how an action went.
    Percept(P),
    /// The world-controller wants something.
    Order(O),
    /// The time that [`Agent::wake_at`] named has come.
    Wake,
}

/// What an agent does.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output<M, A, R> {
    /// Send a message over the current session of a port.
    Send {
        /// The port to send by.
        port: Port,
        /// What the message is for.
        class: Class,
        /// What it says.
        message: M,
    },
    /// Ask the body to act. The answer comes as a percept.
    Act(A),
    /// Tell the world-controller something. Reports are not protocol messages.
    Report(R),
}

/// [`Input`] of an agent.
pub type InputOf<A> = Input<<A as Agent>::Message, <A as Agent>::Percept, <A as Agent>::Order>;
/// [`Output`] of an agent.
pub type OutputOf<A> = Output<<A as Agent>::Message, <A as Agent>::Action, <A as Agent>::Report>;

/// A protocol of one kind of unit.
///
/// Its state is made of integers and a shared [`Agent::Setup`], so that the same inputs give the
/// same outputs on every machine.
pub trait Agent: Sized {
    /// What all agents of a swarm share and nobody changes: parameters, goals.
    type Setup: Serialize + DeserializeOwned + Send + Sync + 'static;
    /// Where a body stands when its agent starts.
    type Place: Wire;
    /// What agents say to each other.
    type Message: Wire;
    /// What an agent asks of its body.
    type Action: Wire;
    /// How an action went.
    type Percept: Wire;
    /// What the world-controller asks of an agent.
    type Order: Wire;
    /// What an agent tells the world-controller.
    type Report: Wire;

    /// The number of ports of a unit, at most 32.
    const PORTS: usize;

    /// A new agent. All its contacts follow as inputs before anything else.
    fn new(setup: &Arc<Self::Setup>, birth: Birth<Self::Place>, now: Time) -> Self;

    /// Takes one input at time `now`. Times never go back.
    fn handle(&mut self, now: Time, input: InputOf<Self>);

    /// The next output, in order; none when there is nothing more to do until the next input.
    fn poll(&mut self) -> Option<OutputOf<Self>>;

    /// When the agent wants [`Input::Wake`] at the latest. Changes only in `new` and `handle`.
    fn wake_at(&self) -> Time;

    /// Feeds the state of the protocol into a hash, to tell runs apart: in a fixed order and form (see
    /// [`crate::digest`]), without caches, times to be woken at, and outputs.
    fn digest(&self, hasher: &mut dyn Hasher);

    /// What it is about, for whoever looks on at a run or its journal.
    fn summary(&self, _now: Time) -> Summary {
        Summary::default()
    }
}

//! The one trait every protocol implements, and the inputs and outputs it is driven with.
//!
//! An agent is a state machine without IO. A driver (the simulator, an agent process, a network bridge) hands
//! in one [`Input`] at a time with the current time, calls [`Agent::poll`] until it returns `None`, and asks
//! [`Agent::wake_at`] when to come back. Nothing else may change an agent, with one exception, [`Agent::reseed`]. Not here: everything that differs
//! between drivers.

use crate::counters::Class;
use crate::ids::{Incarnation, ModuleId, Port, Session};
use crate::time::Time;
use crate::wire::Wire;
use alloc::string::String;
use alloc::sync::Arc;
use core::hash::Hasher;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// The state of an agent in terms that all families share, for viewers and journals. No protocol depends on
/// it.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// The role of the module: for cubes `reserve`, `walker` or `final`, for metamodules `free`, `claiming` or
    /// `settled`.
    pub role: String,
    /// The current activity, such as `moving`.
    pub activity: String,
    /// The number of the goal that the agent works for.
    pub goal: u16,
    /// The depth in the parent forest; for metamodules, the seed that it fills or goes to.
    pub level: Option<u16>,
    /// For cubes the distance to the nearest target, in sixteenths of a move; for metamodules the cost of the claim.
    pub gradient: Option<u32>,
    /// The module that holds a lock granted by this one, which has promised to stay or to keep cells free for it.
    pub lock: Option<ModuleId>,
    /// The module that this one waits for.
    pub waits_for: Option<ModuleId>,
}

/// Knowledge of an agent when its process starts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Birth<P> {
    /// The module.
    pub id: ModuleId,
    /// The incarnation. Above 0 the agent has lost its memory and must ask its neighbours first.
    pub incarnation: Incarnation,
    /// The place of the body.
    pub place: P,
    /// The seed of the run, from which the agent's own random stream is derived.
    pub seed: u64,
    /// When the process was started, by the controller's clock. Unlike times of the agent's own clock, these can be
    /// compared with those of agents on other hosts.
    pub born: Time,
}

/// An event that an agent handles.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Input<M, P, O> {
    /// The contact on a port changed.
    Contact {
        /// The port.
        port: Port,
        /// The session from now on; `None` if nothing touches the port.
        session: Option<Session>,
    },
    /// A message arrived in the current session of a port. Drivers drop all others.
    Message {
        /// The port that it came in by.
        port: Port,
        /// Its content.
        message: M,
    },
    /// The body tells how an action went.
    Percept(P),
    /// An order of the world-controller.
    Order(O),
    /// The time returned by [`Agent::wake_at`] has come.
    Wake,
}

/// An effect that an agent asks its driver for.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output<M, A, R> {
    /// Send a message over the current session of a port.
    Send {
        /// The port to send by.
        port: Port,
        /// The class of the message, for the counters.
        class: Class,
        /// Its content.
        message: M,
    },
    /// Ask the body to act. The answer comes as a percept.
    Act(A),
    /// Report to the world-controller. Reports are not protocol messages.
    Report(R),
}

/// [`Input`] of an agent.
pub type InputOf<A> = Input<<A as Agent>::Message, <A as Agent>::Percept, <A as Agent>::Order>;
/// [`Output`] of an agent.
pub type OutputOf<A> = Output<<A as Agent>::Message, <A as Agent>::Action, <A as Agent>::Report>;

/// The protocol of one family of modules.
///
/// Its state is made of integers and a shared [`Agent::Setup`], so that the same inputs give the
/// same outputs on every machine.
pub trait Agent: Sized + Send + Sync + 'static {
    /// Constant data that all agents of a swarm share: parameters, goals.
    type Setup: Serialize + DeserializeOwned + Send + Sync + 'static;
    /// The place of a body when its agent starts.
    type Place: Wire;
    /// Messages between agents.
    type Message: Wire;
    /// Actions that an agent asks of its body.
    type Action: Wire;
    /// Answers of a body to the actions of its agent.
    type Percept: Wire;
    /// Orders of the world-controller to an agent.
    type Order: Wire;
    /// Reports of an agent to the world-controller.
    type Report: Wire;

    /// The number of ports of a module, at most [`PortSet::CAPACITY`](crate::ids::PortSet::CAPACITY).
    const PORTS: usize;

    /// Creates an agent. All its contacts follow as inputs before anything else.
    fn new(setup: &Arc<Self::Setup>, birth: Birth<Self::Place>, now: Time) -> Self;

    /// Takes one input at time `now`. Times never go back.
    fn handle(&mut self, now: Time, input: InputOf<Self>);

    /// Returns the next output, in order; `None` if there is nothing more to do until the next input.
    fn poll(&mut self) -> Option<OutputOf<Self>>;

    /// Returns the latest time at which the agent wants [`Input::Wake`]. Changes only in `new` and `handle`.
    fn wake_at(&self) -> Time;

    /// Draws from a stream of another seed from now on. A simulator calls this between two inputs, to ask how a run would have
    /// continued with other random numbers. Does nothing by default, for agents that draw nothing.
    fn reseed(&mut self, _seed: u64) {}

    /// Feeds the state of the protocol into a hash that tells runs apart: in a fixed order and form (see
    /// [`crate::digest`]), without caches, wake-up times and outputs.
    fn digest(&self, hasher: &mut dyn Hasher);

    /// Reads the memory that the next message on a port will need, and changes nothing. Returns a value that depends on all that
    /// was read. A simulation of many agents calls this some messages ahead: most of these reads miss the cache, and overlapping
    /// misses take about as long as one. Reads nothing by default.
    fn look_ahead(&self, _port: Port) -> u64 {
        0
    }

    /// Returns a summary of the state, for viewers and journals.
    fn summary(&self, _now: Time) -> Summary {
        Summary::default()
    }
}

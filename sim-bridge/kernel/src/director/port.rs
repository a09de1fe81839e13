//! The interface between a driver and the director.
//!
//! The director is a state machine like the agents: drivers hand it events and carry out its commands, either in
//! virtual time or with signals to real processes.

use crate::director::faults::FaultRecord;
use crate::director::rescue::Rescue;
use crate::world::World;
use metamorph_core::agent::Agent;
use metamorph_core::ids::ModuleId;
use metamorph_core::record::Outside;
use metamorph_core::runtime::Command;
use metamorph_core::time::Time;

/// The director, as drivers see it.
pub trait DirectorPort<W: World> {
    /// Takes the report of an agent.
    fn report(&mut self, now: Time, id: ModuleId, report: <W::Agent as Agent>::Report);
    /// Notes that a process has ended, for any reason.
    fn died(&mut self, now: Time, id: ModuleId);
    /// Notes that a process was killed, stopped or continued from outside the run. For a death,
    /// [`DirectorPort::died`] is called as well, after this.
    fn external(&mut self, _now: Time, _id: ModuleId, _what: &Outside, _world: &W) {}
    /// Notes that a process is up and its agent has started.
    fn started(&mut self, now: Time, id: ModuleId);
    /// Notes that the time of [`DirectorPort::wake_at`] has come, or that bodies have moved. `world` has been
    /// advanced.
    fn wake(&mut self, now: Time, world: &mut W);
    /// Takes an input that is neither a report nor a change of a process: a command of a person, or anything
    /// else that is not determined by scenario and seed. `kind` defines how to read `bytes`.
    ///
    /// # Errors
    /// Returns what is wrong with the input. By default a director takes no kind.
    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        let _ = (now, bytes);
        Err(format!("this director takes no input of kind `{kind}`"))
    }
    /// Draws from another seed from now on, as [`Agent::reseed`] does. Does nothing by default, for directors that draw nothing.
    fn reseed(&mut self, _seed: u64) {}
    /// Helps a swarm that stands still as far as this from now on. Does nothing by default, for families without a rescue.
    fn set_rescue(&mut self, _level: Rescue) {}
    /// Returns the latest time at which to wake the director.
    fn wake_at(&self) -> Time;
    /// Returns the next command, in order. Polled after every other call.
    fn poll(&mut self) -> Option<Command<<W::Agent as Agent>::Order>>;
    /// Returns the effects of the faults injected so far.
    fn struck(&self) -> &[FaultRecord] {
        &[]
    }
    /// Makes the decisions so far durable, as they are about to be carried out: a recording director commits
    /// its journal.
    fn commit(&mut self) {}
}

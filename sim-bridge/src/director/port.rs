//! The seam between a driver and the world-controller's brain.
//!
//! The controller is a state machine like the agents: drivers tell it what happened and carry out
//! the commands it gives, with events in virtual time or with real signals to real processes.

use crate::director::faults::Struck;
use crate::world::World;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;

/// The controller's brain, as drivers see it.
pub trait Direct<W: World> {
    /// An agent reports.
    fn report(&mut self, now: Time, id: ModuleId, report: <W::Agent as Agent>::Report);
    /// A process is gone, for whatever reason.
    fn died(&mut self, now: Time, id: ModuleId);
    /// Something outside the run did this to a process. A death is told by [`Direct::died`] as well, after
    /// this.
    fn external(&mut self, _now: Time, _id: ModuleId, _what: &Outside, _world: &W) {}
    /// A process is up and its agent has started.
    fn started(&mut self, now: Time, id: ModuleId);
    /// The time of [`Direct::wake_at`] has come, or bodies have moved. `world` has been advanced.
    fn wake(&mut self, now: Time, world: &mut W);
    /// Takes an input that is neither a report nor a change of a process: a command of a person, or
    /// anything else that is not decided by scenario and seed. `kind` says how to read `bytes`.
    ///
    /// # Errors
    /// Says what is wrong with it. A director takes no kind unless it says so.
    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        let _ = (now, bytes);
        Err(format!("this director takes no input of kind `{kind}`"))
    }
    /// When to wake the controller at the latest.
    fn wake_at(&self) -> Time;
    /// The next command, in order. Asked after every other call.
    fn poll(&mut self) -> Option<Command<<W::Agent as Agent>::Order>>;
    /// What each fault of the scenario did, as far as they have struck.
    fn struck(&self) -> &[Struck] {
        &[]
    }
    /// What was decided so far is about to be carried out. Whoever keeps a journal makes it safe now.
    fn commit(&mut self) {}
}

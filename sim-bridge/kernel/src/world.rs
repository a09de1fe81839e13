//! The interface of a simulated world to the drivers: bodies that act and sense.
//!
//! A world is ground truth. Agents never read it; drivers carry actions to it and percepts back. There is one
//! implementation per family; the runtime does not depend on the family.

pub mod body_queue;
pub mod contact_graph;
pub mod grid;
pub mod invariants;

use metamorph_core::agent::Agent;
use metamorph_core::ids::{Incarnation, ModuleId, Revision};
use metamorph_core::runtime::Sensed;
use metamorph_core::time::Time;
use std::hash::Hasher;

/// A simulated world with the bodies in it.
///
/// Drivers call [`World::advance`] with the current time before anything else they do at that time, so that
/// events that were due earlier have happened before a later action is judged.
pub trait World {
    /// The agents whose bodies these are.
    type Agent: Agent;

    /// Returns the number of bodies; their ids are `0..len`.
    fn len(&self) -> usize;
    /// Returns true if there is no body.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the place of a body.
    fn place(&self, id: ModuleId) -> <Self::Agent as Agent>::Place;

    /// Starts (or restarts) the process of a module. Its contacts get new sessions; the module hears of all
    /// of them, each neighbour of its own.
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation);

    /// Asks a body to act, for an agent that had seen its contacts up to `sensed`. The answer comes as a
    /// percept, at once or later.
    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &<Self::Agent as Agent>::Action);

    /// Returns when the next event is due.
    fn next_event(&self) -> Time;

    /// Completes all events that are due at or before `now`, in the order in which they are due.
    fn advance(&mut self, now: Time);

    /// Feeds the state of the bodies into a hash, as [`Agent::digest`] does for an agent. Does nothing by
    /// default, for worlds without changes.
    fn digest(&self, _hasher: &mut dyn Hasher) {}

    /// Reads the memory of a body that an audit of its module needs, as [`Agent::look_ahead`] does for an agent. Reads nothing by
    /// default.
    fn look_ahead(&self, _id: ModuleId) -> u64 {
        0
    }

    /// Lets everything that draws in the world draw from another seed, as [`Agent::reseed`] does for an agent. Does nothing by
    /// default.
    fn reseed(&mut self, _seed: u64) {}

    /// Returns what bodies sensed, in order.
    fn poll(&mut self) -> Option<(ModuleId, Sensed<<Self::Agent as Agent>::Percept>)>;
}

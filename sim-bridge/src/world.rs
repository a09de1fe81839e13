//! What a simulated world offers to the drivers: bodies that act and sense.
//!
//! A world is ground truth. Agents never read it; drivers carry actions to it and percepts back.
//! One implementation per family of units; the runtime does not know which one it runs.

pub mod grid;
pub mod invariants;

use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::Time;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::hash::Hasher;

/// A simulated world with the bodies in it.
///
/// Drivers call [`World::advance`] with the current time before anything else they do at that time,
/// so that what was due earlier has happened before a later action is judged.
pub trait World {
    /// The agents whose bodies these are.
    type Agent: Agent;

    /// The number of bodies; their ids are `0..len`.
    fn len(&self) -> usize;
    /// Whether there is no body at all.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Where a body stands.
    fn place(&self, id: ModuleId) -> <Self::Agent as Agent>::Place;

    /// The process of a module starts (again). Its contacts get new sessions; the module and its
    /// neighbours hear of them, the module of all it has.
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation);

    /// A body is asked to act by an agent that had seen its contacts up to `sensed`.
    /// The answer comes as a percept, at once or later.
    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &<Self::Agent as Agent>::Action);

    /// When something that is under way is due next.
    fn next_event(&self) -> Time;

    /// Completes everything that is due at or before `now`, in the order in which it is due.
    fn advance(&mut self, now: Time);

    /// Feeds the state of the bodies into a hash, as [`Agent::digest`] does for an agent. Nothing by default,
    /// for worlds in which nothing changes.
    fn digest(&self, _hasher: &mut dyn Hasher) {}

    /// What bodies sensed, in order.
    fn poll(&mut self) -> Option<(ModuleId, Sensed<<Self::Agent as Agent>::Percept>)>;
}

/// What is under way in the order in which it ends, for comparing worlds: not how it lies in the heap.
pub(crate) fn due(heap: &BinaryHeap<Reverse<(Time, u64, ModuleId)>>) -> Vec<(Time, ModuleId)> {
    let mut all: Vec<_> = heap.iter().map(|Reverse(due)| *due).collect();
    all.sort_unstable();
    all.into_iter().map(|(at, _, id)| (at, id)).collect()
}

//! The world-controller of an exploration.

use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::world::World;
use std::hash::Hash;

/// The part of the world-controller that is explored: what it knows, and its orders.
pub trait Controller<W: World>: Clone + Hash + Send + Sync {
    /// Notes that the process of a module was killed.
    fn died(&mut self, now: Time, id: ModuleId);
    /// Notes that it was started again.
    fn started(&mut self, id: ModuleId);
    /// Takes up a report.
    fn report(&mut self, id: ModuleId, report: &<W::Agent as Agent>::Report);
    /// Returns the orders that follow.
    fn orders(&mut self, now: Time, world: &W) -> Vec<(ModuleId, <W::Agent as Agent>::Order)>;
}

/// No controller.
impl<W: World> Controller<W> for () {
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: ModuleId) {}
    fn report(&mut self, _: ModuleId, _: &<W::Agent as Agent>::Report) {}
    fn orders(&mut self, _: Time, _: &W) -> Vec<(ModuleId, <W::Agent as Agent>::Order)> {
        Vec::new()
    }
}

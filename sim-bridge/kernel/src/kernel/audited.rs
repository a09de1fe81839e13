//! Audits: what a world may check of agents, and how it reads them in any driver.

use crate::world::World;
use crate::world::invariants::Violation;
use metamorph_core::ids::ModuleId;
use metamorph_core::link::ClockOffset;
use metamorph_core::time::Time;

/// A world whose agents can be audited: the invariants that involve agents and the world. By default there are none.
pub trait Audited: World {
    /// Checks what one agent's last input may have broken. An implementation may remember what it has checked
    /// and found sound.
    fn audit_agent(
        &mut self,
        _now: Time,
        _id: ModuleId,
        _agents: &Agents<'_, Self::Agent>,
        _found: &mut Vec<Violation>,
    ) {
    }
    /// Checks an action at the moment the world has accepted or refused it.
    fn audit_action(
        &self,
        _now: Time,
        _id: ModuleId,
        _agents: &Agents<'_, Self::Agent>,
        _found: &mut Vec<Violation>,
    ) {
    }
    /// Checks everything, at intervals.
    fn audit_all(&mut self, _now: Time, _agents: &Agents<'_, Self::Agent>, _found: &mut Vec<Violation>) {}
    /// Takes the violations that the world itself has found.
    fn take_violations(&mut self) -> Vec<Violation> {
        Vec::new()
    }
}

/// A driver that lets audits read its agents.
pub trait Swarm<A> {
    /// Returns the number of modules.
    fn modules(&self) -> usize;
    /// Returns the agent of the module with this number, if its process lives.
    fn living(&self, index: usize) -> Option<&A>;
    /// Returns the agent of the module with this number, or its last state if its process has died.
    fn last(&self, index: usize) -> Option<&A>;
    /// Returns the clock that the agent of the module with this number reads. By default all read the controller's.
    fn clock(&self, _index: usize) -> ClockOffset {
        ClockOffset::default()
    }
}

/// Read access to the living agents, for audits.
pub struct Agents<'a, A> {
    swarm: &'a dyn Swarm<A>,
}

impl<'a, A> Agents<'a, A> {
    /// Creates access to the agents of a swarm.
    pub fn of(swarm: &'a dyn Swarm<A>) -> Agents<'a, A> {
        Agents { swarm }
    }
    /// Returns the agent of a module, if its process lives.
    pub fn get(&self, id: ModuleId) -> Option<&A> {
        self.swarm.living(id.index())
    }
    /// Returns the agent of a module, or its last state if its process has died.
    pub fn last(&self, id: ModuleId) -> Option<&A> {
        self.swarm.last(id.index())
    }
    /// Returns the clock of a module's agent. Times in the state of an agent are times of its clock.
    pub fn clock(&self, id: ModuleId) -> ClockOffset {
        self.swarm.clock(id.index())
    }
    /// Iterates over all living agents.
    pub fn iter(&self) -> impl Iterator<Item = (ModuleId, &A)> {
        (0..self.swarm.modules() as u32).map(ModuleId).filter_map(|id| self.get(id).map(|a| (id, a)))
    }
}

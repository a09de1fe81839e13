//! Copies of a run.

use super::{Sim, SimConfig};
use crate::director::port::DirectorPort;
use crate::kernel::audited::Audited;
use std::sync::Arc;

impl<W: Audited, D: DirectorPort<W>> Sim<W, D> {
    /// Returns a copy of the run, which goes on independently: both take the same events from here on, until one of them is given
    /// an input that the other is not given. Setup and hosts are shared; a change of hosts makes a copy of them. `None` if the run is recorded:
    /// two runs cannot continue one journal.
    pub fn fork(&self) -> Option<Self>
    where
        W: Clone,
        D: Clone,
        W::Agent: Clone,
    {
        if self.log.is_some() {
            return None;
        }
        let (setup, link) = (Arc::clone(&self.config.setup), self.config.link.clone());
        let config = SimConfig { setup, link, ..self.config };
        Some(Sim {
            config,
            now: self.now,
            world: self.world.clone(),
            director: self.director.clone(),
            modules: self.modules.clone(),
            links: self.links.clone(),
            backlogs: self.backlogs.clone(),
            queue: self.queue.clone(),
            parcels: self.parcels.clone(),
            hosts: self.hosts.clone(),
            controller: self.controller.clone(),
            posted: self.posted.clone(),
            control: self.control,
            tally: self.tally,
            latencies: self.latencies.clone(),
            body_messages: self.body_messages,
            trace: self.trace.clone(),
            states: self.states.clone(),
            findings: self.findings.clone(),
            next_audit: self.next_audit,
            instant: self.instant,
            changes: self.changes.clone(),
            births: self.births,
            finished: self.finished,
            audited: self.audited,
            log: None,
        })
    }
}

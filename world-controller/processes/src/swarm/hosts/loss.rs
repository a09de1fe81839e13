//! Hosts that are lost, and hosts that come back: the end of all agents of a host in one instant, other homes for its modules
//! if the scenario wants that, and daemons that serve the run again.

use super::daemon::OWN_COUNTERS;
use super::messages::ToDaemon;
use super::parts::Collected;
use super::reach::Reached;
use super::remains::mark_collected;
use super::shared::Shared;
use super::succession::Succession;
use crate::swarm::launcher::Event;
use crate::swarm::run_dir::{RunDir, kill_agents};
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFile};
use metamorph_module_agent::run_dir::run_name::RunName;
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_module_agent::transport::AgentKey;
use metamorph_protocol::ids::{HostId, ModuleId};
use metamorph_protocol::link::Lost;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Returns why the counts of agents of a host cannot be had.
pub fn counts_are_lost(host: HostId) -> String {
    format!("{host} was lost, and the counts of its agents with it")
}

impl Shared {
    /// Takes over the run directory of a host whose daemon is dead, so that its counters can be read and are removed in
    /// the end. A daemon that lives removes it itself, after they have been read. Returns true if the daemon is dead, and its
    /// agents with it.
    pub fn inherit(&mut self, host: HostId) -> bool {
        let root = self.fleet.roots.get(&host).and_then(Option::as_ref);
        let Some(name) = root.and_then(|root| RunName::of_root(root).ok()) else { return false };
        match RunDir::adopt(name) {
            Ok(dir) => {
                // They die with their daemon; this waits for the last of them.
                kill_agents(dir.root());
                self.inherited.insert(host, dir);
                true
            }
            Err(e) => {
                tracing::debug!("the directory of {host} is not taken over: {e}");
                false
            }
        }
    }

    /// Returns the run directory of a host of this machine that is still there.
    pub fn root_of(&self, host: HostId) -> Option<&Path> {
        self.fleet.roots.get(&host)?.as_deref().filter(|root| root.is_dir())
    }

    /// Reads counters of a host that is lost.
    pub fn left_counters(
        &self,
        host: HostId,
        (id, incarnation): AgentKey,
    ) -> Result<Option<AgentCounters>, String> {
        let root = self.root_of(host).ok_or_else(|| counts_are_lost(host))?;
        CounterFile::read(root, id, incarnation).map_err(|e| e.to_string())
    }

    /// Ends all agents of a host that is lost, and asks its daemon to come back. Their counters outlive them on this machine.
    pub fn lose(&mut self, host: HostId, why: &str) {
        self.lose_for(host, why, false);
        self.call_back(host);
    }

    /// Ends all agents of a host that is lost, unless that has been done. `is_back` says that its daemon serves the run again
    /// already, so that its modules keep their home.
    pub fn lose_for(&mut self, host: HostId, why: &str, is_back: bool) {
        if self.lost.contains_key(&host) {
            return;
        }
        self.lost.insert(host, why.to_owned());
        tracing::error!("{host} is lost: {why}");
        if !self.inherited.contains_key(&host) && !self.inherit(host) {
            // Its daemon lives, and may be stopped: its agents must have ended before they are counted.
            self.root_of(host).map(kill_agents);
        }
        if let Ok(Some(counters)) = self.left_counters(host, OWN_COUNTERS) {
            self.accounts.insert(host, (counters, BTreeMap::new()));
        }
        let gone: Vec<AgentKey> = self.away.keys().copied().filter(|a| self.home(*a) == host).collect();
        for agent in &gone {
            self.away.remove(agent);
            self.counters.insert(*agent, self.left_counters(host, *agent));
        }
        // Hosts that do not watch each other learn that messages to it have nowhere to go.
        self.node.give_up(host);
        let others: Vec<HostId> = self.present();
        others.into_iter().for_each(|other| self.node.tell(other, &ToDaemon::Lost(host)));
        // Without agents it was lost before this controller took over, which asks for them then.
        if !gone.is_empty() {
            let restarts = self.restarts(host, &gone, is_back);
            self.events.push_back(Event::HostLost { host, why: why.to_owned(), agents: gone, restarts });
        }
        if let Some(Err(e)) = self.root_of(host).map(mark_collected) {
            tracing::debug!("{host} is not told that its counts are taken: {e}");
        }
    }

    /// Gives the modules of a lost host other homes, if the scenario wants that and it is not back already. Returns those of
    /// `gone` that can be started again; the others wait for a host that comes back.
    pub fn restarts(&mut self, host: HostId, gone: &[AgentKey], is_back: bool) -> Vec<ModuleId> {
        if self.node.hosts().lost() == Lost::Crash {
            return Vec::new();
        }
        let gone = gone.iter().map(|(id, _)| *id);
        if is_back {
            return gone.collect();
        }
        let moved: BTreeSet<ModuleId> = self.move_homes(host).into_iter().collect();
        let (restarts, stranded): (Vec<_>, Vec<_>) = gone.partition(|id| moved.contains(id));
        self.stranded.extend(stranded);
        restarts
    }

    /// Gives the modules of a host other homes where there is room, and tells all hosts. Returns the modules that have moved.
    pub fn move_homes(&mut self, host: HostId) -> Vec<ModuleId> {
        let Shared { node, fleet, lost, .. } = self;
        let moved = node.change_homes(|hosts| {
            lost.keys().for_each(|lost| hosts.go_down(*lost));
            hosts.lose(host, |other| fleet.rooms.get(&other).copied().unwrap_or(usize::MAX))
        });
        self.former.extend(moved.iter().map(|id| (*id, host)));
        let homes = self.node.hosts().homes().to_vec();
        for other in self.present() {
            self.node.tell(other, &ToDaemon::Homes(homes.clone()));
        }
        self.write_hosts();
        moved
    }

    /// Writes where modules and daemons are, for agents that start and for a controller that takes over.
    pub fn write_hosts(&self) {
        let (hosts, roots) = (self.node.hosts(), &self.fleet.roots);
        let parts = self.collected.as_ref().map(Collected::directory);
        let written = swarm_file::move_homes(&self.root, hosts)
            .and_then(|()| Succession::change(&self.root, hosts, roots))
            .and_then(|()| parts.map_or(Ok(()), |parts| Succession::change(parts, hosts, roots)));
        if let Err(e) = written {
            tracing::error!("the new homes of modules cannot be written: {e}");
        }
    }

    /// Asks the daemon of a host that is not heard to serve the run again, if modules are started again.
    pub fn call_back(&mut self, host: HostId) {
        let hosts = self.node.hosts();
        if hosts.lost() == Lost::Crash {
            return;
        }
        if let Some((address, opening)) = self.fleet.calls_back(host, hosts) {
            self.returning.ask(&self.fleet.reach, host, address, opening);
        }
    }

    /// Takes a daemon that serves the run again. If the host has not counted as lost yet, its modules stay at home there.
    pub fn welcome(&mut self, host: HostId, reached: Reached) {
        let is_early = !self.lost.contains_key(&host);
        if is_early {
            self.lose_for(host, "its daemon was started again, which ended its agents", true);
        }
        self.node.renew(&self.fleet.own, host);
        let attached = self.fleet.welcome(host, reached).and_then(|line| self.node.attach(host, line));
        if let Err(e) = attached {
            tracing::warn!("{host} is back and cannot be reached: {e}");
            return self.call_back(host);
        }
        tracing::warn!("{host} is back");
        self.lost.remove(&host);
        self.inherited.remove(&host);
        self.drained.remove(&host);
        match self.accounts.remove(&host) {
            Some(account) => self.ended_shares.push(account.0),
            None => drop(self.uncounted.insert(host)),
        }
        self.told = None;
        self.node.change_homes(|hosts| hosts.come_back(host));
        for other in self.present().into_iter().filter(|other| *other != host) {
            self.node.tell(other, &ToDaemon::Back(host));
        }
        // They may have changed since the daemon was asked.
        let homes = self.node.hosts().homes().to_vec();
        self.node.tell(host, &ToDaemon::Homes(homes));
        self.write_hosts();
        for other in self.lost.keys().copied().collect::<Vec<_>>() {
            self.move_homes(other);
        }
        let hosts = self.node.hosts();
        let (restarts, stranded) = self.stranded.iter().partition(|id| !hosts.is_down(hosts.home(**id)));
        self.stranded = stranded;
        if !is_early {
            let restarts: BTreeSet<ModuleId> = restarts;
            self.events.push_back(Event::HostBack(host, restarts.into_iter().collect()));
        }
    }
}

//! The state of the controller's host that its transport, its links and its launcher share: the links to the other hosts, and
//! what their daemons say. Absent: hosts that are lost and come back (`loss`).

use super::fleet::Fleet;
use super::messages::{ToController, ToDaemon};
use super::node::Node;
use super::parts::{Collected, Stretch};
use super::returning::Returning;
use crate::metrics::Metrics;
use crate::swarm::launcher::Event;
use crate::swarm::run_dir::RunDir;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::clock::page::Page;
use metamorph_module_agent::clock::source::{ClockSource, FileClock};
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFile, CounterStore};
use metamorph_module_agent::transport::AgentKey;
use metamorph_module_agent::transport::iceoryx::{IceoryxLink, IceoryxTransport};
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::host_link::State;
use metamorph_protocol::ids::{HostId, ModuleId};
use metamorph_sim_bridge::kernel::sim::Crossings;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io;
use std::path::PathBuf;
use std::time::Duration;

/// Number of frames from agents elsewhere that may wait here.
const HEARD: usize = 4_096;

/// State that transport, links and launcher share.
#[derive(Debug)]
pub struct Shared {
    /// The links to the other hosts, and the homes of modules.
    pub node: Node<IceoryxLink>,
    /// Where the daemons of the other hosts are.
    pub fleet: Fleet,
    /// Frames of agents elsewhere that the controller has not taken, at most [`HEARD`].
    pub frames: VecDeque<SharedFrame>,
    /// Ends and stops of agents elsewhere that the controller has not taken.
    pub events: VecDeque<Event>,
    /// The agents of other hosts that run, with the number of frames that they have not taken.
    pub away: BTreeMap<AgentKey, u32>,
    /// The counts of agents elsewhere that have ended, or why they cannot be had.
    pub counters: BTreeMap<AgentKey, Result<Option<AgentCounters>, String>>,
    /// Hosts that have forwarded all that their agents sent.
    pub drained: BTreeSet<HostId>,
    /// The counts that each host has made itself, and those of messages to each other host.
    pub accounts: BTreeMap<HostId, (AgentCounters, BTreeMap<HostId, Tally>)>,
    /// The hosts that are lost, and why.
    pub lost: BTreeMap<HostId, String>,
    /// Modules with hosts that were their homes before.
    pub former: BTreeSet<(ModuleId, HostId)>,
    /// Modules that were lost with a host and have no other.
    pub stranded: BTreeSet<ModuleId>,
    /// Daemons that are not heard, and are asked to come back.
    pub returning: Returning,
    /// The counts of hosts that were lost and have come back, up to their loss.
    pub ended_shares: Vec<AgentCounters>,
    /// Hosts that have come back without the counts up to their loss.
    pub uncounted: BTreeSet<HostId>,
    /// Hosts on other machines that this controller has called, and that have not been heard since.
    pub called: BTreeSet<HostId>,
    /// When they had been called, and how long they may act without hearing a controller.
    pub call: (Stopwatch, Duration),
    /// True if the controller before was on another machine, which is lost with the counts made there.
    pub has_moved: bool,
    /// The run directories of killed daemons, removed with the run.
    pub inherited: BTreeMap<HostId, RunDir>,
    /// Messages with agents of each other host: from it, and to it.
    pub bodies: BTreeMap<HostId, (u64, u64)>,
    /// The clock of the run.
    pub clock: FileClock,
    /// The directory of this host, and the counts that it has made itself.
    pub root: PathBuf,
    /// The file of those counts.
    pub own: CounterFile,
    /// The number of controllers before this one.
    pub generation: u32,
    /// Parts of the journal from other machines, if one is kept.
    pub collected: Option<Collected>,
    /// The clock page that was sent last.
    pub told: Option<Page>,
    /// Where numbers of the run are noted, if they are served.
    pub metrics: Option<Metrics>,
}

impl Shared {
    /// Returns the host of an agent.
    pub fn home(&self, agent: AgentKey) -> HostId {
        self.node.home(agent.0)
    }

    /// Returns true if a module is or was at home on a host.
    pub fn is_of(&self, id: ModuleId, host: HostId) -> bool {
        self.node.home(id) == host || self.former.contains(&(id, host))
    }

    /// Moves frames between hosts, takes what daemons say, and follows hosts that fall silent, end and come back.
    pub fn turn(&mut self, transport: &mut IceoryxTransport) {
        if self.frames.len() >= HEARD {
            return;
        }
        self.tell_time();
        // Before packets are sent: what others receive has been counted.
        let account = AgentCounters { closed: false, ..self.node.account() };
        if let Err(e) = self.own.write(&account) {
            tracing::warn!("{e}");
        }
        self.node.turn(transport);
        if let Some(metrics) = &self.metrics {
            metrics.note_links(|| (self.node.peers(), self.away.len() as u64));
        }
        self.node.residents.flush();
        while let Some((host, state)) = self.node.next_change() {
            match state {
                State::Silent => {
                    tracing::warn!("{host} is silent");
                    // A daemon of this machine that has died need not be waited for.
                    match self.inherit(host) {
                        true => self.lose(host, "its daemon has died"),
                        false => self.call_back(host),
                    }
                }
                State::Fenced => self.lose(host, "the host was silent for too long"),
                State::Closed => self.lose(host, "its daemon was asked to end"),
                state => {
                    tracing::info!("the link to {host} is {state:?}");
                    if state == State::Up {
                        self.called.remove(&host);
                        self.returning.cease(host);
                    }
                }
            }
        }
        while let Some((host, reached)) = self.returning.next() {
            self.welcome(host, reached);
        }
        if self.call.0.elapsed() > self.call.1 {
            let unheard = std::mem::take(&mut self.called);
            unheard
                .into_iter()
                .for_each(|host| self.lose(host, "it did not answer the controller that took over"));
        }
        for host in self.fleet.roots.keys().copied().collect::<Vec<_>>() {
            loop {
                match self.node.hear(host) {
                    Ok(Some(message)) => self.take(host, message),
                    Ok(None) => break,
                    Err(e) => {
                        self.lose(host, &format!("what it says cannot be read: {e}"));
                        break;
                    }
                }
            }
            self.collect(host);
        }
    }

    /// Takes parts of the journal from a host.
    pub fn collect(&mut self, host: HostId) {
        while let Ok(Some(stretch)) = self.node.hear_in_bulk::<Stretch>(host) {
            self.put(host, &stretch);
        }
    }

    /// Adds a part of an agent's journal to those collected here.
    pub fn put(&mut self, host: HostId, stretch: &Stretch) {
        let id = stretch.agent.0;
        if !self.is_of(id, host) {
            tracing::warn!("{host} sends the journal of module {id}, which is not its own");
        } else if let Some(Err(e)) = self.collected.as_mut().map(|collected| collected.put(stretch)) {
            tracing::warn!("the journal of module {id} ends early: {e}");
        }
    }

    /// Sends the clock page to hosts with a clock of their own, once it has changed.
    pub fn tell_time(&mut self) {
        let away: Vec<HostId> = self.fleet.away().filter(|host| !self.lost.contains_key(host)).collect();
        if away.is_empty() {
            return;
        }
        let Ok(page) = self.clock.read_page() else { return };
        if self.told.replace(page) != Some(page) {
            let message = ToDaemon::Clock(page.encode().to_vec());
            away.into_iter().for_each(|host| self.node.tell(host, &message));
        }
    }

    /// Takes a message of a daemon.
    pub fn take(&mut self, host: HostId, message: ToController) {
        let is_theirs = |agent: &AgentKey| self.is_of(agent.0, host);
        match message {
            ToController::Frame(sent) => {
                if let Some(shared) = sent.shared(self.node.healed(host)) {
                    self.bodies.entry(host).or_default().0 += 1;
                    self.frames.push_back(shared);
                }
            }
            ToController::Taken(agent, count) => {
                if let Some(untaken) = self.away.get_mut(&agent) {
                    *untaken = untaken.saturating_sub(count);
                }
            }
            ToController::SpawnFailed(agent, why) if is_theirs(&agent) => {
                self.away.remove(&agent);
                self.events.push_back(Event::SpawnFailed(agent, io::Error::other(why)));
            }
            ToController::Exited { agent, how, signal, of_machine, stderr_tail, counters }
                if is_theirs(&agent) =>
            {
                self.away.remove(&agent);
                self.counters.insert(agent, counters.map(|c| c.map(|c| AgentCounters::from(*c))));
                self.events.push_back(Event::Exited { agent, how, signal, of_machine, stderr_tail });
            }
            ToController::Stopped(agent, signal) if is_theirs(&agent) => {
                self.events.push_back(Event::Stopped(agent, signal));
            }
            ToController::Continued(agent) if is_theirs(&agent) => {
                self.events.push_back(Event::Continued(agent));
            }
            ToController::Journal(stretch) => self.put(host, &stretch),
            ToController::Still(Some(error)) => tracing::warn!(
                "scenario time stands still on {host}: its clock is known to {error} only, and `clock_error` is {}",
                self.fleet.own.clock_error
            ),
            ToController::Still(None) => tracing::info!("scenario time goes on again on {host}"),
            ToController::Drained => {
                self.drained.insert(host);
            }
            ToController::Account(account, crossed) => {
                self.accounts.insert(host, ((*account).into(), crossed));
            }
            _ => tracing::warn!("{host} speaks of modules of another host"),
        }
    }

    /// Returns what has crossed between hosts, as far as they have reported it.
    pub fn crossings(&self) -> Crossings {
        let mut crossings = Crossings::new();
        let own = (&HostId::CONTROLLER, self.node.crossed());
        let others = self.accounts.iter().map(|(host, (_, crossed))| (host, crossed.clone()));
        for (from, crossed) in others.chain([own]) {
            for (to, messages) in crossed {
                crossings.entry((*from, to)).or_default().messages = messages;
            }
        }
        for (host, (from, to)) in &self.bodies {
            crossings.entry((*host, HostId::CONTROLLER)).or_default().body_messages = *from;
            crossings.entry((HostId::CONTROLLER, *host)).or_default().body_messages = *to;
        }
        crossings
    }

    /// Returns the other hosts that are not lost.
    pub fn present(&self) -> Vec<HostId> {
        self.fleet.roots.keys().copied().filter(|host| !self.lost.contains_key(host)).collect()
    }
}

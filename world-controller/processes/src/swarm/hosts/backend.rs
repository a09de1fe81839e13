//! The backend of a swarm on several hosts, as the controller loop sees it: agents of this host are reached as on one
//! host, and those of others over the links to their hosts. A host that is lost ends all its agents in one instant.

use super::daemon::OWN_COUNTERS;
use super::fleet::{Fleet, FleetError, Inherited};
use super::messages::{Sent, ToController, ToDaemon};
use super::node::Node;
use super::parts::{Collected, Stretch};
use super::remains::mark_collected;
use crate::swarm::launcher::{Backend, Event, Found, HostsAccount, Launcher, Takeover};
use crate::swarm::outcome::SwarmError;
use crate::swarm::run_dir::{RunDir, kill_agents};
use crate::swarm::supervisor::Supervisor;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::clock::page::Page;
use metamorph_module_agent::clock::source::{ClockSource, FileClock};
use metamorph_module_agent::journal_file::Parts;
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFile, CounterStore};
use metamorph_module_agent::run_dir::run_name::RunName;
use metamorph_module_agent::transport::iceoryx::{IceoryxLink, IceoryxTransport};
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{
    Address, AgentKey, ConnectError, Link, SendStatus, Transport, TransportError,
};
use metamorph_protocol::counters::Tally;
use metamorph_protocol::host_link::State;
use metamorph_protocol::ids::{HostId, Incarnation};
use metamorph_protocol::time::Span;
use metamorph_protocol::wire::CONTROLLER;
use metamorph_sim_bridge::kernel::sim::Crossings;
use rustix::process::Signal;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

/// Number of frames to one agent elsewhere that its host has not put into its inbox yet.
const UNTAKEN: u32 = 64;
/// Number of frames from agents elsewhere that may wait here.
const HEARD: usize = 4_096;
/// Longest time to wait for the accounts of the other hosts at the end.
const ACCOUNTS_WAIT_MAX: Duration = Duration::from_secs(10);
/// Longest time to wait, before the run begins, until the clocks of all hosts are known well enough.
const CLOCKS_WAIT_MAX: Duration = Duration::from_secs(5);
/// Longest time to wait before the links get a turn at the end.
const LINKS_WAIT_MAX: Duration = Duration::from_millis(5);

/// The backend.
pub enum Hosts {}

impl Backend for Hosts {
    type Transport = HostsTransport;
    type Launcher = HostsLauncher;
    type Clock = FileClock;
}

/// State that transport, links and launcher share.
#[derive(Debug)]
struct Shared {
    node: Node<IceoryxLink>,
    fleet: Fleet,
    frames: VecDeque<SharedFrame>,
    events: VecDeque<Event>,
    /// The agents of other hosts that run, with the number of frames that they have not taken.
    away: BTreeMap<AgentKey, u32>,
    counters: BTreeMap<AgentKey, Result<Option<AgentCounters>, String>>,
    drained: BTreeSet<HostId>,
    accounts: BTreeMap<HostId, (AgentCounters, BTreeMap<HostId, Tally>)>,
    /// The hosts that are lost, and why.
    lost: BTreeMap<HostId, String>,
    /// Hosts on other machines that this controller has called, and that have not been heard since.
    called: BTreeSet<HostId>,
    /// When they had been called, and how long they may act without hearing a controller.
    call: (Stopwatch, Duration),
    /// True if the controller before was on another machine, which is lost with the counts made there.
    has_moved: bool,
    /// The run directories of killed daemons, removed with the run.
    inherited: BTreeMap<HostId, RunDir>,
    /// Messages with agents of each other host: from it, and to it.
    bodies: BTreeMap<HostId, (u64, u64)>,
    clock: FileClock,
    /// The directory of this host, and the counts that it has made itself.
    root: PathBuf,
    own: CounterFile,
    /// The number of controllers before this one.
    generation: u32,
    /// Parts of the journal from other machines, if one is kept.
    collected: Option<Collected>,
    /// The clock page that was sent last.
    told: Option<Page>,
}

impl Shared {
    fn home(&self, agent: AgentKey) -> HostId {
        self.node.home(agent.0)
    }

    fn turn(&mut self, transport: &mut IceoryxTransport) {
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
        self.node.residents.flush();
        while let Some((host, state)) = self.node.next_change() {
            match state {
                State::Silent => {
                    tracing::warn!("{host} is silent");
                    // A daemon of this machine that has died need not be waited for.
                    if self.inherit(host) {
                        self.lose(host, "its daemon has died");
                    }
                }
                State::Fenced => self.lose(host, "the host was silent for too long"),
                State::Closed => self.lose(host, "its daemon was asked to end"),
                state => {
                    tracing::info!("the link to {host} is {state:?}");
                    if state == State::Up {
                        self.called.remove(&host);
                    }
                }
            }
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
    fn collect(&mut self, host: HostId) {
        while let Ok(Some(stretch)) = self.node.hear_in_bulk::<Stretch>(host) {
            self.put(host, &stretch);
        }
    }

    fn put(&mut self, host: HostId, stretch: &Stretch) {
        let id = stretch.agent.0;
        if self.node.home(id) != host {
            tracing::warn!("{host} sends the journal of module {id}, which is not its own");
        } else if let Some(Err(e)) = self.collected.as_mut().map(|collected| collected.put(stretch)) {
            tracing::warn!("the journal of module {id} ends early: {e}");
        }
    }

    /// Sends the clock page to hosts with a clock of their own, once it has changed.
    fn tell_time(&mut self) {
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

    fn take(&mut self, host: HostId, message: ToController) {
        let is_theirs = |agent: &AgentKey| self.node.home(agent.0) == host;
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

    /// Takes over the run directory of a host whose daemon is dead, so that its counters can be read and are removed in
    /// the end. A daemon that lives removes it itself, after they have been read. Returns true if the daemon is dead, and its
    /// agents with it.
    fn inherit(&mut self, host: HostId) -> bool {
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
    fn root_of(&self, host: HostId) -> Option<&Path> {
        self.fleet.roots.get(&host)?.as_deref().filter(|root| root.is_dir())
    }

    /// Reads counters of a host that is lost.
    fn left_counters(
        &self,
        host: HostId,
        (id, incarnation): AgentKey,
    ) -> Result<Option<AgentCounters>, String> {
        let root = self.root_of(host).ok_or_else(|| counts_are_lost(host))?;
        CounterFile::read(root, id, incarnation).map_err(|e| e.to_string())
    }

    /// Ends all agents of a host that is lost permanently. Their counters outlive them on this machine.
    fn lose(&mut self, host: HostId, why: &str) {
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
        // Without agents it was lost before this controller took over, which asks for them then.
        if !gone.is_empty() {
            self.events.push_back(Event::HostLost { host, why: why.to_owned(), agents: gone });
        }
        // Hosts that do not watch each other learn that messages to it have nowhere to go.
        self.node.give_up(host);
        let others: Vec<HostId> = self.present();
        others.into_iter().for_each(|other| self.node.tell(other, &ToDaemon::Lost(host)));
        if let Some(Err(e)) = self.root_of(host).map(mark_collected) {
            tracing::debug!("{host} is not told that its counts are taken: {e}");
        }
    }

    /// Returns what has crossed between hosts, as far as they have reported it.
    fn crossings(&self) -> Crossings {
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

    /// The other hosts that are not lost.
    fn present(&self) -> Vec<HostId> {
        self.fleet.roots.keys().copied().filter(|host| !self.lost.contains_key(host)).collect()
    }
}

type SharedRef = Rc<RefCell<Shared>>;

/// Connects the controller of this generation to agents of all hosts.
///
/// # Errors
/// If a connection cannot be set up.
pub fn backend(
    inherited: Inherited,
    (transport, supervisor): (IceoryxTransport, Supervisor),
    root: &Path,
    generation: u32,
    journal: Option<&Parts>,
) -> Result<(HostsTransport, HostsLauncher), SwarmError> {
    let Inherited { mut fleet, found, ended, lost, since, has_moved, .. } = inherited;
    let called = if generation == 0 { BTreeSet::new() } else { fleet.away().collect() };
    let fence = Duration::from_nanos(fleet.own.silent_and_fence.1.0);
    let mut node = Node::new(&fleet.own, root, generation).map_err(SwarmError::Clock)?;
    for (host, connection) in fleet.connections().map_err(SwarmError::Supervisor)? {
        node.attach(host, connection).map_err(SwarmError::Supervisor)?;
    }
    let clock = FileClock::open(root).map_err(SwarmError::Clock)?;
    let own = CounterFile::create(root, CONTROLLER, own_incarnation(generation))?;
    let mut shared = Shared {
        node,
        fleet,
        frames: VecDeque::new(),
        events: VecDeque::new(),
        away: BTreeMap::new(),
        counters: ended,
        drained: BTreeSet::new(),
        accounts: BTreeMap::new(),
        lost: BTreeMap::new(),
        called,
        call: (since, fence),
        has_moved,
        inherited: BTreeMap::new(),
        bodies: BTreeMap::new(),
        clock,
        root: root.to_owned(),
        own,
        generation,
        collected: journal.map(|parts| Collected::new(&parts.dir)),
        told: None,
    };
    lost.into_iter().for_each(|(host, why)| shared.lose(host, &why));
    let shared = Rc::new(RefCell::new(shared));
    let local = Rc::new(RefCell::new(transport));
    let launcher =
        HostsLauncher { local: supervisor, shared: Rc::clone(&shared), transport: Rc::clone(&local), found };
    Ok((HostsTransport { local, shared }, launcher))
}

/// The inbox of the controller, for frames of agents of all hosts.
#[derive(Debug)]
pub struct HostsTransport {
    shared: SharedRef,
    local: Rc<RefCell<IceoryxTransport>>,
}

/// The sending end to an agent.
#[derive(Debug)]
pub enum HostsLink {
    /// Of this host.
    Here(IceoryxLink),
    /// Of another.
    Away(AgentKey, SharedLink),
}

/// The way to the agents of other hosts.
#[derive(Debug)]
pub struct SharedLink(SharedRef);

impl Link for HostsLink {
    fn send(&mut self, frame: SharedFrame) -> SendStatus {
        let (agent, shared) = match self {
            HostsLink::Here(link) => return link.send(frame),
            HostsLink::Away(agent, SharedLink(shared)) => (*agent, &mut *shared.borrow_mut()),
        };
        let home = shared.home(agent);
        match shared.away.get_mut(&agent) {
            None => return SendStatus::Gone,
            Some(untaken) if *untaken >= UNTAKEN => return SendStatus::Full,
            Some(untaken) => *untaken += 1,
        }
        shared.bodies.entry(home).or_default().1 += 1;
        shared.node.tell(home, &ToDaemon::Frame(agent, Sent::new(&frame)));
        SendStatus::Sent
    }

    /// The transport carries what waits before it waits itself.
    fn flush(&mut self) {
        if let HostsLink::Here(link) = self {
            link.flush();
        }
    }
}

impl Transport for HostsTransport {
    type Link = HostsLink;

    fn connect(&mut self, to: Address) -> Result<HostsLink, ConnectError> {
        if let Address::Agent(agent) = to {
            let shared = self.shared.borrow();
            if shared.home(agent) != HostId::CONTROLLER {
                return Ok(HostsLink::Away(agent, SharedLink(Rc::clone(&self.shared))));
            }
        }
        self.local.borrow_mut().connect(to).map(HostsLink::Here)
    }

    fn receive(&mut self) -> Result<Option<SharedFrame>, TransportError> {
        let (mut shared, mut local) = (self.shared.borrow_mut(), self.local.borrow_mut());
        if let Some(frame) = shared.frames.pop_front() {
            return Ok(Some(frame));
        }
        while let Some(frame) = local.receive()? {
            if !shared.node.forward(&frame) {
                return Ok(Some(frame));
            }
        }
        shared.turn(&mut local);
        Ok(shared.frames.pop_front())
    }

    fn wait(&mut self, timeout: Duration) -> Result<(), TransportError> {
        let (mut shared, mut local) = (self.shared.borrow_mut(), self.local.borrow_mut());
        shared.turn(&mut local);
        if !shared.frames.is_empty() || !shared.events.is_empty() {
            return Ok(());
        }
        let timeout = timeout.min(shared.node.wait());
        if timeout.is_zero() { Ok(()) } else { local.wait(timeout) }
    }
}

/// Starts agents on all hosts.
#[derive(Debug)]
pub struct HostsLauncher {
    local: Supervisor,
    shared: SharedRef,
    transport: Rc<RefCell<IceoryxTransport>>,
    /// Agents of other hosts that an earlier controller has started.
    found: Found,
}

fn counts_are_lost(host: HostId) -> String {
    format!("{host} was lost, and the counts of its agents with it")
}

/// Returns the incarnation under which the controller of this generation keeps its own counts.
fn own_incarnation(generation: u32) -> Incarnation {
    Incarnation(u16::try_from(generation).unwrap_or(u16::MAX))
}

impl Takeover for HostsLauncher {
    fn take_over(&mut self, root: &Path, wanted: &BTreeSet<AgentKey>) -> Found {
        let mut shared = self.shared.borrow_mut();
        let is_here = |agent: &&AgentKey| shared.home(**agent) == HostId::CONTROLLER;
        let here = wanted.iter().filter(is_here).copied().collect();
        let mut found = self.local.take_over(root, &here);
        found.present.keys().for_each(|agent| shared.node.residents.arrive(*agent));
        let elsewhere = std::mem::take(&mut self.found);
        shared.away.extend(elsewhere.present.keys().map(|agent| (*agent, 0)));
        found.latest.extend(elsewhere.latest);
        found.present.extend(elsewhere.present);
        let mut lost = shared.lost.clone();
        if shared.has_moved {
            lost.insert(HostId::CONTROLLER, "its machine is gone".to_owned());
        }
        for (host, why) in lost {
            let is_gone =
                |agent: &&AgentKey| shared.home(**agent) == host && !found.present.contains_key(*agent);
            let agents: Vec<AgentKey> = wanted.iter().filter(is_gone).copied().collect();
            if !agents.is_empty() {
                found.present.extend(agents.iter().map(|agent| (*agent, false)));
                shared.events.push_back(Event::HostLost { host, why, agents });
            }
        }
        found
    }
}

impl Launcher for HostsLauncher {
    fn start(&mut self, agent: AgentKey) {
        let mut shared = self.shared.borrow_mut();
        let home = shared.home(agent);
        if home == HostId::CONTROLLER {
            shared.node.residents.arrive(agent);
            return self.local.start(agent);
        }
        if shared.lost.contains_key(&home) {
            let why = io::Error::other(format!("its host {home} is lost"));
            return shared.events.push_back(Event::SpawnFailed(agent, why));
        }
        shared.away.insert(agent, 0);
        shared.node.tell(home, &ToDaemon::Start(agent));
    }

    fn signal(&mut self, agent: AgentKey, signal: Signal) {
        let mut shared = self.shared.borrow_mut();
        match shared.home(agent) {
            HostId::CONTROLLER => self.local.signal(agent, signal),
            home => shared.node.tell(home, &ToDaemon::Signal(agent, signal.as_raw())),
        }
    }

    fn reap(&mut self, agent: AgentKey) {
        let mut shared = self.shared.borrow_mut();
        match shared.home(agent) {
            HostId::CONTROLLER => self.local.reap(agent),
            home => shared.node.tell(home, &ToDaemon::Reap(agent)),
        }
    }

    fn event(&mut self) -> Result<Option<Event>, SwarmError> {
        let event = self.local.event()?;
        let mut shared = self.shared.borrow_mut();
        if let Some(Event::Exited { agent, .. } | Event::SpawnFailed(agent, _)) = &event {
            shared.node.residents.leave(*agent);
        }
        Ok(event.or_else(|| shared.events.pop_front()))
    }

    fn counters(&self, agent: AgentKey) -> Result<Option<AgentCounters>, String> {
        let shared = self.shared.borrow();
        match shared.home(agent) {
            HostId::CONTROLLER => match self.local.counters(agent) {
                Ok(None) if shared.has_moved => Err(counts_are_lost(HostId::CONTROLLER)),
                counters => counters,
            },
            home => {
                shared.counters.get(&agent).cloned().unwrap_or_else(|| {
                    match shared.lost.contains_key(&home) {
                        // Its end may have been reported to an earlier controller.
                        true if shared.generation > 0 => shared.left_counters(home, agent),
                        _ => Ok(None),
                    }
                })
            }
        }
    }

    fn longest_delay(&self) -> u64 {
        let shared = self.shared.borrow();
        let away = shared.fleet.away().filter(|host| !shared.lost.contains_key(host));
        away.filter_map(|host| Some(shared.node.clock_of(host)?.error())).max().unwrap_or(0)
    }

    fn await_clocks(&mut self) -> Result<(), SwarmError> {
        let begun = Stopwatch::start();
        loop {
            let (mut shared, mut local) = (self.shared.borrow_mut(), self.transport.borrow_mut());
            let bound = shared.fleet.own.clock_error;
            let known = |host| shared.node.clock_of(host).map(|clock| Span(clock.error()));
            let is_unknown = |host: &HostId| {
                !shared.lost.contains_key(host) && known(*host).is_none_or(|error| error > bound)
            };
            let Some(host) = shared.fleet.away().find(is_unknown) else { return Ok(()) };
            if begun.elapsed() > CLOCKS_WAIT_MAX {
                return Err(FleetError::Clock { host, known: known(host), bound }.into());
            }
            shared.turn(&mut local);
            local.wait(LINKS_WAIT_MAX)?;
        }
    }

    fn settle(&mut self) -> Result<Option<HostsAccount>, SwarmError> {
        self.wait_for(&ToDaemon::Drain, |shared, host| shared.drained.contains(&host))?;
        self.wait_for(&ToDaemon::Account, |shared, host| shared.accounts.contains_key(&host))?;
        let shared = self.shared.borrow();
        let mut counters: Vec<AgentCounters> =
            shared.accounts.values().map(|(counters, _)| counters.clone()).collect();
        counters.push(shared.node.account());
        for generation in 0..shared.generation {
            let read = CounterFile::read(&shared.root, CONTROLLER, own_incarnation(generation));
            counters.extend(read?);
        }
        let missing = shared.fleet.roots.keys().filter(|host| !shared.accounts.contains_key(host));
        let missing = shared.has_moved.then_some(&HostId::CONTROLLER).into_iter().chain(missing);
        Ok(Some(HostsAccount {
            counters,
            missing: missing.copied().collect(),
            crossings: shared.crossings(),
        }))
    }
}

impl HostsLauncher {
    /// Asks all other hosts for something, and waits until each has done it or is lost.
    fn wait_for(
        &mut self,
        request: &ToDaemon,
        is_done: fn(&Shared, HostId) -> bool,
    ) -> Result<(), SwarmError> {
        let asked = self.shared.borrow().present();
        for host in &asked {
            self.shared.borrow_mut().node.tell(*host, request);
        }
        let begun = Stopwatch::start();
        loop {
            let (mut shared, mut local) = (self.shared.borrow_mut(), self.transport.borrow_mut());
            while let Some(frame) = local.receive()? {
                shared.node.forward(&frame);
            }
            shared.turn(&mut local);
            shared.frames.clear();
            let is_done = |host: &HostId| shared.lost.contains_key(host) || is_done(&shared, *host);
            if (asked.iter().all(is_done) && shared.node.is_drained()) || begun.elapsed() > ACCOUNTS_WAIT_MAX
            {
                return Ok(());
            }
            local.wait(LINKS_WAIT_MAX)?;
        }
    }
}

impl Drop for HostsLauncher {
    fn drop(&mut self) {
        let (mut shared, mut local) = (self.shared.borrow_mut(), self.transport.borrow_mut());
        shared.turn(&mut local);
        shared.node.close();
    }
}

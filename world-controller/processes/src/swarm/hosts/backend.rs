//! The backend of a swarm on several hosts, as the controller loop sees it: agents of this host are reached as on one
//! host, and those of others over the links to their hosts.

use super::fleet::{FleetError, Inherited};
use super::loss::counts_are_lost;
use super::messages::{Sent, ToDaemon};
use super::node::Node;
use super::parts::Collected;
use super::returning::Returning;
use super::shared::Shared;
use crate::swarm::SwarmOptions;
use crate::swarm::launcher::{Backend, Event, Found, HostsAccount, Launcher, Takeover};
use crate::swarm::outcome::SwarmError;
use crate::swarm::supervisor::Supervisor;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::clock::source::FileClock;
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFile};
use metamorph_module_agent::transport::iceoryx::{IceoryxLink, IceoryxTransport};
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{
    Address, AgentKey, ConnectError, Link, SendStatus, Transport, TransportError,
};
use metamorph_protocol::ids::{HostId, Incarnation};
use metamorph_protocol::link::HostChange;
use metamorph_protocol::time::Span;
use metamorph_protocol::wire::CONTROLLER;
use rustix::process::Signal;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io;
use std::path::Path;
use std::rc::Rc;
use std::time::Duration;

/// Number of frames to one agent elsewhere that its host has not put into its inbox yet.
const UNTAKEN: u32 = 64;
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
    options: &SwarmOptions,
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
        former: BTreeSet::new(),
        stranded: BTreeSet::new(),
        returning: Returning::new(),
        ended_shares: Vec::new(),
        uncounted: BTreeSet::new(),
        called,
        call: (since, fence),
        has_moved,
        inherited: BTreeMap::new(),
        bodies: BTreeMap::new(),
        clock,
        root: root.to_owned(),
        own,
        generation,
        collected: options.journal.as_ref().map(|parts| Collected::new(&parts.dir)),
        told: None,
        metrics: options.metrics.clone(),
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
            if !shared.node.forward(&mut *local, &frame) {
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
                let restarts = shared.restarts(host, &agents, false);
                shared.events.push_back(Event::HostLost { host, why, agents, restarts });
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
        if shared.lost.contains_key(&home) || shared.node.hosts().is_down(home) {
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
        // Also of an agent whose module has moved here since.
        if let Some(counters) = shared.counters.get(&agent) {
            return counters.clone();
        }
        match shared.home(agent) {
            HostId::CONTROLLER => match self.local.counters(agent) {
                Ok(None) if shared.has_moved => Err(counts_are_lost(HostId::CONTROLLER)),
                counters => counters,
            },
            home => match shared.lost.contains_key(&home) {
                // Its end may have been reported to an earlier controller.
                true if shared.generation > 0 => shared.left_counters(home, agent),
                _ => Ok(None),
            },
        }
    }

    fn change_host(&mut self, host: HostId, change: HostChange) {
        let mut shared = self.shared.borrow_mut();
        match change {
            HostChange::Down => shared.node.change_homes(|hosts| hosts.go_down(host)),
            HostChange::Lost => drop(shared.move_homes(host)),
            HostChange::Back => shared.node.change_homes(|hosts| hosts.come_back(host)),
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
        counters.extend(shared.ended_shares.iter().cloned());
        for generation in 0..shared.generation {
            let read = CounterFile::read(&shared.root, CONTROLLER, own_incarnation(generation));
            counters.extend(read?);
        }
        let has_none =
            |host: &&HostId| !shared.accounts.contains_key(host) || shared.uncounted.contains(host);
        let missing = shared.fleet.roots.keys().filter(has_none);
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
                shared.node.forward(&mut *local, &frame);
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

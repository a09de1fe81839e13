//! The simulated link: a discrete-event kernel that drives any number of agents in virtual time.
//!
//! One queue, ordered by time and then by the order of scheduling; one named random stream per
//! sender. Same setup and seed, same events, on every machine and build.
//!
//! The state of all modules lies in flat arrays, and messages under way in one slab, so that a message costs
//! no allocation and a module a few hundred bytes.

mod audit;
mod bodies;
mod changes;
mod fork;
mod module;

pub use bodies::{ControlCounts, Crossed, Crossings};

use crate::director::port::DirectorPort;
use crate::kernel::audited::{Agents, Audited};
use crate::kernel::queue::Queue;
use crate::kernel::recording::Log;
use crate::kernel::state::States;
use crate::kernel::trace::Trace;
use crate::world::invariants::SESSION_CURRENT;
use crate::world::invariants::{self, Violation};
use audit::Findings;
use bodies::{BodyMessage, ControlStreams, HostStreams, Posted};
use changes::Changes;
use metamorph_core::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_core::counters::{Class, Tally};
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::host::{AgentHost, StepContext};
use metamorph_core::ids::{HostId, Incarnation, ModuleId, Port, Revision};
use metamorph_core::latency::Latencies;
use metamorph_core::link::{HostChange, LinkModel, LinkState};
use metamorph_core::record::MessageName;
use metamorph_core::rng::Rng;
use metamorph_core::runtime::Command;
use metamorph_core::runtime::{Contact, Sensed};
use metamorph_core::time::Time;
use metamorph_core::wire::Wire;
use module::{Backlog, InFlight, Link, Module, Process, Sent, Waiting};
use slab::Slab;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The largest number of messages that wait for a stopped process, as in a real inbox.
const INBOX: usize = 32;
/// The number of events that the kernel looks ahead at a time.
const AT_HAND: usize = 16;
/// Largest number of lines of the cache that are read ahead for the links of one module.
const LINES: usize = 12;

/// The configuration of a simulated run, besides its world and its director.
pub struct SimConfig<A: Agent> {
    /// The setup that the agents share.
    pub setup: Arc<A::Setup>,
    /// The link model.
    pub link: LinkModel,
    /// The seed of the run.
    pub seed: u64,
    /// The interval of full audits; every action and every input is audited anyway.
    pub audit_every: metamorph_core::time::Span,
    /// Delivers messages even if they were sent in an earlier session, for tests that show what goes wrong then.
    #[doc(hidden)]
    pub ignore_sessions: bool,
}

#[derive(Clone, Copy)]
enum Event {
    /// A message arrives; its index in the slab.
    Arrive(u32),
    Wake(ModuleId),
    /// The sleep of a process ends; its number.
    Awake(u32),
    /// A message between an agent and the controller arrives; the index in its slab.
    Posted(u32),
}

/// The result of [`Sim::step`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// An event was carried out.
    Done,
    /// No event is due yet.
    Nothing,
    /// The run is over.
    Over,
}

/// A simulated run.
pub struct Sim<W: Audited, D: DirectorPort<W>> {
    now: Time,
    config: SimConfig<W::Agent>,
    world: W,
    director: D,
    modules: Vec<Module<W::Agent>>,
    /// [`Agent::PORTS`] for each module.
    links: Vec<Link>,
    backlogs: BTreeMap<ModuleId, Backlog<W::Agent>>,
    queue: Queue<Event>,
    parcels: Slab<InFlight<<W::Agent as Agent>::Message>>,
    /// The streams between several hosts; `None` if there is only one.
    hosts: Option<HostStreams>,
    /// The link of orders and reports; `None` if they take no time.
    controller: Option<ControlStreams>,
    /// Messages under way between agents and the controller.
    posted: Slab<Posted<W::Agent>>,
    control: ControlCounts,
    tally: Tally,
    latencies: Latencies,
    body_messages: u64,
    trace: Trace,
    states: States,
    findings: Findings,
    next_audit: Time,
    /// The instant of the latest input to an agent, and how many there have been at it.
    instant: (Time, u64),
    /// The number of events so far, and the changes to come.
    changes: Changes,
    /// The seed of agents that start from now on.
    births: u64,
    finished: bool,
    /// True if everything was audited after the end.
    audited: bool,
    log: Option<Log>,
}

impl<W: Audited, D: DirectorPort<W>> Sim<W, D> {
    /// Creates a run at time zero, with all agents started.
    pub fn new(config: SimConfig<W::Agent>, world: W, director: D) -> Self {
        Sim::with_journal(config, world, director, None)
    }

    /// Creates a run that records the steps of agents. World and director must then be wrappers that record, too.
    pub fn with_journal(config: SimConfig<W::Agent>, world: W, director: D, log: Option<Log>) -> Self {
        let hosts = config.link.hosts.clone().map(|hosts| HostStreams::new(hosts, config.seed));
        let controller = config.link.controller.clone();
        let controller = controller.map(|link| ControlStreams::new(link, world.len(), config.seed));
        let modules: Vec<Module<W::Agent>> = (0..world.len())
            .map(|i| Module {
                rng: Rng::named(config.seed, "link", i as u64),
                clock: config.link.clock(ModuleId(i as u32)),
                wake: Time::NEVER,
                started: Time::ZERO,
                revision: Revision(0),
                sent: 0,
                incarnation: Incarnation(0),
                process: Process::Dead,
                agent: None,
            })
            .collect();
        let states = States::new(modules.len());
        let mut sim = Sim {
            now: Time::ZERO,
            next_audit: Time::ZERO + config.audit_every,
            modules,
            links: vec![Link { contact: None, state: LinkState::default() }; world.len() * W::Agent::PORTS],
            backlogs: BTreeMap::new(),
            queue: Queue::new(config.link.delay_max),
            parcels: Slab::new(),
            hosts,
            controller,
            posted: Slab::new(),
            control: ControlCounts::default(),
            births: config.seed,
            config,
            world,
            director,
            tally: Tally::default(),
            latencies: Latencies::default(),
            body_messages: 0,
            trace: Trace::default(),
            states,
            findings: Findings::default(),
            instant: (Time::ZERO, 0),
            changes: Changes::default(),
            finished: false,
            audited: false,
            log,
        };
        for i in 0..sim.modules.len() as u32 {
            sim.start(ModuleId(i), Incarnation(0));
        }
        sim.audit_all();
        sim.settle();
        sim
    }

    /// Returns the current time.
    pub fn now(&self) -> Time {
        self.now
    }
    /// Returns the world.
    pub fn world(&self) -> &W {
        &self.world
    }
    /// Returns the director.
    pub fn director(&self) -> &D {
        &self.director
    }
    /// Returns the living agents.
    pub fn agents(&self) -> Agents<'_, W::Agent> {
        Agents::of(&self.modules)
    }
    /// Returns the message counts.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
    /// Returns the latencies of the messages delivered.
    pub fn latencies(&self) -> &Latencies {
        &self.latencies
    }
    /// Returns the number of actions, percepts and contact changes carried between agents and bodies, and of
    /// reports and orders.
    pub fn body_messages(&self) -> u64 {
        self.body_messages
    }
    /// Returns the trace so far.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }
    /// Returns the first violations, at most a hundred, and their total number.
    pub fn violations(&self) -> (&[Violation], u64) {
        self.findings.violations()
    }
    /// Returns how often an invariant was checked.
    pub fn checked(&self) -> u64 {
        self.findings.checked
    }

    /// Runs until the director finishes the run, no event is left, or `until` has come. Returns true if the
    /// run is over.
    pub fn run_until(&mut self, until: Time) -> bool {
        loop {
            match self.step(until) {
                Step::Done => {}
                Step::Nothing => return false,
                Step::Over => return true,
            }
        }
    }

    /// Carries out the next event, if it is due at or before `until`: bodies that finish a motion, a message or a
    /// timer, or the director.
    pub fn step(&mut self, until: Time) -> Step {
        if self.finished {
            // Audited once more, since the last event was carried out.
            if !std::mem::replace(&mut self.audited, true) {
                self.audit_all();
            }
            return Step::Over;
        }
        let event = self.queue.next_at();
        let (world, director) = (self.world.next_event(), self.director.wake_at());
        let next = event.min(world).min(director).max(self.now);
        if next == Time::NEVER || next > until {
            self.now = self.now.max(until.min(next));
            return if next == Time::NEVER { Step::Over } else { Step::Nothing };
        }
        self.now = next;
        // At one instant bodies come first, then messages and timers, then the controller.
        if world <= next {
            self.world.advance(next);
            self.settle();
        } else if event <= next {
            if self.queue.taken().is_multiple_of(AT_HAND) {
                self.look_ahead();
            }
            if let Some((at, event)) = self.queue.pop() {
                self.dispatch(at, event);
            }
        } else {
            self.director.wake(self.now, &mut self.world);
            self.settle();
        }
        if self.states.is_due(self.trace.events()) {
            self.look_at_states();
        }
        if self.now >= self.next_audit {
            self.audit_all();
            self.next_audit = self.now + self.config.audit_every;
        }
        self.count_event()
    }

    /// Hands the director an input that is not determined by scenario and seed.
    ///
    /// # Errors
    /// Returns what is wrong with the input.
    pub fn input(&mut self, kind: &str, bytes: &[u8]) -> Result<(), String> {
        self.director.input(self.now, kind, bytes)?;
        self.director.commit();
        Ok(())
    }

    /// Reads the memory that the next events will need, without changing anything. In a large swarm most reads miss
    /// the cache, and many overlapping misses take about as long as one.
    fn look_ahead(&self) {
        let coming = self.queue.coming();
        if coming.len() < AT_HAND {
            return;
        }
        let parcels = |from: usize| {
            let events = coming.iter().skip(from).take(AT_HAND);
            events.filter_map(|e| match e.what {
                Event::Arrive(index) => self.parcels.get(index as usize),
                Event::Wake(_) | Event::Posted(_) | Event::Awake(_) => None,
            })
        };
        let mut read = 0;
        for parcel in parcels(AT_HAND) {
            read ^= u64::from(parcel.to.0);
        }
        for parcel in parcels(0) {
            let first = parcel.to.index() * W::Agent::PORTS;
            // Every other one, since two lie within a line of the cache.
            for link in self.links[first..first + W::Agent::PORTS].iter().step_by(2).take(LINES) {
                read ^= link.state.last.0;
            }
            let module = &self.modules[parcel.to.index()];
            read ^= u64::from(module.revision.0) ^ self.world.look_ahead(parcel.to);
            read ^= module.agent.as_ref().map_or(0, |agent| agent.agent().look_ahead(parcel.port));
        }
        std::hint::black_box(read);
    }

    fn dispatch(&mut self, at: Time, event: Event) {
        match event {
            Event::Wake(id) => {
                let module = &mut self.modules[id.index()];
                // Only the latest wake-up asked for counts; earlier ones may have been given up.
                if module.wake != at {
                    return;
                }
                module.wake = Time::NEVER;
                if module.process == Process::Running {
                    self.feed(id, Input::Wake);
                }
            }
            Event::Arrive(index) => {
                let parcel = self.parcels.remove(index as usize);
                self.arrive(parcel);
            }
            Event::Posted(index) => self.posted_arrives(index),
            Event::Awake(sleep) => self.awake(sleep),
        }
        self.settle();
    }

    fn arrive(&mut self, parcel: InFlight<<W::Agent as Agent>::Message>) {
        match self.modules[parcel.to.index()].process {
            Process::Dead => self.tally[parcel.class].expired += 1,
            Process::Running => self.receive(parcel),
            Process::Stopped => {
                let backlog = self.backlogs.entry(parcel.to).or_default();
                if backlog.messages == INBOX {
                    hit(CoveragePoint::DriverInboxFull);
                    self.tally[parcel.class].overflowed += 1;
                } else {
                    backlog.messages += 1;
                    backlog.waiting.push_back(Waiting::Message(parcel));
                }
            }
        }
    }

    fn receive(&mut self, parcel: InFlight<<W::Agent as Agent>::Message>) {
        let InFlight { to, session, port, class, number, sent, message } = parcel;
        let contact = self.link(to, port).contact;
        let current = contact.map(|c| c.session);
        if current != Some(session) && !(self.config.ignore_sessions && current.is_some()) {
            hit(CoveragePoint::DriverExpired);
            self.tally[class].expired += 1;
            return;
        }
        let name = |c: Contact| MessageName { from: c.peer, incarnation: c.peer_incarnation, number };
        if self.changes.loses(|| contact.map(name)) {
            self.tally[class].lost += 1;
            return;
        }
        self.findings.checked += 1;
        if let Err(what) = invariants::session_current(session, current) {
            self.findings.note(Violation { invariant: SESSION_CURRENT, at: self.now, what });
        }
        self.tally[class].delivered += 1;
        self.latencies[class].record(self.now.since(sent));
        self.trace.event(self.now, 1, to.0, u64::from(session.0) << 8 | u64::from(message.kind()));
        let input = Input::Message { port, message };
        self.feed_heard(to, input, contact.map(|c| (name(c), class)));
    }

    fn link(&mut self, id: ModuleId, port: Port) -> &mut Link {
        &mut self.links[id.index() * W::Agent::PORTS + port.index()]
    }

    /// Hands one input to an agent and carries out its outputs.
    fn feed(&mut self, id: ModuleId, input: InputOf<W::Agent>) {
        self.feed_heard(id, input, None);
    }

    /// Hands one input to an agent and carries out its outputs; `heard` is the name of the message, if it is
    /// one.
    fn feed_heard(&mut self, id: ModuleId, input: InputOf<W::Agent>, heard: Option<(MessageName, Class)>) {
        let Module { agent: Some(agent), revision, clock, .. } = &mut self.modules[id.index()] else {
            return;
        };
        let now = clock.local(self.now);
        match &self.log {
            None => agent.handle(now, input),
            Some(log) => {
                let links = &self.links[id.index() * W::Agent::PORTS..];
                let peer = |port: Port| links[port.index()].contact.map(|c| c.peer);
                let sink = &mut *log.lock();
                let context = StepContext { heard, revision: *revision, peer: &peer, sink };
                agent.handle_recorded(now, input, context);
            }
        }
        while let Some(output) = self.modules[id.index()].agent.as_mut().and_then(AgentHost::poll) {
            self.carry_out(id, output);
        }
        self.plan_wake(id);
        self.count_input();
        self.findings.checked += 1;
        let (agents, mut found) = (Agents::of(&self.modules), Vec::new());
        self.world.audit_agent(self.now, id, &agents, &mut found);
        found.into_iter().for_each(|v| self.findings.note(v));
    }

    fn plan_wake(&mut self, id: ModuleId) {
        if let Some(at) = self.modules[id.index()].plan_wake(self.now) {
            self.queue.push(at, Event::Wake(id));
        }
    }

    fn carry_out(&mut self, id: ModuleId, output: OutputOf<W::Agent>) {
        match output {
            Output::Send { port, class, message } => self.send(Sent { from: id, port, class, message }),
            Output::Act(action) => {
                let revision = self.modules[id.index()].revision;
                self.pass(id, BodyMessage::Act(revision, action));
            }
            Output::Report(report) => self.pass(id, BodyMessage::Report(report)),
        }
    }

    fn send(&mut self, sent: Sent<<W::Agent as Agent>::Message>) {
        let from = sent.from;
        let link = &mut self.links[from.index() * W::Agent::PORTS + sent.port.index()];
        let (parcels, queue) = (&mut self.parcels, &mut self.queue);
        let put = |at, parcel| {
            // Invariant: 2^32 messages under way would not fit into memory.
            let index = parcels.insert(parcel) as u32;
            queue.push(at, Event::Arrive(index));
        };
        let module = &mut self.modules[from.index()];
        let crossed = link.contact.and_then(|c| self.hosts.as_mut()?.crossed(from, c.peer));
        let Some(crossed) = crossed else {
            return module.send(&self.config.link, self.now, sent, link, &mut self.tally, put);
        };
        let mut counts = Tally::default();
        module.send(&self.config.link, self.now, sent, link, &mut counts, put);
        crossed.messages += counts;
        self.tally += counts;
    }

    /// Hands what bodies sensed to their agents and carries out the controller's commands, until nothing is left to
    /// do at this instant.
    fn settle(&mut self) {
        let mut bodies_moved = false;
        while self.time_passes().is_ok() {
            let found = self.world.take_violations();
            found.into_iter().for_each(|v| self.findings.note(v));
            if let Some((id, sensed)) = self.world.poll() {
                bodies_moved |= matches!(sensed, Sensed::Percept(_));
                self.pass(id, BodyMessage::Sensed(sensed));
            } else if let Some(command) = self.director.poll() {
                self.execute(command);
            } else if bodies_moved {
                bodies_moved = false;
                self.director.wake(self.now, &mut self.world);
            } else {
                return;
            }
        }
    }

    fn sense(&mut self, id: ModuleId, sensed: Sensed<<W::Agent as Agent>::Percept>) {
        match self.modules[id.index()].process {
            Process::Dead => return,
            Process::Stopped => {
                return self.backlogs.entry(id).or_default().waiting.push_back(Waiting::Sensed(sensed));
            }
            Process::Running => {}
        }
        self.body_messages += 1;
        match sensed {
            Sensed::Contact { port, revision, contact } => {
                let session = contact.map(|c| c.session);
                *self.link(id, port) = Link { contact, state: LinkState::begun(self.now) };
                self.modules[id.index()].revision = revision;
                self.trace.event(self.now, 3, id.0, session.map_or(0, |s| u64::from(s.0)));
                self.feed(id, Input::Contact { port, session });
            }
            Sensed::Percept(percept) => {
                self.trace.event(self.now, 4, id.0, u64::from(percept.kind()));
                self.feed(id, Input::Percept(percept));
            }
        }
    }

    fn execute(&mut self, command: Command<<W::Agent as Agent>::Order>) {
        let now = self.now;
        match command {
            Command::Kill(id) => {
                self.changes.wakes_no_longer(id);
                let module = &mut self.modules[id.index()];
                if std::mem::replace(&mut module.process, Process::Dead) != Process::Dead {
                    for unread in self.backlogs.remove(&id).into_iter().flat_map(|b| b.waiting) {
                        if let Waiting::Message(parcel) = unread {
                            hit(CoveragePoint::DriverDiedUnread);
                            self.tally[parcel.class].expired += 1;
                        }
                    }
                    self.trace.event(now, 5, id.0, 0);
                    self.director.died(now, id);
                }
            }
            Command::Pause(id) => {
                self.changes.wakes_no_longer(id);
                let module = &mut self.modules[id.index()];
                if module.is_alive() {
                    module.process = Process::Stopped;
                }
                self.trace.event(now, 6, id.0, 0);
            }
            Command::Resume(id) => {
                self.changes.wakes_no_longer(id);
                self.resume(id);
            }
            Command::Restart(id) => {
                let module = &self.modules[id.index()];
                // A module has 65,536 incarnations; after the last it stays dead.
                let is_possible = !module.is_alive() && self.config.link.has_place(id);
                if let Some(next) = module.incarnation.0.checked_add(1).filter(|_| is_possible) {
                    self.start(id, Incarnation(next));
                }
            }
            Command::Order(id, order) => self.pass(id, BodyMessage::Order(order)),
            Command::Finish => self.finished = true,
            Command::Links(changes) => self.config.link.changes = changes,
            Command::Host(host, change) => self.change_host(host, change),
        }
    }

    fn change_host(&mut self, host: HostId, change: HostChange) {
        self.trace.event(self.now, 11 + change as u8, u32::from(host.0), 0);
        self.config.link.change_host(host, change);
        if let Some((streams, hosts)) = self.hosts.as_mut().zip(self.config.link.hosts.clone()) {
            streams.hosts = hosts;
        }
    }

    fn resume(&mut self, id: ModuleId) {
        let module = &mut self.modules[id.index()];
        if module.process != Process::Stopped {
            return;
        }
        module.process = Process::Running;
        self.trace.event(self.now, 8, id.0, 0);
        for waiting in self.backlogs.remove(&id).into_iter().flat_map(|b| b.waiting) {
            hit(CoveragePoint::DriverSleptOver);
            match waiting {
                Waiting::Sensed(sensed) => self.sense(id, sensed),
                Waiting::Order(order) => self.order(id, order),
                Waiting::Message(parcel) => self.receive(parcel),
            }
        }
        self.feed(id, Input::Wake);
    }

    fn start(&mut self, id: ModuleId, incarnation: Incarnation) {
        let (place, seed, born) = (self.world.place(id), self.births, self.now);
        let birth = Birth { id, incarnation, place, seed, born };
        let module = &mut self.modules[id.index()];
        // Its home may be another one than that of its last incarnation.
        module.clock = self.config.link.clock(id);
        let now = module.clock.local(born);
        module.agent = Some(match &self.log {
            None => AgentHost::new(&self.config.setup, birth, now),
            Some(log) => AgentHost::recorded(&self.config.setup, birth, now, &mut *log.lock()),
        });
        module.process = Process::Running;
        module.started = born;
        module.incarnation = incarnation;
        module.sent = 0;
        let first = id.index() * W::Agent::PORTS;
        self.links[first..first + W::Agent::PORTS]
            .fill(Link { contact: None, state: LinkState::begun(self.now) });
        self.trace.event(self.now, 9, id.0, u64::from(incarnation.0));
        self.plan_wake(id);
        self.world.start(self.now, id, incarnation);
        self.director.started(self.now, id);
    }
}

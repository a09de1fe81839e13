//! The simulated link: a discrete-event kernel that drives any number of agents in virtual time.
//!
//! One queue, ordered by time and then by the order of scheduling; one named random stream per
//! sender. Same setup and seed, same events, on every machine and build.

use crate::chronicle::Log;
use crate::direct::{Command, Direct};
use crate::invariants::{self, Invariant, Violation};
use crate::trace::Trace;
use crate::world::{Contact, Sensed, World};
use metamorph_protocol::agent::{Agent, Birth, Class, Input, InputOf, Output, OutputOf};
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::journal::{self, Diary, MessageName};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::marks::{Mark, hit};
use metamorph_protocol::stream::Stream;
use metamorph_protocol::tally::Tally;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{Channel, Frame, Header, Wire, WireError};
use siphasher::sip::SipHasher13;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::hash::Hasher;
use std::sync::Arc;

/// Messages that a stopped process can have waiting, as in a real inbox.
const INBOX: usize = 32;
/// Violations kept; a broken protocol makes many, and the first ones tell the story.
const MAX_VIOLATIONS: usize = 100;

/// A world whose agents can be audited: the invariants that only agents and world together show.
pub trait Audited: World {
    /// Checks what one agent's last input may have broken.
    fn audit_agent(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, Self::Agent>,
        found: &mut Vec<Violation>,
    );
    /// Checks an action at the moment the world has accepted or refused it.
    fn audit_action(
        &self,
        now: Time,
        id: ModuleId,
        agents: &Agents<'_, Self::Agent>,
        found: &mut Vec<Violation>,
    );
    /// Checks everything, now and then.
    fn audit_all(&mut self, now: Time, agents: &Agents<'_, Self::Agent>, found: &mut Vec<Violation>);
    /// Takes what the world itself has found broken.
    fn take_violations(&mut self) -> Vec<Violation>;
}

/// Read access to the living agents, for audits.
pub struct Agents<'a, A: Agent> {
    slots: &'a [Slot<A>],
}

impl<A: Agent> Agents<'_, A> {
    /// The agent of a module, if its process lives.
    pub fn get(&self, id: ModuleId) -> Option<&A> {
        self.slots.get(id.index()).filter(|s| s.alive).and_then(|s| s.agent.as_ref())
    }
    /// All living agents.
    pub fn iter(&self) -> impl Iterator<Item = (ModuleId, &A)> {
        (0..self.slots.len() as u32).map(ModuleId).filter_map(|id| self.get(id).map(|a| (id, a)))
    }
}

/// What a simulated run starts from, besides its world and its director.
pub struct SimConfig<A: Agent> {
    /// What the agents share.
    pub setup: Arc<A::Setup>,
    /// The link.
    pub link: LinkModel,
    /// The seed of the run.
    pub seed: u64,
    /// How often everything is audited; every action and every input is audited anyway.
    pub audit_every: metamorph_protocol::time::Span,
    /// Messages are delivered whatever session they were sent in. For tests that show why not to.
    #[doc(hidden)]
    pub ignore_sessions: bool,
}

struct Slot<A: Agent> {
    agent: Option<A>,
    alive: bool,
    paused: bool,
    incarnation: Incarnation,
    contacts: Vec<Option<Contact>>,
    last_arrival: Vec<Time>,
    revision: Revision,
    stream: Stream,
    /// The time of the wake-up that is in the queue.
    wake: Time,
    waiting: VecDeque<Waiting<A>>,
    waiting_messages: usize,
    /// Messages sent in this life.
    sent: u32,
    diary: Option<Diary>,
}

/// What reaches a stopped process.
enum Waiting<A: Agent> {
    Sensed(Sensed<A::Percept>),
    Message { port: Port, session: Session, class: Class, number: u32, message: A::Message },
    Order(A::Order),
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Event {
    at: Time,
    order: u64,
    what: What,
}

#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum What {
    Arrive(u32),
    Wake(ModuleId),
}

/// A message under way.
struct Parcel<M> {
    to: ModuleId,
    port: Port,
    session: Session,
    class: Class,
    /// Its number among all messages of its sender's life.
    number: u32,
    message: M,
}

/// A simulated run.
pub struct Sim<W: Audited, D: Direct<W>> {
    now: Time,
    config: SimConfig<W::Agent>,
    world: W,
    director: D,
    slots: Vec<Slot<W::Agent>>,
    queue: BinaryHeap<Reverse<Event>>,
    order: u64,
    parcels: Vec<Option<Parcel<<W::Agent as Agent>::Message>>>,
    free: Vec<u32>,
    tally: Tally,
    body_messages: u64,
    trace: Trace,
    violations: Vec<Violation>,
    broken: u64,
    checked: u64,
    next_audit: Time,
    finished: bool,
    log: Option<Log>,
}

impl<W: Audited, D: Direct<W>> Sim<W, D> {
    /// A run at time zero, with all agents started.
    pub fn new(config: SimConfig<W::Agent>, world: W, director: D) -> Self {
        Sim::with_journal(config, world, director, None)
    }

    /// The same, writing down what agents do. World and director are the recorded ones then.
    pub fn with_journal(config: SimConfig<W::Agent>, world: W, director: D, log: Option<Log>) -> Self {
        let slots = (0..world.len())
            .map(|i| Slot {
                agent: None,
                alive: false,
                paused: false,
                incarnation: Incarnation(0),
                contacts: vec![None; W::Agent::PORTS],
                last_arrival: vec![Time::ZERO; W::Agent::PORTS],
                revision: Revision(0),
                stream: Stream::named(config.seed, "link", i as u64),
                wake: Time::NEVER,
                waiting: VecDeque::new(),
                waiting_messages: 0,
                sent: 0,
                diary: None,
            })
            .collect();
        let mut sim = Sim {
            now: Time::ZERO,
            next_audit: Time::ZERO + config.audit_every,
            config,
            world,
            director,
            slots,
            queue: BinaryHeap::new(),
            order: 0,
            parcels: Vec::new(),
            free: Vec::new(),
            tally: Tally::default(),
            body_messages: 0,
            trace: Trace::default(),
            violations: Vec::new(),
            broken: 0,
            checked: 0,
            finished: false,
            log,
        };
        for i in 0..sim.slots.len() as u32 {
            sim.start(ModuleId(i), Incarnation(0));
        }
        sim.audit_all();
        sim.settle();
        sim
    }

    /// The present.
    pub fn now(&self) -> Time {
        self.now
    }
    /// The world.
    pub fn world(&self) -> &W {
        &self.world
    }
    /// The controller's brain.
    pub fn director(&self) -> &D {
        &self.director
    }
    /// The living agents.
    pub fn agents(&self) -> Agents<'_, W::Agent> {
        Agents { slots: &self.slots }
    }
    /// Message counts.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }
    /// Actions, percepts and contact changes carried between agents and bodies, reports and orders.
    pub fn body_messages(&self) -> u64 {
        self.body_messages
    }
    /// The trace so far.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }
    /// Invariants found broken: the first hundred, and how many in all.
    pub fn violations(&self) -> (&[Violation], u64) {
        (&self.violations, self.broken)
    }
    /// How often an invariant was checked.
    pub fn checked(&self) -> u64 {
        self.checked
    }

    /// Runs until the director finishes the run, nothing is left to happen, or `until` has come.
    /// Says whether the run is over.
    pub fn run_until(&mut self, until: Time) -> bool {
        while !self.finished {
            let event = self.queue.peek().map_or(Time::NEVER, |Reverse(e)| e.at);
            let (world, director) = (self.world.next_event(), self.director.wake_at());
            let next = event.min(world).min(director).max(self.now);
            if next == Time::NEVER || next > until {
                self.now = self.now.max(until.min(next));
                return next == Time::NEVER;
            }
            self.now = next;
            // At one instant bodies come first, then messages and timers, then the controller.
            if world <= next {
                self.world.advance(next);
                self.settle();
            } else if event <= next {
                if let Some(Reverse(event)) = self.queue.pop() {
                    self.dispatch(event);
                }
            } else {
                self.director.wake(self.now, &mut self.world);
                self.settle();
            }
            if self.now >= self.next_audit {
                self.audit_all();
                self.next_audit = self.now + self.config.audit_every;
            }
        }
        self.audit_all();
        true
    }

    fn dispatch(&mut self, event: Event) {
        match event.what {
            What::Wake(id) => {
                let slot = &mut self.slots[id.index()];
                // Only the latest wake-up asked for counts; earlier plans may have been given up.
                if slot.wake != event.at {
                    return;
                }
                slot.wake = Time::NEVER;
                if slot.alive && !slot.paused {
                    self.feed(id, Input::Wake);
                }
            }
            What::Arrive(index) => {
                let parcel = self.parcels[index as usize].take();
                self.free.push(index);
                if let Some(parcel) = parcel {
                    self.arrive(parcel);
                }
            }
        }
        self.settle();
    }

    fn arrive(&mut self, parcel: Parcel<<W::Agent as Agent>::Message>) {
        let Parcel { to, port, session, class, number, message } = parcel;
        let slot = &mut self.slots[to.index()];
        if !slot.alive {
            self.tally[class].expired += 1;
        } else if slot.paused {
            if slot.waiting_messages == INBOX {
                hit(Mark::DriverInboxFull);
                self.tally[class].overflowed += 1;
            } else {
                slot.waiting_messages += 1;
                slot.waiting.push_back(Waiting::Message { port, session, class, number, message });
            }
        } else {
            self.receive(to, port, session, class, number, message);
        }
    }

    fn receive(
        &mut self,
        to: ModuleId,
        port: Port,
        session: Session,
        class: Class,
        number: u32,
        message: <W::Agent as Agent>::Message,
    ) {
        let contact = self.slots[to.index()].contacts[port.index()];
        let current = contact.map(|c| c.session);
        if current != Some(session) && !(self.config.ignore_sessions && current.is_some()) {
            hit(Mark::DriverExpired);
            self.tally[class].expired += 1;
            return;
        }
        self.checked += 1;
        if let Err(what) = invariants::session_current(session, current) {
            self.note(Violation { invariant: Invariant::SessionCurrent, at: self.now, what });
        }
        self.tally[class].delivered += 1;
        self.trace.event(self.now, 1, to.0, u64::from(session.0) << 8 | u64::from(message.kind()));
        let input = Input::Message { port, message };
        if self.log.is_some() {
            let name = |c: Contact| MessageName { from: c.peer, life: c.peer_incarnation, number };
            return self.feed_recorded(to, input, contact.map(|c| (name(c), class)));
        }
        self.feed(to, input);
    }

    /// Hands one input to an agent and carries out what it does.
    fn feed(&mut self, id: ModuleId, input: InputOf<W::Agent>) {
        if self.log.is_some() {
            return self.feed_recorded(id, input, None);
        }
        let now = self.now;
        let Some(agent) = &mut self.slots[id.index()].agent else { return };
        agent.handle(now, input);
        while let Some(output) = self.slots[id.index()].agent.as_mut().and_then(Agent::poll) {
            self.carry_out(id, output);
        }
        self.fed(id);
    }

    /// The same with a journal: the step is written down before its outputs are carried out.
    fn feed_recorded(&mut self, id: ModuleId, input: InputOf<W::Agent>, heard: Option<(MessageName, Class)>) {
        let now = self.now;
        let Slot { agent: Some(agent), diary: Some(diary), contacts, revision, .. } =
            &mut self.slots[id.index()]
        else {
            return;
        };
        let (taken, mut outputs) = (Diary::taken::<W::Agent>(&input, heard), Vec::new());
        let digest = journal::step(agent, now, input, &mut outputs);
        if let Some(log) = &self.log {
            let peer = |port: Port| contacts[port.index()].map(|c| c.peer);
            diary.step(now, taken, agent, &outputs, digest, *revision, peer, &mut *log.borrow_mut());
        }
        outputs.into_iter().for_each(|output| self.carry_out(id, output));
        self.fed(id);
    }

    fn fed(&mut self, id: ModuleId) {
        self.plan_wake(id);
        self.checked += 1;
        let (agents, mut found) = (Agents { slots: &self.slots }, Vec::new());
        self.world.audit_agent(self.now, id, &agents, &mut found);
        found.into_iter().for_each(|v| self.note(v));
    }

    fn plan_wake(&mut self, id: ModuleId) {
        let slot = &mut self.slots[id.index()];
        let Some(at) = slot.agent.as_ref().map(Agent::wake_at) else { return };
        if at != slot.wake {
            slot.wake = at;
            if at != Time::NEVER {
                self.order += 1;
                self.queue.push(Reverse(Event {
                    at: at.max(self.now),
                    order: self.order,
                    what: What::Wake(id),
                }));
                slot.wake = at.max(self.now);
            }
        }
    }

    fn carry_out(&mut self, id: ModuleId, output: OutputOf<W::Agent>) {
        match output {
            Output::Send { port, class, message } => self.send(id, port, class, message),
            Output::Act(action) => {
                self.body_messages += 1;
                self.trace.event(self.now, 2, id.0, u64::from(action.kind()));
                let revision = self.slots[id.index()].revision;
                self.world.act(self.now, id, revision, &action);
                self.checked += 1;
                let (agents, mut found) = (Agents { slots: &self.slots }, Vec::new());
                self.world.audit_action(self.now, id, &agents, &mut found);
                found.into_iter().for_each(|v| self.note(v));
            }
            Output::Report(report) => {
                self.body_messages += 1;
                self.director.report(self.now, id, report);
            }
        }
    }

    fn send(&mut self, from: ModuleId, port: Port, class: Class, message: <W::Agent as Agent>::Message) {
        let counts = &mut self.tally[class];
        counts.sent += 1;
        counts.bytes += message.wire_len() as u64;
        let slot = &mut self.slots[from.index()];
        let number = slot.sent;
        slot.sent = number.wrapping_add(1);
        let Some(contact) = slot.contacts[port.index()] else {
            counts.expired += 1;
            return;
        };
        let last = &mut slot.last_arrival[port.index()];
        let fate = self.config.link.carry(self.now, from, contact.peer, &mut slot.stream, last);
        let mut copies = 0;
        for arrival in fate.arrivals.into_iter().flatten() {
            copies += 1;
            let message = match arrival.flipped_bit {
                None => Ok(message.clone()),
                Some(bit) => damaged(from, contact, port, class, &message, bit),
            };
            let parcel = match message {
                Ok(message) => Parcel {
                    to: contact.peer,
                    port: contact.peer_port,
                    session: contact.session,
                    class,
                    number,
                    message,
                },
                Err(_) => {
                    hit(Mark::DriverDamaged);
                    self.tally[class].refused += 1;
                    continue;
                }
            };
            let index = self.free.pop().unwrap_or_else(|| {
                self.parcels.push(None);
                self.parcels.len() as u32 - 1
            });
            self.parcels[index as usize] = Some(parcel);
            self.order += 1;
            self.queue.push(Reverse(Event { at: arrival.at, order: self.order, what: What::Arrive(index) }));
        }
        match copies {
            0 => self.tally[class].lost += 1,
            n => self.tally[class].duplicated += n - 1,
        }
    }

    /// Carries what bodies sensed to their agents, and the controller's commands out, until nothing
    /// more happens at this instant.
    fn settle(&mut self) {
        let mut bodies_moved = false;
        loop {
            let found = self.world.take_violations();
            found.into_iter().for_each(|v| self.note(v));
            if let Some((id, sensed)) = self.world.poll() {
                bodies_moved |= matches!(sensed, Sensed::Percept(_));
                self.sense(id, sensed);
            } else if let Some(command) = self.director.poll() {
                self.obey(command);
            } else if bodies_moved {
                bodies_moved = false;
                self.director.wake(self.now, &mut self.world);
            } else {
                return;
            }
        }
    }

    fn sense(&mut self, id: ModuleId, sensed: Sensed<<W::Agent as Agent>::Percept>) {
        let slot = &mut self.slots[id.index()];
        if !slot.alive {
            return;
        }
        if slot.paused {
            slot.waiting.push_back(Waiting::Sensed(sensed));
            return;
        }
        self.body_messages += 1;
        match sensed {
            Sensed::Contact { port, revision, contact } => {
                let session = contact.map(|c| c.session);
                slot.contacts[port.index()] = contact;
                slot.last_arrival[port.index()] = self.now;
                slot.revision = revision;
                self.trace.event(self.now, 3, id.0, session.map_or(0, |s| u64::from(s.0)));
                self.feed(id, Input::Contact { port, session });
            }
            Sensed::Percept(percept) => {
                self.trace.event(self.now, 4, id.0, u64::from(percept.kind()));
                self.feed(id, Input::Percept(percept));
            }
        }
    }

    fn obey(&mut self, command: Command<<W::Agent as Agent>::Order>) {
        let now = self.now;
        match command {
            Command::Kill(id) => {
                let slot = &mut self.slots[id.index()];
                if std::mem::replace(&mut slot.alive, false) {
                    slot.paused = false;
                    slot.waiting_messages = 0;
                    let unread: Vec<_> = slot.waiting.drain(..).collect();
                    for waiting in unread {
                        if let Waiting::Message { class, .. } = waiting {
                            hit(Mark::DriverDiedUnread);
                            self.tally[class].expired += 1;
                        }
                    }
                    self.trace.event(now, 5, id.0, 0);
                    self.director.died(now, id);
                }
            }
            Command::Pause(id) => {
                self.slots[id.index()].paused = self.slots[id.index()].alive;
                self.trace.event(now, 6, id.0, 0);
            }
            Command::Resume(id) => self.resume(id),
            Command::Restart(id) => {
                let slot = &self.slots[id.index()];
                // A module has 65,535 lives; after that it stays dead.
                if let Some(next) = slot.incarnation.0.checked_add(1).filter(|_| !slot.alive) {
                    self.start(id, Incarnation(next));
                }
            }
            Command::Order(id, order) => {
                let slot = &mut self.slots[id.index()];
                if slot.paused {
                    slot.waiting.push_back(Waiting::Order(order));
                } else if slot.alive {
                    self.body_messages += 1;
                    self.trace.event(now, 7, id.0, u64::from(order.kind()));
                    self.feed(id, Input::Order(order));
                }
            }
            Command::Finish => self.finished = true,
        }
    }

    fn resume(&mut self, id: ModuleId) {
        let slot = &mut self.slots[id.index()];
        if !std::mem::replace(&mut slot.paused, false) {
            return;
        }
        slot.waiting_messages = 0;
        self.trace.event(self.now, 8, id.0, 0);
        let waiting: Vec<_> = slot.waiting.drain(..).collect();
        for waiting in waiting {
            hit(Mark::DriverSleptOver);
            match waiting {
                Waiting::Sensed(sensed) => self.sense(id, sensed),
                Waiting::Order(order) => self.obey(Command::Order(id, order)),
                Waiting::Message { port, session, class, number, message } => {
                    self.receive(id, port, session, class, number, message);
                }
            }
        }
        self.feed(id, Input::Wake);
    }

    fn start(&mut self, id: ModuleId, incarnation: Incarnation) {
        let birth = Birth { id, incarnation, place: self.world.place(id), seed: self.config.seed };
        let slot = &mut self.slots[id.index()];
        slot.agent = Some(W::Agent::new(&self.config.setup, birth, self.now));
        slot.alive = true;
        slot.paused = false;
        slot.incarnation = incarnation;
        slot.contacts.fill(None);
        slot.last_arrival.fill(self.now);
        slot.sent = 0;
        if let Some(log) = &self.log {
            let (diary, born) = Diary::new::<W::Agent>(self.now, id, incarnation, &self.world.place(id));
            slot.diary = Some(diary);
            log.borrow_mut().put(&born);
        }
        self.trace.event(self.now, 9, id.0, u64::from(incarnation.0));
        self.plan_wake(id);
        self.world.start(self.now, id, incarnation);
        self.director.started(self.now, id);
    }

    fn note(&mut self, violation: Violation) {
        self.broken += 1;
        if self.violations.len() < MAX_VIOLATIONS {
            self.violations.push(violation);
        }
    }

    fn audit_all(&mut self) {
        self.checked += 1;
        let (agents, mut found) = (Agents { slots: &self.slots }, Vec::new());
        self.world.audit_all(self.now, &agents, &mut found);
        found.extend(self.world.take_violations());
        let waiting: usize = self.slots.iter().map(|s| s.waiting_messages).sum();
        let in_flight = self.parcels.iter().flatten().count() + waiting;
        if let Err(what) = invariants::messages_balance(&self.tally, in_flight as u64) {
            found.push(Violation { invariant: Invariant::MessagesBalance, at: self.now, what });
        }
        found.into_iter().for_each(|v| self.note(v));
    }

    /// The hash of the state of all agents, for comparing runs.
    pub fn digest(&self) -> u64 {
        let mut hasher = SipHasher13::new();
        for slot in &self.slots {
            hasher.write_u8(slot.alive.into());
            if let Some(agent) = &slot.agent {
                agent.digest(&mut hasher);
            }
        }
        hasher.finish()
    }
}

/// A message after a bit of its frame has flipped: refused almost always.
fn damaged<M: Wire>(
    from: ModuleId,
    contact: Contact,
    port: Port,
    class: Class,
    message: &M,
    bit: u64,
) -> Result<M, WireError> {
    let header = Header {
        channel: Channel::Peer,
        kind: message.kind(),
        class,
        port,
        incarnation: Incarnation(0),
        source: from,
        destination: contact.peer,
        session: contact.session.0,
        sequence: 0,
    };
    let mut frame = Frame::seal(header, message);
    frame.flip(bit);
    frame.open()?;
    frame.message()
}

//! A small swarm as a state space: the real agents, the real world, and every fault that a budget
//! allows, at every moment.
//!
//! *What is explored.* Time is exact and passes from event to event, as on the simulated link. A message
//! always takes [`Bounds::delay`]. Whenever messages of several senders are due at one module, every order of
//! them is tried. In addition a run may deviate from that as often as [`Budget`] says, and **every** run with
//! that number of deviations is explored: any message may be lost, delivered twice, or late by any of
//! [`Bounds::late`]; any module may crash, restart or stop for any of [`Bounds::pauses`], before and after
//! every event. Late messages overtake and are overtaken. All invariants of the simulator are checked after
//! every step, with its own audits.
//!
//! *What is not.* More deviations than the budget; other delays than those named; timers that fire late
//! without a pause; events after the goal is built or after [`Bounds::horizon`]. Agents draw their random
//! numbers for [`SwarmModel::seed`] only. Two modules that act at one instant do so in the order of their
//! numbers. There is no controller, so no module is told of deaths or of later goals.

use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output};
use metamorph_protocol::host::AgentHost;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::runtime::{Contact, Sensed};
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::kernel::audited::{Agents, Audited, Swarm};
use stateright::{Model, Property};
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

/// The number of deviations of a run from one without faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Budget {
    /// The number of messages lost.
    pub lost: u8,
    /// The number of messages delivered twice, the second time late.
    pub doubled: u8,
    /// The number of late messages.
    pub late: u8,
    /// The number of processes stopped for a while.
    pub paused: u8,
    /// The number of processes killed.
    pub crashed: u8,
    /// The number of dead processes restarted.
    pub restarted: u8,
}

/// The bounds of an exploration.
#[derive(Clone, Debug)]
pub struct Bounds {
    /// The budget of deviations at the start.
    pub budget: Budget,
    /// The delay of a message.
    pub delay: Span,
    /// The additional delays of late messages.
    pub late: Vec<Span>,
    /// The durations of stops.
    pub pauses: Vec<Span>,
    /// The end of the exploration, unless the goal is built before.
    pub horizon: Time,
}

/// A small swarm.
pub struct SwarmModel<W: Audited> {
    pub setup: Arc<<W::Agent as Agent>::Setup>,
    pub world: W,
    pub seed: u64,
    pub bounds: Bounds,
    /// Returns true if an agent has finished; [`SwarmModel::needed`] agents have to.
    pub done: fn(&W::Agent) -> bool,
    pub needed: usize,
}

/// One step that the environment can choose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// The next event without a choice: time passes, bodies arrive, timers fire.
    Advance,
    /// A message that is due arrives.
    Deliver(usize),
    /// The message is lost.
    Lose(usize),
    /// The message arrives, and once more later.
    Double(usize, Span),
    /// The message comes later instead.
    Delay(usize, Span),
    /// A process stops until then.
    Pause(ModuleId, Time),
    /// A process is killed.
    Crash(ModuleId),
    /// A dead process is restarted, with an empty memory.
    Restart(ModuleId),
}

/// A message under way.
#[derive(Clone, PartialEq, Eq, Hash)]
struct InFlight<M> {
    due: Time,
    from: ModuleId,
    to: ModuleId,
    port: Port,
    session: Session,
    message: Arc<M>,
}

/// An input to a stopped process.
#[derive(Clone, Debug)]
enum Waiting<P, M> {
    Sensed(Sensed<P>),
    Message(Port, Session, Arc<M>),
}

/// The process of a module. Agents are large and most steps change one, so states share them.
struct Process<A: Agent> {
    agent: Arc<AgentHost<A>>,
    alive: bool,
    incarnation: Incarnation,
    contacts: Vec<Option<Contact>>,
    revision: Revision,
    paused: Option<Time>,
    waiting: Vec<Waiting<A::Percept, A::Message>>,
    /// The digest of all fields above.
    digest: u64,
}

impl<A: Agent> Clone for Process<A> {
    fn clone(&self) -> Self {
        Process {
            agent: Arc::clone(&self.agent),
            alive: self.alive,
            incarnation: self.incarnation,
            contacts: self.contacts.clone(),
            revision: self.revision,
            paused: self.paused,
            waiting: self.waiting.clone(),
            digest: self.digest,
        }
    }
}

impl<A: Agent + Hash> Process<A> {
    fn seal(&mut self) {
        let mut hasher = DefaultHasher::new();
        if self.alive {
            // The whole state: fields that a digest leaves out decide when events happen.
            self.agent.agent().hash(&mut hasher);
        }
        (self.alive, self.incarnation, &self.contacts, self.revision, self.paused).hash(&mut hasher);
        format!("{:?}", self.waiting).hash(&mut hasher);
        self.digest = hasher.finish();
    }
}

/// A state of a run.
pub struct Moment<W: Audited> {
    now: Time,
    world: Arc<W>,
    processes: Processes<W::Agent>,
    under_way: Vec<InFlight<<W::Agent as Agent>::Message>>,
    left: Budget,
    /// The first invariant that broke.
    pub broken: Option<String>,
    pub built: bool,
}

struct Processes<A: Agent>(Vec<Process<A>>);

impl<A: Agent> Swarm<A> for Processes<A> {
    fn modules(&self) -> usize {
        self.0.len()
    }
    fn living(&self, index: usize) -> Option<&A> {
        self.0.get(index).filter(|p| p.alive).map(|p| p.agent.agent())
    }
}

impl<W: Audited> Clone for Moment<W> {
    fn clone(&self) -> Self {
        Moment {
            now: self.now,
            world: Arc::clone(&self.world),
            processes: Processes(self.processes.0.clone()),
            under_way: self.under_way.clone(),
            left: self.left,
            broken: self.broken.clone(),
            built: self.built,
        }
    }
}

impl<W: Audited + Hash> Hash for Moment<W>
where
    <W::Agent as Agent>::Message: Hash,
{
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.now.hash(state);
        self.world.hash(state);
        self.processes.0.iter().for_each(|p| p.digest.hash(state));
        self.under_way.hash(state);
        (self.left, &self.broken).hash(state);
    }
}

impl<W: Audited> fmt::Debug for Moment<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at {}: {} messages under way", self.now, self.under_way.len())?;
        self.broken.iter().try_for_each(|broken| write!(f, ", {broken}"))
    }
}

impl<W: Audited> PartialEq for Moment<W>
where
    W: Hash,
    <W::Agent as Agent>::Message: Hash,
{
    /// As exact as the checker itself, which tells states apart by their hash.
    fn eq(&self, other: &Self) -> bool {
        let hash = |moment: &Self| {
            let mut hasher = DefaultHasher::new();
            moment.hash(&mut hasher);
            hasher.finish()
        };
        hash(self) == hash(other)
    }
}

impl<W> SwarmModel<W>
where
    W: Audited + Clone,
    W::Agent: Clone + Hash,
{
    fn begin(&self) -> Moment<W> {
        let mut world = self.world.clone();
        let process = |id| {
            let place = world.place(id);
            Process {
                agent: Arc::new(self.born(id, Incarnation(0), place, Time::ZERO)),
                alive: true,
                incarnation: Incarnation(0),
                contacts: vec![None; W::Agent::PORTS],
                revision: Revision(0),
                paused: None,
                waiting: Vec::new(),
                digest: 0,
            }
        };
        let processes = (0..world.len() as u32).map(ModuleId).map(process).collect();
        for id in (0..world.len() as u32).map(ModuleId) {
            world.start(Time::ZERO, id, Incarnation(0));
        }
        let mut moment = Moment {
            now: Time::ZERO,
            world: Arc::new(world),
            processes: Processes(processes),
            under_way: Vec::new(),
            left: self.bounds.budget,
            broken: None,
            built: false,
        };
        self.settle(&mut moment);
        self.conclude(&mut moment);
        self.hurry(moment)
    }

    fn born(
        &self,
        id: ModuleId,
        incarnation: Incarnation,
        place: <W::Agent as Agent>::Place,
        now: Time,
    ) -> AgentHost<W::Agent> {
        AgentHost::new(&self.setup, Birth { id, incarnation, place, seed: self.seed }, now)
    }

    /// Returns the messages that are due at the first module that has any: those of one sender in their
    /// order. Events of other modules at the same instant do not depend on them.
    fn due(&self, moment: &Moment<W>) -> Vec<usize> {
        let mut due: Vec<usize> = Vec::new();
        let is_due = |i: &usize| moment.under_way[*i].due <= moment.now;
        let Some(to) = (0..moment.under_way.len()).filter(is_due).map(|i| moment.under_way[i].to).min()
        else {
            return due;
        };
        for i in (0..moment.under_way.len()).filter(is_due) {
            let parcel = &moment.under_way[i];
            if parcel.to == to && due.iter().all(|d| moment.under_way[*d].from != parcel.from) {
                due.push(i);
            }
        }
        due
    }

    fn choices(&self, moment: &Moment<W>) -> Vec<Step> {
        let (left, bounds) = (moment.left, &self.bounds);
        let mut steps = Vec::new();
        if moment.broken.is_some() || moment.built || moment.now > bounds.horizon {
            return steps;
        }
        let due = self.due(moment);
        for i in &due {
            steps.push(Step::Deliver(*i));
            if left.lost > 0 {
                steps.push(Step::Lose(*i));
            }
            if left.doubled > 0 {
                steps.extend(bounds.late.iter().map(|by| Step::Double(*i, *by)));
            }
            if left.late > 0 {
                steps.extend(bounds.late.iter().map(|by| Step::Delay(*i, *by)));
            }
        }
        if due.is_empty() {
            steps.push(Step::Advance);
        }
        for (id, process) in (0..).map(ModuleId).zip(&moment.processes.0) {
            if !process.alive {
                if left.restarted > 0 {
                    steps.push(Step::Restart(id));
                }
                continue;
            }
            if left.crashed > 0 {
                steps.push(Step::Crash(id));
            }
            if left.paused > 0 && process.paused.is_none() {
                steps.extend(bounds.pauses.iter().map(|span| Step::Pause(id, moment.now + *span)));
            }
        }
        steps
    }

    /// Advances as long as there is no choice.
    fn hurry(&self, mut moment: Moment<W>) -> Moment<W> {
        while let [only] = &self.choices(&moment)[..] {
            moment = self.take(&moment, only);
        }
        moment
    }

    fn take(&self, moment: &Moment<W>, step: &Step) -> Moment<W> {
        let mut next = moment.clone();
        match step {
            Step::Advance => self.advance(&mut next),
            Step::Deliver(i) => {
                let parcel = next.under_way.remove(*i);
                self.arrive(&mut next, parcel);
            }
            Step::Lose(i) => {
                next.left.lost -= 1;
                next.under_way.remove(*i);
            }
            Step::Double(i, by) => {
                next.left.doubled -= 1;
                let parcel = next.under_way.remove(*i);
                post(&mut next.under_way, InFlight { due: next.now + *by, ..parcel.clone() });
                self.arrive(&mut next, parcel);
            }
            Step::Delay(i, by) => {
                next.left.late -= 1;
                let parcel = next.under_way.remove(*i);
                post(&mut next.under_way, InFlight { due: next.now + *by, ..parcel });
            }
            Step::Pause(id, until) => {
                next.left.paused -= 1;
                next.processes.0[id.index()].paused = Some(*until);
            }
            Step::Crash(id) => {
                next.left.crashed -= 1;
                let process = &mut next.processes.0[id.index()];
                (process.alive, process.paused) = (false, None);
                process.waiting.clear();
            }
            Step::Restart(id) => {
                next.left.restarted -= 1;
                let incarnation = Incarnation(next.processes.0[id.index()].incarnation.0 + 1);
                let place = next.world.place(*id);
                let process = &mut next.processes.0[id.index()];
                process.agent = Arc::new(self.born(*id, incarnation, place, next.now));
                (process.alive, process.incarnation) = (true, incarnation);
                process.contacts.fill(None);
                Arc::make_mut(&mut next.world).start(next.now, *id, incarnation);
                self.settle(&mut next);
            }
        }
        self.conclude(&mut next);
        next
    }

    /// Advances to the next event.
    fn advance(&self, moment: &mut Moment<W>) {
        let running =
            |p: &Process<W::Agent>| if p.alive { p.paused.unwrap_or(p.agent.wake_at()) } else { Time::NEVER };
        let timers = moment.processes.0.iter().map(running);
        let next =
            timers.chain(moment.under_way.iter().map(|p| p.due)).chain([moment.world.next_event()]).min();
        moment.now = moment.now.max(next.unwrap_or(Time::NEVER));
        let now = moment.now;
        Arc::make_mut(&mut moment.world).advance(now);
        self.settle(moment);
        for id in (0..moment.processes.0.len() as u32).map(ModuleId) {
            let process = &mut moment.processes.0[id.index()];
            match process.paused {
                _ if !process.alive => {}
                Some(until) if until <= now => {
                    process.paused = None;
                    for waiting in std::mem::take(&mut process.waiting) {
                        match waiting {
                            Waiting::Sensed(sensed) => self.sense(moment, id, sensed),
                            Waiting::Message(port, session, message) => {
                                self.receive(moment, id, port, session, &message)
                            }
                        }
                    }
                    self.feed(moment, id, Input::Wake);
                }
                None if process.agent.wake_at() <= now => self.feed(moment, id, Input::Wake),
                _ => {}
            }
        }
    }

    fn arrive(&self, moment: &mut Moment<W>, parcel: InFlight<<W::Agent as Agent>::Message>) {
        let process = &mut moment.processes.0[parcel.to.index()];
        if process.paused.is_some() {
            process.waiting.push(Waiting::Message(parcel.port, parcel.session, parcel.message));
        } else if process.alive {
            self.receive(moment, parcel.to, parcel.port, parcel.session, &parcel.message);
        }
    }

    fn receive(
        &self,
        moment: &mut Moment<W>,
        to: ModuleId,
        port: Port,
        session: Session,
        message: &<W::Agent as Agent>::Message,
    ) {
        let current = moment.processes.0[to.index()].contacts[port.index()].map(|c| c.session);
        if current == Some(session) {
            self.feed(moment, to, Input::Message { port, message: message.clone() });
        }
    }

    fn sense(&self, moment: &mut Moment<W>, id: ModuleId, sensed: Sensed<<W::Agent as Agent>::Percept>) {
        let process = &mut moment.processes.0[id.index()];
        if !process.alive {
            return;
        }
        if process.paused.is_some() {
            return process.waiting.push(Waiting::Sensed(sensed));
        }
        let input = match sensed {
            Sensed::Contact { port, revision, contact } => {
                process.contacts[port.index()] = contact;
                process.revision = revision;
                Input::Contact { port, session: contact.map(|c| c.session) }
            }
            Sensed::Percept(percept) => Input::Percept(percept),
        };
        self.feed(moment, id, input);
    }

    fn feed(&self, moment: &mut Moment<W>, id: ModuleId, input: InputOf<W::Agent>) {
        let now = moment.now;
        let Moment { world, processes, under_way, .. } = moment;
        let mut found = Vec::new();
        Arc::make_mut(&mut processes.0[id.index()].agent).handle(now, input);
        while let Some(output) = Arc::make_mut(&mut processes.0[id.index()].agent).poll() {
            match output {
                Output::Send { port, message, .. } => {
                    if let Some(contact) = processes.0[id.index()].contacts[port.index()] {
                        let parcel = InFlight {
                            due: now + self.bounds.delay,
                            from: id,
                            to: contact.peer,
                            port: contact.peer_port,
                            session: contact.session,
                            message: Arc::new(message),
                        };
                        post(under_way, parcel);
                    }
                }
                Output::Act(action) => {
                    let revision = processes.0[id.index()].revision;
                    Arc::make_mut(world).act(now, id, revision, &action);
                    world.audit_action(now, id, &Agents::of(processes), &mut found);
                }
                Output::Report(_) => {}
            }
        }
        Arc::make_mut(world).audit_agent(now, id, &Agents::of(processes), &mut found);
        moment.broken = moment.broken.take().or_else(|| found.first().map(ToString::to_string));
        self.settle(moment);
    }

    /// Hands agents what their bodies sensed.
    fn settle(&self, moment: &mut Moment<W>) {
        while let Some((id, sensed)) = Arc::make_mut(&mut moment.world).poll() {
            self.sense(moment, id, sensed);
        }
    }

    /// Checks the properties of a complete state.
    fn conclude(&self, moment: &mut Moment<W>) {
        let mut found = Arc::make_mut(&mut moment.world).take_violations();
        Arc::make_mut(&mut moment.world).audit_all(moment.now, &Agents::of(&moment.processes), &mut found);
        moment.broken = moment.broken.take().or_else(|| found.first().map(ToString::to_string));
        moment.built =
            moment.processes.0.iter().filter(|p| (self.done)(p.agent.agent())).count() >= self.needed;
        moment.processes.0.iter_mut().for_each(Process::seal);
    }
}

/// Inserts a message in its order: by time, then in the order of sending.
fn post<M>(under_way: &mut Vec<InFlight<M>>, parcel: InFlight<M>) {
    let at = under_way.partition_point(|p| p.due <= parcel.due);
    under_way.insert(at, parcel);
}

/// The name of the property that no invariant is broken.
pub const SAFE: &str = "safe";
/// The name of the property that the goal can be built.
pub const BUILT: &str = "built";
/// The name of the property that the goal is built by the horizon under all deviations. Not expected after a
/// crash, which may take the last module for a cell.
pub const BUILT_IN_TIME: &str = "built in time";

impl<W> Model for SwarmModel<W>
where
    W: Audited + Clone + Hash,
    W::Agent: Clone + Hash,
    <W::Agent as Agent>::Message: Hash,
{
    type State = Moment<W>;
    type Action = Step;

    fn init_states(&self) -> Vec<Moment<W>> {
        vec![self.begin()]
    }

    fn actions(&self, moment: &Moment<W>, steps: &mut Vec<Step>) {
        steps.extend(self.choices(moment));
    }

    fn next_state(&self, moment: &Moment<W>, step: Step) -> Option<Moment<W>> {
        Some(self.hurry(self.take(moment, &step)))
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(SAFE, |_, moment: &Moment<W>| moment.broken.is_none()),
            Property::sometimes(BUILT, |_, moment: &Moment<W>| moment.built),
            Property::always(BUILT_IN_TIME, |model: &Self, moment: &Moment<W>| {
                let crashed = moment.left.crashed < model.bounds.budget.crashed;
                moment.built || crashed || moment.now <= model.bounds.horizon
            }),
        ]
    }
}

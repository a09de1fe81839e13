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
//! numbers. The controller, if there is one, certifies deaths and forwards reports about them; its orders take as
//! long as messages and may be late, and are not lost. There are no later goals.

use super::controller::Controller;
use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output};
use metamorph_protocol::digest::Portable;
use metamorph_protocol::host::AgentHost;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::runtime::{Contact, Sensed};
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::kernel::audited::{Agents, Audited, Swarm};
use metamorph_sim_bridge::world::World;
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
    /// A process that is killed before the exploration begins, when, and when the exploration begins. Until then nothing
    /// deviates.
    pub dead: Option<(ModuleId, Time, Time)>,
}

/// A small swarm.
pub struct SwarmModel<W: Audited, C = ()> {
    pub controller: C,
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

/// A message or an order under way.
#[derive(Clone, PartialEq, Eq, Hash)]
struct InFlight<M, O> {
    due: Time,
    /// The sender; `None` if it is the controller.
    from: Option<ModuleId>,
    to: ModuleId,
    load: Load<M, O>,
}

#[derive(Clone, PartialEq, Eq, Hash, Debug)]
enum Load<M, O> {
    Message(Port, Session, Arc<M>),
    Order(O),
}

type InFlightOf<W> = InFlight<<<W as World>::Agent as Agent>::Message, <<W as World>::Agent as Agent>::Order>;

/// An input to a stopped process.
#[derive(Clone, Debug)]
enum Waiting<P, M, O> {
    Sensed(Sensed<P>),
    Load(Load<M, O>),
}

/// The process of a module. Agents are large and most steps change one, so states share them.
struct Process<A: Agent> {
    agent: Arc<AgentHost<A>>,
    alive: bool,
    incarnation: Incarnation,
    contacts: Vec<Option<Contact>>,
    revision: Revision,
    paused: Option<Time>,
    waiting: Vec<Waiting<A::Percept, A::Message, A::Order>>,
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
        // One long write is faster than many short ones.
        let mut gathered = Portable::new(&mut hasher);
        if self.alive {
            // The whole state: fields that a digest leaves out decide when events happen.
            self.agent.agent().hash(&mut gathered);
        }
        (self.alive, self.incarnation, &self.contacts, self.revision, self.paused).hash(&mut gathered);
        format!("{:?}", self.waiting).hash(&mut gathered);
        drop(gathered);
        self.digest = hasher.finish();
    }
}

/// A state of a run.
pub struct Moment<W: Audited, C = ()> {
    controller: C,
    now: Time,
    world: Arc<W>,
    processes: Processes<W::Agent>,
    under_way: Vec<InFlightOf<W>>,
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
    fn last(&self, index: usize) -> Option<&A> {
        self.0.get(index).map(|p| p.agent.agent())
    }
}

impl<W: Audited, C: Clone> Clone for Moment<W, C> {
    fn clone(&self) -> Self {
        Moment {
            controller: self.controller.clone(),
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

impl<W: Audited + Hash, C: Hash> Hash for Moment<W, C>
where
    <W::Agent as Agent>::Message: Hash,
    <W::Agent as Agent>::Order: Hash,
{
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.controller.hash(state);
        self.now.hash(state);
        self.world.hash(state);
        self.processes.0.iter().for_each(|p| p.digest.hash(state));
        self.under_way.hash(state);
        (self.left, &self.broken).hash(state);
    }
}

impl<W: Audited, C> fmt::Debug for Moment<W, C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at {}: {} messages under way", self.now, self.under_way.len())?;
        self.broken.iter().try_for_each(|broken| write!(f, ", {broken}"))
    }
}

impl<W: Audited, C: Hash> PartialEq for Moment<W, C>
where
    W: Hash,
    <W::Agent as Agent>::Message: Hash,
    <W::Agent as Agent>::Order: Hash,
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

impl<W, C> SwarmModel<W, C>
where
    W: Audited + Clone,
    W::Agent: Clone + Hash,
    C: Controller<W>,
{
    fn begin(&self) -> Moment<W, C> {
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
            controller: self.controller.clone(),
            now: Time::ZERO,
            world: Arc::new(world),
            processes: Processes(processes),
            under_way: Vec::new(),
            left: Budget::default(),
            broken: None,
            built: false,
        };
        self.settle(&mut moment);
        self.conclude(&mut moment);
        if let Some((id, at, begins)) = self.bounds.dead {
            moment = self.undisturbed(moment, at);
            moment.left.crashed = 1;
            moment = self.undisturbed(self.take(&moment, &Step::Crash(id)), begins);
        }
        moment.left = self.bounds.budget;
        self.hurry(moment)
    }

    /// Advances to the last event before `until` without deviations, with messages in one order.
    fn undisturbed(&self, mut moment: Moment<W, C>, until: Time) -> Moment<W, C> {
        while let Some(step) = self.choices(&moment).first() {
            let next = self.take(&moment, step);
            if next.now >= until {
                break;
            }
            moment = next;
        }
        moment
    }

    fn born(
        &self,
        id: ModuleId,
        incarnation: Incarnation,
        place: <W::Agent as Agent>::Place,
        now: Time,
    ) -> AgentHost<W::Agent> {
        AgentHost::new(&self.setup, Birth { id, incarnation, place, seed: self.seed, born: now }, now)
    }

    /// Returns the messages that are due at the first module that has any: those of one sender in their
    /// order. Events of other modules at the same instant do not depend on them.
    fn due(&self, moment: &Moment<W, C>) -> Vec<usize> {
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

    fn choices(&self, moment: &Moment<W, C>) -> Vec<Step> {
        let (left, bounds) = (moment.left, &self.bounds);
        let mut steps = Vec::new();
        if moment.broken.is_some() || moment.built || moment.now > bounds.horizon {
            return steps;
        }
        let due = self.due(moment);
        for i in &due {
            steps.push(Step::Deliver(*i));
            let is_message = moment.under_way[*i].from.is_some();
            if left.lost > 0 && is_message {
                steps.push(Step::Lose(*i));
            }
            if left.doubled > 0 && is_message {
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
    fn hurry(&self, mut moment: Moment<W, C>) -> Moment<W, C> {
        while let [only] = &self.choices(&moment)[..] {
            moment = self.take(&moment, only);
        }
        moment
    }

    fn take(&self, moment: &Moment<W, C>, step: &Step) -> Moment<W, C> {
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
                next.controller.died(next.now, *id);
                self.settle(&mut next);
            }
            Step::Restart(id) => {
                next.left.restarted -= 1;
                let incarnation = Incarnation(next.processes.0[id.index()].incarnation.0 + 1);
                let place = next.world.place(*id);
                let process = &mut next.processes.0[id.index()];
                process.agent = Arc::new(self.born(*id, incarnation, place, next.now));
                (process.alive, process.incarnation) = (true, incarnation);
                process.contacts.fill(None);
                next.controller.started(*id);
                Arc::make_mut(&mut next.world).start(next.now, *id, incarnation);
                self.settle(&mut next);
            }
        }
        self.conclude(&mut next);
        next
    }

    /// Advances to the next event.
    fn advance(&self, moment: &mut Moment<W, C>) {
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
                            Waiting::Load(load) => self.receive(moment, id, load),
                        }
                    }
                    self.feed(moment, id, Input::Wake);
                }
                None if process.agent.wake_at() <= now => self.feed(moment, id, Input::Wake),
                _ => {}
            }
        }
    }

    fn arrive(&self, moment: &mut Moment<W, C>, parcel: InFlightOf<W>) {
        let process = &mut moment.processes.0[parcel.to.index()];
        if process.paused.is_some() {
            process.waiting.push(Waiting::Load(parcel.load));
        } else if process.alive {
            self.receive(moment, parcel.to, parcel.load);
        }
    }

    fn receive(
        &self,
        moment: &mut Moment<W, C>,
        to: ModuleId,
        load: Load<<W::Agent as Agent>::Message, <W::Agent as Agent>::Order>,
    ) {
        match load {
            Load::Message(port, session, message) => {
                let current = moment.processes.0[to.index()].contacts[port.index()].map(|c| c.session);
                if current == Some(session) {
                    self.feed(moment, to, Input::Message { port, message: (*message).clone() });
                }
            }
            Load::Order(order) => self.feed(moment, to, Input::Order(order)),
        }
    }

    fn sense(&self, moment: &mut Moment<W, C>, id: ModuleId, sensed: Sensed<<W::Agent as Agent>::Percept>) {
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

    fn feed(&self, moment: &mut Moment<W, C>, id: ModuleId, input: InputOf<W::Agent>) {
        let now = moment.now;
        let Moment { world, processes, under_way, controller, .. } = moment;
        let mut found = Vec::new();
        Arc::make_mut(&mut processes.0[id.index()].agent).handle(now, input);
        while let Some(output) = Arc::make_mut(&mut processes.0[id.index()].agent).poll() {
            match output {
                Output::Send { port, message, .. } => {
                    if let Some(contact) = processes.0[id.index()].contacts[port.index()] {
                        let parcel = InFlight {
                            due: now + self.bounds.delay,
                            from: Some(id),
                            to: contact.peer,
                            load: Load::Message(contact.peer_port, contact.session, Arc::new(message)),
                        };
                        post(under_way, parcel);
                    }
                }
                Output::Act(action) => {
                    let revision = processes.0[id.index()].revision;
                    Arc::make_mut(world).act(now, id, revision, &action);
                    world.audit_action(now, id, &Agents::of(processes), &mut found);
                }
                Output::Report(report) => controller.report(id, &report),
            }
        }
        Arc::make_mut(world).audit_agent(now, id, &Agents::of(processes), &mut found);
        moment.broken = moment.broken.take().or_else(|| found.first().map(ToString::to_string));
        self.settle(moment);
    }

    /// Hands agents what their bodies sensed, and sends the controller's orders.
    fn settle(&self, moment: &mut Moment<W, C>) {
        while let Some((id, sensed)) = Arc::make_mut(&mut moment.world).poll() {
            self.sense(moment, id, sensed);
        }
        for (to, order) in moment.controller.orders(moment.now, &moment.world) {
            let due = moment.now + self.bounds.delay;
            post(&mut moment.under_way, InFlight { due, from: None, to, load: Load::Order(order) });
        }
    }

    /// Checks the properties of a complete state.
    fn conclude(&self, moment: &mut Moment<W, C>) {
        let mut found = Arc::make_mut(&mut moment.world).take_violations();
        Arc::make_mut(&mut moment.world).audit_all(moment.now, &Agents::of(&moment.processes), &mut found);
        moment.broken = moment.broken.take().or_else(|| found.first().map(ToString::to_string));
        moment.built =
            moment.processes.0.iter().filter(|p| (self.done)(p.agent.agent())).count() >= self.needed;
        moment.processes.0.iter_mut().for_each(Process::seal);
    }
}

/// Inserts a message in its order: by time, then in the order of sending.
fn post<M, O>(under_way: &mut Vec<InFlight<M, O>>, parcel: InFlight<M, O>) {
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

impl<W, C> Model for SwarmModel<W, C>
where
    W: Audited + Clone + Hash,
    W::Agent: Clone + Hash,
    <W::Agent as Agent>::Message: Hash,
    <W::Agent as Agent>::Order: Hash,
    C: Controller<W>,
{
    type State = Moment<W, C>;
    type Action = Step;

    fn init_states(&self) -> Vec<Moment<W, C>> {
        vec![self.begin()]
    }

    fn actions(&self, moment: &Moment<W, C>, steps: &mut Vec<Step>) {
        steps.extend(self.choices(moment));
    }

    fn next_state(&self, moment: &Moment<W, C>, step: Step) -> Option<Moment<W, C>> {
        Some(self.hurry(self.take(moment, &step)))
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(SAFE, |_, moment: &Moment<W, C>| moment.broken.is_none()),
            Property::sometimes(BUILT, |_, moment: &Moment<W, C>| moment.built),
            Property::always(BUILT_IN_TIME, |model: &Self, moment: &Moment<W, C>| {
                let crashed = moment.left.crashed < model.bounds.budget.crashed;
                moment.built || crashed || moment.now <= model.bounds.horizon
            }),
        ]
    }
}

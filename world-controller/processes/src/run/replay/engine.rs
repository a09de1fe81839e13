//! Re-executes a journal: agents, world and director receive the recorded inputs in the recorded order and
//! must produce the recorded outputs and states.
//!
//! Inputs must also have a source: a message received was sent, an action was asked for by its agent, and
//! what the controller sent arrives in order. Absent: reading files, and printing.

use crate::record::journal::{Consumed, Emitted, Event, MessageName, Record, Who};
use metamorph_families::runnable::{AgentOf, Runnable};
use metamorph_families::worded::input;
use metamorph_protocol::agent::Summary;
use metamorph_protocol::agent::{Agent, Birth, InputOf, Output};
use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::{Counts, Tally};
use metamorph_protocol::host::AgentHost;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::record::{self, Blob};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{Wire, WireError};
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::kernel::change::{Change, ChangeKind, NoChange};
use metamorph_sim_bridge::kernel::recording;
use metamorph_sim_bridge::kernel::state::{Held, agents_hash, world_hash};
use metamorph_sim_bridge::world::World;
use siphasher::sip::SipHasher13;
use std::collections::{BTreeMap, VecDeque};
use std::hash::Hasher;

/// The replay of one incarnation of an agent.
struct Replayed<A: Agent> {
    agent: Option<AgentHost<A>>,
    /// The hash of each message sent, indexed by number.
    sent: Vec<u64>,
    /// Actions and reports that the controller has not consumed yet, in order.
    told: VecDeque<Emitted>,
    /// Contacts, percepts and orders that the agent has not consumed yet, in order.
    inputs: VecDeque<Consumed>,
    tally: Tally,
    summary: Summary,
    /// True if its records are incomplete: it is not followed from here on.
    torn: bool,
    /// True if its process ended before the run.
    died: bool,
}

impl<A: Agent> Default for Replayed<A> {
    fn default() -> Replayed<A> {
        Replayed {
            agent: None,
            sent: Vec::new(),
            told: VecDeque::new(),
            inputs: VecDeque::new(),
            tally: Tally::default(),
            summary: Summary::default(),
            torn: false,
            died: false,
        }
    }
}

/// Number of items that a replay has executed, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Done {
    /// Records.
    pub records: u64,
    /// Inputs of agents.
    pub steps: u64,
    /// Incarnations of agents.
    pub incarnations: u64,
    /// Inputs of the world and the director.
    pub controller: u64,
    /// Records not checked, because their cause is missing.
    pub unchecked: u64,
    /// The time of the last record.
    pub until: Time,
}

/// A run being re-executed.
pub struct Engine<'a, R: Runnable> {
    swarm: &'a R,
    plan: &'a Plan,
    /// The links of the plan, with the homes that modules have at present.
    link: LinkModel,
    world: R::World,
    director: R::Director,
    incarnations: BTreeMap<(ModuleId, Incarnation), Replayed<AgentOf<R>>>,
    current: BTreeMap<ModuleId, Incarnation>,
    struck: usize,
    torn: bool,
    /// True if there are no records of agents.
    alone: bool,
    /// The seed of agents that start from now on.
    births: u64,
    done: Done,
    ended: Option<(String, Tally)>,
}

impl<'a, R: Runnable> Engine<'a, R> {
    /// Creates an engine at the start of the run.
    pub fn new(swarm: &'a R, plan: &'a Plan) -> Engine<'a, R> {
        Engine {
            swarm,
            plan,
            link: plan.link.clone(),
            world: swarm.world(plan),
            director: swarm.director(plan),
            incarnations: BTreeMap::new(),
            current: BTreeMap::new(),
            struck: 0,
            torn: false,
            alone: false,
            births: plan.seed,
            done: Done::default(),
            ended: None,
        }
    }

    /// Makes the engine accept the messages of agents to the controller without checks, for journals that contain the
    /// controller's records only.
    pub fn follow_no_agents(&mut self) {
        self.alone = true;
    }
    /// Returns world and director in their current state, and the number of recorded faults.
    pub fn into_parts(self) -> (R::World, R::Director, usize) {
        (self.world, self.director, self.struck)
    }
    /// Returns what was re-executed so far.
    pub fn done(&self) -> Done {
        self.done
    }
    /// Returns the outcome and the counts of the run, once they have been read.
    pub fn ended(&self) -> Option<&(String, Tally)> {
        self.ended.as_ref()
    }
    /// Returns each module with whether it is alive, its place, and its last recorded summary.
    pub fn modules(
        &self,
    ) -> impl Iterator<Item = (ModuleId, bool, <AgentOf<R> as Agent>::Place, Option<&Summary>)> {
        (0..self.world.len() as u32).map(ModuleId).map(|id| {
            let replayed = self.current.get(&id).and_then(|l| self.incarnations.get(&(id, *l)));
            let alive = replayed.is_some_and(|l| !l.died);
            (id, alive, self.world.place(id), replayed.map(|l| &l.summary))
        })
    }

    /// Returns the hashes of all agents and of the world in their current state, as in reports; `None` for
    /// the agents if records are missing, so that not all of them could be re-executed up to here.
    pub fn hashes(&self) -> (Option<u64>, u64) {
        let all = || {
            (0..self.world.len() as u32).map(ModuleId).map(|id| {
                let incarnation = self.current.get(&id).copied().unwrap_or(Incarnation(0));
                (incarnation, self.incarnations.get(&(id, incarnation)))
            })
        };
        let is_followed =
            !self.alone && !self.torn && all().all(|(_, replayed)| replayed.is_some_and(|l| !l.torn));
        let agents = agents_hash(all().map(|(incarnation, replayed)| Held {
            is_alive: replayed.is_some_and(|l| !l.died),
            incarnation,
            agent: replayed.and_then(|l| l.agent.as_ref()).map(AgentHost::agent),
        }));
        (is_followed.then_some(agents), world_hash(&self.world))
    }

    /// Re-executes one record.
    ///
    /// # Errors
    ///
    /// Says what differs from the record.
    pub fn carry_out(&mut self, record: &Record) -> Result<(), String> {
        self.done.records += 1;
        self.done.until = record.at;
        match record.who {
            Who::Agent(id, incarnation) => self.agent(id, incarnation, record),
            Who::Controller => self.controller(record.at, &record.event),
        }
    }

    fn agent(&mut self, id: ModuleId, incarnation: Incarnation, record: &Record) -> Result<(), String> {
        let key = (id, incarnation);
        match &record.event {
            Event::Born { place } => {
                let (place, seed, born) = (read(place)?, self.births, record.at);
                let birth = Birth { id, incarnation, place, seed, born };
                let now = self.link.clock(id).local(born);
                let replayed = self.incarnations.entry(key).or_default();
                replayed.agent = Some(AgentHost::hashed(self.swarm.setup(), birth, now));
                self.done.incarnations += 1;
                Ok(())
            }
            Event::Torn => {
                self.incarnations.entry(key).or_default().torn = true;
                Ok(())
            }
            Event::State(summary) => {
                let replayed = self.incarnations.entry(key).or_default();
                let same = replayed.agent.as_ref().is_none_or(|a| a.agent().summary(record.at) == *summary);
                replayed.summary.clone_from(summary);
                if same { Ok(()) } else { Err("it has another summary".to_owned()) }
            }
            Event::Step(step) => self.step(key, record.at, step),
            other => Err(format!("{other:?} is not an event of an agent")),
        }
    }

    fn step(&mut self, key: (ModuleId, Incarnation), at: Time, step: &record::Step) -> Result<(), String> {
        if let Consumed::Message { name, message, .. } = &step.input {
            self.check_message(*name, message)?;
        }
        let Some(replayed) = self.incarnations.get_mut(&key) else {
            return Err("it took an input before it began".to_owned());
        };
        let is_apart = self.plan.link.controller.is_some();
        if !matches!(step.input, Consumed::Message { .. } | Consumed::Wake)
            && !take(&mut replayed.inputs, &step.input, is_apart)
        {
            if !self.torn {
                return Err(format!("it took {:?}, which the controller had not sent", step.input));
            }
            self.done.unchecked += 1;
        }
        let Some(agent) = &mut replayed.agent else {
            return Err("it took an input before it began".to_owned());
        };
        if replayed.torn {
            return Ok(());
        }
        self.done.steps += 1;
        let input: InputOf<AgentOf<R>> = input(&step.input)?;
        if let Consumed::Message { class, .. } = step.input {
            replayed.tally[class].delivered += 1;
        }
        let digest = agent.handle_hashed(at, input);
        if step.first as usize != replayed.sent.len() {
            return Err(format!(
                "its messages are numbered from {}, not from {}",
                replayed.sent.len(),
                step.first
            ));
        }
        while let Some(output) = agent.poll() {
            match output {
                Output::Send { class, message, .. } => {
                    let counts = &mut replayed.tally[class];
                    counts.sent += 1;
                    counts.bytes += message.wire_len() as u64;
                    replayed.sent.push(hash(&Blob::of(&message)));
                }
                // The contact revision it carries is the driver's, and recorded separately.
                Output::Act(_) | Output::Report(_) => {}
            }
        }
        replayed.told.extend(step.told.iter().cloned());
        if digest != step.digest {
            return Err(format!(
                "after {:?} its state or output differs: {digest:016x}, not {:016x}",
                step.input, step.digest
            ));
        }
        Ok(())
    }

    fn check_message(&mut self, name: MessageName, message: &Blob) -> Result<(), String> {
        let MessageName { from, incarnation, number } = name;
        let sender = self.incarnations.get(&(from, incarnation));
        match sender.and_then(|s| s.sent.get(number as usize)) {
            Some(sent) if *sent == hash(message) => Ok(()),
            Some(_) => Err(format!("it received message {number} of module {from} with other contents")),
            None if sender.is_some_and(|s| s.torn) => {
                self.done.unchecked += 1;
                Ok(())
            }
            None => Err(format!("it received message {number} of module {from}, which had not sent it")),
        }
    }

    fn controller(&mut self, at: Time, event: &Event) -> Result<(), String> {
        self.done.controller += 1;
        match event {
            Event::Start { id, incarnation, place } => {
                if Blob::of(&self.world.place(*id)) != *place {
                    return Err(format!("module {id} starts at another place"));
                }
                self.world.start(at, *id, *incarnation);
                self.current.insert(*id, *incarnation);
                // Messages that the controller sends from here on are for this incarnation.
                self.incarnations.entry((*id, *incarnation)).or_default().died = false;
            }
            Event::Act { id, revision, action, .. } => {
                self.take_told(*id, &Emitted::Act { revision: *revision, action: action.clone() })?;
                self.world.act(at, *id, *revision, &read(action)?);
            }
            Event::Advance { ended } => {
                self.world.advance(at);
                for (id, place) in ended {
                    let got = Blob::of(&self.world.place(*id));
                    if got != *place {
                        return Err(format!("module {id} is at another place: {got:?}, not {place:?}"));
                    }
                }
            }
            Event::Report { id, report } => {
                self.take_told(*id, &Emitted::Report(report.clone()))?;
                self.director.report(at, *id, read(report)?);
            }
            Event::Started { id } => self.director.started(at, *id),
            Event::Died { id } => {
                if let Some(replayed) = self.current_incarnation(*id) {
                    replayed.died = true;
                }
                self.director.died(at, *id);
            }
            Event::External { id, what } => self.director.external(at, *id, what, &self.world),
            Event::Wake => self.director.wake(at, &mut self.world),
            Event::Input { kind, bytes } => self.director.input(at, kind, bytes)?,
            Event::Sensed { id, sensed } => self.sensed(*id, sensed)?,
            Event::Command(wanted) => {
                let got = self.director.poll().map(|c| c.map(Blob::of));
                if got.as_ref() != Some(wanted) {
                    return Err(format!("the next command of the director is {got:?}, not {wanted:?}"));
                }
                match wanted {
                    Command::Order(id, order) => self.tell(*id, Consumed::Order(order.clone())),
                    Command::Host(host, change) => self.link.change_host(*host, *change),
                    _ => {}
                }
            }
            Event::Injected { .. } => {
                let got = self.director.struck().get(self.struck).map(recording::struck);
                self.struck += 1;
                if got.as_ref() != Some(event) {
                    return Err(format!("the fault that strikes is {got:?}"));
                }
            }
            Event::Counted { id, incarnation, tally } => self.compare_counts(*id, *incarnation, tally)?,
            Event::Ended { outcome, tally } => self.end(outcome, tally)?,
            Event::Changed { change } => self.change(change)?,
            // Found by audits, which are not repeated.
            Event::Violated { .. } | Event::Resumed => {}
            Event::Torn => self.torn = true,
            other => return Err(format!("{other:?} is not an event of the controller")),
        }
        Ok(())
    }

    /// Carries out a change of the run; those of links have no effect on a replay.
    fn change(&mut self, text: &str) -> Result<(), String> {
        let change: Change = text.parse().map_err(|e: NoChange| e.to_string())?;
        match (change.kind, change.seed(self.plan.seed)) {
            (ChangeKind::Rescue(level), _) => self.director.set_rescue(level),
            (ChangeKind::All(_), Some(seed)) => {
                self.births = seed;
                for (id, incarnation) in &self.current {
                    let replayed = self.incarnations.get_mut(&(*id, *incarnation)).filter(|l| !l.died);
                    replayed.and_then(|l| l.agent.as_mut()).into_iter().for_each(|agent| agent.reseed(seed));
                }
                self.world.reseed(seed);
                self.director.reseed(seed);
            }
            _ => {}
        }
        Ok(())
    }

    /// Polls the world for what a body senses, compares it with the record, and queues it for the agent.
    fn sensed(&mut self, id: ModuleId, sensed: &Sensed<Blob>) -> Result<(), String> {
        let got = self.world.poll().map(|(id, s)| (id, s.map(Blob::of)));
        if got.as_ref() != Some(&(id, sensed.clone())) {
            return Err(format!("the body of module {id} senses {got:?}, not {sensed:?}"));
        }
        let input = match sensed {
            Sensed::Contact { port, contact, .. } => {
                Consumed::Contact { port: *port, session: contact.map(|c| c.session) }
            }
            Sensed::Percept(percept) => Consumed::Percept(percept.clone()),
        };
        self.tell(id, input);
        Ok(())
    }

    /// Compares the outcome and the counts of the whole run with the recorded ones.
    fn end(&mut self, outcome: &str, tally: &Tally) -> Result<(), String> {
        self.ended = Some((outcome.to_owned(), *tally));
        let account = self.swarm.account(self.plan, &self.director, &self.world);
        let got = account.ended.map_or(Outcome::Aborted, |(_, outcome)| outcome);
        if got.name() != outcome {
            return Err(format!("the run ended {outcome}, and now it ends {got}"));
        }
        self.compare_totals(tally)
    }

    fn current_incarnation(&mut self, id: ModuleId) -> Option<&mut Replayed<AgentOf<R>>> {
        self.current.get(&id).and_then(|incarnation| self.incarnations.get_mut(&(id, *incarnation)))
    }

    /// Queues what the controller sends to a module, if the module has a live process and agents are
    /// followed.
    fn tell(&mut self, id: ModuleId, input: Consumed) {
        if self.alone {
            return;
        }
        if let Some(replayed) = self.current_incarnation(id).filter(|l| !l.died) {
            replayed.inputs.push_back(input);
        }
    }

    fn take_told(&mut self, id: ModuleId, told: &Emitted) -> Result<(), String> {
        if self.alone {
            return Ok(());
        }
        // On a link of their own, reports may arrive after later actions.
        let is_apart = self.plan.link.controller.is_some();
        let Some(replayed) = self.current_incarnation(id) else {
            return Err(format!("module {id} told {told:?} before it began"));
        };
        let is_report = |told: &Emitted| matches!(told, Emitted::Report(_));
        let next = replayed.told.iter().position(|first| !is_apart || is_report(first) == is_report(told));
        match next.and_then(|next| replayed.told.remove(next)) {
            Some(first) if first == *told => Ok(()),
            None if replayed.torn => {
                self.done.unchecked += 1;
                Ok(())
            }
            first => Err(format!("the controller took {told:?}, but module {id} had sent {first:?} next")),
        }
    }

    fn compare_counts(&self, id: ModuleId, incarnation: Incarnation, tally: &Tally) -> Result<(), String> {
        let Some(replayed) = self.incarnations.get(&(id, incarnation)).filter(|l| !l.torn) else {
            return Ok(());
        };
        for (class, counted) in tally.iter() {
            let (got, counted) = (known(&replayed.tally[class]), known(counted));
            // A killed process may have written its last steps but not their counts.
            let late = replayed.died && got.iter().zip(counted).all(|(got, counted)| *got >= counted);
            if got != counted && !late {
                return Err(format!(
                    "module {id} counts {counted:?} {class} messages (sent, delivered, bytes), now {got:?}"
                ));
            }
        }
        Ok(())
    }

    fn compare_totals(&self, tally: &Tally) -> Result<(), String> {
        let mut got = Tally::default();
        self.incarnations.values().for_each(|replayed| got += replayed.tally);
        let died = self.incarnations.values().any(|replayed| replayed.died);
        let torn = self.incarnations.values().any(|replayed| replayed.torn);
        for class in Class::ALL {
            let (got, counted) = (known(&got[class]), known(&tally[class]));
            let late = died && got.iter().zip(counted).all(|(got, counted)| *got >= counted);
            if got != counted && !late && !torn {
                return Err(format!(
                    "the run counts {counted:?} {class} messages (sent, delivered, bytes), now {got:?}"
                ));
            }
        }
        Ok(())
    }

    /// Returns the counts of messages that all agents have sent and received.
    pub fn tally(&self) -> Tally {
        let mut sum = Tally::default();
        self.incarnations.values().for_each(|replayed| sum += replayed.tally);
        sum
    }
}

/// Returns the counts that a replay can reproduce; the others are the link's.
fn known(counts: &Counts) -> [u64; 3] {
    [counts.sent, counts.delivered, counts.bytes]
}

/// Takes `taken` from the front of the queue, and returns true if it was there. Skips contact changes, each
/// only if a later change of the same port is queued. With `is_apart`, orders are a queue of their own: on a link of their own they
/// may arrive after what bodies sense later.
fn take(inputs: &mut VecDeque<Consumed>, taken: &Consumed, is_apart: bool) -> bool {
    let is_order = |input: &Consumed| matches!(input, Consumed::Order(_));
    let next = |inputs: &mut VecDeque<Consumed>| {
        let next = inputs.iter().position(|input| !is_apart || is_order(input) == is_order(taken))?;
        inputs.remove(next)
    };
    while let Some(input) = next(inputs) {
        if input == *taken {
            return true;
        }
        let Consumed::Contact { port, .. } = input else { return false };
        let later = |l: &Consumed| matches!(l, Consumed::Contact { port: p, .. } if *p == port);
        if !inputs.iter().any(later) {
            return false;
        }
    }
    false
}

fn hash(blob: &Blob) -> u64 {
    let mut hasher = SipHasher13::new();
    hasher.write_u8(blob.kind);
    hasher.write(&blob.bytes);
    hasher.finish()
}

fn read<T: Wire>(blob: &Blob) -> Result<T, String> {
    blob.read().map_err(|e: WireError| format!("{blob:?} cannot be read: {e}"))
}

//! The causal past of an event: the inputs of agents that it follows from, by Lamport's order (CACM 21, 1978): an input follows the one
//! before it of the same agent, and the one that sent the message which it is.

use metamorph_processes::family::recorded_events;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::record::{Consumed, Event, MessageName, Record, Step, Who};
use metamorph_protocol::time::Time;
use metamorph_scenario::Plan;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Number of events before the explained one that are recorded.
const WINDOW: usize = 20_000;

/// An input of an agent in the course of a run.
pub struct PastInput {
    /// The number of events before the one in which it was taken.
    pub events: u64,
    /// The module that took it, and its incarnation.
    pub who: (ModuleId, Incarnation),
    /// Its record.
    pub record: Record,
}

impl PastInput {
    /// Returns the scenario time.
    pub fn at(&self) -> Time {
        self.record.at
    }
    fn step(&self) -> Option<&Step> {
        match &self.record.event {
            Event::Step(step) => Some(step),
            _ => None,
        }
    }
    /// Returns the name of the message, if it is one.
    pub fn message(&self) -> Option<MessageName> {
        match self.step()?.input {
            Consumed::Message { name, .. } => Some(name),
            _ => None,
        }
    }
}

/// The inputs of a run in their order, with the ways back along causes.
struct Steps {
    all: Vec<PastInput>,
    /// The steps of each incarnation, in their order.
    of: BTreeMap<(ModuleId, Incarnation), Vec<usize>>,
}

impl Steps {
    fn of(plan: &Plan, events: u64) -> Steps {
        let mut steps = Steps { all: Vec::new(), of: BTreeMap::new() };
        for (events, records) in recorded_events(plan, events, WINDOW) {
            for record in records {
                if let (Who::Agent(id, incarnation), Event::Step(_)) = (record.who, &record.event) {
                    let who = (id, incarnation);
                    steps.of.entry(who).or_default().push(steps.all.len());
                    steps.all.push(PastInput { events, who, record });
                }
            }
        }
        steps
    }

    /// Returns the step before one of the same agent.
    fn before(&self, step: usize) -> Option<usize> {
        let own = self.of.get(&self.all[step].who)?;
        own.partition_point(|other| *other < step).checked_sub(1).map(|i| own[i])
    }

    /// Returns the step that sent a message.
    fn sender(&self, MessageName { from, incarnation, number }: MessageName) -> Option<usize> {
        let own = self.of.get(&(from, incarnation))?;
        let first = |step: &usize| self.all[*step].step().map_or(0, |step| step.first);
        // Steps that send nothing have the number of the next message.
        let last = own.partition_point(|step| first(step) <= number);
        own[..last].iter().rev().copied().find(|step| {
            self.all[*step].step().is_some_and(|step| number - step.first < step.sent.len() as u32)
        })
    }

    /// Returns true if a step changed neither the state of its agent nor the world outside.
    fn is_idle(&self, step: usize) -> bool {
        let digest = |step: usize| self.all[step].step().map(|step| step.digest);
        let is_silent =
            self.all[step].step().is_some_and(|step| step.sent.is_empty() && step.told.is_empty());
        is_silent && self.before(step).is_some_and(|before| digest(before) == digest(step))
    }
}

/// Returns the inputs that the event after this many others follows from, and its own: the nearest first, those that changed
/// something, at most `count`, and none before `since`.
pub fn causes(plan: &Plan, events: u64, since: Time, count: usize) -> Vec<PastInput> {
    let steps = Steps::of(plan, events + 1);
    let own = (0..steps.all.len()).filter(|step| steps.all[*step].events == events);
    let (mut queue, mut found): (VecDeque<usize>, BTreeSet<usize>) = (own.collect(), BTreeSet::new());
    let mut order = Vec::new();
    while let Some(step) = queue.pop_front() {
        if order.len() >= count || steps.all[step].at() < since || !found.insert(step) {
            continue;
        }
        if !steps.is_idle(step) {
            order.push(step);
        }
        let sender = steps.all[step].message().and_then(|name| steps.sender(name));
        queue.extend(steps.before(step).into_iter().chain(sender));
    }
    let mut all: Vec<Option<PastInput>> = steps.all.into_iter().map(Some).collect();
    order.into_iter().filter_map(|step| all[step].take()).collect()
}

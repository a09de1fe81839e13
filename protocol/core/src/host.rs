//! The host of one incarnation of an agent. Every driver (the simulator, an agent process, a replay and the model
//! checker) hands inputs to an agent and takes its outputs through it, so that recording is hooked in here only.
//!
//! Carrying the outputs out is left to the drivers, which differ in it.

use crate::agent::{Agent, Birth, Input, InputOf, Output, OutputOf, Summary};
use crate::counters::Class;
use crate::ids::{ModuleId, Port, Revision};
use crate::record::{Blob, Consumed, Emitted, Event, MessageName, Record, Sent, Sink, Step, Who};
use crate::time::Time;
use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::sync::Arc;
use alloc::vec::Vec;
use core::hash::Hasher;
use siphasher::sip::SipHasher13;

/// One incarnation of an agent.
#[derive(Clone, Debug)]
pub struct AgentHost<A: Agent> {
    agent: A,
    /// State that only recorded and replayed incarnations need.
    steps: Option<Box<Steps<A>>>,
}

#[derive(Clone, Debug)]
struct Steps<A: Agent> {
    who: Who,
    /// Messages sent so far.
    sent: u32,
    /// The summary that was recorded last.
    summary: Summary,
    /// Outputs of the last input that are not polled yet.
    outputs: VecDeque<OutputOf<A>>,
}

/// Context of an input, known to the driver only, for the record of the step.
pub struct StepContext<'a> {
    /// The name and class of the message, if the input is one.
    pub heard: Option<(MessageName, Class)>,
    /// The number of contact changes that the agent knows of.
    pub revision: Revision,
    /// The module at a port.
    pub peer: &'a dyn Fn(Port) -> Option<ModuleId>,
    /// The destination of the record.
    pub sink: &'a mut dyn Sink,
}

impl<A: Agent> AgentHost<A> {
    /// Starts an agent.
    pub fn new(setup: &Arc<A::Setup>, birth: Birth<A::Place>, now: Time) -> AgentHost<A> {
        AgentHost { agent: A::new(setup, birth, now), steps: None }
    }

    /// Starts an agent whose inputs are handed in by [`AgentHost::handle_hashed`].
    pub fn hashed(setup: &Arc<A::Setup>, birth: Birth<A::Place>, now: Time) -> AgentHost<A> {
        let who = Who::Agent(birth.id, birth.incarnation);
        let steps = Steps { who, sent: 0, summary: Summary::default(), outputs: VecDeque::new() };
        AgentHost { agent: A::new(setup, birth, now), steps: Some(Box::new(steps)) }
    }

    /// Starts an agent whose inputs are handed in by [`AgentHost::handle_recorded`], and records the start.
    pub fn recorded(
        setup: &Arc<A::Setup>,
        birth: Birth<A::Place>,
        now: Time,
        sink: &mut dyn Sink,
    ) -> AgentHost<A> {
        let who = Who::Agent(birth.id, birth.incarnation);
        // The time by the controller's clock, from which a replay derives the agent's own.
        sink.put(&Record { at: birth.born, who, event: Event::Born { place: Blob::of(&birth.place) } });
        AgentHost::hashed(setup, birth, now)
    }

    /// Returns the agent.
    pub fn agent(&self) -> &A {
        &self.agent
    }

    /// Returns the latest time at which the agent wants [`Input::Wake`].
    pub fn wake_at(&self) -> Time {
        self.agent.wake_at()
    }

    /// Lets the agent draw from another seed of the run ([`Agent::reseed`]).
    pub fn reseed(&mut self, seed: u64) {
        self.agent.reseed(seed);
    }

    /// Hands in one input.
    pub fn handle(&mut self, now: Time, input: InputOf<A>) {
        self.agent.handle(now, input);
    }

    /// Hands in one input, and returns the hash of all outputs and of the state after them. Without
    /// [`AgentHost::hashed`] or [`AgentHost::recorded`] nothing is hashed, and the hash is 0.
    pub fn handle_hashed(&mut self, now: Time, input: InputOf<A>) -> u64 {
        self.agent.handle(now, input);
        let Some(steps) = &mut self.steps else { return 0 };
        steps.outputs.extend(core::iter::from_fn(|| self.agent.poll()));
        hash(&self.agent, &steps.outputs)
    }

    /// Hands in one input and records it together with its effects, before the first output can be polled.
    pub fn handle_recorded(&mut self, now: Time, input: InputOf<A>, context: StepContext<'_>) {
        let StepContext { heard, revision, peer, sink } = context;
        let input_record = taken::<A>(&input, heard);
        let digest = self.handle_hashed(now, input);
        let Some(steps) = &mut self.steps else { return };
        let first = steps.sent;
        let (mut sent, mut told) = (Vec::new(), Vec::new());
        for output in &steps.outputs {
            match output {
                Output::Send { port, class, .. } => {
                    sent.push(Sent { port: *port, class: *class, to: peer(*port) });
                }
                Output::Act(action) => told.push(Emitted::Act { revision, action: Blob::of(action) }),
                Output::Report(report) => told.push(Emitted::Report(Blob::of(report))),
            }
        }
        steps.sent = first.wrapping_add(sent.len() as u32);
        let mut put = |event| sink.put(&Record { at: now, who: steps.who, event });
        put(Event::Step(Step { input: input_record, first, sent, told, digest }));
        let summary = self.agent.summary(now);
        if summary != steps.summary {
            steps.summary.clone_from(&summary);
            put(Event::State(summary));
        }
    }

    /// Returns the next output of the last input.
    pub fn poll(&mut self) -> Option<OutputOf<A>> {
        match &mut self.steps {
            None => self.agent.poll(),
            Some(steps) => steps.outputs.pop_front(),
        }
    }
}

/// Converts an input to its recorded form; name and class belong to messages only.
fn taken<A: Agent>(input: &InputOf<A>, heard: Option<(MessageName, Class)>) -> Consumed {
    match (input, heard) {
        (Input::Contact { port, session }, _) => Consumed::Contact { port: *port, session: *session },
        (Input::Message { port, message }, Some((name, class))) => {
            Consumed::Message { port: *port, class, name, message: Blob::of(message) }
        }
        // Invariant: drivers name every message that they hand in.
        (Input::Message { .. }, None) | (Input::Wake, _) => Consumed::Wake,
        (Input::Percept(percept), _) => Consumed::Percept(Blob::of(percept)),
        (Input::Order(order), _) => Consumed::Order(Blob::of(order)),
    }
}

/// Hashes the state of an agent and these outputs.
fn hash<A: Agent>(agent: &A, outputs: &VecDeque<OutputOf<A>>) -> u64 {
    let mut hasher = SipHasher13::new();
    for output in outputs {
        let (tag, blob) = match output {
            Output::Send { port, class, message } => {
                (u32::from(port.0) << 8 | *class as u32, Blob::of(message))
            }
            Output::Act(action) => (1 << 16, Blob::of(action)),
            Output::Report(report) => (2 << 16, Blob::of(report)),
        };
        hasher.write_u32(tag);
        hasher.write_u8(blob.kind);
        hasher.write(&blob.bytes);
    }
    agent.digest(&mut hasher);
    hasher.finish()
}

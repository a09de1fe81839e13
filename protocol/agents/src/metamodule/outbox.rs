//! Outgoing messages of a metamodule: outputs in order, the numbering of its statements, and the repetition of its
//! state.

use super::message::{Action, Message, State, Status};
use super::view::{Advertised, View};
use metamorph_core::agent::Output;
use metamorph_core::counters::Class;
use metamorph_core::ids::Port;
use metamorph_core::time::Time;
use std::collections::VecDeque;
use std::hash::{Hash, Hasher};

type Said = Output<Message, Action, Status>;

#[derive(Clone, Debug)]
pub(super) struct Outbox {
    /// Outputs that have not been polled yet.
    queue: VecDeque<Said>,
    /// The sequence number of the latest state, path or directive.
    sequence: u32,
    /// When the state is sent again.
    pub repeat_at: Time,
    reported: Option<Status>,
    /// True while the metamodule asks the operator.
    pub asks: bool,
}

/// Leaves out the queued outputs, which do not affect what the metamodule does from now on, and what follows from the
/// state of the strategy.
impl Hash for Outbox {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Outbox { queue: _, sequence, repeat_at, reported, asks: _ } = self;
        (sequence, repeat_at, reported).hash(hasher);
    }
}

impl Outbox {
    pub fn new(repeat_at: Time) -> Outbox {
        Outbox { queue: VecDeque::new(), sequence: 0, repeat_at, reported: None, asks: false }
    }
    pub fn poll(&mut self) -> Option<Said> {
        self.queue.pop_front()
    }
    /// Returns the sequence number of the latest state, path or directive.
    pub fn sequence(&self) -> u32 {
        self.sequence
    }
    pub fn next_sequence(&mut self) -> u32 {
        self.sequence += 1;
        self.sequence
    }

    pub fn send(&mut self, port: Port, class: Class, message: Message) {
        self.queue.push_back(Output::Send { port, class, message });
    }
    /// Sends a message to all neighbours in range.
    pub fn broadcast(&mut self, v: View<'_>, class: Class, message: Message) {
        for (port, _) in v.neighbours.iter() {
            self.send(port, class, message);
        }
    }
    pub fn act(&mut self, action: Action) {
        self.queue.push_back(Output::Act(action));
    }

    /// Tells one neighbour the state.
    pub fn greet(&mut self, v: View<'_>, advertised: Advertised, port: Port) {
        let message = self.state(v, advertised);
        self.send(port, Class::Liveness, message);
    }
    /// Tells all neighbours the state.
    pub fn tell(&mut self, v: View<'_>, advertised: Advertised, class: Class) {
        self.repeat_at = v.now + v.params().repeat;
        let message = self.state(v, advertised);
        self.broadcast(v, class, message);
    }
    fn state(&mut self, v: View<'_>, advertised: Advertised) -> Message {
        let Advertised { claim, unreachable, blocked } = advertised;
        Message::State(State {
            id: v.own.id,
            sequence: self.next_sequence(),
            pose: v.own.pose,
            settled: v.own.settled.is_some(),
            stuck: v.own.stuck.is_some(),
            blocked,
            task: v.own.task,
            filled: v.own.filled,
            claim,
            unreachable,
        })
    }

    /// Tells the world-controller the status, if it has changed.
    pub fn report(&mut self, status: Status) {
        let status = Status { stuck: status.stuck || self.asks, ..status };
        if self.reported != Some(status) {
            self.reported = Some(status);
            self.queue.push_back(Output::Report(status));
        }
    }
}

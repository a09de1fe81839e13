//! From an agent to the controller: reliable and in order. What does not fit into the controller's
//! inbox waits here; the wait loop hands in nothing new while more than [`UPLINK_LIMIT`] frames do.

use crate::transport::iceoryx::outbox::{Handed, Outbox};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header, Wire};
use std::collections::VecDeque;

/// Frames that may wait before the agent is handed nothing more.
pub const UPLINK_LIMIT: usize = 256;

/// The way to the controller.
#[derive(Debug)]
pub struct Uplink {
    outbox: Outbox,
    id: ModuleId,
    incarnation: Incarnation,
    queue: VecDeque<Frame>,
    sequence: u32,
}

impl Uplink {
    /// An uplink of one life of an agent.
    pub fn new(outbox: Outbox, id: ModuleId, incarnation: Incarnation) -> Uplink {
        Uplink { outbox, id, incarnation, queue: VecDeque::new(), sequence: 0 }
    }

    /// Queues a message. `stamp` is the contact revision of an action, zero otherwise.
    pub fn push<W: Wire>(&mut self, channel: Channel, stamp: u32, message: &W) {
        let header = Header {
            channel,
            kind: message.kind(),
            class: Class::World,
            port: Port(0),
            incarnation: self.incarnation,
            source: self.id,
            destination: CONTROLLER,
            session: stamp,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.queue.push_back(Frame::seal(header, message));
    }

    /// Drops what waits.
    pub fn clear(&mut self) {
        self.queue.clear();
    }

    /// From now on everything goes another way.
    pub fn redirect(&mut self, outbox: Outbox) {
        self.outbox = outbox;
    }

    /// Sends as much as fits at `now`.
    pub fn flush(&mut self, now: Time) {
        while let Some(frame) = self.queue.front() {
            if self.outbox.send(frame, now) != Handed::Over {
                break;
            }
            self.queue.pop_front();
        }
        self.outbox.flush();
    }

    /// Whether nothing waits.
    pub fn is_idle(&self) -> bool {
        self.queue.is_empty()
    }
    /// Whether so much waits that nothing more may be added.
    pub fn is_full(&self) -> bool {
        self.queue.len() >= UPLINK_LIMIT
    }
}

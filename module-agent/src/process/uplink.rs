//! The link from an agent to the controller: reliable and in order. Frames that do not fit into the
//! controller's inbox wait here; the wait loop takes no further input while [`UPLINK_LIMIT`] wait.

use crate::transport::shared_frame::SharedFrame;
use crate::transport::{AgentKey, Link, SendStatus};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::Port;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header, Wire};
use std::collections::VecDeque;

/// Number of waiting frames at which the agent takes no further input.
pub const UPLINK_LIMIT: usize = 256;

/// The link to the controller, and the frames that wait for it.
#[derive(Debug)]
pub struct Uplink<L> {
    link: L,
    agent: AgentKey,
    queue: VecDeque<Frame>,
    sequence: u32,
}

impl<L: Link> Uplink<L> {
    /// Creates the uplink of one incarnation of an agent.
    pub fn new(link: L, agent: AgentKey) -> Uplink<L> {
        Uplink { link, agent, queue: VecDeque::new(), sequence: 0 }
    }

    /// Queues a message. `stamp` is the contact revision of an action, zero otherwise.
    pub fn push<W: Wire>(&mut self, channel: Channel, stamp: u32, message: &W) {
        let header = Header {
            channel,
            kind: message.kind(),
            class: Class::World,
            port: Port(0),
            incarnation: self.agent.1,
            source: self.agent.0,
            destination: CONTROLLER,
            session: stamp,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.queue.push_back(Frame::seal(header, message));
    }

    /// Drops the waiting frames.
    pub fn clear(&mut self) {
        self.queue.clear();
    }

    /// Sends over another link from now on.
    pub fn redirect(&mut self, link: L) {
        self.link = link;
    }

    /// Sends as many waiting frames as fit into the controller's inbox, with `now` as the time of sending.
    pub fn flush(&mut self, now: Time) {
        while let Some(frame) = self.queue.front() {
            if self.link.send(SharedFrame::new(frame, now)) != SendStatus::Sent {
                break;
            }
            self.queue.pop_front();
        }
        self.link.flush();
    }

    /// True if no frame waits.
    pub fn is_idle(&self) -> bool {
        self.queue.is_empty()
    }
    /// True if [`UPLINK_LIMIT`] frames wait, so that no more may be added.
    pub fn is_full(&self) -> bool {
        self.queue.len() >= UPLINK_LIMIT
    }
}

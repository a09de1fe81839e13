//! How many neighbours an agent has, and how many messages it holds, at most.

use crate::link_emulator::HELD_LIMIT;
use crate::process::agent_process::DRAIN;
use crate::process::contacts::EARLY_LIMIT;
use crate::process::sender::BURST;
use crate::transport::{INBOX_DEPTH, INBOX_SPARE};
use metamorph_protocol::agent::Agent;

/// Returns the largest number of neighbours that an agent has at a time in a swarm of `count` modules.
pub fn most_neighbours<A: Agent>(count: usize) -> usize {
    A::PORTS.min(count.saturating_sub(1))
}

/// Returns the largest number of messages that the counts of a killed process may miss, if it has at most `neighbours`
/// neighbours at a time: in its inbox, taken from it, waiting for their contact, gathered to be sent, or held back by
/// its link.
pub fn in_hand(neighbours: usize, transparent: bool) -> u64 {
    let inbox = (neighbours + INBOX_SPARE) * INBOX_DEPTH;
    let held = if transparent { 0 } else { HELD_LIMIT };
    (inbox + DRAIN + EARLY_LIMIT + 2 * BURST + 2 * held) as u64
}

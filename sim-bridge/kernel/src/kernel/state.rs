//! Hashes of the states of agents and bodies. The trace hash tells runs apart by time and kind of events;
//! these do by contents: beacons, grants, positions.

use crate::world::World;
use metamorph_core::agent::Agent;
use metamorph_core::ids::Incarnation;
use siphasher::sip::SipHasher13;
use std::hash::Hasher;

/// Increased whenever the meaning of the hashes changes.
const STATE_VERSION: u64 = 1;

/// The number of events per module between two state hashes. A hash costs about as much as three events of every
/// module, so hashes cost about a hundredth of a run.
const PER_MODULE: u64 = 256;
/// The least number of events between two state hashes.
const AT_LEAST: u64 = 4_096;

fn hasher() -> SipHasher13 {
    let mut hasher = SipHasher13::new_with_keys(0x7374_6174_6568_6173, STATE_VERSION);
    hasher.write(&STATE_VERSION.to_le_bytes());
    hasher
}

/// The state hashes of a simulated run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hashes {
    /// Of the sampled states, including those at the end.
    pub states: u64,
    /// Of all agents at the end.
    pub agents: u64,
    /// Of the world at the end.
    pub world: u64,
}

/// One agent of many, for [`agents_hash`].
pub struct Held<'a, A> {
    /// True if its process lives.
    pub is_alive: bool,
    /// Its incarnation.
    pub incarnation: Incarnation,
    /// The agent, or its last state if its process died; `None` before its first start.
    pub agent: Option<&'a A>,
}

/// Returns the hash of the state of all agents, in the order of their modules.
pub fn agents_hash<'a, A: Agent + 'a>(agents: impl Iterator<Item = Held<'a, A>>) -> u64 {
    let mut hasher = hasher();
    for Held { is_alive, incarnation, agent } in agents {
        hasher.write(&[is_alive.into(), agent.is_some().into()]);
        hasher.write(&incarnation.0.to_le_bytes());
        if let Some(agent) = agent {
            agent.digest(&mut hasher);
        }
    }
    hasher.finish()
}

/// Returns the hash of the state of a world.
pub fn world_hash<W: World>(world: &W) -> u64 {
    let mut hasher = hasher();
    world.digest(&mut hasher);
    hasher.finish()
}

/// The rolling hash of the states of a simulated run: sampled at regular event counts ([`States::is_due`])
/// and at the end.
#[derive(Clone)]
pub struct States {
    hasher: SipHasher13,
    every: u64,
    next: u64,
}

impl States {
    /// Creates the hash for a run of `modules`.
    pub fn new(modules: usize) -> States {
        let every = (modules as u64 * PER_MODULE).max(AT_LEAST);
        States { hasher: hasher(), every, next: every }
    }
    /// Returns true if the next sample is due after `events`.
    pub fn is_due(&self, events: u64) -> bool {
        events >= self.next
    }
    /// Adds the hashes of agents and world after `events`.
    pub fn fold(&mut self, events: u64, agents: u64, world: u64) {
        for n in [events, agents, world] {
            self.hasher.write(&n.to_le_bytes());
        }
        self.next = events - events % self.every + self.every;
    }
    /// Returns the hash so far.
    pub fn value(&self) -> u64 {
        self.hasher.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intermediate_states_count() {
        let hash = |states: &[(u64, u64, u64)]| {
            let mut all = States::new(3);
            states.iter().for_each(|(events, agents, world)| all.fold(*events, *agents, *world));
            all.value()
        };
        let base = hash(&[(4_096, 1, 2), (5_000, 3, 4)]);
        assert_eq!(base, hash(&[(4_096, 1, 2), (5_000, 3, 4)]));
        for other in [&[(5_000, 3, 4)][..], &[(4_096, 9, 2), (5_000, 3, 4)], &[(4_096, 1, 2), (5_000, 3, 5)]]
        {
            assert_ne!(base, hash(other));
        }
    }

    #[test]
    fn is_due_at_regular_event_counts() {
        let mut states = States::new(100);
        assert!(!states.is_due(25_599) && states.is_due(25_600));
        states.fold(25_603, 0, 0);
        assert!(!states.is_due(51_199) && states.is_due(51_200));
    }
}

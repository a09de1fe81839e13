//! The state of a metamodule as a hash: what it knows, has promised and is doing, field by field in a fixed order.
//! Not here: when to look again, and cached findings about the present surroundings.

use super::agent::Metamodule;
use super::locks::Requester;
use super::view::Own;
use metamorph_core::digest::Portable;
use metamorph_core::ids::Port;
use std::hash::{Hash, Hasher};

/// Number of ports that are part of every hash. The others are part of it while they have a neighbour, so that the
/// hash does not depend on the number of ports.
const HASHED_PORTS: usize = 24;

impl Metamodule {
    pub(super) fn digest_state(&self, hasher: &mut dyn Hasher) {
        // Taken apart in full, so that a new part has to be put where it belongs.
        let Metamodule {
            setup: _,
            own,
            neighbours,
            locks: _,
            requester,
            phase,
            policy,
            detector,
            out,
            tuned,
        } = self;
        let Own { id, pose, task, open, filled, settled, stuck, steered, quarantine_until } = own;
        let Requester { token, waiting_since, rest_until, waits_for, prevented, rng } = requester;
        let hasher = &mut Portable::new(hasher);
        (id, pose).hash(hasher);
        self.digest_neighbours(hasher);
        (&neighbours.dead, &neighbours.obstacles, task, open, filled, settled).hash(hasher);
        policy.digest(hasher);
        phase.digest(hasher);
        (stuck, token, waiting_since, rest_until, quarantine_until).hash(hasher);
        (out.sequence(), prevented, waits_for, detector, rng).hash(hasher);
        // Without commands the hash is that of a swarm that knows none.
        steered.iter().for_each(|steered| steered.hash(hasher));
        tuned.iter().for_each(|tuned| tuned.hash(hasher));
    }

    /// All that is kept of each neighbour, by port.
    fn digest_neighbours(&self, hasher: &mut Portable<'_>) {
        let known = |port: Port| {
            let n = self.neighbours.get(port)?;
            let path = self.policy.negotiated().and_then(|n| n.path_of(port));
            let (grant, over) = (self.locks.grant_of(port), self.locks.over(port));
            Some((n.session, n.state, path, grant, n.certified_dead, over))
        };
        HASHED_PORTS.hash(hasher);
        (0..HASHED_PORTS as u8).map(Port).for_each(|port| known(port).hash(hasher));
        let others = self.neighbours.iter().map(|(port, _)| port).filter(|p| p.index() >= HASHED_PORTS);
        others.for_each(|port| (port, known(port)).hash(hasher));
    }
}

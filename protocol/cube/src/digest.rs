//! The state of a cube as a hash: what the protocol knows and has promised, in a fixed order. Not here: state
//! derived from it, wake-up times, and outputs that have been sent.

use super::Cube;
use super::motion_planner::DigestPart;
use super::view::Own;
use core::hash::{Hash, Hasher};
use metamorph_core::digest::Portable;
use metamorph_core::lattice::Face;

impl Cube {
    pub(super) fn digest_state(&self, hasher: &mut dyn Hasher) {
        // Destructured in full, so that the compiler asks for the place of a new part.
        let Cube {
            own,
            sides,
            forest,
            attraction,
            locks,
            planner,
            attempt,
            moving,
            searches,
            retransmission,
            relays,
            prevented,
            next_epoch,
            beacons,
            rng,
            tokens,
            steered,
            called,
            surveyor,
            reporter: _,
            wanted: _,
            finals: _,
            filled: _,
            wake: _,
            out: _,
        } = self;
        let Own {
            id,
            cell,
            settled,
            epoch,
            is_closed,
            role,
            restarted,
            quarantine_until,
            activator,
            support,
            immobile,
            knows_of_death,
            setup: _,
            born: _,
            masks: _,
        } = own;
        let hasher = &mut Portable::new(hasher);
        (id, cell, settled, epoch, role).hash(hasher);
        forest.digest(hasher);
        let next = next_epoch.as_ref().map(|opening| opening.epoch);
        (activator, support, attempt, moving, next, locks, searches).hash(hasher);
        (rng, tokens).hash(hasher);
        planner.digest(hasher, DigestPart::Waiting);
        planner.digest(hasher, DigestPart::Failures);
        (immobile, prevented, restarted).hash(hasher);
        quarantine_until.hash(hasher);
        planner.digest(hasher, DigestPart::Targets);
        // Without searches, repetitions, commands, calls, deaths and closed epochs the hash is that of a swarm that knows none.
        steered.iter().for_each(|steered| steered.hash(hasher));
        called.iter().for_each(|called| called.hash(hasher));
        retransmission.hash(hasher);
        relays.hash(hasher);
        if *knows_of_death {
            surveyor.digest(hasher);
        }
        let is_closed_next = next_epoch.as_ref().is_some_and(|next| next.is_closed);
        if *is_closed || is_closed_next {
            (is_closed, is_closed_next).hash(hasher);
        }
        for face in Face::ALL {
            sides.digest(face, hasher);
            forest.child(face).hash(hasher);
            attraction.digest_field(face, hasher);
            attraction.digest_outside(face, beacons.sequence(face), hasher);
        }
    }
}

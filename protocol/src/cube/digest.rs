//! The state of a cube as a hash: what the protocol knows and has promised, field by field in an order that
//! stays. Absent: what only says when to look again and what has been said already.

use super::{Cube, Side};
use crate::digest::Portable;
use std::hash::{Hash, Hasher};

impl Cube {
    pub(super) fn digest_state(&self, hasher: &mut dyn Hasher) {
        // Taken apart in full, so that a new field has to be put where it belongs.
        let Cube {
            id,
            cell,
            settled,
            epoch,
            role,
            sides,
            rank,
            renew,
            parent,
            want,
            activator,
            anchor,
            attempt,
            moving,
            next_epoch,
            locks,
            searches,
            stream,
            tokens,
            back_off_until,
            waiting_since,
            waits_for,
            patience,
            denied,
            failed,
            immobile,
            prevented,
            reborn,
            quarantine_until,
            corners_seen,
            targets,
            roaming,
            setup: _,
            decide_at: _,
            reported: _,
            reported_at: _,
            field_stale: _,
            wake: _,
            out: _,
        } = self;
        let mut hasher = Portable::new(hasher);
        (id, cell, settled, epoch, role, rank, renew, parent, want).hash(&mut hasher);
        (activator, anchor, attempt, moving, next_epoch, locks, searches).hash(&mut hasher);
        (stream, tokens, back_off_until, waiting_since, waits_for).hash(&mut hasher);
        (patience, denied, failed, immobile, prevented, reborn).hash(&mut hasher);
        (quarantine_until, corners_seen, targets, roaming).hash(&mut hasher);
        sides.iter().for_each(|side| side.digest_state(&mut hasher));
    }
}

impl Side {
    fn digest_state(&self, hasher: &mut Portable<'_>) {
        let Side {
            session,
            peer,
            condemned,
            died_final,
            child,
            field,
            corners,
            corners_until,
            sequence,
            unfilled_since,
            sent: _,
            sent_at: _,
            stale: _,
            later: _,
        } = self;
        (session, peer, condemned, died_final, child, field).hash(hasher);
        (corners, corners_until, sequence, unfilled_since).hash(hasher);
    }
}

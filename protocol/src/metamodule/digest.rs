//! The state of a metamodule as a hash: what it knows, has promised and is about, field by field in an order
//! that stays. Absent: when to look again, and what it has found out already about the same surroundings.

use super::{Core, Phase};
use crate::digest::Portable;
use std::hash::{Hash, Hasher};

impl Core {
    pub(super) fn digest_state(&self, hasher: &mut dyn Hasher) {
        // Taken apart in full, so that a new field has to be put where it belongs.
        let Core {
            id,
            pose,
            peers,
            dead,
            obstacles,
            task,
            open,
            filled,
            settled,
            course,
            intent,
            lead,
            stuck,
            phase,
            token,
            waiting_since,
            rest_until,
            quarantine,
            sequence,
            prevented,
            waits_for,
            watch,
            chance,
            repeat_at: _,
            reported: _,
        } = self;
        let mut hasher = Portable::new(hasher);
        (id, pose, peers, dead, obstacles, task, open, filled, settled, course).hash(&mut hasher);
        intent.digest_state(&mut hasher);
        lead.digest_state(&mut hasher);
        phase.digest_state(&mut hasher);
        (stuck, token, waiting_since, rest_until, quarantine).hash(&mut hasher);
        (sequence, prevented, waits_for, watch, chance).hash(&mut hasher);
    }
}

impl Phase {
    fn digest_state(&self, hasher: &mut Portable<'_>) {
        match self {
            Phase::Idle { look_at: _ } => 0u8.hash(hasher),
            Phase::Asking { plan, pending, asked, again: _ } => (1u8, plan, pending, asked).hash(hasher),
            Phase::Moving { plan, next, tries, until } => (2u8, plan, next, tries, until).hash(hasher),
        }
    }
}

//! Read-only queries about a metamodule, for audits and viewers.

use super::agent::Metamodule;
use super::phase::Phase;
use super::pose::Pose;
use metamorph_core::agent::Summary;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;

impl Metamodule {
    /// Returns the pose that the metamodule believes itself to be in.
    pub fn pose(&self) -> Pose {
        self.own.pose
    }
    /// Returns the seed that it fills; `None` if it is not settled.
    pub fn settled(&self) -> Option<u8> {
        self.own.settled
    }
    /// The cells that it holds a lock on; none while it holds no lock.
    pub fn held(&self, now: Time) -> impl Iterator<Item = Cell> + '_ {
        let motion = match &self.phase {
            Phase::Moving(motion) if now <= motion.until => Some(motion),
            _ => None,
        };
        motion.into_iter().flat_map(|m| m.plan.cells(&self.setup))
    }
    /// Returns when the lease of its present motion's lock ends; `None` while it does not move.
    pub fn locked_until(&self) -> Option<Time> {
        match &self.phase {
            Phase::Moving(motion) => Some(motion.until),
            _ => None,
        }
    }
    pub(super) fn summarize(&self) -> Summary {
        let (settled, claim) = (self.own.settled, self.policy.advertised().claim);
        let role = match (settled, claim) {
            (Some(_), _) => "settled",
            (None, Some(_)) => "claiming",
            (None, None) => "free",
        };
        let activity = match self.phase {
            Phase::Idle { .. } => "idle",
            Phase::Asking(_) => "asking",
            Phase::Moving(_) => "moving",
        };
        let mut granted = self.neighbours.states().filter(|(port, _)| self.locks.grant_of(*port).is_some());
        Summary {
            role: role.to_owned(),
            activity: activity.to_owned(),
            goal: u16::from(self.own.task.goal),
            level: settled.or(claim.map(|c| c.seed)).map(u16::from),
            gradient: claim.map(|c| u32::from(c.cost)),
            lock: granted.next().map(|(_, state)| state.id),
            waits_for: self.requester.waits_for,
        }
    }
}

//! The branch lock of a turn: a wave of requests over the connections of the moving side, and the answers back (an echo
//! algorithm, Chang 1982). Each module has one lock at most, its own or one that it has granted.
//!
//! The first request makes its sender the parent; a request that comes again by another port is answered at once, so
//! loops within the moving side do no harm. A grant ends with its lease, or when the origin releases it. The origin
//! counts the lease from before it asked, so its own ends first.

use super::message::{LatticeDenial, LatticeMessage, LockMessage};
use metamorph_core::ids::{ModuleId, Port};
use metamorph_core::time::Time;

/// A set of ports as bits.
pub type Ports = u16;

/// Iterates over the ports of a set.
pub fn ports(set: Ports) -> impl Iterator<Item = Port> {
    (0..16).filter(move |p| set >> p & 1 != 0).map(Port)
}

/// A lock that this module asks for, or has granted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BranchLock {
    /// The module that turns.
    pub origin: ModuleId,
    /// Its attempt.
    pub token: u32,
    /// The port that the request came by; `None` at the origin.
    pub parent: Option<Port>,
    /// The ports that were asked.
    pub asked: Ports,
    /// Those of them that have not answered.
    pub awaiting: Ports,
    /// The first refusal, and the module that refused.
    pub denial: Option<(LatticeDenial, ModuleId)>,
    /// The end of the lease.
    pub until: Time,
    /// When those that have not answered are asked again.
    pub resend_at: Time,
}

impl BranchLock {
    /// Returns true if this is the lock that a message is about.
    pub fn is_of(&self, message: &LatticeMessage) -> bool {
        (self.origin, self.token) == (message.origin, message.token)
    }
    /// Returns true if every port that was asked has answered.
    pub fn is_answered(&self) -> bool {
        self.awaiting == 0
    }
    /// Notes the answer of a port. Returns true if it was awaited.
    pub fn answer(&mut self, port: Port, denial: Option<(LatticeDenial, ModuleId)>) -> bool {
        let bit = 1 << port.0;
        let awaited = self.awaiting & bit != 0;
        self.awaiting &= !bit;
        if awaited && self.denial.is_none() {
            self.denial = denial;
        }
        awaited
    }
    /// Returns a message about this lock.
    pub fn message(&self, what: LockMessage) -> LatticeMessage {
        LatticeMessage { origin: self.origin, token: self.token, what }
    }
}

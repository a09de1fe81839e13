//! Reconfiguration of free modules on the lattice: agents that carry out the steps of a central plan.
//!
//! The controller plans ([`metamorph_planning::reconfiguration`]) and orders steps; each agent carries out its own ([`agent`]). A connection is
//! made, or given up, by both sides. A joint turns only under a *branch lock* ([`branch_lock`]): all modules that the
//! turn moves have agreed to keep still. Safety does not rest on the plan: an agent follows the latest epoch only, and
//! the body refuses what is not possible.

pub mod agent;
pub mod branch_lock;
pub mod message;
pub mod place;
#[cfg(test)]
mod tests;

pub use agent::LatticeModule;

use metamorph_core::defects::Defect;
use metamorph_core::time::Span;
use serde::{Deserialize, Serialize};

/// Constant parameters that all agents share. All times are scenario time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LatticeSetup {
    /// How long a step of a joint takes, 120° or 90°.
    pub turn_time: Span,
    /// How long a connector takes to close or to open.
    pub connect_time: Span,
    /// How long a grant of a branch lock lasts.
    pub lease: Span,
    /// The time after which an unanswered request or order is repeated.
    pub resend: Span,
    /// The shortest wait before a refused action is tried again; the longest is twice as long.
    pub back_off: Span,
    /// How long the controller waits for a silent or dead module before it plans without it.
    pub patience: Span,
    /// The largest difference between the controller's clock and the clock of a host.
    pub skew: Span,
    /// A defect for tests.
    #[doc(hidden)]
    pub defect: Option<Defect>,
}

impl LatticeSetup {
    /// Returns the usual setup for joints that need `turn_time` per step, and links with this message delay.
    pub fn scaled(turn_time: Span, delay: Span) -> LatticeSetup {
        let round_trip = delay * 2;
        let resend = round_trip + Span(delay.0 / 2) + Span::millis(20);
        LatticeSetup {
            turn_time,
            connect_time: turn_time,
            lease: turn_time * 4 + resend * 16,
            resend,
            back_off: turn_time,
            patience: turn_time * 20 + resend * 16,
            skew: Span::ZERO,
            defect: None,
        }
    }

    /// Returns how long after its order a step may begin.
    pub fn window(&self) -> Span {
        self.lease * 2
    }
}

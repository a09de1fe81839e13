//! The configuration of one end of a host link.

use super::packet::{Life, Proof, Run, Terms};
use metamorph_core::defects::HostLinkDefect;
use metamorph_core::ids::HostId;
use metamorph_core::time::Span;

/// Makes the proofs of a greeting from a secret that all hosts of a run share.
pub trait Prover {
    /// Returns the proof of `from` that it answers number `number` of `to`.
    fn prove(&self, run: Run, from: (HostId, Life), to: (HostId, Life), number: u64) -> Proof;
}

/// Reaction of an end to long silence of the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Role {
    /// The end that counts the other as dead after [`Timing::fence`] of silence: the controller's host.
    Guardian,
    /// The end that stops acting before its guardian counts it as dead: a host whose agents the controller relies on.
    Ward,
    /// Neither: a link between two hosts that both have a link to the controller's.
    Equal,
}

/// The times of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Timing {
    /// The time between two greetings, and between two acknowledgements.
    pub every: Span,
    /// The time without any packet after which the other end counts as silent.
    pub silent: Span,
    /// The time without any packet after which a guardian counts the other end as dead. A ward acts for a fiftieth less,
    /// which is what clocks may drift apart.
    pub fence: Span,
    /// How long frames wait for others to share their packet.
    pub batch: Span,
}

impl Default for Timing {
    fn default() -> Timing {
        Timing {
            every: Span::millis(250),
            silent: Span::secs(2),
            fence: Span::secs(10),
            batch: Span::millis(1),
        }
    }
}

/// The configuration of one end.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Config {
    /// This host.
    pub host: HostId,
    /// The other host.
    pub peer: HostId,
    /// The run.
    pub run: Run,
    /// This start of this host.
    pub life: Life,
    /// The terms on which both ends must agree, and the offer of this host.
    pub terms: Terms,
    /// The reaction of this end to long silence of the other.
    pub role: Role,
    /// The times.
    pub timing: Timing,
    /// The most frames under way, at most [`FRAME_WINDOW`](super::FRAME_WINDOW).
    pub window: usize,
    /// A defect for tests.
    #[doc(hidden)]
    pub defect: Option<HostLinkDefect>,
}

//! Defects of the protocols that tests switch on to prove that the checks find them: a test harness that
//! cannot find a known defect proves nothing about a sound protocol. Never set by a scenario.

use serde::{Deserialize, Serialize};

/// A known defect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[doc(hidden)]
pub enum Defect {
    /// Both families: messages are delivered in whatever session they were sent.
    IgnoreSessions,
    /// Cubes: moves are started without a latest start time for the body.
    NoDeadline,
    /// Cubes: a grant ends long before the mover believes it does.
    ShortLease,
    /// Cubes: locks and reservations of others are not checked before leaving.
    IgnoreLocks,
    /// Cubes: locks are never released.
    KeepLocks,
    /// Cubes: a cell is reserved for every module that asks.
    ReserveTwice,
    /// Cubes: a silent child is forgotten.
    DropSilentChildren,
    /// Cubes: a parent is adopted before it has acknowledged.
    AdoptUnacknowledged,
    /// Cubes: a restarted module takes part at once.
    NoListening,
    /// Cubes: a neighbour that has not spoken yet does not count.
    IgnoreStrangers,
    /// Cubes: neighbours that a search has not connected count as connected.
    ShallowSearch,
    /// Cubes: gradient values of any age are accepted.
    AcceptStaleValues,
    /// Cubes: solid goals grow by the rule that is enough for scaffolds.
    AnyLowerOnSolids,
    /// Cubes: a module announces that it holds a dead neighbour without proof that it does not hang on it.
    LetGoUnproved,
    /// Cubes: a registered child counts as proof that this module does not hang on it.
    ChildProves,
    /// Cubes: a late beacon of a dead neighbour ends that this module holds it, whatever was announced.
    ForgetSaid,
    /// Cubes: an announcement for another death of the same module counts.
    LetGoOldDeath,
    /// Cubes: an announcement for another goal counts.
    EpochWords,
    /// Metamodules: every request is granted.
    GrantEverything,
    /// Metamodules: no neighbour is asked.
    AskNobody,
    /// Metamodules: locks are forgotten at once, by the holder and by the modules that granted them. Either
    /// alone is enough to keep others out: a grant that is remembered is planned around.
    ForgetLocks,
    /// Metamodules: a holder goes on after its lock has run out.
    OutstayLease,
    /// Metamodules: a restarted metamodule grants at once.
    GrantAfterRestart,
    /// Metamodules: an earlier state replaces a later one, even a certified death. For a living sender the
    /// next state corrects it.
    AcceptStaleStates,
    /// Metamodules: none makes way, neither by itself nor on a directive.
    StandInTheWay,
}

impl Defect {
    /// All defects.
    pub const ALL: [Defect; 25] = [
        Defect::IgnoreSessions,
        Defect::NoDeadline,
        Defect::ShortLease,
        Defect::IgnoreLocks,
        Defect::KeepLocks,
        Defect::ReserveTwice,
        Defect::DropSilentChildren,
        Defect::AdoptUnacknowledged,
        Defect::NoListening,
        Defect::IgnoreStrangers,
        Defect::ShallowSearch,
        Defect::AcceptStaleValues,
        Defect::AnyLowerOnSolids,
        Defect::LetGoUnproved,
        Defect::ChildProves,
        Defect::ForgetSaid,
        Defect::LetGoOldDeath,
        Defect::EpochWords,
        Defect::GrantEverything,
        Defect::AskNobody,
        Defect::ForgetLocks,
        Defect::OutstayLease,
        Defect::GrantAfterRestart,
        Defect::AcceptStaleStates,
        Defect::StandInTheWay,
    ];
}

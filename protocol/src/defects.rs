//! Defects of the protocols that tests switch on to prove that somebody notices: a harness that cannot
//! see a broken protocol break proves nothing about a sound one. Never set by a scenario.

use serde::{Deserialize, Serialize};

/// A defect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[doc(hidden)]
pub enum Sabotage {
    /// Both families: messages are delivered whatever session they were sent in.
    IgnoreSessions,
    /// Cubes: moves are started without telling the body by when they must have begun.
    NoDeadline,
    /// Cubes: a grant ends long before the mover believes it does.
    ShortLease,
    /// Cubes: locks and reservations of others are not looked at before leaving.
    IgnoreLocks,
    /// Cubes: what was locked is never released.
    KeepLocks,
    /// Cubes: a cell is kept for everybody who asks.
    ReserveTwice,
    /// Cubes: a silent child is forgotten.
    DropSilentChildren,
    /// Cubes: a parent is adopted before it has acknowledged.
    AdoptUnacknowledged,
    /// Cubes: a restarted module takes part at once.
    NoListening,
    /// Cubes: a neighbour that has said nothing yet does not count.
    IgnoreStrangers,
    /// Cubes: neighbours that a search has not connected count as connected.
    ShallowSearch,
    /// Cubes: gradient values of any age are accepted.
    AcceptStaleValues,
    /// Cubes: solid goals grow by the rule that is enough for scaffolds.
    AnyLowerOnSolids,
    /// Metamodules: everything asked for is granted.
    GrantEverything,
    /// Metamodules: nobody is asked.
    AskNobody,
    /// Metamodules: locks are forgotten at once, by who holds them and by who has granted them. Either of
    /// the two is enough to keep others out: a grant that is remembered is planned around.
    ForgetLocks,
    /// Metamodules: a holder goes on after its lock has run out.
    OutstayLease,
    /// Metamodules: a restarted one grants at once.
    GrantAfterRestart,
    /// Metamodules: what was said earlier replaces what was said later, even that somebody is dead. Of the
    /// living the next word makes it good again.
    AcceptStaleStates,
    /// Metamodules: nobody makes way, on its own account or when it is called.
    StandInTheWay,
}

impl Sabotage {
    /// All of them.
    pub const ALL: [Sabotage; 20] = [
        Sabotage::IgnoreSessions,
        Sabotage::NoDeadline,
        Sabotage::ShortLease,
        Sabotage::IgnoreLocks,
        Sabotage::KeepLocks,
        Sabotage::ReserveTwice,
        Sabotage::DropSilentChildren,
        Sabotage::AdoptUnacknowledged,
        Sabotage::NoListening,
        Sabotage::IgnoreStrangers,
        Sabotage::ShallowSearch,
        Sabotage::AcceptStaleValues,
        Sabotage::AnyLowerOnSolids,
        Sabotage::GrantEverything,
        Sabotage::AskNobody,
        Sabotage::ForgetLocks,
        Sabotage::OutstayLease,
        Sabotage::GrantAfterRestart,
        Sabotage::AcceptStaleStates,
        Sabotage::StandInTheWay,
    ];
}

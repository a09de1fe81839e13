//! Known defects of the protocols and of the planner. Tests switch them on to prove that the checks find them; no
//! scenario does.

use crate::listed;
use serde::{Deserialize, Serialize};

listed! {
    /// A known defect.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[doc(hidden)]
    pub enum Defect {
        /// Both families: a message is accepted even if it was sent in an earlier session.
        IgnoreSessions,
        /// Cubes: moves carry no latest start time for the body.
        NoDeadline,
        /// Cubes: a grant ends long before the mover believes it does.
        ShortLease,
        /// Cubes: locks and reservations of others are not checked before leaving.
        IgnoreLocks,
        /// Cubes: locks are never released.
        KeepLocks,
        /// Cubes: a cell is reserved for every module that asks.
        ReserveTwice,
        /// Cubes: a silent child is dropped.
        DropSilentChildren,
        /// Cubes: a parent is adopted before it has acknowledged.
        AdoptUnacknowledged,
        /// Cubes: a restarted module takes part at once.
        NoListening,
        /// Cubes: a neighbour that has not been heard yet is ignored.
        IgnoreStrangers,
        /// Cubes: the neighbours of a mover count as connected although the search for a cycle has not connected them.
        ShallowSearch,
        /// Cubes: gradient values are accepted however old they are.
        AcceptStaleValues,
        /// Cubes: a cell of a solid goal is started as soon as any lower neighbour is filled, as in scaffolds.
        AnyLowerOnSolids,
        /// Cubes: a module announces that it holds a dead neighbour without proof that its own path to the finalized
        /// modules does not lead through that neighbour.
        LetGoUnproved,
        /// Cubes: a dead neighbour that is a registered child counts as proof that a module's path does not lead through
        /// it.
        ChildProves,
        /// Cubes: a beacon that a dead neighbour sent before its death makes a module let go of it, even if the module
        /// has announced that it holds the neighbour.
        ForgetSaid,
        /// Cubes: a module lets go of a dead neighbour after an announcement about another death of that neighbour.
        LetGoOldDeath,
        /// Cubes: a module lets go of a dead neighbour after an announcement that belongs to another goal.
        EpochWords,
        /// Cubes: a cycle does not keep a dead neighbour of the mover connected.
        IgnoreDead,
        /// Cubes: a neighbour that died finalized for an earlier goal counts as one of the present goal.
        RootOfOldGoal,
        /// Cubes: modules slide from dead ones, and leave from beside them, at any time.
        IgnoreTurns,
        /// Cubes: all modules slide from dead ones in the same slot.
        OneColour,
        /// Cubes: a neighbour counts as having spoken when its beacon is taken from the inbox, not when it was sent.
        TrustArrival,
        /// Cubes: a walker leaves although it has not heard a neighbour, which may rest on it.
        LeaveStrangers,
        /// Cubes: the last words of a neighbour that died in an earlier epoch count for the present one.
        FixedOfOldEpoch,
        /// Cubes: a restarted module believes that its dead neighbours stay connected without it.
        BelieveAfterRestart,
        /// Cubes: holders of the dead are ordered by their places alone, not by when their paths were confirmed.
        ClusterOrder,
        /// Metamodules: every request is granted.
        GrantEverything,
        /// Metamodules and free modules: no other module is asked for its consent.
        AskNone,
        /// Metamodules: locks are dropped at once, by the holder and by the modules that granted them. Both have to
        /// drop them: a module that remembers its grant plans its motions around it.
        ForgetLocks,
        /// Metamodules: a holder goes on after its lease has ended.
        OutstayLease,
        /// Metamodules: a restarted metamodule grants at once.
        GrantAfterRestart,
        /// Metamodules: an earlier state replaces a later one, even a certified death. The next state of a living
        /// sender corrects it.
        AcceptStaleStates,
        /// Metamodules: no metamodule makes way, neither on its own nor on a directive.
        StandInTheWay,
        /// Metamodules and free modules: an order of an earlier plan replaces a later one.
        FollowOldPlans,
        /// All families: deadlines of actions leave no room for the difference of clocks between hosts.
        IgnoreSkew,
        /// Cubes: a restarted module takes the time of its restart from its own clock.
        OwnBirthTime,
    }
}

/// A known defect of the planner of free modules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[doc(hidden)]
pub enum PlanningDefect {
    /// A connection that holds the structure together can be detached.
    DetachBridges,
    /// A joint turns although a loop of modules locks it.
    TurnInLoops,
    /// A turn is not checked against the half of its own cube that stays.
    IgnoreOwnHalf,
}

listed! {
    /// A known defect of the link between two hosts.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    #[doc(hidden)]
    pub enum HostLinkDefect {
        /// Frames are taken although they have come before, or after a later one.
        TakeDoubled,
        /// A stream goes on after a gap.
        SkipGaps,
        /// A stream is not sent again after a gap.
        NoRepeat,
        /// Frames are sent however many are under way.
        IgnoreWindow,
        /// Packets from and for an earlier life are taken.
        TrustAnyLife,
        /// Frames that an acknowledgement shows to be lost are counted again with each acknowledgement.
        CountLossTwice,
        /// A ward acts as long as it hears its guardian, although that may not hear it.
        LeaseByHearing,
        /// An accept is taken whatever hello it answers.
        AnyAttempt,
        /// A confirmation is taken whatever accept it answers.
        AnyChallenge,
    }
}

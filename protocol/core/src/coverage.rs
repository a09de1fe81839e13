//! Coverage points: rare paths of the protocols and drivers note that they have run, so that an exploration
//! can list the paths that were never taken.
//!
//! How often each point has run is counted for each thread; a count costs about as much as an addition, and measurements
//! read it. *Invariant.* No protocol and no driver reads the counts, so they cannot influence a run. Without the feature
//! `std` there are no threads to count for: [`hit`] does nothing, and nothing reads it.

#[cfg(feature = "std")]
use core::cell::Cell;

macro_rules! marks {
    ($($(#[$doc:meta])* $name:ident => $text:literal,)*) => {
        /// A rare path.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum CoveragePoint {
            $(#[doc = $text] $name,)*
        }
        impl CoveragePoint {
            /// All points.
            pub const ALL: &'static [CoveragePoint] = &[$(CoveragePoint::$name),*];
            /// Returns the name used in reports; the part before the colon is the family or the driver.
            pub const fn name(self) -> &'static str {
                match self { $(CoveragePoint::$name => $text,)* }
            }
        }
    };
}

marks! {
    CubeAsked => "cube: a module began to ask for a move",
    CubeLockExpired => "cube: a lock ran out",
    CubeRequestRepeated => "cube: a request that came twice was granted again",
    CubeDeniedNoSupport => "cube: refused, nothing to stand on",
    CubeDeniedBusy => "cube: refused, moving",
    CubeDeniedFull => "cube: refused, too many locks",
    CubeDeniedQuarantined => "cube: refused, just restarted",
    CubeDeniedYounger => "cube: refused, had waited longer itself",
    CubeDeniedOccupied => "cube: refused, the cell is taken",
    CubeDeniedReserved => "cube: refused, the cell is kept for another",
    CubeYielded => "cube: gave its own attempt up for another's request",
    CubeTimedOut => "cube: answers did not come",
    CubeRelayCutOff => "cube: a request was denied because the next module has left",
    CubeRelayRepeated => "cube: a request was repeated on its way",
    CubeAskedAgain => "cube: an unanswered request was repeated",
    CubeAnswerOvertaken => "cube: a grant or a denial came back when it did not count any more",
    CubeOutOfTurn => "cube: all was granted, but it was not its turn any more",
    CubeTooLate => "cube: all was granted too late",
    CubeHeldAtLaunch => "cube: all was granted, but it may not leave any more",
    CubeTooManyRequests => "cube: an attempt needed too many requests",
    CubeReleaseForwarded => "cube: a release was passed on",
    CubeReleasedByLoss => "cube: locks were dropped because their owner has left",
    CubeSearchStarted => "cube: a search for a cycle began",
    CubeSearchRepeated => "cube: a message of a search was repeated on one hop",
    CubeSearchWidened => "cube: a search went farther",
    CubeSearchExhausted => "cube: the farthest search found nothing",
    CubeFoundRoot => "cube: a search found the finalized ones",
    CubeFoundRound => "cube: a search came round to the mover",
    CubeFoundDead => "cube: a search found a module beside a dead neighbour of the mover",
    CubeParentReplaced => "cube: a module changed its parent",
    CubeParentLost => "cube: a parent left",
    CubeWantDropped => "cube: a wanted parent could not be had any more",
    CubeNotAdoptable => "cube: an acknowledged parent was not adopted",
    CubeParentSuspected => "cube: a silent parent was to be replaced",
    CubeRenewalAsked => "cube: a path to the finalized modules had to be confirmed anew",
    CubeRootRenewed => "cube: a finalized module vouched for itself anew",
    CubeDeadIsFixed => "cube: a dead module is known to stay connected without a holder",
    CubeHangsOnDead => "cube: a dead finalized module became a parent",
    CubeCustodyAnnounced => "cube: a module announced that it holds a dead one",
    CubeCustodyReleased => "cube: a module let go of a dead one that another holds",
    CubeStartedByDead => "cube: a module was finalized in place of a dead one that would have started it",
    CubeDeadSpoke => "cube: a beacon of a dead neighbour came after its certificate",
    CubeRebornWaits => "cube: a restarted module waited to hear all neighbours",
    CubeBeaconLate => "cube: a beacon came late or twice",
    CubeRelaxed => "cube: a cell was unfilled for so long that any neighbour may start it",
    CubeWaitsForNews => "cube: a neighbour was heard again after long, and no cell is started out of turn at once",
    CubeEpochAfterMove => "cube: a new goal had to wait for the end of a move",
    CubeReopened => "cube: a module took up a goal that was opened again",
    CubeSourceForgotten => "cube: a field forgot a source to make room",
    CubeSourcesFull => "cube: a field had no room for another source",
    CubeStaleVersion => "cube: an old version of a distance was refused",
    CubeNotCloser => "cube: a distance was refused that could be its own echo",
    CubeVersionExpired => "cube: a distance was not renewed",
    CubeDetour => "cube: a walker took a detour",
    CubeBehindWalker => "cube: a walker waited behind another",
    CubeSteered => "cube: an operator commanded",
    CubeCalled => "cube: the controller called a module along a way",
    CubeCarries => "cube: a module granted the controller that it carries a called one",
    CubeParked => "cube: a walker without a target took a place in the forest",
    CubeLandsOnDead => "cube: a request ended at a dead module, which needs no lock",
    CubeImmobile => "cube: a joint was given up",
    CubeMoveFailed => "cube: a move failed",
    CubeRefusedBlocked => "cube: the body refused, a cell was taken",
    CubeRefusedLate => "cube: the body refused, too late",
    CubeRefusedStale => "cube: the body refused, contacts had changed",
    CubeCornerSeen => "cube: a walker saw a blocked corner",
    CubeCarriedOn => "cube: a restarted module heard of an earlier incarnation's move",
    MetaGrantExpired => "metamodule: a grant ran out",
    MetaRequestRepeated => "metamodule: a request that came twice was granted again",
    MetaRequestOver => "metamodule: a request came after its release",
    MetaDeniedOccupied => "metamodule: refused, it stands there",
    MetaDeniedHeld => "metamodule: refused, it moves there",
    MetaDeniedYounger => "metamodule: refused, more important itself",
    MetaDeniedQuarantined => "metamodule: refused, just restarted",
    MetaLetFirst => "metamodule: stood still for one that goes before it",
    MetaYielded => "metamodule: gave its own attempt up for another's request",
    MetaResent => "metamodule: a request was repeated",
    MetaCameWhileAsking => "metamodule: another came into range while it asked",
    MetaLockRanOut => "metamodule: its lock would have run out on the way",
    MetaStaleOnTheWay => "metamodule: contacts changed on the way",
    MetaStaleAtStart => "metamodule: contacts changed before it began",
    MetaActionGivenUp => "metamodule: an action failed too often",
    MetaStuck => "metamodule: its joints stuck",
    MetaJointsTried => "metamodule: it tried stuck joints",
    MetaEarlierLifeSettled => "metamodule: a restarted one was in a filled seed",
    MetaEarlierLifeGripped => "metamodule: a restarted one let go for its earlier incarnation",
    MetaEarlierLifeActed => "metamodule: an action of an earlier incarnation ended",
    MetaStaysForNewTask => "metamodule: it was right for the new task where it was",
    MetaCondemnedSpoke => "metamodule: the state of a dead one came late",
    MetaStateLate => "metamodule: a state came late or twice",
    MetaDeathTold => "metamodule: a death was told",
    MetaSteered => "metamodule: an operator commanded",
    MetaObstacle => "metamodule: an obstacle was told",
    MetaOutranked => "metamodule: its claim was outranked",
    MetaUnreachable => "metamodule: a seed was unreachable",
    MetaGaveUpSeed => "metamodule: a claimed seed was given up",
    MetaLetBy => "metamodule: went where another gets past on another path",
    MetaCornered => "metamodule: no way out of a more important path",
    MetaMadeWay => "metamodule: it made way",
    MetaNearest => "metamodule: the nearest seed was claimed, no other had claimed it",
    MetaLed => "metamodule: it led, no other made progress",
    MetaLedInVain => "metamodule: it led and found no plan for all together",
    MetaByLuck => "metamodule: a plan for all together was found by random walk",
    MetaCalled => "metamodule: it made a move that it was called to make",
    DriverSleptOver => "driver: a stopped process missed messages and percepts",
    DriverInboxFull => "driver: the inbox of a stopped process was full",
    DriverDiedUnread => "driver: a process died with unread messages",
    DriverDamaged => "driver: a damaged message was refused",
    DriverExpired => "driver: a message came after its contact had ended",
}

const _: () = assert!(CoveragePoint::ALL.len() <= 128, "marks are kept in 128 bits");

/// A set of coverage points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct CoveragePoints(u128);

impl CoveragePoints {
    /// Returns true if the point is in the set.
    pub const fn has(self, mark: CoveragePoint) -> bool {
        self.0 >> mark as u32 & 1 == 1
    }
}

#[cfg(feature = "std")]
std::thread_local! {
    static COUNTS: [Cell<u64>; CoveragePoint::ALL.len()] =
        const { [const { Cell::new(0) }; CoveragePoint::ALL.len()] };
}

/// Notes that this path has run.
#[inline]
pub fn hit(mark: CoveragePoint) {
    #[cfg(feature = "std")]
    COUNTS.with(|counts| counts[mark as usize].set(counts[mark as usize].get() + 1));
    #[cfg(not(feature = "std"))]
    let _ = mark;
}

/// Adds points that have run in another thread to those of this thread.
#[cfg(feature = "std")]
pub fn add(marks: CoveragePoints) {
    CoveragePoint::ALL.iter().filter(|mark| marks.has(**mark)).for_each(|mark| hit(*mark));
}

/// Returns how often a point has run in this thread since the last [`take`]. For measurements, not for agents.
#[cfg(feature = "std")]
pub fn count(mark: CoveragePoint) -> u64 {
    COUNTS.with(|counts| counts[mark as usize].get())
}

/// Returns the points that have run in this thread since the last call, and counts from zero again. For drivers, not for agents.
#[cfg(feature = "std")]
pub fn take() -> CoveragePoints {
    COUNTS.with(|counts| {
        let marks = counts.iter().enumerate().filter(|(_, count)| count.take() > 0);
        CoveragePoints(marks.fold(0, |set, (i, _)| set | 1 << i))
    })
}

#[cfg(feature = "std")]
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_taken_once_and_by_their_thread() {
        take();
        hit(CoveragePoint::CubeDetour);
        hit(CoveragePoint::DriverExpired);
        hit(CoveragePoint::DriverExpired);
        assert_eq!(count(CoveragePoint::DriverExpired), 2);
        assert!(std::thread::spawn(take).join().is_ok_and(|theirs| theirs == CoveragePoints::default()));
        let mine = take();
        let set: Vec<CoveragePoint> = CoveragePoint::ALL.iter().copied().filter(|m| mine.has(*m)).collect();
        assert_eq!(set, [CoveragePoint::CubeDetour, CoveragePoint::DriverExpired]);
        assert_eq!(take(), CoveragePoints::default());
    }

    #[test]
    fn names_differ() {
        let names: std::collections::BTreeSet<&str> = CoveragePoint::ALL.iter().map(|m| m.name()).collect();
        assert_eq!(names.len(), CoveragePoint::ALL.len());
    }
}

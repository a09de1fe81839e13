//! Last words: which dead neighbours touch a finalized module, and so need no holder.
//!
//! Custody asks that a module stays for the dead that may hang on it (`custody`). Many of them touch a finalized module. It does
//! not leave, and the dead do not move, so such a dead module stays connected; it is *fixed*. Its neighbours know it from its
//! certificate, if it was finalized itself; from its last words, in which it named its finalized neighbours
//! ([`Beacon::finals`]); or from the announcement of a finalized holder. A fixed module needs no holder; it serves as a parent,
//! which needs no confirmation, and it starts goal cells beside it.
//!
//! *Why it stays true.* The finalized neighbour stays where it is also after its death or restart. What was said counts for one epoch
//! and one contact session. A dead module that only hangs together with fixed ones over other dead modules is not fixed. Custody
//! frees its holders. As a parent it is only as good as what is known of the time: if the dead in between restart, it is connected as
//! long as they stay, and a path over it must not be confirmed later (`hang_on_connected`).

use super::ParentForest;
use crate::custody;
use crate::message::{Beacon, Role};
use crate::params::Connectivity;
use crate::view::View;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::lattice::Face;

impl ParentForest {
    /// Returns true if the dead neighbour on a face was finalized, or touches a finalized module.
    pub fn is_fixed(&self, v: View<'_>, face: Face) -> bool {
        v.sides.is_certified_dead(face) && (v.died_finalized(face) || self.custody.is_fixed(face))
    }

    /// Returns the faces whose dead neighbour is fixed; all, if this module is finalized itself.
    pub fn fixed_mask(&self, v: View<'_>) -> u8 {
        let is_fixed = |f: &Face| v.own.role == Role::Final || self.is_fixed(v, *f);
        Face::mask(Face::in_mask(v.sides.certified_mask()).filter(is_fixed))
    }

    /// Notes which dead neighbours are fixed. Returns true if there is news.
    pub fn tend_fixed(&mut self, v: View<'_>) -> bool {
        if self.custody.is_empty() || !custody::believes(v) || v.own.connectivity() != Connectivity::Forest {
            return false;
        }
        let mut is_news = false;
        for face in Face::in_mask(v.sides.certified_mask()) {
            if !self.is_fixed(v, face) && named_final(v, face) && self.custody.set_fixed(face) {
                hit(CoveragePoint::CubeDeadIsFixed);
                // It needs this module no more.
                self.forget_child(face);
                is_news = true;
            }
        }
        is_news
    }

    /// Returns true if this module stays anyway, for a dead neighbour that it has announced to hold.
    pub(super) fn stays_for_any(&self, v: View<'_>) -> bool {
        Face::ALL.into_iter().any(|f| self.custody.is_announced(f) && !self.custody.is_released(v, f))
    }

    /// Returns true if the neighbour that sent `b` stays for a dead one and is as near to the finalized modules as the parent,
    /// which stays for this module only and may leave then.
    pub(super) fn is_shared(&self, v: View<'_>, b: &Beacon) -> bool {
        let parent = self.parent.filter(|f| !v.sides.is_certified_dead(*f)).and_then(|f| v.peer(f));
        stays_for_dead(b)
            && b.rank.below().label <= self.rank.label
            && parent.is_some_and(|p| p.role == Role::Reserve && !stays_for_dead(p))
    }
}

/// Returns true if the module that sent a beacon touches a dead one that is not known to be fixed.
pub(super) fn stays_for_dead(b: &Beacon) -> bool {
    b.dead & !b.fixed != 0
}

/// Returns true if a beacon belongs to the present epoch.
fn is_of_epoch(v: View<'_>, b: &Beacon) -> bool {
    b.epoch == v.own.epoch || v.has(Defect::FixedOfOldEpoch)
}

/// Returns true if the dead neighbour on a face named a finalized neighbour other than this module.
fn named_final(v: View<'_>, face: Face) -> bool {
    let others = |b: &Beacon| b.finals & !face.opposite().bit();
    v.peer(face).is_some_and(|b| is_of_epoch(v, b) && others(b) != 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Order;
    use crate::custody::tests::{Bench, DEAD, DIED, PARENT};
    use crate::epoch::{Epoch, Opening};
    use crate::message::{Claim, Rank};
    use metamorph_core::ids::{Session, Token};
    use metamorph_core::time::{Span, Time};

    const RANK: Rank = Rank { rooted: Time::ZERO, label: 3 };

    /// Lets the neighbour, a child, name finalized neighbours, die and be certified.
    fn dies(bench: &mut Bench, finals: u8) {
        bench.speaks(DEAD, RANK, |b| (b.claim, b.finals) = (Claim::Parent(Token(1)), finals));
        bench.now = DIED + Span::secs(1);
        bench.condemn(Session(1));
    }

    #[test]
    fn a_dead_module_that_named_a_finalized_one_needs_no_holder() {
        let is_free = |finals: u8| {
            let mut bench = Bench::living(None);
            dies(&mut bench, finals);
            bench.is_free()
        };
        assert!(is_free(Face::Up.bit()));
        assert!(!is_free(0));
        assert!(!is_free(DEAD.opposite().bit()), "it named this module, which is not finalized any more");
    }

    #[test]
    fn last_words_count_for_one_epoch() {
        let later = |defect| {
            let mut bench = Bench::living(defect);
            dies(&mut bench, Face::Up.bit());
            bench.order(Order::Goal(Opening::of(Epoch::first(1), bench.now)));
            bench
        };
        let mut bench = later(None);
        bench.adopt_again();
        assert!(!bench.is_free());
        let mut bench = later(Some(Defect::FixedOfOldEpoch));
        bench.speaks(PARENT, RANK, |_| {});
        assert!(bench.is_free());
    }

    #[test]
    fn a_restarted_module_holds_its_dead_neighbours() {
        let is_free = |defect| {
            let mut bench = Bench::living(defect);
            bench.cube.own.restarted = true;
            dies(&mut bench, Face::Up.bit());
            bench.is_free()
        };
        assert!(!is_free(None));
        assert!(is_free(Some(Defect::BelieveAfterRestart)));
    }
}

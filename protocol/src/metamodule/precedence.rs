//! Precedence under the published strategies: of two unsettled metamodules close together one goes first,
//! and the other stands still ("locking modules which are too close from each other before deciding which
//! one should move first", thesis 4.1.3).
//!
//! What decides is worked out by each metamodule alone, from the states that neighbours have told and the
//! seeds known to be open. The order is total, so a wait never closes a circle while both know the same;
//! where they do not, the locks still keep them apart. Absent: `negotiated`, which claims seeds instead.

use super::Metamodule;
use super::blueprint::Seed;
use super::params::PrecedenceBy;
use super::pose::Pose;
use crate::ids::ModuleId;
use crate::lattice::Cell;
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::strategy::force_field::distance;

/// Where a metamodule stands in the order: distance to the nearest open seed, then id. Smaller goes first.
type Turn = (i64, ModuleId);

impl Metamodule {
    /// Returns the first in the order of those close by that go before this one, or `None` if this one may
    /// move. `fixed` are the cells that stay taken.
    ///
    /// Settled and dead bodies never move, and one with stuck joints cannot: none of them is waited for.
    pub(super) fn goes_before(&self, fixed: &[Cell]) -> Option<ModuleId> {
        let precedence = self.setup.params.precedence?;
        let seeds: Vec<Seed> =
            self.open().iter().filter_map(|seed| self.setup.seed(self.core.task, seed)).collect();
        if seeds.is_empty() {
            return None;
        }
        let turn = |id: ModuleId, pose: Pose| -> Turn {
            match precedence.by {
                PrecedenceBy::SeedDistance => (self.nearest(&seeds, pose, fixed), id),
                PrecedenceBy::Id => (0, id),
            }
        };
        let foot = self.core.pose.foot();
        let is_close = |pose: &Pose| {
            let at = pose.foot();
            at.0.abs_diff(foot.0).max(at.1.abs_diff(foot.1)) <= precedence.within
        };
        let states = self.core.peers.iter().filter_map(|(_, peer)| peer.state);
        let close = states.filter(|s| {
            is_close(&s.pose) && !self.stays(s) && !s.stuck && !self.core.dead.contains_key(&s.id)
        });
        let others: Vec<Turn> = close.map(|s| turn(s.id, s.pose)).collect();
        let first = others.into_iter().min()?;
        (first < turn(self.core.id, self.core.pose)).then_some(first.1)
    }

    /// The distance to the nearest of some seeds, as the force field measures it.
    fn nearest(&self, seeds: &[Seed], pose: Pose, fixed: &[Cell]) -> i64 {
        let (motions, floor) = (&self.setup.motions, self.setup.floor);
        let lands = Ground { motions, floor, taken: fixed }.lands(pose);
        let far = |seed: &Seed| {
            let strides = motions.distances(floor, *seed, fixed).strides(pose, lands)?;
            Some(distance(strides, pose, seed.foot))
        };
        seeds.iter().filter_map(far).min().unwrap_or(i64::MAX)
    }
}

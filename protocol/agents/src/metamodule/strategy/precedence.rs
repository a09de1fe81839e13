//! Precedence under the published strategies: of two unsettled metamodules close together one goes first,
//! and the other stands still ("locking modules which are too close from each other before deciding which
//! one should move first", thesis 4.1.3).
//!
//! Each metamodule computes the order alone, from the states that neighbours have announced and the
//! seeds known to be open. The order is total, so a wait never closes a circle while both know the same;
//! where they do not, the locks still keep them apart. Absent: `negotiated`, which claims seeds instead.

use crate::metamodule::blueprint::Seed;
use crate::metamodule::message::State;
use crate::metamodule::params::PrecedenceBy;
use crate::metamodule::pose::Pose;
use crate::metamodule::strategy::force_field::distance;
use crate::metamodule::view::View;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;

/// Where a metamodule stands in the order: distance to the nearest open seed, then id. Smaller goes first.
type Turn = (i64, ModuleId);

/// Returns the neighbour close by that comes first in the order, if it goes before this metamodule; `None` if this
/// metamodule may move. `fixed` are the cells that stay taken.
///
/// Settled and dead bodies never move, and one with stuck joints cannot: none of them is waited for.
pub(super) fn goes_before(v: View<'_>, fixed: &[Cell]) -> Option<ModuleId> {
    let (precedence, own) = (v.params().precedence?, v.own);
    let seeds: Vec<Seed> = v.open().iter().filter_map(|seed| v.setup.seed(own.task, seed)).collect();
    if seeds.is_empty() {
        return None;
    }
    let turn = |id: ModuleId, pose: Pose| -> Turn {
        match precedence.by {
            PrecedenceBy::SeedDistance => (nearest(v, &seeds, pose, fixed), id),
            PrecedenceBy::Id => (0, id),
        }
    };
    let foot = own.pose.foot();
    let is_close = |pose: &Pose| {
        let at = pose.foot();
        at.0.abs_diff(foot.0).max(at.1.abs_diff(foot.1)) <= precedence.within
    };
    let may_move = |s: &State| !v.stays(s) && !s.stuck && !v.neighbours.is_dead(s.id);
    let close = v.neighbours.states().map(|(_, s)| s).filter(|s| is_close(&s.pose) && may_move(s));
    let first = close.map(|s| turn(s.id, s.pose)).min()?;
    (first < turn(own.id, own.pose)).then_some(first.1)
}

/// The distance to the nearest of some seeds, as the force field measures it.
fn nearest(v: View<'_>, seeds: &[Seed], pose: Pose, fixed: &[Cell]) -> i64 {
    let lands = v.ground(fixed).lands(pose);
    let far = |seed: &Seed| {
        let steps = v.motions().distances(v.setup.floor, *seed, fixed).steps(pose, lands)?;
        Some(distance(steps, pose, seed.foot))
    };
    seeds.iter().filter_map(far).min().unwrap_or(i64::MAX)
}

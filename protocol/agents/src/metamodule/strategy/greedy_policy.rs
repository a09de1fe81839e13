//! The published strategies (thesis 4.1.3): a metamodule makes the landing with the highest score in the force field,
//! or the last motion into a seed. The strategies differ only in their parameters, and have no state.

use super::context::Decision;
use super::force_field::{Field, WORTH};
use super::precedence::goes_before;
use crate::metamodule::blueprint::{Seed, SeedSet, Task};
use crate::metamodule::motions::Middle;
use crate::metamodule::plan::{Aim, Plan};
use crate::metamodule::planning::graph::{Landed, Reach};
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::pose::Pose;
use crate::metamodule::setup::Setup;
use crate::metamodule::view::View;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;

/// Decides what to do next, from the states that neighbours have announced.
pub(in crate::metamodule) fn look(v: View<'_>, next_expiry: Time) -> Decision {
    let motions = v.motions();
    let (mut fixed, mut moving) = (v.fixed(), Vec::new());
    let (mut feet, mut neighbours) = (Vec::new(), Vec::new());
    feet.extend(v.neighbours.dead.values().map(|p| p.foot()));
    for (_, state) in v.neighbours.states() {
        feet.push(state.pose.foot());
        let dead = v.neighbours.is_dead(state.id);
        let is_fixed = v.stays(state) || dead;
        if is_fixed {
            fixed.extend(motions.cells(state.pose));
        } else {
            moving.extend(motions.cells(state.pose));
        }
        if !is_fixed || (v.params().settled_repel && !dead) {
            neighbours.push(motions.middle(state.pose));
        }
    }
    if let Some(first) = goes_before(v, &fixed) {
        // It tells when it has moved, settled or got stuck, which starts a new look here.
        hit(CoveragePoint::MetaLetFirst);
        return Decision::WaitFor(Some(first), next_expiry);
    }
    moving.extend(v.locks.cells(v.setup));
    let taken = [&fixed[..], &moving].concat();
    let choice = Choice {
        setup: v.setup,
        task: v.own.task,
        pose: v.own.pose,
        open: v.open(),
        ground: &v.ground(&taken),
        fixed: &fixed,
        feet: &feet,
        neighbours: &neighbours,
    };
    // The end of a grant may open a way; everything else that may is heard.
    choice.best().map_or(Decision::WaitFor(None, next_expiry), Decision::Ask)
}

/// The inputs of the choice of a motion.
struct Choice<'a> {
    setup: &'a Setup,
    task: Task,
    /// Where this metamodule stands.
    pose: Pose,
    /// The seeds that attract.
    open: SeedSet,
    /// Cells to keep out of.
    ground: &'a Ground<'a>,
    /// Those of them that stay taken.
    fixed: &'a [Cell],
    /// Connectors on which others stand.
    feet: &'a [(i16, i16)],
    /// The middles of neighbours that push.
    neighbours: &'a [Middle],
}

impl Choice<'_> {
    /// The next motion; `None` if none is possible or worth it.
    fn best(&self) -> Option<Plan> {
        let reach = self.ground.reach(self.pose);
        self.home().or_else(|| self.best_landing(&reach)).or_else(|| self.upright(&reach))
    }

    fn open_seeds(&self) -> impl Iterator<Item = (u8, Seed)> {
        self.open.iter().filter_map(|s| Some((s, self.setup.seed(self.task, s)?)))
    }

    /// Returns the motion that fills the open seed on whose connector this metamodule stands.
    fn home(&self) -> Option<Plan> {
        let (number, seed) = self.open_seeds().find(|(_, seed)| seed.foot == self.pose.foot())?;
        let (posture, _) = self.ground.filling(self.pose, seed)?;
        Plan::to(self.ground, self.pose, posture, Aim::Settle(number))
    }

    /// Standing up, if this metamodule does not stand upright yet.
    fn upright(&self, reach: &Reach) -> Option<Plan> {
        let motions = self.ground.motions;
        let stands = |p: u16| motions.graph().filled(p).iter().all(|c| (c.x, c.y) == (0, 0));
        if stands(self.pose.posture) {
            return None;
        }
        let (to, _) = reach.chains.iter().flatten().find(|(p, _)| stands(*p))?;
        Plan::to(self.ground, self.pose, *to, Aim::Shift)
    }

    /// Returns the motion to the landing with the highest score in the force field, if that score exceeds [`WORTH`].
    fn best_landing(&self, reach: &Reach) -> Option<Plan> {
        let motions = self.ground.motions;
        let landings: Vec<(Landed, Pose)> = reach
            .landings
            .iter()
            .filter_map(|l| Some((*l, self.ground.landed(self.pose, l.posture)?)))
            .filter(|(_, to)| to.state != self.pose.state)
            .collect();
        let places: Vec<Pose> = landings.iter().map(|(_, to)| *to).collect();
        // A seed on whose connector another one stands does not attract.
        let seeds = self.open_seeds().map(|(_, seed)| seed).filter(|s| !self.feet.contains(&s.foot));
        let mut field = Field::new(motions, self.ground.floor, self.fixed, self.pose, places);
        seeds.for_each(|seed| field.add_seed(seed));
        let own = motions.middle(self.pose);
        for of in self.neighbours {
            field.add_push(self.setup.params.repulsion, own, *of);
        }
        // Of equal ones the first is kept, which is the one with the nearest posture.
        let scores = (0..landings.len()).map(|i| (field.score(i, landings[i].0.turns), i));
        let (score, best) = scores.rev().max_by_key(|(score, _)| *score)?;
        let posture = landings[best].0.posture;
        (score > WORTH).then(|| Plan::to(self.ground, self.pose, posture, Aim::Land))?
    }
}

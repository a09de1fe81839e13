//! What to do next: the best landing by the force field, or the last motion into a seed.

use super::blueprint::SeedSet;
use super::field::{Force, Middle, WORTH};
use super::motions::{Motions, Sweep};
use super::params::Setup;
use super::pose::{Pose, to_world};
use crate::lattice::Cell;
use crate::roombots::database::Reach;

/// What a motion is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Aim {
    /// Putting the free end on a connector, and letting go of the other.
    Land,
    /// Filling this seed.
    Settle(u8),
}

/// A motion from one pose, to be locked as a whole.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Plan {
    /// Where it begins.
    pub from: Pose,
    /// The steps, by their numbers in the database.
    pub steps: Vec<u16>,
    /// All cells of it, core and graze and those filled at the beginning, seen from `from`.
    pub sweep: Sweep,
    /// What it is for.
    pub aim: Aim,
}

/// What the choice depends on.
pub struct View<'a> {
    /// What everybody shares.
    pub setup: &'a Setup,
    /// Where we are.
    pub pose: Pose,
    /// What attracts.
    pub open: SeedSet,
    /// Cells to keep out of.
    pub obstacles: &'a [Cell],
    /// The middles of neighbours that push.
    pub neighbours: &'a [Middle],
}

/// Four times the middle of a metamodule.
pub fn middle(motions: &Motions, pose: Pose) -> Middle {
    motions.cells(pose).iter().fold((0, 0), |(x, y), c| (x + i64::from(c.x), y + i64::from(c.y)))
}

impl View<'_> {
    /// The next motion; none if nothing is worth it or possible.
    pub fn choose(&self) -> Option<Plan> {
        if self.open.is_empty() {
            return None;
        }
        let motions = &self.setup.motions;
        let blocked = motions.blocked(self.pose.state, self.obstacles.iter().copied());
        let reach = motions.table().reach(self.pose.posture, &blocked);
        let seeds = self.setup.blueprint.seeds();
        let here = |s: &u8| seeds[usize::from(*s)].foot == self.pose.foot();
        match self.open.iter().find(here) {
            Some(seed) => self.into_seed(&reach, seed),
            None => self.best_landing(&reach),
        }
    }

    fn plan(&self, reach: &Reach, to: u16, aim: Aim) -> Option<Plan> {
        let motions = &self.setup.motions;
        let way = motions.table().way_within(reach, self.pose.posture, to)?;
        let own = motions.blocked(self.pose.state, motions.cells(self.pose));
        Some(Plan {
            from: self.pose,
            steps: way.steps.iter().map(|(number, _)| *number).collect(),
            sweep: Sweep::of(&way.core.union(&way.graze).union(&own)),
            aim,
        })
    }

    fn into_seed(&self, reach: &Reach, seed: u8) -> Option<Plan> {
        let table = self.setup.motions.table();
        let goal = self.setup.blueprint.seeds()[usize::from(seed)].cells();
        let fills = |posture: u16| {
            let chain = table.postures()[usize::from(posture)].chain;
            let cells = &table.chains()[usize::from(chain)].cells;
            cells.iter().zip(goal).all(|(c, g)| to_world(self.pose.state, *c) == g)
        };
        let (to, _) = reach.postures().find(|(p, _)| fills(*p))?;
        self.plan(reach, to, Aim::Settle(seed))
    }

    fn best_landing(&self, reach: &Reach) -> Option<Plan> {
        let motions = &self.setup.motions;
        let table = motions.table();
        let seeds: Vec<(i16, i16)> =
            self.open.iter().map(|s| self.setup.blueprint.seeds()[usize::from(s)].foot).collect();
        let at = self.pose.foot();
        let mut force = Force::attraction(at, seeds.iter().copied());
        let own = middle(motions, self.pose);
        for of in self.neighbours {
            force.push(self.setup.params.repulsion, own, *of);
        }
        let mut best: Option<(i64, u16)> = None;
        for (posture, turns) in reach.postures() {
            let Some(landing) = table.postures()[usize::from(posture)].landing else { continue };
            let to = self.pose.state.then(table.landings()[usize::from(landing)].state);
            if !self.setup.floor.has(to.x, to.y) {
                continue;
            }
            let score = force.score(at, (to.x, to.y), turns, &seeds);
            // Nearest postures come first, so of equal ones the first is kept.
            if score > WORTH && best.is_none_or(|(b, _)| score > b) {
                best = Some((score, posture));
            }
        }
        self.plan(reach, best?.1, Aim::Land)
    }
}

//! What to do next: the best landing by the force field, or the last motion into a seed.

use super::blueprint::SeedSet;
use super::field::{Field, Middle, WORTH};
use super::motions::{Motions, Sweep};
use super::params::Setup;
use super::pose::{Pose, to_world};
use crate::lattice::Cell;
use crate::roombots::database::Reach;
use crate::roombots::grid::GridState;
use std::collections::BTreeSet;

/// What a motion is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Aim {
    /// Putting the free end on a connector, and letting go of the other.
    Land,
    /// Filling this seed.
    Settle(u8),
    /// Standing upright, to be in the way as little as possible while there is nothing better to do.
    Rise,
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
    /// The states that the course leads over, the one that this motion leads to first.
    pub via: Vec<GridState>,
}

/// What the choice depends on.
pub struct View<'a> {
    /// What everybody shares.
    pub setup: &'a Setup,
    /// Where we are.
    pub pose: Pose,
    /// What is left of the course that was chosen last.
    pub course: &'a [GridState],
    /// What attracts.
    pub open: SeedSet,
    /// Cells to keep out of.
    pub obstacles: &'a [Cell],
    /// Connectors on which others stand.
    pub feet: &'a [(i16, i16)],
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
        let motions = &self.setup.motions;
        let blocked = motions.blocked(self.pose.state, self.obstacles.iter().copied());
        let reach = motions.table().reach(self.pose.posture, &blocked);
        let seeds = self.setup.blueprint.seeds();
        let here = |s: &u8| seeds[usize::from(*s)].foot == self.pose.foot();
        let home = self.open.iter().find(here).and_then(|seed| self.fill_seed(&reach, seed));
        home.or_else(|| self.follow(&reach, self.course))
            .or_else(|| self.best_course(&reach))
            .or_else(|| self.upright(&reach))
    }

    /// Standing up, for whoever does not stand upright yet.
    fn upright(&self, reach: &Reach) -> Option<Plan> {
        let table = self.setup.motions.table();
        let stands = |posture: u16| {
            let chain = table.postures()[usize::from(posture)].chain;
            table.chains()[usize::from(chain)].cells.iter().all(|c| (c.x, c.y) == (0, 0))
        };
        if stands(self.pose.posture) {
            return None;
        }
        let (to, _) = reach.postures().find(|(p, _)| stands(*p))?;
        self.plan(reach, to, Aim::Rise)
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
            via: Vec::new(),
        })
    }

    fn fill_seed(&self, reach: &Reach, seed: u8) -> Option<Plan> {
        self.plan(reach, self.filling(self.pose.state, reach, seed)?, Aim::Settle(seed))
    }

    /// The nearest posture that fills a seed from a state on its connector.
    fn filling(&self, state: GridState, reach: &Reach, seed: u8) -> Option<u16> {
        let table = self.setup.motions.table();
        let goal = self.setup.blueprint.seeds()[usize::from(seed)].cells();
        let fills = |posture: u16| {
            let chain = table.postures()[usize::from(posture)].chain;
            let cells = &table.chains()[usize::from(chain)].cells;
            cells.iter().zip(goal).all(|(c, g)| to_world(state, *c) == g)
        };
        reach.postures().find(|(p, _)| fills(*p)).map(|(p, _)| p)
    }

    /// Whether this is a place on an open seed's connector from which the seed can be filled. How it is
    /// turned there makes the difference: what is built already is in the way of some of the four.
    fn is_home(&self, at: Pose) -> bool {
        let seeds = self.setup.blueprint.seeds();
        let Some(seed) = self.open.iter().find(|s| seeds[usize::from(*s)].foot == at.foot()) else {
            return false;
        };
        let motions = &self.setup.motions;
        let blocked = motions.blocked(at.state, self.obstacles.iter().copied());
        self.filling(at.state, &motions.table().reach(at.posture, &blocked), seed).is_some()
    }

    /// The first motion of the best course: of all courses of the fewest strides that end in a place
    /// worth going to, the one that ends in the best.
    fn best_course(&self, reach: &Reach) -> Option<Plan> {
        let motions = &self.setup.motions;
        let field = self.field();
        let mut seen = BTreeSet::from([self.pose.state]);
        let mut front = self.strides(&self.pose, reach, &mut seen);
        let mut course: Vec<Course> = front
            .drain(..)
            .map(|(posture, turns, to)| Course { first: posture, turns, at: to, via: vec![to.state] })
            .collect();
        let mut looked = 1;
        for depth in 1..=self.setup.params.look_ahead {
            // Of equal ones the first is kept, which is the one with the nearest postures.
            let best = course
                .iter()
                .map(|c| (field.score(c.at.state, c.turns, self.is_home(c.at)), c))
                .rev()
                .max_by_key(|(score, _)| *score)
                .filter(|(score, _)| *score > WORTH);
            if let Some((_, best)) = best {
                let mut plan = self.plan(reach, best.first, Aim::Land)?;
                plan.via = best.via.clone();
                return Some(plan);
            }
            if depth == self.setup.params.look_ahead {
                break;
            }
            let mut next = Vec::new();
            for c in course {
                looked += 1;
                if looked > MOST_LOOKS {
                    break;
                }
                let blocked = motions.blocked(c.at.state, self.obstacles.iter().copied());
                let reach = motions.table().reach(c.at.posture, &blocked);
                for (_, turns, to) in self.strides(&c.at, &reach, &mut seen) {
                    let via = [&c.via[..], &[to.state]].concat();
                    next.push(Course { turns: c.turns.saturating_add(turns), at: to, via, ..c });
                }
            }
            course = next;
        }
        None
    }

    fn field(&self) -> Field<'_> {
        let motions = &self.setup.motions;
        let foot = |s: u8| self.setup.blueprint.seeds()[usize::from(s)].foot;
        // Where another one stands already, there is nothing to get.
        let seeds = self.open.iter().map(foot).filter(|f| !self.feet.contains(f));
        let mut field = Field::of_seeds(motions, self.pose.state, seeds);
        let own = middle(motions, self.pose);
        for of in self.neighbours {
            field.add_push(self.setup.params.repulsion, own, *of);
        }
        field
    }

    /// Every state not seen before that a stride leads to: the posture that lands, the number of
    /// steps, and the pose after it.
    fn strides(&self, from: &Pose, reach: &Reach, seen: &mut BTreeSet<GridState>) -> Vec<(u16, u8, Pose)> {
        let motions = &self.setup.motions;
        let mut found = Vec::new();
        for (posture, turns) in reach.postures() {
            let lands = Pose { posture, ..*from };
            let Some(to) = motions.turned_around(lands) else { continue };
            if self.setup.floor.has(to.state.x, to.state.y) && seen.insert(to.state) {
                found.push((posture, turns, to));
            }
        }
        found
    }

    /// The next stride of a course, if it is still possible.
    fn follow(&self, reach: &Reach, via: &[GridState]) -> Option<Plan> {
        let motions = &self.setup.motions;
        let next = via.first()?;
        let lands = |posture: u16| motions.landing(Pose { posture, ..self.pose }) == Some(*next);
        let (to, _) = reach.postures().find(|(p, _)| lands(*p))?;
        let mut plan = self.plan(reach, to, Aim::Land)?;
        plan.via = via.to_vec();
        Some(plan)
    }
}

/// A way over several connectors.
struct Course {
    first: u16,
    turns: u8,
    at: Pose,
    via: Vec<GridState>,
}

/// So many places are looked at from, at most, in one choice.
const MOST_LOOKS: usize = 150;

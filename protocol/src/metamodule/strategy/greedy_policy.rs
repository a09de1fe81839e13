//! What to do next by the force field alone (thesis 4.1.3): the best landing, or the last motion into a
//! seed.

use crate::lattice::Cell;
use crate::metamodule::blueprint::{Seed, SeedSet, Task};
use crate::metamodule::motions::{Motions, Sweep};
use crate::metamodule::params::Setup;
use crate::metamodule::planning::graph::{Landed, Reach};
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::pose::Pose;
use crate::metamodule::strategy::force_field::{Field, Middle, WORTH};

/// What a motion is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Aim {
    /// Putting the free end on a connector, and letting go of the other.
    Land,
    /// Filling this seed.
    Settle(u8),
    /// Taking another shape, to be less in the way.
    Shift,
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
    /// The posture at the end.
    pub ends: u16,
    /// What it is for.
    pub aim: Aim,
    /// It was chosen because it ends where it is no harm to anybody (`negotiated` only).
    pub harmless: bool,
}

impl Plan {
    /// The shortest motion to a posture over free ground.
    pub fn to(ground: &Ground<'_>, from: Pose, posture: u16, aim: Aim) -> Option<Plan> {
        let graph = ground.motions.graph();
        let way = graph.way(from.posture, posture, ground.taken_at(from))?;
        let sweep = Sweep(way.swept | graph.filled_bits(from.posture));
        Some(Plan { from, steps: way.steps.to_vec(), sweep, ends: posture, aim, harmless: false })
    }
}

/// Four times the middle of a metamodule.
pub fn middle(motions: &Motions, pose: Pose) -> Middle {
    motions.cells(pose).iter().fold((0, 0), |(x, y), c| (x + i64::from(c.x), y + i64::from(c.y)))
}

/// What the choice depends on.
pub struct View<'a> {
    /// What everybody shares.
    pub setup: &'a Setup,
    /// What is built.
    pub task: Task,
    /// Where we are.
    pub pose: Pose,
    /// What attracts.
    pub open: SeedSet,
    /// Cells to keep out of.
    pub ground: &'a Ground<'a>,
    /// Those of them that stay taken.
    pub fixed: &'a [Cell],
    /// Connectors on which others stand.
    pub feet: &'a [(i16, i16)],
    /// The middles of neighbours that push.
    pub neighbours: &'a [Middle],
}

impl View<'_> {
    /// The next motion; none if nothing is worth it or possible.
    pub fn choose(&self) -> Option<Plan> {
        let reach = self.ground.reach(self.pose);
        self.home().or_else(|| self.best_landing(&reach)).or_else(|| self.upright(&reach))
    }

    fn open_seeds(&self) -> impl Iterator<Item = (u8, Seed)> {
        self.open.iter().filter_map(|s| Some((s, self.setup.seed(self.task, s)?)))
    }

    /// Filling the open seed on whose connector this is.
    fn home(&self) -> Option<Plan> {
        let (number, seed) = self.open_seeds().find(|(_, seed)| seed.foot == self.pose.foot())?;
        let (posture, _) = self.ground.filling(self.pose, seed)?;
        Plan::to(self.ground, self.pose, posture, Aim::Settle(number))
    }

    /// Standing up, for whoever does not stand upright yet.
    fn upright(&self, reach: &Reach) -> Option<Plan> {
        let motions = self.ground.motions;
        let stands = |p: u16| motions.graph().filled(p).iter().all(|c| (c.x, c.y) == (0, 0));
        if stands(self.pose.posture) {
            return None;
        }
        let (to, _) = reach.chains.iter().flatten().find(|(p, _)| stands(*p))?;
        Plan::to(self.ground, self.pose, *to, Aim::Shift)
    }

    /// The landing that the force field likes best, if it likes it at all.
    fn best_landing(&self, reach: &Reach) -> Option<Plan> {
        let motions = self.ground.motions;
        let landings: Vec<(Landed, Pose)> = reach
            .landings
            .iter()
            .filter_map(|l| Some((*l, self.ground.landed(self.pose, l.posture)?)))
            .filter(|(_, to)| to.state != self.pose.state)
            .collect();
        let places: Vec<Pose> = landings.iter().map(|(_, to)| *to).collect();
        // Where another one stands already, there is nothing to get.
        let seeds = self.open_seeds().map(|(_, seed)| seed).filter(|s| !self.feet.contains(&s.foot));
        let mut field = Field::new(motions, self.ground.floor, self.fixed, self.pose, places);
        seeds.for_each(|seed| field.add_seed(seed));
        let own = middle(motions, self.pose);
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

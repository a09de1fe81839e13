//! What to do next by the force field alone (thesis 4.1.3): the best landing, or the last motion into a
//! seed.

use super::blueprint::{Seed, SeedSet, Task};
use super::field::{Field, Middle, WORTH};
use super::motions::{Motions, Sweep};
use super::params::Setup;
use super::pose::Pose;
use super::search::{Course, Ground};
use crate::roombots::grid::GridState;
use std::collections::BTreeSet;

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
    /// What it is for.
    pub aim: Aim,
}

impl Plan {
    /// The shortest motion to a posture over free ground.
    pub fn to(ground: &Ground<'_>, from: Pose, posture: u16, aim: Aim) -> Option<Plan> {
        let graph = ground.motions.graph();
        let way = graph.way(from.posture, posture, ground.taken_at(from))?;
        let sweep = Sweep(way.swept | graph.filled_bits(from.posture));
        Some(Plan { from, steps: way.steps.to_vec(), sweep, aim })
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
    /// What is left of the course that was chosen last.
    pub course: &'a Course,
    /// What attracts.
    pub open: SeedSet,
    /// Cells to keep out of.
    pub ground: &'a Ground<'a>,
    /// Connectors on which others stand.
    pub feet: &'a [(i16, i16)],
    /// The middles of neighbours that push.
    pub neighbours: &'a [Middle],
}

impl View<'_> {
    /// The next motion and the course that begins with it; none if nothing is worth it or possible.
    pub fn choose(&self) -> Option<(Plan, Course)> {
        let home = self.home(self.pose).and_then(|(number, posture)| {
            Some((Plan::to(self.ground, self.pose, posture, Aim::Settle(number))?, Course::default()))
        });
        home.or_else(|| self.follow(self.course.clone()))
            .or_else(|| self.follow(self.best_course()?))
            .or_else(|| self.upright())
    }

    fn open_seeds(&self) -> impl Iterator<Item = (u8, Seed)> {
        self.open.iter().filter_map(|s| Some((s, self.setup.seed(self.task, s)?)))
    }

    /// The open seed on whose connector this is, and the posture that fills it. How one is turned there
    /// makes the difference: what is built already is in the way of some of the four classes.
    fn home(&self, at: Pose) -> Option<(u8, u16)> {
        let (number, seed) = self.open_seeds().find(|(_, seed)| seed.foot == at.foot())?;
        Some((number, self.ground.filling(at, seed)?.0))
    }

    /// The next stride of a course, if it is possible.
    fn follow(&self, course: Course) -> Option<(Plan, Course)> {
        let (posture, _) = course.next()?;
        Some((Plan::to(self.ground, self.pose, posture, Aim::Land)?, course))
    }

    /// Standing up, for whoever does not stand upright yet.
    fn upright(&self) -> Option<(Plan, Course)> {
        let motions = self.ground.motions;
        let stands = |p: u16| motions.graph().filled(p).iter().all(|c| (c.x, c.y) == (0, 0));
        if stands(self.pose.posture) {
            return None;
        }
        let reach = self.ground.reach(self.pose);
        let (to, _) = reach.chains.iter().flatten().find(|(p, _)| stands(*p))?;
        Some((Plan::to(self.ground, self.pose, *to, Aim::Shift)?, Course::default()))
    }

    /// Of all courses of the fewest strides that end in a place worth going to, the one that ends in
    /// the best.
    fn best_course(&self) -> Option<Course> {
        let field = self.field();
        let mut seen = BTreeSet::from([self.pose.state]);
        let mut places = vec![Place { at: self.pose, turns: 0, by: None }];
        let mut front = 0..1;
        for _ in 0..self.setup.params.look_ahead {
            for i in front.clone().take(MOST_LOOKS) {
                self.strides(i, &mut places, &mut seen);
            }
            front = front.end..places.len();
            // Of equal ones the first is kept, which is the one with the nearest postures.
            let best = front
                .clone()
                .map(|i| {
                    let place = &places[i];
                    (field.score(place.at.state, place.turns, self.home(place.at).is_some()), i)
                })
                .rev()
                .max_by_key(|(score, _)| *score)
                .filter(|(score, _)| *score > WORTH);
            if let Some((_, mut at)) = best {
                let mut strides = Vec::new();
                while let Some((before, posture)) = places[at].by {
                    strides.push(posture);
                    at = before;
                }
                strides.reverse();
                return Some(Course { strides, last: None });
            }
        }
        None
    }

    fn field(&self) -> Field<'_> {
        let motions = &self.setup.motions;
        // Where another one stands already, there is nothing to get.
        let seeds = self.open_seeds().map(|(_, seed)| seed.foot).filter(|f| !self.feet.contains(f));
        let mut field = Field::of_seeds(motions, self.pose.state, seeds);
        let own = middle(motions, self.pose);
        for of in self.neighbours {
            field.add_push(self.setup.params.repulsion, own, *of);
        }
        field
    }

    /// Adds every state not seen before that a stride leads to.
    fn strides(&self, from: usize, places: &mut Vec<Place>, seen: &mut BTreeSet<GridState>) {
        let Place { at, turns, .. } = places[from];
        for landed in &self.ground.reach(at).landings {
            if let Some(to) = self.ground.landed(at, landed.posture)
                && seen.insert(to.state)
            {
                let turns = turns.saturating_add(landed.turns);
                places.push(Place { at: to, turns, by: Some((from, landed.posture)) });
            }
        }
    }
}

/// A place that has been looked at.
#[derive(Clone, Copy)]
struct Place {
    at: Pose,
    turns: u8,
    by: Option<(usize, u16)>,
}

/// So many places are left for the next depth, at most.
const MOST_LOOKS: usize = 150;

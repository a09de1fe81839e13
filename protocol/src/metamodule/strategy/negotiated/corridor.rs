//! The cells of ways: of those to keep out of, and of the own one.

use super::scene::Scene;
use crate::defects::Sabotage;
use crate::lattice::Cell;
use crate::metamodule::message::{LEGS, Leg, Rank, Way};
use crate::metamodule::motions::Sweep;
use crate::metamodule::plan::{Aim, Plan};
use crate::metamodule::planning::paths::Course;
use crate::metamodule::pose::Pose;

/// The ways to keep out of: the cells and the rank of each.
pub(super) struct Corridor(Vec<(Vec<Cell>, Rank)>);

impl Corridor {
    fn crossed<'a>(&'a self, body: &'a [Cell; 4]) -> impl Iterator<Item = Rank> + 'a {
        let crosses = |cells: &[Cell]| body.iter().any(|c| cells.contains(c));
        self.0.iter().filter(move |(cells, _)| crosses(cells)).map(|(_, rank)| *rank)
    }
    /// The rank of the most important way that a body is in.
    pub fn most_important(&self, body: &[Cell; 4]) -> Option<Rank> {
        self.crossed(body).min()
    }
    /// Whether a body is out of all of them.
    pub fn is_clear_of(&self, body: &[Cell; 4]) -> bool {
        self.crossed(body).next().is_none()
    }
}

impl Scene<'_> {
    /// The ways of others that are more important than a rank.
    fn ways_above(&self, rank: Rank) -> impl Iterator<Item = &Way> {
        let me = self.v.own.id;
        let makes_way = !self.v.has(Sabotage::StandInTheWay);
        let ways = self.free.iter().filter_map(|o| Some((o.id, o.way.as_ref()?)));
        ways.filter(move |(id, w)| makes_way && (w.rank, *id) < (rank, me)).map(|(_, way)| way)
    }

    /// The ways that a metamodule of this rank keeps out of.
    pub fn corridor(&self, rank: Rank) -> Corridor {
        let ways = self.ways_above(rank);
        Corridor(ways.map(|w| (self.cells_of(w.from, w.legs()), w.rank)).collect())
    }

    /// Only the cells in which their legs end.
    pub fn ends_of_ways(&self, rank: Rank) -> Vec<Cell> {
        let unswept = |leg: &Leg| Leg { sweep: Sweep::default(), ..*leg };
        let ends = |w: &Way| self.cells_of(w.from, &w.legs().iter().map(unswept).collect::<Vec<Leg>>());
        self.ways_above(rank).flat_map(ends).collect()
    }

    /// All cells of a way.
    pub fn cells_of(&self, from: Pose, legs: &[Leg]) -> Vec<Cell> {
        let motions = self.v.motions();
        let (mut at, mut cells) = (from, Vec::new());
        for leg in legs {
            cells.extend(motions.swept(at.state, leg.sweep));
            let ends = Pose { posture: leg.posture, ..at };
            cells.extend(motions.cells(ends));
            match motions.turned_around(ends) {
                Some(to) => at = to,
                None => break,
            }
        }
        cells
    }

    /// The first legs of a course of this metamodule, around others where that is possible without another
    /// course.
    pub fn legs(&self, course: &Course) -> Vec<Leg> {
        let (fixed, taken) = (self.v.ground(&self.fixed), self.v.ground(&self.taken));
        let (mut at, mut legs) = (self.v.own.pose, Vec::new());
        for posture in course.strides.iter().copied().chain(course.last).take(LEGS) {
            let Some(straight) = Plan::to(&fixed, at, posture, Aim::Land) else { break };
            let is_free = straight.sweep.0 & taken.taken_at(at) == 0;
            let around = || Plan::to(&taken, at, posture, Aim::Land);
            let plan = if is_free { straight } else { around().unwrap_or(straight) };
            legs.push(Leg { posture, sweep: plan.sweep });
            match fixed.landed(at, posture) {
                Some(to) => at = to,
                None => break,
            }
        }
        legs
    }
}

//! The cells of paths: of those of others, to keep out of, and of this metamodule's own.

use super::scene::{ROOM, Scene};
use crate::metamodule::message::{LEGS, Path, Rank, Segment};
use crate::metamodule::motions::Sweep;
use crate::metamodule::plan::{Aim, Plan};
use crate::metamodule::planning::paths::Route;
use crate::metamodule::pose::Pose;
use metamorph_core::defects::Defect;
use metamorph_core::lattice::Cell;

/// The paths to keep out of, each as its cells and its rank.
pub(super) struct Corridor(Vec<(Vec<Cell>, Rank)>);

impl Corridor {
    fn crossed<'a>(&'a self, body: &'a [Cell; 4]) -> impl Iterator<Item = Rank> + 'a {
        let crosses = |cells: &[Cell]| body.iter().any(|c| cells.contains(c));
        self.0.iter().filter(move |(cells, _)| crosses(cells)).map(|(_, rank)| *rank)
    }
    /// Returns the rank of the most important path that has a cell of a body in it.
    pub fn most_important(&self, body: &[Cell; 4]) -> Option<Rank> {
        self.crossed(body).min()
    }
    /// Returns true if a body has no cell in any of the paths.
    pub fn is_clear_of(&self, body: &[Cell; 4]) -> bool {
        self.crossed(body).next().is_none()
    }
}

impl Scene<'_> {
    /// The ways of others that are more important than a rank.
    fn ways_above(&self, rank: Rank) -> impl Iterator<Item = &Path> {
        let me = self.v.own.id;
        let makes_way = !self.v.has(Defect::StandInTheWay);
        let paths = self.free.iter().filter_map(|o| Some((o.id, o.path.as_ref()?)));
        paths.filter(move |(id, w)| makes_way && (w.rank, *id) < (rank, me)).map(|(_, path)| path)
    }

    /// The ways that a metamodule of this rank keeps out of.
    pub fn corridor(&self, rank: Rank) -> Corridor {
        let paths = self.ways_above(rank);
        Corridor(paths.map(|w| (self.cells_of(w.from, w.segments()), w.rank)).collect())
    }

    /// Returns the cells that bodies fill at the ends of the segments of the paths above a rank.
    pub fn ends_of_ways(&self, rank: Rank) -> Vec<Cell> {
        let unswept = |segment: &Segment| Segment { sweep: Sweep::default(), ..*segment };
        let ends =
            |w: &Path| self.cells_of(w.from, &w.segments().iter().map(unswept).collect::<Vec<Segment>>());
        self.ways_above(rank).flat_map(ends).collect()
    }

    /// All cells of a way.
    pub fn cells_of(&self, from: Pose, segments: &[Segment]) -> Vec<Cell> {
        let motions = self.v.motions();
        let (mut at, mut cells) = (from, Vec::with_capacity(segments.len() * ROOM));
        for segment in segments {
            cells.extend(motions.swept(at.state, segment.sweep));
            let ends = Pose { posture: segment.posture, ..at };
            cells.extend(motions.cells(ends));
            match motions.turned_around(ends) {
                Some(to) => at = to,
                None => break,
            }
        }
        cells
    }

    /// Returns the first segments of a route of this metamodule. Each leads around other bodies where that is possible
    /// with the same landing posture.
    pub fn segments(&self, route: &Route) -> Vec<Segment> {
        let (fixed, taken) = (self.v.ground(&self.fixed), self.v.ground(&self.taken));
        let (mut at, mut segments) = (self.v.own.pose, Vec::new());
        for posture in route.steps.iter().copied().chain(route.last).take(LEGS) {
            let Some(straight) = Plan::to(&fixed, at, posture, Aim::Land) else { break };
            let is_free = straight.sweep.0 & taken.taken_at(at) == 0;
            let around = || Plan::to(&taken, at, posture, Aim::Land);
            let plan = if is_free { straight } else { around().unwrap_or(straight) };
            segments.push(Segment { posture, sweep: plan.sweep });
            match fixed.landed(at, posture) {
                Some(to) => at = to,
                None => break,
            }
        }
        segments
    }
}

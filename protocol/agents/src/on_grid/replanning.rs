//! Replanning on a floor whose obstacles come and go: the exact space as a graph for D* Lite.

use super::{GridAction, OnGrid, Standing};
use metamorph_planning::plan::Cost;
use metamorph_planning::plan::incremental::{DStarLite, Graph, Length};
use metamorph_roombots::grid::GridState;

/// Length of a landing. A turn has length 1, so that of the paths with the fewest landings the one with the fewest
/// turns is taken.
const LANDING: Length = 1 << 32;
/// Number of postures of a single module.
const POSTURES: u32 = 36;
/// An upper bound of the distance along an axis, in cells, from the foot to a landing or a cell that a turn sweeps.
const REACH: i16 = 3;

/// The standings of a module on a floor, numbered.
#[derive(Clone, Debug)]
struct GridGraph(OnGrid);

impl GridGraph {
    fn node(&self, at: Standing) -> u32 {
        let (width, _) = self.0.ground.size();
        let place = (i32::from(at.foot.y) * i32::from(width) + i32::from(at.foot.x)) as u32;
        (place * 4 + u32::from(at.foot.class)) * POSTURES + u32::from(at.posture)
    }
    fn standing(&self, node: u32) -> Standing {
        let width = self.0.ground.size().0.unsigned_abs();
        let (posture, foot) = ((node % POSTURES) as u8, node / POSTURES);
        let place = foot / 4;
        let (x, y) = ((place % u32::from(width)) as i16, (place / u32::from(width)) as i16);
        Standing { foot: GridState::new(x, y, (foot % 4) as u8), posture }
    }
    /// Returns the nodes with the foot on a connector of the floor that is at most `by` away from (`x`, `y`) on each
    /// axis.
    fn nodes(&self, [x, y]: [i16; 2], by: i16) -> Vec<u32> {
        let places = (y - by..=y + by).flat_map(|row| (x - by..=x + by).map(move |column| (column, row)));
        let on_floor = places.filter(|p| self.0.ground.has(p.0, p.1));
        let feet = on_floor.flat_map(|(x, y)| (0..4).map(move |class| GridState::new(x, y, class)));
        feet.flat_map(|foot| (0..POSTURES as u8).map(move |posture| self.node(Standing { foot, posture })))
            .collect()
    }
}

impl Graph for GridGraph {
    fn size(&self) -> usize {
        let (width, height) = self.0.ground.size();
        width as usize * height as usize * 4 * POSTURES as usize
    }
    fn neighbours(&self, node: u32, visit: &mut impl FnMut(u32, Length)) {
        let at = self.standing(node);
        // Nothing stands on an obstacle, so that a landing can be undone.
        if !self.0.ground.is_free(at.foot.x, at.foot.y) {
            return;
        }
        for action in OnGrid::all() {
            if let Some(to) = self.0.after(at, action) {
                visit(self.node(to), if action == GridAction::Land { LANDING } else { 1 });
            }
        }
    }
    fn lower(&self, from: u32, to: u32) -> Length {
        let (from, to) = (self.standing(from).foot, self.standing(to).foot);
        LANDING * u64::from(from.x.abs_diff(to.x) + from.y.abs_diff(to.y))
    }
}

/// A walk that is replanned when the floor changes.
#[derive(Clone, Debug)]
pub struct Replanner(DStarLite<GridGraph>);

impl Replanner {
    /// Plans a walk from `start`.
    pub fn new(space: OnGrid, start: Standing) -> Replanner {
        let goal = space.goal;
        let graph = GridGraph(space);
        let (start, goals) = (graph.node(start), graph.nodes([goal.0, goal.1], 0));
        Replanner(DStarLite::new(graph, start, goals))
    }
    /// Returns the space as it is now.
    pub fn space(&self) -> &OnGrid {
        &self.0.graph().0
    }
    /// Puts a column on a connector, or removes it if `blocked` is false.
    pub fn set(&mut self, x: i16, y: i16, blocked: bool) {
        let touched = self.0.graph().nodes([x, y], REACH);
        self.0.edit(|graph| graph.0.ground.set(x, y, blocked), touched);
    }
    /// Moves the start of the walk to where the module is now.
    pub fn move_to(&mut self, at: Standing) {
        let node = self.0.graph().node(at);
        self.0.move_to(node);
    }
    /// Returns the fewest landings to the goal, `None` if it cannot be reached.
    pub fn landings(&mut self) -> Option<Cost> {
        self.0.distance().map(|length| (length / LANDING) as Cost)
    }
    /// Returns the standings on the way to the goal.
    pub fn path(&mut self) -> Option<Vec<Standing>> {
        let path = self.0.path()?;
        Some(path.into_iter().map(|node| self.0.graph().standing(node)).collect())
    }
    /// Returns the number of standings expanded.
    pub fn expanded(&self) -> u64 {
        self.0.expanded()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::on_grid::tests::fewest;
    use crate::on_grid::{ActionTable, GridGround, Span};
    use metamorph_core::rng::Rng;
    use std::rc::Rc;

    /// After every edit and every step of the walk, the distance is that of a whole search, and the path is a path.
    #[test]
    fn a_repaired_path_is_as_short_as_a_new_one() {
        let actions = Rc::new(ActionTable::new());
        let (mut blocked, mut walked) = (0, 0);
        for seed in 0..12 {
            let mut rng = Rng::named(seed, "edits", 0);
            let span = [Span::Feet, Span::Core, Span::Strict][seed as usize % 3];
            let space =
                OnGrid { ground: GridGround::open(8, 7, 3), span, goal: (6, 5), actions: actions.clone() };
            let mut at = Standing::upright(1, 1, 0);
            let mut walk = Replanner::new(space, at);
            for edit in 0..40 {
                let (x, y) = (rng.below(8) as i16, rng.below(7) as i16);
                if (x, y) != (at.foot.x, at.foot.y) {
                    let was = walk.space().ground.is_blocked(x, y);
                    walk.set(x, y, !was);
                }
                let (repaired, anew) = (walk.landings(), fewest(walk.space(), at));
                assert_eq!(repaired, anew, "seed {seed}, edit {edit}");
                blocked += u32::from(anew.is_none());
                let Some(path) = walk.path() else { continue };
                let land = |pair: &[Standing]| {
                    let action = OnGrid::all().find(|a| walk.space().after(pair[0], *a) == Some(pair[1]));
                    u32::from(action.expect("an action leads there") == GridAction::Land)
                };
                assert_eq!(
                    path.windows(2).map(land).sum::<u32>(),
                    anew.unwrap_or(0),
                    "seed {seed}, edit {edit}"
                );
                // Some steps on, unless it is there.
                if edit % 4 == 3 && path.len() > 4 {
                    at = path[3];
                    walk.move_to(at);
                    walked += 1;
                }
            }
        }
        assert!(blocked > 10 && walked > 10, "{blocked} impossible, {walked} steps");
    }

    /// The reach that edits are spread to covers everything that a step examines.
    #[test]
    fn nothing_is_out_of_reach_of_an_edit() {
        let table = ActionTable::new();
        let swept =
            table.turns.iter().flatten().flatten().flatten().flat_map(|t| t.core.iter().chain(&t.graze));
        let landed = table.landings.iter().flatten();
        let far = swept.map(|c| c[0].abs().max(c[1].abs())).chain(landed.map(|l| l.x.abs().max(l.y.abs())));
        assert!(far.max().is_some_and(|far| far <= REACH));
    }
}

//! On-grid locomotion: one module that walks over a floor of connectors between obstacles (thesis chapter 6).
//!
//! [`OnGrid`] is the exact space: its states are the connector and class of the attached end, and the posture. A
//! step of a joint costs 0 and is tested against the obstacles; a landing (an atomic motor primitive, table 6.1)
//! costs 1. So a plan has the fewest primitives, and if there is no plan the search proves that. [`two_layer`] is
//! the published planner.

pub mod replanning;
pub mod reward_map;
pub mod two_layer;

use metamorph_planning::plan::{Cost, Space};
use metamorph_roombots::Kind;
use metamorph_roombots::grid::{GridState, landing};
use metamorph_roombots::lattice_pose::LatticeRotation;
use metamorph_roombots::posture::{Posture, values};
use metamorph_roombots::sweep::{FloorContact, Sweeper};
use std::rc::Rc;

/// Which cells around a step of a joint must be free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Span {
    /// None: only the connectors of the feet.
    Feet,
    /// Cells entered deeper than 11 mm.
    Core,
    /// Cells entered deeper than 2.2 mm.
    Strict,
}

/// A floor of connectors with columns on some of them. A body may hang over the rim, a foot may not.
#[derive(Clone, Debug)]
pub struct GridGround {
    width: i16,
    height: i16,
    blocked: Vec<bool>,
    /// Height of the columns in cells.
    column: i16,
}

impl GridGround {
    /// Creates a floor without obstacles, of at most 255 by 255 connectors.
    pub fn open(width: u8, height: u8, column: i16) -> GridGround {
        let blocked = vec![false; usize::from(width) * usize::from(height)];
        GridGround { width: width.into(), height: height.into(), blocked, column }
    }
    /// Returns true if the floor has this connector.
    pub fn has(&self, x: i16, y: i16) -> bool {
        (0..self.width).contains(&x) && (0..self.height).contains(&y)
    }
    fn index(&self, x: i16, y: i16) -> usize {
        (y * self.width + x) as usize
    }
    /// Returns true if a column stands here.
    pub fn is_blocked(&self, x: i16, y: i16) -> bool {
        self.has(x, y) && self.blocked[self.index(x, y)]
    }
    /// Returns true if a foot can attach here.
    pub fn is_free(&self, x: i16, y: i16) -> bool {
        self.has(x, y) && !self.blocked[self.index(x, y)]
    }
    /// Puts a column on a connector, or removes it if `blocked` is false. Does nothing outside of the floor.
    pub fn set(&mut self, x: i16, y: i16, blocked: bool) {
        if self.has(x, y) {
            let i = self.index(x, y);
            self.blocked[i] = blocked;
        }
    }
    /// Puts columns on a rectangle of connectors whose corner with the smallest coordinates is (`x`, `y`).
    pub fn block(&mut self, x: i16, y: i16, width: i16, height: i16) {
        for column in x..x + width {
            for row in y..y + height {
                self.set(column, row, true);
            }
        }
    }
    /// Returns the width and height in connectors.
    pub fn size(&self) -> (i16, i16) {
        (self.width, self.height)
    }
}

/// A module on the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Standing {
    /// The attached end.
    pub foot: GridState,
    /// The number of the posture, seen from the attached end.
    pub posture: u8,
}

impl Standing {
    /// Returns an upright module.
    pub fn upright(x: i16, y: i16, class: u8) -> Standing {
        Standing { foot: GridState::new(x, y, class), posture: 0 }
    }
}

/// An action of a module on the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GridAction {
    /// A joint, counted from 0, turns by one step; true for the positive direction.
    Turn(u8, bool),
    /// The free end attaches, the other one detaches.
    Land,
}

/// A step of a joint: the posture afterwards, and the swept cells by depth, in the foot frame of class 0.
#[derive(Clone, Debug)]
struct Turned {
    to: u8,
    core: Vec<[i16; 3]>,
    graze: Vec<[i16; 3]>,
}

/// The steps and landings of a single module.
#[derive(Debug)]
pub struct ActionTable {
    /// By posture, joint and direction; `None` if the floor is in the way.
    turns: Vec<[[Option<Turned>; 2]; 3]>,
    /// The landing of each posture.
    landings: Vec<Option<GridState>>,
}

impl ActionTable {
    /// Computes them from the exact bodies.
    pub fn new() -> ActionTable {
        let mut sweeper = Sweeper::new();
        let mut turned = |from: Posture, joint: usize, to: Posture| {
            let sweep = sweeper.step(from, joint);
            let cells = |list: &[metamorph_core::lattice::Cell]| list.iter().map(|c| (*c).into()).collect();
            (sweep.floor == FloorContact::Free).then(|| Turned {
                to: to.code() as u8,
                core: cells(&sweep.core),
                graze: cells(&sweep.graze),
            })
        };
        let turns = Posture::all(Kind::Single).map(|p| {
            [0, 1, 2].map(|joint| {
                // The reverse of a step sweeps the same.
                let before = (1..values(joint)).fold(p, |q, _| q.turned(joint));
                [turned(before, joint, before), turned(p, joint, p.turned(joint))]
            })
        });
        let turns = turns.collect();
        ActionTable { turns, landings: Posture::all(Kind::Single).map(landing).collect() }
    }
}

impl Default for ActionTable {
    fn default() -> ActionTable {
        ActionTable::new()
    }
}

/// The space of walks over a floor to a connector, which may be reached in any class.
#[derive(Clone, Debug)]
pub struct OnGrid {
    /// The floor.
    pub ground: GridGround,
    /// Which cells must be free.
    pub span: Span,
    /// The connector to be reached.
    pub goal: (i16, i16),
    /// The steps and landings.
    pub actions: Rc<ActionTable>,
}

impl OnGrid {
    /// Returns where a module stands after an action, `None` if it is not possible.
    pub fn after(&self, at: Standing, action: GridAction) -> Option<Standing> {
        match action {
            GridAction::Turn(joint, positive) => {
                let turns = &self.actions.turns[usize::from(at.posture)];
                let turned = turns[usize::from(joint)][usize::from(positive)].as_ref()?;
                let graze = if self.span == Span::Strict { &turned.graze[..] } else { &[] };
                let core = if self.span == Span::Feet { &[][..] } else { &turned.core };
                let free = core.iter().chain(graze).all(|c| !self.hits(at.foot, *c));
                free.then_some(Standing { posture: turned.to, ..at })
            }
            GridAction::Land => {
                let foot = at.foot.then(self.actions.landings[usize::from(at.posture)]?);
                let posture = Posture::from_code(Kind::Single, at.posture.into()).reversed();
                let free = self.ground.is_free(foot.x, foot.y);
                free.then_some(Standing { foot, posture: posture.code() as u8 })
            }
        }
    }
    fn hits(&self, foot: GridState, [x, y, z]: [i16; 3]) -> bool {
        let [dx, dy, _] = LatticeRotation::QUARTER.power(foot.class).apply([x, y, 0]);
        z < self.ground.column && self.ground.is_blocked(foot.x + dx, foot.y + dy)
    }
    /// Iterates over all actions.
    pub fn all() -> impl Iterator<Item = GridAction> {
        let turns = (0..3).flat_map(|joint| [false, true].map(|positive| GridAction::Turn(joint, positive)));
        turns.chain([GridAction::Land])
    }
}

impl Space for OnGrid {
    type State = Standing;
    type Action = GridAction;
    fn key_width(&self) -> usize {
        4
    }
    fn key(&self, at: &Standing, key: &mut [u8]) {
        key.copy_from_slice(&[at.foot.x as u8, at.foot.y as u8, at.foot.class, at.posture]);
    }
    fn state(&self, key: &[u8]) -> Standing {
        Standing { foot: GridState::new(key[0].into(), key[1].into(), key[2]), posture: key[3] }
    }
    fn expand(&self, at: &Standing, visit: &mut impl FnMut(GridAction, Cost, &Standing)) {
        for action in OnGrid::all() {
            if let Some(to) = self.after(*at, action) {
                visit(action, Cost::from(action == GridAction::Land), &to);
            }
        }
    }
    fn lower(&self, at: &Standing) -> Option<Cost> {
        // A landing is one connector further.
        let (x, y) = self.goal;
        Some(Cost::from(x.abs_diff(at.foot.x) + y.abs_diff(at.foot.y)))
    }
    fn is_goal(&self, at: &Standing) -> bool {
        (at.foot.x, at.foot.y) == self.goal
    }
}

#[cfg(test)]
mod tests {
    use super::two_layer::{Walk, walk};
    use super::*;
    use metamorph_core::rng::Rng;
    use metamorph_planning::plan::search::{Method, Search};
    use metamorph_planning::plan::{Limits, Outcome, Step};
    use std::collections::{BTreeSet, VecDeque};

    const LIMITS: Limits = Limits { memory: 64 << 20, work: u64::MAX };

    pub(super) fn fewest(space: &OnGrid, from: Standing) -> Option<Cost> {
        let mut search = Search::new(space.clone(), &from, LIMITS, Method::astar());
        match search.advance(u64::MAX) {
            Step::Done(Outcome::Solved { path, .. }) => Some(path.cost),
            Step::Done(Outcome::Impossible { .. }) => None,
            other => panic!("{other:?}"),
        }
    }

    /// Searches breadth-first by landings, without keys, bounds or tables of the core.
    fn brute_force(space: &OnGrid, from: Standing) -> Option<Cost> {
        let mut seen = BTreeSet::from([from]);
        let mut open = VecDeque::from([(from, 0)]);
        while let Some((at, cost)) = open.pop_front() {
            if space.is_goal(&at) {
                return Some(cost);
            }
            // Everything that turns reach, then the landings from there.
            let mut all = vec![at];
            let mut turned = BTreeSet::from([at]);
            while let Some(at) = all.pop() {
                for action in OnGrid::all() {
                    let Some(to) = space.after(at, action) else { continue };
                    if action == GridAction::Land {
                        if seen.insert(to) {
                            open.push_back((to, cost + 1));
                        }
                    } else if turned.insert(to) {
                        all.push(to);
                    }
                }
            }
        }
        None
    }

    /// The numbers of primitives of table 6.1, for all 24 connectors within two cells.
    #[test]
    fn an_open_floor_takes_the_known_numbers_of_primitives() {
        let actions = Rc::new(ActionTable::new());
        for span in [Span::Feet, Span::Core, Span::Strict] {
            let mut counts = [0; 8];
            for goal in (0..25).map(|i| (8 + i % 5, 8 + i / 5)).filter(|g| *g != (10, 10)) {
                let ground = GridGround::open(20, 20, 3);
                let space = OnGrid { ground, span, goal, actions: actions.clone() };
                counts[fewest(&space, Standing::upright(10, 10, 0)).unwrap() as usize] += 1;
            }
            assert_eq!(counts[1..7], [2, 3, 6, 8, 4, 1], "{span:?}");
        }
    }

    /// Random floors: the exact search is right, and the published planner never claims more.
    #[test]
    fn exact_search_agrees_with_brute_force_and_bounds_the_published_planner() {
        let actions = Rc::new(ActionTable::new());
        let (mut impossible, mut failed) = (0, 0);
        for seed in 0..1_000 {
            let mut rng = Rng::named(seed, "floor", 0);
            let mut draw = |n: u64| rng.below(n) as i16;
            let mut ground = GridGround::open(7, 6, 3);
            for _ in 0..draw(4) {
                let (x, y, width, height) = (draw(7), draw(6), 1 + draw(3), 1 + draw(3));
                ground.block(x, y, width, height);
            }
            let (from, goal) = ((draw(7), draw(6)), (draw(7), draw(6)));
            let span = [Span::Feet, Span::Core, Span::Strict][seed as usize % 3];
            let class = draw(4) as u8;
            if !ground.is_free(from.0, from.1) || !ground.is_free(goal.0, goal.1) {
                continue;
            }
            let space = OnGrid { ground, span, goal, actions: actions.clone() };
            let from = Standing::upright(from.0, from.1, class);
            let exact = fewest(&space, from);
            assert_eq!(exact, brute_force(&space, from), "seed {seed}");
            impossible += u32::from(exact.is_none());
            match walk(&space, from) {
                Walk::Reached { primitives, .. } => {
                    assert!(exact.is_some_and(|e| e <= primitives), "seed {seed}: {exact:?}");
                }
                Walk::Lost => failed += u32::from(exact.is_some()),
            }
        }
        assert!(impossible > 10 && failed > 0, "{impossible} impossible, {failed} missed");
    }
}

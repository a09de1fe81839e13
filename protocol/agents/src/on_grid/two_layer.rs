//! The published planner (thesis 6.2): a path over free connectors, and for each of its steps a fixed composed primitive.
//!
//! Assumed here where the thesis is silent: the path is a shortest one, with eight neighbours for each connector. The
//! primitive of a direction has the fewest atomic ones on an open floor; among these the first in the order of
//! actions is taken. Its spanning area is that of [`Span`]. If a step is not possible, the other neighbours are tried
//! clockwise. A connector is visited once, which makes the search finite; if no neighbour is left the module steps
//! back.

use super::{GridAction, GridGround, OnGrid, Span, Standing};
use metamorph_planning::plan::search::{Method, Search};
use metamorph_planning::plan::{Cost, Limits, Outcome, Space, Step, actions};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The eight neighbours, clockwise.
const AROUND: [(i16, i16); 8] = [(0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1)];
/// Side of the open floor on which primitives are composed, in connectors.
const OPEN_WIDTH: u8 = 15;

/// The end of a walk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walk {
    /// The goal was reached.
    Reached {
        /// The number of atomic primitives, including those of steps back.
        primitives: Cost,
        /// Steps back.
        back: u32,
    },
    /// The goal was not reached: no neighbour was left to try.
    Lost,
}

/// Composed primitives by posture and direction in the foot frame.
#[derive(Debug, Default)]
struct Composed(BTreeMap<(u8, i16, i16), Vec<GridAction>>);

impl Composed {
    /// Returns the actions that lead to the neighbour at (`dx`, `dy`) in the foot frame; none if it is not reachable.
    fn to(&mut self, space: &OnGrid, posture: u8, dx: i16, dy: i16) -> &[GridAction] {
        self.0.entry((posture, dx, dy)).or_insert_with(|| {
            let middle = i16::from(OPEN_WIDTH) / 2;
            let open = OnGrid {
                ground: GridGround::open(OPEN_WIDTH, OPEN_WIDTH, 0),
                span: Span::Feet,
                goal: (middle + dx, middle + dy),
                actions: space.actions.clone(),
            };
            let start = Standing { posture, ..Standing::upright(middle, middle, 0) };
            let limits = Limits { memory: Limits::LEAST_MEMORY, work: u64::MAX };
            let mut search = Search::new(open, &start, limits, Method::astar());
            match search.advance(u64::MAX) {
                Step::Done(Outcome::Solved { path, .. }) => {
                    actions(search.space(), &start, &path.keys).unwrap_or_default()
                }
                _ => Vec::new(),
            }
        })
    }
}

/// Walks to the goal of a space.
pub fn walk(space: &OnGrid, from: Standing) -> Walk {
    let far = distances(&space.ground, space.goal);
    let mut composed = Composed::default();
    let mut visited = BTreeSet::from([(from.foot.x, from.foot.y)]);
    // Where it stood, and the primitives of the way there.
    let mut path = vec![(from, 0)];
    let (mut primitives, mut back) = (0, 0);
    while let Some((at, cost)) = path.last().copied() {
        if space.is_goal(&at) {
            return Walk::Reached { primitives, back };
        }
        let Some((to, more)) = next(space, &far, &mut composed, &mut visited, at) else {
            path.pop();
            if !path.is_empty() {
                // The way back is the same one in reverse.
                primitives += cost;
                back += 1;
            }
            continue;
        };
        primitives += more;
        path.push((to, more));
    }
    Walk::Lost
}

/// Takes the first neighbour that can be reached, the one on a shortest path first.
fn next(
    space: &OnGrid,
    far: &BTreeMap<(i16, i16), u32>,
    composed: &mut Composed,
    visited: &mut BTreeSet<(i16, i16)>,
    at: Standing,
) -> Option<(Standing, Cost)> {
    let cell = |(dx, dy): (i16, i16)| (at.foot.x + dx, at.foot.y + dy);
    let distance = |i: &usize| far.get(&cell(AROUND[*i])).copied().unwrap_or(u32::MAX);
    let wanted = (0..8).min_by_key(|i| (distance(i), *i))?;
    for i in 0..8 {
        let direction = AROUND[(wanted + i) % 8];
        let to = cell(direction);
        if !space.ground.is_free(to.0, to.1) || visited.contains(&to) {
            continue;
        }
        // In the foot frame: turned back by the class.
        let (dx, dy) = (0..at.foot.class).fold(direction, |(x, y), _| (y, -x));
        let actions = composed.to(space, at.posture, dx, dy);
        let end = actions.iter().try_fold((at, 0), |(at, cost), action| {
            Some((space.after(at, *action)?, cost + Cost::from(*action == GridAction::Land)))
        });
        if let Some((end, cost)) = end.filter(|(end, _)| (end.foot.x, end.foot.y) == to) {
            visited.insert(to);
            return Some((end, cost));
        }
    }
    None
}

/// Returns the number of steps to the goal from every free connector that is connected with it, diagonal steps
/// included.
fn distances(ground: &GridGround, goal: (i16, i16)) -> BTreeMap<(i16, i16), u32> {
    let mut far = BTreeMap::from([(goal, 0)]);
    let mut open = VecDeque::from([(goal, 0)]);
    while let Some(((x, y), n)) = open.pop_front() {
        for (dx, dy) in AROUND {
            let to = (x + dx, y + dy);
            if ground.is_free(to.0, to.1) && !far.contains_key(&to) {
                far.insert(to, n + 1);
                open.push_back((to, n + 1));
            }
        }
    }
    far
}

/// Returns true if steps over free connectors, diagonal ones included, lead from a connector to the goal.
pub fn joined(ground: &GridGround, from: (i16, i16), goal: (i16, i16)) -> bool {
    distances(ground, goal).contains_key(&from)
}

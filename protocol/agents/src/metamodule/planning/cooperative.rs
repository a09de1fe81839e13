//! Cooperative search: finds moves of several bodies, one after the other, after which one of them fills one
//! more open seed while everything built stays; or proves that there are none.
//!
//! The state space of all bodies is too large to enumerate (`state_space`), so simpler problems come first.
//! In most standstills some bodies are *held*: they are confined even if all others were gone, alone or
//! together with one or two that are confined too. The cells that a held body never leaves count as taken in
//! every search. A body that fills a seed could also do so if all bodies that are not held were gone; if none
//! can, there is no plan. Conversely, most plans move one or two bodies while all others stay where they are.
//! If the exact searches end undecided, a random walk may still find a plan (`random_walk_search`).
//!
//! Not here: what each agent knows, and the messages that carry a plan out.

use crate::metamodule::blueprint::{Seed, SeedSet, Task};
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::planning::random_walk::random_walk_search;
use crate::metamodule::planning::state_space::{StateSpace, StopAt};
use crate::metamodule::pose::Pose;
use crate::metamodule::setup::Setup;
use metamorph_core::lattice::Cell;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A standstill: the poses of all bodies and the goal.
#[derive(Clone, Debug)]
pub struct Standstill {
    /// The parameters, the floor, the goals and the motion database.
    pub setup: Arc<Setup>,
    /// The goal to be built.
    pub task: Task,
    /// The seeds of it that are filled.
    pub filled: SeedSet,
    /// The poses of the bodies that are alive, can move, and are not part of the structure.
    pub free: Vec<Pose>,
    /// The cells of everything that stays.
    pub fixed: Vec<Cell>,
}

impl Standstill {
    /// Returns the fixed cells, and those of all free bodies but these.
    pub fn taken_around(&self, bodies: &[usize]) -> Vec<Cell> {
        let others = self.free.iter().enumerate().filter(|(i, _)| !bodies.contains(i));
        let others = others.flat_map(|(_, pose)| self.setup.motions.cells(*pose));
        self.fixed.iter().copied().chain(others).collect()
    }

    /// Returns the standstill after `path`: the body of the last move has filled a seed and stays there.
    /// `None` if `path` does not fit this standstill or fills no open seed.
    pub fn after(&self, path: &[Move]) -> Option<Standstill> {
        let (setup, mut next) = (&self.setup, self.clone());
        let ground = Ground { motions: &setup.motions, floor: setup.floor, taken: &[] };
        for step in path {
            let to = match step.lands {
                true => ground.landed(step.from, step.posture)?,
                false => Pose { posture: step.posture, ..step.from },
            };
            *next.free.get_mut(step.body)? = to;
        }
        let last = path.last()?.body;
        let cells = setup.motions.cells(next.free[last]);
        let open = setup.goal(self.task).open(self.filled);
        let (seed, _) = setup.seeds(self.task).find(|(i, seed)| open.has(*i) && seed.cells() == cells)?;
        next.fill(last, seed);
        Some(next)
    }

    /// Moves a free body to the fixed cells: from now on it fills `seed`.
    pub fn fill(&mut self, body: usize, seed: u8) {
        self.free.remove(body);
        self.filled = self.filled.with(seed);
        self.fixed.extend(self.setup.seed(self.task, seed).iter().flat_map(|seed| seed.cells()));
    }
}

/// One move of a plan; all other bodies rest meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Move {
    /// Index of the body among the free ones.
    pub body: usize,
    /// The pose before the move.
    pub from: Pose,
    /// The posture after the turns.
    pub posture: u16,
    /// True if the free end then connects to the floor and the other end detaches.
    pub lands: bool,
}

/// The result of a search.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SearchResult {
    /// A plan.
    Path(Vec<Move>),
    /// There is no plan; holds the number of reachable states, all of them examined.
    NoWay(usize),
    /// The bound on the work was reached first.
    Undecided,
}

/// The largest numbers of states with which a single body, and a group of up to [`GROUP`] bodies, count as confined.
const HELD: [usize; 2] = [300, 4_000];
/// Largest number of bodies examined as a group that confines itself.
const GROUP: usize = 3;
/// Factor by which the work bound of the first pass over single bodies and pairs is smaller.
const FIRST_PASS_DIVISOR: usize = 20;
/// Factor of the work that all single bodies and pairs may take together.
const FEW: usize = 10;
/// Factor of the work that random walks may take.
const RANDOM_WALK_FACTOR: usize = 5;

/// The largest number of seeds of a goal of which all unfilled ones are shared out; of larger goals only the open ones are. Every
/// seed costs a search over the whole floor.
pub const SHARED_SEEDS_MAX: usize = 32;
/// The largest number of plans that are examined for whether they leave the rest of the goal possible.
const LOOKS: usize = 16;
/// Divisor of the work: the share that each look at the rest of the goal may take.
const LOOK_DIVISOR: usize = 20;

/// Default work bound: a number of placements examined, as [`search`] counts them. Agents and the judge use the same,
/// so both find the same plans.
pub const WORK: usize = 2_000_000;

/// Searches for a plan, or for a proof that there is none, from the simplest problem to the complete one. Each
/// search may take about `work`, all those for single bodies and pairs together ten times `work`, and the random
/// walks at the end five times `work`. One unit of work is one placement of the moving body examined, which takes
/// less than a microsecond.
pub fn search(standstill: &Standstill, work: usize) -> SearchResult {
    search_for(standstill, work, &mut |_| true)
}

/// Searches like [`search`], for a plan after which the other seeds can be filled as well. If every plan that it finds closes the
/// way to another seed permanently, returns the first.
pub fn search_ahead(standstill: &Standstill, work: usize) -> SearchResult {
    let first = search(standstill, work);
    let SearchResult::Path(path) = &first else { return first };
    let mut looks = LOOKS;
    let ahead = work / LOOK_DIVISOR;
    if leaves_the_rest(standstill, path, ahead, &mut looks) {
        return first;
    }
    let accepts = &mut |path: &[Move]| looks > 0 && leaves_the_rest(standstill, path, ahead, &mut looks);
    match search_for(standstill, work, accepts) {
        better @ SearchResult::Path(_) => better,
        SearchResult::NoWay(_) | SearchResult::Undecided => first,
    }
}

fn leaves_the_rest(standstill: &Standstill, path: &[Move], work: usize, looks: &mut usize) -> bool {
    standstill.after(path).is_none_or(|rest| finishes(&rest, work, looks))
}

/// Returns true unless at most `looks` searches show that the open seeds cannot all be filled. What they leave undecided counts as
/// possible.
fn finishes(standstill: &Standstill, work: usize, looks: &mut usize) -> bool {
    if standstill.filled == standstill.setup.goal(standstill.task).all() {
        return true;
    }
    let left = standstill.setup.goal(standstill.task).all().without(standstill.filled);
    if !can_be_shared_out(&standstill.setup, (standstill.task, left), &standstill.free, &standstill.fixed) {
        return false;
    }
    let Some(left) = looks.checked_sub(1) else { return true };
    *looks = left;
    let mut is_refused = false;
    let found = search_for(standstill, work, &mut |path| {
        let leaves = leaves_the_rest(standstill, path, work, looks);
        is_refused |= !leaves;
        leaves
    });
    match found {
        SearchResult::Path(_) => true,
        SearchResult::NoWay(_) => false,
        // All plans that were found close the way to another seed.
        SearchResult::Undecided => !is_refused,
    }
}

/// Returns false if it is certain that these seeds cannot all be filled: even if no other free body was there, too few bodies come
/// to them around the cells that stay taken. Of more than [`SHARED_SEEDS_MAX`] seeds nothing is certain.
pub fn can_be_shared_out(
    setup: &Setup,
    (task, seeds): (Task, SeedSet),
    free: &[Pose],
    stays: &[Cell],
) -> bool {
    if seeds.len() > SHARED_SEEDS_MAX {
        return true;
    }
    let ground = Ground { motions: &setup.motions, floor: setup.floor, taken: stays };
    let comes = |seed: Seed| -> Vec<usize> {
        let distances = setup.motions.distances(setup.floor, seed, stays);
        let comes = |pose: Pose| {
            let stands = pose.foot() == seed.foot && ground.filling(pose, seed).is_some();
            stands || distances.steps(pose, ground.lands(pose)).is_some()
        };
        (0..free.len()).filter(|body| comes(free[*body])).collect()
    };
    let reached: Vec<Vec<usize>> = seeds.iter().filter_map(|s| setup.seed(task, s)).map(comes).collect();
    // For each body the seed that it has been given (augmenting paths).
    let mut given: Vec<Option<usize>> = vec![None; free.len()];
    (0..reached.len()).all(|seed| give(seed, &reached, &mut given, &mut BTreeSet::new()))
}

/// Gives a seed to a body that comes to it, and other seeds to other bodies if need be. Returns false if that is impossible.
fn give(
    seed: usize,
    reached: &[Vec<usize>],
    given: &mut [Option<usize>],
    seen: &mut BTreeSet<usize>,
) -> bool {
    reached[seed].iter().copied().any(|body| {
        let can = seen.insert(body) && given[body].is_none_or(|other| give(other, reached, given, seen));
        if can {
            given[body] = Some(seed);
        }
        can
    })
}

/// Searches for a plan that `accepts` takes.
fn search_for(
    standstill: &Standstill,
    work: usize,
    accepts: &mut dyn FnMut(&[Move]) -> bool,
) -> SearchResult {
    let held = Held::find(standstill, work);
    let all_indices = 0..standstill.free.len();
    let outside: Vec<usize> = all_indices.clone().filter(|i| !held.bodies.contains(i)).collect();
    if !held.fills {
        let starts: Vec<Vec<usize>> = outside.iter().map(|i| vec![*i]).collect();
        if let none @ SearchResult::NoWay(_) =
            held.state_space(standstill).search(&starts, StopAt::Everything, work, &mut |_| true)
        {
            return none;
        }
    }
    let movers: Vec<usize> = all_indices.filter(|i| !held.still.contains(i)).collect();
    let pairs = movers.iter().flat_map(|i| movers.iter().filter(move |j| *j > i).map(move |j| vec![*i, *j]));
    let mut groups: Vec<Vec<usize>> = movers.iter().map(|i| vec![*i]).chain(pairs).collect();
    // Most plans take little work to find.
    let mut left = work.saturating_mul(FEW);
    for most in [work / FIRST_PASS_DIVISOR, work] {
        let mut undecided = Vec::new();
        for group in groups {
            if left == 0 {
                undecided.push(group);
                continue;
            }
            let mut state_space = StateSpace::around_all_but(standstill, &group);
            match state_space.search(
                std::slice::from_ref(&group),
                StopAt::Everything,
                most.min(left),
                accepts,
            ) {
                SearchResult::NoWay(_) => {}
                SearchResult::Undecided => undecided.push(group),
                path @ SearchResult::Path(_) => return path,
            }
            left = left.saturating_sub(state_space.work);
        }
        groups = undecided;
    }
    let inside = || movers.iter().copied().filter(|i| held.bodies.contains(i));
    let mut starts: Vec<Vec<usize>> = outside.iter().map(|i| inside().chain([*i]).collect()).collect();
    // A single body outside is part of the start above; without it, the search would move through that body.
    if outside.len() != 1 {
        starts.push(inside().collect());
    }
    let mut state_space = StateSpace::around_all_but(standstill, &movers);
    // With more than one body outside, this only shows that there is no plan.
    let any = &mut |_: &[Move]| true;
    let accepted = if outside.len() <= 1 { &mut *accepts } else { any };
    match state_space.search(&starts, StopAt::Everything, work, accepted) {
        none @ SearchResult::NoWay(_) => return none,
        path @ SearchResult::Path(_) if outside.len() <= 1 => return path,
        _ => {}
    }
    for rests in [StopAt::Landings, StopAt::Everything] {
        match state_space.search(std::slice::from_ref(&movers), rests, work, accepts) {
            SearchResult::Undecided => {}
            decided => return decided,
        }
    }
    random_walk_search(standstill, &movers, work.saturating_mul(RANDOM_WALK_FACTOR))
        .filter(|path| accepts(path))
        .map_or(SearchResult::Undecided, SearchResult::Path)
}

/// Returns the sets of cells, each from the attached end on, in which a free body can come to rest while all
/// other bodies stay where they are; with `alone`, as if they were gone.
pub fn reach(standstill: &Standstill, body: usize, alone: bool) -> BTreeSet<[Cell; 4]> {
    let (poses, body) = match alone {
        true => (vec![standstill.free[body]], 0),
        false => (standstill.free.clone(), body),
    };
    let reachable = StateSpace::without_seeds(standstill, standstill.fixed.clone()).reachable(&poses, body);
    reachable.rests.iter().map(|rest| standstill.setup.motions.cells(reachable.pose(*rest))).collect()
}

/// The bodies that can never get away, alone or as a group, whatever the others do.
struct Held {
    bodies: BTreeSet<usize>,
    /// The held bodies that never leave any of their cells.
    still: BTreeSet<usize>,
    /// The fixed cells and those that held bodies never leave.
    stays: Vec<Cell>,
    /// True if a held body might fill a seed.
    fills: bool,
}

impl Held {
    fn find(standstill: &Standstill, work: usize) -> Held {
        let (bodies, still) = (BTreeSet::new(), BTreeSet::new());
        let mut held = Held { bodies, still, stays: standstill.fixed.clone(), fills: false };
        // A body is held only if it is confined while all others stay where they are.
        let is_shut_in =
            |i: &usize| StateSpace::around_all_but(standstill, &[*i]).explore(&[*i], HELD[0]).is_some();
        let shut_in: Vec<usize> = (0..standstill.free.len()).filter(is_shut_in).collect();
        let mut left = work;
        let mut groups: Vec<Vec<usize>> = shut_in.iter().map(|i| vec![*i]).collect();
        let mut at = 0;
        // Each new held body takes cells, which may confine others, so the search begins again.
        while let Some(group) = groups.get(at).cloned() {
            at += 1;
            if group.iter().any(|i| held.bodies.contains(i)) {
                continue;
            }
            let mut state_space = held.state_space(standstill);
            let found = state_space.explore(&group, HELD[usize::from(group.len() > 1)]);
            left = left.saturating_sub(state_space.work);
            if left == 0 {
                break;
            }
            if let Some((stays, fills)) = found {
                held.add(standstill, &group, &stays, fills);
                at = 0;
            } else if group.len() < GROUP {
                let more = shut_in.iter().filter(|i| group.iter().all(|j| j < *i));
                let larger = more.map(|i| group.iter().copied().chain([*i]).collect::<Vec<usize>>());
                let larger: Vec<Vec<usize>> = larger.filter(|group| !groups.contains(group)).collect();
                groups.extend(larger);
            }
        }
        held
    }

    fn add(&mut self, standstill: &Standstill, group: &[usize], stays: &BTreeSet<Cell>, fills: bool) {
        let mut cells = group.iter().flat_map(|i| standstill.setup.motions.cells(standstill.free[*i]));
        if !fills && cells.all(|c| stays.contains(&c)) {
            self.still.extend(group);
        }
        self.bodies.extend(group);
        self.stays.extend(stays);
        self.fills |= fills;
    }

    fn state_space<'a>(&self, standstill: &'a Standstill) -> StateSpace<'a> {
        StateSpace::new(standstill, self.stays.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::blueprint::Floor;
    use crate::metamodule::blueprint::Seed;
    use crate::metamodule::blueprint::{Blueprint, SeedOrder};
    use crate::metamodule::elements::Elements;
    use crate::metamodule::motions::Motions;
    use crate::metamodule::params::{Params, Strategy};
    use metamorph_core::lattice::Face;
    use metamorph_core::rng::Rng;
    use metamorph_core::time::Span;
    use metamorph_roombots::Kind;
    use metamorph_roombots::database::Database;
    use metamorph_roombots::grid::GridState;
    use metamorph_roombots::posture::Posture;

    fn setup(database: &Arc<Database>, side: i16, feet: &[(i16, i16)]) -> Arc<Setup> {
        let seed = |foot: &(i16, i16)| Seed { foot: *foot, directions: [Face::Up; 3] };
        let levels = [feet.iter().map(seed).collect()];
        Arc::new(Setup {
            params: Params::scaled(Strategy::Negotiated, Span::secs(1), Span::millis(10)),
            floor: Floor { min: (0, 0), max: (side - 1, side - 1) },
            goals: vec![Blueprint::new(&levels, SeedOrder::AtOnce).unwrap()],
            motions: Motions::new(Arc::clone(database), Kind::Srs).unwrap(),
            elements: Elements::NONE,
        })
    }

    fn upright(setup: &Setup, x: i16, y: i16) -> Pose {
        let posture = setup.motions.table().find(Posture::zero(Kind::Srs)).unwrap();
        Pose::standing(GridState::new(x, y, 0), posture)
    }

    fn standstill(setup: &Arc<Setup>, free: &[(i16, i16)], fixed: &[Cell]) -> Standstill {
        let free = free.iter().map(|(x, y)| upright(setup, *x, *y)).collect();
        let (task, filled) = (Task::default(), SeedSet::default());
        Standstill { setup: Arc::clone(setup), task, filled, free, fixed: fixed.to_vec() }
    }

    /// Checks the moves of a plan: no motion meets another body, and the last one fills a seed.
    fn go(standstill: &Standstill, moves: &[Move]) {
        let setup = &standstill.setup;
        let motions = &setup.motions;
        let mut poses = standstill.free.clone();
        for m in moves {
            let from = poses[m.body];
            assert_eq!((m.from.state, m.from.posture), (from.state, from.posture), "{moves:?}");
            let others = poses.iter().enumerate().filter(|(i, _)| *i != m.body);
            let others = others.flat_map(|(_, pose)| motions.cells(*pose));
            let taken: Vec<Cell> = standstill.fixed.iter().copied().chain(others).collect();
            let ground = Ground { motions, floor: setup.floor, taken: &taken };
            let path = motions.graph().path(from.posture, m.posture, ground.taken_at(from));
            assert!(path.is_some(), "{m:?} of {moves:?}");
            poses[m.body] = match m.lands {
                true => ground.landed(from, m.posture).unwrap(),
                false => Pose { posture: m.posture, ..from },
            };
        }
        let filled = motions.cells(poses[moves.last().unwrap().body]);
        assert!(setup.seeds(standstill.task).any(|(_, seed)| seed.cells() == filled), "{moves:?}");
    }

    #[test]
    fn finds_a_way_where_there_is_one() {
        let setup = setup(&Arc::new(Database::build()), 9, &[(4, 4)]);
        let from = upright(&setup, 4, 4);
        let stays = vec![Move { body: 0, from, posture: from.posture, lands: false }];
        assert_eq!(
            search(&standstill(&setup, &[(4, 4)], &[]), 100_000),
            SearchResult::Path(stays),
            "it stands there"
        );
        assert!(matches!(
            search(&standstill(&setup, &[(0, 0), (1, 1)], &[]), 100_000),
            SearchResult::Path(_)
        ));
        assert_eq!(search(&standstill(&setup, &[(0, 0), (1, 1)], &[]), 0), SearchResult::Undecided);
        let has_no_way = |standstill| matches!(search(&standstill, 100_000), SearchResult::NoWay(_));
        assert!(has_no_way(standstill(&setup, &[], &[])), "there is no free body");
        assert!(has_no_way(standstill(&setup, &[(0, 0)], &[Cell::new(4, 4, 2)])), "the seed is taken");
    }

    /// The staged search agrees with a search of the complete state space.
    #[test]
    fn says_only_what_is_so() {
        let (database, mut rng) = (Arc::new(Database::build()), Rng::named(1, "feasible", 0));
        let (mut counts, mut lucky) = ([0; 4], 0);
        for _ in 0..60 {
            let side = 2 + rng.below(3) as i16;
            let mut place = || (rng.below(side as u64) as i16, rng.below(side as u64) as i16);
            let (setup, mut free) = (setup(&database, side, &[place()]), Vec::<(i16, i16)>::new());
            for at in [place(), place(), place()] {
                if !free.contains(&at) {
                    free.push(at);
                }
            }
            let fixed = (0..5).map(|_| place()).filter(|p| !free.contains(p));
            let fixed: Vec<Cell> = fixed.map(|(x, y)| Cell::new(x, y, (x + 2 * y) % 4)).collect();
            let standstill = standstill(&setup, &free, &fixed);
            let all_indices: Vec<usize> = (0..free.len()).collect();
            let mut state_space = StateSpace::around_all_but(&standstill, &all_indices);
            let all = state_space.search(&[all_indices], StopAt::Everything, 200_000, &mut |_| true);
            let found = search(&standstill, 200_000);
            if let SearchResult::Path(moves) = &found {
                go(&standstill, moves);
            }
            let by_random_walk =
                random_walk_search(&standstill, &(0..free.len()).collect::<Vec<usize>>(), 20_000);
            if let Some(moves) = &by_random_walk {
                go(&standstill, moves);
                lucky += 1;
            }
            let is_so = match &all {
                SearchResult::Path(_) => matches!(found, SearchResult::Path(_)),
                SearchResult::NoWay(_) => matches!(found, SearchResult::NoWay(_)) && by_random_walk.is_none(),
                SearchResult::Undecided => true,
            };
            assert!(is_so, "{all:?}, {found:?}: {standstill:?}");
            counts[match (&all, &found) {
                (SearchResult::Path(_), _) => 0,
                (SearchResult::NoWay(_), _) => 1,
                (SearchResult::Undecided, SearchResult::NoWay(_)) => 2,
                _ => 3,
            }] += 1;
        }
        assert!(counts[..3].iter().all(|n| *n > 1), "{counts:?}");
        assert!(lucky > counts[0] / 2, "{lucky} by luck, {counts:?}");
    }
}

//! Ways for several at a time: what bodies that stand in each other's way can do together, one after the
//! other, so that one of them fills one more open seed, with what is built staying. Or the proof that they cannot.
//!
//! All bodies together have too many arrangements to look at them all (`state_space`), so what is simple is asked first.
//! Most standstills have somebody in them who is *held*: it could not get away even if all others were
//! gone, or all but one or two who could not either. The cells that it never leaves are taken for everybody
//! else, always; and whoever fills a seed could do it also if all others who are not held were gone. If
//! nobody can do that, there is no way. On the other hand, most ways take one or two who move while all
//! others stay where they are. Where nothing is decided in the end, luck may find a way (`random_walk_search`).
//!
//! Absent: what is known to whom, and who tells whom what to do.

use crate::lattice::Cell;
use crate::metamodule::blueprint::{SeedSet, Task};
use crate::metamodule::params::Setup;
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::planning::random_walk::random_walk_search;
use crate::metamodule::planning::state_space::{StateSpace, StopAt};
use crate::metamodule::pose::Pose;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A standstill: who stands where, and what is to be built.
#[derive(Clone, Debug)]
pub struct Standstill {
    /// What they are, and where.
    pub setup: Arc<Setup>,
    /// What is built.
    pub task: Task,
    /// What of it is.
    pub filled: SeedSet,
    /// Those who live, can move, and are no part of what is built.
    pub free: Vec<Pose>,
    /// The cells of everything that stays.
    pub fixed: Vec<Cell>,
}

impl Standstill {
    /// The same after the moves of a way: the body that makes the last one has filled a seed and stays. None if
    /// that is no way of this standstill.
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

    /// A free body is in a seed from now on, and stays there.
    pub fn fill(&mut self, body: usize, seed: u8) {
        self.free.remove(body);
        self.filled = self.filled.with(seed);
        self.fixed.extend(self.setup.seed(self.task, seed).iter().flat_map(|seed| seed.cells()));
    }
}

/// One move of a way: while it is made, all others stay where they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Move {
    /// Whose, by its place among the free.
    pub body: usize,
    /// Where it begins.
    pub from: Pose,
    /// The posture to turn to.
    pub posture: u16,
    /// Whether it lands then.
    pub lands: bool,
}

/// What a search came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SearchResult {
    /// A way.
    Path(Vec<Move>),
    /// There is none: all arrangements that can be reached were seen, so many.
    NoWay(usize),
    /// The bound was reached first.
    Undecided,
}

/// Whoever has more arrangements before it than this is not taken to be held: alone, and with one or two others
/// who could not get away alone.
const HELD: [usize; 2] = [300, 4_000];
/// So many together are looked at whether they hold each other.
const GROUP: usize = 3;
/// Each one or two who could move while all others stay are first looked at with so much less work.
const HASTE: usize = 20;
/// All of these together are looked at with so much more work than everybody at once.
const FEW: usize = 10;
/// Ways by luck are looked for with so much more.
const LUCK: usize = 5;

/// So much work is worth it to a swarm that stands still, and to whoever judges it: they see the same ways.
pub const WORK: usize = 2_000_000;

/// Looks for a proof that there is no way, and for a way. Each of the searches that this takes, from the
/// simplest to that over everything, does so much work at most, those for one or two who move ten times as much
/// together, and what is tried by luck in the end five times as much; a unit is one that moves looked at in one
/// place, less than a microsecond.
pub fn search(standstill: &Standstill, work: usize) -> SearchResult {
    let held = Held::find(standstill, work);
    let everybody = 0..standstill.free.len();
    let outside: Vec<usize> = everybody.clone().filter(|i| !held.bodies.contains(i)).collect();
    if !held.fills {
        let starts: Vec<Vec<usize>> = outside.iter().map(|i| vec![*i]).collect();
        if let none @ SearchResult::NoWay(_) =
            held.state_space(standstill).search(&starts, StopAt::Everything, work)
        {
            return none;
        }
    }
    let movers: Vec<usize> = everybody.filter(|i| !held.still.contains(i)).collect();
    let pairs = movers.iter().flat_map(|i| movers.iter().filter(move |j| *j > i).map(move |j| vec![*i, *j]));
    let mut groups: Vec<Vec<usize>> = movers.iter().map(|i| vec![*i]).chain(pairs).collect();
    // Most ways are found soon, if there is one.
    let mut left = work.saturating_mul(FEW);
    for most in [work / HASTE, work] {
        let mut undecided = Vec::new();
        for group in groups {
            if left == 0 {
                undecided.push(group);
                continue;
            }
            let mut state_space = StateSpace::around_all_but(standstill, &group);
            match state_space.search(std::slice::from_ref(&group), StopAt::Everything, most.min(left)) {
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
    // Whoever is alone outside is in the way of all others, and in the start before.
    if outside.len() != 1 {
        starts.push(inside().collect());
    }
    let mut state_space = StateSpace::around_all_but(standstill, &movers);
    match state_space.search(&starts, StopAt::Everything, work) {
        none @ SearchResult::NoWay(_) => return none,
        path @ SearchResult::Path(_) if outside.len() <= 1 => return path,
        _ => {}
    }
    for rests in [StopAt::Landings, StopAt::Everything] {
        match state_space.search(std::slice::from_ref(&movers), rests, work) {
            SearchResult::Undecided => {}
            decided => return decided,
        }
    }
    random_walk_search(standstill, &movers, work.saturating_mul(LUCK))
        .map_or(SearchResult::Undecided, SearchResult::Path)
}

/// The cells, from the attached end on, that a free body can come to rest in while all others stay where they
/// are; or, alone, if they were gone.
pub fn reach(standstill: &Standstill, body: usize, alone: bool) -> BTreeSet<[Cell; 4]> {
    let (poses, body) = match alone {
        true => (vec![standstill.free[body]], 0),
        false => (standstill.free.clone(), body),
    };
    let reachable = StateSpace::without_seeds(standstill, standstill.fixed.clone()).reachable(&poses, body);
    reachable.rests.iter().map(|rest| standstill.setup.motions.cells(reachable.pose(*rest))).collect()
}

/// Those who can never get away, alone or together, whatever all others do.
struct Held {
    bodies: BTreeSet<usize>,
    /// Those of them who never leave any of their cells.
    still: BTreeSet<usize>,
    /// The cells of what stays, and those that are never left.
    stays: Vec<Cell>,
    /// One of them might fill a seed.
    fills: bool,
}

impl Held {
    fn find(standstill: &Standstill, work: usize) -> Held {
        let (bodies, still) = (BTreeSet::new(), BTreeSet::new());
        let mut held = Held { bodies, still, stays: standstill.fixed.clone(), fills: false };
        // Only who cannot get away while all others stand still is held.
        let is_shut_in =
            |i: &usize| StateSpace::around_all_but(standstill, &[*i]).explore(&[*i], HELD[0]).is_some();
        let shut_in: Vec<usize> = (0..standstill.free.len()).filter(is_shut_in).collect();
        let mut left = work;
        let mut groups: Vec<Vec<usize>> = shut_in.iter().map(|i| vec![*i]).collect();
        let mut at = 0;
        // Once somebody new is held, it may be that others are too.
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
    use crate::lattice::Face;
    use crate::metamodule::blueprint::Seed;
    use crate::metamodule::blueprint::{Blueprint, SeedOrder};
    use crate::metamodule::motions::Motions;
    use crate::metamodule::params::{Floor, Params, Strategy};
    use crate::metamodule::pose::End;
    use crate::rng::Rng;
    use crate::roombots::Kind;
    use crate::roombots::database::Database;
    use crate::roombots::grid::GridState;
    use crate::roombots::posture::Posture;
    use crate::time::Span;

    fn setup(database: &Arc<Database>, side: i16, feet: &[(i16, i16)]) -> Arc<Setup> {
        let seed = |foot: &(i16, i16)| Seed { foot: *foot, directions: [Face::Up; 3] };
        let levels = [feet.iter().map(seed).collect()];
        Arc::new(Setup {
            params: Params::scaled(Strategy::Negotiated, Span::secs(1), Span::millis(10)),
            floor: Floor { min: (0, 0), max: (side - 1, side - 1) },
            goals: vec![Blueprint::new(&levels, SeedOrder::AtOnce).unwrap()],
            motions: Motions::new(Arc::clone(database), Kind::Srs).unwrap(),
        })
    }

    fn upright(setup: &Setup, x: i16, y: i16) -> Pose {
        let posture = setup.motions.table().find(Posture::zero(Kind::Srs)).unwrap();
        Pose { state: GridState::new(x, y, 0), end: End::Foot, both: false, posture }
    }

    fn standstill(setup: &Arc<Setup>, free: &[(i16, i16)], fixed: &[Cell]) -> Standstill {
        let free = free.iter().map(|(x, y)| upright(setup, *x, *y)).collect();
        let (task, filled) = (Task::default(), SeedSet::default());
        Standstill { setup: Arc::clone(setup), task, filled, free, fixed: fixed.to_vec() }
    }

    /// Makes the moves of a way. Whoever makes the last one fills a seed, and nobody has met anybody.
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
        assert!(has_no_way(standstill(&setup, &[], &[])), "nobody is free");
        assert!(has_no_way(standstill(&setup, &[(0, 0)], &[Cell::new(4, 4, 2)])), "the seed is taken");
    }

    /// What is seen without a search over everything is what such a search says.
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
            let everybody: Vec<usize> = (0..free.len()).collect();
            let mut state_space = StateSpace::around_all_but(&standstill, &everybody);
            let all = state_space.search(&[everybody], StopAt::Everything, 200_000);
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

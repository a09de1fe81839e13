//! Other places for a goal of metamodules: places that are clear of all immovable objects, what a search
//! shows of each, and which of them have been tried.
//!
//! Two questions are kept apart. [`clear_places`] examines cells only and is fast: it is used when an
//! immovable object appears in a seed. [`prospect`] searches for a plan to build the whole goal with the
//! bodies at their present places: it is used at a standstill, and to prove that the goal cannot be built.
//!
//! Not here: telling the swarm, which the director does.

use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{SeedSet, Task};
use metamorph_protocol::metamodule::params::{Floor, Setup};
use metamorph_protocol::metamodule::planning::cooperative::{SearchResult, Standstill, WORK, reach, search};
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

/// The free width around a goal that is moved, in cells, where the floor has room for it.
const ROOM: i16 = 3;
/// The budget of the search that proves that no seed of a place can be the first: a number of placements examined, as
/// [`search`] counts them.
const WORK_FOR_THE_FIRST: usize = WORK / 20;
/// The budget of the search for a plan for each of the other seeds, where several bodies have to move. A
/// search beyond it leaves the prospect of a place open.
const WORK_FOR_A_SEED: usize = WORK / 200;
/// The largest number of places with open prospects that one survey examines: each may use the whole budget
/// of its searches.
const MOST_OPEN: usize = 12;
/// The largest number of tries of a place at which a search builds the whole goal. The bodies are elsewhere
/// the second time.
const MOST_TRIES: u8 = 2;
/// The largest number of places with open prospects that are tried in a run.
const MOST_HOPES: u8 = 8;

/// A distance along x and y that a goal is moved by.
pub type Shift = (i16, i16);

/// The cells that a body can come to rest in, from the attached end on.
pub type Reach = BTreeSet<[Cell; 4]>;

/// The result of a search at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prospect {
    /// The whole goal can be built: every move is known.
    Whole,
    /// It is proved neither that the goal can be built nor that it cannot.
    Open,
    /// The goal cannot be built: even if each body moved alone, there would not be a separate body for each seed; or
    /// no seed can be filled first.
    Barred,
}

/// Returns the cells that each of the bodies could come to rest in if it were alone with the immovable
/// objects.
pub fn reaches(bodies: &Standstill) -> Vec<Rc<Reach>> {
    let mut all: Vec<Rc<Reach>> = Vec::new();
    for (i, pose) in bodies.free.iter().enumerate() {
        let cells = bodies.setup.motions.cells(*pose);
        // Motions can be undone, so bodies that reach each other's places reach the same places.
        let same = all.iter().find(|reach| reach.contains(&cells)).cloned();
        all.push(same.unwrap_or_else(|| Rc::new(reach(bodies, i, true))));
    }
    all
}

/// Returns what can be built at the place of a task by bodies that are all free, from their present places.
/// `reaches` are the places that each of them reaches alone.
pub fn prospect(bodies: &Standstill, reaches: &[Rc<Reach>]) -> Prospect {
    let (setup, task) = (&bodies.setup, bodies.task);
    let goal = setup.goal(task).all();
    let fills = |reach: &Rc<Reach>| {
        let seeds = setup.seeds(task).filter(|(_, seed)| reach.contains(&seed.cells()));
        seeds.fold(SeedSet::default(), |set, (i, _)| set.with(i))
    };
    let mut able: Vec<SeedSet> = reaches.iter().map(fills).collect();
    if !can_all_be_filled(goal, &able) {
        return Prospect::Barred;
    }
    let mut built = Standstill { filled: SeedSet::default(), ..bodies.clone() };
    // Every round fills one more seed.
    while !built.filled.holds(goal) {
        if let Some((body, seed)) = fill_alone(&built, &able) {
            built.fill(body, seed);
            able.remove(body);
            continue;
        }
        let work = if built.filled.is_empty() { WORK_FOR_THE_FIRST } else { WORK_FOR_A_SEED };
        let next = match search(&built, work) {
            SearchResult::Path(way) => way.last().and_then(|last| Some((last.body, built.after(&way)?))),
            SearchResult::NoWay(_) if built.filled.is_empty() => return Prospect::Barred,
            SearchResult::NoWay(_) | SearchResult::Undecided => None,
        };
        let Some((body, next)) = next else { return Prospect::Open };
        built = next;
        able.remove(body);
    }
    Prospect::Whole
}

/// Returns a body that fills an open seed while all others stay, and the seed; of several, the one that could
/// fill the fewest others.
fn fill_alone(bodies: &Standstill, able: &[SeedSet]) -> Option<(usize, u8)> {
    let open = bodies.setup.goal(bodies.task).open(bodies.filled);
    let mut order: Vec<usize> = (0..bodies.free.len()).collect();
    order.sort_by_key(|body| able[*body].without(bodies.filled).len());
    order.into_iter().find_map(|body| {
        let places = reach(bodies, body, false);
        let seeds = open.iter().filter_map(|i| Some((i, bodies.setup.seed(bodies.task, i)?)));
        seeds.filter(|(_, seed)| places.contains(&seed.cells())).map(|(i, _)| (body, i)).next()
    })
}

/// Returns true if there is a separate body for each seed of a goal, where each body can fill only some.
/// Every body of a plan that fills a seed could also do so alone, so if there is none, no order of filling
/// helps.
fn can_all_be_filled(goal: SeedSet, able: &[SeedSet]) -> bool {
    fn give(seed: u8, able: &[SeedSet], given: &mut [Option<u8>], asked: &mut [bool]) -> bool {
        for body in (0..able.len()).filter(|body| able[*body].has(seed)) {
            if std::mem::replace(&mut asked[body], true) {
                continue;
            }
            if given[body].is_none_or(|other| give(other, able, given, asked)) {
                given[body] = Some(seed);
                return true;
            }
        }
        false
    }
    let mut given = vec![None; able.len()];
    goal.iter().all(|seed| give(seed, able, &mut given, &mut vec![false; able.len()]))
}

/// Returns the places of a goal at which no seed contains a cell of `stays`, the immovable objects. Those with the
/// most free width around them, up to the edge of the floor, come first, and among these the nearest to the present
/// place of the goal. The present place is included if it is clear.
pub fn clear_places(setup: &Setup, task: Task, stays: &BTreeSet<Cell>) -> Vec<Shift> {
    let floor = setup.floor;
    let rim = |shift: &Shift| {
        let edges = |(x, y): (i16, i16)| [x - floor.min.0, floor.max.0 - x, y - floor.min.1, floor.max.1 - y];
        setup.seeds(Task { shift: *shift, ..task }).flat_map(|(_, s)| edges(s.foot)).min().unwrap_or(0)
    };
    let is_clear = |shift: &Shift, margin: i16| {
        setup.seeds(Task { shift: *shift, ..task }).flat_map(|(_, seed)| seed.cells()).all(|cell| {
            stays
                .range(Cell::new(cell.x - margin, i16::MIN, i16::MIN)..)
                .take_while(|f| f.x <= cell.x + margin)
                .all(|f| f.y.abs_diff(cell.y) > margin as u16 || (margin == 0 && f.z != cell.z))
        })
    };
    let mut left = shifts(setup, task, floor);
    let now_at = task.shift;
    left.sort_by_key(|(x, y)| (x.abs_diff(now_at.0) + y.abs_diff(now_at.1), *x, *y));
    let mut places = Vec::new();
    for room in (0..=ROOM).rev() {
        let has_room = |shift: &Shift| is_clear(shift, room.min(2)) && rim(shift) >= room;
        let (found, others) = left.into_iter().partition::<Vec<Shift>, _>(has_room);
        places.extend(found);
        left = others;
    }
    places
}

/// Returns all shifts that keep the feet of a goal on the floor.
fn shifts(setup: &Setup, task: Task, floor: Floor) -> Vec<Shift> {
    let feet = || setup.seeds(Task { shift: (0, 0), ..task }).map(|(_, seed)| seed.foot);
    let along = |least: Option<i16>, most: Option<i16>, min: i16, max: i16| {
        min - least.unwrap_or(min)..=max - most.unwrap_or(max)
    };
    let xs = along(feet().map(|f| f.0).min(), feet().map(|f| f.0).max(), floor.min.0, floor.max.0);
    let ys = along(feet().map(|f| f.1).min(), feet().map(|f| f.1).max(), floor.min.1, floor.max.1);
    xs.flat_map(|x| ys.clone().map(move |y| (x, y))).collect()
}

/// The result of a survey of all places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elsewhere {
    /// The goal can be built here, or may be.
    Place(Shift),
    /// It is proved that the goal can be built at none of the clear places, of which this is the number.
    Barred(usize),
    /// No place is left to try, but for some of them it is not proved that the goal cannot be built there.
    Unproved,
}

/// The places that a goal has been tried at since the immovable objects last changed.
#[derive(Clone, Debug, Default)]
pub struct Trials {
    tried: BTreeMap<Shift, u8>,
    hopes: u8,
}

impl Trials {
    /// Forgets all trials: the immovable objects or the goal have changed, so an unreachable place may be usable
    /// now.
    pub fn forget(&mut self) {
        self.tried.clear();
    }

    /// Returns the place to go to next. `bodies` are all free, and no seed of the goal is filled; the goal
    /// has come to a standstill at the place of its task.
    pub fn next(&mut self, bodies: &Standstill) -> Elsewhere {
        let tries = self.tried.entry(bodies.task.shift).or_default();
        *tries = (*tries + 1).min(MOST_TRIES);
        let stays: BTreeSet<Cell> = bodies.fixed.iter().copied().collect();
        let mut places = clear_places(&bodies.setup, bodies.task, &stays);
        let tries = |shift: &Shift| self.tried.get(shift).copied().unwrap_or(0);
        places.sort_by_key(tries);
        let reaches = reaches(bodies);
        let (mut unreachable, mut open) = (0, Vec::new());
        for shift in &places {
            let there = Standstill { task: Task { shift: *shift, ..bodies.task }, ..bodies.clone() };
            match prospect(&there, &reaches) {
                Prospect::Whole if tries(shift) < MOST_TRIES => return Elsewhere::Place(*shift),
                Prospect::Barred => unreachable += 1,
                Prospect::Whole | Prospect::Open => open.push(*shift),
            }
            if open.len() == MOST_OPEN {
                break;
            }
        }
        match open.into_iter().find(|shift| tries(shift) == 0) {
            Some(shift) if self.hopes < MOST_HOPES => {
                self.hopes += 1;
                Elsewhere::Place(shift)
            }
            _ if unreachable == places.len() => Elsewhere::Barred(unreachable),
            _ => Elsewhere::Unproved,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::lattice::Face;
    use metamorph_protocol::metamodule::blueprint::{Blueprint, Seed, SeedOrder};
    use metamorph_protocol::metamodule::elements::Elements;
    use metamorph_protocol::metamodule::motions::Motions;
    use metamorph_protocol::metamodule::params::{Params, Strategy};
    use metamorph_protocol::metamodule::pose::Pose;
    use metamorph_protocol::roombots::Kind;
    use metamorph_protocol::roombots::database::Database;
    use metamorph_protocol::roombots::grid::GridState;
    use metamorph_protocol::roombots::posture::Posture;
    use metamorph_protocol::time::Span;
    use std::sync::Arc;

    /// Returns upright seeds at these feet, and an upright body in a corner, on a floor of 9 × 9.
    fn bodies(feet: &[(i16, i16)], fixed: Vec<Cell>) -> Standstill {
        let level = feet.iter().map(|foot| Seed { foot: *foot, directions: [Face::Up; 3] }).collect();
        let setup = Setup {
            params: Params::scaled(Strategy::Negotiated, Span::secs(1), Span::millis(10)),
            floor: Floor { min: (0, 0), max: (8, 8) },
            goals: vec![Blueprint::new(&[level], SeedOrder::AtOnce).unwrap()],
            motions: Motions::new(Arc::new(Database::build()), Kind::Srs).unwrap(),
            elements: Elements::NONE,
        };
        let posture = setup.motions.table().find(Posture::zero(Kind::Srs)).unwrap();
        let free = vec![Pose::standing(GridState::new(0, 0, 0), posture)];
        let (task, filled) = (Task::default(), SeedSet::default());
        Standstill { setup: Arc::new(setup), task, filled, free, fixed }
    }

    /// Returns walls around the corner, higher than the length of a body.
    fn walls() -> Vec<Cell> {
        let columns = (0..3).flat_map(|x| (0..3).map(move |y| (x, y))).filter(|column| *column != (0, 0));
        columns.flat_map(|(x, y)| (0..6).map(move |z| Cell::new(x, y, z))).collect()
    }

    fn at(bodies: &Standstill, shift: Shift) -> Standstill {
        Standstill { task: Task { shift, ..bodies.task }, ..bodies.clone() }
    }

    fn seen(bodies: &Standstill) -> Prospect {
        prospect(bodies, &reaches(bodies))
    }

    #[test]
    fn each_seed_needs_a_body_of_its_own() {
        let able = |sets: &[u128]| sets.iter().map(|set| SeedSet(*set)).collect::<Vec<_>>();
        let all = |seeds, sets: &[u128]| can_all_be_filled(SeedSet(seeds), &able(sets));
        assert!(all(0b111, &[0b001, 0b011, 0b111]) && all(0b111, &[0b111, 0b011, 0b001]));
        assert!(!all(0b111, &[0b001, 0b001, 0b111]), "two bodies for one seed");
        assert!(!all(0b11, &[0b11]) && !all(0b1, &[]) && all(0, &[]));
    }

    #[test]
    fn a_prospect_is_what_can_be_built_at_the_place() {
        let free = bodies(&[(4, 4)], Vec::new());
        assert_eq!(seen(&free), Prospect::Whole);
        let shut_in = bodies(&[(4, 4)], walls());
        assert_eq!(seen(&shut_in), Prospect::Barred);
        assert_eq!(seen(&at(&shut_in, (-4, -4))), Prospect::Whole, "the body stands there");
        assert_eq!(seen(&bodies(&[(4, 4), (6, 4)], Vec::new())), Prospect::Barred, "one body for two seeds");
    }

    #[test]
    fn places_are_clear_of_obstacles_and_roomy_ones_come_first() {
        let shut_in = bodies(&[(4, 4)], walls());
        let stays: BTreeSet<Cell> = shut_in.fixed.iter().copied().collect();
        let places = clear_places(&shut_in.setup, shut_in.task, &stays);
        assert_eq!(places.len(), 81 - 8);
        assert_eq!(places[0], (0, 1), "three cells from the edge, two from the walls, and the nearest such");
    }

    /// The only place where the goal can be built is found and tried twice; after that no result is claimed.
    #[test]
    fn the_only_good_place_is_found() {
        let (shut_in, mut trials) = (bodies(&[(4, 4)], walls()), Trials::default());
        let good = (-4, -4);
        assert_eq!(trials.next(&shut_in), Elsewhere::Place(good));
        assert_eq!(trials.next(&at(&shut_in, good)), Elsewhere::Place(good));
        assert_eq!(trials.next(&at(&shut_in, good)), Elsewhere::Unproved);
        trials.forget();
        assert_eq!(trials.next(&shut_in), Elsewhere::Place(good));
    }

    #[test]
    fn an_impossible_goal_is_proved_for_every_place() {
        let too_few = bodies(&[(4, 4), (6, 4)], walls());
        let stays: BTreeSet<Cell> = too_few.fixed.iter().copied().collect();
        let places = clear_places(&too_few.setup, too_few.task, &stays).len();
        assert_eq!(Trials::default().next(&too_few), Elsewhere::Barred(places));
    }
}

//! Walks of a metamodule without an element: landings from foothold to foothold, among obstacles.

use super::scene::{Foothold, Scene, Sets};
use super::terrain::GridConnector;
use crate::lattice::Cell;
use crate::plan::search::{Method, Search};
use crate::plan::{Cost, Limits, Outcome, Space, Step};
use crate::roombots::posture::is_middle;
use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::rc::Rc;

/// A foothold and a set of empty postures there.
pub type Stand = (Foothold, u16);

/// Numbers of landings from a stand to all others that can be reached.
pub type Distances = Rc<HashMap<Stand, u16>>;

/// The connectors that exist, and the distances between stands without obstacles.
pub struct Ground<'a> {
    scene: &'a Scene,
    exists: Vec<bool>,
    distances: RefCell<HashMap<Stand, Distances>>,
}

impl<'a> Ground<'a> {
    /// Creates the ground of the connectors that `exists` accepts.
    pub fn new(scene: &'a Scene, exists: impl Fn(&GridConnector) -> bool) -> Ground<'a> {
        let exists = scene.terrain().connectors().iter().map(exists).collect();
        Ground { scene, exists, distances: RefCell::default() }
    }
    /// Returns the scene.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }
    /// Returns true if the connector of a foothold exists.
    pub fn exists(&self, foothold: Foothold) -> bool {
        self.exists[usize::from(foothold) / 4]
    }

    /// Returns the fewest landings between a stand and all others, without obstacles. A walk can be taken backwards.
    pub fn distances(&self, from: Stand) -> Distances {
        if let Some(known) = self.distances.borrow().get(&from) {
            return known.clone();
        }
        let mut found = HashMap::from([(from, 0)]);
        let mut open = VecDeque::from([from]);
        while let Some(at) = open.pop_front() {
            let next = found[&at] + 1;
            let sets = self.scene.empty(at.0);
            for landing in self.scene.landings(at.0) {
                if sets[usize::from(landing.posture)] != at.1 || !self.exists(landing.to) {
                    continue;
                }
                let to = (landing.to, self.scene.empty(landing.to)[usize::from(landing.reversed)]);
                found.entry(to).or_insert_with(|| {
                    open.push_back(to);
                    next
                });
            }
        }
        let found = Rc::new(found);
        self.distances.borrow_mut().insert(from, found.clone());
        found
    }
}

/// Returns true if a metamodule can walk from where it stands to a foothold that `is_out` accepts. It may not enter the
/// cells in `obstacles`.
pub fn leaves(
    ground: &Ground<'_>,
    obstacles: &BTreeSet<Cell>,
    from: Body,
    is_out: impl Fn(Foothold) -> bool,
) -> bool {
    let scene = ground.scene;
    let mut known: HashMap<Foothold, Sets> = HashMap::new();
    let mut sets = |foothold: Foothold| {
        let free = || scene.empty_among(&scene.blocked(foothold, |c| obstacles.contains(&c)));
        known.entry(foothold).or_insert_with(free).clone()
    };
    let first = (from.foothold, sets(from.foothold)[usize::from(from.posture)]);
    let mut seen = BTreeSet::from([first]);
    let mut open = VecDeque::from([first]);
    while let Some((foothold, set)) = open.pop_front() {
        if is_out(foothold) {
            return true;
        }
        let here = sets(foothold);
        for landing in scene.landings(foothold) {
            if here[usize::from(landing.posture)] == set && ground.exists(landing.to) {
                let to = (landing.to, sets(landing.to)[usize::from(landing.reversed)]);
                if seen.insert(to) {
                    open.push_back(to);
                }
            }
        }
    }
    false
}

/// A metamodule that stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Body {
    /// Where it stands.
    pub foothold: Foothold,
    /// Its posture.
    pub posture: u16,
}

/// One motion of one metamodule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// A joint turns by one step, 120° or 90°.
    Turn {
        /// The posture afterwards.
        to: u16,
        /// The angle in degrees.
        degrees: u16,
    },
    /// The head lands and becomes the foot.
    Land(Body),
}

/// The walks of a metamodule among obstacles.
pub struct Walk<'a> {
    ground: &'a Ground<'a>,
    obstacles: &'a BTreeSet<Cell>,
    goal: Stand,
    /// To the goal without obstacles.
    bound: Distances,
    sets: RefCell<HashMap<Foothold, Sets>>,
}

impl<'a> Walk<'a> {
    /// Creates the walks to a posture at a foothold. The obstacles are the cells of other bodies.
    pub fn new(ground: &'a Ground<'a>, obstacles: &'a BTreeSet<Cell>, to: Body) -> Walk<'a> {
        let bound = (to.foothold, ground.scene.empty(to.foothold)[usize::from(to.posture)]);
        let mut walk = Walk {
            ground,
            obstacles,
            goal: (to.foothold, 0),
            bound: ground.distances(bound),
            sets: RefCell::default(),
        };
        walk.goal.1 = walk.sets(to.foothold)[usize::from(to.posture)];
        walk
    }

    fn sets(&self, foothold: Foothold) -> Sets {
        if let Some(sets) = self.sets.borrow().get(&foothold) {
            return sets.clone();
        }
        let scene = self.ground.scene;
        let sets = scene.empty_among(&scene.blocked(foothold, |c| self.obstacles.contains(&c)));
        self.sets.borrow_mut().insert(foothold, sets.clone());
        sets
    }

    fn stand(&self, body: Body) -> Stand {
        (body.foothold, self.sets(body.foothold)[usize::from(body.posture)])
    }

    /// Finds a walk with the fewest landings from a body to the goal in `to`; `None` if there is none.
    pub fn find(self, from: Body, to: Body) -> Option<Vec<Motion>> {
        let start = self.stand(from);
        let limits = Limits { memory: 64 << 20, work: MAX_EXPANSIONS };
        let mut search = Search::new(self, &start, limits, Method::astar());
        let Step::Done(Outcome::Solved { path, .. }) = search.advance(u64::MAX) else { return None };
        let stands: Vec<Stand> = path.keys.iter().map(|key| search.space().state(key)).collect();
        search.space().replay(from, &stands, to)
    }

    /// Returns the motions along a path of stands.
    fn replay(&self, from: Body, stands: &[Stand], to: Body) -> Option<Vec<Motion>> {
        let (mut at, mut motions) = (from, Vec::new());
        for pair in stands.windows(2) {
            let sets = self.sets(at.foothold);
            let landing = self.ground.scene.landings(at.foothold).iter().find(|landing| {
                sets[usize::from(landing.posture)] == pair[0].1
                    && landing.to == pair[1].0
                    && self.sets(landing.to)[usize::from(landing.reversed)] == pair[1].1
            })?;
            motions.extend(self.turns(at, landing.posture)?);
            at = Body { foothold: landing.to, posture: landing.reversed };
            motions.push(Motion::Land(at));
        }
        motions.extend(self.turns(at, to.posture)?);
        Some(motions)
    }

    fn turns(&self, at: Body, to: u16) -> Option<Vec<Motion>> {
        let (scene, table) = (self.ground.scene, self.ground.scene.table());
        let blocked = scene.blocked(at.foothold, |c| self.obstacles.contains(&c));
        let way = table.way_within(&table.reach(at.posture, &blocked), at.posture, to)?;
        let turn = |(posture, (step, _)): (&u16, &(u16, _))| {
            let joint = usize::from(table.steps()[usize::from(*step)].joint);
            Motion::Turn { to: *posture, degrees: degrees_of(joint) }
        };
        Some(way.postures[1..].iter().zip(&way.steps).map(turn).collect())
    }
}

/// Expansions of a walk at most: several times the number of footholds of a large terrain.
const MAX_EXPANSIONS: u64 = 100_000;

/// Returns the angle of a step of a joint.
pub fn degrees_of(joint: usize) -> u16 {
    if is_middle(joint) { 90 } else { 120 }
}

impl Space for Walk<'_> {
    type State = Stand;
    type Action = ();

    fn key_width(&self) -> usize {
        4
    }
    fn key(&self, (foothold, set): &Stand, key: &mut [u8]) {
        key[..2].copy_from_slice(&foothold.to_be_bytes());
        key[2..].copy_from_slice(&set.to_be_bytes());
    }
    fn state(&self, key: &[u8]) -> Stand {
        (u16::from_be_bytes([key[0], key[1]]), u16::from_be_bytes([key[2], key[3]]))
    }
    fn expand(&self, (foothold, set): &Stand, visit: &mut impl FnMut((), Cost, &Stand)) {
        let sets = self.sets(*foothold);
        for landing in self.ground.scene.landings(*foothold) {
            if sets[usize::from(landing.posture)] == *set && self.ground.exists(landing.to) {
                let to = Body { foothold: landing.to, posture: landing.reversed };
                visit((), 1, &self.stand(to));
            }
        }
    }
    fn lower(&self, (foothold, set): &Stand) -> Option<Cost> {
        let without = self.ground.scene.empty(*foothold)[usize::from(*set)];
        self.bound.get(&(*foothold, without)).map(|d| Cost::from(*d))
    }
    fn is_goal(&self, state: &Stand) -> bool {
        *state == self.goal
    }
}

//! Walks of a metamodule without an element: landings from foothold to foothold, among obstacles.

use super::scene::{Foothold, Hold, Scene, Sets, Transfer};
use super::terrain::GridConnector;
use crate::plan::search::{Method, Search};
use crate::plan::{Cost, Limits, Outcome, Space, Step};
use metamorph_core::lattice::Cell;
use metamorph_roombots::posture::is_middle;
use std::cell::{OnceCell, RefCell};
use std::collections::{BTreeSet, HashMap, HashSet, VecDeque};
use std::rc::Rc;

/// A foothold and a set of empty postures there.
pub type Stand = (Foothold, u16);

/// Numbers of landings from a stand to all others that can be reached.
pub type Distances = Rc<HashMap<Stand, u16>>;

/// The connectors that exist, and the distances between stands without obstacles.
pub struct WalkingGround<'a> {
    scene: &'a Scene,
    exists: Vec<bool>,
    distances: RefCell<HashMap<Stand, Distances>>,
}

impl<'a> WalkingGround<'a> {
    /// Creates the ground of the connectors that `exists` accepts.
    pub fn new(scene: &'a Scene, exists: impl Fn(&GridConnector) -> bool) -> WalkingGround<'a> {
        let exists = scene.terrain().connectors().iter().map(exists).collect();
        WalkingGround { scene, exists, distances: RefCell::default() }
    }
    /// Returns the scene.
    pub fn scene(&self) -> &'a Scene {
        self.scene
    }
    /// Returns true if the connector of a foothold exists.
    pub fn exists(&self, foothold: Foothold) -> bool {
        self.exists[usize::from(foothold) / 4]
    }

    /// Iterates over the ways to hand the element over from a hold, each with the hold of the receiver.
    pub fn ways_from(&self, hold: &Hold) -> impl Iterator<Item = (Hold, &'a Transfer)> {
        let ways = self.scene.ways_from(hold).filter(|(to, _)| self.exists(*to));
        ways.map(|(foothold, way)| {
            let (grip, set) = way.receiver;
            (Hold { foothold, grip, set }, way)
        })
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
    ground: &WalkingGround<'_>,
    obstacles: &BTreeSet<Cell>,
    from: Body,
    is_out: impl Fn(Foothold) -> bool,
) -> bool {
    Walks::new(ground, obstacles.clone(), from).reach(is_out).1
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

/// The walks of a metamodule from where it stands, among obstacles. What is found out for one walk is kept for the next.
pub struct Walks<'a> {
    ground: &'a WalkingGround<'a>,
    from: Body,
    /// The cells of other bodies.
    obstacles: BTreeSet<Cell>,
    sets: RefCell<HashMap<Foothold, Sets>>,
    /// The stands that can be reached; known once there was no walk to one.
    reached: OnceCell<HashSet<Stand>>,
}

impl<'a> Walks<'a> {
    /// Creates the walks from a posture at a foothold. The obstacles are the cells of other bodies.
    pub fn new(ground: &'a WalkingGround<'a>, obstacles: BTreeSet<Cell>, from: Body) -> Walks<'a> {
        Walks { ground, from, obstacles, sets: RefCell::default(), reached: OnceCell::new() }
    }

    /// Returns true if a metamodule in this posture is in none of the cells of other bodies.
    pub fn fits(&self, at: Body) -> bool {
        let cells = self.ground.scene.body(at.foothold, at.posture);
        !cells.iter().any(|c| self.obstacles.contains(c))
    }

    /// Finds a walk with the fewest landings to a posture at a foothold; `None` if there is none.
    pub fn find(&self, to: Body) -> Option<Vec<Motion>> {
        let (start, goal) = (self.stand(self.from), self.stand(to));
        if self.reached.get().is_some_and(|reached| !reached.contains(&goal)) {
            return None;
        }
        let end = (to.foothold, self.ground.scene.empty(to.foothold)[usize::from(to.posture)]);
        let walk = Walk { walks: self, goal, bound: self.ground.distances(end) };
        let limits = Limits { memory: 64 << 20, work: MAX_EXPANSIONS };
        let mut search = Search::new(walk, &start, limits, Method::astar());
        let Step::Done(Outcome::Solved { path, .. }) = search.advance(u64::MAX) else {
            self.reached.get_or_init(|| self.reach(|_| false).0);
            return None;
        };
        let stands: Vec<Stand> = path.keys.iter().map(|key| search.space().state(key)).collect();
        self.replay(&stands, to)
    }

    fn sets(&self, foothold: Foothold) -> Sets {
        if let Some(sets) = self.sets.borrow().get(&foothold) {
            return sets.clone();
        }
        let scene = self.ground.scene;
        let sets = scene.empty_among(&scene.blocked(foothold, &self.obstacles));
        self.sets.borrow_mut().insert(foothold, sets.clone());
        sets
    }

    fn stand(&self, body: Body) -> Stand {
        (body.foothold, self.sets(body.foothold)[usize::from(body.posture)])
    }

    /// Returns the stands one landing away.
    fn next(&self, (foothold, set): Stand) -> impl Iterator<Item = Stand> {
        let sets = self.sets(foothold);
        let landings = self.ground.scene.landings(foothold).iter();
        let landings = landings.filter(move |landing| sets[usize::from(landing.posture)] == set);
        let landings = landings.filter(|landing| self.ground.exists(landing.to));
        landings.map(|landing| self.stand(Body { foothold: landing.to, posture: landing.reversed }))
    }

    /// Returns the stands that can be reached, up to the first at a foothold that `is_end` accepts, and whether there is one.
    fn reach(&self, is_end: impl Fn(Foothold) -> bool) -> (HashSet<Stand>, bool) {
        let start = self.stand(self.from);
        let (mut reached, mut open) = (HashSet::from([start]), VecDeque::from([start]));
        while let Some(at) = open.pop_front() {
            if is_end(at.0) {
                return (reached, true);
            }
            open.extend(self.next(at).filter(|to| reached.insert(*to)));
        }
        (reached, false)
    }

    /// Returns the motions along a path of stands.
    fn replay(&self, stands: &[Stand], to: Body) -> Option<Vec<Motion>> {
        let (mut at, mut motions) = (self.from, Vec::new());
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
        let blocked = scene.blocked(at.foothold, &self.obstacles);
        let way = table.path_within(&table.reach(at.posture, &blocked), at.posture, to)?;
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

/// The search for a walk to one stand.
struct Walk<'a> {
    walks: &'a Walks<'a>,
    goal: Stand,
    /// To the goal without obstacles.
    bound: Distances,
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
    fn expand(&self, stand: &Stand, visit: &mut impl FnMut((), Cost, &Stand)) {
        self.walks.next(*stand).for_each(|to| visit((), 1, &to));
    }
    fn lower(&self, (foothold, set): &Stand) -> Option<Cost> {
        let without = self.walks.ground.scene.empty(*foothold)[usize::from(*set)];
        self.bound.get(&(*foothold, without)).map(|d| Cost::from(*d))
    }
    fn is_goal(&self, state: &Stand) -> bool {
        *state == self.goal
    }
}

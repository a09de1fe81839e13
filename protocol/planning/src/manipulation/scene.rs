//! A terrain with everything that metamodules of one kind can do on it with one element: the graphs of the planner.
//!
//! The *footholds* are the poses of a foot on all connectors. At a foothold, postures that steps connect are one set,
//! named by its first posture: sets of empty metamodules, and sets of metamodules that hold the element within
//! the limits of torque. Landings connect footholds, and *links* are the hand-overs between them. Which connectors
//! exist is a matter of the task; a scene is made once for all of them.

use super::carry::{CarryTable, Cells};
use super::element::Element;
use super::handover::{HandoverTable, PosturePair};
use super::load::{LoadLimits, LoadTable};
use super::terrain::{Terrain, gravity, world_cell};
use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::Kind;
use metamorph_roombots::database::{CellSet, Database, Table};
use metamorph_roombots::lattice_pose::LatticePose;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, PoisonError};

/// The number of a foothold.
pub type Foothold = u16;

/// The first posture of the set that each posture belongs to; [`NO_SET`] where the posture collides.
pub type Sets = Arc<[u16]>;

/// The most surroundings whose sets of empty postures are kept. Each takes two bytes a posture; scenes outlive runs.
const MAX_KNOWN: usize = 4_096;

/// The number of the set of a posture that collides.
pub const NO_SET: u16 = u16::MAX;

/// A posture whose head plate is on a connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Landing {
    /// The posture before.
    pub posture: u16,
    /// The foothold of the head.
    pub to: Foothold,
    /// The same posture seen from the head.
    pub reversed: u16,
}

/// A set of postures that hold the element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Hold {
    /// Where the holder stands.
    pub foothold: Foothold,
    /// The grip.
    pub grip: u8,
    /// The set.
    pub set: u16,
}

/// A way to hand the element over between two footholds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Transfer {
    /// The grip and the set of the holder.
    pub holder: (u8, u16),
    /// The set of empty postures that the holder is in afterwards.
    pub left: u16,
    /// The grip and the set of the receiver.
    pub receiver: (u8, u16),
    /// The set of empty postures from which the receiver takes the element.
    pub came: u16,
}

/// The ways to hand the element over to a foothold from one grip to another.
#[derive(Clone, Debug)]
struct Link {
    /// The foothold of the receiver.
    to: Foothold,
    /// The ways, ascending.
    ways: Arc<[Transfer]>,
}

impl Link {
    /// Returns the ways from a set of postures of the holder.
    fn ways_from(&self, set: u16) -> &[Transfer] {
        let first = self.ways.partition_point(|w| w.holder.1 < set);
        let count = self.ways[first..].partition_point(|w| w.holder.1 == set);
        &self.ways[first..first + count]
    }
}

/// Footholds with the same relative pose, sets (by address) and grips have the same ways.
type SameWays = (LatticePose, [*const u16; 4], (u8, u8));

/// The graphs of a terrain.
pub struct Scene {
    database: Arc<Database>,
    kind: Kind,
    terrain: Terrain,
    footholds: Vec<LatticePose>,
    carry: Vec<CarryTable>,
    /// By grip and direction of gravity, the steps within the limits of torque.
    within: BTreeMap<(u8, Face), Vec<bool>>,
    handovers: BTreeMap<(u8, u8), HandoverTable>,
    landings: Vec<Vec<Landing>>,
    empty: Vec<Sets>,
    /// By foothold and grip.
    holding: Vec<Vec<Sets>>,
    /// By foothold and grip.
    links: Vec<Vec<Vec<Link>>>,
    /// By foothold, the cells of the motion database that the terrain blocks.
    blocked: Vec<CellSet>,
    /// Sets of empty postures by what is blocked.
    known: Mutex<HashMap<CellSet, Sets>>,
}

impl Scene {
    /// Makes the graphs for an element of this mass.
    pub fn new(
        database: Arc<Database>,
        kind: Kind,
        element: &Element,
        grams: u32,
        limits: LoadLimits,
        terrain: Terrain,
    ) -> Scene {
        let carry = CarryTable::all(&database, kind, element);
        let down: BTreeSet<Face> = terrain.footholds().into_iter().map(gravity).collect();
        let mut within = BTreeMap::new();
        for (grip, carry) in (0..).zip(&carry) {
            for down in &down {
                let loads = LoadTable::new(database.table(kind), carry, *down);
                let steps = 0..carry.steps().len();
                let steps = steps.map(|step| loads.peak(step, grams).within(limits)).collect();
                within.insert((grip, *down), steps);
            }
        }
        let handovers = hand_overs(database.table(kind), element, &carry);
        Scene::of_tables(database, carry, within, handovers, terrain)
    }

    /// Makes the graphs from tables of one kind: carry tables by grip, with the steps that are within the limits of torque by
    /// grip and direction of gravity, and the hand-overs between grips, of which those that are missing are not used.
    pub fn of_tables(
        database: Arc<Database>,
        carry: Vec<CarryTable>,
        within: BTreeMap<(u8, Face), Vec<bool>>,
        handovers: BTreeMap<(u8, u8), HandoverTable>,
        terrain: Terrain,
    ) -> Scene {
        let footholds = terrain.footholds();
        let kind = carry.first().map_or(Kind::Srs, CarryTable::kind);
        let mut scene = Scene {
            kind,
            terrain,
            carry,
            within,
            handovers,
            landings: Vec::new(),
            empty: Vec::new(),
            holding: Vec::new(),
            links: Vec::new(),
            blocked: Vec::new(),
            known: Mutex::default(),
            footholds,
            database,
        };
        scene.make_sets();
        let index: HashMap<LatticePose, Foothold> =
            scene.footholds.iter().enumerate().map(|(i, pose)| (*pose, i as Foothold)).collect();
        scene.landings = scene.landings_of(&index);
        scene.make_links(&index);
        scene
    }

    /// Returns the motions of the kind.
    pub fn table(&self) -> &Table {
        self.database.table(self.kind)
    }
    /// Returns the terrain.
    pub fn terrain(&self) -> &Terrain {
        &self.terrain
    }
    /// Returns the poses of all footholds, four for each connector.
    pub fn footholds(&self) -> &[LatticePose] {
        &self.footholds
    }
    /// Returns the pose of a foothold.
    pub fn pose(&self, foothold: Foothold) -> LatticePose {
        self.footholds[usize::from(foothold)]
    }
    /// Returns the carry tables by grip.
    pub fn carry(&self) -> &[CarryTable] {
        &self.carry
    }
    /// Returns the landings from a foothold.
    pub fn landings(&self, foothold: Foothold) -> &[Landing] {
        &self.landings[usize::from(foothold)]
    }
    /// Iterates over the ways to hand the element over from a hold, each with the foothold of the receiver.
    pub fn ways_from(&self, hold: &Hold) -> impl Iterator<Item = (Foothold, &Transfer)> {
        let (links, set) = (&self.links[usize::from(hold.foothold)][usize::from(hold.grip)], hold.set);
        links.iter().flat_map(move |link| link.ways_from(set).iter().map(|way| (link.to, way)))
    }
    /// Returns the sets of empty postures at a foothold without other bodies.
    pub fn empty(&self, foothold: Foothold) -> &Sets {
        &self.empty[usize::from(foothold)]
    }
    /// Returns the sets of postures at a foothold that hold the element.
    pub fn holding(&self, foothold: Foothold, grip: u8) -> &Sets {
        &self.holding[usize::from(foothold)][usize::from(grip)]
    }
    /// Returns the cells of the element that a posture at a foothold holds.
    pub fn held(&self, foothold: Foothold, grip: u8, posture: u16) -> Option<Vec<Cell>> {
        let cells = self.carry[usize::from(grip)].held(posture)?;
        let mut cells: Vec<Cell> = cells.iter().map(|c| world_cell(self.pose(foothold), *c)).collect();
        cells.sort_unstable();
        Some(cells)
    }
    /// Returns the cells of the cubes of a posture at a foothold.
    pub fn body(&self, foothold: Foothold, posture: u16) -> [Cell; 4] {
        let placement = self.table().postures()[usize::from(posture)].posture.placement();
        placement.cells.map(|cell| world_cell(self.pose(foothold), cell))
    }
    /// Returns true if a step of a holder at a foothold is within the limits of torque.
    pub fn is_within_limits(&self, foothold: Foothold, grip: u8, step: usize) -> bool {
        self.within.get(&(grip, gravity(self.pose(foothold)))).is_some_and(|steps| steps[step])
    }

    /// Returns all ways to hold the element in these cells: the hold and the posture.
    pub fn holds_at(&self, cells: &[Cell]) -> Vec<(Hold, u16)> {
        let mut all = Vec::new();
        let reach = |foothold: Foothold| {
            let foot = world_cell(self.pose(foothold), Cell::default());
            cells.iter().any(|c| c.manhattan(foot) <= 4)
        };
        for foothold in (0..self.footholds.len() as Foothold).filter(|f| reach(*f)) {
            for grip in 0..self.carry.len() as u8 {
                let sets = self.holding(foothold, grip);
                for (posture, set) in (0..).zip(sets.iter()).filter(|(_, set)| **set != NO_SET) {
                    if self.held(foothold, grip, posture).is_some_and(|held| held == cells) {
                        all.push((Hold { foothold, grip, set: *set }, posture));
                    }
                }
            }
        }
        all
    }

    /// Returns the pairs of postures for a way along a link.
    pub fn pairs(&self, from: Foothold, to: Foothold, way: &Transfer) -> Vec<PosturePair> {
        let relative = self.pose(from).inverse().compose(self.pose(to));
        let pairs = self.handovers[&(way.holder.0, way.receiver.0)].pairs.get(&relative);
        let sets = self.sets_of(from, to, (way.holder.0, way.receiver.0));
        pairs.into_iter().flatten().filter(|pair| sets(pair).as_ref() == Some(way)).copied().collect()
    }

    /// Returns the sets of empty postures where these cells are blocked.
    pub fn empty_among(&self, blocked: &CellSet) -> Sets {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(sets) = known().get(blocked) {
            return sets.clone();
        }
        let table = self.table();
        let mut sets = vec![NO_SET; table.postures().len()];
        for posture in 0..sets.len() as u16 {
            if sets[usize::from(posture)] == NO_SET {
                for (reached, _) in table.reach(posture, blocked).postures() {
                    sets[usize::from(reached)] = posture;
                }
            }
        }
        let sets: Sets = sets.into();
        let mut known = known();
        if known.len() >= MAX_KNOWN {
            known.clear();
        }
        known.insert(*blocked, sets.clone());
        sets
    }

    /// Returns the cells of the motion database that are blocked at a foothold, by the terrain or because they are taken.
    pub fn blocked(&self, foothold: Foothold, taken: &BTreeSet<Cell>) -> CellSet {
        let from = self.pose(foothold).inverse();
        let taken = taken.iter().map(|cell| world_cell(from, *cell));
        self.blocked[usize::from(foothold)].union(&self.database.cell_set(taken))
    }

    fn make_sets(&mut self) {
        let mut known: HashMap<(u8, Face, Vec<u64>), Sets> = HashMap::new();
        for pose in self.footholds.clone() {
            let is_blocked = |cell: &Cell| self.terrain.is_blocked(world_cell(pose, *cell));
            let cells = self.database.cells().iter().copied();
            let blocked = self.database.cell_set(cells.filter(is_blocked));
            self.empty.push(self.empty_among(&blocked));
            self.blocked.push(blocked);
            let down = gravity(pose);
            let mut of_grips = Vec::new();
            for (grip, carry) in self.carry.iter().enumerate() {
                let grip = grip as u8;
                let within = self.within.get(&(grip, down));
                let blocked = carry.set(|cell| self.terrain.is_blocked(world_cell(pose, cell)));
                let key = (grip, down, blocked.words().to_vec());
                let sets = known.entry(key).or_insert_with(|| {
                    let is_within = |i: usize| within.is_some_and(|steps| steps[i]);
                    let passes = |i: usize| !carry.steps()[i].swept.meets(&blocked) && is_within(i);
                    first_postures(carry, &blocked, passes)
                });
                of_grips.push(sets.clone());
            }
            self.holding.push(of_grips);
        }
    }

    /// Returns the landings from each foothold.
    fn landings_of(&self, index: &HashMap<LatticePose, Foothold>) -> Vec<Vec<Landing>> {
        let table = self.table();
        // The poses of the head do not depend on the foothold.
        let heads = (0..).zip(table.postures()).filter_map(|(posture, entry)| {
            Some((posture, entry.posture.placement().head, table.find(entry.posture.reversed())?))
        });
        let heads: Vec<(u16, LatticePose, u16)> = heads.collect();
        let at = |foot: &LatticePose| {
            let landing = |(posture, head, reversed): &(u16, LatticePose, u16)| {
                let to = *index.get(&foot.compose(*head))?;
                Some(Landing { posture: *posture, to, reversed: *reversed })
            };
            heads.iter().filter_map(landing).collect()
        };
        self.footholds.iter().map(at).collect()
    }

    fn make_links(&mut self, index: &HashMap<LatticePose, Foothold>) {
        let mut known: HashMap<SameWays, Arc<[Transfer]>> = HashMap::new();
        for from in 0..self.footholds.len() as Foothold {
            let mut links = vec![Vec::new(); self.carry.len()];
            for (grips, table) in &self.handovers {
                for (relative, pairs) in &table.pairs {
                    let Some(to) = index.get(&self.pose(from).compose(*relative)) else { continue };
                    let sets = [
                        self.holding(from, grips.0),
                        self.holding(*to, grips.1),
                        self.empty(from),
                        self.empty(*to),
                    ];
                    let key = (*relative, sets.map(|s| s.as_ptr()), *grips);
                    let ways = known.entry(key).or_insert_with(|| {
                        let mut ways: Vec<Transfer> =
                            pairs.iter().filter_map(self.sets_of(from, *to, *grips)).collect();
                        ways.sort_unstable();
                        ways.dedup();
                        ways.into()
                    });
                    if !ways.is_empty() {
                        links[usize::from(grips.0)].push(Link { to: *to, ways: ways.clone() });
                    }
                }
            }
            self.links.push(links);
        }
    }

    /// Returns the function that gives the way of a pair.
    fn sets_of(
        &self,
        from: Foothold,
        to: Foothold,
        grips: (u8, u8),
    ) -> impl Fn(&PosturePair) -> Option<Transfer> + use<> {
        let (holding, left) = (self.holding(from, grips.0).clone(), self.empty(from).clone());
        let (taking, came) = (self.holding(to, grips.1).clone(), self.empty(to).clone());
        move |pair| {
            let (holder, receiver) = (usize::from(pair.holder), usize::from(pair.receiver));
            let valid = holding[holder] != NO_SET && taking[receiver] != NO_SET;
            valid.then(|| Transfer {
                holder: (grips.0, holding[holder]),
                left: left[holder],
                receiver: (grips.1, taking[receiver]),
                came: came[receiver],
            })
        }
    }
}

/// Generates the hand-overs between all grips of an element.
pub fn hand_overs(
    table: &Table,
    element: &Element,
    carry: &[CarryTable],
) -> BTreeMap<(u8, u8), HandoverTable> {
    let mut all = BTreeMap::new();
    for (g, holder) in (0..).zip(carry) {
        for (h, receiver) in (0..).zip(carry) {
            let sets = [holder, receiver].map(CarryTable::valid_postures);
            all.insert((g, h), HandoverTable::between(table, element, [holder, receiver], sets));
        }
    }
    all
}

/// Returns for each posture the first one of its set.
fn first_postures(carry: &CarryTable, blocked: &Cells, passes: impl Fn(usize) -> bool) -> Sets {
    let mut sets = vec![NO_SET; carry.postures()];
    for set in carry.connected(|p| !carry.fills(p).is_some_and(|cells| cells.meets(blocked)), passes) {
        for posture in &set {
            sets[usize::from(*posture)] = set[0];
        }
    }
    sets.into()
}

//! Goals: seeds in levels (thesis 4.1.3), and the order in which they open.

use metamorph_core::lattice::{Cell, Face};
use metamorph_core::names;
use metamorph_core::wire::{Decoder, Encoder, Field, WireError};
use serde::{Deserialize, Serialize};
use std::hash::{Hash, Hasher};
use thiserror::Error;

/// The most seeds of a blueprint: sets of seeds are 128 bits.
pub const MAX_SEEDS: usize = 128;

/// The floor: a rectangle of connectors, both corners included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Floor {
    /// The corner with the smallest coordinates.
    pub min: (i16, i16),
    /// The corner with the largest.
    pub max: (i16, i16),
}

impl Floor {
    /// Returns the number of connectors.
    pub fn connectors(&self) -> usize {
        let side = |min: i16, max: i16| (i32::from(max) - i32::from(min) + 1).max(0) as usize;
        side(self.min.0, self.max.0) * side(self.min.1, self.max.1)
    }
    /// Whether there is a connector.
    pub fn has(&self, x: i16, y: i16) -> bool {
        (self.min.0..=self.max.0).contains(&x) && (self.min.1..=self.max.1).contains(&y)
    }
}

/// A place for one metamodule: the connector that holds its foot, and the directions from cell to
/// cell. Which end stands there and how it is turned are free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Seed {
    /// The connector cell.
    pub foot: (i16, i16),
    /// From the first cell to the second, and so on.
    pub directions: [Face; 3],
}

impl Seed {
    /// Returns the seed after quarter turns from x to y, about the connector (0, 0).
    fn turned(self, quarters: u8) -> Seed {
        (0..quarters % 4).fold(self, |Seed { foot: (x, y), directions }, _| Seed {
            foot: (y.saturating_neg(), x),
            directions: directions.map(|face| match face {
                Face::East => Face::North,
                Face::North => Face::West,
                Face::West => Face::South,
                Face::South => Face::East,
                Face::Up | Face::Down => face,
            }),
        })
    }
    /// The four cells, from the foot on.
    pub fn cells(&self) -> [Cell; 4] {
        let mut cells = [Cell::new(self.foot.0, self.foot.1, 0); 4];
        for (i, d) in self.directions.iter().enumerate() {
            cells[i + 1] = cells[i].step(*d);
        }
        cells
    }
}

/// The three seeding orders that the thesis compared (4.1.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum SeedOrder {
    /// One after the other, as listed.
    Circular,
    /// One after the other, in pairs that lie half the list apart. The default: of the three it takes the fewest moves
    /// and messages under `negotiated`, which can build in any of them.
    #[default]
    Crosswise,
    /// All seeds of a level at once.
    AtOnce,
}

names!(SeedOrder { Circular => "circular", Crosswise => "crosswise", AtOnce => "at-once" });

/// A set of seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Default)]
#[serde(transparent)]
pub struct SeedSet(pub u128);

impl Hash for SeedSet {
    /// Hashes a set of the first 32 seeds as 32 bits: state hashes of goals with at most 32 seeds do not depend on
    /// how many are possible.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        match self.narrow() {
            Some(first) => first.hash(hasher),
            None => self.0.hash(hasher),
        }
    }
}

impl SeedSet {
    /// Returns the set as 32 bits, if it holds no other seeds than the first 32.
    pub fn narrow(self) -> Option<u32> {
        u32::try_from(self.0).ok()
    }
    /// Whether a seed is in it.
    pub const fn has(self, seed: u8) -> bool {
        (seed as usize) < MAX_SEEDS && self.0 >> seed & 1 == 1
    }
    /// Returns this set with one more seed.
    pub const fn with(self, seed: u8) -> SeedSet {
        SeedSet(if (seed as usize) < MAX_SEEDS { self.0 | 1 << seed } else { self.0 })
    }
    /// The seeds that are not in the other.
    pub const fn without(self, other: SeedSet) -> SeedSet {
        SeedSet(self.0 & !other.0)
    }
    /// Whether all seeds of the other are in it.
    pub const fn holds(self, other: SeedSet) -> bool {
        other.0 & !self.0 == 0
    }
    /// Returns the number of seeds in it.
    pub const fn len(self) -> usize {
        self.0.count_ones() as usize
    }
    /// Whether there is none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
    /// Returns the union of this set and the other.
    pub const fn and(self, other: SeedSet) -> SeedSet {
        SeedSet(self.0 | other.0)
    }
    /// The seeds in it, ascending.
    pub fn iter(self) -> impl Iterator<Item = u8> {
        (0..MAX_SEEDS as u8).filter(move |s| self.has(*s))
    }
    /// Writes 4 bytes, or 16 if `wide`.
    pub(super) fn encode(self, wide: bool, out: &mut Encoder) {
        if wide {
            out.u64(self.0 as u64);
            out.u64((self.0 >> 64) as u64);
        } else {
            out.u32(self.0 as u32);
        }
    }
    /// Reads 4 bytes, or 16 if `wide`.
    pub(super) fn decode(wide: bool, from: &mut Decoder<'_>) -> Result<SeedSet, WireError> {
        Ok(SeedSet(match wide {
            true => u128::from(from.u64()?) | u128::from(from.u64()?) << 64,
            false => from.u32()?.into(),
        }))
    }
}

/// The current task of a swarm: one of its goals, turned and moved along the floor. Of two tasks, the one with the
/// larger epoch is later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
pub struct Task {
    /// How often the task has changed.
    pub epoch: u16,
    /// The number of the goal: at most 31.
    pub goal: u8,
    /// How far the goal is moved along x and y, after it is turned.
    pub shift: (i16, i16),
    /// How many quarters it is turned from x to y, about the connector (0, 0): at most 3.
    pub quarters: u8,
    /// The order in which its seeds open, if that is not the scenario's.
    pub order: Option<SeedOrder>,
    /// True if the goal is given up: nothing is built.
    pub is_dropped: bool,
}

impl Hash for Task {
    /// Hashes the last three only where they say something: other state hashes do not depend on whether goals can be
    /// turned.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        (self.epoch, self.goal, self.shift).hash(hasher);
        let changed = (self.quarters, self.order, self.is_dropped);
        if changed != Default::default() {
            changed.hash(hasher);
        }
    }
}

impl Task {
    /// The goal's bits in its byte on the wire.
    const GOAL: u8 = 0x1f;
    /// The bit that says that the goal is given up. The order is in the two bits above it.
    const DROPPED: u8 = 0x20;

    /// Returns the task with its goal moved by this much more.
    pub fn shifted(self, by: (i16, i16)) -> Task {
        let (x, y) = self.shift;
        Task { shift: (x.saturating_add(by.0), y.saturating_add(by.1)), ..self }
    }
    /// A seed of the goal where this task wants it.
    pub fn moved(&self, seed: Seed) -> Seed {
        let seed = seed.turned(self.quarters);
        let (x, y) = seed.foot;
        Seed { foot: (x.saturating_add(self.shift.0), y.saturating_add(self.shift.1)), ..seed }
    }
}

/// Seven bytes. Of a coordinate, the two highest bits are equal, so one of them can say more.
impl Field for Task {
    fn put(&self, out: &mut Encoder) {
        out.u16(self.epoch);
        let order = SeedOrder::ALL.iter().position(|order| Some(*order) == self.order).map_or(0, |i| i + 1);
        let dropped = if self.is_dropped { Task::DROPPED } else { 0 };
        out.u8(self.goal & Task::GOAL | dropped | (order as u8) << 6);
        let bit = |bit: u8| u16::from(self.quarters >> bit & 1) << 15;
        out.u16(self.shift.0 as u16 ^ bit(0));
        out.u16(self.shift.1 as u16 ^ bit(1));
    }
    fn take(_: &'static str, from: &mut Decoder<'_>) -> Result<Task, WireError> {
        let (epoch, goal) = (from.u16()?, from.u8()?);
        let words = (from.u16()?, from.u16()?);
        let bit = |word: u16| word >> 15 ^ word >> 14 & 1;
        let coordinate = |word: u16| (word ^ bit(word) << 15) as i16;
        let shift = (coordinate(words.0), coordinate(words.1));
        let far = |c: i16| c.unsigned_abs() > Cell::LIMIT.unsigned_abs();
        if far(shift.0) || far(shift.1) {
            return Err(WireError::Field("shift"));
        }
        Ok(Task {
            epoch,
            goal: goal & Task::GOAL,
            shift,
            quarters: (bit(words.0) | bit(words.1) << 1) as u8,
            order: usize::from(goal >> 6).checked_sub(1).map(|i| SeedOrder::ALL[i]),
            is_dropped: goal & Task::DROPPED != 0,
        })
    }
}

/// A goal: seeds, and the steps in which they open. A step opens when all before it are filled.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Blueprint {
    seeds: Vec<Seed>,
    /// How many seeds each level has.
    levels: Vec<u8>,
    steps: Vec<SeedSet>,
    /// The same seeds in each of the orders; empty in these.
    ordered: Vec<Blueprint>,
}

/// Why a blueprint cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum BlueprintError {
    /// The blueprint has no seeds.
    #[error("there is no seed")]
    Empty,
    /// The blueprint has more than [`MAX_SEEDS`] seeds; holds their number.
    #[error("there are {0} seeds; at most {MAX_SEEDS} are possible")]
    TooMany(usize),
    /// Two metamodules cannot share a cell.
    #[error("seeds {} and {} both need the cell {cell}", .first + 1, .second + 1)]
    Overlap {
        /// One of the seeds, from 0.
        first: usize,
        /// The other.
        second: usize,
        /// The shared cell.
        cell: Cell,
    },
    /// The cells of a seed fold back onto each other, or go into the floor; holds its number, from 0.
    #[error("seed {} has a cell in the floor or twice the same cell", .0 + 1)]
    Impossible(usize),
}

impl Blueprint {
    /// A blueprint without seeds; stands for a goal that does not exist.
    pub const NOTHING: Blueprint =
        Blueprint { seeds: Vec::new(), levels: Vec::new(), steps: Vec::new(), ordered: Vec::new() };

    /// A blueprint of these levels, from the ground up.
    pub fn new(levels: &[Vec<Seed>], order: SeedOrder) -> Result<Blueprint, BlueprintError> {
        let seeds: Vec<Seed> = levels.iter().flatten().copied().collect();
        match seeds.len() {
            0 => return Err(BlueprintError::Empty),
            1..=MAX_SEEDS => {}
            n => return Err(BlueprintError::TooMany(n)),
        }
        for (i, seed) in seeds.iter().enumerate() {
            let cells = seed.cells();
            let twice = (1..4).any(|k| cells[..k].contains(&cells[k]));
            if twice || cells.iter().any(|c| c.z < 0) {
                return Err(BlueprintError::Impossible(i));
            }
            for (j, other) in seeds[..i].iter().enumerate() {
                if let Some(cell) = cells.into_iter().find(|c| other.cells().contains(c)) {
                    return Err(BlueprintError::Overlap { first: j, second: i, cell });
                }
            }
        }
        let levels: Vec<u8> = levels.iter().map(|l| l.len() as u8).collect();
        let with = |order, ordered| {
            let (seeds, levels, steps) = (seeds.clone(), levels.clone(), Blueprint::steps(&levels, order));
            Blueprint { seeds, levels, steps, ordered }
        };
        Ok(with(order, SeedOrder::ALL.map(|order| with(order, Vec::new())).into()))
    }

    /// Returns the steps in which seeds open, from the number of seeds of each level.
    fn steps(levels: &[u8], order: SeedOrder) -> Vec<SeedSet> {
        let (mut steps, mut first) = (Vec::new(), 0u8);
        for n in levels.iter().copied() {
            let one = |i: u8| SeedSet::default().with(first + i);
            match order {
                SeedOrder::Circular => steps.extend((0..n).map(one)),
                SeedOrder::Crosswise => {
                    let half = n.div_ceil(2);
                    let pair = |i: u8| [i, i + half].into_iter().filter(move |k| *k < n);
                    steps.extend((0..half).flat_map(pair).map(one));
                }
                SeedOrder::AtOnce => steps.push((0..n).fold(SeedSet::default(), |s, i| s.with(first + i))),
            }
            first += n;
        }
        steps.retain(|s| !s.is_empty());
        steps
    }

    /// Returns the blueprint with the same seeds in another order.
    pub fn in_order(&self, order: SeedOrder) -> &Blueprint {
        let i = SeedOrder::ALL.iter().position(|other| *other == order);
        i.and_then(|i| self.ordered.get(i)).unwrap_or(self)
    }

    /// All seeds, level by level.
    pub fn seeds(&self) -> &[Seed] {
        &self.seeds
    }
    /// How many seeds each level has.
    pub fn levels(&self) -> &[u8] {
        &self.levels
    }
    /// All seeds as a set.
    pub fn all(&self) -> SeedSet {
        self.steps.iter().fold(SeedSet::default(), |a, b| SeedSet(a.0 | b.0))
    }
    /// The seeds that are to be filled before this one: those of the steps before, and of its own step
    /// those with smaller numbers.
    pub fn before(&self, seed: u8) -> SeedSet {
        let mut before = SeedSet::default();
        for step in self.steps.iter().take_while(|s| !s.has(seed)) {
            before = before.and(*step);
        }
        let step = self.steps.iter().find(|s| s.has(seed)).copied().unwrap_or_default();
        before.and(SeedSet(step.0 & ((1 << seed) - 1)))
    }
    /// Returns the seeds that are open when those in `filled` are filled: the unfilled ones of the first step that is
    /// not complete.
    pub fn open(&self, filled: SeedSet) -> SeedSet {
        let step = self.steps.iter().find(|s| !filled.holds(**s)).copied().unwrap_or_default();
        step.without(filled)
    }
}

/// The box of four: the stool of figure 4.4a as "leg and top" pairs, four L-shapes around a square.
/// The thesis gives no cells; these are a reading of the figure.
pub fn box_of_four(x: i16, y: i16) -> Vec<Vec<Seed>> {
    use Face::{East, North, South, Up, West};
    let seed = |dx, dy, turn| Seed { foot: (x + dx, y + dy), directions: [Up, Up, turn] };
    vec![vec![seed(0, 0, East), seed(2, 0, North), seed(2, 2, West), seed(0, 2, South)]]
}

/// The chair of six: the box with a back of two upright metamodules behind it.
pub fn chair_of_six(x: i16, y: i16) -> Vec<Vec<Seed>> {
    let back = |dx, dy| Seed { foot: (x + dx, y + dy), directions: [Face::Up; 3] };
    let mut levels = box_of_four(x, y);
    levels.push(vec![back(0, 3), back(2, 3)]);
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::message::Order;
    use metamorph_core::wire::{Wire, from_payload, payload};

    fn opened(order: SeedOrder) -> Vec<u128> {
        let blueprint = Blueprint::new(&chair_of_six(0, 0), order).unwrap();
        let (mut filled, mut all) = (SeedSet::default(), Vec::new());
        while !blueprint.open(filled).is_empty() {
            let open = blueprint.open(filled);
            all.push(open.0);
            filled = SeedSet(filled.0 | open.0);
        }
        assert_eq!(filled, blueprint.all());
        all
    }

    /// The three orders of thesis 4.1.3 for the chair.
    #[test]
    fn opens_seeds_in_the_orders_of_the_thesis() {
        assert_eq!(opened(SeedOrder::Circular), [1, 2, 4, 8, 16, 32]);
        assert_eq!(opened(SeedOrder::Crosswise), [1, 4, 2, 8, 16, 32]);
        assert_eq!(opened(SeedOrder::AtOnce), [15, 48]);
    }

    #[test]
    fn seeds_before_others_are_of_earlier_steps_or_smaller_numbers() {
        let before = |order, seed| Blueprint::new(&chair_of_six(0, 0), order).unwrap().before(seed).0;
        assert_eq!([0, 1, 2, 3, 4, 5].map(|s| before(SeedOrder::Crosswise, s)), [0, 5, 1, 7, 15, 31]);
        assert_eq!([0, 1, 2, 3, 4, 5].map(|s| before(SeedOrder::AtOnce, s)), [0, 1, 3, 7, 15, 31]);
    }

    #[test]
    fn a_level_waits_for_all_of_the_one_below() {
        let blueprint = Blueprint::new(&chair_of_six(0, 0), SeedOrder::AtOnce).unwrap();
        assert_eq!(blueprint.open(SeedSet(0b0111)), SeedSet(0b1000));
        assert_eq!(blueprint.open(SeedSet(0b1111)), SeedSet(0b11_0000));
    }

    #[test]
    fn refuses_what_cannot_be() {
        use Face::{Down, East, Up, West};
        let seed = |x, directions| Seed { foot: (x, 0), directions };
        let of = |seeds: &[Seed]| Blueprint::new(&[seeds.to_vec()], SeedOrder::Circular).unwrap_err();
        assert_eq!(of(&[]), BlueprintError::Empty);
        assert_eq!(of(&[seed(0, [Up, Down, Up])]), BlueprintError::Impossible(0));
        assert_eq!(of(&[seed(0, [East, Down, East])]), BlueprintError::Impossible(0));
        let overlap = of(&[seed(0, [Up, Up, East]), seed(1, [Up, Up, West])]);
        assert!(matches!(overlap, BlueprintError::Overlap { first: 0, second: 1, .. }), "{overlap}");
        let many: Vec<Seed> = (0..129).map(|x| seed(x, [Up; 3])).collect();
        assert_eq!(of(&many), BlueprintError::TooMany(129));
    }

    /// 128 seeds open one after the other, the last one last.
    #[test]
    fn the_largest_blueprint_opens_seed_by_seed() {
        let all: Vec<Seed> = (0..128).map(|x| Seed { foot: (x, 0), directions: [Face::Up; 3] }).collect();
        let blueprint = Blueprint::new(&[all], SeedOrder::Circular).unwrap();
        let mut filled = SeedSet::default();
        for seed in 0..128 {
            assert_eq!(
                (blueprint.open(filled), blueprint.before(seed)),
                (SeedSet::default().with(seed), filled)
            );
            filled = filled.with(seed);
        }
        assert_eq!((filled, filled.len(), filled.with(128)), (blueprint.all(), 128, filled));
        assert!(blueprint.open(filled).is_empty() && !filled.has(128));
    }

    #[test]
    fn tasks_survive_the_wire_and_the_last_fields_are_hashed_only_if_they_say_something() {
        let tasks = (0..4).flat_map(|quarters| {
            let orders = SeedOrder::ALL.map(Some).into_iter().chain([None]);
            orders.flat_map(move |order| {
                [(-3, 4), (0, 0), (-Cell::LIMIT, Cell::LIMIT)].into_iter().flat_map(move |shift| {
                    [true, false].map(|is_dropped| Task {
                        epoch: 9,
                        goal: 31,
                        shift,
                        quarters,
                        order,
                        is_dropped,
                    })
                })
            })
        });
        let mut all = Vec::new();
        for task in tasks {
            let order = Order::Seeds { task, open: SeedSet(0), filled: SeedSet(0) };
            let bytes = payload(&order);
            assert_eq!((bytes.len(), from_payload(order.kind(), &bytes)), (15, Ok(order)));
            all.push(hash_of(&task));
        }
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 96);
        let plain = Task { epoch: 2, goal: 1, shift: (-3, 4), ..Task::default() };
        assert_eq!(hash_of(&plain), hash_of(&(2u16, 1u8, (-3i16, 4i16))));
    }

    fn hash_of(value: &impl Hash) -> u64 {
        let mut hasher = siphasher::sip::SipHasher13::new();
        value.hash(&mut hasher);
        hasher.finish()
    }

    /// Four quarters are none, and the chair stays a chair.
    #[test]
    fn seeds_turn_with_the_goal() {
        for seed in chair_of_six(3, 4).into_iter().flatten() {
            let turned = |quarters| Task { quarters, ..Task::default() }.moved(seed);
            let [x, y, z] = turned(0).cells().map(|c| [c.x, c.y, c.z])[3];
            let end = Cell::new(-y, x, z);
            assert_eq!(turned(1).cells()[3], end);
            assert_eq!(turned(3).turned(1), seed);
        }
    }

    /// Hashes of states are a contract: those of small sets are what they were when sets had 32 bits.
    #[test]
    fn small_sets_hash_as_32_bits() {
        let hash = |value: &dyn Fn(&mut siphasher::sip::SipHasher13)| {
            let mut hasher = siphasher::sip::SipHasher13::new();
            value(&mut hasher);
            hasher.finish()
        };
        for bits in [0, 7, u32::MAX] {
            assert_eq!(hash(&|h| SeedSet(bits.into()).hash(h)), hash(&|h| bits.hash(h)));
        }
        assert_eq!(SeedSet(1 << 32).narrow(), None);
        assert_ne!(hash(&|h| SeedSet(1 << 32).hash(h)), hash(&|h| SeedSet(1 << 33).hash(h)));
    }
}

//! The order in which the parts of a goal can be assembled, found by taking it apart (thesis B.4).
//!
//! Motions can be reversed, so a part can be put in place while others stand exactly if it can leave while they stand.
//! What can leave while some parts stand can leave while fewer of them stand. So taking away whatever can leave, until
//! nothing can, finds an order if there is one, and no choice has to be taken back. The parts that are left
//! otherwise block each other.

use metamorph_agents::metamodule::blueprint::{Blueprint, Floor, Seed, SeedSet};
use metamorph_agents::metamodule::motions::Motions;
use metamorph_agents::metamodule::planning::is_away;
use metamorph_core::lattice::Cell;

/// Width of the free floor on each side of the goal, in connectors: more than a body needs to leave.
const MARGIN: i16 = 8;

/// A part that cannot leave.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Blocked {
    /// Its seed.
    pub seed: u8,
    /// Other parts that block it; without any one of them it could leave. Empty if it can never leave.
    pub by: Vec<u8>,
}

/// How a goal can be assembled.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AssemblyOrder {
    /// The seeds that are not blocked, by steps, the first step first. Those of one step can be filled in any order.
    pub steps: Vec<Vec<u8>>,
    /// The parts that block each other: none of them can be the last one.
    pub blocked: Vec<Blocked>,
}

/// Finds the order in which metamodules can fill the seeds of a goal on a floor that is large enough.
pub fn assembly_order(motions: &Motions, goal: &Blueprint) -> AssemblyOrder {
    let of = Disassembly::new(motions, goal);
    let mut standing = goal.all();
    let mut steps = Vec::new();
    loop {
        let leave: Vec<u8> = standing.iter().filter(|seed| of.can_leave(*seed, standing)).collect();
        if leave.is_empty() {
            break;
        }
        standing = leave.iter().fold(standing, |rest, seed| rest.without(SeedSet::default().with(*seed)));
        steps.push(leave);
    }
    steps.reverse();
    let blocked = standing.iter().map(|seed| Blocked { seed, by: of.blockers(seed, standing) });
    AssemblyOrder { steps, blocked: blocked.collect() }
}

struct Disassembly<'a> {
    motions: &'a Motions,
    seeds: Vec<Seed>,
    floor: Floor,
}

impl<'a> Disassembly<'a> {
    fn new(motions: &'a Motions, goal: &Blueprint) -> Disassembly<'a> {
        let seeds = goal.seeds().to_vec();
        let cells = || seeds.iter().flat_map(Seed::cells);
        let least = |along: fn(Cell) -> i16| cells().map(along).min().unwrap_or(0) - MARGIN;
        let most = |along: fn(Cell) -> i16| cells().map(along).max().unwrap_or(0) + MARGIN;
        let floor = Floor { min: (least(|c| c.x), least(|c| c.y)), max: (most(|c| c.x), most(|c| c.y)) };
        Disassembly { motions, seeds, floor }
    }

    /// Returns true if a part can get away while these parts stand, itself among them or not.
    fn can_leave(&self, seed: u8, standing: SeedSet) -> bool {
        let part = self.seeds[usize::from(seed)];
        let others = standing.without(SeedSet::default().with(seed));
        let cells = others.iter().flat_map(|other| self.seeds[usize::from(other)].cells());
        let taken: Vec<Cell> = cells.collect();
        let middle = (i64::from(part.foot.0) * 4, i64::from(part.foot.1) * 4);
        self.motions.distances(self.floor, part, &taken).reach(|connector| is_away(middle, connector))
    }

    /// Returns a minimal set of parts that keep a part from leaving: without any one of them it could leave.
    fn blockers(&self, seed: u8, standing: SeedSet) -> Vec<u8> {
        let mut by = standing.without(SeedSet::default().with(seed));
        for other in standing.iter() {
            let without = by.without(SeedSet::default().with(other));
            if !self.can_leave(seed, without) {
                by = without;
            }
        }
        by.iter().collect()
    }
}

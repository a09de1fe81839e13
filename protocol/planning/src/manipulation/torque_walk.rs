//! The torque experiment of thesis 5.1.4: a metamodule walks across a floor under limits of torque.
//!
//! A move is a path of single steps from one landing to the next. Fewest moves come first, then the least joint
//! travel, the sum of |Δq|.

use crate::plan::search::{Method, Search};
use crate::plan::{Cost, Limits as SearchLimits, Outcome, Space, Step};
use metamorph_core::names;
use metamorph_roombots::database::Table;
use metamorph_roombots::grid::GridState;
use metamorph_roombots::posture::{Posture, is_middle};
use metamorph_roombots::sweep::FloorContact;
use metamorph_roombots::torque::{Limits, Load, Torque, torques};
use std::collections::{BTreeMap, BTreeSet};

/// The estimate of the torque that must stay within the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Estimate {
    /// No limit.
    None,
    /// T^w, the worst case.
    Worst,
    /// T^r as printed, with the force at the last pivot.
    Printed,
    /// T^r with the force at the centre of mass.
    Reasonable,
    /// The exact static torque.
    Exact,
}

names!(Estimate {
    None => "none",
    Worst => "worst",
    Printed => "printed",
    Reasonable => "reasonable",
    Exact => "exact",
});

impl Estimate {
    fn of(self, torque: &Torque) -> f64 {
        match self {
            Estimate::None => 0.0,
            Estimate::Worst => torque.worst,
            Estimate::Printed => torque.printed,
            Estimate::Reasonable => torque.reasonable,
            Estimate::Exact => torque.exact,
        }
    }
}

/// Steps and landings that a metamodule can reach within limits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MoveGraph {
    /// The number of postures within the limits.
    pub postures: usize,
    /// The number of strict steps all of whose samples are within the limits.
    pub steps: usize,
    /// The states of landings with a posture within the limits.
    pub landings: BTreeSet<GridState>,
    /// From each posture at the beginning of a move: the end posture, its landing, and the least travel in units of
    /// 30°.
    from: BTreeMap<u16, Vec<(u16, GridState, Cost)>>,
}

/// A path across the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Walk {
    /// The number of moves.
    pub moves: u32,
    /// The joint travel in degrees.
    pub degrees: u32,
}

/// A unit of travel in degrees: the greatest common divisor of both kinds of steps.
const UNIT: u32 = 30;
/// The cost of a move, in units of travel: more than the travel of any path that is looked for.
const MOVE_COST: Cost = 1000;

impl MoveGraph {
    /// Finds the moves of a kind within limits.
    pub fn new(table: &Table, estimate: Estimate, limits: Limits) -> MoveGraph {
        let within = |q: &[f64]| {
            let all = torques(table.kind(), q, &Load::floor());
            let all = all.expect("invariant: a posture of the table has all joints and finite angles");
            // Rounding must not decide where the torque is the limit.
            estimate == Estimate::None
                || all.iter().enumerate().all(|(i, t)| estimate.of(t) <= limits.of(i) + 1e-9)
        };
        let stands: Vec<bool> = table.postures().iter().map(|p| within(&p.posture.radians())).collect();
        let mut steps_at = vec![Vec::new(); stands.len()];
        let mut steps = 0;
        for step in table.steps().iter().filter(|s| s.floor == FloorContact::Free) {
            let (from, to, joint) = (usize::from(step.from), usize::from(step.to), usize::from(step.joint));
            let mut q = table.postures()[from].posture.radians();
            let (first, samples, units) =
                if is_middle(joint) { (q[joint], 12_u32, 3) } else { (q[joint], 16, 4) };
            let passes = (0..=samples).all(|sample| {
                q[joint] = first + (7.5 * f64::from(sample)).to_radians();
                within(&q)
            });
            if passes {
                steps += 1;
                steps_at[from].push((step.to, units));
                steps_at[to].push((step.from, units));
            }
        }
        let mut moves = MoveGraph {
            postures: stands.iter().filter(|s| **s).count(),
            steps,
            landings: table
                .landings()
                .iter()
                .filter(|l| l.postures.iter().any(|p| stands[usize::from(*p)]))
                .map(|l| l.state)
                .collect(),
            from: BTreeMap::new(),
        };
        moves.connect(table, &stands, &steps_at);
        moves
    }

    /// Finds the least travel between every two postures at the ends of moves.
    fn connect(&mut self, table: &Table, stands: &[bool], steps_at: &[Vec<(u16, Cost)>]) {
        let upright = table.find(Posture::zero(table.kind()));
        let reversed = |p: u16| table.reversed(p).filter(|r| stands[usize::from(*r)]);
        let ends: BTreeSet<u16> =
            (0..stands.len() as u16).filter(|p| stands[usize::from(*p)] && reversed(*p).is_some()).collect();
        for start in ends.iter().copied().chain(upright.filter(|p| stands[usize::from(*p)])) {
            let travel = least_travel(start, steps_at);
            let landed = |p: &u16| {
                let state = table.landings()[usize::from(table.postures()[usize::from(*p)].landing?)].state;
                Some((reversed(*p)?, state, travel[usize::from(*p)]?))
            };
            let list: Vec<_> = ends.iter().filter(|p| **p != start).filter_map(landed).collect();
            self.from.insert(start, list);
        }
    }

    /// Finds the path of the fewest moves, and of these the one of the least travel, from the upright posture at
    /// `from` to a landing in state `to`, on a floor of this size; `None` if there is none.
    pub fn walk(&self, table: &Table, from: GridState, to: GridState, size: (i16, i16)) -> Option<Walk> {
        let upright = table.find(Posture::zero(table.kind()))?;
        let limits = SearchLimits { memory: 256 << 20, work: u64::MAX };
        let mut search =
            Search::new(Floor { moves: self, to, size }, &(from, upright), limits, Method::astar());
        match search.advance(u64::MAX) {
            Step::Done(Outcome::Solved { path, .. }) => {
                Some(Walk { moves: path.cost / MOVE_COST, degrees: path.cost % MOVE_COST * UNIT })
            }
            _ => None,
        }
    }
}

/// Returns the least travel to every posture, in units of 30°.
fn least_travel(start: u16, steps_at: &[Vec<(u16, Cost)>]) -> Vec<Option<Cost>> {
    let mut travel = vec![None; steps_at.len()];
    let mut open = BTreeSet::from([(0, start)]);
    travel[usize::from(start)] = Some(0);
    while let Some((cost, at)) = open.pop_first() {
        for (to, units) in &steps_at[usize::from(at)] {
            let known = &mut travel[usize::from(*to)];
            if known.is_none_or(|k| cost + units < k) {
                if let Some(k) = known.replace(cost + units) {
                    open.remove(&(k, *to));
                }
                open.insert((cost + units, *to));
            }
        }
    }
    travel
}

/// The moves on a floor.
struct Floor<'a> {
    moves: &'a MoveGraph,
    to: GridState,
    size: (i16, i16),
}

impl Space for Floor<'_> {
    type State = (GridState, u16);
    type Action = ();

    fn key_width(&self) -> usize {
        7
    }
    fn key(&self, (foot, posture): &Self::State, key: &mut [u8]) {
        key[..2].copy_from_slice(&foot.x.to_be_bytes());
        key[2..4].copy_from_slice(&foot.y.to_be_bytes());
        key[4] = foot.class;
        key[5..].copy_from_slice(&posture.to_be_bytes());
    }
    fn state(&self, key: &[u8]) -> Self::State {
        let number = |i: usize| i16::from_be_bytes([key[i], key[i + 1]]);
        (GridState::new(number(0), number(2), key[4]), u16::from_be_bytes([key[5], key[6]]))
    }
    fn expand(&self, (foot, posture): &Self::State, visit: &mut impl FnMut((), Cost, &Self::State)) {
        for (next, landing, travel) in self.moves.from.get(posture).into_iter().flatten() {
            let to = foot.then(*landing);
            if (0..self.size.0).contains(&to.x) && (0..self.size.1).contains(&to.y) {
                visit((), MOVE_COST + travel, &(to, *next));
            }
        }
    }
    /// A move is at most three connectors long.
    fn lower(&self, (foot, _): &Self::State) -> Option<Cost> {
        let distance = foot.x.abs_diff(self.to.x) + foot.y.abs_diff(self.to.y);
        Some(if *foot == self.to { 0 } else { Cost::from(distance.div_ceil(3)).max(1) * MOVE_COST })
    }
    fn is_goal(&self, (foot, _): &Self::State) -> bool {
        *foot == self.to
    }
}

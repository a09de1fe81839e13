//! Calls: when nothing moves any more though goal cells are unfilled, the director leads modules there that hear of none,
//! because dead modules pass no distances on. It looks for a plan by the rules that the modules follow, one module
//! first, and calls them one after the other ([`Order::Call`]). What a module does is still up to its own checks:
//! a wrong or late call costs time.
//!
//! Nothing is called as long as nothing is broken, so runs without faults are as they would be without calls.

use crate::cube::reachability::{PlannedMove, StandstillSnapshot, plan};
use crate::cube::world::CubeWorld;
use metamorph_protocol::cube::call::{MAX_STEPS, Step, Way};
use metamorph_protocol::cube::control::Order;
use metamorph_protocol::cube::params::Params;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::{BTreeSet, VecDeque};

/// The largest number of modules that a plan is looked for, one by one.
const CANDIDATES: usize = 16;
/// The largest number of arrangements in each search.
const ARRANGEMENTS: usize = 3_000;
/// The largest number of cells in the arrangements of all searches for one module together.
const EFFORT: usize = 3_000_000;
/// The largest number of modules of a swarm in which plans of several modules are looked for.
const TOGETHER: usize = 48;
/// How long a called module may take to set out, in moves.
const TO_SET_OUT: u64 = 24;
/// How long a called module may take for each step, in moves.
const PER_STEP: u64 = 8;
/// How long nothing must move before the next call, in moves, once calls have filled a cell.
const PAUSE: u64 = 12;
/// The largest number of plans that are given up before one more cell is filled.
const MOST_GIVEN_UP: u8 = 16;

/// A call that has been sent.
#[derive(Clone, Copy, Debug, Hash)]
struct Sent {
    module: ModuleId,
    from: Cell,
    to: Cell,
    /// The time by which the module must have left its cell.
    leaves_by: Time,
    until: Time,
}

/// The calls of a run.
#[derive(Clone, Debug, Default, Hash)]
pub(super) struct Calls {
    /// The ways that are left of the present plan.
    ways: VecDeque<Way>,
    sent: Option<Sent>,
    /// Modules that did not set out, since the last news.
    refused: BTreeSet<ModuleId>,
    /// The number of plans given up since the last news.
    given_up: u8,
    /// When a cell was last filled or something broke.
    news: Time,
    /// When no plan was found: not before this time is another looked for.
    next: Time,
    /// True if calls have filled a cell since something last broke.
    is_fruitful: bool,
}

/// What the director knows of the progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    /// When a cell was last filled.
    pub last_fill: Time,
    /// When something last broke.
    pub last_fault: Time,
    /// When something last moved.
    pub last_move: Time,
    /// How long nothing must have moved before the first call.
    pub patience: Span,
}

impl Calls {
    /// Calls the next module of a plan, and makes a plan if nothing has moved for long.
    pub fn tend(
        &mut self,
        now: Time,
        standing: Standing,
        world: &mut CubeWorld,
        snapshot: &dyn Fn(&CubeWorld) -> StandstillSnapshot,
        (epoch, params): (u16, &Params),
        commands: &mut VecDeque<Command<Order>>,
    ) {
        let news = standing.last_fill.max(standing.last_fault);
        if news != self.news {
            let are_done = self.ways.is_empty() && self.sent.is_some();
            let is_fruitful = standing.last_fill > standing.last_fault && (self.is_fruitful || are_done);
            *self = Calls { news, is_fruitful, ..Calls::default() };
        }
        self.watch(now, world);
        if self.sent.is_some() || self.given_up >= MOST_GIVEN_UP {
            return;
        }
        let changed = news.max(standing.last_move);
        let patience = if self.is_fruitful { params.move_time * PAUSE } else { standing.patience };
        if self.ways.is_empty() && now.since(changed) > patience && now >= self.next {
            let snapshot = snapshot(world);
            self.ways = self.find(world, &snapshot).unwrap_or_default();
            if self.ways.is_empty() {
                // Walkers that rest take a place in the forest meanwhile, and carry others then.
                self.next = now + standing.patience;
            }
        }
        if let Some(way) = self.ways.pop_front() {
            self.call(now, way, world, (epoch, params), commands);
        }
    }

    /// Drops the plan if the called module does not come.
    fn watch(&mut self, now: Time, world: &CubeWorld) {
        let Some(sent) = self.sent else { return };
        let at = world.cell(sent.module);
        let stays = at == sent.from && !world.is_moving(sent.module);
        if at == sent.to && !world.is_moving(sent.module) && !self.ways.is_empty() {
            self.sent = None;
        } else if now > sent.until || (stays && now > sent.leaves_by) {
            if stays {
                self.refused.insert(sent.module);
            }
            self.given_up += 1;
            (self.sent, self.ways) = (None, VecDeque::new());
        }
    }

    fn call(
        &mut self,
        now: Time,
        way: Way,
        world: &CubeWorld,
        (epoch, params): (u16, &Params),
        commands: &mut VecDeque<Command<Order>>,
    ) {
        let Some(module) = world.body_at(way.from()) else { return self.ways.clear() };
        let steps = way.steps().count() as u64;
        let arrives_by = now + params.move_time * (TO_SET_OUT + PER_STEP * steps);
        // At the end of the last way it waits until the cell may be started out of turn.
        let until = if self.ways.is_empty() { arrives_by + params.out_of_turn_after } else { arrives_by };
        let leaves_by = now + params.move_time * TO_SET_OUT;
        self.sent = Some(Sent { module, from: way.from(), to: way.to(), leaves_by, until });
        commands.push_back(Command::Order(module, Order::Call { epoch, until, way }));
    }

    /// Returns the ways of a plan that fills one more cell: of the module with the shortest way or, in a small swarm, of
    /// several modules.
    fn find(&self, world: &mut CubeWorld, snapshot: &StandstillSnapshot) -> Option<VecDeque<Way>> {
        let mut snapshot = snapshot.clone();
        let arrangements = (EFFORT / CANDIDATES / snapshot.modules.len().max(1)).min(ARRANGEMENTS);
        let may_go: Vec<usize> = (0..snapshot.modules.len())
            .filter(|i| {
                let (m, id) = (&snapshot.modules[*i], ModuleId(*i as u32));
                m.alive && !(m.stuck || m.finalized || m.pinned) && !self.refused.contains(&id)
            })
            .collect();
        for (i, module) in snapshot.modules.iter_mut().enumerate() {
            module.pinned |= may_go.binary_search(&i).is_err();
        }
        let together = (snapshot.modules.len() <= TOGETHER).then(|| snapshot.clone());
        let unfilled = snapshot.unfilled();
        let distance = |i: &usize| unfilled.iter().map(|c| c.manhattan(snapshot.modules[*i].cell)).min();
        let mut nearest: Vec<(Option<u32>, usize)> = may_go.iter().map(|i| (distance(i), *i)).collect();
        nearest.sort_unstable();
        let is_removable = |(_, i): &(Option<u32>, usize)| world.is_removable(ModuleId(*i as u32));
        let nearest: Vec<(Option<u32>, usize)> =
            nearest.into_iter().filter(is_removable).take(CANDIDATES).collect();
        snapshot.modules.iter_mut().for_each(|m| m.pinned = true);
        let mut best: Option<Vec<PlannedMove>> = None;
        for (_, i) in nearest {
            snapshot.modules[i].pinned = false;
            let found = plan(&snapshot, arrangements);
            snapshot.modules[i].pinned = true;
            if let Some(found) = found.filter(|f| best.as_ref().is_none_or(|b| f.len() < b.len())) {
                best = Some(found);
            }
        }
        let best = best.or_else(|| plan(&together?, ARRANGEMENTS))?;
        Some(ways(&best))
    }
}

/// Returns a plan as ways, each of one module.
fn ways(plan: &[PlannedMove]) -> VecDeque<Way> {
    let mut ways = VecDeque::new();
    let mut rest = plan;
    while let Some(first) = rest.first() {
        let (mut at, mut steps) = (first.from, Vec::new());
        for planned in rest.iter().take(MAX_STEPS).take_while(|planned| {
            let follows = planned.from == at;
            at = planned.motion.destination(planned.from);
            follows
        }) {
            steps.push(Step { motion: planned.motion, lands_on_fixed: planned.lands_on_fixed });
        }
        rest = &rest[steps.len()..];
        ways.extend(Way::new(first.from, &steps));
    }
    ways
}

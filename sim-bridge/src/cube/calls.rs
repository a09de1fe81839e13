//! Calls: when nothing moves any more though goal cells are unfilled, the director leads modules there that hear of none,
//! because dead modules pass no distances on. It looks for a plan by the rules that the modules follow, one module
//! first, and calls them one after the other ([`Order::Call`]). What a module does is still up to its own checks:
//! a wrong or late call costs time.
//!
//! Nothing is called as long as nothing is broken, so runs without faults are as they would be without calls.

use crate::cube::diagnosis::Known;
use crate::cube::reachability::{PlannedMove, StandstillSnapshot, plan};
use crate::cube::world::CubeWorld;
use metamorph_protocol::cube::call::{MAX_STEPS, Step, Walk};
use metamorph_protocol::cube::control::Order;
use metamorph_protocol::cube::epoch::Epoch;
use metamorph_protocol::cube::params::Params;
use metamorph_protocol::ids::{ModuleId, Token};
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

/// A part of a plan: the way of one module.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Segment {
    way: Walk,
    /// The cell of the module that the only step lands on, if the mover cannot ask it for consent and it may leave.
    unasked: Option<Cell>,
}

/// A module that has been asked to carry the called one.
#[derive(Clone, Copy, Debug, Hash)]
struct Asked {
    segment: Segment,
    carrier: ModuleId,
    mover: ModuleId,
    until: Time,
}

#[derive(Clone, Copy, Debug, Hash)]
struct Sent {
    module: ModuleId,
    way: Walk,
    /// The number of steps that it has made.
    made: usize,
    leaves_by: Time,
    until: Time,
}

#[derive(Clone, Debug, Default, Hash)]
pub(super) struct Calls {
    /// The rest of the present plan.
    segments: VecDeque<Segment>,
    asked: Option<Asked>,
    /// The number of requests made for called modules.
    requests: u32,
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
    /// The number of moves of called modules in the run.
    called: u64,
    /// The number of plans in the run.
    plans: u64,
}

/// The swarm, as the director knows it.
#[derive(Clone, Copy)]
pub(super) struct Swarm<'a> {
    pub epoch: Epoch,
    pub params: &'a Params,
    pub known: &'a [Known],
}

/// The director's knowledge of the progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct CallProgress {
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
    /// Returns the number of moves that called modules have made in the run.
    pub fn called(&self) -> u64 {
        self.called
    }
    /// Returns the number of plans that were made in the run.
    pub fn plans(&self) -> u64 {
        self.plans
    }

    /// Returns true while a module is called, or asked to carry the called one.
    pub fn is_active(&self) -> bool {
        self.asked.is_some() || self.sent.is_some()
    }

    /// Counts the steps that the called module has made.
    pub fn count(&mut self, world: &CubeWorld) {
        let Some(sent) = &mut self.sent else { return };
        let at = world.cell(sent.module);
        if let Some(made) = sent.way.cells().position(|cell| cell == at) {
            self.called += made.saturating_sub(sent.made) as u64;
            sent.made = made.max(sent.made);
        }
    }

    /// Calls the next module of a plan, and makes a plan if nothing has moved for long.
    pub fn tend(
        &mut self,
        now: Time,
        progress: CallProgress,
        world: &mut CubeWorld,
        snapshot: &dyn Fn(&CubeWorld) -> StandstillSnapshot,
        swarm: Swarm<'_>,
        commands: &mut VecDeque<Command<Order>>,
    ) {
        let news = progress.last_fill.max(progress.last_fault);
        if news != self.news {
            let are_done = self.segments.is_empty() && self.sent.is_some();
            let is_fruitful = progress.last_fill > progress.last_fault && (self.is_fruitful || are_done);
            let Calls { requests, called, plans, .. } = *self;
            *self = Calls { news, is_fruitful, requests, called, plans, ..Calls::default() };
        }
        self.watch(now, world);
        if let Some(asked) = self.asked {
            self.follow_up(now, asked, swarm, commands);
        }
        if self.asked.is_some() || self.sent.is_some() || self.given_up >= MOST_GIVEN_UP {
            return;
        }
        let changed = news.max(progress.last_move);
        let patience = if self.is_fruitful { swarm.params.move_time * PAUSE } else { progress.patience };
        if self.segments.is_empty() && now.since(changed) > patience && now >= self.next {
            let snapshot = snapshot(world);
            self.segments = self.find(world, &snapshot).unwrap_or_default();
            if self.segments.is_empty() {
                // Walkers that rest take a place in the forest meanwhile, and carry others then.
                self.next = now + progress.patience;
            } else {
                self.plans += 1;
            }
        }
        if let Some(segment) = self.segments.pop_front() {
            self.call(now, segment, world, swarm, commands);
        }
    }

    /// Drops the plan if the called module does not come.
    fn watch(&mut self, now: Time, world: &CubeWorld) {
        let Some(sent) = self.sent else { return };
        let at = world.cell(sent.module);
        let stays = at == sent.way.from() && !world.is_moving(sent.module);
        if at == sent.way.to() && !world.is_moving(sent.module) && !self.segments.is_empty() {
            self.sent = None;
        } else if now > sent.until || (stays && now > sent.leaves_by) {
            if stays {
                self.refused.insert(sent.module);
            }
            self.give_up();
        }
    }

    fn give_up(&mut self) {
        self.given_up += 1;
        (self.sent, self.asked, self.segments) = (None, None, VecDeque::new());
    }

    /// Calls the mover once the module that it lands on has granted that.
    fn follow_up(
        &mut self,
        now: Time,
        asked: Asked,
        swarm: Swarm<'_>,
        commands: &mut VecDeque<Command<Order>>,
    ) {
        let granted = swarm.known[asked.carrier.index()].status.and_then(|status| status.carries);
        if now >= asked.until {
            self.give_up();
        } else if granted == Some(Token(self.requests)) {
            self.asked = None;
            self.call_until(asked.until, asked.mover, asked.segment.way, swarm, commands);
        }
    }

    /// Calls a module for one step, which it starts before `until` or not at all.
    fn call_until(
        &mut self,
        until: Time,
        module: ModuleId,
        way: Walk,
        Swarm { epoch, params, .. }: Swarm<'_>,
        commands: &mut VecDeque<Command<Order>>,
    ) {
        let arrives_by = until + params.move_time * 2;
        self.sent = Some(Sent { module, way, made: 0, leaves_by: until, until: arrives_by });
        commands.push_back(Command::Order(module, Order::Call { epoch, until, way }));
    }

    fn call(
        &mut self,
        now: Time,
        segment: Segment,
        world: &CubeWorld,
        swarm: Swarm<'_>,
        commands: &mut VecDeque<Command<Order>>,
    ) {
        let (Segment { way, .. }, Swarm { epoch, params, known }) = (segment, swarm);
        let Some(module) = world.body_at(way.from()) else { return self.segments.clear() };
        if let Some(carrier) = segment.unasked.and_then(|cell| world.body_at(cell)) {
            // Grants from now on outlast the move of a call that ends at this time. So does the quarantine of a dead
            // module that is restarted.
            let until = now + params.start_within();
            if !known[carrier.index()].alive {
                return self.call_until(until, module, way, swarm, commands);
            }
            let carries_at = way.to();
            let Some(face) = world.cell(carrier).face_to(carries_at) else { return self.segments.clear() };
            self.requests += 1;
            self.asked = Some(Asked { segment, carrier, mover: module, until });
            let token = Token(self.requests);
            let order = Order::Carry { epoch, mover: module, token, face };
            return commands.push_back(Command::Order(carrier, order));
        }
        let steps = way.steps().count() as u64;
        let arrives_by = now + params.move_time * (TO_SET_OUT + PER_STEP * steps);
        // At the end of the last way it waits until the cell may be started out of turn.
        let until = if self.segments.is_empty() { arrives_by + params.out_of_turn_after } else { arrives_by };
        let leaves_by = now + params.move_time * TO_SET_OUT;
        self.sent = Some(Sent { module, way, made: 0, leaves_by, until });
        commands.push_back(Command::Order(module, Order::Call { epoch, until, way }));
    }

    /// Returns the parts of a plan that fills one more cell: of the module with the shortest way or, in a small
    /// swarm, of several modules.
    fn find(&self, world: &mut CubeWorld, snapshot: &StandstillSnapshot) -> Option<VecDeque<Segment>> {
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
        Some(segments(&best))
    }
}

/// Returns a plan in parts, each the way of one module. A step onto a module that has to be asked first is a part of
/// its own.
fn segments(plan: &[PlannedMove]) -> VecDeque<Segment> {
    let is_asked_first = |planned: &PlannedMove| planned.is_unasked && !planned.lands_on_fixed;
    let mut rest = plan;
    let segment = |way: Walk| {
        let first = rest[0];
        rest = &rest[way.steps().count()..];
        let landing = first.motion.destination(first.from).step(first.motion.landing_support());
        Segment { way, unasked: is_asked_first(&first).then_some(landing) }
    };
    ways(plan, &is_asked_first).map(segment).collect()
}

/// Iterates over the ways of a plan, each of one module. A move for which `is_apart` holds begins a way.
pub(super) fn ways(
    plan: &[PlannedMove],
    is_apart: &dyn Fn(&PlannedMove) -> bool,
) -> impl Iterator<Item = Walk> {
    let mut rest = plan;
    std::iter::from_fn(move || {
        let mut at = rest.first()?.from;
        let follows = |planned: &&PlannedMove| {
            let follows = planned.from == at && !is_apart(planned);
            at = planned.motion.destination(planned.from);
            follows
        };
        let count = rest.iter().take(MAX_STEPS).take_while(follows).count().max(1);
        let (part, others) = rest.split_at(count);
        let step = |p: &PlannedMove| Step { motion: p.motion, is_vouched: p.is_unasked };
        let steps: Vec<Step> = part.iter().map(step).collect();
        rest = others;
        Walk::new(part[0].from, &steps)
    })
}

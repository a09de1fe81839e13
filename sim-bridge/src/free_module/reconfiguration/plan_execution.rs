//! Carries plans out: senses, plans, orders steps as those before them are confirmed, and plans again when a step
//! fails, a module dies or comes back.
//!
//! Each plan has an epoch. At its beginning all modules are told to finish what they do; it is made from what they report
//! when they rest. A connection that only one side holds is first opened again. What cannot act counts as frozen: the
//! dead and the silent do nothing and are not moved, a module with a stuck joint does not turn. Planning takes scenario
//! time: its work divided by [`PLANNING_RATE`].

use metamorph_protocol::assembly::action::Action;
use metamorph_protocol::assembly::configuration::{Configuration, Module};
use metamorph_protocol::assembly::space::Assembly;
use metamorph_protocol::free_module::reconfiguration::LatticeSetup;
use metamorph_protocol::free_module::reconfiguration::message::{
    Failure, LatticeBodyAction, LatticeOrder, LatticeStatus, StepName, StepResult,
};
use metamorph_protocol::free_module::reconfiguration::place::{LatticePlace, configuration};
use metamorph_protocol::free_module::reconfiguration::planning::{Frozen, Plan, Planned, Planner};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::{BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

/// Expansions of the planner in one second of scenario time.
pub const PLANNING_RATE: u64 = 20_000;
/// Largest number of tries of a connection in one plan.
const TRIES_MAX: u8 = 4;
/// Plans in a row, without a step confirmed in between, after which the modules rest.
const REPLANS: u32 = 8;
/// Factor of the patience for a module that is being restarted: the time of a restart depends on the machine.
const RESTART_PATIENCE: u64 = 32;

/// Counts of plans and orders in a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReconfigurationCounts {
    /// Plans made.
    pub plans: u64,
    /// Actions of the first plan.
    pub actions: u64,
    /// The cost of the first plan.
    pub cost: u64,
    /// The proven lower bound of the cost of the first plan.
    pub bound: u64,
    /// A number by which first plans are told apart.
    pub hash: u64,
    /// Orders of steps, without repeats.
    pub orders: u64,
    /// Orders repeated.
    pub repeated: u64,
    /// Actions confirmed.
    pub confirmed: u64,
    /// Steps that failed.
    pub failed: u64,
    /// Steps without an answer in time.
    pub late: u64,
    /// Work of planning, in expansions.
    pub work: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Known {
    pub alive: bool,
    /// True once it has started.
    pub launched: bool,
    /// True from the command to restart it until it has started again.
    pub restarting: bool,
    pub status: Option<LatticeStatus>,
    /// Where the body of a module is that is dead, or has not reported yet.
    pub body: LatticePlace,
}

impl Known {
    fn place(&self) -> LatticePlace {
        self.status.filter(|_| self.alive).map_or(self.body, |status| status.place)
    }
}

/// Why there is nothing to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shortage {
    /// No plan exists: this many configurations were examined.
    NoPlan(u64),
    /// A limit was reached.
    Undecided,
    /// Plans could not be carried out.
    NotCarriedOut,
}

#[derive(Clone, Debug)]
pub(super) struct Confirmed {
    pub epoch: u32,
    pub index: usize,
    pub sides: Vec<ModuleId>,
    pub after: Vec<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Modules finish what they do, since this time.
    Holding { since: Time, repeat_at: Time },
    /// A plan is made until this time.
    Planning(Time),
    /// The plan is carried out.
    Moving,
    /// It has been carried out. If the goal is not there, another one is made.
    Finished,
    /// There is no plan; what seems stuck or silent is tried again at this time.
    Waiting(Time),
    /// There is nothing to do until something changes.
    Resting,
}

#[derive(Clone, Copy, Debug)]
struct Sent {
    not_after: Time,
    repeat_at: Time,
}

/// Part of one module in an action.
#[derive(Clone, Copy, Debug)]
struct Side {
    id: ModuleId,
    body_action: LatticeBodyAction,
    expect: (u8, u16),
    attempt: u8,
    sent: Option<Sent>,
    done: bool,
}

#[derive(Clone, Debug)]
struct Step {
    sides: Vec<Side>,
    after: Vec<usize>,
    done: bool,
}

/// The space of plans, once there was a plan. Never locked by two: the mutex is for types that are not `Sync`. It is a cache, so
/// a copy begins without one.
#[derive(Default)]
struct PlanSpace(Option<Mutex<Assembly>>);

impl Clone for PlanSpace {
    fn clone(&self) -> PlanSpace {
        PlanSpace::default()
    }
}

/// The plan of a structure, and how far it is carried out.
#[derive(Clone)]
pub(super) struct PlanExecution {
    setup: Arc<LatticeSetup>,
    planner: Planner,
    space: PlanSpace,
    stage: Stage,
    epoch: u32,
    steps: Vec<Step>,
    disturbed: bool,
    stuck: BTreeSet<ModuleId>,
    silent: BTreeSet<ModuleId>,
    /// The dead that plans have been made without.
    given_up: BTreeSet<ModuleId>,
    replans: u32,
    pub shortage: Option<Shortage>,
    pub counts: ReconfigurationCounts,
}

type Orders = VecDeque<Command<LatticeOrder>>;

impl PlanExecution {
    pub fn new(setup: Arc<LatticeSetup>, planner: Planner) -> PlanExecution {
        PlanExecution {
            setup,
            planner,
            space: PlanSpace::default(),
            stage: Stage::Holding { since: Time::ZERO, repeat_at: Time::ZERO },
            epoch: 1,
            steps: Vec::new(),
            disturbed: false,
            stuck: BTreeSet::new(),
            silent: BTreeSet::new(),
            given_up: BTreeSet::new(),
            replans: 0,
            shortage: None,
            counts: ReconfigurationCounts::default(),
        }
    }

    /// Returns how plans are made.
    pub fn planner(&self) -> &Planner {
        &self.planner
    }
    /// Returns true if there is nothing to do until something changes.
    pub fn is_resting(&self) -> bool {
        self.stage == Stage::Resting
    }
    /// Returns true if steps of a plan are carried out.
    pub fn is_moving(&self) -> bool {
        self.stage == Stage::Moving
    }
    /// Returns true if plans are made without this module because it does not answer.
    pub fn is_silent(&self, id: ModuleId) -> bool {
        self.silent.contains(&id)
    }
    /// Returns the modules with a joint that does not turn.
    pub fn stuck(&self) -> &BTreeSet<ModuleId> {
        &self.stuck
    }

    /// Returns true if plans are made without this module because it is dead.
    pub fn has_given_up(&self, id: ModuleId) -> bool {
        self.given_up.contains(&id)
    }

    /// Requests a new plan: something has changed that plans depend on.
    pub fn disturb(&mut self) {
        self.disturbed = true;
    }

    /// Returns when the execution has to be examined again.
    pub fn wake_at(&self) -> Time {
        match self.stage {
            Stage::Holding { repeat_at, .. } => repeat_at,
            Stage::Planning(at) | Stage::Waiting(at) => at,
            Stage::Moving => {
                let sides = self.steps.iter().flat_map(|step| &step.sides).filter(|side| !side.done);
                sides.filter_map(|side| side.sent).map(|sent| sent.repeat_at).min().unwrap_or(Time::NEVER)
            }
            Stage::Finished => Time::ZERO,
            Stage::Resting => Time::NEVER,
        }
    }

    /// Does what is due. Returns the actions that are confirmed.
    pub fn step(&mut self, now: Time, known: &[Known], orders: &mut Orders) -> Vec<Confirmed> {
        let mut confirmed = Vec::new();
        if std::mem::take(&mut self.disturbed) {
            self.stuck.clear();
            self.silent.clear();
            self.replans = 0;
            self.hold(now, known, orders);
        }
        match self.stage {
            Stage::Holding { since, repeat_at } => self.sense(now, since, repeat_at, known, orders),
            Stage::Planning(ready) if now >= ready => {
                self.stage = Stage::Moving;
                self.dispatch(now, orders);
            }
            Stage::Finished => self.hold(now, known, orders),
            Stage::Moving => self.go_on(now, known, orders, &mut confirmed),
            Stage::Waiting(at) if now >= at => {
                self.stuck.clear();
                self.silent.clear();
                self.hold(now, known, orders);
            }
            Stage::Planning(_) | Stage::Waiting(_) | Stage::Resting => {}
        }
        confirmed
    }

    /// Begins the next epoch: all modules finish what they do.
    fn hold(&mut self, now: Time, known: &[Known], orders: &mut Orders) {
        self.epoch += 1;
        self.steps.clear();
        self.given_up.retain(|id| !known[id.index()].alive);
        self.stage = Stage::Holding { since: now, repeat_at: now };
        self.sense(now, now, now, known, orders);
    }

    /// Waits until all modules rest and have reported; then plans.
    fn sense(&mut self, now: Time, since: Time, repeat_at: Time, known: &[Known], orders: &mut Orders) {
        let rests = |k: &Known| k.alive && k.status.is_some_and(|s| s.epoch == self.epoch && !s.busy);
        let all = (0..).map(ModuleId).zip(known);
        let awaited = |id: &ModuleId| !self.given_up.contains(id) && !self.silent.contains(id);
        let missing: Vec<ModuleId> =
            all.filter(|(_, k)| !rests(k)).map(|(id, _)| id).filter(awaited).collect();
        let is_restarting = missing.iter().any(|id| known[id.index()].restarting);
        let patience = self.setup.patience * if is_restarting { RESTART_PATIENCE } else { 1 };
        // A module restarted during a turn takes its body for resting until the turn ends.
        let is_behind = || !fit(&known.iter().map(Known::place).collect::<Vec<_>>());
        if (!missing.is_empty() || is_behind()) && now < since + patience {
            if now >= repeat_at {
                let living = missing.iter().filter(|id| known[id.index()].alive);
                let hold = |id: &ModuleId| Command::Order(*id, LatticeOrder::Hold { epoch: self.epoch });
                orders.extend(living.map(hold));
                let repeat_at = now + self.setup.resend * 4;
                self.stage = Stage::Holding { since, repeat_at };
            }
            return;
        }
        for id in missing {
            if known[id.index()].alive {
                self.silent.insert(id)
            } else {
                self.given_up.insert(id)
            };
        }
        self.plan(now, known, orders);
    }

    /// Returns what cannot act, and the configuration that it leaves.
    fn frozen(&self, known: &[Known]) -> Frozen {
        let bits = |of: &BTreeSet<ModuleId>| of.iter().fold(0, |all, id| all | 1 << id.0);
        let dead = known.iter().enumerate().filter(|(_, k)| !k.alive).fold(0, |all, (i, _)| all | 1 << i);
        Frozen { joints: bits(&self.stuck), dead: dead | bits(&self.silent) }
    }

    /// Returns steps that open the connections that one side holds.
    fn tidied(&self, places: &[LatticePlace], frozen: Frozen) -> Vec<Step> {
        let Some(state) = configuration(places) else { return Vec::new() };
        let mut steps = Vec::new();
        state.facing(|pair| {
            let holds = |(module, connector): (u8, u8)| places[usize::from(module)].is_closed(connector);
            let (held, free) = match (holds(pair.a), holds(pair.b)) {
                (true, false) => (pair.a, pair.b),
                (false, true) => (pair.b, pair.a),
                _ => return,
            };
            let can_act = |(module, _): (u8, u8)| frozen.dead >> module & 1 == 0;
            // A connector that a dead module holds stays so; then the other side holds as well.
            let (site, body_action) = match (can_act(held), can_act(free)) {
                (true, _) => (held, LatticeBodyAction::Detach(held.1)),
                (false, true) => (free, LatticeBodyAction::Attach(free.1)),
                (false, false) => return,
            };
            let place = places[usize::from(site.0)];
            let side = Side::new(site.0, body_action, (place.posture, place.closed));
            steps.push(Step { sides: vec![side], after: Vec::new(), done: false });
        });
        steps
    }

    fn plan(&mut self, now: Time, known: &[Known], orders: &mut Orders) {
        let places: Vec<LatticePlace> = known.iter().map(Known::place).collect();
        let frozen = self.frozen(known);
        if self.replans >= REPLANS {
            return self.give_up(now, Shortage::NotCarriedOut);
        }
        if !fit(&places) {
            return self.give_up(now, Shortage::Undecided);
        }
        self.replans += 1;
        self.steps = self.tidied(&places, frozen);
        if !self.steps.is_empty() {
            self.stage = Stage::Moving;
            return self.dispatch(now, orders);
        }
        let Some(start) = configuration(&agreed(&places)) else {
            return self.give_up(now, Shortage::Undecided);
        };
        let planner = &self.planner;
        let space = self.space.0.get_or_insert_with(|| Mutex::new(planner.space(start.len())));
        let space = space.get_mut().unwrap_or_else(PoisonError::into_inner);
        let (planned, work) = planner.plan(space, &start, frozen);
        self.counts.work += work;
        match planned {
            Planned::Plan(plan) => {
                self.note(&plan);
                self.shortage = None;
                self.steps = self.steps_of(&plan, &start);
                self.stage = Stage::Planning(now + Span(work.saturating_mul(1_000_000_000) / PLANNING_RATE));
            }
            Planned::Impossible(states) => self.give_up(now, Shortage::NoPlan(states)),
            Planned::Undecided => self.give_up(now, Shortage::Undecided),
        }
    }

    fn note(&mut self, plan: &Plan) {
        if self.counts.plans == 0 {
            self.counts.actions = plan.actions.len() as u64;
            (self.counts.cost, self.counts.bound) = (plan.cost.into(), plan.lower.into());
            self.counts.hash = plan.hash();
        }
        self.counts.plans += 1;
    }

    /// Rests, or tries what seemed stuck or silent again after a while.
    fn give_up(&mut self, now: Time, shortage: Shortage) {
        self.shortage = Some(shortage);
        let may_change = !self.stuck.is_empty() || !self.silent.is_empty();
        self.stage = if may_change && self.replans < REPLANS {
            Stage::Waiting(now + self.setup.patience)
        } else {
            Stage::Resting
        };
    }

    /// Returns the steps of a plan, each with the state for which it is planned.
    fn steps_of(&self, plan: &Plan, start: &Configuration) -> Vec<Step> {
        let rules = self.planner.rules();
        let mut at = *start;
        let mut steps = Vec::new();
        for (action, after) in plan.actions.iter().zip(&plan.after) {
            let action_counts = match *action {
                Action::Attach(pair) => {
                    [pair.a, pair.b].map(|(m, c)| (m, LatticeBodyAction::Attach(c))).to_vec()
                }
                Action::Detach(pair) => {
                    [pair.a, pair.b].map(|(m, c)| (m, LatticeBodyAction::Detach(c))).to_vec()
                }
                Action::Turn { module, joint, positive } => {
                    vec![(module, LatticeBodyAction::Turn { joint, positive })]
                }
            };
            let side = |(module, body_action): (u8, LatticeBodyAction)| {
                let m = at.modules()[usize::from(module)];
                Side::new(module, body_action, (m.posture, m.held))
            };
            let sides = action_counts.into_iter().map(side).collect();
            steps.push(Step { sides, after: after.clone(), done: false });
            at = rules.apply(&at, *action).expect("invariant: the planner followed this action");
        }
        steps
    }

    /// Orders all steps whose predecessors are confirmed, and repeats orders without an answer.
    fn dispatch(&mut self, now: Time, orders: &mut Orders) {
        for index in 0..self.steps.len() {
            let is_due = self.steps[index].after.iter().all(|before| self.steps[*before].done);
            if !is_due || self.steps[index].done {
                continue;
            }
            let (epoch, window, repeat) = (self.epoch, self.setup.window(), self.setup.resend * 4);
            for side in self.steps[index].sides.iter_mut().filter(|side| !side.done) {
                let not_after = match &mut side.sent {
                    None => {
                        self.counts.orders += 1;
                        let not_after = now + window;
                        side.sent = Some(Sent { not_after, repeat_at: now + repeat });
                        not_after
                    }
                    Some(sent) if now >= sent.repeat_at => {
                        self.counts.repeated += 1;
                        sent.repeat_at = now + repeat;
                        sent.not_after
                    }
                    Some(_) => continue,
                };
                let step = StepName { epoch, index: index as u16, attempt: side.attempt };
                let order = LatticeOrder::Step {
                    step,
                    body_action: side.body_action,
                    expect: side.expect,
                    not_after,
                };
                orders.push_back(Command::Order(side.id, order));
            }
        }
    }

    /// Takes the results that have been reported, and orders what is due then.
    fn go_on(&mut self, now: Time, known: &[Known], orders: &mut Orders, confirmed: &mut Vec<Confirmed>) {
        let mut anew = false;
        for index in 0..self.steps.len() {
            if self.steps[index].done {
                continue;
            }
            for side in 0..self.steps[index].sides.len() {
                anew |= self.take(now, index, side, known);
            }
            let Step { sides, after, done } = &mut self.steps[index];
            if sides.iter().all(|side| side.done) {
                *done = true;
                self.replans = 0;
                self.counts.confirmed += 1;
                let sides = sides.iter().map(|side| side.id).collect();
                confirmed.push(Confirmed { epoch: self.epoch, index, sides, after: after.clone() });
            }
        }
        if anew {
            self.hold(now, known, orders);
        } else if self.steps.iter().all(|step| step.done) {
            self.stage = Stage::Finished;
        } else {
            self.dispatch(now, orders);
        }
    }

    /// Takes the result of one side. Returns true if another plan is needed.
    fn take(&mut self, now: Time, index: usize, side: usize, known: &[Known]) -> bool {
        let side = &mut self.steps[index].sides[side];
        let Some(sent) = side.sent.filter(|_| !side.done) else { return false };
        let name = StepName { epoch: self.epoch, index: index as u16, attempt: side.attempt };
        let result: Option<StepResult> =
            known[side.id.index()].status.and_then(|s| s.last).filter(|l| l.0 == name).map(|l| l.1);
        match result {
            Some(Ok(())) => side.done = true,
            Some(Err(failure)) => {
                self.counts.failed += 1;
                if failure == Failure::Joint {
                    self.stuck.insert(side.id);
                }
                if failure == Failure::Connection && side.attempt + 1 < TRIES_MAX {
                    side.attempt += 1;
                    side.sent = None;
                    return false;
                }
                return true;
            }
            None => {
                // An action that began in time has ended by then, and has been reported.
                let late = sent.not_after + self.setup.turn_time * 2 + self.setup.resend * 4;
                if now > late {
                    self.counts.late += 1;
                    self.silent.insert(side.id);
                    return true;
                }
            }
        }
        false
    }
}

impl Side {
    fn new(module: u8, body_action: LatticeBodyAction, expect: (u8, u16)) -> Side {
        Side { id: ModuleId(module.into()), body_action, expect, attempt: 0, sent: None, done: false }
    }
}

/// Returns true if no two modules overlap and every closed connector faces a module. Of a turn, the reports of all
/// modules that it moves come one after another, and do not fit until the last has come.
fn fit(places: &[LatticePlace]) -> bool {
    let Some(state) = configuration(places) else { return false };
    let mut filled = BTreeSet::new();
    if !state.modules().iter().flat_map(Module::cells).all(|cell| filled.insert(cell)) {
        return false;
    }
    let mut facing = vec![0_u16; places.len()];
    state.facing(|pair| [pair.a, pair.b].into_iter().for_each(|(m, c)| facing[usize::from(m)] |= 1 << c));
    places.iter().zip(facing).all(|(place, facing)| place.closed & !facing == 0)
}

/// Returns the places with the connections that both sides hold.
fn agreed(places: &[LatticePlace]) -> Vec<LatticePlace> {
    let mut closed = vec![0_u16; places.len()];
    if let Some(state) = configuration(places) {
        state.facing(|pair| {
            let holds = |(m, c): (u8, u8)| places[usize::from(m)].is_closed(c);
            if holds(pair.a) && holds(pair.b) {
                for (m, c) in [pair.a, pair.b] {
                    closed[usize::from(m)] |= 1 << c;
                }
            }
        });
    }
    places.iter().zip(closed).map(|(place, closed)| LatticePlace { closed, ..*place }).collect()
}

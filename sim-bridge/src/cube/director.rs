//! The director of cubes: opens goals, injects faults, certifies deaths, watches progress and decides how the
//! run ends. Sans-IO; both drivers carry out its commands.

use crate::cube::calls::{Calls, Standing, Swarm};
use crate::cube::diagnosis::{Known, diagnose, snapshot};
use crate::cube::global_plan::GlobalPlan;
use crate::cube::reachability::StandstillSnapshot;
use crate::cube::registrar::Registrar;
use crate::cube::world::CubeWorld;
use crate::director::fault_injector::FaultInjector;
use crate::director::faults::{Fault, FaultRecord, Schedule};
use crate::director::outcome::{Outcome, Stall};
use crate::director::port::DirectorPort;
use crate::director::progress::{Progress, Stage, Stop};
use crate::director::steering::Steering as Wish;
use metamorph_protocol::cube::control::{Order, Status};
use metamorph_protocol::cube::epoch::{Epoch, Opening};
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::cube::params::{Connectivity, Setup};
use metamorph_protocol::cube::steering::Steering;
use metamorph_protocol::goal::Goal;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::VecDeque;
use std::sync::Arc;

/// The part of the time without moves that ends a run after which modules are called.
const PATIENCE: u64 = 4;
/// The part of the time without moves, or without a filled cell, that ends a run after which a global plan is made.
const LAST_PATIENCE: u64 = 2;

/// The director of a swarm of cubes.
pub struct Director {
    setup: Arc<Setup>,
    faults: FaultInjector,
    stop: Stop,
    failure: Ratio,
    /// The present epoch.
    opening: Opening,
    global_plan: GlobalPlan,
    stages: Vec<Stage>,
    known: Vec<Known>,
    /// The number of modules that are dead, or finalized in the present stage.
    done: usize,
    registrar: Registrar,
    calls: Calls,
    commands: VecDeque<Command<Order>>,
    filled: usize,
    recount: bool,
    moves: u64,
    last_move: Time,
    last_fault: Time,
    /// The end of the latest lease of a command.
    leased: Time,
    /// Collisions prevented in incarnations that have ended.
    prevented_before: u64,
    last_fill: Time,
    next_check: Time,
    outcome: Option<(Time, Outcome)>,
    stall: Option<Stall>,
}

impl Director {
    /// Creates a director for a swarm of `modules` cubes.
    pub fn new(
        setup: Arc<Setup>,
        modules: usize,
        schedule: Schedule,
        stop: Stop,
        failure: Ratio,
    ) -> Director {
        let opened = |goal: &Goal| Stage {
            cells: goal.len(),
            filled: 0,
            opened: Time::ZERO,
            built: None,
            known: None,
        };
        let stages = setup.goals.first().map(opened).into_iter().collect();
        Director {
            setup,
            faults: FaultInjector::new(schedule),
            stop,
            failure,
            opening: Opening::of(Epoch::default(), Time::ZERO),
            global_plan: GlobalPlan::default(),
            stages,
            known: vec![Known::default(); modules],
            // Modules are dead until they are started.
            done: modules,
            registrar: Registrar::default(),
            calls: Calls::default(),
            commands: VecDeque::new(),
            filled: 0,
            recount: true,
            moves: 0,
            last_move: Time::ZERO,
            last_fault: Time::ZERO,
            leased: Time::ZERO,
            prevented_before: 0,
            last_fill: Time::ZERO,
            next_check: Time::ZERO,
            outcome: None,
            stall: None,
        }
    }

    /// Returns how the run ended, and when; `None` while it goes on.
    pub fn outcome(&self) -> Option<(Time, Outcome)> {
        self.outcome
    }
    /// Returns the standstill that ended the run, if one did.
    pub fn stall(&self) -> Option<&Stall> {
        self.stall.as_ref()
    }
    /// Returns the current state of the swarm as the input of a reachability search.
    pub fn snapshot(&self, world: &CubeWorld) -> StandstillSnapshot {
        let known = (self.known.as_slice(), &self.registrar);
        snapshot(world, known, self.goal(), self.connectivity(), self.opening.epoch)
    }
    /// Returns the effects of the faults so far.
    pub fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
    /// Returns all goals so far.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }
    /// Returns how many processes died, and how many were restarted.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        self.faults.crashed_and_restarted()
    }
    /// Returns the number of collisions that negotiation has prevented, as reported.
    pub fn prevented(&self) -> u64 {
        let now: u64 = self.known.iter().filter_map(|k| k.status).map(|s| u64::from(s.prevented)).sum();
        self.prevented_before + now
    }
    /// Returns the number of moves that the director led by global plans.
    pub fn led(&self) -> u64 {
        self.global_plan.led()
    }
    /// Returns the number of modules whose process is alive.
    pub fn alive(&self) -> usize {
        self.known.iter().filter(|k| k.alive).count()
    }
    /// Returns the progress of the run.
    pub fn progress(&self) -> Progress {
        Progress {
            stage: self.opening.epoch.goal(),
            stages: self.setup.goals.len() as u16,
            goal: self.goal().len(),
            filled: self.filled,
            alive: self.alive(),
            moves: self.moves,
            messages: None,
        }
    }
    /// Returns what is known of each module.
    pub fn known(&self) -> &[Known] {
        &self.known
    }

    /// Ends the run from outside.
    pub fn finish(&mut self, now: Time, outcome: Outcome) {
        if self.outcome.is_none() {
            self.outcome = Some((now, outcome));
            self.commands.push_back(Command::Finish);
        }
    }

    fn goal(&self) -> &Goal {
        // Invariant: the epoch only advances while there is a next goal.
        &self.setup.goals[usize::from(self.opening.epoch.goal())]
    }

    /// Describes the state of a module at the moment of a fault.
    fn found(&self, id: ModuleId, world: &CubeWorld) -> String {
        let known = self.known[id.index()];
        let role = match known.status.map(|s| s.role) {
            _ if !known.alive => "dead",
            Some(Role::Final) => "finalized",
            Some(Role::Walker) => "wandering",
            _ => "in reserve",
        };
        let moving = if world.is_moving(id) { ", moving" } else { "" };
        format!("it was {role} at {}{moving}", world.cell(id))
    }

    fn inject(&mut self, now: Time, fault: Fault, world: &mut CubeWorld) {
        self.last_fault = now;
        let Some(id) = fault.module() else {
            // The scenario reader refuses obstacles among cubes.
            let effect = "cubes have no obstacles but each other".to_owned();
            return self.faults.inject(now, fault, false, effect, &mut self.commands);
        };
        let (alive, mut effect, rule) =
            (self.known[id.index()].alive, self.found(id, world), self.rule(&fault));
        if let Err(rule) = &rule {
            effect = format!("{effect}; refused: {rule}");
        }
        self.faults.inject(now, fault, alive, effect, &mut self.commands);
        match fault {
            Fault::Steer(_, wish) if rule.is_ok() => self.steer(now, id, wish),
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => world.set_stuck(id, false),
            _ => {}
        }
    }

    /// Hands a command that no rule refuses to the module.
    fn steer(&mut self, now: Time, id: ModuleId, wish: Wish) {
        let (steering, lease) = match wish {
            Wish::GoTo(to, lease) => (Steering::GoTo(to), lease),
            Wish::Hold(lease) => (Steering::Hold, lease),
            Wish::Release | Wish::Take(..) | Wish::Swap(_) => (Steering::Release, Span::ZERO),
        };
        let until = now + lease;
        self.leased = self.leased.max(until);
        self.commands.push_back(Command::Order(id, Order::Steer { steering, until }));
    }

    /// Returns the rule that refuses a command, and what to do instead.
    fn rule(&self, fault: &Fault) -> Result<(), String> {
        let Fault::Steer(id, wish) = *fault else { return Ok(()) };
        // An unknown module is refused by its number.
        let Some(known) = self.known.get(id.index()) else { return Ok(()) };
        if matches!(wish, Wish::Take(..) | Wish::Swap(_)) {
            return Err(
                "family: any cube fills any cell of the goal; use `goto`, `hold` or `release`".to_owned()
            );
        }
        if !known.alive {
            return Err(format!("dead: the process of module {id} is dead; restart it first"));
        }
        if known.is_final(self.opening.epoch) {
            return Err(format!("settled: module {id} fills a cell and stays there until the goal changes"));
        }
        Ok(())
    }

    /// Certifies deaths, and forwards who holds the dead.
    fn tell_of_the_dead(&mut self, world: &CubeWorld) {
        let (epoch, seed) = (self.opening.epoch, self.goal().seed());
        self.registrar.tell(world, &self.known, epoch, seed, &mut self.commands);
    }

    /// Counts the goal cells that are filled. Returns true if all are.
    fn count_filled(&mut self, now: Time, world: &CubeWorld) -> bool {
        self.recount = false;
        let (epoch, goal) = (self.opening.epoch, self.goal());
        // No module is finalized while a global plan is carried out.
        let is_led = self.global_plan.is_under_way();
        let is_filled = |id: ModuleId| {
            let k = &self.known[id.index()];
            // A body that still moves fills no cell.
            ((is_led || !k.alive) && !world.is_moving(id)) || k.is_final(epoch)
        };
        let is_filled = |c: &Cell| world.body_at(*c).is_some_and(is_filled);
        let filled = goal.cells().filter(is_filled).count();
        let is_built = filled == goal.len();
        if filled > self.filled {
            self.last_fill = now;
        }
        self.filled = filled;
        if let Some(stage) = self.stages.last_mut() {
            stage.filled = filled;
        }
        is_built
    }

    fn next_stage(&mut self, now: Time) {
        if let Some(stage) = self.stages.last_mut() {
            stage.built = Some(now);
        }
        let next = self.opening.epoch.next_goal();
        if usize::from(next.goal()) == self.setup.goals.len() {
            return self.finish(now, Outcome::Built);
        }
        self.open(Opening::of(next, now));
        self.stages.push(Stage {
            cells: self.goal().len(),
            filled: 0,
            opened: now,
            built: None,
            known: None,
        });
    }

    /// Begins an epoch.
    fn open(&mut self, opening: Opening) {
        self.opening = opening;
        self.done = self.count_done();
        self.filled = 0;
        self.recount = true;
        (self.last_fill, self.last_move) = (opening.opened, opening.opened);
        for id in (0..self.known.len() as u32).map(ModuleId) {
            self.commands.push_back(Command::Order(id, Order::Goal(opening)));
        }
    }

    fn watch(&mut self, now: Time, world: &mut CubeWorld) {
        let motions = world.motions();
        // Moves that fail are no progress: a stuck module tries again and again.
        if motions.completed != self.moves {
            self.moves = motions.completed;
            self.last_move = now;
        }
        let is_checked = now >= self.next_check || (self.recount && self.may_be_built());
        if is_checked {
            self.next_check = now + self.setup.params.move_time;
            let is_built = self.count_filled(now, world);
            if self.global_plan.is_under_way() {
                self.lead(now, world);
            } else if is_built {
                return self.next_stage(now);
            }
        }
        let planned = self.faults.is_pending() || now < self.stop.planned_until || now < self.leased;
        let changed = self.last_fault.max(self.stop.planned_until).max(self.leased);
        let idle_since = self.last_move.max(self.last_fill).max(changed);
        let unfilled_since = self.last_fill.max(changed);
        if now >= self.stop.timeout {
            self.stall = Some(self.explain(world, idle_since));
            self.finish(now, Outcome::Timeout);
        } else if planned {
            // Further events are planned.
        } else if now.since(idle_since) > self.stop.stall {
            self.stall = Some(self.explain(world, idle_since));
            self.finish(now, Outcome::Deadlock);
        } else if now.since(unfilled_since) > self.stop.livelock {
            self.stall = Some(self.explain(world, unfilled_since));
            self.finish(now, Outcome::Livelock);
        } else if is_checked && !self.global_plan.is_under_way() {
            self.call(now, world);
            let is_idle = now.since(idle_since) > self.stop.stall / LAST_PATIENCE;
            let is_jammed = now.since(unfilled_since) > self.stop.livelock / LAST_PATIENCE;
            let is_healed = self.is_broken() && self.connectivity() != Connectivity::Gradient;
            if (is_idle || is_jammed) && is_healed {
                self.plan_globally(now, world);
            }
        }
    }

    /// Opens the goal again in a closed epoch, if a global plan is found or looked for.
    fn plan_globally(&mut self, now: Time, world: &CubeWorld) {
        let (goal, when) = (self.opening.epoch.goal(), (now, self.last_fault));
        let mut global_plan = std::mem::take(&mut self.global_plan);
        let is_begun = global_plan.begin(when, goal, world, &|| self.snapshot(world), self.swarm());
        self.global_plan = global_plan;
        if is_begun && let Some(epoch) = self.opening.epoch.reopened() {
            self.open(Opening { epoch, opened: now, is_closed: true });
        }
    }

    /// Carries out a global plan, and opens the whole goal when it is over.
    fn lead(&mut self, now: Time, world: &CubeWorld) {
        // It reads all but the plan and the commands.
        let mut global_plan = std::mem::take(&mut self.global_plan);
        let mut commands = std::mem::take(&mut self.commands);
        let goes_on = global_plan.lead(
            (now, self.last_fault),
            world,
            &|| self.snapshot(world),
            self.swarm(),
            &mut commands,
        );
        (self.global_plan, self.commands) = (global_plan, commands);
        if !goes_on && let Some(epoch) = self.opening.epoch.reopened() {
            self.open(Opening::of(epoch, now));
        }
    }

    /// Returns the swarm as it is known.
    fn swarm(&self) -> Swarm<'_> {
        Swarm { epoch: self.opening.epoch, params: &self.setup.params, known: &self.known }
    }

    /// Returns true if a module is dead, has been restarted or cannot move.
    fn is_broken(&self) -> bool {
        let is_broken = |k: &Known| !k.alive || k.restarted || k.status.is_some_and(|s| s.immobile);
        self.known.iter().any(is_broken)
    }

    /// Calls modules that hear of no goal cell, if something is broken.
    fn call(&mut self, now: Time, world: &mut CubeWorld) {
        if !self.is_broken() {
            return;
        }
        let (last_fill, last_fault, last_move) = (self.last_fill, self.last_fault, self.last_move);
        let standing = Standing { last_fill, last_fault, last_move, patience: self.stop.stall / PATIENCE };
        // The search reads all but the calls and the commands.
        let (mut calls, mut commands) = (std::mem::take(&mut self.calls), std::mem::take(&mut self.commands));
        let swarm = self.swarm();
        calls.tend(now, standing, world, &|world| self.snapshot(world), swarm, &mut commands);
        (self.calls, self.commands) = (calls, commands);
    }

    /// Returns the connectivity check in use.
    fn connectivity(&self) -> Connectivity {
        self.setup.params.connectivity_in(self.opening.epoch)
    }

    fn may_be_built(&self) -> bool {
        debug_assert_eq!(self.done, self.count_done());
        self.done >= self.goal().len()
    }

    fn is_done(&self, known: &Known) -> bool {
        !known.alive || known.is_final(self.opening.epoch)
    }
    fn count_done(&self) -> usize {
        self.known.iter().filter(|k| self.is_done(k)).count()
    }
    /// Replaces what is known of a module.
    fn learn(&mut self, id: ModuleId, known: Known) {
        let before = std::mem::replace(&mut self.known[id.index()], known);
        self.done += usize::from(self.is_done(&known));
        self.done -= usize::from(self.is_done(&before));
    }

    fn explain(&self, world: &mut CubeWorld, since: Time) -> Stall {
        let connectivity = self.connectivity();
        diagnose(world, &self.known, self.goal(), connectivity, self.opening.epoch, since)
    }
}

impl DirectorPort<CubeWorld> for Director {
    fn report(&mut self, now: Time, id: ModuleId, report: Status) {
        let goal = self.goal().len();
        if let Some(stage) = self.stages.last_mut()
            && report.epoch == self.opening.epoch
            && report.subtree as usize >= goal
        {
            stage.known.get_or_insert(now);
        }
        self.recount |= report.role == Role::Final;
        if self.registrar.has_news(id, &report) || self.global_plan.is_under_way() {
            // It is forwarded as soon as the world can be read.
            self.next_check = Time::ZERO;
        }
        self.learn(id, Known { status: Some(report), ..self.known[id.index()] });
    }

    fn died(&mut self, now: Time, id: ModuleId) {
        self.faults.died(id);
        self.learn(id, Known { alive: false, ..self.known[id.index()] });
        self.registrar.died(now, id);
        self.recount = true;
        // Deaths are certified as soon as the world can be read.
        self.next_check = Time::ZERO;
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &CubeWorld) {
        self.last_fault = now;
        let found = self.found(id, world);
        self.faults.external(now, id, what, &found);
    }
    fn started(&mut self, _now: Time, id: ModuleId) {
        let before = self.known[id.index()].status.map_or(0, |s| s.prevented);
        self.prevented_before += u64::from(before);
        let restarted = self.registrar.started(id) || self.known[id.index()].restarted;
        self.learn(id, Known { alive: true, restarted, status: None });
        if self.opening.epoch != Epoch::default() {
            self.commands.push_back(Command::Order(id, Order::Goal(self.opening)));
        }
    }

    fn wake(&mut self, now: Time, world: &mut CubeWorld) {
        if self.outcome.is_some() {
            return;
        }
        world.set_failure(self.failure);
        while let Some(fault) = self.faults.due(now) {
            self.inject(now, fault, world);
        }
        self.tell_of_the_dead(world);
        self.watch(now, world);
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        if self.outcome.is_some() {
            return Err("the run is over".to_owned());
        }
        // The rules read all but the injector.
        let mut faults = std::mem::take(&mut self.faults);
        let taken =
            faults.input_if(now, kind, bytes, self.known.len(), &[], |fault: &Fault| self.rule(fault));
        self.faults = faults;
        taken
    }

    fn wake_at(&self) -> Time {
        if self.outcome.is_some() {
            return Time::NEVER;
        }
        let fault = self.faults.next_at();
        fault.min(self.next_check).min(self.stop.timeout)
    }

    fn poll(&mut self) -> Option<Command<Order>> {
        self.commands.pop_front()
    }

    fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
}

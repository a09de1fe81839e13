//! The director of cubes: opens goals, injects faults, certifies deaths, watches progress and decides how the
//! run ends. Sans-IO; both drivers carry out its commands.

use crate::cube::calls::{CallProgress, Calls, Swarm};
use crate::cube::diagnosis::{Building, Known};
use crate::cube::global_plan::GlobalPlan;
use crate::cube::reachability::{StandstillSnapshot, search};
use crate::cube::registrar::Registrar;
use crate::cube::world::CubeWorld;
use metamorph_kernel::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_kernel::director::monitor::{RunMonitor, Standing};
use metamorph_kernel::director::outcome::{Outcome, Stall};
use metamorph_kernel::director::port::DirectorPort;
use metamorph_kernel::director::progress::{Progress, Stage, Stop};
use metamorph_kernel::director::proof::{Found, RuleSet};
use metamorph_kernel::director::reason::Proves;
use metamorph_kernel::director::rescue::{Help, Rescue};
use metamorph_kernel::director::standstills::PATIENCE;
use metamorph_kernel::director::steering::Steering as Wish;
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
use std::sync::Arc;

/// The part of the time without moves, or without a filled cell, that ends a run after which a global plan is made.
const LAST_PATIENCE: u64 = 2;

/// The director of a swarm of cubes.
#[derive(Clone)]
pub struct Director {
    setup: Arc<Setup>,
    monitor: RunMonitor<Order>,
    failure: Ratio,
    rescue: Rescue,
    opening: Opening,
    global_plan: GlobalPlan,
    stages: Vec<Stage>,
    known: Vec<Known>,
    /// The number of modules that are dead, or finalized in the present stage.
    done: usize,
    registrar: Registrar,
    calls: Calls,
    filled: usize,
    recount: bool,
    last_fault: Time,
    /// The end of the latest lease of a command.
    leased: Time,
    /// The state in which the last fault left the modules, or the opening of the goal if that was later; with what identifies it.
    before: Option<(Disturbance, StandstillSnapshot)>,
    /// Whether it is proved of the present standstill that no cell can be filled any more.
    is_stranded: bool,
}

/// Search budget of the proof that no cell can be filled any more: arrangements of cubes examined, times the number of modules.
const PROOF_EFFORT: usize = 2_000_000;

/// The time of the last fault, the goal, and the number of living modules.
type Disturbance = (Time, u16, usize);

impl Director {
    /// Creates a director for a swarm of `modules` cubes.
    pub fn new(
        setup: Arc<Setup>,
        modules: usize,
        schedule: Schedule,
        stop: Stop,
        failure: Ratio,
        rescue: Rescue,
    ) -> Director {
        Director {
            monitor: RunMonitor::new(schedule, stop),
            failure,
            rescue,
            opening: Opening::of(Epoch::default(), Time::ZERO),
            global_plan: GlobalPlan::default(),
            stages: setup.goals.iter().take(1).map(|goal| Stage::opened(goal.len(), Time::ZERO)).collect(),
            setup,
            known: vec![Known::default(); modules],
            // Modules are dead until they are started.
            done: modules,
            registrar: Registrar::default(),
            calls: Calls::default(),
            filled: 0,
            recount: true,
            last_fault: Time::ZERO,
            leased: Time::ZERO,
            before: None,
            is_stranded: false,
        }
    }

    /// Returns the faults, the commands and the end of the run.
    pub fn monitor(&self) -> &RunMonitor<Order> {
        &self.monitor
    }
    /// Returns the current state of the swarm as the input of a reachability search.
    pub fn snapshot(&self, world: &CubeWorld) -> StandstillSnapshot {
        self.building().snapshot(world)
    }
    /// Returns the state in which the last fault left the modules, or the opening of the goal if that was later.
    pub fn before(&self) -> Option<&StandstillSnapshot> {
        self.before.as_ref().map(|(_, snapshot)| snapshot)
    }
    /// Returns all goals so far.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }
    /// Returns the number of collisions that negotiation has prevented, as reported.
    pub fn prevented(&self) -> u64 {
        self.monitor.prevented(self.known.iter().filter_map(|k| k.status).map(|s| s.prevented))
    }
    /// Returns the number of moves that the director has brought about.
    pub fn help(&self, world: &CubeWorld) -> Help {
        Help { called: self.calls.called(), led: self.global_plan.led(world) }
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
            moves: self.monitor.done(),
            standstills: self.monitor.standstill_count(),
            restarts: self.monitor.crashed_and_restarted().1,
            messages: None,
        }
    }
    /// Returns what is known of each module.
    pub fn known(&self) -> &[Known] {
        &self.known
    }

    fn building(&self) -> Building<'_> {
        Building::of(&self.setup, self.opening.epoch, &self.known, &self.registrar)
    }
    fn goal(&self) -> &Goal {
        self.building().goal
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
            return self.monitor.inject(now, fault, false, "cubes have no obstacles but each other");
        };
        let (alive, mut effect, rule) = (
            self.known[id.index()].alive,
            self.found(id, world),
            rule(&fault, &self.known, self.opening.epoch),
        );
        if let Err(rule) = &rule {
            effect = format!("{effect}; refused: {rule}");
        }
        self.monitor.inject(now, fault, alive, effect);
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
        self.monitor.order(id, Order::Steer { steering, until });
    }

    /// Certifies deaths, and forwards who holds the dead.
    fn tell_of_the_dead(&mut self, now: Time, world: &CubeWorld) {
        let (epoch, seed) = (self.opening.epoch, self.goal().seed());
        self.registrar.tell(now, world, &self.known, epoch, seed, &mut self.monitor.commands);
    }

    /// Counts the goal cells that are filled. Returns true if all are.
    fn count_filled(&mut self, now: Time, world: &CubeWorld) -> bool {
        self.recount = false;
        let (epoch, goal) = (self.opening.epoch, self.goal());
        // No module is finalized while a global plan is carried out.
        let is_led = self.global_plan.is_active();
        let is_filled = |id: ModuleId| {
            let k = &self.known[id.index()];
            // A body that still moves fills no cell.
            ((is_led || !k.alive) && !world.is_moving(id)) || k.is_final(epoch)
        };
        let is_filled = |c: &Cell| world.body_at(*c).is_some_and(is_filled);
        let filled = goal.cells().filter(is_filled).count();
        let is_built = filled == goal.len();
        if filled > self.filled {
            self.monitor.last_gain = now;
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
            return self.monitor.finish(now, Outcome::Built);
        }
        self.monitor.resolve_standstill(now);
        self.open(Opening::of(next, now));
        self.stages.push(Stage::opened(self.goal().len(), now));
    }

    fn open(&mut self, opening: Opening) {
        self.opening = opening;
        self.done = self.count_done();
        self.filled = 0;
        self.recount = true;
        (self.monitor.last_gain, self.monitor.last_action) = (opening.opened, opening.opened);
        for id in (0..self.known.len() as u32).map(ModuleId) {
            self.monitor.order(id, Order::Goal(opening));
        }
    }

    fn watch(&mut self, now: Time, world: &mut CubeWorld) {
        // Moves that fail are no progress: a stuck module tries again and again.
        self.monitor.count_actions(now, world.motions().completed);
        let is_checked = now >= self.monitor.next_check || (self.recount && self.may_be_built());
        if is_checked {
            self.monitor.next_check = now + self.setup.params.move_time;
            let is_built = self.count_filled(now, world);
            self.calls.count(world);
            self.note_disturbance(world);
            if let Some(since) = self.look(now, world)
                && !is_built
            {
                let stall = self.building().diagnose(world, since);
                self.is_stranded = self.is_hopeless(world, &stall);
                self.monitor.begin_standstill(stall);
            }
            if self.global_plan.is_active() {
                self.lead(now, world);
            } else if is_built {
                return self.next_stage(now);
            }
        }
        let (standing, stop) = (self.standing(now), self.monitor.stop);
        let Standing { is_planned, idle_since, no_gain_since, .. } = standing;
        // The help that is under way ends by itself, and its end may be progress.
        let is_helped = self.calls.is_active() || self.global_plan.is_active();
        let verdict = self.monitor.verdict(now, standing);
        if let Some(outcome) = verdict.filter(|outcome| *outcome == Outcome::Timeout || !is_helped) {
            let since = if outcome == Outcome::Livelock { no_gain_since } else { idle_since };
            let stall = self.building().diagnose(world, since);
            self.monitor.give_up(now, outcome, stall);
        } else if is_checked && !is_planned && !self.global_plan.is_active() {
            self.call(now, world, idle_since);
            let is_idle = now.since(idle_since) > stop.stall / LAST_PATIENCE;
            let is_jammed = now.since(no_gain_since) > stop.livelock / LAST_PATIENCE;
            let is_led = self.rescue >= Rescue::Plans;
            let is_healed =
                is_led && self.is_broken() && self.building().connectivity != Connectivity::Gradient;
            if (is_idle || is_jammed) && is_healed {
                self.plan_globally(now, world);
            }
        }
    }

    /// Takes note of the state in which a fault has left the modules, to be asked later if the goal could have been built from
    /// there.
    fn note_disturbance(&mut self, world: &CubeWorld) {
        let disturbance = (self.last_fault, self.opening.epoch.goal(), self.alive());
        if self.before.as_ref().is_none_or(|(last, _)| *last != disturbance) {
            self.before = Some((disturbance, self.building().bodies(world)));
        }
    }

    /// Returns how the swarm stands.
    fn standing(&self, now: Time) -> Standing {
        let RunMonitor { last_action, last_gain, stop, .. } = self.monitor;
        let is_planned = self.monitor.is_event_planned(now) || now < self.leased;
        let no_gain_since = last_gain.max(self.last_fault).max(stop.planned_until).max(self.leased);
        let idle_since = last_action.max(no_gain_since);
        let is_stranded = self.is_stranded && self.monitor.standstills().is_present();
        Standing { is_planned, is_stranded, idle_since, no_gain_since }
    }

    /// Returns true if the goal cannot be completed, and it is proved that no further cell of it can be filled either, as long as
    /// walkers carry no other module: then there is nothing to wait for.
    fn is_hopeless(&self, world: &CubeWorld, stall: &Stall) -> bool {
        let proved = || {
            let bound = PROOF_EFFORT / self.known.len().max(1);
            search(&self.building().snapshot(world), RuleSet::Carried, bound)
        };
        match stall.reason.proves {
            Proves::Counted => true,
            Proves::Incomplete => matches!(proved(), Found::Impossible(_)),
            Proves::Nothing | Proves::NotHere => false,
        }
    }

    /// Returns the time since which the swarm stands still, if that is noticed now.
    fn look(&mut self, now: Time, world: &CubeWorld) -> Option<Time> {
        let (standing, help, is_led) = (self.standing(now), self.help(world), self.global_plan.is_active());
        self.monitor.look(now, standing, self.filled, help, is_led)
    }

    /// Opens the goal again in a closed epoch, if a global plan is found or looked for.
    fn plan_globally(&mut self, now: Time, world: &CubeWorld) {
        let (goal, when) = (self.opening.epoch.goal(), (now, self.last_fault));
        let building = Building::of(&self.setup, self.opening.epoch, &self.known, &self.registrar);
        let swarm = Swarm { epoch: building.epoch, params: &self.setup.params, known: &self.known };
        let is_begun = self.global_plan.begin(when, goal, world, &|| building.snapshot(world), swarm);
        if is_begun && let Some(epoch) = self.opening.epoch.reopened() {
            self.open(Opening { epoch, opened: now, is_closed: true });
        }
    }

    /// Carries out a global plan, and opens the whole goal when it is over.
    fn lead(&mut self, now: Time, world: &CubeWorld) {
        let building = Building::of(&self.setup, self.opening.epoch, &self.known, &self.registrar);
        let swarm = Swarm { epoch: building.epoch, params: &self.setup.params, known: &self.known };
        let (when, snapshot) = ((now, self.last_fault), || building.snapshot(world));
        let goes_on = self.global_plan.lead(when, world, &snapshot, swarm, &mut self.monitor.commands);
        if !goes_on && let Some(epoch) = self.opening.epoch.reopened() {
            self.open(Opening::of(epoch, now));
        }
    }

    /// Returns true if a module is dead, has been restarted or cannot move.
    fn is_broken(&self) -> bool {
        let is_broken = |k: &Known| !k.alive || k.restarted || k.status.is_some_and(|s| s.immobile);
        self.known.iter().any(is_broken)
    }

    /// Calls modules that hear of no goal cell, if something is broken.
    fn call(&mut self, now: Time, world: &mut CubeWorld, idle_since: Time) {
        if self.rescue < Rescue::Calls || !self.is_broken() {
            return;
        }
        let plans = self.calls.plans();
        let RunMonitor { last_gain: last_fill, last_action: last_move, stop, commands, .. } =
            &mut self.monitor;
        let patience = stop.stall / PATIENCE;
        let progress = CallProgress {
            last_fill: *last_fill,
            last_fault: self.last_fault,
            last_move: *last_move,
            patience,
        };
        let building = Building::of(&self.setup, self.opening.epoch, &self.known, &self.registrar);
        let swarm = Swarm { epoch: building.epoch, params: &self.setup.params, known: &self.known };
        self.calls.tend(now, progress, world, &|world| building.snapshot(world), swarm, commands);
        // After calls that have filled a cell, the next one is made earlier.
        if self.calls.plans() > plans && !self.monitor.standstills().is_present() {
            let stall = self.building().diagnose(world, idle_since);
            self.monitor.begin_standstill(stall);
        }
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
    fn learn(&mut self, id: ModuleId, known: Known) {
        let before = std::mem::replace(&mut self.known[id.index()], known);
        self.done += usize::from(self.is_done(&known));
        self.done -= usize::from(self.is_done(&before));
    }
}

/// Returns the rule that refuses a command, and what to do instead.
fn rule(fault: &Fault, known: &[Known], epoch: Epoch) -> Result<(), String> {
    let Fault::Steer(id, wish) = *fault else { return Ok(()) };
    // An unknown module is refused by its number.
    let Some(known) = known.get(id.index()) else { return Ok(()) };
    if matches!(wish, Wish::Take(..) | Wish::Swap(_)) {
        return Err("family: any cube fills any cell of the goal; use `goto`, `hold` or `release`".to_owned());
    }
    if !known.alive {
        return Err(format!("dead: the process of module {id} is dead; restart it first"));
    }
    if known.is_final(epoch) {
        return Err(format!("settled: module {id} fills a cell and stays there until the goal changes"));
    }
    Ok(())
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
        if self.registrar.has_news(id, &report) || self.global_plan.is_active() {
            // It is forwarded as soon as the world can be read.
            self.monitor.next_check = Time::ZERO;
        }
        self.learn(id, Known { status: Some(report), ..self.known[id.index()] });
    }

    fn died(&mut self, now: Time, id: ModuleId) {
        self.monitor.faults.died(id);
        self.learn(id, Known { alive: false, ..self.known[id.index()] });
        self.registrar.died(now, id);
        self.recount = true;
        // Deaths are certified as soon as the world can be read.
        self.monitor.next_check = Time::ZERO;
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &CubeWorld) {
        self.last_fault = now;
        let found = self.found(id, world);
        self.monitor.faults.external(now, id, what, &found);
    }
    fn started(&mut self, _now: Time, id: ModuleId) {
        let before = self.known[id.index()].status.map_or(0, |s| s.prevented);
        self.monitor.prevented_before += u64::from(before);
        let restarted = self.registrar.started(id) || self.known[id.index()].restarted;
        self.learn(id, Known { alive: true, restarted, status: None });
        if self.opening.epoch != Epoch::default() {
            self.monitor.order(id, Order::Goal(self.opening));
        }
    }

    fn wake(&mut self, now: Time, world: &mut CubeWorld) {
        if self.monitor.outcome().is_some() {
            return;
        }
        world.set_failure(self.failure);
        while let Some(fault) = self.monitor.faults.due(now) {
            self.inject(now, fault, world);
        }
        self.tell_of_the_dead(now, world);
        self.watch(now, world);
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        let (known, epoch) = (&self.known, self.opening.epoch);
        let rule = |fault: &Fault| rule(fault, known, epoch);
        self.monitor.injector()?.input_if(now, kind, bytes, known.len(), &[], rule)
    }
    fn set_rescue(&mut self, level: Rescue) {
        self.rescue = level;
    }
    fn wake_at(&self) -> Time {
        self.monitor.wake_at(Time::NEVER)
    }
    fn poll(&mut self) -> Option<Command<Order>> {
        self.monitor.commands.pop_front()
    }
    fn struck(&self) -> &[FaultRecord] {
        self.monitor.struck()
    }
}

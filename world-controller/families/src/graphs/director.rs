//! The director of modules with a graph of contacts: it injects the faults, and ends a run when all living modules have reached
//! the goal or none has reported anything for too long.

use super::GraphProtocol;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_sim_bridge::director::monitor::{RunMonitor, Standing};
use metamorph_sim_bridge::director::outcome::{Objective, Outcome, Stall};
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::{Progress, Stage, Stop};
use metamorph_sim_bridge::director::reason::{Excuse, Reason};
use metamorph_sim_bridge::kernel::graph_world::GraphWorld;
use metamorph_sim_bridge::world::contact_graph::ContactGraph;
use std::collections::BTreeSet;
use std::sync::Arc;

/// The living modules are not connected.
const DIVIDED: Reason = Reason::new(
    "divided",
    Excuse::IfDead,
    "divided: dead modules cut the living ones off from each other, and these have not all reached the goal",
);
/// The living modules are connected, and nothing happens.
const SILENT: Reason = Reason::new(
    "silent",
    Excuse::Never,
    "silent: modules that can all reach each other have not all reached the goal, and report nothing more",
);
/// There is no living module.
const ALL_DEAD: Reason = Reason::new("all-dead", Excuse::IfDead, "all dead: no module lives");

/// The director.
pub struct GraphDirector<P: GraphProtocol> {
    monitor: RunMonitor<Never>,
    graph: Arc<ContactGraph>,
    setup: Arc<P::Setup>,
    reports: Vec<Option<P::Report>>,
    alive: Vec<bool>,
    reached: Vec<bool>,
    /// The progress at the last look, since drivers ask after every event when to wake the director.
    seen: Progress,
    /// True if `reached` and `seen` are older than a report or a death.
    is_stale: bool,
    /// Processes that are to be killed and are not dead yet.
    dying: BTreeSet<ModuleId>,
    /// Processes that are to be started again and are not up yet.
    starting: BTreeSet<ModuleId>,
    last_change: Time,
}

impl<P: GraphProtocol> GraphDirector<P> {
    /// Creates the director of a run.
    pub fn new(
        graph: &Arc<ContactGraph>,
        setup: &Arc<P::Setup>,
        schedule: Schedule,
        stop: Stop,
    ) -> GraphDirector<P> {
        let modules = graph.cells().len();
        let mut monitor = RunMonitor::new(schedule, stop);
        monitor.next_check = Time::NEVER;
        GraphDirector {
            monitor,
            graph: Arc::clone(graph),
            setup: Arc::clone(setup),
            reports: vec![None; modules],
            alive: vec![false; modules],
            reached: vec![false; modules],
            seen: Progress::default(),
            is_stale: false,
            dying: BTreeSet::new(),
            starting: BTreeSet::new(),
            last_change: Time::ZERO,
        }
    }

    /// Returns the faults and the end of the run.
    pub fn monitor(&self) -> &RunMonitor<Never> {
        &self.monitor
    }
    /// Returns the progress: every living module is to reach the goal.
    pub fn progress(&self) -> Progress {
        let alive = self.living().count();
        let filled = self.living().filter(|id| self.reached[id.index()]).count();
        Progress {
            stage: 0,
            stages: 1,
            goal: alive,
            filled,
            alive,
            moves: 0,
            standstills: self.monitor.standstill_count(),
            restarts: self.monitor.crashed_and_restarted().1,
            messages: None,
        }
    }
    /// Returns the one goal.
    pub fn stage(&self) -> Stage {
        let built =
            self.monitor.outcome().filter(|(_, outcome)| *outcome == Outcome::Built).map(|(at, _)| at);
        let Progress { goal, filled, .. } = self.progress();
        Stage { cells: goal, filled, opened: Time::ZERO, built, known: built }
    }

    fn living(&self) -> impl Iterator<Item = ModuleId> {
        (0..self.alive.len() as u32).map(ModuleId).filter(|id| self.alive[id.index()])
    }

    fn change(&mut self, now: Time) {
        (self.is_stale, self.last_change) = (true, now);
    }

    fn look(&mut self) {
        if std::mem::take(&mut self.is_stale) {
            self.reached = P::reached(&self.setup, &self.reports);
            self.reached.resize(self.reports.len(), false);
            self.seen = self.progress();
        }
    }

    /// Returns since when nothing has happened. While messages are impaired for a time, all may wait for the end of that.
    fn idle_since(&self) -> Time {
        self.last_change.max(self.monitor.stop.planned_until)
    }

    /// Returns true if something outside of the protocol may still change the run.
    fn is_planned(&self, now: Time) -> bool {
        self.monitor.is_event_planned(now) || self.is_changing()
    }

    /// Returns true if a process is about to end or to start.
    fn is_changing(&self) -> bool {
        !self.dying.is_empty() || !self.starting.is_empty()
    }

    fn stall(&self) -> Stall {
        let reason = match self.graph.reach(|id| self.alive[id.index()]) {
            _ if self.living().next().is_none() => ALL_DEAD,
            None => DIVIDED,
            Some(_) => SILENT,
        };
        let open = self.living().filter(|id| !self.reached[id.index()]);
        let open = open.map(|id| Objective { text: format!("module {id}"), cell: None }).collect();
        Stall {
            since: self.last_change,
            reason,
            text: reason.text,
            open,
            wait_cycle: Vec::new(),
            waiting: Vec::new(),
            detected: None,
            proof: None,
        }
    }
}

impl<P: GraphProtocol> DirectorPort<GraphWorld<P>> for GraphDirector<P> {
    fn report(&mut self, now: Time, id: ModuleId, report: P::Report) {
        self.reports[id.index()] = Some(report);
        self.change(now);
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.monitor.faults.died(id);
        self.alive[id.index()] = false;
        self.reports[id.index()] = None;
        if !self.dying.remove(&id) {
            // It could not be started, or has ended at once.
            self.starting.remove(&id);
        }
        self.change(now);
    }
    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, _: &GraphWorld<P>) {
        self.monitor.faults.external(now, id, what, "it was running");
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        self.alive[id.index()] = true;
        self.starting.remove(&id);
        self.change(now);
    }
    fn wake(&mut self, now: Time, _: &mut GraphWorld<P>) {
        while let Some(fault) = self.monitor.faults.due(now) {
            let alive = fault.module().is_some_and(|id| self.alive[id.index()]);
            match fault {
                Fault::Kill(id) if alive => drop(self.dying.insert(id)),
                Fault::Restart(id) if !alive || self.dying.contains(&id) => drop(self.starting.insert(id)),
                _ => {}
            }
            self.monitor.inject(now, fault, alive, if alive { "it was running" } else { "it was dead" });
            self.change(now);
        }
        self.look();
        let Progress { goal, filled, alive, .. } = self.seen;
        let is_planned = self.is_planned(now);
        if alive > 0 && filled == goal && !is_planned {
            return self.monitor.finish(now, Outcome::Built);
        }
        let (idle_since, no_gain_since) = (self.idle_since(), self.idle_since());
        let standing = Standing { is_planned, is_stranded: alive == 0, idle_since, no_gain_since };
        if let Some(outcome) =
            self.monitor.verdict(now, standing).filter(|_| self.monitor.outcome().is_none())
        {
            let stall = self.stall();
            self.monitor.give_up(now, outcome, stall);
        }
    }
    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        let modules = self.alive.len();
        self.monitor.injector()?.input(now, kind, bytes, modules, &[])
    }
    fn wake_at(&self) -> Time {
        if self.is_stale {
            return self.monitor.wake_at(Time::ZERO);
        }
        // The end of a pause or a partition is among the faults to come.
        if self.monitor.faults.is_pending() || self.is_changing() {
            return self.monitor.wake_at(Time::NEVER);
        }
        let Progress { goal, filled, alive, .. } = self.seen;
        let is_over = alive == 0 || filled == goal;
        let patience = if is_over { Span::ZERO } else { self.monitor.stop.stall + Span::nanos(1) };
        self.monitor.wake_at(self.idle_since() + patience)
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        self.monitor.commands.pop_front()
    }
    fn struck(&self) -> &[FaultRecord] {
        self.monitor.struck()
    }
}

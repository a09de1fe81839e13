//! The report of a run: turns a driver's results into one value that is printed for people and written as
//! JSON. Independent of the driver. Absent: measuring (drivers do) and printing (`terminal` does).

pub mod document;
pub mod family_part;
pub mod hosts;
mod human;
mod latency;
pub mod message_timeline;
pub mod operator;
mod over_time;
pub mod page;
pub mod plot_file;
pub mod plots;
pub mod prospect;
pub mod run_result;
pub mod schema;
mod standstills;
pub mod statistics;
pub mod two_samples;

pub use human::{human, progress};

use crate::run_result::RunResult;
use hosts::HostsReport;
use metamorph_core::counters::Class;
use metamorph_core::counters::{Counts, Tally};
use metamorph_core::latency::Latencies;
use metamorph_core::time::{Span, Time};
use metamorph_kernel::director::faults::{FaultRecord, Origin};
use metamorph_kernel::director::outcome::{Outcome, Stall};
use metamorph_kernel::director::progress::Progress;
use metamorph_kernel::director::reason::SELF_BLOCKED;
use metamorph_kernel::kernel::sim::{ControlCounts, Crossings};
use metamorph_kernel::world::invariants::Violation;
use metamorph_scenario::family::Words;
use metamorph_scenario::{LinkChange, Plan};
use metamorph_text::format::{count, digits, many};
use prospect::{Possible, Prospect};
use schema::{
    Agents, ClassCounts, Collisions, Detected, FaultReport, GoalReport, Invariants, LogsReport, Machine,
    Messages, ProofReport, Report, SCHEMA, SlowedReport, Standstill, Times, ViolationReport, Waiting,
};
use std::time::Duration;

/// How the clock of a run was slowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slowed {
    /// The mean speed of scenario time, as a share of the scenario's.
    pub factor: f64,
    /// The lowest speed at which time passed, as a share of the scenario's.
    pub lowest: f64,
    /// Real time that passed at less than the scenario's speed.
    pub time: Duration,
}

impl Default for Slowed {
    fn default() -> Slowed {
        Slowed { factor: 1.0, lowest: 1.0, time: Duration::ZERO }
    }
}

/// The results of a driver at the end of a run.
pub struct Facts<'a> {
    /// The plan that was run.
    pub plan: &'a Plan,
    /// The results of director and world.
    pub account: RunResult,
    /// The time of a move, or of a step of a joint.
    pub time_step: Span,
    /// Message counts.
    pub tally: &'a Tally,
    /// Latencies of the messages delivered.
    pub latencies: &'a Latencies,
    /// Messages between agents, bodies and controller, not counted as protocol messages.
    pub body_messages: u64,
    /// Messages between the controller and the agents; `None` if they were not counted.
    pub control: Option<ControlCounts>,
    /// Messages that crossed between hosts, if there were several.
    pub crossings: Crossings,
    /// Violations kept, in order.
    pub violations: &'a [Violation],
    /// Violations in all.
    pub broken: u64,
    /// Invariant checks made.
    pub checked: u64,
    /// Scenario time at the end.
    pub now: Time,
    /// Real time from the first event to the last.
    pub wall: Duration,
    /// Real time from the start of the program to the first event.
    pub setup: Duration,
    /// The number of processors available.
    pub cores: u64,
    /// How far the clock was slowed; `None` without a real clock.
    pub slowed: Option<Slowed>,
    /// Messages by class that both ends of the links counted as in flight at the end; `None` if that follows
    /// from the other counts.
    pub left: Option<[u64; Class::ALL.len()]>,
    /// The trace hash; `None` if runs are not deterministic.
    pub trace_hash: Option<u64>,
    /// The hash of all intermediate states; `None` if runs are not deterministic.
    pub state_hash: Option<u64>,
    /// The hash of all agents at the end; `None` if agents end with their processes.
    pub agents_hash: Option<u64>,
    /// The hash of the world at the end.
    pub world_hash: u64,
    /// Whether a standstill is worth a search for what could still have been built.
    pub search: bool,
    /// Why the run was ended early, if the machine took away what it needs.
    pub machine_fault: Option<String>,
    /// Where the logs of the run are; `None` if it has no processes.
    pub logs: Option<LogsReport>,
    /// Notes for the reader, such as processes that died without a fault.
    pub notes: Vec<String>,
}

/// Creates the report of a run. A run without an outcome was interrupted.
pub fn report(facts: &Facts<'_>) -> Report {
    let (plan, account) = (facts.plan, &facts.account);
    let ended = ended(account, facts.machine_fault.as_deref());
    let outcome = if facts.broken > 0 { Outcome::Unsafe } else { ended };
    let progress = account.progress;
    let question = account.snapshot.as_deref().filter(|_| facts.search);
    let unbuilt = account.stall.as_ref().map(|stall| standstill(stall, &Prospect::of(stall, question)));
    let listed = |when| (ended == when).then(|| unbuilt.clone()).flatten().into_iter().collect();
    let collides = |v: &&Violation| v.invariant.is_collision;
    let suffered = facts.violations.iter().filter(collides).count() as u64;
    let (prevented, refused) = (account.prevented, account.bodies.refused_taken);
    let part = account.family_part.as_ref();
    Report {
        schema: SCHEMA,
        version: metamorph_text::version::version().to_owned(),
        scenario: plan.title(),
        file: plan.file(),
        family: plan.swarm.family().to_owned(),
        seed: plan.seed,
        link: plan.overrides.link.name().to_owned(),
        outcome: outcome.name().to_owned(),
        reason: reason(outcome, facts, unbuilt.as_ref()),
        agents: Agents {
            launched: plan.swarm.len() as u64,
            alive: progress.alive as u64,
            crashed: account.crashed,
            restarted: account.restarted,
        },
        goal: GoalReport { cells: progress.goal as u64, filled: progress.filled as u64 },
        stages: account.stages.clone(),
        deadlocks: listed(Outcome::Deadlock),
        livelocks: listed(Outcome::Livelock),
        standstills: Some(standstills::report(plan, &account.standstills)),
        unbuilt,
        collisions: Collisions { attempted: refused + prevented + suffered, prevented, refused, suffered },
        moves: account.moves,
        move_details: account.bodies.clone(),
        family_parts: part.map(|part| (part.key.to_owned(), part.value.clone())).into_iter().collect(),
        family_text: part.map(|part| part.text.clone()).unwrap_or_default(),
        messages: messages(facts.tally, facts.left.as_ref(), facts.latencies),
        body_messages: facts.body_messages,
        controller: facts.control.map(|ControlCounts { orders, reports, bytes, lost }| {
            schema::ControllerReport { orders, reports, bytes, lost }
        }),
        operator: account.operator.clone(),
        hosts: HostsReport::of(plan, &facts.account.struck, &facts.crossings),
        time: Times {
            virtual_s: facts.now.as_secs_f64(),
            move_times: facts.now.0 as f64 / facts.time_step.0 as f64,
            wall_s: facts.wall.as_secs_f64(),
            setup_s: facts.setup.as_secs_f64(),
            slowed: facts.slowed.map(|s| SlowedReport {
                factor: s.factor,
                lowest: s.lowest,
                real_s: s.time.as_secs_f64(),
            }),
        },
        invariants: Invariants {
            checked: facts.checked,
            broken: facts.broken,
            violated: facts.violations.iter().map(violation).collect(),
        },
        faults: faults(plan, account, facts.now),
        faults_planned: plan.schedule.iter().filter(|s| s.by == Origin::Scenario).count() as u64
            + plan.link_changes().len() as u64,
        notes: facts.notes.clone(),
        logs: facts.logs.clone(),
        incomplete_journal: None,
        trace_hash: facts.trace_hash.map(digits),
        state_hash: facts.state_hash.map(digits),
        agents_hash: facts.agents_hash.map(digits),
        world_hash: Some(digits(facts.world_hash)),
        repeat: plan.repeat_with(),
        machine: Machine {
            os: std::env::consts::OS.to_owned(),
            arch: std::env::consts::ARCH.to_owned(),
            cores: facts.cores,
            build: if cfg!(debug_assertions) { "debug" } else { "release" }.to_owned(),
        },
    }
}

/// Returns how a run has ended. If the machine took away what it needs, only a goal that was built says anything.
pub fn ended(account: &RunResult, machine_fault: Option<&str>) -> Outcome {
    let ended = account.ended.map_or(Outcome::Aborted, |(_, outcome)| outcome);
    if machine_fault.is_some() && ended != Outcome::Built { Outcome::Aborted } else { ended }
}

fn reason(outcome: Outcome, facts: &Facts<'_>, unbuilt: Option<&Standstill>) -> String {
    let Words { modules, cell, part, filled: reached, .. } = *facts.plan.swarm.words();
    let Progress { filled, goal, .. } = facts.account.progress;
    let why = unbuilt.map(|s| s.text.as_str());
    let unknown = "no reason found";
    let so_far = format!("{} of {}", count(filled as u64), many(goal as u64, part));
    match outcome {
        Outcome::Built => format!("every {cell} is {reached}{}", standstills::help(&facts.account)),
        Outcome::Unsafe => match facts.violations.first() {
            Some(first) => format!("an invariant broke: {first}"),
            None => "an invariant broke".to_owned(),
        },
        Outcome::Aborted => match &facts.machine_fault {
            Some(why) => format!("machine: {why}; it says nothing about the protocol ({so_far} {reached})"),
            None => format!("stopped from outside with {so_far} {reached}"),
        },
        // Whether the modules could have continued says more than what held each of them just then.
        Outcome::Timeout => {
            let prospect = unbuilt.map_or(unknown, |s| s.prospect.as_str());
            format!("the time limit was reached with {so_far} {reached}; {prospect}")
        }
        Outcome::Livelock => format!(
            "{modules} moved, but no {cell} was filled for {}; {}",
            facts.plan.stop.livelock,
            why.unwrap_or(unknown)
        ),
        Outcome::Deadlock => why.unwrap_or("nothing moves").to_owned(),
    }
}

fn standstill(stall: &Stall, prospect: &Prospect) -> Standstill {
    let reason = if prospect.before.is_some() { SELF_BLOCKED } else { stall.reason };
    Standstill {
        since_s: stall.since.as_secs_f64(),
        reason: reason.name.to_owned(),
        infeasible: prospect.possible == Possible::No,
        possible: prospect.possible.name().to_owned(),
        impossible_within: prospect.within.map(|within| within.name().to_owned()),
        way: if let Possible::Yes(moves) = prospect.possible { Some(moves as u64) } else { None },
        prospect: prospect.text(),
        text: if prospect.before.is_some() { SELF_BLOCKED.text } else { stall.text }.to_owned(),
        unfilled: stall.open.iter().filter_map(|o| Some(o.cell?.into())).collect(),
        open: stall.open.iter().map(|o| o.text.clone()).collect(),
        wait_cycle: stall.wait_cycle.iter().map(|id| id.0).collect(),
        waiting: stall
            .waiting
            .iter()
            .map(|w| Waiting { module: w.module.0, waits_for: w.on.map(|on| on.0), why: w.why.0.to_owned() })
            .collect(),
        detected: stall.detected.map(|(at, by)| Detected { at_s: at.as_secs_f64(), by: by.0 }),
        proof: stall
            .proof
            .map(|p| ProofReport { arrangements: p.arrangements as u64, places: p.places.map(|n| n as u64) }),
    }
}

fn messages(tally: &Tally, left: Option<&[u64; Class::ALL.len()]>, latencies: &Latencies) -> Messages {
    let counts = |c: &Counts, left: Option<u64>| ClassCounts {
        sent: c.sent,
        delivered: c.delivered,
        lost: c.lost,
        duplicated: c.duplicated,
        overflowed: c.overflowed,
        expired: c.expired,
        refused: c.refused,
        // Without the counts of a lost host more may have arrived than is known to have been sent.
        in_flight: c.in_flight().max(0),
        uncounted: left.map_or(0, |left| (c.in_flight() - left as i64).max(0)),
        bytes: c.bytes,
    };
    let total = tally.total();
    let by_class = |(class, c): (Class, &Counts)| {
        (class.name().to_owned(), counts(c, left.map(|left| left[class.index()])))
    };
    Messages {
        total: total.sent,
        bytes: total.bytes,
        all: counts(&total, left.map(|left| left.iter().sum())),
        by_class: tally.iter().map(by_class).collect(),
        latency: latency::report(latencies),
    }
}

fn violation(v: &Violation) -> ViolationReport {
    ViolationReport { invariant: v.invariant.name.to_owned(), at_s: v.at.as_secs_f64(), what: v.what.clone() }
}

/// Lists the faults of modules, cells and links, by time.
fn faults(plan: &Plan, account: &RunResult, now: Time) -> Vec<FaultReport> {
    let changes = plan.link_changes().into_iter().filter(|c| c.at <= now);
    let of_links = changes.map(|LinkChange { at, name, effect }| FaultReport {
        at_s: at.as_secs_f64(),
        fault: name.to_owned(),
        module: None,
        by: Origin::Scenario.to_string(),
        effect,
    });
    let mut faults: Vec<FaultReport> = account.struck.iter().map(fault).chain(of_links).collect();
    faults.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    faults
}

fn fault(struck: &FaultRecord) -> FaultReport {
    let text = struck.fault.to_string();
    FaultReport {
        at_s: struck.at.as_secs_f64(),
        fault: text.split(' ').next().unwrap_or("").to_owned(),
        module: struck.fault.module().map(|id| id.0),
        by: struck.by.to_string(),
        effect: struck.effect.clone(),
    }
}

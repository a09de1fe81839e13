//! The report as written to JSON. A field is never renamed, redefined or removed without a new [`SCHEMA`];
//! new fields may be added. Times end in `_s` and are seconds of scenario time unless stated otherwise.

use super::family_part::FamilyText;
use super::hosts::HostsReport;
use super::operator::OperatorReport;
use metamorph_text::format::count;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// The version of this layout.
pub const SCHEMA: u32 = 1;

/// The name in [`FaultReport`] of what was done to a process from outside the run.
pub const EXTERNAL: &str = "external";

/// The report of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Report {
    /// The version of this layout.
    pub schema: u32,
    /// The version of the program that ran.
    pub version: String,
    /// The scenario's name, or its file if it has none.
    pub scenario: String,
    /// The scenario's file as it was typed, or its last part if that was an absolute path.
    pub file: String,
    /// The family of modules: `cube`, `metamodule` or `free-module`.
    pub family: String,
    /// The seed of the run.
    pub seed: u64,
    /// The link that carried the messages: `ipc` or `sim`.
    pub link: String,
    /// `built`, `deadlock`, `livelock`, `timeout`, `unsafe` or `aborted`.
    pub outcome: String,
    /// The reason of the outcome, as text.
    pub reason: String,
    /// Processes (`ipc`) or agents (`sim`).
    pub agents: Agents,
    /// The last goal that was opened.
    pub goal: GoalReport,
    /// Every goal that was opened; of metamodules, whose goals replace one another, the last one.
    pub stages: Vec<StageReport>,
    /// The standstill, if the outcome of the run was a deadlock.
    pub deadlocks: Vec<Standstill>,
    /// The standstill, if the outcome of the run was a livelock.
    pub livelocks: Vec<Standstill>,
    /// Every standstill in the course of the run, whatever followed; null in reports of earlier versions.
    #[serde(default)]
    pub standstills: Option<StandstillsReport>,
    /// Why goal cells are unfilled, whatever the outcome; null if all are filled or it was not examined.
    pub unbuilt: Option<Standstill>,
    /// Attempts to use one cell twice; the body of a cube also refuses a move whose support is missing.
    pub collisions: Collisions,
    /// Moves completed. A move of a metamodule is all its actions between two connections.
    pub moves: u64,
    /// Results of moves; of metamodules, of all steps of joints, connections and releases.
    pub move_details: MoveReport,
    /// The results that only one family has, each family's in a field of its own; null for other families.
    #[serde(flatten)]
    pub family_parts: BTreeMap<String, Value>,
    /// The same for people.
    #[serde(skip)]
    pub family_text: FamilyText,
    /// Counts of protocol messages, by class and by what became of them.
    pub messages: Messages,
    /// Messages between agents, bodies and controller: actions, percepts, contact changes, reports, orders.
    /// They are not protocol messages.
    pub body_messages: u64,
    /// Orders and reports, which are among the messages before; null on `ipc`, where they are not told apart.
    #[serde(default)]
    pub controller: Option<ControllerReport>,
    /// The scripted operator, and the measures of the team; null without one.
    #[serde(default)]
    pub operator: Option<OperatorReport>,
    /// The hosts, and what crossed between them; null if there was one host only.
    #[serde(default)]
    pub hosts: Option<HostsReport>,
    /// Durations of the run.
    pub time: Times,
    /// Invariant checks and violations.
    pub invariants: Invariants,
    /// Faults that struck, by time, including those from outside the run.
    pub faults: Vec<FaultReport>,
    /// Faults of the plan, including those after the end of the run.
    pub faults_planned: u64,
    /// Notes for the reader, such as processes that died without a fault.
    pub notes: Vec<String>,
    /// Where the logs of the run are; null on `sim`, and in reports of earlier versions.
    #[serde(default)]
    pub logs: Option<LogsReport>,
    /// Why the journal of the run is not whole; null if it is, or if none was asked for.
    #[serde(default)]
    pub incomplete_journal: Option<String>,
    /// 16 hexadecimal digits, equal for two runs with the same events by time, module and kind; null on
    /// `ipc`.
    pub trace_hash: Option<String>,
    /// 16 hexadecimal digits, equal for two runs whose agents and bodies were also in the same states,
    /// sampled after a fixed number of events and at the end; null on `ipc`.
    pub state_hash: Option<String>,
    /// The hash of the state of all agents at the end, also shown by `metamorph replay`; null on `ipc`.
    pub agents_hash: Option<String>,
    /// The hash of the state of the world at the end, also shown by `metamorph replay`. On `ipc` it includes
    /// times, so it differs between runs. Null in reports of earlier versions.
    pub world_hash: Option<String>,
    /// The command that repeats the run.
    pub repeat: String,
    /// The machine that ran it.
    pub machine: Machine,
}

/// Where the logs of a run of processes are.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct LogsReport {
    /// The name of the run, which its log lines and metrics carry.
    pub run: String,
    /// Where each host writes.
    pub hosts: Vec<LogPlace>,
}

impl LogsReport {
    /// Returns the places as text; with one host, without its name.
    pub fn places(&self) -> Vec<String> {
        match &self.hosts[..] {
            [only] => vec![only.place.clone()],
            hosts => hosts.iter().map(|LogPlace { host, place, .. }| format!("{host} {place}")).collect(),
        }
    }
}

/// Where one host writes its log.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct LogPlace {
    /// Its name.
    pub host: String,
    /// The place, in words.
    pub place: String,
    /// The directory of its modules' own logs until the run ends, which is removed then; null on other hosts.
    pub modules: Option<String>,
}

/// What passed between the controller and the agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerReport {
    /// Orders to living agents.
    pub orders: u64,
    /// Reports of agents.
    pub reports: u64,
    /// Bytes of both, headers included; what was sent again counts once.
    pub bytes: u64,
    /// Sendings that were lost, each of which was made again.
    pub lost: u64,
}

/// Processes or simulated agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Agents {
    /// Modules of the swarm, each started once.
    pub launched: u64,
    /// Alive at the end.
    pub alive: u64,
    /// Deaths, including those followed by a restart.
    pub crashed: u64,
    /// Starts after a death.
    pub restarted: u64,
}

/// The progress of a goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GoalReport {
    /// Cells of the goal; of metamodules, its seeds.
    pub cells: u64,
    /// Cells filled by a finalized module, or occupied by a dead one; seeds filled by a settled
    /// metamodule, or by a dead one.
    pub filled: u64,
}

/// One goal of the run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageReport {
    /// Its name in the scenario.
    pub name: String,
    /// Cells, or seeds, of the goal.
    pub cells: u64,
    /// Cells, or seeds, filled at the end.
    pub filled: u64,
    /// Cells that the shape has besides `cells`, and that its growth leaves out.
    #[serde(default)]
    pub omitted: u64,
    /// Time at which it was opened.
    pub opened_s: f64,
    /// Time at which the last cell was filled; null if never.
    pub built_s: Option<f64>,
    /// Time at which the swarm itself knew that all cells were filled; null if the run ended before.
    pub known_s: Option<f64>,
    /// From `built_s` to `known_s`, 0 if it was known first; null if either is null.
    pub detect_lag_s: Option<f64>,
}

impl StageReport {
    /// Returns which share of its shape the goal is, in words, if its growth leaves cells out.
    pub fn share_of_shape(&self) -> Option<String> {
        let shape = self.cells + self.omitted;
        let share = || {
            let (cells, shape) = (count(self.cells), count(shape));
            format!("{cells} of the {shape} cells of your shape; its growth leaves out the others")
        };
        (self.omitted > 0).then(share)
    }
}

/// A standstill, and why goal cells stay unfilled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Standstill {
    /// Time of the last progress.
    pub since_s: f64,
    /// `blocked`, `pinned`, `material-exhausted`, `no-active-target` or `no-way`; of metamodules `material-exhausted`,
    /// `seed-blocked`, `no-way`, `misplaced`, `no-better-place`, `no-lock` or `blocked`.
    pub reason: String,
    /// Whether it is proved that no protocol could have made progress from here: `possible` is `no`.
    pub infeasible: bool,
    /// Whether modules that nothing holds in place could have filled more of the goal: `no` if that is proved
    /// impossible, `yes` if a search found a plan, `undecided` if the search reached its bound or was not
    /// made (large swarms, the published strategies of metamodules, `sweep`).
    #[serde(default = "undecided")]
    pub possible: String,
    /// The widest rules under which progress is proved impossible: `held` (connections that may carry a
    /// broken module are not released), `carried` (walkers carry none), `grown` (what is built stays) or `anything`; null if nothing is proved.
    #[serde(default)]
    pub impossible_within: Option<String>,
    /// The moves of the plan that was found; null if there is none.
    #[serde(default)]
    pub way: Option<u64>,
    /// The last three fields as text.
    #[serde(default)]
    pub prospect: String,
    /// The reason as text.
    pub text: String,
    /// Goal cells that are not filled; of seeds, the cells of their feet.
    pub unfilled: Vec<[i16; 3]>,
    /// Objectives that are not reached, as text: goal cells by their coordinates.
    #[serde(default)]
    pub open: Vec<String>,
    /// Modules that wait for each other in a cycle; empty if there is none.
    pub wait_cycle: Vec<u32>,
    /// Spare modules that have a path to a goal cell and do not take it (the first 20); of metamodules, all
    /// that are free.
    pub waiting: Vec<Waiting>,
    /// When the swarm itself detected the deadlock, if it did (`detector = true`).
    pub detected: Option<Detected>,
    /// The proof of the standstill under `negotiated`; null if there is none, and for cubes.
    #[serde(default)]
    pub proof: Option<ProofReport>,
}

/// The standstills in the course of a run. Without help of the controller or of an operator, the run would have ended at the
/// first that did not end by itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StandstillsReport {
    /// How far the controller may help modules that stand still: `off`, `calls` or `plans`; `none` for families in which it does
    /// not.
    pub rescue: String,
    /// The number of standstills.
    pub count: u64,
    /// The number of those that the controller resolved: by calls, by a plan, or by moving the goal.
    pub rescued: u64,
    /// The number of standstills by what ended them: `itself`, `call`, `plan`, `relocation`, `operator` or `nothing`.
    pub ended: BTreeMap<String, u64>,
    /// The first hundred standstills.
    pub events: Vec<StandstillEvent>,
}

/// One standstill in the course of a run: no module moved for a quarter of the bound of a deadlock, or modules moved for half of
/// the bound of a livelock and filled no cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StandstillEvent {
    /// Time of the last progress.
    pub since_s: f64,
    /// Time at which it was noticed.
    pub noticed_s: f64,
    /// Time at which it ended: modules moved that the controller had not called, or the goal was built. Null if the run ended
    /// first.
    pub until_s: Option<f64>,
    /// `itself`, `call`, `plan`, `relocation`, `operator` or `nothing`.
    pub ended_by: String,
    /// True if modules moved without filling a cell.
    pub moving: bool,
    /// The reason, as in a standstill that ends a run. No search was made.
    pub reason: String,
    /// The reason as text.
    pub text: String,
    /// Goal cells that were not filled; of seeds, the cells of their feet.
    pub unfilled: Vec<[i16; 3]>,
    /// Objectives that were not reached, as text: goal cells by their coordinates.
    pub open: Vec<String>,
    /// Modules that waited for each other in a cycle; empty if there was none.
    pub wait_cycle: Vec<u32>,
    /// Who waited, for whom, and why.
    pub waiting: Vec<Waiting>,
    /// Moves of called modules while it lasted.
    pub called: u64,
    /// Moves led by a plan while it lasted.
    pub led: u64,
}

/// A proof by exhaustive search that no moves of the free metamodules, in any order, fill one more seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProofReport {
    /// The number of reachable arrangements of bodies, all of which were examined.
    pub arrangements: u64,
    /// With `relocate = true`, the number of placements free of obstacles, at each of which the goal is
    /// proved unbuildable; null if the goal may not be moved.
    pub places: Option<u64>,
}

/// The default of reports without a search.
fn undecided() -> String {
    "undecided".to_owned()
}

/// A deadlock detected by the swarm itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detected {
    /// Time of the detection.
    pub at_s: f64,
    /// The module that counted all the others.
    pub by: u32,
}

/// A module that waits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Waiting {
    /// Its number.
    pub module: u32,
    /// The module it waits for, if it reported one.
    pub waits_for: Option<u32>,
    /// Why it makes no progress, as text to follow its name.
    pub why: String,
}

/// Attempts to use one cell twice; the body of a cube also refuses a move whose support is missing.
///
/// For metamodules, `prevented + refused` is comparable to the collisions ("CL") in tables 4.1 and 4.2 of the
/// thesis, which leaves out those of runs that were not built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Collisions {
    /// The sum of prevented, refused and suffered.
    pub attempted: u64,
    /// Prevented between modules: by negotiation, of metamodules by locks.
    pub prevented: u64,
    /// Refused by the body itself; of metamodules, the interlock.
    pub refused: u64,
    /// Two modules in one cell. Must be 0.
    pub suffered: u64,
}

/// Results of moves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MoveReport {
    /// Begun.
    pub started: u64,
    /// Ended at the intended place.
    pub completed: u64,
    /// Failed, by a stuck joint or a failed connection, and rolled back.
    pub failed: u64,
    /// Refused by the body because a cell was taken or a support missing.
    pub refused_taken: u64,
    /// Refused by the body because the grants would have expired before the end of the move.
    pub refused_late: u64,
    /// Refused by the body because contacts had changed since the decision.
    pub refused_stale: u64,
    /// Refused by the body as impossible from its state, or because it was already acting; 0 for cubes.
    pub refused_impossible: u64,
    /// Completed by cubes that the controller had called to an unfilled cell; 0 for other modules.
    #[serde(default)]
    pub called: u64,
    /// Completed by modules that the controller led by a plan for the whole swarm: by cubes, if calls did not help; of metamodules
    /// under `planned` and of free modules that reconfigure, all moves.
    #[serde(default)]
    pub led: u64,
}

/// Protocol messages. For every class `sent + duplicated = delivered + lost + overflowed + expired + refused
/// + in_flight`. Both ends of a link count; if the counts do not add up in a run without killed or stopped
/// processes, the invariant `messages-balance` is violated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Messages {
    /// Handed to the link.
    pub total: u64,
    /// Their bytes, headers included.
    pub bytes: u64,
    /// All classes together.
    pub all: ClassCounts,
    /// Counts by class: gradient, seed, connectivity, negotiation, world, liveness, gait.
    pub by_class: BTreeMap<String, ClassCounts>,
    /// Latencies of the messages delivered; `null` if none was measured.
    #[serde(default)]
    pub latency: Option<LatencyReport>,
}

/// Latencies of the messages delivered, in scenario time from sending to the input of the receiver. What waits for a process
/// that is stopped counts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LatencyReport {
    /// All classes together.
    pub all: Quantiles,
    /// By class; without classes of which no message was measured.
    pub by_class: BTreeMap<String, Quantiles>,
    /// Of these, the time in the channels between processes, which is the machine's; `null` on `sim`.
    pub channel: Option<Quantiles>,
}

/// Quantiles of durations in seconds, none below the exact one and none more than a sixteenth above it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Quantiles {
    /// Number of messages measured. With processes fewer than those delivered: the last of an agent that is killed, and those
    /// that came from another host, are missing.
    pub count: u64,
    /// The shortest, which is not exact either.
    pub least_s: f64,
    /// Not exceeded by half of the messages.
    pub p50_s: f64,
    /// Not exceeded by 90 % of the messages.
    pub p90_s: f64,
    /// Not exceeded by 99 % of the messages.
    pub p99_s: f64,
    /// Not exceeded by 99.9 % of the messages.
    pub p999_s: f64,
    /// Not exceeded by any message.
    pub greatest_s: f64,
}

/// Counts of one class of messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ClassCounts {
    /// Handed to the link by agents.
    pub sent: u64,
    /// Handed to agents by the link.
    pub delivered: u64,
    /// Lost in transit, or cut off by a partition.
    pub lost: u64,
    /// Extra copies made in transit.
    pub duplicated: u64,
    /// Dropped because an inbox was full.
    pub overflowed: u64,
    /// Arrived after their contact had ended, or at a dead process.
    pub expired: u64,
    /// Arrived damaged and refused.
    pub refused: u64,
    /// In flight when the run ended.
    pub in_flight: i64,
    /// Messages in flight that no process has counted: to or from a killed process, or to one that was
    /// stopped until the contact had ended; 0 on `sim`.
    #[serde(default)]
    pub uncounted: i64,
    /// Bytes of the messages sent, headers included.
    pub bytes: u64,
}

/// Durations of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Times {
    /// Scenario time from the start to the end.
    pub virtual_s: f64,
    /// The same, as a multiple of the time of a move; of metamodules, of a step of a joint.
    pub move_times: f64,
    /// Real time from the first event to the last.
    pub wall_s: f64,
    /// Real time before the first event.
    pub setup_s: f64,
    /// How far the clock was slowed because the machine was too busy for the agents; null on `sim`.
    #[serde(default)]
    pub slowed: Option<SlowedReport>,
}

/// How far the clock of a run was slowed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SlowedReport {
    /// Mean speed of scenario time, as a share of `time_scale`: 1 if it was never slowed.
    pub factor: f64,
    /// The lowest speed at which time passed, as a share of `time_scale`.
    pub lowest: f64,
    /// Real time, in seconds, that passed at less than `time_scale`.
    pub real_s: f64,
}

/// Invariant checks and violations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Invariants {
    /// Checks made.
    pub checked: u64,
    /// Violations found.
    pub broken: u64,
    /// The first hundred violations.
    pub violated: Vec<ViolationReport>,
}

/// A violation of an invariant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViolationReport {
    /// The name of the invariant.
    pub invariant: String,
    /// Time of the violation.
    pub at_s: f64,
    /// What was observed.
    pub what: String,
}

/// A fault and its effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FaultReport {
    /// Time at which it struck.
    pub at_s: f64,
    /// The name of the fault or command, its first word: `kill`, `pause`, `resume`, `restart`, `stick`, `unstick`, one of the
    /// family's world such as `block`, `drop` or `goal.move`, `hold` and the like; `partition` and its end, `heal`; `external`:
    /// a process killed, stopped or continued by something outside the run; or `lost`: a host, with all its processes.
    pub fault: String,
    /// The module; null if it hit a cell or links.
    pub module: Option<u32>,
    /// `scenario`; `operator` and a number, for a command; or `external`. Empty in reports of earlier versions.
    #[serde(default)]
    pub by: String,
    /// The state of the module when it struck; for `external` also what was done, for `partition` the modules
    /// cut off, for `lost` the host and why it counts as lost.
    pub effect: String,
}

/// The machine of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Machine {
    /// The operating system.
    pub os: String,
    /// The processor architecture.
    pub arch: String,
    /// Processors available to the program.
    pub cores: u64,
    /// `debug` or `release`.
    pub build: String,
}

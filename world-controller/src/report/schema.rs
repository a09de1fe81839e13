//! The report as it is written to JSON. A field is never renamed, given another meaning or removed
//! without a new [`SCHEMA`]; new ones may be added. Times end in `_s` and are seconds of scenario
//! time unless they say otherwise.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The version of this layout.
pub const SCHEMA: u32 = 1;

/// What [`FaultReport`] calls something that was done to a process from outside the run.
pub const EXTERNAL: &str = "external";

/// What a run did.
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
    /// What was run: `cube` or `metamodule`.
    pub family: String,
    /// The seed of the run.
    pub seed: u64,
    /// What carried the messages: `ipc` or `sim`.
    pub link: String,
    /// `built`, `deadlock`, `livelock`, `timeout`, `unsafe` or `aborted`.
    pub outcome: String,
    /// Why, in words.
    pub reason: String,
    /// Processes (`ipc`) or agents (`sim`).
    pub agents: Agents,
    /// The goal that was being built last.
    pub goal: GoalReport,
    /// Every goal that was begun; of metamodules, whose goals replace one another, the one that was being
    /// built last.
    pub stages: Vec<StageReport>,
    /// The standstill, if the outcome of the run was a deadlock.
    pub deadlocks: Vec<Standstill>,
    /// What was found, if the outcome of the run was a livelock.
    pub livelocks: Vec<Standstill>,
    /// Why goal cells are unfilled, whatever the outcome; null if all are filled or nobody looked.
    pub unbuilt: Option<Standstill>,
    /// Attempts to use one cell twice; the body of a cube also refuses a move whose support is missing.
    pub collisions: Collisions,
    /// Moves completed. A move of a metamodule is all that it does between two connections.
    pub moves: u64,
    /// What became of moves; of metamodules, of all steps of joints, connections and releases.
    pub move_details: MoveReport,
    /// What only metamodules have; null for other families.
    pub metamodules: Option<MetamoduleReport>,
    /// Protocol messages.
    pub messages: Messages,
    /// Messages between agents, bodies and controller: actions, percepts, contact changes, reports,
    /// orders. They are no protocol messages.
    pub body_messages: u64,
    /// How long it took.
    pub time: Times,
    /// What must always hold.
    pub invariants: Invariants,
    /// Faults that struck, in order, those from outside the run included.
    pub faults: Vec<FaultReport>,
    /// Faults that the plan contained, those that came too late included.
    pub faults_planned: u64,
    /// What else happened that a reader should know.
    pub notes: Vec<String>,
    /// 16 hexadecimal digits that two runs share if they were the same event by event, by time, module and
    /// kind; null on `ipc`.
    pub trace_hash: Option<String>,
    /// 16 hexadecimal digits that two runs share if their agents and bodies were also in the same states, as
    /// looked at every so many events and at the end; null on `ipc`.
    pub state_hash: Option<String>,
    /// The hash of the state of all agents at the end, which `metamorph replay` shows too; null on `ipc`.
    pub agents_hash: Option<String>,
    /// The hash of the state of the world at the end, which `metamorph replay` shows too. On `ipc` it says
    /// when what happened, so no two runs share it. Null in reports of earlier versions.
    pub world_hash: Option<String>,
    /// The command that repeats the run.
    pub repeat: String,
    /// What it ran on.
    pub machine: Machine,
}

/// Processes or simulated agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Agents {
    /// Modules of the swarm, each started once.
    pub launched: u64,
    /// Alive at the end.
    pub alive: u64,
    /// Deaths, those before a restart included.
    pub crashed: u64,
    /// Starts after a death.
    pub restarted: u64,
}

/// How much of a goal is there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GoalReport {
    /// Cells of the goal; of metamodules, its seeds.
    pub cells: u64,
    /// Cells filled by a finalized module, or occupied by a dead one; seeds filled by a settled
    /// metamodule, or by a dead one.
    pub filled: u64,
}

/// One goal of several.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StageReport {
    /// What the scenario calls it.
    pub name: String,
    /// Cells, or seeds, of the goal.
    pub cells: u64,
    /// Cells, or seeds, filled at the end.
    pub filled: u64,
    /// When it was begun.
    pub opened_s: f64,
    /// When the last cell was filled; null if never.
    pub built_s: Option<f64>,
    /// When the swarm itself knew that all cells were filled; null if the run ended before.
    pub known_s: Option<f64>,
    /// From built to known, 0 if it was known first; null if either is.
    pub detect_lag_s: Option<f64>,
}

/// Why goal cells stay unfilled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Standstill {
    /// Since when nothing went on.
    pub since_s: f64,
    /// `blocked`, `pinned`, `cut-off`, `material-exhausted`, `no-active-target`, `needs-dead-support`, `no-way`; of
    /// metamodules `material-exhausted`, `seed-blocked`, `no-way`, `misplaced`, `no-better-place`, `no-lock` or
    /// `blocked`.
    pub reason: String,
    /// Whether it is proved that no protocol could have gone on from here: `possible` is `no`.
    pub infeasible: bool,
    /// Whether live modules that can hear of the goal could have filled more of it: `no` if that is proved
    /// impossible, `yes` if a search found a way, `undecided` if it did not end or was not made (large
    /// swarms, the published strategies of metamodules, `sweep`).
    #[serde(default = "undecided")]
    pub possible: String,
    /// The widest rules within which it is proved that nothing more could be done: `held` (what may hang on
    /// a broken module is not let go), `called` (live modules that can hear of the goal), `grown` (all, but
    /// what is built stays) or `anything`; null if nothing is proved.
    #[serde(default)]
    pub impossible_within: Option<String>,
    /// The moves of the way that was found; null if there is none.
    #[serde(default)]
    pub way: Option<u64>,
    /// The last three in words.
    #[serde(default)]
    pub prospect: String,
    /// The reason in words.
    pub text: String,
    /// Goal cells that are not filled; of seeds, the cells of their feet.
    pub unfilled: Vec<[i16; 3]>,
    /// Modules that wait for each other in a circle; empty if none do.
    pub wait_cycle: Vec<u32>,
    /// Spare modules that have a way to a goal cell and do not take it (the first 20); of metamodules,
    /// all that are free.
    pub waiting: Vec<Waiting>,
    /// When the swarm itself found out that nobody can go on, if it did (`detector = true`).
    pub detected: Option<Detected>,
    /// What is proved of metamodules under `negotiated`; null if nothing is, and for cubes.
    #[serde(default)]
    pub proof: Option<ProofReport>,
}

/// A proof by exhaustive search that no moves of the free metamodules, in any order, fill one more seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProofReport {
    /// The number of arrangements of bodies that can be reached, all of which were looked at.
    pub arrangements: u64,
    /// With `relocate = true`, the number of places that are clear of everything that stays, at each of which it
    /// is proved that the goal cannot be built; null if the goal may not be moved.
    pub places: Option<u64>,
}

/// What is known where nobody has looked.
fn undecided() -> String {
    "undecided".to_owned()
}

/// What the swarm itself found out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Detected {
    /// When.
    pub at_s: f64,
    /// Which module counted all the others.
    pub by: u32,
}

/// A module that waits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Waiting {
    /// Who.
    pub module: u32,
    /// For whom, if it said.
    pub waits_for: Option<u32>,
    /// Why it does not go on, in words to follow its name.
    pub why: String,
}

/// Attempts to use one cell twice; the body of a cube also refuses a move whose support is missing.
///
/// Of metamodules, `prevented + refused` is what can be compared with the collisions ("CL") in tables
/// 4.1 and 4.2 of the thesis, which leaves out those of runs that were not built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Collisions {
    /// All: prevented by negotiation, refused by the body, suffered.
    pub attempted: u64,
    /// Prevented between modules: by negotiation, of metamodules by locks.
    pub prevented: u64,
    /// Refused by the body itself; of metamodules, the interlock.
    pub refused: u64,
    /// Two modules in one cell. Must be 0.
    pub suffered: u64,
}

/// What became of moves.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MoveReport {
    /// Begun.
    pub started: u64,
    /// Ended where they should.
    pub completed: u64,
    /// Failed, by a stuck joint or a failed connection, and rolled back.
    pub failed: u64,
    /// Refused by the body because a cell was taken or a support missing.
    pub refused_taken: u64,
    /// Refused by the body because the grants they rest on would have ended before them.
    pub refused_late: u64,
    /// Refused by the body because contacts had changed since the decision.
    pub refused_stale: u64,
    /// Refused by the body because it could not do that from where it was, or was acting already; 0 for
    /// cubes.
    pub refused_impossible: u64,
}

/// What only metamodules have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetamoduleReport {
    /// `PAR`, `PER`, `SRS` or `SRZ`.
    pub kind: String,
    /// How they decided: `greedy`, `slope`, `step` or `negotiated`.
    pub strategy: String,
    /// The levels of the goal that was being built last, from the ground up.
    pub levels: Vec<LevelReport>,
    /// How far that goal was moved along x and y, to where it could be built.
    pub shift: [i16; 2],
    /// Steps of joints.
    pub turns: u64,
    /// Connections made; the same as `moves`.
    pub connections: u64,
    /// Ends let go.
    pub releases: u64,
    /// When the last seed was filled; 0 if none was.
    pub last_fill_s: f64,
}

/// One level of a goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LevelReport {
    /// Its seeds.
    pub seeds: u64,
    /// Those of them that were filled at the end.
    pub filled: u64,
}

/// Protocol messages. For every class `sent + duplicated = delivered + lost + overflowed + expired +
/// refused + in_flight`. Both ends of a link count; a run in which no process was killed or stopped and
/// whose counts do not add up has broken the invariant `messages-balance`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Messages {
    /// Handed to the link.
    pub total: u64,
    /// Bytes of those, headers included.
    pub bytes: u64,
    /// All classes together.
    pub all: ClassCounts,
    /// By what messages are for: gradient, seed, connectivity, negotiation, world, liveness.
    pub by_class: BTreeMap<String, ClassCounts>,
}

/// Counts of one class of messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ClassCounts {
    /// Handed to the link by agents.
    pub sent: u64,
    /// Handed to agents by the link.
    pub delivered: u64,
    /// Lost on the way, or cut off by a partition.
    pub lost: u64,
    /// Extra copies made on the way.
    pub duplicated: u64,
    /// Dropped because an inbox was full.
    pub overflowed: u64,
    /// Arrived after their contact had ended, or at a dead process.
    pub expired: u64,
    /// Arrived damaged and refused.
    pub refused: u64,
    /// Not arrived when the run ended.
    pub in_flight: i64,
    /// Those of them that no process has counted: under way to or from one that was killed, or to one that was
    /// stopped until the contact had ended; 0 on `sim`.
    #[serde(default)]
    pub uncounted: i64,
    /// Bytes of the messages sent, headers included.
    pub bytes: u64,
}

/// How long a run took.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Times {
    /// Scenario time from the start to the end.
    pub virtual_s: f64,
    /// The same, in durations of a move; of metamodules, of a step of a joint.
    pub move_times: f64,
    /// Real time from the first event to the last.
    pub wall_s: f64,
    /// Real time before that.
    pub setup_s: f64,
    /// By how much the clock was slowed because the machine was too busy for the agents to keep up; null on
    /// `sim`.
    #[serde(default)]
    pub slowed: Option<SlowedReport>,
}

/// By how much the clock of a run was slowed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SlowedReport {
    /// The mean speed of scenario time, as a share of `time_scale`: 1 if it was never slowed.
    pub factor: f64,
    /// The lowest speed that was set, as a share of `time_scale`.
    pub lowest: f64,
    /// Real time, in seconds, that passed at less than `time_scale`.
    pub real_s: f64,
}

/// What must always hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Invariants {
    /// How often one was checked.
    pub checked: u64,
    /// How often one was broken.
    pub broken: u64,
    /// The first hundred of those.
    pub violated: Vec<ViolationReport>,
}

/// An invariant that did not hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ViolationReport {
    /// Its name.
    pub invariant: String,
    /// When.
    pub at_s: f64,
    /// What was seen.
    pub what: String,
}

/// A fault and what it did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FaultReport {
    /// When it struck.
    pub at_s: f64,
    /// `kill`, `pause`, `resume`, `restart`, `stick`, `unstick`, `block`, `unblock`; `partition` and its
    /// end, `heal`; or `external`: a process killed, stopped or continued by something outside the run.
    pub fault: String,
    /// Whom it hit; null if it hit a cell or links.
    pub module: Option<u32>,
    /// The state it found the module in; of `external` also what was done, of `partition` who is cut off.
    pub effect: String,
}

/// What a run ran on.
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

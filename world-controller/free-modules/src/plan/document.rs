//! The files of planning: structures that are read, plans that are written and checked, and the result as JSON.

use metamorph_protocol::assembly::action::Connectors;
use metamorph_protocol::assembly::checker::PhysicalAction;
use metamorph_protocol::assembly::collision::Model;
use metamorph_protocol::assembly::space::Objective;
use metamorph_protocol::plan::Progress;
use metamorph_protocol::roombots::connector::Connector;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The word that begins a structure file.
pub const STRUCTURE: &str = "metamorph structure";
/// The word that begins a plan file.
pub const PLAN: &str = "metamorph plan";
/// The version of both formats.
pub const VERSION: u32 = 1;

/// A structure of free modules: a shape, or with poses of all modules a configuration.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Structure {
    /// `metamorph structure`.
    pub format: String,
    /// 1.
    pub version: u32,
    /// The modules, numbered from 0; all with poses or none.
    pub modules: Vec<Module>,
    /// The joined faces: the cells on both sides.
    pub joined: Vec<[[i64; 3]; 2]>,
}

/// A structure given by its connectors.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConnectedStructure {
    /// `metamorph structure`.
    pub format: String,
    /// 1.
    pub version: u32,
    /// The number of modules, numbered from 0.
    pub modules: usize,
    /// The connections.
    pub connections: Vec<ConnectionEntry>,
    /// Joint values q1, q2, q3 of every module in degrees; 0 if absent. A ring closes with bent joints only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joints_deg: Option<Vec<[f64; 3]>>,
}

/// A connection of two connectors.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConnectionEntry {
    /// A module.
    pub a: u32,
    /// Its connector, C0X to C3Z.
    #[schemars(with = "String")]
    pub at: Connector,
    /// The other module.
    pub b: u32,
    /// Its connector.
    #[schemars(with = "String")]
    pub to: Connector,
    /// Quarter turns 0 to 3 of `b` about the outward normal of `at`. At 0, the diagonal axes of two modules joined end
    /// to end are parallel.
    pub rotation: u8,
}

/// A structure file: by cells and joined faces, or by connectors.
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum StructureFile {
    /// By cells and joined faces.
    Cells(Structure),
    /// By connectors.
    Connected(ConnectedStructure),
}

/// A module of a structure.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "a module is two cells, or an object of cells, foot_rotation and three joints_deg"
)]
pub enum Module {
    /// Its two cells.
    Cells([[i64; 3]; 2]),
    /// Its two cells and its pose.
    Posed(Posed),
}

/// A module with its pose.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Posed {
    /// The cells, that of C0X first.
    pub cells: [[i64; 3]; 2],
    /// The rows of the rotation of the foot frame; its z looks away from C0X.
    pub foot_rotation: [[i8; 3]; 3],
    /// The joint values in degrees: 0, ±120; 0, ±90, 180; 0, ±120.
    pub joints_deg: [f64; 3],
}

/// A plan.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanFile {
    /// `metamorph plan`.
    pub format: String,
    /// 1.
    pub version: u32,
    /// The configuration that it begins in.
    pub start: Structure,
    /// The shape or configuration that it ends in.
    pub goal: Structure,
    /// What the cost counts: actions, connections, turns or moves.
    #[schemars(with = "String")]
    pub objective: Objective,
    /// What a turn may touch: final, core or strict.
    #[schemars(with = "String")]
    pub collision: Model,
    /// Which connectors can connect: all or active.
    #[schemars(with = "String")]
    pub connectors: Connectors,
    /// What the structure stands on; absent in free assembly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground: Option<GroundEntry>,
    /// The actions in an order in which they can be carried out.
    pub actions: Vec<Step>,
    /// The cost.
    pub cost: u32,
    /// The proven lower bound of the cost of every plan.
    pub lower: u32,
    /// The planner.
    pub planner: String,
    /// The states that the planner expanded.
    pub expanded: u64,
}

/// What a structure stands on. Up is +z of the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GroundEntry {
    /// The module that is held.
    pub module: usize,
    /// True if it is held by its head, false by its foot.
    pub head: bool,
    /// True if the floor is solid; it lies below the lowest cell of the start.
    pub floor: bool,
    /// True if the static torque of joints is limited.
    pub gravity: bool,
}

/// An action of a plan.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// What is done.
    #[serde(rename = "do")]
    pub what: What,
    /// The actions that must have been done before, by their numbers from 0.
    pub after: Vec<usize>,
    /// The fingerprint of the configuration before it, as 16 hexadecimal digits.
    pub from: String,
    /// The fingerprint afterwards.
    pub to: String,
}

/// What an action does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum What {
    /// Two connectors begin to hold: module and connector of both.
    Attach(#[schemars(with = "[(usize, String); 2]")] [(usize, Connector); 2]),
    /// A connection ends.
    Detach(#[schemars(with = "[(usize, String); 2]")] [(usize, Connector); 2]),
    /// A joint turns by a step: module, joint from 1, and degrees.
    Turn(usize, usize, i16),
}

impl What {
    /// Returns the action as the checker understands it; `None` if its joint or its angle does not exist.
    pub fn action(&self) -> Option<PhysicalAction> {
        match *self {
            What::Attach([a, b]) => Some(PhysicalAction::Attach(a, b)),
            What::Detach([a, b]) => Some(PhysicalAction::Detach(a, b)),
            What::Turn(module, joint @ 1..=3, degrees) => {
                let step = if joint == 2 { 90 } else { 120 };
                (degrees.abs() == step).then_some(PhysicalAction::Turn(module, joint - 1, degrees > 0))
            }
            What::Turn(..) => None,
        }
    }
    /// Returns the action of the checker.
    pub fn of(action: PhysicalAction) -> What {
        match action {
            PhysicalAction::Attach(a, b) => What::Attach([a, b]),
            PhysicalAction::Detach(a, b) => What::Detach([a, b]),
            PhysicalAction::Turn(module, joint, positive) => {
                let step = if joint == 1 { 90 } else { 120 };
                What::Turn(module, joint + 1, if positive { step } else { -step })
            }
        }
    }
}

/// How a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// A plan was found whose cost is proven to be the least.
    Optimal,
    /// A plan was found; `factor` says how far from the least it is at most.
    Bounded,
    /// There is no plan: all states that can be reached were examined.
    Impossible,
    /// A limit was reached without a plan.
    Undecided,
}

/// The result of `metamorph plan --json`.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Answer {
    /// How the search ended.
    pub verdict: Verdict,
    /// What ran out: memory, work, cost, time or interrupt.
    pub ended_by: Option<String>,
    /// The planner.
    pub planner: String,
    /// The cost of the plan.
    pub cost: Option<u32>,
    /// The proven lower bound of the cost of every plan.
    pub lower: u32,
    /// The cost divided by the bound.
    pub factor: Option<f64>,
    /// What the plan consists of.
    pub counts: Option<Counts>,
    /// The work done.
    #[schemars(with = "serde_json::Value")]
    pub progress: Progress,
    /// The plan.
    pub plan: Option<PlanFile>,
}

/// What a plan consists of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Counts {
    /// Attachments, detachments and steps of joints.
    pub actions: u32,
    /// Steps of joints of ±120° or ±90°.
    pub turns: u32,
    /// Attachments.
    pub attachments: u32,
    /// Detachments.
    pub detachments: u32,
    /// Sections of the plan that end in an attachment, and the last one (thesis 5.1.4).
    pub moves: u32,
    /// Cubes lifted, summed over all turns; of each turn those of the smaller side.
    pub lifted: u32,
    /// Actions one after another if independent ones are carried out together.
    pub makespan: u32,
}

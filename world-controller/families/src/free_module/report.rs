//! The results that only free modules have, as a part of the report.

use super::walking::report::WalkReport;
use crate::connection::ConnectionReport;
use metamorph_report::family_part::{FamilyPart, FamilyText};
use metamorph_report::schema::MoveReport;
use metamorph_text::format::{count, many};
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The field of the report.
pub const KEY: &str = "free_modules";

/// Additional results of free modules.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FreeModuleReport {
    /// The model of bodies: `lattice`.
    pub body: String,
    /// Steps of joints.
    pub turns: u64,
    /// Connections made.
    pub attachments: u64,
    /// Connections given up.
    pub detachments: u64,
    /// The work of the planner.
    pub plan: FreePlanReport,
    /// Attempts to close a connector; left out without `[swarm.connection]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub connecting: Option<ConnectionReport>,
}

/// The work of the planner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FreePlanReport {
    /// Plans made.
    pub plans: u64,
    /// Actions of the first plan.
    pub actions: u64,
    /// The cost of the first plan.
    pub cost: u64,
    /// The proven lower bound of the cost of every plan from the start.
    pub bound: u64,
    /// The hash of the first plan, as 16 hexadecimal digits: equal for equal plans.
    pub hash: String,
    /// Orders of steps, without repeats; a connection takes two.
    pub orders: u64,
    /// Orders repeated because there was no answer.
    pub repeated: u64,
    /// Actions confirmed.
    pub confirmed: u64,
    /// Steps that failed.
    pub failed: u64,
    /// Steps without an answer in time.
    pub late: u64,
    /// Expansions of the planner; 20,000 take one second of scenario time.
    pub work: u64,
}

/// Returns the JSON schema of the field.
pub fn schema() -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize().with(|s| s.inline_subschemas = true);
    let lattice = settings.clone().into_generator().into_root_schema_for::<FreeModuleReport>();
    let physics = settings.into_generator().into_root_schema_for::<WalkReport>();
    json!({ "anyOf": [lattice.to_value(), physics.to_value()] })
}

/// Returns the field and its text.
pub fn part(report: &FreeModuleReport, bodies: &MoveReport) -> FamilyPart {
    let actions = [
        many(report.turns, "joint step"),
        many(report.attachments, "connection"),
        many(report.detachments, "release"),
    ]
    .join(", ");
    let plan = &report.plan;
    let mut moves = vec![
        (
            "actions",
            format!(
                "{} completed of {} begun, {} failed: {actions}",
                count(bodies.completed),
                count(bodies.started),
                count(bodies.failed)
            ),
        ),
        (
            "plan",
            format!(
                "{}, the first of {} (cost {}, at least {}) with hash {}; {} confirmed",
                many(plan.plans, "plan"),
                many(plan.actions, "action"),
                count(plan.cost),
                count(plan.bound),
                plan.hash,
                many(plan.confirmed, "action")
            ),
        ),
        (
            "orders",
            format!(
                "{}, {} repeated; {} failed, {} late",
                count(plan.orders),
                count(plan.repeated),
                many(plan.failed, "step"),
                count(plan.late)
            ),
        ),
    ];
    moves.extend(report.connecting.as_ref().map(ConnectionReport::line));
    let note = format!("Free modules on the lattice, planned centrally. Their actions are {actions}.");
    let text = FamilyText { moves, note, joint_steps: Some(report.turns) };
    FamilyPart { key: KEY, value: json!(report), text }
}

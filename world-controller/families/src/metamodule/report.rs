//! The results that only metamodules have, as a part of the report.

use crate::connection::ConnectionReport;
use metamorph_report::family_part::{FamilyPart, FamilyText};
use metamorph_report::schema::MoveReport;
use metamorph_sim_bridge::metamodule::director::GoalChange;
use metamorph_text::format::{count, listed, many, seconds};
use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Largest number of changes of the goal that the text names; JSON has all.
const CHANGES_MAX: usize = 6;

/// Puts a change of the goal into words.
pub fn goal_change(change: &GoalChange) -> String {
    match *change {
        GoalChange::Relocated((x, y)) => format!("moved by ({x}, {y}) to where it could be built"),
        GoalChange::Moved((x, y)) => format!("moved by ({x}, {y}) by command"),
        GoalChange::Turned(quarters) => format!("turned by {}° by command", u16::from(quarters) * 90),
        GoalChange::Ordered(order) => format!("order {} by command", order.name()),
        GoalChange::Dropped => "given up by command".to_owned(),
        GoalChange::Resumed => "taken up again by command".to_owned(),
    }
}

/// The field of the report.
pub const KEY: &str = "metamodules";

/// Additional results of metamodules.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetamoduleReport {
    /// `PAR`, `PER`, `SRS` or `SRZ`.
    pub kind: String,
    /// The strategy: `greedy`, `slope`, `step`, `negotiated` or `planned`.
    pub strategy: String,
    /// The levels of the last goal, from the ground up.
    pub levels: Vec<LevelReport>,
    /// How far that goal is from its place in the scenario along x and y, by whatever changed it.
    pub shift: [i16; 2],
    /// What was done to that goal while it was built, in order; left out if nothing was.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub goal_changes: Vec<String>,
    /// Steps of joints.
    pub turns: u64,
    /// Connections made; the same as `moves`.
    pub connections: u64,
    /// Connections released.
    pub releases: u64,
    /// Time at which the last seed was filled; 0 if none was.
    pub last_fill_s: f64,
    /// The work of the planner under `planned`; `null` for the others.
    pub plan: Option<PlanReport>,
    /// The passive elements; left out if there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elements: Option<ElementsReport>,
    /// Attempts to close a connector; left out without `[swarm.connection]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub connecting: Option<ConnectionReport>,
}

/// The passive elements of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ElementsReport {
    /// Elements at their goals at the end.
    pub placed: u64,
    /// Elements that are not there and that a dead metamodule holds.
    pub pinned: Vec<PinnedReport>,
    /// Elements without a transport to their goals, with the dead metamodules in the way.
    #[serde(default)]
    pub blocked: Vec<BlockedReport>,
    /// Elements that are neither at their goals nor pinned.
    pub on_the_way: u64,
    /// Elements handed over: let go while another metamodule held on.
    pub hand_overs: u64,
    /// Grips closed.
    pub grips: u64,
    /// Steps of joints with an element.
    pub carries: u64,
    /// Refusals to let an element go that would have fallen.
    pub drops_prevented: u64,
    /// Refusals of steps over the limits of torque.
    pub overloads_prevented: u64,
    /// Elements dropped by a fault.
    #[serde(default)]
    pub drops: u64,
    /// Of these, those that fell on a metamodule.
    #[serde(default)]
    pub drops_on_bodies: u64,
    /// Dropped elements that were picked up again.
    #[serde(default)]
    pub drops_recovered: u64,
    /// The largest number of elements that were on their way at a time: held, and not at their goals.
    #[serde(default)]
    pub under_way_at_most: u64,
    /// The largest number of transports under way at a time: from the first order to the end of the last step, with the walks of
    /// metamodules to and from the element.
    #[serde(default)]
    pub transports_at_most: u64,
}

/// An element that cannot be moved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PinnedReport {
    /// The element.
    pub element: String,
    /// The dead metamodule that holds it.
    pub by: u32,
}

/// An element for which no transport to its goal was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BlockedReport {
    /// The element.
    pub element: String,
    /// The dead metamodules without which there would be one; empty if there would be none either.
    pub by: Vec<u32>,
}

/// The work of the planner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlanReport {
    /// Plans made.
    pub plans: u64,
    /// Moves of the first plan.
    pub moves: u64,
    /// The least number of moves that any plan could have taken instead; 0 if it is not known.
    pub bound: u64,
    /// Orders to move.
    pub orders: u64,
    /// Moves that were not made in time.
    pub late: u64,
    /// Times that the metamodules were left to decide for themselves.
    pub handed_over: u64,
    /// Work of planning, in placements examined; 2,000,000 take one second of scenario time.
    pub work: u64,
}

/// One level of a goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LevelReport {
    /// Its seeds.
    pub seeds: u64,
    /// Seeds of the level filled at the end.
    pub filled: u64,
}

/// Returns the JSON schema of the field.
pub fn schema() -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize().with(|s| s.inline_subschemas = true);
    settings.into_generator().into_root_schema_for::<MetamoduleReport>().to_value()
}

/// Returns the field and its text. `modules` is the size of the swarm; `is_begun` says whether a seed was filled.
pub fn part(m: &MetamoduleReport, d: &MoveReport, modules: usize, is_begun: bool) -> FamilyPart {
    let per_module = m.connections as f64 / modules.max(1) as f64;
    let actions =
        [many(m.turns, "joint step"), many(m.connections, "connection"), many(m.releases, "release")];
    let levels: Vec<String> = m.levels.iter().map(|l| format!("{} of {}", l.filled, l.seeds)).collect();
    let hidden = m.goal_changes.len().saturating_sub(CHANGES_MAX);
    let first =
        if hidden > 0 { format!("; {} before", many(hidden as u64, "change")) } else { String::new() };
    let changes = m.goal_changes.iter().skip(hidden).map(|change| format!("; {change}"));
    let changed: String = std::iter::once(first).chain(changes).collect();
    let (completed, begun, failed) = (count(d.completed), count(d.started), count(d.failed));
    let mut moves = vec![
        (
            "moves",
            format!("{} completed ({per_module:.1} a metamodule of kind {})", count(m.connections), m.kind),
        ),
        (
            "actions",
            format!("{completed} completed of {begun} begun, {failed} failed: {}", actions.join(", ")),
        ),
        ("levels", format!("{} seeds, from the ground up{changed}", levels.join(", "))),
    ];
    if is_begun {
        moves.push(("last seed", format!("filled at {}", seconds(m.last_fill_s))));
    }
    moves.extend(m.connecting.as_ref().map(ConnectionReport::line));
    if let Some(plan) = &m.plan {
        let handed = match plan.handed_over {
            0 => String::new(),
            n => format!("; left to themselves {}", many(n, "time")),
        };
        let (orders, late) = (many(plan.orders, "order"), count(plan.late));
        moves.push((
            "plan",
            format!(
                "{}, the first of {} (at least {}); {orders}, {late} late{handed}",
                many(plan.plans, "plan"),
                many(plan.moves, "move"),
                count(plan.bound)
            ),
        ));
    }
    if let Some(elements) = &m.elements {
        moves.push(("elements", elements_text(elements)));
    }
    let [turns, connections, releases] = actions;
    let note = format!(
        "Kind {}, strategy {}. A move is all that a metamodule does from one connection to the next; its actions \
         are {turns}, {connections} and {releases}.",
        m.kind, m.strategy
    );
    FamilyPart { key: KEY, value: json!(m), text: FamilyText { moves, note, joint_steps: Some(m.turns) } }
}

fn elements_text(e: &ElementsReport) -> String {
    let all = e.placed + e.pinned.len() as u64 + e.on_the_way;
    let pinned: Vec<String> =
        e.pinned.iter().map(|p| format!("; {} is pinned by dead metamodule {}", p.element, p.by)).collect();
    let blocked = e.blocked.iter().map(|b| match b.by.as_slice() {
        [] => format!("; no transport was found for {}", b.element),
        by => format!("; {} has no way past dead metamodule {}", b.element, listed(by, 4)),
    });
    let blocked: String = blocked.collect();
    let prevented = match (e.drops_prevented, e.overloads_prevented) {
        (0, 0) => String::new(),
        (drops, overloads) => {
            format!("; {} and {} prevented", many(drops, "drop"), many(overloads, "overload"))
        }
    };
    let dropped = match e.drops {
        0 => String::new(),
        n => format!("; {} dropped, {} picked up again", count(n), count(e.drops_recovered)),
    };
    format!(
        "{} of {} placed; {}, {}, {}{}{blocked}{prevented}{dropped}",
        count(e.placed),
        count(all),
        many(e.grips, "grip"),
        many(e.hand_overs, "hand-over"),
        many(e.carries, "carrying step"),
        pinned.concat()
    )
}

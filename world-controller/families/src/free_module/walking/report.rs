//! The results that only walking structures have, as a part of the report.

use crate::free_module::report::KEY;
use metamorph_report::family_part::{FamilyPart, FamilyText};
use metamorph_text::format::{count, many};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

/// Additional results of walking structures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WalkReport {
    /// The model of bodies: `physics`.
    pub body: String,
    /// The engine and its version.
    pub engine: String,
    /// The time from the first gait to the end, in seconds.
    pub walked_s: f64,
    /// The distance between the centres of mass at both times, in mm.
    pub distance_mm: f64,
    /// The length of the path in mm, in strides of 5 s.
    pub path_mm: f64,
    /// The distance by the time.
    pub speed_mm_s: f64,
    /// How far the structure turned in degrees, counter-clockwise seen from above.
    pub turned_deg: f64,
    /// The work of all motors by weight and distance; null if there are rings, or if the structure stayed where it was.
    pub cost_of_transport: Option<f64>,
    /// The time of the latest self-collision; null if there was none.
    pub collided_s: Option<f64>,
    /// How often the body turned upside down.
    pub falls: u32,
    /// What was done after each change of the structure.
    pub situations: Vec<SituationReport>,
}

/// What was done after a change of the structure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SituationReport {
    /// When all agents knew the structure.
    pub since_s: f64,
    /// Modules that were dead.
    pub dead: Vec<u32>,
    /// Gaits tried.
    pub tried: u32,
    /// The speed of the first gait in mm/s; null if its trial did not end.
    pub first_mm_s: Option<f64>,
    /// The speed of the best gait.
    pub best_mm_s: Option<f64>,
    /// When a gait was kept; null if that did not come.
    pub kept_s: Option<f64>,
}

/// Returns the field and its text.
pub fn part(report: &WalkReport) -> FamilyPart {
    let metres = |mm: f64| format!("{:.2} m", mm / 1000.0);
    let walk = format!(
        "{} away in {:.0} s ({:.1} mm/s), on a path of {}, turned by {:.0} degrees{}{}",
        metres(report.distance_mm),
        report.walked_s,
        report.speed_mm_s,
        metres(report.path_mm),
        report.turned_deg,
        report.cost_of_transport.map_or(String::new(), |cost| format!(", cost of transport {cost:.1}")),
        if report.falls > 0 { format!(", {}", many(report.falls.into(), "fall")) } else { String::new() }
    );
    let mut moves = vec![("walk", walk.clone())];
    for s in &report.situations {
        let dead: Vec<String> = s.dead.iter().map(u32::to_string).collect();
        let which = if dead.is_empty() { "whole".to_owned() } else { format!("without {}", dead.join(", ")) };
        let speed = |mm_s: Option<f64>| mm_s.map_or("unknown".to_owned(), |v| format!("{v:.1} mm/s"));
        let kept = s.kept_s.map_or("none kept".to_owned(), |t| format!("kept at {t:.1} s"));
        let text = format!(
            "{which} from {:.1} s: {} tried, first {}, best {}, {kept}",
            s.since_s,
            many(s.tried.into(), "gait"),
            speed(s.first_mm_s),
            speed(s.best_mm_s)
        );
        moves.push(("gaits", text));
    }
    let tried: u64 = report.situations.iter().map(|s| u64::from(s.tried)).sum();
    let note = format!("A structure of free modules that walks: {walk}; {} gaits tried.", count(tried));
    FamilyPart { key: KEY, value: json!(report), text: FamilyText { moves, note, joint_steps: None } }
}

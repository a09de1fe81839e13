//! Tables of the thesis beside the results of the model.

use super::{Answer, RobotError};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::grid::landings;
use metamorph_protocol::roombots::posture::Posture;
use metamorph_protocol::roombots::reach::{
    Assumptions, PUBLISHED, incomplete_search, positions, reachable_each,
};
use serde_json::json;
use std::fmt::Write;

/// Returns one of the tables.
pub fn table(number: &str) -> Result<Answer, RobotError> {
    match number.trim() {
        "2.2" => Ok(reach()),
        "6.1" => Ok(primitives()),
        other => Err(RobotError::Usage(format!("unknown table `{other}`; write `2.2` or `6.1`"))),
    }
}

/// Explains why no complete method reproduces the published numbers.
const WHY: [&str; 6] = [
    "SRS and SRZ are mirror images, and grid, floor and classes are mirror symmetric: a complete \
     method must give them equal numbers. The thesis has 38 and 35.",
    "A head at most 3 cells away sees 28 connectors, so numbers above 28 count states (connector and \
     connection class), while the 2 of the single module counts connectors: it has 4 states.",
    "The thesis does not say which angles, which floor and which contact count. Each row is one \
     reading; PAR is always the smallest, PER is the largest only if middle cubes stay off the floor.",
    "The most plausible reading is an incomplete numerical search, of the kind thesis 5.1.3 describes: \
     with four random starts per state and the thesis's spheres all four numbers lie within the \
     spread of the runs (last row). This makes the table plausible and proves nothing.",
    "Thesis 2.2.4 says that no kind's set lies inside another's. In the complete sets PAR lies inside \
     PER; with lattice angles PAR lies inside SRS and SRZ.",
    "Row `lattice` is what the motion database reaches, row `exact` what continuous angles reach.",
];

/// Number of random starts per state of the incomplete search. Seeds are fixed, so that the table is deterministic.
const STARTS: u32 = 4;
/// Number of repetitions of the incomplete search.
const RUNS: u64 = 6;

/// Returns mean and standard deviation.
fn spread(run: &[usize]) -> String {
    let n = run.len() as f64;
    let mean = run.iter().sum::<usize>() as f64 / n;
    let square = run.iter().map(|x| (*x as f64 - mean).powi(2)).sum::<f64>();
    let deviation = (square / (n - 1.0).max(1.0)).sqrt();
    if deviation == 0.0 { format!("{mean:.0}") } else { format!("{mean:.0}±{deviation:.0}") }
}

fn reach() -> Answer {
    let sets = Assumptions::ALL;
    let found: Vec<_> = Kind::ALL.iter().map(|k| reachable_each(*k, &sets)).collect();
    let mut text = String::new();
    let mut line = |name: &str, cells: Vec<String>| {
        let _ = write!(text, "{name:50}");
        for cell in cells {
            let _ = write!(text, "{cell:>9}");
        }
        text.push('\n');
    };
    let names = |k: &Kind| if *k == Kind::Single { "S.M.".to_owned() } else { k.to_string() };
    line("Thesis table 2.2: states (connectors)", Kind::ALL.iter().map(names).collect());
    line("published", PUBLISHED.iter().map(u32::to_string).collect());
    let mut rows = Vec::new();
    for (i, set) in sets.iter().enumerate() {
        let counts: Vec<(usize, usize)> = found.iter().map(|f| (f[i].len(), positions(&f[i]))).collect();
        line(&set.describe(), counts.iter().map(|(s, p)| format!("{s} ({p})")).collect());
        rows.push(json!({
            "assumptions": set.describe(),
            "states": counts.iter().map(|c| c.0).collect::<Vec<_>>(),
            "positions": counts.iter().map(|c| c.1).collect::<Vec<_>>(),
        }));
    }
    let runs: Vec<Vec<usize>> = Kind::ALL
        .iter()
        .map(|k| (0..RUNS).map(|seed| incomplete_search(*k, STARTS, seed).len()).collect())
        .collect();
    let name = format!("damped search, {STARTS} random starts, {RUNS} runs");
    line(&name, runs.iter().map(|run| spread(run)).collect());
    rows.push(json!({"assumptions": name, "states_per_run": runs}));
    text.push_str("\nWhy the published numbers cannot all be met:\n");
    for (i, why) in WHY.iter().enumerate() {
        let _ = writeln!(text, "{}. {why}", i + 1);
    }
    let json = json!({
        "table": "2.2",
        "kinds": Kind::ALL.map(Kind::name),
        "published": PUBLISHED,
        "rows": rows,
        "why": WHY,
    });
    Answer::new(text, json)
}

/// τ and ρ (in quarter turns) of the primitives P1..P4 for H0 attached.
const PUBLISHED_PRIMITIVES: [(&str, (i16, i16), i16); 4] =
    [("P1", (0, 1), 2), ("P2", (0, 1), -1), ("P3", (1, 0), 1), ("P4", (1, 0), -2)];

fn primitives() -> Answer {
    let mut text = String::from("Thesis table 6.1: atomic motor primitives, H0 attached\n");
    let mut rows = Vec::new();
    let found = landings(Kind::Single);
    for (name, tau, quarters) in PUBLISHED_PRIMITIVES {
        let class = quarters.rem_euclid(4) as u8;
        let makers = found.iter().find(|(s, _)| (s.x, s.y) == tau && s.class == class);
        let q: Vec<Vec<i16>> =
            makers.map(|(_, p)| p.iter().map(|p: &Posture| p.degrees()).collect()).unwrap_or_default();
        let degrees = quarters * 90;
        let _ = writeln!(text, "{name}  shift {tau:?}  turn {degrees:4}°  joint angles {q:?}");
        rows.push(json!({"name": name, "shift": tau, "turn_degrees": degrees, "joint_angles": q}));
    }
    let _ = writeln!(
        text,
        "The model finds {} landings in all. With H3 attached the angles are sent in reverse order.",
        found.len()
    );
    Answer::new(text, json!({"table": "6.1", "primitives": rows, "landings": found.len()}))
}
